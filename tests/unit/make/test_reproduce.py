"""Every change to a kit that has a meaning is caught by making the kit again, with all hashes made to fit.

The changes are those of an attack, each re-signed by `OpenKit`: what is left to notice them are the bytes alone.
"""

from __future__ import annotations

import io
import json
import re
import resource
import shutil
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from tactape_fab import Kit, PanelKit, TapeSpec, make_kit
from tactape_fab.cli import main
from tactape_fab.cli.verify import _STAND_IN
from tactape_fab.make.kit import fill_kit
from tactape_fab.make.reproduce import reproduce_kit
from tests.roundtrip.kits import Edit, OpenKit, bytes_of, moved, points, stated
from tests.thorough import costly, slow

pytestmark = pytest.mark.usefixtures("kits_as_elsewhere")
Copy = Callable[[Kit | PanelKit], Path]


def save(kit: OpenKit) -> Path:
    """Save with hashes, signatures, zip and report that fit, and the manifest written as `make` writes it."""
    folder = kit.save(consistent=True)
    text = json.dumps(kit.manifest, indent=1, ensure_ascii=True)
    (folder / "manifest.json").write_text(text + "\n", encoding="ascii", newline="\n")
    return folder


def text(role: str, old: str, new: str) -> Edit:
    def edit(kit: OpenKit) -> None:
        assert old.encode() in kit.data[role], f"{role} holds no {old!r}"
        kit.data[role] = kit.data[role].replace(old.encode(), new.encode(), 1)

    return edit


def both(*edits: Edit) -> Edit:
    def edit(kit: OpenKit) -> None:
        for each in edits:
            each(kit)

    return edit


def described(kit: OpenKit) -> None:
    """Another description, in the BOM and in the manifest that says what the BOM must say."""
    old = str(kit.manifest["assembly"]["description"])
    stated("assembly.description", "any resistor you have")(kit)
    kit.data["bom"] = kit.data["bom"].replace(old.encode(), b"any resistor you have")


def formula(kit: OpenKit) -> None:
    old = str(kit.manifest["assembly"]["value"])
    stated("assembly.value", "=cmd|' /C calc'!A0")(kit)
    kit.data["bom"] = kit.data["bom"].replace(old.encode(), b"=cmd|' /C calc'!A0")


def one_pixel(ending: str) -> Edit:
    image = np.zeros((1, 1, 3), dtype=np.uint8)
    return bytes_of("preview-png", lambda _: cv2.imencode(ending, image)[1].tobytes())


def relationships(kit: OpenKit) -> None:
    """A 3MF whose relationships name another part."""
    with zipfile.ZipFile(io.BytesIO(kit.data["3mf"])) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["_rels/.rels"] = members["_rels/.rels"].replace(b"3dmodel.model", b"another.model")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    kit.data["3mf"] = stream.getvalue()


def normals(kit: OpenKit) -> None:
    """The normals of an STL turned inside."""
    triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    data = kit.data["stl"]
    triangles = np.frombuffer(data, dtype=triangle, offset=84).copy()
    triangles["normal"] *= -1
    kit.data["stl"] = data[:84] + triangles.tobytes()


def without_policy(kit: OpenKit) -> None:
    before, _, rest = kit.data["report"].partition(b"<meta http-equiv")
    kit.data["report"] = before + rest.partition(b">")[2]


def pasted_zip(change: Callable[[bytes], bytes]) -> Edit:
    return bytes_of("fab-zip", change)


def swapped_symbols(kit: OpenKit) -> None:
    """A part off its grid point, on every layer and in the CPL: as if W, Δ and code were others."""
    for role in ("copper-top", "paste-top", "coverlay-top", "components-top"):
        points(role, moved(0.05, 0.0))(kit)


