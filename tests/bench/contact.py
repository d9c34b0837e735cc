"""Tilt, force and pose of tapes pressed into an elastic gel: `python -m tests.bench.contact [--page docs/frames.md]`.

A row is one contact at one force, with the slope noise of a real GelSight Mini; `--seed` draws other poses. Nothing that the
decoder knows of forces comes from frames; its constants for tilts are from seeds 5, 61 and 77. Errors are root mean squares;
"true" is the mean squared error over the variance that is said, 1 where that is right. For the pose it is NEES/3.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab import Localizer, Tape, TapeSpec
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import load_fab, load_part
from tactape_fab.sense import ElasticContact, Frame, Scene, SensorProfile, iterate_frames, load_sensor
from tactape_fab.texture.frames import FloatArray
from tests.bench.elastic import SLOPE_NOISE, WRONG_MM
from tests.bench.marks import command, write_between

FORCES_N = (0.5, 1.0, 2.0, 5.0, 10.0)
OBLIQUE_DEG = 45.0
PRESSES: dict[str, tuple[dict[str, Any], float]] = {
    "flat": ({}, 0.0),
    "tilt 2, 0": ({"tilt_deg": (2.0, 0.0)}, 0.0),
    "tilt 0, -2": ({"tilt_deg": (0.0, -2.0)}, 0.0),
    "tilt 5, 0": ({"tilt_deg": (5.0, 0.0)}, 0.0),
    "tilt 0, 5": ({"tilt_deg": (0.0, 5.0)}, 0.0),
    "tilt -3.5, 3.5": ({"tilt_deg": (-3.5, 3.5)}, 0.0),
    "cylinder 30": ({"cylinder_radius_mm": 30.0}, 0.0),
    "cylinder 30, tilt 2, 1": ({"cylinder_radius_mm": 30.0, "tilt_deg": (2.0, 1.0)}, 0.0),
    "cylinder 15.7": ({"cylinder_radius_mm": 15.7}, 0.0),
    "cylinder 15.7, oblique": ({"cylinder_radius_mm": 15.7}, OBLIQUE_DEG),
    "cylinder 30, oblique": ({"cylinder_radius_mm": 30.0}, OBLIQUE_DEG),
    "cylinder 50, oblique": ({"cylinder_radius_mm": 50.0}, OBLIQUE_DEG),
    "cylinder 130, oblique": ({"cylinder_radius_mm": 130.0}, OBLIQUE_DEG),
}
"""How a tape is pressed in, and by how much a cylinder's axis is turned from the image's width, degrees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What one contact gave."""

    frames: int
    located: int
    wrong: int
    tilt_deg: float
    tilt_true: float
    force_share: float
    force_bias: float
    force_true: float
    position_um: float
    pose_true: float


def measure(localizer: Localizer, tape: Tape, scene: Scene, count: int, seed: int) -> Row:
    """Locate `count` frames of a scene."""
    assert scene.elastic is not None
    found, wrong, located = [], 0, 0
    frames: Iterator[Frame] = iterate_frames(tape, count, seed, scene=scene)
    for frame in frames:
        fix = localizer.locate(frame.depth)
        if not fix.located or fix.position_mm is None or fix.theta_deg is None:
            continue
        located += 1
        off = np.asarray(fix.position_mm) - frame.position_mm
        if np.hypot(*off) > WRONG_MM:
            wrong += 1
            continue
        turn = np.radians((fix.theta_deg - frame.theta_deg + 180.0) % 360.0 - 180.0)
        error = np.array([*off, turn])
        pose = error @ np.linalg.solve(np.asarray(fix.covariance), error) / 3
        force = np.nan if fix.force_n is None else fix.force_n / scene.elastic.force_n - 1
        share = np.nan if fix.force_sigma_n is None else fix.force_sigma_n / scene.elastic.force_n
        tilt: FloatArray = np.full(2, np.nan)
        tilt_true = float("nan")
        if fix.tilt_deg is not None:
            tilt = np.asarray(fix.tilt_deg) - scene.elastic.tilt_deg
            turned = np.radians(tilt)
            tilt_true = float(turned @ np.linalg.solve(np.asarray(fix.tilt_covariance), turned)) / 2
        found.append([*tilt, tilt_true, force, (force / share) ** 2, *off, pose])
    values = np.array(found).reshape(-1, 8)
    rms = np.sqrt(np.nanmean(values**2, axis=0)) if len(values) else np.full(8, np.nan)
    mean = np.nanmean(values, axis=0) if len(values) else np.full(8, np.nan)
    return Row(
        frames=count,
        located=located,
        wrong=wrong,
        tilt_deg=float(np.hypot(rms[0], rms[1]) / np.sqrt(2)),
        tilt_true=float(mean[2]),
        force_share=float(rms[3]),
        force_bias=float(mean[3]),
        force_true=float(mean[4]),
        position_um=float(1000 * np.hypot(rms[5], rms[6]) / np.sqrt(2)),
        pose_true=float(mean[7]),
    )


def sensors(name: str) -> dict[str, SensorProfile]:
    """The sensor, and what it would be with other knowledge of its gel."""
    stock = load_sensor(name)
    return {"as profiled": stock, "crown not known": replace(stock, gel=replace(stock.gel, crown_mm=None))}


HEADER = """\
| contact | force, N | located | wrong | tilt error, ° | squared, over its variance | force error, % | its mean, % \
| squared, over its variance | position, µm | NEES/3 |
|---|---|---|---|---|---|---|---|---|---|---|
"""


def line_of(name: str, force_n: float, row: Row) -> str:
    """A row of the table."""
    tilt, force = f"{row.tilt_deg:.3f} | {row.tilt_true:.2f}", f"{100 * row.force_share:.1f} | {100 * row.force_bias:+.1f}"
    rest = f"{row.force_true:.2f} | {row.position_um:.1f} | {row.pose_true:.2f}"
    return f"| {name} | {force_n:g} | {row.located} of {row.frames} | {row.wrong} | {tilt} | {force} | {rest} |\n"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.contact", description=__doc__)
    parser.add_argument("--frames", type=int, default=40, metavar="N", help="frames a row")
    parser.add_argument("--seed", type=int, default=11, metavar="S")
    parser.add_argument("--no-crown", action="store_true", help="the gel's crown is not known")
    parser.add_argument("--row", action="append", metavar="NAME", help="contacts that start so; all when left out")
    parser.add_argument("--force", type=float, action="append", metavar="N", help="a force; five of them when left out")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="write the table between marks of a page, docs/frames.md")
    given = parser.parse_args()
    tape = plan(TapeSpec(sector=7), load_fab("generic-fpc"), load_part("r0201"))
    localizer = Localizer([tape], sensor=sensors("gelsight-mini")["crown not known" if given.no_crown else "as profiled"])
    table = HEADER
    print(HEADER, end="")
    for name, (options, turn_deg) in PRESSES.items():
        if given.row and not any(name.startswith(start) for start in given.row):
            continue
        for force_n in given.force or FORCES_N:
            elastic = ElasticContact(force_n=force_n, **options)
            scene = Scene(elastic=elastic, slope_noise=SLOPE_NOISE, contact_turn_deg=turn_deg)
            line = line_of(name, force_n, measure(localizer, tape, scene, given.frames, given.seed))
            print(line, end="", flush=True)
            table += line
    if given.page is not None:
        about = f"Simulated contacts for each row: {given.frames} ({command('tests.bench.contact')})."
        write_between(given.page, "contact", f"{about}\n\n{table}")


if __name__ == "__main__":
    main()
