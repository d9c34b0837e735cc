"""Wrong sign, mirror or scale of a sensor profile, found by trying a frame that is not located with each put right.

Nothing here locates a frame. A quarter turn cannot be told: the tape's answer is as good with another angle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import cos, inf, log, pi, sin

import numpy as np

from tactape_fab.sense.decode.accept import accept_place
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.elongation import flipped_u
from tactape_fab.sense.decode.dots.rim import settled
from tactape_fab.sense.decode.grid.fit import fit_grid
from tactape_fab.sense.decode.grid.lattice import find_lattices
from tactape_fab.sense.decode.rank import View, read
from tactape_fab.sense.decode.result import SOLID_DOTS, Localization
from tactape_fab.sense.decode.rule import GOOD_TRUST, Limits
from tactape_fab.sense.decode.search.hypotheses import Registry
from tactape_fab.sense.decode.search.plane import CodePlane
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray

LEAST_PITCH, MOST_PITCH = 0.45, 2.05
"""Range of pitches that is searched, over the profile's: it includes half and twice the scale."""
MOST_GRIDS = 3
SURE_SHARE, LEAST_POWER, LEAST_AXIS = 0.8, 0.4, 0.25
"""A grid is there from this share of the power that its displaced dots keep, and from this share of a perfect grid's power, with
at least the last at either axis: ridges have one alone. Simulated contacts of W / 6 have 0.51 to 0.70, where 0.56 is expected;
random bumps, smooth noise and a ball have at most 0.37 (40 frames each)."""
LEAST_NEAREST, MOST_NEAREST = 0.6, 1.2
"""Bounds of the median distance of a dot from the nearest other one, in pitches. A finer grid on which all dots happen to stand,
as W / sqrt(13) for a displacement of W / 6, has a larger one."""
CLEARLY_OFF = 0.05
"""How far beyond the tolerance a pitch must be off to be named where no tape confirms it; small contacts give it to 2 %."""
_FOUND_TO = 0.04
"""Largest relative error of a pitch that was found: twice that of small contacts."""
IN_PROFILE = " in the sensor profile"
"""What every reason that names a wrong profile has."""
_ANY_BOUND = inf
"""As `read`'s limit: no other grid is tried, so that a frame of something else costs little."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """A frame that was not located, with the settings of its search."""

    sensor: SensorProfile
    view: View
    world: Registry | CodePlane
    limits: Limits


def wrong_profile(seen: Seen, dots: Dots, raw: Dots, negated: Callable[[], Dots] | None) -> str | None:
    """A reason that names what is wrong in the sensor profile, for a frame that is not located.

    dots: Of the contact, as they were decoded.
    raw: As they were detected, in square pixels.
    negated: Detects the dots of the negated frame; None where there are only dots.
    Returns: None where the dots show nothing of the kind.
    """
    # mirrored first: it needs neither another pitch nor another detection of dots
    behind = _decoded(seen, seen.view, _flipped(seen, dots), seen.limits.on_tape)
    if behind is not None:
        remedy = f"set mirror = {_flag(not seen.sensor.mirror)}{IN_PROFILE}"
        return f"the frame is mirrored: it shows {_name(behind)} from behind; {remedy}"
    pitch_px = _pitch(seen, raw)
    off = 0.0 if pitch_px is None else _off(seen, pitch_px)
    message = None
    if pitch_px is not None and off > seen.view.scale_tolerance:
        message = _off_scale(seen, raw, pitch_px)
    if message is None and negated is not None:
        message = _of_negated(seen, negated())
    if (
        message is None
        and pitch_px is not None
        and off > seen.view.scale_tolerance + CLEARLY_OFF
        and _as_of_a_tape(seen, raw, pitch_px)
    ):
        scale = _scale(seen, pitch_px / seen.view.pitch_mm)
        message = f"{_found(seen, pitch_px)}; set {scale}{IN_PROFILE}, {_another_tape(seen, pitch_px)}"
    return message


def _off(seen: Seen, pitch_px: float) -> float:
    return abs(pitch_px / seen.view.pitch_px - 1.0)


def _as_of_a_tape(seen: Seen, raw: Dots, pitch_px: float) -> bool:
    """Whether dots stand where those of some tape do: displaced from the points of a grid, as far as the tapes' parts."""
    dots = settled(raw, pitch_px, seen.view.shift)
    xy, strength = _centred(dots)
    (angle, pitch, phase_a, phase_b, _), *_ = find_lattices(xy, strength, pitch_px, _FOUND_TO, 1).tolist()
    shift, directions = seen.view.shift, seen.view.directions
    return fit_grid(xy, dots.weights, dots.trust, angle, pitch, phase_a, phase_b, shift, True, directions).expected


def _off_scale(seen: Seen, raw: Dots, pitch_px: float) -> str | None:
    """The reason for a tape that is seen at another scale; None if nothing shows one."""
    found = _decoded_at(seen, raw, pitch_px)
    if found is None:
        return None
    remedy = f"set {_scale(seen, found.px_per_mm)}{IN_PROFILE}, {_another_tape(seen, pitch_px)}"
    return f"{_found(seen, pitch_px)}; it shows {_name(found)} at another scale: {remedy}"


