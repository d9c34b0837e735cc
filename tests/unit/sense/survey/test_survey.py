"""Places of parts from use: better than the design, said as well as they are known, and held by a robot or an inspection."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tactape_fab import AsBuilt, Localizer, SpecError, Tape, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Frame, Scene, iterate_frames, load_sensor
from tactape_fab.sense.survey import survey
from tactape_fab.sense.survey.adjust import Prior, adjust
from tactape_fab.sense.survey.contacts import Contact, contact_of, ground_of
from tactape_fab.sense.survey.poses import RobotPose
from tactape_fab.sense.survey.survey import Survey, _refuse_number, _robot, _sigma_before, _surveyed, survey_files
from tactape_fab.texture.frames import FloatArray
from tests.measured import measured
from tests.thorough import slow

PLACEMENT_MM = 0.05
SCENE = Scene(contact_mm=(10.0, 10.0))


@cache
def small_tape() -> Tape:
    return examine(TapeSpec(sector=7, size_mm=(45.0, 25.0), models=False)).tape


@cache
def pressed(count: int, missing: float = 0.0) -> tuple[Tape, tuple[Frame, ...], tuple[Frame, ...]]:
    """The tape with its true places, frames to learn from, and others to look at."""
    truth, parts = measured(small_tape(), PLACEMENT_MM, missing=missing, error_mm=1e-9, seed=3)
    learn, look = (tuple(iterate_frames(truth, n, seed, scene=SCENE, parts=parts)) for n, seed in ((count, 1), (12, 2)))
    return truth, learn, look


@dataclass
class Frames:
    """As `sense.files.depth_maps.FrameFile`, in memory."""

    depths: list[Any]
    px_per_mm: tuple[float, float] | None = None

    @property
    def count(self) -> int:
        return len(self.depths)

    def frames(self) -> Iterator[Any]:
        return iter(self.depths)


def surveyed(tmp_path: Path, learn: tuple[Frame, ...], tape: Tape | None = None, robot: tuple[RobotPose, ...] = ()) -> Survey:
    manifest = tmp_path / "manifest.json"
    manifest.write_text("{}")
    files: Any = [Frames([frame.depth for frame in learn])]
    return _surveyed(tape or small_tape(), manifest, load_sensor("gelsight-mini"), files, robot, lambda *_: None)


def errors(found: Survey, truth: Tape) -> FloatArray:
    """Errors of the touched parts, mm."""
    got = replace(small_tape(), as_built=found.as_built).built_parts().shift_mm
    return (got - truth.built_parts().shift_mm)[found.adjusted.part]


def pose_rms(tape: Tape, look: tuple[Frame, ...]) -> tuple[float, float, float]:
    """Error of a localizer's positions, mm rms per axis, of its angles, degrees, and the mean square over the covariance."""
    localizer, off, turned, nees = Localizer(tape), [], [], []
    for frame in look:
        fix = localizer.locate(frame.depth)
        assert fix.located and fix.position_mm is not None and fix.covariance is not None
        e = np.array(fix.position_mm) - frame.position_mm
        assert fix.theta_deg is not None
        off.append(e)
        turned.append((fix.theta_deg - frame.theta_deg + 180.0) % 360.0 - 180.0)
        nees.append(e @ np.linalg.solve(fix.covariance[:2, :2], e) / 2)
    return float(np.sqrt(np.square(off).mean())), float(np.sqrt(np.square(turned).mean())), float(np.mean(nees))


def test_places_from_touch_are_better_than_the_design_and_said_as_well_as_they_are_known(tmp_path: Path) -> None:
    truth, learn, look = pressed(60)
    found = surveyed(tmp_path, learn)
    off, sigma = errors(found, truth), found.as_built.sigma_mm
    assert found.contacts >= 58
    assert np.sqrt((off**2).mean()) < 0.4 * PLACEMENT_MM
    assert 0.5 < (off**2 / sigma[:, None] ** 2).mean() < 2.0
    nominal_mm, nominal_deg, _ = pose_rms(small_tape(), look)
    rms_mm, rms_deg, nees = pose_rms(replace(small_tape(), as_built=found.as_built), look)
    assert rms_mm < 0.8 * nominal_mm  # a tape so small has a shift, a turn and a stretch of its own, which touch does not show
    assert rms_deg < 0.5 * nominal_deg
    assert nees < 2.0
    assert abs(found.adjusted.scatter_mm - PLACEMENT_MM) < 0.01  # type: ignore[operator]


