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
from tactape_fab.sense.track import change as module
from tactape_fab.sense.track.change import CAMERA_SHARE, LEAST_COMMON, Change, _camera, _common, _solved, change_between
from tactape_fab.sense.track.motion import pose_of, slip_of
from tactape_fab.texture.frames import BoolArray
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
    for count in (LEAST_COMMON - 1, LEAST_COMMON):
        few = inliers(old, np.arange(len(old.dots.inlier)) % 5 == 0, count)
        assert (change_between(old, few, SENSOR) is None) == (count < LEAST_COMMON)


def inliers(fix: Localization, of: BoolArray, count: int | None = None) -> Localization:
    """An answer of which only some dots agree."""
    assert fix.dots is not None
    kept = np.zeros(len(of), dtype=bool)
    kept[np.flatnonzero(of)[:count]] = True
    parts = {name: getattr(fix.dots, name) for name in ("uv_px", "cell", "symbol", "residual_mm")}
    return replace(fix, dots=LocatedDots(**parts, inlier=kept))


def fitted_elsewhere(fix: Localization, by: tuple[float, float, float]) -> Localization:
    """The answer with another pose (mm, mm, degrees off), and the residuals S + R(theta) q - C that its dots have there."""
    assert fix.dots is not None and fix.position_mm is not None and fix.theta_deg is not None
    q = SENSOR.camera.from_px(fix.dots.uv_px) - SENSOR.camera.from_px(SENSOR.centre_px)
    position, theta_deg = np.add(fix.position_mm, by[:2]), fix.theta_deg + by[2]
    was, turned = (np.array([[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]]) for t in np.radians([fix.theta_deg, theta_deg]))
    parts = {name: getattr(fix.dots, name) for name in ("uv_px", "cell", "symbol", "inlier")}
    residual_mm = fix.dots.residual_mm + np.array(by[:2]) + q @ (turned - was).T
    moved = LocatedDots(**parts, residual_mm=residual_mm)
    return replace(fix, dots=moved, position_mm=tuple(position.tolist()), theta_deg=theta_deg)


def test_a_change_is_that_of_the_dots_whatever_pose_was_fitted_to_them(localizer: Localizer) -> None:
    """Dots on one side of the image, whose middle is off its centre."""
    old, new = at(localizer, 30.0, 20.0, 20.0), at(localizer, 30.2, 19.9, 21.0)
    assert old.dots is not None and new.dots is not None
    old, new = (inliers(fix, fix.dots.uv_px[:, 0] > SENSOR.centre_px[0]) for fix in (old, new) if fix.dots is not None)
    # by the profile's camera
    old, new = (replace(fix, px_per_mm=SENSOR.px_per_mm[0], strain=(0.0, 0.0, None)) for fix in (old, new))
    want = known(old, new)
    assert want.shift == pytest.approx([0.2, -0.1, np.radians(1.0)], abs=1e-3)
    found = known(old, fitted_elsewhere(new, (0.02, 0.05, 0.3)))
    # but for its direction, which is by the answer's turn: 0.3 degrees of 0.22 mm
    assert found.shift == pytest.approx(want.shift, abs=1.3e-3)


def test_the_camera_of_two_fits_undoes_the_mean_of_theirs(localizer: Localizer) -> None:
    first = at(localizer, 30.0, 20.0, 0.0)
    fixes = [
        replace(first, px_per_mm=SENSOR.px_per_mm[0] * scale, strain=strain)
        for scale, strain in ((1.02, (0.05, 0.01, None)), (1.0, (0.03, 0.03, None)))
    ]
    seen_by = 1.01 * np.array([[1.02, 0.02], [0.0, 0.98]])
    assert _camera(SENSOR, *fixes) @ seen_by == pytest.approx(np.eye(2))


def test_a_solution_s_covariance_is_that_of_a_t_distribution() -> None:
    """Of 12 numbers and 3 unknowns: nine degrees of freedom, whose variance is 9 / 7 of the normal one."""
    rng = np.random.default_rng(1)
    rates = rng.standard_normal((6, 2, 3))
    normal = np.linalg.inv(rates.reshape(-1, 3).T @ rates.reshape(-1, 3))
    of = [_solved(rates, rng.standard_normal((6, 2)))[1] / normal for _ in range(4000)]
    assert np.mean(of) == pytest.approx(9.0 / 7.0, rel=0.03)


def test_what_answers_take_off_is_unsure(monkeypatch: pytest.MonkeyPatch, localizer: Localizer) -> None:
    old, new = at(localizer, 30.0, 20.0, 20.0), at(localizer, 30.0, 20.0, 20.0)
    assert new.dots is not None
    # of a fit to places 0.04 mm from those that are seen
    parts = {name: getattr(new.dots, name) for name in ("uv_px", "cell", "symbol", "inlier")}
    new = replace(new, dots=LocatedDots(**parts, residual_mm=np.add(new.dots.residual_mm, (0.04, 0.0))))
    change = known(old, new)
    monkeypatch.setattr(module, "CORRECTION_SHARE", 0.0)
    without = known(old, new)
    assert change.shift == pytest.approx(without.shift)
    more = change.covariance - without.covariance
    assert more[0, 0] == pytest.approx(0.01**2, rel=0.02) and np.abs(more[1:, 1:]).max() < 1e-7


def test_common_dots_are_those_of_equal_cells() -> None:
    """Also where the frames reach to different columns, so that one number for a cell may stand for two."""
    rng = np.random.default_rng(5)
    for _ in range(200):
        frames = []
        for columns in rng.integers(1, 9, 2).tolist():
            every = np.stack(np.meshgrid(np.arange(columns), np.arange(4)), axis=-1).reshape(-1, 2)
            cell = rng.permutation(every)[: rng.integers(1, len(every) + 1)]
            none = np.zeros((len(cell), 2))
            inlier = rng.random(len(cell)) < 0.7
            frames.append(LocatedDots(uv_px=none, cell=cell, symbol=cell[:, 0], residual_mm=none, inlier=inlier))
        found = _common(*frames)
        both = set.intersection(*(set(map(tuple, dots.cell[dots.inlier].tolist())) for dots in frames))
        assert all(set(map(tuple, dots.cell[k].tolist())) == both for dots, k in zip(frames, found, strict=True))
        assert np.array_equal(frames[0].cell[found[0]], frames[1].cell[found[1]])


def test_a_way_and_a_turn_are_as_unsure_as_the_camera(localizer: Localizer) -> None:
    """Of dots without noise nothing else is left: the camera's share of 0.5 mm, and of half a degree."""
    change = known(at(localizer, 30.0, 20.0, 0.0), at(localizer, 30.5, 20.0, 0.5))
    share_mm, share_deg = 0.5 * CAMERA_SHARE, 0.5 * CAMERA_SHARE
    sigmas = np.sqrt(np.diag(change.covariance))
    assert sigmas[:2] == pytest.approx([share_mm, share_mm], rel=0.1)
    assert share_deg < np.degrees(sigmas[2]) < 2.0 * share_deg + 0.005


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
