"""Whether parts that a line places may point in eight directions: how often their scatter turns a symbol into its neighbour."""

from __future__ import annotations

from math import ceil, erfc, pi, sin, sqrt
from statistics import NormalDist

PLACEMENT_MM = 0.05
"""Standard deviation of a placed part along each axis that is believed of a line; no fab's figure. Printed elements have none."""
MOST_SYMBOL_ERRORS = 0.01
"""Share of parts that may show a wrong symbol: the smallest contacts have some ten parts, and one in ten of them then has one."""
_HALF_STEP = sin(pi / 8.0)


def symbol_errors(displacement_mm: float, placement_mm: float = PLACEMENT_MM) -> float:
    """Share of parts that stand nearer to the place of a neighbouring direction, of eight, than to their own.

    Two neighbours are 2 Δ sin(22.5 deg) apart, and a part has one on each side.
    """
    return erfc(displacement_mm * _HALF_STEP / (placement_mm * sqrt(2.0)))


def least_displacement_mm(placement_mm: float = PLACEMENT_MM, most: float = MOST_SYMBOL_ERRORS) -> float:
    """The displacement, in whole hundredths of a millimetre, from which on no more symbols than that are wrong."""
    scatters = NormalDist().inv_cdf(1.0 - most / 2.0)
    return ceil(100.0 * scatters * placement_mm / _HALF_STEP) / 100.0


def scatter_refusal(displacement_mm: float) -> str | None:
    """Why eight directions of such a displacement are refused to parts that a line places; None where they are not."""
    errors = symbol_errors(displacement_mm)
    if errors <= MOST_SYMBOL_ERRORS:
        return None
    return (
        f"directions = 8 at displacement_mm = {displacement_mm:g} mm: parts that a line places scatter by {PLACEMENT_MM:g} mm "
        f"along each axis, and {100.0 * errors:.1f} % of them would show a neighbouring direction, more than "
        f"{100.0 * MOST_SYMBOL_ERRORS:g} %; use --delta {least_displacement_mm():g} or more, a printed element "
        "(--part block --process sla), or 4 directions"
    )
