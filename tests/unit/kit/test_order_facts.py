"""Facts of an order, against the layers that they are about."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely

from tactape_fab import TapeSpec
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.film.layout import Layout
from tactape_fab.kit.order_facts import OrderFacts, order_facts
from tactape_fab.kit.render.order_notes import render_order_notes


def examined(**values: Any) -> Examined:
    return examine(TapeSpec(**{"sector": 7, "size_mm": (24.0, 20.0), "tag": "none", "models": False, **values}))


def facts_of(made: Examined, **other: Any) -> OrderFacts:
    paths = ("bom", "cpl", "fab-zip", "preview-png", "placement-preview")
    files = [Artifact(role=role, path=role, data=b"\r\n") for role in paths]
    given = {"layout": made.layout, "fab": made.fab, "findings": made.findings, **other}
    return order_facts(given["layout"], given["fab"], given["findings"], files)


def spacing_mm(layout: Layout) -> float:
    """Least distance of two pieces of copper that do not touch: pads, each with its spur, and webs."""
    pads = shapely.polygons(layout.pads.xy_mm[:, None] + layout.pads.outline_mm)
    pieces = pads
    if layout.anchors is not None:
        half_mm = layout.anchors.web_mm / 2
        spurs, webs = (
            shapely.buffer(shapely.linestrings(lines), half_mm, quad_segs=64)
            for lines in (layout.anchors.spurs_mm, layout.anchors.webs_mm)
        )
        # a mesh is one piece: what it keeps from pads is between them and its lines
        pieces = np.concatenate([shapely.union(pads, spurs) if len(webs) == 0 else pads, webs])
    a, b = shapely.STRtree(pieces).query(pieces, predicate="dwithin", distance=0.6)
    gaps = shapely.distance(pieces[a], pieces[b])
    return float(gaps[gaps > 1e-6].min())


@pytest.mark.parametrize(
    ("values", "least_mm"),
    [
        ({"pitch_mm": 1.5}, 0.18),
        ({"fab": "generic-lpi", "pitch_mm": 2.0, "rotation_deg": 0.0, "anchor": "spur"}, 0.1),
        ({"fab": "generic-lpi", "pitch_mm": 1.9, "rotation_deg": 15.0, "anchor": "spur"}, 0.18),
        ({"fab": "generic-fr4", "pitch_mm": 1.9, "rotation_deg": 15.0, "anchor": "spur"}, None),
        ({"fab": "pcbway-fr4", "pitch_mm": 1.5, "anchor": "mesh"}, 0.1036),
        ({"fab": "generic-fpc", "pitch_mm": 2.4, "anchor": "mesh"}, 0.18),
    ],
)
def test_the_least_spacing_is_that_of_all_copper(values: dict[str, Any], least_mm: float | None) -> None:
    made = examined(displacement_mm=0.25, **values)
    assert not any(finding.blocks for finding in made.findings)
    found = facts_of(made).least_gap_mm
    assert found == pytest.approx(spacing_mm(made.layout), abs=2e-4)
    assert least_mm is None or found == pytest.approx(least_mm, abs=2e-4)


def test_webs_are_tracks() -> None:
    for anchor, said in (("none", "0.18 mm"), ("mesh", "0.1 mm")):
        made = examined(fab="pcbway-fr4", pitch_mm=2.0, displacement_mm=0.25, anchor=anchor)
        (notes,) = render_order_notes(facts_of(made))
        (row,) = (line for line in notes.data.decode().splitlines() if "Min Track/Spacing" in line)
        assert row.split(maxsplit=2)[2] == said


def test_courtyards_that_overlap_are_asked_about() -> None:
    made = examined(pitch_mm=1.42, displacement_mm=0.24)
    (courtyard,) = (f for f in made.findings if f.rule == "courtyard")
    assert courtyard.limit == 0.0 and courtyard.value is not None and courtyard.value < 0.0 and courtyard.level == "warn"
    assert f"courtyard: {courtyard.message}" in facts_of(made).close
    apart = [replace(f, value=0.0) if f.rule == "courtyard" else f for f in made.findings]
    assert not any(line.startswith("courtyard:") for line in facts_of(made, findings=apart).close)


def test_a_limit_that_is_not_met_is_asked_about_whoever_gave_it() -> None:
    made = examined(size_mm=(610.0, 60.0), pitch_mm=4.0, corner_radius_mm=0.5)
    broken = [f for f in made.findings if f.level == "warn" and not f.passed]
    assert {"size", "corner-radius"} <= {f.rule for f in broken}
    for findings in (made.findings, [replace(f, confirmed=True) for f in made.findings]):
        close = facts_of(made, findings=findings).close
        assert {f"{f.rule}: {f.message}" for f in broken if f.rule in ("size", "corner-radius")} <= {*close}
    # one that is met is not
    assert not any(line.startswith(("size:", "corner-radius:")) for line in facts_of(examined()).close)


@pytest.mark.parametrize(("size_mm", "fits"), [((70.0, 69.9996), True), ((70.0, 69.9994), False), ((250.0004, 80.0), True)])
def test_the_line_takes_what_the_rule_says_it_takes(size_mm: tuple[float, float], fits: bool) -> None:
    made = examined(size_mm=size_mm)
    (rule,) = (f for f in made.findings if f.rule == "assembly-size")
    assert rule.passed is facts_of(made).fits_panel is fits


def test_a_limit_has_its_own_date_though_others_have_its_source() -> None:
    made = examined()
    dates = {"pad-pad": "2026-11-18", "body-body": "2026-11-25", "pad-edge": "2026-11-02"}
    limits = {rule: replace(made.fab.limits[rule], source="by telephone", date=date) for rule, date in dates.items()}
    findings = [replace(f, source="by telephone") if f.rule in dates else f for f in made.findings]
    facts = facts_of(made, fab=replace(made.fab, limits={**made.fab.limits, **limits}), findings=findings)
    assert {q.rule: q.date for q in facts.questions if q.rule in dates} == dates
