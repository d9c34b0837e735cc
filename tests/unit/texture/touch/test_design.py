"""The touch code: what its designs promise, by plain enumeration, and how its tapes are kept."""

from __future__ import annotations

import hashlib
import signal
from dataclasses import replace
from functools import cache
from itertools import product
from time import process_time
from typing import Any

import numpy as np
import pytest

from tactape_fab import Tape, TapeSpec, default_origin
from tactape_fab.base.errors import CapacityError, SpecError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.writer import search_record
from tactape_fab.texture.certify.certificate import certify
from tactape_fab.texture.certify.pairs import across, conflicts
from tactape_fab.texture.code import TOUCH_CODE, get_plane
from tactape_fab.texture.frames import LETTERS, TURNED, SymbolArray
from tactape_fab.texture.touch.design import Rung, design
from tactape_fab.texture.touch.designed import symbols_sha256
from tactape_fab.texture.touch.patches import PATCHES, patch_distances
from tests.thorough import slow

SMALL = TapeSpec(sector=7, code=TOUCH_CODE, size_mm=(30.0, 20.0), models=False)
STEPS = {"N": (0, -1), "W": (-1, 0), "E": (1, 0), "S": (0, 1)}


def bits_apart(a: int, b: int) -> int:
    """Quarter turns between two directions: 0, 1 or 2."""
    (ax, ay), (bx, by) = STEPS[LETTERS[a]], STEPS[LETTERS[b]]
    return 1 - (ax * bx + ay * by)


APART = np.array([[bits_apart(a, b) for b in range(4)] for a in range(4)])


def patches_of(symbols: SymbolArray, mask: np.ndarray, turn: int) -> np.ndarray:
    """Every patch of a shape, turned as a picture of parts is, with its symbols."""
    side, becomes = len(mask), np.arange(8, dtype=np.uint8)
    for _ in range(turn):
        becomes = TURNED[becomes]
    corners = product(range(symbols.shape[0] - side + 1), range(symbols.shape[1] - side + 1))
    return np.array([np.rot90(becomes[symbols[r : r + side, c : c + side]], turn)[mask] for r, c in corners])


def nearest(one: SymbolArray, other: SymbolArray, mask: np.ndarray) -> tuple[int, int]:
    """Fewest bits between patches of two grids in any turn, and pairs at it; of one grid with itself every pair once."""
    a = patches_of(one, mask, 0)
    least = []
    for turn in range(4):
        b = patches_of(other, mask, turn)
        distance = APART[a[:, None], b[None]].sum(axis=2)
        if one is other:  # a turn of one against the other is the opposite turn of the other against the one
            distance = distance[np.triu_indices(len(a), 0 if turn in (1, 2) else 1)]
        least.append(distance.ravel())
    every = np.concatenate(least)
    return int(every.min()), int((every == every.min()).sum())


@pytest.mark.parametrize("shape", [(5, 5), (9, 16), (14, 11)])
def test_distances_are_a_plain_enumeration_and_those_of_the_last_rung(shape: tuple[int, int]) -> None:
    symbols = design(3, shape)
    found = patch_distances(symbols, np.ones(shape, dtype=bool))
    for distance, (name, mask), promised in zip(found, PATCHES.items(), (2, 3, 5, 8, 11), strict=True):
        bits, pairs = nearest(symbols, symbols, mask)
        assert (distance.shape, distance.bits, distance.pairs) == (name, bits, pairs)
        assert bits >= promised


def test_patches_with_holes_do_not_count() -> None:
    symbols = np.zeros((5, 6), dtype=np.uint8)  # all alike but for turns
    placed = np.ones((5, 6), dtype=bool)
    placed[0, 0] = placed[4, 5] = False
    counts = {d.shape: d.patches for d in patch_distances(symbols, placed)}
    assert counts == {"3x3": 10, "disc-12": 6, "4x4": 4, "disc-21": 2, "5x5": 0}
    assert patch_distances(symbols, placed)[4].bits is None and patch_distances(symbols, placed)[0].bits == 0


@slow
def test_the_usual_tape_reaches_its_levels_and_is_the_same_everywhere() -> None:
    symbols = design(7, (32, 62))
    assert [d.bits for d in patch_distances(symbols, np.ones((32, 62), dtype=bool))] == [2, 3, 5, 8, 11]
    assert symbols_sha256(symbols) == "6e9d5cfa4d6349086e5c6e34b10003baeb7cdf3b21558c336e43dc6aeedb5e1c"


def test_designs_are_pinned_and_differ_by_sector_and_shape() -> None:
    digests = {symbols_sha256(design(*of)) for of in [(7, (9, 16)), (8, (9, 16)), (7, (16, 9)), (7, (9, 17))]}
    assert len(digests) == 4
    assert symbols_sha256(design(7, (9, 16))) == "6723f2933b243a0693f7affb1709b6eb3bd5044627909e9add464e6147085efe"
    assert not design(7, (9, 16)).flags.writeable


def test_a_design_is_left_soon_after_ctrl_c() -> None:
    def leave(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    design(7, (9, 16))  # all is compiled
    alone = {(4, False, False): (Rung(own=(2, 4, 6, 9, 12), across=(0,) * 5),)}
    before, started_s = signal.signal(signal.SIGVTALRM, leave), process_time()
    try:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.5)
        with pytest.raises(KeyboardInterrupt):
            design(7, (32, 62), rungs=alone)  # some ten seconds: no design has these distances
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)
    assert process_time() - started_s < 2.5


