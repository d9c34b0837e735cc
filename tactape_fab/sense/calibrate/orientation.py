"""Orientation and rough scale: the sign, mirror and px/mm that show a tape, and the quarter turn that a known press asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import remainder

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.sense.calibrate.presses import Frame
from tactape_fab.sense.decode.dots.detect import band_pass
from tactape_fab.sense.decode.dots.inputs import canonical_frame, shown_pixels
from tactape_fab.sense.decode.localizer import Localizer
from tactape_fab.sense.geometry import Geometry
from tactape_fab.sense.sensors import MOST_PX, SensorProfile
from tactape_fab.texture.frames import BoolArray
from tactape_fab.texture.tape import Tape

SCALES = (1.0, 0.8, 1.25, 0.64, 1.5625, 0.512, 1.953)
"""Scales that are tried, over the initial profile's; each covers `TOLERANCE` about it."""
TOLERANCE = 0.15
PROBES = 6
"""Frames of most relief that are tried."""
MOST_OFF_DEG = 20.0
"""How far a press of known direction may be off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownTurn:
    """A press whose direction is known: the frame's index, and the sensor's turn on the tape, counter-clockwise from above."""

    frame: int
    theta_deg: float


def fitted_size(frame_shape: tuple[int, int], like: SensorProfile) -> SensorProfile:
    """A profile for frames of some shape (h, w): where `like` is of another, its field of view at that size, upright."""
    if frame_shape == like.frame_shape:
        return like
    height, width = frame_shape
    if not (min(frame_shape) >= 16 and max(frame_shape) <= MOST_PX):
        message = f"frames of {height} x {width} px (height x width): each side must be from 16 to {MOST_PX} px; scale them"
        raise SpecError(Problem("frames", message))
    # the same field of view on more pixels: px/mm grows as the root of the area, whatever the sides' ratio
    mean = float(np.sqrt(width * height / (like.width_px * like.height_px)))
    u, v = like.px_per_mm[::-1] if like.rotate90 % 2 else like.px_per_mm
    scale = (min(max(u * mean, 1.0), 1000.0), min(max(v * mean, 1.0), 1000.0))
    return replace(like, width_px=width, height_px=height, px_per_mm=scale, rotate90=0, mask=None, geometry=Geometry())


def find_orientation(
    frames: Sequence[Frame], tapes: Sequence[Tape], like: SensorProfile, valid: BoolArray | None
) -> SensorProfile | None:
    """The profile, of those with another sign, mirror or scale, by which a tape is located first.

    like: Tried first.
    valid: Pixels of a frame that carry depth.
    Returns: None where nothing shows a tape.
    """
    probes = _most_relief(frames, like)
    for factor in SCALES:
        u, v = like.px_per_mm
        rough = replace(like, px_per_mm=(u * factor, v * factor), scale_tolerance=max(TOLERANCE, like.scale_tolerance))
        found = _located_by(probes, tapes, rough, valid)
        if found is not None:
            return found
    return None


def _located_by(
    probes: Sequence[Frame], tapes: Sequence[Tape], rough: SensorProfile, valid: BoolArray | None
) -> SensorProfile | None:
    """The profile of some scale by which a probe is located, with the scale found in it."""
    # a localizer is built for each mirror; the other sign is the frame negated, and needs none
    for mirror in (rough.mirror, not rough.mirror):
        seen = with_mask(replace(rough, mirror=mirror), valid)
        localizer = Localizer(tapes, seen, refine="dots")
        for sign in (rough.sign, -rough.sign):
            for frame in probes:
                fix = localizer.locate(frame if sign == rough.sign else -frame)
                if fix.located and fix.px_per_mm is not None:
                    change = fix.px_per_mm / rough.px_per_mm[0]
                    scale = (fix.px_per_mm, rough.px_per_mm[1] * change)
                    return replace(seen, sign=sign, px_per_mm=scale)
    return None


def _most_relief(frames: Sequence[Frame], like: SensorProfile) -> list[Frame]:
    """Frames with most relief of the size of parts."""
    # beyond slow shapes and pixel noise: a contact without dots has little of it
    relief = [float(band_pass(canonical_frame(frame, like), like.px_per_mm[0]).std()) for frame in frames]
    return [frames[k] for k in np.argsort(-np.array(relief), kind="stable")[:PROBES]]


def with_mask(sensor: SensorProfile, valid: BoolArray | None) -> SensorProfile:
    """A profile with a mask drawn on frames as they are delivered."""
    if valid is None:
        return replace(sensor, mask=None)
    # frames are mirrored first, then turned (`inputs.canonical_frame`)
    turned = np.ascontiguousarray(np.rot90(valid[:, ::-1] if sensor.mirror else valid, sensor.rotate90))
    turned.setflags(write=False)
    return replace(sensor, mask=turned)


def with_depth(valid: BoolArray | None, like: SensorProfile) -> BoolArray | None:
    """Pixels of a frame that carry depth: valid ones that a profile's own mask leaves; None: all."""
    if like.mask is None:
        return valid
    return shown_pixels(like) if valid is None else valid & shown_pixels(like)


def upright(sensor: SensorProfile, known: KnownTurn, theta_deg: float, valid: BoolArray | None) -> SensorProfile:
    """A profile turned by quarter turns so that a press of known direction has it.

    theta_deg: What the profile says of that press.
    valid: As for `find_orientation`.
    Raises SpecError where no quarter turn explains it.
    """
    quarters = round((known.theta_deg - theta_deg) / 90.0)
    off = remainder(known.theta_deg - theta_deg - 90.0 * quarters, 360.0)
    if abs(off) > MOST_OFF_DEG:
        message = (
            f"known_theta = {known.frame},{known.theta_deg:g}: the frame is said to be at {known.theta_deg:g} deg and seen at "
            f"{theta_deg:.1f} deg; that is {abs(off):.0f} deg from a quarter turn, more than {MOST_OFF_DEG:g}; press along the "
            "tape's edge and give 0, 90, 180 or 270"
        )
        raise SpecError(Problem("known_theta", message))
    # the image shows the tape as from above (z goes into it): turned counter-clockwise, its axes lie clockwise on the tape
    quarters = -quarters % 4
    turned = replace(sensor, rotate90=(sensor.rotate90 + quarters) % 4)
    # a quarter turn swaps the sides, and px/mm along them
    if quarters % 2:
        u, v = sensor.px_per_mm
        turned = replace(turned, width_px=sensor.height_px, height_px=sensor.width_px, px_per_mm=(v, u))
    return with_mask(replace(turned, geometry=Geometry()), valid)
