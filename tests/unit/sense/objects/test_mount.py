"""Mounts: what is refused, and where points and contacts of a film lie on a plane and round a cylinder."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tactape_fab.base.errors import SpecError
from tactape_fab.sense.objects.mount import Mount, on_surface, printed_mount, sensor_on_object, to_object
from tests.tapes import tape_at

TURN = Rotation.from_euler("xyz", (40.0, -20.0, 70.0), degrees=True)
AT_MM = np.array([1.0, 2.0, 3.0])
ROUND: dict[str, Any] = {"surface": "cylinder", "top_mm": 16.1, "true_mm": 16.0}


def mount(**more: Any) -> Mount:
    return Mount(**{"surface": "plane", "rotation": TURN.as_matrix(), "position_mm": AT_MM} | more)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"surface": "sphere"}, "surface"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "is no rotation; give a rotation matrix"),
        ({"rotation": 2.0 * np.eye(3)}, "is no rotation"),
        ({"rotation": np.eye(4)}, "rotation"),
        ({"position_mm": (1.0, 2.0)}, "position_mm"),
        ({"surface": "cylinder"}, "top_mm"),
        ({"surface": "cylinder", "top_mm": 16.0}, "true_mm"),
        (ROUND | {"true_mm": -16.0}, "true_mm"),
        (ROUND | {"around": "z"}, "around"),
        ({"covariance": np.eye(3)}, "covariance"),
        ({"covariance": np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -1.0])}, "covariance = .* is none; give a covariance"),
        ({"covariance": np.triu(np.ones((6, 6)))}, "covariance = .* is none; give a covariance"),
        ({"covariance": 1e-9 * np.triu(np.ones((6, 6)))}, "covariance = .* is none; give a covariance"),
    ],
)
def test_a_mount_that_is_none_is_refused(more: dict[str, Any], says: str) -> None:
    with pytest.raises(SpecError, match=says):
        mount(**more)


def test_lists_are_taken_as_arrays() -> None:
    made = mount(rotation=TURN.as_matrix().tolist(), position_mm=[1, 2, 3])
    assert made.rotation == pytest.approx(TURN.as_matrix()) and made.position_mm.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("around", "board_mm", "point", "axes"),
    [
        # a quarter of 2 pi 16 mm round, 7 mm up
        ("x", (8.0 * np.pi, 7.0), (0.0, 16.1, 7.0), [(-1, 0, 0), (0, 0, 1), (0, 1, 0)]),
        ("x", (0.0, 7.0), (16.1, 0.0, 7.0), [(0, 1, 0), (0, 0, 1), (1, 0, 0)]),
        ("y", (7.0, 8.0 * np.pi), (0.0, 16.1, -7.0), [(0, 0, -1), (-1, 0, 0), (0, 1, 0)]),
    ],
)
def test_a_film_lies_round_a_cylinder(around: str, board_mm: tuple[float, float], point: Any, axes: Any) -> None:
    made = mount(**ROUND, around=around)
    points, found = on_surface(made, [board_mm, (0.0, 0.0)])
    assert points[0] == pytest.approx(point, abs=1e-12) and found[0] == pytest.approx(np.transpose(axes), abs=1e-12)
    points, found = to_object(made, [board_mm])
    assert points[0] == pytest.approx(TURN.apply(point) + AT_MM) and found[0] == pytest.approx(TURN.apply(axes).T)


def test_a_rod_may_be_thin() -> None:
    assert mount(**ROUND | {"top_mm": 0.5, "true_mm": 0.4}).top_mm == 0.5


@pytest.mark.parametrize("around", ["x", "y"])
def test_the_middle_line_of_a_print_stays_where_it_was_flat(around: Any) -> None:
    """In the model's frame: z out of the board, 0 at the middle line; 3 mm of arc beside it are 12 sin(3 / 12) mm."""
    made = printed_mount((40.0, 26.0), 12.0, around)
    half, k = (20.0, 0) if around == "x" else (13.0, 1)
    board = np.full((3, 2), 7.0)
    board[:, k] = half + np.array([0.0, 3.0, -3.0])
    points, axes = to_object(made, board)
    side_mm, drop_mm = 12.0 * np.sin(0.25), 12.0 * (1.0 - np.cos(0.25))
    want = np.column_stack([np.full((3, 2), 7.0), [0.0, -drop_mm, -drop_mm]])
    want[:, k] = half + np.array([0.0, side_mm, -side_mm])
    assert points == pytest.approx(want, abs=1e-12)
    assert axes[0] == pytest.approx(np.eye(3), abs=1e-12)


@pytest.mark.parametrize("theta_deg", [0.0, 30.0, -100.0])
@pytest.mark.parametrize("surface", ["plane", "cylinder"])
def test_a_sensor_on_a_film_looks_into_the_object(surface: str, theta_deg: float) -> None:
    """Its z is against the film's normal, its u is the board's x turned clockwise from the image's side."""
    tape = tape_at(7, (6, 5))
    made = mount() if surface == "plane" else mount(**ROUND)
    found = sensor_on_object("cup", made, tape, (4.0, 3.0), theta_deg)
    x0, y0 = tape.board.texture_origin_mm
    points, axes = to_object(made, [(x0 + 4.0, y0 - 3.0)])
    turned = axes[0] @ np.diag([1.0, -1.0, -1.0]) @ Rotation.from_euler("z", -theta_deg, degrees=True).as_matrix()
    pose = found.transform()
    assert found.object == "cup" and found.position_mm == pytest.approx(points[0]) and found.covariance is None
    assert pose[:3, :3] == pytest.approx(turned, abs=1e-9) and pose[:, 3] == pytest.approx([*points[0], 1.0])
    with pytest.raises(SpecError, match="theta_deg"):
        sensor_on_object("cup", made, tape, (4.0, 3.0), float("nan"))