def test_an_inspection_is_combined_by_its_covariance(tmp_path: Path) -> None:
    truth, learn, _ = pressed(60)
    inspected, _ = measured(small_tape(), PLACEMENT_MM, error_mm=0.008, seed=3)
    found = surveyed(tmp_path, learn, inspected)
    alone = np.sqrt((errors(surveyed(tmp_path, learn), truth) ** 2).mean())
    before = inspected.built_parts().shift_mm - truth.built_parts().shift_mm
    both = np.sqrt((errors(found, truth) ** 2).mean())
    assert both < 0.7 * np.sqrt((before**2).mean())
    assert both < 0.7 * alone
    assert [entry["kind"] for entry in found.as_built.source] == ["scan", "survey"]
    assert len(found.as_built.number) == small_tape().part_count


@slow
def test_a_robot_holds_what_touch_alone_does_not(tmp_path: Path) -> None:
    """A stretch of the whole tape: touch takes it for the sensor's scale, a robot's poses do not."""
    truth, parts = measured(small_tape(), 0.03, error_mm=1e-9, seed=3)
    x = small_tape().part_xy_mm()[:, 0]
    stretch = 0.004 * (x - x.mean())
    assert truth.as_built is not None
    drifted = replace(truth, as_built=replace(truth.as_built, dx_mm=truth.as_built.dx_mm + stretch))
    moved = replace(parts, xy_mm=parts.xy_mm + np.stack([stretch, np.zeros_like(stretch)], axis=1))
    learn = tuple(iterate_frames(truth, 60, 1, scene=SCENE, parts=moved))
    rng, turn = np.random.default_rng(1), 30.0
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    robot = []
    for k, frame in enumerate(learn):
        board = frame.position_mm * (1.0, -1.0)
        x_mm, y_mm = np.array([[c, -s], [s, c]]) @ board + [400.0, -20.0] + rng.normal(0.0, 0.01, 2)
        robot.append(RobotPose(frame=k, x_mm=x_mm, y_mm=y_mm, theta_deg=frame.theta_deg + turn, sigma_mm=0.01, sigma_deg=0.05))
    drift = {}
    others = tuple(replace(pose, frame=(pose.frame + 1) % len(learn)) for pose in robot)
    with pytest.raises(SpecError, match=r"poses of the robot do not fit the contacts: half of them are .* counted from 0"):
        surveyed(tmp_path, learn, robot=others)
    # the flange straight above, 60 mm from the sensor's axis: nothing is wrong with its tilt
    reach = [60.0 * np.exp(1j * np.radians(pose.theta_deg)) for pose in robot]
    flange = tuple(replace(p, x_mm=p.x_mm + r.real, y_mm=p.y_mm + r.imag) for p, r in zip(robot, reach, strict=True))
    with pytest.raises(SpecError, match=r"of the sensor itself, or of the flange with --hand-eye"):
        surveyed(tmp_path, learn, robot=flange)
    some = tuple(replace(pose, x_mm=pose.x_mm + 40.0 * (pose.frame % 10 == 0)) for pose in robot)
    assert errors(surveyed(tmp_path, learn, robot=some), drifted)[:, 0].std() < 0.02  # those that are lost weigh little
    for name, given in (("touch", ()), ("robot", tuple(robot))):
        off = errors(surveyed(tmp_path, learn, robot=given), drifted)[:, 0]
        drift[name] = off.std()
    assert drift["robot"] < 0.6 * drift["touch"]


