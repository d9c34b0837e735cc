"""Patches of a scan: a picture whose value is its pixel's number tells where each sample was taken."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from tactape_fab.sense.inspect.patches import patch_grid, sample
from tactape_fab.sense.inspect.warp import LineShift, affine_warp

WARP = affine_warp(((10.0, 1.0), (0.5, -9.0)), (20.0, 150.0), (8.0, 8.0), 8.0)
CENTRES = np.array([(5.0, 6.0), (9.0, 4.0), (7.0, 9.0)])
U, V = np.meshgrid(np.arange(150.0), np.arange(170.0))


@pytest.mark.parametrize(("px_per_mm", "step_mm", "shape"), [(10.0, 0.1, (7, 13)), (100.0, 1 / 60, (37, 73))])
def test_a_grid_is_about_its_part_and_as_fine_as_the_scan(px_per_mm: float, step_mm: float, shape: tuple[int, int]) -> None:
    grid = patch_grid(0.61, 0.31, px_per_mm)
    assert grid.shape == shape and grid.count == shape[0] * shape[1] and grid.step_mm == step_mm
    a, b = grid.a_mm.reshape(shape), grid.b_mm.reshape(shape)
    assert np.diff(a, axis=1) == pytest.approx(step_mm) and np.diff(b, axis=0) == pytest.approx(step_mm)
    assert a[:, ::-1] == pytest.approx(-a) and b[::-1] == pytest.approx(-b)


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, np.array([10.0, -70.0, 180.0])])
@pytest.mark.parametrize("axis", [None, 0, 1])
def test_samples_are_where_the_warp_has_them(turn_deg: float, axis: int | None) -> None:
    grid = patch_grid(0.6, 0.3, 10.0)
    lines = (
        () if axis is None else (LineShift(axis=axis, start_px=0.0, step_px=170.0, value_px=np.array([(0.0, 2.0), (2.0, -1.0)])),)
    )
    picture: Any = np.stack([U, V, 0 * U], axis=-1).astype(np.float32)
    warp = replace(WARP, lines=lines)
    seen = sample(picture, warp, CENTRES, turn_deg, grid)
    turn = np.broadcast_to(np.radians(turn_deg), 3)
    for k, (centre, at) in enumerate(zip(CENTRES, turn.tolist(), strict=True)):
        a, b = np.array([np.cos(at), np.sin(at)]), np.array([-np.sin(at), np.cos(at)])
        px = warp.to_px(centre + grid.a_mm[:, None] * a + grid.b_mm[:, None] * b)
        assert seen[k, :, :2] == pytest.approx(px, abs=0.04)  # remap takes 32nds of a pixel


def test_samples_outside_are_black_and_many_patches_are_taken_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = patch_grid(0.6, 0.3, 10.0)
    centres = np.concatenate([CENTRES, [(40.0, 5.0)]])
    picture = np.full((170, 150, 3), 200, dtype=np.uint8)
    whole = sample(picture, WARP, centres, 0.0, grid)
    assert (whole[:3] == 200).all() and (whole[3] == 0).all()
    monkeypatch.setattr("tactape_fab.sense.inspect.patches._MOST_ROWS", 3 * grid.shape[0])
    rows: list[int] = []

    def remap(image: Any, u: Any, *rest: Any, remap: Any = cv2.remap, **more: Any) -> Any:
        rows.append(len(u))
        return remap(image, u, *rest, **more)

    monkeypatch.setattr(cv2, "remap", remap)
    assert sample(picture, WARP, centres, 0.0, grid).tolist() == whole.tolist()
    assert rows == [3 * grid.shape[0], grid.shape[0]]
