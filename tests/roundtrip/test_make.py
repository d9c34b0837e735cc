"""Making a kit: the same bytes from the same input wherever and whenever it runs, the files of the contract, and an exchange
that leaves the old kit or the new one.
"""

from __future__ import annotations

import csv
import errno
import hashlib
import io
import json
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterable, Mapping
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from pypdf import PdfReader

from tactape_fab import Kit, Tape, TapeSpec, default_origin, make_kit, verify_kit
from tactape_fab.base.errors import Check, SpecError, TactapeError, VerifyError
from tactape_fab.base.templates import templates_folder
from tactape_fab.cli import main
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.writer import write_kit
from tactape_fab.make import kit as make
from tactape_fab.make import publish as folders
from tactape_fab.verify import Verification
from tests.roundtrip.kits import IN_ZIP, ROLES, contents
from tests.thorough import thorough

pytestmark = pytest.mark.usefixtures("kits_as_elsewhere")
SMALL = TapeSpec(sector=100, size_mm=(20.0, 20.0), holes_mm=[(16.4, 10.0, 1.0)])
"""The spec of the shared small kit."""
PINNED_KEYS = {
    "format", "name", "tool", "sector", "code", "origin", "columns", "rows", "pitch_mm", "displacement_mm", "board", "part",
    "fab", "spec", "symbols", "omitted", "tag", "files",
}  # fmt: skip


def manifest_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "manifest.json").read_text(encoding="ascii")))


def rows_of(data: bytes) -> list[list[str]]:
    return list(csv.reader(io.StringIO(data.decode("ascii"), newline="")))


def file_of(kit: Kit, role: str) -> bytes:
    return (kit.path / kit.files[role]).read_bytes()


# The same bytes


def make_in_process(folder: Path, env: Mapping[str, str], *args: str) -> dict[str, bytes]:
    """Run the main job as a process in `folder`, and return its kit's bytes."""
    folder.mkdir(parents=True)
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("LC_", "SOURCE_DATE"))}
    command = [sys.executable, "-m", "tactape_fab", "make", "--sector", "7", "--w", "1.5", "--delta", "0.25", *args]
    subprocess.run(command, cwd=folder, env={**clean, **env}, capture_output=True, check=True)
    return contents(next(p for p in folder.iterdir() if p.is_dir()))


def test_same_command_gives_the_same_bytes_anywhere(tmp_path: Path, default_kit: Kit) -> None:
    first = make_in_process(tmp_path / "a", {"PYTHONHASHSEED": "1", "TZ": "Pacific/Kiritimati", "LANG": "C"})
    second = make_in_process(
        tmp_path / "b" / "far away",
        {"PYTHONHASHSEED": "2", "TZ": "America/Los_Angeles", "LANG": "de_DE.UTF-8", "PYTHONUTF8": "0", "OMP_NUM_THREADS": "1"},
        "-o",
        "another name",
    )
    assert first == second
    assert first == contents(default_kit.path)
    assert hashlib.sha256(first["tactape-s007-fab.zip"]).digest() == hashlib.sha256(second["tactape-s007-fab.zip"]).digest()


def test_own_profile_gives_the_same_bytes_from_any_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "conf").mkdir()
    profile = (templates_folder() / "fabs" / "generic-fpc.toml").read_text(encoding="utf-8")
    (tmp_path / "conf" / "ours.toml").write_text(profile, encoding="utf-8")
    (tmp_path / "conf" / "tape.toml").write_text('sector = 3\nsize_mm = [20, 20]\nfab = "ours.toml"\n')
    made: list[dict[str, bytes]] = []
    absolute = str(tmp_path / "conf" / "tape.toml")
    for cwd, spec in ((tmp_path, "conf/tape.toml"), (tmp_path / "conf", "tape.toml"), (tmp_path, absolute)):
        monkeypatch.chdir(cwd)
        result = CliRunner().invoke(main, ["make", spec, "--no-verify", "-o", str(tmp_path / f"kit{len(made)}")])
        assert result.exit_code == 0, result.output
        made.append(contents(tmp_path / f"kit{len(made)}"))
    assert made[0] == made[1]
    assert made[0] == made[2]


