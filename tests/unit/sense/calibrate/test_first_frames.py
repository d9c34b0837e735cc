"""First frames: every fault of frames or profile is named with its remedy, and good ones are left alone."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import SpecError
from tactape_fab.sense import Scene, SensorProfile, calibrate_sensor, iterate_frames
from tactape_fab.sense.calibrate.first_frames import _named, _of_values, look_at_frames
from tactape_fab.sense.calibrate.orientation import fitted_size
from tactape_fab.sense.calibrate.presses import Frame
from tests.tapes import tape_at
from tests.unit.sense.calibrate.sensors import STOCK, TAPE, TRUE, presses


def good() -> list[Frame]:
    """Seven presses, simulated by the first test that asks: every worker collects these tests."""
    return presses(7).frames


def said(frames: list[Frame], like: SensorProfile = TRUE) -> str:
    return " | ".join(look_at_frames(frames, [TAPE], like).wrong)


def test_good_frames_are_left_alone() -> None:
    found = look_at_frames(good(), [TAPE], TRUE)
    assert found.wrong == () and [look.located for look in found.frames] == [True] * 7
    assert found.next_step == "7 of 7 frames are located: run tactape-fab calibrate with them"
    assert min(look.dots for look in found.frames) > 15
    assert set(found.to_mapping()) == {"frames", "wrong", "next_step"}


def test_one_press_given_many_times_is_one() -> None:
    """Its pixels never change: by a profile with a mask all were blind, and calibrate asked to press harder."""
    rim = np.pad(np.ones((220, 300), dtype=bool), 10)
    frames = [np.where(rim, good()[0], 0.0)] * 12
    masked = replace(TRUE, mask=rim)
    found = look_at_frames(frames, [TAPE], masked)
    assert [look.located for look in found.frames] == [True] * 12 and "11 frames are the same" in found.wrong[0]
    assert found.next_step.startswith("1 of 1 frames are located; press the tape some ten times")
    with pytest.raises(SpecError, match=r"^only 1 press of 12 frames can be used.*what is there twice counts once"):
        calibrate_sensor(frames, [TAPE], masked)


def test_frames_of_presses_that_are_held_are_no_presses_of_their_own() -> None:
    """Seven of three presses were sent on to calibrate, which needs six presses."""
    rng = np.random.default_rng(1)
    frames = [f + rng.normal(0.0, 5e-4, f.shape).astype(np.float32) for f in (*good()[:3], *good()[:3], good()[0])]
    assert look_at_frames(frames, [TAPE], TRUE).next_step.startswith(
        "7 of 7 frames are located, at 3 places; press the tape some"
    )
    assert look_at_frames([frames[0], frames[3]], [TAPE], TRUE).next_step.startswith(
        "2 of 2 frames are located, all at one place;"
    )


def test_frames_of_two_kinds_are_told_apart() -> None:
    """Presses of a recording that is mirrored from some frame on: more presses would not help, and the remedy does as typed."""
    frames = [*good(), *(frame[:, ::-1] for frame in good())]
    found = look_at_frames(frames[3:11], [TAPE], TRUE)
    what = "the frame is mirrored: it shows tape-7 from behind, mostly"
    assert found.wrong == (
        f"4 of 8 frames are located, and 4 would be by another profile ({what}): no profile fits both; give the frames of one "
        "kind alone, 6 presses or more",
    )
    assert "frames of one kind alone" in found.next_step and "press the tape" not in found.next_step
    with pytest.raises(SpecError, match=r"^only 4 presses of 8 .*4 would be by another profile .*; give the frames of one kind"):
        calibrate_sensor(frames[3:11], [TAPE], TRUE)
    # those of one kind are enough, and that the others are left out is said
    for some, left_out in ((frames[:9], True), (frames[7:], False)):
        found_of = calibrate_sensor(some, [TAPE], TRUE)
        assert len(found_of.presses) == 7
        assert any("7 of 9 frames are located, and 2 would be" in remark for remark in found_of.remarks) == left_out


def test_a_file_s_own_scale_counts() -> None:
    off = replace(TRUE, px_per_mm=(10.0, 10.0))
    assert look_at_frames(good(), [TAPE], off, TRUE.px_per_mm).wrong == ()
    found = look_at_frames(good(), [TAPE], TRUE, (10.0, 10.0))
    assert all("(the file has a px_per_mm of its own, which counts" in line for line in found.wrong) and found.wrong


def test_without_a_tape_dots_are_counted() -> None:
    found = look_at_frames(good(), [], TRUE)
    assert found.frames[0].located is None and found.frames[0].dots > 15 and "--tape" in found.next_step


@pytest.mark.parametrize(
    ("like", "words"),
    [
        (
            replace(TRUE, sign=-1),
            "the frame's sign is inverted: it shows tape-7 with sign = 1; set sign = 1 in the sensor profile",
        ),
        (
            replace(TRUE, mirror=True),
            "the frame is mirrored: it shows tape-7 from behind; set mirror = false in the sensor profile",
        ),
        (replace(TRUE, px_per_mm=(10.0, 10.0)), "it shows tape-7 at another scale: set px_per_mm = [15"),
        (
            replace(STOCK, px_per_mm=(27.0, 27.0), sign=-1, mirror=True),
            "the tape is seen with another profile: set sign = 1, mirror = false",
        ),
    ],
)
def test_a_wrong_profile_is_named(like: SensorProfile, words: str) -> None:
    assert words in said(good(), like)


def test_faults_of_the_frames_are_named() -> None:
    frames = good()
    low, high = min(f.min() for f in frames), max(f.max() for f in frames)
    coarse = [np.round((f - low) / (high - low) * 50).astype(np.float32) for f in frames]
    cut = [np.minimum(f, np.quantile(f, 0.9)) for f in frames]
    blind = [np.where(np.arange(320) < 40, 0.0, f).astype(np.float32) for f in frames]
    assert "different values: 8 bits are too coarse for dots" in said(coarse)
    assert "10 % of a frame's pixels have its largest value: depth is cut off" in said(cut)
    assert said(blind).startswith("12.5 % of the pixels never change: blind ones belong into a mask")
    masked = replace(TRUE, mask=np.broadcast_to(np.arange(320) >= 40, (240, 320)))
    assert "never change" not in said(blind, masked)  # they are in one
    above = [np.where(np.arange(320) < 40, 9.0, f).astype(np.float32) for f in frames]
    assert not any("cut off" in said(above, like) for like in (TRUE, masked))  # a blind pixel is no depth
    assert "1 frames are the same as the one before, pixel for pixel" in said([*frames, frames[-1]])
    assert "frame 7 is constant: 0 in every pixel; leave it out" in said([*frames, np.zeros_like(frames[0])])
    assert "frames are 200 x 320 px (height x width), those of 'gelsight-mini' 240 x 320" in said([f[40:] for f in frames])
    with pytest.raises(SpecError, match="no frame shows anything"):
        said([np.full((240, 320), np.nan, dtype=np.float32)])


def test_what_is_said_of_frames_of_another_size_does_as_typed() -> None:
    """The scale that was said alone is over the square root of the areas in a profile of the old size."""
    cut = [frame[20:220, 40:300] for frame in good()]
    text = said(cut, STOCK)
    assert "set width_px = 260, height_px = 200 in the sensor profile" in text and "rotate90" not in text
    scale = float(text.split("px_per_mm = [")[-1].split(",")[0])
    typed = replace(STOCK, width_px=260, height_px=200, px_per_mm=(scale, scale))
    found = look_at_frames(cut, [TAPE], typed)
    assert found.wrong == () and all(look.located for look in found.frames)
    assert "height_px = 200 and rotate90 = 0 in the sensor profile" in said(cut[:1], replace(STOCK, rotate90=2))


def test_frames_of_half_the_size_that_are_located_have_their_scale_said() -> None:
    """Where the size alone was set, every frame was refused for its scale."""
    half = [frame[::2, ::2] for frame in good()]
    text = said(half)
    assert "set width_px = 160, height_px = 120 in the sensor profile" in text
    assert "located at px_per_mm = [7.5, 7.5]; set it in the sensor profile, or calibrate" in text
    found = look_at_frames(half, [TAPE], replace(TRUE, width_px=160, height_px=120, px_per_mm=(7.5, 7.5)))
    assert found.wrong == () and all(look.located for look in found.frames)


def test_frames_of_a_tape_that_was_not_named_are_asked_for_its_kit() -> None:
    """They fit it by this profile: there is nothing to set, and calibrating on the tape that was named would be refused."""
    shown = tape_at(8, (62, 32))
    found = look_at_frames([frame.depth for frame in iterate_frames(shown, 3, 4, TRUE)], [TAPE], TRUE)
    assert len(found.wrong) == 1 and "looks like sector 8 of" in found.wrong[0]
    assert found.next_step == "another tape was pressed; give its kit"


def test_frames_of_another_size_have_their_field_of_view_upright() -> None:
    """Of a profile that turns its frames by a quarter the scale along u is that along the frames' height."""
    oblong = replace(TRUE, width_px=320, height_px=192, px_per_mm=(16.0, 12.8), rotate90=1)
    half = fitted_size((160, 96), oblong)
    assert (half.frame_shape, half.rotate90) == ((160, 96), 0) and half.px_per_mm == pytest.approx((6.4, 8.0))
    assert fitted_size((320, 192), oblong) is oblong


