"""Changes between two frames of one contact, against dots moved by hand and against simulated frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import Localization, Localizer, Motion, TapeSpec
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import load_fab, load_part
from tactape_fab.sense import ElasticContact, LocatedDots, SensorProfile, load_sensor, simulate
from tactape_fab.sense.geometry import Geometry
from tactape_fab.sense.simulation.parts import parts_of, scattered
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.sense.track.change import LEAST_COMMON, Change, change_between
from tactape_fab.sense.track.motion import pose_of, slip_of
from tests.contacts import TAPE, dots

SENSOR = load_sensor("gelsight-mini")


def at(localizer: Localizer, x: float, y: float, theta_deg: float) -> Localization:
    return localizer.locate_dots(dots((x, y), theta_deg, (5.0, 4.0)))


def known(old: Localization, new: Localization, sensor: SensorProfile = SENSOR) -> Change:
    change = change_between(old, new, sensor)
    assert change is not None
    return change


@pytest.mark.parametrize("turn_deg", [0.0, 0.7, -20.0])
def test_a_rigid_tape_moves_without_strain(localizer: Localizer, turn_deg: float) -> None:
    change = known(at(localizer, 30.0, 20.0, 170.0), at(localizer, 30.3, 19.6, 170.0 + turn_deg))
    assert change.shift == pytest.approx([0.3, -0.4, np.radians(turn_deg)], abs=1e-4)
    assert np.abs(change.strain).max() < 1e-4
    assert change.dots > 10


def test_an_image_that_is_stretched_is_strain(localizer: Localizer) -> None:
    centre = SENSOR.centre_px
    for k, matrix in enumerate(([[1.01, 0.0], [0.0, 1.01]], [[1.01, 0.0], [0.0, 0.99]], [[1.0, 0.02], [0.0, 1.0]])):
        xy = dots((30.0, 20.0), 40.0, (5.0, 4.0))
        bent = localizer.locate_dots((xy - centre) @ np.array(matrix).T + centre)
        change = known(at(localizer, 30.0, 20.0, 40.0), bent)
        wanted = np.zeros(3)
        wanted[k] = (0.01, 0.02, 0.02)[k]
        assert change.strain == pytest.approx(wanted, abs=6e-4)


def test_a_bent_camera_is_taken_out() -> None:
    sensor = replace(SENSOR, px_per_mm=(16.0, 13.0), geometry=Geometry(aspect=0.05, shear=0.04))
    localizer = Localizer([TAPE], sensor)
    frames = [simulate(TAPE, (30.0 + 0.2 * k, 20.0), 10.0 + 2.0 * k, sensor=sensor, seed=k, noise=0.0) for k in (0, 1)]
    old, new = (localizer.locate(frame) for frame in frames)
    change = known(old, new, sensor)
    assert change.shift == pytest.approx([0.2, 0.0, np.radians(2.0)], abs=0.004)


def test_too_few_dots_in_common_are_no_change(localizer: Localizer) -> None:
    old, new = at(localizer, 30.0, 20.0, 10.0), at(localizer, 37.5, 20.0, 10.0)
    assert change_between(old, new, SENSOR) is None
    assert change_between(old, replace(new, dots=None), SENSOR) is None
    assert change_between(old, replace(old, tape="another"), SENSOR) is None
    assert old.dots is not None
    few = LocatedDots(
        uv_px=old.dots.uv_px,
        cell=old.dots.cell,
        symbol=old.dots.symbol,
        residual_mm=old.dots.residual_mm,
        inlier=np.arange(len(old.dots.inlier)) < LEAST_COMMON - 1,
    )
    assert change_between(old, replace(old, dots=few), SENSOR) is None


def test_what_both_frames_share_cancels(localizer: Localizer) -> None:
    """Parts 50 um off their places: a pose is off by 8 um, the change of a contact at rest by one; and that is what is said."""
    squares, poses, said, off = [], [], [], []
    for k in range(30):
        parts, _ = scattered(parts_of(TAPE), Scene(placement_mm=0.05), np.random.default_rng(k))
        frames = [simulate(TAPE, (25.0 + 0.3 * k, 20.0), 12.0 * k, parts=parts, seed=2 * k + j) for j in (0, 1)]
        old, new = (localizer.locate(frame) for frame in frames)
        if old.located and new.located and old.covariance is not None and new.covariance is not None:
            change = known(old, new)
            squares.append(change.shift @ np.linalg.solve(change.covariance, change.shift) / 3)
            poses.append(np.sqrt(np.trace((old.covariance + new.covariance)[:2, :2]) / 2))
            said.append(np.sqrt(np.trace(change.covariance[:2, :2]) / 2))
            off.append(np.hypot(*change.shift[:2]))
    assert len(squares) >= 28
    assert np.median(said) < 0.3 * np.median(poses)
    assert np.sqrt(np.mean(np.square(off)) / 2) < 0.003
    assert 0.4 < np.mean(squares) < 2.0


def test_a_gel_that_is_sheared_unevenly_shows(localizer: Localizer) -> None:
    """Its image is carried along by 0.1 mm rms, smooth over 4 mm."""
    bent = []
    for k in range(8):
        frames = [simulate(TAPE, (30.0, 20.0), 30.0 * k, seed=k, gel_displacement_um=um) for um in (0.0, 100.0)]
        old, new = (localizer.locate(frame) for frame in frames)
        change = known(old, new)
        covariance = change.strain_covariance + 0.002**2 * np.eye(3)
        bent.append(np.sqrt(change.strain @ np.linalg.solve(covariance, change.strain)))
    assert (np.array(bent) > 4.0).sum() >= 5


@pytest.mark.parametrize("tilt_deg", [7.0, 10.0])
def test_a_contact_that_tilts_does_not_move(tilt_deg: float) -> None:
    """Tops lean and are drawn by tens of micrometres, which its answers put right; and it is no shear of the gel."""
    localizer, truth = Localizer([TAPE], SENSOR), ((30.0, 20.0), 30.0)
    flat, tilted = (
        localizer.locate(simulate(TAPE, *truth, seed=k, elastic=ElasticContact(force_n=4.0, tilt_deg=(k * tilt_deg, 0.0))))
        for k in (0, 1)
    )
    change = known(flat, tilted)
    assert np.hypot(*change.shift[:2]) < 0.012
    motion = Motion()
    slip = slip_of(pose_of(tilted, 1.0), pose_of(flat, 0.0), pose_of(flat, 0.0), motion, change)  # type: ignore[arg-type]
    assert not slip.detected and slip.cause is None


def test_a_firmer_press_shears_nothing() -> None:
    """Tops of long parts are drawn by the pressure, by percents of the image's size."""
    tape = plan(TapeSpec(sector=7, pitch_mm=2.2, displacement_mm=0.3), load_fab("generic-fpc"), load_part("r0402"))
    localizer = Localizer([tape], SENSOR)
    soft, firm = (
        localizer.locate(simulate(tape, (40.0, 22.0), 0.0, seed=k, elastic=ElasticContact(force_n=force_n)))
        for k, force_n in enumerate((1.0, 12.0))
    )
    change = known(soft, firm)
    slip = slip_of(pose_of(firm, 1.0), pose_of(soft, 0.0), pose_of(soft, 0.0), Motion(), change)  # type: ignore[arg-type]
    assert not slip.detected and slip.cause is None