def test_nothing_depends_on_the_clock(tmp_path: Path, small_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> None:
    year_2040 = 2_208_988_800.0
    monkeypatch.setattr(time, "time", lambda: year_2040)
    monkeypatch.setattr(time, "localtime", lambda *_: time.gmtime(year_2040))
    assert contents(make_kit(SMALL, tmp_path / "kit").path) == contents(small_kit.path)


def test_no_file_holds_today_s_date_or_the_place_of_the_kit(small_kit: Kit) -> None:
    today = date.today().isoformat().encode()
    profiles = b"".join(path.read_bytes() for path in templates_folder().rglob("*.toml"))
    marks = [str(small_kit.path.parent).encode(), str(Path.home()).encode()]
    marks += [] if today in profiles else [today]  # a profile's own date is a fact, today's as well on that day
    for path, data in contents(small_kit.path).items():
        if not path.endswith((".zip", ".png")):
            assert not [mark for mark in marks if mark in data and mark != b"/"], path


def test_dates_before_a_zip_can_hold_them_stand_in_the_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    kit = make_kit(TapeSpec(sector=1, size_mm=(20, 20)), tmp_path / "kit")
    assert b"TF.CreationDate,1970-01-01T00:00:00+00:00*" in (kit.path / kit.files["copper-top"]).read_bytes()
    with zipfile.ZipFile(kit.path / kit.files["fab-zip"]) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_source_date_epoch_changes_the_dates_and_nothing_else(
    tmp_path: Path, small_kit: Kit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767323045")  # 2026-01-02T03:04:05Z
    dated, plain = contents(make_kit(SMALL, tmp_path / "kit").path), contents(small_kit.path)
    assert dated.keys() == plain.keys()
    for path, data in dated.items():
        if path.endswith((".zip", ".3mf", ".pdf", "manifest.json", "report.html")):
            continue
        undated = without_signature(
            data.replace(b"2026-01-02T03:04:05", b"1980-01-01T00:00:00").replace(b"2026-01-02", b"1980-01-01")
        )
        assert undated == without_signature(plain[path]), path
    drawings = (PdfReader(io.BytesIO(of["tactape-s100-drawing.pdf"])).pages[0].extract_text() for of in (dated, plain))
    of_2026, of_1980 = drawings
    assert of_2026.replace("2026-01-02", "1980-01-01") == of_1980
    assert dated["gerber/tactape-s100.gtl"].count(b"2026-01-02T03:04:05+00:00") == 1
    with zipfile.ZipFile(io.BytesIO(dated["tactape-s100-fab.zip"])) as archive:
        assert {member.date_time for member in archive.infolist()} == {(2026, 1, 2, 3, 4, 4)}  # a zip counts two seconds


def without_signature(data: bytes) -> bytes:
    """A Gerber file without its .MD5, which covers its date."""
    return b"\n".join(line for line in data.splitlines() if b"TF.MD5," not in line)


# The files


def test_kit_holds_the_files_of_the_contract(default_kit: Kit, small_kit: Kit) -> None:
    for kit, roles in ((default_kit, set(ROLES) - {"drill-npth"}), (small_kit, ROLES)):
        content = manifest_of(kit.path)
        rows = content["files"]
        assert sorted(row["role"] for row in rows) == sorted(roles)
        assert {row["path"] for row in rows} | {"manifest.json"} == set(contents(kit.path))
        assert kit.files == {row["role"]: row["path"] for row in rows}
        for row in rows:
            data = (kit.path / row["path"]).read_bytes()
            assert (row["bytes"], row["sha256"]) == (len(data), hashlib.sha256(data).hexdigest())


def test_manifest_holds_the_pinned_keys(default_kit: Kit) -> None:
    content = manifest_of(default_kit.path)
    assert content.keys() >= PINNED_KEYS
    assert content["format"] == "tactape-manifest/1"
    assert (content["name"], content["sector"], content["code"]) == ("tactape-s007", 7, "microdots-4x4")
    assert (content["origin"], content["columns"], content["rows"]) == ([84, 1428], 62, 32)
    assert content["board"] == {
        "size_mm": [100.0, 50.0],
        "texture_origin_mm": [6.9, 48.25],
        "corner_radius_mm": 1.0,
        "thickness_mm": 0.11,
        "holes": [],
    }
    assert content["part"] == {"name": "r0201", "shape": "block", "body_mm": [0.6, 0.3, 0.23], "rotation_deg": 45.0}
    assert {key: content["tag"][key] for key in ("family", "id", "cell_mm", "rotation_deg")} == {
        "family": "tag36h11",
        "id": 7,
        "cell_mm": 0.5,
        "rotation_deg": 0.0,
    }
    assert {(len(row), *set(row) - set("NESW")) for row in content["symbols"]} == {(62,)}
    assert TapeSpec.from_mapping(content["spec"]) == TapeSpec(sector=7, assembly="generic", x2="full", coverlay="per-part")


def test_zip_holds_what_the_fab_needs_and_no_more(small_kit: Kit) -> None:
    with zipfile.ZipFile(small_kit.path / small_kit.files["fab-zip"]) as archive:
        members = archive.infolist()
        found = {member.filename: archive.read(member) for member in members}
    expected = {Path(small_kit.files[role]).name: file_of(small_kit, role) for role in IN_ZIP}
    assert found == expected
    assert [member.filename for member in members] == sorted(expected)
    assert {member.date_time for member in members} == {(1980, 1, 1, 0, 0, 0)}


def test_cpl_and_bom_have_the_columns_of_every_house(default_kit: Kit, tmp_path: Path) -> None:
    jlcpcb = make_kit(TapeSpec(sector=7, assembly="jlcpcb"), tmp_path / "kit")
    for kit in (default_kit, jlcpcb):
        assert rows_of(file_of(kit, "cpl"))[0] == ["Designator", "Mid X", "Mid Y", "Layer", "Rotation"]
        assert len(rows_of(file_of(kit, "cpl"))) == 1 + 1984
    assert file_of(jlcpcb, "bom").splitlines()[0] == b"Comment,Designator,Footprint,JLCPCB Part #"
    assert "Designator" in rows_of(file_of(default_kit, "bom"))[0]


@pytest.mark.parametrize("assembly", ["generic", "jlcpcb"])
def test_no_bom_row_holds_more_than_200_designators(assembly: str, tmp_path: Path) -> None:
    kit = make_kit(TapeSpec(sector=7, assembly=assembly), tmp_path / "kit", verify=False)
    header, *rows = rows_of(file_of(kit, "bom"))
    groups = [row[header.index("Designator")].split(",") for row in rows]
    assert max(len(group) for group in groups) == 200
    assert [name for group in groups for name in group] == [f"R{i}" for i in range(1, 1985)]


def test_tape_without_a_tag_has_no_legend(tmp_path: Path) -> None:
    kit = make_kit(TapeSpec(sector=7, size_mm=(20, 20), tag="none"), tmp_path / "kit")
    assert "legend-top" not in kit.files
    assert manifest_of(kit.path)["tag"] is None
    assert not [path for path in contents(kit.path) if path.endswith(".gto")]
    with zipfile.ZipFile(kit.path / kit.files["fab-zip"]) as archive:
        assert len(archive.namelist()) == len(set(IN_ZIP) - {"legend-top", "drill-npth"})


def test_black_legend_profile_makes_a_kit_that_verifies(tmp_path: Path) -> None:
    profile = (templates_folder() / "fabs" / "generic-fpc.toml").read_text(encoding="utf-8")
    changed = profile.replace('coverlay = "amber"', 'coverlay = "white"').replace('legend = "white"', 'legend = "black"')
    (tmp_path / "dark.toml").write_text(changed.replace('"generic-fpc"', '"dark"', 1), encoding="utf-8")
    dark = TapeSpec(sector=7, size_mm=(30, 20), models=False, fab=str(tmp_path / "dark.toml"))
    kit = make_kit(dark, tmp_path / "kit", verify=False)
    white = make_kit(TapeSpec(sector=7, size_mm=(30, 20), models=False), tmp_path / "white", verify=False)
    verification = verify_kit(kit.path)
    assert verification.passed
    assert any(check.name == "tag by OpenCV" for check in verification.checks)
    assert file_of(kit, "legend-top") != file_of(white, "legend-top")
    assert file_of(kit, "copper-top").count(b"D03*") == file_of(white, "copper-top").count(b"D03*")


SIZES: list[tuple[tuple[float, float], float, dict[str, Any]]] = [
    ((20.0, 20.0), 1.5, {}),
    ((60.0, 16.0), 1.6, {"tag": "none", "corner_radius_mm": 6.0}),
    ((24.0, 40.0), 2.0, {"rotation_deg": 0.0, "x2": "comments", "displacement_mm": 0.3}),
    ((33.3, 27.7), 1.55, {"x2": "off", "tag_id": 586, "tag_cell_mm": 0.4, "holes_mm": [(20.0, 15.0, 3.2)]}),
]
AT_A_DESK = {("microdots-4x4", 3), ("debruijn-4x4", 1), ("anoto-6x6", 2)}
MORE = {("microdots-4x4", 1), ("debruijn-4x4", 0), ("anoto-6x6", 3)}
"""Two sizes of each code, each size at least once; test_random_kits.py and tests/property mix all options."""


@pytest.mark.parametrize(
    ("code", "size_mm", "pitch_mm", "options"),
    [
        (code, *size) if (code, i) in AT_A_DESK else thorough(code, *size)
        for code in ("microdots-4x4", "debruijn-4x4", "anoto-6x6")
        for i, size in enumerate(SIZES)
        if (code, i) in AT_A_DESK | MORE
    ],
)
def test_every_code_and_size_makes_a_kit_that_verifies(
    code: str, size_mm: tuple[float, float], pitch_mm: float, options: dict[str, Any], tmp_path: Path
) -> None:
    models = code == "microdots-4x4"  # one code's solids with every reader: they know of no code
    spec = TapeSpec(sector=255, code=code, size_mm=size_mm, pitch_mm=pitch_mm, models=models, **options)
    kit = make_kit(spec, tmp_path / "kit", verify=False)
    verification = verify_kit(kit.path)
    assert [check.message for check in verification.checks if not check.passed and not check.warning] == []
    assert any(check.name == "windows from copper" for check in verification.checks)
    assert Tape.load(kit.path).origin == default_origin(code, 255)


# The Python interface


def test_python_interface_is_as_the_contract_writes_it(here: Path, default_kit: Kit) -> None:
    kit = make_kit(TapeSpec(sector=7, pitch_mm=1.5, displacement_mm=0.25, size_mm=(100, 50)), "out/tactape-s007")
    tape = Tape.load("out/tactape-s007/manifest.json")
    assert default_origin("microdots-4x4", 7) == (84, 1428) == tape.origin
    assert (tape.sector, tape.columns, tape.rows) == (7, 62, 32)
    assert (tape.symbols == kit.tape.symbols).all()
    assert all(check.passed for check in kit.checks)
    assert contents(here / "out/tactape-s007") == contents(default_kit.path)


def test_make_kit_without_a_path_takes_the_tape_s_name(here: Path) -> None:
    told: list[str] = []
    kit = make_kit(TapeSpec(sector=42, size_mm=(20, 20)), progress=told.append)
    assert kit.path == Path("tactape-s042")
    assert told == ["rendering", "writing", "verifying", "reporting"]


# Into place


def test_overwrite_replaces_an_older_kit(tmp_path: Path, small_kit: Kit) -> None:
    older = make_kit(TapeSpec(sector=8, size_mm=(20.0, 20.0)), tmp_path / "kit")
    with pytest.raises(SpecError, match="exists already; use --overwrite"):
        make_kit(SMALL, older.path)
    make_kit(SMALL, older.path, overwrite=True)
    assert contents(tmp_path / "kit") == contents(small_kit.path)
    assert [p.name for p in tmp_path.iterdir()] == ["kit"]


def test_overwrite_works_where_folders_cannot_be_exchanged(
    tmp_path: Path, small_kit: Kit, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_kit(TapeSpec(sector=8, size_mm=(20.0, 20.0)), tmp_path / "kit")
    monkeypatch.setattr(folders, "_exchange", lambda *_: False)
    make_kit(SMALL, tmp_path / "kit", overwrite=True)
    assert contents(tmp_path / "kit") == contents(small_kit.path)
    assert [p.name for p in tmp_path.iterdir()] == ["kit"]


def test_overwrite_of_nothing_makes_a_kit(tmp_path: Path, small_kit: Kit) -> None:
    assert contents(make_kit(SMALL, tmp_path / "kit", overwrite=True).path) == contents(small_kit.path)


def test_kit_goes_through_a_linked_parent_folder(tmp_path: Path, small_kit: Kit) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    make_kit(SMALL, tmp_path / "link" / "kit")
    assert contents(tmp_path / "real" / "kit") == contents(small_kit.path)


def test_folders_of_a_kit_have_the_permissions_of_any_other(tmp_path: Path) -> None:
    usual = tmp_path / "usual"
    usual.mkdir()
    kit = make_kit(SMALL, tmp_path / "kit", verify=False)
    assert {p.stat().st_mode for p in (kit.path, *kit.path.iterdir()) if p.is_dir()} == {usual.stat().st_mode}


def failing(manifest_file: Path, *, quick: bool) -> Verification:
    assert manifest_file.is_file()
    return Verification(name="kit", checks=(Check(name="copper-top", passed=False, message="a pad is off by 0.02 mm"),))


@pytest.mark.parametrize("place", ["kit", "new/deep/kit"])
def test_kit_that_fails_its_verification_never_stands_under_its_name(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tactape_fab.verify.verify_folder", failing)
    with pytest.raises(VerifyError, match=r"off by 0\.02 mm"):
        make_kit(SMALL, tmp_path / place)
    assert list(tmp_path.iterdir()) == []


def test_failed_verification_leaves_the_old_kit_untouched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_kit(TapeSpec(sector=8, size_mm=(20.0, 20.0)), tmp_path / "kit")
    before = contents(tmp_path / "kit")
    monkeypatch.setattr("tactape_fab.verify.verify_folder", failing)
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["make", "--sector", "100", "--size", "20x20", "-o", "kit", "--overwrite"])
    assert result.exit_code == 4
    assert "error: copper-top: a pad is off by 0.02 mm" in result.stderr
    assert contents(tmp_path / "kit") == before
    assert [p.name for p in tmp_path.iterdir()] == ["kit"]


def test_full_disk_is_a_message_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill(folder: Path, *_: object) -> None:
        (folder / "part.gtl").write_text("half a file")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(make, "write_kit", fill)
    with pytest.raises(TactapeError, match=r"cannot be written to .*: No space left on device"):
        make_kit(SMALL, tmp_path / "kit")
    assert list(tmp_path.iterdir()) == []


def test_a_kit_that_comes_meanwhile_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(folder: Path, content: Mapping[str, Any], artifacts: Iterable[Artifact]) -> None:
        write_kit(folder, content, artifacts)
        (tmp_path / "kit").mkdir()
        (tmp_path / "kit" / "thesis.txt").write_text("mine")

    monkeypatch.setattr(make, "write_kit", write)
    with pytest.raises(SpecError, match="exists already"):
        make_kit(SMALL, tmp_path / "kit")
    assert contents(tmp_path) == {"kit/thesis.txt": b"mine"}
