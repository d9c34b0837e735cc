"""The pose of a tilted contact: dots corrected for the tilt, and the covariance with what the correction leaves uncertain."""

from __future__ import annotations

from dataclasses import replace
from math import cos, exp, inf, log, pi, remainder, sin, sqrt, tau

import numpy as np

from tactape_fab.sense.decode.contact.bent import Bend
from tactape_fab.sense.decode.contact.surface import LEAST_SLOPE, Lie
from tactape_fab.sense.decode.grid.long_parts import BEND, HEIGHT_ERROR, SLOPE, drawn_px
from tactape_fab.sense.decode.grid.pose import Pose, fit_pose
from tactape_fab.sense.decode.rank import View
from tactape_fab.texture.frames import FloatArray

WHOLLY = 0.0175
"""Slope, 1 degree, from which a contact counts as tilted in full."""
BENT, WHOLLY_BENT = 0.01, 0.03
"""Curvatures, 1/mm, between which a bent contact goes from not counting to counting in full as one with a pressure gradient. With
0.5 to 8 N round 15.7 to 70 mm NEES/3 is 0.6 to 1.3 so; up to 0.02 it is as good and angles are worse, up to 0.06 it is 1.8."""
USUAL_PART_MM, UNSTRETCHED_MM = 0.23, 0.06
"""Height of a part that is not known, about which it may be wrong by as much; and how far below a film's top its layer is that is
not stretched round a cylinder, half of a film."""
DRAWN, DRAWN_ROUND, DRAWN_SIGMA, DRAWN_ERROR = (0.01296, 53 / 45), 0.09, 0.25, 0.25
"""How far a top is drawn to where the pressure is, mm^2, by a relative slope of the pressure of 1/mm: a constant, and what goes
with the fourth power of the part's side along that slope, mm^-2, as a longer top is flatter. Of domes and cones over the square
of their diameter. And how much of that, as a share, is unsure. Of 0201 it is 0.16 mm^2 along and 0.02 across, of 0402 2 and
0.1, of squares of 0.5, 0.6 and 0.8 mm 0.09, 0.2 and 0.9, of domes of 0.6 and 1 mm 0.03 and 0.1, with 0.5 to 3 N, tilted by 2 to
5 degrees along either axis (constants here: seeds 0, 5, 61 and 77 of the elastic simulator). All dots of a tilted contact are
drawn to its middle, millimetres off the image's centre: the pose would be 10 um off at 2 degrees. Under light forces, and in
gels that follow a part less, it is up to twice as much: `DRAWN_SIGMA` of it is a factor that the dots tell, `DRAWN_ERROR` what
they do not."""
MOST_DRAWN, FLAT_MOST = 0.13, (0.4, -0.162)
"""Largest such shift, over length and width: tops of 0201 come near to 0.08 mm from a relative slope of 0.5/mm on. From 0.6 mm on
it is a share of the side, and mm: longer tops are drawn until near their ends."""
EDGES_DRAWN = 0.13
"""The same of middles between edges on a bent tape, mm^3, over a relative slope of the pressure and a curvature, both 1/mm. Tops
lean outwards with the tape, and under light forces the gel leaves them on that side first: round 10 to 60 mm, with 0.5 to 5 N,
they are up to 25 um inside, as far as slopes of the pressure times the curvature say (elastic simulator, seed 1)."""
USUAL_BODY_MM = (0.45, 0.45)
"""Length and width, mm, assumed for an unknown part, whose direction is unknown too."""
TWIST = 0.02
"""Prior standard deviation of the pressure's third derivatives over the pressure, 1/mm^3. A tilted contact ends at the image's
border on one side: there a surface of second order errs as a lens would, and shifts the pose by 15 um at 5 degrees."""
SLIGHT_MM = 190.0
"""A slight tilt that is not taken off moves the position by its slope times this, times the draw over the area of the dots. Of
0201 that is 5 um at 0.7 degrees and 0.5 N, 2.5 um at 1 to 3 N, 1 where the image is full of dots (elastic simulator, seed 21)."""
_HEIGHT_PRIORS = np.diag([1e-9, *(HEIGHT_ERROR / np.repeat((SLOPE, BEND, TWIST), (2, 3, 4))) ** 2])
_FACTORS = np.array([[1.0], [1.0], [1.0], [0.5], [1.0], [0.5], [1 / 6], [0.5], [0.5], [1 / 6]])
_DERIVATIVES = np.array([[1, 3, 4, 6, 7, 8], [2, 4, 5, 7, 8, 9]])
FLOOR = 0.2
"""Lower limit of the fitted pressure, over that of full dots."""
LOW, RELIABLE, STEEPNESS = 0.15, 0.6, 0.45
"""A low dot of a tilted contact is mostly not at the rim: put back, it errs by 16 um at a weight of 0.65, 18 at 0.5, 22 at 0.4.
So (`RELIABLE` - weight) / `STEEPNESS` of what it misses is left, but at least the first share and at most all."""
BORDER_MM, AT_BORDER = 0.65, 0.3
"""So near the image's border the filter mirrors a part, and its top is 5 to 25 um too far inside; largest weight of such dots."""
LEAN_MM = 0.03
"""Standard deviation of a dot's offset from the top of its part, over the slope of the tape."""
USUAL_MM, USUAL_DOTS = 0.011, 3.0
"""Prior standard deviation of a dot under a tilt, and the number of dots that it counts as: the scatter of 17 dots, to which nine
unknowns were fitted, is often too small by chance. A larger scatter is used as it is."""
CANCELS, CANCELS_MM = 0.36, 0.0085
"""Share of the dots' variance that does not move a pose, up to this standard deviation: under pressure neighbours push each other
by 20 um, equal and opposite. Further variance, as by misplaced parts, counts in full."""
AS_DRAWN = 0.3
"""Prior odds, for tops that are not those of a film, that they are drawn rather than not tilted. Contacts of the imprint model
beside the crown of a gel have a slope but no pressure gradient, which the dots' residuals show as well."""