ATTACKS: dict[str, Edit] = {
    "order notes: thickness": text("order-notes", "0.11 mm", "1.6 mm"),
    "order notes: openings merged": text("order-notes", "Do not merge openings", "Merge openings"),
    "order notes: a line more": bytes_of("order-notes", lambda b: b + b"Use FR4.\n"),
    "preview: script in the SVG": text("preview-svg", "</svg>", "<script>alert(1)</script></svg>"),
    "preview: SVG of nothing": bytes_of("preview-svg", lambda _: b"<svg></svg>"),
    "preview: a JPEG": one_pixel(".jpg"),
    "preview: one pixel": one_pixel(".png"),
    "report: script": text("report", "</body>", "<script>alert(1)</script></body>"),
    "report: without its policy": without_policy,
    "report: another figure": text("report", "20 x 20 mm", "20 x 21 mm"),
    "board: clearance 0": text("kicad-project", '"min_clearance": 0.1', '"min_clearance": 0.0'),
    "board: thickness": text("kicad-pcb", "(thickness 0.11)", "(thickness 1.6)"),
    "board: text more": bytes_of("kicad-pcb", lambda b: b.rstrip()[:-1] + b'(gr_text "x" (at 1 1) (layer "F.SilkS")))\n'),
    "manifest: spec's pitch": stated("spec.pitch_mm", 1.6),
    "manifest: spec's part": stated("spec.part", "c0201"),
    "manifest: spec's x2": stated("spec.x2", "off"),
    "manifest: spec's fab": stated("spec.fab", "generic-fr4"),
    "manifest: unknown option": stated("spec.force", True),
    "manifest: limit": stated("fab.limits_mm.pad-pad", 0.01),
    "manifest: forced": stated("forced", [{"rule": "pad-pad", "value": 0.05, "limit": 0.1, "message": "it is all right"}]),
    "manifest: a key more": stated("approved", "yes"),
    "manifest: verified": stated("made.verified", False),
    "manifest: date": stated("made.date", "2026-01-01T00:00:00+00:00"),
    "manifest: coverlay asked for": stated("made.coverlay_asked", True),
    "BOM: description, with the manifest": described,
    "BOM: formula, with the manifest": formula,
    "job: thickness": text("job", '"BoardThickness": 0.11', '"BoardThickness": 1.6'),
    "job: layers": text("job", '"LayerNumber": 1', '"LayerNumber": 2'),
    "job: finish": text("job", "ENIG", "HASL"),
    "component layer: rotation": text("components-top", "CRot,45", "CRot,0"),
    "component layer: value": text("components-top", "CVal,0R", "CVal,1k"),
    "label: a line wider": text("legend-top", "C,0.15", "C,0.02"),
    "outline: 5 mm wide": text("profile", "C,0.100000", "C,5.000000"),
    "zip: data before it": pasted_zip(lambda b: b"PK\x03\x04" + b),
    "zip: comment": pasted_zip(lambda b: b[:-2] + b"\x02\x00hi"),
    "3MF: relationships": relationships,
    "STL: normals": normals,
    "STEP: another unit of angle": text("step-solid", "SI_UNIT($,.RADIAN.)", "SI_UNIT($,.STERADIAN.)"),
    "one layer moved with the others": swapped_symbols,
}


def said(folder: Path, *, required: bool = True) -> str:
    (line,) = reproduce_kit(folder, required=required).checks
    assert not line.passed
    return line.message


@pytest.mark.parametrize("edit", ATTACKS.values(), ids=ATTACKS.keys())
def test_a_changed_kit_is_not_what_its_manifest_makes(edit: Edit, small_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(small_kit))
    before = (dict(kit.data), json.dumps(kit.manifest))
    edit(kit)
    assert (kit.data, json.dumps(kit.manifest)) != before
    (line,) = reproduce_kit(save(kit), required=False).checks
    assert line.name == "reproduced"
    assert not line.passed and not line.warning, line.message


def test_the_message_names_files_and_the_manifests_value(small_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(small_kit))
    text("order-notes", "0.11 mm", "1.6 mm")(kit)
    stated("fab.limits_mm.pad-pad", 0.01)(kit)
    message = said(save(kit))
    assert "tactape-s100-order-notes.txt is not what this manifest makes" in message
    assert "fab.limits_mm.pad-pad = 0.01, computed 0.1" in message


SPECS: dict[str, dict[str, Any]] = {
    "solid elements": {"part": "dome"},
    "coverlay asked for": {"coverlay": "per-part", "anchor": "none"},
    "mould on a cylinder": {"part": "block", "negative": True, "cylinder_mm": 40.0, "around": "x"},
    "rigid board without attributes": {"fab": "pcbway-fr4", "x2": "off", "tag": "none", "tag_cell_mm": 1.0},
    "origin searched for": {"origin": "best"},
    "designed code": {"code": "touch-1"},
    "house and number": {"assembly": "jlcpcb", "part_number": "C123456"},
}


