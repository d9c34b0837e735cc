"""Tops that are cut off, as where the range of a format or of a sensor ends: told by many pixels of the largest depth."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np

from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.result import Localization

CUT_SHARE, FLAT_SHARE = 0.003, 0.3
"""Shares of the pixels with the largest depth between which tops count as cut off. Beyond the second it is the background's. One
averaged pixel has that depth where tops are whole, also in steps of 1/60 of a frame's range; cut at the quantile 0.99 of the
depths, 0.006 have it (simulated contacts, imprinted and elastic)."""
CUT_VARIANCE = 2.0
"""Factor on the variances of a pose from such tops: what is left of them errs by more than its scatter tells. Without it, 5 to
15 % of frames cut at the quantiles 0.85 to 0.99 have errors that 5 % should have.
`python -m tests.bench.nees` measures it, in its rows of depths that are cut off."""


def cut_share(image: Image) -> float:
    """Share of the pixels that have the largest depth, where tops are cut off; else 0.

    image (h, w): With pixels, and finite: the image that dots were detected in, `Dots.small`.
    """
    share = float(np.count_nonzero(image == image.max())) / image.size
    return share if CUT_SHARE <= share <= FLAT_SHARE else 0.0


def as_cut(fix: Localization, image: Image) -> Localization:
    """An answer from such tops: less sure where it is located, otherwise with a reason that says so, and a remedy.

    image (h, w): The canonical depth map.
    """
    if not fix.located:
        share = float(np.count_nonzero(image == image.max())) / image.size
        of_pixels = f"{100 * share:.2g} % of the pixels have the largest depth"
        return replace(fix, reason=f"{fix.reason}; {of_pixels}: if tops are cut off there, write depths with a larger range")
    if fix.covariance is None or fix.strain_sigma is None:  # the paper's method states none
        return fix
    aspect, shear = (None if sigma is None else sqrt(CUT_VARIANCE) * sigma for sigma in fix.strain_sigma[:2])
    return replace(fix, covariance=CUT_VARIANCE * fix.covariance, strain_sigma=(aspect, shear, None))
