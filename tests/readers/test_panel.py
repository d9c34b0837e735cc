"""Outside readers see a panel's tapes, fiducials, slots and holes where they belong; KiCad opens its board and finds it legal."""

from __future__ import annotations

import json
import os
import re
import subprocess
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from gerbonara import GerberFile
from gerbonara.excellon import ExcellonFile

from tactape_fab import Tape
from tactape_fab.make.panel import PanelKit
from tests.panels import TWO, panel_of
from tests.readers.pictures import Picture, Reader
from tests.readers.raster import Window, coverage, polygon_edges_mm
from tests.roundtrip.kits import OpenKit, flashes, moved
from tests.thorough import slow

MARGIN_MM, PX_PER_MM = 0.5, 40
PAD_MM, PAD_RADIUS_MM, PAD_OFFSET_MM = (0.46, 0.40), 0.10, 0.32
FIDUCIAL_MM = 1.0
JUDGE = """
import json, re, sys, pcbnew
board = pcbnew.LoadBoard(sys.argv[1])
origin = board.GetDesignSettings().GetAuxOrigin()
places = {}
for part in board.GetFootprints():
    at = part.GetPosition()
    places[part.GetReference()] = [(at.x - origin.x) / 1e6, (origin.y - at.y) / 1e6]
assert pcbnew.WriteDRCReport(board, sys.argv[2], pcbnew.EDA_UNITS_MILLIMETRES, False)
text = open(sys.argv[2], encoding="utf-8").read()
json.dump({"places": places, "violations": re.findall(r"^\\\\[(\\\\w+)\\\\]:", text, flags=re.MULTILINE)}, sys.stdout)
"""


def placed(panel: PanelKit) -> list[tuple[Tape, Any]]:
    """Tapes and offsets as the manifests say."""
    return [(tape, offset) for tape, offset, _ in lying(panel)]


def lying(panel: PanelKit) -> list[tuple[Tape, Any, Any]]:
    """Tapes, offsets and turns as the manifests say."""
    rows = json.loads((panel.path / "manifest.json").read_bytes())["tapes"]
    return [(Tape.load(panel.path / row["manifest"]), np.array(row["offset_mm"]), turn_of(row["rotation_deg"])) for row in rows]


def turn_of(rotation_deg: float) -> Any:
    """Matrix from a tape's board to the panel."""
    turn = np.radians(rotation_deg)
    return np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])


def parts_mm(panel: PanelKit) -> Any:
    """Places of all parts on the panel, from the tapes alone."""
    return np.concatenate([tape.part_xy_mm() @ turn.T + offset for tape, offset, turn in lying(panel)])


def window(panel: PanelKit) -> Window:
    width, height = (round((side + 2 * MARGIN_MM) * PX_PER_MM) for side in panel.panel.size_mm)
    return Window(left_mm=-MARGIN_MM, bottom_mm=-MARGIN_MM, width_px=width, height_px=height)


def pads_mm(panel: PanelKit) -> Any:
    """Every pad as a polygon, from the tapes alone and the 0201's land pattern turned by 45 degrees."""
    core = shapely.box(*(-(np.array(PAD_MM) / 2 - PAD_RADIUS_MM)), *(np.array(PAD_MM) / 2 - PAD_RADIUS_MM))
    pad = shapely.affinity.rotate(core.buffer(PAD_RADIUS_MM, quad_segs=8), 45.0, origin=(0, 0))
    step = np.full(2, PAD_OFFSET_MM * np.sqrt(0.5))
    pads = []
    for tape, offset, turn in lying(panel):
        centres = tape.part_xy_mm() @ turn.T + offset
        both = np.concatenate([centres - turn @ step, centres + turn @ step])
        own = shapely.affinity.rotate(pad, np.degrees(np.arctan2(turn[1, 0], turn[0, 0])), origin=(0, 0))
        pads += [shapely.affinity.translate(own, x, y) for x, y in both.tolist()]
    return pads


def copper(panel: PanelKit) -> Picture:
    marks = [shapely.Point(xy).buffer(FIDUCIAL_MM / 2, quad_segs=32) for xy in panel.panel.fiducials_mm]
    return coverage(polygon_edges_mm(shapely.MultiPolygon([*pads_mm(panel), *marks])), window(panel))


def test_readers_draw_the_copper_of_every_tape_and_the_fiducials(panel_2: PanelKit, reader: Reader) -> None:
    picture = reader.draw(panel_2.path / panel_2.files["copper-top"], window(panel_2))
    assert reader.iou(picture, copper(panel_2)) >= reader.least_iou


