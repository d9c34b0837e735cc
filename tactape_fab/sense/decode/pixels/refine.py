"""Refined dots -> pose: correction of the contact's rim, weights of the dots, and checks of the refined pose."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import cos, hypot, pi, sin, sqrt

import numpy as np

from tactape_fab.base.jit import kernel
from tactape_fab.sense.decode.dots.filters import Image, averaged
from tactape_fab.sense.decode.dots.kth import select
from tactape_fab.sense.decode.dots.rim import ONE_SIDED
from tactape_fab.sense.decode.grid.displaced import displaced
from tactape_fab.sense.decode.grid.long_parts import drawn_px
from tactape_fab.sense.decode.grid.pose import Pose, fit_pose
from tactape_fab.sense.decode.grid.posterior import eliminate
from tactape_fab.sense.decode.pixels.patches import PixelFit, has_patch, median, rehearse_patches, settled_patches, unknown_relief
from tactape_fab.sense.decode.rank import View
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart

LEAST_PATCHES = 8
"""Fewest dots from which the height of a full dot and the scatter are estimated."""
LEAST_AGREEING = 6
"""Refined dots that agree with a pose; the scatter of fewer is chance."""
RIM_MM = 2.5
"""Neighbours within this distance give the direction to the contact's middle."""
PULL_MM, PULL_WEIGHT, PULL_SCATTER = 0.27, 0.05, 0.35
"""How far a rim draws a dot inwards for each unit of its missing height m, as m / (1 + 2 m), believed before the frame is seen;
how many squared units this belief counts as; and by what share one dot differs from another. On frames without noise, for small
m, it is 0.1, 0.2 and 0.3 mm for rims 1.6, 0.8 and 0.4 mm wide, 0.12 mm for a blur of 0.08 mm. Contacts of 7x7 mm: dots that miss
0.1 of their height are 26 um too far inwards, those that miss 0.25 47 um."""
HEIGHT_ERROR, AT_RIM, AT_RIM_STEP = 5.5, 2.1, 0.5
"""Error of a whole dot's height as a share of it, over that of its place, 1/mm; how many of them are missing where a dot is as
likely at the rim as not; and width of the step. A dot of 3 um has a height of 1.65 %: most that miss less are whole."""
LEVEL_ERROR = 0.02
"""Least missing share of its height for a dot to be treated as one at the rim."""
LEAST_INNER = 4
"""Least number of dots inside the contact from which a full dot's height is taken; with fewer, from the higher half of all."""
MOST_MISFIT = 0.8
"""Share of the slopes' power around a dot that its relief may leave unexplained; more is noise."""
MOST_EXCESS = 9.0
"""Squared residual over that of the profile's slope noise: three times the noise, by the sensor or by parts of another shape."""
MOST_SCATTER, FEW_SCATTER = 1.1, 4.0
"""Largest scatter of refined dots over that of the dots: where parts are placed badly both scatter alike. Of n it is a share of
FEW_SCATTER / n larger, as that of few is chance: of 7x7 mm, with a dozen whole dots, one in 30 was left to the dots."""
MOST_MOVE = 25.0
"""Largest squared distance, in the covariance of the dots' pose, by which the pixels may move it: chance has more in 2e-5."""
MOVE_FLOOR = np.diag([0.003, 0.003, 0.0005]) ** 2
"""Covariance of the dots' pose that their scatter does not show, mm, mm and rad: of 100 frames one was off by 5 um, 5 sigma."""
ALONG_SHARE = 0.4
"""Standard deviation of how far the pressure draws a refined centre along its part, over how far it draws a dot's maximum
(`long_parts`). Of the turn of a pose it was 0.2 on gels without a skin to 0.7 on those with a stiff one, under 1 to 4 N (an
elastic layer by Polonsky and Keer's solver, parts in place): its squared error was 3 to 7 times the variance without this."""
LEAST_SIGMA_MM = 0.0005
USUAL_MM = 0.005
"""Initial standard deviation of dots, mm, besides the pixels' noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pixels:
    """A frame, canonical, and how its pixels are fitted."""

    fit: PixelFit
    image: Image


def refine(
    pixels: Pixels,
    view: View,
    part: TapePart | None,
    offset_px: FloatArray,
    texture_mm: FloatArray,
    pose: Pose,
    placed_mm: FloatArray | None,
) -> tuple[Pose, str | None]:
    """The pose from the pixels around the dots.

    part: None where it is not known.
    offset_px (n, 2): Dots from the image centre, square pixels.
    texture_mm (n, 2): Their nominal places.
    pose: Fitted to the dots.
    placed_mm (n,): Standard deviations of measured places; `texture_mm` are those then.
    Returns pose: The dots' own where the pixels say nothing better; `agree` is theirs in any case.
    Returns why: Why it is the dots' own.
    """
    fit, image = pixels.fit, pixels.image
    unknown = unknown_relief(part)
    if part is None or unknown is not None:
        return pose, unknown
    at = fit.to_px(offset_px / view.px_per_mm)
    chosen = has_patch(fit, at).nonzero()[0]
    if len(chosen) < LEAST_PATCHES:
        return pose, f"only {len(chosen)} dots have all the pixels around them"
    if fit.factor > 1:
        image = averaged(image, fit.factor)
    # mm along the body's length and width of pixels right and down (docs/frames.md; board +y is up, texture +y down)
    turn = pose.theta_rad - part.rotation_deg * pi / 180.0
    to_body = np.array([[cos(turn), sin(turn)], [-sin(turn), cos(turn)]]) @ mm_of_px(fit, at[chosen])
    found, centres = settled_patches(fit, image, at[chosen], to_body, part)
    good = found.height > 0.0
    usable = np.count_nonzero(good)
    if usable < LEAST_PATCHES or not median(found.misfit) <= MOST_MISFIT:
        return pose, "the pixels around the dots do not look like the tape's parts"
    left = median(found.left)
    # chi^2 over its degrees of freedom, of the middle dot: outliers among the dots do not decide
    excess = 1.0 if fit.variance is None else left / (fit.freedom * fit.variance)
    if not excess <= MOST_EXCESS:
        return pose, f"the pixels around the dots differ from the tape's parts by {sqrt(excess):.1f} times the slopes' noise"
    if usable < len(good):
        chosen, centres, found = chosen[good], centres[good], found.taken(good)
        left = median(found.left)
    gel_mm, nominal_mm = fit.from_px(centres), texture_mm.take(chosen, 0)
    c, s = cos(pose.theta_rad), sin(pose.theta_rad)
    turned = np.array([[c, s], [-s, c]])  # for rows: from the texture's axes to the image's
    # a dot's own residuals estimate its slopes' variance where they are larger than usual; smaller ones are chance
    slopes = np.maximum(found.left, left) / fit.freedom
    # mean variance of both axes: `fit_pose` takes one weight a dot
    own = (found.spread_mm2[:, 0, 0] + found.spread_mm2[:, 1, 1]) / 2.0 * slopes
    inwards, low = at_rim(nominal_mm, texture_mm, found.imprint)
    scale = view.px_per_mm / pose.px_per_mm
    along_parts = drawn_px(part, found.imprint, gel_mm * view.px_per_mm, nominal_mm, view.px_per_mm)
    # where a dot is seen less where its part is by the dots' pose, image axes, mm on the texture: the errors that the law is
    # fitted to
    drawn_mm, buffer = gel_mm * scale + (pose.position_mm - nominal_mm) @ turned, np.empty((7, 2, len(own)))
    _rim_law(
        drawn_mm,
        gel_mm,
        inwards @ turned,
        low,
        own,
        view.beliefs.sigmas,
        view.beliefs.centre_mm,
        view.beliefs.corner_mm,
        buffer,
        np.zeros((7, 8)),
        weights := np.empty(len(own)),
    )
    refined = fit_pose(
        # `_rim_law` has replaced the errors by the rim's share of them: it is taken off, in mm of the profile's scale again
        (gel_mm - drawn_mm / scale) * view.px_per_mm,
        nominal_mm,
        weights,
        view.px_per_mm,
        view.beliefs,
        least_sigma_mm=LEAST_SIGMA_MM,
        smoothed=False,
        unsure_px=None if along_parts is None else ALONG_SHARE * along_parts.shift_px,
        placed_mm=None if placed_mm is None else placed_mm[chosen],
    )
    why = _doubt(pose, refined)
    if why is not None:
        return pose, why
    # low dots have the error of the rim's law in their weights
    return replace(displaced(refined, view.beliefs, np.ones(len(weights))), agree=pose.agree), None


def rehearse_pixels(fit: PixelFit, parts: Iterable[TapePart]) -> None:
    """Compile the kernels and make the tables of some parts now, so that no frame waits."""
    rehearse_patches(fit, parts)
    place, some = np.zeros((1, 2)), np.ones(7)
    at_rim(place, place, some[:1])
    _rim_law(place, place, place, some[:1], some[:1], some, place[0], some, np.zeros((7, 2, 1)), np.eye(7, 8), some[:1])


def _doubt(pose: Pose, refined: Pose) -> str | None:
    """Why a refined pose is rejected; None if it is accepted."""
    if not refined.finite or np.count_nonzero(refined.agree) < LEAST_AGREEING:
        return "the refined dots give no pose"
    if refined.sigma_mm > MOST_SCATTER * (1.0 + FEW_SCATTER / np.count_nonzero(refined.agree)) * pose.sigma_mm:
        return f"refined dots scatter by {refined.sigma_mm * 1000:.1f} um, the dots by {pose.sigma_mm * 1000:.1f} um"
    x, y = (refined.position_mm - pose.position_mm).tolist()
    turn = (refined.theta_rad - pose.theta_rad + pi) % (2.0 * pi) - pi
    if not _squared_distance((x, y, turn), (pose.covariance + MOVE_FLOOR).tolist()) <= MOST_MOVE:
        return f"the pixels move the pose by {hypot(x, y) * 1000:.1f} um, more than the dots' errors allow"
    return None


def _squared_distance(move: tuple[float, float, float], covariance: list[list[float]]) -> float:
    """move^T covariance^-1 move by Cramer's rule: numpy takes ten times as long for three numbers."""
    (a, b, c), (_, d, e), (_, _, f) = covariance
    x, y, z = move
    minors = d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b
    squares = minors[0] * x * x + minors[3] * y * y + minors[5] * z * z
    crossed = minors[1] * x * y + minors[2] * x * z + minors[4] * y * z
    return (squares + 2.0 * crossed) / (a * minors[0] + b * minors[1] + c * minors[2])


