"""Sensor profiles: those that come with the package, a user's own, their masks, and everything wrong in one message."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.base.templates import profile_names, templates_folder
from tactape_fab.sense import SensorProfile, load_sensor
from tests.png import png_chunk, png_of

GENERIC = (templates_folder() / "sensors" / "generic.toml").read_text()
Write = Callable[..., Path]


def png(grey: np.ndarray, orientation: int | None = None) -> bytes:
    """A grey PNG, written without the library that reads it; how it is to be turned is Exif's tag 274 in its chunk eXIf."""
    height, width = grey.shape
    rows = b"".join(b"\x00" + row.tobytes() for row in grey.astype(np.uint8))
    tag = b"" if orientation is None else b"II*\x00" + struct.pack("<IHHHIII", 8, 1, 274, 3, 1, orientation, 0)
    return png_of(width, height, zlib.compress(rows), more=png_chunk(b"eXIf", tag) if tag else b"")


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """A profile like generic with lines replaced, and the files beside it."""

    def profile(*changes: tuple[str, str], **files: bytes) -> Path:
        text = GENERIC
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        for name, data in files.items():
            (tmp_path / f"{name}.png").write_bytes(data)
        path = tmp_path / "mine.toml"
        path.write_text(text)
        return path

    return profile


def masked(value: str) -> tuple[str, str]:
    return "[image]\n", f"[image]\nmask = {value}\n"


def test_the_sensors_that_come_with_the_package() -> None:
    mini = load_sensor("gelsight-mini")
    assert (mini.width_px, mini.height_px, mini.px_per_mm) == (320, 240, (16.0, 16.0))
    assert (mini.sign, mini.mirror, mini.rotate90, mini.depth_unit_mm, mini.mask) == (1, False, 0, 1.0, None)
    for px_per_mm in (16.0, 1 / 0.0634):  # the paper's figure and that of gs_sdk
        assert abs(px_per_mm / mini.px_per_mm[0] - 1) < mini.scale_tolerance
    assert mini.centre_px.tolist() == [159.5, 119.5]
    digit = load_sensor("digit")
    assert digit.frame_shape == (320, 240)
    assert digit.depth_unit_mm is None
    generic = load_sensor("generic")
    assert (generic.width_px / generic.px_per_mm[0], generic.height_px / generic.px_per_mm[1]) == (20.0, 15.0)
    assert all(load_sensor(n).name == n for n in profile_names("sensors"))


def test_a_users_own_profile_by_path(write: Write) -> None:
    path = write(("rotate90 = 0", "rotate90 = 1"), ("mirror = false", "mirror = true"), ("sign = 1", "sign = -1"))
    sensor = load_sensor(path)
    assert isinstance(sensor, SensorProfile)
    assert (sensor.sign, sensor.mirror, sensor.rotate90) == (-1, True, 1)
    assert sensor.frame_shape == (320, 240)
    with_unit = load_sensor(write(("# [depth]\n# unit_mm = 1.0 ", "[depth]\nunit_mm = 0.0634 #")))
    assert with_unit.depth_unit_mm == 0.0634


def test_a_profile_s_file_may_end_in_capitals(write: Write) -> None:
    path = write()
    capitals = path.rename(path.with_suffix(".TOML"))
    assert load_sensor(str(capitals)).name == load_sensor(capitals).name == "generic"


def test_canonical_is_sign_then_mirror_then_quarter_turns_counter_clockwise(write: Write) -> None:
    path = write(("rotate90 = 0", "rotate90 = 1"), ("mirror = false", "mirror = true"), ("sign = 1", "sign = -1"))
    frame = np.array([[1, 2, 3], [4, 5, 6]], dtype=np.float32)
    assert load_sensor(path).canonical(frame).tolist() == [[-1, -4], [-2, -5], [-3, -6]]
    turned = load_sensor(write(("rotate90 = 0", "rotate90 = 1")))
    assert turned.canonical(frame).tolist() == [[3, 6], [2, 5], [1, 4]]
    upright = load_sensor("generic")
    assert np.shares_memory(upright.canonical(frame), frame)


def test_masks_of_all_kinds(write: Write) -> None:
    ellipse = load_sensor(write(masked('"ellipse"'))).mask
    assert ellipse is not None
    assert ellipse.shape == (240, 320)
    assert ellipse.mean() == pytest.approx(np.pi / 4, abs=1e-3)
    assert not ellipse[0, 0]
    assert ellipse[120, 0] == ellipse[120, 319] == ellipse[0, 160] == ellipse[239, 160] == True  # noqa: E712
    border = load_sensor(write(masked("8"))).mask
    assert border is not None
    assert border.sum() == (240 - 16) * (320 - 16)
    assert border[8, 8]
    assert not border[7, 160]
    whole = load_sensor(write(masked("0"))).mask
    assert whole is not None
    assert whole.all()
    with pytest.raises(ValueError, match="read-only"):
        whole[0, 0] = False


def test_a_mask_drawn_on_a_frame_is_turned_as_the_frame(write: Write) -> None:
    grey = np.full((320, 240), 255, dtype=np.uint8)  # what a sensor turned by 90 degrees delivers
    grey[:5, :10] = 0
    path = write(masked('"mask.png"'), ("rotate90 = 0", "rotate90 = 1"), mask=png(grey))
    sensor = load_sensor(path)
    assert sensor.mask is not None
    assert (~sensor.mask).sum() == 50
    assert not sensor.mask[-10:, :5].any()


