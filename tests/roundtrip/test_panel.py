"""Panels from their written files: every tape is read where it lies, decodes to its sector, and what is wrong is named."""

from __future__ import annotations

import csv
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner

from tactape_fab import Localizer, Tape, verify_kit
from tactape_fab.base.errors import Check, DesignRuleError, SpecError, VerifyError
from tactape_fab.cli import main
from tactape_fab.make.panel import PanelKit, make_panel
from tactape_fab.sense import simulate
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.frames import rows_to_symbols
from tactape_fab.texture.plane import locate_windows
from tactape_fab.texture.registry import read_tapes
from tactape_fab.verify import Verification
from tactape_fab.verify.panel import verify_panel_folder
from tests.panels import TWO, examined_panel, panel_of
from tests.roundtrip.kits import OpenKit, exchanged, failed, flashes, map_points, moved, points, replaced, rows, text_of
from tests.thorough import as_elsewhere, slow

Edit = Callable[[OpenKit], object]
LETTERS = {(0, 1): "N", (0, -1): "S", (-1, 0): "W", (1, 0): "E"}
"""Symbols by the direction of the displacement on the board, y up."""


def manifest_of(panel: PanelKit) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((panel.path / "manifest.json").read_bytes())
    return content


def test_the_manifest_is_as_pinned(panel: PanelKit) -> None:
    content = manifest_of(panel)
    assert content["format"] == "tactape-panel/1"
    assert {row["role"] for row in content["files"]} >= {"copper-top", "cpl", "bom", "kicad-pcb", "order-notes", "fab-zip"}
    number = 1
    for row in content["tapes"]:
        kit = json.loads((panel.path / row["manifest"]).read_bytes())
        assert row["manifest"] == f"tapes/{kit['name']}/manifest.json"
        assert (row["first_designator"], row["rotation_deg"]) == (f"R{number}", 0.0)
        number += sum(map(len, kit["symbols"])) - len(kit["omitted"])
    assert number - 1 == sum(tape.part_count for tape in panel.tapes)


def test_the_cpl_decodes_to_every_sector_at_its_place(panel: PanelKit) -> None:
    with (panel.path / panel.files["cpl"]).open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["Designator"] for row in table] == [f"R{n}" for n in range(1, len(table) + 1)]
    xy = np.array([(float(row["Mid X"]), float(row["Mid Y"])) for row in table])
    for row in manifest_of(panel)["tapes"]:
        kit = json.loads((panel.path / row["manifest"]).read_bytes())
        first = int(row["first_designator"][1:]) - 1
        own = xy[first : first + row["parts"]] - row["offset_mm"]
        symbols = symbols_at(own, kit)
        code = get_plane(kit["code"])
        places = locate_windows(code, symbols)
        assert places.valid.all()
        assert set(np.unique(places.sector)) == {kit["sector"]}
        column, line = np.meshgrid(np.arange(places.valid.shape[1]), np.arange(places.valid.shape[0]))
        assert (places.column == kit["origin"][0] + column).all()
        assert (places.row == kit["origin"][1] + line).all()


def symbols_at(xy_mm: npt.NDArray[np.float64], kit: dict[str, Any]) -> npt.NDArray[np.uint8]:
    """Symbols by the formula of docs/frames.md: grid point (c, r) at (x0 + c W, y0 - r W), a part displaced by Delta from it."""
    x0, y0 = kit["board"]["texture_origin_mm"]
    pitch = kit["pitch_mm"]
    place = np.stack([xy_mm[:, 0] - x0, y0 - xy_mm[:, 1]], axis=1) / pitch
    cell = np.rint(place).astype(int)
    off = np.rint((place - cell) * pitch / kit["displacement_mm"]).astype(int) * (1, -1)
    letters = np.full((kit["rows"], kit["columns"]), "?")
    for (c, r), (dx, dy) in zip(cell.tolist(), off.tolist(), strict=True):
        letters[r, c] = LETTERS[dx, dy]
    return rows_to_symbols(["".join(line) for line in letters])


