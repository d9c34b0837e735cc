"""Picture of a decoded frame: band-passed depth, dots, grid and symbols, pose, error, place on the tape."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, radians, sin
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tactape_fab.base.libraries import library
from tactape_fab.base.picture_file import refuse_pictures, write_picture
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import DIRECTIONS_XY, LETTERS, FloatArray
from tactape_fab.texture.tape import Tape

if TYPE_CHECKING:
    from tactape_fab.sense.decode.result import Localization

Picture = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]
Point = tuple[float, float]

LEAST_SIDE_PX = 720
WORDS_PX, PANEL_PX = 56, 230
"""Heights of the bands above and below the enlarged frame, px."""
_SUBPIXEL = 4
_GRID, _PLAIN, _AGREEING, _OTHER = (120, 95, 60), (235, 235, 235), (240, 190, 90), (50, 110, 245)
_X_AXIS, _Y_AXIS, _TEXT, _BAND, _FIELD = (60, 230, 245), (215, 150, 225), (255, 255, 255), (36, 36, 36), (95, 95, 95)
"""Colours, BGR as in OpenCV; agreeing dots are light blue rings, others orange diamonds, safe for colour-blind readers."""
_ERROR_SCALES_UM = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
_ERROR_PX = 78


def draw_overlay(depth: npt.ArrayLike, sensor: SensorProfile, tapes: Sequence[Tape], fix: Localization, frame: int) -> Picture:
    """Picture of a frame and its answer.

    depth (h, w): As the sensor delivers it.
    tapes: The registry. Of the answer's tape the grid, the symbols and the whole outline are drawn.
    Returns (height, width, 3): Text, the enlarged canonical image, and the tape with the contact beside the error; BGR.
    """
    from tactape_fab.sense.decode.dots.detect import band_pass
    from tactape_fab.sense.decode.dots.frame_dots import frame_dots
    from tactape_fab.sense.decode.dots.inputs import canonical_frame
    from tactape_fab.sense.decode.result import tape_named

    image = canonical_frame(depth, sensor)
    scale = float(np.sqrt(sensor.px_per_mm[0] * sensor.px_per_mm[1]))
    # rounded up
    zoom = max(1, -(-LEAST_SIDE_PX // max(image.shape)))
    picture = _shades(band_pass(image, scale), zoom)
    dots = _zoomed(frame_dots(image, sensor).xy_px, zoom)
    radius = 0.17 * scale * zoom
    tape = next((t for t in tapes if (t.name, t.sector, t.origin) == tape_named(fix)), None)
    view = None
    if tape is not None and fix.position_mm is not None and fix.theta_deg is not None:
        view = View(sensor, fix, zoom)
        _draw_grid(picture, tape, view)
        _draw_symbols(picture, tape, view, dots, radius)
        _draw_pose(picture, tape, view)
    else:
        for x, y in dots:
            _circle(picture, (x, y), radius, _PLAIN)
    words = _band(picture.shape[1], WORDS_PX)
    for line, text in enumerate(_words(fix, frame)):
        _write(words, text, (8, 22 + 22 * line))
    panel = _band(picture.shape[1], PANEL_PX)
    if tape is not None and view is not None:
        _draw_tape(panel[:, :-PANEL_PX], tape, view, fix)
        _draw_error(panel[:, -PANEL_PX:], fix)
    return np.concatenate([words, picture, panel])


def refuse_overlay(folder: Path) -> None:
    """Refuse a folder with pictures of frames that this tool did not draw, such as the frames themselves. Raises SpecError."""
    refuse_pictures(folder, "frame-*.png", "overlay")


def write_overlay(folder: Path, picture: Picture, frame: int) -> None:
    """Write a picture as ``frame-NNNNNN.png``. Raises TactapeError when it cannot be written."""
    write_picture(folder / f"frame-{frame:06d}.png", picture, "overlay")


class View:
    """Map from the texture to the enlarged picture: the inverse of T = S + (1/R) [[cos, sin], [-sin, cos]] (p - p0).

    It includes the aspect, shear and distortion of the profile's camera.
    """

    def __init__(self, sensor: SensorProfile, fix: Localization, zoom: int) -> None:
        assert fix.position_mm is not None and fix.theta_deg is not None
        c, s = cos(radians(fix.theta_deg)), sin(radians(fix.theta_deg))
        self.turn = np.array([[c, s], [-s, c]])
        self.position_mm = np.asarray(fix.position_mm)
        self.refined = (fix.px_per_mm or sensor.px_per_mm[0]) / sensor.px_per_mm[0]
        self.px_per_mm = np.asarray(sensor.px_per_mm) * self.refined
        self.centre_px = sensor.centre_px
        self.zoom = zoom
        g = sensor.geometry
        self.camera = None if (g.aspect, g.shear, g.k1) == (0.0, 0.0, 0.0) else sensor.camera
        corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) * (sensor.width_px - 1, sensor.height_px - 1)
        self.corners_mm = self.position_mm + self._offset_mm(corners) @ self.turn.T

    def _offset_mm(self, px: FloatArray) -> FloatArray:
        """Vectors on the gel, mm along image u and v, from the point that the image centre sees to those that pixels see."""
        if self.camera is None:
            return np.asarray((px - self.centre_px) / self.px_per_mm)
        return (self.camera.from_px(px) - self.camera.from_px(self.centre_px)) / self.refined

    def to_px(self, texture_mm: npt.ArrayLike) -> FloatArray:
        """Texture points, mm, as (u, v) of the enlarged picture; shape (n, 2)."""
        offset_mm = (np.asarray(texture_mm, dtype=np.float64) - self.position_mm) @ self.turn
        if self.camera is None:
            return _zoomed(offset_mm * self.px_per_mm + self.centre_px, self.zoom)
        return _zoomed(self.camera.to_px(offset_mm * self.refined + self.camera.from_px(self.centre_px)), self.zoom)


def placed_mm(tape: Tape) -> FloatArray:
    """Nominal places of a tape's parts, texture frame, mm (Eq. 9 of the paper); in designator order, shape (n, 2)."""
    cells = tape.cells()
    return cells * tape.pitch_mm + tape.displacement_mm * DIRECTIONS_XY[tape.symbols[cells[:, 1], cells[:, 0]]]