def test_a_tape_keeps_away_from_those_that_exist() -> None:
    first = design(1, (14, 16))
    plane = examine(TapeSpec(sector=3, size_mm=(30.0, 24.0), models=False)).tape.symbols
    second = design(2, (14, 16), [first, plane])
    for other, (mask, least) in product((first, plane), zip(PATCHES.values(), (0, 2, 4, 7, 9), strict=True)):
        assert nearest(second, other, mask)[0] >= least
    assert symbols_sha256(second) != symbols_sha256(design(2, (14, 16)))


def test_more_grid_points_than_are_designed_for_are_refused() -> None:
    with pytest.raises(CapacityError, match=r"200 x 101 grid points, more than the 20000 .*smaller --size"):
        design(0, (101, 200))
    with pytest.raises(SpecError, match=r"395 x 132 grid points, more than the 20000 of a tape of code 'touch-1'.*microdots-4x4"):
        examine(TapeSpec(sector=1, code=TOUCH_CODE, size_mm=(600.0, 200.0), models=False))


# The tape


@cache
def small_tape() -> Tape:
    """Not to be changed."""
    return examine(SMALL).tape


def changed(**values: Any) -> dict[str, Any]:
    """Its manifest with other values, or with functions of those that it has."""
    usual = small_tape().to_mapping()
    return {**usual, **{key: value(usual[key]) if callable(value) else value for key, value in values.items()}}


def test_a_manifest_holds_the_digest_of_the_matrix_and_gives_the_tape_back() -> None:
    tape, mapping = small_tape(), small_tape().to_mapping()
    rows = "".join(f"{row}\n" for row in mapping["symbols"]).encode("ascii")
    assert mapping["symbols_sha256"] == hashlib.sha256(rows).hexdigest()
    assert (mapping["code"], mapping["origin"], default_origin(TOUCH_CODE, 7)) == ("touch-1", [0, 0], (0, 0))
    again = Tape.from_mapping(mapping)
    assert np.array_equal(again.symbols, tape.symbols) and again.to_mapping() == mapping


def other_letter(rows: list[str]) -> list[str]:
    return [("N" if rows[0][0] != "N" else "E") + rows[0][1:], *rows[1:]]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"symbols": other_letter}, "symbols_sha256 = .* is not that of symbols"),
        ({"symbols_sha256": "0" * 64}, "symbols_sha256 = 0{64} is not that of symbols"),
        ({"symbols_sha256": None}, "symbols_sha256"),
        ({"symbols_sha256": 7}, "symbols_sha256"),
        ({"symbols_sha256": "0" * 63}, "symbols_sha256"),
        ({"origin": [0, 1]}, r"origin = \[0, 1\] of code 'touch-1' is not \[0, 0\]"),
        ({"sector": 4096}, "sector = 4096"),
        ({"code": "microdots-4x4"}, "symbols differ from code 'microdots-4x4'"),
    ],
)
def test_a_manifest_that_contradicts_itself_is_refused(values: dict[str, Any], said: str) -> None:
    with pytest.raises(SpecError, match=said):
        Tape.from_mapping(changed(**values))


@pytest.mark.parametrize("origin", [(3, 4), "best", (0, 1)])
def test_an_origin_is_refused_with_the_reason(origin: Any) -> None:
    with pytest.raises(SpecError, match="means nothing with code 'touch-1', which has no plane: its tapes are designed"):
        replace(SMALL, origin=origin)
    assert replace(SMALL, origin=(0, 0)) == SMALL


def test_there_is_no_plane_to_ask_for() -> None:
    with pytest.raises(SpecError, match=r"'touch-1' has no code plane.*name the tape's kit$"):
        get_plane(TOUCH_CODE)


def test_tapes_to_avoid_are_recorded_and_change_the_design() -> None:
    values = {"code": TOUCH_CODE, "size_mm": (30.0, 20.0), "models": False}
    plain = examine({**values, "sector": 8}).tape
    beside = examine(values, avoid=[small_tape()])
    assert beside.tape.sector != 7 and beside.spec.origin == (0, 0)
    assert search_record(beside.search, beside.avoided) == {"avoided": ["tactape-s007"]}
    assert not np.array_equal(examine({**values, "sector": 8}, avoid=[small_tape()]).tape.symbols, plain.symbols)


def test_the_certificate_says_what_the_design_reached() -> None:
    certificate = certify(small_tape())
    said = certificate.to_mapping()["patches"]
    assert [patch["shape"] for patch in said] == list(PATCHES)
    assert [patch["bits"] >= least for patch, least in zip(said, (2, 3, 5, 8, 11), strict=True)] == [True] * 5
    assert "patches" not in certify(examine(TapeSpec(sector=7, size_mm=(30.0, 20.0), models=False)).tape).to_mapping()


def test_only_equal_designs_are_one_tape() -> None:
    tape = small_tape()
    other = replace(tape, symbols=np.array(design(7, tape.symbols.shape, [tape.symbols])), tag=None)
    names = ["a", "b"]
    assert [c.kind for c in conflicts([tape, other], names, across([tape, other], 4))] == []
    again = conflicts([tape, replace(tape, tag=None)], names, across([tape, tape], 4))
    assert next(c.kind for c in again) == "same-tape"
