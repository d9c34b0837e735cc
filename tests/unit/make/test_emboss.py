"""A texture on a user's part: what is said where its own check fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from tactape_fab import TapeSpec, make_kit
from tactape_fab.base.errors import VerifyError
from tactape_fab.make.emboss import emboss_kit
from tactape_fab.solids.surface.charts import Placement

trimesh = pytest.importorskip("trimesh")


def test_a_part_of_coarse_facets_that_fails_its_check_is_told_to_be_finer(tmp_path: Path) -> None:
    spec = TapeSpec(sector=3, part="dome", pitch_mm=2.5, size_mm=(20.0, 16.0), process="sla", tag="none")
    kit = make_kit(spec, tmp_path / "kit", verify=False)
    said = []
    for name, finer in (("coarse", 1), ("fine", 2)):  # 80 facets, which fold by up to 22 degrees, and 320, by up to 11
        ball = trimesh.creation.icosphere(subdivisions=finer, radius=30.0)
        ball.export(tmp_path / f"{name}.stl")
        placement = Placement(at_mm=ball.vertices[0].tolist(), up=(0.3, 0.5, 0.8))
        try:
            emboss_kit(kit.path, tmp_path / f"{name}.stl", tmp_path / name, placement=placement)
        except VerifyError as error:
            said.append((name, str(error)))
    ((name, message),) = said
    assert name == "coarse" and not (tmp_path / "coarse").exists() and (tmp_path / "fine").exists()
    assert message.count("give a SURFACE of finer facets, or another place") == 1 and message.endswith("or another place")


def test_facets_that_rise_above_tops_beside_them_are_of_no_element(tmp_path: Path) -> None:
    """A ball whose facets are longer than three pitches: its corners are higher than the tops of elements beside them."""
    spec = TapeSpec(sector=3, part="dome", pitch_mm=2.5, size_mm=(30.0, 24.0), process="sla")
    kit = make_kit(spec, tmp_path / "kit", verify=False)
    trimesh.creation.icosphere(subdivisions=2, radius=30.0).export(tmp_path / "ball.stl")
    made = emboss_kit(kit.path, tmp_path / "ball.stl", tmp_path / "out", placement=Placement(at_mm=(0.0, 30.0, 0.0)))
    assert all(check.passed for check in made.checks)
