"""The readers as fixtures, and layouts from the specs of the kits that they read."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.kit.film.layout import Layout, build_layout
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import load_fab, load_part
from tests.conftest import _missing, _program
from tests.readers.pictures import Reader, gerbonara_svg, gerbv_picture, rasterised, tracespace_svg
from tests.readers.solids import NAMES, Variant, write_variant


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A written kit and the layout of the same spec, which was never a file."""

    kit: Kit
    layout: Layout

    def path(self, role: str) -> Path:
        return self.kit.path / self.kit.files[role]


def layout_of(spec: TapeSpec) -> Layout:
    fab, part = load_fab(spec.fab or "generic-fpc"), load_part(spec.part)
    return build_layout(plan(spec, fab, part), spec, fab, part)


@pytest.fixture(scope="session")
def tape_100x50(default_kit: Kit) -> Sample:
    """The main job's tape."""
    return Sample(kit=default_kit, layout=layout_of(TapeSpec(sector=7)))


@pytest.fixture(scope="session")
def tape_6x4(tmp_path_factory: pytest.TempPathFactory) -> Sample:
    """A tape of 6 x 4 parts with tag, text, arrow and holes of two diameters."""
    holes_mm = [(9.0, 10.5, 0.9), (17.0, 6.5, 2.0), (25.123, 10.4567, 0.9)]
    spec = TapeSpec(sector=100, pitch_mm=4.0, displacement_mm=0.5, size_mm=(30.0, 17.0), holes_mm=holes_mm, name="t1")
    sample = Sample(kit=make_kit(spec, tmp_path_factory.mktemp("6x4") / "t1"), layout=layout_of(spec))
    assert (sample.kit.tape.columns, sample.kit.tape.rows, len(sample.kit.tape.omitted)) == (6, 4, 0)
    return sample


@pytest.fixture(params=["gerbonara", "gerbv", "gerber-to-svg"])
def reader(request: pytest.FixtureRequest, tmp_path: Path) -> Reader:
    """Each of the readers that draw a whole tape in no time."""
    folder = tmp_path / "reader"
    folder.mkdir()
    if request.param == "gerbv":
        gerbv: str = request.getfixturevalue("gerbv")
        return Reader(draw=lambda path, window: gerbv_picture(gerbv, path, window, folder), least_iou=0.93, antialiased=False)
    rsvg: str = request.getfixturevalue("rsvg_convert")
    if request.param == "gerbonara":
        return Reader(draw=lambda path, window: rasterised(rsvg, gerbonara_svg(path, window), window, folder), least_iou=0.98)
    find: Callable[[str], str] = request.getfixturevalue("node_module")
    node = find("gerber-to-svg")
    return Reader(draw=lambda path, window: rasterised(rsvg, tracespace_svg(node, path, window), window, folder), least_iou=0.98)


@pytest.fixture(scope="session")
def solid_variants(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Variant]:
    """Every kind of solid that a test of this run asks for, written once; not to be changed."""
    folder = tmp_path_factory.mktemp("solids")
    asked = {str(call.params.get("name")) for item in request.session.items if (call := getattr(item, "callspec", None))}
    return {name: write_variant(name, folder) for name in NAMES if name in asked}


@pytest.fixture(scope="session")
def freecad() -> str:
    """Path of FreeCAD without a window."""
    return _program("FreeCAD", "install Debian's freecad-python3", "freecadcmd", "FreeCADCmd")


@pytest.fixture(scope="session")
def prusa_slicer() -> str:
    """Path of PrusaSlicer."""
    return _program("PrusaSlicer", "install Debian's prusa-slicer", "prusa-slicer")


@pytest.fixture(scope="session")
def kicad_python() -> str:
    """A Python that has KiCad's pcbnew: the system's, which is not the one that runs the tests."""
    for found in filter(None, ("/usr/bin/python3", shutil.which("python3"))):
        run = subprocess.run(
            [found, "-c", "import pcbnew"], capture_output=True, check=False, env={**os.environ, "PYTHONPATH": ""}
        )
        if run.returncode == 0:
            return found
    _missing("KiCad's pcbnew", "install Debian's kicad")
    return ""


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Debian's chromium without a window, driven by playwright; nothing is ever downloaded."""
    program = _program("chromium", "install Debian's chromium", "chromium", "chromium-browser", "google-chrome")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        _missing("playwright", "pip install playwright")
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield running
        running.close()