def test_a_robot_shows_a_tape_that_was_stuck_on_in_a_bow(tmp_path: Path) -> None:
    """Parts that scatter each by itself would hold a bow of all of them against any robot, the more of them the better."""
    long = examine(TapeSpec(sector=7, size_mm=(100.0, 30.0), models=False)).tape
    truth, parts = measured(long, PLACEMENT_MM, error_mm=1e-9, seed=3)
    x = long.part_xy_mm()[:, 0]
    bow = 0.3 * (2.0 * (x - x.mean()) / np.ptp(x)) ** 2
    moved = replace(parts, xy_mm=parts.xy_mm + np.stack([np.zeros_like(bow), bow], axis=1))
    learn = tuple(iterate_frames(truth, 60, 1, scene=SCENE, parts=moved))
    rng, robot = np.random.default_rng(1), []
    for k, frame in enumerate(learn):
        x_mm, y_mm = frame.position_mm * (1.0, -1.0) + rng.normal(0.0, 0.02, 2)
        theta_deg = frame.theta_deg + rng.normal(0.0, 0.05)
        robot.append(RobotPose(frame=k, x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg, sigma_mm=0.02, sigma_deg=0.05))
    found = surveyed(tmp_path, learn, long, tuple(robot))
    got, true = (replace(long, as_built=of).built_parts().shift_mm for of in (found.as_built, truth.as_built))
    off = (got - true - np.stack([np.zeros_like(bow), bow], axis=1))[found.adjusted.part]
    off = off - off.mean(axis=0)  # where all parts lie together is the unknown frame of the robot
    sigma_mm = found.as_built.sigma_mm[found.as_built.present, None]
    assert np.sqrt((off[:, 1] ** 2).mean()) < 0.02
    assert (off**2 / sigma_mm**2).mean() < 1.5
    # no film is longer by a sixtieth
    others = tuple(replace(pose, x_mm=pose.x_mm * 1.016, y_mm=pose.y_mm * 1.016) for pose in robot)
    with pytest.raises(
        SpecError, match=r"by the poses of the robot the tape is stretched or bent by 0\.\d+ mm \(rms\), more than 0\.3"
    ):
        surveyed(tmp_path, learn, long, others)


def test_parts_that_no_contact_shows_are_missing_and_no_other(tmp_path: Path) -> None:
    truth, learn, _ = pressed(80, missing=0.03)
    found = surveyed(tmp_path, learn).as_built
    assert truth.as_built is not None
    gone = set(truth.as_built.number[~truth.as_built.present].tolist())
    said = set(found.number[~found.present].tolist())
    assert said <= gone
    assert len(said) >= 4
    for of_a_part in (found.dx_mm, found.dy_mm, found.sigma_mm, found.rotation_deg):
        assert not of_a_part[~found.present].any()


def test_a_dot_that_is_far_off_does_not_count() -> None:
    _, learn, _ = pressed(60)
    ground, sensor, localizer = ground_of(small_tape()), load_sensor("gelsight-mini"), Localizer(small_tape())
    contacts = []
    for k, frame in enumerate(learn):
        fix = localizer.locate(frame.depth)
        contact = contact_of(k, frame.depth, fix, ground, sensor, ground.nominal_mm) if fix.located else None
        if contact is not None:
            contacts.append(contact)
    prior = Prior(shift_mm=np.zeros_like(ground.nominal_mm), sigma_mm=np.full(len(ground.nominal_mm), np.nan))
    clean = adjust(contacts, ground.nominal_mm, sensor, prior)
    well = int(clean.part[clean.touched.argmax()])
    spoilt: list[Contact] = []
    for contact in contacts:
        seen = contact.seen_px.copy()
        if well in contact.part and not any(well in c.part for c in spoilt):
            seen[contact.part == well] += 12.0
        spoilt.append(replace(contact, seen_px=seen))
    found = adjust(spoilt, ground.nominal_mm, sensor, prior)
    assert found.left > 0.0
    at = int(np.flatnonzero(found.part == well)[0])
    assert np.abs(found.shift_mm[at] - clean.shift_mm[at]).max() < 0.01


def test_frames_that_are_there_twice_count_once(tmp_path: Path) -> None:
    _, learn, _ = pressed(40)
    once, twice = surveyed(tmp_path, learn), surveyed(tmp_path, (*learn, *learn))
    assert (twice.frames, twice.contacts) == (80, 40)
    assert np.array_equal(twice.as_built.sigma_mm, once.as_built.sigma_mm)