def test_verify_names_every_tape_and_every_kit(panel: PanelKit) -> None:
    verification = verify_kit(panel.path, quick=True)
    assert verification.passed
    names = {check.name for check in verification.checks}
    assert {f"{what} {tape.name}" for tape in panel.tapes for what in ("tape", "kit")} <= names


def test_decode_locates_frames_of_every_tape(panel: PanelKit) -> None:
    registry = read_tapes([panel.path])
    assert [tape.name for tape in registry] == [tape.name for tape in panel.tapes]
    localizer = Localizer(registry, sensor="gelsight-mini")
    for tape in registry:
        depth = simulate(tape, (10.0, 8.0), 25.0, sensor="gelsight-mini", seed=1)
        fix = localizer.locate(depth)
        assert (fix.located, fix.tape) == (True, tape.name), fix.reason
        assert fix.position_mm == pytest.approx((10.0, 8.0), abs=0.1)


def test_a_folder_of_panels_and_kits_is_a_registry(panel_2: PanelKit, panel_packed: PanelKit, tmp_path: Path) -> None:
    for name, made in (("a", panel_packed), ("b", panel_2)):
        (tmp_path / name).symlink_to(made.path)
    assert len(read_tapes([tmp_path])) == 7
    assert len(read_tapes([panel_2.path / "manifest.json"])) == 2


def test_a_panel_is_no_tape(panel_2: PanelKit) -> None:
    with pytest.raises(SpecError, match="that of a panel, not of one tape; give the folder of one of the kits on it"):
        Tape.load(panel_2.path)


def test_the_same_panel_has_the_same_bytes(panel_2: PanelKit, tmp_path: Path) -> None:
    with as_elsewhere():
        again = panel_of(TWO, tmp_path / "again")
    for path in sorted(p.relative_to(panel_2.path) for p in panel_2.path.rglob("*") if p.is_file()):
        assert (again.path / path).read_bytes() == (panel_2.path / path).read_bytes(), path


def test_the_kits_are_those_of_the_tapes_alone(panel_2: PanelKit, tmp_path: Path) -> None:
    alone = tmp_path / "alone"
    command = f"make --sector 8 --size 60x30 --no-3d -o {alone}"
    with as_elsewhere():
        assert CliRunner().invoke(main, command.split()).exit_code == 0
    on_panel = panel_2.path / "tapes" / "tactape-s008"
    differing = [
        str(path.relative_to(alone))
        for path in sorted(alone.rglob("*"))
        if path.is_file() and (on_panel / path.relative_to(alone)).read_bytes() != path.read_bytes()
    ]
    assert differing == []


# What is wrong is named


def swap_kits(kit: OpenKit) -> None:
    """The manifest says of two tapes that each is the other."""
    a, b = kit.manifest["tapes"][:2]
    for key in ("manifest", "sha256", "name", "sector"):
        a[key], b[key] = b[key], a[key]


def swap_places(kit: OpenKit) -> None:
    a, b = kit.manifest["tapes"][:2]
    a["offset_mm"], b["offset_mm"] = b["offset_mm"], a["offset_mm"]


def _apart(kit: OpenKit) -> float:
    """How far apart the first two tapes of a panel in one column lie."""
    return float(kit.manifest["tapes"][0]["offset_mm"][1] - kit.manifest["tapes"][1]["offset_mm"][1])


def swap_drawn(role: str) -> Edit:
    """The upper tape of one file is drawn where the lower one belongs, and the other way round."""

    def edit(kit: OpenKit) -> None:
        step, middle = _apart(kit), kit.manifest["panel"]["size_mm"][1] / 2

        def other(p: tuple[float, float]) -> tuple[float, float]:
            rail = p[1] < 6.0 or p[1] > 2 * middle - 6.0
            return p if rail else (p[0], p[1] - step if p[1] > middle else p[1] + step)

        kit.text(role, lambda text: map_points(text, other))

    return edit