def tilted_pose(
    pose: Pose,
    lie: Lie,
    offset_px: FloatArray,
    seen_px: FloatArray,
    texture_mm: FloatArray,
    weights: FloatArray,
    heights: FloatArray,
    border_mm: FloatArray,
    view: View,
    by_maxima: float = 1.0,
) -> tuple[Pose, FloatArray, bool]:
    """The pose with the tilt's bias taken off and its uncertainty in the covariance; the places of dots that it is fitted to; and
    whether their tops are drawn, as under a tilt they are.

    A tilted tape is seen foreshortened along its slope, by the cosine of its tilt, one round a cylinder towards its flanks. The
    pressure falls all across the contact, and draws the tops of all dots along: where `rim.settled` took low dots for those at a
    rim, and `long_parts` the heights of whole ones, the heights of all say it better.

    pose: Fitted to `offset_px`.
    offset_px, seen_px (n, 2): Dots from the image centre, square pixels: with those at the rim put back, and as detected.
    texture_mm, weights, view: As for `fit_pose`.
    heights (n,): Of the tops, in any unit.
    border_mm (n,): How far dots are from the image's border.
    by_maxima: How far dots are at maxima, which are drawn, and not between the edges of their bodies (`Dots.by_edges`).
    """
    slope, unsure, bend, film, dome = lie
    square = float(slope @ slope)
    # a ramp from 0.75 to 1 degree, so that a pose does not jump where the slope passes a limit
    share = min(max((sqrt(square) - LEAST_SLOPE) / (WHOLLY - LEAST_SLOPE), 0.0), 1.0)
    if bend is not None:
        share = max(share, min(max((abs(bend.curvature) - BENT) / (WHOLLY_BENT - BENT), 0.0), 1.0))
    slight = np.zeros(3)  # by how much a film's slight tilt is expected to move the pose, as far as that is not taken off below
    if film and bend is None and share < 1.0:
        c, s = cos(pose.theta_rad), sin(pose.theta_rad)
        by_slope = SLIGHT_MM * float(_drawn_by_slope_mm2(view).max()) / (float(pose.agree.sum()) * view.pitch_mm**2)
        slight[:2] = (1.0 - share) * by_slope * (np.array([[c, s], [-s, c]]) @ slope)
        if share == 0.0:
            return replace(pose, covariance=pose.covariance + np.outer(slight, slight)), offset_px, False
    # of the height 1 - w that a dot misses only a share counts (`RELIABLE`), as far as the contact is tilted
    detected = weights
    weights = 1.0 - (1.0 - weights) * (1.0 - share + share * np.minimum(np.maximum((RELIABLE - weights) / STEEPNESS, LOW), 1.0))
    weights = np.where(border_mm < BORDER_MM, np.minimum(weights, AT_BORDER), weights)
    slopes = _relative_slopes(heights, offset_px / view.px_per_mm)
    at_edges = 0.0 if bend is None else EDGES_DRAWN * abs(bend.curvature) * slopes
    drawn = share * view.px_per_mm * (by_maxima * _drawn_mm(slopes, pose, view) + (1.0 - by_maxima) * at_edges)
    along_parts = None if view.part is None else drawn_px(view.part, heights, offset_px, texture_mm, view.px_per_mm)
    if along_parts is not None:  # has been taken off, by heights of whole dots alone
        seen_px = seen_px + by_maxima * along_parts.shift_px
    # `settled`'s correction is taken back as far as the contact counts as tilted, the draw of the pressure taken off instead
    places = offset_px + share * (seen_px - offset_px) - drawn
    # positions on the flat film, and what is unsure of them: the bend's parameters, or the length of the slope
    laid = _upright(places, np.outer((1.0, 1.0 + unsure), slope)) if bend is None else _laid(places, bend, view)
    moved, unsure_px = laid[0], DRAWN_SIGMA * drawn
    # with the whole error of maxima at a rim, also where dots are between edges: under a tilt of 2 degrees those of 1.0 mm parts
    # are off alike by 4 um, and half of it left NEES/3 at 3
    found = fit_pose(moved, texture_mm, weights, view.px_per_mm, view.beliefs, unsure_px=unsure_px)
    if found.fitted is None or found.used is None or not (found.finite and 0.0 < found.sigma_mm < inf):
        return pose, offset_px, False
    # changes of the pose by one standard deviation of an uncertain amount, as which a share of the draw and a lean of the tops
    # count, too: their outer products are added to the covariance
    left = np.empty((len(laid) + 1, *moved.shape))
    left[0], left[1], left[2:] = DRAWN_ERROR * drawn, LEAN_MM * view.px_per_mm * slope, laid[1:] - moved
    changes = np.vstack([found.fitted.changes(left.take(found.used, 1) / view.px_per_mm), slight])
    changes[~np.isfinite(changes).all(axis=1)] = 0.0
    count = float(pose.agree.sum())
    # without drawn tops the tape is flat, under a dome or none, or a film that is bent all the same
    undrawn, undrawn_px, not_drawn = pose, offset_px, 0.0
    if not film:
        if bend is not None:
            flat_px = _laid(offset_px, bend, view)[0]
            flat = fit_pose(flat_px, texture_mm, detected, view.px_per_mm, view.beliefs)
            undrawn, undrawn_px = (flat, flat_px) if flat.finite else (pose, offset_px)
        not_drawn = _share_not_drawn(found.sigma_mm, undrawn.sigma_mm, count)
    # the variance of a dot, a weighted mean of the frame's and of the prior's, over the frame's
    own = max((count + USUAL_DOTS * (USUAL_MM / found.sigma_mm) ** 2) / (count + USUAL_DOTS), 1.0)
    own -= CANCELS * min(CANCELS_MM / found.sigma_mm, 1.0) ** 2
    found = replace(found, covariance=own * found.covariance, agree=pose.agree)
    shares = (1.0 - dome, 0.0, dome) if film else (1.0 - not_drawn, (1.0 - dome) * not_drawn, dome * not_drawn)
    mixed = _mixture(shares, (found, undrawn, pose), changes.T @ changes)
    likeliest = shares.index(max(shares))
    return mixed, (moved, undrawn_px, offset_px)[likeliest], likeliest == 0


