"""Changes to a written KiCad board are caught by `verify` and named, whether or not the manifest's hashes were made to fit."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tactape_fab import Kit
from tactape_fab.verify import verify_kit
from tests.roundtrip.kits import OpenKit, failed

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


CHANGES = {
    "part moved": (footprint_moved, "off the grid: R10 by 20.0 um"),
    "part dropped": (footprint_dropped, "R10"),
    "part renamed": (replaced('reference "R10"', 'reference "C10"'), "C10, R10"),
    "all turned": (lambda t: re.sub(r"(\(at \S+ \S+) 45\)", r"\1 135)", t), "turned: R1 at 135 deg"),
    "one pad wider": (replaced("(size 0.46 0.4)", "(size 0.48 0.4)", 1), "pad 1 is there"),
    "all pads wider": (replaced("(size 0.46 0.4)", "(size 0.48 0.4)"), "pad 1 is not the land pattern's"),
    "pads apart": (replaced("(at 0.32 0 45)", "(at 0.34 0 45)"), "pad 2 is not the land pattern's"),
    "stencil": (replaced("(size 0.318 0.36)", "(size 0.318 0.4)"), "stencil aperture 1 is not"),
    "outline larger": (replaced("(start 21.000000 40.000000)", "(start 21.000000 40.200000)"), "outline"),
    "outline open": (lambda t: re.sub(r'\n  \(gr_arc [^\n]*"Edge.Cuts"[^\n]*', "", t, count=1), "7 sides"),
    "hole larger": (replaced("(drill 1)", "(drill 1.1)"), "holes are not the manifest's 1"),
    "origin moved": (replaced("(aux_axis_origin 20 40)", "(aux_axis_origin 21 40)"), "off the grid: R1 by 1000.0 um"),
    "cut off": (lambda t: t[: len(t) // 2], "cut off"),
    "empty": (lambda t: "", "no board of KiCad"),
}


@pytest.mark.parametrize("consistent", [False, True])
@pytest.mark.parametrize(("change", "says"), CHANGES.values(), ids=CHANGES)
def test_a_changed_board_is_caught(
    change: Callable[[str], str], says: str, consistent: bool, flat_kit: Kit, copied: Copy
) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.text(BOARD, change)
    lines = failed(verify_kit(kit.save(consistent=consistent), quick=True))
    assert says in lines["kicad board"].message
    assert ("files" in lines) == (not consistent)


@pytest.mark.parametrize("project", [b"", b"{}", b"[" * 100_000, b'{"board": []}'])
def test_a_project_without_rules_is_caught(project: bytes, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.data["kicad-project"] = project
    assert "no design rules" in failed(verify_kit(kit.save(consistent=True), quick=True))["kicad board"].message
