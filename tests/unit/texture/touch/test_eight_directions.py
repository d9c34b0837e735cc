"""Eight directions: their letters and bits, what a design promises, who may have them, and what a decoder makes of them."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from functools import cache
from itertools import product
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from click.testing import CliRunner

from tactape_fab import Localizer, Tape, TapeSpec, make_kit
from tactape_fab.base.errors import SpecError
from tactape_fab.base.templates import profile_names
from tactape_fab.cli import main
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.spec.scatter import MOST_SYMBOL_ERRORS, PLACEMENT_MM, least_displacement_mm, symbol_errors
from tactape_fab.sense import Scene
from tactape_fab.sense.decode.grid.fit import fit_grid, posteriors
from tactape_fab.sense.decode.search.evidence import tables_of
from tactape_fab.sense.decode.search.matrices import LARGEST_CONTACT, matrices_of, weigh_matrices
from tactape_fab.sense.decode.search.single_place import evidence_at, shown_by
from tactape_fab.sense.decode.search.tally import BEST, TOTAL, new_tally
from tactape_fab.texture.certify.nearest import near_pairs, plan_search
from tactape_fab.texture.certify.pairs import across
from tactape_fab.texture.code import TOUCH_CODE
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import DIRECTIONS_XY, LETTERS, TURNED, SymbolArray, rows_to_symbols
from tactape_fab.texture.touch.design import design
from tactape_fab.texture.touch.designed import symbols_sha256
from tactape_fab.texture.touch.patches import PATCHES, patch_distances
from tactape_fab.texture.windows import bit_count, windows_of
from tactape_fab.verify.symbols import check_symbols, symbols_of_positions
from tactape_fab.verify.trip.misplaced import explain
from tests.unit.sense.decode.test_touch import contacts
from tests.unit.texture.touch.test_design import patches_of

ANGLES_DEG = {"E": 0, "n": 45, "N": 90, "w": 135, "W": 180, "s": 225, "S": 270, "e": 315}
"""Each letter's direction, counter-clockwise as the tape is looked at."""
ROUND = "NwWsSeEn"
PRINTED: dict[str, Any] = {"code": TOUCH_CODE, "directions": 8, "part": "block", "pitch_mm": 1.06}


@cache
def printed(sector: int, size_mm: tuple[float, float] = (40.0, 24.0)) -> Tape:
    return examine(TapeSpec(sector=sector, size_mm=size_mm, **PRINTED)).tape


# Letters, directions, bits


@pytest.mark.parametrize("letter", ANGLES_DEG)
def test_a_letter_points_where_it_says(letter: str) -> None:
    x, y = DIRECTIONS_XY[LETTERS.index(letter)]
    assert np.degrees(np.arctan2(-y, x)) % 360 == pytest.approx(ANGLES_DEG[letter])
    assert np.hypot(x, y) == pytest.approx(1.0, abs=1e-15)
    turned = LETTERS[TURNED[LETTERS.index(letter)]]
    assert ANGLES_DEG[turned] == (ANGLES_DEG[letter] + 90) % 360


def test_neighbours_differ_in_one_bit_and_four_directions_keep_theirs() -> None:
    codes = [int(DIRECTIONS[8].gray_codes[LETTERS.index(letter)]) for letter in ROUND]
    assert sorted(codes) == list(range(8))
    assert all((a ^ b).bit_count() == 1 for a, b in zip(codes, codes[1:] + codes[:1], strict=True))
    assert DIRECTIONS[4].gray_codes.tolist() == [0, 1, 2, 3] and (DIRECTIONS[4].bits, DIRECTIONS[8].bits) == (2, 3)


def test_small_letters_are_read_where_there_are_eight_alone() -> None:
    assert rows_to_symbols(["NEnesw"], 8).tolist() == [[0, 2, 4, 6, 7, 5]]
    with pytest.raises(ValueError, match=r"other than N, E, S, W$"):
        rows_to_symbols(["Nn"])
    with pytest.raises(ValueError, match=r"other than N, E, S, W, n, e, s, w$"):
        rows_to_symbols(["NX"], 8)


# The design


