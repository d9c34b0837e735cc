"""Quarter turns, sizes and masks of a profile, against the frames that it describes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.sense.calibrate.orientation import (
    MOST_OFF_DEG,
    SCALES,
    TOLERANCE,
    KnownTurn,
    _most_relief,
    find_orientation,
    fitted_size,
    upright,
    with_depth,
    with_mask,
)
from tactape_fab.sense.decode.dots.inputs import canonical_frame, shown_pixels
from tests.unit.sense.calibrate.sensors import STOCK, TAPE, TRUE, pressed, presses

OBLONG = replace(STOCK, px_per_mm=(16.0, 12.0))
SEEN = np.zeros((240, 320), dtype=bool)
SEEN[20:200, 30:310] = True


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("rotate90", range(4))
def test_a_mask_on_frames_is_turned_as_they_are(mirror: bool, rotate90: int) -> None:
    height, width = SEEN.shape
    size = (width, height) if rotate90 % 2 == 0 else (height, width)
    sensor = replace(STOCK, width_px=size[0], height_px=size[1], mirror=mirror, rotate90=rotate90)
    masked = with_mask(sensor, SEEN)
    assert masked.mask is not None and not masked.mask.flags.writeable
    assert np.array_equal(masked.mask, canonical_frame(SEEN.astype(np.float32), sensor) > 0.5)
    assert np.array_equal(shown_pixels(masked), SEEN)
    assert with_mask(masked, None).mask is None
    # what a mask leaves of valid pixels
    valid = np.roll(SEEN, 40, axis=1)
    assert with_depth(valid, sensor) is valid and with_depth(None, sensor) is None
    both, own = with_depth(valid, masked), with_depth(None, masked)
    assert both is not None and own is not None
    assert np.array_equal(both, valid & SEEN) and np.array_equal(own, SEEN)


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize(("seen_deg", "off_deg"), [(10.0, 19.9), (170.0, -19.9), (-95.0, 0.0)])
def test_a_known_direction_turns_the_profile_by_quarters(seen_deg: float, off_deg: float, quarters: int) -> None:
    """A sensor that is said to be turned counter-clockwise by so many more quarters has its image turned back by them."""
    known = KnownTurn(frame=2, theta_deg=(seen_deg + off_deg + 90.0 * quarters) % 360.0)
    sensor = replace(OBLONG, rotate90=1)
    found = upright(sensor, known, seen_deg, SEEN.T if quarters % 2 else None)
    assert found.rotate90 == (1 - quarters) % 4 and found.frame_shape == sensor.frame_shape
    swapped = quarters % 2 == 1
    assert found.px_per_mm == ((12.0, 16.0) if swapped else (16.0, 12.0))
    assert (found.width_px, found.height_px) == ((240, 320) if swapped else (320, 240))
    assert (found.mask is not None) == swapped


def test_a_direction_that_no_quarter_turn_explains_is_refused() -> None:
    with pytest.raises(
        SpecError, match=r"known_theta = 2,125: the frame is said to be at 125 deg and seen at 10.0 deg; that is 25 deg"
    ):
        upright(OBLONG, KnownTurn(frame=2, theta_deg=125.0), 10.0, None)
    with pytest.raises(SpecError, match="that is 20 deg from a quarter turn, more than 20"):
        upright(OBLONG, KnownTurn(frame=2, theta_deg=79.8), 10.0, None)
    # no more than that is none
    assert upright(OBLONG, KnownTurn(frame=2, theta_deg=MOST_OFF_DEG), 0.0, None).rotate90 == OBLONG.rotate90


def test_every_scale_from_half_to_twice_is_tried_the_profile_s_own_first() -> None:
    assert SCALES[0] == 1.0
    in_order = sorted(SCALES)
    assert in_order[0] * (1.0 - TOLERANCE) < 0.5 and in_order[-1] * (1.0 + TOLERANCE) > 2.0
    assert all(low * (1.0 + TOLERANCE) > high * (1.0 - TOLERANCE) for low, high in pairwise(in_order))


@pytest.mark.parametrize(("off", "sign"), [(0.9, 1), (1.4, -1)])
def test_pixels_stay_as_oblong_as_the_profile_has_them(off: float, sign: int) -> None:
    """Of a profile whose scale is off, of frames that are mirrored, and of other sign."""
    sensor = replace(TRUE, px_per_mm=(15.0, 12.0))
    frames = [np.float32(sign) * frame[:, ::-1] for frame in pressed(sensor, 2, 1, (3.0, 2.0), 20.0).frames]
    found = find_orientation(frames, [TAPE], replace(sensor, px_per_mm=(15.0 * off, 12.0 * off)), None)
    assert found is not None and found.mirror != sensor.mirror and found.sign == sign * sensor.sign
    assert found.px_per_mm == pytest.approx(sensor.px_per_mm, rel=0.01)


def test_frames_of_another_size_have_the_same_field_of_view() -> None:
    assert fitted_size((240, 320), OBLONG) is OBLONG
    half = fitted_size((120, 160), OBLONG)
    assert (half.width_px, half.height_px, half.px_per_mm) == (160, 120, (8.0, 6.0))
    assert half.mask is None and half.rotate90 == 0
    # of a profile that turns its frames by a quarter the scale along u is that along their height
    turned = replace(OBLONG, width_px=240, height_px=320, px_per_mm=(12.0, 16.0), rotate90=3)
    assert turned.frame_shape == (240, 320) and fitted_size((120, 160), turned).px_per_mm == (8.0, 6.0)
    assert fitted_size((120, 160), replace(OBLONG, rotate90=2)).px_per_mm == (8.0, 6.0)
    # twice as high: px/mm grows as the root of the area
    assert fitted_size((480, 320), OBLONG).px_per_mm == pytest.approx((16.0 * 2**0.5, 12.0 * 2**0.5))
    assert fitted_size((16, 16), replace(OBLONG, px_per_mm=(4.0, 4.0))).px_per_mm == (1.0, 1.0)
    # a profile holds 1000 px/mm at most
    assert fitted_size((2400, 3200), replace(OBLONG, px_per_mm=(400.0, 400.0))).px_per_mm == (1000.0, 1000.0)
    for shape in ((15, 320), (240, 15), (240, 99_999)):
        with pytest.raises(
            SpecError, match=rf"frames of {shape[0]} x {shape[1]} px \(height x width\): each side must be from 16"
        ):
            fitted_size(shape, OBLONG)


def test_frames_of_most_relief_are_tried_first() -> None:
    """Relief of the size of parts: neither a slope nor noise of single pixels."""
    frame = presses().frames[0]
    slope = np.tile(np.linspace(-0.1, 0.1, 320, dtype=np.float32), (240, 1))
    frames = [frame * 0.5, slope, frame, *[frame * 0.1 * k for k in (1, 2, 3, 4)], frame * 0.6]
    first = _most_relief(frames, STOCK)
    assert [next(k for k, each in enumerate(frames) if each is some) for some in first] == [2, 7, 0, 6, 5, 4]
