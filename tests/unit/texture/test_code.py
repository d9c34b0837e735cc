"""Codes as objects: what each has and does whatever its family, and that nobody outside texture asks for a code by its name."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tactape_fab
from tactape_fab import default_origin
from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import Fields
from tactape_fab.texture.code import (
    ALL_CODE_NAMES,
    CODE_NAMES,
    CODES,
    DEFAULT_CODE,
    Code,
    get_code,
    get_plane,
    has_plane,
    read_directions,
)
from tactape_fab.texture.directions import DIRECTIONS, USUAL_DIRECTIONS
from tactape_fab.texture.plane import MOST_POINTS
from tactape_fab.texture.touch.design import MOST_TOUCH_POINTS
from tests.thorough import slow

PACKAGE = Path(tactape_fab.__file__).parent
SHAPE = (9, 11)

every_code = pytest.mark.parametrize("code", CODES.values(), ids=CODES)


# What every code has


def test_names_are_views_of_the_registry() -> None:
    assert tuple(CODES) == ALL_CODE_NAMES and CODE_NAMES[0] == DEFAULT_CODE
    assert tuple(name for name, code in CODES.items() if code.plane is not None) == CODE_NAMES
    assert all(get_code(name) is code and code.name == name for name, code in CODES.items())


@every_code
def test_a_code_says_what_its_tapes_may_be(code: Code) -> None:
    assert 1 <= code.window <= code.range
    assert code.window**2 <= code.most_points <= MOST_POINTS
    assert code.sectors >= 1
    assert USUAL_DIRECTIONS in code.directions and set(code.directions) <= set(DIRECTIONS)
    assert "--" in code.another
    assert code.proven_by


def test_codes_are_those_that_kits_were_made_with() -> None:
    """A code that changes makes other tapes under the same name; the figures are those of the pages on codes."""
    expected = {
        "microdots-4x4": (4, 27 * 125, 16**2, MOST_POINTS),
        "debruijn-4x4": (4, 16**3, 16**2, MOST_POINTS),
        "anoto-6x6": (6, 236 * 233 * 31 * 241, 63**2, MOST_POINTS),
        "trace-22": (4, 127, 256, 127 * 127),
        "touch-1": (4, 2000, 4096, MOST_TOUCH_POINTS),
        "touch-2": (4, 2000, 4096, MOST_TOUCH_POINTS),
    }
    assert {n: (code.window, code.range, code.sectors, code.most_points) for n, code in CODES.items()} == expected, (
        "enter the figures of a new code; never change those of one that kits were made with"
    )
    assert default_origin("microdots-4x4", 7) == (12 * 7, 12 * (17 * 7 % 256))
    assert default_origin("debruijn-4x4", 7) == (12 * 7, 12 * (17 * 7 % 256))
    assert default_origin("anoto-6x6", 300) == (1000 * 300, 1000 * (17 * 300 % 3969))


@pytest.mark.parametrize(
    ("name", "digest"),
    [("debruijn-4x4", "3e20efb7f73bb96a"), ("trace-22", "f6786bed15b01f17")],
)
def test_symbols_without_a_published_table_stay_the_same(name: str, digest: str) -> None:
    """Microdots' and Anoto's are held against tables of others (test_plane); a touch code's stand in the manifest."""
    code = CODES[name]
    symbols = code.symbols(7, default_origin(name, 7), (40, 50), (), 4)
    assert sha256(symbols.tobytes()).hexdigest()[:16] == digest


@every_code
def test_a_code_has_a_plane_or_designs_its_tapes(code: Code) -> None:
    assert has_plane(code.name) is (code.plane is not None) is (code.name in CODE_NAMES)
    if code.plane is None:
        with pytest.raises(SpecError, match=f"'{code.name}' has no code plane"):
            get_plane(code.name)
    else:
        assert get_plane(code.name) is code.plane and code.plane.name == code.name


