"""Errors of located contacts before and after a calibration from presses, beside those with the sensor's true parameters.

    python -m tests.bench.calibration [--sets N] [--frames N] [--presses N] [--only ROW] [--page docs/calibrate.md [--mark MARK]]

Each row is a sensor that is not as its profile says. A set is some presses at random places and turns on a known tape, with the
contact anywhere in view, and further frames, which are located by three profiles: the one to start from, the calibrated one, and
the truth with no doubt about it. "off" is the error of the calibrated camera at the image's corners, "said" the standard
deviation that it gives for the worst place in view; NEES/3 is 1 where covariances are true.

With several numbers of presses the table has one row for each. "Least" is then the bound that dots set (Cramer and Rao): each
dot of a press errs as found, camera and poses are unknown; a further contact has its own dots and what the presses say of the
camera, together. Nothing is estimated in it: errors are drawn from these covariances. "Said" is what `calibrate` says of itself.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab import Localizer, SpecError, Tape
from tactape_fab.sense import Parts, Scene, SensorProfile, calibrate_sensor, load_sensor, simulate
from tactape_fab.sense.calibrate import camera
from tactape_fab.sense.calibrate.adjust import CAMERA_SIGMAS, expected
from tactape_fab.sense.calibrate.errors import whitening
from tactape_fab.sense.calibrate.result import Calibration
from tactape_fab.sense.decode.grid.beliefs import PULL_SIGMA
from tactape_fab.sense.geometry import USUAL_BLUR_MM, Geometry
from tactape_fab.texture.frames import FloatArray
from tests.bench.marks import command, write_between
from tests.measured import measured as measured_places
from tests.tapes import tape_at

PROTOTYPE = {"aspect_error": 0.03, "shear_error": 0.01, "k1_error": 0.03}
SEED = 30
PROFILES = ("start", "calibrated", "true")
DRAWN = 40
"""Errors that are drawn for each contact of the bound."""

Errors = tuple[list[FloatArray], list[float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A sensor that is not as its profile says.

    Attributes
    ----------
    sensor : str
        Profile that the sensor really has, but for the scene's errors.
    scene : dict
        Options of `Scene`, errors of the camera among them.
    start_scale : float
        px/mm of the profile to start from, over the truth's.
    flipped : bool
        Whether the profile to start from has the other sign and mirror.
    measured : bool
        Whether parts are placed to 0.05 mm and their places were measured to 3 um, as `inspect` does.
    """

    name: str
    sensor: str = "gelsight-mini"
    scene: dict[str, float] = field(default_factory=dict)
    start_scale: float = 1.0
    flipped: bool = False
    measured: bool = False


