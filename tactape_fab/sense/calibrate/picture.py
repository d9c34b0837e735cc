"""Pictures of a calibration: where dots were seen, and how far they are from where the camera expects them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab.base.libraries import library
from tactape_fab.base.picture_file import write_picture
from tactape_fab.sense.calibrate.posedness import empty_corners
from tactape_fab.sense.calibrate.result import Calibration
from tactape_fab.texture.frames import FloatArray

Picture = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]

WIDTH_PX, WORDS_PX, MARGIN_PX = 960, 64, 16
PICTURES = ("coverage.png", "residuals.png")
CELLS = 8
"""Cells along the image's width in which residuals are averaged."""
_BACK, _BLIND, _LINE, _TEXT = (36, 36, 36), (70, 60, 60), (95, 95, 95), (255, 255, 255)
_DOT, _MEAN, _EMPTY = (240, 190, 90), (60, 230, 245), (50, 110, 245)
_LENGTHS_UM = (2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
_COLOURS = ((240, 190, 90), (110, 220, 130), (60, 230, 245), (50, 110, 245), (215, 150, 225), (230, 230, 230))


def write_pictures(folder: Path, found: Calibration) -> list[Path]:
    """Write coverage.png and residuals.png. Raises TactapeError."""
    paths = [folder / name for name in PICTURES]
    for path, picture in zip(paths, (draw_coverage(found), draw_residuals(found)), strict=True):
        write_picture(path, picture, "picture")
    return paths


def draw_coverage(found: Calibration) -> Picture:
    """Dots of all presses in the image, a colour for each; blind pixels are darker red, corners without a dot are framed."""
    cv2 = library("cv2", "drawing a picture")
    picture, zoom = _canvas(found)
    sensor = found.sensor
    for k, press in enumerate(found.presses):
        for at in _placed(press.seen_px, zoom):
            cv2.circle(picture, at, 4, _COLOURS[k % len(_COLOURS)], -1, cv2.LINE_AA)
    empty = empty_corners(found.presses, sensor)
    quarter = (sensor.centre_px * 0.5 * zoom).astype(int)
    for name in empty:
        low = np.array([MARGIN_PX, WORDS_PX])
        low += (np.array(["right" in name, "lower" in name]) * (2 * sensor.centre_px * zoom - quarter)).astype(int)
        cv2.rectangle(picture, _pair(low), _pair(low + quarter), _EMPTY, 3)
    dots = sum(len(press.weights) for press in found.presses)
    _write(picture, f"{len(found.presses)} presses, {dots} dots; a colour for each press", 26)
    _write(picture, f"no dot in the {', '.join(empty)}" if empty else "dots near all four corners", 52)
    return picture


def draw_residuals(found: Calibration) -> Picture:
    """Every dot's residual as a thin line, and the mean of each cell with at least four dots as an arrow, both enlarged."""
    cv2 = library("cv2", "drawing a picture")
    picture, zoom = _canvas(found)
    at = np.concatenate([press.seen_px for press in found.presses])
    off = np.concatenate(found.bundle.residual_mm) * 1000.0
    cell_px = found.sensor.width_px / CELLS
    middles, means = _means(at, off, cell_px)
    single_um = _round_length(float(np.percentile(np.hypot(*off.T), 90.0)))
    mean_um = _round_length(float(np.hypot(*means.T).max())) if len(means) else single_um
    reach = 0.45 * cell_px * zoom
    for a, b in zip(_placed(at, zoom), _placed(at + off * reach / single_um / zoom, zoom), strict=True):
        cv2.line(picture, a, b, _DOT, 1, cv2.LINE_AA)
    for a, b in zip(_placed(middles, zoom), _placed(middles + means * reach / mean_um / zoom, zoom), strict=True):
        cv2.arrowedLine(picture, a, b, _MEAN, 2, cv2.LINE_AA, 0, 0.25)
    held = found.held_out
    outside = "" if held is None else f", {held.outside_um:.1f} um in presses left out"
    _write(picture, f"residuals: {1000 * found.bundle.rms_mm:.1f} um rms along an axis{outside}", 26)
    _legend(picture, _DOT, 52, 24, f"a dot, this long: {single_um:g} um", reach)
    _legend(picture, _MEAN, 52, 480, f"mean of a cell, this long: {mean_um:g} um", reach)
    return picture


def _means(at: FloatArray, off: FloatArray, cell_px: float) -> tuple[FloatArray, FloatArray]:
    """Middles of cells with at least four dots, and the mean residual in each."""
    cells = np.floor(at / cell_px).astype(np.int64)
    keys, inverse, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(keys), 2))
    np.add.at(sums, inverse.ravel(), off)
    enough = counts >= 4
    middles: FloatArray = (keys[enough].astype(np.float64) + 0.5) * cell_px
    return middles, sums[enough] / counts[enough][:, None]


def _canvas(found: Calibration) -> tuple[Picture, float]:
    """The image's field below two lines of text, and picture px for each px of the image."""
    cv2 = library("cv2", "drawing a picture")
    sensor = found.sensor
    zoom = (WIDTH_PX - 2 * MARGIN_PX) / sensor.width_px
    height = round(sensor.height_px * zoom)
    field = np.full((height, WIDTH_PX - 2 * MARGIN_PX, 3), _BACK, dtype=np.uint8)
    if sensor.mask is not None:
        blind = cv2.resize((~sensor.mask).astype(np.uint8), field.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0
        field[blind] = _BLIND
    picture = np.full((height + WORDS_PX + MARGIN_PX, WIDTH_PX, 3), 0, dtype=np.uint8)
    picture[WORDS_PX : WORDS_PX + height, MARGIN_PX:-MARGIN_PX] = field
    cv2.rectangle(picture, (MARGIN_PX, WORDS_PX), (WIDTH_PX - MARGIN_PX, WORDS_PX + height), _LINE, 1)
    return picture, zoom


def _placed(at_px: FloatArray, zoom: float) -> list[tuple[int, int]]:
    return [_pair(at) for at in np.rint((at_px + 0.5) * zoom + (MARGIN_PX, WORDS_PX)).astype(int)]


def _pair(at: npt.NDArray[np.int64]) -> tuple[int, int]:
    u, v = at.tolist()
    return u, v


def _round_length(um: float) -> float:
    return next((length for length in _LENGTHS_UM if length >= um), _LENGTHS_UM[-1])


def _legend(picture: Picture, colour: Colour, y: int, x: int, text: str, length_px: float) -> None:
    cv2 = library("cv2", "drawing a picture")
    cv2.line(picture, (x, y - 5), (x + round(length_px), y - 5), colour, 2, cv2.LINE_AA)
    cv2.putText(picture, text, (x + round(length_px) + 10, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _TEXT, 1, cv2.LINE_AA)


def _write(picture: Picture, text: str, y: int) -> None:
    cv2 = library("cv2", "drawing a picture")
    cv2.putText(picture, text, (MARGIN_PX, y), cv2.FONT_HERSHEY_SIMPLEX, 0.6, _TEXT, 1, cv2.LINE_AA)
