"""What a picture's header says before it is unpacked is what the library that unpacks it finds there."""

from __future__ import annotations

import resource
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.base.image_file import TiffDirectory, chunks_fit, jpeg_frame, jpeg_segments
from tactape_fab.sense.inspect.scan_files import read_scan
from tactape_fab.sense.raw.image_files import read_colour, read_picture

PNG = cv2.imencode(".png", np.arange(96, dtype=np.uint16).reshape(8, 12))[1].tobytes()


def test_chunks_of_a_whole_file_fit() -> None:
    assert chunks_fit(PNG) and chunks_fit(PNG + b"more") and chunks_fit(b"") and chunks_fit(b"\xff\xd8")


@pytest.mark.parametrize("end", range(8, len(PNG)))
def test_a_file_that_is_cut_off_is_told(end: int) -> None:
    assert not chunks_fit(PNG[:end])


def test_a_length_of_4_gb_costs_nothing(tmp_path: Path) -> None:
    at = PNG.index(b"IDAT") - 4
    (tmp_path / "a.png").write_bytes(PNG[:at] + b"\xff\x7f\xff\xff" + PNG[at + 4 :])  # found by fuzzing: 4.3 GB
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(SpecError, match="it is damaged and cannot be unpacked"):
        read_picture(tmp_path / "a.png")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 100_000


def with_two_sizes(marker: bytes) -> bytes:
    """A JPEG of 30,000 x 30,000 px for libjpeg, and of 64 x 64 px for who takes what follows the marker for a length."""
    whole = cv2.imencode(".jpg", np.zeros((64, 64, 3), dtype=np.uint8))[1].tobytes()
    at = whole.index(b"\xff\xc0")
    frame = whole[at : at + 19]
    vast = frame[:5] + struct.pack(">HH", 30_000, 30_000) + frame[9:]
    data = b"\xff\xd8" + marker + whole[2:at] + vast + whole[at + 19 : -2]
    return data.ljust(2 + 2 + 0xFFE0, b"\0") + frame + b"\xff\xd9"


@pytest.mark.parametrize("marker", [b"\xff\xd0", b"\xff\x01", b"\xff\x00"])
@pytest.mark.parametrize("read", [read_colour, read_scan])
def test_no_marker_without_length_hides_the_frame_of_a_jpeg(
    marker: bytes, read: Callable[[Path], object], tmp_path: Path
) -> None:
    data = with_two_sizes(marker)
    assert [jpeg_frame(kind, data, at) for kind, at in jpeg_segments(data) if jpeg_frame(kind, data, at)] == []
    (tmp_path / "a.jpg").write_bytes(data)
    with pytest.raises(SpecError, match="it is a JPEG without a picture"):
        read(tmp_path / "a.jpg")


def tiff(*entries: tuple[int, int, int]) -> bytes:
    """A TIFF's first directory, of (tag, type, value)."""
    rows = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries)
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + rows + bytes(8)


def test_a_tag_of_a_tiff_has_one_value() -> None:
    directory = TiffDirectory(tiff((256, 3, 64), (257, 4, 70_000)), "write it anew")
    assert (directory.value(256), directory.value(257)) == (64, 70_000)
    with pytest.raises(SpecError, match="its header has a tag twice; write it anew"):
        TiffDirectory(tiff((256, 4, 30_000), (256, 4, 64)), "write it anew")  # libtiff takes the first
    with pytest.raises(SpecError, match="tag 256 in its header is of type 16, no whole number"):
        TiffDirectory(tiff((256, 16, 64)), "write it anew").value(256)  # eight bytes elsewhere, and the entry their place


def test_a_file_that_is_too_large_is_told_what_to_give(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactape_fab.sense.raw.image_files._MOST_BYTES", 9)
    (tmp_path / "a.png").write_bytes(bytes(10))
    for read, remedy in ((read_colour, "give a PNG or JPEG with three channels"), (read_picture, "write it with one channel")):
        with pytest.raises(SpecError, match=f"larger than 9 bytes; {remedy}"):
            read(tmp_path / "a.png")
