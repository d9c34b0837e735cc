"""Tapes that a panel's manifest lists: what is read, what is refused, and whose folders are the panel's kits."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import Fields
from tactape_fab.texture.panel_manifest import PlacedTape, is_panel, kits_of, read_placed

ROW: dict[str, Any] = {
    "manifest": "tapes/a/manifest.json",
    "sha256": "0" * 64,
    "offset_mm": [5.0, 7.5],
    "rotation_deg": 90.0,
    "first_designator": "R217",
}


def test_tapes_are_read_with_their_places() -> None:
    table = Fields(
        {"tapes": [ROW, {**ROW, "manifest": "tapes/b.1_2-3/manifest.json", "rotation_deg": 0, "offset_mm": [0, 10000]}]}
    )
    first, second = read_placed(table)
    assert table.problems == []
    assert first == PlacedTape(**{**ROW, "offset_mm": (5.0, 7.5)}) and first.first_number == 217
    assert (second.offset_mm, second.rotation_deg) == ((0.0, 10000.0), 0.0)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"manifest": "tapes/../manifest.json"}, r"tapes\[1\].manifest = .*give tapes/NAME/manifest.json"),
        ({"manifest": f"tapes/{'a' * 65}/manifest.json"}, r"tapes\[1\].manifest = "),
        ({"sha256": "0" * 63}, r"tapes\[1\].sha256 = .*give 64 hexadecimal digits"),
        ({"offset_mm": [-0.1, 0.0]}, r"tapes\[1\].offset_mm\[0\] = -0.1 mm is below 0 mm"),
        ({"offset_mm": [0.0, 10000.1]}, r"tapes\[1\].offset_mm\[1\] = 10000.1 mm exceeds 10000 mm"),
        ({"offset_mm": [0.0, 0.0, 0.0]}, r"tapes\[1\].offset_mm = .* is not 2 numbers"),
        ({"rotation_deg": 0.5}, r"tapes\[1\].rotation_deg = 0.5 deg is no turn of a tape on a panel; give 0 or 90"),
        ({"rotation_deg": 180}, r"tapes\[1\].rotation_deg = 180 deg exceeds 90 deg; give 0 or 90"),
        ({"rotation_deg": -90}, r"tapes\[1\].rotation_deg = -90 deg is below 0 deg; give 0 or 90"),
        ({"first_designator": "R0"}, r"tapes\[1\].first_designator = .*give R and a number"),
        ({"first_designator": "R1234567890"}, r"tapes\[1\].first_designator = "),
    ],
)
def test_a_tape_that_cannot_be_placed_is_named(changed: dict[str, Any], says: str) -> None:
    table = Fields({"tapes": [{**ROW, "manifest": "tapes/b/manifest.json"}, {**ROW, **changed}]})
    read_placed(table)
    (problem,) = table.problems
    assert re.match(says, problem.message)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([], "names no tape"),
        ([ROW, ROW], "names a kit twice"),
        ([None], "manifest is missing"),
        ([ROW] * 10_001, "more than 10000"),
    ],
)
def test_lists_that_no_panel_has_are_refused(rows: list[Any], says: str) -> None:
    table = Fields({"tapes": rows})
    read_placed(table)
    assert any(says in problem.message for problem in table.problems)


def test_kits_of_a_panel_are_its_tapes_and_of_all_else_the_place_itself(tmp_path: Path) -> None:
    def written(**content: Any) -> Path:
        (tmp_path / "manifest.json").write_text(json.dumps(content))
        return tmp_path

    assert kits_of(tmp_path) == [tmp_path]  # no manifest: told when it is read as a kit
    kit, panel = {"format": "tactape-manifest/1"}, {"format": "tactape-panel/1"}
    assert (is_panel(kit), is_panel(panel), is_panel({})) == (False, True, False)
    assert kits_of(written(**kit)) == [tmp_path]
    for path in (written(**panel, tapes=[ROW]), tmp_path / "manifest.json"):
        assert kits_of(path) == [tmp_path / "tapes" / "a"]
    with pytest.raises(SpecError, match=r"tapes\[0\].rotation_deg = 45 deg") as refused:
        kits_of(written(**panel, tapes=[{**ROW, "rotation_deg": 45}]))
    assert [problem.key for problem in refused.value.problems] == ["tape"]