ROWS = (
    Row(name="GelSight Mini, prototype's errors", scene=PROTOTYPE),
    Row(name="DIGIT, prototype's errors", sensor="digit", scene=PROTOTYPE),
    Row(name="generic, prototype's errors", sensor="generic", scene=PROTOTYPE),
    Row(name="prototype, px/mm 30 % off, sign and mirror wrong", scene=PROTOTYPE, start_scale=1.3, flipped=True),
    Row(name="prototype, px/mm 30 % off the other way", scene=PROTOTYPE, start_scale=0.7),
    Row(name="as its profile says"),
    Row(name="prototype, noise x2", scene={**PROTOTYPE, "noise": 2.0}),
    Row(name="prototype, placement 0.05 mm", scene={**PROTOTYPE, "placement_mm": 0.05}),
    Row(name="prototype, placement 0.05 mm measured to 3 µm", scene=PROTOTYPE, measured=True),
    Row(name="prototype, gel displaced 0.05 mm", scene={**PROTOTYPE, "gel_displacement_um": 50.0}),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Press:
    """A simulated frame and its true pose."""

    depth: npt.NDArray[np.float32]
    position_mm: FloatArray
    theta_rad: float


def tape_of(row: Row) -> tuple[Tape, Parts | None]:
    """The tape that is pressed, and where its parts really are."""
    tape = tape_at(7, (62, 32))
    return measured_places(tape, 0.05, seed=SEED) if row.measured else (tape, None)


def presses_of(row: Row, count: int, seed: int) -> Iterator[Press]:
    """Contacts anywhere: place and turn on the tape, and the contact's centre in view, are uniform."""
    (tape, parts), sensor = tape_of(row), load_sensor(row.sensor)
    rng = np.random.default_rng([SEED, seed])
    reach = 0.5 * sensor.centre_px / sensor.px_per_mm
    size = np.minimum((11.0, 9.0), 2.2 * sensor.centre_px / sensor.px_per_mm * 0.6)
    for k in range(count):
        offset = rng.uniform(-reach, reach).tolist()
        scene = Scene(contact_offset_mm=tuple(offset), contact_mm=tuple(size.tolist())).changed(row.scene)
        position, theta = rng.uniform((15.0, 12.0), (76.0, 35.0)), float(rng.uniform(-180.0, 180.0))
        depth = simulate(tape, position.tolist(), theta, sensor=sensor, scene=scene, seed=1000 * seed + k, parts=parts)
        yield Press(depth=depth, position_mm=position, theta_rad=float(np.radians(theta)))


def start_of(row: Row) -> SensorProfile:
    """The profile that a calibration starts from."""
    sensor = load_sensor(row.sensor)
    scale = (sensor.px_per_mm[0] * row.start_scale, sensor.px_per_mm[1] * row.start_scale)
    sign = -sensor.sign if row.flipped else sensor.sign
    return replace(sensor, px_per_mm=scale, sign=sign, mirror=sensor.mirror != row.flipped)


def truth_of(row: Row) -> SensorProfile:
    """The sensor as it is, with no doubt about its camera; its blur is known, so its answers rest on the pixels, too."""
    sensor = load_sensor(row.sensor)
    scale = 1.0 + row.scene.get("scale_error", 0.0)
    geometry = Geometry(
        aspect=row.scene.get("aspect_error", 0.0),
        shear=row.scene.get("shear_error", 0.0),
        k1=row.scene.get("k1_error", 0.0),
        sigma_px_per_mm=1e-6,
        sigma_aspect=1e-6,
        sigma_shear=1e-6,
        sigma_k1=1e-6,
    )
    gel = replace(sensor.gel, displacement_um=row.scene.get("gel_displacement_um", 0.0), blur_mm=USUAL_BLUR_MM)
    return replace(
        sensor,
        px_per_mm=(sensor.px_per_mm[0] * scale, sensor.px_per_mm[1] * scale),
        geometry=geometry,
        gel=gel,
        scale_tolerance=0.03,
    )


def corner_off_um(found: SensorProfile, true: SensorProfile) -> float:
    """Error at the image's corners, root mean square along an axis; a turn of the whole image is the pose's."""
    ends = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]) * (true.width_px - 1, true.height_px - 1)
    seen, right = (s.camera.from_px(ends) - s.camera.from_px(s.centre_px) for s in (found, true))
    return float(1000.0 * np.sqrt(((seen - right) ** 2).mean()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """Errors of frames that a profile locates."""

    frames: int
    located: int
    p50_um: float
    p95_um: float
    nees: float


def figures_of(errors: list[FloatArray], squares: list[float], frames: int) -> Figures:
    off = 1000.0 * np.hypot(*np.array(errors).T[:2]) if errors else np.full(1, np.nan)
    p50, p95 = np.percentile(off, [50.0, 95.0]).tolist()
    return Figures(frames=frames, located=len(errors), p50_um=p50, p95_um=p95, nees=float(np.mean(squares or [np.nan])) / 3.0)


def located_by(sensor: SensorProfile, tape: Tape, tests: list[Press]) -> tuple[list[FloatArray], list[float]]:
    """Errors (x mm, y mm, theta rad) of frames located by a profile, and their squares over the covariance."""
    localizer = Localizer([tape], sensor)
    errors: list[FloatArray] = []
    squares: list[float] = []
    for test in tests:
        fix = localizer.locate(test.depth)
        if fix.located and fix.position_mm is not None and fix.theta_deg is not None and fix.covariance is not None:
            turn = float(np.remainder(np.radians(fix.theta_deg) - test.theta_rad + np.pi, 2 * np.pi) - np.pi)
            error = np.array([*(np.array(fix.position_mm) - test.position_mm), turn])
            errors.append(error)
            squares.append(float(error @ np.linalg.solve(fix.covariance, error)))
    return errors, squares


def measured(
    row: Row, sets: int, frames: int, counts: Sequence[int]
) -> tuple[dict[int, dict[str, Figures]], dict[int, list[Calibration]]]:
    """Figures by number of presses and profile, and the calibrations; presses and frames are the same for each number."""
    gathered: dict[int, dict[str, Errors]] = {count: {name: ([], []) for name in PROFILES} for count in counts}
    made: dict[int, list[Calibration]] = {count: [] for count in counts}
    tape, most = tape_of(row)[0], max(counts)
    for k in range(sets):
        drawn = list(presses_of(row, most + frames, k))
        known = {
            name: located_by(sensor, tape, drawn[most:]) for name, sensor in (("start", start_of(row)), ("true", truth_of(row)))
        }
        for count in counts:
            try:
                found = calibrate_sensor([p.depth for p in drawn[:count]], [tape], start_of(row))
            except SpecError as error:  # random contacts may leave out a corner
                print(f"{row.name}, set {k} refused: {error}", file=sys.stderr)
                continue
            made[count].append(found)
            for name, (errors, squares) in (*known.items(), ("calibrated", located_by(found.sensor, tape, drawn[most:]))):
                gathered[count][name][0].extend(errors)
                gathered[count][name][1].extend(squares)
    return (
        {c: {name: figures_of(*both, len(made[c]) * frames) for name, both in of.items()} for c, of in gathered.items()},
        made,
    )


def least_of(made: Sequence[Calibration]) -> tuple[float, float]:
    """p50 and p95 of positions over those by the true camera: the least that the dots of the presses allow.

    Contacts are the presses of the other calibrations.
    """
    told, contacts, with_camera, alone = [], [], [], []
    for found in made:
        bundle = found.bundle
        seen, here = camera.seen_by(bundle.sensor, bundle.values), []
        for press, pose in zip(found.presses, bundle.poses, strict=True):
            _, shared, own = expected(press, seen, bundle.push_mm, pose)
            both = np.concatenate([own, shared[:, :, : camera.COUNT]], axis=2)  # the pose and the rim's pull, then the camera
            white = (whitening(press, bundle.errors) @ both.transpose(1, 0, 2)).reshape(-1, both.shape[2])
            here.append(white.T @ white + np.diag([0.0, 0.0, 0.0, 1.0 / PULL_SIGMA**2, *np.zeros(camera.COUNT)]))
        prior = CAMERA_SIGMAS * np.array([1.0, 1.0, 1.0, 1.0, found.sensor.width_px, found.sensor.width_px])
        told.append(sum((n[4:, 4:] - n[4:, :4] @ np.linalg.solve(n[:4, :4], n[:4, 4:]) for n in here), np.diag(prior**-2.0)))
        contacts.append(here)
    for k, known in enumerate(told):
        for normal in (one for j, here in enumerate(contacts) if j != k for one in here):
            alone.append(np.linalg.inv(normal[:4, :4])[:2, :2])
            with_camera.append(np.linalg.inv(normal + np.pad(known, ((4, 0), (4, 0))))[:2, :2])
    drawn = np.random.default_rng(SEED).standard_normal((len(alone), 2, DRAWN))
    off = [np.hypot(*np.moveaxis(np.linalg.cholesky(np.array(c)) @ drawn, 1, 0)) for c in (with_camera, alone)]
    p50, p95 = (np.percentile(off[0], [50.0, 95.0]) / np.percentile(off[1], [50.0, 95.0])).tolist()
    return p50, p95


HEADER = """\
| sensor | profile | sets | located | p50, µm | p95, µm | over the truth's | NEES/3 | corner: off, said, µm |
|---|---|---|---|---|---|---|---|---|
"""
BY_PRESSES = """\
| sensor | presses | sets | located | p50, µm | p95, µm | over the truth's | least | said | NEES/3 |
|---|---|---|---|---|---|---|---|---|---|
"""


def figures_text(f: Figures, true: Figures) -> str:
    """Errors, and their ratios to those by the true parameters."""
    ratio = f"{f.p50_um / true.p50_um:.2f} / {f.p95_um / true.p95_um:.2f}" if f.located and true.located else "-"
    return f"{f.p50_um:.1f} | {f.p95_um:.1f} | {ratio}"


def lines_of(row: Row, sets: int, frames: int, counts: Sequence[int]) -> str:
    """The rows of the table for a sensor, one for each profile; of several numbers of presses one for each of them."""
    lines = ""
    by_count, all_made = measured(row, sets, frames, counts)
    for count, figures in by_count.items():
        made, calibrated, true = all_made[count], figures["calibrated"], figures["true"]
        if len(counts) > 1:
            said = float(np.mean([q.value for one in made for q in one.quantities if q.name == "over_perfect"] or [np.nan]))
            least = "{:.2f} / {:.2f}".format(*least_of(made)) if len(made) > 1 else "-"
            done = f"{count} | {len(made)} of {sets} | {calibrated.located} of {calibrated.frames}"
            end = f"{least} | {said:.2f} | {calibrated.nees:.2f}"
            lines += f"| {row.name} | {done} | {figures_text(calibrated, true)} | {end} |\n"
            continue
        corner = "-"
        if made:
            off = np.sqrt(np.mean([corner_off_um(one.sensor, truth_of(row)) ** 2 for one in made]))
            told = np.sqrt(np.mean([next(q.sigma or 0.0 for q in one.quantities if q.name == "corner") ** 2 for one in made]))
            corner = f"{off:.1f}, {1000.0 * told:.1f}"
        for name, f in figures.items():
            done = f"{len(made)} of {sets} | {f.located} of {f.frames}"
            end = f"{f.nees:.2f} | {corner if name == 'calibrated' else ''}"
            lines += f"| {row.name} | {name} | {done} | {figures_text(f, true)} | {end} |\n"
    return lines


def about(sets: int, frames: int, counts: Sequence[int]) -> str:
    """What the table is of."""
    aspect, shear, k1 = (f"{100 * PROTOTYPE[name]:g} %" for name in ("aspect_error", "shear_error", "k1_error"))
    return (
        f"{sets} sets for each sensor, of {' or '.join(map(str, counts))} presses and {frames} further contacts each. The "
        f"prototype's errors are aspect {aspect}, shear {shear}, lens {k1} at the corner "
        f"({command('tests.bench.calibration')}).\n\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.calibration", description=__doc__)
    parser.add_argument("--sets", type=int, default=8, metavar="N", help="calibrations of each row")
    parser.add_argument("--frames", type=int, default=50, metavar="N", help="frames located after each calibration")
    parser.add_argument("--presses", type=int, action="append", metavar="N", help="of a calibration, 10; may be given again")
    parser.add_argument("--only", action="append", metavar="ROW", help="rows whose name holds this; may be given again")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the table between marks of a page, docs/calibrate.md")
    chosen = parser.parse_args()
    counts = chosen.presses or [10]
    table = BY_PRESSES if len(counts) > 1 else HEADER
    print(table, end="")
    for row in ROWS:
        if chosen.only is None or any(part in row.name for part in chosen.only):
            lines = lines_of(row, chosen.sets, chosen.frames, counts)
            print(lines, end="", flush=True)
            table += lines
    if chosen.page is not None:
        mark = "presses" if len(counts) > 1 else "calibration"
        write_between(chosen.page, mark, about(chosen.sets, chosen.frames, counts) + table)


if __name__ == "__main__":
    main()