def nearest(symbols: SymbolArray, mask: np.ndarray, apart: np.ndarray) -> tuple[int, int]:
    """Least distance of two patches in any turn, and pairs at it, each pair once."""
    a, every = patches_of(symbols, mask, 0), []
    for turn in range(4):
        distance = apart[a[:, None], patches_of(symbols, mask, turn)[None]].sum(axis=2)
        every.append(distance[np.triu_indices(len(a), 0 if turn in (1, 2) else 1)])
    least = np.concatenate(every)
    return int(least.min()), int((least == least.min()).sum())


BITS_APART = bit_count(DIRECTIONS[8].gray_codes[:, None] ^ DIRECTIONS[8].gray_codes).astype(np.int64)


@pytest.mark.parametrize("shape", [(6, 6), (9, 15)])
def test_distances_are_a_plain_enumeration_and_those_of_the_last_rung(shape: tuple[int, int]) -> None:
    symbols = design(3, shape, directions=8)
    found = patch_distances(symbols, np.ones(shape, dtype=bool), 8)
    for distance, (name, mask), promised in zip(found, PATCHES.items(), (4, 7, 11, 16, 16), strict=True):
        assert (distance.shape, distance.bits, distance.pairs) == (name, *nearest(symbols, mask, BITS_APART))
        assert distance.bits is not None and distance.bits >= promised


def test_designs_are_pinned_and_differ_by_sector() -> None:
    symbols = design(7, (32, 62), directions=8)
    assert [d.bits for d in patch_distances(symbols, np.ones((32, 62), dtype=bool), 8)] == [4, 7, 11, 16, 18]
    assert symbols_sha256(symbols) == "6301be6430d4e6149f6614b0a9c43d69c8872832c16c053cb310f0eee221407d"
    assert set(np.unique(symbols)) == set(range(8))
    assert symbols_sha256(design(7, (9, 16), directions=8)) != symbols_sha256(design(8, (9, 16), directions=8))


def test_windows_are_held_against_each_other_symbol_by_symbol() -> None:
    symbols = np.random.default_rng(1).integers(0, 8, (9, 11)).astype(np.uint8)
    for side in (4, 5):
        windows = windows_of(symbols, np.ones(symbols.shape, dtype=bool), side, directions=8)
        least = min(
            int(pairs.distance.min(initial=99))
            for pairs in near_pairs(windows.words, plan_search(side, windows.count, 99), bits=3)
        )
        assert least == nearest(symbols, np.ones((side, side), dtype=bool), 1 - np.eye(8, dtype=np.int64))[0]


def test_a_tape_keeps_away_from_those_that_exist_if_they_have_as_many_directions() -> None:
    spec = TapeSpec(sector=2, size_mm=(24.0, 18.0), **PRINTED)
    first, second = printed(1, (24.0, 18.0)), examine(spec, avoid=[printed(1, (24.0, 18.0))]).tape
    assert (across([first, second], 4).distance or 0) >= 3
    four = examine(TapeSpec(sector=1, code=TOUCH_CODE, size_mm=(24.0, 18.0), models=False)).tape
    with pytest.raises(SpecError, match=r"avoid: the parts of tactape-s001 point in 4 directions, those of this tape in 8"):
        examine(spec, avoid=[four])


# The manifest


def changed(**values: Any) -> dict[str, Any]:
    return {**printed(1, (16.0, 12.0)).to_mapping(), **values}


