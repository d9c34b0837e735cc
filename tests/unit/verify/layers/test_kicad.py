"""Outlines and fiducials of a KiCad board; other changes of a board are those of `tests/roundtrip/test_verify_kicad.py`."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.kit.read.gerber_file import ReadbackError
from tactape_fab.kit.read.s_expression import read_s_expression
from tactape_fab.verify.layers.kicad import Shown, _fiducials, _outline, _read_board, _tracks, sides_of
from tactape_fab.verify.layers.kicad_drawn import child, rules_problems

MARK = '(pad "" smd circle (at 0 0) (size 1 1) (layers "F.Cu" "F.Mask") (solder_mask_margin 0.5) (clearance 0.5))'
BOARD = f"""(kicad_pcb (setup (aux_axis_origin 20 40))
(gr_line (start 21 40) (end 49 40) (layer "Edge.Cuts")) (gr_line (start 50 39) (end 50 31) (layer "Edge.Cuts"))
(gr_arc (start 49 30) (mid 49.7 30.3) (end 50 31) (layer "Edge.Cuts")) (gr_line (start 20 31) (end 20 39) (layer "Edge.Cuts"))
(footprint "fid" (layer "F.Cu") (at 23 37) (fp_text reference "FID1" (at 0 0)) {MARK})
(footprint "fid" (layer "F.Cu") (at 45 38.5) (fp_text reference "FID2" (at 0 0)) {MARK}))"""
SHOWN = Shown(
    parts_xy_mm=np.empty((0, 2)),
    rotation_deg=np.empty(0),
    size_mm=(30.0, 10.0),
    holes=(),
    edge_lines=4,
    tracks_mm=np.empty((0, 2, 2)),
    track_width_mm=0.1,
    fiducials_mm=((3.0, 3.0), (25.0, 1.5)),
    fiducial_mm=(1.0, 2.0),
)


@pytest.mark.parametrize(
    ("size_mm", "radius_mm", "sides"),
    [((30.0, 10.0), 0.0, 4), ((30.0, 10.0), 1.0, 8), ((30.0, 10.0), 5.0, 6), ((10.0, 10.0), 5.0, 4)],
)
def test_sides_of_an_outline(size_mm: tuple[float, float], radius_mm: float, sides: int) -> None:
    assert sides_of(size_mm, radius_mm) == sides


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("", "", ""),
        ("(at 23 37)", "(at 23.02 37)", "its 2 fiducials are not the manifest's 2"),
        ("(at 0 0) (size", "(at 0 0.02) (size", "fiducials"),
        ("(size 1 1)", "(size 1 1.02)", "fiducials"),
        ("margin 0.5", "margin 0.6", "fiducials"),
        ("clearance 0.5", "clearance 0.6", "fiducials"),
        ('"F.Cu" "F.Mask"', '"F.Cu"', "fiducials"),
        ('"F.Cu" "F.Mask"', '"B.Cu" "F.Mask"', "fiducials"),
        ("smd circle", "smd rect", "fiducials"),
        ("smd circle", "thru_hole circle", "fiducials"),
        (MARK, MARK + MARK, "fiducials"),
        ('"FID2"', '"H1"', "its 1 fiducials are not the manifest's 2"),
        ("(end 50 31) (layer", "(end 51 31) (layer", "its outline is 31 x 10 mm about another place"),
        ("(mid 49.7 30.3)", "(mid 49.7 29)", "its outline is 30 x 11 mm about another place"),
        ("origin 20 40", "origin 21 40", "its outline is 30 x 10 mm about another place"),
        ("gr_arc", "gr_curve", "its outline has 3 sides and corners, not 4"),
    ],
)
def test_outline_and_fiducials_are_the_manifest_s(old: str, new: str, says: str) -> None:
    found = _read_board(read_s_expression(BOARD.replace(old, new, 1).encode(), ()))
    problems = [*_fiducials(found, SHOWN), *_outline(found, SHOWN)]
    assert bool(problems) == bool(says) and says in "; ".join(problems)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (MARK, "()", "a list without a name stands in 'footprint' 'FID1'"),
        (MARK, "((pad))", "a list without a name stands in 'footprint' 'FID1'"),
        (MARK, "(pad)", "'pad' of 'footprint' 'FID1' begins with 0 words, not 3"),
        ("(at 0 0) (size", "(at 0) (size", "'at' of 'pad' of 'footprint' 'FID1' begins with 1 word, not 2 or 3"),
        ("(size 1 1)", "(size (1) 1)", "'size' of 'pad' of 'footprint' 'FID1' begins with 0 words, not 2"),
        ("(at 23 37)", "(at 23 37 0 0)", "'at' of 'footprint' 'FID1' begins with 4 words, not 2 or 3"),
        ("(start 21 40)", "(start)", "'start' of 'gr_line' begins with 0 words, not 2"),
        ("(end 49 40)", "()", "a list without a name stands in 'gr_line'"),
        ("(gr_line", "() (gr_line", "a list without a name stands in 'kicad_pcb'"),
        ("(gr_line", "(layers (0)) (gr_line", "'0' of 'layers' begins with 0 words, not 2 or 3"),
        ('(fp_text reference "FID2" (at 0 0))', "", "footprint 2 has 0 references, not one"),
        ("(setup", "(setup) (setup", "it has 2 times setup"),
        ('(layer "Edge.Cuts"))', '(layer "Edge.Cuts") hide)', "'gr_line' holds 'hide', which this tool does not write"),
        ("(end 49 40)", "(end 49 40) (locked)", "'gr_line' holds 'locked', which this tool does not write"),
        ("(end 49 40)", "(end 49 40) (end 49 40)", "'gr_line' has 2 times end"),
        ("(end 49 40)", "(end 49 40 (locked))", "'end' of 'gr_line' holds 'locked', which this tool does not write"),
        ("(gr_line", "(gr_poly (pts (xy 0 0) 1)) (gr_line", "'pts' of 'gr_poly' holds '1', which this tool does not write"),
        ("(gr_line", "(gr_line locked", "'gr_line' begins with 1 word, not 0"),
        (
            "(gr_line",
            '(layers (31 "B.Cu" signal locked)) (gr_line',
            "'31' of 'layers' has another word than the name of its layer",
        ),
    ],
)
def test_an_element_that_is_cut_short_is_named(old: str, new: str, says: str) -> None:
    with pytest.raises(ReadbackError) as caught:
        _read_board(read_s_expression(BOARD.replace(old, new, 1).encode(), ()))
    assert str(caught.value) == says


def test_a_list_of_a_footprint_that_is_missing_is_said_to_be_a_footprint_s() -> None:
    with pytest.raises(ReadbackError, match=r"^a 'footprint' has 0 times attr$"):
        child((("fp_text", "reference"), ("pad", "1")), "attr")


def test_a_board_without_fiducials_has_none() -> None:
    found = _read_board(read_s_expression(BOARD[: BOARD.index("(footprint")].encode() + b")", ()))
    assert _fiducials(found, replace(SHOWN, fiducials_mm=())) == []


TRACK = '(segment (start 23 37) (end 25 38.5) (width 0.1) (layer "F.Cu") (net 0))'


@pytest.mark.parametrize(
    ("track", "passed"),
    [
        (TRACK, True),
        (TRACK.replace("(start 23 37) (end 25 38.5)", "(start 25 38.5) (end 23 37)"), True),
        (TRACK.replace("23 37", "23.02 37"), False),
        (TRACK.replace("25 38.5", "25 38.52"), False),
        (TRACK.replace("width 0.1", "width 0.12"), False),
        (TRACK.replace("F.Cu", "B.Cu"), False),
        (TRACK.replace("net 0", "net 1"), False),
        (TRACK * 2, False),
        ("", False),
    ],
)
def test_tracks_are_the_anchors(track: str, passed: bool) -> None:
    """Of an origin at 20, 40 on the sheet, whose y points down, the line is from 3, 3 to 5, 1.5 mm."""
    found = _read_board(read_s_expression(f"{BOARD[:-1]}{track})".encode(), ()))
    shown = replace(SHOWN, tracks_mm=np.array([[(3.0, 3.0), (5.0, 1.5)]]))
    assert (_tracks(found, shown) == []) is passed


LIMITS_MM = {"pad-pad": 0.1, "pad-edge": 0.3, "hole-copper": 0.2, "hole-hole": 0.5, "hole-size": 0.25}


def project(changes: dict[str, float], **severities: str) -> bytes:
    """A project of those limits, anchors of 0.15 mm, and some rules otherwise."""
    rules = {
        "min_clearance": 0.1,
        "min_copper_edge_clearance": 0.3,
        "min_hole_clearance": 0.2,
        "min_hole_to_hole": 0.5,
        "min_through_hole_diameter": 0.25,
        "min_track_width": 0.15,
        "min_silk_clearance": 0.0,
    }
    net_class = {"clearance": 0.1, "track_width": 0.15, "via_diameter": 0.6, "via_drill": 0.3}
    net_class |= {k: v for k, v in changes.items() if k in net_class}
    rules |= {k: v for k, v in changes.items() if k not in net_class}
    settings = {"rules": rules, "rule_severities": severities}
    return json.dumps({"board": {"design_settings": settings}, "net_settings": {"classes": [net_class]}}).encode()


@pytest.mark.parametrize(
    ("changes", "limits", "track_mm", "wrong"),
    [
        ({}, {}, 0.15, ""),
        ({"min_track_width": 0.1, "track_width": 0.1}, {}, 0.0, ""),
        ({}, {"hole-size": None}, 0.15, ""),
        ({"min_through_hole_diameter": 9.0}, {"hole-size": None}, 0.15, ""),
        ({"min_track_width": 9.0, "track_width": 9.0, "min_clearance": 9.0, "clearance": 9.0}, {"pad-pad": None}, 0.0, ""),
        *(({key: 0.4}, {}, 0.15, key) for key in ("min_clearance", "min_copper_edge_clearance", "min_hole_to_hole")),
        (
            {"min_hole_clearance": 0.1, "min_through_hole_diameter": 0.2},
            {},
            0.15,
            "min_hole_clearance, min_through_hole_diameter",
        ),
        ({"clearance": 0.05}, {}, 0.15, "clearance of its class"),
        ({"track_width": 0.1}, {}, 0.15, "track width of its class"),
        ({}, {}, 0.0, "min_track_width, track width of its class"),
        ({"min_silk_clearance": 0.1}, {}, 0.15, "min_silk_clearance"),
        ({"via_diameter": 0.5}, {}, 0.15, "via diameter of its class"),
        ({"via_drill": 0.2}, {}, 0.15, "via drill of its class"),
        ({"min_via_diameter": 0.1}, {}, 0.15, "'min_via_diameter'"),
    ],
)
def test_rules_of_a_project_are_the_fab_s_limits(
    changes: dict[str, float], limits: dict[str, None], track_mm: float, wrong: str
) -> None:
    """A limit that the manifest does not have leaves its rule open."""
    asked = {rule: value for rule, value in LIMITS_MM.items() if rule not in limits}
    said = rules_problems(project(changes), asked, track_mm)
    assert said == ([f"its project's {wrong} are not the limits of the manifest's fab"] if wrong else [])


def test_severities_of_a_project_are_those_of_this_tool() -> None:
    assert rules_problems(project({}, track_dangling="ignore"), LIMITS_MM, 0.15) == []
    (said,) = rules_problems(project({}, clearance="ignore"), LIMITS_MM, 0.15)
    assert "rule_severities" in said