@costly
@pytest.mark.parametrize("values", SPECS.values(), ids=SPECS.keys())
@pytest.mark.parametrize("verify", [True, False], ids=["verified", "unverified"])
def test_a_kit_is_made_again_byte_for_byte(values: dict[str, Any], verify: bool, tmp_path: Path) -> None:
    models = values.get("part") is not None
    kit = make_kit(TapeSpec(sector=5, size_mm=(20.0, 20.0), models=models, **values), tmp_path / "kit", verify=verify)
    (line,) = reproduce_kit(kit.path).checks
    assert line.passed, line.message
    assert line.figure == len(kit.files) + 1


def test_a_broken_rule_is_made_again_with_it(tmp_path: Path) -> None:
    kit = make_kit(TapeSpec(sector=5, size_mm=(20.0, 20.0), pitch_mm=1.0, models=False), tmp_path / "kit", force=True)
    assert "forced" in json.loads((kit.path / "manifest.json").read_bytes())
    assert reproduce_kit(kit.path).passed


def test_the_date_is_the_kits_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    kit = make_kit(TapeSpec(sector=5, size_mm=(20.0, 20.0)), tmp_path / "kit")
    monkeypatch.delenv("SOURCE_DATE_EPOCH")
    assert reproduce_kit(kit.path).passed


@slow
def test_a_panel_is_made_again_with_its_kits(panel_2: PanelKit, copied: Copy) -> None:
    folder = copied(panel_2)
    (line,) = reproduce_kit(folder).checks
    assert line.passed, line.message
    notes = next((folder / "tapes").rglob("*-order-notes.txt"))
    notes.write_bytes(notes.read_bytes() + b"!")
    assert f"{notes.relative_to(folder).as_posix()} is not" in said(folder)


def test_a_tape_made_away_from_others_is_made_again(small_kit: Kit, tmp_path: Path) -> None:
    spec = TapeSpec(sector=5, size_mm=(20.0, 20.0), origin="best", models=False)
    kit = make_kit(spec, tmp_path / "kit", avoid=[small_kit.tape])
    assert reproduce_kit(kit.path).passed
    designed = TapeSpec(sector=5, size_mm=(20.0, 20.0), code="touch-1", models=False)
    first = make_kit(designed, tmp_path / "first", verify=False)
    second = make_kit(designed.with_values(name="second"), tmp_path / "second", avoid=[first.tape], verify=False)
    assert "its design avoids other tapes" in said(second.path)


# What this version cannot make again


CANNOT: dict[str, tuple[Edit, str]] = {
    "another version": (stated("tool.version", "0.0.9"), "install that version"),
    "no record": (lambda kit: kit.manifest.pop("made"), "make it anew"),
    "own profile": (stated("spec.fab", "/dev/zero.toml"), "is the user's own, and not in it; make it again from that profile"),
    "other libraries": (
        both(stated("made.libraries", {"numpy": "0.1"}), text("order-notes", "0.11 mm", "1.6 mm")),
        "made with numpy '0.1', here",
    ),
}