def test_a_manifest_says_how_many_directions_and_gives_the_tape_back() -> None:
    tape = printed(1, (16.0, 12.0))
    mapping = tape.to_mapping()
    assert mapping["directions"] == 8 and set("".join(mapping["symbols"])) == set(LETTERS)
    rows = "".join(f"{row}\n" for row in mapping["symbols"]).encode("ascii")
    assert mapping["symbols_sha256"] == hashlib.sha256(rows).hexdigest()
    again = Tape.from_mapping(json.loads(json.dumps(mapping)))
    assert np.array_equal(again.symbols, tape.symbols) and again.to_mapping() == mapping
    four = examine(TapeSpec(sector=1, code=TOUCH_CODE, size_mm=(16.0, 12.0), models=False))
    assert "directions" not in four.tape.to_mapping() and "directions" not in four.spec.to_mapping()


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"directions": 3}, "directions = 3 is neither 4 nor 8"),
        ({"directions": "8"}, "directions = '8' is neither 4 nor 8"),
        ({"directions": True}, "directions = True is neither 4 nor 8"),
        ({"directions": 8.0}, r"directions = 8\.0 is neither 4 nor 8"),
        ({"directions": None}, "directions = None is neither 4 nor 8"),
        ({"directions": 4}, "other than N, E, S, W$"),
        ({"code": "microdots-4x4"}, "directions = 8 of code 'microdots-4x4': only touch-1 and touch-2 have 8"),
        ({"symbols_sha256": "0" * 64}, "is not that of symbols"),
    ],
)
def test_what_contradicts_itself_is_refused(values: dict[str, Any], said: str) -> None:
    with pytest.raises(SpecError, match=said):
        Tape.from_mapping(changed(**values))


# Who may have them


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"directions": 6}, "directions = 6 is neither 4 nor 8; give one of them"),
        ({"directions": "many"}, "directions = 'many' is neither 4 nor 8"),
        (
            {"directions": 8, "code": "anoto-6x6", "displacement_mm": 0.4},
            "directions = 8 of code 'anoto-6x6': only touch-1 and .* have 8; use --code touch-1",
        ),
        ({"directions": 8, "code": TOUCH_CODE}, r"directions = 8 at displacement_mm = 0\.25 mm: .* 5\.6 % .* more than 1 %"),
    ],
)
def test_others_are_refused_with_the_figure_and_a_remedy(values: dict[str, Any], said: str) -> None:
    with pytest.raises(SpecError, match=said) as refused:
        TapeSpec(sector=1, **values)
    assert len(refused.value.problems) == 1


def test_code_and_displacement_are_refused_together() -> None:
    with pytest.raises(SpecError) as refused:
        TapeSpec(sector=1, directions=8)
    assert [("--code touch-1" in p.message, "--delta 0.34" in p.message) for p in refused.value.problems] == [
        (True, False),
        (False, True),
    ]


def test_a_refusal_names_a_displacement_that_is_taken() -> None:
    least_mm = least_displacement_mm()
    spec = TapeSpec(sector=1, code=TOUCH_CODE, directions=8, pitch_mm=2.0, displacement_mm=least_mm, size_mm=(30.0, 24.0))
    assert examine(spec).tape.directions == 8
    with pytest.raises(SpecError, match=f"use --delta {least_mm:g} or more, or --directions 4, or a printed element"):
        TapeSpec(sector=1, code=TOUCH_CODE, directions=8, pitch_mm=2.0, displacement_mm=least_mm - 0.01)
    with pytest.raises(SpecError, match=f"use --w 2 --delta {least_mm:g}, or --directions 4, or a printed element"):
        TapeSpec(sector=1, code=TOUCH_CODE, directions=8)
    for fab in (name for name in profile_names("fabs") if not name.startswith("_")):
        examined = examine(spec.with_values(fab=fab))
        assert [finding.rule for finding in examined.findings if finding.blocks] == [], fab


def test_no_remedy_names_a_displacement_that_is_refused() -> None:
    spec = TapeSpec(sector=1, code=TOUCH_CODE, directions=8, displacement_mm=least_displacement_mm(), size_mm=(30.0, 24.0))
    broken = [finding.message for finding in examine(spec).findings if not finding.passed and "--delta" in finding.message]
    assert len(broken) > 2
    for message in broken:
        for options in re.findall(r"(?:--w ([\d.]+) )?--delta ([\d.]+)", message):
            pitch_mm, displacement_mm = float(options[0] or spec.pitch_mm), float(options[1])
            spec.with_values(pitch_mm=pitch_mm, displacement_mm=displacement_mm)
    assert TapeSpec(sector=1, code=TOUCH_CODE, directions=8, part="dome").directions == 8