def _mixture(shares: tuple[float, ...], poses: tuple[Pose, ...], strain: FloatArray) -> Pose:
    """The first of poses with mean and covariance of their mixture (law of total variance).

    shares: Probability of each.
    strain (3, 3): Covariance of errors that all have besides.
    """
    first = poses[0]
    if shares[0] == 1.0:
        return replace(first, covariance=first.covariance + strain)
    shares, poses = zip(*(pair for pair in zip(shares, poses, strict=True) if pair[0] > 0.0), strict=True)
    of = np.array(shares)
    apart = np.array([[*(p.position_mm - first.position_mm), remainder(p.theta_rad - first.theta_rad, tau)] for p in poses])
    towards = of @ apart
    scatter = (of * (apart - towards).T) @ (apart - towards)
    within = sum((share * pose.covariance for share, pose in zip(shares, poses, strict=True)), strain)
    return replace(
        first,
        position_mm=first.position_mm + towards[:2],
        theta_rad=remainder(first.theta_rad + float(towards[2]), tau),
        covariance=within + scatter,
    )


def _share_not_drawn(drawn_mm: float, undrawn_mm: float, dots: float) -> float:
    """Probability that no top is drawn, from the dots' residuals with and without the draw, for which neighbours err alike."""
    if not (0.0 < drawn_mm < inf and 0.0 < undrawn_mm < inf):
        return 0.0
    # a normal law with its own best sigma has the likelihood sigma^-2 for each dot, over the two axes; half of that counts
    odds = log(AS_DRAWN) + dots * (log(undrawn_mm) - log(drawn_mm))
    return 1.0 / (1.0 + exp(min(odds, 700.0)))


