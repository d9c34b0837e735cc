"""Tape: the manifest's share round-trips through JSON, holds every pinned key, and a corrupt one is refused by name."""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactape_fab import Kit, Tape, TapeSpec
from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import Fields
from tactape_fab.base.output_file import UNFINISHED_SUFFIX
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.profiles import load_fab
from tactape_fab.texture.board import LEAST_BEND_THICKNESSES
from tactape_fab.texture.manifest import MANIFEST_FORMAT, find_manifest, read_manifest
from tactape_fab.texture.tape import DEFAULT_PITCH_MM, read_displacement, read_pitch, refuse_no_tapes
from tests.measured import measured
from tests.tapes import tape_at
from tests.unit.base.test_fields import JSON

TAPE_KEYS = (
    *("name", "sector", "code", "origin", "columns", "rows", "pitch_mm", "displacement_mm"),
    *("board", "part", "symbols", "omitted", "tag"),
)
BOARD_KEYS = ("size_mm", "texture_origin_mm", "corner_radius_mm", "thickness_mm", "holes")
PART_KEYS = ("name", "shape", "body_mm", "rotation_deg")
TAG_KEYS = ("family", "id", "cell_mm", "center_mm", "rotation_deg")
PATHS = [
    *((key,) for key in TAPE_KEYS),
    *(("board", key) for key in BOARD_KEYS),
    *(("part", key) for key in PART_KEYS),
    *(("tag", key) for key in TAG_KEYS),
]

SPEC = TapeSpec(sector=100, size_mm=(20.0, 20.0), holes_mm=[(16.4, 10.0, 1.0)])
TAPE = examine(SPEC).layout.tape
MAPPING: dict[str, Any] = TAPE.to_mapping()


def with_value(path: tuple[str, ...], value: Any) -> dict[str, Any]:
    mapping = copy.deepcopy(MAPPING)
    table = mapping
    for key in path[:-1]:
        table = table[key]
    table[path[-1]] = value
    return mapping


def without(path: tuple[str, ...]) -> dict[str, Any]:
    mapping = with_value(path, None)
    table = mapping
    for key in path[:-1]:
        table = table[key]
    del table[path[-1]]
    return mapping


def refused_keys(mapping: dict[str, Any]) -> list[str]:
    with pytest.raises(SpecError) as caught:
        Tape.from_mapping(mapping)
    assert all(p.message for p in caught.value.problems)
    return [p.key for p in caught.value.problems]


def names(keys: list[str], path: tuple[str, ...]) -> bool:
    wanted = ".".join(path)
    return any(key == wanted or key.startswith((f"{wanted}[", f"{wanted}.")) for key in keys)


# What a manifest holds


def test_tape_writes_every_pinned_key_and_no_other() -> None:
    assert sorted(MAPPING) == sorted(TAPE_KEYS)
    assert sorted(MAPPING["board"]) == sorted(BOARD_KEYS)
    assert sorted(MAPPING["part"]) == sorted(PART_KEYS)
    assert sorted(MAPPING["tag"]) == sorted(TAG_KEYS)


def test_pinned_values_of_the_main_job(default_kit: Kit) -> None:
    manifest = read_manifest(default_kit.path / "manifest.json")
    expected = {
        "format": "tactape-manifest/1",
        "name": "tactape-s007",
        "sector": 7,
        "code": "microdots-4x4",
        "origin": [84, 1428],
        "columns": 62,
        "rows": 32,
        "pitch_mm": 1.5,
        "displacement_mm": 0.25,
        "part": {"name": "r0201", "shape": "block", "body_mm": [0.6, 0.3, 0.23], "rotation_deg": 45.0},
        "omitted": [],
        "board": {
            "size_mm": [100.0, 50.0],
            "texture_origin_mm": [6.9, 48.25],
            "corner_radius_mm": 1.0,
            "thickness_mm": 0.11,
            "holes": [],
        },
    }
    assert {key: manifest[key] for key in expected} == expected
    assert manifest["tool"]["name"] == "tactape-fab"
    assert manifest["fab"]["name"] == "generic-fpc"
    assert manifest["spec"]["sector"] == 7
    assert (manifest["tag"]["family"], manifest["tag"]["id"], manifest["tag"]["cell_mm"]) == ("tag36h11", 7, 0.5)
    assert all(set(row) == {"role", "path", "bytes", "sha256"} for row in manifest["files"])
    assert [len(row) for row in manifest["symbols"]] == [62] * 32
    assert set("".join(manifest["symbols"])) == set("NESW")


