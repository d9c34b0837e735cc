"""Check of the legend: its label, and its tag, which independent AprilTag detectors read in a picture of the written layer."""

from __future__ import annotations

import atexit
from collections.abc import Iterable
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields
from tactape_fab.kit.film.layout import tape_legend
from tactape_fab.kit.profiles.fabs import LEAST_LEGEND_MM, LegendSizes
from tactape_fab.kit.read.gerber_file import GerberContent
from tactape_fab.texture.board import Tag
from tactape_fab.texture.frames import FloatArray, board_to_picture, board_to_texture
from tactape_fab.texture.shapes import rotate
from tactape_fab.texture.tag import CODE_CELLS
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.layers.job_file import known_fab
from tactape_fab.verify.layers.written_form import same_contours, segments

_PX_PER_CELL = 12
_OVERSAMPLING = 4
_MARGIN_CELLS = 4
_CORNER_TOLERANCE_CELLS = 0.1
_INK, _FILM = 235, 90
_PRINT_TOLERANCE_MM = 1e-5
_DARK_INK = 20
_LEAST_APART = 0.05
"""OpenCV's least distance of two quadrilaterals, relative to their perimeter, below which it drops one. With its default of 0.125
a letter of the label may replace the tag: one with cells of 0.63 to 0.95 mm was never found.
"""

GrayImage = npt.NDArray[np.uint8]


