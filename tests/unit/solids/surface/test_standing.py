"""Volumes of elements on planes, cylinders and cones, against closed forms and sums over a fine grid."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab.solids.elements import element_volume_mm3, sphere_radius_mm
from tactape_fab.solids.surface.charts import Frames
from tactape_fab.solids.surface.developed import Developable, Kind
from tactape_fab.solids.surface.standing import standing_mm3
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart

ORIGIN_MM = np.array([1.0, 2.0, 3.0])
PARTS = {
    "block": TapePart(name="b", shape="block", body_mm=(0.6, 0.3, 0.23), rotation_deg=30.0),
    "cap": TapePart(name="d", shape="dome", body_mm=(0.8, 0.8, 0.3), rotation_deg=0.0),
    "half ball": TapePart(name="h", shape="dome", body_mm=(0.8, 0.8, 0.39), rotation_deg=0.0),
    "cone": TapePart(name="c", shape="dome", body_mm=(0.8, 0.8, 0.3), rotation_deg=0.0, top_mm=0.4),
}


def placed(surface: Developable, *, sense: float = 1.0) -> Frames:
    """Four places, board x at 0.3 rad to the first flat axis."""
    places = surface.roll(np.array([[0.4, 2.0]]).repeat(4, axis=0), np.array([(0.0, 0.0), (3.0, 1.0), (-2.0, 3.0), (1.0, -4.0)]))
    x_axis = np.cos(0.3) * places.first + np.sin(0.3) * places.second
    return Frames(
        points_mm=places.points_mm,
        x_axis=x_axis,
        normal=places.normal * sense,
        facet=np.zeros(4, dtype=np.int64),
        walked_mm=np.zeros(4),
        arrived=np.ones(4, dtype=bool),
    )


def tops_mm(part: TapePart, x: FloatArray, y: FloatArray) -> FloatArray:
    """Height of an element at points of its foot's plane, its flank going on below that; minus infinity beside it."""
    radius = np.hypot(x, y)
    length, width, height = part.body_mm
    if part.shape == "block":
        c, s = np.cos(np.radians(part.rotation_deg)), np.sin(np.radians(part.rotation_deg))
        inside = (np.abs(c * x + s * y) < length / 2) & (np.abs(c * y - s * x) < width / 2)
        return np.where(inside, height, -np.inf)
    if part.top_mm is not None:
        return np.minimum(height, height * (length / 2 - radius) / (length / 2 - part.top_mm / 2))
    ball = sphere_radius_mm(part)
    return np.where(radius < ball, height - ball + np.sqrt(np.maximum(ball**2 - radius**2, 0)), -np.inf)


@pytest.mark.parametrize("name", PARTS)
def test_on_a_plane_it_is_the_closed_form(name: str) -> None:
    plane = Developable(kind="plane", origin_mm=ORIGIN_MM, axes=np.eye(3))
    assert standing_mm3(PARTS[name], plane, placed(plane), 0.05) == pytest.approx(element_volume_mm3(PARTS[name]), rel=1e-12)


@pytest.mark.parametrize("sense", [1.0, -1.0], ids=["bulging", "hollow"])
@pytest.mark.parametrize("half_angle_rad", [0.0, 0.2, -0.2], ids=["cylinder", "widening", "narrowing"])
@pytest.mark.parametrize("name", PARTS)
def test_on_a_curved_surface_it_is_the_sum_over_a_grid(name: str, half_angle_rad: float, sense: float) -> None:
    kind: Kind = "cone" if half_angle_rad else "cylinder"
    surface = Developable(kind=kind, origin_mm=ORIGIN_MM, axes=np.eye(3), radius_mm=4.0, half_angle_rad=half_angle_rad)
    frames, step = placed(surface, sense=sense), 0.002
    line = np.arange(-0.55 + step / 2, 0.55, step)
    x, y = (a.ravel()[None].repeat(4, axis=0) for a in np.meshgrid(line, line))
    height = surface.heights(frames, x, y)
    # the heights lead to the surface: by its own equation
    points = frames.points_mm[:, None] + sum(
        a[:, :, None] * d[:, None] for a, d in ((x, frames.x_axis), (y, frames.y_axis), (height, frames.normal))
    )
    away = np.hypot(*np.moveaxis(points[:, :, :2] - ORIGIN_MM[:2], 2, 0))
    assert np.abs(away - 4.0 - (points[:, :, 2] - ORIGIN_MM[2]) * np.tan(half_angle_rad)).max() < 1e-12
    assert np.abs(height).max() < 0.1
    summed = np.maximum(tops_mm(PARTS[name], x, y) - height, 0.0).sum(axis=1) * step**2
    assert standing_mm3(PARTS[name], surface, frames, 0.1) == pytest.approx(summed, rel=1e-3 if name == "block" else 1e-4)
