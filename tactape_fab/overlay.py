"""What the decoder saw of a frame, as a picture: band-passed depth, dots, grid, agreeing dots, axes of the tape."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tactape_fab.errors import TactapeError
from tactape_fab.fields import shown_path
from tactape_fab.profiles.sensors import SensorProfile
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray
from tactape_fab.texture.tape import Tape

if TYPE_CHECKING:
    from tactape_fab.decode.result import Localization

Picture = npt.NDArray[np.uint8]

LEAST_SIDE_PX = 720
_SUBPIXEL = 4
_GRID, _DOT, _AGREEING, _X_AXIS, _Y_AXIS, _TEXT = (
    (150, 110, 0), (0, 140, 255), (90, 220, 90), (60, 60, 255), (255, 160, 60), (255, 255, 255),
)  # fmt: skip
"""Colours, blue first as OpenCV has them."""


def draw_overlay(depth: npt.ArrayLike, sensor: SensorProfile, tapes: Sequence[Tape], fix: Localization, frame: int) -> Picture:
    """Picture of a frame and its answer.

    Parameters
    ----------
    depth : array_like, shape (h, w)
        As the sensor delivers it.
    tapes : sequence of Tape
        The registry. Of the answer's tape the grid and the places of its parts are drawn.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
        Canonical image, enlarged; blue first.
    """
    import cv2

    from tactape_fab.decode.detect import band_pass, detect

    image = np.asarray(depth).astype(np.float32)
    image = np.ascontiguousarray(sensor.canonical(np.where(np.abs(image) < 1e15, image, 0.0).astype(np.float32)))
    scale = float(np.sqrt(sensor.px_per_mm[0] * sensor.px_per_mm[1]))
    dots = detect(image, scale)
    zoom = max(1, -(-LEAST_SIDE_PX // max(image.shape)))
    picture = _shades(band_pass(image, scale), zoom)
    places = np.empty((0, 2))
    tape = next((t for t in tapes if t.name == fix.tape), None)
    if tape is not None and fix.position_mm is not None and fix.theta_deg is not None:
        view = View(sensor, fix, zoom)
        _draw_grid(picture, tape, view)
        places = view.to_px(placed_mm(tape))
    reach_px = (tapes[0].pitch_mm / 10 if tapes else 0.15) * scale * zoom
    for x, y in _zoomed(dots.xy_px, zoom):
        agrees = len(places) and float(np.hypot(*(places - (x, y)).T).min()) < reach_px
        _circle(picture, (x, y), 0.2 * scale * zoom, _AGREEING if agrees else _DOT)
    if tape is not None and fix.position_mm is not None and fix.theta_deg is not None:
        _draw_axes(picture, tape, View(sensor, fix, zoom))
    lines = _words(fix, frame)
    picture[: 10 + 20 * len(lines)] //= 3
    for line, text in enumerate(lines):
        cv2.putText(picture, text, (8, 20 + 20 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _TEXT, 1, cv2.LINE_AA)
    return picture


def write_overlay(folder: Path, picture: Picture, frame: int) -> None:
    """Write a picture as ``frame-NNNNNN.png``.

    Raises
    ------
    TactapeError
        When it cannot be written.
    """
    import cv2

    path = folder / f"frame-{frame:06d}.png"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise TactapeError(f"{shown_path(path)} cannot be written: {reason}") from error


class View:
    """From the texture to the enlarged picture: the inverse of SPEC's T = S + (1/R) [[cos, sin], [-sin, cos]] (p - p0)."""

    def __init__(self, sensor: SensorProfile, fix: Localization, zoom: int) -> None:
        assert fix.position_mm is not None and fix.theta_deg is not None
        c, s = cos(radians(fix.theta_deg)), sin(radians(fix.theta_deg))
        self.turn = np.array([[c, s], [-s, c]])
        self.position_mm = np.asarray(fix.position_mm)
        refined = (fix.px_per_mm or sensor.px_per_mm[0]) / sensor.px_per_mm[0]
        self.px_per_mm = np.asarray(sensor.px_per_mm) * refined
        self.centre_px = sensor.centre_px
        self.zoom = zoom
        corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) * (sensor.width_px - 1, sensor.height_px - 1)
        self.corners_mm = self.position_mm + (corners - self.centre_px) / self.px_per_mm @ self.turn.T

    def to_px(self, texture_mm: npt.ArrayLike) -> FloatArray:
        offset_mm = (np.asarray(texture_mm, dtype=np.float64) - self.position_mm) @ self.turn
        return _zoomed(offset_mm * self.px_per_mm + self.centre_px, self.zoom)


