"""p_place said against places that were wrong, by decade: `python -m tests.bench.place_chance [--contacts N]`.

Contacts of 4.5 to 6 mm in a closed world, of which so few dots are seen that places are mistaken: each is located among 1 and
among 16 tapes, with `max_p_tape` 0.01 and 0.3, all other limits off, so that every p_place is said. For a decade of p_place the
table has how many answers said so, the wrong ones that these p_place add up to, and the wrong ones that there were. Where p_place
is true or on the safe side, happened / said is 1 at most, up to chance (the range is that of 95 %).

Each batch of contacts has its own seed: figures do not depend on processes. `--elastic` presses the tape into an elastic gel
instead, without force enough for more dots.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache
from math import floor, log10
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np

from tactape_fab import Localizer
from tactape_fab.base.pool import mapped_as_done
from tactape_fab.sense import ElasticContact, Scene, SensorProfile, iterate_frames, load_sensor
from tactape_fab.sense.decode.rule import Limits
from tests.bench.localization_measure import is_right
from tests.bench.localization_rows import SEED, Row, tapes_of
from tests.bench.workers import workers

FRAME_PX = 160
"""Side of the frames: 10 mm, more than any contact here."""
BATCH = 250
TAPES = (1, 16)
MAX_P_TAPE = (0.01, 0.3)
LEAST_DECADE = -7
"""Decades from here on; what is smaller counts to the last."""
SIZES_MM = (4.5, 5.0, 5.5, 6.0)
FORCES_N = (0.02, 0.03, 0.05)
MISSING = (0.0, 0.3)
_PRECISION = 1e-8


class Unlimited(Limits):
    """Limits that refuse nothing by p_place, with p_place as exact as where it decides."""

    __slots__ = ()

    @property
    def precision(self) -> float:
        """As for a far smaller `max_p_false`."""
        return _PRECISION


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """Answers for one batch: how they were asked for, what they said, and whether they were wrong.

    Attributes
    ----------
    name : str
        Of the scene.
    part : int
        Batch of that scene.
    tapes : int
    max_p_tape : float
    frame : tuple of int
        Number of the contact in its batch.
    p_tape, p_place : tuple of float
    wrong : tuple of bool
    """

    name: str
    part: int
    tapes: int
    max_p_tape: float
    frame: tuple[int, ...]
    p_tape: tuple[float, ...]
    p_place: tuple[float, ...]
    wrong: tuple[bool, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """Contacts of one scene, drawn together."""

    name: str
    scene: Scene
    part: int
    count: int
    tapes: tuple[int, ...] = TAPES
    max_p_tape: tuple[float, ...] = MAX_P_TAPE


def scenes(elastic: bool, options: dict[str, float | str]) -> dict[str, Scene]:
    """Contacts by name: sizes, or forces, each with all parts and with 30 % missing."""
    if elastic:
        forces = {f"{force:g} N": Scene(elastic=ElasticContact(force_n=force)) for force in FORCES_N}
        plain = forces
    else:
        plain = {f"{side:g} mm": Scene(contact_mm=(side, side)) for side in SIZES_MM}
    return {
        f"{name}, {100 * missing:g} % missing": scene.changed({"missing": missing, **options})
        for name, scene in plain.items()
        for missing in MISSING
    }


def batches(elastic: bool, options: dict[str, float | str], contacts: int) -> Iterator[Batch]:
    """So many contacts, evenly of all scenes."""
    chosen = scenes(elastic, options)
    each = -(-contacts // len(chosen))
    for part in range(-(-each // BATCH)):
        for name, scene in chosen.items():
            yield Batch(name=name, scene=scene, part=part, count=min(BATCH, each - part * BATCH))


@cache
def small_sensor() -> SensorProfile:
    """A GelSight Mini of which only the middle is looked at."""
    return replace(load_sensor("gelsight-mini"), width_px=FRAME_PX, height_px=FRAME_PX)


@cache
def _localizer(tapes: int, max_p_tape: float) -> Localizer:
    localizer = Localizer(tapes_of(Row(name="", tapes=tapes)), small_sensor(), world="closed")
    localizer._limits = Unlimited(max_p_false=1.0, max_p_tape=max_p_tape, kappa=1.0)
    return localizer


def measure(batch: Batch) -> list[Said]:
    """What is said of a batch's contacts."""
    tape = tapes_of(Row(name=""))[0]
    seed = crc32(f"{SEED}, {batch.name}, {batch.part}".encode())
    frames = list(iterate_frames(tape, batch.count, seed, sensor=small_sensor(), scene=batch.scene))
    out = []
    for tapes in batch.tapes:
        for most in batch.max_p_tape:
            localizer = _localizer(tapes, most)
            fixes = [localizer.locate(frame.depth) for frame in frames]
            said = tuple(k for k, fix in enumerate(fixes) if fix.located)
            out.append(
                Said(
                    name=batch.name,
                    part=batch.part,
                    tapes=tapes,
                    max_p_tape=most,
                    frame=said,
                    p_tape=tuple(float(fixes[k].p_tape or 0.0) for k in said),
                    p_place=tuple(float(fixes[k].p_place or 0.0) for k in said),
                    wrong=tuple(not is_right(fixes[k], frames[k]) for k in said),
                )
            )
    return out


