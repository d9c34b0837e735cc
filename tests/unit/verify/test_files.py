"""Files of a kit against its manifest: each read once, inside the folder, within its budget, and each role once."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import cv2
import numpy as np
import pytest

from tactape_fab import TapeSpec, make_kit, verify_kit
from tactape_fab.base.errors import Check
from tactape_fab.base.templates import templates_folder
from tactape_fab.base.version import __version__
from tactape_fab.kit.render.preview import MOST_PX
from tactape_fab.texture.as_built import Film
from tactape_fab.verify.budgets import MOST_FILES, WHOLE_KIT, most_bytes
from tactape_fab.verify.files import (
    _ATTRIBUTES,
    _TAGS,
    ALWAYS,
    EMBOSSED,
    LATER,
    SIM,
    WrittenFile,
    check_as_built,
    check_listed,
    check_picture,
    check_signature,
    kind_of,
    read_files,
    read_inside,
    roles_of,
)
from tactape_fab.verify.pictured import Pictured
from tests.measured import measured
from tests.tapes import tape_at

FILES = {"copper-top": ("fab/a.gbr", b"copper"), "cpl": ("cpl.csv", b"parts"), "job": ("fab/j.gbrjob", b"{}")}


def row(role: str, path: str, data: bytes) -> dict[str, Any]:
    return {"role": role, "path": path, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}


@pytest.fixture
def kit(tmp_path: Path) -> Path:
    folder = tmp_path / "kit"
    (folder / "fab").mkdir(parents=True)
    for path, data in FILES.values():
        (folder / path).write_bytes(data)
    (folder / "manifest.json").write_text("{}")
    return folder


def manifest(**changed: Any) -> dict[str, Any]:
    return {"files": [{**row(role, *file), **changed.get(role.replace("-", "_"), {})} for role, file in FILES.items()]}


def read(kit: Path, content: dict[str, Any], count: int = 9, **options: Any) -> tuple[dict[str, list[WrittenFile]], list[Check]]:
    return read_files(kit, content, count, **options)


def test_files_as_listed_are_read_by_role(kit: Path) -> None:
    files, checks = read(kit, manifest())
    assert files == {role: [WrittenFile(path=path, data=data)] for role, (path, data) in FILES.items()}
    assert [(c.name, c.passed, c.figure, c.message) for c in checks] == [
        ("files", True, 3.0, "3 files, sizes and SHA-256 as listed")
    ]


def test_other_bytes_sizes_or_digests_are_named(kit: Path) -> None:
    (kit / "cpl.csv").write_bytes(b"PARTS")
    files, (check,) = read(kit, manifest())
    assert not check.passed and check.message == "cpl.csv is not the file that was written: its SHA-256 differs"
    assert files["cpl"][0].data == b"PARTS"
    (kit / "cpl.csv").write_bytes(b"parts")
    for wrong in ({"bytes": 6}, {"bytes": None}, {"sha256": "0" * 64}, {"sha256": None}):
        assert not read(kit, manifest(cpl=wrong))[1][0].passed
    size = read(kit, manifest(cpl={"bytes": 6}))[1][0]
    assert size.message == "cpl.csv has 5 bytes and the SHA-256 as listed, but the manifest lists 6 bytes"


def test_files_that_are_missing_or_elsewhere_are_named(kit: Path) -> None:
    outside = kit.parent / "outside"
    outside.write_bytes(b"parts")
    for path, said in (
        ("../outside", "names no file inside the kit"),
        (str(outside), "names no file inside the kit"),
        (7, "names no file inside the kit"),
        ("none.csv", "none.csv is missing"),
        ("fab", "fab is missing"),
    ):
        files, checks = read(kit, manifest(cpl={"path": path}))
        assert not checks[0].passed and said in checks[0].message and "cpl" not in files
    (kit / "cpl.csv").unlink()
    (kit / "cpl.csv").symlink_to(outside)
    files, checks = read(kit, manifest())
    assert "cpl.csv leads out of the kit's folder" in checks[0].message and "cpl" not in files
    (kit / "cpl.csv").unlink()
    (kit / "cpl.csv").symlink_to("cpl.csv")
    assert not read(kit, manifest())[1][0].passed
    assert not read(kit, {"files": [*manifest()["files"], "cpl.csv"]})[1][0].passed


def test_a_manifest_lists_some_files_and_not_too_many(kit: Path) -> None:
    nothing: tuple[object, ...] = (None, [], {}, "cpl.csv")
    for rows in nothing:
        files, (check,) = read(kit, {"files": rows})
        assert (files, check.passed, check.message) == ({}, False, "the manifest lists no files")
    one = manifest()["files"][0]
    assert read(kit, {"files": [one] * MOST_FILES})[1][0].passed
    files, (check,) = read(kit, {"files": [one] * (MOST_FILES + 1)})
    assert not files and check.message == f"the manifest lists {MOST_FILES + 1} files, more than {MOST_FILES}"


def test_a_file_is_read_once_however_often_it_is_listed(kit: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    places: list[str] = []

    def reading(root: Path, place: Path, most: int) -> bytes:
        places.append(place.name)
        return read_inside(root, place, most)

    monkeypatch.setattr("tactape_fab.verify.files.read_inside", reading)
    content = {"files": [row("cpl", *FILES["cpl"]), row("bom", *FILES["cpl"]), row("job", "none", b""), row("job", "none", b"")]}
    files, checks = read(kit, content)
    assert places == ["cpl.csv", "none"]
    assert files["cpl"] == files["bom"] and checks[0].message == "none is missing"


def test_a_file_has_as_many_bytes_as_its_role_may_have(kit: Path) -> None:
    most = most_bytes("cpl", 9)
    for size, is_read in ((most, True), (most + 1, False)):
        with (kit / "cpl.csv").open("r+b") as stream:
            stream.truncate(size)
        files, (check,) = read(kit, manifest())
        assert ("cpl" in files) is is_read
        assert (f"cpl.csv has more than {most} bytes" in check.message) is not is_read


def test_all_files_together_have_a_budget_too(kit: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactape_fab.verify.files.most_bytes", lambda role, *_, **__: 12 if role == WHOLE_KIT else 9)
    files, (check,) = read(kit, manifest())
    assert set(files) == {"copper-top", "cpl"} and check.message.startswith("fab/j.gbrjob has more than 1 bytes")


def test_the_user_s_own_part_has_room_in_models_alone(kit: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def budget(role: str, count: int, *, embossed: bool) -> int:
        asked.append(embossed)
        return 99

    monkeypatch.setattr("tactape_fab.verify.files.most_bytes", budget)
    read(kit, manifest())
    assert not any(asked)
    asked.clear()
    read(kit, {**manifest(), "surface": {}})
    assert asked and all(asked)


def test_files_that_are_not_listed_are_a_warning(kit: Path) -> None:
    (kit / "as-built.json").write_text("{}")
    (kit / "manifest.json.sig").write_text("")
    assert len(read(kit, manifest())[1]) == 1
    (kit / "tape" / "one").mkdir(parents=True)
    (kit / "tape" / "one" / "b.txt").write_text("")
    (kit / "fab" / "notes.txt").write_text("")
    checks = read(kit, manifest())[1]
    assert [(c.name, c.passed, c.warning) for c in checks] == [("files", True, False), ("unlisted", False, True)]
    assert checks[1].message == "files that the manifest does not list: fab/notes.txt, tape/one/b.txt"
    assert read(kit, manifest(), kits=["tape/one/"])[1][1].message.endswith("list: fab/notes.txt")


# Roles

ONE = WrittenFile(path="a", data=b"")


def roles(files: dict[str, int], allowed: tuple[str, ...] = ()) -> tuple[list[str], Check]:
    found = {role: [ONE] * times for role, times in files.items()}
    single, missing, checks = check_listed({}, found, ["cpl", "bom"], allowed=allowed)
    assert single == {role: ONE for role, times in files.items() if times}
    assert [check.name for check in checks] == ["roles"] + ["sim"] * (SIM in files)
    return missing, checks[0]


@pytest.mark.parametrize(
    ("files", "missing", "said"),
    [
        ({"cpl": 1, "bom": 1}, [], None),
        ({"cpl": 1, "bom": 1, SIM: 3}, [], None),
        ({"cpl": 1, "bom": 1, LATER[0]: 1}, [], None),
        ({"cpl": 1, "bom": 1, LATER[0]: 2}, [], f"the kit holds {LATER[0]} 2 times"),
        ({"cpl": 1}, ["bom"], "the kit holds bom 0 times"),
        ({"cpl": 1, "bom": 2}, [], "the kit holds bom 2 times"),
        ({"cpl": 1, "bom": 1, "gift": 1}, [], "the kit holds gift, which this tape has no use for"),
    ],
)
def test_every_role_is_there_once(files: dict[str, int], missing: list[str], said: str | None) -> None:
    found, check = roles(files)
    assert (found, check.name, check.passed) == (missing, "roles", said is None)
    assert check.message == (said or "2 roles, one file each")


def test_roles_that_are_allowed_may_be_there() -> None:
    assert roles({"cpl": 1, "bom": 1, "gift": 1}, ("gift",))[1].passed
    assert roles({"cpl": 1, "bom": 1}, ("gift",))[1].passed
    assert not roles({"cpl": 1, "bom": 1, "gift": 2}, ("gift",))[1].passed


def test_a_kind_of_kit_has_its_roles() -> None:
    tape = tape_at(7, (6, 5))
    film = {*ALWAYS, "preview-svg", "preview-png", "certificate", "fab-zip"}
    models = {"step-solid", "stl", "3mf"}
    assert set(roles_of(tape, models=False)) == film
    assert set(roles_of(tape)) == {*film, *models, "step-assembly"}
    assert set(roles_of(tape, models=False, backings=["stiffener-bottom"])) == {*film, "stiffener-bottom"}
    drilled = replace(tape, board=replace(tape.board, holes=((1.0, 1.0, 0.5),)))
    assert set(roles_of(drilled, models=False)) == {*film, "drill-npth"}
    assert set(roles_of(tape, "texture")) == {*models, "preview-svg", "preview-png", "certificate"}
    assert roles_of(tape, "embossed") == EMBOSSED


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        ({"surface": {}, "land_pattern": {}}, "embossed"),
        ({"land_pattern": {}, "spec": {"fab": None}}, "film"),
        ({"spec": {"fab": "generic-fpc"}}, "film"),
        ({"spec": None}, "film"),
        ({}, "film"),
        ({"spec": {"fab": None}}, "texture"),
        ({"spec": {}}, "texture"),
    ],
)
def test_kinds_of_kits(content: dict[str, Any], kind: str) -> None:
    assert kind_of(content) == kind


# Signatures and pictures


@pytest.mark.parametrize("mark", [b"%", b"G04 #@! "])
def test_a_gerber_signature_is_of_all_before_it(mark: bytes) -> None:
    body = b"%FSLAX46Y46*%\nD10*\r\n"
    digest = hashlib.md5(b"%FSLAX46Y46*%D10*").hexdigest().encode()
    right = body + mark + b"TF.MD5," + digest + b"*%\nM02*\n"
    assert check_signature("cpl", right) is None
    assert check_signature("cpl", body) is None
    others = (right.replace(digest, other) for other in (digest[::-1], digest[1:], b"g" + digest[1:], b""))
    for wrong in (right.replace(b"D10", b"D11"), b"\nX" + right, *others):
        assert check_signature("cpl", wrong) == "cpl: its .MD5 signature does not fit its content"
    assert check_signature("cpl", right.replace(mark + b"TF", b"TF")) is None  # not at the beginning of a statement


SVG = b'<svg xmlns="http://www.w3.org/2000/svg" width="1"><g id="a1"><path d="M0 0Z" fill="#123"/></g><use href="#a1"/></svg>\n'


def png(width: int, height: int) -> bytes:
    done, data = cv2.imencode(".png", np.zeros((height, width, 3), np.uint8))
    assert done
    return bytes(data)


def pictured(svg: bytes = SVG, image: bytes = b"", placements: bytes | None = None) -> Check:
    files = {"preview-svg": svg, "preview-png": image or png(30, 20), **({"placement-preview": placements} if placements else {})}
    return check_picture({role: WrittenFile(path=role, data=data) for role, data in files.items()})


def test_previews_that_can_be_opened() -> None:
    assert pictured().passed and pictured().message.startswith("PNG 30 x 20 px and SVG;")
    assert pictured(placements=SVG).passed and not pictured(placements=SVG[:-8]).passed


def test_a_preview_of_another_tape_is_told_by_title_and_parts() -> None:
    uses = b"".join(b'<use href="#bodies-0" x="%.4f" y="%.4f"/>' % (x, -y) for x, y in ((1.5, 2.0), (3.0, 2.25)))
    svg = SVG.replace(b"<g", b"<title>a&amp;b</title>" + uses + b"<g")
    files = {"preview-svg": WrittenFile(path="a", data=svg), "preview-png": WrittenFile(path="b", data=png(30, 20))}
    xy_mm = np.array([(1.5, 2.0), (3.0, 2.25)])

    def parts(*index: int, up_mm: float = 0.0) -> Pictured:
        shown = xy_mm[list(index)] + up_mm
        return Pictured(size_mm=(11.0, 6.0), xy_mm=shown, rotation_deg=np.zeros(len(shown)), body_mm=(0.6, 0.3))

    assert check_picture(files, "a&b", parts(0, 1)).passed and check_picture(files, "a&b").passed
    assert check_picture(files, "a&b", parts(1, 0)).passed
    assert check_picture(files, "b", parts(0, 1)).message == "the SVG is of 'a&amp;b'"
    assert check_picture(files, "a&b", parts(0)).message == "the SVG shows 2 parts, not 1"
    assert check_picture(files, "a&b", parts(0, 1, up_mm=-0.25)).message == "the SVG shows 2 parts in other places"
    files["preview-png"] = WrittenFile(path="b", data=png(30, 26))
    assert check_picture(files, "a&b", parts(0, 1)).message == "the PNG is not in the proportions of 11 x 6 mm"


def test_the_preview_of_another_sector_is_no_preview_of_this_tape(tmp_path: Path) -> None:
    made = [
        make_kit(TapeSpec(sector=s, name="t", size_mm=(30, 25), tag="none", models=False), tmp_path / str(s), verify=False)
        for s in (7, 8)
    ]
    preview = Path("preview", "t.svg")
    manifest = (made[0].path / "manifest.json").read_text()
    old, new = ((kit.path / preview).read_bytes() for kit in made)
    assert "previews" not in [line.name for line in verify_kit(made[0].path, quick=True).checks if not line.passed]
    (made[0].path / preview).write_bytes(new)
    manifest = manifest.replace(hashlib.sha256(old).hexdigest(), hashlib.sha256(new).hexdigest())
    manifest = manifest.replace(f'"bytes": {len(old)}', f'"bytes": {len(new)}')
    (made[0].path / "manifest.json").write_text(manifest)
    (line,) = [line for line in verify_kit(made[0].path, quick=True).checks if line.name == "previews"]
    assert not line.passed and "parts in other places" in line.message


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data[:-8],
        lambda data: b" " + data,
        lambda data: data.replace(b'href="#a1"', b'href="http://a"'),
        lambda data: data.replace(b'href="#a1"', b"href='#a1'"),
        lambda data: data.replace(b"#123", b"url(http://a)"),
        lambda data: data.replace(b"<g", b"<script>alert(1)</script><g"),
        lambda data: data.replace(b'id="a1"', b'onload="alert(1)"'),
        lambda data: data.replace(b"<path", b"<image"),
    ],
)
def test_a_drawing_that_runs_or_fetches_is_refused(change: Callable[[bytes], bytes]) -> None:
    found = pictured(change(SVG))
    assert not found.passed and found.message == "the SVG cannot be opened"


def test_a_drawing_is_read_in_time_whatever_its_names() -> None:
    start = process_time()
    assert pictured(SVG.replace(b"><path", b">" + b"(" * 100_000 + b"<path")).passed  # text, which a browser shows
    assert process_time() - start < 5.0


def test_a_drawing_may_hold_every_shape_and_attribute_of_this_tool() -> None:
    attributes = b" ".join(name + b'="1"' for name in sorted(_ATTRIBUTES - {b"href"})) + b' href="#a1"'
    shapes = b"".join(b"<%b %b></%b>" % (tag, attributes, tag) for tag in sorted(_TAGS - {b"svg"}))
    assert pictured(b"<svg " + attributes + b">" + shapes + b"</svg>").passed


def test_pictures_that_are_cut_or_too_large_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    good = png(30, 20)
    for data in (good[:-1], good[1:], good[:40], b"\x89PNG\r\n\x1a\n", good.replace(b"PNG", b"PNK")):
        assert pictured(image=data).message == "the PNG cannot be opened"
    assert MOST_PX < 20_000
    monkeypatch.setattr("tactape_fab.verify.files.MOST_PX", 30)
    assert pictured(image=png(30, 30)).passed
    assert not pictured(image=png(31, 30)).passed and not pictured(image=png(30, 31)).passed


# Measured places


def test_measured_places_beside_a_manifest_are_told_and_those_of_another_fail(tmp_path: Path) -> None:
    tape, file = tape_at(7, (8, 8)), tmp_path / "manifest.json"
    file.write_text("{}")
    assert check_as_built(file, tape) == (tape, [])
    built = measured(tape, 0.0, digest=hashlib.sha256(b"{}").hexdigest())[0].as_built
    assert built is not None
    off = {"dx_mm": np.full(64, 0.03), "dy_mm": np.where(np.arange(64) == 5, 0.0, 0.04), "present": np.arange(64) != 5}
    scan, aoi = {"kind": "scan"}, {"kind": "aoi"}
    for source, said in (((scan, aoi, scan), "scan, aoi"), ((), "a source that it does not name")):
        replace(built, **off, source=source).write(file.parent)
        found, (check,) = check_as_built(file, tape)
        assert found.as_built is not None and found.as_built.missing == 1
        assert (check.name, check.passed, check.unit) == ("as-built", True, "mm")
        assert check.figure == pytest.approx(0.05 / 2**0.5)
        assert check.message == (
            f"64 of 64 parts measured by {said}: 1 missing, the others 35.4 um off the design (rms per axis); on the mean "
            "50.0 um, by which they move every position; nothing in the kit vouches for them"
        )
    # a film that is 1 % longer along x moves positions, too, the most in the last column
    replace(built, **off, film=Film(scale=(1.01, 1.0))).write(file.parent)
    (check,) = check_as_built(file, tape)[1]
    most_um = 10.0 * tape.part_xy_mm()[:, 0].max()
    assert f"every position, and a stretch of the film that moves them by up to {most_um:.1f} um more; " in check.message
    replace(built, manifest_sha256="0" * 64).write(file.parent)
    found, (check,) = check_as_built(file, tape)
    assert found is tape and not check.passed
    assert check.message.startswith("as-built.json: ") and check.message.endswith("; or delete the file")
    (file.parent / "as-built.json").write_text('{"format": "tactape-as-built/1"}')
    said = check_as_built(file, tape)[1][0].message
    assert "tape is missing; give a text (and " in said and " more); or delete the file" in said and "\n" not in said


# Report

OWN = [line for line in (templates_folder() / "report" / "begin.js").read_text(encoding="utf-8").splitlines() if line][:3]
LISTED = [row("cpl", "cpl.csv", b"parts"), row("order-notes", "notes.txt", b"<use> 'FR4' & \"gold\"\n")]
NOTES = WrittenFile(path="notes.txt", data=b"<use> 'FR4' & \"gold\"\n")


def page(
    rows: list[dict[str, Any]] | None = None, name: str = "s7", script: str = "\n".join(OWN), style: str = "", more: str = ""
) -> bytes:
    """A report of so little that everything in it is seen here."""

    def digest(text: str) -> str:
        return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()

    policy = (
        "default-src &#39;none&#39;; img-src data:; "
        f"script-src &#39;sha256-{digest(script)}&#39;; style-src &#39;sha256-{digest(style)}&#39;; "
        "base-uri &#39;none&#39;; form-action &#39;none&#39;"
    )
    data = json.dumps({"name": name, "files": LISTED if rows is None else rows})
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n<style>{style}</style></head><body>'
        '<pre tabindex="0">&lt;use&gt; &#39;FR4&#39; &amp; &#34;gold&#34;\n</pre>'
        f'<script type="application/json" id="data">{data}</script>{more}<script>{script}</script></body></html>'
    ).encode()


def reported(data: bytes, version: str = __version__, notes: WrittenFile | None = NOTES) -> Check:
    content = {"name": "s7", "tool": {"version": version}, "files": [*LISTED, row("report", "report.html", data)]}
    files = {"report": [WrittenFile(path="report.html", data=data)], **({"order-notes": [notes]} if notes else {})}
    _, _, checks = check_listed(content, files, [], allowed=("order-notes",))
    assert [check.name for check in checks] == ["roles", "report"]
    return checks[1]


def test_a_report_of_this_kit_passes() -> None:
    found = reported(page())
    assert found.passed, found.message
    assert found.message.startswith("of this tape, with the SHA-256 of the 2 other files; ")
    assert found.message.endswith("not compared: what it draws and says beside notes and digests")
    other = reported(page(script="alert(1)"), version="0.0.1")
    assert other.passed and other.message.endswith("and the script, of another version")
    assert reported(page(), notes=None).passed


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (page(name="s8"), "it is that of another tape"),
        (page(LISTED[:1]), "it does not show as they are: notes.txt"),
        (page([*LISTED, row("bom", "bom.csv", b"")]), "it does not show as they are: bom.csv"),
        (page([row("bom", "cpl.csv", b"parts"), LISTED[1]]), "it does not show as they are: cpl.csv"),
        (page([row("cpl", "cpl.csv", b"PARTS"), LISTED[1]]), "it does not show as they are: cpl.csv"),
        (page([{"path": "cpl.csv"}]), "its data cannot be read: KeyError"),
        (b"", "its data cannot be read: ValueError"),
        (page() + page(), "its data cannot be read: ValueError"),
        (page().replace(b"FR4", b"FR5"), "its order notes are not the kit's"),
        (b" " + page(), "it does not begin with the policy"),
        (page().replace(b"img-src data:", b"img-src *"), "it does not begin with the policy"),
        (page(more="<SCRIPT>alert(1)</SCRIPT>"), "it has another script, style or directive than its own"),
        (page(more="<style></style>"), "it has another script, style or directive than its own"),
        (page(more='<meta http-equiv="refresh">'), "it has another script, style or directive than its own"),
        (page().replace(OWN[0].encode(), b"alert(1)"), "its script is not the one that its policy names"),
        (page().replace(b"<style>", b"<style>a"), "its style is not the one that its policy names"),
        (page(script="alert(1)"), "its script is not this version's: 'alert(1)'"),
        (page(style="a { background: url(http://a) }"), "its style is not this version's: 'a { background: url(http://a) }'"),
    ],
)
def test_a_report_that_is_another_or_does_more_fails(data: bytes, said: str) -> None:
    found = reported(data)
    assert not found.passed and said in found.message
