"""`touch-2`: more bits between patches whose turn parts show, and between larger ones where they do not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tactape_fab import TapeSpec
from tactape_fab.kit.examine.tape import examine, profiles_of
from tactape_fab.texture.certify.certificate import certify
from tactape_fab.texture.frames import SymbolArray
from tactape_fab.texture.touch.design import HIGHER_RUNGS, RUNGS, design
from tactape_fab.texture.touch.patches import PATCHES, patch_distances
from tests.thorough import only_thorough
from tests.unit.texture.touch.test_design import APART, nearest, patches_of

SHAPE = (12, 16)


def distances(symbols: SymbolArray) -> list[tuple[int | None, tuple[int, int] | None]]:
    placed = np.ones(symbols.shape, dtype=bool)
    return [(found.bits, found.half_turns) for found in patch_distances(symbols, placed, half_turns=True)]


def test_distances_in_half_turns_are_those_of_an_enumeration() -> None:
    symbols = design(3, SHAPE, rungs=HIGHER_RUNGS, half_turns=True)
    for (name, mask), (bits, halves) in zip(PATCHES.items(), distances(symbols), strict=True):
        assert bits == nearest(symbols, symbols, mask)[0], name
        upright, turned = (np.array(patches_of(symbols, mask, turn)) for turn in (0, 2))
        same = APART[upright[:, None], upright[None]].sum(axis=2)[np.triu_indices(len(upright), 1)]
        half = APART[upright[:, None], turned[None]].sum(axis=2)[np.triu_indices(len(upright))]
        both = np.concatenate([same, half])
        assert halves == (both.min(), (both == both.min()).sum()), name


def test_a_small_tape_reaches_every_rung() -> None:
    found = distances(design(3, SHAPE, rungs=HIGHER_RUNGS, half_turns=True))
    assert all(halves is not None and halves[0] >= least for (_, halves), least in zip(found, (2, 3, 6, 9, 12), strict=True))
    assert all(bits is not None and bits >= least for (bits, _), least in zip(found, (1, 3, 5, 8, 11), strict=True))
    assert [bits for bits, _ in distances(design(3, SHAPE, rungs=HIGHER_RUNGS))] >= [1, 3, 6, 9, 12]


@only_thorough
def test_a_tape_of_the_usual_size_reaches_every_rung() -> None:
    found = distances(design(7, (32, 62), rungs=HIGHER_RUNGS, half_turns=True))
    assert [halves and halves[0] for _, halves in found] == [2, 3, 6, 9, 12]
    assert [bits for bits, _ in found] == [1, 3, 5, 8, 11]
    assert [bits for bits, _ in distances(design(7, (32, 62), rungs=HIGHER_RUNGS))] == [1, 3, 6, 9, 12]


@pytest.mark.parametrize(("values", "half_turns"), [({}, True), ({"part": "dome", "pitch_mm": 2.0}, False)])
def test_long_parts_are_designed_for_half_turns_and_round_ones_for_all(values: dict[str, Any], half_turns: bool) -> None:
    spec = TapeSpec(sector=5, code="touch-2", size_mm=(36.0, 24.0), tag="none", **values)
    tape = profiles_of(spec).plan(spec)
    assert np.array_equal(tape.symbols, design(5, tape.symbols.shape, rungs=HIGHER_RUNGS, half_turns=half_turns))
    assert all("half_turns" in patch for patch in certify(tape).to_mapping()["patches"])


def test_kits_of_touch_1_are_as_they_were() -> None:
    assert all(rung.quarter is None and rung.effort == 1 for rungs in RUNGS.values() for rung in rungs)
    tape = examine(TapeSpec(sector=5, code="touch-1", size_mm=(36.0, 24.0), tag="none", models=False)).layout.tape
    assert not any("half_turns" in patch for patch in certify(tape).to_mapping()["patches"])