def _zoomed(xy_px: FloatArray, zoom: int) -> FloatArray:
    """Pixel coordinates of the frame converted to the enlarged picture; whole numbers are pixel centres in both."""
    return np.asarray((xy_px + 0.5) * zoom - 0.5)


def _shades(high: npt.NDArray[np.float32], zoom: int) -> Picture:
    """Grey image scaled from the lowest to the highest percentile, enlarged without smoothing."""
    low, top = np.percentile(high, (1.0, 99.8))
    grey = np.clip((high - low) / max(float(top - low), 1e-30), 0.0, 1.0) * 200
    enlarged = np.repeat(np.repeat(grey.astype(np.uint8), zoom, axis=0), zoom, axis=1)
    return np.ascontiguousarray(np.stack([enlarged] * 3, axis=-1))


def grid_lines_mm(tape: Tape, view: View) -> FloatArray:
    """Ends of the grid lines within the tape and the picture, shape (n, 2, 2), texture frame, mm."""
    low = np.clip(np.floor(view.corners_mm.min(axis=0) / tape.pitch_mm), 0, (tape.columns - 1, tape.rows - 1))
    high = np.clip(np.ceil(view.corners_mm.max(axis=0) / tape.pitch_mm), 0, (tape.columns - 1, tape.rows - 1))
    columns = [((column, low[1]), (column, high[1])) for column in np.arange(low[0], high[0] + 1)]
    rows = [((low[0], row), (high[0], row)) for row in np.arange(low[1], high[1] + 1)]
    return np.reshape([*columns, *rows], (-1, 2, 2)) * tape.pitch_mm


def box_mm(tape: Tape) -> tuple[FloatArray, FloatArray]:
    """Corner and size of the board's outline, texture frame, mm; of the grid's where the texture is on no board."""
    if tape.surface is not None:
        return np.full(2, -tape.pitch_mm), (np.array([tape.columns, tape.rows]) + 1.0) * tape.pitch_mm
    (x0, y0), (width_mm, height_mm) = tape.board.texture_origin_mm, tape.board.size_mm
    return np.array([-x0, y0 - height_mm]), np.array([width_mm, height_mm])


def ellipse_mm(covariance: FloatArray) -> FloatArray:
    """Ellipse of two standard deviations of a position, a closed line of shape (n, 2), texture frame, mm."""
    values, axes = np.linalg.eigh(covariance[:2, :2])
    turn = np.linspace(0.0, 2 * np.pi, 73)
    around = 2.0 * np.sqrt(np.maximum(values, 0.0)) * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return np.asarray(around @ axes.T)


