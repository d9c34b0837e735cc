"""The codes of the texture: encoding against a slow reference and foreign vectors, location of every window, the default
origins, and what a single window can and cannot tell.
"""

from __future__ import annotations

import json
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import default_origin
from tactape_fab.base.errors import CapacityError, SpecError
from tactape_fab.texture.code import CODES, get_code
from tactape_fab.texture.frames import SymbolArray, symbols_to_rows
from tactape_fab.texture.plane import PlaneCode, encode, locate_windows

SEQUENCE_NAMES = [name for name, code in CODES.items() if code.sequences is not None]
VECTORS: dict[str, dict[str, Any]] = json.loads((Path(__file__).parents[2] / "data" / "microdots_vectors.json").read_text())
DIFFERENCES = {"microdots-4x4": (1, (1, 3)), "debruijn-4x4": (0, (1,)), "anoto-6x6": (5, (1, 3, 9, 18))}
"""Least difference and the weight of each secondary sequence's digit."""
RANGES = {"microdots-4x4": 3375, "debruijn-4x4": 4096, "anoto-6x6": 410_815_348}
SECTORS = {"microdots-4x4": 256, "debruijn-4x4": 256, "anoto-6x6": 3969}
LETTER_OF_BITS = {(0, 0): "N", (1, 0): "W", (0, 1): "E", (1, 1): "S"}
TURNED_LETTER = {"N": "W", "W": "S", "S": "E", "E": "N"}


def sequences_of(name: str) -> PlaneCode:
    code = get_code(name).sequences
    assert code is not None
    return code


def difference(code: PlaneCode, k: int) -> int:
    least, weights = DIFFERENCES[code.name]
    return least + sum(w * int(s.digits[k % s.length]) for w, s in zip(weights, code.secondary, strict=True))


def slow_phase(code: PlaneCode, index: int) -> int:
    """Sum of the differences before `index`: whole periods counted, the rest one by one."""
    total = 0
    least, weights = DIFFERENCES[code.name]
    for weight, sequence in zip(weights, code.secondary, strict=True):
        whole, rest = divmod(index, sequence.length)
        total += weight * whole * sum(sequence.digits.tolist())
        for k in range(rest):
            total += weight * int(sequence.digits[k])
    return total + least * index


def slow_encode(code: PlaneCode, sector: int, origin: tuple[int, int], shape: tuple[int, int]) -> list[str]:
    """The formula of the code plane, one symbol after the other."""
    main = code.main.digits.tolist()
    length = len(main)
    u, v = divmod(sector, length)
    texts = []
    before_row = slow_phase(code, origin[1])
    for r in range(origin[1], origin[1] + shape[0]):
        text = ""
        before_column = slow_phase(code, origin[0])
        for c in range(origin[0], origin[0] + shape[1]):
            x = main[(r + u + before_column) % length]
            y = main[(c + v + before_row) % length]
            text += LETTER_OF_BITS[x, y]
            before_column += difference(code, c)
        texts.append(text)
        before_row += difference(code, r)
    return texts


def turned(symbols: SymbolArray) -> SymbolArray:
    """A texture turned by 90 degrees counter-clockwise: places turn, and so does each letter's direction."""
    letters = np.array([list(row) for row in symbols_to_rows(symbols)])
    value_of = {"N": 0, "W": 1, "E": 2, "S": 3}
    return np.array([[value_of[TURNED_LETTER[t]] for t in row] for row in np.rot90(letters).tolist()], dtype=np.uint8)


def side_by_side(windows: SymbolArray) -> SymbolArray:
    """Windows of shape (m, n, n) as one patch of shape (n, m n); window i begins at column n i."""
    return np.ascontiguousarray(windows.transpose(1, 0, 2)).reshape(windows.shape[1], -1)


@pytest.mark.parametrize("name", SEQUENCE_NAMES)
def test_range_sectors_and_window(name: str) -> None:
    code = sequences_of(name)
    assert (code.range, code.sectors, code.window) == (RANGES[name], SECTORS[name], 6 if name == "anoto-6x6" else 4)


def test_vectors_cover_every_code() -> None:
    have = {v["code"] for v in VECTORS.values()}
    assert have == set(SEQUENCE_NAMES), "add a matrix by an independent program to tests/data/microdots_vectors.json"


@pytest.mark.parametrize("key", VECTORS)
def test_foreign_vectors_are_reproduced_exactly(key: str) -> None:
    vector = VECTORS[key]
    code = sequences_of(vector["code"])
    u, v = vector["section"]
    column, row = vector["origin"]
    shape = (len(vector["rows"]), len(vector["rows"][0]))
    symbols = encode(code, u * code.main.length + v, (column, row), shape)
    assert symbols_to_rows(symbols) == vector["rows"]


