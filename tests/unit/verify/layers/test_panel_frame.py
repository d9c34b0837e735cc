"""Outline, slots, fiducials and tooling holes of a panel: as planned they pass, and one that is changed is named."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import shapely

from tactape_fab.kit.panel.panel_drawing import slots_mm
from tactape_fab.kit.panel.tabs_and_marks import plan_panel
from tactape_fab.kit.profiles import load_fab
from tactape_fab.kit.read.gerber_file import GerberContent
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.panel_manifest import PlacedTape
from tactape_fab.verify.layers.on_panel import OnPanel
from tactape_fab.verify.layers.panel_frame import check_cut, check_rails
from tests.tapes import tape_at

TAPE = tape_at(7, (20, 12))  # 36 x 24 mm
PANEL = plan_panel(TAPE.board.size_mm, 0.0, (2, 1), "auto", load_fab("jlcpcb-fpc"))
SIZE = f"{PANEL.size_mm[0]:g} x {PANEL.size_mm[1]:g}"
TABS = 2 * (PANEL.places[0].tabs_x + PANEL.places[0].tabs_y)
ON = [
    OnPanel(tape=TAPE, place=PlacedTape(manifest="m", sha256="0", offset_mm=at, rotation_deg=0.0, first_designator="R1"))
    for at in PANEL.offsets_mm
]
NONE = np.empty((0, 2))


def content(*strokes: FloatArray, flashes: FloatArray = NONE, outline: FloatArray = NONE, **more: Any) -> GerberContent:
    values: dict[str, Any] = {
        "flash_xy_mm": flashes,
        "flash_aperture": np.zeros(len(flashes), dtype=np.int64),
        "aperture_outlines_mm": (outline,) if len(flashes) else (),
        "areas_mm": (),
        "strokes_mm": strokes,
        "stroke_width_mm": np.full(len(strokes), 0.1),
        "aperture_functions": (),
        "flash_component": ("",) * len(flashes),
        "flash_pin": ("",) * len(flashes),
        "clear": False,
        "file_attributes": {},
    }
    return GerberContent(**values | more)


CUT = [np.concatenate([line, line[:1]]) for line in (PANEL.outline_mm, *slots_mm(PANEL))]


def outside(polygon: Any) -> FloatArray:
    return np.array(polygon.exterior.coords)


def over_a_tab() -> list[FloatArray]:
    """The first slot reaches 3 mm along the tape's side over the tab beside it."""
    tape = shapely.Polygon(PANEL.places[0].outline_mm)
    tab = min(
        shapely.get_parts(
            shapely.difference(tape.buffer(0.5, join_style="mitre"), shapely.union_all([tape, *map(shapely.Polygon, CUT[1:])]))
        ),
        key=lambda piece: shapely.distance(piece, shapely.Polygon(CUT[1])) + abs(shapely.area(piece) - 0.5 * PANEL.tab_mm),
    )
    longer = shapely.Polygon(CUT[1]).union(tab.buffer(0.01, join_style="mitre").difference(tape))
    return [CUT[0], outside(longer), *CUT[2:]]


Strokes = Callable[[], list[FloatArray]]


@pytest.mark.parametrize(
    ("strokes", "more", "says"),
    [
        (lambda: CUT, {}, f"{SIZE} mm with {len(CUT) - 1} slots, every tape whole and held by {TABS} tabs"),
        (lambda: [line + 0.0005 for line in CUT], {}, f"held by {TABS} tabs"),
        (lambda: [CUT[0] + (0.002, 0.0), *CUT[1:]], {}, "a contour is 0.002 mm off the manifest's panel"),
        (lambda: [CUT[0], CUT[1] + (1.0, 0.5), *CUT[2:]], {}, "mm2 off a tape"),
        (over_a_tab, {}, f"a tape is held by {TABS - 1} tabs, not {TABS}"),
        (lambda: CUT[:-1], {}, f"{len(CUT) - 1} contours instead of {len(CUT)}"),
        (lambda: [CUT[0][:-1], *CUT[1:]], {}, "objects that are not closed contours"),
        (lambda: [*CUT, CUT[0][[0, 1, 0]]], {}, "objects that are not closed contours"),
        (lambda: CUT, {"areas_mm": (CUT[0],)}, "objects that are not closed contours"),
        (lambda: CUT, {"flashes": np.ones((1, 2)), "outline": CUT[0]}, "objects that are not closed contours"),
        (lambda: CUT, {"clear": True}, "clear polarity"),
        (lambda: [CUT[0][[0, 2, 1, 3, 0]], *CUT[1:]], {}, "a contour crosses itself"),
    ],
)
def test_slots_leave_every_tape_whole_and_held(strokes: Strokes, more: dict[str, Any], says: str) -> None:
    check = check_cut(content(*strokes(), **more), PANEL)
    assert check.passed == ("held by" in says and "not" not in says), check.message
    assert says in check.message
    assert "0.002 mm off" not in says or check.figure == pytest.approx(2.0)


