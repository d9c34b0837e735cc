"""Trace codes: distances of windows counted over the whole field, the search for the constants, and contacts beside other codes.

Run: python -m tests.bench.trace_codes [--search SECONDS --seed N | --frames N] [--page docs/codes.md]
"""

from __future__ import annotations

import argparse
import random
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab import Localizer, Tape
from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.texture.code import CODES, DEFAULT_CODE, TOUCH_CODE, get_code
from tactape_fab.texture.touch.patches import PATCHES
from tactape_fab.texture.trace import TraceCode
from tests.bench.code_trust import right_place
from tests.bench.localization_measure import WORLDS
from tests.bench.localization_rows import SEED, registered_tape
from tests.bench.marks import command, write_between

Bytes = npt.NDArray[np.uint8]
BESIDE = (DEFAULT_CODE, TOUCH_CODE, "touch-2", "trace-22")
BARE = "no manifest"
CONTACTS_MM = (5.5, 6.0, 6.5, 7.0, 7.5, 8.0, 9.0, 10.0)
ENOUGH = {"4x4": 4, "5x5": 9}
"""Distances that are asked for."""
_CHUNK, _SHIFTS = 1 << 16, 400
APART = (127, 128, 129)
"""Exponents from a row to the next that leave room for all sectors in the field of degree 22."""


def recurrence(code: TraceCode) -> Bytes:
    """The x bits of all exponents by the linear recurrence of the polynomial, in blocks that double; shape (2^m - 1,)."""
    taps = [t for t in range(code.degree) if code.polynomial >> t & 1]
    bits = np.zeros(2 * code.order, dtype=np.uint8)
    bits[0], known, stride = 1, code.degree, 1  # the element 1, and a^1 ... a^(m - 1), have the x bits 1, 0 ... 0
    while known < code.order:
        # P(x)^(2^j) = P(x^(2^j)) over GF(2): the recurrence holds at every stride 2^j
        while code.degree * 2 * stride <= known:
            stride *= 2
        start = known - code.degree * stride
        bits[known : known + stride] = np.bitwise_xor.reduce([bits[start + t * stride :][:stride] for t in taps])
        known += stride
    return bits[: code.order].copy()


def least_weight(code: TraceCode, bits: Bytes, name: str, enough: int = 0) -> int:
    """Least weight of the windows of a shape at all exponents; some weight below `enough` where there is one."""
    both = bits + np.roll(bits, -code.y_exponent)
    exponents = [column + code.columns_apart * row for row, column in np.argwhere(PATCHES[name]).tolist()]
    both = np.concatenate([both, both[: max(exponents)]])
    least = len(exponents) * 2
    for low in range(0, code.order, _CHUNK):
        high = min(low + _CHUNK, code.order)
        total = np.zeros(high - low, dtype=np.uint8)
        for exponent in exponents:
            total += both[low + exponent : high + exponent]
        least = min(least, int(total.min()))
        if least < enough:
            break
    return least


def least_weights(code: TraceCode) -> dict[str, int]:
    """Least number of bits in which two windows at any places differ, the turn being known, by shape.

    The difference of two windows is the window of another element, so that all elements are counted.
    """
    bits = recurrence(code)
    return {name: least_weight(code, bits, name) for name in PATCHES}


def searched(seconds: float, seed: int) -> None:
    """Print codes of the same field with the distances that are asked for, as random ones come up."""
    rng, code, end = random.Random(seed), _code(), time.monotonic() + seconds
    tried = 0
    while time.monotonic() < end:
        code = replace(code, polynomial=rng.getrandbits(code.degree) | 1)
        if not primitive(code):
            continue
        bits = recurrence(code)
        for _ in range(_SHIFTS):
            other = replace(code, columns_apart=rng.choice(APART), y_exponent=rng.randrange(1, code.order))
            tried += 1
            if all(least_weight(other, bits, name, least) >= least for name, least in ENOUGH.items()):
                found = {name: least_weight(other, bits, name) for name in PATCHES}
                print(f"{tried}: {other.polynomial:#x}, C {other.columns_apart}, G {other.y_exponent}: {found}", flush=True)


