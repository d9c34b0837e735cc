"""Valid area: pixels of a sensor's frames that carry depth, from frames alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_erosion, binary_opening

from tactape_fab.sense.calibrate.presses import Frame
from tactape_fab.sense.decode.dots.inputs import shown_pixels
from tactape_fab.sense.decode.rule import BACKGROUND_MM
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import BoolArray

LEAST_FRAMES = 3
"""With fewer frames a pixel may have the same value in all of them by chance."""
_THIN_PX = 4
"""Blind areas less wide than this are single pixels, which smoothing hides."""
LEAST_SHARE = 0.05
"""Share of a frame that must carry depth for it to be looked at."""


def valid_pixels(frames: Sequence[Frame], like: SensorProfile) -> BoolArray | None:
    """Pixels that change from frame to frame and are mostly finite; None where that is all of them.

    A blind pixel holds the same value in every frame, or NaN. The noise of a real one is never exactly zero. What the mask of
    `like` hides is not looked at: it counts as valid.
    """
    frames = [frame for frame in frames if np.isfinite(frame).any()]
    if len(frames) < LEAST_FRAMES:
        return None
    first = frames[0]
    changes, holes = np.zeros(first.shape, dtype=bool), np.zeros(first.shape, dtype=np.int64)
    for frame in frames:
        finite = np.isfinite(frame)
        holes += ~finite
        # where the first frame is NaN any finite value differs from it
        changes |= finite & (frame != first)
    valid: BoolArray = changes & (2 * holes < len(frames))
    if like.mask is not None:
        valid |= ~shown_pixels(like)
    return None if valid.all() else valid


def clear_of_blind(valid: BoolArray, px_per_mm: float) -> BoolArray | None:
    """Pixels from which a detector sees no blind area: its band-pass takes a mean over `BACKGROUND_MM`, and a step of the
    depth within that draws dots by up to 0.1 mm. Single blind pixels are let through. None where all are clear.
    """
    # padded by its own edge: a blind strip of a pixel or two along the border counts as wide
    blind = binary_opening(np.pad(~valid, _THIN_PX, mode="edge"), np.ones((_THIN_PX, _THIN_PX), dtype=bool))
    blind = blind[_THIN_PX:-_THIN_PX, _THIN_PX:-_THIN_PX]
    reach = round(BACKGROUND_MM / 2.0 * px_per_mm)
    # beyond the image is not blind: dots near its sides are judged elsewhere (`presses.SIDE_MM`)
    clear: BoolArray = binary_erosion(~blind, np.ones((3, 3), dtype=bool), iterations=reach, border_value=1)
    return None if clear.all() else clear
