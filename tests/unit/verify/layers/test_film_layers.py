"""Anchors, the window for all parts, and backings: as drawn they pass, and one line or corner changed is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from tactape_fab import TapeSpec
from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.film.anchors import AnchorPlan, anchor_plan
from tactape_fab.kit.read.gerber_file import GerberContent, read_gerber
from tactape_fab.kit.render.gerber import render_copper, render_coverlay
from tactape_fab.texture.frames import FloatArray
from tactape_fab.verify.layers.film_layers import (
    FilmRecord,
    check_anchors,
    check_backing,
    check_window,
    file_function,
    forced_as_warnings,
    read_film_record,
    without_counterpart,
)

Change = Callable[[GerberContent], GerberContent]
RECORD = FilmRecord(mode="gang", anchor=None, backings={}, job_in_zip=True, frame_mm=0.5, forced=frozenset())


@cache
def drawn(**more: Any) -> tuple[Examined, GerberContent, GerberContent]:
    """A tape, its copper and its coverlay as they are read back."""
    made = examine(TapeSpec(sector=7, size_mm=(30.0, 24.0), pitch_mm=1.8, models=False, **more))
    (copper,), (coverlay,) = render_copper(made.drawing, made.fab), render_coverlay(made.drawing, made.fab)
    return made, read_gerber(copper.data), read_gerber(coverlay.data)


def lines(change: Callable[[list[FloatArray]], list[FloatArray]], width_mm: float = 0.1) -> Change:
    def changed(content: GerberContent) -> GerberContent:
        strokes = change([line + 0.0 for line in content.strokes_mm])
        return replace(content, strokes_mm=tuple(strokes), stroke_width_mm=np.full(len(strokes), width_mm))

    return changed


@pytest.mark.parametrize("mode", ["spur", "mesh"])
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lines(lambda all_of: all_of), " lines hold 288 pads"),
        (lines(lambda all_of: [line[::-1] for line in all_of]), " lines hold 288 pads"),
        (lines(lambda all_of: [line + 0.0006 for line in all_of]), " lines hold 288 pads"),
        (lines(lambda all_of: [all_of[0] + 0.0011, *all_of[1:]]), "lines are missing, first at ("),
        (lines(lambda all_of: all_of[1:]), "1 lines are missing, first at ("),
        (lines(lambda all_of: [*all_of, all_of[0] + (0.2, 0.1)]), "1 lines are not an anchor of any part, first at ("),
        (lines(lambda all_of: [*all_of, all_of[0]]), " lines instead of "),
        (lines(lambda all_of: all_of, width_mm=0.102), "a line is 0.102 mm wide instead of 0.1 mm"),
    ],
)
def test_lines_of_the_copper_are_the_anchors_of_these_parts(mode: str, change: Change, says: str) -> None:
    made, copper, coverlay = drawn(anchor=mode)
    plan = anchor_plan(mode, made.fab, made.layout.outlines)
    checks = check_anchors(change(copper), coverlay, plan, made.layout.part.pads, made.tape)
    assert checks[0].passed == ("hold" in says) and says in checks[0].message
    assert [check.name for check in checks[1:]] == ["anchors to openings", "anchors to edge"] * checks[0].passed


def anchored(hole: tuple[float, float, float] | None = None, **plan: Any) -> dict[str, Check]:
    made, copper, coverlay = drawn(anchor="spur")
    planned: AnchorPlan = replace(anchor_plan("spur", made.fab, made.layout.outlines), **plan)
    tape = made.tape if hole is None else replace(made.tape, board=replace(made.tape.board, holes=(hole,)))
    checks = check_anchors(copper, coverlay, planned, made.layout.part.pads, tape)
    return {check.name: check for check in checks}


def test_anchors_keep_from_outline_holes_and_openings() -> None:
    """Distances from the ends of all lines, half of the width of 0.1 mm taken off."""
    made, copper, coverlay = drawn(anchor="spur")
    ends = np.concatenate(copper.strokes_mm)
    edge_mm = float(np.minimum(ends, np.array(made.tape.board.size_mm) - ends).min()) - 0.05
    for limit_mm, passed in ((edge_mm + 0.0004, True), (edge_mm + 0.0006, False)):
        check = anchored(pad_edge_mm=limit_mm)["anchors to edge"]
        assert check.passed is passed and check.figure == pytest.approx(edge_mm, abs=1e-6)
    x, y = ends[np.argmax(ends[:, 1])].tolist()
    for radius_mm, passed in ((0.6, True), (0.61, False)):
        # the hole stands 1 mm above the uppermost end: 1 mm - 0.05 mm - its radius, of 0.2 mm and 0.15 mm more
        check = anchored((x, y + 1.0, 2 * radius_mm), hole_copper_mm=0.35)["anchors to edge"]
        assert check.passed is passed and f"{0.95 - radius_mm:.3f} mm from the nearest hole" in check.message
    gap = anchored()["anchors to openings"]
    assert gap.passed and gap.figure is not None
    assert not anchored(opening_mm=gap.figure + 0.0006)["anchors to openings"].passed
    assert anchored(opening_mm=gap.figure + 0.0004)["anchors to openings"].passed
    one_less = replace(coverlay, flash_xy_mm=coverlay.flash_xy_mm[1:], flash_aperture=coverlay.flash_aperture[1:])
    plan = anchor_plan("spur", made.fab, made.layout.outlines)
    assert "143 openings for 288 pads" in check_anchors(copper, one_less, plan, made.layout.part.pads, made.tape)[1].message


def test_lines_are_equal_in_either_direction() -> None:
    some = np.array([[(0.0, 0.0), (1.0, 0.0)], [(0.0, 1.0), (1.0, 2.0)]])
    none = np.empty((0, 2, 2))
    assert len(without_counterpart(some, some[::-1, ::-1] + 0.0005)) == 0
    # one that crosses it in the same middle is another
    assert without_counterpart(some, np.array([some[0], [(1.0, 1.0), (0.0, 2.0)]])).tolist() == some[1:].tolist()
    assert without_counterpart(some, none).tolist() == some.tolist() and without_counterpart(none, some).shape == (0, 2, 2)


def corner(dx_mm: float) -> Change:
    def changed(content: GerberContent) -> GerberContent:
        (area,) = content.areas_mm
        far = area[:, 0] > area[:, 0].max() - 1e-6
        return replace(content, areas_mm=(area + np.outer(far, (dx_mm, 0.0)),))

    return changed


@pytest.mark.parametrize(
    ("change", "failed", "says"),
    [
        (corner(0.0), [], "within 0.0 um of the window that these parts ask for"),
        (corner(0.0008), [], "within 0.8 um"),
        (corner(0.3), ["coverlay-top window"], "off by 300.0 um"),
        (corner(-0.1), ["coverlay-top window", "coverlay-top parts"], "off by 100.0 um"),
        (lambda content: replace(content, clear=True), ["coverlay-top window"], "other objects than one window"),
        (lambda content: replace(content, areas_mm=content.areas_mm * 2), ["coverlay-top window"], "other objects"),
        (lambda content: replace(content, flash_xy_mm=np.zeros((1, 2))), ["coverlay-top window"], "other objects"),
        (
            lambda content: replace(content, areas_mm=(content.areas_mm[0][[0, 2, 1, 3]],)),
            ["coverlay-top window"],
            "the window crosses itself",
        ),
    ],
)
def test_one_window_holds_the_openings_of_all_parts(change: Change, failed: list[str], says: str) -> None:
    made, _, coverlay = drawn(coverlay="gang")
    cpl: Any = made.layout.bodies  # places of parts, as a list has them
    checks = check_window(change(coverlay), made.layout.outlines.opening, RECORD, made.tape, cpl)
    assert [check.name for check in checks if not check.passed] == failed and says in checks[0].message
    assert len(checks) == 1 or failed != ["coverlay-top window", "coverlay-top parts"] or "partly covered" in checks[1].message


def test_the_frame_round_the_window_is_measured() -> None:
    made, _, coverlay = drawn(coverlay="gang")
    (area,) = coverlay.areas_mm
    frame_mm = float(np.minimum(area, np.array(made.tape.board.size_mm) - area).min())
    cpl: Any = made.layout.bodies
    for limit_mm, passed in ((frame_mm + 0.0004, True), (frame_mm + 0.0006, False)):
        record = replace(RECORD, frame_mm=limit_mm)
        check = check_window(coverlay, made.layout.outlines.opening, record, made.tape, cpl)[-1]
        assert check.passed is passed and check.figure == pytest.approx(frame_mm)


SQUARE = np.array([(0.0, 0.0), (30.0, 0.0), (30.0, 24.0), (0.0, 24.0)])


@pytest.mark.parametrize(
    ("more", "path", "says"),
    [
        ({}, "gerber/t-stiffener_FR4_0.2mm.gbr", "FR4 0.2 mm, as large as the board"),
        ({"areas_mm": (SQUARE * (1.0, 1.00004),)}, "FR4_0.2mm.gbr", "as large as the board"),
        ({"areas_mm": (SQUARE * (1.0, 1.00005),)}, "FR4_0.2mm.gbr", "it leaves the outline by 0.001 mm"),
        ({"areas_mm": (SQUARE[[0, 2, 1, 3]],)}, "FR4_0.2mm.gbr", "its area crosses itself"),
        ({"areas_mm": (SQUARE, SQUARE)}, "FR4_0.2mm.gbr", "other objects than one area"),
        ({"clear": True}, "FR4_0.2mm.gbr", "other objects than one area"),
        ({"strokes_mm": (SQUARE,)}, "FR4_0.2mm.gbr", "other objects than one area"),
        ({}, "gerber/t-stiffener_FR4_0.4mm.gbr", "its name t-stiffener_FR4_0.4mm.gbr does not say FR4_0.2mm"),
    ],
)
def test_a_backing_is_the_board_in_a_file_that_says_what_it_is(more: dict[str, Any], path: str, says: str) -> None:
    none: dict[str, Any] = {"strokes_mm": (), "flash_xy_mm": np.empty((0, 2)), "clear": False, "areas_mm": (SQUARE,)}
    check = check_backing("stiffener-bottom", replace(drawn(anchor="spur")[1], **none | more), path, "FR4 0.2", SQUARE)
    assert check.passed == ("as large" in says) and says in check.message
    assert file_function("stiffener-bottom", "FR4 0.2") == "Other,Stiffener_Bottom_FR4_0.2mm"


def test_what_was_forced_is_a_warning_and_nothing_else() -> None:
    checks = [Check(name=f"{name} to edge", passed=False, message="m") for name in ("bodies", "copper-top")]
    checks.append(Check(name="bodies to edge", passed=True, message="m"))
    told = forced_as_warnings(checks, replace(RECORD, forced=frozenset({"body-edge", "pad-size"})))
    assert [(check.warning, check.message) for check in told] == [
        *((True, "m; made in spite of rule body-edge"), (False, "m"), (False, "m")),
    ]


def test_the_record_of_a_film_is_read() -> None:
    plan: dict[str, Any] = {
        "mode": "mesh",
        "web_mm": 0.1,
        "opening_mm": 0.15,
        "tip_mm": 0.7,
        "pad_edge_mm": 0.3,
        "hole_copper_mm": 0.2,
    }
    fab = {"coverlay_mode": "lpi", "limits_mm": {"opening-edge": 0.4}, "job_in_zip": False}
    full = Fields(
        {
            "fab": fab,
            "anchor": plan,
            "adhesive": "3M468 0.13",
            "forced": [{"rule": "pad-edge", "message": "near"}],
        }
    )
    assert read_film_record(full) == FilmRecord(
        mode="lpi",
        anchor=AnchorPlan(**plan),
        backings={"adhesive-bottom": "3M468 0.13"},
        job_in_zip=False,
        frame_mm=0.4,
        forced=frozenset({"pad-edge"}),
        broken=frozenset({"pad-edge: near"}),
    )
    bare = read_film_record(Fields({"fab": fab | {"job_in_zip": True}}))
    assert (bare.anchor, bare.backings, bare.job_in_zip, bare.forced) == (None, {}, True, frozenset())
    wrong = Fields({"fab": fab, "stiffener": "FR4 0.2 mm"})
    read_film_record(wrong)
    assert "give material and mm" in str(wrong.problems)
