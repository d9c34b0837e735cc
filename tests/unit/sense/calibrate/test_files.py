"""Files of a calibration: the profile is read back as it was found, pictures show what they say, poses are untrusted."""

from __future__ import annotations

import errno
import json
import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tactape_fab import SpecError
from tactape_fab.base.errors import TactapeError
from tactape_fab.sense import Calibration, calibrate_sensor, load_sensor
from tactape_fab.sense.calibrate.files import MARK, checked_output, write_profile
from tactape_fab.sense.calibrate.picture import draw_coverage, draw_residuals, write_pictures
from tactape_fab.sense.calibrate.posedness import empty_corners
from tests.thorough import costly, slow
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
