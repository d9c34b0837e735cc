"""The decoder on tapes pressed into an elastic gel, beside the imprint model.

    python -m tests.bench.elastic [--frames N] [--part r0402 --w 2.2 --delta 0.3]

A row is one contact: located of N, wrong (off by more than 0.5 mm), root mean square of the position's errors per axis and of the
angle's, and the normalised squared error (NEES) over its three degrees of freedom, which is 1 where the covariance is true.
Frames have the slope noise of a real GelSight Mini; with `--noise smooth` the profile's older noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np

from tactape_fab import Localizer, Tape, TapeSpec
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import load_fab, load_part
from tactape_fab.sense import ElasticContact, Frame, Scene, iterate_frames

SLOPE_NOISE = 0.032
"""White noise of measured slopes, rms a pixel: 172 patches off contact of gelslam's calibration images, 15.77 px/mm."""
WRONG_MM = 0.5
FORCES_N = (0.5, 2.0, 10.0)
IMPRINTS: dict[str, dict[str, Any]] = {
    "imprint 11x9": {},
    "imprint 7x7": {"contact_mm": (7.0, 7.0)},
    "imprint cylinder 30": {"contact": "strip", "cylinder_radius_mm": 30.0},
    "imprint cylinder 15.7": {"contact": "strip", "cylinder_radius_mm": 15.7},
}
PRESSES: dict[str, dict[str, Any]] = {
    "flat": {},
    "tilt 2": {"tilt_deg": (2.0, 0.0)},
    "tilt 5": {"tilt_deg": (5.0, 0.0)},
    "cylinder 30": {"cylinder_radius_mm": 30.0},
    "cylinder 15.7": {"cylinder_radius_mm": 15.7},
    "cylinder 15.7, 4 mm off": {"cylinder_radius_mm": 15.7},
    "cylinder 260, turned 45": {"cylinder_radius_mm": 260.0},
    "flat, markers": {"markers": True},
}
PLACES: dict[str, dict[str, Any]] = {
    "cylinder 15.7, 4 mm off": {"contact_offset_mm": (0.0, 4.0)},
    "cylinder 260, turned 45": {"contact_turn_deg": 45.0},
}
"""How the contact lies under the image: the cylinder's axis off its middle along v, or turned from its rows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """One row."""

    frames: int
    located: int
    wrong: int
    rms_um: float
    rms_deg: float
    nees: float
    seconds: float


def rows(noise: dict[str, Any]) -> Iterator[tuple[str, Scene]]:
    """Names and scenes, the imprint model's first."""
    for name, options in IMPRINTS.items():
        yield name, Scene(**options, **noise)
    for name, options in PRESSES.items():
        for force_n in FORCES_N:
            elastic = ElasticContact(force_n=force_n, **options)
            yield f"{name}, {force_n:g} N", Scene(elastic=elastic, **PLACES.get(name, {}), **noise)


def measure(localizer: Localizer, tape: Tape, scene: Scene, count: int, seed: int) -> Measured:
    """Locate `count` frames of a scene; seconds are those of the processor for the simulation of a frame."""
    start, located, errors, squares = process_time(), 0, [], []
    frames: list[Frame] = list(iterate_frames(tape, count, seed, scene=scene))
    seconds = (process_time() - start) / count
    for frame in frames:
        fix = localizer.locate(frame.depth)
        if not fix.located or fix.position_mm is None or fix.theta_deg is None:
            continue
        located += 1
        turn = np.radians((fix.theta_deg - frame.theta_deg + 180.0) % 360.0 - 180.0)
        error = np.array([*(np.asarray(fix.position_mm) - frame.position_mm), turn])
        errors.append(error)
        squares.append(error @ np.linalg.solve(np.asarray(fix.covariance), error) / 3)
    off = np.array(errors).reshape(-1, 3)
    right = np.hypot(off[:, 0], off[:, 1]) <= WRONG_MM
    rms_mm, rms_rad = (
        float(np.sqrt(np.mean(part**2))) if right.any() else float("nan") for part in (off[right, :2], off[right, 2])
    )
    return Measured(
        frames=count,
        located=located,
        wrong=int((~right).sum()),
        rms_um=1000 * rms_mm,
        rms_deg=float(np.degrees(rms_rad)),
        nees=float(np.mean(squares)) if squares else float("nan"),
        seconds=seconds,
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.elastic", description=__doc__)
    parser.add_argument("--frames", type=int, default=40, metavar="N", help="frames a row")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    parser.add_argument("--noise", choices=("slope", "smooth"), default="slope")
    parser.add_argument("--part", default="r0201", metavar="NAME")
    parser.add_argument("--w", type=float, default=1.5, metavar="MM")
    parser.add_argument("--delta", type=float, default=0.25, metavar="MM")
    given = parser.parse_args()
    spec = TapeSpec(sector=7, pitch_mm=given.w, displacement_mm=given.delta)
    tape = plan(spec, load_fab("generic-fpc"), load_part(given.part))
    localizer = Localizer([tape], sensor="gelsight-mini")
    noise: dict[str, Any] = {"slope_noise": SLOPE_NOISE} if given.noise == "slope" else {"noise_model": "smooth"}
    print(f"{'contact':32} {'located':>9} {'wrong':>5} {'rms um':>7} {'rms deg':>8} {'NEES/3':>7} {'s/frame':>8}")
    for name, scene in rows(noise):
        found = measure(localizer, tape, scene, given.frames, given.seed)
        of = f"{found.located}/{found.frames}"
        figures = f"{found.rms_um:7.1f} {found.rms_deg:8.3f} {found.nees:7.2f} {found.seconds:8.2f}"
        print(f"{name:32} {of:>9} {found.wrong:5d} {figures}", flush=True)


if __name__ == "__main__":
    main()
