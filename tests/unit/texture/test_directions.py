"""Directions by their geometry: bits, Gray codes, order, distances; and that manifests and their schema know the same ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactape_fab import Tape, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.texture.code import ALL_CODE_NAMES
from tactape_fab.texture.directions import DIRECTIONS, USUAL_DIRECTIONS, Directions
from tactape_fab.texture.frames import DIRECTIONS_XY
from tactape_fab.texture.windows import bit_count

SCHEMA = json.loads((Path(__file__).parents[3] / "docs" / "manifest.schema.json").read_text(encoding="utf-8"))

every_count = pytest.mark.parametrize(("count", "directions"), DIRECTIONS.items(), ids=map(str, DIRECTIONS))


@every_count
def test_symbols_of_so_many_directions(count: int, directions: Directions) -> None:
    assert directions.count == count == len(directions.letters) == len(directions.xy) == 2**directions.bits
    assert directions.letters == "NWESnwes"[:count]
    assert np.allclose(np.linalg.norm(directions.xy, axis=1), 1.0)
    assert sorted(directions.gray_codes.tolist()) == sorted(directions.clockwise.tolist()) == list(range(count))


@every_count
def test_clockwise_from_east_each_next_symbol_differs_in_one_bit(count: int, directions: Directions) -> None:
    order = directions.clockwise
    angles = np.degrees(np.arctan2(*DIRECTIONS_XY[order].T[::-1]))  # y is down, so that angles grow clockwise as they are seen
    assert np.allclose(angles % 360.0, np.arange(count) * 360.0 / count)
    codes = directions.gray_codes[order]
    assert bit_count(codes ^ np.roll(codes, 1)).tolist() == [1] * count


@every_count
def test_neighbouring_places_are_as_near_as_is_said(count: int, directions: Directions) -> None:
    xy = directions.xy
    apart = np.linalg.norm(xy[:, None] - xy, axis=2)[~np.eye(count, dtype=bool)].min()
    assert directions.spacing * np.sqrt(2.0) == pytest.approx(apart, rel=1e-12)
    assert directions.reads_within == 1.0 / np.ceil(2.0 / apart) < apart / 2.0  # the largest 1/n that is less


@every_count
@given(angle=st.floats(0.0, 6.3), share=st.floats(0.0, 0.999))
def test_what_is_read_within_the_limit_is_nearest_to_its_own_place(
    count: int, directions: Directions, angle: float, share: float
) -> None:
    off = share * directions.reads_within * np.array([np.cos(angle), np.sin(angle)])
    distance = np.linalg.norm(directions.xy[:, None] + off - directions.xy, axis=2)
    assert distance.argmin(axis=1).tolist() == list(range(count))


@every_count
def test_tables_cannot_be_changed(count: int, directions: Directions) -> None:
    for table in (directions.gray_codes, directions.clockwise):
        with pytest.raises(ValueError, match="read-only"):
            table[0] = 1


def test_how_far_parts_move_towards_a_diagonal() -> None:
    assert [of.reach_diagonal for of in DIRECTIONS.values()] == [1.0, float(np.sqrt(2.0))]


def test_the_paper_s_four_are_the_usual_ones() -> None:
    assert USUAL_DIRECTIONS == 4 and [count for count, of in DIRECTIONS.items() if of.usual] == [4]


def test_the_schema_knows_the_same_directions_and_codes() -> None:
    known = SCHEMA["$defs"]["tape"]["properties"]
    assert known["directions"]["enum"] == list(DIRECTIONS)
    assert known["code"]["enum"] == list(ALL_CODE_NAMES)


def test_a_manifest_may_say_four_and_is_written_without() -> None:
    tape = examine(TapeSpec(sector=3, size_mm=(20.0, 20.0), models=False)).tape
    mapping = tape.to_mapping()
    assert "directions" not in mapping
    assert Tape.from_mapping({**mapping, "directions": 4}).to_mapping() == mapping
