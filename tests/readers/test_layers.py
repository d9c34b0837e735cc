"""Outside readers draw every fabrication layer as the layout's own polygons, at 40 px/mm; and wrong files do not pass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely

from tactape_fab import TapeSpec, make_kit
from tactape_fab.kit.film.coverlay import gang_window
from tactape_fab.kit.film.drawing import tape_drawing
from tactape_fab.kit.film.layout import Flashes, Layout
from tactape_fab.kit.profiles import load_fab
from tactape_fab.kit.render.gerber import render_copper
from tests.readers.conftest import Sample, layout_of
from tests.readers.pictures import Picture, Reader
from tests.readers.raster import LAYERS, PX_PER_MM, Window, area_mm2, board_window, coverage, layer_edges_mm, polygon_edges_mm

Truth = Callable[[str], Picture]


@pytest.fixture(scope="session")
def truth_100x50(tape_100x50: Sample) -> Truth:
    """A layer's polygons of the main job's tape as a picture."""
    layout = tape_100x50.layout
    return cache(lambda layer: coverage(layer_edges_mm(layout, layer), board_window(layout)))


def _assert_alike(reader: Reader, picture: Picture, truth: Picture, folder: Path) -> None:
    measured = reader.iou(picture, truth)
    if measured < reader.least_iou:
        both = np.stack([truth, np.zeros_like(truth), picture], axis=-1)
        cv2.imwrite(str(folder / "blue-truth-red-reader.png"), (255 * both).astype(np.uint8))
    assert measured >= reader.least_iou, f"IoU {measured:.4f}, see {folder}"


def test_the_truth_of_a_square_is_its_area_in_each_pixel() -> None:
    square_px = np.array([(1.25, 1.0), (2.5, 1.0), (2.5, 2.5), (1.25, 2.5)])
    edges = np.stack([square_px, np.roll(square_px, -1, axis=0)], axis=1) / PX_PER_MM
    window = Window(left_mm=0.0, bottom_mm=0.0, width_px=4, height_px=4)
    expected = [[0, 0, 0, 0], [0, 0.375, 0.25, 0], [0, 0.75, 0.5, 0], [0, 0, 0, 0]]
    assert coverage(edges, window).tolist() == expected


@pytest.mark.parametrize("layer", LAYERS)
def test_the_truth_covers_the_area_of_the_polygons(tape_100x50: Sample, truth_100x50: Truth, layer: str) -> None:
    area = area_mm2(layer_edges_mm(tape_100x50.layout, layer))
    assert truth_100x50(layer).sum(dtype=np.float64) / PX_PER_MM**2 == pytest.approx(area, rel=1e-3)


@pytest.mark.parametrize("layer", LAYERS)
def test_reader_draws_the_layer_as_laid_out(
    tape_100x50: Sample, truth_100x50: Truth, reader: Reader, layer: str, tmp_path: Path
) -> None:
    picture = reader.draw(tape_100x50.path(layer), board_window(tape_100x50.layout))
    _assert_alike(reader, picture, truth_100x50(layer), tmp_path)


@pytest.mark.parametrize("rotation_deg", [0.0, 20.0, 110.0])
def test_reader_draws_pads_at_any_angle(reader: Reader, rotation_deg: float, tmp_path: Path) -> None:
    layout = layout_of(TapeSpec(sector=3, pitch_mm=2.5, size_mm=(20.0, 20.0), tag="none", rotation_deg=rotation_deg))
    picture = reader.draw(_copper_file(layout, tmp_path), board_window(layout))
    _assert_alike(reader, picture, _copper_truth(layout), tmp_path)


@pytest.mark.parametrize("corner_radius_mm", [2.0, 5.0])
def test_reader_draws_wide_corners_as_laid_out(reader: Reader, corner_radius_mm: float, tmp_path: Path) -> None:
    spec = TapeSpec(sector=3, size_mm=(40.0, 30.0), tag="none", corner_radius_mm=corner_radius_mm)
    layout, kit = layout_of(spec), make_kit(spec, tmp_path / "tape", verify=False)
    picture = reader.draw(kit.path / kit.files["profile"], board_window(layout))
    _assert_alike(reader, picture, coverage(layer_edges_mm(layout, "profile"), board_window(layout)), tmp_path)


@pytest.mark.parametrize("role", ["coverlay-top", "stiffener-bottom", "adhesive-bottom"])
def test_reader_draws_a_layer_of_regions_alone(reader: Reader, role: str, tmp_path: Path) -> None:
    spec = TapeSpec(
        sector=3, size_mm=(20.0, 14.0), tag="none", coverlay="gang", stiffener="FR4 0.2", adhesive="3M468 0.13", models=False
    )
    layout, kit = layout_of(spec), make_kit(spec, tmp_path / "tape", verify=False)
    window_mm = gang_window(layout.tape.board, layout.parts_xy_mm, layout.outlines.opening)
    truth = coverage(
        polygon_edges_mm(shapely.Polygon({"coverlay-top": window_mm}.get(role, layout.outline_mm))), board_window(layout)
    )
    _assert_alike(reader, reader.draw(kit.path / kit.files[role], board_window(layout)), truth, tmp_path)


@pytest.mark.parametrize("corner_radius_mm", [0.5, 2.0, 3.0])
def test_a_tape_with_other_corners_verifies(corner_radius_mm: float, tmp_path: Path) -> None:
    spec = TapeSpec(sector=3, size_mm=(40.0, 30.0), tag="none", corner_radius_mm=corner_radius_mm)
    assert all(check.passed for check in make_kit(spec, tmp_path / "tape").checks)


def _mirrored(pads: Flashes, width_mm: float) -> Flashes:
    return Flashes(outline_mm=pads.outline_mm[::-1] * (-1.0, 1.0), xy_mm=pads.xy_mm * (-1.0, 1.0) + (width_mm, 0.0))


def _turned(pads: Flashes, _: float) -> Flashes:
    return Flashes(outline_mm=pads.outline_mm @ np.array([(0.0, -1.0), (1.0, 0.0)]), xy_mm=pads.xy_mm)


def _moved(pads: Flashes, _: float) -> Flashes:
    return Flashes(outline_mm=pads.outline_mm, xy_mm=pads.xy_mm + np.array((0.05, 0.0)))


def _tenth_missing(pads: Flashes, _: float) -> Flashes:
    return Flashes(outline_mm=pads.outline_mm, xy_mm=pads.xy_mm[: -len(pads.xy_mm) // 10])


@pytest.mark.parametrize("wrong", [_mirrored, _turned, _moved, _tenth_missing])
def test_a_wrong_copper_layer_falls_below_the_threshold(
    tape_6x4: Sample, reader: Reader, wrong: Callable[[Flashes, float], Flashes], tmp_path: Path
) -> None:
    layout = tape_6x4.layout
    other = replace(layout, pads=wrong(layout.pads, layout.tape.board.size_mm[0]))
    picture = reader.draw(_copper_file(other, tmp_path), board_window(layout))
    assert picture.mean() > 0.0
    assert reader.iou(picture, _copper_truth(layout)) < reader.least_iou
    _assert_alike(reader, picture, _copper_truth(other), tmp_path)


def _copper_file(layout: Layout, folder: Path) -> Path:
    (artifact,) = render_copper(tape_drawing(layout), load_fab("generic-fpc"))
    path = folder / "copper.gtl"
    path.write_bytes(artifact.data)
    return path


def _copper_truth(layout: Layout) -> Picture:
    return coverage(layer_edges_mm(layout, "copper-top"), board_window(layout))
