"""Trace codes: against polynomials written out, every window back to its place, and the distances that are claimed."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from tactape_fab import Localizer, Tape
from tactape_fab.base.errors import CapacityError, SpecError
from tactape_fab.cli.certify import proven_lines
from tactape_fab.texture.certify.certificate import certify, proven_between
from tactape_fab.texture.code import CODES, get_plane
from tactape_fab.texture.frames import LETTERS, BoolArray, SymbolArray, symbols_to_rows
from tactape_fab.texture.plane import encode, locate_windows
from tactape_fab.texture.touch.patches import PATCHES
from tactape_fab.texture.trace import TraceCode
from tactape_fab.texture.windows import WordArray, bit_count
from tests.bench.trace_codes import least_weights, primitive
from tests.contacts import dots, is_near, texture_of
from tests.tapes import tape_at
from tests.thorough import only_thorough, some
from tests.unit.texture.touch.test_design import APART, nearest, patches_of

CODE = get_plane("trace-22")
assert isinstance(CODE, TraceCode)
TRACE: TraceCode = CODE


def slow_symbol(column: int, row: int, sector: int) -> str:
    """Symbol of a place: x^e by e's binary digits, each product reduced by long division of polynomials over GF(2)."""
    modulus = 1 << 22 | 0x21C8AB

    def times(a: int, b: int) -> int:
        product = 0
        for bit in range(22):
            product ^= (a << bit) if b >> bit & 1 else 0
        while product.bit_length() > 22:
            product ^= modulus << product.bit_length() - 23
        return product

    element = 1
    for digit in f"{column + 129 * (row + 127 * sector):b}":
        element = times(element, element)
        element = times(element, 2) if digit == "1" else element
    return LETTERS[(element & 1) + 2 * (bin(element & 0xA66E2).count("1") % 2)]


def test_every_polynomial_is_primitive() -> None:
    assert all(primitive(code) for code in CODES.values() if isinstance(code, TraceCode))


def test_symbols_are_those_of_polynomials_written_out() -> None:
    rng = np.random.default_rng(3)
    for sector, column, row in [(0, 0, 0), (255, 120, 120), *rng.integers(0, 120, (some(24), 3)).tolist()]:
        found = symbols_to_rows(encode(TRACE, sector, (column, row), (3, 5)))
        slow = ["".join(slow_symbol(column + c, row + r, sector) for c in range(5)) for r in range(3)]
        assert found == slow


def test_every_window_tells_its_place() -> None:
    rng = np.random.default_rng(4)
    for sector in (0, 255, *rng.integers(0, 256, 2).tolist()):
        places = locate_windows(TRACE, encode(TRACE, sector, (0, 0), (127, 127)))
        assert places.valid.all() and (places.sector == sector).all()
        assert (places.column == np.arange(124)).all() and (places.row == np.arange(124)[:, None]).all()


def test_a_tape_may_have_all_points_of_a_sector_and_its_windows_are_counted_by_row() -> None:
    assert TRACE.most_points == encode(TRACE, 3, (0, 0), (127, 127)).size
    places = locate_windows(TRACE, encode(TRACE, 3, (40, 60), (5, 9)))
    assert places.column.tolist() == [list(range(40, 46))] * 2 and places.row.tolist() == [[60] * 6, [61] * 6]


def test_an_element_tells_its_place_if_it_is_of_a_sector() -> None:
    for sector, column, row in ((0, 0, 0), (255, 126, 126), (3, 126, 0), (77, 5, 120)):
        assert TRACE.place_of(TRACE.power(column + 129 * (row + 127 * sector))) == (sector, (column, row))
    assert TRACE.place_of(TRACE.power(127)) is None  # between two rows
    assert TRACE.place_of(TRACE.power(129 * 127 * 256)) is None  # after the last sector


def test_exponents_of_an_order_with_a_square_are_found() -> None:
    small = replace(TRACE, degree=12, polynomial=0x53)
    elements = np.array([small.power(exponent) for exponent in range(small.order)])
    assert small.factors == [9, 5, 7, 13] and len(set(elements.tolist())) == small.order
    assert primitive(small) and not primitive(replace(small, polynomial=0x3))
    assert (small.logarithms(elements) == np.arange(small.order)).all()


def test_a_wrong_symbol_is_never_unnoticed() -> None:
    rng = np.random.default_rng(5)
    symbols = encode(TRACE, 9, (0, 0), (4, 120))
    windows = symbols.reshape(4, 30, 4).transpose(1, 0, 2).copy()
    for window, wrong in zip(windows, rng.integers(0, 16, len(windows)), strict=True):
        window.reshape(-1)[wrong] ^= rng.integers(1, 4)
        assert not locate_windows(TRACE, window).valid.any()


@only_thorough
def test_no_two_places_have_one_exponent() -> None:
    column, row, sector = np.arange(127), np.arange(127)[:, None], np.arange(256)[:, None, None]
    exponent = (column + 129 * (row + 127 * sector)).ravel()
    assert exponent.max() < TRACE.order and len(np.unique(exponent)) == len(exponent)


