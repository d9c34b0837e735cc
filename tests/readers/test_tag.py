"""Two AprilTag detectors read id and orientation from gerbv's picture of the written legend layer."""

from __future__ import annotations

from math import atan2, degrees
from pathlib import Path

import cv2
import numpy as np
import pytest
from cv2 import aruco

from tactape_fab import TapeSpec, make_kit
from tactape_fab.verify.layers.legend import pupil_detector
from tests.readers.conftest import layout_of
from tests.readers.pictures import GrayImage, gerbv_image
from tests.readers.raster import board_window

_LIGHT, _DARK = "#ebebeb", "#5a5a5a"
_IDS = (0, 7, 100, 255)

Reading = tuple[int, float]
"""Id, and yaw in degrees, counter-clockwise in the picture, in (-180, 180]."""


def _yaw_deg(left_px: np.ndarray, right_px: np.ndarray) -> float:
    u, v = np.asarray(right_px, dtype=np.float64) - left_px
    return degrees(atan2(-v, u))


def _read_pupil(image: GrayImage) -> list[Reading]:
    """By AprilRobotics' own corner order: the lower edge runs from corner 0 to corner 1; a skip where it has no wheel."""
    pytest.importorskip("pupil_apriltags")
    found = pupil_detector().detect(np.ascontiguousarray(image))
    return [(d.tag_id, _yaw_deg(d.corners[0], d.corners[1])) for d in found if d.hamming == 0]


def _read_opencv(image: GrayImage) -> list[Reading]:
    """By OpenCV's corner order: the upper edge of its dictionary's marker runs from corner 0 to corner 1."""
    parameters = aruco.DetectorParameters()
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    detector = aruco.ArucoDetector(aruco.getPredefinedDictionary(aruco.DICT_APRILTAG_36h11), parameters)
    corners, ids, _ = detector.detectMarkers(np.ascontiguousarray(image))
    if ids is None:
        return []
    return [(int(i), _yaw_deg(c[0, 0], c[0, 1])) for i, c in zip(np.ravel(ids), corners, strict=True)]


def _turn_deg(yaw_deg: float, expected_deg: float) -> float:
    return abs((yaw_deg - expected_deg + 180) % 360 - 180)


def _legend_picture(spec: TapeSpec, gerbv: str, folder: Path, ink: str, film: str) -> GrayImage:
    kit = make_kit(spec, folder / "kit", verify=False)
    image, complaints = gerbv_image(
        gerbv, kit.path / kit.files["legend-top"], board_window(layout_of(spec)), folder, ink=ink, film=film
    )
    assert complaints == ""
    return image


@pytest.fixture(scope="module")
def picture_of_7(gerbv: str, tmp_path_factory: pytest.TempPathFactory) -> GrayImage:
    return _legend_picture(TapeSpec(sector=7), gerbv, tmp_path_factory.mktemp("tag-7"), _LIGHT, _DARK)


@pytest.mark.parametrize("tag_id", _IDS)
def test_both_detectors_read_the_tag_upright(gerbv: str, tag_id: int, tmp_path: Path) -> None:
    image = _legend_picture(TapeSpec(sector=tag_id, size_mm=(40.0, 40.0)), gerbv, tmp_path, _LIGHT, _DARK)
    ((opencv_id, opencv_yaw_deg),) = _read_opencv(image)
    assert opencv_id == tag_id
    assert _turn_deg(opencv_yaw_deg, 180.0) <= 0.5  # OpenCV's dictionary holds each tag turned by 180 degrees
    ((pupil_id, pupil_yaw_deg),) = _read_pupil(image)
    assert pupil_id == tag_id
    assert _turn_deg(pupil_yaw_deg, 0.0) <= 0.5


def test_the_tag_of_the_main_job_reads_with_its_whole_label(picture_of_7: GrayImage) -> None:
    ((opencv_id, opencv_yaw_deg),) = _read_opencv(picture_of_7)
    assert opencv_id == 7 and _turn_deg(opencv_yaw_deg, 180.0) <= 0.5
    ((pupil_id, pupil_yaw_deg),) = _read_pupil(picture_of_7)
    assert pupil_id == 7 and _turn_deg(pupil_yaw_deg, 0.0) <= 0.5


def test_a_turned_picture_reads_turned(picture_of_7: GrayImage) -> None:
    counter_clockwise = cv2.rotate(picture_of_7, cv2.ROTATE_90_COUNTERCLOCKWISE)
    ((_, pupil_yaw_deg),) = _read_pupil(np.asarray(counter_clockwise, dtype=np.uint8))
    ((_, opencv_yaw_deg),) = _read_opencv(np.asarray(counter_clockwise, dtype=np.uint8))
    assert _turn_deg(pupil_yaw_deg, 90.0) <= 0.5
    assert _turn_deg(opencv_yaw_deg, -90.0) <= 0.5


def test_a_mirrored_or_inverted_picture_reads_as_nothing(picture_of_7: GrayImage) -> None:
    for wrong in (picture_of_7[:, ::-1], picture_of_7[::-1], 255 - picture_of_7):
        assert _read_pupil(wrong) == []
        assert _read_opencv(wrong) == []


def test_a_black_legend_on_light_film_prints_the_dark_cells(gerbv: str, tmp_path: Path) -> None:
    generic = Path(__file__).parents[2] / "templates" / "fabs" / "generic-fpc.toml"
    fab = tmp_path / "black.toml"
    fab.write_text(generic.read_text().replace('legend = "white"', 'legend = "black"'))
    spec = TapeSpec(sector=100, size_mm=(40.0, 40.0), fab=str(fab))
    image = _legend_picture(spec, gerbv, tmp_path, _DARK, _LIGHT)
    ((pupil_id, pupil_yaw_deg),) = _read_pupil(image)
    ((opencv_id, opencv_yaw_deg),) = _read_opencv(image)
    assert (pupil_id, opencv_id) == (100, 100)
    assert max(_turn_deg(pupil_yaw_deg, 0.0), _turn_deg(opencv_yaw_deg, 180.0)) <= 0.5
