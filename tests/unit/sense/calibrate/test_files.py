"""Files of a calibration: the profile is read back as it was found, pictures show what they say, poses are untrusted."""

from __future__ import annotations

import errno
import json
import os
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tactape_fab import SpecError
from tactape_fab.base.errors import TactapeError
from tactape_fab.sense import Calibration, calibrate_sensor, load_sensor
from tactape_fab.sense.calibrate.files import MARK, checked_output, profile_text, write_profile
from tactape_fab.sense.calibrate.picture import draw_coverage, draw_residuals, write_pictures
from tactape_fab.sense.calibrate.posedness import empty_corners
from tactape_fab.sense.calibrate.result import HeldOut
from tactape_fab.sense.geometry import Gel
from tests.thorough import costly, slow
from tests.unit.sense.calibrate.by_hand import calibration
from tests.unit.sense.calibrate.sensors import STOCK, TAPE, presses


@cache
def blind_left() -> Calibration:
    """A sensor with a blind border at the left."""
    frames = [frame.copy() for frame in presses(14).frames]
    for frame in frames:
        frame[:, :16] = 0.0
    return calibrate_sensor(frames, [TAPE], STOCK, name="mine")


@slow
def test_the_profile_is_read_back_as_it_was_found(tmp_path: Path) -> None:
    found = blind_left()
    files = write_profile(tmp_path / "mine.toml", found)
    assert [file.name for file in files] == ["mine-mask.png", "mine.toml"] == sorted(p.name for p in tmp_path.iterdir())
    read, made = load_sensor(tmp_path / "mine.toml"), found.sensor
    assert (read.name, read.width_px, read.height_px, read.sign, read.mirror) == ("mine", 320, 240, 1, False)
    assert np.allclose(read.px_per_mm, made.px_per_mm, rtol=1e-5) and np.array_equal(read.mask, made.mask)  # type: ignore[arg-type]
    for key in ("aspect", "shear", "k1", "center_px", "sigma_px_per_mm", "sigma_aspect", "sigma_shear", "sigma_k1"):
        assert np.allclose(getattr(read.geometry, key), getattr(made.geometry, key), rtol=1e-5), key
    assert np.allclose([read.slope_noise or 0, read.gel.blur_mm or 0], [made.slope_noise or 0, made.gel.blur_mm or 0], rtol=1e-4)
    assert (read.gel.poisson, read.gel.crown_mm) == (STOCK.gel.poisson, STOCK.gel.crown_mm) == (0.485, (189.0, 113.0))
    text = (tmp_path / "mine.toml").read_text()
    assert text.startswith(MARK) and all(f"# {q.name} = " in text for q in found.quantities)
    json.dumps(found.to_mapping(), allow_nan=False)


@costly
@pytest.mark.parametrize("most", [100, 60_000])
def test_frames_of_whole_numbers_make_a_profile_that_is_read_back(most: int, tmp_path: Path) -> None:
    low, high = (float(end([end(frame) for frame in presses(7).frames])) for end in (np.min, np.max))
    frames = [np.rint((frame - low) / (high - low) * most).astype(np.uint16) for frame in presses(7).frames]
    found = calibrate_sensor(frames, [TAPE], "generic", name="mine")
    write_profile(tmp_path / "mine.toml", found)
    read, like = load_sensor(tmp_path / "mine.toml"), load_sensor("generic")
    assert (read.slope_noise, read.white_um, read.correlated_um) == (like.slope_noise, like.white_um, like.correlated_um)
    assert any("noise of 'generic'" in remark for remark in found.remarks)
    assert next(q.value for q in found.quantities if q.name == "noise_slope") > 1.0


def test_an_older_profile_keeps_its_mask_where_a_new_one_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("mine-mask.png", "mine.toml"):
        (tmp_path / name).write_bytes(b"older")
    write = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if path.suffix == ".toml":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(TactapeError, match="No space left on device; what stood there is as it was"):
        write_profile(tmp_path / "mine.toml", blind_left())
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"mine-mask.png": b"older", "mine.toml": b"older"}


