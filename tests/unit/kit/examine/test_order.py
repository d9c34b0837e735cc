"""Orders of panels: what is refused is said together, and what a remedy names is not refused in its turn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.kit.examine.order import ExaminedPanel, examine_order

NARROW: dict[str, Any] = {"size_mm": [20.0, 50.0], "models": False}
ANOTO: dict[str, Any] = {**NARROW, "code": "anoto-6x6"}


def refused(**values: Any) -> list[str]:
    with pytest.raises(SpecError) as refusal:
        examine_order(values)
    return [problem.message for problem in refusal.value.problems]


def test_a_panel_is_examined_beside_a_tape_that_is_refused() -> None:
    corner, panel, sector = refused(sector=255, panel="1x1", corner_radius_mm=2.0, **NARROW)
    assert corner.startswith("corner_radius_mm = 2 mm cuts into the tag")
    assert panel.endswith("; use --panel 3x2")
    assert sector.startswith("sector = 255 on a panel of 6 tapes") and "use --sector 250 or less" in sector  # of that panel
    coverlay, panel = refused(sector=9, panel="1x1", coverlay="lpi", **NARROW)
    assert coverlay.startswith("coverlay") and panel.startswith("panel")


def test_a_folder_of_the_panel_s_name_is_nothing_to_who_writes_none(here: Path) -> None:
    (here / "tactape-panel-s007").mkdir()
    examined, _ = examine_order({"sector": 7, "panel": "3x2", **NARROW})
    assert isinstance(examined, ExaminedPanel) and examined.name == "tactape-panel-s007"


def test_no_panel_is_measured_of_a_size_that_is_refused() -> None:
    assert all("panel" not in line for line in refused(sector=9, panel="1x1", size_mm=[20.0, 4.0]))
    assert all("panel" not in line for line in refused(sector=9, panel="1x1", size_mm=[20.0, -4.0]))


@pytest.mark.parametrize("panel", ["3x2", "auto"])
def test_a_panel_beyond_the_ids_of_tags_has_a_remedy_that_works(panel: str) -> None:
    (line,) = refused(sector=586, panel=panel, **ANOTO)
    assert line == (
        "sector = 586 on a panel of 6 tapes asks for tags up to 591, but the last id of tag36h11 is 586; use --sector 581 or "
        "less, or use --tag none"
    )
    for values in ({"sector": 581}, {"sector": 586, "tag": "none"}):
        examined, _ = examine_order({**ANOTO, "panel": panel, **values})
        assert isinstance(examined, ExaminedPanel) and len(examined.tapes) == 6
    (line,) = refused(sector=700, panel=panel, **ANOTO)  # --tag-id is no way out of a panel of several
    assert "--tag-id" not in line
    (line,) = refused(sector=586, panel=panel, tag_id=5, **ANOTO)
    assert line.endswith("; leave out --tag-id, and use --sector 581 or less, or --tag none")


def test_named_sectors_beyond_the_ids_of_tags() -> None:
    (line,) = refused(sectors=[586, 587, 1, 2, 3, 4], panel="auto", **ANOTO)
    assert line == (
        "sectors ask for tags up to 587, but the last id of tag36h11 is 586; name --sectors up to 586, or use --tag none"
    )


def test_copies_and_a_panel_of_one_take_any_id() -> None:
    for values in ({"panel": "3x2", "same_sector": True}, {"panel": "1x1", "size_mm": [80.0, 60.0]}):
        examined, _ = examine_order({**ANOTO, "sector": 700, "tag_id": 5, **values})
        assert isinstance(examined, ExaminedPanel)
        assert "choose an id with --tag-id" in refused(**{**ANOTO, "sector": 700, **values})[0]


def test_findings_of_a_panel_have_their_places_on_it() -> None:
    # W so small that bridges are below the limit: between parts of one tape, so within one tape's outline on the panel
    examined, _ = examine_order({"sector": 7, "panel": "3x2", "pitch_mm": 1.3, "displacement_mm": 0.2, **NARROW})
    assert isinstance(examined, ExaminedPanel)
    of_tapes = {(f.rule, f.value): f.at_mm for f in examined.tapes[0].findings}
    found = [f for f in examined.findings_on_panel if f.at_mm is not None]
    offset_mm = examined.panel.places[0].offset_mm
    assert found and offset_mm[1] > 50.0  # the first tape is the upper left one
    for finding in found:
        at_mm = of_tapes[finding.rule, finding.value]
        assert at_mm is not None and finding.at_mm == pytest.approx((at_mm[0] + offset_mm[0], at_mm[1] + offset_mm[1]))
    assert [replace(f, at_mm=None) for f in examined.findings] == [replace(f, at_mm=None) for f in examined.findings_on_panel]


def test_without_a_panel_its_other_options_go_as_well() -> None:
    asked = {"sector": 7, "panel": "10x10", "size_mm": [240.0, 240.0], "tabs": "x"}
    assert refused(**asked)[0].endswith("; use another --size, or --panel none without --tabs")
    both = refused(**asked, same_sector=True)
    assert both[0].endswith("; use another --size, or --panel none without --same-sector and --tabs")
    assert refused(**{**asked, "panel": "auto"})[0].endswith("or --panel none without --tabs")
    assert refused(sector=7, part="dome", panel="2x2", tabs="x")[0].endswith("; leave out --panel and --tabs")


@pytest.mark.parametrize(("sectors", "also"), [([0, 1, 2], ", or use --panel auto"), ([0], "")])
def test_another_panel_is_named_for_sectors_that_fill_one(sectors: list[int], also: str) -> None:
    (line,) = refused(sectors=sectors, panel="2x3", models=False)
    assert line.endswith(f"has 6; name 6{also}")
    if also:
        examined, _ = examine_order({"sectors": sectors, "panel": "auto", "models": False})
        assert isinstance(examined, ExaminedPanel) and len(examined.tapes) == len(sectors)
