"""Textures that must never be located: what is touched, as dots or as depth maps, and how often it is located all the same."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from tactape_fab import Tape
from tactape_fab.decode.detect import detect
from tactape_fab.decode.localizer import Localizer
from tactape_fab.decode.result import Localization
from tactape_fab.simulate import (
    DotErrors,
    Parts,
    Scene,
    dots_of,
    draw_poses,
    iterate_frames,
    other_surface,
    plain_grid,
    random_bumps,
    random_symbols,
    simulate,
)
from tactape_fab.texture.frames import FloatArray, IntArray

from .localization_rows import FELT, SECTOR, SEED, STRIPS, registered_tape, tape_of

FALSE = int(os.environ.get("TACTAPE_BENCH_FALSE", "10000"))
PX_PER_MM = 16.0
COMMON = (0, 0)
NEIGHBOURS = tuple(SECTOR + step for step in (-1, 1, -7, 16, 17, 32, 34))
"""Sectors that a common origin makes most alike; sector 0 stands for those below 16 and 17."""

EDGE_SECTORS = (SECTOR + 17, SECTOR + 1)
Edge = Literal["none", "narrow", "any"]
SCENES: tuple[tuple[Scene, Edge], ...] = (
    (Scene(), "none"),
    (Scene(contact_mm=(8.0, 8.0)), "none"),
    (Scene(contact_mm=(6.0, 6.0)), "none"),
    (STRIPS[6.0], "none"),
    (STRIPS[4.5], "none"),
    (STRIPS[3.0], "none"),
    (Scene(), "narrow"),
    (Scene(contact_mm=(7.5, 8.5), bumps=3), "any"),
)
"""Contacts, and whether they hang over the tape's edge: narrow with two or three columns or rows of dots."""
OVER_THE_EDGE = SCENES[-1:]
"""Dots beside the tape, where a rival has no part either."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Accepts:
    """How often a kind of texture was located.

    Attributes
    ----------
    smallest : float
        Least p_false of all frames, located or not.
    worst : str
        Where that was.
    by : dict
        Located frames by kind.
    """

    frames: int
    located: int
    smallest: float
    worst: str
    by: Mapping[str, int]

    def __str__(self) -> str:
        by = f" ({dict(self.by)})" if self.by else ""
        return f"{self.located} of {self.frames} located{by}, least p_false {self.smallest:.1e} at {self.worst}"


def count_accepts(answers: Iterator[tuple[str, Localization]]) -> Accepts:
    """Count located frames; each answer comes with the kind of frame it is of."""
    frames, smallest, worst, by = 0, 1.0, "-", Counter[str]()
    for kind, fix in answers:
        frames += 1
        by[kind] += fix.located
        if fix.p_false is not None and fix.p_false < smallest:
            smallest, worst = fix.p_false, kind
    return Accepts(frames=frames, located=by.total(), smallest=smallest, worst=worst, by={k: n for k, n in by.items() if n})


# Dots


@cache
def fitted_errors(frames: int = 100) -> DotErrors:
    """How the detector errs in the default scene, measured on frames that no other test uses."""
    tape, near = registered_tape(), 0.3 * PX_PER_MM
    sums: Counter[str] = Counter()
    errors: list[FloatArray] = []
    weights: list[FloatArray] = []
    for frame in iterate_frames(tape, frames, SEED + 900, scene=Scene()):
        dots = detect(frame.depth, PX_PER_MM)
        whole = frame.dots_imprint > 0.99
        apart = frame.dots_px[:, None] - dots.xy_px[None]
        distance = np.hypot(apart[..., 0], apart[..., 1])
        nearest = distance.argmin(axis=1)
        found = distance[np.arange(len(nearest)), nearest] < near
        errors.append(apart[np.arange(len(nearest)), nearest][whole & found])
        weights.append(dots.weights[nearest[whole & found]])
        sums["whole"] += int(whole.sum())
        sums["lost"] += int((whole & ~found).sum())
        sums["false"] += int((distance[frame.dots_imprint > 0.05].min(axis=0) >= near).sum())
    error, weight = np.concatenate(errors), np.concatenate(weights)
    sigma_px = float(np.median(np.abs(error)) * 1.4826)
    return DotErrors(
        sigma_px=sigma_px,
        outliers=float((np.abs(error).max(axis=1) > 4 * sigma_px).mean()),
        lost=sums["lost"] / sums["whole"],
        least_imprint=FELT,
        false_dots=sums["false"] / frames,
        weight_sigma=float(weight.std() / weight.mean()),
    )


def dots_answers(
    localizer: Localizer,
    tape: Tape,
    count: int,
    seed: int,
    kind: str,
    *,
    parts: Callable[[int], Parts] | None = None,
    mirrored: bool = False,
    scenes: tuple[tuple[Scene, Edge], ...] = SCENES,
) -> Iterator[tuple[str, Localization]]:
    """Answers for the dots of a touched tape, the contacts of `scenes` in turn, which of them first by the seed.

    Parameters
    ----------
    parts : callable, optional
        Seed -> the parts that stand there instead of the tape's own.
    """
    rng = np.random.default_rng([SEED, seed])
    errors = fitted_errors()
    for k in range(len(scenes)):
        scene, edge = scenes[(k + seed) % len(scenes)]
        share = len(range(k, count, len(scenes)))
        if share == 0:
            continue
        scene = scene.changed({"mirrored_tape": mirrored})
        drawn = 0
        standing: Parts | None = None
        for n, pose in enumerate(draw_poses(tape, 20 * share, SEED + seed, scene=scene, edge=edge != "none")):
            if parts is not None and n % 50 == 0:
                standing = parts(SEED + 100_000 * k + n)
            dots = dots_of(tape, pose.tolist(), scene, rng, errors, parts=standing)
            if edge == "narrow" and not 2 <= _fewest_lines(tape, dots.part) <= 3:
                continue
            yield kind, localizer.locate_dots(dots.xy_px, dots.weights)
            drawn += 1
            if drawn == share:
                break


def _fewest_lines(tape: Tape, part: IntArray) -> int:
    cells = tape.cells()[part[part >= 0]]
    return min(len(np.unique(cells[:, axis])) for axis in (0, 1))


# What is touched

IMPOSTORS: Mapping[str, Callable[[Tape, int], Parts]] = {
    "plain grid": lambda tape, seed: plain_grid(tape),
    "random symbols": random_symbols,
    "random bumps": random_bumps,
}


def impostor_dots(localizer: Localizer, name: str, count: int) -> Accepts:
    """Dots of parts that carry no code, or of the own tape as its mirror image."""
    tape = registered_tape()
    if name == "own tape mirrored":
        return count_accepts(dots_answers(localizer, tape, count, 1, name, mirrored=True))
    make = IMPOSTORS[name]
    return count_accepts(dots_answers(localizer, tape, count, 2, name, parts=lambda seed: make(tape, seed)))


def impostor_frames(localizer: Localizer, name: str, count: int) -> Accepts:
    """The same through depth maps, and surfaces without parts."""

    def answers() -> Iterator[tuple[str, Localization]]:
        tape = registered_tape()
        rng = np.random.default_rng([SEED, 3])
        standing: Parts | None = None
        for n in range(count):
            scene = SCENES[n % 6][0]
            if name in ("blank", "ball", "ridges"):
                yield name, localizer.locate(other_surface(name, scene=scene, seed=SEED + n))  # type: ignore[arg-type]
                continue
            if name in IMPOSTORS and n % 50 == 0:
                standing = IMPOSTORS[name](tape, SEED + n)
            scene = scene.changed({"mirrored_tape": name == "own tape mirrored"})
            x, y = rng.uniform((6.0, 6.0), ((tape.columns - 1) * 1.5 - 6.0, (tape.rows - 1) * 1.5 - 6.0))
            depth = simulate(tape, (x, y), float(rng.uniform(-180, 180)), scene=scene, seed=SEED + n, parts=standing)
            yield name, localizer.locate(depth)

    return count_accepts(answers())


def unregistered_dots(
    localizer: Localizer,
    sectors: tuple[int, ...],
    count: int,
    origin: tuple[int, int] | None = None,
    *,
    seed: int = 0,
    scenes: tuple[tuple[Scene, Edge], ...] = SCENES,
) -> Accepts:
    """Dots of other sectors' tapes, `count` frames in all."""

    def answers() -> Iterator[tuple[str, Localization]]:
        for k, sector in enumerate(sectors):
            share = len(range(k, count, len(sectors)))
            yield from dots_answers(
                localizer, tape_of(sector, origin), share, 10 + sector + 256 * seed, f"sector {sector}", scenes=scenes
            )

    return count_accepts(answers())


def unregistered_frames(localizer: Localizer, sectors: tuple[int, ...], count: int) -> Accepts:
    """The same through depth maps."""

    def answers() -> Iterator[tuple[str, Localization]]:
        for k, sector in enumerate(sectors):
            tape = tape_of(sector)
            for n in range(k, count, len(sectors)):
                scene, edge = SCENES[(n // len(sectors) + k) % len(SCENES)]
                pose = draw_poses(tape, 1, SEED + 100 * n + 7, scene=scene, edge=edge != "none")[0]
                depth = simulate(tape, (pose[0], pose[1]), float(pose[2]), scene=scene, seed=SEED + n)
                yield f"sector {sector}", localizer.locate(depth)

    return count_accepts(answers())