def beside(size_mm: float, frames: int) -> dict[str, dict[str, int]]:
    """Frames located right, by code and by what is known; wrong ones under "wrong". Poses and noise are those of all codes."""
    scene, found = Scene(contact_mm=(size_mm, size_mm)), {}
    for code in BESIDE:
        tape = _tape(code)
        localizers: dict[str, Localizer] = {world: Localizer([tape], world=world) for world in WORLDS}
        if get_code(code).plane is not None:
            localizers[BARE] = Localizer.from_code(code, pitch_mm=tape.pitch_mm, displacement_mm=tape.displacement_mm)
        counts = dict.fromkeys([*localizers, "wrong"], 0)
        for frame in iterate_frames(tape, frames, SEED + 17, scene=scene):
            for known, localizer in localizers.items():
                fix = localizer.locate(frame.depth)
                right = right_place(fix, frame, tape)
                counts[known] += fix.located and right
                counts["wrong"] += fix.located and not right
        found[code] = counts
    return found


def _tape(code: str) -> Tape:
    like, of = registered_tape(), get_code(code)
    origin = of.default_origin(like.sector)
    symbols = of.symbols(like.sector, origin, like.symbols.shape, (), 4, half_turns=True)
    return replace(like, name=code, code=code, origin=origin, symbols=symbols, tag=None)


def table(frames: int) -> str:
    """Share located of each code, by contact."""
    heads = [f"`{code}`, {known}" for code in BESIDE for known in _known(code)]
    lines = [f"| contact | {' | '.join(heads)} | wrong |", "|---" * (len(heads) + 2) + "|"]
    for size_mm in CONTACTS_MM:
        found = beside(size_mm, frames)
        shares = [f"{100 * found[code][known] / frames:.0f} %" for code in BESIDE for known in _known(code)]
        lines.append(f"| {size_mm:g} mm | {' | '.join(shares)} | {sum(counts['wrong'] for counts in found.values())} |")
        print(lines[-1], flush=True)
    return "\n".join(
        [*lines, "", f"{frames} frames a row and code, one tape, default trust; {command('tests.bench.trace_codes')}.", ""]
    )


def distances() -> str:
    """Least distances of all windows by shape."""
    found = least_weights(_code())
    heads = [f"{name} ({2 * int(PATCHES[name].sum())} bits)" for name in found]
    rows = [f"| windows | {' | '.join(heads)} |", "|---" * (len(found) + 1) + "|"]
    return "\n".join([*rows, f"| differ in at least | {' | '.join(map(str, found.values()))} |", ""])


def _known(code: str) -> tuple[str, ...]:
    return (*WORLDS, BARE) if get_code(code).plane is not None else WORLDS


def primitive(code: TraceCode) -> bool:
    """Whether a root of the polynomial has the order 2^m - 1."""
    if code.product(code.power(code.order - 1), 2) != 1:  # `power` takes exponents modulo the order
        return False
    primes = [next(number for number in range(3, factor + 1) if factor % number == 0) for factor in code.factors]
    return all(code.power(code.order // prime) != 1 for prime in primes)


def _code() -> TraceCode:
    return next(code for code in CODES.values() if isinstance(code, TraceCode))


def main() -> None:
    """Count, or search."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--search", type=float, metavar="SECONDS")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frames", type=int, metavar="N")
    parser.add_argument("--page", type=Path)
    asked = parser.parse_args()
    if asked.search is not None:
        searched(asked.search, asked.seed)
    elif asked.frames is not None:
        made = table(asked.frames)
        if asked.page is not None:
            write_between(asked.page, "trace-contacts", made)
    else:
        made = distances()
        print(made, end="")
        if asked.page is not None:
            write_between(asked.page, "trace-distances", made)


if __name__ == "__main__":
    main()