@pytest.mark.parametrize(("edit", "says"), CANNOT.values(), ids=CANNOT.keys())
def test_what_cannot_be_made_again_is_said_and_proves_nothing(edit: Edit, says: str, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    edit(kit)
    folder = save(kit)
    assert says in said(folder)
    (line,) = reproduce_kit(folder, required=False).checks
    assert line.warning and not line.passed
    run = CliRunner().invoke(main, ["verify", str(folder), "--reproduce"])
    assert run.exit_code == 4 and says in run.stderr


# A manifest is untrusted


HOSTILE: dict[str, Edit] = {
    "a large board of few points": both(
        stated("spec.size_mm", [600.0, 600.0]), stated("spec.pitch_mm", 0.5), stated("spec.code", "anoto-6x6")
    ),
    "spec is no table": stated("spec", ["sector"]),
    "sector is a table": stated("spec.sector", {"a": 1}),
    "a folder as a profile": stated("spec.fab", "../../fabs/generic-fpc"),
    "date": stated("made.date", "yesterday"),
    "libraries": stated("made.libraries", "all"),
    "holes": stated("spec.holes_mm", [[1.0, 1.0, 0.5]] * 100_000),
    "name": stated("spec.name", "../outside"),
}


@pytest.mark.parametrize("edit", HOSTILE.values(), ids=HOSTILE.keys())
def test_a_hostile_spec_is_refused_before_anything_is_made(edit: Edit, flat_kit: Kit, copied: Copy, tmp_path: Path) -> None:
    kit = OpenKit(copied(flat_kit))
    edit(kit)
    folder = save(kit)
    before, started = sorted(tmp_path.rglob("*")), time.process_time()
    assert "it cannot be made from its manifest" in said(folder)
    assert time.process_time() - started < 5.0
    assert sorted(tmp_path.rglob("*")) == before
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 4 << 20  # KiB


def test_a_link_in_the_kit_is_not_followed(flat_kit: Kit, copied: Copy, tmp_path: Path) -> None:
    folder = copied(flat_kit)
    outside = tmp_path / "outside.txt"
    notes = folder / "tactape-s100-order-notes.txt"
    shutil.move(notes, outside)
    notes.symlink_to(outside)
    assert "leads out of the kit's folder" in said(folder)


@pytest.mark.parametrize("gone", [".", "manifest.json"])
def test_a_kit_that_is_removed_while_it_is_read_is_told(
    gone: str, flat_kit: Kit, copied: Copy, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = copied(flat_kit)

    def filled_and_removed(*args: Any, **named: Any) -> None:
        fill_kit(*args, **named)
        shutil.rmtree(folder) if gone == "." else (folder / gone).unlink()

    monkeypatch.setattr("tactape_fab.make.reproduce.fill_kit", filled_and_removed)
    assert said(folder) == (f"{folder} was removed while it was read" if gone == "." else "manifest.json is missing")


def test_the_command_makes_again_and_nothing_else(flat_kit: Kit) -> None:
    run = CliRunner().invoke(main, ["verify", str(flat_kit.path), "--reproduce"])
    assert run.exit_code == 0 and run.stdout.split()[:5] == ["ok", "reproduced", "made", "again", "from"]
    refused = CliRunner().invoke(main, ["verify", str(flat_kit.path), "--reproduce", "--quick"])
    assert refused.exit_code == 2 and "leave out --reproduce, or --quick" in refused.stderr


def test_the_whole_verification_makes_the_kit_again(flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    text("preview-svg", 'fill="#c98a1b"', 'fill="#1b8ac9"')(kit)  # no other line compares what colours a picture has
    run = CliRunner().invoke(main, ["verify", str(save(kit)), "--json"])
    failed = [c["name"] for c in json.loads(run.stdout)["checks"] if not c["passed"] and not c["warning"]]
    assert run.exit_code == 4 and failed == ["reproduced"]


def test_a_forged_version_is_said_loudly_with_what_stands_in(flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    text("preview-svg", 'fill="#c98a1b"', 'fill="#1b8ac9"')(kit)  # no other line compares what colours a picture has
    stated("tool.version", "0.0.9")(kit)
    run = CliRunner().invoke(main, ["verify", str(save(kit))])
    assert run.exit_code == 0, run.output  # a kit of another version is none that fails
    assert "warn  reproduced" in run.stdout
    warning = run.stderr.splitlines()[-1]
    assert warning.startswith(
        "warning: the kit was NOT made again, so not every byte of it is proved; for what the fab gets written "
    )
    (lines,) = re.findall("for what the fab gets (.*) and the places of parts", warning)
    assert lines.split(", ") == list(_STAND_IN)


def test_the_warning_names_no_line_that_a_kit_does_not_have(tmp_path: Path) -> None:
    kit = OpenKit(make_kit(TapeSpec(sector=1, part="block", size_mm=(20.0, 20.0), tag="none"), tmp_path / "k", verify=False).path)
    stated("tool.version", "0.0.9")(kit)
    run = CliRunner().invoke(main, ["verify", str(save(kit))])
    assert run.exit_code == 0, run.output
    assert "is proved; for what pictures, drawing and report" in run.stderr.splitlines()[-1]
