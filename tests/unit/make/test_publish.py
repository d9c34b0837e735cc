"""What a user has is not lost by making a kit in its place: edits are named and kept, links and foreign files never replaced."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from tactape_fab import Kit, PanelKit, TapeSpec, make_kit
from tactape_fab.base.errors import SpecError, TactapeError
from tactape_fab.cli import main
from tactape_fab.kit.output_place import refuse_taken

Copy = Callable[[Kit | PanelKit], Path]
SPEC = TapeSpec(sector=100, size_mm=(20.0, 20.0), models=False)


def cli(*arguments: str) -> Result:
    return CliRunner().invoke(main, list(arguments))


def contents(folder: Path) -> dict[str, bytes | None]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


def listed(folder: Path, role: str) -> Path:
    rows = json.loads((folder / "manifest.json").read_bytes())["files"]
    return folder / str(next(row["path"] for row in rows if row["role"] == role))


@pytest.mark.parametrize("role", ["order-notes", "kicad-pcb", "cpl", "report"])
def test_an_edited_file_is_named_and_kept(role: str, flat_kit: Kit, copied: Copy) -> None:
    folder = copied(flat_kit)
    edited = listed(folder, role)
    edited.write_bytes(edited.read_bytes() + b"\n")
    before = contents(folder)
    run = cli("make", "--sector", "100", "--size", "20x20", "--no-3d", "--no-verify", "-o", str(folder), "--overwrite")
    assert run.exit_code == 2
    assert f"edited since: {edited.relative_to(folder).as_posix()};" in run.stderr and "--discard-edits" in run.stderr
    assert contents(folder) == before
    run = cli("make", "--sector", "100", "--size", "20x20", "--no-3d", "--no-verify", "-o", str(folder), "--discard-edits")
    assert run.exit_code == 0, run.stderr
    assert contents(folder) != before


def test_an_unedited_kit_is_replaced(flat_kit: Kit, copied: Copy) -> None:
    folder = copied(flat_kit)
    make_kit(SPEC, folder, overwrite=True, verify=False)
    assert json.loads((folder / "manifest.json").read_bytes())["board"]["holes"] == []


@pytest.mark.parametrize("discard", [True, "edits"])
@pytest.mark.parametrize("mine", ["folder", "file", "link", "as-built"])
def test_what_the_manifest_does_not_list_is_kept(mine: str, discard: Any, flat_kit: Kit, copied: Copy) -> None:
    folder = copied(flat_kit)
    place = folder / ("as-built.json" if mine == "as-built" else "mine")
    if mine == "folder":
        place.mkdir()
    elif mine == "link":
        place.symlink_to(folder.parent)
    else:
        place.write_bytes(b"mine")
    with pytest.raises(SpecError, match=f"{place.name}, which its manifest does not list"):
        make_kit(SPEC, folder, overwrite=discard, verify=False)
    assert place.exists()


def test_a_listed_file_that_is_a_link_now_is_kept(flat_kit: Kit, copied: Copy, tmp_path: Path) -> None:
    folder = copied(flat_kit)
    notes = listed(folder, "order-notes")
    notes.rename(tmp_path / "elsewhere.txt")
    notes.symlink_to(tmp_path / "elsewhere.txt")
    with pytest.raises(SpecError, match="edited since"):
        make_kit(SPEC, folder, overwrite=True, verify=False)
    assert notes.is_symlink()


def test_an_edit_in_a_kit_of_a_panel_is_named(panel_2: PanelKit, copied: Copy) -> None:
    folder = copied(panel_2)
    notes = next((folder / "tapes").rglob("*-order-notes.txt"))
    notes.write_bytes(b"mine")
    with pytest.raises(SpecError, match=f"edited since: {notes.relative_to(folder).as_posix()};"):
        refuse_taken(folder, overwrite=True)


def test_files_are_on_the_disk_before_the_kit_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []
    names_then: list[bool] = []
    sync = os.fsync

    def noted(handle: int) -> None:
        synced.append(str(Path(f"/proc/self/fd/{handle}").readlink()))
        names_then.append((tmp_path / "kit").exists())
        sync(handle)

    monkeypatch.setattr(os, "fsync", noted)
    kit = make_kit(SPEC, tmp_path / "kit", verify=False)
    files = {Path(path).name for path, named in zip(synced, names_then, strict=True) if not named}
    assert {Path(path).name for path in kit.files.values()} | {"manifest.json", "gerber"} <= files
    assert synced[-1] == str(tmp_path) and names_then[-1]


@pytest.mark.parametrize("call", range(0, 30, 3))
@pytest.mark.parametrize("over", [False, True], ids=["new", "over an older kit"])
def test_a_failing_fsync_leaves_the_old_kit_or_none(
    call: int, over: bool, flat_kit: Kit, copied: Copy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = copied(flat_kit) if over else tmp_path / "kit"
    before = contents(folder) if over else {}
    count, sync = 0, os.fsync

    def failing(handle: int) -> None:
        nonlocal count
        count += 1
        if count == call + 1 and not os.path.isdir(f"/proc/self/fd/{handle}"):  # noqa: PTH112
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        sync(handle)

    monkeypatch.setattr(os, "fsync", failing)
    try:
        make_kit(SPEC, folder, overwrite=over, verify=False)
    except TactapeError as error:
        assert "Input/output error" in str(error)
        assert contents(folder) == before if over else not folder.exists()
    else:
        assert contents(folder) != before
    assert [p.name for p in tmp_path.iterdir() if p.name.endswith(".partial")] == []


# Pictures


def test_the_picture_of_a_certificate_replaces_nothing(flat_kit: Kit, copied: Copy, tmp_path: Path) -> None:
    folder = copied(flat_kit)
    before = contents(folder)
    run = cli("certify", str(folder), "--picture", str(folder / "manifest.json"))
    assert run.exit_code == 2 and "does not end with .png" in run.stderr
    link = tmp_path / "link.png"
    link.symlink_to(folder / "manifest.json")
    for option in ([], ["--overwrite"]):
        run = cli("certify", str(folder), "--picture", str(link), *option)
        assert run.exit_code == 2 and "is a link; nothing was touched" in run.stderr
    assert contents(folder) == before
    picture = tmp_path / "windows.png"
    assert cli("certify", str(folder), "--picture", str(picture)).exit_code == 0
    assert cli("certify", str(folder), "--picture", str(picture)).exit_code == 2
    assert cli("certify", str(folder), "--picture", str(picture), "--overwrite").exit_code == 0


def test_a_map_replaces_nothing(flat_kit: Kit, tmp_path: Path) -> None:
    mine = tmp_path / "mine.png"
    mine.write_bytes(b"mine")
    link = tmp_path / "link.png"
    link.symlink_to(mine)
    for path, says in ((mine, "exists already; use --overwrite"), (link, "is a link; nothing was touched")):
        run = cli("verify", str(flat_kit.path), "--map", str(path))
        assert run.exit_code == 2 and says in run.stderr
    assert mine.read_bytes() == b"mine"