def _laid(seen_px: FloatArray, bend: Bend, view: View) -> FloatArray:
    """Positions on the flattened film, from the image centre, square pixels, as `Bend.unrolled` has them; (5, n, 2)."""
    part_mm, error_mm = (USUAL_PART_MM, USUAL_PART_MM) if view.part is None else (view.part.body_mm[2], UNSTRETCHED_MM)
    return bend.unrolled(seen_px / view.px_per_mm, part_mm, error_mm) * view.px_per_mm


def _upright(seen_px: FloatArray, slopes: FloatArray) -> FloatArray:
    """Positions as on an untilted tape: the foreshortening by the cosine of the tilt along the slope is removed.

    seen_px (n, 2); slopes (k, 2)
    Returns: (k, n, 2), for each slope.
    """
    squares = (slopes * slopes).sum(axis=1)
    # seen from above a tape of slope g is shorter along g by cos = 1 / sqrt(1 + g^2); g g^T / g^2 projects on that direction
    longer = (np.sqrt(1.0 + squares) - 1.0) / squares
    return np.asarray(seen_px + (longer[:, None] * (slopes @ seen_px.T))[:, :, None] * slopes[:, None])


def _drawn_mm(slopes: FloatArray, pose: Pose, view: View) -> FloatArray:
    """Shift of the tops, mm, by relative slopes of the pressure, 1/mm, in image axes; both (n, 2)."""
    size_mm = np.array(USUAL_BODY_MM if view.part is None else view.part.body_mm[:2])
    psi = 0.0 if view.part is None else pose.theta_rad - view.part.rotation_deg * pi / 180.0
    to_part = np.array([[cos(psi), -sin(psi)], [sin(psi), cos(psi)]])  # for rows
    most_mm = np.maximum(MOST_DRAWN * size_mm, FLAT_MOST[0] * size_mm + FLAT_MOST[1])
    # linear for small slopes, and at most `most_mm`
    along = most_mm * np.tanh(slopes @ to_part * (_drawn_by_slope_mm2(view) / most_mm))
    return np.asarray(along @ to_part.T)


def _drawn_by_slope_mm2(view: View) -> FloatArray:
    """How far a top is drawn along and across its part by a small relative slope of the pressure, mm over 1/mm; (2,)."""
    size_mm = np.array(USUAL_BODY_MM if view.part is None else view.part.body_mm[:2])
    is_round = view.part is not None and view.part.shape != "block"
    return DRAWN_ROUND * size_mm**2 if is_round else DRAWN[0] + DRAWN[1] * (size_mm**2) ** 2


def _relative_slopes(heights: FloatArray, at_mm: FloatArray) -> FloatArray:
    """Slopes of the pressure at the dots over the pressure, 1/mm, by a third-order surface through their heights; (n, 2)."""
    rows, shares = np.empty((10, len(heights))), heights / max(float(np.sort(heights)[3 * len(heights) // 4]), 1e-300)
    rows[0], rows[1:3] = 1.0, (at_mm - at_mm.sum(axis=0) / len(at_mm)).T
    rows[3:5], rows[5] = rows[1] * rows[1:3], rows[2] * rows[2]
    rows[6:9], rows[9] = rows[1] * rows[3:6], rows[2] * rows[5]
    rows *= _FACTORS
    known = rows * (shares > 0.0)
    # ridge regression; the constant's prior is only there so that no matrix is singular
    surface = np.linalg.solve(known @ known.T + _HEIGHT_PRIORS, known @ shares)
    # d/du and d/dv of a row are rows of one order less
    slopes = surface[_DERIVATIVES] @ rows[:6]
    return np.asarray((slopes / np.maximum(surface @ rows, FLOOR)).T)