def test_round_trip_through_json() -> None:
    again = Tape.from_mapping(json.loads(json.dumps(MAPPING, allow_nan=False)))
    assert again.to_mapping() == MAPPING
    assert np.array_equal(again.symbols, TAPE.symbols)
    assert np.array_equal(again.omitted, TAPE.omitted)
    assert (again.board, again.part, again.tag) == (TAPE.board, TAPE.part, TAPE.tag)


def test_round_trip_without_a_tag() -> None:
    tape = examine(TapeSpec(sector=1, size_mm=(20.0, 20.0), tag="none")).layout.tape
    assert tape.to_mapping()["tag"] is None
    assert Tape.from_mapping(tape.to_mapping()).to_mapping() == tape.to_mapping()


def test_load_by_folder_and_by_file(small_kit: Kit) -> None:
    by_folder, by_file = Tape.load(small_kit.path), Tape.load(str(small_kit.path / "manifest.json"))
    assert by_folder.to_mapping() == by_file.to_mapping() == small_kit.tape.to_mapping()


# What follows from it


def test_designators_run_row_major_over_placed_parts_only() -> None:
    omitted = {tuple(cell) for cell in MAPPING["omitted"]}
    assert omitted
    expected = [(c, r) for r in range(TAPE.rows) for c in range(TAPE.columns) if (c, r) not in omitted]
    assert [tuple(cell) for cell in TAPE.cells().tolist()] == expected
    assert TAPE.part_count == len(expected)
    assert TAPE.designators() == [f"R{i}" for i in range(1, len(expected) + 1)]


def test_omitted_points_keep_their_letter_and_stand_row_major() -> None:
    assert all(len(row) == TAPE.columns for row in MAPPING["symbols"])
    cells = [(r, c) for c, r in MAPPING["omitted"]]
    assert cells == sorted(cells)


def test_part_centres_are_the_displaced_grid_points_in_the_board_frame() -> None:
    step = {"N": (0.0, 0.25), "S": (0.0, -0.25), "W": (-0.25, 0.0), "E": (0.25, 0.0)}
    x0, y0 = MAPPING["board"]["texture_origin_mm"]
    for (c, r), centre_mm in zip(TAPE.cells().tolist(), TAPE.part_xy_mm().tolist(), strict=True):
        dx, dy = step[MAPPING["symbols"][r][c]]
        assert centre_mm == pytest.approx([x0 + 1.5 * c + dx, y0 - 1.5 * r + dy], abs=1e-9)


def test_symbols_and_omitted_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        TAPE.symbols[0, 0] = 0
    with pytest.raises(ValueError, match="read-only"):
        TAPE.omitted[0, 0] = 0


# Corrupt manifests


@pytest.mark.parametrize("path", PATHS, ids=".".join)
def test_a_missing_key_is_named(path: tuple[str, ...]) -> None:
    assert names(refused_keys(without(path)), path)


@pytest.mark.parametrize("key", BOARD_KEYS)
def test_one_missing_board_key_gives_one_problem(key: str) -> None:
    assert refused_keys(without(("board", key))) == [f"board.{key}"]


NUMBERS = [
    *((p, i) for p in (("origin",), ("board", "size_mm"), ("board", "texture_origin_mm"), ("tag", "center_mm")) for i in (0, 1)),
    *((p, None) for p in (("sector",), ("columns",), ("rows",), ("pitch_mm",), ("displacement_mm",), ("tag", "id"))),
    *((p, None) for p in (("board", "corner_radius_mm"), ("board", "thickness_mm"), ("tag", "cell_mm"))),
    *((p, None) for p in (("part", "rotation_deg"), ("tag", "rotation_deg"))),
    *((("part", "body_mm"), i) for i in range(3)),
]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300, -1e300, 10**400, "1", True, None, [], {}], ids=repr)
@pytest.mark.parametrize(("path", "index"), NUMBERS, ids=lambda p: ".".join(p) if isinstance(p, tuple) else str(p))
def test_a_number_that_is_none_is_named(path: tuple[str, ...], index: int | None, bad: Any) -> None:
    value = bad
    if index is not None:
        table = MAPPING
        for key in path:
            table = table[key]
        value = [bad if i == index else v for i, v in enumerate(table)]
    assert names(refused_keys(with_value(path, value)), path)


