"""AprilTag ink: all 587 ids print as whole, hole-free areas whose gaps stay open after bleed, and outside detectors read them."""

from __future__ import annotations

import math
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import shapely

from tactape_fab.kit.film.tag_ink import Ink, tag_ink
from tactape_fab.texture.tag import LEAST_CELL_MM, tag_cells
from tactape_fab.verify.layers.legend import pupil_detector
from tests.thorough import costly, thorough

IDS = range(587)
SAMPLE = [0, 1, 7, 100, 255, 300, 444, 586]
GAP_MM, BLEED_MM = 0.15, 0.05
LEG_MM = math.sqrt(2.0) * (GAP_MM / 2 + BLEED_MM)
APRILTAG_2_CODES = {0: 0xD5D628584, 1: 0xD97F18B49, 2: 0xDD280910E}
"""From tag36h11.c of AprilTag 2: row by row from the upper left, a set bit is a light cell."""
APRILTAG_3_CODES = {0: 0xD7E00984B, 1: 0xDDA664CA7, 2: 0xDC4A1C821, 7: 0x1106CBA43}
"""From tag36h11.c of AprilRobotics/apriltag (3): four equal turns of nine cells, the first along the upper edge."""
APRILTAG_3_FIRST_TURN = [(1, 1), (2, 1), (3, 1), (4, 1), (5, 1), (2, 2), (3, 2), (4, 2), (3, 3)]
"""(bit_x, bit_y) of the first nine cells there, counted from the border cell at the upper left."""

Cells = npt.NDArray[np.bool_]
Image = npt.NDArray[np.uint8]


@cache
def ink_of(tag_id: int, *, light: bool, cell_mm: float = 0.5) -> Ink:
    return tag_ink(tag_id, cell_mm=cell_mm, gap_mm=GAP_MM, bleed_mm=BLEED_MM, legend_is_light=light)


@cache
def union_of(tag_id: int, *, light: bool, cell_mm: float = 0.5) -> shapely.Geometry:
    return shapely.union_all([shapely.Polygon(area) for area in ink_of(tag_id, light=light, cell_mm=cell_mm).areas_mm])


def inked_cells(tag_id: int, *, light: bool) -> Cells:
    cells = tag_cells(tag_id)
    return cells if light else ~cells


def squares(inked: Cells, cell_mm: float = 0.5) -> shapely.Geometry:
    """Inked cells as they stand about the centre of the tag, row 0 at the top."""
    r, c = np.nonzero(inked)
    return shapely.union_all(shapely.box((c - 5) * cell_mm, (4 - r) * cell_mm, (c - 4) * cell_mm, (5 - r) * cell_mm))


def corner_contacts(inked: Cells) -> list[tuple[int, int]]:
    """Grid corners (row, column) round which exactly two cells are inked, and those lie diagonally."""
    return [
        (r, c)
        for r in range(1, 10)
        for c in range(1, 10)
        if inked[r - 1, c - 1] == inked[r, c] != inked[r - 1, c] == inked[r, c - 1]
    ]


def region_count(cells: Cells, connectivity: int) -> int:
    return int(cv2.connectedComponents(cells.astype(np.uint8), connectivity=connectivity)[0]) - 1


def picture(tag_id: int, *, light: bool, cell_mm: float = 0.5, bleed_mm: float = 0.0, px_per_cell: int = 16) -> Image:
    """Printed ink on film, upright, with a margin of three cells of bare film."""
    ink_gray, film_gray = (235, 90) if light else (20, 170)
    side_px = 16 * px_per_cell
    image = np.full((side_px, side_px), film_gray, dtype=np.uint8)
    for area in ink_of(tag_id, light=light, cell_mm=cell_mm).areas_mm:
        outline = np.array(shapely.Polygon(area).buffer(bleed_mm).exterior.coords)
        px = side_px / 2 - 0.5 + outline * (1, -1) * px_per_cell / cell_mm
        cv2.fillPoly(image, [np.rint(px * 16).astype(np.int32)], ink_gray, cv2.LINE_8, 4)
    return image