def test_a_profile_gets_its_name_when_the_disk_has_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a power cut there must be no profile that is empty, or whose mask is."""
    for name in ("mine-mask.png", "mine.toml"):
        (tmp_path / name).write_bytes(b"older")

    def lost(_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fsync", lost)
    with pytest.raises(TactapeError, match="Input/output error; what stood there is as it was"):
        write_profile(tmp_path / "mine.toml", blind_left())
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"mine-mask.png": b"older", "mine.toml": b"older"}


def test_only_a_calibrated_profile_is_replaced(tmp_path: Path) -> None:
    assert checked_output(tmp_path / "new.toml") == tmp_path / "new.toml"
    (tmp_path / "ours.toml").write_text(MARK + " from 10 presses\n")
    assert checked_output(tmp_path / "ours.toml").name == "ours.toml"
    (tmp_path / "theirs.toml").write_text('name = "hand-made"\n')
    for name, words in (
        ("theirs.toml", "is there and is no calibrated profile; nothing was touched; use another name"),
        ("sensor.json", "is no .toml file"),
        ("none/sensor.toml", "there is no folder of that name; make it first"),
    ):
        with pytest.raises(SpecError, match=words):
            checked_output(tmp_path / name)


def test_pictures_show_dots_and_residuals(tmp_path: Path) -> None:
    found = blind_left()
    paths = write_pictures(tmp_path / "pictures", found)
    assert [path.name for path in paths] == ["coverage.png", "residuals.png"] and all(
        path.stat().st_size > 5000 for path in paths
    )
    assert draw_coverage(found).shape == draw_residuals(found).shape == (776, 960, 3)
    assert empty_corners(found.presses, found.sensor) == []
    left = [press for press in found.presses if press.seen_px[:, 0].max() < 240.0]
    assert "upper right" in empty_corners(left, found.sensor)


# By hand


def test_what_a_profile_says_stands_in_it_as_comments_and_keys() -> None:
    text = profile_text(calibration(held_out=HeldOut(inside_um=1.234, outside_um=2.341, folds=4)), "mine-mask.png")
    head, _, rest = text.partition("\n\n")
    assert head.splitlines() == [
        "# Calibrated by tactape-fab from 2 presses of 5 frames, 5 dots; docs/calibrate.md",
        "#",
        "# k1 = 0.03 +- 0.0013   (a note)",
        "# scale = 15.5 px/mm",
        "# x = 1",
        "# dots scatter by 1.23 um in the adjustment, 2.34 um in presses left out of it",
        "# press more often",
    ]
    assert "mask" not in text and "depth" not in rest and "slope" not in text
    assert rest.startswith('name = "mine"\ntitle = "My \\"sensor\\""\n\n[image]\n')
    assert "px_per_mm = [15.12346, 16.0]" in rest and "rotate90 = 3" in rest and "mirror = true" in rest
    assert "dots scatter" not in profile_text(calibration(), "")


@pytest.mark.parametrize("given", [False, True])
def test_every_key_of_a_profile_is_read_back(given: bool, tmp_path: Path) -> None:
    found = calibration()
    if given:
        geometry = replace(found.sensor.geometry, center_px=(19.123456789, 14.5), sigma_px_per_mm=0.01, sigma_k1=0.05)
        gel = Gel(displacement_um=20.0, correlation_mm=3.0, thickness_mm=4.0, modulus_kpa=100.0, crown_mm=(189.123, 113.0))
        sensor = replace(found.sensor, depth_unit_mm=0.001, slope_noise=0.02, geometry=geometry, gel=gel)
        found = calibration(sensor=sensor)
    made = found.sensor
    assert write_profile(tmp_path / "mine.toml", found) == [tmp_path / "mine.toml"]
    assert [at.name for at in tmp_path.iterdir()] == ["mine.toml"]
    read = load_sensor(tmp_path / "mine.toml")
    for key in ("name", "title", "width_px", "height_px", "sign", "mirror", "rotate90", "depth_unit_mm", "slope_noise", "mask"):
        assert getattr(read, key) == getattr(made, key), key
    for key in ("px_per_mm", "white_um", "correlated_um", "correlated_px", "scale_tolerance"):
        assert getattr(read, key) == pytest.approx(getattr(made, key), rel=1e-6), key
    # a lens that is not known has the largest error that a profile may say
    assert read.geometry.sigma_k1 == (0.05 if given else 0.2)
    assert replace(read.geometry, sigma_k1=0.0, center_px=None) == replace(made.geometry, sigma_k1=0.0, center_px=None)
    assert read.geometry.center_px == (pytest.approx((19.12346, 14.5), abs=1e-6) if given else None)
    assert read.gel == replace(made.gel)


def test_a_mask_and_a_hand_eye_answer_stand_beside_the_profile(tmp_path: Path) -> None:
    valid = np.ones((40, 30), dtype=bool)  # of a frame that is turned by 90 degrees
    valid[:4] = False
    hand_eye = SimpleNamespace(to_mapping=lambda: {"tape": "t"})
    files = write_profile(tmp_path / "mine.toml", calibration(valid=valid, hand_eye=hand_eye))
    assert {at.name for at in files} == {at.name for at in tmp_path.iterdir()}
    assert [at.name for at in files] == ["mine-mask.png", "mine-hand-eye.json", "mine.toml"]
    text = (tmp_path / "mine-hand-eye.json").read_text()
    assert text == '{\n "tape": "t"\n}\n'
    mask = cv2.imread(str(tmp_path / "mine-mask.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None and np.array_equal(mask, np.where(valid, 255, 0))
    assert 'mask = "mine-mask.png"' in (tmp_path / "mine.toml").read_text()
    read = load_sensor(tmp_path / "mine.toml")
    assert read.mask is not None and (~read.mask).sum() == 4 * 30
    for name in ("mine-mask.png", "mine-hand-eye.json"):  # where they are without a profile they are somebody else's
        other = tmp_path / "other.toml"
        beside = tmp_path / name.replace("mine", "other")
        beside.write_bytes(b"theirs")
        with pytest.raises(SpecError, match=rf"{beside.name} exists already; nothing was touched"):
            checked_output(other)
        beside.unlink()
    assert checked_output(tmp_path / "mine.toml") == tmp_path / "mine.toml"


def test_a_profile_that_cannot_be_read_is_not_kept(tmp_path: Path) -> None:
    bad = calibration(sensor=replace(calibration().sensor, scale_tolerance=7.0))
    with pytest.raises(TactapeError):
        write_profile(tmp_path / "mine.toml", bad)
    assert list(tmp_path.iterdir()) == []
