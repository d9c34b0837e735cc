"""Checks of the parts in a kit's pictures against the manifest: pixels of the PNG, and the placement preview."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from tactape_fab.base.fields import named
from tactape_fab.kit.render.preview import MARGIN_MM, picture_px_per_mm, picture_side_px
from tactape_fab.texture.frames import FloatArray, board_to_picture
from tactape_fab.texture.shapes import rotate

_LEAST_BODY_PX = 5.0
"""Least width of a body whose pixels can be distinguished from those beside it."""
_SAME_COLOUR = 40
"""Largest difference in each channel, of 255: a body differs from the film around it by more than 100 in one."""
_ALONG, _BESIDE = 0.15, 0.75
"""Places of probes: along a body, short of its terminals, as a fraction of its length; and beside it, within its opening, as a
fraction of its width."""
_SAME_MM, _SAME_DEG = 1e-3, 1e-3
_XY = rb"(-?\d{1,7}\.\d\d)"
_POINTS = rb"(?:-?\d{1,7}\.\d\d,-?\d{1,7}\.\d\d ?){4}"
_PLACED = re.compile(
    rb'<polygon points="(%b)" fill="[^"]{1,9}"/>\n(?:<polygon points="%b" fill="[^"]{1,9}"/>\n){2}'
    rb'<circle cx="%b" cy="%b" [^>]{1,99}>\n<text x="%b" y="%b" [^>]{1,199}>R(\d{1,7})</text>\n' % (_POINTS, _POINTS, *[_XY] * 4)
)
"""A part in the placement preview: body, terminals, mark of land 1, designator."""
_VIEW = re.compile(rb'viewBox="%b %b (\d{1,7}) (\d{1,7})"' % (_XY, _XY))
_UNITS_PER_MM = 100.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pictured:
    """Expected content of pictures: size of the board, and parts R1 ... Rn in its frame; xy_mm (n, 2), rotation_deg (n,)."""

    size_mm: tuple[float, float]
    xy_mm: FloatArray
    rotation_deg: FloatArray
    body_mm: tuple[float, float]

    def at(self, along: float, across: float) -> FloatArray:
        """A point of each part, given as fractions of length and width from its middle; shape (n, 2), mm."""
        offset = np.array([along * self.body_mm[0], across * self.body_mm[1]])
        turned = {angle: rotate([offset], angle)[0] for angle in set(self.rotation_deg.tolist())}
        return np.asarray(self.xy_mm + np.array([turned[angle] for angle in self.rotation_deg.tolist()]))


def px_per_mm(image: np.ndarray, shown: Pictured) -> float:
    """Scale of a picture, from its longer side: that of this version's pictures, where the side agrees with it."""
    side_px, side_mm = max(image.shape[:2]), max(shown.size_mm) + 2 * MARGIN_MM
    usual = picture_px_per_mm(side_mm)
    # the side was rounded up to whole pixels, so that of any other scale is known to half a pixel: at the far end of a panel a
    # probe half a pixel off is on the film beside a body of 6 px
    return usual if picture_side_px(side_mm, usual) == side_px else (side_px - 0.5) / side_mm


def shows_bodies(image: np.ndarray, shown: Pictured) -> bool:
    """Whether a picture is fine enough to show where parts are."""
    return px_per_mm(image, shown) * shown.body_mm[1] >= _LEAST_BODY_PX


def png_problem(image: np.ndarray, shown: Pictured) -> str | None:
    """Reason why a picture does not show these parts; None if each has a body's colour at its middle and another beside it."""
    scale, (width, height) = px_per_mm(image, shown), shown.size_mm
    # the shorter side was also rounded up, by up to a pixel, and the scale may be off by half a pixel
    if np.abs(np.array([width, height]) + 2 * MARGIN_MM - np.array(image.shape[1::-1]) / scale).max() * scale > 1.5 + 1e-6:
        return f"the PNG is not in the proportions of {width:g} x {height:g} mm"
    if not shows_bodies(image, shown):
        return None

    def colours(xy_mm: FloatArray) -> np.ndarray:
        columns, rows = np.rint(board_to_picture(xy_mm, (-MARGIN_MM, height + MARGIN_MM), scale)).astype(np.int64).T
        seen = image[rows.clip(0, image.shape[0] - 1), columns.clip(0, image.shape[1] - 1)]
        return np.asarray(seen, dtype=np.int64)

    middle = np.median(colours(shown.xy_mm), axis=0)

    def is_body(along: float, across: float) -> np.ndarray:
        return np.asarray((np.abs(colours(shown.at(along, across)) - middle) <= _SAME_COLOUR).all(axis=1))

    within = is_body(0.0, 0.0) & is_body(_ALONG, 0.0) & is_body(-_ALONG, 0.0)
    # on one side another body may be near, so one of both is enough
    off = np.flatnonzero(~within | (is_body(0.0, _BESIDE) & is_body(0.0, -_BESIDE)))
    return f"the PNG does not show {named([f'R{i + 1}' for i in off.tolist()])} in its place" if len(off) else None


def placements_problem(svg: bytes, shown: Pictured) -> str | None:
    """Reason why a placement preview is wrong: bodies, lands 1 and names of all parts in view, and the first angle; or None."""
    found, view = _PLACED.findall(svg), _VIEW.search(svg)
    if view is None or not found or {svg.count(b"<circle"), svg.count(b">R")} != {len(found)}:
        return "the preview of placements is not in the form that this tool writes"
    # y points down in the picture
    x, y, wide, high = (float(value) / _UNITS_PER_MM for value in view.groups())
    inside = ((shown.xy_mm > (x, -y - high)) & (shown.xy_mm < (x + wide, -y))).all(axis=1)
    numbers = np.array([int(part[-1]) - 1 for part in found])
    missing = sorted({*np.flatnonzero(inside).tolist()}.difference(numbers.tolist()))
    if missing:
        return f"the preview of placements lacks {named([f'R{i + 1}' for i in missing])}"
    if numbers[0] or numbers.min() < 0 or numbers.max() >= len(shown.xy_mm) or len(set(numbers.tolist())) < len(numbers):
        return "the preview of placements does not begin with R1, has a part twice, or one that is not there"
    corners = np.stack([shown.at(*corner)[numbers] for corner in ((0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5))], axis=1)
    values = [[*part[0].replace(b",", b" ").split(), *part[1:5]] for part in found]
    drawn = np.array(values, dtype=np.float64).reshape(-1, 6, 2) * (1, -1) / _UNITS_PER_MM
    marks, names = drawn[:, 4], drawn[:, 5]
    off = np.abs(drawn[:, :4] - corners).max(axis=(1, 2)) > _SAME_MM
    # land 1 is at the left end of an unrotated part, and a name is beside its part
    ends, middles = shown.at(-0.5, 0.0)[numbers], shown.xy_mm[numbers]
    off |= (((marks - ends) * (ends - middles)).sum(axis=1) <= 0.0) | (np.hypot(*(marks - ends).T) >= shown.body_mm[1])
    off |= np.hypot(*(names - middles).T) > sum(shown.body_mm)
    if off.any():
        parts = named([f"R{i + 1}" for i in numbers[off].tolist()])
        return f"the preview of placements has the body, the mark of land 1 or the name of {parts} elsewhere"
    degrees = re.findall(r">(-?\d{1,3}(?:\.\d{1,6})?)°<", svg.decode("utf-8", "replace"))
    right_deg = float(shown.rotation_deg[0]) % 360.0
    same = len(degrees) == 1 and abs(float(degrees[0]) - right_deg) <= _SAME_DEG
    return None if same else f"the preview of placements does not say the {right_deg:g} deg of R1"