FREE_NUMBERS = ("pitch_mm", "corner_radius_mm", "thickness_mm", "cell_mm", "rotation_deg")
WRONG: tuple[Any, ...] = (7.5, "x y", [None], {"a": []}, False)
WRONG_TYPES: list[tuple[tuple[str, ...], Any]] = [
    (path, bad)
    for path in PATHS
    for bad in WRONG
    if not (bad == 7.5 and path[-1] in FREE_NUMBERS) and not (bad == "x y" and path == ("part", "name"))
]


@pytest.mark.parametrize(("path", "bad"), WRONG_TYPES, ids=str)
def test_a_value_of_the_wrong_type_is_named(path: tuple[str, ...], bad: Any) -> None:
    assert names(refused_keys(with_value(path, bad)), path)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("sector",), 256),
        (("sector",), -1),
        (("origin",), [3375, 0]),
        (("origin",), [0, 3374]),
        (("columns",), 3),
        (("rows",), 0),
        (("columns",), 100_000),
        (("pitch_mm",), 0.0),
        (("displacement_mm",), 0.75),
        (("displacement_mm",), -0.25),
        (("board", "size_mm"), [0.0, 20.0]),
        (("board", "corner_radius_mm"), 10.1),
        (("board", "holes"), [[1.0, 1.0]]),
        (("board", "holes"), [[1.0, math.nan, 1.0]]),
        (("board", "holes"), [[0.0, 0.0, 0.0]] * 10_001),
        (("part", "shape"), "ball"),
        (("part", "body_mm"), [0.6, 0.3]),
        (("tag", "family"), "tag25h9"),
        (("tag", "id"), 587),
        (("code",), "morse"),
        (("name",), "../up"),
        (("name",), ""),
        (("omitted",), [[8, 0]]),
        (("omitted",), [[0, 99]]),
        (("omitted",), [[-1, 0]]),
        (("omitted",), [[0.0, 0]]),
        (("omitted",), [[True, 0]]),
        (("omitted",), [[0, 0], [0, 0]]),
        (("omitted",), [[0, 0, 0]]),
        (("omitted",), [0, 0]),
    ],
    ids=str,
)
def test_a_value_out_of_range_is_named(path: tuple[str, ...], value: Any) -> None:
    assert names(refused_keys(with_value(path, value)), path)


def reaching(path: tuple[str, ...], value: Any) -> dict[str, Any]:
    """The mapping with a value, and beside it what that value needs."""
    if path[0] == "surface":
        return {**MAPPING, "surface": {**SURFACE, path[1]: value}}
    mapping = with_value(path, value)
    if path == ("board", "size_mm"):
        mapping["board"]["corner_radius_mm"] = 0.0
    if path == ("part", "top_mm"):
        mapping["part"] |= {"shape": "dome", "body_mm": [0.6, 0.6, 0.9]}
    return mapping


