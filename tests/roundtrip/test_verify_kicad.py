"""Changes to a written KiCad board are caught by `verify` and named, whether or not the manifest's hashes were made to fit."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from tactape_fab import Kit
from tactape_fab.verify import verify_kit
from tests.roundtrip.kits import OpenKit, failed
from tests.thorough import thorough

Copy = Callable[[Kit], Path]
BOARD = "kicad-pcb"


def replaced(old: str, new: str, count: int = -1) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new, count)

    return change


def footprint_moved(text: str) -> str:
    """R10 by 20 um."""
    start = text.rindex("(footprint", 0, text.index('reference "R10"'))
    found = re.compile(r"\(at (\S+)").search(text, start)
    assert found is not None
    return text[: found.start(1)] + f"{float(found[1]) + 0.02:.6f}" + text[found.end(1) :]


def footprint_dropped(text: str) -> str:
    start = text.rindex("  (footprint", 0, text.index('reference "R10"'))
    return text[:start] + text[text.index("  (footprint", start + 1) :]


def pad_moved_to_another_part(text: str) -> str:
    """The first pad of R10 stands in R11."""
    start = text.index('    (pad "1"', text.index('reference "R10"'))
    end = text.index("\n", start) + 1
    pad, text = text[start:end], text[:start] + text[end:]
    at = text.index('    (pad "1"', start)
    return text[:at] + pad + text[at:]


def added(item: str) -> Callable[[str], str]:
    return lambda text: text.rstrip()[:-1] + f"  {item}\n)\n"


def added_to_r1(item: str) -> Callable[[str], str]:
    return lambda text: text.replace('    (pad "1"', f'    {item}\n    (pad "1"', 1)


def octagon(text: str) -> str:
    """The board's sides and corners as eight lines between points of its outline."""
    at = [(26, 40), (34, 40), (40, 34), (40, 26), (34, 20), (26, 20), (20, 26), (20, 34)]
    lines = [
        f'(gr_line (start {a} {b}) (end {c} {d}) (layer "Edge.Cuts") (width 0.1))' for (a, b), (c, d) in pairwise(at + at[:1])
    ]
    return added("\n  ".join(lines))(re.sub(r'\n  \(gr_(?:line|arc) [^\n]*"Edge.Cuts"[^\n]*', "", text))


