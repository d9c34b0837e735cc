"""Scans that are refused, each with its own words."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactape_fab import TapeSpec, make_kit
from tactape_fab.base.errors import SpecError
from tactape_fab.sense import inspect_scans
from tactape_fab.sense.inspect import scan_files
from tactape_fab.sense.inspect.colours import learn_palette
from tactape_fab.sense.inspect.warp import affine_warp
from tests.unit.sense.inspect.conftest import Scanned, write


def refusal(path: Path, kit: Path, *, dpi: float | None = None) -> str:
    with pytest.raises(SpecError) as error:
        inspect_scans(path, kit, dpi=dpi)
    (problem,) = error.value.problems
    assert str(path.name) in problem.message or "outside the scans" in problem.message
    return problem.message


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def bomb(width: int, height: int) -> bytes:
    """A PNG of so many black pixels, in a few hundred kilobytes."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows = zlib.compressobj(9)
    data = b"".join(rows.compress(bytes(width + 1)) for _ in range(height)) + rows.flush()
    return b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", header) + png_chunk(b"IDAT", data) + png_chunk(b"IEND", b"")


def test_another_tape_is_named_by_its_tag(scanned: Scanned, tmp_path: Path) -> None:
    other = make_kit(TapeSpec(sector=9, size_mm=(40.0, 30.0), models=False), tmp_path / "other")
    assert "it shows a tape with tag 7, and tactape-s009 has tag 9: another tape" in refusal(scanned.path, other.path)


def test_another_tape_is_named_by_its_code_where_tags_agree(scanned: Scanned, tmp_path: Path) -> None:
    other = make_kit(TapeSpec(sector=9, tag_id=7, size_mm=(40.0, 30.0), models=False), tmp_path / "other")
    assert "its parts are those of sector 7, and tactape-s009 is of sector 9: another tape" in refusal(scanned.path, other.path)


def test_a_tape_without_a_visible_tag_is_named_by_its_code(scanned: Scanned, tmp_path: Path) -> None:
    other = make_kit(TapeSpec(sector=9, size_mm=(40.0, 30.0), models=False), tmp_path / "other")
    cut = write(tmp_path / "cut.png", scanned.picture[:, scanned.picture.shape[1] // 4 :])
    assert "its parts are those of sector 7" in refusal(cut, other.path, dpi=1200)


@pytest.mark.parametrize("tagged", [True, False])
def test_a_mirrored_scan_is_named(scanned: Scanned, tmp_path: Path, tagged: bool) -> None:
    picture = scanned.picture if tagged else scanned.picture[:, scanned.picture.shape[1] // 4 :]
    mirrored = write(tmp_path / "mirrored.png", np.ascontiguousarray(picture[:, ::-1]))
    assert "it is mirrored" in refusal(mirrored, scanned.kit, dpi=1200)


def test_a_cropped_scan_says_which_parts_are_outside(scanned: Scanned, tmp_path: Path) -> None:
    cropped = write(tmp_path / "cropped.png", scanned.picture[:, : scanned.picture.shape[1] * 3 // 4])
    said = refusal(cropped, scanned.kit)
    assert "outside the scans: cropped" in said and "board x 31" in said


def test_jpeg_blocks_are_refused_by_the_header_and_in_pixels(scanned: Scanned, tmp_path: Path) -> None:
    poor = write(tmp_path / "poor.jpg", scanned.picture, cv2.IMWRITE_JPEG_QUALITY, 12)
    assert "JPEG of quality 12, below 30" in refusal(poor, scanned.kit)
    hidden = write(tmp_path / "poor.png", np.asarray(cv2.imread(str(poor)), dtype=np.uint8))
    assert "full of JPEG blocks" in refusal(hidden, scanned.kit)


def test_a_good_jpeg_serves(scanned: Scanned, tmp_path: Path) -> None:
    (one,) = inspect_scans(write(tmp_path / "good.jpg", scanned.picture, cv2.IMWRITE_JPEG_QUALITY, 90), scanned.kit)
    np.testing.assert_array_equal(one.present, scanned.built.present)


def test_an_empty_scan_is_named(scanned: Scanned, tmp_path: Path) -> None:
    lid = np.full((1200, 1800, 3), 236, np.uint8)
    assert "it is empty" in refusal(write(tmp_path / "lid.png", lid), scanned.kit)


def test_a_picture_of_something_else_is_named(scanned: Scanned, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    noise = write(tmp_path / "noise.png", rng.integers(0, 255, (900, 1500, 3), dtype=np.uint8))
    assert "no tag of the family tag36h11 is in it, and it does not say its dpi; give --dpi" in refusal(noise, scanned.kit)
    assert "spots are no parts of tactape-s007" in refusal(noise, scanned.kit, dpi=1200)


def test_a_bomb_is_refused_before_a_pixel_is_unpacked(scanned: Scanned, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unpacked(*_: object) -> None:
        raise AssertionError("pixels were unpacked")

    monkeypatch.setattr(scan_files, "_unpacked", unpacked)
    path = tmp_path / "bomb.png"
    path.write_bytes(bomb(16_000, 16_000))
    assert "it has 16000 x 16000 px, more than 250 million px" in refusal(path, scanned.kit)


@pytest.mark.parametrize("data", [b"", b"no picture at all", b"%PDF-1.4", b"\x80\x04\x95pickle", b"\x93NUMPY\x01\x00"])
def test_what_is_no_picture_is_named(scanned: Scanned, tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "scan.png"
    path.write_bytes(data)
    assert "it is no picture" in refusal(path, scanned.kit)


def test_a_damaged_picture_and_a_missing_one_are_named(scanned: Scanned, tmp_path: Path) -> None:
    path = tmp_path / "half.png"
    path.write_bytes(scanned.path.read_bytes()[:3000])
    assert "damaged" in refusal(path, scanned.kit)
    assert "cannot be read: No such file" in refusal(tmp_path / "none.png", scanned.kit)


def test_too_few_dpi_are_named(scanned: Scanned, tmp_path: Path) -> None:
    small = cv2.resize(scanned.picture, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    assert "it has 29" in refusal(write(tmp_path / "small.png", small), scanned.kit)
    assert "fewer than 559; scan at 600 dpi or more" in refusal(tmp_path / "small.png", scanned.kit)


def test_bodies_that_do_not_stand_out_are_named(scanned: Scanned) -> None:
    tape = scanned.tape
    warp = affine_warp([(47.0, 0.0), (0.0, -47.0)], (50.0, 1500.0), (20.0, 15.0), 20.0)
    faint = np.full((1600, 2000, 3), 120, np.uint8)
    with pytest.raises(SpecError, match="bodies do not stand out from the film: RGB 120, 120, 120 against RGB 120, 120, 120"):
        learn_palette(faint, warp, tape, np.ones(tape.part_count, dtype=bool))