@pytest.mark.parametrize("key", VECTORS)
def test_foreign_vectors_are_located_at_every_window(key: str) -> None:
    vector = VECTORS[key]
    code = sequences_of(vector["code"])
    u, v = vector["section"]
    letters = np.array([["NWES".index(t) for t in row] for row in vector["rows"]], dtype=np.uint8)
    places = locate_windows(code, letters)
    rows, columns = np.indices(places.valid.shape)
    assert places.valid.shape == (len(letters) - code.window + 1, letters.shape[1] - code.window + 1)
    assert places.valid.all()
    assert (places.sector == u * code.main.length + v).all()
    assert np.array_equal(places.column, vector["origin"][0] + columns)
    assert np.array_equal(places.row, vector["origin"][1] + rows)


@pytest.mark.parametrize("name", SEQUENCE_NAMES)
def test_a_window_is_located_where_the_code_has_it_or_nowhere(name: str) -> None:
    code, rng = sequences_of(name), np.random.default_rng(5)
    n = code.window
    anything = rng.integers(0, 4, (400, n, n)).astype(np.uint8)
    worn = np.stack([encode(code, 3, (k, 2 * k), (n, n)) for k in range(400)])
    worn[np.arange(400), rng.integers(0, n, 400), rng.integers(0, n, 400)] ^= rng.integers(1, 4, 400).astype(np.uint8)
    windows = np.concatenate([anything, worn])
    places = locate_windows(code, side_by_side(windows))
    valid, *fields = (found[0, ::n] for found in (places.valid, places.column, places.row, places.sector))
    assert all((field[~valid] == -1).all() and (field[valid] >= 0).all() for field in fields)
    assert name == "debruijn-4x4" or not valid.all()
    for i in np.flatnonzero(valid):
        column, row, sector = (int(field[i]) for field in fields)
        if max(column, row) <= code.range - n:
            assert np.array_equal(encode(code, sector, (column, row), (n, n)), windows[i])


@pytest.mark.parametrize("name", SEQUENCE_NAMES)
def test_encode_is_the_formula_at_the_plane_start_without_any_shortcut(name: str) -> None:
    code = sequences_of(name)
    phase = 0
    for index in range(400):
        assert int(code.phase_before(np.array([index]))[0]) == phase % code.main.length
        phase += difference(code, index)


@pytest.mark.parametrize("name", SEQUENCE_NAMES)
def test_encode_is_the_formula_everywhere(name: str) -> None:
    code = sequences_of(name)
    rng = np.random.default_rng(1)
    for _ in range(40):
        shape = (int(rng.integers(1, 12)), int(rng.integers(1, 12)))
        origin = (int(rng.integers(0, code.range - shape[1] + 1)), int(rng.integers(0, code.range - shape[0] + 1)))
        sector = int(rng.integers(code.sectors))
        assert symbols_to_rows(encode(code, sector, origin, shape)) == slow_encode(code, sector, origin, shape)


@pytest.mark.parametrize("name", SEQUENCE_NAMES)
def test_encode_is_the_formula_at_the_end_of_the_plane(name: str) -> None:
    code = sequences_of(name)
    origin = (code.range - 9, code.range - 8)
    last = code.sectors - 1
    assert symbols_to_rows(encode(code, last, origin, (8, 9))) == slow_encode(code, last, origin, (8, 9))


@pytest.mark.parametrize("name", SEQUENCE_NAMES)
@pytest.mark.parametrize(
    ("origin", "shape", "sector"),
    [
        ((1, 0), (4, 0), 0),
        ((0, 1), (0, 4), 0),
        ((-1, 0), (4, 4), 0),
        ((0, -1), (4, 4), 0),
        ((0, 0), (4, 4), -1),
        ((0, 0), (4, 4), None),
    ],
)
def test_encode_refuses_what_lies_outside(name: str, origin: tuple[int, int], shape: tuple[int, int], sector: int | None) -> None:
    code = sequences_of(name)
    rows, columns = shape[0] or code.range, shape[1] or code.range
    with pytest.raises(CapacityError) as caught:
        encode(code, code.sectors if sector is None else sector, origin, (rows, columns))
    assert caught.value.problems[0].key in ("origin", "sector")
    assert str(code.range if sector == 0 else code.sectors - 1) in str(caught.value)


@pytest.mark.parametrize("name", SEQUENCE_NAMES)
def test_a_plane_of_3375_squared_is_encoded_well_within_a_second(name: str) -> None:
    code = sequences_of(name)
    encode(code, 0, (0, 0), (4, 4))
    tracemalloc.start()
    begin = time.process_time()
    symbols = encode(code, 7, (0, 0), (3375, 3375))
    elapsed_s = time.process_time() - begin
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    print(f"{name}: 3375 x 3375 in {elapsed_s * 1e3:.0f} ms, peak {peak / 1e6:.0f} MB")
    assert elapsed_s < 1.0
    assert peak < 5 * symbols.size