def test_the_figure_is_what_scattered_parts_show() -> None:
    """Of parts that scatter as is believed, so many stand nearer to another direction's place than to their own."""
    rng = np.random.default_rng(0)
    for displacement_mm in (0.15, 0.25, least_displacement_mm()):
        at = displacement_mm * DIRECTIONS_XY[0] + rng.normal(0.0, PLACEMENT_MM, (200_000, 2))
        wrong = np.linalg.norm(at[:, None] - displacement_mm * DIRECTIONS_XY, axis=2).argmin(axis=1) != 0
        assert wrong.mean() == pytest.approx(symbol_errors(displacement_mm), rel=0.06, abs=5e-4)
    assert symbol_errors(least_displacement_mm()) <= MOST_SYMBOL_ERRORS < symbol_errors(least_displacement_mm() - 0.01)


@pytest.mark.parametrize(("pitch_mm", "rotation_deg"), [(1.06, 45.0), (1.05, 45.0), (1.3, 20.0)])
def test_the_gap_is_that_of_the_nearest_two_blocks(pitch_mm: float, rotation_deg: float) -> None:
    """Plain geometry over all parts; from W 1.06 on every two blocks are 0.15 mm apart."""
    spec = TapeSpec(sector=2, size_mm=(40.0, 24.0), **(PRINTED | {"pitch_mm": pitch_mm, "rotation_deg": rotation_deg}))
    examined = examine(spec)
    (gap,) = [finding for finding in examined.findings if finding.rule == "gap"]
    foot = shapely.affinity.rotate(shapely.box(-0.3, -0.15, 0.3, 0.15), rotation_deg, origin=(0, 0))
    bodies = np.array([shapely.affinity.translate(foot, x, y) for x, y in examined.tape.part_xy_mm().tolist()])
    a, b = shapely.STRtree(bodies).query(bodies, predicate="dwithin", distance=1.0)
    apart = shapely.distance(bodies[a[a < b]], bodies[b[a < b]])
    assert gap.value == pytest.approx(float(apart.min()), abs=2e-6)
    if rotation_deg == 45.0:
        assert (ceil(1e6 * (gap.value or 0.0)) >= 149_500) is (pitch_mm == 1.06)


# Verification


def test_parts_that_show_another_symbol_are_found() -> None:
    tape = printed(1)
    symbols, found, strays = symbols_of_positions(tape, tape.part_xy_mm())
    assert np.array_equal(symbols, tape.symbols) and found.all() and strays == 0
    assert all(check.passed for check in check_symbols(tape, tape.part_xy_mm(), "STL"))
    moved, number = tape.part_xy_mm(), 5 * tape.columns + 4
    other = (tape.symbols[5, 4] + 4) % 8  # 45 degrees on
    moved[number] += tape.displacement_mm * np.array([1.0, -1.0]) * (DIRECTIONS_XY[other] - DIRECTIONS_XY[tape.symbols[5, 4]])
    shown, windows = check_symbols(tape, moved, "STL")
    letters = f"'{LETTERS[other]}' instead of '{LETTERS[tape.symbols[5, 4]]}'"
    assert not shown.passed and f"first at column 4, row 5: {letters}" in shown.message
    assert not windows.passed and windows.message.startswith("16 of ")


@pytest.mark.parametrize(
    ("moved", "said"),
    [
        (lambda p: p + np.array([0.53, 0.0]), "it is shifted by (+0.530, +0.000) mm on the board, half a pitch along x"),
        (lambda p: (40.0, 24.0) - p, "it is turned by 180 deg"),
        (lambda p: (40.0, 0.0) + p * (-1.0, 1.0), "it is mirrored left to right"),
        (lambda p: p, None),
    ],
)
def test_misplaced_parts_are_explained(moved: Any, said: str | None) -> None:
    tape = printed(1)
    assert explain(tape, moved(tape.part_xy_mm())) == said


def test_a_report_has_all_letters_and_their_bits(tmp_path: Path) -> None:
    kit = make_kit(TapeSpec(sector=1, size_mm=(16.0, 12.0), **PRINTED), tmp_path / "kit", verify=False)
    text = (kit.path / "report.html").read_text(encoding="utf-8")
    assert '"letters":"NWESnwes"' in text.replace(" ", "") and '"codes":[0,3,5,6,4,1,7,2]' in text.replace(" ", "")
    assert "in 8 directions" in text