SURFACE = {"source": "finger.stl", "sha256": "0" * 64, "centre_mm": [1.0, 2.0, 3.0], "up": [0.0, 0.0, 1.0], "radius_mm": None}
BOTH_SIDES: list[tuple[tuple[str, ...], list[Any], list[Any]]] = [
    (("sector",), [], [-1, 256]),
    (("origin",), [], [[-1, 0], [0, -1], [3375, 0], [0, 3375]]),
    (("name",), ["a", "a" * 64, "9.A_-"], ["", "a" * 65, ".a", "-a"]),
    (("pitch_mm",), [0.51, 100.0], [100.001, 0.0]),
    (("displacement_mm",), [0.749, 1e-9], [0.75, 0.0]),
    (("board", "size_mm"), [[1e-9, 20.0], [10_000.0, 10_000.0]], [[10_000.1, 20.0], [20.0, 10_000.1], [20.0, 0.0]]),
    (("board", "texture_origin_mm"), [[0.0, 10_000.0], [10_000.0, 0.0]], [[-0.1, 0.0], [0.0, -0.1], [10_000.1, 0.0]]),
    (("board", "corner_radius_mm"), [0.0, 0.001, 10.0], [-1e-9, 1e-300, 10.01]),
    (("board", "thickness_mm"), [1e-9, 100.0], [0.0, 100.1]),
    (("board", "holes"), [[], [[0.0, 10_000.0, 10_000.0], [10_000.0, 0.0, 0.0]]], [[[-0.1, 0.0, 1.0]], [[0.0, 0.0, 10_001.0]]]),
    (("part", "body_mm"), [[100.0, 100.0, 100.0], [0.001] * 3], [[100.1, 1.0, 1.0], [1.0, 100.1, 1.0], [1.0, 1.0, 100.1]]),
    (("part", "body_mm"), [], [[0.0, 1.0, 1.0], [1.0, 1e-300, 1.0], [1.0, 1.0, 0.0009]]),
    (("part", "name"), ["x" * 200], ["x" * 201]),
    (("part", "rotation_deg"), [-360.0, 360.0], [-360.1, 360.1]),
    (("part", "top_mm"), [1e-9, 0.599], [0.0, 0.6]),
    (("tag", "id"), [0, 586], [-1, 587]),
    (("tag", "cell_mm"), [0.001, 100.0], [0.0, 1e-300, 100.1]),
    (("tag", "center_mm"), [[0.0, 10_000.0], [10_000.0, 0.0]], [[-0.1, 0.0], [0.0, -0.1], [10_000.1, 0.0], [0.0, 10_000.1]]),
    (("tag", "rotation_deg"), [-360.0, 360.0], [-360.1, 360.1]),
    (("surface", "source"), ["x" * 300], ["x" * 301]),
    (("surface", "sha256"), ["0123456789abcdef" * 4], ["0" * 63, "0" * 65, "g" * 64]),
    (("surface", "centre_mm"), [[-1e5, 1e5, 0.0], [0.0, -1e5, 1e5]], [[-100_001.0, 0.0, 0.0], [0.0, 100_001.0, 0.0], [0.0, 0.0]]),
    (("surface", "up"), [[-1.0, 1.0, 0.0], [0.0, 1.0, -1.0]], [[-1.01, 0.0, 0.0], [0.0, 1.01, 0.0], [0.0] * 4]),
    (("surface", "radius_mm"), [None, -1e9, 1e9], [-1.1e9, 1.1e9]),
]


@pytest.mark.parametrize(("path", "within", "beyond"), BOTH_SIDES, ids=[".".join(path) for path, _, _ in BOTH_SIDES])
def test_each_limit_from_both_sides(path: tuple[str, ...], within: list[Any], beyond: list[Any]) -> None:
    for value in within:
        mapping = reaching(path, value)
        assert Tape.from_mapping(mapping).to_mapping() == mapping
    for value in beyond:
        assert names(refused_keys(reaching(path, value)), path)


def test_the_last_sector_of_a_code_is_read() -> None:
    mapping = {"format": "tactape-manifest/1", **tape_at(255, (6, 5)).to_mapping()}
    assert Tape.from_mapping(mapping).sector == 255


@pytest.mark.parametrize(("pitch_mm", "passed"), [(0.2, True), (0.1999, False), (20.0, True), (20.001, False)])
def test_w_that_is_asked_for_is_from_0_2_to_20_mm(pitch_mm: float, passed: bool) -> None:
    table = Fields({"w": pitch_mm})
    assert read_pitch(table, "w") == (pitch_mm if passed else DEFAULT_PITCH_MM)
    assert bool(table.problems) is not passed


@pytest.mark.parametrize("values", [[tape_at(7, (6, 5)), 3], ["kit"], "kit", None, 7], ids=repr)
def test_a_list_with_what_is_no_tape_is_refused(values: object) -> None:
    refuse_no_tapes((tape_at(7, (6, 5)),), "avoid")
    with pytest.raises(SpecError, match=r"^avoid = .* is no list of tapes; give \[Tape.load\(KIT\), ...\]$"):
        refuse_no_tapes(values, "avoid")