class Decade(NamedTuple):
    """Answers of one way of asking whose p_place is in one decade: how many, what they add up to, and how many were wrong."""

    tapes: int
    max_p_tape: float
    exponent: int
    answers: int
    said: float
    wrong: int


def by_decade(found: Sequence[Said]) -> list[Decade]:
    """The decades of p_place of all batches together, largest first, for every way of asking."""
    out = []
    for tapes, most in sorted({(one.tapes, one.max_p_tape) for one in found}):
        mine = [one for one in found if (one.tapes, one.max_p_tape) == (tapes, most)]
        p_place = np.concatenate([one.p_place for one in mine])
        wrong = np.concatenate([np.asarray(one.wrong, dtype=bool) for one in mine])
        exponent = np.array([min(max(floor(log10(max(p, 1e-300))), LEAST_DECADE), -1) for p in p_place], dtype=int)
        for k in range(-1, LEAST_DECADE - 1, -1):
            of = exponent == k
            out.append(Decade(tapes, most, k, int(of.sum()), float(p_place[of].sum()), int(wrong[of].sum())))
    return out


def rows(decades: Sequence[Decade]) -> list[str]:
    """A table of decades, those of the same name added up."""
    from scipy.stats import chi2

    out = [
        "| tapes | max-p-tape | p_place | answers | wrong, said | wrong, happened | happened / said |",
        "|---|---|---|---|---|---|---|",
    ]
    for tapes, most, k in sorted({one[:3] for one in decades}, key=lambda one: (one[0], one[1], -one[2])):
        same = [one for one in decades if one[:3] == (tapes, most, k)]
        answers, said, wrong = (sum(one[field] for one in same) for field in (3, 4, 5))
        if answers == 0:
            continue
        low, high = (chi2.ppf(0.025, 2 * wrong) / 2 if wrong else 0.0), chi2.ppf(0.975, 2 * wrong + 2) / 2
        name = f"1e{k} to 1e{k + 1}" if k > LEAST_DECADE else f"below 1e{k + 1}"
        ratio = f"{wrong / said:.2f} ({low / said:.2f} to {high / said:.2f})" if high / said < 1000.0 else ""
        out.append(f"| {tapes} | {most:g} | {name} | {answers:,} | {said:.3g} | {wrong} | {ratio} |")
    return out


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.place_chance", description=__doc__)
    parser.add_argument("--contacts", type=int, default=100_000, metavar="N", help="100,000 take half an hour on two cores")
    parser.add_argument("--workers", type=workers, default=2, metavar="N|tcp://HOST:PORT")
    parser.add_argument("--elastic", action="store_true", help="press an elastic gel, 40 times as slow")
    parser.add_argument(
        "--scene", nargs="*", default=[], metavar="NAME=VALUE", help="attributes of Scene, such as placement_mm=0.05"
    )
    parser.add_argument("--only", metavar="WORDS", help="scenes whose name holds these words")
    parser.add_argument("--tapes", type=int, nargs="+", default=TAPES, metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep what was said of every contact")
    chosen = parser.parse_args()
    options = {name: _number(value) for name, _, value in (one.partition("=") for one in chosen.scene)}
    todo = [
        replace(batch, tapes=tuple(chosen.tapes))
        for batch in batches(chosen.elastic, options, chosen.contacts)
        if chosen.only is None or chosen.only in batch.name
    ]
    found: list[Said] = []
    with closing(mapped_as_done(measure, todo, chosen.workers)) as results:
        for done, (_, said) in enumerate(results, 1):
            found += said
            print(f"{done} of {len(todo)} batches", end="\r", file=sys.stderr, flush=True)
    if chosen.json is not None:
        chosen.json.write_text(json.dumps([{n: getattr(one, n) for n in one.__slots__} for one in found]))
    print(f"{sum(batch.count for batch in todo)} contacts")
    print("\n".join(rows(by_decade(found))))


def _number(value: str) -> float | str:
    try:
        return float(value)
    except ValueError:
        return value


if __name__ == "__main__":
    from tests.bench.place_chance import main as of_module  # processes know its functions by this name

    of_module()