def _draw_grid(picture: Picture, tape: Tape, view: View) -> None:
    for start, end in grid_lines_mm(tape, view):
        # from grid point to grid point, as a lens bends lines
        steps = np.linspace(0.0, 1.0, max(round(float(np.abs(end - start).max()) / tape.pitch_mm), 1) + 1)
        _line(picture, view.to_px(start + steps[:, None] * (end - start)), _GRID, 1, closed=False)


def _draw_symbols(picture: Picture, tape: Tape, view: View, dots: FloatArray, radius: float) -> None:
    """Draw every dot: a ring and its letter if it is at its part's place, else a diamond; with a line from the grid point."""
    cells = tape.cells()
    symbols = tape.symbols[cells[:, 1], cells[:, 0]]
    nodes = view.to_px(cells * tape.pitch_mm)
    places = view.to_px(placed_mm(tape))
    pitch_px = float(view.px_per_mm[0]) * tape.pitch_mm * view.zoom
    for x, y in dots:
        near = int(np.hypot(*(places - (x, y)).T).argmin())
        if np.hypot(*(places[near] - (x, y))) < pitch_px / 10:
            (u, v), (to_u, to_v) = nodes[near], places[near] - nodes[near]
            _stroke(picture, (u, v), (x, y), _AGREEING, 2)
            _circle(picture, (x, y), radius, _AGREEING)
            far = 0.24 * pitch_px / max(float(np.hypot(to_u, to_v)), 1e-9)
            _write(picture, LETTERS[symbols[near]], (round(u - far * to_u) - 5, round(v - far * to_v) + 5), 0.45, _AGREEING)
        else:
            corners = [(x, y - 1.3 * radius), (x + 1.3 * radius, y), (x, y + 1.3 * radius), (x - 1.3 * radius, y)]
            for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
                _stroke(picture, a, b, _OTHER, 2)
            node = int(np.hypot(*(nodes - (x, y)).T).argmin())
            if np.hypot(*(nodes[node] - (x, y))) < pitch_px / 2:
                _stroke(picture, (nodes[node, 0], nodes[node, 1]), (x, y), _OTHER, 2)


def _draw_pose(picture: Picture, tape: Tape, view: View) -> None:
    """Draw texture x and y from the image centre as arrows, two pitches long."""
    start = view.to_px(view.position_mm)
    for axis, colour, name in ((0, _X_AXIS, "x"), (1, _Y_AXIS, "y")):
        end = view.to_px(view.position_mm + 2 * tape.pitch_mm * np.eye(2)[axis])
        _arrow(picture, (start[0], start[1]), (end[0], end[1]), colour)
        beyond = end + 0.12 * (end - start)
        _write(picture, name, (round(beyond[0]) - 6, round(beyond[1]) + 6), 0.7, colour)
    _circle(picture, (start[0], start[1]), 6, _TEXT)


def _draw_tape(panel: Picture, tape: Tape, view: View, fix: Localization) -> None:
    """Draw the whole tape in its box: outline, parts, the sensor's field, an arrow along image u, the dot at the contact."""
    low, size_mm = box_mm(tape)
    room = np.array([panel.shape[1], panel.shape[0]]) - 32.0
    px_per_mm = float((room / size_mm).min())
    corner = 16.0 + (room - size_mm * px_per_mm) / 2

    def to_px(texture_mm: npt.ArrayLike) -> FloatArray:
        return np.asarray((np.asarray(texture_mm) - low) * px_per_mm + corner)

    _line(panel, to_px(low + size_mm * np.array([(0, 0), (1, 0), (1, 1), (0, 1)])), _TEXT, 1)
    u, v = np.rint(to_px(placed_mm(tape))).astype(int).T
    panel[np.clip(v, 0, panel.shape[0] - 1), np.clip(u, 0, panel.shape[1] - 1)] = _FIELD
    _line(panel, to_px(view.corners_mm[[0, 1, 3, 2]]), _OTHER, 2)
    start = to_px(view.position_mm)
    ahead = view.turn @ (1.0, 0.0)  # image u on the texture
    end = start + ahead * max(4 * tape.pitch_mm * px_per_mm, 22.0)
    _arrow(panel, (start[0], start[1]), (end[0], end[1]), _X_AXIS)
    _circle(panel, (start[0], start[1]), 4, _TEXT)
    if fix.contact_mm is not None:
        at = to_px(fix.contact_mm)
        _circle(panel, (at[0], at[1]), 2, _AGREEING)