def test_a_board_has_10_000_holes_at_most() -> None:
    mapping = with_value(("board", "holes"), [[1.0, 1.0, 0.5]] * 10_000)
    assert len(Tape.from_mapping(mapping).board.holes) == 10_000
    assert refused_keys(with_value(("board", "holes"), [[1.0, 1.0, 0.5]] * 10_001)) == ["board.holes"]


def test_a_dome_is_round_and_lower_than_its_radius_or_has_a_flat_top() -> None:
    for shape, body_mm, top_mm, is_one in (
        ("dome", [0.6, 0.6, 0.299], None, True),
        ("dome", [0.6, 0.6, 0.3], None, False),
        ("dome", [0.6, 0.5, 0.2], None, False),
        ("dome", [0.6, 0.6, 0.9], 0.2, True),
        ("dome", [0.6, 0.5, 0.2], 0.2, False),
        ("block", [0.6, 0.5, 0.9], None, True),
    ):
        part = {**MAPPING["part"], "shape": shape, "body_mm": body_mm, **({} if top_mm is None else {"top_mm": top_mm})}
        mapping = {**MAPPING, "part": part}
        if is_one:
            assert Tape.from_mapping(mapping).to_mapping() == mapping
        else:
            assert refused_keys(mapping) == ["part.body_mm"]


@pytest.mark.parametrize("size_mm", [[60.0, 40.0], [40.0, 60.0]])
def test_a_corner_is_at_most_half_the_shorter_side(size_mm: list[float]) -> None:
    board = {**MAPPING["board"], "size_mm": size_mm}
    assert refused_keys({**MAPPING, "board": {**board, "corner_radius_mm": 20.1}}) == ["board.corner_radius_mm"]
    assert Tape.from_mapping({**MAPPING, "board": {**board, "corner_radius_mm": 20.0}}).board.corner_radius_mm == 20.0


def test_a_grid_has_at_least_a_window_and_not_too_many_points() -> None:
    smallest = tape_at(7, (4, 4)).to_mapping()
    assert Tape.from_mapping(smallest).to_mapping() == smallest
    wide = {**MAPPING, "code": "anoto-6x6", "sector": 0, "origin": [0, 0], "symbols": []}
    assert refused_keys({**wide, "columns": 1000, "rows": 500}) == ["symbols"]
    assert refused_keys({**wide, "columns": 1000, "rows": 501}) == ["columns"]


def test_points_are_omitted_to_the_last_one_and_each_once() -> None:
    last = [[TAPE.columns - 1, 0], [0, TAPE.rows - 1]]
    assert Tape.from_mapping(with_value(("omitted",), last)).omitted.tolist() == last
    for wrong in ([[TAPE.columns, 0]], [[0, TAPE.rows]], [[0, -1]], [[0]], [[0, False]], [last[0]] * 2):
        assert refused_keys(with_value(("omitted",), wrong)) == ["omitted"]


def test_bodies_that_are_long_leave_half_a_turn_open_and_others_four() -> None:
    part = TAPE.part
    for shape, body_mm, turns_deg in (
        ("block", (0.5, 0.4, 0.2), (0, 180)),
        ("block", (0.4, 0.5, 0.2), (0, 180)),
        ("block", (0.499, 0.4, 0.2), (0, 90, 180, 270)),
        ("block", (0.4, 0.4, 0.6), (0, 90, 180, 270)),
        ("dome", (0.5, 0.4, 0.2), (0, 90, 180, 270)),
    ):
        assert replace(part, shape=shape, body_mm=body_mm).open_turns_deg == turns_deg


def test_of_long_bodies_the_direction_is_felt_and_of_others_not() -> None:
    assert replace(TAPE.part, rotation_deg=-135.0).relief == TAPE.part.relief != replace(TAPE.part, rotation_deg=135.0).relief
    dome = replace(TAPE.part, shape="dome", body_mm=(0.5, 0.5, 0.2))
    assert dome.relief == ("dome", (0.5, 0.5, 0.2), 0.0)
    assert replace(dome, rotation_deg=0.0).relief == dome.relief != replace(dome, body_mm=(0.6, 0.6, 0.2)).relief