def disc(diameter_mm: float, vertices: int = 64) -> FloatArray:
    angle = np.linspace(0.0, 2 * np.pi, vertices, endpoint=False)
    return diameter_mm / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)


MARKS = np.array(PANEL.fiducials_mm)
MM, OPENING_MM = PANEL.fiducial_mm, PANEL.fiducial_opening_mm
HOLES = np.array(PANEL.tooling_holes_mm)
ON_TAPE = np.add([PANEL.offsets_mm[1]], 10.0)


@pytest.mark.parametrize(
    ("role", "layer", "says"),
    [
        ("copper-top", content(flashes=MARKS, outline=disc(MM)), f"{len(MARKS)} fiducials"),
        ("coverlay-top", content(flashes=MARKS, outline=disc(OPENING_MM)), f"{len(MARKS)} fiducials"),
        ("copper-top", content(flashes=np.concatenate([ON_TAPE, MARKS]), outline=disc(MM)), f"{len(MARKS)} fiducials"),
        ("copper-top", content(flashes=MARKS + 0.0009, outline=disc(MM)), f"{len(MARKS)} fiducials"),
        ("copper-top", content(flashes=np.add(MARKS, (0.0, 0.0011)), outline=disc(MM)), "a fiducial is at ("),
        ("copper-top", content(flashes=MARKS[1:], outline=disc(MM)), f"instead of {len(MARKS)} fiducials"),
        (
            "copper-top",
            content(flashes=np.concatenate([MARKS, [(1.0, 2.0)]]), outline=disc(MM)),
            "one of them at (1.000, 2.000) mm",
        ),
        ("copper-top", content(flashes=MARKS, outline=disc(MM + 0.004)), f"{len(MARKS)} fiducials"),
        ("copper-top", content(flashes=MARKS, outline=disc(MM + 0.006)), f"a fiducial is no disc of {MM:g} mm"),
        ("copper-top", content(flashes=MARKS, outline=disc(MM, 4)), f"a fiducial is no disc of {MM:g} mm"),
        ("paste-top", content(flashes=MARKS, outline=disc(MM)), f"{len(MARKS)} flashes beside the tapes instead of 0 fiducials"),
        ("paste-top", content(), "nothing beside the tapes"),
        ("legend-top", content(np.array([(0.5, 1.0), (3.0, 1.0)])), "1 lines lie beside the tapes"),
        ("legend-top", content(np.add(ON_TAPE, [[0.0, 0.0], [3.0, 1.0]])), "nothing beside the tapes"),
        ("legend-top", content(areas_mm=(disc(2.0) + 2.0, disc(2.0) + ON_TAPE)), "1 areas lie beside the tapes"),
    ],
)
def test_beside_the_tapes_there_are_the_fiducials_alone(role: str, layer: GerberContent, says: str) -> None:
    (check,) = check_rails({"profile": content(*CUT), role: layer}, None, PANEL, ON)
    assert check.name == f"{role} of the rails" and says in check.message
    assert check.passed == (says in (f"{len(MARKS)} fiducials", "nothing beside the tapes"))


@pytest.mark.parametrize(
    ("holes", "passed"),
    [
        (HOLES, True),
        (HOLES[::-1], True),
        (np.concatenate([HOLES, np.column_stack([ON_TAPE, [2.0]])]), True),
        (np.add(HOLES, (0.0, 0.0009, 0.0)), True),
        (np.add(HOLES, (0.0, 0.0011, 0.0)), False),
        (HOLES[1:], False),
        (np.concatenate([HOLES, [(1.0, 1.0, 0.5)]]), False),
        (np.add(HOLES, (0.0, 0.0, 0.1)), False),
    ],
)
def test_tooling_holes_are_those_of_the_panel(holes: FloatArray, passed: bool) -> None:
    (check,) = check_rails({}, holes, PANEL, ON)
    assert check.passed is passed and check.message.startswith(
        f"{len(holes) - (len(holes) > len(HOLES) and passed)} tooling holes"
    )
    assert passed or f"not the {len(HOLES)} of the manifest" in check.message
