"""TapeSpec: defaults, round trip, and every bad value refused in words, all of them together."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactape_fab import TapeSpec
from tactape_fab.base.errors import CapacityError, SpecError
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.spec.tape_spec import KEYS, read_spec_file
from tactape_fab.texture.code import ALL_CODE_NAMES
from tests.unit.base.test_fields import JSON


def refusal(values: dict[str, Any]) -> SpecError:
    with pytest.raises(SpecError) as caught:
        TapeSpec.from_mapping(values)
    return caught.value


def test_defaults() -> None:
    spec = TapeSpec(sector=7)
    assert spec.to_mapping() == {
        "sector": 7,
        "pitch_mm": 1.5,
        "displacement_mm": 0.25,
        "size_mm": [100.0, 50.0],
        "code": "microdots-4x4",
        "origin": [84, 1428],
        "tag": "strip",
        "tag_id": 7,
        "tag_cell_mm": 0.5,
        "part": "r0201",
        "rotation_deg": 45.0,
        "fab": "generic-fpc",
        "assembly": None,
        "part_number": None,
        "x2": None,
        "corner_radius_mm": 1.0,
        "holes_mm": [],
        "name": "tactape-s007",
        "body_mm": None,
        "dome_top_mm": None,
        "process": None,
        "models": True,
        "base_mm": 0.8,
        "negative": False,
        "top": "tiles",
        "cylinder_mm": None,
        "around": None,
        "shell": None,
        "coverlay": None,
        "anchor": "none",
        "stiffener": None,
        "adhesive": None,
        "bend_axis": None,
        "bend_radius_mm": None,
    }


@pytest.mark.parametrize(("pitch_mm", "displacement_mm"), [(1.5, 0.25), (3.0, 0.5), (2.0, 0.333333)])
def test_displacement_is_a_sixth_of_the_pitch_where_none_is_given(pitch_mm: float, displacement_mm: float) -> None:
    assert TapeSpec(sector=0, pitch_mm=pitch_mm).displacement_mm == displacement_mm


def test_tag_id_follows_the_sector_unless_given_or_without_a_strip() -> None:
    assert TapeSpec(sector=255).tag_id == 255
    assert TapeSpec(sector=3968, code="anoto-6x6", tag_id=586).tag_id == 586
    assert TapeSpec(sector=3968, code="anoto-6x6", tag="none").tag_id is None


def test_whole_millimetres_may_be_written_without_a_point() -> None:
    spec = TapeSpec.from_mapping({"sector": 7, "size_mm": [100, 50], "pitch_mm": 2})
    assert (spec.size_mm, spec.pitch_mm) == ((100.0, 50.0), 2.0)


def test_lengths_are_snapped_to_a_nanometre() -> None:
    spec = TapeSpec(sector=0, pitch_mm=1.50000049, size_mm=(100.0000004, 50.0))
    assert (spec.pitch_mm, spec.size_mm) == (1.5, (100.0, 50.0))


BAD: list[tuple[dict[str, Any], str, str]] = [
    ({"sector": 256}, "sector", "sector = 256 is outside 0 to 255; code 'microdots-4x4' has 256 sectors"),
    ({"sector": -1}, "sector", "sector = -1 is outside 0 to 255"),
    ({"sector": 7.5}, "sector", "sector = 7.5 is not a whole number"),
    ({"sector": True}, "sector", "sector = True is not a whole number"),
    ({"sector": "seven"}, "sector", "sector = 'seven' is not a whole number"),
    ({"sector": 3969, "code": "anoto-6x6"}, "sector", "sector = 3969 is outside 0 to 3968"),
    ({"pitch_mm": math.nan}, "pitch_mm", "pitch_mm = nan mm is not a finite number; --w is the grid pitch in millimetres"),
    ({"pitch_mm": math.inf}, "pitch_mm", "pitch_mm = inf mm is not a finite number"),
    ({"pitch_mm": 0.0}, "pitch_mm", "pitch_mm = 0 mm is below 0.2 mm"),
    ({"pitch_mm": -1.5}, "pitch_mm", "pitch_mm = -1.5 mm is below 0.2 mm"),
    ({"pitch_mm": 1500.0}, "pitch_mm", "pitch_mm = 1500 mm exceeds 20 mm"),
    ({"pitch_mm": "1.5mm"}, "pitch_mm", "pitch_mm = '1.5mm' is not a number in mm"),
    ({"displacement_mm": 0.75}, "displacement_mm", "displacement_mm = 0.75 mm is not below 0.75 mm; --delta is the displacement"),
    ({"displacement_mm": 0.0}, "displacement_mm", "displacement_mm = 0 mm is below 0.02 mm"),
    ({"displacement_mm": math.nan}, "displacement_mm", "displacement_mm = nan mm is not a finite number"),
    ({"size_mm": [100.0]}, "size_mm", "size_mm = [100.0] is not 2 numbers; give WIDTHxHEIGHT in millimetres"),
    ({"size_mm": "100x50"}, "size_mm", "size_mm = '100x50' is not 2 numbers"),
    ({"size_mm": [0.0, 50.0]}, "size_mm[0]", "size_mm[0] = 0 mm is not above 0 mm"),
    ({"size_mm": [100.0, math.nan]}, "size_mm[1]", "size_mm[1] = nan mm is not a finite number"),
    ({"size_mm": [1e7, 50.0]}, "size_mm[0]", "size_mm[0] = 1e+07 mm exceeds 10000 mm"),
    ({"code": "qr"}, "code", f"code = 'qr' is none of: {', '.join(ALL_CODE_NAMES)}"),
    ({"origin": [3375, 0]}, "origin[0]", "origin[0] = 3375 is outside 0 to 3374; give --origin COL,ROW"),
    ({"origin": [0, -1]}, "origin[1]", "origin[1] = -1 is outside 0 to 3374"),
    ({"origin": [0]}, "origin", "origin = [0] is not 2 whole numbers"),
    ({"tag": "both"}, "tag", "tag = 'both' is none of: strip, none"),
    ({"tag_id": 587}, "tag_id", "tag_id = 587 is outside 0 to 586; family tag36h11 has 587 ids"),
    ({"tag": "none", "tag_id": 3}, "tag_id", "tag_id = 3 contradicts tag = 'none'"),
    (
        {"sector": 587, "code": "anoto-6x6"},
        "tag_id",
        "exceeds 586, the last id of tag36h11; choose an id with --tag-id or",
    ),
    ({"tag_cell_mm": 0.2}, "tag_cell_mm", "tag_cell_mm = 0.2 mm is below 0.3 mm"),
    ({"rotation_deg": 400.0}, "rotation_deg", "rotation_deg = 400 deg exceeds 360 deg"),
    ({"rotation_deg": -400.0}, "rotation_deg", "rotation_deg = -400 deg is below -360 deg"),
    ({"part": "r9999"}, "part", f"part = 'r9999' is none of: {', '.join(profile_names('parts'))}, nor the path of a .toml file"),
    ({"part": 201}, "part", "part = 201 is not a text"),
    (
        {"fab": "acme"},
        "fab",
        f"fab = 'acme' is none of: {', '.join(profile_names('fabs'))}, nor the path of a .toml file",
    ),
    ({"assembly": "yes"}, "assembly", "assembly = 'yes' is none of: generic, jlcpcb"),
    ({"x2": "on"}, "x2", "x2 = 'on' is none of: full, comments, off"),
    (
        {"corner_radius_mm": 25.1},
        "corner_radius_mm",
        "corner_radius_mm = 25.1 mm exceeds 25 mm; give at most half",
    ),
    ({"corner_radius_mm": -1.0}, "corner_radius_mm", "corner_radius_mm = -1 mm is below 0 mm"),
    ({"holes_mm": "10,10,2"}, "holes_mm", "holes_mm = '10,10,2' is not a list"),
    ({"holes_mm": [[10.0, 10.0]]}, "holes_mm[0]", "holes_mm[0] = [10.0, 10.0] is not 3 numbers; give X,Y,DIAMETER"),
    ({"holes_mm": [[10.0, 10.0, 0.0]]}, "holes_mm[0][2]", "holes_mm[0][2] = 0 mm is not above 0 mm"),
    ({"holes_mm": [[99.5, 10.0, 2.0]]}, "holes_mm[0]", "holes_mm[0] = 99.5,10,2 mm does not lie inside the outline 100 x 50 mm"),
    ({"name": "a/b"}, "name", "name = 'a/b' has a form that cannot be used; use 1 to 64 letters"),
    ({"name": ".hidden"}, "name", "digits, '.', '_', '-', a letter or digit first"),
    ({"name": "x" * 65}, "name", "has a form that cannot be used"),
    *(
        ({"name": name}, "name", "none that Windows keeps for a device")
        for name in ("con", "NUL", "Com1", "lpt9.tape", "aux.x.y")
    ),
    ({"name": "tape."}, "name", "no '.' last"),
    ({"size_mm": "100x50"}, "size_mm", "such as 100x50, or [100, 50] in TOML and Python"),
    ({"part": "block", "body_mm": "0.8x0.4"}, "body_mm", "or [LENGTH, WIDTH, HEIGHT] in TOML and Python"),
    ({"part": "dome", "body_mm": "0.8x0.4"}, "body_mm", "or [DIAMETER, HEIGHT] in TOML and Python"),
    ({"holes_mm": ["50,25,1"]}, "holes_mm[0]", "or [X, Y, DIAMETER] in TOML and Python"),
    ({"origin": "0,0"}, "origin", "in TOML and Python give [COL, ROW]"),
    ({"mark": True}, "mark", "leave out --no-mark, in TOML and Python mark"),
    ({"w": 1.5}, "w", "w is not a known key"),
    ({"secter": 7}, "secter", "secter is not a known key; did you mean 'sector'?"),
]


@pytest.mark.parametrize(("values", "key", "message"), BAD, ids=[json.dumps(values) for values, _, _ in BAD])
def test_a_bad_value_is_refused_in_words(values: dict[str, Any], key: str, message: str) -> None:
    error = refusal({"sector": 7, **values})
    assert [p.key for p in error.problems] == [key]
    assert message in error.problems[0].message


@pytest.mark.parametrize("name", ["console", "com10", "nul-1", "tape.con"])
def test_names_like_those_of_devices_are_taken(name: str) -> None:
    assert TapeSpec.from_mapping({"sector": 7, "name": name}).name == name


def test_a_missing_sector_says_how_to_give_it() -> None:
    assert str(refusal({})) == "sector is missing; give --sector N, or sector = N in the TOML file"


def test_all_problems_come_together() -> None:
    error = refusal({"pitch_mm": math.nan, "size_mm": [1e9, -1], "code": "qr", "colour": "red", "tag_id": -1})
    assert {p.key for p in error.problems} == {"sector", "pitch_mm", "size_mm[0]", "size_mm[1]", "code", "colour", "tag_id"}


def test_only_a_lack_of_reach_is_a_capacity_error() -> None:
    assert isinstance(refusal({"sector": 7, "size_mm": [6000, 50]}), CapacityError)
    assert not isinstance(refusal({"sector": 7, "size_mm": [6000, 50], "pitch_mm": -1}), CapacityError)


def test_broken_design_rules_are_listed_beside_refused_values() -> None:
    with pytest.raises(SpecError) as caught:
        examine({"sector": 7, "displacement_mm": 0.5, "coverlay": "per-part", "tag": "both"})
    assert [p.key for p in caught.value.problems] == ["tag"]
    assert "opening-bridge" in {f.rule for f in caught.value.findings}
    assert all(f.blocks for f in caught.value.findings)


@pytest.mark.parametrize(("pitch_mm", "displacement_mm"), [(0.2, 0.02), (20.0, 9.99), (1.5, 0.749999)])
def test_extreme_but_legal_numbers_are_taken(pitch_mm: float, displacement_mm: float) -> None:
    spec = TapeSpec(sector=0, pitch_mm=pitch_mm, displacement_mm=displacement_mm)
    assert (spec.pitch_mm, spec.displacement_mm) == (pitch_mm, displacement_mm)


@settings(deadline=None, derandomize=True, max_examples=300)
@given(key=st.sampled_from([*KEYS, "other"]), value=JSON)
def test_any_value_of_any_key_is_understood_or_refused(key: str, value: Any) -> None:
    try:
        spec = TapeSpec.from_mapping({"sector": 7, key: value})
    except SpecError as error:
        assert all(p.message for p in error.problems)
    else:
        assert TapeSpec.from_mapping(json.loads(json.dumps(spec.to_mapping()))) == spec


# From a file


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "tape.toml"
    path.write_text(text)
    return path


def test_a_spec_file_gives_the_same_spec(tmp_path: Path) -> None:
    path = written(tmp_path, 'sector = 9\nsize_mm = [30, 25.5]\ntag = "none"\nholes_mm = [[15, 12, 1.5]]\n')
    assert TapeSpec.from_mapping(read_spec_file(path)) == TapeSpec(
        sector=9, size_mm=(30.0, 25.5), tag="none", holes_mm=((15.0, 12.0, 1.5),)
    )


def test_profile_paths_are_relative_to_the_spec_file(tmp_path: Path) -> None:
    values = read_spec_file(written(tmp_path, 'sector = 9\nfab = "mine.toml"\npart = "r0201"\n'))
    assert values == {"sector": 9, "fab": str(tmp_path / "mine.toml"), "part": "r0201"}
    with pytest.raises(SpecError, match=r"fab = .*mine\.toml cannot be opened"):
        examine(TapeSpec.from_mapping(values))


@pytest.mark.parametrize(
    "text",
    [
        "sector 7",
        "sector = ",
        "sector = 7\nsector = 8",
        "[[[[",
        "sector = " + "[" * 5000,
        "a = 2020-13-45",
        "sector = " + "9" * 5000,
        "sector = 0x" + "f" * 5000,
    ],
    ids=["no-equals", "no-value", "twice", "open", "deep", "date", "long-number", "long-hexadecimal"],
)
def test_a_file_that_is_no_toml(tmp_path: Path, text: str) -> None:
    with pytest.raises(SpecError, match="is not TOML") as refused:
        read_spec_file(written(tmp_path, text))
    assert "sys." not in str(refused.value)  # nothing to call


@pytest.mark.parametrize("text", ["sector = 1979-05-27", "sector = 07:32:00", "sector = 0x" + "f" * 2000, "sector = nan"])
def test_toml_values_that_are_no_sector(tmp_path: Path, text: str) -> None:
    error = refusal(read_spec_file(written(tmp_path, text)))
    assert [p.key for p in error.problems] == ["sector"]


def test_bytes_that_are_no_text_and_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SpecError, match="is not TOML"):
        read_spec_file(tmp_path / "bytes.toml")
    with pytest.raises(SpecError, match="cannot be opened"):
        read_spec_file(tmp_path / "nothing.toml")
    with pytest.raises(SpecError, match="cannot be opened"):
        read_spec_file(tmp_path)