def read_by_pupil(image: Image) -> list[tuple[int, int, npt.NDArray[np.float64]]]:
    """Id, hamming distance and corners, lower left first, counter-clockwise as seen; a skip where it has no wheel."""
    pytest.importorskip("pupil_apriltags")
    found = pupil_detector().detect(image)
    return [(int(d.tag_id), int(d.hamming), np.asarray(d.corners)) for d in found]


def read_by_opencv(image: Image) -> list[tuple[int, npt.NDArray[np.float64]]]:
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    corners, ids, _ = detector.detectMarkers(image)
    return [(int(i), c[0]) for i, c in zip([] if ids is None else ids.ravel(), corners, strict=True)]


def angle_deg(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> float:
    return math.degrees(math.atan2(b[1] - a[1], b[0] - a[0]))


# Cells


def test_every_tag_has_a_light_ring_a_black_border_and_its_own_data() -> None:
    seen = set()
    for tag_id in IDS:
        cells = tag_cells(tag_id)
        assert cells.shape == (10, 10)
        assert all(edge.all() for edge in (cells[0], cells[-1], cells[:, 0], cells[:, -1]))
        assert not any(edge.any() for edge in (cells[1, 1:9], cells[8, 1:9], cells[1:9, 1], cells[1:9, 8]))
        seen.add(cells.tobytes())
    assert len(seen) == len(IDS)


def as_number(cells: list[bool]) -> int:
    return int("".join("1" if cell else "0" for cell in cells), 2)


@pytest.mark.parametrize(("tag_id", "code"), APRILTAG_2_CODES.items())
def test_cells_are_those_of_apriltag_2(tag_id: int, code: int) -> None:
    assert as_number(tag_cells(tag_id)[2:8, 2:8].ravel().tolist()) == code


@pytest.mark.parametrize(("tag_id", "code"), APRILTAG_3_CODES.items())
def test_cells_are_those_of_apriltag_3(tag_id: int, code: int) -> None:
    turns = [np.rot90(tag_cells(tag_id)[1:9, 1:9], k) for k in range(4)]
    assert as_number([bool(turn[y, x]) for turn in turns for x, y in APRILTAG_3_FIRST_TURN]) == code


# Ink, every id in both polarities

BOTH = pytest.mark.parametrize("light", [True, thorough(False)], ids=["light-ink", "dark-ink"])


@BOTH
def test_areas_are_simple_polygons(light: bool) -> None:
    for tag_id in IDS:
        polygons = [shapely.Polygon(area) for area in ink_of(tag_id, light=light).areas_mm]
        assert all(p.is_valid and p.exterior.is_simple and p.area > 0.0 for p in polygons), tag_id
        assert all((area[0] != area[-1]).any() for area in ink_of(tag_id, light=light).areas_mm)


@BOTH
@costly
def test_areas_unite_to_the_cells_less_their_chamfers(light: bool) -> None:
    for tag_id in IDS:
        inked = inked_cells(tag_id, light=light)
        image, whole = union_of(tag_id, light=light), squares(inked)
        contacts = corner_contacts(inked)
        assert whole.buffer(1e-9).covers(image), tag_id
        assert whole.area - image.area == pytest.approx(len(contacts) * LEG_MM**2, abs=1e-9), tag_id
        if contacts:
            near = shapely.MultiPoint([((c - 5) * 0.5, (5 - r) * 0.5) for r, c in contacts]).buffer(LEG_MM + 1e-9)
            assert near.covers(whole.difference(image)), tag_id


@costly
@BOTH
@pytest.mark.parametrize("cell_mm", [0.5, LEAST_CELL_MM])
def test_gaps_between_areas_stay_open_after_bleed(light: bool, cell_mm: float) -> None:
    """Ink grown by the bleed and half the gap still has the tag's own regions: no two of them joined, no film cut off."""
    grown_mm = BLEED_MM + GAP_MM / 2 - 1e-6
    unions = [union_of(tag_id, light=light, cell_mm=cell_mm) for tag_id in IDS]
    for tag_id, grown in zip(IDS, shapely.buffer(unions, grown_mm, quad_segs=4), strict=True):
        inked = inked_cells(tag_id, light=light)
        film_round = np.pad(~inked, 1, constant_values=True)
        parts = shapely.get_parts(grown)
        assert len(parts) == region_count(inked, 4), tag_id
        assert sum(len(p.interiors) for p in parts) == region_count(film_round, 8) - 1, tag_id


@BOTH
def test_a_wider_gap_than_asked_for_would_close(light: bool) -> None:
    """The chamfers are no larger than they must be: ink grown a little further joins across a corner."""
    tag_id = next(i for i in IDS if corner_contacts(inked_cells(i, light=light)))
    inked = inked_cells(tag_id, light=light)
    r, c = corner_contacts(inked)[0]
    corner = shapely.Point((c - 5) * 0.5, (5 - r) * 0.5)
    assert union_of(tag_id, light=light).distance(corner) == pytest.approx(BLEED_MM + GAP_MM / 2, abs=1e-9)


@BOTH
def test_pieces_of_a_cut_area_overlap(light: bool) -> None:
    """An area that was cut to lose a hole leaves no hairline: shrunk a little, its pieces still unite without a gap."""
    for tag_id in SAMPLE:
        areas = [shapely.Polygon(a) for a in ink_of(tag_id, light=light).areas_mm]
        shrunk = shapely.union_all([a.buffer(-0.01, join_style="mitre") for a in areas])
        regions = region_count(inked_cells(tag_id, light=light), 4)
        assert len(shapely.get_parts(shrunk)) == len(shapely.get_parts(union_of(tag_id, light=light))) == regions


# Readers


@BOTH
@pytest.mark.parametrize("tag_id", SAMPLE)
@pytest.mark.parametrize(("cell_mm", "bleed_mm"), [(0.5, 0.0), (0.5, BLEED_MM), (LEAST_CELL_MM, 0.0)])
def test_detectors_read_id_and_orientation(tag_id: int, light: bool, cell_mm: float, bleed_mm: float) -> None:
    image = picture(tag_id, light=light, cell_mm=cell_mm, bleed_mm=bleed_mm)
    ((opencv_id, corners),) = read_by_opencv(image)
    assert opencv_id == tag_id
    assert abs(angle_deg(corners[0], corners[1])) == pytest.approx(180.0, abs=0.5)
    ((pupil_id, hamming, corners),) = read_by_pupil(image)
    assert (pupil_id, hamming) == (tag_id, 0)
    assert angle_deg(corners[0], corners[1]) == pytest.approx(0.0, abs=0.5)
    assert corners[0][1] > corners[3][1]


@BOTH
@pytest.mark.parametrize("tag_id", SAMPLE)
def test_the_least_cell_still_reads_after_bleed(tag_id: int, light: bool) -> None:
    image = picture(tag_id, light=light, cell_mm=LEAST_CELL_MM, bleed_mm=BLEED_MM)
    assert [(i, hamming) for i, hamming, _ in read_by_pupil(image)] == [(tag_id, 0)]


def test_ink_of_the_wrong_polarity_is_not_read() -> None:
    assert read_by_pupil(255 - picture(7, light=True)) == []


@pytest.mark.parametrize("light", [False, True])
def test_a_gap_of_many_cells_leaves_no_area(light: bool) -> None:
    """An area without vertices ended `make` in the Gerber writer; no area is told by `verify`, which finds no tag."""
    assert tag_ink(7, cell_mm=0.5, gap_mm=10.0, bleed_mm=0.05, legend_is_light=light).areas_mm == ()