def placed_mm(tape: Tape) -> FloatArray:
    cells = tape.cells()
    return cells * tape.pitch_mm + tape.displacement_mm * DIRECTIONS_XY[tape.symbols[cells[:, 1], cells[:, 0]]]


def _zoomed(xy_px: FloatArray, zoom: int) -> FloatArray:
    """Pixel centres of the frame as those of the enlarged picture."""
    return np.asarray((xy_px + 0.5) * zoom - 0.5)


def _shades(high: npt.NDArray[np.float32], zoom: int) -> Picture:
    """Grey levels from the lowest to the highest percentile, enlarged without smoothing."""
    low, top = np.percentile(high, (1.0, 99.8))
    grey = np.clip((high - low) / max(float(top - low), 1e-30), 0.0, 1.0) * 200
    enlarged = np.repeat(np.repeat(grey.astype(np.uint8), zoom, axis=0), zoom, axis=1)
    return np.ascontiguousarray(np.stack([enlarged] * 3, axis=-1))


def _draw_grid(picture: Picture, tape: Tape, view: View) -> None:
    """Grid lines as far as the tape and the picture reach."""
    low = np.clip(np.floor(view.corners_mm.min(axis=0) / tape.pitch_mm), 0, (tape.columns - 1, tape.rows - 1))
    high = np.clip(np.ceil(view.corners_mm.max(axis=0) / tape.pitch_mm), 0, (tape.columns - 1, tape.rows - 1))
    for column in np.arange(low[0], high[0] + 1):
        _line(picture, view, ((column, low[1]), (column, high[1])), tape.pitch_mm, _GRID, 1)
    for row in np.arange(low[1], high[1] + 1):
        _line(picture, view, ((low[0], row), (high[0], row)), tape.pitch_mm, _GRID, 1)


def _draw_axes(picture: Picture, tape: Tape, view: View) -> None:
    """Texture x (red) and y (blue) from the image centre, two pitches long."""
    at = view.position_mm / tape.pitch_mm
    _line(picture, view, (at, at + np.array([2.0, 0.0])), tape.pitch_mm, _X_AXIS, 2)
    _line(picture, view, (at, at + np.array([0.0, 2.0])), tape.pitch_mm, _Y_AXIS, 2)


def _line(picture: Picture, view: View, ends: Any, pitch_mm: float, colour: tuple[int, int, int], width: int) -> None:
    import cv2

    (x0, y0), (x1, y1) = np.rint(view.to_px(np.asarray(ends, dtype=np.float64) * pitch_mm) * 2**_SUBPIXEL).astype(int).tolist()
    cv2.line(picture, (x0, y0), (x1, y1), colour, width, cv2.LINE_AA, _SUBPIXEL)


def _circle(picture: Picture, at: tuple[float, float], radius: float, colour: tuple[int, int, int]) -> None:
    import cv2

    x, y, r = (round(v * 2**_SUBPIXEL) for v in (*at, radius))
    cv2.circle(picture, (x, y), r, colour, 2, cv2.LINE_AA, _SUBPIXEL)


def _words(fix: Localization, frame: int) -> list[str]:
    first = f"frame {frame}: {fix.status}, {fix.n_agree} of {fix.n_dots} dots agree"
    if not fix.located:
        return [first, *_wrapped(f"not located: {fix.reason}")]
    where = "" if fix.position_mm is None else f"  x {fix.position_mm[0]:.3f}  y {fix.position_mm[1]:.3f} mm"
    turn = "" if fix.theta_deg is None else f"  {fix.theta_deg:.2f} deg"
    chance = "" if fix.p_false is None else f"  p_false {fix.p_false:.1e}"
    return [first, f"{fix.tape or f'sector {fix.sector}'}{where}{turn}{chance}"]


def _wrapped(text: str) -> list[str]:
    import textwrap

    return textwrap.wrap(text.encode("ascii", "replace").decode(), 85)
