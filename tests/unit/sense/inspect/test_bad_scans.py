"""Scans that are refused, each with its own words."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from tactape_fab import TapeSpec, make_kit
from tactape_fab.base.errors import SpecError
from tactape_fab.sense import inspect_scans
from tactape_fab.sense.inspect import scan_files
from tactape_fab.sense.inspect.colours import learn_palette
from tactape_fab.sense.inspect.warp import affine_warp
from tests.png import black_png
from tests.scans import Picture
from tests.thorough import costly
from tests.unit.sense.inspect.conftest import Scanned, write


def refusal(path: Path, kit: Path, *, dpi: float | None = None) -> str:
    with pytest.raises(SpecError) as error:
        inspect_scans(path, kit, dpi=dpi)
    (problem,) = error.value.problems
    assert str(path.name) in problem.message or "outside the scans" in problem.message
    return problem.message


def png(picture: Picture) -> bytes:
    return bytes(cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


def jpeg(picture: Picture, quality: int) -> bytes:
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def untagged(picture: Picture) -> Picture:
    return picture[:, picture.shape[1] // 4 :]


def mirrored(picture: Picture) -> Picture:
    return np.ascontiguousarray(picture[:, ::-1])


def noise(_: Picture) -> bytes:
    return png(np.random.default_rng(0).integers(0, 255, (900, 1500, 3), dtype=np.uint8))


def shrunk(picture: Picture) -> bytes:
    return png(np.asarray(cv2.resize(picture, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA), dtype=np.uint8))


def blocks_as_png(picture: Picture) -> bytes:
    return png(np.asarray(cv2.imdecode(np.frombuffer(jpeg(picture, 12), dtype=np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8))


def one_bit(picture: Picture) -> bytes:
    """Without the tag of bits a sample, of which TIFF 6.0 (section 8) says that there is one then."""
    out = BytesIO()
    Image.fromarray(picture).convert("1").save(out, "TIFF")
    return out.getvalue()


def brighter(picture: Picture, times: float, plus: float = 0.0) -> Picture:
    return np.asarray(np.clip(picture.astype(np.float32) * times + plus, 0, 255), dtype=np.uint8)


THIS, OTHER, SAME_TAG = "this", "other", "other with the same tag"
BAD: dict[str, tuple[Callable[[Picture], bytes], str, float | None, str]] = {
    "another tape, by its tag": (png, OTHER, None, "it shows a tape with tag 7, and tactape-s009 has tag 9: another tape"),
    "another tape of that tag": (
        png,
        SAME_TAG,
        None,
        "its parts are those of sector 7, and tactape-s009 is of sector 9: another tape",
    ),
    "another tape, no tag in view": (lambda p: png(untagged(p)), OTHER, 1200, "its parts are those of sector 7"),
    "wrong side": (lambda p: png(mirrored(p)), THIS, 1200, "it is mirrored: its tag can be read in a mirror alone"),
    "wrong side, no tag in view": (lambda p: png(mirrored(untagged(p))), THIS, 1200, "it is mirrored"),
    "cropped": (lambda p: png(p[:, : p.shape[1] * 3 // 4]), THIS, None, "outside the scans: cropped"),
    "cropped at the top": (lambda p: png(p[p.shape[0] // 3 :]), THIS, 1200, "outside the scans: cropped"),
    "JPEG of low quality": (lambda p: jpeg(p, 12), THIS, None, "JPEG of quality 12, below 30"),
    "JPEG blocks saved as PNG": (blocks_as_png, THIS, None, "full of JPEG blocks"),
    "over-exposed": (lambda p: png(brighter(p, 2.0)), THIS, None, "is white, more than 50%, so edges are not where they seem"),
    "over-exposed, no tag can be read": (lambda p: png(brighter(p, 3.0, 120.0)), THIS, 1200, "it is over-exposed: 100% of the"),
    "empty lid": (lambda p: png(np.full((1200, 1800, 3), 236, np.uint8)), THIS, None, "it is empty"),
    "black": (lambda p: png(np.zeros((1200, 1800, 3), np.uint8)), THIS, 1200, "it is empty"),
    "noise of no dpi": (noise, THIS, None, "no tag of the family tag36h11 is in it, and it does not say its dpi; give dpi=N"),
    "noise": (noise, THIS, 1200, "spots are no parts of tactape-s007"),
    "1200 x 600 dpi": (lambda p: png(np.ascontiguousarray(p[::2])), THIS, 1200, "at as many dpi across as along"),
    "too few dpi": (shrunk, THIS, None, "fewer than 559; scan at 600 dpi or more"),
    "no bytes": (lambda _: b"", THIS, None, "it is no TIFF, PNG or JPEG"),
    "text": (lambda _: b"no picture at all", THIS, None, "it is no TIFF, PNG or JPEG"),
    "PDF": (lambda _: b"%PDF-1.4", THIS, None, "it is no TIFF, PNG or JPEG"),
    "pickle": (lambda _: b"\x80\x04\x95pickle", THIS, None, "it is no TIFF, PNG or JPEG"),
    "numpy": (lambda _: b"\x93NUMPY\x01\x00", THIS, None, "it is no TIFF, PNG or JPEG"),
    "BigTIFF": (lambda _: b"II+\x00\x08\x00", THIS, None, "it is a BigTIFF; give a scan as TIFF, PNG or JPEG"),
    "TIFF of one bit": (one_bit, THIS, None, "it has 1 bits a channel; give a scan as TIFF, PNG or JPEG with 8 or 16"),
    "cut off": (lambda p: png(p)[:3000], THIS, None, "damaged"),
    "tiny": (lambda p: png(p[:40, :40]), THIS, None, "it has 40 x 40 px; give a scan of 600 to 4800 dpi"),
    "16k x 16k bomb": (
        lambda _: black_png(16_000, 16_000),
        THIS,
        None,
        "it has 16000 x 16000 px, more than 250 million px",
    ),
}


@pytest.fixture(scope="module")
def others(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Kits of other tapes, the second with the scanned one's tag."""
    folder = tmp_path_factory.mktemp("others")
    return {
        name: make_kit(TapeSpec(sector=9, tag_id=tag, size_mm=(40.0, 30.0), models=False), folder / str(tag)).path
        for name, tag in ((OTHER, None), (SAME_TAG, 7))
    }


