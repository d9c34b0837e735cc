"""Pictures say who wrote them, and replace nothing else."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactape_fab.base.errors import RenderError, SpecError, TactapeError
from tactape_fab.base.picture_file import is_own_picture, refuse_picture, refuse_pictures, write_picture

PICTURE = np.random.default_rng(1).integers(0, 256, (7, 5, 3), dtype=np.uint8)


def test_a_picture_names_its_software_in_a_valid_chunk(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.png"
    write_picture(path, PICTURE, "picture", compression=9)
    assert np.array_equal(np.asarray(cv2.imread(str(path))), PICTURE)
    data, at, names = path.read_bytes(), 8, []
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        body = data[at + 4 : at + 8 + length]
        assert zlib.crc32(body) == int.from_bytes(data[at + 8 + length : at + 12 + length], "big")
        names.append(bytes(body[:4]))
        at += 12 + length
    assert names[:2] == [b"IHDR", b"tEXt"] and b"Software\0tactape-fab" in data
    write_picture(path, PICTURE, "picture", compression=9)
    assert path.read_bytes() == data and is_own_picture(path)


@pytest.mark.parametrize("overwrite", [None, True])
@pytest.mark.parametrize("content", [b"", b"mine", cv2.imencode(".png", PICTURE)[1].tobytes()])
def test_what_is_no_picture_of_this_tool_is_kept(content: bytes, overwrite: bool | None, tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(content)
    with pytest.raises(SpecError, match=r"picture = .*a\.png is there and is no picture of this tool; nothing was touched"):
        write_picture(path, PICTURE, "picture", overwrite=overwrite)
    assert path.read_bytes() == content


def test_a_picture_that_cannot_be_encoded_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "imencode", lambda *_: (False, np.zeros(0, dtype=np.uint8)))
    with pytest.raises(RenderError, match="the picture could not be encoded as PNG"):
        write_picture(tmp_path / "a.png", PICTURE, "picture")
    assert not any(tmp_path.iterdir())


def test_a_picture_is_replaced_as_asked(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    write_picture(path, PICTURE, "picture", overwrite=False)
    with pytest.raises(SpecError, match="exists already; use --overwrite to replace it"):
        write_picture(path, PICTURE, "picture", overwrite=False)
    write_picture(path, 255 - PICTURE, "picture", overwrite=True)
    assert np.array_equal(np.asarray(cv2.imread(str(path))), 255 - PICTURE)
    with pytest.raises(SpecError, match=r"does not end with \.png"):
        refuse_picture(tmp_path / "a.jpg", "picture")


def test_a_folder_that_is_read_only_is_refused_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)  # root may write where others may not
    for folder in (tmp_path, tmp_path / "new" / "one"):
        said = r"^overlay = .* cannot be written: no file can be made in .*; use another folder$"
        with pytest.raises(TactapeError, match=said) as raised:
            refuse_pictures(folder, "frame-*.png", "overlay")
        assert not isinstance(raised.value, SpecError)  # which would end a command with the status of a refused value


def test_a_folder_is_refused_before_the_work(tmp_path: Path) -> None:
    refuse_pictures(tmp_path / "none", "frame-*.png", "overlay")
    write_picture(tmp_path / "frame-000000.png", PICTURE, "overlay")
    refuse_pictures(tmp_path, "frame-*.png", "overlay")
    (tmp_path / "frame-000007.png").write_bytes(b"a recording")
    for names in ("frame-*.png", ["frame-000007.png"]):
        with pytest.raises(SpecError, match=r"frame-000007\.png is there and is no picture of this tool"):
            refuse_pictures(tmp_path, names, "overlay")
    refuse_pictures(tmp_path, ["other.png"], "overlay")
    (tmp_path / "file").touch()
    with pytest.raises(SpecError, match="file is there and is no folder; nothing was touched; use another folder"):
        refuse_pictures(tmp_path / "file", "*.png", "overlay")
    with pytest.raises(SpecError, match="cannot be looked at: File name too long; use another folder"):
        refuse_pictures(tmp_path / ("n" * 300), "*.png", "overlay")
    with pytest.raises(TactapeError, match=r"cannot be written: .*; use another folder"):
        write_picture(tmp_path / "file" / "a" / "a.png", PICTURE, "overlay")