def mm_of_px(fit: PixelFit, at_px: FloatArray) -> FloatArray:
    """Jacobian at the mean of some pixels: mm on the gel, right and down, per pixel right and down; shape (2, 2)."""
    if fit.camera.k1 == 0.0:
        return fit.camera.inverse * fit.factor
    # the Jacobian by central differences over one pixel; without a lens it is the matrix itself
    steps = fit.from_px(at_px.mean(axis=0) + np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]]))
    return np.stack([steps[0] - steps[1], steps[2] - steps[3]], axis=1)


@kernel()
def _rim_law(
    error_mm: FloatArray,
    gel_mm: FloatArray,
    inwards: FloatArray,
    low: FloatArray,
    own: FloatArray,
    sigmas: FloatArray,
    centre_mm: FloatArray,
    corner_mm: FloatArray,
    rates: FloatArray,
    normal: FloatArray,
    weights: FloatArray,
) -> None:
    """Replace errors of dots by how far the rim draws each of them, and fill in weights: least variance over that of each dot.

    Axes are the image's. The law's one unknown is fitted to the errors less what the pose and the camera, within its priors, may
    be off by. A dot's variance is its own (n,), the rim's, and what else places scatter by. `rates` (7, 2, n) and `normal`
    (7, 8), zero before, are work buffers.
    """
    n, all_of = len(own), PULL_WEIGHT
    for i in range(n):
        # the missing height is the rim's, or noise
        missing = low[i] + LEVEL_ERROR if low[i] > 0.0 else 0.0
        noise, drawn = HEIGHT_ERROR * np.sqrt(own[i]), missing / (1.0 + 2.0 * missing)
        likely = 1.0 / (1.0 + np.exp((AT_RIM - missing / noise) / AT_RIM_STEP))
        low[i], all_of = likely * drawn, all_of + (likely * drawn) ** 2
        # variance of the shift over the squared pull: that of the missing height (m / (1 + 2 m) rises by 1 at most), of the
        # law, and p (1 - p) drawn^2 of whether the dot is at the rim at all
        unsure = likely * (noise**2 + (PULL_SCATTER * drawn) ** 2 + (1.0 - likely) * drawn**2)
        # errors of dots at the rim are mostly the rim's: they say little of the pose. `weights` holds `unsure` until the pull
        # is known
        weight, weights[i] = 1.0 / (own[i] + PULL_MM**2 * (low[i] ** 2 + unsure) + USUAL_MM**2), unsure
        x, y = gel_mm[i, 0], gel_mm[i, 1]
        dx, dy = x - centre_mm[0], y - centre_mm[1]
        square = (dx / corner_mm[0]) ** 2 + (dy / corner_mm[1]) ** 2
        u, v = rates[:, 0, i], rates[:, 1, i]
        # x, y, the turn, ln of the scale, aspect, shear and k1
        # derivatives at the profile's camera, each over one standard deviation of its prior (`posterior._linearised`)
        aspect, bend = sigmas[1] / 2.0, sigmas[3] * square
        u[0], u[1], u[2], u[3], u[4], u[5], u[6] = 1.0, 0.0, -y, sigmas[0] * x, aspect * x, sigmas[2] * y, bend * dx
        v[0], v[1], v[2], v[3], v[4], v[5], v[6] = 0.0, 1.0, x, sigmas[0] * y, -aspect * y, 0.0, bend * dy
        for k in range(7):
            for m in range(7):
                normal[k, m] += weight * (u[k] * u[m] + v[k] * v[m])
            normal[k, 7] += weight * (u[k] * error_mm[i, 0] + v[k] * error_mm[i, 1])
    for k in range(3, 7):  # the priors
        normal[k, k] += 1.0
    for k in range(7):
        eliminate(normal, k, 7)
    # ridge regression on one unknown about its prior mean: (w p0 + sum drawn e) / (w + sum drawn^2), e the error inwards
    pull_mm = PULL_WEIGHT * PULL_MM
    for i in range(n):
        for axis in range(2):
            for k in range(7):
                error_mm[i, axis] -= rates[k, axis, i] * normal[k, 7]
            pull_mm += low[i] * error_mm[i, axis] * inwards[i, axis]
    pull_mm = min(max(pull_mm / all_of, 0.0), 2.0 * PULL_MM)
    # the rates are no longer needed: their first rows hold the whole dots' squared errors and own variances
    squares, owns, whole, least = rates[0, 0], rates[1, 0], 0, np.inf
    for i in range(n):
        x, y = pull_mm * low[i] * inwards[i, 0], pull_mm * low[i] * inwards[i, 1]
        if pull_mm**2 * weights[i] <= own[i]:
            squares[whole], owns[whole] = (error_mm[i, 0] - x) ** 2 + (error_mm[i, 1] - y) ** 2, own[i]
            whole += 1
        weights[i] = own[i] + pull_mm**2 * weights[i]
        error_mm[i, 0], error_mm[i, 1] = x, y
    scatter = 0.0
    if whole >= LEAST_INNER:
        # the squared length of a normal vector has the median 2 ln 2 times the variance of a component
        scatter = max(select(squares[:whole], whole // 2) / (2.0 * np.log(2.0)) - select(owns[:whole], whole // 2), 0.0)
    for i in range(n):
        weights[i] += scatter
        least = min(least, weights[i])
    for i in range(n):
        weights[i] = least / weights[i]


def at_rim(texture_mm: FloatArray, neighbours_mm: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """For dots at the contact's rim the direction inwards (n, 2), and the share of the height that is missing (n,), 0 elsewhere.

    texture_mm (n, 2): Nominal places of dots.
    neighbours_mm (k, 2): Those of all dots of the contact.
    height (n,)
    """
    inwards, low = np.empty(texture_mm.shape), np.empty(len(height))
    _at_rim(texture_mm, neighbours_mm, height, inwards, low)
    return inwards, low


@kernel()
def _at_rim(texture_mm: FloatArray, neighbours_mm: FloatArray, height: FloatArray, inwards: FloatArray, low: FloatArray) -> None:
    """`at_rim`, by the mean of the unit vectors to the neighbours within `RIM_MM`: long where they are all to one side."""
    n, inner = len(height), 0
    for i in range(n):
        count = x = y = 0.0
        for k in range(len(neighbours_mm)):
            dx, dy = neighbours_mm[k, 0] - texture_mm[i, 0], neighbours_mm[k, 1] - texture_mm[i, 1]
            distance = np.sqrt(dx * dx + dy * dy)
            if 0.0 < distance < RIM_MM:
                count += 1.0
                x += dx / distance
                y += dy / distance
        length = np.sqrt(x * x + y * y)
        inwards[i, 0], inwards[i, 1] = x / max(length, 1e-9), y / max(length, 1e-9)
        if length <= ONE_SIDED * max(count, 1.0):
            inwards[i, 0] = inwards[i, 1] = 0.0
            low[inner] = height[i]
            inner += 1
    if inner < LEAST_INNER:
        inner = n
        for i in range(n):
            low[i] = height[i]
        # the median of the higher half, which no rim lowers as long as half of the dots are inside
        level = select(low, n // 2 + (n - n // 2) // 2)
    else:
        level = select(low[:inner], inner // 2)
    for i in range(n):
        at_side = inwards[i, 0] != 0.0 or inwards[i, 1] != 0.0
        low[i] = min(max(1.0 - LEVEL_ERROR - height[i] / level, 0.0), 1.0) if at_side else 0.0