@costly
@pytest.mark.parametrize("case", BAD)
def test_bad_scans_are_refused_in_words(scanned: Scanned, others: dict[str, Path], tmp_path: Path, case: str) -> None:
    made, kit, dpi, words = BAD[case]
    path = tmp_path / "scan.png"
    path.write_bytes(made(scanned.picture))
    assert words in refusal(path, {THIS: scanned.kit, **others}[kit], dpi=dpi)


def test_a_cropped_scan_says_which_parts_are_outside(scanned: Scanned, tmp_path: Path) -> None:
    cropped = write(tmp_path / "cropped.png", scanned.picture[:, : scanned.picture.shape[1] * 3 // 4])
    assert "board x 31" in refusal(cropped, scanned.kit)


def test_a_scan_that_is_not_there_is_named(scanned: Scanned, tmp_path: Path) -> None:
    assert "cannot be read: No such file" in refusal(tmp_path / "none.png", scanned.kit)


def test_a_good_jpeg_serves(scanned: Scanned, tmp_path: Path) -> None:
    (one,) = inspect_scans(write(tmp_path / "good.jpg", scanned.picture, cv2.IMWRITE_JPEG_QUALITY, 90), scanned.kit)
    np.testing.assert_array_equal(one.present, scanned.built.present)


def test_a_bright_scan_whose_metal_glares_serves(scanned: Scanned, tmp_path: Path) -> None:
    """A third of the metal is white, and nearly all film in its red channel."""
    (one,) = inspect_scans(write(tmp_path / "bright.png", brighter(scanned.picture, 1.5)), scanned.kit)
    np.testing.assert_array_equal(one.present, scanned.built.present)
    assert len(one.foreign_mm) == len(scanned.built.specks) and not one.covered.any()


def test_a_bomb_is_refused_before_a_pixel_is_unpacked(scanned: Scanned, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unpacked(*_: object) -> None:
        raise AssertionError("pixels were unpacked")

    monkeypatch.setattr(scan_files, "_unpacked", unpacked)
    path = tmp_path / "bomb.png"
    path.write_bytes(black_png(16_000, 16_000))
    assert "it has 16000 x 16000 px, more than 250 million px" in refusal(path, scanned.kit)


def test_bodies_that_do_not_stand_out_are_named(scanned: Scanned) -> None:
    tape = scanned.tape
    warp = affine_warp([(47.0, 0.0), (0.0, -47.0)], (50.0, 1500.0), (20.0, 15.0), 20.0)
    faint = np.full((1600, 2000, 3), 120, np.uint8)
    with pytest.raises(SpecError, match="bodies do not stand out from the film: RGB 120, 120, 120 against RGB 120, 120, 120"):
        learn_palette(faint, warp, tape, np.ones(tape.part_count, dtype=bool))