@slow
@pytest.mark.parametrize("name", ["panel_packed", "coupon_panel"])
def test_readers_draw_the_pads_of_tapes_that_differ(name: str, reader: Reader, request: pytest.FixtureRequest) -> None:
    """Every tape's own grid, turned where the tape lies turned; a mesh of copper only where tapes are anchored."""
    panel: PanelKit = request.getfixturevalue(name)
    picture = reader.draw(panel.path / panel.files["copper-top"], window(panel))
    pads, anchored = pads_mm(panel), [row["sector"] for row in manifests(panel) if row["spec"]["anchor"] != "none"]
    outlines = [
        shapely.affinity.translate(
            shapely.affinity.rotate(shapely.box(0, 0, *tape.board.size_mm), 90.0 * bool(turn[1, 0]), (0, 0)), *offset
        )
        for tape, offset, turn in lying(panel)
        if tape.sector in anchored
    ]
    kept = shapely.box(0, 0, *panel.panel.size_mm).difference(shapely.union_all(outlines))
    marks = [shapely.Point(xy).buffer(FIDUCIAL_MM / 2, quad_segs=32) for xy in panel.panel.fiducials_mm]
    truth = coverage(polygon_edges_mm(shapely.MultiPolygon([*(p for p in pads if kept.contains(p)), *marks])), window(panel))
    mask = coverage(polygon_edges_mm(kept), window(panel)) > 0.5
    assert anchored and reader.iou(np.where(mask, picture, 0.0), np.where(mask, truth, 0.0)) >= reader.least_iou


def manifests(panel: PanelKit) -> list[Any]:
    return [json.loads((panel.path / kit / "manifest.json").read_bytes()) for kit in panel.kits]


