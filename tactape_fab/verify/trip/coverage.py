"""Map of the information limit: where on a tape a contact of a given size can be located with error-free dots."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.trip.round_trip import Contact, Progress

TURNS = 3
"""Number of angles tried at each place, within half a turn, after which an ellipse repeats."""
_PLACES, _LEAST_STEP_MM = 800, 1.0
_GOLDEN_DEG = 180.0 * (sqrt(5) - 1) / 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coverage:
    """Fraction of the angles at which a contact is located, by the place of its centre.

    x_mm, y_mm (m,), (n,): Texture frame, evenly spaced.
    share (n, m): Fraction from 0 to 1.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    share: FloatArray


def coverage_of(tape: Tape, contact: Contact, progress: Progress = lambda *_: None) -> Coverage:
    """Apply the decoder's decision rule at each place of the board to dots exactly at the parts' places.

    contact: Noise and elastomer are ignored.
    """
    from tactape_fab.verify.trip.limit import error_free, rule_of

    rule = rule_of(tape, contact.sensor)
    width_mm, height_mm = tape.board.size_mm
    x0, y0 = tape.board.texture_origin_mm
    step_mm = max(sqrt(width_mm * height_mm / _PLACES), _LEAST_STEP_MM)
    x_mm, y_mm = (_middles(side, step_mm) for side in (width_mm, height_mm))
    # texture x = board x - x0, texture y = y0 - board y: rows from the upper edge, board y = height - y
    x_mm, y_mm = x_mm - x0, y_mm + y0 - height_mm
    share = np.zeros((len(y_mm), len(x_mm)))
    for place, (j, i) in enumerate(np.ndindex(share.shape)):
        for turn in range(TURNS):
            # golden-ratio steps of half a turn spread the angles of neighbouring places evenly, so three per place suffice
            theta_deg = (place * _GOLDEN_DEG + turn * 180.0 / TURNS) % 360.0 - 180.0
            share[j, i] += error_free(rule, np.array([x_mm[i], y_mm[j], theta_deg]), contact.scene).located
        progress("map: place", place + 1, share.size)
    return Coverage(x_mm=x_mm, y_mm=y_mm, share=share / TURNS)


def _middles(length_mm: float, step_mm: float) -> FloatArray:
    """Centres of equal intervals that fill a length, mm."""
    count = max(round(length_mm / step_mm), 1)
    return (np.arange(count) + 0.5) * length_mm / count
