"""Smooth random displacement of what the gel shows: its covariance, and what of a frame it changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import Tape
from tactape_fab.sense import Scene, iterate_frames, load_sensor
from tactape_fab.sense.geometry import Gel
from tactape_fab.sense.simulation.dot_errors import dots_of
from tactape_fab.sense.simulation.gel_displacement import displacement_um, displacements
from tactape_fab.sense.simulation.view import View, make_view
from tactape_fab.verify.trip.visible_parts import ERROR_FREE

MINI = load_sensor("gelsight-mini")
POSE = (40.0, 20.0, 25.0)


def view_of(tape: Tape, scene: Scene) -> View:
    return make_view(tape, POSE[:2], POSE[2], MINI, scene)


@pytest.mark.parametrize("length_mm", [1.5, 4.0, 30.0])
def test_it_is_a_gaussian_process_of_that_rms_and_length(tape: Tape, length_mm: float) -> None:
    view = view_of(tape, Scene(gel_displacement_um=100.0, gel_correlation_mm=length_mm))
    at_mm = np.array([[0.0, 0.0], [0.5 * length_mm, 0.0], [0.31, 0.2 + length_mm], [-9.9, 7.4]])
    rng = np.random.default_rng(4)
    drawn = np.stack([displacements(view, at_mm, rng) for _ in range(4000)])
    apart = np.hypot(*(at_mm[:, None] - at_mm).transpose(2, 0, 1))
    expected = 0.1**2 * np.exp(-(apart**2) / (2 * length_mm**2))
    for axis in (0, 1):
        found = drawn[:, :, axis].T @ drawn[:, :, axis] / len(drawn)
        np.testing.assert_allclose(found, expected, atol=0.06 * 0.1**2)
    between = drawn[:, :, 0].T @ drawn[:, :, 1] / len(drawn)
    np.testing.assert_allclose(between, 0.0, atol=0.06 * 0.1**2)


def test_parts_are_drawn_where_the_truth_says_and_nothing_else_moves(tape: Tape) -> None:
    bare = Scene(contact="pad", roll_off_mm=0.0, elastomer_mm=0.0, dome_mm=0.0, tilt_mm_per_mm=(0.0, 0.0), noise=0.0)
    defects = bare.changed({"missing": 0.3, "placement_mm": 0.05})
    still, moved = (
        next(iterate_frames(tape, 1, 3, scene=scene, poses=[POSE]))
        for scene in (defects, defects.changed({"gel_displacement_um": 200.0}))
    )
    both = np.intersect1d(still.dots_part, moved.dots_part)
    assert len(both) >= len(still.dots_part) - 6
    shift_px = moved.dots_px[np.isin(moved.dots_part, both)] - still.dots_px[np.isin(still.dots_part, both)]
    assert 1.0 < np.sqrt((shift_px**2).mean()) < 6.5  # 3.2 px rms, but a frame holds few independent values
    for frame in (still, moved):
        for u, v in frame.dots_px[(np.abs(frame.dots_px - MINI.centre_px) < MINI.centre_px - 8.0).all(axis=1)]:
            near_v, near_u = np.mgrid[round(v) - 7 : round(v) + 8, round(u) - 7 : round(u) + 8]
            patch = frame.depth[near_v, near_u]
            centroid = [(patch * axis).sum() / patch.sum() for axis in (near_u, near_v)]
            np.testing.assert_allclose(centroid, (u, v), atol=0.01)
    again = next(iterate_frames(tape, 1, 3, scene=defects.changed({"gel_displacement_um": 200.0}), poses=[POSE]))
    np.testing.assert_array_equal(again.depth, moved.depth)


def test_noise_and_bumps_stay_as_they_are(tape: Tape) -> None:
    empty = np.empty((0, 2))
    still, moved = (
        next(iterate_frames(tape, 1, 3, scene=Scene(bumps=4, gel_displacement_um=um), poses=[POSE], parts=empty)).depth
        for um in (0.0, 150.0)
    )
    np.testing.assert_array_equal(still, moved)


def test_it_is_the_gel_s_own_where_the_scene_says_nothing(tape: Tape) -> None:
    soft = replace(MINI, gel=Gel(displacement_um=80.0, correlation_mm=2.0))
    own, given = (
        next(iterate_frames(tape, 1, 3, sensor, scene, poses=[POSE])).dots_px
        for sensor, scene in ((soft, Scene()), (MINI, Scene(gel_displacement_um=80.0, gel_correlation_mm=2.0)))
    )
    np.testing.assert_array_equal(own, given)
    assert displacement_um(make_view(tape, POSE[:2], 0.0, soft, Scene(gel_displacement_um=0.0))) == 0.0
    assert displacement_um(view_of(tape, Scene())) == 0.0


def test_simulated_dots_are_displaced_too(tape: Tape) -> None:
    still, moved = (
        dots_of(tape, POSE, Scene(gel_displacement_um=um, gel_correlation_mm=3.0), 1, ERROR_FREE) for um in (0.0, 100.0)
    )
    both = np.intersect1d(still.part, moved.part)
    shift_px = moved.true_px[np.isin(moved.part, both)] - still.true_px[np.isin(still.part, both)]
    assert 0.6 < np.sqrt((shift_px**2).mean()) < 3.0
    near = np.hypot(*(moved.true_px[:, None] - moved.true_px).transpose(2, 0, 1)) < 26.0
    assert near.sum() > 2 * len(near)
    np.testing.assert_array_equal(moved.xy_px, moved.true_px)
