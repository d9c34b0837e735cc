"""A panel's report shows the panel, leads to the reports of its tapes, and lists its files."""

from __future__ import annotations

import hashlib
import json
from base64 import b64encode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.make.panel import PanelKit
from tactape_fab.report import REPORT_NAME, WrittenPanel, render_panel_report
from tactape_fab.report.page import PANEL_READ_ROLES
from tactape_fab.texture.shapes import rotate
from tactape_fab.verify.panel import verify_panel_folder
from tests.panels import copied_panel
from tests.reports import Page, unpacked


@pytest.fixture(scope="module")
def panel(panel_2: PanelKit) -> WrittenPanel:
    manifest = json.loads((panel_2.path / "manifest.json").read_text())
    rows = [row for row in manifest["files"] if row["role"] != "report"]
    files = {row["role"]: (panel_2.path / row["path"]).read_bytes() for row in rows if row["role"] in PANEL_READ_ROLES}
    return WrittenPanel(manifest={**manifest, "files": rows}, tapes=panel_2.tapes, files=files)


def test_every_tape_has_a_link_to_its_own_report_and_every_file_one(panel_2: PanelKit) -> None:
    page = Page((panel_2.path / REPORT_NAME).read_bytes())
    links = [str(given["href"]) for tag, given in page.tags if tag == "a" and not str(given["href"]).startswith("#")]
    own = [path for role, path in panel_2.files.items() if role != "report"]
    assert sorted(links) == sorted([*own, *(f"{kit}/{REPORT_NAME}" for kit in panel_2.kits)])
    assert all((panel_2.path / link).is_file() for link in links)


def test_it_says_which_tape_is_where(panel_2: PanelKit) -> None:
    text = " ".join(Page((panel_2.path / REPORT_NAME).read_bytes()).text.split())
    first = 1
    for tape, (x, y) in zip(panel_2.tapes, panel_2.panel.offsets_mm, strict=True):
        last = first + tape.part_count - 1
        assert f"{tape.name} {tape.sector} {tape.part_count} R{first} to R{last} {x:g}, {y:g}" in text
        first = last + 1
    assert f"{first - 1} fab" in text and panel_2.findings[0].rule in text
    assert text.count("checks of the written files") == 1 and "arrangement" in text


def test_it_lists_what_the_manifest_does_and_its_verification_reads_that(panel_2: PanelKit, tmp_path: Path) -> None:
    folder = copied_panel(panel_2, tmp_path)
    manifest = json.loads((folder / "manifest.json").read_text())
    page = Page((folder / REPORT_NAME).read_bytes())
    assert page.data["files"] == [row for row in manifest["files"] if row["role"] != "report"]
    for row in manifest["files"]:
        if row["role"] == "bom":
            row["sha256"] = "0" * 64
    (folder / "manifest.json").write_text(json.dumps(manifest))
    checks = verify_panel_folder(folder / "manifest.json", quick=True, kits=False).checks
    (report,) = [check for check in checks if check.name == "report"]
    assert not report.passed and "-bom.csv" in report.message


def test_a_panel_without_a_report_is_whole(panel_2: PanelKit, tmp_path: Path) -> None:
    folder = copied_panel(panel_2, tmp_path)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"] = [row for row in manifest["files"] if row["role"] != "report"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / REPORT_NAME).unlink()
    assert verify_panel_folder(folder / "manifest.json", quick=True, kits=False).passed


def test_nothing_in_a_panel_becomes_markup(panel: WrittenPanel) -> None:
    hostile = "</script><script>alert(1)</script><img src=x onerror=alert(1)>"
    tapes = [{**tape, "name": hostile} for tape in panel.manifest["tapes"]]
    worst = replace(
        panel,
        manifest={**panel.manifest, "name": hostile, "tapes": tapes},
        files={**panel.files, "order-notes": hostile.encode()},
    )
    page = Page(render_panel_report(worst).data)
    assert [given.get("type") for given, _ in page.scripts] == ["application/json", None]
    assert [str(of["src"]).partition(",")[0] for tag, of in page.tags if tag == "img"] == ["data:image/svg+xml;base64"]
    assert page.data["name"] == hostile
    digest = b64encode(hashlib.sha256(page.script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page.policy and page.policy.startswith("default-src 'none'")


def test_every_part_of_the_panel_is_on_the_map_with_its_tape_and_grid_point(panel: WrittenPanel, panel_2: PanelKit) -> None:
    data = Page(render_panel_report(panel).data).data
    places, total = data["places"], sum(tape.part_count for tape in panel_2.tapes)
    assert places["designators"].split("\n") == [f"R{k}" for k in range(1, total + 1)]
    cells, xy_mm = unpacked(places["cells"], "<i4", total, 2), unpacked(places["xy_mm"], "<f8", total, 2)
    owner, symbols = unpacked(places["tapes"], "<u2", total), unpacked(places["symbols"], "u1", total)
    assert data["tapes"] == [{"name": t.name, "origin": list(t.origin), "turned": False} for t in panel_2.tapes]
    for k, (tape, row) in enumerate(zip(panel_2.tapes, panel.manifest["tapes"], strict=True)):
        assert np.array_equal(cells[owner == k], tape.cells())
        assert np.array_equal(symbols[owner == k], tape.symbols[tape.cells()[:, 1], tape.cells()[:, 0]])
        assert np.abs(xy_mm[owner == k] - tape.part_xy_mm() - row["offset_mm"]).max() < 1e-4
    assert {"copper-top", "drill-npth", "bodies"} <= {layer["id"] for layer in data["layers"]}


def test_a_tape_that_is_turned_on_the_panel_keeps_its_grid_points(panel: WrittenPanel, panel_2: PanelKit) -> None:
    """The first tape alone, a quarter turn counter-clockwise: its places are turned with it."""
    first, tape = panel.manifest["tapes"][0], panel_2.tapes[0]
    cpl = read_cpl(panel.files["cpl"])
    turned = rotate(tape.part_xy_mm(), 90.0) + np.array([50.0, 3.0])
    text = panel.files["cpl"].decode().splitlines()[: tape.part_count + 1]
    rows = [f"{name},{x:.4f},{y:.4f},Top,135" for name, (x, y) in zip(cpl.designators, turned.tolist(), strict=False)]
    manifest = {**panel.manifest, "tapes": [{**first, "offset_mm": [50.0, 3.0], "rotation_deg": 90.0}]}
    files = {**panel.files, "cpl": "\r\n".join([text[0], *rows, ""]).encode()}
    page = Page(render_panel_report(replace(panel, manifest=manifest, tapes=[tape], files=files)).data)
    assert np.array_equal(unpacked(page.data["places"]["cells"], "<i4", -1, 2), tape.cells())
    # on the panel that corner is the lower right one
    assert "its lower left corner at x, y mm" in page.text and "50, 3, turned by 90° round it" in page.text
    assert page.data["tapes"][0]["turned"] is True


def test_the_same_panel_gives_the_same_bytes(panel: WrittenPanel) -> None:
    assert render_panel_report(panel).data == render_panel_report(panel).data
    assert b"not verified when it was made" in render_panel_report(panel).data
