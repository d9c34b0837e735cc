"""STEP files read by FreeCAD, whose kernel is years older than build123d's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab.texture.tape import Tape
from tests.readers.solids import NAMES, Variant, read_with_freecad, write_assembly
from tests.solids import centre_mm, volume_mm3


@pytest.fixture(scope="module")
def readings(
    freecad: str, solid_variants: dict[str, Variant], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Tape, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("freecad")
    tape = write_assembly(folder / "assembly.step")
    paths = {name: variant.path("step") for name, variant in solid_variants.items()}
    paths["assembly"] = str(folder / "assembly.step")
    found = read_with_freecad(freecad, list(paths.values()), folder)
    return tape, {name: found[path] for name, path in paths.items()}


@pytest.mark.parametrize("name", NAMES)
def test_freecad_reads_one_valid_solid(
    name: str, readings: tuple[Tape, dict[str, Any]], solid_variants: dict[str, Variant]
) -> None:
    variant, found = solid_variants[name], readings[1][name]
    assert (found["solids"], found["valid"]) == (1, True)
    assert found["faces"] == variant.step.count(b"=ADVANCED_FACE(")
    # it integrates spheres that a spline bounds less exactly than OCCT with an accuracy given
    coarse = variant.tape.part.shape == "dome" and variant.form.cylinder is not None
    assert found["volume_mm3"] == pytest.approx(volume_mm3(variant.tape, variant.form), rel=1e-6 if coarse else 1e-7)
    exact = centre_mm(variant.tape, variant.form)
    if exact is not None:
        assert np.abs(np.array(found["centres"][0][:3]) - exact).max() < 1e-6


def test_freecad_reads_the_assembly(readings: tuple[Tape, dict[str, Any]]) -> None:
    tape, found = readings[0], readings[1]["assembly"]
    assert (found["solids"], found["valid"]) == (1 + tape.part_count, True)
    board, *parts = found["centres"]
    assert board[3] > 100 * parts[0][3]
    assert np.array(parts)[:, 3] == pytest.approx(np.full(tape.part_count, 0.6 * 0.3 * 0.23), rel=1e-9)
    assert np.abs(np.array(parts)[:, :3] - np.c_[tape.part_xy_mm(), np.full(tape.part_count, 0.115)]).max() < 1e-9


def test_freecad_is_the_program_that_was_found(freecad: str) -> None:
    assert Path(freecad).name.lower() == "freecadcmd"
