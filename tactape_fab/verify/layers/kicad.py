"""The KiCad board against the manifest: footprints, their lands, outline and holes, read out of its text."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.kit.profiles import LandPattern
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import named
from tactape_fab.verify.layers.lands import PLACE_TOLERANCE_MM, ROTATION_TOLERANCE_DEG, Recorded

_NUMBER = r"(-?\d+(?:\.\d+)?)"
_FOOTPRINT = re.compile(
    rf'\n  \(footprint "tactape:[^"\n]*" \(layer "F\.Cu"\)[^\n]*\n    \(at {_NUMBER} {_NUMBER}(?: {_NUMBER})?\)\n'
    r'[^\n]*\n    \(fp_text reference "([A-Z]+\d+)"',
    re.MULTILINE,
)
_PAD = re.compile(
    rf'"([12]?)" smd (?:roundrect|rect) \(at {_NUMBER} 0 {_NUMBER}\) \(size {_NUMBER} {_NUMBER}\)'
    rf' \(layers "([\w.]+)"\)(?: \(roundrect_rratio {_NUMBER}\))?'
)
_ANY_PAD = re.compile(r"\n    \(pad ([^\n]*) \(tstamp [0-9a-f-]+\)\)$", re.MULTILINE)
_DRILL = re.compile(rf"\(drill {_NUMBER}\)")
_ORIGIN = re.compile(rf"\(aux_axis_origin {_NUMBER} {_NUMBER}\)")
_POINT = re.compile(rf"\((?:start|mid|end) {_NUMBER} {_NUMBER}\)")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shown:
    """What a board should show: parts R1 ... Rn, outline and holes, the lines of the outline and of what is cut out of it,
    and fiducials, as in the board frame.
    """

    parts_xy_mm: FloatArray
    rotation_deg: float
    size_mm: tuple[float, float]
    holes: Sequence[tuple[float, float, float]]
    edge_lines: int
    fiducials_mm: Sequence[tuple[float, float]] = ()

    def designators(self) -> list[str]:
        return [f"R{n}" for n in range(1, len(self.parts_xy_mm) + 1)]


def sides_of(corner_radius_mm: float) -> int:
    """Lines and arcs of an outline."""
    return 8 if corner_radius_mm > 0 else 4


def shown_tape(tape: Tape) -> Shown:
    """What the board of a tape alone should show."""
    return Shown(
        parts_xy_mm=tape.part_xy_mm(),
        rotation_deg=tape.part.rotation_deg,
        size_mm=tape.board.size_mm,
        holes=tape.board.holes,
        edge_lines=sides_of(tape.board.corner_radius_mm),
    )


def check_kicad(board: bytes, project: bytes, shown: Shown, lands: Recorded) -> list[Check]:
    """The board shows what the manifest says, and its project is JSON with design rules."""
    text = board.decode("utf-8", errors="replace")
    origin = _ORIGIN.search(text)
    if origin is None or text.count("(") != text.count(")"):
        return [Check(name="kicad board", passed=False, message="it is no board of KiCad with an origin, or it was cut off")]
    x0_mm, y0_mm = float(origin[1]), float(origin[2])
    found = {m[4]: (float(m[1]) - x0_mm, y0_mm - float(m[2]), float(m[3] or 0.0)) for m in _FOOTPRINT.finditer(text)}
    others = {name: at for name, at in found.items() if name[0] in "HF"}
    problems = [
        *_places(found, text.count('\n  (footprint "'), shown),
        *_lands(text, shown, lands),
        *_outline(text, (x0_mm, y0_mm), shown),
        *_holes(others, text, shown),
        *_fiducials(others, shown),
        *_rules(project),
    ]
    right = f"{len(shown.parts_xy_mm)} footprints with their lands, outline and holes as the manifest has them"
    message = named(problems) if problems else right
    return [Check(name="kicad board", passed=not problems, message=message)]


def _places(found: dict[str, tuple[float, float, float]], count: int, shown: Shown) -> list[str]:
    expected = shown.designators()
    parts = [name for name in found if name[0] not in "HF"]
    if parts != expected or count != len(expected) + len(shown.holes) + len(shown.fiducials_mm):
        wrong = sorted(set(parts) ^ set(expected))
        return [f"its {count} footprints are not R1 to R{len(expected)} in order" + (f": {named(wrong)}" if wrong else "")]
    rows = np.array([found[name] for name in expected])
    error_mm = np.hypot(*(rows[:, :2] - shown.parts_xy_mm).T)
    turn_deg = np.abs((rows[:, 2] - shown.rotation_deg + 180.0) % 360.0 - 180.0)
    far, turned = np.flatnonzero(error_mm > PLACE_TOLERANCE_MM), np.flatnonzero(turn_deg > ROTATION_TOLERANCE_DEG)
    said = []
    if len(far):
        said.append(f"off the grid: {named([f'{expected[i]} by {1000 * error_mm[i]:.1f} um' for i in far])}")
    if len(turned):
        said.append(f"turned: {named([f'{expected[i]} at {rows[i, 2]:g} deg' for i in turned])}")
    return said


def _lands(text: str, shown: Shown, lands: Recorded) -> list[str]:
    """Every pad is one of the four that the manifest's land pattern gives, each as often as there are parts."""
    parts = len(shown.parts_xy_mm)
    pads = ((_PAD.fullmatch(words), count) for words, count in Counter(_ANY_PAD.findall(text)).items())
    counts = {pad.groups(default=""): count for pad, count in pads if pad is not None}
    expected = [
        *(("12"[k], "F.Cu", lands.pads, k) for k in range(2)),
        *(("", "F.Paste", lands.paste, k) for k in range(2)),
    ]
    problems = []
    for number, layer, land, k in expected:
        alike = [row for row in counts if row[0] == number and row[5] == layer and (float(row[1] or 0) > 0) == (k == 1)]
        what = f"pad {number}" if number else f"stencil aperture {k + 1}"
        if [counts[row] for row in alike] != [parts]:
            problems.append(f"{what} is there {sum(counts[row] for row in alike)} times in {len(alike)} forms")
        elif not _is_land(alike[0], land, k, shown.rotation_deg):
            problems.append(f"{what} is not the land pattern's")
    if (total := sum(counts.values())) != 4 * parts:
        problems.append(f"it has {total} lands, not {4 * parts}")
    return problems