def test_frames_that_are_there_in_two_types_count_once(tmp_path: Path) -> None:
    """As of a file that was loaded, and saved again as float64."""
    _, learn, _ = pressed(40)
    wide = tuple(replace(frame, depth=frame.depth.astype(np.float64)) for frame in learn)
    assert surveyed(tmp_path, (*learn, *wide)).contacts == 40


@slow
def test_frames_that_are_located_at_last_do_not_count_the_others_twice(tmp_path: Path) -> None:
    """The places found by the first adjustment are where the second starts, not what is known before it."""
    truth, parts = measured(small_tape(), 0.1, error_mm=1e-9, seed=3)
    large, small = (
        tuple(iterate_frames(truth, n, seed, scene=Scene(contact_mm=(mm, mm)), parts=parts))
        for n, seed, mm in ((40, 1, 10.0), (120, 7, 7.0))
    )
    found = surveyed(tmp_path, (*large, *small))
    localizer = Localizer(small_tape())
    assert found.contacts > sum(localizer.locate(frame.depth).located for frame in (*large, *small))
    off = errors(found, truth)
    assert np.sqrt((off**2).mean()) < 0.022  # 0.028 where they count twice
    assert ((off / found.as_built.sigma_mm[:, None]) ** 2).mean() < 1.4


def test_parts_that_a_file_does_not_list_are_not_known_before(tmp_path: Path) -> None:
    """A file that only says which parts are missing says nothing of where the others are."""
    _, learn, _ = pressed(60)
    none = np.zeros(2)
    said = AsBuilt(
        tape=small_tape().name,
        manifest_sha256="0" * 64,
        number=np.array([1, 2]),
        dx_mm=none,
        dy_mm=none,
        rotation_deg=none,
        present=none.astype(bool),
        sigma_mm=none,
        source=({"kind": "aoi"},),
    )
    found, alone = surveyed(tmp_path, learn, replace(small_tape(), as_built=said)), surveyed(tmp_path, learn)
    scatter = found.adjusted.scatter_mm
    assert scatter is not None and scatter == pytest.approx(alone.adjusted.scatter_mm, rel=0.1)
    assert np.median(found.as_built.sigma_mm) == pytest.approx(np.median(alone.as_built.sigma_mm), rel=0.1)


def test_a_hand_eye_without_poses_is_named_as_it_was_given(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=r"hand_eye = arm\.json is for poses of a robot, and none are given; give --poses"):
        survey_files([], tmp_path, hand_eye="arm.json")


def test_too_few_contacts_are_refused(tmp_path: Path) -> None:
    _, learn, _ = pressed(60)
    with pytest.raises(SpecError, match="only 5 of 5 frames are located"):
        surveyed(tmp_path, learn[:5])


