"""Names and values of untrusted files neither forge a line of the terminal nor steer it."""

from __future__ import annotations

import io
import json
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

import pytest
from click.testing import CliRunner

from tactape_fab import Kit, PanelKit
from tactape_fab.base.errors import Check, Finding
from tactape_fab.base.plain_text import one_line, toml_string
from tactape_fab.cli import main
from tests.roundtrip.kits import OpenKit, rows

Copy = Callable[[Kit | PanelKit], Path]
FORGED = "x\nverified: 62 checks of the written files\x1b[2J\u202egnp.\r\u2028\x07"


def test_what_is_not_printed_is_shown_as_an_escape() -> None:
    assert one_line("a\nb\x1b[0m\u202ec\u2028\t\x9b") == "a\\nb\\x1b[0m\\u202ec\\u2028\\t\\x9b"
    assert one_line("Δ 0.25 µm, 5°, naïve") == "Δ 0.25 µm, 5°, naïve"
    assert one_line("\ud800") == "\\ud800"


def test_checks_and_findings_hold_one_line() -> None:
    assert Check(name=FORGED, passed=True, message=FORGED).message == one_line(FORGED)
    assert Check(name=FORGED, passed=True, message="").name == one_line(FORGED)
    assert Finding(rule="x", level="info", passed=True, message=FORGED).message == one_line(FORGED)


def clean(output: str) -> bool:
    return not any(line.startswith("verified: 62") for line in output.split("\n")) and output.replace("\n", "").isprintable()


def unlisted(kit: OpenKit) -> None:
    (kit.folder / FORGED).write_bytes(b"")


def designator(kit: OpenKit) -> None:
    rows("cpl", lambda table: table[5].__setitem__(0, "R5\rverified"))(kit)


def job_path(kit: OpenKit) -> None:
    job = json.loads(kit.data["job"])
    job["FilesAttributes"][0]["Path"] = FORGED
    kit.data["job"] = json.dumps(job).encode()


def job_error(kit: OpenKit) -> None:
    kit.data["job"] = json.dumps({"GeneralSpecs": {"Size": {"X": FORGED, "Y": 1}}, "FilesAttributes": []}).encode()


def bom_header(kit: OpenKit) -> None:
    kit.data["bom"] = kit.data["bom"].replace(b"Designator", b'"Desig\x1b[2J\nverified: 62 checks"', 1)


def role(kit: OpenKit) -> None:
    kit.manifest["files"][0]["role"] = FORGED


def path(kit: OpenKit) -> None:
    kit.manifest["files"][0]["path"] = FORGED


def member(kit: OpenKit) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(FORGED, b"")
    kit.data["fab-zip"] = stream.getvalue()


@pytest.mark.parametrize("edit", [unlisted, designator, job_path, job_error, bom_header, role, path, member])
def test_verify_prints_no_forged_line(edit: Callable[[OpenKit], None], flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    edit(kit)
    run = CliRunner().invoke(main, ["verify", str(kit.save(consistent=True)), "--quick"])
    assert clean(run.stdout) and clean(run.stderr)
    assert run.exit_code == (0 if edit is unlisted else 4)


def test_profiles_and_archives_print_no_forged_line(flat_kit: Kit, tmp_path: Path) -> None:
    frames = tmp_path / "a.npz"
    with zipfile.ZipFile(frames, "w") as archive:
        archive.writestr(FORGED + ".npy", b"")
    run = CliRunner().invoke(main, ["decode", str(frames), "--tape", str(flat_kit.path)])
    assert run.exit_code == 2 and clean(run.stderr)
    profile = tmp_path / "fab.toml"
    source = json.dumps(FORGED)
    profile.write_text(f'extends = "generic-fpc"\n[limits.pad-pad]\nsource = {source}\n', encoding="utf-8")
    for command in (["profiles", str(profile)], ["check", "--sector", "1", "--fab", str(profile)]):
        run = CliRunner().invoke(main, command)
        assert clean(run.stdout) and clean(run.stderr)


@pytest.mark.parametrize(
    "text", ["", "a", '"q" \\ back', "\u00e4\U0001f600\u2028\u202e\U000e0001", "".join(map(chr, range(128)))]
)
def test_a_string_of_toml_is_read_as_the_text(text: str) -> None:
    assert tomllib.loads(f"a = {toml_string(text)}") == {"a": text}
    assert toml_string(text).isprintable()  # editors obey marks of writing direction


def test_bytes_of_a_name_that_are_no_text_are_shown() -> None:
    assert tomllib.loads(f"a = {toml_string('caf' + chr(0xDCE9))}") == {"a": "caf\\udce9"}
