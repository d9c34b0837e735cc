"""What a user has is not lost by making a kit in its place: edits are named and kept, links and foreign files never replaced."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pytest
from click.testing import CliRunner, Result

from tactape_fab import Kit, PanelKit, TapeSpec, make_kit
from tactape_fab.base.errors import SpecError, TactapeError
from tactape_fab.cli import main
from tactape_fab.kit.output_place import refuse_taken
from tactape_fab.make import publish
from tactape_fab.make.publish import finished

if TYPE_CHECKING:
    from tactape_fab.verify.signature import Signer

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


# A folder and its name


def put(target: Path, content: str, overwrite: Any = False, meanwhile: Callable[[], Any] | None = None) -> None:
    with finished(target, "kit", overwrite=overwrite) as folder:
        (folder / "manifest.json").write_text(json.dumps({"format": "tactape-manifest/1", "says": content}))
        if meanwhile is not None:
            meanwhile()


def says(folder: Path) -> str:
    return str(json.loads((folder / "manifest.json").read_bytes())["says"])


def raising(error: BaseException) -> Callable[..., None]:
    def call(*_: object, **__: object) -> None:
        raise error

    return call


def test_a_folder_is_signed_before_it_has_its_name_and_is_alone_then(tmp_path: Path) -> None:
    target, signed = tmp_path / "new" / "deep" / "kit", []

    class Noting:
        def sign(self, folder: Path) -> None:
            signed.append((target.exists(), sorted(contents(folder))))

    with finished(target, "kit", overwrite=False, signer=cast("Signer", Noting())) as folder:
        (folder / "file").write_bytes(b"")
    assert signed == [(False, ["file"])]
    assert sorted(contents(tmp_path)) == ["new", "new/deep", "new/deep/kit", "new/deep/kit/file"]


def test_an_error_removes_what_was_made_and_nothing_else(tmp_path: Path) -> None:
    target, full = tmp_path / "new" / "deep" / "kit", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(TactapeError, match=f"the kit cannot be written to {target}: No space left on device; use -o"):
        put(target, "mine", meanwhile=raising(full))
    assert tmp_path.is_dir() and contents(tmp_path) == {}  # a folder that was there stays, though it is empty
    with pytest.raises(KeyboardInterrupt), finished(target, "kit", overwrite=False):
        (tmp_path / "new" / "other").touch()
        raise KeyboardInterrupt
    assert sorted(contents(tmp_path)) == ["new", "new/other"]


def test_a_name_that_is_too_long_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(TactapeError, match="File name too long; use -o"):
        put(tmp_path / ("k" * 300), "mine", meanwhile=pytest.fail)


def test_a_place_that_was_taken_meanwhile_is_kept(tmp_path: Path) -> None:
    kit, link = tmp_path / "kit", tmp_path / "link"
    with pytest.raises(SpecError, match="exists already"):
        put(kit, "mine", meanwhile=lambda: put(kit, "theirs"))
    with pytest.raises(SpecError, match="is not a folder"):
        put(link, "mine", True, meanwhile=lambda: link.symlink_to("nowhere"))
    assert says(kit) == "theirs" and sorted(path.name for path in tmp_path.iterdir()) == ["kit", "link"]


@pytest.mark.parametrize("exchanges", [True, False])
def test_an_older_kit_is_replaced_as_it_is_asked_for(exchanges: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not exchanges:
        monkeypatch.setattr("ctypes.CDLL", raising(OSError()))
    kit = tmp_path / "kit"
    put(kit, "old")
    put(kit, "old", "same")
    with pytest.raises(SpecError, match="exists already"):
        put(kit, "new", "same")
    assert says(kit) == "old"
    put(kit, "new", True)
    assert says(kit) == "new" and list(tmp_path.iterdir()) == [kit]


def test_an_older_kit_has_its_name_again_where_the_new_one_cannot_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kit, rename = tmp_path / "kit", Path.rename
    put(kit, "old")

    def failing(self: Path, target: Path) -> Path:
        if target == kit and says(self) == "new":
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return rename(self, target)

    monkeypatch.setattr(publish, "_exchange", lambda *_: False)
    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(TactapeError, match="Input/output error"):
        put(kit, "new", True)
    assert says(kit) == "old" and list(tmp_path.iterdir()) == [kit]


@pytest.mark.skipif(sys.platform != "linux", reason="folders are exchanged by a call of Linux")
def test_folders_are_exchanged_in_one_call_where_that_can_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    put(Path("a"), "a")
    put(Path("b"), "b")
    monkeypatch.setattr(Path, "rename", raising(AssertionError()))
    assert publish._exchange(Path("a"), Path("b")) and (says(Path("a")), says(Path("b"))) == ("b", "a")
    Path("a/below").mkdir()
    assert not publish._exchange(Path("a"), Path("a/below"))  # EINVAL, as of a file system that cannot
    with pytest.raises(FileNotFoundError):
        publish._exchange(Path("a"), Path("none"))


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
