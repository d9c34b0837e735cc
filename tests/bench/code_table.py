"""All codes side by side: bits, distances and their bounds, smallest contacts, and times, for docs/codes.md.

Run: python -m tests.bench.code_table distances|contacts [--contacts N] [--page docs/codes.md]

Contacts are drawn as dots that the detector once made of parts alike (`recorded`), the same for all codes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path
from time import process_time
from zlib import crc32

import numpy as np

from tactape_fab import Localizer, Tape
from tactape_fab.base.errors import SpecError
from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.texture.code import ALL_CODE_NAMES, get_code
from tactape_fab.texture.touch.patches import PATCHES, patch_distances, patch_shapes
from tactape_fab.texture.windows import bit_count
from tests.bench.code_bounds import most_distance
from tests.bench.code_trust import NO_MANIFEST, Posed, localizer_of, right_place, tape_of_code
from tests.bench.dot_records import contact_poses, recorded
from tests.bench.localization_rows import SECTOR, SEED, registered_tape
from tests.bench.marks import command, write_between
from tests.bench.recorded import draw_dots

STEP_MM, LEAST_STEP, MOST_STEP = 0.25, 18, 48
"""Contacts of 4.5 to 12 mm."""
ENOUGH = 0.9
TAPES, MANY = (1, 16, 256), 16
BESIDE = 8
"""Tapes between which distances are counted."""


@cache
def tapes_of_code(code: str, count: int) -> tuple[Tape, ...]:
    """A registry: of a plane its first sectors; of a designed code one design, and random matrices in place of others."""
    own, others = tape_of_code(code), [sector for sector in range(256) if sector != SECTOR][: count - 1]
    if get_code(code).plane is not None:
        return own, *(tape_of_code(code, sector) for sector in others)
    rng = np.random.default_rng(SEED)
    drawn = rng.integers(0, 4, (len(others), *own.symbols.shape)).astype(np.uint8)
    return own, *(replace(own, name=f"random {s}", sector=s, symbols=m) for s, m in zip(others, drawn, strict=True))


# Distances


def words_upright(tape: Tape) -> list[np.ndarray]:
    """Every patch of a tape in the one turn, a word each, by shape."""
    from tactape_fab.texture.touch.words import words_of

    words, count = words_of(tape.points_in.gray_codes[tape.symbols], patch_shapes())
    return [words[k, 0, : count[k]] for k in range(len(PATCHES))]


def between(code: str) -> list[int]:
    """Least bits between patches of two of some tapes of a code with a plane, the turn being known."""
    words = [words_upright(tape) for tape in tapes_of_code(code, BESIDE)]
    least = [99] * len(PATCHES)
    for one, other in combinations(words, 2):
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            least[k] = min(least[k], *(int(bit_count(a[i : i + 256, None] ^ b).min()) for i in range(0, len(a), 256)))
    return least


def distances() -> str:
    """Bits between patches of a tape in all turns and in half turns, and between tapes, beside what no code can exceed."""
    tape = registered_tape()
    head = [f"{name} ({2 * int(mask.sum())} bits)" for name, mask in PATCHES.items()]
    lines = [f"| code | turns | {' | '.join(head)} |", "|---" * (len(head) + 2) + "|"]

    def row(name: str, turns: str, values: list[object]) -> None:
        lines.append(f"| {name} | {turns} | {' | '.join(map(str, values))} |")
        print(lines[-1], flush=True)

    for code in ALL_CODE_NAMES:
        own, name = tape_of_code(code), f"`{code}`"
        found = patch_distances(own.symbols, own.present, half_turns=True)
        row(name, "any", [patch.bits for patch in found])
        row(name, "0 and 180°", [patch.half_turns[0] if patch.half_turns else "-" for patch in found])
        if get_code(code).plane is not None:
            row(name, f"known, between {BESIDE} tapes", list(between(code)))
        if get_code(code).proven:
            row(name, "known, all places of all sectors, proven", list(get_code(code).proven.values()))
    sizes = {name: (len(mask), 2 * int(mask.sum())) for name, mask in PATCHES.items()}
    patches = {name: (tape.columns - side + 1) * (tape.rows - side + 1) for name, (side, _) in sizes.items()}
    for turns, said in ((4, "any"), (2, "0 and 180°")):
        row("no code more than (LP)", said, [most_distance(bits, turns * patches[name]) for name, (_, bits) in sizes.items()])
    places = get_code("trace-22").range ** 2 * 256
    row("no code more than (LP)", "known, all places of 256 sectors", [most_distance(bits, places) for _, bits in sizes.values()])
    return "\n".join([*lines, "", f"One tape of {tape.columns}x{tape.rows} points; {command('tests.bench.code_table')}.", ""])


# Contacts


def located(code: str, localizer: Localizer, size_mm: float, missing: float, count: int) -> float:
    """Share of contacts on a code's tape that are located, and right."""
    scene, tape = Scene(contact_mm=(size_mm, size_mm), missing=missing), tape_of_code(code)
    rng = np.random.default_rng([SEED, crc32(f"{size_mm}, {missing}".encode())])
    poses = contact_poses(tape, count, int(rng.integers(2**62)), scene, "none")
    drawn, right = draw_dots(tape, poses, recorded(scene, "none"), rng), 0
    for k in range(count):
        fix = localizer.locate_dots(drawn[k].xy_px, drawn[k].weights)
        right += fix.located and right_place(fix, Posed(poses[k, :2], float(poses[k, 2])), tape)
    return right / count