def swap_rows(kit: OpenKit) -> None:
    step = _apart(kit)

    def swap(table: list[list[str]]) -> None:
        y = table[0].index("Mid Y")
        second = kit.manifest["tapes"][1]["first_designator"]
        at = next(i for i, row in enumerate(table) if row[0] == second)
        for i, row in enumerate(table[1:], start=1):
            row[y] = f"{float(row[y]) + (step if i >= at else -step):.4f}"

    rows("cpl", swap)(kit)


def fiducial(dx_mm: float) -> Edit:
    return lambda kit: flashes("copper-top", moved(dx_mm, 0.0), kit.data["copper-top"].count(b"D03*") - 1)(kit)


def fill_slot(kit: OpenKit) -> None:
    """Leave the last slot out of the profile."""

    def change(text: str) -> str:
        start = text.rindex("\n", 0, text.rindex("D02*"))
        end = text.index("%T", start) if "%T" in text[start:] else text.index("M02*")
        return text[: start + 1] + text[end:]

    kit.text("profile", change)


def cut_tab(kit: OpenKit) -> None:
    """Move the ends of one slot over the tab beside it."""
    kit.text(
        "profile", lambda text: re.sub(r"(?s)(.*)X(\d+)Y(\d+)D01\*", lambda m: f"{m[1]}X{int(m[2]) + 3_000_000}Y{m[3]}D01*", text)
    )


def kit_of_another(kit: OpenKit) -> None:
    """The folder of one tape holds the kit of its neighbour."""
    a, b = (kit.folder / Path(row["manifest"]).parent for row in kit.manifest["tapes"][:2])
    shutil.rmtree(a)
    shutil.copytree(b, a)


