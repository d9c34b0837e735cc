"""Quarter turns that the dots' own shape speaks for: long bodies all lie at one angle to the grid, and so half the turns are out.

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
"""Scatter of one dot's elongation that is believed before a frame is seen, and how many dots this belief counts as."""
COMMON_ERROR = 0.04
"""Standard error that all dots of a frame share: pixels 2 % more oblong than the sensor's profile says give half of it."""


def square_pixels(elongation: FloatArray | None, aspect: float) -> FloatArray | None:
    """Elongations as they are after v is stretched by `aspect`; shape (n, 2)."""
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
    """Prior weights of the four quarter turns of a grid, from nothing but the shape of the dots; shape (4,), sum 1.

    They weigh hypotheses, and never enter E (docs/trust.md): the bound holds for any weights fixed before a tape is looked at.

    elongation (n, 2): In square pixels.
    weights (n,): Heights over that of a whole dot.
    trust (n,)
    grid (4,): From `fit.fit_grid`.
    part: Of the tape in question; a round one gives even weights.
    """
    return turn_shares(parity_log_ratio(elongation, weights, trust, grid, part))


def parity_log_ratio(
    elongation: FloatArray | None, weights: FloatArray, trust: FloatArray, grid: FloatArray, part: TapePart
) -> float:
    """Ln of how much likelier turns 0 and 2 are than 1 and 3; 0 where nothing can be told. Parameters as in `turn_weights`.

    The mean along the bodies' direction is a > 0 for even turns and -a for odd ones, a itself unknown: it depends on the gel.
    What its sign is worth is that of a normal variable of flat prior, ln Phi(z) - ln Phi(-z).
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
    """Mean of the good dots' elongations along a double angle over its standard error; 0 for too few of them."""
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
    # both components have one variance: n - 1 deviations each, besides the belief before the frame
    scatter = squares / 2.0 - (along * along + across * across) / (2.0 * count)
    variance = (scatter + USUAL_DOTS * USUAL_SCATTER**2) / (count - 1.0 + USUAL_DOTS)
    # what all dots share does not fall with their number, as the error of a mean does
    return float(along / count / np.sqrt(variance / count + COMMON_ERROR**2))