@pytest.mark.parametrize("orientation", [1, 2, 3, 6])
def test_a_mask_is_read_as_it_is_stored(write: Write, orientation: int) -> None:
    grey = np.full((240, 320), 255, dtype=np.uint8)
    grey[:5, :10] = 0
    sensor = load_sensor(write(masked('"mask.png"'), mask=png(grey, orientation)))
    np.testing.assert_array_equal(sensor.mask, grey > 0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"GIF89a", "is no PNG"),
        (b"", "is no PNG"),
        (png(np.full((10, 10), 255)), "is 10 x 10 px, a frame is 320 x 240"),
        (png(np.full((240, 320), 255))[:60], "cannot be unpacked"),
        (png(np.zeros((240, 320))), "leaves no pixel"),
    ],
)
def test_a_bad_mask_is_refused_in_words(write: Write, data: bytes, words: str) -> None:
    with pytest.raises(SpecError) as error:
        load_sensor(write(masked('"mask.png"'), mask=data))
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (masked('"square"'), 'give "ellipse", a border in px, or the path of a .png'),
        (masked("200"), "is not below 120 px"),
        (masked("-1"), "is below 0 px"),
        (masked('"none.png"'), "cannot be opened"),
        (("width_px = 320", "width_px = 1"), "width_px = 1 is outside 16 to 4096"),
        (("px_per_mm = [16.0, 16.0]", "px_per_mm = 16.0"), "is not 2 numbers"),
        (("px_per_mm = [16.0, 16.0]", "px_per_mm = [16.0, 0.0]"), "px_per_mm[1] = 0 px/mm is below 1 px/mm"),
        (("sign = 1", "sign = 0"), "sign = 0 is neither 1 nor -1"),
        (("sign = 1", "sign = true"), "sign = True is neither 1 nor -1"),
        (("sign = 1", ""), "sign = None is neither 1 nor -1"),
        (("rotate90 = 0", "rotate90 = 90"), "rotate90 = 90 is outside 0 to 3"),
        (("mirror = false", "mirror = 1"), "neither true nor false"),
        (("scale_tolerance = 0.10", "scale_tolerance = 0.9"), "exceeds 0.5"),
        (("white_um = 4.0", "white_um = nan"), "not a finite number"),
        (("white_um = 4.0", "wite_um = 4.0"), "did you mean 'white_um'?"),
        (("# [depth]\n# unit_mm = 1.0 ", "[depth]\nunit_mm = 0.0 #"), "unit_mm = 0 mm is below 1e-09 mm"),
        (("# [depth]\n# unit_mm = 1.0 ", "[depth]\nunit_mm = 1e-300 #"), "unit_mm = 1e-300 mm is below 1e-09 mm"),
    ],
)
def test_a_bad_value_is_refused_in_words(write: Write, change: tuple[str, str], words: str) -> None:
    with pytest.raises(SpecError) as error:
        load_sensor(write(change))
    assert words in str(error.value)


def test_all_problems_of_a_profile_come_together(write: Write) -> None:
    with pytest.raises(SpecError) as error:
        load_sensor(write(("width_px = 320", "width_px = 0"), ("sign = 1", "sign = 2"), ("white_um = 4.0", "white_um = -1.0")))
    assert [p.key for p in error.value.problems] == [
        "sensor mine: image.width_px",
        "sensor mine: orientation.sign",
        "sensor mine: noise.white_um",
    ]


def test_nothing_is_held_against_a_size_that_is_refused(write: Write) -> None:
    camera = ("[orientation]", "[geometry]\ncenter_px = [159.5, 119.5]\n\n[orientation]")
    with pytest.raises(SpecError) as error:
        load_sensor(write(("width_px = 320", "width_px = 320.0"), masked("10"), camera))
    assert [p.key for p in error.value.problems] == ["sensor mine: image.width_px"]


def test_an_unknown_name_lists_the_known() -> None:
    with pytest.raises(SpecError, match=f"sensor = 'gelsight' is none of: {', '.join(profile_names('sensors'))}"):
        load_sensor("gelsight")
    with pytest.raises(SpecError, match="cannot be opened"):
        load_sensor("no-such-file.toml")


def test_a_profile_says_the_blur_of_its_gel(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    text = (templates_folder() / "sensors" / "gelsight-mini.toml").read_text(encoding="utf-8").partition("\n[gel]")[0]
    path.write_text(text + "\n[gel]\nblur_mm = 0.12\n", encoding="utf-8")
    assert load_sensor(path).gel.blur_mm == 0.12
    path.write_text(text + "\n[gel]\nblur_mm = 0.0\n", encoding="utf-8")
    with pytest.raises(SpecError, match="blur_mm"):
        load_sensor(path)
    assert load_sensor("gelsight-mini").gel.blur_mm is None


def test_a_profile_has_a_mask_of_its_own() -> None:
    mask = np.ones((240, 320), dtype=bool)
    profile = replace(load_sensor("generic"), mask=mask)
    mask[:] = False
    assert profile.mask is not None and profile.mask.all() and not profile.mask.flags.writeable
    assert replace(profile, name="other").mask is profile.mask