def legend_picture(legend: GerberContent, tag: Tag, *, legend_is_light: bool) -> GrayImage:
    """Picture of the ink on the film around the tag: uint8 gray, row 0 at the top (board +y)."""
    import cv2

    # oversampled four times and reduced by area averaging, so that edges are gray as in a camera image
    px_per_mm = _OVERSAMPLING * _PX_PER_CELL / tag.cell_mm
    cells = CODE_CELLS + 2 + 2 * _MARGIN_CELLS
    half_mm = cells * tag.cell_mm / 2
    upper_left_mm = (tag.center_mm[0] - half_mm, tag.center_mm[1] + half_mm)
    side_px = cells * _PX_PER_CELL * _OVERSAMPLING
    # light ink on dark film or dark ink on light film: the tag's border must be darker than its surroundings
    image = np.full((side_px, side_px), _FILM if legend_is_light else 170, dtype=np.uint8)
    ink = _INK if legend_is_light else _DARK_INK

    def px(points_mm: FloatArray) -> npt.NDArray[np.int32]:
        # clipped, as sixteenths of a pixel must fit in 32 bits; such points are outside the picture anyway
        inside = np.clip(board_to_picture(points_mm, upper_left_mm, px_per_mm), -1e6, 1e6)
        return np.rint(inside * 16).astype(np.int32)

    for area in legend.areas_mm:
        cv2.fillPoly(image, [px(area)], ink, cv2.LINE_8, 4)
    for stroke, width in zip(legend.strokes_mm, legend.stroke_width_mm, strict=True):
        cv2.polylines(image, [px(stroke)], False, ink, max(round(float(width) * px_per_mm), 1), cv2.LINE_8, 4)
    size = cells * _PX_PER_CELL
    return np.asarray(cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def read_legend_record(table: Fields) -> LegendSizes | None:
    """The legend's sizes from a manifest; None if it has no record and names a user's own profile.

    Problems are collected in `table`.
    """
    fab = table.table("fab")
    sizes = LEAST_LEGEND_MM
    if all(f"legend_{size}" in fab.values for size in sizes):
        return LegendSizes(**{size: fab.number(f"legend_{size}", low=low, high=10.0) for size, low in sizes.items()})
    profile = known_fab(fab)
    return None if profile is None else profile.legend


def inked_or_cut(
    legend: GerberContent | None, holes: Iterable[tuple[float, float, float]]
) -> list[tuple[FloatArray, FloatArray]]:
    """Low and high corners of the bounding boxes of all inked shapes, and of each hole (x, y, diameter)."""
    lines = () if legend is None else (*legend.areas_mm, *legend.strokes_mm)
    circles = ((np.array([x, y]), diameter / 2) for x, y, diameter in holes)
    return [*((line.min(axis=0), line.max(axis=0)) for line in lines), *((at - r, at + r) for at, r in circles)]


def check_label(content: GerberContent, tape: Tape, sizes: LegendSizes | None, *, light: bool) -> Check:
    """Check that the legend has exactly this tape's tag and label, stroke by stroke."""
    if sizes is None:
        message = "not compared: the manifest does not record the sizes of its fab profile's print"
        return Check(name="label", passed=False, warning=True, message=message)
    expected = tape_legend(tape, sizes, light=light)
    problems = []
    found, right = segments(content.strokes_mm), segments(expected.strokes_mm)
    if len(content.flash_xy_mm):
        problems.append(f"{len(content.flash_xy_mm)} flashes, which no legend has")
    # in the same order, as the same strokes of the same font are drawn
    if found.shape != right.shape or (np.abs(found - right) > _PRINT_TOLERANCE_MM).any():
        problems.append(f"its {len(found)} lines are not the {len(right)} of this tape's label")
    if len(found) and np.abs(content.stroke_width_mm - expected.line_mm).max() > _PRINT_TOLERANCE_MM:
        problems.append(f"a line is not {expected.line_mm:g} mm wide")
    areas = content.areas_mm
    if not same_contours(areas, expected.areas_mm, _PRINT_TOLERANCE_MM):
        problems.append(f"its {len(areas)} areas are not the {len(expected.areas_mm)} of this tape's tag")
    message = "; ".join(problems) or f"{len(areas)} areas and {len(found)} lines, those of this tape's tag and label"
    return Check(name="label", passed=not problems, message=message)


def check_tag(legend: GerberContent, tape: Tape, *, legend_is_light: bool, with_pupil: bool) -> list[Check]:
    """Detect the tag in the written legend layer, and check its id and corners (and so its orientation)."""
    if tape.tag is None:
        return []
    if legend.clear:
        return [
            Check(
                name="tag by OpenCV",
                passed=False,
                message="the legend layer draws in clear polarity, which no detector can judge",
            )
        ]
    image = legend_picture(legend, tape.tag, legend_is_light=legend_is_light)
    checks = [_judge("tag by OpenCV", tape.tag, _read_opencv(image))]
    if with_pupil and find_spec("pupil_apriltags") is not None:
        checks.append(_judge("tag by pupil-apriltags", tape.tag, _read_pupil(image)))
    elif with_pupil:
        missing = "not installed; install the extra 'verify' for a second detector"
        checks.append(Check(name="tag by pupil-apriltags", passed=False, warning=True, skipped=True, message=missing))
    return checks


Reading = tuple[int, FloatArray]
"""Id, and corners of the black border in px, shape (4, 2), counter-clockwise (with y up) from the lower left of the upright
tag."""


def _read_opencv(image: GrayImage) -> list[Reading]:
    from cv2 import aruco

    parameters = aruco.DetectorParameters()
    # a pixel is a twelfth of a cell, nearly all of the tolerance
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    parameters.minMarkerDistanceRate = _LEAST_APART
    detector = aruco.ArucoDetector(aruco.getPredefinedDictionary(aruco.DICT_APRILTAG_36h11), parameters)
    corners, ids, _ = detector.detectMarkers(image)
    # OpenCV's tags are turned by 180 degrees, so its first corner is the upright tag's lower right one
    return [
        (int(i), np.asarray(c[0], dtype=np.float64)[[1, 0, 3, 2]])
        for i, c in zip([] if ids is None else ids.ravel(), corners, strict=True)
    ]


@cache
def pupil_detector() -> Any:
    """The single pupil-apriltags detector of this process.

    kornia-rs 0.2 has wheels for more machines and reads our legends as well, but orders corners by the picture, not by the
    tag, so that a turned tag cannot be distinguished from an upright one.

    It is never destroyed: its destructor frees the tag family before the detector that still points to it, which
    corrupts the heap (pupil-apriltags 1.0.4).
    """
    from pupil_apriltags import Detector

    detector = Detector(families="tag36h11", nthreads=1)
    atexit.register(setattr, detector, "tag_detector_ptr", None)  # without a pointer the destructor does nothing
    return detector


def _read_pupil(image: GrayImage) -> list[Reading]:
    found = pupil_detector().detect(image)
    # its first pixel's centre is at 0.5, OpenCV's at 0
    return [(int(d.tag_id), np.asarray(d.corners, dtype=np.float64) - 0.5) for d in found if d.hamming == 0]


def _judge(name: str, tag: Tag, readings: list[Reading]) -> Check:
    if len(readings) != 1:
        return Check(name=name, passed=False, message=f"{len(readings)} tags found in the written legend layer instead of one")
    tag_id, corners_px = readings[0]
    if tag_id != tag.id:
        return Check(
            name=name, passed=False, message=f"the legend shows tag {tag_id}, the manifest says {tag.id}", figure=float(tag_id)
        )
    side_px = (CODE_CELLS + 2 + 2 * _MARGIN_CELLS) * _PX_PER_CELL
    half = CODE_CELLS / 2 * _PX_PER_CELL
    # pixel centres are integers, so the middle of n pixels is at (n - 1) / 2
    centre = (side_px - 1) / 2
    upright = rotate([(-1, -1), (1, -1), (1, 1), (-1, 1)], tag.rotation_deg)
    # y is flipped, as rows of a picture count downward
    expected = centre + half * board_to_texture(upright, (0.0, 0.0))
    error_cells = float(np.linalg.norm(corners_px - expected, axis=1).max() / _PX_PER_CELL)
    error_mm = error_cells * tag.cell_mm
    passed = error_cells <= _CORNER_TOLERANCE_CELLS
    message = (
        f"tag {tag_id} reads the right way up, corners within {error_mm:.3f} mm"
        if passed
        else f"tag {tag_id} is turned or displaced: a corner is {error_mm:.3f} mm from its place"
    )
    return Check(name=name, passed=passed, message=message, figure=error_mm, unit="mm")
