"""Dots drawn from records: parts where the simulator's frames have them, and dots as the detector finds them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import Tape, TapeSpec
from tactape_fab.base.errors import SpecError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Frame, Parts, Scene, draw_poses, iterate_frames, load_sensor
from tactape_fab.sense.simulation.parts import parts_of
from tactape_fab.texture.frames import FloatArray
from tests.bench.impostors import random_bumps
from tests.bench.recorded import DotRecords, draw_dots, record_dots
from tests.bench.touched import LEAST_IMPRINT, touched_parts
from tests.thorough import some

SENSOR = load_sensor("gelsight-mini")
STRIP = Scene(contact="strip", strip_width_mm=5.0, contact_turn_deg=30.0, contact_offset_mm=(1.0, 2.0))


@pytest.fixture(scope="module")
def tape() -> Tape:
    return examine(TapeSpec(sector=7)).layout.tape


@pytest.mark.parametrize(
    ("scene", "edge", "scattered"),
    [
        (Scene(), False, False),
        (Scene(contact_mm=(6.0, 4.0), contact_turn_deg=30.0, contact_offset_mm=(1.0, 2.0)), True, False),
        (STRIP, True, False),
        (Scene(contact="strip", strip_width_mm=3.0, cylinder_radius_mm=3.8), False, True),
        (Scene(contact="pad", scale_error=0.05), False, True),
        (Scene(mirrored_tape=True), True, True),
    ],
    ids=["ellipse", "edge", "strip", "narrow strip", "pad", "mirrored"],
)
def test_the_same_parts_are_touched_as_in_frames(tape: Tape, scene: Scene, edge: bool, scattered: bool) -> None:
    parts = random_bumps(tape, 3) if scattered else parts_of(tape)
    poses = draw_poses(tape, 300, 5, scene=scene, edge=edge)
    touched = touched_parts(tape, poses, SENSOR, scene, parts, np.random.default_rng(0))
    assert (np.diff(touched.pose) >= 0).all()
    chosen, seen = [0, 1, 2, 255, 256, 299], 0
    for k, frame in zip(chosen, iterate_frames(tape, 6, scene=scene, poses=poses[chosen], parts=parts), strict=True):
        mine = np.flatnonzero(touched.pose == k)
        mine = mine[np.argsort(touched.part[mine])]
        inside = (np.abs(frame.dots_px - SENSOR.centre_px) <= SENSOR.centre_px).all(axis=1)
        felt = np.flatnonzero((frame.dots_imprint >= LEAST_IMPRINT) & inside)
        felt = felt[np.argsort(frame.dots_part[felt])]
        seen += len(felt)
        assert (touched.part[mine] == frame.dots_part[felt]).all()
        assert touched.px[mine] == pytest.approx(frame.dots_px[felt], abs=1e-9)
        assert touched.imprint[mine] == pytest.approx(frame.dots_imprint[felt], abs=1e-9)
    assert seen > 40


def test_parts_are_missing_and_displaced_as_the_scene_says(tape: Tape) -> None:
    poses = draw_poses(tape, 400, 5)
    rng = np.random.default_rng(1)
    whole = touched_parts(tape, poses, SENSOR, Scene(), parts_of(tape), rng)
    fewer = touched_parts(tape, poses, SENSOR, Scene(missing=0.25), parts_of(tape), rng)
    assert len(fewer.part) / len(whole.part) == pytest.approx(0.75, abs=0.02)
    moved = touched_parts(tape, poses, SENSOR, Scene(placement_mm=0.05), parts_of(tape), rng)
    places = {(pose, part): at for pose, part, at in zip(whole.pose, whole.part, whole.at_mm, strict=True)}
    both = zip(moved.pose, moved.part, moved.at_mm, strict=True)
    off = np.array([at - places[pose, part] for pose, part, at in both if (pose, part) in places])
    assert off.std(axis=0) == pytest.approx([0.05, 0.05], rel=0.05)


def seen(frame: Frame, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """What an invented detector finds: half the parts at the rim, all of them 1 px out of place, and two dots in a corner."""
    felt = (frame.dots_imprint >= LEAST_IMPRINT) & ((frame.dots_imprint > 0.999) | (rng.random(len(frame.dots_px)) < 0.5))
    false = np.array([(5.0, 6.0), (310.0, 230.0)])
    weights = 0.5 + 0.5 * frame.dots_imprint[felt]
    return np.concatenate([frame.dots_px[felt] + (1.0, 0.0), false]), np.concatenate([weights, [0.31, 0.32]])


@pytest.fixture(scope="module")
def records(tape: Tape) -> DotRecords:
    rng = np.random.default_rng(2)
    return record_dots(tape, ((frame, *seen(frame, rng)) for frame in iterate_frames(tape, 60, 8)), Scene())


def test_dots_are_drawn_as_they_were_recorded(tape: Tape, records: DotRecords) -> None:
    poses = draw_poses(tape, 500, 9)
    dots = draw_dots(tape, poses, records, np.random.default_rng(3))
    touched = touched_parts(tape, poses, SENSOR, Scene(), parts_of(tape), np.random.default_rng(0))
    rim = touched.imprint < 0.999
    real = dots.part >= 0
    assert len(dots) == 500
    assert dots.first[-1] == len(dots.weights)
    assert real.sum() == pytest.approx((~rim).sum() + rim.sum() / 2, rel=0.01)
    assert np.diff(dots.first).sum() - real.sum() == 1000
    assert sorted(set(dots.weights[~real])) == [0.31, 0.32]
    one = dots[7]
    assert (one.xy_px == dots.xy_px[dots.first[7] : dots.first[8]]).all()
    whole = one.weights > 0.9999
    assert one.xy_px[whole] - one.true_px[whole] == pytest.approx(np.tile([1.0, 0.0], (whole.sum(), 1)), abs=1e-9)
    expected = {(pose, part): share for pose, part, share in zip(touched.pose, touched.part, touched.imprint, strict=True)}
    share = np.array([expected[7, part] for part in one.part[one.part >= 0]])
    assert one.weights[one.part >= 0] == pytest.approx(0.5 + 0.5 * share, abs=0.06)


def test_errors_at_the_rim_keep_their_direction_to_the_outline(tape: Tape) -> None:
    """Recorded inwards, they are drawn inwards wherever the rim is."""
    frames = list(iterate_frames(tape, 60, 8))

    def pulled(frame: Frame) -> FloatArray:
        to_centre = SENSOR.centre_px - frame.dots_px
        return np.asarray(frame.dots_px + 2.0 * to_centre / np.hypot(*to_centre.T)[:, None])

    recorded = record_dots(tape, ((f, pulled(f), np.ones(len(f.dots_px))) for f in frames), Scene())
    dots = draw_dots(tape, draw_poses(tape, 50, 1), recorded, np.random.default_rng(1))
    off, to_centre = dots.xy_px - dots.true_px, SENSOR.centre_px - dots.true_px
    far = np.hypot(*(to_centre / (88.0, 72.0)).T) > 1.0
    assert far.sum() > 100
    assert ((off * to_centre).sum(axis=1) / np.hypot(*to_centre.T) / np.hypot(*off.T))[far].min() > 0.9


def test_false_dots_keep_away_from_dots_and_stay_by_the_outline(tape: Tape) -> None:
    """Beside the tape they are drawn where they were recorded: 4 mm beyond the left edge of the board, or the right one."""
    scene = Scene(contact_mm=(14.0, 12.0))

    def beyond(frame: Frame) -> FloatArray:
        x0, y0 = tape.board.texture_origin_mm
        centre = np.array([frame.position_mm[0] + x0, y0 - frame.position_mm[1]])
        out = np.array([-1.0, 0.0]) if centre[0] < tape.board.size_mm[0] / 2 else np.array([1.0, 0.0])
        at = np.array([-4.0 if out[0] < 0 else tape.board.size_mm[0] + 4.0, centre[1]]) - centre
        c, s = np.cos(np.radians(frame.theta_deg)), np.sin(np.radians(frame.theta_deg))
        x, y = at * (1.0, -1.0)
        return np.array([[c * x - s * y, s * x + c * y]]) * 16 + SENSOR.centre_px

    x0, y0 = tape.board.texture_origin_mm
    rng = np.random.default_rng(4)
    recordings, n = 2 * some(300), 2 * some(300) + 300
    x = np.where(rng.random(n) < 0.5, rng.uniform(0.0, 2.0, n), tape.board.size_mm[0] - rng.uniform(0.0, 2.0, n)) - x0
    poses = np.column_stack([x, y0 - rng.uniform(20.0, 30.0, n), rng.uniform(-180.0, 180.0, n)])
    frames = iterate_frames(tape, recordings, 1, scene=replace(scene, noise=0.0), poses=poses[:recordings])
    seen_there = ((f, np.concatenate([f.dots_px, beyond(f)]), np.append(f.dots_imprint, 0.123)) for f in frames)
    recorded = record_dots(tape, seen_there, scene)
    dots = draw_dots(tape, poses[recordings:], recorded, np.random.default_rng(5))
    for k in range(300):
        one, angle = dots[k], np.radians(poses[recordings + k, 2])
        false = one.xy_px[one.part < 0]
        assert len(false) <= 1
        for u, v in (false - SENSOR.centre_px) / 16:
            at_x = poses[recordings + k, 0] + x0 + np.cos(angle) * u + np.sin(angle) * v
            assert min(abs(at_x + 4.0), abs(at_x - tape.board.size_mm[0] - 4.0)) < 1.0
    assert (dots.part < 0).sum() > 270

    every = np.stack(np.meshgrid(np.arange(60.0, 260.0, 12.0), np.arange(60.0, 180.0, 12.0)), axis=-1).reshape(-1, 2)
    crowded = replace(recorded, outline=recorded.outline[:1], false_first=np.array([0, len(every)]), false_px=every)
    crowded = replace(crowded, false_weights=np.ones(len(every)), false_room_px=np.full(len(every), 9.0))
    dots = draw_dots(tape, draw_poses(tape, 5, 1), crowded, np.random.default_rng(5))
    one = dots[2]
    false, real = one.xy_px[one.part < 0], one.xy_px[one.part >= 0]
    apart = np.hypot(*(false[:, None] - real[None]).transpose(2, 0, 1))
    assert len(false) == len(every)
    assert apart.min() > 7.0


def test_no_parts_and_no_false_dots_are_possible(tape: Tape, records: DotRecords) -> None:
    quiet = replace(records, false_first=np.zeros_like(records.false_first), false_px=np.empty((0, 2)))
    quiet = replace(quiet, false_weights=np.empty(0), false_room_px=np.empty(0))
    far = np.array([(5000.0, -300.0, 10.0), (20.0, 20.0, 10.0)])
    dots = draw_dots(tape, far, quiet, np.random.default_rng(1))
    assert np.diff(dots.first).tolist()[0] == 0
    assert len(dots[1].weights) > 20
    nothing = draw_dots(
        tape, far[:1], records, np.random.default_rng(1), parts=Parts(xy_mm=np.zeros((1, 2)), rotation_deg=np.zeros(1))
    )
    assert (nothing[0].part == -1).all()
    with pytest.raises(SpecError, match="no part that is wholly imprinted"):
        record_dots(tape, [], Scene())
