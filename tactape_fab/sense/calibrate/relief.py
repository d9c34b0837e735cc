"""Relief: how far a gel smooths the tape's parts, how high they are in its frames, and what the fit leaves between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, log, radians, sin

import numpy as np

from tactape_fab.sense.calibrate.adjust import Bundle
from tactape_fab.sense.calibrate.presses import Frame, Press
from tactape_fab.sense.decode.dots.filters import averaged
from tactape_fab.sense.decode.dots.inputs import canonical_frame
from tactape_fab.sense.decode.pixels.patches import BLURS_MM, fitted, has_patch, pixel_fit, unknown_relief
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.tape import Tape

WHOLE = 0.9
"""Dots of this weight are imprinted wholly."""
FINE = (0.03, 0.04, *BLURS_MM, 0.55, 0.7)
"""Blurs that are tried, mm; the minimum between them is interpolated by a parabola."""
MOST_PRESSES = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Relief:
    """The relief of parts in the gel.

    blur_mm, sigma_blur_mm: Standard deviation of the Gaussian that smooths, and its error from press to press; None of one press.
    amplitude, sigma_amplitude: Height of a part before it is smoothed, in the frame's unit, and its error alike.
    left: Squares that are left of differences between neighbouring pixels, over what slopes of variance 1 have.
    """

    blur_mm: float
    sigma_blur_mm: float | None
    amplitude: float
    sigma_amplitude: float | None
    left: float
    freedom: float


def find_relief(frames: Sequence[Frame], presses: Sequence[Press], bundle: Bundle, tapes: Sequence[Tape]) -> Relief | None:
    """Blur and height of the parts, from the pixels around whole dots; None where nothing is known of the parts' relief."""
    parts = {tape.name: tape.part for tape in tapes}
    rows = []
    for press, pose in list(zip(presses, bundle.poses, strict=True))[:MOST_PRESSES]:
        if unknown_relief(parts[press.tape]) is not None:
            continue
        found = _of_press(frames[press.frame], press, float(pose[2]), bundle.sensor, parts[press.tape])
        if found is not None:
            rows.append(found)
    if not rows:
        return None
    blurs, heights, left, freedom = (np.array(column) for column in zip(*rows, strict=True))
    # of one press nothing differs
    root = float(np.sqrt(len(rows) - 1))
    return Relief(
        blur_mm=float(np.median(blurs)),
        sigma_blur_mm=float(blurs.std() / root) if root else None,
        amplitude=float(np.median(heights)),
        sigma_amplitude=float(heights.std() / root) if root else None,
        left=float(np.median(left)),
        freedom=float(freedom.sum()),
    )


def _of_press(
    frame: Frame, press: Press, theta: float, sensor: SensorProfile, part: TapePart
) -> tuple[float, float, float, float] | None:
    """Blur, height, squares left for each expected, and how many are expected."""
    fit = pixel_fit(sensor)
    image = canonical_frame(frame, sensor)
    if fit.factor > 1:
        image = averaged(image, fit.factor)
    # in averaged pixels, whose centres are those of blocks of the image's
    at = (press.seen_px - (fit.factor - 1) / 2) / fit.factor
    whole = (press.weights >= WHOLE) & has_patch(fit, at)
    # the cost of a blur is the median over dots, which of fewer follows one of them
    if whole.sum() < 4:
        return None
    at = at[whole]
    turn = theta - radians(part.rotation_deg)
    middle = at.mean(axis=0)
    # the camera about the middle of the dots as a matrix: mm on the gel for a pixel along u and along v
    ends = fit.from_px(middle + np.array([(1.0, 0.0), (0.0, 1.0)])) - fit.from_px(middle[None])
    # pixels to mm on the gel, turned into the part's own axes
    to_body = np.array([[cos(turn), sin(turn)], [-sin(turn), cos(turn)]]) @ ends.T
    costs = [fitted(fit, image, at, to_body, part, blur) for blur in FINE]
    sums = np.array([float(np.median(found.left)) for found in costs])
    best = int(sums.argmin())
    blur = _least(FINE, sums, best)
    chosen = costs[best]
    return blur, float(np.median(chosen.height)), sums[best] / fit.freedom, fit.freedom * len(at)


def _least(blurs: Sequence[float], sums: FloatArray, best: int) -> float:
    """Blur at the minimum of the parabola in ln of the blur through the best sum and its neighbours."""
    if best in (0, len(blurs) - 1):
        return float(blurs[best])
    below, above = (log(blurs[best + k] / blurs[best]) for k in (-1, 1))
    # by divided differences: of three equal sums a least-squares fit has a curvature, of either sign by the processor's rounding
    slopes = (sums[best - 1] - sums[best]) / below, (sums[best + 1] - sums[best]) / above
    curve = (slopes[1] - slopes[0]) / (above - below)
    step = -(slopes[0] - curve * below) / (2.0 * curve) if curve > 0.0 else 0.0
    return float(blurs[best] * np.exp(np.clip(step, below, above)))