def _is_land(row: tuple[str, ...], land: LandPattern, k: int, rotation_deg: float) -> bool:
    at_mm, turn_deg, length_mm, width_mm = (float(v or "nan") for v in row[1:5])
    radius_mm = float(row[6] or 0.0) * min(length_mm, width_mm)
    wanted = (land.offset_mm if k else -land.offset_mm, *land.size_mm, land.corner_radius_mm)
    turned = abs((turn_deg - rotation_deg + 180.0) % 360.0 - 180.0)
    return bool(
        np.allclose((at_mm, length_mm, width_mm, radius_mm), wanted, rtol=0.0, atol=PLACE_TOLERANCE_MM)
        and turned <= ROTATION_TOLERANCE_DEG
    )


def _outline(text: str, origin_mm: tuple[float, float], shown: Shown) -> list[str]:
    lines = _lines_with(text, '(layer "Edge.Cuts")')
    points = np.array([(float(x), float(y)) for line in lines for x, y in _POINT.findall(line)]).reshape(-1, 2)
    if len(lines) != shown.edge_lines:
        return [f"its outline has {len(lines)} sides and corners, not {shown.edge_lines}"]
    box_mm = np.concatenate([points.min(axis=0), points.max(axis=0)]) - np.tile(origin_mm, 2)
    width_mm, height_mm = shown.size_mm
    wrong = np.abs(box_mm - (0.0, -height_mm, width_mm, 0.0)).max() > PLACE_TOLERANCE_MM
    return [f"its outline is {box_mm[2] - box_mm[0]:g} x {box_mm[3] - box_mm[1]:g} mm about another place"] if wrong else []


def _lines_with(text: str, words: str) -> list[str]:
    """Lines of a long text with words that stand in few of them."""
    lines, at = [], text.find(words)
    while at >= 0:
        end = (text.find("\n", at) + 1 or len(text) + 1) - 1
        lines.append(text[text.rfind("\n", 0, at) + 1 : end])
        at = text.find(words, end)
    return lines


def _holes(found: dict[str, tuple[float, float, float]], text: str, shown: Shown) -> list[str]:
    holes = [xy[:2] for name, xy in found.items() if name.startswith("H")]
    drills = [float(d) for d in _DRILL.findall(text)]
    rows = np.array([(*xy, d) for xy, d in zip(holes, drills, strict=False)]).reshape(-1, 3)
    wanted = np.array(shown.holes).reshape(-1, 3)
    if len(holes) == len(drills) == len(wanted) and np.allclose(rows, wanted, rtol=0.0, atol=PLACE_TOLERANCE_MM):
        return []
    return [f"its {len(drills)} holes are not the manifest's {len(wanted)}"]


def _fiducials(found: dict[str, tuple[float, float, float]], shown: Shown) -> list[str]:
    marks = np.array([xy[:2] for name, xy in found.items() if name.startswith("FID")]).reshape(-1, 2)
    wanted = np.array(shown.fiducials_mm).reshape(-1, 2)
    if len(marks) == len(wanted) and np.allclose(marks, wanted, rtol=0.0, atol=PLACE_TOLERANCE_MM):
        return []
    return [f"its {len(marks)} fiducials are not the manifest's {len(wanted)}"]


def _rules(project: bytes) -> list[str]:
    try:
        json.loads(project)["board"]["design_settings"]["rules"]["min_clearance"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return ["its project holds no design rules"]
    return []
