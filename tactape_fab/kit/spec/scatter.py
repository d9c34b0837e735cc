"""Placement scatter with eight directions: how often it turns a symbol into a neighbouring one."""

from __future__ import annotations

from math import ceil, erfc, pi, sin, sqrt

PLACEMENT_MM = 0.05
"""Assumed standard deviation of a placed part along each axis, mm; not a fab's figure. Printed elements have none."""
MOST_SYMBOL_ERRORS = 0.01
"""Fraction of parts that may show a wrong symbol: the smallest contacts have about ten parts, so one contact in ten has one."""
ROOMY_PITCH_MM = 2.0
"""Pitch at which 0201 chips with that displacement meet the gap limits of all fabs that come with the package."""
_HALF_STEP = sin(pi / 8.0)
_BLOCK_REACH_MM = 0.338
"""Reach of the block at any rotation, half the diagonal of 0.6 x 0.3 mm, with its clearance, mm; rounded up."""


def symbol_errors(displacement_mm: float) -> float:
    """Fraction of parts that are nearer to the place of a neighbouring direction, of eight, than to their own.

    Two neighbours are 2 Δ sin(22.5 deg) apart, and a part has one on each side.
    """
    # The boundary to a neighbour is h = Δ sin 22.5 deg away, half their distance. The scatter along that direction is normal with
    # sigma s: P(beyond) = erfc(h / (s sqrt 2)) / 2, with a boundary on each side. Places beyond both, behind the grid point, are
    # counted twice, so the sum is an upper bound
    return erfc(displacement_mm * _HALF_STEP / (PLACEMENT_MM * sqrt(2.0)))


def least_displacement_mm() -> float:
    """Least displacement, in whole hundredths of a millimetre, at which at most `MOST_SYMBOL_ERRORS` of the symbols are wrong."""
    from statistics import NormalDist  # imported here: it loads decimals and fractions

    # the same equation solved for h, with MOST_SYMBOL_ERRORS in both tails together
    scatters = NormalDist().inv_cdf(1.0 - MOST_SYMBOL_ERRORS / 2.0)
    return ceil(100.0 * scatters * PLACEMENT_MM / _HALF_STEP) / 100.0


def scatter_refusal(displacement_mm: float, pitch_mm: float, of_film: str = "") -> str | None:
    """Reason why placed parts cannot have eight directions at this displacement; None if they can.

    of_film: Options that a printed element has not, such as `` without --fab``.
    """
    errors = symbol_errors(displacement_mm)
    if errors <= MOST_SYMBOL_ERRORS:
        return None
    least = f"--delta {least_displacement_mm():g} or more"
    if pitch_mm < ROOMY_PITCH_MM:  # pads might be too near at this pitch
        least = f"--w {ROOMY_PITCH_MM:g} --delta {least_displacement_mm():g}"
    block_mm = ceil(round(2000.0 * (_BLOCK_REACH_MM + displacement_mm), 3)) / 1000.0
    wider = "" if pitch_mm >= block_mm else f" --w {block_mm:g} --delta {displacement_mm:g}"
    return (
        f"directions = 8 at displacement_mm = {displacement_mm:g} mm: parts that a line places scatter by {PLACEMENT_MM:g} mm "
        f"along each axis, and {100.0 * errors:.1f} % of them would show a neighbouring direction, more than "
        f"{100.0 * MOST_SYMBOL_ERRORS:g} %; use {least}, or --directions 4, "
        f"or a printed element, --part block --process sla{wider}{of_film}"
    )
