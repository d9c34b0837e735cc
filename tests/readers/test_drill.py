"""Outside readers find every hole of the drill file at its place and with its diameter."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import shapely
from gerbonara.excellon import ExcellonFile

from tests.readers.conftest import Sample
from tests.readers.pictures import Picture, Reader
from tests.readers.raster import Floats, board_window, coverage, polygon_edges_mm


def _holes_mm(sample: Sample) -> Floats:
    return np.array(sample.layout.tape.board.holes)


def _truth(sample: Sample) -> Picture:
    x, y, diameter = _holes_mm(sample).T
    circles = shapely.buffer(shapely.points(x, y), diameter / 2, quad_segs=64)
    return coverage(polygon_edges_mm(shapely.MultiPolygon(list(circles))), board_window(sample.layout))


def test_gerbonara_reads_every_hole(tape_6x4: Sample) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        file = ExcellonFile.open(tape_6x4.path("drill-npth"))
    read = np.array([(hole.x, hole.y, hole.aperture.diameter) for hole in file.objects])
    expected = _holes_mm(tape_6x4)
    assert {hole.unit.shorthand for hole in file.objects} == {"mm"}
    np.testing.assert_allclose(read[np.lexsort(read.T)], expected[np.lexsort(expected.T)], atol=1e-9)


def test_reader_draws_every_hole_at_its_place(tape_6x4: Sample, reader: Reader) -> None:
    picture = reader.draw(tape_6x4.path("drill-npth"), board_window(tape_6x4.layout))
    assert reader.iou(picture, _truth(tape_6x4)) >= reader.least_iou


@pytest.mark.parametrize(("right", "wrong"), [("X17.0000Y6.5000", "X17.2000Y6.5000"), ("T2C2.0000", "T2C1.0000")])
def test_a_wrong_hole_falls_below_the_threshold(tape_6x4: Sample, reader: Reader, right: str, wrong: str, tmp_path: Path) -> None:
    text = tape_6x4.path("drill-npth").read_text()
    assert text.count(right) == 1
    path = tmp_path / "wrong.drl"
    path.write_text(text.replace(right, wrong))
    picture = reader.draw(path, board_window(tape_6x4.layout))
    assert reader.iou(picture, _truth(tape_6x4)) < reader.least_iou


def test_the_drill_file_says_that_its_holes_are_not_plated(tape_6x4: Sample) -> None:
    assert "; #@! TF.FileFunction,NonPlated,1,1,NPTH\n" in tape_6x4.path("drill-npth").read_text()


def test_a_tape_without_holes_has_no_drill_file(tape_100x50: Sample) -> None:
    assert "drill-npth" not in tape_100x50.kit.files