def test_parts_are_where_the_design_has_them_unless_they_were_measured() -> None:
    assert TAPE.as_built is None and TAPE.present.tolist() == TAPE.placed.tolist()
    plain = TAPE.built_parts()
    assert plain.shift_mm.shape == (TAPE.part_count, 2) and plain.present.all() and TAPE.part_count > 9
    assert not (plain.shift_mm.any() or plain.rotation_deg.any() or plain.sigma_mm.any())
    built, _ = measured(TAPE, 0.05, missing=0.2)
    assert built.as_built is not None and built.as_built.missing > 0
    found, there = built.built_parts(), built.as_built.present
    assert found.shift_mm[:, 0].tolist() == built.as_built.dx_mm.tolist() and found.present.tolist() == there.tolist()
    gone = {tuple(cell) for cell in TAPE.cells()[~there].tolist()} | {tuple(cell) for cell in TAPE.omitted.tolist()}
    assert {(c, r) for r, c in np.argwhere(~built.present).tolist()} == gone
    assert built.placed.tolist() == TAPE.placed.tolist()


def test_eight_directions_are_told() -> None:
    assert (TAPE.in_directions, replace(TAPE, directions=8).in_directions) == ("", " in 8 directions")
    assert replace(TAPE, directions=8).points_in.count == 8


def test_tapes_that_read_the_same_have_one_key() -> None:
    same = replace(TAPE, name="other", pitch_mm=2.0, tag=None)
    assert same.texture_key == TAPE.texture_key != replace(TAPE, sector=101).texture_key


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("symbols", 3, "symbols is not"),
        ("omitted", [[1]], "omitted is not a list of"),
        ("omitted", [[1, 1], [1, 1]], "omitted names a grid point twice"),
        ("sector", 101, "symbols differ from code"),
    ],
)
def test_symbols_that_cannot_be_are_refused_once_with_a_remedy(key: str, value: object, said: str) -> None:
    with pytest.raises(SpecError) as refused:
        Tape.from_mapping(with_value((key,), value))
    message = str(refused.value)
    assert message.startswith(said) and message.endswith("; make the kit again") and "\n" not in message


def test_one_changed_symbol_is_found_and_its_place_named() -> None:
    rows = list(MAPPING["symbols"])
    old = rows[3][5]
    new = "N" if old != "N" else "S"
    rows[3] = rows[3][:5] + new + rows[3][6:]
    with pytest.raises(SpecError, match=f"at 1 grid points, first at column 5, row 3: '{new}' where the code has '{old}'"):
        Tape.from_mapping(with_value(("symbols",), rows))


@pytest.mark.parametrize("path", [("sector",), ("origin",), ("code",)])
def test_another_place_in_the_code_contradicts_the_symbols(path: tuple[str, ...]) -> None:
    other = {"sector": 101, "origin": [0, 0], "code": "debruijn-4x4"}[path[0]]
    assert "symbols" in refused_keys(with_value(path, other))


@pytest.mark.parametrize(
    "change",
    [
        lambda rows: rows[:-1],
        lambda rows: [*rows, rows[0]],
        lambda rows: [rows[0][:-1], *rows[1:]],
        lambda rows: [rows[0].lower(), *rows[1:]],
        lambda rows: ["\u00c9" * len(rows[0]), *rows[1:]],
        lambda rows: ["\ud800" * len(rows[0]), *rows[1:]],
        lambda rows: [list(rows[0]), *rows[1:]],
        "".join,
    ],
)
def test_symbols_of_another_form_are_named(change: Callable[[list[str]], Any]) -> None:
    assert "symbols" in refused_keys(with_value(("symbols",), change(list(MAPPING["symbols"]))))


def test_all_problems_come_together() -> None:
    mapping = with_value(("sector",), -1) | {"pitch_mm": math.nan, "name": "?"}
    assert set(refused_keys(mapping)) >= {"sector", "pitch_mm", "name"}


