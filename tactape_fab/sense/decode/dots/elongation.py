"""Prior of the quarter turns from the shape of the dots: all long bodies lie at one angle to the grid, which rules out two.

Elongations are those of `detect.Dots`: a top that is longest at an angle phi has -a (cos 2 phi, sin 2 phi).
"""

from __future__ import annotations

from math import atan2, copysign, erfc, log, radians, sqrt

import numpy as np

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.rule import GOOD_TRUST, GOOD_WEIGHT, LEAST_GOOD, turn_shares
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart, is_long

USUAL_SCATTER, USUAL_DOTS = 0.1, 4.0
"""Prior standard deviation of one dot's elongation, and the number of dots that this prior counts as."""
COMMON_ERROR = 0.04
"""Standard error common to all dots of a frame; an aspect ratio 2 % off the sensor profile's gives half of it."""


def square_pixels(elongation: FloatArray | None, aspect: float) -> FloatArray | None:
    """Elongations after v is stretched by `aspect`; shape (n, 2)."""
    if elongation is None or aspect == 1.0:
        return elongation
    # second derivatives in v' = aspect v: h_vv falls by aspect squared, h_uv by aspect
    along, across, mixed = 1.0 + elongation[:, 0], (1.0 - elongation[:, 0]) / aspect**2, elongation[:, 1] / aspect
    return np.stack([along - across, 2.0 * mixed], axis=1) / (along + across)[:, None]


def flipped_u(elongation: FloatArray | None) -> FloatArray | None:
    """Elongations of the image with u reversed."""
    return None if elongation is None else elongation * (1.0, -1.0)


def turn_weights(
    elongation: FloatArray | None, weights: FloatArray, trust: FloatArray, grid: FloatArray, part: TapePart
) -> FloatArray:
    """Prior weights of the four quarter turns of a grid, from the shape of the dots alone; shape (4,), sum 1.

    They weigh hypotheses, and never enter E (docs/trust.md): the bound holds for any weights fixed before a tape is looked at.

    elongation (n, 2): In square pixels.
    weights (n,): Heights over that of a fully imprinted dot.
    trust (n,)
    grid (4,): From `fit.fit_grid`.
    part: The tape's part; a round one gives equal weights.
    """
    return turn_shares(parity_log_ratio(elongation, weights, trust, grid, part))


def parity_log_ratio(
    elongation: FloatArray | None, weights: FloatArray, trust: FloatArray, grid: FloatArray, part: TapePart
) -> float:
    """Log odds of turns 0 and 2 against 1 and 3; 0 if the dots do not tell. Parameters as in `turn_weights`.

    The mean elongation along the bodies is a > 0 for even turns and -a for odd ones; a depends on the gel and is unknown.
    With a flat prior on a, the log odds of its sign are ln Phi(z) - ln Phi(-z), z the mean over its standard error.
    """
    length_mm, width_mm = part.body_mm[:2]
    if elongation is None or not is_long(part.shape, part.body_mm):
        return 0.0
    # a texture direction psi (from x towards y, down) is seen at theta + psi, and theta is the grid's angle in turn 0
    psi = radians(-part.rotation_deg + (0.0 if length_mm >= width_mm else 90.0))
    z = _sign_strength(elongation, weights, trust, 2.0 * (atan2(grid[1], grid[0]) + psi))
    # Phi(z) = erfc(-z / sqrt 2) / 2: the halves cancel in the ratio. For |z| beyond 37 erfc is 0 in double precision
    likely = erfc(-abs(z) / sqrt(2.0))
    return copysign(log(likely) - log(max(erfc(abs(z) / sqrt(2.0)), 1e-300)), z)


@kernel()
def _sign_strength(elongation: FloatArray, weights: FloatArray, trust: FloatArray, twice_rad: float) -> float:
    """Mean elongation of the good dots along half of `twice_rad`, over its standard error; 0 if there are too few dots."""
    # a long top has -a (cos 2 phi, sin 2 phi): the unit vector of that direction
    c, s = -np.cos(twice_rad), -np.sin(twice_rad)
    count = along = across = squares = 0.0
    for i in range(len(weights)):
        # a dot at the rim is imprinted on one side, and elongated along the rim whatever its body
        if weights[i] >= GOOD_WEIGHT and trust[i] >= GOOD_TRUST:
            count += 1.0
            along += c * elongation[i, 0] + s * elongation[i, 1]
            across += c * elongation[i, 1] - s * elongation[i, 0]
            squares += elongation[i, 0] ** 2 + elongation[i, 1] ** 2
    if count < LEAST_GOOD:
        return 0.0
    # both components have one variance: n - 1 degrees of freedom each, and those of the prior
    scatter = squares / 2.0 - (along * along + across * across) / (2.0 * count)
    variance = (scatter + USUAL_DOTS * USUAL_SCATTER**2) / (count - 1.0 + USUAL_DOTS)
    # an error common to all dots does not average out
    return float(along / count / np.sqrt(variance / count + COMMON_ERROR**2))