MUTATIONS: dict[str, tuple[Edit, str]] = {
    "kits swapped in the manifest": (swap_kits, r"tape tactape-s00[78]: .*"),
    "places swapped in the manifest": (swap_places, "arrangement"),
    "tapes swapped in the CPL": (swap_rows, "tape tactape-s007: symbols from CPL"),
    "tapes swapped in copper": (swap_drawn("copper-top"), "tape tactape-s007: symbols from copper"),
    "tapes swapped in the legend": (swap_drawn("legend-top"), "tape tactape-s007: tag.*"),
    "tapes swapped in the component layer": (swap_drawn("components-top"), "tape tactape-s007: components-top"),
    "the folder of a kit holds another": (kit_of_another, "kits"),
    "a fiducial moved": (fiducial(0.1), "copper-top of the rails"),
    "square fiducials": (replaced("copper-top", "C,1.000000*%", "P,1.000000X4X0.000000*%"), "copper-top of the rails"),
    "a fiducial on a tape": (
        lambda k: flashes("coverlay-top", lambda _: (20.0, 20.0), k.data["coverlay-top"].count(b"D03*") - 1)(k),
        "coverlay-top of the rails",
    ),
    "a tooling hole moved": (replaced("drill-npth", "X2.5000Y2.5000", "X2.6000Y2.5000"), "drill-npth of the rails"),
    "a tooling hole of another size": (replaced("drill-npth", "C2.0000", "C2.1000"), "drill-npth of the rails"),
    "a slot left out": (fill_slot, "profile"),
    "a tab cut": (cut_tab, "profile"),
    "the outline moved": (points("profile", moved(0.1, 0.0)), "profile"),
    "copper and paste exchanged": (exchanged("copper-top", "paste-top"), "attributes"),
    "a pad in the rails": (flashes("paste-top", lambda _: (2.5, 30.0), 5), "paste-top of the rails"),
    "rows of the CPL exchanged": (rows("cpl", lambda t: t.insert(1, t.pop())), "cpl order"),
    "a designator of the BOM": (rows("bom", lambda t: t[1].__setitem__(0, t[1][0].replace("R2,", "R9999,"))), "bom"),
    "another first designator": (lambda k: k.manifest["tapes"][1].update(first_designator="R5"), "arrangement"),
    "another name of a tape": (lambda k: k.manifest["tapes"][1].update(name="tactape-s009"), "arrangement"),
    "another sector of a tape": (lambda k: k.manifest["tapes"][1].update(sector=9), "arrangement"),
    "another number of parts": (lambda k: k.manifest["tapes"][1].update(parts=1), "arrangement"),
    "another pitch in the spec": (lambda k: k.manifest["spec"].update(pitch_mm=1.6), "arrangement"),
    "an option of no tape in the spec": (lambda k: k.manifest["spec"].update(hello=1), "arrangement"),
    "a turned tape": (lambda k: k.manifest["tapes"][1].update(rotation_deg=90.0), "arrangement"),
    "a tape turned by half": (lambda k: k.manifest["tapes"][1].update(rotation_deg=45.0), "manifest"),
    "a path out of the panel": (lambda k: k.manifest["tapes"][1].update(manifest="tapes/../../x/manifest.json"), "manifest"),
    "more rows than tapes": (lambda k: k.manifest["panel"].update(rows=3), "arrangement"),
    "another outline in the manifest": (lambda k: k.manifest["panel"].update(size_mm=[74.0, 76.05]), "arrangement"),
    "another radius in the manifest": (lambda k: k.manifest["panel"].update(corner_radius_mm=1.05), "arrangement"),
    "a wider gap": (lambda k: k.manifest["panel"].update(gap_mm=2.5), "arrangement"),
    "one tab less": (lambda k: k.manifest["panel"].update(tabs_x=1), "profile"),
    "the notes' size": (text_of("order-notes", lambda t: t.replace(" x 76 mm", " x 77 mm")), "order-notes"),
    "a part moved in KiCad's board": (
        text_of("kicad-pcb", lambda t: re.sub(r"\(at (\d+)", lambda m: f"(at {int(m[1]) + 1}", t, count=1)),
        "kicad board",
    ),
    "a slot less in KiCad's board": (
        text_of("kicad-pcb", lambda t: re.sub(r"(?m)^  \(gr_line .*Edge.Cuts.*\n", "", t, count=1)),
        "kicad board",
    ),
    "a smaller fiducial in KiCad's board": (
        text_of("kicad-pcb", lambda t: t.replace("smd circle (at 0 0) (size 1 1)", "smd circle (at 0 0) (size 0.5 0.5)", 1)),
        "kicad board",
    ),
    "a fiducial covered in KiCad's board": (
        text_of("kicad-pcb", lambda t: t.replace("(solder_mask_margin 0.5)", "(solder_mask_margin 0)", 1)),
        "kicad board",
    ),
    "a fiducial less in KiCad's board": (
        text_of("kicad-pcb", lambda t: t.replace('reference "FID4"', 'reference "FIX4"')),
        "kicad board",
    ),
}


def assert_named(case: tuple[Edit, str], folder: Path) -> None:
    edit, line = case
    opened = OpenKit(folder)
    edit(opened)
    wrong = failed(verify_panel_folder(opened.save(consistent=True) / "manifest.json", quick=True, kits=False))
    assert any(re.fullmatch(line, found) for found in wrong), list(wrong)


@pytest.mark.parametrize("name", MUTATIONS)
def test_what_is_wrong_is_named(name: str, panel_2: PanelKit, copied: Callable[[PanelKit], Path]) -> None:
    assert_named(MUTATIONS[name], copied(panel_2))


def test_a_changed_kit_is_named(panel_2: PanelKit, copied: Callable[[PanelKit], Path]) -> None:
    folder = copied(panel_2)
    opened = OpenKit(folder / "tapes" / "tactape-s008")
    rows("cpl", lambda table: table[1].__setitem__(1, "1.0"))(opened)
    opened.save(consistent=True)
    wrong = failed(verify_kit(folder, quick=True))
    assert {"kits", "kit tactape-s008: cpl places"} <= set(wrong)
    assert not any(name.startswith("tape ") for name in wrong)


@pytest.mark.parametrize(
    "content", ["{}", "[]", '{"format": "tactape-panel/1"}', '{"format": "tactape-panel/1", "tapes": 7, "panel": []}']
)
def test_a_broken_manifest_is_a_clear_answer(content: str, panel_2: PanelKit, copied: Callable[[PanelKit], Path]) -> None:
    folder = copied(panel_2)
    (folder / "manifest.json").write_text(content)
    assert list(failed(verify_kit(folder, quick=True))) == ["manifest"]
    with pytest.raises(SpecError):
        read_tapes([folder])