@settings(deadline=None, derandomize=True, max_examples=400)
@given(path=st.sampled_from(PATHS), value=JSON)
def test_any_json_value_is_understood_or_refused(path: tuple[str, ...], value: Any) -> None:
    mapping = with_value(path, value)
    try:
        tape = Tape.from_mapping(mapping)
    except SpecError as error:
        assert error.problems
        assert all(p.key and p.message for p in error.problems)
    else:
        assert tape.to_mapping() == mapping


@settings(deadline=None, derandomize=True, max_examples=100)
@given(value=JSON)
def test_any_json_file_is_understood_or_refused(value: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.getbasetemp() / "any.json"
    file.write_text(json.dumps(value))
    with pytest.raises(SpecError):
        Tape.load(file)
    file.write_text(json.dumps({"format": MANIFEST_FORMAT, "symbols": value, "board": value}))
    with pytest.raises(SpecError):
        Tape.load(file)


TEXT = json.dumps({"format": MANIFEST_FORMAT, **MAPPING})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "cannot be read as JSON"),
        (TEXT.encode()[:-20], "cannot be read as JSON"),
        (b"\x00\xff\xfe" * 50, "cannot be read as JSON"),
        (b"[" * 100_000, "cannot be read as JSON"),
        (b'{"sector": ' + b"9" * 5000 + b"}", "cannot be read as JSON"),
        (b"[]", "has format None"),
        (b"{}", "has format None"),
        (TEXT.replace("manifest/1", "manifest/2").encode(), "has format 'tactape-manifest/2'; this version reads"),
        (TEXT.replace(MANIFEST_FORMAT, "tactape-panel/1").encode(), "is that of a panel, not of one tape"),
    ],
    ids=["empty", "truncated", "binary", "deep", "long-number", "list", "no-format", "newer", "panel"],
)
def test_a_file_that_is_no_manifest(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "manifest.json").write_bytes(content)
    with pytest.raises(SpecError, match=f"^{re.escape(str(tmp_path))}.*{message}"):
        Tape.load(tmp_path)


def test_a_wrong_value_is_named_with_its_kit(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text(json.dumps({"format": MANIFEST_FORMAT, **MAPPING, "rows": 1}))
    with pytest.raises(SpecError, match=f"^{re.escape(str(tmp_path))}: rows = 1 is outside") as refused:
        Tape.load(tmp_path)
    assert refused.value.problems[0].of_file


def test_a_place_without_a_kit(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=r"is no kit: it holds no manifest\.json"):
        find_manifest(tmp_path)
    with pytest.raises(SpecError, match="is no kit: there is no such file"):
        find_manifest(tmp_path / "nothing")


def test_an_unfinished_folder_is_never_a_kit(tmp_path: Path, small_kit: Kit) -> None:
    folder = tmp_path / f".kit.x{UNFINISHED_SUFFIX}"
    folder.mkdir()
    (folder / "manifest.json").write_bytes((small_kit.path / "manifest.json").read_bytes())
    for place in (folder, folder / "manifest.json"):
        with pytest.raises(SpecError, match="unfinished kit"):
            Tape.load(place)


@pytest.mark.parametrize(
    ("delta", "refused", "found", "problems"),
    [(None, False, 0.25, 0), (0.3, False, 0.3, 0), (0.75, False, 0.25, 1), (0.75, True, 0.25, 0), (0.0, True, 0.25, 1)],
)
def test_a_displacement_without_a_manifest(delta: float | None, refused: bool, found: float, problems: int) -> None:
    """Of 1.5 mm it is less than half, unless the pitch is not known."""
    table = Fields({} if delta is None else {"delta": delta})
    assert read_displacement(table, "delta", 1.5, pitch_refused=refused) == found
    assert len(table.problems) == problems


def test_whether_a_board_bends_is_no_part_of_its_record() -> None:
    """Files and answers are told by what a tape shows: a manifest that does not say it is of the same tape."""
    tape = tape_at(7, (6, 5))
    bent = replace(tape, board=replace(tape.board, flexible=True))
    assert bent.board == tape.board and repr(bent.board) == repr(tape.board) and bent.to_mapping() == tape.to_mapping()


def test_films_bear_what_the_generic_fab_says() -> None:
    bend = load_fab("generic-fpc").bend
    assert bend is not None and bend.least_thicknesses == LEAST_BEND_THICKNESSES
