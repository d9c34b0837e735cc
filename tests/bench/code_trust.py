"""Contacts on codes with distance, drawn as dots: how many places are wrong, and how often other textures are located.

Run: python -m tests.bench.code_trust CODE [--contacts N] [--bare N] [--page docs/codes.md]

No image is drawn: dots are those that the detector once made of parts alike (`recorded`). They tell no direction of bodies, so
that all four turns stay open, which is the harder case for designs that promise less in quarter turns.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np

from tactape_fab import Localization, Localizer, Tape
from tactape_fab.sense import Parts, Scene
from tactape_fab.sense.decode.rule import MAX_P_FALSE
from tactape_fab.sense.simulation.dot_errors import Dots
from tactape_fab.texture.code import get_code
from tactape_fab.texture.frames import FloatArray
from tests.bench.dot_records import Edge, recorded
from tests.bench.false_tally import upper_bound
from tests.bench.localization_false import IMPOSTORS, MIRRORED, SCENES, Job, _poses
from tests.bench.localization_measure import Truth, is_right
from tests.bench.localization_rows import SECTOR, SEED, registered_tape
from tests.bench.marks import command, write_between
from tests.bench.recorded import draw_dots

CODES = ("trace-22", "touch-2")
PART = 1000
HARDER: dict[str, tuple[Scene, Edge]] = {
    "5x5 mm": (Scene(contact_mm=(5.0, 5.0)), "none"),
    "8x8 mm, 30 % missing": (Scene(contact_mm=(8.0, 8.0), missing=0.3), "none"),
    "7x7 mm, placement 0.05 mm": (Scene(contact_mm=(7.0, 7.0), placement_mm=0.05), "none"),
}
CONTACTS = {**SCENES, **HARDER}
SECTORS = (SECTOR, 0, 8, 100, 255)
"""Of the registered tape, and of others that are touched."""


class Posed(NamedTuple):
    """The truth of a contact."""

    position_mm: FloatArray
    theta_deg: float


@cache
def tape_of_code(code: str, sector: int = SECTOR) -> Tape:
    """The benchmark's own tape, as a code and sector have it."""
    like, of = registered_tape(), get_code(code)
    origin = of.default_origin(sector)
    symbols = of.symbols(sector, origin, like.symbols.shape, (), 4, half_turns=True)
    return replace(like, name=f"{code}, sector {sector}", code=code, sector=sector, origin=origin, symbols=symbols, tag=None)


def contacts(
    subject: str, tape: Tape, *, parts: Callable[[Tape, int], Parts] | None = None, mirrored: bool = False
) -> Iterator[tuple[Posed, Dots]]:
    """Contacts of all kinds on a tape, or on its parts moved elsewhere; without end."""
    part = 0
    while True:
        drawn = []
        for contact, (scene, edge) in CONTACTS.items():
            rng = np.random.default_rng([SEED, crc32(f"{subject}, {contact}".encode()), part])
            if contact in SCENES:
                poses = _poses(tape, Job(kind="", subject=subject, level="dots"), contact, rng)
            else:
                poses = _uniform(tape, rng)
            made = None if parts is None else parts(tape, int(rng.integers(2**62)))
            drawn.append((poses, draw_dots(tape, poses, recorded(scene, edge), rng, parts=made, mirrored=mirrored)))
        for k in range(min(len(dots) for _, dots in drawn)):
            for poses, dots in drawn:
                yield Posed(poses[k, :2], float(poses[k, 2])), dots[k]
        part += 1


