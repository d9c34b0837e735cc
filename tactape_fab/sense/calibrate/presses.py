"""Frames -> presses: what each dot of a located frame says of the camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from math import radians

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.decode.dots.frame_dots import contact_dots, squared
from tactape_fab.sense.decode.grid.drawn_dots import drawn
from tactape_fab.sense.decode.grid.pose import LEAST_WEIGHT
from tactape_fab.sense.decode.localizer import Localizer
from tactape_fab.sense.decode.result import Localization
from tactape_fab.sense.decode.rule import BACKGROUND_MM
from tactape_fab.sense.decode.search.built_places import built_of
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import DIRECTIONS_XY, BoolArray, FloatArray, IntArray
from tactape_fab.texture.tape import Tape

ONE_SIDED, REACH_PITCHES, LEAST_AMID = 0.5, 1.6, 12
"""Length of the mean unit vector to a dot's neighbours from which on it is at the rim; largest distance of a neighbour; and least
number of surrounded dots of a press for which those at the rim are left out."""
SIDE_MM = BACKGROUND_MM / 2.0
"""Dots nearer to the image's sides are left out: the detector's band-pass takes a mean over twice that, which the side cuts."""

Frame = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Press:
    """A located frame.

    frame: Its place among the frames.
    tape: Name of the tape.
    seen_px (n, 2): Dots as detected, canonical image, or the middles of their bodies.
    rim_mm (n, 2): Correction of dots at the rim, on the gel along u and v.
    texture_mm (n, 2): Positions of their parts: as built if the answer rests on those, else nominal.
    weights (n,): Height over that of a whole dot, times trust; at most 1.
    interior (n,): Dots with others on all sides, and off the image's sides: free of shifts by the filter that are the same in all
        presses.
    pushed, pulled (n, 2): Shift of each by neighbours and by the rim, along u and v, for a push and a pull of 1; see
        `decode.grid.posterior`.
    theta_rad: The decoder's answer, to start from.
    fine: Whether centres come from the pixels (`refined`).
    by_edges: How far dots are middles of bodies between their edges, from 0 to 1; see `Dots`.
    """

    frame: int
    tape: str
    seen_px: FloatArray
    rim_mm: FloatArray
    texture_mm: FloatArray
    weights: FloatArray
    interior: BoolArray
    pushed: FloatArray
    pulled: FloatArray
    position_mm: tuple[float, float]
    theta_rad: float
    fine: bool = False
    by_edges: float = 0.0

    def taken(self, which: BoolArray | IntArray) -> Press:
        """A copy with some of the dots; shifts by dots that are left out stay."""
        arrays = {f.name: getattr(self, f.name)[which] for f in fields(self) if isinstance(getattr(self, f.name), np.ndarray)}
        return replace(self, **arrays)

    def at(self, pose: FloatArray) -> Press:
        """A copy with another initial pose: x mm, y mm, theta rad; further entries are ignored."""
        return replace(self, position_mm=(float(pose[0]), float(pose[1])), theta_rad=float(pose[2]))


def located(
    frames: Sequence[Frame],
    tapes: Sequence[Tape],
    sensor: SensorProfile,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> tuple[list[Press], list[Localization]]:
    """Locate frames with a profile: the presses, and the answer of every frame."""
    localizer = Localizer(tapes, sensor, refine="dots")
    by_name = {tape.name: tape for tape in localizer.tapes}
    presses, answers = [], []
    for k, frame in enumerate(frames):
        fix = localizer.locate(frame)
        answers.append(fix)
        progress(len(answers), len(frames))
        if fix.located and fix.tape is not None:
            presses.append(press_of(k, frame, fix, by_name[fix.tape], sensor))
    return presses, answers


def press_of(index: int, frame: Frame, fix: Localization, tape: Tape, sensor: SensorProfile) -> Press:
    """The press of a located frame's dots."""
    assert fix.dots is not None and fix.position_mm is not None and fix.theta_deg is not None and fix.tape is not None
    dots = contact_dots(frame, sensor, tape)
    assert dots.seen_px is not None and len(dots.weights) == len(fix.dots.uv_px)
    weights = np.minimum(dots.weights * dots.trust, 1.0)
    cells = fix.dots.cell
    used = (cells[:, 0] >= 0) & (weights > LEAST_WEIGHT)
    # of u and v each, from either side
    side_px = SIDE_MM * np.array(sensor.px_per_mm)
    inside = (np.abs(dots.seen_px - sensor.centre_px) < sensor.centre_px - side_px).all(axis=1) & used
    inside &= interior(np.asarray(cells * tape.pitch_mm, dtype=np.float64), inside, REACH_PITCHES * tape.pitch_mm)
    # cells of dots beside the tape are -1, and would index its last row
    cells = cells[used]
    symbols = tape.symbols[cells[:, 1], cells[:, 0]]
    # paper, Eq. 9
    texture_mm = cells * tape.pitch_mm + tape.displacement_mm * DIRECTIONS_XY[symbols]
    built = built_of(tape) if fix.places == "as-built" else None
    if built is not None:
        texture_mm = texture_mm + built.shift_mm[cells[:, 1], cells[:, 0]]
    theta = radians(fix.theta_deg)
    square = squared(dots.seen_px, sensor)
    pushed, pulled = drawn(texture_mm, weights[used], theta, dots.by_edges)
    return Press(
        frame=index,
        tape=fix.tape,
        seen_px=dots.seen_px[used],
        rim_mm=((dots.xy_px - square) / sensor.px_per_mm[0])[used],
        texture_mm=texture_mm,
        weights=weights[used],
        interior=inside[used],
        pushed=pushed,
        pulled=pulled,
        position_mm=fix.position_mm,
        theta_rad=theta,
        by_edges=dots.by_edges,
    )


def interior(at_mm: FloatArray, of: BoolArray, reach_mm: float) -> BoolArray:
    """Dots with neighbours on all sides; all dots of `of` where too few have. The rim draws the others by micrometres, alike in
    all presses: with them the aspect and k1 of a calibration are off by 3 and by 9 in ten thousand, without by 1 and 6.

    at_mm (n, 2)
    of (n,): Those that count as neighbours.
    reach_mm: Farthest neighbours.
    """
    apart = at_mm[:, None] - at_mm
    distance = np.hypot(apart[..., 0], apart[..., 1])
    near = (distance > 0.0) & (distance < reach_mm) & of
    # length of the mean direction to the neighbours: 0 amid them, 2 / pi for a half plane of them
    ahead = np.where(near[..., None], apart / np.maximum(distance, 1e-9)[..., None], 0.0).sum(axis=1)
    inner: BoolArray = np.hypot(*(ahead / np.maximum(near.sum(axis=1), 1)[:, None]).T) < ONE_SIDED
    return inner if np.count_nonzero(inner & of & near.any(axis=1)) >= LEAST_AMID else of
