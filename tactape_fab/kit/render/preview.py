"""Previews of a tape or a panel, drawn from the bytes of the other files: Gerber, drill and CPL."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil

import numpy as np
import numpy.typing as npt

from tactape_fab.base.number_rows import number_rows
from tactape_fab.base.picture_file import encoded_png
from tactape_fab.kit.artifact import AnyArtifact, Artifact, LongArtifact
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.read.gerber_file import GerberShapes
from tactape_fab.kit.read.readback import read_cpl, read_drill
from tactape_fab.kit.read.written_gerber import first_body_mm, read_shapes
from tactape_fab.kit.render.colours import (
    BACKING_COLOURS,
    BASE_FILM,
    BODY,
    COVERLAY_COLOURS,
    GOLD,
    LEGEND_COLOURS,
    TERMINAL,
    Colour,
    rgb8,
)
from tactape_fab.texture.cpl import PLACEMENTS
from tactape_fab.texture.frames import FloatArray, board_to_picture, board_to_texture
from tactape_fab.texture.shapes import outlines_at, rotate

MARGIN_MM = 2.0
PX_PER_MM = 20.0
MOST_PX = 6000
OVERSAMPLING = 3
EDGE_MM = 0.1
_TERMINAL_SHARE = 0.2
_SUB_PIXEL_BITS = 4
_PIECE_STAMPS = 5000
"""Places that are drawn or written at once, which bounds the memory."""

_BACKGROUND = "#ffffff"
_RIM_MM = 0.3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Shapes:
    """Shapes of one colour: an outline repeated at many places, single polygons, or strokes (board frame, mm)."""

    name: str
    colour: Colour
    stamps: tuple[tuple[FloatArray, FloatArray], ...] = ()
    polygons: tuple[FloatArray, ...] = ()
    lines: tuple[FloatArray, ...] = ()
    line_mm: float = 0.0
    edge: Colour | None = None
    edge_mm: float = EDGE_MM


def stamps(content: GerberShapes) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Outline of each aperture, mm about its middle, and where it is flashed, board frame."""
    return tuple(
        (outline, content.flash_xy_mm[content.flash_aperture == i]) for i, outline in enumerate(content.aperture_outlines_mm)
    )


def _picture(files: Mapping[str, bytes], fab: FabProfile) -> tuple[list[_Shapes], FloatArray]:
    """All shapes in drawing order, and the board's outline."""
    # the outline is the first contour of the profile layer
    outline, *slots = read_shapes(files["profile"]).strokes_mm
    film, edge = COVERLAY_COLOURS[fab.coverlay_colour]
    openings, copper = read_shapes(files["coverlay-top"]), read_shapes(files["copper-top"])
    shapes = [*_backings(files), _Shapes(name="coverlay", colour=film, polygons=(outline,), edge=edge)]
    if copper.strokes_mm:
        web_mm = float(copper.stroke_width_mm[0])
        shapes.append(_Shapes(name="anchors", colour=edge, lines=copper.strokes_mm, line_mm=web_mm))
    shapes.append(_Shapes(name="openings", colour=BASE_FILM, stamps=stamps(openings), polygons=openings.areas_mm))
    shapes.append(_Shapes(name="pads", colour=GOLD, stamps=stamps(copper)))
    if "legend-top" in files:
        legend = read_shapes(files["legend-top"])
        line_mm = float(legend.stroke_width_mm[0]) if len(legend.stroke_width_mm) else 0.0
        colour = LEGEND_COLOURS[fab.legend_colour]
        shapes.append(_Shapes(name="legend", colour=colour, polygons=legend.areas_mm, lines=legend.strokes_mm, line_mm=line_mm))
    cpl = read_cpl(files["cpl"])
    bodies, terminals = [], []
    body = body_outline(files["components-top"])
    for angle in sorted(set(cpl.rotation_deg.tolist())):
        xy = cpl.xy_mm[cpl.rotation_deg == angle]
        bodies.append((rotate(body, angle), xy))
        terminals += [(rotate(end, angle), xy) for end in terminals_of(body)]
    shapes.append(_Shapes(name="bodies", colour=BODY, stamps=tuple(bodies)))
    shapes.append(_Shapes(name="terminals", colour=TERMINAL, stamps=tuple(terminals)))
    if "drill-npth" in files:
        angle_rad = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
        circle = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)
        holes = tuple(circle * d / 2 + (x, y) for x, y, d in read_drill(files["drill-npth"]))
        shapes.append(_Shapes(name="holes", colour=_BACKGROUND, polygons=holes, edge=edge))
    if slots:
        shapes.append(_Shapes(name="slots", colour=_BACKGROUND, polygons=tuple(slots), edge=edge))
    return shapes, outline