@pytest.mark.parametrize("place", ["", "tapes/tactape-s008"])
def test_a_missing_table_of_a_manifest_is_named_once(place: str, panel_2: PanelKit, copied: Callable[[PanelKit], Path]) -> None:
    folder = copied(panel_2) / place
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({key: value for key, value in manifest.items() if key != "spec"}))
    (check,) = verify_kit(folder, quick=True).checks
    assert check.message == "spec is missing; give a table of that name"


@pytest.mark.parametrize("gone", ["tapes/tactape-s008/manifest.json", "gerber/panel.gtl", "assembly/panel-cpl.csv"])
def test_a_missing_file_is_named(gone: str, panel_2: PanelKit, copied: Callable[[PanelKit], Path]) -> None:
    folder = copied(panel_2)
    next(p for p in folder.glob(gone.replace("panel", "tactape-panel-s007"))).unlink()
    assert failed(verify_kit(folder, quick=True))


def test_a_kit_beyond_a_link_is_named(panel_2: PanelKit, copied: Callable[[PanelKit], Path], tmp_path: Path) -> None:
    folder, outside = copied(panel_2), tmp_path / "outside"
    kit = folder / panel_2.kits[0]
    shutil.move(kit, outside)
    kit.symlink_to(outside)
    lines = {check.name: check for check in verify_kit(folder, quick=True).checks}
    assert lines["kits"].message == f"{panel_2.kits[0]}/manifest.json leads out of the kit's folder"


def test_an_unlisted_file_is_a_warning(panel_2: PanelKit, copied: Callable[[PanelKit], Path]) -> None:
    folder = copied(panel_2)
    (folder / "tapes" / "notes.txt").write_text("mine")
    (line,) = [check for check in verify_kit(folder, quick=True).checks if check.name == "unlisted"]
    assert line.warning
    assert "tapes/notes.txt" in line.message


# Its place


@slow
def test_overwrite_replaces_a_panel_that_is_wholly_ours(panel_2: PanelKit, copied: Callable[[PanelKit], Path]) -> None:
    folder = copied(panel_2)
    with pytest.raises(SpecError, match="exists already; use --overwrite"):
        panel_of(TWO, folder)
    make_panel(examined_panel({**TWO, "sector": 30}), folder, overwrite=True)
    assert [tape.sector for tape in read_tapes([folder])] == [30, 31]
    (folder / "tapes" / "tactape-s030" / "notes.txt").write_text("mine")
    with pytest.raises(SpecError, match=r"holds tapes/tactape-s030/notes.txt, which its manifest does not list"):
        make_panel(examined_panel(TWO), folder, overwrite=True)
    assert (folder / "tapes" / "tactape-s030" / "notes.txt").read_text() == "mine"


def test_a_panel_that_fails_its_verification_never_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    failing = Verification(name="panel", checks=(Check(name="profile", passed=False, message="wrong"),))
    monkeypatch.setattr("tactape_fab.verify.panel.verify_panel_folder", lambda *_, **__: failing)
    with pytest.raises(VerifyError):
        panel_of(TWO, tmp_path / "deep" / "panel")
    assert list(tmp_path.iterdir()) == []


