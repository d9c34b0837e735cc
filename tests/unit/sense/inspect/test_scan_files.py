"""Headers of scans."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from tactape_fab.base.errors import SpecError
from tactape_fab.sense.inspect.scan_files import read_header, read_scan

PICTURE = np.random.default_rng(0).integers(0, 255, (80, 120, 3), dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_size_and_dpi_are_read_from_the_header(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"scan{suffix}"
    Image.fromarray(PICTURE).save(path, dpi=(1200, 1200))
    picture, header = read_scan(path)
    assert (header.width_px, header.height_px, header.bits) == (120, 80, 8)
    assert header.dpi == pytest.approx(1200, abs=0.1)
    if suffix != ".jpg":
        np.testing.assert_array_equal(picture, PICTURE[..., ::-1])


@pytest.mark.parametrize("quality", [15, 35, 50, 75, 92])
def test_quality_of_a_jpeg_is_that_it_was_written_with(quality: int) -> None:
    data = cv2.imencode(".jpg", PICTURE, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    if quality < 30:
        with pytest.raises(SpecError, match=f"quality {quality}"):
            read_header(data)
    else:
        assert read_header(data).quality == pytest.approx(quality, abs=1.5)


def test_16_bits_a_channel_serve(tmp_path: Path) -> None:
    path = tmp_path / "deep.png"
    path.write_bytes(cv2.imencode(".png", PICTURE.astype(np.uint16) * 257)[1].tobytes())
    picture, header = read_scan(path)
    assert header.bits == 16
    assert np.abs(picture.astype(int) - PICTURE).max() <= 1


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_tiff_that_lies_on_its_side_serves(orientation: int, tmp_path: Path) -> None:
    """Orientation is that of TIFF 6.0, page 36."""
    Image.fromarray(PICTURE).save(tmp_path / "side.tif", tiffinfo={274: orientation})
    picture, _ = read_scan(tmp_path / "side.tif")
    assert sorted(picture.shape) == sorted(PICTURE.shape)


@pytest.mark.parametrize(
    "data",
    [
        b"\x89PNG\r\n\x1a\n",
        b"\xff\xd8\xff\xe0",
        b"II*\x00",
        b"II*\x00\xff\xff\xff\xff",
        b"MM\x00*\x00\x00\x00\x08\xff\xff",
        b"II*\x00" + struct.pack("<IH", 8, 3) + bytes(5),
    ],
)
def test_a_header_that_ends_early_is_refused(data: bytes) -> None:
    with pytest.raises(SpecError):
        read_header(data)


def test_every_prefix_of_a_file_is_read_or_refused() -> None:
    for suffix in (".png", ".jpg", ".tif"):
        data = cv2.imencode(suffix, PICTURE)[1].tobytes()
        for end in range(0, min(len(data), 700), 3):
            try:
                read_header(data[:end])
            except SpecError:
                continue


def test_a_small_file_of_many_pixels_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    written, data = cv2.imencode(".png", np.zeros((12_000, 14_000), dtype=np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert written and len(data) < 1_000_000
    (tmp_path / "scan.png").write_bytes(data.tobytes())
    with pytest.raises(SpecError, match="it shows next to nothing"):
        read_scan(tmp_path / "scan.png")
