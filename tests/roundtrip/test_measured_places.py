"""The round trip of `verify` for measured places: contacts of parts where `as-built.json` has them, located by these."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tactape_fab import Kit, Tape
from tactape_fab.sense import Parts
from tactape_fab.sense.simulation.parts import built_parts_of, parts_of
from tactape_fab.texture.as_built import Film, manifest_digest
from tactape_fab.verify import verify_kit
from tactape_fab.verify.trip import round_trip
from tactape_fab.verify.trip.round_trip import MEASURED, check_measured
from tests.measured import measured
from tests.tapes import tape_at

SCATTERED, _ = measured(tape_at(7, (30, 24)), 0.05, missing=0.02, error_mm=0.0)


def stretched() -> Tape:
    assert SCATTERED.as_built is not None
    return replace(SCATTERED, as_built=replace(SCATTERED.as_built, film=Film(scale=(1.003, 0.998), shear=0.001, sigma=0.001)))


@pytest.mark.parametrize("tape", [SCATTERED, stretched()], ids=["scattered", "on a stretched film"])
def test_measured_places_locate_contacts_of_the_measured_parts(tape: Tape) -> None:
    check = check_measured(tape)
    assert check.passed and check.figure == MEASURED
    by_places, by_design = (float(part.split()[0]) for part in check.message.split("error p50 ")[1:])
    assert by_places < 3.0 and 4.0 * by_places < by_design


@pytest.mark.parametrize("sign", [(1.0, -1.0), (-1.0, 1.0), (0.0, 0.0)], ids=["y the other way", "x the other way", "not at all"])
def test_a_decoder_that_reads_them_another_way_is_seen(sign: tuple[float, float], monkeypatch: pytest.MonkeyPatch) -> None:
    def read(tape: Tape) -> Parts:
        there = parts_of(tape).taken(tape.built_parts().present)
        return replace(there, xy_mm=there.xy_mm + sign * (built_parts_of(tape).xy_mm - there.xy_mm))

    monkeypatch.setattr(round_trip, "built_parts_of", read)
    check = check_measured(SCATTERED)
    assert not check.passed and "they bring nothing; measure again, or delete as-built.json" in check.message


def test_the_whole_verify_has_the_line(flat_kit: Kit, copied: Callable[[Kit], Path]) -> None:
    folder = copied(flat_kit)
    tape, _ = measured(Tape.load(folder), 0.05, digest=manifest_digest(folder / "manifest.json"))
    assert tape.as_built is not None
    tape.as_built.write(folder)
    names = {quick: [check.name for check in verify_kit(folder, quick=quick).checks] for quick in (True, False)}
    assert "round trip from as-built" in names[False] and "round trip from as-built" not in names[True]
    assert all("as-built" in of for of in names.values())