@slow
def test_broken_rules_are_forced_aloud(tmp_path: Path) -> None:
    examined = examined_panel({**TWO, "pitch_mm": 1.3, "coverlay": "per-part"})
    with pytest.raises(DesignRuleError):
        make_panel(examined, tmp_path / "panel", verify=False)
    made = make_panel(examined, tmp_path / "panel", force=True)
    assert {row["rule"] for row in manifest_of(made)["forced"]} >= {"opening-bridge"}
    assert "FORCED" in (made.path / made.files["order-notes"]).read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_interrupted_make_leaves_no_half_a_panel(kind: signal.Signals, tmp_path: Path) -> None:
    command = ["make", "--sector", "7", "--panel", "auto", "--size", "60x30", "--no-3d", "-o", "deep/panel"]
    run = subprocess.Popen([sys.executable, "-m", "tactape_fab", *command], cwd=tmp_path, stderr=subprocess.DEVNULL)
    while run.poll() is None and not list(tmp_path.glob("deep/.panel.*/tapes/tactape-s008")):
        time.sleep(0.005)
    run.send_signal(kind)
    assert run.wait(timeout=60) != 0
    left = [path.name for path in tmp_path.glob("deep/*")]
    assert "panel" not in left
    if kind == signal.SIGKILL:  # nobody can clean up, but what is left is never taken for a panel
        assert [name.endswith(".partial") for name in left] == [True]
        with pytest.raises(SpecError):
            verify_kit(tmp_path / "deep" / left[0])
    else:
        assert list(tmp_path.iterdir()) == []


# Packed panels


def turned_row(opened: OpenKit) -> dict[str, Any]:
    return next(row for row in opened.manifest["tapes"] if row["rotation_deg"] == 90.0)


def of_turned(edit: Callable[[list[list[str]], int], None]) -> Callable[[OpenKit], None]:
    """Edit the placement list at the first part of the first turned tape."""

    def edited(opened: OpenKit) -> None:
        number = int(turned_row(opened)["first_designator"][1:])
        rows("cpl", lambda table: edit(table, number))(opened)

    return edited


def near_places(opened: OpenKit) -> None:
    """Say, in both places, that a tape lies a millimetre nearer to its neighbour than slots allow."""
    panel, place = opened.manifest["panel"], opened.manifest["panel"]["places"][-1]
    assert len(panel["places"]) == len(opened.manifest["tapes"])
    place["offset_mm"][0] -= 3.0
    opened.manifest["tapes"][-1]["offset_mm"][0] -= 3.0


PACKED_MUTATIONS: dict[str, tuple[Callable[[OpenKit], object], str]] = {
    "a turned tape said to lie straight": (lambda k: turned_row(k).update(rotation_deg=0.0), "arrangement"),
    "both say that it lies straight": (
        lambda k: (
            [row.update(rotation_deg=0.0) for row in k.manifest["tapes"]],
            [place.update(turned=False) for place in k.manifest["panel"]["places"]],
        ),
        "arrangement|profile|tape .*",
    ),
    "a part of a turned tape not turned": (of_turned(lambda t, n: t[n].__setitem__(4, "45")), "tape .*: cpl rotation"),
    "a part of a turned tape moved": (of_turned(lambda t, n: t[n].__setitem__(1, "50.0000")), "tape .*: cpl places"),
    "the rotation in the component layer": (
        text_of("components-top", lambda t: t.replace("TO.CRot,135", "TO.CRot,45")),
        "tape .*",
    ),
    "a tape too near to another": (near_places, "arrangement|profile"),
    "another size": (lambda k: k.manifest["panel"]["places"][0]["size_mm"].__setitem__(0, 30.0), "arrangement"),
    "a tab less": (lambda k: k.manifest["panel"]["places"][0].update(tabs_x=0), "profile"),
    "a slot left out": (fill_slot, "profile"),
}


@pytest.mark.parametrize("name", PACKED_MUTATIONS)
def test_what_is_wrong_on_a_packed_panel_is_named(name: str, panel_packed: PanelKit, copied: Callable[[PanelKit], Path]) -> None:
    assert_named(PACKED_MUTATIONS[name], copied(panel_packed))


@slow
@pytest.mark.parametrize("name", ["panel_packed", "coupon_panel"])
def test_panels_of_tapes_that_differ_verify(name: str, request: pytest.FixtureRequest) -> None:
    made: PanelKit = request.getfixturevalue(name)
    assert not failed(verify_panel_folder(made.path / "manifest.json", quick=True))


def test_a_packed_panel_has_turned_tapes(panel_packed: PanelKit) -> None:
    assert any(place.turned for place in panel_packed.panel.places) and not all(p.turned for p in panel_packed.panel.places)
