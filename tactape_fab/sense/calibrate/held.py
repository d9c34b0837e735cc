"""Frames of one press that is held: the gel has moved once, dots err alike in all of them, and more of them say little more."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from math import pi, radians

import numpy as np

from tactape_fab.sense.calibrate.adjust import Bundle
from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.texture.frames import FloatArray

SAME_MM, SAME_RAD = 0.3, radians(2.0)
"""Largest distance and turn of frames that may be of one press. Poses of one that is held scatter by up to 0.05 mm and 0.4 deg
with a gel that is displaced by 60 um (simulated); of ten presses anywhere on 50 x 18 mm two are so near in one set of 6000."""
LEAST_COMMON = 0.5
"""Least share of dots, of the frame with fewer, that both show: a sensor that rolls about its image's middle shows others."""
ALIKE = 0.5
"""Least correlation of the errors of dots that both show. With a gel that is displaced by 20 to 60 um it is 0.6 to 1 for nine in
ten pairs of frames of one press, and below 0.65 for nine in ten pairs of presses anew at one place (simulated)."""


def held_frames(presses: Sequence[Press], bundle: Bundle, posed: Collection[int] = ()) -> dict[int, int]:
    """Frames that show a press of another frame again, each with that frame: of each press the one with most dots stays.

    Presses anew at one place count as presses of their own where the gel's displacement tells them apart.

    bundle: Of these presses.
    posed: Frames with a pose of the arm, one of which stays where there is one.
    """
    kept: list[int] = []
    again: dict[int, int] = {}
    # of frames with as many dots the earlier stays: sorting is stable
    for k in sorted(range(len(presses)), key=lambda k: (presses[k].frame not in posed, -len(presses[k].weights))):
        first = next((j for j in kept if _same(presses, bundle, j, k)), None)
        if first is None:
            kept.append(k)
        else:
            again[presses[k].frame] = presses[first].frame
    return dict(sorted(again.items()))


def held_remark(again: dict[int, int]) -> list[str]:
    """The remark on frames that show a press again."""
    if not again:
        return []
    k, j = next(iter(again.items()))
    counted = "1 frame shows the press of another" if len(again) == 1 else f"{len(again)} frames show the presses of others"
    return [f"{counted} again (frame {k} that of frame {j}); a press that is held counts once: press elsewhere for another"]


def at_one_place(a: FloatArray, b: FloatArray) -> bool:
    """Whether two poses, x mm, y mm and theta rad, may be of one press."""
    turn = abs((a[2] - b[2] + pi) % (2.0 * pi) - pi)
    return bool(np.hypot(a[0] - b[0], a[1] - b[1]) <= SAME_MM and turn <= SAME_RAD)


def _same(presses: Sequence[Press], bundle: Bundle, j: int, k: int) -> bool:
    """Whether two frames are of one press."""
    a, b = presses[j], presses[k]
    if a.tape != b.tape or not at_one_place(bundle.poses[j], bundle.poses[k]):
        return False
    # a part is at one place in all frames
    of_a, of_b = np.intersect1d(_parts(a), _parts(b), return_indices=True)[1:]
    if len(of_a) < LEAST_COMMON * min(len(a.weights), len(b.weights)):
        return False
    # without a gel that is displaced, nothing tells whether it was lifted
    return bundle.errors.gel_mm == 0.0 or _correlation(bundle.residual_mm[j][of_a], bundle.residual_mm[k][of_b]) > ALIKE


def _parts(press: Press) -> FloatArray:
    return np.asarray(press.texture_mm[:, 0] + 1e6 * press.texture_mm[:, 1])


def _correlation(a: FloatArray, b: FloatArray) -> float:
    return float((a * b).sum() / max(np.sqrt((a**2).sum() * (b**2).sum()), 1e-18))
