"""Changes to a written KiCad board are caught by `verify` and named, whether or not the manifest's hashes were made to fit."""

from __future__ import annotations

import re
from collections.abc import Callable
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
    "hole larger": (replaced("(drill 1)", "(drill 1.1)"), "holes are not the manifest's 1"),
    "origin moved": (replaced("(aux_axis_origin 20 40)", "(aux_axis_origin 21 40)"), "off the grid: R1 by 1000.0 um"),
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
    "hidden by a comment": (replaced("  (footprint", "#  (footprint", 1), "'#' outside quotes"),
    "quote left open": (replaced('(rev "', "(rev ", 1), "quote without an end"),
    "bracket too many": (lambda t: t + ")", "brackets do not match"),
    "nested without end": (lambda t: "(" * 100_000 + ")" * 100_000, "more than 16 deep"),
    "no number": (replaced("(at 0.32 0 45)", "(at nan 0 45)", 1), "not finite"),
    "a word for a list": (lambda t: t.rstrip()[:-1] + " zone)", "'zone' stands in no list"),
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


@pytest.mark.parametrize("project", [b"", b"{}", b"[" * 100_000, b'{"board": []}'])
def test_a_project_without_rules_is_caught(project: bytes, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.data["kicad-project"] = project
    assert "no design rules" in failed(verify_kit(kit.save(consistent=True), quick=True))["kicad board"].message
