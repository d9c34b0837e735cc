"""The report shows what the written files hold: numbers equal to the tape's, files that were changed as they are."""

from __future__ import annotations

import hashlib
import json
import shutil
from base64 import b64encode
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.base.errors import Check, Finding
from tactape_fab.base.fields import Fields
from tactape_fab.base.plain_text import one_line
from tactape_fab.kit.profiles.assembly import FORMATS
from tactape_fab.make.emboss import emboss_kit
from tactape_fab.report import REPORT_NAME, Written, render_report
from tactape_fab.report.bom_summary import bom_lines
from tactape_fab.report.page import report_data
from tactape_fab.report.solid_view import MOST_TRIANGLES, solid_view
from tactape_fab.solids.mesh.stl import read_stl, stl_corners
from tactape_fab.texture.frames import LETTERS
from tactape_fab.texture.tape import Tape
from tactape_fab.verify import verify_kit
from tests.reports import Page, unpacked, written
from tests.thorough import as_elsewhere, thorough

VALUES: dict[str, Any] = {"sector": 100, "size_mm": (20.0, 20.0), "holes_mm": [(16.4, 10.0, 1.0)], "models": False}
HOSTILE = "</script><script>document.title = 'hacked'</script><img src=x onerror=alert(1)> & \"'{{ 7 * 7 }}\u2028"


def spec(**values: Any) -> TapeSpec:
    """The small tape of the kits that all tests share, otherwise in some ways."""
    return TapeSpec(**{**VALUES, **values})


@pytest.fixture(scope="module")
def film() -> Written:
    return written(spec())


@pytest.fixture(scope="module")
def page(film: Written) -> Page:
    return Page(render_report(film).data)


def places_of(data: dict[str, Any]) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    places = data["places"]
    names = places["designators"].split("\n")
    n = len(names)
    cells, symbols = unpacked(places["cells"], "<i4", n, 2), unpacked(places["symbols"], "u1", n)
    return names, unpacked(places["xy_mm"], "<f8", n, 2), cells, symbols


def shapes_of(data: dict[str, Any], layer: str) -> list[dict[str, Any]]:
    return [shape for shape in data["shapes"] if shape["layer"] == layer]


def flashes(shape: dict[str, Any]) -> int:
    """How many outlines of a shape stand at places of their own."""
    return sum(len(unpacked(stamp["xy"], "<f4", -1, 2)) for stamp in shape["stamps"] if stamp["xy"] is not None)


def polygons(paths: dict[str, str]) -> list[shapely.Polygon]:
    points, ends = unpacked(paths["points"], "<f4", -1, 2), unpacked(paths["ends"], "<u4", -1)
    return [shapely.Polygon(part) for part in np.split(points, ends[:-1])]


# The numbers


def test_parts_stand_where_the_tape_has_them(page: Page, film: Written) -> None:
    tape = film.tape
    names, xy_mm, cells, symbols = places_of(page.data)
    assert names == tape.designators()
    assert np.abs(xy_mm - tape.part_xy_mm()).max() <= 5e-5  # what four decimals of the CPL leave
    assert np.array_equal(cells, tape.cells())
    assert np.array_equal(symbols, tape.symbols[cells[:, 1], cells[:, 0]])
    assert page.data["letters"] == LETTERS[:4]
    data = page.data
    assert (data["origin"], data["grid"], data["pitch_mm"]) == (list(tape.origin), [tape.columns, tape.rows], tape.pitch_mm)
    assert data["texture_origin_mm"] == list(tape.board.texture_origin_mm)


def test_a_part_that_was_moved_in_the_cpl_is_shown_where_it_is(film: Written) -> None:
    """Drawn from the file: its symbol is the one that its place shows, not the manifest's."""
    tape = film.tape
    row = film.files["cpl"].decode().splitlines()[1]
    assert row.startswith("R1,")
    x, y = tape.board.texture_origin_mm
    files = {**film.files, "cpl": film.files["cpl"].replace(row.encode(), f"R1,{x + 0.25:.4f},{y:.4f},Top,45".encode())}
    names, xy_mm, cells, symbols = places_of(report_data(replace(film, files=files)))
    assert names[0] == "R1" and xy_mm[0].tolist() == pytest.approx([x + 0.25, y])
    assert cells[0].tolist() == [0, 0] and LETTERS[symbols[0]] == "E"
    assert LETTERS[tape.symbols[0, 0]] != "E"
    assert np.array_equal(symbols[1:], tape.symbols[tape.cells()[1:, 1], tape.cells()[1:, 0]])