def least_contact(code: str, localizer: Localizer, missing: float, count: int) -> str:
    """Smallest contact of which nine in ten are located, from there on larger ones taken to be, too."""
    low, high = LEAST_STEP - 1, MOST_STEP + 1
    while high - low > 1:
        middle = (low + high) // 2
        enough = located(code, localizer, middle * STEP_MM, missing, count) >= ENOUGH
        low, high = (low, middle) if enough else (middle, high)
    return f"{high * STEP_MM:g} mm" if high <= MOST_STEP else f"over {MOST_STEP * STEP_MM:g} mm"


def decode_ms(localizer: Localizer, code: str) -> float:
    """Processor time of a frame of 11x9 mm, detection and all: median over frames of the least of some."""
    depths = [frame.depth for frame in iterate_frames(tape_of_code(code), 8, SEED, scene=Scene())]
    least = []
    for depth in depths:
        times = []
        for _ in range(5):
            start = process_time()
            localizer.locate(depth)
            times.append(1000.0 * (process_time() - start))
        least.append(min(times))
    return float(np.median(least))


def contacts(count: int) -> str:
    """Smallest contacts by code and by what is registered, design time and decode time."""
    head = ["code", *(f"{tapes} tape{'s' * (tapes > 1)}" for tapes in TAPES), "30 % missing", "no manifest"]
    head += ["design of a tape", "a frame"]
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for code in ALL_CODE_NAMES:
        start = process_time()
        tape_of_code(code)
        design_s = process_time() - start
        alone, few = localizer_of(code, "its manifest"), max(2 * count // 5, 20)
        cells = [
            least_contact(code, Localizer(tapes_of_code(code, tapes)), 0.0, few if tapes > MANY else count) for tapes in TAPES
        ]
        cells += [least_contact(code, alone, 0.3, count), _bare(code, few)]
        cells += [f"{design_s:.1f} s" if design_s > 0.1 else "at once", f"{decode_ms(alone, code):.2g} ms"]
        lines.append(f"| `{code}` | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    said = (
        f"Smallest contact, in steps of {STEP_MM} mm, of which {ENOUGH:.0%} are located at the usual trust in an open world; "
        f"{count} contacts a size, of {TAPES[-1]} tapes and without a manifest {max(2 * count // 5, 20)}; "
        f"{command('tests.bench.code_table')}."
    )
    return "\n".join([*lines, "", said, ""])


def _bare(code: str, count: int) -> str:
    if get_code(code).plane is None:
        return "never"
    try:
        return least_contact(code, localizer_of(code, NO_MANIFEST), 0.0, count)
    except SpecError:
        return "too large to search"


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.code_table", description=__doc__)
    parser.add_argument("table", choices=("distances", "contacts"))
    parser.add_argument("--contacts", type=int, default=100, metavar="N", help="a size")
    parser.add_argument("--page", type=Path)
    asked = parser.parse_args()
    made = distances() if asked.table == "distances" else contacts(asked.contacts)
    if asked.page is not None:
        write_between(asked.page, f"code-{asked.table}", made)


if __name__ == "__main__":
    main()
