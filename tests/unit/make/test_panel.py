"""A panel is made with the kit of every tape, and says which of them are verified, forced, or of a coupon."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tactape_fab.base.errors import Check, DesignRuleError, SpecError
from tactape_fab.make import panel as panel_module
from tactape_fab.make.panel import make_panel
from tactape_fab.texture.as_built import manifest_digest
from tests.panels import TWO, examined_panel

# a fault must not write into the checkout
pytestmark = pytest.mark.usefixtures("here")

SMALL: dict[str, Any] = {**TWO, "sectors": [7, 9], "panel": "1x2", "size_mm": [62.0, 30.0]}
del SMALL["sector"]


def test_a_panel_holds_its_own_files_and_a_whole_kit_of_each_tape() -> None:
    told = list[str]()
    examined = examined_panel(SMALL)
    made = make_panel(examined, verify=False, progress=told.append)
    assert made.path == Path(examined.name) and made.name == examined.name and made.checks == ()
    assert told == ["tape 1 of 2", "tape 2 of 2", "rendering the panel"]
    assert [tape.sector for tape in made.tapes] == [7, 9] and made.kits == tuple(f"tapes/{tape.name}" for tape in made.tapes)
    content = json.loads((made.path / "manifest.json").read_text())
    # the report has no row, as it is made of the manifest
    listed = {row["role"]: row["path"] for row in content["files"]} | {"report": "report.html"}
    assert made.files == listed and all((made.path / path).is_file() for path in listed.values())
    assert {"order-notes", "fab-drawing", "fab-dxf", "fab-zip", "kicad-pcb"} <= set(made.files)
    first = 1
    for row, kit, tape in zip(content["tapes"], made.kits, made.tapes, strict=True):
        assert (row["manifest"], row["first_designator"]) == (f"{kit}/manifest.json", f"R{first}")
        assert row["sha256"] == manifest_digest(made.path / kit / "manifest.json")
        first += tape.part_count
    assert "forced" not in content and "coupon" not in content
    shown = made.to_mapping()
    assert [(tape["kit"], tape["sector"], tape["parts"]) for tape in shown["tapes"]] == [
        (kit, tape.sector, tape.part_count) for kit, tape in zip(made.kits, made.tapes, strict=True)
    ]
    assert [tape["offset_mm"] for tape in shown["tapes"]] == [list(place.offset_mm) for place in made.panel.places]
    with pytest.raises(SpecError, match="exists already; use --overwrite"):
        make_panel(examined, verify=False)


def test_checks_are_those_of_the_kits_and_then_of_the_panel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kits are verified as they are made, the panel by its own files alone, quickly."""
    asked = list[dict[str, bool]]()

    def verify_panel_folder(_path: Path, **how: bool) -> object:
        asked.append(how)
        return SimpleNamespace(raise_if_failed=lambda: None, checks=(Check(name="of the panel", passed=True, message=""),))

    def fill_kit(place: Path, tape: Any, blocking: list[Any], *, verify: bool, progress: object) -> object:
        assert verify and blocking == []
        (place / "manifest.json").write_text("{}")
        return None, (Check(name=tape.tape.name, passed=True, message=""),)

    monkeypatch.setattr("tactape_fab.verify.panel.verify_panel_folder", verify_panel_folder)
    monkeypatch.setattr(panel_module, "fill_kit", fill_kit)
    told = list[str]()
    made = make_panel(examined_panel(SMALL), tmp_path / "p", progress=told.append)
    assert [check.name for check in made.checks] == [*(tape.name for tape in made.tapes), "of the panel"]
    assert asked == [{"quick": True, "kits": False}] and told[-2:] == ["rendering the panel", "verifying the panel"]


def test_rules_that_are_broken_are_refused_or_recorded(tmp_path: Path) -> None:
    examined = examined_panel({**SMALL, "pitch_mm": 1.3, "coverlay": "per-part"})
    with pytest.raises(DesignRuleError):
        make_panel(examined, tmp_path / "p", verify=False)
    assert not (tmp_path / "p").exists()
    made = make_panel(examined, tmp_path / "p", verify=False, force=True)
    contents = [json.loads((made.path / of / "manifest.json").read_text()) for of in (".", *made.kits)]
    assert all({row["rule"] for row in content["forced"]} >= {"opening-bridge"} for content in contents)


def test_a_single_tape_is_no_panel_and_flags_are_bools(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="verify = 'no'"):
        make_panel(examined_panel(SMALL), tmp_path / "p", verify="no")  # type: ignore[arg-type]
    with pytest.raises(SpecError, match="examined"):
        make_panel(SimpleNamespace(), tmp_path / "p")  # type: ignore[arg-type]
