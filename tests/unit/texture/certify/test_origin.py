"""Origins and sectors that are searched for: the best of those looked at, the same every time, away from what exists."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from tactape_fab import Kit, Tape, TapeSpec, default_origin, make_kit, verify_kit
from tactape_fab.base.errors import SpecError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.texture.certify import origin as choose
from tactape_fab.texture.certify.certificate import closest
from tactape_fab.texture.certify.origin import choose_origin, choose_sector
from tactape_fab.texture.certify.pairs import across
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.windows import windows_of
from tests.tapes import tape_at

CODE = get_plane("microdots-4x4")
GRID = (20, 14)
WHOLE = np.ones((14, 20), dtype=bool)


def merit(sector: int, origin: tuple[int, int], grid: tuple[int, int] = GRID) -> tuple[int, int, int]:
    tape = tape_at(sector, grid, origin=origin)
    near, further = closest(tape, 4), closest(tape, 5)
    assert near.distance is not None and further.distance is not None
    return near.distance, further.distance, -near.pairs


@pytest.mark.parametrize("sector", [255])
def test_best_origin_is_the_best_of_those_looked_at(sector: int) -> None:
    choice = choose_origin(CODE, sector, WHOLE)
    looked_at = choose._origins(CODE, sector, WHOLE.shape, choose.MOST_CANDIDATES)
    assert len(looked_at) == choice.candidates > 100
    assert looked_at[0] == default_origin(CODE.name, sector)
    best = max(merit(sector, origin) for origin in looked_at)
    assert merit(sector, choice.origin) == best
    assert choice.origin == next(o for o in looked_at if merit(sector, o) == best)
    assert choice.distance == best[0] >= choice.default_distance == merit(sector, looked_at[0])[0]  # type: ignore[operator]


@pytest.mark.parametrize("grid", [(5, 6), (9, 10), (13, 12)])
def test_best_origin_of_few_windows_is_the_best_of_those_looked_at(grid: tuple[int, int]) -> None:
    """Of few windows every pair is compared, whatever distance is asked for."""
    choice = choose_origin(CODE, 11, np.ones(grid[::-1], dtype=bool))
    looked_at = choose._origins(CODE, 11, grid[::-1], choose.MOST_CANDIDATES)
    best = max(merit(11, origin, grid) for origin in looked_at)
    assert choice.origin == next(o for o in looked_at if merit(11, o, grid) == best)
    assert (choice.distance, best > merit(11, looked_at[0], grid)) == (best[0], True)


def test_search_is_the_same_every_time_and_looks_where_no_sector_lies() -> None:
    assert choose_origin(CODE, 7, WHOLE) == choose_origin(CODE, 7, WHOLE)
    defaults = np.array([default_origin(CODE.name, s) for s in range(256)])
    for sector in range(0, 256, 5):  # for three of these one was where their own default tape lies
        apart = np.abs(np.array(choose._origins(CODE, sector, (32, 62), 160)[1:])[:, None] - defaults)
        assert ((apart[..., 0] >= 62) | (apart[..., 1] >= 32)).all()


@pytest.mark.parametrize("shape", [(200, 4), (4, 200)])
def test_long_tapes_of_other_sectors_are_left_beside(shape: tuple[int, int]) -> None:
    tried = np.array(choose._origins(CODE, 7, shape, 160)[1:])
    others = np.array([default_origin(CODE.name, s) for s in range(256) if s != 7])
    apart = np.abs(tried[:, None] - others)
    assert len(tried) > 100 and ((apart[..., 0] >= shape[1]) | (apart[..., 1] >= shape[0])).all()


def test_a_place_is_occupied_where_grid_points_are_shared() -> None:
    tape = tape_at(7, (6, 5), origin=(50, 60))
    taken = {(50 + c, 60 + r) for c in range(6) for r in range(5)}
    for column, row in product((43, 46, 47, 50, 55, 56), (53, 57, 58, 60, 64, 65)):
        mine = {(column + c, row + r) for c in range(4) for r in range(3)}
        assert choose._occupied((column, row), CODE, 7, (3, 4), [tape]) == bool(mine & taken)
    assert not choose._occupied((50, 60), CODE, 8, (3, 4), [tape])
    assert not choose._occupied((50, 60), get_plane("debruijn-4x4"), 7, (3, 4), [tape])


def test_origins_are_weighed_by_windows_of_four_then_of_five_then_by_pairs() -> None:
    for origin in choose._origins(CODE, 7, WHOLE.shape, 12):
        assert choose._origin_score(CODE, 7, origin, WHOLE, None) == merit(7, origin)


def test_one_window_that_an_existing_tape_has_is_at_no_distance() -> None:
    tape = tape_at(7, (9, 8))
    both = (tape.symbols[2:6, 3:7], tape_at(8, (9, 8)).symbols[2:6, 3:7])
    own, strange = (windows_of(symbols, np.ones((4, 4), dtype=bool), 4, turns=4) for symbols in both)
    assert choose._farthest([own], [tape]) == ([0], 0)
    assert choose._farthest([own, strange], [tape])[0] == [1]


def test_of_equally_good_origins_the_first_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choose, "_origin_score", lambda *_: (3, 5, -1))
    assert choose_origin(CODE, 7, WHOLE).origin == default_origin(CODE.name, 7)


def test_as_many_origins_are_tried_as_asked_and_tapes_end_within_the_plane() -> None:
    for count in (2, 3, 40):
        assert len(set(choose._origins(CODE, 7, (4, 4), count))) == count
    last = CODE.range - 20, CODE.range - 14
    assert choose._fits(last, CODE, WHOLE.shape)
    assert not choose._fits((last[0] + 1, last[1]), CODE, WHOLE.shape)
    assert not choose._fits((last[0], last[1] + 1), CODE, WHOLE.shape)


def test_avoiding_takes_the_farthest_of_those_looked_at() -> None:
    avoid = [tape_at(s, GRID) for s in (3, 7, 12)] + [tape_at(20, GRID, origin=(0, 0))]
    choice = choose_origin(CODE, 7, WHOLE, avoid)
    apart = []
    for origin in choose._origins(CODE, 7, WHOLE.shape, choose.MOST_BESIDE_OTHERS)[1:]:  # the first is there already
        tapes = [tape_at(7, GRID, origin=origin), *avoid]
        apart.append((int(across(tapes, 4).matrix[0, 1:].min()), origin))
    assert choice.candidates == len(apart)
    assert choice.from_others == max(d for d, _ in apart)
    assert choice.origin in [origin for d, origin in apart if d == choice.from_others]


def test_sector_chosen_is_free_and_the_farthest() -> None:
    avoid = [tape_at(s, GRID) for s in (0, 1, 5)]
    sector = choose_sector(CODE, WHOLE, avoid)
    free = [s for s in range(60) if s not in (0, 1, 5)][: choose.MOST_BESIDE_OTHERS]
    apart = {s: int(across([tape_at(s, GRID), *avoid], 4).matrix[0, 1:].min()) for s in free}
    assert apart[sector] == max(apart.values())


def test_no_room_and_no_sector_are_refused() -> None:
    with pytest.raises(SpecError, match="leave no sector of microdots-4x4 free for 20 x 14 grid points"):
        choose_sector(CODE, WHOLE, [tape_at(s, (4, 4)) for s in range(256)])
    everywhere = [tape_at(7, (3375, 40), origin=(0, row)) for row in range(0, 3335, 40)]
    everywhere.append(tape_at(7, (3375, 40), origin=(0, 3335)))
    with pytest.raises(SpecError, match="sector 7 of microdots-4x4 has no room for 20 x 14 grid points"):
        choose_origin(CODE, 7, WHOLE, everywhere)


# Through make


def test_kit_with_the_best_origin_says_what_was_found(tmp_path: Path) -> None:
    spec = TapeSpec(sector=9, size_mm=(20.0, 20.0), origin="best", models=False)
    kit = make_kit(spec, tmp_path / "kit")
    manifest = json.loads((kit.path / "manifest.json").read_bytes())
    search = manifest["search"]
    assert manifest["origin"] == manifest["spec"]["origin"] == search["origin"] == list(kit.tape.origin)
    assert search["distance"] == closest(kit.tape, 4).distance >= search["default_distance"]
    assert (search["avoided"], search["from_others"]) == ([], None)
    assert verify_kit(kit.path, quick=True).passed
    again = TapeSpec.from_mapping({k: v for k, v in manifest["spec"].items() if v is not None})
    assert examine(again).tape.to_mapping() == kit.tape.to_mapping()


def test_best_origin_of_solid_elements() -> None:
    examined = examine(TapeSpec(sector=3, size_mm=(20.0, 20.0), part="dome", origin="best"))
    assert examined.search is not None
    assert examined.tape.origin == examined.search.origin == examined.spec.origin


def test_kits_without_a_search_record_none(small_kit: Kit) -> None:
    assert "search" not in json.loads((small_kit.path / "manifest.json").read_bytes())


def test_avoided_tapes_decide_sector_and_origin(small_kit: Kit) -> None:
    tape: Tape = small_kit.tape
    values = {"size_mm": (20.0, 20.0), "models": False}
    examined = examine(values, avoid=[tape])
    assert examined.spec.sector != tape.sector
    assert examined.spec.name == f"tactape-s{examined.spec.sector:03d}"
    assert examined.tape.tag is not None and examined.tape.tag.id == examined.spec.sector
    assert examined.avoided == (tape.name,)
    given = examine({**values, "sector": tape.sector}, avoid=[tape])
    assert given.tape.sector == tape.sector
    assert given.tape.origin != tape.origin
    with pytest.raises(SpecError, match="contradicts avoid"):
        examine(TapeSpec(sector=5), avoid=[tape])


def test_no_sector_is_chosen_without_tapes_to_avoid() -> None:
    with pytest.raises(SpecError, match="sector is missing"):
        examine({"origin": "best"})