def _of_negated(seen: Seen, raw: Dots) -> str | None:
    """The reason for a frame whose sign is inverted; None if it is not."""
    pitch_px = _pitch(seen, raw)
    if pitch_px is None:
        return None
    right = _off(seen, pitch_px) <= seen.view.scale_tolerance
    pitch_px = seen.view.pitch_px if right else pitch_px
    found = _decoded_at(seen, raw, pitch_px)
    mirror = ""
    if found is None:
        found = _decoded_at(seen, _flipped(seen, raw), pitch_px)
        mirror = f" and mirror = {_flag(not seen.sensor.mirror)}"
    if found is None:
        return None
    scale = "" if right else f" and {_scale(seen, found.px_per_mm)}"
    sign = -seen.sensor.sign
    remedy = f"set sign = {sign}{mirror}{scale}{IN_PROFILE}"
    return f"the frame's sign is inverted: it shows {_name(found)} with sign = {sign}; {remedy}"


def _decoded_at(seen: Seen, raw: Dots, pitch_px: float) -> Localization | None:
    """The located answer for a grid of some pitch."""
    view = replace(seen.view, px_per_mm=pitch_px / seen.view.pitch_mm)
    return _decoded(seen, view, settled(raw, pitch_px, view.shift), _ANY_BOUND)


def _decoded(seen: Seen, view: View, dots: Dots, bound: float) -> Localization | None:
    """The located answer of dots in a view; None if there is none."""
    if dots.trust.sum() < 1.0:
        return None
    limits = seen.limits
    least = -log(limits.on_tape)
    reading = read(dots, view, seen.world, None, bound, limits.precision, least)
    if reading is None or reading.ln_bound < least:
        return None
    found, _ = accept_place(dots, reading, view, seen.world, limits)
    return found if found.located else None


def _flipped(seen: Seen, dots: Dots) -> Dots:
    # u -> 2 u0 - u about the image centre
    flipped = dots.xy_px * (-1.0, 1.0) + (2.0 * seen.view.centre_px[0], 0.0)
    return replace(dots, xy_px=flipped, elongation=flipped_u(dots.elongation))


def _pitch(seen: Seen, raw: Dots) -> float | None:
    """Pitch of the dots' grid, px, independent of the profile's scale; None if there is no grid."""
    good = raw.trust > GOOD_TRUST
    if np.count_nonzero(good) < SOLID_DOTS:
        return None
    xy, strength = _centred(raw)
    # as a middle and a share of it on both sides, which is how `find_lattices` takes a range of pitches
    middle, half = (MOST_PITCH + LEAST_PITCH) / 2, (MOST_PITCH - LEAST_PITCH) / (MOST_PITCH + LEAST_PITCH)
    lattices = find_lattices(xy, strength, seen.view.pitch_px * middle, half, MOST_GRIDS)
    # half the dots keep cos(2 pi delta / w) of their wave along an axis, the others all of it
    kept = ((1.0 + cos(2.0 * pi * seen.view.shift)) / 2.0) ** 2
    strong = lattices[lattices[:, 4] >= max(SURE_SHARE * kept, LEAST_POWER)]
    if len(strong) == 0:
        return None
    nearest = _nearest(xy[good])
    for angle, pitch, _, _, _ in strong[np.argsort(-strong[:, 4])].tolist():
        if LEAST_NEAREST <= nearest / pitch <= MOST_NEAREST and min(_powers(xy, strength, angle, pitch)) >= LEAST_AXIS:
            return float(pitch)
    return None


def _centred(dots: Dots) -> tuple[FloatArray, FloatArray]:
    """Dots from their centroid, px, and the weight of each in a fit of the grid."""
    return dots.xy_px - dots.trust @ dots.xy_px / dots.trust.sum(), dots.trust * np.minimum(dots.weights, 1.0)


def _nearest(xy: FloatArray) -> float:
    """Median distance of a dot from its nearest neighbour, px."""
    apart = ((xy[:, None] - xy) ** 2).sum(axis=2)
    np.fill_diagonal(apart, inf)
    return float(np.sqrt(np.median(apart.min(axis=1))))


def _powers(xy: FloatArray, strength: FloatArray, angle: float, pitch: float) -> tuple[float, float]:
    """Power of dots at each axis of a grid, as a share of a perfect grid's."""
    # columns are the wave vectors of both axes; a perfect grid's sum has the weights' sum for its length
    waves = np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]]) / pitch
    sums = strength @ np.exp(2j * pi * (xy @ waves)) / strength.sum()
    first, second = (np.abs(sums) ** 2).tolist()
    return first, second


def _found(seen: Seen, pitch_px: float) -> str:
    view = seen.view
    expected = f"W {view.pitch_mm:g} mm at the profile's {view.px_per_mm:g} px/mm is {view.pitch_px:.1f} px"
    return f"a grid of {pitch_px:.1f} px was found, {expected}"


def _another_tape(seen: Seen, pitch_px: float) -> str:
    """The remedy where the profile is right: no frame tells a scale from a pitch."""
    return f"or name a tape of W {pitch_px / seen.view.px_per_mm:.3g} mm if it is one"


def _scale(seen: Seen, px_per_mm: float | None) -> str:
    """The key of the profile for a scale along u; pixels stay as oblong as they are."""
    assert px_per_mm is not None
    along_u, along_v = seen.sensor.px_per_mm
    return f"px_per_mm = [{px_per_mm:.4g}, {px_per_mm * along_v / along_u:.4g}]"


def _name(found: Localization) -> str:
    return found.tape or f"sector {found.sector}"


def _flag(value: bool) -> str:
    return "true" if value else "false"