@every_code
def test_default_origins_lie_where_tapes_may_begin(code: Code) -> None:
    for sector in {0, 1, code.sectors // 2, code.sectors - 1}:
        origin = code.default_origin(sector)
        assert default_origin(code.name, sector) == origin
        assert all(0 <= place <= code.range - code.window for place in origin)
    with pytest.raises(SpecError, match=f"sector = {code.sectors} is outside 0 to {code.sectors - 1} of code '{code.name}'"):
        default_origin(code.name, code.sectors)
    given: Any
    for given in (True, 1.5, "1"):
        with pytest.raises(SpecError, match=f"is not a whole number; give one from 0 to {code.sectors - 1}$"):
            default_origin(code.name, given)


@every_code
def test_symbols_are_the_same_again_and_others_in_another_sector(code: Code) -> None:
    for directions in code.directions:
        first = code.symbols(3, code.default_origin(3), SHAPE, (), directions)
        again = code.symbols(3, code.default_origin(3), SHAPE, (), directions)
        other = code.symbols(4, code.default_origin(4), SHAPE, (), directions)
        assert first.shape == SHAPE and first.dtype == np.uint8 and first.max() < directions
        assert np.array_equal(first, again) and not np.array_equal(first, other)


@every_code
def test_equal_textures_have_one_key_and_others_another(code: Code) -> None:
    origin = code.default_origin(3)
    symbols = code.symbols(3, origin, SHAPE, (), USUAL_DIRECTIONS)
    key = code.texture_key(3, origin, symbols)
    assert hash(key) == hash(code.texture_key(3, origin, symbols.copy())) and key == code.texture_key(3, origin, symbols.copy())
    assert key != code.texture_key(
        4, code.default_origin(4), code.symbols(4, code.default_origin(4), SHAPE, (), USUAL_DIRECTIONS)
    )
    changed = symbols.copy()
    changed[0, 0] ^= 1
    assert (code.texture_key(3, origin, changed) != key) is (code.plane is None)  # a plane's symbols follow from the place


@every_code
def test_extended_symbols_are_the_texture_s_own(code: Code) -> None:
    origin = code.default_origin(3)
    symbols = code.symbols(3, origin, SHAPE, (), USUAL_DIRECTIONS)
    rows, columns = SHAPE if code.plane is None else (SHAPE[0] + 2, SHAPE[1] + 3)
    larger = code.extended(symbols, 3, origin, (rows, columns))
    assert larger.shape == (rows, columns) and np.array_equal(larger[: SHAPE[0], : SHAPE[1]], symbols)


@every_code
def test_a_manifest_s_symbols_are_vouched_for(code: Code) -> None:
    origin = code.default_origin(3)
    symbols = code.symbols(3, origin, SHAPE, (), USUAL_DIRECTIONS)
    entry = code.digest_entry(symbols)
    assert set(entry) == ({"symbols_sha256"} if code.plane is None else set())
    code.check_symbols(symbols, 3, origin, Fields(entry))
    changed = symbols.copy()
    changed[2, 5] = (changed[2, 5] + 1) % USUAL_DIRECTIONS
    with pytest.raises(SpecError, match="symbols") as caught:
        code.check_symbols(changed, 3, origin, Fields(entry))
    place = f"sector 3, origin [{origin[0]}, {origin[1]}] at 1 grid points, first at column 5, row 2: "
    assert code.plane is None or place in str(caught.value)


@every_code
@pytest.mark.parametrize("directions", DIRECTIONS)
def test_directions_are_read_as_the_code_allows_them(code: Code, directions: int) -> None:
    table = Fields({"directions": directions})
    assert read_directions(table, code) == directions
    assert [p.key for p in table.problems] == ([] if directions in code.directions else ["directions"])
    assert all("only touch-1 and touch-2 have 8; use --code touch-1, or --directions 4" in p.message for p in table.problems)


@pytest.mark.parametrize("value", [0, 1, 5, 16, 4.0, True, "4", None, []])
def test_other_directions_are_refused(value: Any) -> None:
    table = Fields({"directions": value})
    assert read_directions(table, None) == USUAL_DIRECTIONS
    assert ["is neither 4 nor 8" in p.message for p in table.problems] == [True]


def test_without_a_known_code_any_known_directions_are_taken() -> None:
    table = Fields({"directions": 8})
    assert read_directions(table, None) == 8 and read_directions(Fields({}), None) == USUAL_DIRECTIONS and not table.problems


@pytest.mark.parametrize("name", ["morse", "", None, 7, ["touch-1"]])
def test_what_is_no_code_counts_as_one_with_a_plane(name: Any) -> None:
    assert has_plane(name)


@pytest.mark.parametrize(("get", "names"), [(get_code, ALL_CODE_NAMES), (get_plane, CODE_NAMES)])
def test_unknown_code_names_the_known_ones(get: Any, names: tuple[str, ...]) -> None:
    with pytest.raises(SpecError, match=rf"^code = 'morse' is none of: {', '.join(names)}$"):
        get("morse")


# Who asks for a code by its name


def _named(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def asked_by_name(source: str, *, directions: bool) -> Iterator[str]:
    """Lines that name the touch code's constant, compare something with a code's name, or directions with a number."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.alias | ast.Name | ast.Attribute):
            if (node.name if isinstance(node, ast.alias) else _named(node)) == "TOUCH_CODE":
                yield f"{node.lineno}: TOUCH_CODE"
        elif isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            values = [side.value for side in sides if isinstance(side, ast.Constant)]
            if any(value in ALL_CODE_NAMES for value in values):
                yield f"{node.lineno}: a code's name"
            if directions and any("directions" in _named(side) for side in sides) and any(type(v) is int for v in values):
                yield f"{node.lineno}: directions"


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("from tactape_fab.texture.code import TOUCH_CODE", 1),
        ("x = code.TOUCH_CODE", 1),
        ("if tape.code == 'touch-1': pass", 1),
        ("a = 4 if tape.directions == 8 else 2", 1),
        ("a = directions != 4", 1),
        ("code = get_code('touch-1'); a = {4: 1.0, 8: 2.0}[tape.directions]", 0),
        ("a = tape.directions != spec.directions", 0),
    ],
)
def test_the_scan_finds_what_it_looks_for(source: str, found: int) -> None:
    assert len(list(asked_by_name(source, directions=True))) == found


@slow
def test_no_room_but_texture_asks_which_code_or_how_many_directions() -> None:
    """Arithmetic that differs by the number of directions is the decoder's alone."""
    said = [
        f"{file.relative_to(PACKAGE)}:{line}"
        for file in sorted(PACKAGE.rglob("*.py"))
        if (room := file.relative_to(PACKAGE).parts)[0] != "texture"
        for line in asked_by_name(file.read_text(encoding="utf-8"), directions=room[:2] != ("sense", "decode"))
    ]
    assert said == []