CHANGES = {
    "part moved": (footprint_moved, "off the grid: R10 by 20.0 um"),
    "part dropped": (footprint_dropped, "R10"),
    "part renamed": (replaced('reference "R10"', 'reference "C10"'), "C10, R10"),
    "all turned": (lambda t: re.sub(r"(\(at \S+ \S+) 45\)", r"\1 135)", t), "turned: R1 at 135 deg"),
    "one pad wider": (replaced("(size 0.46 0.4)", "(size 0.48 0.4)", 1), "pad 1 is not the land pattern's (R1)"),
    "all pads wider": (replaced("(size 0.46 0.4)", "(size 0.48 0.4)"), "pad 1 is not the land pattern's (every part)"),
    "pads apart": (replaced("(at 0.32 0 45)", "(at 0.34 0 45)"), "pad 2 is not the land pattern's"),
    "stencil": (replaced("(size 0.318 0.36)", "(size 0.318 0.4)"), "stencil aperture 1 is not"),
    "outline larger": (replaced("(start 21.000000 40.000000)", "(start 21.000000 40.200000)"), "outline"),
    "outline open": (lambda t: re.sub(r'\n  \(gr_arc [^\n]*"Edge.Cuts"[^\n]*', "", t, count=1), "7 sides"),
    "outline on no layer": (lambda t: re.sub(r'\n *\(44 "Edge.Cuts" user\)', "", t), "its table of layers lacks Edge.Cuts"),
    "corners cut off": (octagon, "its outline is not that of the outline layer"),
    "ink in another order": (
        lambda t: re.sub(r"(pts )(\(xy \S+ \S+\)) (.*?) (\(xy \S+ \S+\))(\) \(layer \"F.SilkS\"\))", r"\1\4 \3 \2\5", t, count=1),
        "areas of ink",
    ),
    "hole larger": (replaced("(drill 1)", "(drill 1.1)"), "holes are not the manifest's 1"),
    "hole beside its place": (replaced("np_thru_hole circle (at 0 0)", "np_thru_hole circle (at 0 1)"), "holes are not the"),
    "origin moved": (replaced("(aux_axis_origin 20 40)", "(aux_axis_origin 21 40)"), "off the grid: R1 by 1000.0 um"),
    "body begins elsewhere": (replaced("(fp_rect (start -0.3 -0.15)", "(fp_rect (start -0.2 -0.15)", 1), "another body"),
    "pad of another part": (pad_moved_to_another_part, "pad 1 is there 0 times (R10)"),
    "pad twice": (lambda t: re.sub(r'(\n    \(pad "2"[^\n]*)', r"\1\1", t, count=1), "it has 5 lands, not 4 (R1)"),
    "pad off the axis": (replaced("(at 0.32 0 45)", "(at 0.32 0.1 45)", 1), "pad 2 is not the land pattern's (R1)"),
    "pad with a hole": (replaced('(layers "F.Cu") (round', '(layers "F.Cu") (drill 0.2) (round', 1), "pad 1 is not the land"),
    "pad underneath": (replaced('(layers "F.Cu") (round', '(layers "B.Cu") (round', 1), "pad 1 is there 0 times (R1)"),
    "part underneath": (replaced('(layer "F.Cu") (tstamp', '(layer "B.Cu") (tstamp', 1), "1 footprint with layer on B.Cu"),
    "line in a part": (added_to_r1('(fp_line (start 0 0) (end 1 0) (layer "F.Cu") (width 0.1))'), "1 footprint with fp_line"),
    "copper in a part": (replaced("(fill none)", '(fill none) (layer "F.Cu")', 1), "has 2 times layer"),
    "zone": (added('(zone (net 0) (net_name "") (layer "F.Cu") (polygon (pts (xy 0 0) (xy 9 0) (xy 9 9))))'), "1 zone"),
    "track": (added('(segment (start 30 30) (end 31 30) (width 0.1) (layer "F.Cu") (net 0))'), "1 tracks are not the 0 lines"),
    "via": (added('(via (at 30 30) (size 0.6) (drill 0.3) (layers "F.Cu" "B.Cu") (net 0))'), "it has 1 via"),
    "line on copper": (added('(gr_line (start 30 30) (end 31 30) (layer "B.Cu") (width 0.1))'), "1 gr_line on B.Cu"),
    "thickness": (replaced("(thickness 0.11)", "(thickness 1.6)"), "1.6 mm thick, not 0.11"),
    "title": (replaced('(title "tactape-s100")', '(title "tactape-s101")'), "title is not the kit's name"),
    "inner copper": (replaced('(31 "B.Cu" signal)', '(1 "In1.Cu" signal) (31 "B.Cu" signal)'), "copper layers are not"),
    "a plane": (replaced('(0 "F.Cu" signal)', '(0 "F.Cu" power)'), "copper layers are not"),
    "all openings larger": (replaced("(pad_to_mask_clearance 0)", "(pad_to_mask_clearance 0.5)"), "its setup is not"),
    "a net": (replaced('(net 0 "")', '(net 0 "") (net 1 "GND")'), "it has nets"),
    "a note": (added('(gr_text "use FR4" (at 0 0) (layer "Cmts.User"))'), "it says 'use FR4' of backings"),
    "no opening": (lambda t: re.sub(r'    \(fp_rect [^\n]*"F.Mask"[^\n]*\n', "", t), "its 0 openings"),
    "an opening less": (lambda t: re.sub(r'    \(fp_rect [^\n]*"F.Mask"[^\n]*\n', "", t, count=1), "its 93 openings"),
    "an opening wider": (replaced("(start -0.6 -0.25) (end 0.6", "(start -0.6 -0.25) (end 0.8", 1), "its 94 openings"),
    "one window": (
        added('(gr_poly (pts (xy 22 22) (xy 38 22) (xy 38 38)) (layer "F.Mask") (width 0) (fill solid))'),
        "its 95 openings are not the 94",
    ),
    "hollow openings": (replaced('"F.Mask") (width 0) (fill solid)', '"F.Mask") (width 0) (fill none)'), "not filled"),
    "wide edge of openings": (replaced('"F.Mask") (width 0)', '"F.Mask") (width 1)'), "not filled to its edge alone"),
    "no tag": (lambda t: re.sub(r'  \(gr_poly [^\n]*"F.SilkS"[^\n]*\n', "", t), "its 0 areas of ink"),
    "ink across": (added('(gr_line (start 22 22) (end 38 38) (layer "F.SilkS") (width 0.15))'), "lines of ink"),
    "wide ink": (replaced('"F.SilkS") (width 0.15)', '"F.SilkS") (width 0.9)'), "lines of ink"),
    "another value": (replaced('value "0R"', 'value "10k"', 1), "1 footprints with another value"),
    "another footprint": (replaced("tactape:R_0201_0603Metric", "tactape:C_0402", 1), "1 footprints with another name"),
    "not placed": (replaced("(attr smd)", "(attr smd exclude_from_pos_files)", 1), "1 footprints with other attributes"),
    "another body": (replaced("(start -0.3 -0.15) (end 0.3 0.15)", "(start -0.3 -0.15) (end 0.6 0.15)", 1), "with another body"),
    "plated hole": (replaced("(layers *.Cu *.Mask)", "(layers *.Cu)"), "1 footprints with another pad"),
    "bulged corner": (
        lambda t: re.sub(r"(\(gr_arc \(start \S+ \S+\) \(mid )\S+ \S+\)", r"\1 30 30)", t, count=1),
        "its outline is",
    ),
    "side twice": (
        lambda t: re.sub(
            r'(\n  \(gr_line [^\n]*"Edge.Cuts"[^\n]*)\n  (\(gr_arc [^\n]*\n)  \(gr_line [^\n]*', r"\1\n  \2\1", t, count=1
        ),
        "its outline is",
    ),
    "number in quotes": (replaced("(at 0.32 0 45)", '(at "0.32" 0 45)', 1), "no quotes around '0.32' of at"),
    "number of a font in quotes": (replaced("(font (size 0.2", '(font (size "0.2"', 1), "no quotes around '0.2' of size"),
    "word in quotes": (replaced("(fill solid)", '(fill "solid")', 1), "no quotes around 'solid' of fill"),
    "kind in quotes": (replaced("fp_text reference", 'fp_text "reference"', 1), "no quotes around 'reference' of fp_text"),
    "name of a list in quotes": (replaced("(size 0.46", '("size" 0.46', 1), "no quotes around 'size' of size"),
    "format in quotes": (replaced("(version 20211014)", '(version "20211014")'), "'20211014' of version"),
    "row of layers in quotes": (replaced('(0 "F.Cu"', '("0" "F.Cu"'), "no quotes around '0' of 0"),
    "hidden by a comment": (replaced("  (footprint", "#  (footprint", 1), "'#' or character beyond ASCII outside quotes"),
    "quote left open": (replaced('(rev "', "(rev ", 1), "quote without an end"),
    "bracket too many": (lambda t: t + ")", "brackets do not match"),
    "nested without end": (lambda t: "(" * 100_000 + ")" * 100_000, "more than 16 deep"),
    "no number": (replaced("(at 0.32 0 45)", "(at nan 0 45)", 1), "'nan' stands where a number should"),
    "underscore in a place": (replaced("(at 26.9 22 45)", "(at 2_6.9 22 45)", 1), "'2_6.9' stands where a number should"),
    "courtyard of no number": (replaced("(start -0.7 -0.35)", "(start nan -0.35)", 1), "'nan' stands where a number should"),
    "value elsewhere": (replaced('value "0R" (at 0 0', 'value "0R" (at nan 0', 1), "'nan' stands where a number should"),
    "area of no number": (lambda t: re.sub(r"(gr_poly \(pts \(xy )", r"\1+", t, count=1), "stands where a number should"),
    "word for a row of layers": (replaced('(0 "F.Cu" signal)', "0"), "'0' stands in no row of its layers"),
    "empty list in what is foreign": (added_to_r1("(tag ())"), "footprint with tag"),
    "a word for a list": (lambda t: t.rstrip()[:-1] + " zone)", "'zone' stands in no list"),
    "word behind a line": (
        replaced('"Edge.Cuts") (width 0.05))', '"Edge.Cuts") (width 0.05) hide)', 1),
        "'gr_line' holds 'hide'",
    ),
    "locked": (replaced("(gr_arc (start", "(gr_arc locked (start", 1), "'gr_arc' begins with 1 word, not 0"),
    "font of no number": (replaced("(font (size 0.2", "(font (size x", 1), "'x' stands where a number should"),
    "format of another KiCad": (replaced("(version 20211014)", "(version 20171130)"), "its format is not that of KiCad 6"),
    "another sheet": (lambda t: re.sub(r'\(paper "User" \S+', '(paper "User" 300', t), "its sheet of 300 x"),
    "grid elsewhere": (replaced("(grid_origin 20 ", "(grid_origin 21 "), "its setup is not"),
    "wide outline": (replaced('"Edge.Cuts") (width 0.05)', '"Edge.Cuts") (width 0.5)', 1), "its outline is not"),
    "wide lines of a body": (replaced('"F.Fab") (width 0.05)', '"F.Fab") (width 0.5)', 1), "1 footprints with other lines"),
    "no courtyard": (lambda t: re.sub(r'    \(fp_rect [^\n]*"F.CrtYd"[^\n]*\n', "", t, count=1), "with another courtyard"),
    "value that shows": (replaced('(layer "F.Fab") hide)', '(layer "F.Fab"))', 1), "a text elsewhere, or one that shows"),
    "value turned": (replaced('value "0R" (at 0 0 45)', 'value "0R" (at 0 0 90)', 1), "a text elsewhere, or one that shows"),
    "cut off": (lambda t: t[: len(t) // 2], "cut off"),
    "empty": (lambda t: "", "no board of KiCad"),
}


@pytest.mark.parametrize("consistent", [thorough(False), True])
@pytest.mark.parametrize(("change", "says"), CHANGES.values(), ids=CHANGES)
def test_a_changed_board_is_caught(
    change: Callable[[str], str], says: str, consistent: bool, flat_kit: Kit, copied: Copy
) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.text(BOARD, change)
    lines = failed(verify_kit(kit.save(consistent=consistent), quick=True))
    assert says in lines["kicad board"].message
    assert ("files" in lines) == (not consistent)


def on_one_line(text: str) -> str:
    return re.sub(r"\s+", " ", text)


def spread_out(text: str) -> str:
    return re.sub(r'\(|\)|"[^"]*"', lambda found: f"\n\t {found[0]} \r\n" if found[0] in "()" else found[0], text)


def attributes_turned_round(text: str) -> str:
    """Lists of every pad, and of every footprint, in another order; the numbers of a list stay in theirs."""
    text = re.sub(r"(\(at \S+ 0 45\)) (\(size [^)]*\)) (\(layers [^)]*\))", r"\3 \2 \1", text)
    return re.sub(r'( \(layer "F.Cu"\) \(tstamp [^)]*\))(\n    \(at [^)]*\))', r"\2\1", text)


def without_quotes(text: str) -> str:
    return re.sub(r'\(layers? "([\w.]+)"\)', lambda found: found[0].replace('"', ""), text)


SAME = (on_one_line, spread_out, attributes_turned_round, without_quotes)


@pytest.mark.parametrize("change", SAME, ids=[change.__name__ for change in SAME])
def test_the_same_board_written_otherwise_is_the_same(change: Callable[[str], str], flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    before = kit.data[BOARD]
    kit.text(BOARD, change)
    assert kit.data[BOARD] != before
    assert failed(verify_kit(kit.save(consistent=True), quick=True)) == {}


RULES = {
    "clearance": ('"min_clearance": 0.1', '"min_clearance": 0.0'),
    "clearance of the class": ('"clearance": 0.1', '"clearance": 0.0'),
    "edge": ('"min_copper_edge_clearance": 0.3', '"min_copper_edge_clearance": 0.0'),
    "holes": ('"min_hole_to_hole": 0.5', '"min_hole_to_hole": 0.0'),
    "tracks": ('"min_track_width": 0.1', '"min_track_width": 0.0'),
    "tracks of the class": ('"track_width": 0.1', '"track_width": 0.2'),
    "ink": ('"min_silk_clearance": 0.0', '"min_silk_clearance": 0.2'),
    "vias": ('"via_drill": 0.3', '"via_drill": 0.1'),
    "excluded": ('"rule_severities": {}', '"rule_severities": {}, "drc_exclusions": ["clearance|1|2"]'),
    "not checked": ('"rule_severities": {}', '"rule_severities": {"clearance": "ignore"}'),
}


@pytest.mark.parametrize(("old", "new"), RULES.values(), ids=RULES)
def test_changed_rules_are_caught(old: str, new: str, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.text("kicad-project", replaced(old, new))
    kit.manifest["tool"]["version"] = "0.0.9"
    assert "are not the limits" in failed(verify_kit(kit.save(consistent=True), quick=True))["kicad board"].message


@pytest.mark.parametrize("project", [b"", b"{}", b"[" * 100_000, b'{"board": []}'])
def test_a_project_without_rules_is_caught(project: bytes, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.data["kicad-project"] = project
    assert "no design rules" in failed(verify_kit(kit.save(consistent=True), quick=True))["kicad board"].message
