"""Tapes that may be touched: equal ones once, with the grid points of both, and the world that they are in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import AsBuilt, Tape
from tactape_fab.base.errors import SpecError
from tactape_fab.sense.decode.search.hypotheses import distinct, register
from tactape_fab.texture.board import Surface
from tests.measured import measured
from tests.tapes import tape_at


def cells(tape: Tape) -> set[tuple[int, int]]:
    return {(column, row) for column, row in tape.cells().tolist()}


def test_tapes_of_one_texture_are_one_with_the_grid_points_of_both() -> None:
    wide, tall = tape_at(7, (12, 6)), replace(tape_at(7, (8, 10)), name="tall")
    tall = replace(tall, omitted=np.array([(2, 8), (3, 2)]))
    (both,) = distinct([wide, tall])
    assert (both.name, both.columns, both.rows) == (wide.name, 12, 10)
    assert cells(both) == cells(wide) | cells(tall)
    for tape in (wide, tall):
        assert np.array_equal(both.symbols[: tape.rows, : tape.columns], tape.symbols)
    assert np.array_equal(distinct([tall, wide])[0].symbols, both.symbols)


def test_tapes_of_one_texture_that_lie_elsewhere_on_their_boards_are_known() -> None:
    tape, other = tape_at(7, (12, 6)), tape_at(8, (12, 6))
    elsewhere = replace(tape, board=replace(tape.board, texture_origin_mm=(3.0, 4.0)))

    def differ(*tapes: Tape) -> frozenset[int]:
        return register(tapes, unregistered_share=0.0).boards_differ

    assert differ(tape, replace(tape, name="copy"), other) == frozenset()
    assert differ(other, tape, elsewhere) == differ(other, tape, elsewhere, tape) == {1}
    part = Surface(source="part.stl", sha256="0" * 64, centre_mm=(0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), radius_mm=None)
    assert differ(tape, replace(tape, surface=part)) == {0}
    assert differ(replace(tape, surface=part), replace(elsewhere, surface=part)) == frozenset()  # neither has a board


def test_tapes_that_differ_in_anything_that_a_touch_shows_are_two() -> None:
    tape = tape_at(7, (12, 6))
    others = [replace(tape, pitch_mm=1.6), replace(tape, displacement_mm=0.3), replace(tape, directions=8), tape_at(8, (12, 6))]
    found = distinct([tape, *others, tape])
    assert [of.texture_key for of in found] == [of.texture_key for of in (tape, *others)]


def test_a_measured_tape_and_its_design_are_not_told_apart() -> None:
    known, _ = measured(tape_at(7, (12, 10)), 0.05)
    with pytest.raises(SpecError, match="a touch cannot tell which of them was measured"):
        distinct([known, replace(known, as_built=None)])
    assert len(distinct([known, known])) == 1
    assert known.as_built is not None
    again = AsBuilt.from_mapping(known.as_built.to_mapping())  # the file, read twice
    read_twice = [replace(known, as_built=AsBuilt.from_mapping(again.to_mapping())) for _ in range(2)]
    (one,) = distinct(read_twice)
    assert one.as_built is read_twice[0].as_built
    moved = replace(again, dx_mm=again.dx_mm + 0.01)
    with pytest.raises(SpecError, match="a touch cannot tell which of them was measured"):
        distinct([replace(known, as_built=again), replace(known, as_built=moved)])
    alone, beside = register([known], unregistered_share=0.0), register([known, tape_at(8, (12, 10))], unregistered_share=0.5)
    assert [of is None for of in alone.built] == [False] and [of is None for of in beside.built] == [False, True]


def test_tapes_that_an_answer_cannot_name_apart_are_refused() -> None:
    tape = tape_at(7, (12, 10))
    register([tape, replace(tape_at(8, (12, 10)), name=tape.name)], unregistered_share=0.0)  # told apart by their sectors
    register([tape, replace(tape, code="debruijn-4x4")], unregistered_share=0.0)  # as two codes have them by default
    other = replace(tape, code="touch-1", symbols=np.rot90(tape.symbols, 2).copy())
    with pytest.raises(
        SpecError, match=r"two tapes of code 'touch-1' and different texture have the name .* make one of them with another name"
    ):
        register([replace(tape, code="touch-1"), other], unregistered_share=0.0)


def test_the_world_is_open_where_strangers_have_a_share() -> None:
    for share, is_open in ((0.0, False), (1e-9, True), (0.5, True)):
        registry = register([tape_at(7, (12, 10))], unregistered_share=share)
        assert registry.unregistered_share == share and registry.built == ()
        assert (registry.families[0].unregistered is not None) == is_open