def test_layers_hold_what_their_files_draw(page: Page, film: Written) -> None:
    data, parts = page.data, film.tape.part_count
    assert sum(flashes(shape) for shape in shapes_of(data, "copper-top")) == 2 * parts
    assert sum(flashes(shape) for shape in shapes_of(data, "paste-top")) == 2 * parts
    assert sum(flashes(shape) for shape in shapes_of(data, "coverlay-top")) == parts
    body, ends = shapes_of(data, "bodies")
    assert [stamp["xy"] for stamp in (*body["stamps"], *ends["stamps"])] == [None, None, None]  # at every part
    outline = shapely.Polygon(unpacked(body["stamps"][0]["outline"], "<f4", -1, 2))
    length, width, _ = film.tape.part.body_mm
    assert outline.area == pytest.approx(length * width, rel=1e-5)
    (board,) = polygons(shapes_of(data, "profile")[0]["polygons"])
    assert board.area == pytest.approx(20.0 * 20.0 - (4 - np.pi) * film.tape.board.corner_radius_mm**2, rel=1e-4)
    (hole,) = polygons(shapes_of(data, "drill-npth")[0]["polygons"])
    assert (hole.centroid.x, hole.centroid.y) == pytest.approx((16.4, 10.0), abs=1e-5)
    assert shapes_of(data, "drill-npth")[0]["fill"] == ""
    titles = {layer["id"]: layer["shown"] for layer in data["layers"]}
    assert list(titles) == ["profile", "coverlay-top", "copper-top", "paste-top", "legend-top", "bodies", "drill-npth"]
    assert [layer for layer, shown in titles.items() if not shown] == ["paste-top"]