# Decoding


@pytest.mark.parametrize("angle_deg", [0.0, 31.0, 77.0])
def test_displaced_dots_give_the_grid_and_their_symbols(angle_deg: float) -> None:
    rng, pitch, shift = np.random.default_rng(4), 17.0, 1 / 6
    cells = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2).astype(float)
    places = np.arange(len(cells)) % 8
    angles = np.pi / 4 * places
    at = cells + shift * np.stack([np.cos(angles), np.sin(angles)], axis=1) + rng.normal(0.0, 0.012, cells.shape)
    turn = np.radians(angle_deg)
    xy = pitch * at @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    ones = np.ones(len(xy))
    fit = fit_grid(xy, ones, ones, turn + 0.01, pitch * 1.01, 0.1, -0.1, shift, True, 8)
    assert np.hypot(*fit.grid[:2]) == pytest.approx(pitch, rel=0.005)
    assert np.degrees(np.arctan2(fit.grid[1], fit.grid[0])) == pytest.approx(angle_deg, abs=0.4)
    q = posteriors(fit.nodes, fit.squares, ones, ones, fit.sigma)
    assert q.shape == (20, 8) and q.sum(axis=1) == pytest.approx(1.0) and np.array_equal(q.argmax(axis=1), places)
    np.testing.assert_allclose(fit.squares.min(axis=1), (fit.squares[np.arange(20), places]), rtol=0)


def test_evidence_is_that_of_the_bits_of_the_turned_symbols() -> None:
    rng = np.random.default_rng(3)
    nodes, q = rng.integers(0, 4, (9, 2)), rng.dirichlet(np.ones(8), 9)
    tables = tables_of(nodes, q, np.empty(0, dtype=np.float32), LARGEST_CONTACT)
    around = "EeSsWwNn"  # from the texture's x axis to its y axis
    bits = DIRECTIONS[8].gray_codes[[LETTERS.index(letter) for letter in around]][:, None] >> np.arange(3) & 1
    for turn, dot, place in product(range(4), range(9), range(8)):
        own = np.roll(q[dot], -2 * turn)
        expected = sum(np.log(2.0 * own[bits[:, bit] == bits[place, bit]].sum()) for bit in range(3))
        signs = np.concatenate([[1.0], 2.0 * bits[place] - 1.0])
        assert tables.evidence[turn, dot] @ signs == pytest.approx(expected)


def test_evidence_of_a_symbol_drawn_from_all_has_mean_one() -> None:
    """What the bound rests on: whatever a dot says, E of a symbol that knows nothing of it is 1 on the mean."""
    q = np.random.default_rng(5).dirichlet(np.full(8, 0.2), 50)
    tables = tables_of(np.zeros((50, 2), dtype=np.int64), q, np.empty(0, dtype=np.float32), LARGEST_CONTACT)
    signs = np.array([[1, *(2 * (code >> bit & 1) - 1 for bit in range(3))] for code in range(8)])
    for turn in range(4):
        assert np.exp(tables.evidence[turn] @ signs.T).mean(axis=1) == pytest.approx(1.0)


