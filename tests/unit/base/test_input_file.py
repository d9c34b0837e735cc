"""Untrusted files: a FIFO or a device in place of one is refused at once, wherever a file is read."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tactape_fab import Kit, PanelKit
from tactape_fab.base.errors import SpecError
from tactape_fab.base.input_file import open_regular, read_regular
from tactape_fab.cli import main
from tactape_fab.texture.manifest import read_manifest
from tactape_fab.verify import verify_kit

Copy = Callable[[Kit | PanelKit], Path]


@pytest.fixture(autouse=True)
def patience() -> Iterator[None]:
    """A test that hangs ends after two minutes: the first one ever compiles the decoder."""

    def stuck(*_: Any) -> None:
        raise TimeoutError("it hangs")

    before = signal.signal(signal.SIGALRM, stuck)
    signal.alarm(120)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def fifo(path: Path) -> Path:
    os.mkfifo(path)
    return path


def zero(path: Path) -> Path:
    path.symlink_to("/dev/zero")
    return path


def socket_at(path: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
    return path


KINDS = pytest.mark.parametrize("kind", [fifo, zero, socket_at])


@KINDS
def test_what_is_no_regular_file_is_refused_at_once(kind: Callable[[Path], Path], tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"no regular file|No such device"):
        read_regular(kind(tmp_path / "x"), 100)


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="no regular file"):
        open_regular(tmp_path)


def test_a_file_is_read_through_a_link_and_bounded(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"x" * 100)
    (tmp_path / "link").symlink_to(tmp_path / "file")
    assert read_regular(tmp_path / "link", 100) == b"x" * 100
    assert read_regular(tmp_path / "link", 10) == b"x" * 11


@KINDS
@pytest.mark.parametrize("name", ["a.npz", "a.npy", "a.png", "a.tif"])
def test_decode_refuses_it(name: str, kind: Callable[[Path], Path], flat_kit: Kit, tmp_path: Path) -> None:
    path = kind(tmp_path / name)
    run = CliRunner().invoke(main, ["decode", str(path), "--tape", str(flat_kit.path)])
    assert run.exit_code == 2 and name in run.stderr


@KINDS
@pytest.mark.parametrize("name", ["a.npz", "a.png", "a.tif"])
def test_watch_passes_over_it(name: str, kind: Callable[[Path], Path], flat_kit: Kit, tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    kind(folder / name)
    np.save(folder / "b.npy", np.zeros((240, 320), dtype=np.float32))
    run = CliRunner().invoke(main, ["watch", str(folder), "--tape", str(flat_kit.path), "--idle", "1", "--json"])
    assert run.exit_code == 0, run.output
    assert run.stdout.count("\n") == 1


@pytest.mark.parametrize("kind", [fifo, zero])
def test_emboss_refuses_it(kind: Callable[[Path], Path], flat_kit: Kit, tmp_path: Path) -> None:
    run = CliRunner().invoke(main, ["emboss", str(flat_kit.path), str(kind(tmp_path / "part.stl"))])
    assert run.exit_code == 2 and "no regular file" in run.stderr


@pytest.mark.parametrize("kind", [fifo, zero])
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("x.png", "inspect X --tape KIT -o new.json"),
        ("x.json", "inspect here.png --tape KIT -o X"),
        ("x-deviations.csv", "inspect here.png --tape KIT -o x.json"),
        ("x.npz", "survey X --tape KIT -o new.json"),
        ("x", "survey here.npz --tape X -o new.json"),
        ("x.toml", "survey here.npz --tape KIT --sensor X -o new.json"),
        ("x.csv", "survey here.npz --tape KIT --poses X -o new.json"),
        ("x.json", "survey here.npz --tape KIT --from X -o new.json"),
        ("x.json", "survey here.npz --tape KIT -o X"),
        ("x.npz", "calibrate X --tape KIT -o new.toml"),
        ("x.csv", "calibrate here.npz --tape KIT --hand-eye X -o new.toml"),
        ("x.toml", "calibrate here.npz --tape KIT -o X"),
        ("x.json", "decode here.npz --tape KIT --as-built X"),
        ("x.toml", "decode here.npz --tape KIT --sensor X"),
        ("x.npz", "simulate KIT -o X --count 1"),
        ("x.png", "certify KIT --picture X --overwrite"),
        ("x", "registry X"),
        ("x.toml", "make X"),
        ("x.toml", "make --sector 1 --fab X"),
    ],
)
def test_every_other_file_that_a_command_names_is_refused(
    name: str, words: str, kind: Callable[[Path], Path], flat_kit: Kit, here: Path
) -> None:
    kind(here / name)
    np.savez("here.npz", depth=np.zeros((1, 240, 320), dtype=np.float32))
    Path("here.png").write_bytes(b"no picture")
    there = sorted(path.name for path in here.iterdir())
    run = CliRunner().invoke(main, [{"X": name, "KIT": str(flat_kit.path)}.get(word, word) for word in words.split()])
    assert run.exit_code == 2 and run.stderr.startswith("error: "), run.output
    assert name.partition(".")[0] in run.stderr
    assert sorted(path.name for path in here.iterdir()) == there


@pytest.mark.parametrize("kind", [fifo, zero])
def test_verify_refuses_it_in_a_kit(kind: Callable[[Path], Path], flat_kit: Kit, copied: Copy) -> None:
    folder = copied(flat_kit)
    notes = next(folder.glob("*-order-notes.txt"))
    notes.unlink()
    kind(notes)
    assert not verify_kit(folder, quick=True).passed
    manifest = folder / "manifest.json"
    manifest.unlink()
    kind(manifest)
    with pytest.raises(SpecError):
        verify_kit(folder, quick=True)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"pitch_mm": 1.5', '"pitch_mm": Infinity', "Infinity is no JSON"),
        ('"pitch_mm": 1.5', '"pitch_mm": NaN', "NaN is no JSON"),
        ('"sector": 100', '"sector": 100, "sector": 101', "the key 'sector' stands twice"),
    ],
)
def test_a_manifest_that_readers_take_differently_is_refused(old: str, new: str, says: str, flat_kit: Kit, copied: Copy) -> None:
    file = copied(flat_kit) / "manifest.json"
    text = file.read_text(encoding="ascii")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="ascii")
    with pytest.raises(SpecError, match=says):
        read_manifest(file)