VARIANTS = {
    "gang": (spec(coverlay="gang"), {"coverlay-top"}),
    "mesh": (spec(pitch_mm=1.9, holes_mm=(), anchor="mesh"), {"copper-top"}),
    "laminated": (spec(stiffener="FR4:0.2", adhesive="3M468:0.13"), {"stiffener-bottom", "adhesive-bottom"}),
    "no strip": (spec(tag="none"), {"bodies"}),
    "kicad list": (spec(assembly="kicad"), {"bodies"}),
    "black ink": (spec(fab="generic-fr4"), {"legend-top"}),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_every_kind_of_film_has_a_report(name: str) -> None:
    asked, layers = VARIANTS[name]
    kit = written(asked)
    data = Page(render_report(kit).data).data
    assert layers <= {layer["id"] for layer in data["layers"]}
    names, _, cells, _ = places_of(data)
    assert names == kit.tape.designators()
    assert np.array_equal(cells, kit.tape.cells())
    if name == "gang":
        (window,) = [shape for shape in shapes_of(data, "coverlay-top") if shape["polygons"]["ends"] and flashes(shape) == 0][1:]
        assert polygons(window["polygons"])[0].area > 50.0
    if name == "mesh":
        assert any(shape["lines"]["ends"] for shape in shapes_of(data, "copper-top"))
    if name == "no strip":
        assert "legend-top" not in {layer["id"] for layer in data["layers"]}


def test_a_kit_lists_and_hashes_every_other_file(small_kit: Kit) -> None:
    data = Page((small_kit.path / REPORT_NAME).read_bytes()).data
    manifest = json.loads((small_kit.path / "manifest.json").read_bytes())
    assert small_kit.files["report"] == REPORT_NAME
    assert data["files"] == [row for row in manifest["files"] if row["role"] != "report"]
    assert [row["path"] for row in manifest["files"]] == sorted(row["path"] for row in manifest["files"])
    for row in data["files"]:
        assert hashlib.sha256((small_kit.path / row["path"]).read_bytes()).hexdigest() == row["sha256"]


def test_the_page_says_how_the_kit_was_verified(small_kit: Kit) -> None:
    shown = Page((small_kit.path / REPORT_NAME).read_bytes())
    text = " ".join(shown.text.split())
    assert f"ok {len(small_kit.checks)} checks of the written files" in text
    for check in small_kit.checks:
        assert f"{check.name} ✓ ok {check.message}" in text
    for finding in small_kit.findings:
        assert f"{finding.rule} {'✓ ok' if finding.passed else '! note'}" in text
    notes = (small_kit.path / small_kit.files["order-notes"]).read_text(encoding="utf-8")
    assert " ".join(notes.split()) in text
    certificate = json.loads((small_kit.path / small_kit.files["certificate"]).read_bytes())
    assert shown.data["contact"] == certificate["smallest_contact"]
    for size in certificate["windows"]:
        assert f"{size['side']} x {size['side']} {size['count']}" in text
    links = [str(given["href"]) for tag, given in shown.tags if tag == "a" and not str(given["href"]).startswith("#")]
    assert sorted(links) == sorted(path for role, path in small_kit.files.items() if role != "report")


def test_a_kit_that_was_not_verified_or_forced_says_so(tmp_path: Path) -> None:
    kit = make_kit(spec(pitch_mm=1.3, displacement_mm=0.3, holes_mm=()), tmp_path / "forced", verify=False, force=True)
    text = " ".join(Page((kit.path / REPORT_NAME).read_bytes()).text.split())
    assert "not verified when it was made" in text and "made with --no-verify" in text
    broken = [f.rule for f in kit.findings if f.blocks]
    assert broken
    assert f"made in spite of {len(broken)} broken design rule{'s' * (len(broken) > 1)}: {', '.join(broken)}" in text
    assert f"{broken[0]} ✗ broken" in text


def test_the_same_kit_gives_the_same_bytes(film: Written, small_kit: Kit, tmp_path: Path) -> None:
    assert render_report(film).data == render_report(written(spec())).data
    with as_elsewhere():
        again = make_kit(spec(models=True), tmp_path / "again")
    assert (again.path / REPORT_NAME).read_bytes() == (small_kit.path / REPORT_NAME).read_bytes()


# Solids


def corners_of(view: dict[str, Any]) -> np.ndarray:
    vertices = unpacked(view["vertices"], "<u2", -1, 3)
    kind = "<u4" if len(vertices) > 0xFFFF else "<u2"
    steps = vertices[unpacked(view["faces"], kind, -1, 3)]
    return np.asarray(np.array(view["low_mm"]) + steps * np.array(view["step_mm"]))


def test_the_shaded_view_is_the_written_mesh(small_kit: Kit) -> None:
    data = (small_kit.path / small_kit.files["stl"]).read_bytes()
    view = Page((small_kit.path / REPORT_NAME).read_bytes()).data["solid"]
    corners = stl_corners(data)
    assert (view["shown"], view["total"]) == (len(corners), len(corners))
    assert np.abs(corners_of(view) - corners).max() <= 0.51 * max(view["step_mm"]) + 1e-6
    assert max(view["step_mm"]) < 0.001
    mesh = read_stl(data)
    assert np.array_equal(mesh.corners_mm.astype(np.float32), corners)


def test_of_a_large_mesh_a_connected_piece_is_shown() -> None:
    kit = written(TapeSpec(sector=9, size_mm=(60.0, 40.0), part="dome", process="sla"))
    data = kit.files["stl"]
    total = len(stl_corners(data))
    assert total > MOST_TRIANGLES
    view = solid_view(data)
    assert (view["shown"], view["total"]) == (MOST_TRIANGLES, total)
    corners = corners_of(view)
    middle = np.abs(corners[:, 0, :2] - (30.0, 20.0)).max(axis=1)
    assert np.sort(middle)[-MOST_TRIANGLES // 10] < 17.5  # round the middle of the board, on top; chords of 0.015 mm
    moved = solid_view(data, (0.0, 0.0, 0.0))
    assert corners_of(moved)[:, 0, :2].min() == pytest.approx(0.0, abs=0.01)
    assert np.median(corners_of(moved)[:, 0, :2]) < np.median(corners[:, 0, :2])


@pytest.mark.parametrize("cylinder_mm", [None, thorough(20.0)])
def test_a_printed_kit_has_a_report(cylinder_mm: float | None, tmp_path: Path) -> None:
    printed = TapeSpec(sector=9, size_mm=(30.0, 20.0), part="dome", process="sla", cylinder_mm=cylinder_mm)
    kit = make_kit(printed, tmp_path / "printed")
    shown = Page((kit.path / REPORT_NAME).read_bytes())
    names, xy_mm, cells, _ = places_of(shown.data)
    assert names == kit.tape.designators()
    assert np.array_equal(xy_mm, kit.tape.part_xy_mm()) and np.array_equal(cells, kit.tape.cells())
    assert {layer["id"] for layer in shown.data["layers"]} == {"profile", "bodies"}
    picture = b64encode((kit.path / kit.files["preview-png"]).read_bytes()).decode()
    assert [given["src"] for tag, given in shown.tags if tag == "img"] == [f"data:image/png;base64,{picture}"]
    assert "Bill of materials" not in shown.text and "Order notes" not in shown.text
    assert verify_kit(kit.path, quick=True).passed


def test_an_embossed_part_has_a_report(tmp_path: Path) -> None:
    import trimesh

    kit = make_kit(TapeSpec(sector=9, size_mm=(12.0, 12.0), part="dome", process="sla"), tmp_path / "kit", verify=False)
    trimesh.creation.box((30.0, 30.0, 10.0)).export(tmp_path / "box.stl")
    made = emboss_kit(kit.path, tmp_path / "box.stl", tmp_path / "part")
    shown = Page((made.path / made.files["report"]).read_bytes())
    on_part = unpacked(shown.data["places"]["model_mm"], "<f8", -1, 3)
    rows = (made.path / made.files["placements"]).read_text().splitlines()[1:]
    assert np.array_equal(on_part, [[float(v) for v in row.split(",")[3:6]] for row in rows])
    view = shown.data["solid"]["texture"]
    assert view["normal"] == pytest.approx([0.0, 0.0, 1.0]) and view["middle_mm"][2] == pytest.approx(5.0)
    assert shown.text.index("Drag or arrow keys turn it") < shown.text.index("The texture unrolled")
    assert "Measured places" not in shown.text
    assert "box.stl, round (0.000, 0.000, 5.000) mm" in shown.text
    verification = verify_kit(made.path, quick=True)
    assert verification.passed and "report" in [check.name for check in verification.checks]


def test_rows_of_one_part_are_one_row_of_the_list() -> None:
    manifest = {"assembly": {"format": "pcbway"}}
    head = list(FORMATS["pcbway"].bom.headers)
    lines = [["1", "R1,R2", "2", "", "X", "0R", "R", "SMD", ""], ["2", "R3", "1", "", "X", "0R", "R", "SMD", ""]]
    other = ["3", "R4", "1", "", "Y", "0R", "R", "SMD", ""]
    data = "\r\n".join(",".join(f'"{cell}"' for cell in row) for row in [head, *lines, other]).encode()
    assert bom_lines(data, manifest) == [head, ["1", "R1,R2,R3", "3", "", "X", "0R", "R", "SMD", ""], other]


def test_counts_are_whole_numbers_and_the_list_has_a_row_for_each_part(small_kit: Kit) -> None:
    text = " ".join(Page((small_kit.path / REPORT_NAME).read_bytes()).text.split())
    count = next(f for f in small_kit.findings if f.rule == "part-count")
    assert f"part-count ✓ ok {count.value:.0f} " in text
    assert f"R1 … R{small_kit.tape.part_count}" in text or small_kit.tape.part_count < 30


# The page is data, whatever stands in the files


def test_nothing_in_a_file_becomes_markup_or_script(film: Written, page: Page) -> None:
    rows = [{**row, "role": HOSTILE} if row["role"] == "job" else row for row in film.manifest["files"]]
    hostile = replace(
        film,
        manifest={**film.manifest, "files": rows, "tool": {"name": HOSTILE, "version": "0"}},
        files={**film.files, "order-notes": HOSTILE.encode(), "bom": f'"{HOSTILE.replace(chr(34), chr(34) * 2)}",b\r\n'.encode()},
        checks=[Check(name=HOSTILE, passed=False, message=HOSTILE)],
        findings=[Finding(rule=HOSTILE, level="block", passed=False, message=HOSTILE, source=HOSTILE)],
    )
    shown = Page(render_report(hostile).data)
    assert "\u2028" not in shown.text  # nor a mark of writing direction, which turns what a browser shows of a line
    assert [tag for tag, _ in shown.tags if tag in ("script", "img")] == ["img", "script", "script"]
    assert [str(of["src"]).partition(",")[0] for tag, of in shown.tags if tag == "img"] == ["data:image/svg+xml;base64"]
    assert shown.script == page.script
    assert shown.text.count(HOSTILE) + shown.text.count(one_line(HOSTILE)) >= 8  # checks say it in one line
    assert HOSTILE in [row["role"] for row in shown.data["files"]]
    assert {name for _, given in shown.tags for name in given if name.startswith("on")} == set()


def test_the_page_allows_its_own_script_and_style_and_nothing_else(page: Page) -> None:
    def digest(text: str) -> str:
        return f"'sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"

    assert page.policy.split("; ") == [
        "default-src 'none'",
        "img-src data:",
        f"script-src {digest(page.script)}",
        f"style-src {digest(page.styles[0])}",
        "base-uri 'none'",
        "form-action 'none'",
    ]
    assert not any(word in page.script for word in ("innerHTML", "eval(", "fetch(", "XMLHttpRequest", "http", "import("))
    given = [(name, value) for _, attributes in page.tags for name, value in attributes.items()]
    assert not [value for name, value in given if name in ("src", "href") and "//" in str(value)]
    assert "style" not in {name for name, _ in given}


# verify


def with_report(kit: Kit, tmp_path: Path, change: Any) -> list[Check]:
    """Lines that are not well after a consistent change of the report."""
    folder = Path(shutil.copytree(kit.path, tmp_path / "kit"))
    path = folder / REPORT_NAME
    path.write_bytes(change(path.read_bytes()))
    manifest = json.loads((folder / "manifest.json").read_bytes())
    for row in manifest["files"]:
        if row["role"] == "report":
            row["bytes"], row["sha256"] = len(path.read_bytes()), hashlib.sha256(path.read_bytes()).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return [check for check in verify_kit(folder, quick=True).checks if not check.passed]


def cpl_row(data: bytes) -> bytes:
    return data.replace(b'-cpl.csv","bytes":', b'-cpl.csv","bytes":1')


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda data: data.replace(b'{"name":"tactape-s100"', b'{"name":"tactape-s101"'), "another tape"),
        (cpl_row, "assembly/tactape-s100-cpl.csv"),
        (lambda data: data.replace(b'id="data">{', b'id="data">{{'), "cannot be read"),
        (lambda data: b"", "cannot be read"),
        (lambda data: data.replace(b'"name":', b'"nam":', 1), "cannot be read"),
    ],
)
def test_verify_refuses_the_report_of_another_kit(flat_kit: Kit, tmp_path: Path, change: Any, says: str) -> None:
    (wrong,) = with_report(flat_kit, tmp_path, change)
    assert wrong.name == "report" and says in wrong.message


def test_a_kit_without_a_report_is_whole_and_one_with_two_is_not(flat_kit: Kit, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(flat_kit.path, tmp_path / "kit"))
    manifest = json.loads((folder / "manifest.json").read_bytes())
    (row,) = [row for row in manifest["files"] if row["role"] == "report"]
    (folder / "second.html").write_bytes((folder / REPORT_NAME).read_bytes())
    twice = {**manifest, "files": [*manifest["files"], {**row, "path": "second.html"}]}
    (folder / "manifest.json").write_text(json.dumps(twice))
    assert [c.message for c in verify_kit(folder, quick=True).checks if c.name == "roles"] == ["the kit holds report 2 times"]
    without = {**manifest, "files": [r for r in manifest["files"] if r["role"] != "report"]}
    (folder / "manifest.json").write_text(json.dumps(without))
    for name in (REPORT_NAME, "second.html"):
        (folder / name).unlink()
    assert verify_kit(folder, quick=True).passed
    assert Tape.from_mapping(without).name == Fields(without).text("name")
