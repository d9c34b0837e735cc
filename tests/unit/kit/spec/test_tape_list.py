"""Lists of tapes: sectors in words, tables of a spec file, options over both."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactape_fab.base.errors import SpecError
from tactape_fab.kit.spec.sectors import read_sectors
from tactape_fab.kit.spec.tape_list import is_list, read_list, read_list_file


@pytest.mark.parametrize(
    ("value", "sectors"),
    [
        ("7", (7,)),
        ("7,8,9", (7, 8, 9)),
        ("0-3", (0, 1, 2, 3)),
        ("0-2,20", (0, 1, 2, 20)),
        (" 9 , 3-4 ", (9, 3, 4)),
        ("5-5", (5,)),
        ([3, 1], (3, 1)),
        ("0-255", tuple(range(256))),
    ],
)
def test_sectors_in_words(value: object, sectors: tuple[int, ...]) -> None:
    assert read_sectors(value, 256) == sectors


@given(st.sets(st.integers(0, 3968), min_size=1, max_size=40).map(sorted))
def test_sectors_written_in_any_way_are_read_back(sectors: list[int]) -> None:
    ranges: list[list[int]] = []
    for sector in sectors:
        if ranges and ranges[-1][-1] == sector - 1:
            ranges[-1].append(sector)
        else:
            ranges.append([sector])
    text = ",".join(f"{r[0]}-{r[-1]}" if len(r) > 1 else f"{r[0]}" for r in ranges)
    assert read_sectors(text, 3969) == read_sectors(",".join(map(str, sectors)), 3969) == tuple(sectors)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("", "names no sector"),
        ([], "names no sector"),
        ("7-", "holds '7-'"),
        ("-7", "holds '-7'"),
        ("1..4", "holds '1..4'"),
        ("7;8", "holds '7;8'"),
        ("7,,8", "holds ''"),
        ("٣", "holds '٣'"),
        ("1_0", "holds '1_0'"),
        ("9-3", "runs backwards; give 3-9"),
        ("256", "holds 256, outside 0 to 255; the code has 256 sectors"),
        ("0-999999999999", "outside 0 to 255"),
        ("0-3,2", "names sector 2 more than once"),
        ("0-9,0-9", "names sector 0, 1, 2, 3, 4 and 5 more more than once"),
        ([1, True], "holds True"),
        ([1, -1], "holds -1"),
        ([1, 2.0], "holds 2.0"),
        (7, "is no list of sectors"),
        ([0] * 5000, "has 5000 entries, more than 4096"),
    ],
)
def test_what_is_no_list_of_sectors_is_refused(value: object, said: str) -> None:
    with pytest.raises(SpecError) as caught:
        read_sectors(value, 256)
    assert said in str(caught.value)
    assert all("; " in problem.message for problem in caught.value.problems)


def test_all_that_is_wrong_with_sectors_is_said() -> None:
    with pytest.raises(SpecError) as caught:
        read_sectors("3-1,400,x,2,2", 256)
    assert len(caught.value.problems) == 4


@pytest.mark.parametrize(
    ("values", "options", "several"),
    [
        ({}, {"sector": 7}, False),
        ({}, {"sectors": "7"}, True),
        ({"tapes": []}, {}, True),
        ({"sectors": "1-3"}, {}, True),
        ({"sectors": "1-3"}, {"sector": 2}, False),
        ({"sector": 2}, {"sectors": "1-3"}, True),
    ],
)
def test_what_is_a_list(values: dict[str, Any], options: dict[str, Any], several: bool) -> None:
    assert is_list(values, options) is several


def test_tables_inherit_and_options_override() -> None:
    values = {
        "fab": "jlcpcb-fpc",
        "size_mm": [60, 40],
        "tapes": [{"sector": 3}, {"sectors": "5-6", "size_mm": [30, 20]}, {"sector": 9, "name": "nine", "fab": "generic-fpc"}],
    }
    entries, problems = read_list(values, {"models": False, "fab": "pcbway-fpc"})
    assert problems == []
    assert [(e.where, e.of_sector) for e in entries] == [
        ("tapes[0]: ", ""),
        ("tapes[1]: ", "sector 5: "),
        ("tapes[1]: ", "sector 6: "),
        ("tapes[2]: ", ""),
    ]
    assert [e.values["sector"] for e in entries] == [3, 5, 6, 9]
    assert [e.values["size_mm"] for e in entries] == [[60, 40], [30, 20], [30, 20], [60, 40]]
    assert all(e.values["fab"] == "pcbway-fpc" and e.values["models"] is False for e in entries)
    assert entries[3].values["name"] == "nine"
    assert all(set(e.values) <= {"fab", "size_mm", "sector", "models", "name"} for e in entries)


@pytest.mark.parametrize(
    ("values", "options", "said"),
    [
        ({"tapes": []}, {}, "tapes = [] is no list of tapes"),
        ({"tapes": "many"}, {}, "tapes = 'many' is no list of tapes"),
        ({"tapes": [3]}, {}, "tapes[0]: 3 is no table"),
        ({"tapes": [{}]}, {}, "tapes[0]: sector is missing"),
        ({"tapes": [{"sector": 1, "sectors": "2"}]}, {}, "tapes[0]: sector = 1 contradicts sectors = '2'"),
        ({"tapes": [{"sectors": "2-3", "name": "n"}]}, {}, "tapes[0]: name = 'n' cannot be that of all sectors"),
        ({"tapes": [{"sector": 1}], "sector": 2}, {}, "sector = 2 cannot be that of all tapes"),
        ({"tapes": [{"sector": 1}]}, {"sectors": "2"}, "sectors = '2' cannot be that of all tapes"),
        ({"tapes": [{"sector": 1}]}, {"name": "n"}, "name = 'n' cannot be that of all tapes"),
        ({}, {"sectors": "1-2", "name": "n"}, "name = 'n' cannot be that of all tapes"),
        ({}, {"sectors": "1-2", "sector": 4}, "sector = 4 contradicts sectors = '1-2'"),
        ({"tapes": [{"sectors": "0-255"}] * 20}, {}, "these are at least 4352, more than 4096 tapes"),
        ({"same_sector": True}, {"sectors": "1-2"}, "same_sector = True is of a panel"),
        ({"tapes": [{"sector": 1}]}, {"tabs": "x"}, "tabs = 'x' is of a panel"),
        ({"tapes": [{"sector": 1, "panel": "auto"}]}, {}, "tapes[0]: panel = 'auto' is of a panel"),
    ],
)
def test_contradictions_of_a_list_are_named(values: dict[str, Any], options: dict[str, Any], said: str) -> None:
    entries, problems = read_list(values, options)
    assert [said in problem.message for problem in problems].count(True) == 1
    assert len(entries) <= 4096


def test_options_take_the_place_of_the_file_s_sector() -> None:
    entries, problems = read_list({"sector": 7, "size_mm": [30, 20]}, {"sectors": "1-2"})
    assert problems == []
    assert [e.values for e in entries] == [{"size_mm": [30, 20], "sector": 1}, {"size_mm": [30, 20], "sector": 2}]


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text("sector = 1\n", encoding="utf-8-sig")
    assert read_list_file(tmp_path / "lab.toml") == {"sector": 1}


def test_profiles_in_tables_stand_beside_the_file(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text('fab = "a.toml"\n[[tapes]]\nsector = 1\npart = "b.toml"\n[[tapes]]\nsector = 2\npart = "r0201"\n')
    values = read_list_file(file)
    assert values["fab"] == str(tmp_path / "a.toml")
    assert [tape["part"] for tape in values["tapes"]] == [str(tmp_path / "b.toml"), "r0201"]
