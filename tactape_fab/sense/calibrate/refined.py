"""Presses whose dots' centres come from the pixels around them: no neighbour and no filter draws these."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import cos, radians, sin

import numpy as np

from tactape_fab.sense.calibrate.adjust import LEAST_AGREEING
from tactape_fab.sense.calibrate.presses import Frame, Press
from tactape_fab.sense.decode.dots.filters import averaged
from tactape_fab.sense.decode.dots.inputs import canonical_frame
from tactape_fab.sense.decode.pixels.patches import PixelFit, has_patch, median, pixel_fit, settled_patches, unknown_relief
from tactape_fab.sense.decode.pixels.refine import MOST_MISFIT, at_rim, mm_of_px
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.tape import Tape

MOST_LOW = 0.3
"""Dots that miss a larger share of their height are left out: so far out on the rim its slope is not constant over the dot."""


def refined(frames: Sequence[Frame], presses: Iterable[Press], sensor: SensorProfile, tapes: Sequence[Tape]) -> list[Press]:
    """Presses with centres from the pixels, but for those whose parts' relief is not known, or that do not look like it.

    presses: With all their dots, at poses by which no dot is off by more than a quarter of a part.
    sensor: With a camera as good.
    """
    parts, fit, out = {tape.name: tape.part for tape in tapes}, pixel_fit(sensor), []
    for press in presses:
        part = parts[press.tape]
        if unknown_relief(part) is None:
            image = canonical_frame(frames[press.frame], sensor)
            found = _refined(fit, averaged(image, fit.factor) if fit.factor > 1 else image, press, part)
            out += [] if found is None else [found]
    return out


def _refined(fit: PixelFit, image: Frame, press: Press, part: TapePart) -> Press | None:
    at = (press.seen_px - (fit.factor - 1) / 2) / fit.factor
    chosen = np.flatnonzero(has_patch(fit, at))
    if len(chosen) < LEAST_AGREEING:
        return None
    at, theta = at[chosen], press.theta_rad
    turn = theta - radians(part.rotation_deg)
    to_body = np.array([[cos(turn), sin(turn)], [-sin(turn), cos(turn)]]) @ mm_of_px(fit, at)
    found, centres = settled_patches(fit, image, at, to_body, part)
    # also where it is NaN
    if not median(found.misfit) <= MOST_MISFIT:
        return None
    inwards, low = at_rim(press.texture_mm[chosen], press.texture_mm, found.imprint)
    kept = (found.height > 0.0) & (low < MOST_LOW)
    if kept.sum() < LEAST_AGREEING:
        return None
    c, s = cos(theta), sin(theta)
    # texture to gel: R(theta)^T, for rows
    on_gel = inwards @ np.array([[c, s], [-s, c]])
    return replace(
        press.taken(chosen[kept]),
        seen_px=centres[kept] * fit.factor + (fit.factor - 1) / 2,
        rim_mm=np.zeros((int(kept.sum()), 2)),
        weights=1.0 - low[kept],
        # the fit of a patch has the neighbours in it; the rim still draws a centre inwards, by the height that is missing
        pushed=np.zeros((int(kept.sum()), 2)),
        pulled=(-low[:, None] * on_gel)[kept],
        fine=True,
        by_edges=0.0,
    )