def test_small_contacts_are_named_beside_a_wrong_tape() -> None:
    small = [frame.depth for frame in iterate_frames(TAPE, 3, 4, TRUE, Scene(contact_mm=(5.0, 5.0)))]
    assert "shows the tape: is it the one that was pressed" in said(small) and "dots at most, which are few" in said(small)


def test_another_tape_is_named_by_the_decoder() -> None:
    other = replace(TAPE, pitch_mm=5.0, displacement_mm=0.8)
    found = look_at_frames(good(), [other], TRUE)
    assert "no sign, mirror or px/mm shows the tape" in " ".join(found.wrong)


def test_reasons_that_differ_in_numbers_alone_are_one() -> None:
    reasons = Counter({"12 of 40 dots agree": 2, "13 of 41 dots agree": 3, "another tape": 4, "few dots": 1, "no grid": 1})
    assert _named(reasons) == [("13 of 41 dots agree", 5), ("another tape", 4), ("few dots", 1)]


def test_values_of_whole_frames_are_looked_at() -> None:
    """Noise of one frame that repeats, of 256 and of 257 values, with 1 % and more of its pixels at the largest value."""
    rng = np.random.default_rng(1)
    noise = [rng.permutation(10_000).reshape(100, 100).astype(np.float32) for _ in range(4)]
    assert _of_values(noise, None) == []
    assert "2 frames are the same as the one before" in _of_values([noise[0], *noise[1:2] * 3, noise[2]], None)[0]
    for values, coarse in ((256, True), (257, False)):
        of = [np.minimum(frame, values - 1) for frame in noise]
        assert any(f"at most {values} different values" in line for line in _of_values(of, None)) == coarse
    for most, cut_off in ((9_900, False), (9_899, True), (7_999, True)):
        found = _of_values([np.minimum(frame, most) for frame in noise], None)
        assert bool(found) == cut_off
    assert found[0].startswith("up to 20 % of a frame's pixels have its largest value")
    # of pixels that carry depth alone, and not of frames that are refused
    seen = noise[0] < 8_000
    assert _of_values([np.where(seen, noise[0], 9_999)], seen) == []
    assert _of_values([*noise, np.full((100, 100), np.nan, dtype=np.float32)], None) == []