def _draw_error(panel: Picture, fix: Localization) -> None:
    """Draw the ellipse of two standard deviations of the position, texture x right, y down, in a box labelled with its size."""
    centre = (panel.shape[1] / 2, 104.0)
    if fix.covariance is None:
        _write(panel, "no covariance", (60, 110), 0.45)
        return
    sigma_um = np.sqrt(np.diag(fix.covariance)[:2]) * 1000.0
    half_um = next((s for s in _ERROR_SCALES_UM if s >= 2.2 * sigma_um.max()), _ERROR_SCALES_UM[-1])
    px_per_um = _ERROR_PX / half_um
    box = np.array(centre) + _ERROR_PX * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    _line(panel, box, _FIELD, 1)
    _stroke(panel, (centre[0] - _ERROR_PX, centre[1]), (centre[0] + _ERROR_PX, centre[1]), _FIELD, 1)
    _stroke(panel, (centre[0], centre[1] - _ERROR_PX), (centre[0], centre[1] + _ERROR_PX), _FIELD, 1)
    shown = np.clip(ellipse_mm(fix.covariance) * 1000.0 * px_per_um, -_ERROR_PX, _ERROR_PX) + centre
    _line(panel, shown, _AGREEING, 2)
    _write(panel, f"2 sigma; box +-{half_um:g} um", (28, 18), 0.45)
    theta_deg = float(np.degrees(np.sqrt(fix.covariance[2, 2])))
    _write(panel, f"sigma {sigma_um[0]:.1f}, {sigma_um[1]:.1f} um, {theta_deg:.3f} deg", (8, 208), 0.42)


def _band(width: int, height: int) -> Picture:
    return np.full((height, width, 3), _BAND, dtype=np.uint8)


def _fixed(at: Point) -> tuple[int, int]:
    return round(float(at[0]) * 2**_SUBPIXEL), round(float(at[1]) * 2**_SUBPIXEL)


def _stroke(picture: Picture, a: Point, b: Point, colour: Colour, width: int) -> None:
    cv2 = library("cv2", "drawing a picture")

    cv2.line(picture, _fixed(a), _fixed(b), colour, width, cv2.LINE_AA, _SUBPIXEL)


def _arrow(picture: Picture, a: Point, b: Point, colour: Colour) -> None:
    cv2 = library("cv2", "drawing a picture")

    cv2.arrowedLine(picture, _fixed(a), _fixed(b), colour, 2, cv2.LINE_AA, _SUBPIXEL, 0.2)


def _line(picture: Picture, points: FloatArray, colour: Colour, width: int, *, closed: bool = True) -> None:
    cv2 = library("cv2", "drawing a picture")

    fixed = np.rint(points * 2**_SUBPIXEL).astype(np.int32)
    cv2.polylines(picture, [fixed], closed, colour, width, cv2.LINE_AA, _SUBPIXEL)


def _circle(picture: Picture, at: Point, radius: float, colour: Colour) -> None:
    cv2 = library("cv2", "drawing a picture")

    cv2.circle(picture, _fixed(at), round(radius * 2**_SUBPIXEL), colour, 2, cv2.LINE_AA, _SUBPIXEL)


def _write(picture: Picture, text: str, at: tuple[int, int], size: float = 0.5, colour: Colour = _TEXT) -> None:
    cv2 = library("cv2", "drawing a picture")

    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def _words(fix: Localization, frame: int) -> list[str]:
    first = f"frame {frame}: {fix.status}, {fix.n_agree} of {fix.n_dots} dots agree"
    if not fix.located:
        return [first, *wrap(f"not located: {fix.reason}".encode("ascii", "replace").decode(), 85)]
    where = "" if fix.position_mm is None else f"  x {fix.position_mm[0]:.3f}  y {fix.position_mm[1]:.3f} mm"
    turn = "" if fix.theta_deg is None else f"  {fix.theta_deg:.2f} deg"
    chance = "" if fix.p_false is None else f"  p_false {fix.p_false:.1e}"
    return [first, f"{fix.tape or f'sector {fix.sector}'}{where}{turn}{chance}"]
