"""The pose of a tilted contact: what the tilt does to the places of dots, and how sure that leaves the pose."""

from __future__ import annotations

from dataclasses import replace
from math import exp, inf, log, remainder, sqrt, tau

import numpy as np

from tactape_fab.sense.decode.contact.plane import terms
from tactape_fab.sense.decode.contact.surface import LEAST_SLOPE
from tactape_fab.sense.decode.grid.long_parts import BEND, HEIGHT_ERROR, SLOPE
from tactape_fab.sense.decode.grid.pose import Pose, fit_pose
from tactape_fab.sense.decode.rank import View
from tactape_fab.texture.frames import FloatArray

WHOLLY = 0.03
"""Slope, 1.7 degrees, from which a contact counts as tilted in full."""
DRAWN, DRAWN_ERROR = 0.345, 0.08
"""How far tops are drawn to where the pressure is by a relative slope of it of 1/mm, over the mean of the squares of length and
width, mm^2; and how much of that, as a share, is unsure. `long_parts` has the difference between along a part and across it; this
is what both have in common. Of 0201 it is 0.075 to 0.09 mm^2 from the middle of a contact down to a third of the height there,
tilted by 2 or 5 degrees along either axis, with 0.5 and 2 N; of 01005 0.03 mm^2 (seed 5 of the elastic simulator). All dots of a
tilted contact are drawn to its middle, which is millimetres off the image's centre: without it the pose is off by 8 um at 2
degrees along v, 4 along u."""
USUAL_BODY_MM = (0.6, 0.3)
"""Length and width where no part is known."""
FLOOR = 0.2
"""Least pressure that is believed, over that of whole dots."""
LOW, RELIABLE, STEEPNESS = 0.25, 0.6, 0.45
"""A low dot of a tilted contact is mostly not at the rim: put back, it errs by 14 um at a weight of 0.65, 17 at 0.5, 25 at 0.3.
So (`RELIABLE` - weight) / `STEEPNESS` of what it misses is left, but at least the first share and at most all."""
BORDER_MM, AT_BORDER = 0.65, 0.3
"""So near the image's border the filter mirrors a part, and its top is 5 to 25 um too far inside; most weight that it has."""
LEAN_MM = 0.045
"""How far beside the top of a part, over the slope, its dot may be."""
USUAL_MM, USUAL_DOTS = 0.0095, 8.0
"""Error of a dot under a tilt believed before the frame is seen, and how many dots this belief counts as: the scatter of 17 dots,
on which nine unknowns were fitted, is often too small by chance. A larger one is believed as it is."""
AS_DRAWN = 3.0
"""How much likelier it is that tops are drawn than that they are not, before the frame is seen. Gels of the imprint model have a
crown, so a slope beside their middle, but no pressure; heights of dots differ there, too."""
STRAIN = 2.4
"""Standard deviation of a linear displacement of the dots about their middle that is left, under a tilt of 5 degrees, over that
which independent errors of the dots make of it. It grows with the square of the slope. Seed 5 of the elastic simulator."""
PIXELS, PIXELS_DRAWN = 0.45, 0.31
"""Share of what is left, and of what tops are drawn by, in centres that are fitted to pixels (seed 5, 2 degrees, 0.5 N)."""
_STEEP = 0.0875


