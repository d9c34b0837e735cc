"""Correction of the dots of long parts, which a pressure gradient shifts more along their length than across.

The relief of a part is that of its body times the pressure. Its maximum lies where the relative slopes of both cancel, away from
the body's own maximum by the body's squared width times the relative slope of the pressure. A part twice as long as wide is
shifted six times as far along itself as across. All parts lie alike, so the contact looks contracted along them, which a fit
would mistake for the camera's aspect and shear, and for a rotation.
"""

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.dots.clip import clip
from tactape_fab.sense.decode.dots.kth import select
from tactape_fab.sense.decode.grid.second_order import add_point, solve
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart, is_long

DRAWN = 0.55 / 0.45
"""How much farther a maximum shifts along a part than across it, mm, for a relative slope of the heights of 1/mm, over length^4 -
width^4, mm^4: the longer a top, the flatter its middle. For 0201 the shift for 1/mm is 0.13 to 0.16 mm^2 in contacts of the
elastic simulator that are flat or tilted by 2 degrees, with 0.5 and 2 N (seed 5); other parts, `contact.tilted.DRAWN`."""
WHOLE = 0.8
"""Dots lower than this share of the upper quartile are at the rim: their heights do not show the pressure inside."""
LEAST_WHOLE = 8
HEIGHT_ERROR, SLOPE, BEND = 0.05, 0.1, 0.05
"""Standard deviation of ln of the heights; prior standard deviations of the slope (1/mm) and of the second derivatives (1/mm^2)
of ln of the pressure."""
FARTHEST_MM = 0.1
UNSURE_MM2 = 0.2
"""Draw, in the unit of `DRAWN` times mm^4, from which on its uncertainty is told. That of 0201 is 0.15, and errs by 0.2 um in the
default scene; that of 0402 errs by 2 um and 0.1 degrees, many times what the dots' own errors leave."""


class Drawn(NamedTuple):
    """Shift (n, 2) of dots by a pressure gradient, square pixels, and what the pose errs by if it is wrong.

    covariance (3, 3): Of a pose's u mm, v mm and theta rad, along the image's axes; None where it is negligible.
    """

    shift_px: FloatArray
    covariance: FloatArray | None


def drawn_px(
    part: TapePart, heights: FloatArray, offset_px: FloatArray, texture_mm: FloatArray, px_per_mm: float
) -> Drawn | None:
    """Shift of the maxima from where those of parts as wide as long would lie; None for parts that are not long.

    heights (n,): Of the maxima, in any unit.
    offset_px (n, 2): Positions in the image, square pixels.
    texture_mm (n, 2): Nominal positions of the same dots.
    """
    if not is_long(part.shape, part.body_mm):
        return None
    length_mm, width_mm = part.body_mm[:2]
    # a texture direction psi (from x towards y, down) is seen at theta + psi
    n, psi = len(heights), -part.rotation_deg * pi / 180.0
    out, normal, drawn_mm2 = np.zeros((n, 2)), np.zeros((7, 7)), DRAWN * (length_mm**4 - width_mm**4)
    along_u, along_v = _draw(heights, offset_px, texture_mm, px_per_mm, psi, drawn_mm2, np.empty(n), normal, out)
    if drawn_mm2 < UNSURE_MM2:
        return Drawn(shift_px=out, covariance=None)
    # dots at p from their middle m shift by D (g + B p), D = drawn_mm2 (a a^T - 1/2) = [[d, e], [e, -d]], with slopes g and
    # second derivatives B = [[x, z], [z, y]] of the surface, and a along the parts. The fit turns by half of the antisymmetric
    # part of D B and takes the rest for the camera's; the pose's place is the image's centre, p = -m: D (B m - g)
    d, e = drawn_mm2 * (along_u * along_u - along_v * along_v) / 2.0, drawn_mm2 * along_u * along_v
    u, v = (offset_px.mean(axis=0) / px_per_mm).tolist()
    rates = np.array(
        [  # by g_u, g_v, x, y, z
            [-d, -e, d * u, e * v, d * v + e * u],
            [-e, d, e * u, -d * v, e * v - d * u],
            [0.0, 0.0, e / 2.0, -e / 2.0, -d],
        ]
    )
    # what is left of the normal matrix is its inverse: the surface's covariance over the variance of a height
    return Drawn(shift_px=out, covariance=HEIGHT_ERROR**2 * rates @ normal[1:6, 1:6] @ rates.T)


@kernel()
def _draw(
    heights: FloatArray,
    offset_px: FloatArray,
    texture_mm: FloatArray,
    px_per_mm: float,
    psi: float,
    drawn_mm2: float,
    ordered: FloatArray,
    normal: FloatArray,
    out: FloatArray,
) -> tuple[float, float]:
    """Fill in the shifts of all dots, px, from a second-order surface fitted to ln of the heights of those not at the rim.

    Returns the parts' direction in the image; zeros where too few heights are known, and nothing is shifted.

    `ordered` and `normal` (7, 7), zero before, are work buffers.
    """
    n, share = len(heights), 1.0 / len(heights)
    u = v = cos = sin = 0.0
    for i in range(n):
        ordered[i] = heights[i]
        u, v = u + share * offset_px[i, 0], v + share * offset_px[i, 1]
    least = WHOLE * select(ordered, (3 * n) // 4)
    whole = 0
    for i in range(n):
        p, q, s, t = offset_px[i, 0] - u, offset_px[i, 1] - v, texture_mm[i, 0], texture_mm[i, 1]
        # R cos and R sin of theta up to a common factor, by least squares (`pose._similarity`): enough for a direction. Texture
        # points need not be from their middle, as offsets from theirs add up to 0
        cos, sin = cos + p * s + q * t, sin + q * s - p * t
        if heights[i] > least > 0.0:
            whole += 1
            # ln of the product of body and pressure is a sum: the slope of ln of the heights is the pressure's relative slope, in
            # 1/mm. The unit of the heights is absorbed by the constant term
            add_point(p / px_per_mm, q / px_per_mm, np.log(heights[i] / least), 1.0, normal)
    if whole < LEAST_WHOLE:
        return 0.0, 0.0
    for j in range(1, 6):
        # ridge regression: the variance of a height over that of the coefficient's prior
        normal[j, j] += (HEIGHT_ERROR / (SLOPE if j < 3 else BEND)) ** 2
    solve(normal)
    length = np.sqrt(cos * cos + sin * sin)
    along_u, along_v = (cos * np.cos(psi) - sin * np.sin(psi)) / length, (sin * np.cos(psi) + cos * np.sin(psi)) / length
    for i in range(n):
        p, q = (offset_px[i, 0] - u) / px_per_mm, (offset_px[i, 1] - v) / px_per_mm
        du = normal[1, 6] + normal[3, 6] * p + normal[5, 6] * q
        dv = normal[2, 6] + normal[4, 6] * q + normal[5, 6] * p
        # half of it along the part, minus half of it across: the mean of both is taken up by the rim's correction and the scale
        slope = along_u * du + along_v * dv
        move_u, move_v = drawn_mm2 * (slope * along_u - du / 2.0), drawn_mm2 * (slope * along_v - dv / 2.0)
        # beyond the dots that it was fitted to a second-order surface may be as steep as it likes
        share = px_per_mm * clip(FARTHEST_MM / clip(np.sqrt(move_u * move_u + move_v * move_v), 1e-9, np.inf), 0.0, 1.0)
        out[i, 0], out[i, 1] = share * move_u, share * move_v
    return along_u, along_v
