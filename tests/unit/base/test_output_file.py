"""A file that a user asks for is written whole or not at all, and never over something else."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactape_fab.base.errors import SpecError, TactapeError
from tactape_fab.base.output_file import refuse_taken_place, unfinished, write_file


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_new_file_is_written(tmp_path: Path) -> None:
    write_file(tmp_path / "map.png", b"new", "map", overwrite=False)
    assert (tmp_path / "map.png").read_bytes() == b"new"
    assert names(tmp_path) == ["map.png"]


def test_a_folder_whose_name_a_file_has_is_not_to_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"kept")
    for below in ("file/a.npz", "file/deeper/a.npz"):
        with pytest.raises(SpecError, match=r"a\.npz: .*file is there and is no folder; use another name$"):
            refuse_taken_place(tmp_path / below, "output")
    with pytest.raises(SpecError, match=r"nowhere/a\.npz: there is no folder of that name; make it first"):
        refuse_taken_place(tmp_path / "nowhere/a.npz", "output")


def test_another_file_is_kept_unless_it_may_be_replaced(tmp_path: Path) -> None:
    path = tmp_path / "map.png"
    path.write_bytes(b"old")
    with pytest.raises(SpecError, match=r"map = .* exists already; use --overwrite to replace it"):
        write_file(path, b"new", "map", overwrite=False)
    assert path.read_bytes() == b"old"
    write_file(path, b"new", "map", overwrite=True)
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("what", ["link", "dangling link", "folder", "fifo"])
def test_what_is_no_regular_file_is_never_replaced(what: str, overwrite: bool, tmp_path: Path) -> None:
    path, other = tmp_path / "map.png", tmp_path / "other"
    if what == "folder":
        path.mkdir()
    elif what == "fifo":
        os.mkfifo(path)
    else:
        path.symlink_to(other)
        if what == "link":
            other.write_bytes(b"mine")
    with pytest.raises(SpecError, match="nothing was touched"):
        write_file(path, b"new", "map", overwrite=overwrite)
    assert other.exists() is (what == "link") and (what != "link" or other.read_bytes() == b"mine")
    assert names(tmp_path) == (["map.png", "other"] if what == "link" else ["map.png"])


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("call", ["write", "fsync", "rename"])
def test_a_full_disk_leaves_what_was_there(call: str, overwrite: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "map.png"
    if overwrite:
        path.write_bytes(b"old")

    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if call == "write":
        real: Callable[..., Any] = Path.open

        def opened(self: Path, *args: Any, **kwargs: Any) -> Any:
            with real(self, *args, **kwargs) as stream:
                stream.write(b"n")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(Path, "open", opened)
    elif call == "fsync":
        monkeypatch.setattr(os, "fsync", full)
    else:
        monkeypatch.setattr(os, "link", full)
        monkeypatch.setattr(Path, "rename", full)
        monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(TactapeError, match="cannot be written: No space left on device; what stood there is as it was"):
        write_file(path, b"new", "map", overwrite=overwrite)
    monkeypatch.undo()
    assert names(tmp_path) == (["map.png"] if overwrite else [])
    assert not overwrite or path.read_bytes() == b"old"


def test_a_file_that_comes_into_being_meanwhile_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, sync = tmp_path / "map.png", os.fsync

    def another(handle: int) -> None:
        path.write_bytes(b"theirs")
        sync(handle)

    monkeypatch.setattr(os, "fsync", another)
    with pytest.raises(SpecError, match="exists already"):
        write_file(path, b"new", "map", overwrite=False)
    assert path.read_bytes() == b"theirs" and names(tmp_path) == ["map.png"]


def test_the_bytes_are_on_the_disk_before_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    sync, link = os.fsync, os.link

    def synced(handle: int) -> None:
        said.append("fsync")
        sync(handle)

    def linked(a: Path, b: Path) -> None:
        said.append("link")
        link(a, b)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "link", linked)
    write_file(tmp_path / "map.png", b"new", "map", overwrite=False)
    assert said == ["fsync", "link", "fsync"]


@pytest.mark.parametrize("name", ["x" * 255, "\u00e4" * 127, "\u6df1" * 85])
def test_any_name_that_the_file_system_takes_is_written(name: str, tmp_path: Path) -> None:
    write_file(tmp_path / name, b"data", "output", overwrite=False)
    assert [place.name for place in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["a" * 255, "\N{GRINNING FACE}" * 63, "a" * 199 + "\u00e9" * 28, "\udcff" * 255])
def test_an_unfinished_file_has_a_name_wherever_the_file_has(name: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    first, second = unfinished(tmp_path / name), unfinished(tmp_path / name)
    first.touch()
    assert first != second and first.parent == tmp_path and first.name.startswith(".") and first.name.endswith(".partial")