def test_the_search_finds_the_place_that_a_plain_sum_finds_and_weighs_all_others() -> None:
    tape, rng = printed(1, (20.0, 16.0)), np.random.default_rng(6)
    tape = replace(tape, omitted=np.array([[5, 6]]))
    shown = shown_by(tape)
    cells = np.stack(np.meshgrid(np.arange(3), np.arange(4)), axis=-1).reshape(-1, 2)
    around = [LETTERS.index(letter) for letter in "EeSsWwNn"]
    true = np.array([around.index(s) for s in tape.symbols[cells[:, 1] + 7, cells[:, 0] + 5]])
    q = 0.9 * np.eye(8)[true] + 0.1 * rng.dirichlet(np.ones(8), len(cells))
    tables = tables_of(cells, q, np.empty(0, dtype=np.float32), LARGEST_CONTACT)
    base, cue, tally = np.tile([-6.0, -9.0], (4, 1)), np.zeros(4), new_tally()
    weigh_matrices(tables, matrices_of([shown], [(tape.columns, tape.rows)], 8), 6, base, cue, tally)
    weights = []
    for turn in range(4):
        wide, high = tables.size[turn].tolist()
        for x, y in product(range(1 - wide, tape.columns), range(1 - high, tape.rows)):
            inside = 0 <= x <= tape.columns - wide and 0 <= y <= tape.rows - high
            value, _ = evidence_at(tables, shown, turn, x, y)
            within = ((tables.cells[turn] + (x, y) >= 0) & (tables.cells[turn] + (x, y) < (tape.columns, tape.rows))).all(axis=1)
            if within.sum() >= 6:
                weights.append((value - (6.0 if inside else 9.0), (turn, 0, x, y)))
    best = max(weights)
    assert tuple(tally.best_place[:4].tolist()) == best[1] == (0, 0, 5, 7)
    assert tally.sums[BEST] == pytest.approx(best[0], abs=1e-4)
    total = sum(np.exp(weight - best[0]) for weight, _ in weights)
    assert tally.sums[TOTAL] == pytest.approx(total, abs=1e-4) and tally.sums[TOTAL] >= total - 1e-6


SCENE = Scene(contact_mm=(5.5, 5.5))


@pytest.mark.parametrize("world", ["open", "closed"])
def test_contacts_are_located_in_their_place(world: str) -> None:
    tapes = [printed(1), printed(2)]
    localizer, located = Localizer(tapes, world=world), 0  # type: ignore[arg-type]
    for tape in tapes:
        for pose, depth in contacts(tape, 12, 3, SCENE):
            fix = localizer.locate(depth)
            if fix.located:
                located += 1
                assert fix.tape == tape.name and fix.position_mm is not None and fix.theta_deg is not None
                assert np.hypot(*(np.array(fix.position_mm) - pose[:2])) < 0.05
                assert abs((fix.theta_deg - pose[2] + 180) % 360 - 180) < 1.5
    assert located >= 23


def test_smaller_contacts_are_located_than_with_four_directions() -> None:
    scene = Scene(contact_mm=(4.0, 4.0))
    four = examine(TapeSpec(sector=1, size_mm=(40.0, 24.0), **(PRINTED | {"directions": 4}))).tape
    counts = [sum(Localizer([t]).locate(depth).located for _, depth in contacts(t, 40, 5, scene)) for t in (printed(1), four)]
    assert counts[0] >= 28 and counts[0] > counts[1] + 8


def test_what_is_no_registered_tape_is_not_located() -> None:
    localizer = Localizer([printed(1)])
    others = [printed(2), examine(TapeSpec(sector=1, size_mm=(40.0, 24.0), **(PRINTED | {"directions": 4}))).tape]
    others.append(examine(TapeSpec(sector=7, size_mm=(40.0, 24.0), pitch_mm=1.06, part="block")).tape)
    for other in others:
        assert not any(localizer.locate(depth).located for _, depth in contacts(other, 10, 11, SCENE))
    for _, depth in contacts(printed(1), 6, 13, replace(SCENE, mirrored_tape=True, contact_mm=(7.0, 7.0))):
        fix = localizer.locate(depth)
        assert not fix.located and "mirrored" in str(fix.reason)


def test_tapes_of_four_and_of_eight_directions_are_refused_together(tmp_path: Path) -> None:
    four = examine(TapeSpec(sector=1, size_mm=(40.0, 24.0), **(PRINTED | {"directions": 4}))).tape
    with pytest.raises(SpecError, match=r"the tapes differ in directions \(4 and 8\); give those of one kind, and"):
        Localizer([printed(1), four])
    files = []
    for name, tape in (("four", four), ("eight", printed(1))):
        files.append(tmp_path / f"{name}.json")
        files[-1].write_text(json.dumps({"format": "tactape-manifest/1", **tape.to_mapping()}), encoding="utf-8")
    np.save(tmp_path / "frame.npy", np.zeros((240, 320), dtype=np.float32))
    given = [str(tmp_path / "frame.npy"), *(part for file in files for part in ("--tape", str(file)))]
    result = CliRunner().invoke(main, ["decode", *given])
    assert result.exit_code == 2 and "the tapes differ in directions" in result.output