def _uniform(tape: Tape, rng: np.random.Generator) -> FloatArray:
    """Poses (n, 3) of contacts wholly on a tape."""
    high = np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm
    count = -(-PART // len(SCENES))
    at = 4.0 + rng.random((count, 2)) * (high - 8.0)
    return np.column_stack([at, rng.uniform(-180.0, 180.0, count)])


@dataclass(slots=True, kw_only=True)
class Count:
    """What was said of some contacts: how many were located, and of these the wrong ones, said (sum of p_false) and happened."""

    contacts: int = 0
    located: int = 0
    wrong: int = 0
    said: float = 0.0

    def add(self, fix: Localization, right: bool) -> None:
        self.contacts += 1
        if fix.located:
            self.located += 1
            self.wrong += not right
            self.said += fix.p_false or 0.0

    def merge(self, other: Count) -> None:
        """Add another count."""
        self.contacts, self.located = self.contacts + other.contacts, self.located + other.located
        self.wrong, self.said = self.wrong + other.wrong, self.said + other.said


def own(code: str, frames: int, localizer: Localizer) -> Count:
    """Contacts on the registered tape."""
    tape, found = tape_of_code(code), Count()
    for truth, dots in islice(contacts(f"{code}, own", tape), frames):
        fix = localizer.locate_dots(dots.xy_px, dots.weights)
        found.add(fix, right_place(fix, truth, tape))
    return found


def foreign(code: str, subject: str, frames: int, localizer: Localizer) -> Count:
    """Contacts on what is not the registered tape, or in the plane of no sector; every one located is wrong."""
    found = Count()
    if subject == OTHER_SECTORS:
        streams = [contacts(f"{code}, {sector}", tape_of_code(code, sector)) for sector in SECTORS[1:]]
    elif subject == OTHER_CODE:
        streams = [contacts(f"{code}, {subject}", tape_of_code(next(other for other in CODES if other != code)))]
    else:
        made, tape = IMPOSTORS.get(subject), tape_of_code(code)
        streams = [contacts(f"{code}, {subject}", tape, parts=made, mirrored=subject == MIRRORED)]
    for k in range(frames):
        _, dots = next(streams[k % len(streams)])
        found.add(localizer.locate_dots(dots.xy_px, dots.weights), right=False)
    return found


OWN, OTHER_SECTORS, OTHER_CODE, NO_MANIFEST = (
    "the tape itself",
    "other sectors",
    "a tape of the other code",
    "nothing but the code",
)
SUBJECTS = (*IMPOSTORS, MIRRORED, OTHER_CODE, OTHER_SECTORS)


def right_place(fix: Localization, truth: Truth, tape: Tape) -> bool:
    """Whether an answer names the place; without a tape it is one in the plane, whose mm are the tape's own from its origin."""
    if not fix.located or fix.tape is not None:
        return is_right(fix, truth, tape)
    assert fix.plane_mm is not None
    off = np.subtract(fix.plane_mm, np.multiply(tape.origin, tape.pitch_mm)) - truth.position_mm
    return fix.sector == tape.sector and float(np.hypot(*off)) < tape.pitch_mm / 2


def localizer_of(code: str, known: str) -> Localizer:
    """Of the registered tape in an open world, or of the code alone."""
    tape = tape_of_code(code)
    if known == NO_MANIFEST:
        return Localizer.from_code(code, pitch_mm=tape.pitch_mm, displacement_mm=tape.displacement_mm)
    return Localizer([tape])


def table(code: str, frames: int, bare: int) -> str:
    """Wrong answers of own and of foreign contacts, said and happened."""
    head = ("known", "touched", "contacts", "located", "wrong", "rate below", "wrong, said")
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for known, count in (("its manifest", frames), *(((NO_MANIFEST, bare),) if bare else ())):
        localizer = localizer_of(code, known)
        lines.append(_row(known, OWN, own(code, count, localizer)))
        print(lines[-1], flush=True)
        subjects = [subject for subject in SUBJECTS if known != NO_MANIFEST or subject != OTHER_SECTORS]
        whole = Count()
        for subject in subjects:  # in the plane other sectors are no strangers
            found = foreign(code, subject, -(-count // len(subjects)), localizer)
            whole.merge(found)
            lines.append(_row(known, subject, found))
            print(lines[-1], flush=True)
        lines.append(_row(known, "all of these but itself", whole))
    said = f"One tape of 62x32 points, contacts of 3 to 11 mm and over edges, `--max-p-false` {MAX_P_FALSE:g}"
    return "\n".join([*lines, "", f"{said}; {command('tests.bench.code_trust')}.", ""])


def _row(known: str, touched: str, found: Count) -> str:
    said = f"{found.said:.2g}" if touched == OWN else f"≤ {MAX_P_FALSE * found.contacts:.2g}"
    below = f"{upper_bound(found.wrong, found.contacts):.1e}"
    cells = (known, touched, f"{found.contacts:,}", f"{found.located:,}", str(found.wrong), below, said)
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Count."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.code_trust", description=__doc__)
    parser.add_argument("code", choices=CODES)
    parser.add_argument("--contacts", type=int, default=100_000, metavar="N", help="on the tape; as many on others together")
    parser.add_argument("--bare", type=int, default=0, metavar="N", help="of trace-22 without a manifest, 120 ms each")
    parser.add_argument("--page", type=Path)
    asked = parser.parse_args()
    made = table(asked.code, asked.contacts, asked.bare)
    if asked.page is not None:
        write_between(asked.page, f"trust-{asked.code}", made)


if __name__ == "__main__":
    main()