def test_progress_counts_frames_of_all_files_up_to_the_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(survey, "_BLOCK", 2)
    depths, said = [frame.depth for frame in pressed(60)[1][:5]], list[tuple[object, ...]]()
    files: Any = [Frames(depths[:3]), Frames(depths[3:])]
    (manifest := tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(SpecError, match="only 5 of 5 frames"):
        _surveyed(small_tape(), manifest, load_sensor("gelsight-mini"), files, (), lambda *words: said.append(words))
    assert said == [("frames", 2, 5), ("frames", 4, 5), ("frames", 5, 5)]


def test_no_file_of_measured_places_is_read_twice(tmp_path: Path) -> None:
    """A survey that starts from an earlier one lists both, oldest first, and is as sure as both together."""
    _, learn, _ = pressed(60)
    first = surveyed(tmp_path, learn[:30]).as_built
    second = surveyed(tmp_path, learn[30:], replace(small_tape(), as_built=first)).as_built
    assert [entry["kind"] for entry in second.source] == ["survey", "survey"]
    common = np.intersect1d(first.number, second.number)

    def sigma(built: AsBuilt) -> FloatArray:
        return built.sigma_mm[np.isin(built.number, common)]

    assert np.median(sigma(second)) < np.median(sigma(first))


def test_the_frames_of_an_earlier_survey_are_refused_after_it(tmp_path: Path) -> None:
    """In whatever order: their errors would count twice."""
    _, learn, _ = pressed(40)
    first = surveyed(tmp_path, learn).as_built
    with pytest.raises(SpecError, match="surveyed of these very frames, which would count twice; give new frames"):
        surveyed(tmp_path, learn[::-1], replace(small_tape(), as_built=first))


def test_places_from_before_are_known_without_what_all_err_by_together() -> None:
    """No part is its drift alone: half of what was said is its own at least; and none is exact, whatever a file says."""
    sigma_mm = np.array([0.05, 0.0101, 0.004, 0.0, 0.0])
    none = np.zeros(4)
    before = AsBuilt(
        tape="t",
        manifest_sha256="0" * 64,
        number=np.array([1, 2, 3, 5]),
        dx_mm=none,
        dy_mm=none,
        rotation_deg=none,
        present=none.astype(bool),
        sigma_mm=sigma_mm[[0, 1, 2, 4]],
        source=({"kind": "survey", "drift_mm": 0.01},),
    )
    found = _sigma_before(sigma_mm, before)
    assert found[0] == pytest.approx(np.sqrt(0.05**2 - 0.01**2))
    assert found[1:3] == pytest.approx([0.0101 / 2, 0.004 / 2])
    assert np.isnan(found).tolist() == [False, False, False, True, False] and 0.0 < found[4] <= 0.0005


@slow
def test_a_survey_that_is_continued_is_as_sure_as_it_is_right(tmp_path: Path) -> None:
    """What neighbours are wrong by together is no error of each: no number of parts makes it smaller, and no contact shows it."""
    truth, learn, _ = pressed(80)
    tape, sures, nominal_mm = small_tape(), [], small_tape().part_xy_mm()
    for k in range(0, 80, 20):
        found = surveyed(tmp_path, learn[k : k + 20], tape)
        tape, off_mm, part = replace(small_tape(), as_built=found.as_built), errors(found, truth), found.adjusted.part
        sigma_mm = tape.built_parts().sigma_mm[part]
        near = np.hypot(*(nominal_mm[part][:, None] - nominal_mm[part]).transpose(2, 0, 1)) < 4.0
        together_mm = np.stack([off_mm[of].mean(axis=0) for of in near])
        assert np.sqrt((together_mm**2).mean()) < 1.5 * found.as_built.drift_mm
        assert (off_mm**2 / sigma_mm[:, None] ** 2).mean() < 2.0
        sures.append(float(np.median(found.adjusted.sigma_mm)))
    assert sures == sorted(sures, reverse=True)


@cache
def of_copy(seed: int, first: int, count: int) -> tuple[Tape, tuple[Frame, ...]]:
    """A copy of the tape with its true places, and frames of it."""
    truth, parts = measured(small_tape(), PLACEMENT_MM, error_mm=1e-9, seed=seed)
    return truth, tuple(iterate_frames(truth, count, first, scene=SCENE, parts=parts))


@pytest.mark.parametrize("others", [40, 8])
def test_frames_of_two_copies_are_refused(tmp_path: Path, others: int) -> None:
    """Parts of both would be set between where they are in either, far beyond what is said of them."""
    learn = (*of_copy(3, 1, 40)[1], *of_copy(4, 2, 40)[1][:others])
    named = ", ".join(str(k) for k in range(40, 48)) if others == 8 else "[0-9]"
    with pytest.raises(SpecError, match=rf"two copies of the tape: in {others} of {40 + others} frames \({named}"):
        surveyed(tmp_path, learn)


@slow
def test_measured_places_of_another_copy_are_no_start(tmp_path: Path) -> None:
    """Nothing but the dots can give way then: what came out was farther off than the design, and said to be known to 10 um."""
    first = surveyed(tmp_path, of_copy(3, 1, 40)[1])
    start = replace(small_tape(), as_built=first.as_built)
    with pytest.raises(SpecError, match=r"off the design \(median\), as where they are of another copy"):
        surveyed(tmp_path, of_copy(4, 2, 40)[1], start)
    truth, learn = of_copy(3, 7, 40)
    assert np.sqrt((errors(surveyed(tmp_path, learn, start), truth) ** 2).mean()) < 0.4 * PLACEMENT_MM


def test_figures_are_those_of_places_and_adjustment() -> None:
    built: Any = SimpleNamespace(tape="t", missing=2, sigma_mm=np.array([0.01, 0.02, 0.05]), drift_mm=0.003, scatter_mm=0.04)
    adjusted: Any = SimpleNamespace(
        part=np.arange(7), dot_mm=0.005, left=0.01, common=np.arange(6.0), common_sigma=np.full(6, 0.5)
    )
    figures = Survey(as_built=built, adjusted=adjusted, frames=50, contacts=40, parts=9).to_mapping()
    named = ("px_per_mm", "aspect", "shear", "k1", "push", "pull")
    assert figures.pop("nuisance") == {name: [float(k), 0.5] for k, name in enumerate(named)}
    assert figures == {
        **{"tape": "t", "frames": 50, "contacts": 40, "parts": 9, "touched": 7, "missing": 2, "sigma_mm": 0.02},
        **{"drift_mm": 0.003, "scatter_mm": 0.04, "dot_mm": 0.005, "far_off": 0.01},
    }


@pytest.mark.parametrize(
    ("contacts", "says"), [(9, "fewer than 10"), (10, ""), (3000, ""), (3001, "more than 3000; give the frames in parts")]
)
def test_contacts_are_10_to_3000(contacts: int, says: str) -> None:
    with pytest.raises(SpecError, match=says) if says else nullcontext():
        _refuse_number(contacts, 4000)


def test_files_of_different_scales_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for other, same in (((12.0, 12.0), False), (None, True)):
        scales = [load_sensor("gelsight-mini").px_per_mm, other]
        monkeypatch.setattr("tactape_fab.sense.survey.survey.open_frames", lambda *_, s=scales: [Frames([], px) for px in s])
        with pytest.raises(SpecError) as caught:
            survey_files(["a.npz", "b.npz"], tmp_path)
        assert ("sensors with different px/mm; survey them one by one" in str(caught.value)) != same


def test_files_are_surveyed_with_the_sensor_at_their_scale(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    manifest = tmp_path / "manifest.json"
    manifest.write_text(json.dumps({"format": "tactape-manifest/1", **small_tape().to_mapping()}))
    monkeypatch.setattr("tactape_fab.sense.survey.survey.open_frames", lambda *_: [Frames([], (12.0, 13.0))])
    monkeypatch.setattr("tactape_fab.sense.survey.survey._surveyed", lambda *given: given)
    tape, file, profile, files, robot, _, workers = cast(Any, survey_files(["a.npz"], tmp_path, workers=2))
    assert (tape.name, tape.as_built, file, robot, workers) == (small_tape().name, None, manifest, [], 2)
    assert profile.px_per_mm == (12.0, 13.0) and files == [Frames([], (12.0, 13.0))]


def test_measured_places_are_named_as_the_option_that_gave_them(tmp_path: Path) -> None:
    with pytest.raises(SpecError) as caught:
        survey_files(["a.npz"], tmp_path, inspected="as_built = 1.json")
    assert any(problem.message.startswith("inspected = as_built = 1.json ") for problem in caught.value.problems)


def test_a_hand_eye_is_that_of_the_tape(tmp_path: Path) -> None:
    still = np.eye(4).tolist()
    known = {"format": "tactape-hand-eye/1", "tape": small_tape().name, "sensor_to_flange": still, "tape_to_base": still}
    poses, hand_eye = tmp_path / "poses.csv", tmp_path / "hand-eye.json"
    poses.write_text("frame,x_mm,y_mm,z_mm,qw,qx,qy,qz\n2,10,20,0,0,1,0,0\n")
    hand_eye.write_text(json.dumps(known))
    (pose,) = _robot(poses, hand_eye, small_tape(), 3)
    assert (pose.frame, pose.x_mm, pose.y_mm) == (2, 10.0, 20.0)
    with pytest.raises(SpecError, match=rf"says where {small_tape().name} lies; give that of another"):
        _robot(poses, hand_eye, replace(small_tape(), name="another"), 3)
    with pytest.raises(SpecError, match="frame = 2 is not a whole number from 0 to 1"):
        _robot(poses, hand_eye, small_tape(), 2)