@slow
@pytest.mark.parametrize("name", ["panel_packed", "coupon_panel"])
def test_gerbonara_sees_what_each_tape_is_opened_by(name: str, request: pytest.FixtureRequest) -> None:
    panel: PanelKit = request.getfixturevalue(name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mask = GerberFile.open(panel.path / panel.files["coverlay-top"])
        copper_layer = GerberFile.open(panel.path / panel.files["copper-top"])
    kinds = [type(o).__name__ for o in mask.objects]
    ways = {row["sector"]: row["fab"]["coverlay_mode"] for row in manifests(panel)}
    alone = sum(tape.part_count for tape in panel.tapes if ways[tape.sector] != "gang")
    assert set(ways.values()) == {"gang", "per-part"}
    assert (kinds.count("Region"), kinds.count("Flash")) == (list(ways.values()).count("gang"), alone + 4)
    flashed = np.array([(o.x, o.y) for o in copper_layer.objects if type(o).__name__ == "Flash"])[:-4]
    np.testing.assert_allclose(flashed.reshape(-1, 2, 2).mean(axis=1), parts_mm(panel), atol=2e-6)


def test_readers_draw_outline_and_slots(panel: PanelKit, reader: Reader) -> None:
    """What is left of the panel is the rails, the tapes, and tabs."""
    picture = reader.draw(panel.path / panel.files["profile"], window(panel))
    width, height = panel.panel.size_mm
    outer = shapely.box(0, 0, width, height).buffer(-1.0).buffer(1.0)
    lines = [outer.exterior, *slots_by_hand(panel)]
    truth = coverage(polygon_edges_mm(shapely.union_all([line.buffer(0.05, quad_segs=16) for line in lines])), window(panel))
    assert reader.iou(picture, truth) >= reader.least_iou


def slots_by_hand(panel: PanelKit) -> list[Any]:
    """Outlines of the slots, from numbers: rails 5, gaps 2, tabs 1 mm wide and at most 25 mm apart."""
    (width, height), (w, h) = panel.panel.size_mm, panel.panel.places[0].size_mm
    tapes = [
        shapely.box(*offset, *(offset + np.array([w, h]))).buffer(-1.0).buffer(1.0, quad_segs=32) for _, offset in placed(panel)
    ]
    room = shapely.box(5, 5, width - 5, height - 5).buffer(-1.0).buffer(1.0, quad_segs=32)
    bridges = []
    for _, (x, y) in placed(panel):
        for side, across in ((w, False), (h, True)):
            count = int(np.ceil(side / 25))
            for at in side * (np.arange(count) + 0.5) / count:
                for edge in (-1.0, (w if across else h) + 1.0):
                    middle = np.array([x + edge, y + at] if across else [x + at, y + edge])
                    along = np.array([0.0, 1.5] if across else [1.5, 0.0])
                    rest = shapely.box(
                        *(middle - along - (1.0, 1.0) * (along == 0)), *(middle + along + (1.0, 1.0) * (along == 0))
                    )
                    ends = [shapely.Point(middle + s * along).buffer(1.0, quad_segs=32) for s in (-1, 1)]
                    bridges.append(rest.buffer(1e-6).difference(shapely.union_all(ends)))
    pieces = shapely.get_parts(room.difference(shapely.union_all([*tapes, *bridges])))
    return [piece.exterior for piece in pieces if piece.area > 0.01]


def test_gerbonara_sees_the_worth_of_every_tape(panel: PanelKit) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        layer = GerberFile.open(panel.path / panel.files["copper-top"])
    flashed = np.array([(o.x, o.y) for o in layer.objects if type(o).__name__ == "Flash"])
    marks = flashed[-4:]
    np.testing.assert_allclose(marks, panel.panel.fiducials_mm, atol=1e-6)
    for tape, offset in placed(panel):
        inside = ((flashed >= offset) & (flashed <= offset + np.array(panel.panel.places[0].size_mm))).all(axis=1)
        assert inside.sum() == 2 * tape.part_count
    assert len(flashed) == 4 + sum(2 * tape.part_count for tape in panel.tapes)
    # turned round by half a turn, or mirrored, the marks would not fall on each other
    turned = np.array(panel.panel.size_mm) - marks
    assert min(np.abs(marks - xy).max(axis=1).min() for xy in turned) < 1e-6
    assert max(np.abs(marks - xy).max(axis=1).min() for xy in turned) > 4.9


def test_gerbonara_reads_every_hole(panel: PanelKit) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        file = ExcellonFile.open(panel.path / panel.files["drill-npth"])
    read = {(round(hole.x, 4), round(hole.y, 4), round(hole.aperture.diameter, 4)) for hole in file.objects}
    width, height = panel.panel.size_mm
    expected = {(x, y, 2.0) for x in (2.5, width - 2.5) for y in (2.5, height - 2.5)}
    expected |= {(x + dx, y + dy, d) for tape, (dx, dy) in placed(panel) for x, y, d in tape.board.holes}
    assert read == expected


@slow
def test_a_fiducial_elsewhere_is_seen(panel_2: PanelKit, reader: Reader, tmp_path: Path) -> None:
    """The pictures are fine enough to tell a wrong file: a pad's width is enough."""
    opened = OpenKit(panel_2.path)
    flashes("copper-top", moved(0.3, 0.3))(opened)
    path = tmp_path / "wrong.gtl"
    path.write_bytes(opened.data["copper-top"])
    assert reader.iou(reader.draw(path, window(panel_2)), copper(panel_2)) < reader.least_iou


@pytest.fixture(scope="module")
def gang_panel(tmp_path_factory: pytest.TempPathFactory) -> PanelKit:
    """Two tapes at a fab that opens the coverlay once over all parts of a tape."""
    return panel_of({**TWO, "fab": "jlcpcb-fpc"}, tmp_path_factory.mktemp("gang") / "panel")


@pytest.mark.parametrize("name", ["panel_2", "panel_6", "gang_panel", "panel_packed", "coupon_panel"])
def test_kicad_opens_the_board_and_finds_it_legal(
    name: str, request: pytest.FixtureRequest, kicad_python: str, tmp_path: Path
) -> None:
    panel: PanelKit = request.getfixturevalue(name)
    script = tmp_path / "judge.py"
    script.write_text(JUDGE.replace("\\\\", "\\"))
    board = panel.path / panel.files["kicad-pcb"]
    run = subprocess.run(
        [kicad_python, str(script), str(board), str(tmp_path / "report.txt")],
        capture_output=True,
        encoding="utf-8",
        check=False,
        env={**os.environ, "PYTHONPATH": ""},
    )
    assert run.returncode == 0, run.stderr[-2000:]
    answer = json.loads(run.stdout[run.stdout.index("{") :])
    assert answer["violations"] == []
    parts = parts_mm(panel)
    found = np.array([answer["places"][f"R{n}"] for n in range(1, len(parts) + 1)])
    np.testing.assert_allclose(found, parts, atol=1e-5)
    marks = [answer["places"][f"FID{n}"] for n in range(1, 5)]
    np.testing.assert_allclose(marks, panel.panel.fiducials_mm, atol=1e-5)
    assert sum(bool(re.fullmatch(r"H\d+", name)) for name in answer["places"]) == 4 + sum(len(t.board.holes) for t in panel.tapes)
