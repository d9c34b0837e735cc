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
    spec = TapeSpec(sector=3, part="dome", pitch_mm=2.5, size_mm=(20.0, 16.0), process="sla")
    kit = make_kit(spec, tmp_path / "kit", verify=False)
    at_mm, said = (0.0, 30.0, 0.0), []
    for name, finer in (("coarse", 2), ("fine", 4)):
        ball = trimesh.creation.icosphere(subdivisions=finer, radius=30.0)
        ball.export(tmp_path / f"{name}.stl")
        try:
            emboss_kit(kit.path, tmp_path / f"{name}.stl", tmp_path / name, placement=Placement(at_mm=at_mm))
        except VerifyError as error:
            said.append((name, str(error)))
    ((name, message),) = said
    assert name == "coarse" and not (tmp_path / "coarse").exists() and (tmp_path / "fine").exists()
    assert message.count("give a SURFACE of finer facets, or another place") == 1 and message.endswith("or another place")