def test_distances_of_all_places_are_the_claimed_ones() -> None:
    assert least_weights(TRACE) == dict(TRACE.proven) == {"3x3": 0, "disc-12": 2, "4x4": 4, "disc-21": 6, "5x5": 9}


def test_distances_recounted_between_tapes() -> None:
    """By brute force on tapes as `make` plans them, in the one turn: nothing of the field is used."""
    tapes = [encode(TRACE, sector, (0, 0), (32, 62)) for sector in (0, 1, 100, 255)[: some(8)]]
    for name in ("4x4", "disc-12", "5x5"):
        words = [patch_words(symbols, PATCHES[name]) for symbols in tapes]
        between = [int(bit_count(a[:, None] ^ b).min()) for a, b in combinations(words, 2)]
        within = [int((bit_count(a[:, None] ^ a) + 99 * np.eye(len(a), dtype=np.uint8)).min()) for a in words]
        assert min(between + within) >= TRACE.proven[name]


def patch_words(symbols: SymbolArray, mask: BoolArray) -> WordArray:
    """Every patch of a shape as one number, two bits a symbol."""
    cut = np.lib.stride_tricks.sliding_window_view(symbols, mask.shape)[..., mask].reshape(-1, mask.sum()).astype(np.uint64)
    words: WordArray = np.bitwise_or.reduce(cut << (2 * np.arange(mask.sum(), dtype=np.uint64)), axis=1)
    return words


def test_a_tape_larger_than_a_sector_is_refused() -> None:
    with pytest.raises(CapacityError, match="runs past 127"):
        encode(TRACE, 0, (66, 0), (32, 62))


def test_a_contact_is_located_with_and_without_the_manifest() -> None:
    tape = tape_at(7, (62, 32), code="trace-22")
    known, unknown = Localizer([tape]), Localizer.from_code("trace-22", pitch_mm=1.5, displacement_mm=0.25)
    for position_mm, theta_deg in (((40.3, 22.1), 37.0), ((20.0, 9.3), -140.0), ((60.2, 30.0), 92.0)):
        xy_px = dots(position_mm, theta_deg, texture_mm=texture_of(tape))
        with_tape, without = known.locate_dots(xy_px), unknown.locate_dots(xy_px)
        assert with_tape.located and is_near(with_tape, position_mm, theta_deg), with_tape.reason
        assert without.located and (without.sector, without.index) == (7, with_tape.index), without.reason
        assert without.plane_mm == pytest.approx(with_tape.position_mm, abs=1e-6)


def test_a_place_is_told_in_microseconds() -> None:
    symbols = encode(TRACE, 77, (0, 0), (64, 64))
    locate_windows(TRACE, symbols)
    start = time.process_time()
    count = sum(locate_windows(TRACE, symbols).valid.size for _ in range(3))
    assert (time.process_time() - start) / count < 60e-6  # 12 us on two quiet cores


def test_other_symbols_are_refused() -> None:
    tape = tape_at(7, (62, 32), code="trace-22").to_mapping()
    tape["symbols"][3] = tape["symbols"][3][::-1]
    with pytest.raises(SpecError, match="differ from code 'trace-22'"):
        Tape.from_mapping(tape)


def test_the_certificate_recounted_in_all_turns_and_in_half_turns() -> None:
    tape = tape_at(7, (20, 20), code="trace-22")
    certificate = certify(tape)
    for (name, mask), patch in zip(PATCHES.items(), certificate.patches, strict=True):
        assert (patch.shape, patch.proven) == (name, TRACE.proven[name])
        assert patch.bits == nearest(tape.symbols, tape.symbols, mask)[0]
        upright, turned = (np.array(patches_of(tape.symbols, mask, turn)) for turn in (0, 2))
        apart = [APART[upright[:, None], other[None]].sum(axis=2)[np.triu_indices(len(upright), k)]
                 for other, k in ((upright, 1), (turned, 0))]  # fmt: skip
        assert patch.half_turns is not None and patch.half_turns[0] == np.concatenate(apart).min()
    found = certificate.to_mapping()
    assert found["open_turns_deg"] == [0, 180] and found["patches"][2]["all_sectors"] == {"bits": 4}


def test_what_is_proven_holds_for_tapes_of_different_sectors_alone() -> None:
    tapes = [tape_at(sector, (12, 12), code="trace-22") for sector in range(256)]
    assert proven_between(tapes) == dict(TRACE.proven)
    assert proven_between([*tapes, tapes[3]]) == {}
    assert proven_between([tapes[0], tape_at(7, (12, 12))]) == {}
    words = [patch_words(tape.symbols, PATCHES["4x4"]) for tape in tapes]
    assert min(int(bit_count(a[:, None] ^ b).min()) for a, b in combinations(words[:: 256 // some(32)], 2)) >= 4
    lines = proven_lines(tapes)
    assert len(lines) == 1 and lines[0].endswith("2 in disc-12, 4 in 4x4, 6 in disc-21, 9 in 5x5")