def _backings(files: Mapping[str, bytes]) -> Iterator[_Shapes]:
    """Stiffener and adhesive under the film, drawn as rims around it; the lowest layer has the widest rim."""
    given = [role for role in ("adhesive-bottom", "stiffener-bottom") if role in files]
    # from the lowest layer up: the adhesive is drawn first, and its wider rim shows around the stiffener
    for place, role in enumerate(given):
        rim_mm = _RIM_MM * (len(given) - place)
        areas = read_shapes(files[role]).areas_mm
        yield _Shapes(name=role, colour=BACKING_COLOURS[role], polygons=areas, edge=BACKING_COLOURS[role], edge_mm=2 * rim_mm)


def body_outline(components: bytes) -> FloatArray:
    """The unrotated body as a rectangle, from the first part of the component layer; other parts are not read."""
    length, width = (side / 2 for side in first_body_mm(components))
    return np.array([(length, -width), (length, width), (-length, width), (-length, -width)])


def terminals_of(body: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Outlines of both metal ends of a body, mm about its middle."""
    # the corner (+, +) of the rectangle
    length, width = body[1]
    inner = length * (1 - 2 * _TERMINAL_SHARE)
    end = np.array([(length, -width), (length, width), (inner, width), (inner, -width)])
    return end, -end


def render_preview(artifacts: Sequence[AnyArtifact], fab: FabProfile) -> tuple[LongArtifact, Artifact]:
    """SVG and PNG pictures of the finished tape.

    artifacts: The rendered files; only their bytes are used.
    fab: Gives the colours of coverlay and legend.
    """
    files = {a.role: a.data for a in artifacts if isinstance(a, Artifact)}
    name = next(a.path for a in artifacts if a.role == "cpl").rsplit("/", 1)[-1].removesuffix(PLACEMENTS[fab.assembly].ending)
    shapes, outline = _picture(files, fab)
    size_mm = outline.max(axis=0)
    return (
        LongArtifact(role="preview-svg", path=f"preview/{name}.svg", pieces=partial(_svg, shapes, size_mm, name)),
        Artifact(role="preview-png", path=f"preview/{name}.png", data=_png(shapes, size_mm)),
    )


# SVG


def _down(xy_mm: FloatArray) -> FloatArray:
    """Board points with y down, as in SVG."""
    return board_to_texture(xy_mm, (0.0, 0.0))


def _path(points: FloatArray, *, closed: bool) -> str:
    """A path in absolute coordinates."""
    text = ("M%.4f %.4f" + "L%.4f %.4f" * (len(points) - 1)) % tuple(points.ravel().tolist())
    return text + "Z" if closed else text


def _stamp_uses(outline: FloatArray, xy: FloatArray, key: str) -> Iterator[str]:
    """An outline defined once and used at every place."""
    yield f'<defs><path id="{key}" d="{_path(outline, closed=True)}"/></defs>\n'
    for i in range(0, len(xy), _PIECE_STAMPS):
        yield number_rows(f'<use href="#{key}" x="%.4f" y="%.4f"/>\n', xy[i : i + _PIECE_STAMPS]).decode("ascii")


def _svg(shapes: Sequence[_Shapes], size_mm: FloatArray, name: str) -> Iterator[bytes]:
    return (line.encode("ascii") for line in _svg_lines(shapes, size_mm, name))


def _svg_lines(shapes: Sequence[_Shapes], size_mm: FloatArray, name: str) -> Iterator[str]:
    width, height = size_mm + 2 * MARGIN_MM
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{height:.4f}mm" '
        f'viewBox="{-MARGIN_MM:.4f} {-size_mm[1] - MARGIN_MM:.4f} {width:.4f} {height:.4f}">\n'
        f"<title>{name}</title>\n"
    )
    for shape in shapes:
        edge = f' stroke="{shape.edge}" stroke-width="{shape.edge_mm:g}"' if shape.edge else ""
        yield f'<g id="{shape.name}" fill="{shape.colour}"{edge}>\n'
        for i, (outline, xy) in enumerate(shape.stamps):
            yield from _stamp_uses(_down(outline), _down(xy), f"{shape.name}-{i}")
        for polygon in shape.polygons:
            yield f'<path d="{_path(_down(polygon), closed=True)}"/>\n'
        if shape.lines:
            stroke = "".join(_path(_down(line), closed=False) for line in shape.lines)
            yield (
                f'<path d="{stroke}" fill="none" stroke="{shape.colour}" stroke-width="{shape.line_mm:.4f}" '
                'stroke-linecap="round" stroke-linejoin="round"/>\n'
            )
        yield "</g>\n"
    yield "</svg>\n"


# PNG


def _bgr(colour: Colour) -> tuple[int, int, int]:
    red, green, blue = rgb8(colour)
    return blue, green, red


def picture_px_per_mm(side_mm: float) -> float:
    """Scale of the PNG of a board whose longer side, with its margins, is `side_mm`; the side is rounded up to whole pixels."""
    return min(PX_PER_MM, MOST_PX / side_mm)


def picture_side_px(side_mm: float, px_per_mm: float) -> int:
    """Length of a side of the PNG, px."""
    # at the scale of `MOST_PX` the product may lie just above it, and would be rounded up to a picture that verify refuses
    return min(ceil(side_mm * px_per_mm), MOST_PX)


def _png(shapes: Sequence[_Shapes], size_mm: FloatArray) -> bytes:
    import cv2

    extent_mm = size_mm + 2 * MARGIN_MM
    # the picture has at most `MOST_PX` along a side, and so has its oversampled image
    longest_mm = float(extent_mm.max())
    px_per_mm = picture_px_per_mm(longest_mm)
    finer = max(1, min(OVERSAMPLING, int(MOST_PX / (longest_mm * px_per_mm))))
    width, height = (picture_side_px(float(v), px_per_mm) for v in extent_mm)
    image = np.empty((height * finer, width * finer, 3), dtype=np.uint8)
    cv2.rectangle(image, (0, 0), (width * finer, height * finer), _bgr(_BACKGROUND), cv2.FILLED)  # np.full is slow
    # OpenCV takes coordinates in 1/16 px with `shift` 4; oversampling and INTER_AREA antialias the edges
    one = 1 << _SUB_PIXEL_BITS

    def px(points_mm: FloatArray) -> npt.NDArray[np.int32]:
        upper_left_mm = (-MARGIN_MM, float(size_mm[1]) + MARGIN_MM)
        fixed: npt.NDArray[np.int32] = np.rint(board_to_picture(points_mm, upper_left_mm, px_per_mm * finer) * one).astype(
            np.int32
        )
        return fixed

    def line_px(width_mm: float) -> int:
        return max(round(width_mm * px_per_mm * finer), 1)

    for shape in shapes:
        colour = _bgr(shape.colour)
        for outline, xy in shape.stamps:
            for i in range(0, len(xy), _PIECE_STAMPS):
                for polygon in px(outlines_at(xy[i : i + _PIECE_STAMPS], outline)):
                    cv2.fillConvexPoly(image, polygon, colour, cv2.LINE_8, _SUB_PIXEL_BITS)
        for polygon in shape.polygons:
            cv2.fillPoly(image, [px(polygon)], colour, cv2.LINE_8, _SUB_PIXEL_BITS)
            if shape.edge:
                cv2.polylines(image, [px(polygon)], True, _bgr(shape.edge), line_px(shape.edge_mm), cv2.LINE_8, _SUB_PIXEL_BITS)
        for line in shape.lines:
            cv2.polylines(image, [px(line)], False, colour, line_px(shape.line_mm), cv2.LINE_8, _SUB_PIXEL_BITS)
    if finer > 1:
        image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    settings = [cv2.IMWRITE_PNG_COMPRESSION, 3]
    if hasattr(cv2, "IMWRITE_PNG_FILTER"):  # not in older OpenCV; makes files smaller, and takes a third of the time
        settings += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
    return encoded_png(image, settings)