def tilted_pose(
    pose: Pose,
    slope: FloatArray,
    offset_px: FloatArray,
    seen_px: FloatArray,
    texture_mm: FloatArray,
    weights: FloatArray,
    heights: FloatArray,
    border_mm: FloatArray,
    view: View,
) -> tuple[Pose, FloatArray, tuple[FloatArray, FloatArray]]:
    """The pose with the tilt's bias taken off and its uncertainty in the covariance; the places of dots that it is fitted to, and
    for `of_pixels` what of the covariance is the tilt's, and how far the tops' drawing moved the pose, mm and rad.

    A tilted tape is seen foreshortened along its slope, by the cosine of its tilt. Its pressure falls all across the contact, and
    draws the tops of all dots along: where `rim.settled` took low dots for those at a rim, the heights say it better. A strain of
    the contact looks as the camera's scale, aspect and shear do, but about the contact's middle: it moves the image's centre,
    which is far from it under a tilt.

    pose: Fitted to `offset_px`.
    slope (2,): Rise of the tape towards the sensor along image u and v.
    offset_px, seen_px (n, 2): Dots from the image centre, square pixels: with those at the rim put back, and as detected.
    texture_mm, weights, view: As for `fit_pose`.
    heights (n,): Of the tops, in any unit.
    border_mm (n,): How far dots are from the image's border.
    """
    square = float(slope @ slope)
    share = min(max((sqrt(square) - LEAST_SLOPE) / (WHOLLY - LEAST_SLOPE), 0.0), 1.0)
    weights = 1.0 - (1.0 - weights) * (1.0 - share + share * np.clip((RELIABLE - weights) / STEEPNESS, LOW, 1.0))
    weights = np.where(border_mm < BORDER_MM, np.minimum(weights, AT_BORDER), weights)
    length_mm, width_mm = USUAL_BODY_MM if view.part is None else view.part.body_mm[:2]
    drawn_mm2 = share * DRAWN * (length_mm**2 + width_mm**2) / 2.0
    drawn = drawn_mm2 * view.px_per_mm * _relative_slopes(heights, offset_px / view.px_per_mm)
    moved = offset_px + share * (seen_px - offset_px) - drawn
    moved = _upright(moved, slope)
    found = fit_pose(moved, texture_mm, weights, view.px_per_mm, view.beliefs)
    undrawn = fit_pose(_upright(offset_px, slope), texture_mm, weights, view.px_per_mm, view.beliefs)
    if not (np.isfinite(found.position_mm).all() and np.isfinite(found.covariance).all() and np.isfinite(found.px_per_mm)):
        return pose, offset_px, (np.zeros((3, 3)), np.zeros(3))
    # what may be left: a share of what was taken off, a lean of the tops, and a strain about the dots' middle
    count = float(np.count_nonzero(pose.agree))
    believed = sqrt((count * found.sigma_mm**2 + USUAL_DOTS * USUAL_MM**2) / (count + USUAL_DOTS))
    sigma_mm, from_middle = max(found.sigma_mm, believed), moved - moved[pose.agree].mean(axis=0)
    reach, directions = np.linalg.eigh(from_middle[pose.agree].T @ from_middle[pose.agree])
    sigmas = STRAIN * (square / _STEEP**2) * sigma_mm * view.px_per_mm / np.sqrt(np.maximum(reach, 1e-300))
    left = [DRAWN_ERROR * drawn, np.broadcast_to(LEAN_MM * view.px_per_mm * slope, moved.shape)]
    left += [s * (from_middle @ d)[:, None] * along for s, d in zip(sigmas, directions.T, strict=True) for along in np.eye(2)]
    changes = np.zeros((len(left), 3))
    for by, change in zip(left, changes, strict=True):
        other = fit_pose(moved + by, texture_mm, weights, view.px_per_mm, view.beliefs)
        change[:2], change[2] = other.position_mm - found.position_mm, remainder(other.theta_rad - found.theta_rad, tau)
    changes[~np.isfinite(changes).all(axis=1)] = 0.0
    apart = np.array([*(undrawn.position_mm - found.position_mm), remainder(undrawn.theta_rad - found.theta_rad, tau)])
    not_drawn = _share_not_drawn(found.sigma_mm, undrawn.sigma_mm, count) if np.isfinite(apart).all() else 0.0
    apart[~np.isfinite(apart)] = 0.0
    strain = changes.T @ changes + (1.0 - not_drawn) * not_drawn * np.outer(apart, apart)
    own = found.covariance * (sigma_mm / found.sigma_mm) ** 2
    towards = not_drawn * apart
    mixed = replace(
        found,
        position_mm=found.position_mm + towards[:2],
        theta_rad=remainder(found.theta_rad + float(towards[2]), tau),
        covariance=own + strain,
        agree=pose.agree,
    )
    return mixed, moved, (strain, (1.0 - not_drawn) * changes[0] / DRAWN_ERROR)


def of_pixels(pose: Pose, tilted: tuple[FloatArray, FloatArray]) -> Pose:
    """A pose from the pixels of a tilted contact, less its bias, and its covariance; `tilted` is from `tilted_pose`."""
    strain, drawn = tilted
    x, y, turn = (PIXELS_DRAWN * drawn).tolist()
    return replace(
        pose,
        position_mm=pose.position_mm - (x, y),
        theta_rad=remainder(pose.theta_rad - turn, tau),
        covariance=pose.covariance + PIXELS**2 * strain,
    )


def _share_not_drawn(drawn_mm: float, undrawn_mm: float, dots: float) -> float:
    """Probability that no top is drawn, from the errors of dots under either law; a dot counts once, as neighbours err alike."""
    if not (0.0 < drawn_mm < inf and 0.0 < undrawn_mm < inf):
        return 0.0
    odds = log(AS_DRAWN) + dots * (log(undrawn_mm) - log(drawn_mm))
    return 1.0 / (1.0 + exp(min(odds, 700.0)))


def _upright(seen_px: FloatArray, slope: FloatArray) -> FloatArray:
    """Places as on a tape that is not tilted: the cosine of the tilt along its slope is taken out."""
    square = float(slope @ slope)
    return seen_px + ((sqrt(1.0 + square) - 1.0) / square) * (seen_px @ slope)[:, None] * slope


def _relative_slopes(heights: FloatArray, at_mm: FloatArray) -> FloatArray:
    """Slopes of the pressure at the dots over the pressure, 1/mm, by a second-order surface through their heights; (n, 2)."""
    rows = terms(at_mm - at_mm.mean(axis=0))
    shares = heights / max(float(np.sort(heights)[3 * len(heights) // 4]), 1e-300)
    known, level = rows[shares > 0.0], shares[shares > 0.0]
    prior = np.diag([1e-9, *[(HEIGHT_ERROR / SLOPE) ** 2] * 2, *[(HEIGHT_ERROR / BEND) ** 2] * 3])
    surface = np.linalg.solve(known.T @ known + prior, known.T @ level)
    along_u = surface[1] + surface[3] * rows[:, 1] + surface[5] * rows[:, 2]
    along_v = surface[2] + surface[4] * rows[:, 2] + surface[5] * rows[:, 1]
    return np.stack([along_u, along_v], axis=1) / np.maximum(rows @ surface, FLOOR)[:, None]
