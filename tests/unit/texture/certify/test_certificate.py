"""Certificates against a comparison of every window with every other, written here and for nothing but to be simple."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest

from tactape_fab import Kit, Tape, TapeSpec, default_origin
from tactape_fab.kit.examine.tape import examine
from tactape_fab.texture.certify import nearest
from tactape_fab.texture.certify.certificate import (
    LISTED,
    SIDES,
    Certificate,
    Closest,
    certify,
    closest,
    nearest_distances,
    pair_words,
    proven_between,
    window_words,
)
from tactape_fab.texture.certify.nearest import Pairs, Search, near_pairs, plan_search
from tactape_fab.texture.certify.pairs import NO_WINDOWS, across, conflicts
from tactape_fab.texture.code import CODE_NAMES, get_code, get_plane
from tactape_fab.texture.frames import SymbolArray, symbols_to_rows
from tactape_fab.texture.plane import encode
from tactape_fab.texture.windows import symbol_distance, windows_of
from tests.tapes import tape_at

TURN = {"N": "W", "W": "S", "S": "E", "E": "N"}
"""A quarter turn counter-clockwise, seen from above."""

Text = tuple[str, ...]


def turned(window: Text) -> Text:
    """Column by column from the right: what was on the right is now on top."""
    side = len(window)
    return tuple("".join(TURN[window[r][side - 1 - c]] for r in range(side)) for c in range(side))


def cut(tape: Tape, side: int) -> dict[tuple[int, int], Text]:
    """Whole windows by row and column of their upper left point."""
    letters = symbols_to_rows(tape.symbols)
    gone = {(row, column) for column, row in tape.omitted.tolist()}
    found = {}
    for row, column in product(range(tape.rows - side + 1), range(tape.columns - side + 1)):
        if not any((row + r, column + c) in gone for r, c in product(range(side), range(side))):
            found[row, column] = tuple(letters[row + r][column : column + side] for r in range(side))
    return found


def differing(a: Text, b: Text) -> int:
    return sum(x != y for row_a, row_b in zip(a, b, strict=True) for x, y in zip(row_a, row_b, strict=True))


def turns_of(window: Text) -> list[Text]:
    turns = [window]
    for _ in range(3):
        turns.append(turned(turns[-1]))
    return turns


def every_pair(tape: Tape, side: int) -> Iterator[tuple[int, tuple[int, int], tuple[int, int], int]]:
    """Distance, both windows and the turn of the second: each pair once, whichever of its windows is turned."""
    windows = cut(tape, side)
    for a, b in product(windows, windows):
        for turn, seen in enumerate(turns_of(windows[b])):
            if (turn in (0, 2) and a < b) or (turn == 2 and a == b) or turn == 1:
                yield differing(windows[a], seen), a, b, turn


def brute(tape: Tape, side: int) -> tuple[int | None, list[tuple[tuple[int, int], tuple[int, int], int]]]:
    """The least distance, and every pair at it in order."""
    found = sorted(every_pair(tape, side))
    return (found[0][0], [(a, b, turn) for d, a, b, turn in found if d == found[0][0]]) if found else (None, [])


def listed(size: Closest) -> list[tuple[tuple[int, int], tuple[int, int], int]]:
    rows = zip(size.first_rc.tolist(), size.second_rc.tolist(), size.turn.tolist(), strict=True)
    return [((a[0], a[1]), (b[0], b[1]), turn) for a, b, turn in rows]


def small_tape(seed: int) -> Tape:
    """A tape of 4 to 9 columns and rows anywhere in one of the codes, a point here and there without a part."""
    random = np.random.default_rng(seed)
    code = get_plane(CODE_NAMES[seed % 3])
    rows, columns = (int(v) for v in random.integers(4, 10, 2))
    origin = tuple(int(v) for v in random.integers(0, min(code.range, 5000) - 10, 2))
    tape = tape_at(int(random.integers(code.sectors)), (columns, rows), code=code.name, origin=(origin[0], origin[1]))
    gone = np.argwhere(random.random((columns, rows)) < (0.02 if seed % 2 else 0.0))
    return replace(tape, omitted=gone[np.lexsort(gone.T)].astype(np.int64))


@pytest.mark.parametrize("seed", range(50))
def test_certificate_is_what_comparing_every_pair_says(seed: int) -> None:
    tape = small_tape(seed)
    certificate = certify(tape)
    for side, size in zip(SIDES, certificate.sizes, strict=True):
        distance, pairs = brute(tape, side)
        assert size.windows == len(cut(tape, side))
        assert (size.distance, size.pairs) == (distance, len(pairs))
        assert listed(size) == pairs[:LISTED]
        if distance is not None:
            assert size.detects == max(distance - 1, 0)
            assert size.corrects == max((distance - 1) // 2, 0)


@pytest.mark.parametrize("seed", range(6))
def test_smallest_contacts_are_the_smallest_squares(seed: int) -> None:
    tape = small_tape(seed)
    certificate = certify(tape)
    distance = {side: brute(tape, side)[0] for side in range(3, 9)}
    for least, found in ((1, certificate.distinct_side), (3, certificate.correcting_side)):
        enough = [side for side, d in distance.items() if d is not None and d >= least]
        assert found == (min(enough) if enough else None)


@pytest.mark.parametrize("side", [4, 5, 6])
def test_windows_may_differ_in_every_symbol(side: int) -> None:
    tape = replace(tape_at(7, (side, side)), symbols=np.zeros((side, side), dtype=np.uint8))
    assert closest(tape, side).distance == side**2  # from itself, turned


@pytest.mark.parametrize("side", [4, 5])
def test_it_does_not_matter_in_what_portions_pairs_come(side: int, monkeypatch: pytest.MonkeyPatch) -> None:
    tape = tape_at(11, (12, 10))
    whole = closest(tape, side)

    def one_by_one(*arguments: Any, **named: Any) -> Iterator[Pairs]:
        for some in near_pairs(*arguments, **named):
            for i in range(-1, len(some.first)):
                part = slice(max(i, 0), i + 1)
                rows = {name: getattr(some, name)[part] for name in ("first", "second", "turn", "distance")}
                yield Pairs(**rows)

    monkeypatch.setattr("tactape_fab.texture.certify.certificate.near_pairs", one_by_one)
    portioned = closest(tape, side)
    assert (portioned.distance, portioned.pairs, listed(portioned)) == (whole.distance, whole.pairs, listed(whole))


@pytest.mark.parametrize("side", [4, 5, 8])
def test_many_windows_are_searched_as_if_each_were_compared_with_each(side: int) -> None:
    """So many that a search begins with the nearest; windows of 8 x 8 differ in a third of their symbols or more."""
    tape = tape_at(7, (36, 34))
    windows = windows_of(tape.symbols, tape.placed, side)
    rows = []
    for i, turn in product(range(windows.count), range(3)):
        first = i if turn == 2 else i + 1 if turn == 0 else 0
        own, others = (tuple(word[0, i : i + 1] for word in windows.words), tuple(word[turn, first:] for word in windows.words))
        apart = symbol_distance(own, others)
        rows.append(np.column_stack([apart, np.full(len(apart), i), first + np.arange(len(apart)), np.full(len(apart), turn)]))
    every = np.concatenate(rows)
    nearest = every[every[:, 0] == every[:, 0].min()]
    found = closest(tape, side)
    assert (found.distance, found.pairs) == (nearest[0, 0], len(nearest))
    expected = sorted((*windows.corner_rc[a], *windows.corner_rc[b], turn) for _, a, b, turn in nearest.tolist())
    assert [(*a, *b, turn) for a, b, turn in listed(found)] == expected[:LISTED]
    assert side < 8 or nearest[0, 0] > 2 * side


def test_without_windows_there_are_no_pairs() -> None:
    none = closest(tape_at(7, (3, 9)), 4)
    assert (none.windows, none.distance, none.pairs) == (0, None, 0)
    assert none.first_rc.shape == none.second_rc.shape == (0, 2) and none.turn.shape == (0,)


def test_a_window_is_named_by_its_upper_left_part() -> None:
    tape = replace(tape_at(7, (9, 6)), omitted=np.array([(2, 0), (1, 3)]))
    for (column, row), name in zip(tape.cells().tolist(), tape.designators(), strict=True):
        assert window_words(tape, row, column) == f"{name} (column {column}, row {row})"


def test_a_contact_of_eight_points_may_be_the_smallest() -> None:
    symbols = np.zeros((8, 8), dtype=np.uint8)
    symbols[0, 0] = 1
    assert certify(replace(tape_at(7, (8, 8)), symbols=symbols)).distinct_side == 8


def test_a_contact_of_three_points_may_be_as_good_as_one_of_four() -> None:
    symbols = np.random.default_rng(0).integers(0, 4, (4, 9)).astype(np.uint8)
    symbols[:, 5:] = symbols[:, :4]
    symbols[1, 6] = (symbols[1, 6] + 1) % 4
    tape = replace(tape_at(7, (9, 4)), symbols=symbols)
    assert closest(tape, 3).distance == closest(tape, 4).distance == 1
    assert certify(tape).distinct_side == 3
    assert certify(tape_at(7, (12, 3))).distinct_side is None  # no window of 4x4


@pytest.mark.parametrize(("side", "most"), [(3, 1), (4, 2), (4, 3), (5, 4), (6, 4), (6, 8), (8, 4)])
def test_every_search_finds_each_near_pair_once(side: int, most: int) -> None:
    tape = tape_at(3, (9, 9), origin=(0, 0))
    expected = sorted((d, a, b, t) for d, a, b, t in every_pair(tape, side) if d <= most)
    windows = windows_of(tape.symbols, tape.placed, side)
    for parts in range(most + 1, min(side * side, most + 4) + 1):
        dealt = tuple(tuple(int(c) for c in part) for part in np.array_split(np.arange(side * side), parts))
        search = Search(parts=dealt, agreeing=parts - most, most=most)
        found = [row for some in near_pairs(windows.words, search) for row in rows_of(some, windows.corner_rc.tolist())]
        assert sorted(found) == expected, parts


def rows_of(pairs: Pairs, corner_rc: list[list[int]]) -> list[tuple[int, tuple[int, int], tuple[int, int], int]]:
    rows = zip(pairs.distance.tolist(), pairs.first.tolist(), pairs.second.tolist(), pairs.turn.tolist(), strict=True)
    return [(d, (corner_rc[a][0], corner_rc[a][1]), (corner_rc[b][0], corner_rc[b][1]), t) for d, a, b, t in rows]


def test_plans_never_look_less_far_than_asked() -> None:
    for side, count, most in product((3, 4, 6, 8), (1, 60, 1711, 400_000), (0, 1, 2, 4, 9)):
        search = plan_search(side, count, most)
        assert search.most >= min(most, side * side)
        assert len(search.parts) - search.agreeing >= min(most, 1)
        assert sorted(cell for part in search.parts for cell in part) == list(range(side * side))


def test_turning_a_window_four_times_gives_it_back() -> None:
    tape = tape_at(7, (9, 7))
    windows = windows_of(tape.symbols, tape.placed, 5, turns=4)
    texts = cut(tape, 5)
    for i, (row, column) in enumerate(windows.corner_rc.tolist()):
        for k, text in enumerate(turns_of(texts[row, column])):
            symbols = np.array([["NWES".index(letter) for letter in line] for line in text], dtype=np.uint8)
            alone = windows_of(symbols, np.ones((5, 5), dtype=bool), 5, turns=1)
            assert all(word[k, i] == single[0, 0] for word, single in zip(windows.words, alone.words, strict=True))


def test_a_window_that_is_its_own_half_turn_leaves_the_angle_open() -> None:
    half = [["N", "E", "W", "S"], ["E", "S", "N", "W"]]
    opposite = {"N": "S", "S": "N", "E": "W", "W": "E"}
    rows = half + [[opposite[x] for x in reversed(row)] for row in reversed(half)]
    symbols = np.array([["NWES".index(x) for x in row] for row in rows], dtype=np.uint8)
    tape = replace(tape_at(0, (4, 4)), symbols=symbols)
    size = closest(tape, 4)
    assert (size.windows, size.distance, size.pairs) == (1, 0, 1)
    assert listed(size) == [((0, 0), (0, 0), 2)]
    assert pair_words(tape, size, 0) == "R1 (column 0, row 0) and R1 (column 0, row 0) turned by 180 deg"


def test_distance_counts_symbols_and_not_bits() -> None:
    word = (np.array([0], dtype=np.uint64),)
    for other, symbols in ((1, 1), (2, 1), (3, 1), (0b1111, 2), (0b0110, 2), (2**64 - 1, 32)):
        assert symbol_distance(word, (np.array([other], dtype=np.uint64),)).tolist() == [symbols]


def test_nearest_distance_of_each_window() -> None:
    tape = tape_at(9, (12, 10), origin=(0, 0))
    corner_rc, distance = nearest_distances(tape, 4, 3)
    expected = dict.fromkeys(cut(tape, 4), 4)
    for d, a, b, _ in every_pair(tape, 4):
        expected[a], expected[b] = min(expected[a], d), min(expected[b], d)
    assert {(r, c): d for (r, c), d in zip(corner_rc.tolist(), distance.tolist(), strict=True)} == expected


# Several tapes


def test_tapes_are_as_far_apart_as_comparing_every_pair_says() -> None:
    assert_as_brute([small_tape(s) for s in range(0, 36, 3)], SIDES)


def test_tapes_that_show_parts_of_each_other_turned_are_as_near_as_comparing_every_pair_says() -> None:
    whole = tape_at(7, (7, 6)).symbols
    once, twice = (
        replace(tape_at(7, (len(s[0]), len(s))), symbols=s) for s in (turned_symbols(whole, 1), turned_symbols(whole, 2))
    )
    changed = once.symbols.copy()
    changed[2, 2] ^= 1
    strange = tape_at(9, (5, 5))
    tapes = [strange, replace(once, symbols=changed), twice, replace(twice, symbols=whole), once, tape_at(3, (3, 9)), strange]
    assert_as_brute(tapes, (4, 5))


def turned_symbols(symbols: SymbolArray, quarters: int) -> SymbolArray:
    """A whole texture turned counter-clockwise."""
    rows = symbols_to_rows(np.rot90(symbols, quarters))
    for _ in range(quarters):
        rows = ["".join(TURN[letter] for letter in row) for row in rows]
    return np.array([["NWES".index(letter) for letter in row] for row in rows], dtype=np.uint8)


def assert_as_brute(tapes: Sequence[Tape], sides: Sequence[int]) -> None:
    """Distances between tapes are those of every window of one with every window of another in every turn."""
    texts = {side: [cut(t, side) for t in tapes] for side in sides}
    for side in sides:
        found = across(tapes, side)
        pairs = []
        for a, b in product(range(len(tapes)), repeat=2):
            distances = [
                (differing(w, seen), (a, *at), (b, *bt), turn)
                for (at, w), (bt, v) in product(texts[side][a].items(), texts[side][b].items())
                for turn, seen in enumerate(turns_of(v))
            ]
            least = min((d[0] for d in distances), default=NO_WINDOWS)
            wanted = NO_WINDOWS if a == b or not distances else min(least, 5)
            assert found.matrix[a, b] == wanted
            assert found.rows()[a][b] == (None if wanted == NO_WINDOWS else wanted)
            assert found.shared[a, b] == (0 if a == b else sum(d[0] == 0 for d in distances))
            pairs += distances if a < b else []
        least = min(d[0] for d in pairs)
        nearest = sorted(p[1:] for p in pairs if p[0] == least) if least < 5 else []
        assert (found.distance, found.pairs) == (min(least, 5), len(nearest))
        rows = zip(found.first.tolist(), found.second.tolist(), found.turn.tolist(), strict=True)
        assert [(tuple(a), tuple(b), t) for a, b, t in rows] == nearest[:LISTED]


def test_eight_directions_are_told_apart_beside_tapes_of_four() -> None:
    four = tape_at(7, (5, 5))
    eight = replace(four, directions=8, symbols=four.symbols + 4)
    assert across([four, eight], 4).distance == across([eight, four], 4).distance == 5


def test_one_tape_with_windows_is_at_no_distance() -> None:
    found = across([tape_at(7, (5, 5)), tape_at(7, (3, 9))], 4)
    assert (found.distance, found.pairs) == (None, 0)


def test_tapes_of_a_code_without_a_plane_conflict_where_their_symbols_are_the_same() -> None:
    one, other = (examine(TapeSpec(sector=s, code="touch-1", size_mm=(30.0, 20.0), tag="none")).layout.tape for s in (3, 4))
    tapes = [one, replace(other, sector=3), replace(one, name="copy")]
    found = conflicts(tapes, ["one", "other", "copy"], across(tapes, 4))
    assert [(c.kind, c.tapes) for c in found if c.kind != "windows"] == [("same-tape", (0, 2))]


def test_conflicts_name_what_two_tapes_share() -> None:
    base = tape_at(7, (20, 12), origin=(100, 200))
    tapes = [
        base,
        replace(base, name="copy"),
        tape_at(7, (20, 12), origin=(115, 205), name="moved"),
        tape_at(7, (20, 12), origin=(120, 200), name="beside"),
        tape_at(8, (20, 12), origin=(100, 200), name="other"),
    ]
    windows = across(tapes, 4)
    found = conflicts(tapes, [t.name for t in tapes], windows)
    kinds = {(c.kind, c.tapes) for c in found}
    assert ("same-tape", (0, 1)) in kinds
    assert {t for k, t in kinds if k == "overlap"} == {(0, 2), (1, 2), (2, 3)}
    assert windows.shared[0, 1] >= 17 * 9
    assert windows.shared[0, 2] >= 2 * 4
    assert next(c for c in found if c.tapes == (0, 2)).message.endswith("and 5 x 7 grid points of it at 115,205 are on both")
    assert ("windows", (0, 2)) in kinds


def test_a_corner_and_a_window_in_common_are_conflicts_after_those_of_one_tape() -> None:
    tapes = [tape_at(7, (6, 5), origin=(100, 200), name=name) for name in ("base", "copy")]
    corner = tape_at(7, (6, 5), origin=(95, 196), name="corner")
    window = tape_at(7, (4, 4), origin=(102, 201), name="window")
    tapes = [corner, *tapes, window]
    found = conflicts(tapes, [t.name for t in tapes], across(tapes, 4))
    in_plane = [(c.kind, c.tapes) for c in found if c.kind in ("same-tape", "overlap")]
    assert in_plane == [("same-tape", (1, 2)), *(("overlap", pair) for pair in ((0, 1), (0, 2), (1, 3), (2, 3)))]
    said = {c.tapes: c.message for c in found if c.kind != "windows"}
    assert "at origin 100,200: they are the same tape" in said[1, 2]
    assert "1 x 1 grid points of it at 100,200 are" in said[0, 1]
    shared = {c.tapes: c.message for c in found if c.kind == "windows"}
    assert "1 pair of 4x4 windows" in shared[1, 3] and "6 pairs of 4x4" in shared[1, 2] and (0, 1) not in shared


@pytest.mark.parametrize("seed", range(4))
def test_pairs_come_in_portions_as_full_as_may_be(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nearest, "_CHUNK", 10)
    random = np.random.default_rng(seed)
    ends = np.repeat(lengths := np.cumsum(random.integers(1, 14, 9)), np.diff(lengths, prepend=0))
    starts = np.flatnonzero(random.random(len(ends)) < 0.8)
    portions = [list(zip(a.tolist(), b.tolist(), strict=True)) for a, b in nearest._within_runs(starts, ends[starts])]
    every = [[(a, b) for b in range(a + 1, ends[a])] for a in starts.tolist()]
    assert [pair for portion in portions for pair in portion] == [pair for of in every for pair in of]
    for portion, following in pairwise(portions):
        of_next = sum(a == following[0][0] for a, _ in following)
        assert len(portion) + of_next > 10 and (len(portion) <= 10 or len({a for a, _ in portion}) == 1)
    assert all(portions)


def test_windows_asked_for_are_compared_with_those_after_them_alone() -> None:
    tape = tape_at(7, (7, 6))
    windows = windows_of(tape.symbols, tape.placed, 4, turns=4)
    for queries in (1, 5, windows.count - 1):
        search = plan_search(4, windows.count, 16)
        found = []
        for some in near_pairs(windows.words, search, queries=queries):
            found += list(zip(some.first.tolist(), some.second.tolist(), some.turn.tolist(), strict=True))
        assert sorted(found) == [(a, b, t) for a in range(queries) for b in range(queries, windows.count) for t in range(4)]


def test_nearest_windows_of_the_default_origins() -> None:
    """A quarter of all default origins, and the sectors whose windows are nearest; tests/bench has the whole table."""
    tapes = [tape_at(s, (62, 32)) for s in sorted({*range(0, 256, 4), 197, 253})]
    nearest = {}
    for side in (5, 6):
        found = across(tapes, side)
        (a, *at), (b, *bt) = found.first[0].tolist(), found.second[0].tolist()
        nearest[side] = (found.distance, found.pairs, tapes[a].sector, at, tapes[b].sector, bt, int(found.turn[0]))
        texts = cut(tapes[a], side)[at[0], at[1]], turns_of(cut(tapes[b], side)[bt[0], bt[1]])[found.turn[0]]
        assert differing(*texts) == found.distance
    assert nearest == {5: (1, 1, 4, [24, 46], 253, [17, 4], 1), 6: (3, 1, 168, [24, 16], 197, [1, 43], 0)}
    assert not [c for c in conflicts(tapes, [t.name for t in tapes], found) if c.kind != "windows"]


def test_24_sectors_have_windows_that_read_the_same_at_origin_0_0() -> None:
    found = [closest(tape_at(sector, (62, 32), origin=(0, 0)), 4) for sector in range(256)]
    alike = [size for size in found if size.distance == 0]
    assert len(alike) == 24
    assert {turn for size in alike for turn in size.turn.tolist()} == {2}


# The kit's file


def test_the_file_has_three_sizes_and_twenty_pairs_of_each() -> None:
    even = replace(tape_at(7, (9, 9)), symbols=np.zeros((9, 9), dtype=np.uint8))
    content = certify(even).to_mapping()
    assert [size["side"] for size in content["windows"]] == [4, 5, 6]
    assert [len(size["nearest"]) for size in content["windows"]] == [20, 20, 20]
    assert "patches" not in content


@pytest.mark.parametrize(
    ("distance", "detects", "corrects"), [(None, None, None), (0, 0, 0), (1, 0, 0), (2, 1, 0), (3, 2, 1), (5, 4, 2)]
)
def test_a_distance_detects_one_less_and_corrects_half_of_that(
    distance: int | None, detects: int | None, corrects: int | None
) -> None:
    size = replace(closest(tape_at(7, (5, 5)), 4), distance=distance)
    assert (size.detects, size.corrects) == (detects, corrects)


def test_what_a_code_proves_holds_between_its_sectors_alone() -> None:
    one, other = (tape_at(sector, (6, 6), code="trace-22") for sector in (3, 4))
    proven = dict(get_code("trace-22").proven)
    assert proven and proven_between([one, other]) == proven_between([one]) == proven
    assert proven_between([one, replace(one, name="copy")]) == proven_between([one, tape_at(5, (6, 6))]) == {}
    assert {patch["shape"] for patch in certify(one).to_mapping()["patches"]} >= set(proven)


def test_certificate_of_a_kit_is_its_tape_s(small_kit: Kit) -> None:
    content = json.loads((small_kit.path / small_kit.files["certificate"]).read_bytes())
    assert content == certify(small_kit.tape).to_mapping()
    assert content["parts"] == small_kit.tape.part_count
    designators = dict(zip(map(tuple, small_kit.tape.cells().tolist()), small_kit.tape.designators(), strict=True))
    for size in content["windows"]:
        for pair in size["nearest"]:
            assert all(w["designator"] == designators[tuple(w["cell"])] for w in pair["windows"])


def test_symbols_of_the_default_tape_hold_what_its_certificate_says(default_kit: Kit) -> None:
    certificate: Certificate = certify(default_kit.tape)
    code = get_plane("microdots-4x4")
    symbols = encode(code, 7, default_origin("microdots-4x4", 7), (32, 62))
    assert (symbols == default_kit.tape.symbols).all()
    for size in certificate.sizes:
        texts = cut(default_kit.tape, size.side)
        for a, b, turn in listed(size):
            assert differing(texts[a], turns_of(texts[b])[turn]) == size.distance
