"""KiCad opens the boards that are written, sees the CPL's parts in them, and its design-rule check finds nothing."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.kit.profiles import load_fab, profile_names
from tests.conftest import _missing

ANCHORED: dict[str, Any] = {"pitch_mm": 2.0, "size_mm": (40.0, 30.0), "holes_mm": [(20.0, 15.0, 2.0)]}
SPECS = {
    **{fab: TapeSpec(sector=7, fab=fab, size_mm=(100.0, 50.0), models=False) for fab in profile_names("fabs")},
    **{anchor: TapeSpec(sector=7, anchor=anchor, models=False, **ANCHORED) for anchor in ("spur", "mesh")},
}


@pytest.fixture(scope="module")
def python_of_kicad() -> str:
    """The interpreter that can import pcbnew."""
    python = "/usr/bin/python3"
    if (
        shutil.which(python) is None
        or subprocess.run([python, "-c", "import pcbnew"], capture_output=True, check=False).returncode
    ):
        _missing("pcbnew", "install Debian's kicad")
    return python


@pytest.fixture(scope="module")
def kits(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> dict[str, Kit]:
    """Those that are asked for."""
    folder = tmp_path_factory.mktemp("kicad")
    cases = [getattr(item, "callspec", None) for item in request.session.items if item.path == request.path]
    asked = {"generic-fpc", *(case.params["name"] for case in cases if case is not None)}
    return {name: make_kit(spec, folder / name, verify=False) for name, spec in SPECS.items() if name in asked}


@pytest.fixture(scope="module")
def seen(python_of_kicad: str, kits: dict[str, Kit], tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """What KiCad says of each board, and of one whose limits were raised."""
    folder = tmp_path_factory.mktemp("opened")  # KiCad writes beside what it opens
    paths = {name: str(_copy(kit, folder / name)) for name, kit in kits.items()}
    raised = _copy(kits["generic-fpc"], folder / "raised")
    project = raised.with_suffix(".kicad_pro")
    rules = json.loads(project.read_bytes())
    rules["board"]["design_settings"]["rules"].update(min_clearance=0.5, min_copper_edge_clearance=5.0)
    project.write_text(json.dumps(rules))
    paths["raised"] = str(raised)
    script = Path(__file__).parent / "kicad_board.py"
    run = subprocess.run(
        [python_of_kicad, script], input=json.dumps(list(paths.values())), capture_output=True, encoding="utf-8", check=False
    )
    assert run.returncode == 0, run.stderr[-2000:]
    found = json.loads(run.stdout[run.stdout.index("{") :])
    return {name: found[path] for name, path in paths.items()}


def _copy(kit: Kit, folder: Path) -> Path:
    shutil.copytree(kit.path / "kicad", folder)
    return next(folder.glob("*.kicad_pcb"))


@pytest.mark.parametrize("name", SPECS)
def test_kicad_finds_nothing_wrong(name: str, seen: dict[str, dict[str, Any]], kits: dict[str, Kit]) -> None:
    assert (seen[name]["violations"], seen[name]["unconnected"]) == ([], [0])
    limits = load_fab(SPECS[name].fab or "generic-fpc").limits
    assert (seen[name]["clearance_mm"], seen[name]["edge_mm"]) == (limits["pad-pad"].value_mm, limits["pad-edge"].value_mm)
    assert seen[name]["size_mm"] == pytest.approx(np.array(kits[name].tape.board.size_mm) + 0.05, abs=1e-6)  # with its line
    assert seen[name]["origin_mm"] == pytest.approx([-0.025, -0.025], abs=1e-6)


def test_kicad_finds_what_breaks_its_rules(seen: dict[str, dict[str, Any]]) -> None:
    assert {"clearance", "copper_edge_clearance"} <= set(seen["raised"]["violations"])


@pytest.mark.parametrize("name", SPECS)
def test_kicad_sees_the_parts_of_the_cpl(name: str, seen: dict[str, dict[str, Any]], kits: dict[str, Kit]) -> None:
    kit = kits[name]
    with (kit.path / kit.files["cpl"]).open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    parts = {name: place for name, place in seen[name]["parts"].items() if name.startswith("R")}
    assert list(parts) == [row["Designator"] for row in rows]
    at_mm = np.array([[float(row["Mid X"]), float(row["Mid Y"]), float(row["Rotation"])] for row in rows])
    assert np.abs(np.array(list(parts.values())) - at_mm).max() < 1e-4  # the CPL has four decimals
    first, second = (np.array([seen[name]["lands"][f"{part}.{pin}"] for part in parts]) for pin in "12")
    turn = np.deg2rad(kit.tape.part.rotation_deg)
    assert np.abs(second - first - 0.64 * np.array([np.cos(turn), np.sin(turn)])).max() < 2e-6
