"""PyGerber, the strictest parser of the four, accepts every layer in every attribute mode, and draws a small tape as laid out."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tactape_fab import Kit, TapeSpec, make_kit
from tests.readers.conftest import Sample, layout_of
from tests.readers.pictures import Picture, read_gray
from tests.readers.raster import LAYERS, PX_PER_MM, Window, coverage, iou, layer_edges_mm
from tests.thorough import only_thorough, thorough

_OVERSAMPLING = 20  # PyGerber draws on whole pixels: one of them must be little of the profile's line
_MARGIN_PX = 20


def _parsed(path: Path) -> Any:
    from pygerber.gerberx3.api.v2 import GerberFile, OnParserErrorEnum  # every worker collects these tests

    return GerberFile.from_file(path).parse(on_parser_error=OnParserErrorEnum.Raise)


def _drawn(path: Path, folder: Path) -> tuple[Picture, Window]:
    """PyGerber's picture from the bounding box that it reports, with a margin, and the window that this is."""
    file = _parsed(path)
    target = folder / "pygerber.png"
    file.render_raster(str(target), dpmm=PX_PER_MM * _OVERSAMPLING)
    drawn = np.where(read_gray(target) > 0, 255, 0).astype(np.uint8)
    height_px, width_px = (-(-side // _OVERSAMPLING) for side in drawn.shape)
    bottom, right = height_px * _OVERSAMPLING - drawn.shape[0], width_px * _OVERSAMPLING - drawn.shape[1]
    whole = cv2.copyMakeBorder(drawn, 0, bottom, 0, right, cv2.BORDER_CONSTANT, value=0)
    fine = cv2.resize(whole, (width_px, height_px), interpolation=cv2.INTER_AREA)
    info = file.get_info()
    window = Window(
        left_mm=float(info.min_x_mm) - _MARGIN_PX / PX_PER_MM,
        bottom_mm=float(info.max_y_mm) - (height_px + _MARGIN_PX) / PX_PER_MM,
        width_px=width_px + 2 * _MARGIN_PX,
        height_px=height_px + 2 * _MARGIN_PX,
    )
    return np.pad(fine.astype(np.float32) / 255, _MARGIN_PX), window


@pytest.fixture(scope="module")
def tape_without_strip(tmp_path_factory: pytest.TempPathFactory) -> Sample:
    """6 x 4 parts on a tape no larger than it must be."""
    spec = TapeSpec(sector=12, size_mm=(10.7, 7.7), tag="none", name="t2")
    sample = Sample(kit=make_kit(spec, tmp_path_factory.mktemp("plain") / "t2"), layout=layout_of(spec))
    assert (sample.kit.tape.columns, sample.kit.tape.rows) == (6, 4)
    return sample


@pytest.mark.parametrize("layer", ["copper-top", *(thorough(layer) for layer in LAYERS if layer != "copper-top")])
def test_pygerber_draws_the_layer_as_laid_out(tape_without_strip: Sample, tape_6x4: Sample, layer: str, tmp_path: Path) -> None:
    sample = tape_6x4 if layer == "legend-top" else tape_without_strip
    picture, window = _drawn(sample.path(layer), tmp_path)
    assert iou(picture, coverage(layer_edges_mm(sample.layout, layer), window)) >= 0.98


@only_thorough
def test_a_mirrored_layer_falls_below_the_threshold(tape_without_strip: Sample, tmp_path: Path) -> None:
    picture, window = _drawn(tape_without_strip.path("copper-top"), tmp_path)
    truth = coverage(layer_edges_mm(tape_without_strip.layout, "copper-top"), window)
    assert iou(picture[:, ::-1], truth) < 0.98


@pytest.fixture(scope="module", params=["full", "comments", "off"])
def kit_in_each_mode(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Kit:
    spec = TapeSpec(sector=100, pitch_mm=4.0, size_mm=(30.0, 17.0), x2=request.param)
    return make_kit(spec, tmp_path_factory.mktemp(request.param) / "tape")


@pytest.mark.parametrize("layer", [*LAYERS, "components-top"])
def test_pygerber_parses_the_layer_strictly(kit_in_each_mode: Kit, layer: str) -> None:
    info = _parsed(kit_in_each_mode.path / kit_in_each_mode.files[layer]).get_info()
    half_line_mm = Decimal("0.1") if layer == "profile" else Decimal(0)
    assert -half_line_mm <= info.min_x_mm < info.max_x_mm <= 30 + half_line_mm
    assert -half_line_mm <= info.min_y_mm < info.max_y_mm <= 17 + half_line_mm


def test_pygerber_refuses_a_broken_layer(tape_6x4: Sample, tmp_path: Path) -> None:
    broken = tmp_path / "broken.gtl"
    broken.write_bytes(tape_6x4.path("copper-top").read_bytes().replace(b"G75*", b"G75"))
    with pytest.raises(Exception, match="found 'G75'"):
        _parsed(broken)
