"""Random kits through the round trip: no answer is wrong, and the information limit explains whatever is not located.

TACTAPE_KITS=FIRST:LAST takes those kits instead of the first twelve, from each source as many contacts as `verify` takes in all.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import Fields
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.read.gerber_file import read_gerber
from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.make.kit import make_examined
from tactape_fab.solids.forms import read_form
from tactape_fab.solids.mesh.stl import read_stl
from tactape_fab.texture.code import CODE_NAMES, get_code
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.trip.positions import Source, copper_source, cpl_source, stl_source
from tactape_fab.verify.trip.round_trip import BARELY, EDGE, INSIDE, LIMITED, LOST, MISSED, NOISY, RIGHT, WRONG, full_trips
from tests.roundtrip.kits import OpenKit
from tests.thorough import some

KITS = os.environ.get("TACTAPE_KITS", "")
FIRST, LAST = (int(v) for v in KITS.split(":")) if KITS else (0, some(12))
COUNTS = (INSIDE, EDGE) if KITS else (8, 4)  # from each source
ONE_MISSED_OF = 10_000
"""The decoder may miss one of every so many contacts though their dots say enough; none of fewer."""
SOLID = ("block", "dome", "cone")


def drawn(number: int) -> Examined:
    """The first spec of a stream that is a legal tape within its design rules."""
    rng = np.random.default_rng([11, number])
    while True:
        code = str(rng.choice(CODE_NAMES))
        sectors, solid = get_code(code).sectors, rng.random() < 0.25
        sector, pitch_mm = int(rng.integers(sectors)), round(float(rng.uniform(1.0, 2.6)), 2)
        values: dict[str, Any] = {
            "sector": sector,
            "code": code,
            "pitch_mm": pitch_mm,
            "displacement_mm": round(pitch_mm * float(rng.uniform(0.12, 0.24)), 3),
            "size_mm": [round(float(rng.uniform(20.0, 200.0)), 1), round(float(rng.uniform(20.0, 100.0)), 1)],
            "part": str(rng.choice(SOLID) if solid else "r0201"),
            "tag": str(rng.choice(["strip", "none"])),
            "models": solid,
        }
        if rng.random() < 0.5:
            values["origin"] = rng.integers(0, 3000, 2).tolist()
        if values["tag"] == "strip" and not solid:
            values["tag_id"] = sector % 587
        try:
            examined = examine(TapeSpec.from_mapping(values))
        except SpecError:
            continue
        if not any(finding.blocks for finding in examined.findings):
            return examined


def sources_of(folder: Path, tape: Tape) -> list[Source]:
    """Parts as each of the written files has them."""
    kit = OpenKit(folder)
    if "cpl" not in kit.data:
        return [stl_source(tape, read_form(Fields(kit.manifest["solid"])), read_stl(kit.data["stl"]))]
    flashes = read_gerber(kit.data["copper-top"]).flash_xy_mm
    pads = kit.manifest["land_pattern"]["pads"]
    return [cpl_source(read_cpl(kit.data["cpl"])), copper_source(flashes, pads["offset_mm"], tape.part.rotation_deg)]


@pytest.fixture(scope="module")
def tally() -> Counter[str]:
    """What became of the contacts of all kits so far."""
    return Counter()


@pytest.mark.parametrize("number", range(FIRST, LAST))
def test_a_random_kit_comes_back(number: int, tally: Counter[str], tmp_path: Path) -> None:
    kit = make_examined(drawn(number), tmp_path / "kit")
    assert len([c for c in kit.checks if c.name.startswith("round trip") and c.passed]) == (1 if "stl" in kit.files else 2)
    tape = Tape.load(kit.path)
    sources = sources_of(kit.path, tape)
    for trip in full_trips(tape, sources, counts=(COUNTS[0] * len(sources), COUNTS[1] * len(sources))):
        counted = {name: trip.count(value) for name, value in _NAMES.items()}
        worst = float(np.nanmax(trip.error_um)) if counted["right"] else float("nan")
        print(f"\nkit {number} {tape.code} {tape.part.name} W {tape.pitch_mm} {trip.source}: {counted}, {worst:.0f} um")
        assert counted["wrong"] == 0, trip.poses[trip.outcome == WRONG]
        assert counted["lost"] == 0, (trip.poses[trip.outcome == LOST], trip.reasons)
        if counted["missed"]:
            print("missed:", trip.poses[trip.outcome == MISSED].tolist(), dict(trip.reasons))
        tally.update(counted)


def test_the_decoder_misses_hardly_any_that_say_enough(tally: Counter[str]) -> None:
    print(f"\n{LAST - FIRST} kits, {tally.total()} contacts: {dict(tally)}")
    assert tally["right"] > 0.5 * tally.total()
    assert tally["missed"] <= tally.total() // ONE_MISSED_OF


_NAMES = {"right": RIGHT, "limited": LIMITED, "noisy": NOISY, "barely": BARELY, "missed": MISSED, "lost": LOST, "wrong": WRONG}
