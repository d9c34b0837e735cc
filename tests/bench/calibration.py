"""Errors of located contacts before and after a calibration from presses, beside those with the sensor's true parameters.

    python -m tests.bench.calibration [--sets N] [--frames N] [--presses N] [--only ROW] [--page docs/calibrate.md]

Each row is a sensor that is not as its profile says. A set is some presses at random places and turns on a known tape, with the
contact anywhere in view, and further frames, which are located by three profiles: the one to start from, the calibrated one, and
the truth with no doubt about it. "off" is the error of the calibrated camera at the image's corners, "said" the standard
deviation that it gives for the worst place in view; NEES/3 is 1 where covariances are true.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab import Localizer, SpecError, Tape
from tactape_fab.sense import Parts, Scene, SensorProfile, calibrate_sensor, load_sensor, simulate
from tactape_fab.sense.calibrate.result import Calibration
from tactape_fab.sense.geometry import Geometry
from tactape_fab.texture.frames import FloatArray
from tests.bench.marks import command, write_between
from tests.measured import measured as measured_places
from tests.tapes import tape_at

PROTOTYPE = {"aspect_error": 0.03, "shear_error": 0.01, "k1_error": 0.03}
SEED = 30


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
    gel = replace(sensor.gel, displacement_um=row.scene.get("gel_displacement_um", 0.0), blur_mm=Scene().elastomer_mm)
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


def measured(row: Row, sets: int, frames: int, presses: int) -> tuple[dict[str, Figures], list[Calibration]]:
    """Figures by profile, and the calibrations."""
    gathered: dict[str, tuple[list[FloatArray], list[float]]] = {name: ([], []) for name in ("start", "calibrated", "true")}
    made: list[Calibration] = []
    tape = tape_of(row)[0]
    for k in range(sets):
        drawn = list(presses_of(row, presses + frames, k))
        try:
            found = calibrate_sensor([p.depth for p in drawn[:presses]], [tape], start_of(row))
        except SpecError as error:  # random contacts may leave out a corner
            print(f"{row.name}, set {k} refused: {error}", file=sys.stderr)
            continue
        made.append(found)
        for name, sensor in (("start", start_of(row)), ("calibrated", found.sensor), ("true", truth_of(row))):
            errors, squares = located_by(sensor, tape, drawn[presses:])
            gathered[name][0].extend(errors)
            gathered[name][1].extend(squares)
    return {name: figures_of(*both, len(made) * frames) for name, both in gathered.items()}, made


HEADER = """\
| sensor | profile | sets | located | p50, µm | p95, µm | over the truth's | NEES/3 | corner: off, said, µm |
|---|---|---|---|---|---|---|---|---|
"""


def lines_of(row: Row, sets: int, frames: int, presses: int) -> str:
    """The rows of the table for a sensor, one for each profile."""
    figures, made = measured(row, sets, frames, presses)
    true, lines, corner = figures["true"], "", "-"
    if made:
        off = np.sqrt(np.mean([corner_off_um(one.sensor, truth_of(row)) ** 2 for one in made]))
        said = np.sqrt(np.mean([next(q.sigma or 0.0 for q in one.quantities if q.name == "corner") ** 2 for one in made]))
        corner = f"{off:.1f}, {1000.0 * said:.1f}"
    for name, f in figures.items():
        ratio = f"{f.p50_um / true.p50_um:.2f} / {f.p95_um / true.p95_um:.2f}" if f.located and true.located else "-"
        errors = f"{f.p50_um:.1f} | {f.p95_um:.1f} | {ratio} | {f.nees:.2f}"
        counts = f"{len(made)} of {sets} | {f.located} of {f.frames}"
        lines += f"| {row.name} | {name} | {counts} | {errors} | {corner if name == 'calibrated' else ''} |\n"
    return lines


def about(sets: int, frames: int, presses: int) -> str:
    """What the table is of."""
    aspect, shear, k1 = (f"{100 * PROTOTYPE[name]:g} %" for name in ("aspect_error", "shear_error", "k1_error"))
    return (
        f"{sets} sets for each sensor, of {presses} presses and {frames} further contacts each. The prototype's errors are "
        f"aspect {aspect}, shear {shear}, lens {k1} at the corner ({command('tests.bench.calibration')}).\n\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.calibration", description=__doc__)
    parser.add_argument("--sets", type=int, default=8, metavar="N", help="calibrations of each row")
    parser.add_argument("--frames", type=int, default=50, metavar="N", help="frames located after each calibration")
    parser.add_argument("--presses", type=int, default=10, metavar="N", help="presses of a calibration")
    parser.add_argument("--only", action="append", metavar="ROW", help="rows whose name holds this; may be given again")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the table between marks of a page, docs/calibrate.md")
    chosen = parser.parse_args()
    table = HEADER
    print(HEADER, end="")
    for row in ROWS:
        if chosen.only is None or any(part in row.name for part in chosen.only):
            lines = lines_of(row, chosen.sets, chosen.frames, chosen.presses)
            print(lines, end="", flush=True)
            table += lines
    if chosen.page is not None:
        write_between(chosen.page, "calibration", about(chosen.sets, chosen.frames, chosen.presses) + table)


if __name__ == "__main__":
    main()
