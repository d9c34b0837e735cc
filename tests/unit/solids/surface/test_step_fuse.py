"""Domes on cones whose apex is far: OCCT's fuse loses parts of them, the written file does not."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from math import pi, radians, tan
from pathlib import Path
from typing import Any

import pytest

from tactape_fab.solids.surface.charts import Placement
from tactape_fab.solids.surface.place import lay_out
from tactape_fab.solids.surface.standing import standing_mm3
from tactape_fab.texture.part import TapePart
from tests.surfaces import planned, step_file
from tests.thorough import slow

HEIGHT_MM = 60.0


def volume_mm3(solid: Any) -> float:
    """As exact as doubles are: by default OCCT is off by a hundredth of what the elements add."""
    properties = import_module("OCP.GProp").GProp_GProps()
    import_module("OCP.BRepGProp").BRepGProp.VolumeProperties_s(solid.wrapped, properties, 1e-9)
    return float(properties.Mass())


@slow
@pytest.mark.parametrize(
    ("top_mm", "half_angle_deg", "radius_mm"),
    [(None, -1.4, 15.0), (None, -2.0, 15.0), (0.4, 1.5, 15.0), (None, 1.2, 25.0)],
    ids=["cap, narrowing", "cap, valid but wrong at first", "cone, widening", "cap, given solid spoilt at first"],
)
def test_domes_on_a_cone_whose_apex_is_far(tmp_path: Path, top_mm: float | None, half_angle_deg: float, radius_mm: float) -> None:
    bd = import_module("build123d")
    fuse, step = (import_module(f"tactape_fab.solids.surface.{name}") for name in ("step_fuse", "part_step"))
    less = HEIGHT_MM / 2 * tan(radians(half_angle_deg))
    low, high = radius_mm - less, radius_mm + less
    model = step.read_step_solid(step_file(tmp_path / "cone.step", bd.Solid.make_cone(low, high, HEIGHT_MM)).read_bytes())
    # over the seam where OCCT's fuse goes wrong at once; opposite to it, -2 degrees came out valid, all faces, two domes cut
    at_mm = (-radius_mm if half_angle_deg == -2 else radius_mm, 0.0, HEIGHT_MM / 2)
    chart = step.FaceChart(model, Placement(at_mm=at_mm))
    dome = TapePart(name="d", shape="dome", body_mm=(0.8, 0.8, 0.3), rotation_deg=0.0, top_mm=top_mm)
    laid = lay_out(replace(planned((10.0, 10.0)), part=dome), chart)
    path = tmp_path / "embossed.step"
    path.write_bytes(fuse.embossed_step(model.solid, chart.surface, laid, "1980-01-01T00:00:00"))
    solid = bd.import_step(path)
    count = laid.tape.part_count
    assert (len(solid.solids()), len(solid.faces()), solid.is_valid) == (1, 3 + count * (1 if top_mm is None else 2), True)
    assert {face.geom_type.name for face in solid.faces()} == {"PLANE", "CONE"} | ({"SPHERE"} if top_mm is None else set())
    cone_mm3 = pi * HEIGHT_MM / 3 * (low**2 + low * high + high**2)
    expected_mm3 = standing_mm3(dome, chart.surface, laid.elements, float(laid.sink_mm.max()))
    assert volume_mm3(solid) - cone_mm3 == pytest.approx(expected_mm3.sum(), abs=0.01 * expected_mm3.min())