@pytest.mark.parametrize("origin", [0, 400_000_000, 410_815_308])
def test_far_origins_cost_no_memory(origin: int) -> None:
    tracemalloc.start()
    encode(sequences_of("anoto-6x6"), 5, (origin, origin), (40, 40))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000


def test_far_origins_cost_no_time() -> None:
    def best_s(origin: int) -> float:
        times = []
        for _ in range(20):
            begin = time.process_time()
            encode(sequences_of("anoto-6x6"), 5, (origin, origin), (40, 40))
            times.append(time.process_time() - begin)
        return min(times)

    best_s(0)
    assert best_s(400_000_000) < 2 * best_s(0) + 1e-3


@pytest.mark.parametrize("name", ["microdots-4x4", "debruijn-4x4"])
def test_every_4x4_window_reads_validly_in_all_four_rotations(name: str) -> None:
    """Orientation cannot be told from one error-free 4x4 window."""
    code = sequences_of(name)
    symbols = encode(code, 100, (700, 1500), (150, 150))
    for _ in range(4):
        places = locate_windows(code, symbols)
        assert places.valid.all()
        symbols = turned(symbols)
    assert np.array_equal(symbols, encode(code, 100, (700, 1500), (150, 150)))


def test_a_turned_texture_does_not_read_as_one_place() -> None:
    code = sequences_of("microdots-4x4")
    symbols = encode(code, 100, (700, 1500), (30, 30))
    upright = locate_windows(code, symbols)
    assert (upright.column[0] == 700 + np.arange(27)).all()
    aside = locate_windows(code, turned(symbols))
    assert len(np.unique(np.diff(aside.column, axis=1))) > 1


def test_one_wrong_symbol_in_a_4x4_window_mostly_goes_unnoticed() -> None:
    """About 87 %: a 4x4 window has next to no redundancy."""
    code = sequences_of("microdots-4x4")
    rng = np.random.default_rng(2)
    symbols = encode(code, 33, (1000, 200), (220, 220))
    windows = np.lib.stride_tricks.sliding_window_view(symbols, (4, 4)).reshape(-1, 16)[:40_000].copy()
    which = rng.integers(16, size=len(windows))
    windows[np.arange(len(windows)), which] += rng.integers(1, 4, size=len(windows)).astype(np.uint8)
    windows %= 4
    unnoticed = float(locate_windows(code, side_by_side(windows.reshape(-1, 4, 4))).valid[0, ::4].mean())
    print(f"one wrong symbol in a 4x4 window goes unnoticed in {unnoticed:.1%} of {len(windows)} cases")
    assert 0.80 <= unnoticed <= 0.93


def test_a_patch_smaller_than_a_window_has_no_windows() -> None:
    code = sequences_of("anoto-6x6")
    for shape, windows in (((5, 9), (0, 4)), ((9, 5), (4, 0)), ((5, 5), (0, 0)), ((3, 3), (0, 0))):
        places = locate_windows(code, np.zeros(shape, dtype=np.uint8))
        assert places.valid.shape == places.column.shape == places.row.shape == places.sector.shape == windows


def test_default_origin_literals() -> None:
    assert default_origin("microdots-4x4", 7) == (84, 1428)
    assert default_origin("debruijn-4x4", 16) == (192, 192)
    assert default_origin("anoto-6x6", 234) == (234_000, 9_000)
    assert all(default_origin(name, 0) == (0, 0) for name in SEQUENCE_NAMES)


@pytest.mark.parametrize("name", SEQUENCE_NAMES)
def test_default_origins_keep_tapes_of_166_points_apart_and_in_range(name: str) -> None:
    stride = 1000 if name == "anoto-6x6" else 12
    origins = np.array([default_origin(name, s) for s in range(SECTORS[name])], dtype=np.int32)
    sectors = np.arange(len(origins))
    assert np.array_equal(origins, np.stack([stride * sectors, stride * (17 * sectors % len(sectors))], axis=1))
    assert origins.min() >= 0
    assert origins.max() + 166 <= RANGES[name]
    for s in range(1, len(origins)):
        apart = np.abs(origins[s] - origins[:s])
        assert apart.min() >= stride
        assert apart.max(axis=1).min() >= 166


@pytest.mark.parametrize(("name", "sector"), [("microdots-4x4", 256), ("microdots-4x4", -1), ("anoto-6x6", 3969), ("morse", 0)])
def test_default_origin_refuses_unknown_sectors_and_codes(name: str, sector: int) -> None:
    with pytest.raises(SpecError, match=r"^(sector|code) = "):
        default_origin(name, sector)


def test_differences_of_anoto_are_from_5_to_58() -> None:
    """54 of them: digits of 3, 3, 2 and 3 values with the weights 1, 3, 9 and 18."""
    code = sequences_of("anoto-6x6")
    assert (code.least_difference, code.greatest_difference) == (5, 58) and code.weights == (1, 3, 9, 18)
