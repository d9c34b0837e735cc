"""Pixels for each millimetre against accuracy, and the size of the image against time: what the paper's Eq. 17 and 18 promise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from time import process_time

import numpy as np

from tactape_fab import Localizer
from tactape_fab.sense import SensorProfile, iterate_frames, load_sensor
from tests.bench.evidence.job import Job, Result, Size
from tests.bench.localization_measure import error_of, is_right
from tests.bench.localization_rows import SEED, registered_tape

SECTION = "resolution"
TITLE = "Resolution"
PX_PER_MM = (8, 12, 16, 24, 32)
FIELD_MM = (20, 15)
ROUNDS = 3


def jobs(size: Size) -> list[Job]:
    """One for each resolution; times are measured."""
    return [
        Job(
            section=SECTION,
            name=f"{px_per_mm} px/mm",
            measure=measure,
            options={"px_per_mm": px_per_mm, "frames": max(size.frames // 4, 10)},
            alone=True,
        )
        for px_per_mm in PX_PER_MM
    ]


def sensor_of(px_per_mm: int) -> SensorProfile:
    """A GelSight Mini of another resolution: the same field of view, the same noise of slopes in each pixel."""
    width, height = (side * px_per_mm for side in FIELD_MM)
    scale = (float(px_per_mm), float(px_per_mm))
    return replace(load_sensor("gelsight-mini"), width_px=width, height_px=height, px_per_mm=scale)


def measure(px_per_mm: int, frames: int) -> Result:
    """Errors of contacts located and right, and the processor's time for each (the least of some calls)."""
    sensor = sensor_of(px_per_mm)
    localizer = Localizer([registered_tape()], sensor)
    errors, elapsed_ms = [], []
    for frame in iterate_frames(registered_tape(), frames, SEED, sensor):
        times = []
        for _ in range(ROUNDS):
            start = process_time()
            fix = localizer.locate(frame.depth)
            times.append(1000.0 * (process_time() - start))
        elapsed_ms.append(min(times))
        if is_right(fix, frame):
            errors.append(error_of(fix, frame))
    rms = np.sqrt(np.mean(np.square(errors), axis=0)) if errors else np.full(3, np.nan)
    return {
        "frames": frames,
        "right": len(errors),
        "size_px": [sensor.width_px, sensor.height_px],
        "position_um": float(np.hypot(rms[0], rms[1]) / np.sqrt(2) * 1000),
        "theta_deg": float(np.degrees(rms[2])),
        "p50_ms": float(np.median(elapsed_ms)),
    }


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    first, last = (results[name] for name in (min(results, key=_px_per_mm), max(results, key=_px_per_mm)))
    finer = last["size_px"][0] / first["size_px"][0]
    place, angle = (first[key] / last[key] for key in ("position_um", "theta_deg"))
    out = [
        f"## {TITLE}",
        "",
        "The paper expects errors to fall as 1/R (Eq. 17 and 18), and time not to depend on the image's size. The default scene,",
        "with a sensor of the same field of view and other pixels, whose slopes are as noisy in each pixel; times are processor",
        f"time, one thread. From the coarsest to the finest, R is {finer:.0f} times as large: the place is {place:.1f} times as",
        f"exact and the angle {angle:.1f} times, in {last['p50_ms'] / first['p50_ms']:.1f} times the time.",
        "",
        "| R, px/mm | image, px | right | place, µm | angle, ° | ms, median |",
        "|---|---|---|---|---|---|",
    ]
    for name, one in sorted(results.items(), key=lambda item: _px_per_mm(item[0])):
        width, height = one["size_px"]
        out.append(
            f"| {name.partition(' ')[0]} | {width}x{height} | {one['right']} of {one['frames']} | {one['position_um']:.2f} "
            f"| {one['theta_deg']:.3f} | {one['p50_ms']:.2f} |"
        )
    return [*out, ""]


def _px_per_mm(name: str) -> int:
    return int(name.partition(" ")[0])
