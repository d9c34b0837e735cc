"""Bundle adjustment: the camera that all presses share and the pose of each, by sparse least squares.

A dot of a press at S, turned by theta, with its part at T on the tape, is at q = R(theta)^T (T - S) on the gel, right and down of
the point that the image centre sees; neighbours push it and the rim pulls it (`decode.grid.posterior`); the camera sees it at a
pixel. The residuals, in mm, have the covariance of `errors.covariance`: a dot's own error and the gel's displacement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix

from tactape_fab.sense.calibrate import camera
from tactape_fab.sense.calibrate.errors import Design, Errors, whitening
from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.sense.decode.grid.beliefs import PULL, PULL_SIGMA, PUSH_MM, PUSH_SIGMA_MM
from tactape_fab.sense.decode.rule import AGREE_SIGMAS
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

K1 = camera.NAMES.index("k1")
OF_ALL = camera.COUNT + 1
"""Number of unknowns that all presses share: the camera's, then the push of neighbours."""
OF_PRESS = 4
"""Number of unknowns of each press: x mm, y mm, theta rad, pull of the rim."""
CAMERA_SIGMAS = np.array([1.0, 0.1, 0.1, 0.1, 0.05, 0.05])
"""Prior standard deviations of the camera's parameters: of the scale about the profile's, of the others about a camera without
distortion. They are wide, so that presses decide. Those of the distortion's centre are shares of the image's width."""
SYSTEMATIC = np.array([1e-4, 1e-4, 5e-5, 5e-4, 0.3, 0.3])
"""Standard deviations of systematic errors, as rims draw dots alike in all presses: in 7 calibrations from 10 simulated presses
the mean error was 1.4e-4 of the aspect and -6e-4 of k1."""
SYSTEMATIC_FINE = np.array([5e-5, 5e-5, 5e-5, 2e-4, 0.15, 0.15])
"""The same for centres fitted to the pixels: in 14 such calibrations no mean error was larger than its own scatter."""
ALIKE_MM = 0.12e-3
"""Error of dots that looks like k1, root mean square, which more presses do not make smaller: dots at a contact's rim are drawn
inwards by 1 to 2 um in all presses. Where the gel is displaced, k1 rests on differences of near dots, in which that counts more:
in 20 sets of 30 presses (simulated) its mean error is -2e-4 without a displacement, and -23e-4 and -49e-4 with 20 and 60 um."""
LEAST_AGREEING = 8
"""Fewest inliers of a press: fewer tell little of a camera beyond the press's own pose."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bundle:
    """An adjustment.

    sensor: With the camera found.
    values (6,): Parameters of the camera, in the order of `camera.NAMES`.
    covariance (6, 6): Rows of parameters that were not free are zero.
    free (6,)
    poses (m, 4): x mm, y mm, theta rad and pull of each press.
    poses_alone, poses_anew (m, 4, 4): Covariance of each pose by its own dots, if the camera were known; and with the camera's
        covariance from the other presses.
    residual_mm each (n, 2): On the gel along u and v: seen minus expected position of each dot.
    errors: Of the dots.
    """

    sensor: SensorProfile
    values: FloatArray
    covariance: FloatArray
    free: BoolArray
    push_mm: float
    poses: FloatArray
    poses_alone: FloatArray
    poses_anew: FloatArray
    residual_mm: tuple[FloatArray, ...]
    errors: Errors

    @property
    def rms_mm(self) -> float:
        """Root mean square of all residuals along one axis."""
        return float(np.sqrt(np.mean(np.concatenate(self.residual_mm) ** 2)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """Input of an adjustment: presses, the initial profile, the errors of dots, the camera's free parameters."""

    presses: Sequence[Press]
    sensor: SensorProfile
    errors: Errors
    free: BoolArray
    prior: FloatArray
    prior_sigmas: FloatArray

    @property
    def systematic(self) -> FloatArray:
        """Standard deviations of the camera's systematic errors; 0 for parameters that are not free."""
        fine = all(press.fine for press in self.presses)
        return np.where(self.free, SYSTEMATIC_FINE if fine else SYSTEMATIC, 0.0)


def problem_of(presses: Sequence[Press], sensor: SensorProfile, errors: Errors, free: BoolArray | None = None) -> Problem:
    """An adjustment of presses from a profile; `free` says which of the camera's parameters are unknown, all unless said."""
    sigmas = CAMERA_SIGMAS * np.array([1.0, 1.0, 1.0, 1.0, sensor.width_px, sensor.width_px])
    prior = camera.parameters(sensor)
    # the prior is about a camera without distortion at the profile's scale; the profile's other parameters are initial values
    prior[1:] = 0.0
    free = np.ones(camera.COUNT, dtype=bool) if free is None else free
    return Problem(presses=presses, sensor=sensor, errors=errors, free=free, prior=prior, prior_sigmas=sigmas)


def start(problem: Problem) -> FloatArray:
    """Initial values of all unknowns, one vector."""
    of_presses = [(*press.position_mm, press.theta_rad, PULL) for press in problem.presses]
    return np.concatenate([camera.parameters(problem.sensor), [PUSH_MM], np.ravel(of_presses)])


def expected(press: Press, seen: camera.Seen, push_mm: float, pose: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Residuals of a press's dots, mm on the gel, and their derivatives by the shared unknowns and by the press's own.

    Shapes (n, 2), (n, 2, 7) and (n, 2, 4).
    """
    x, y, theta, pull = pose.tolist()
    c, s = np.cos(theta), np.sin(theta)
    from_s = press.texture_mm - (x, y)
    # R(theta) of Eq. 12 of the paper, and its derivative; rows times R are R^T times columns
    turn, turned = np.array([[c, s], [-s, c]]), np.array([[-s, c], [-c, -s]])
    # expected position of the dot on the gel: its part's, then the shifts by neighbours and rim; `rim_mm`, the correction of a
    # dot at the rim, is applied to the expected position
    at = from_s @ turn + push_mm * press.pushed - pull * press.pulled - press.rim_mm
    px, by_point, by_camera = seen.to_px(at)
    # pixels may be oblong
    scale = np.array(seen.scale)
    own = np.empty((len(at), 2, OF_PRESS))
    own[:, :, :2] = -turn.T
    own[:, :, 2], own[:, :, 3] = from_s @ turned, -press.pulled
    # camera, then the push of neighbours, as in `OF_ALL`
    shared = np.concatenate([by_camera, by_point @ press.pushed[:, :, None]], axis=2)
    # px over the scale: mm, but for the small distortion. That the divisor is an unknown, too, is not in the derivative: it would
    # add the residual, some 0.01 mm, to arms of mm
    return (press.seen_px - px) / scale, -shared / scale[:, None], -(by_point @ own) / scale[:, None]


def solve(problem: Problem) -> Bundle:
    """Least squares, from `start`; dots that do not agree must be left out before (`agreeing`)."""
    at = start(problem)
    white = [whitening(press, problem.errors) for press in problem.presses]
    held = np.concatenate([~problem.free, np.zeros(len(at) - camera.COUNT, dtype=bool)])
    free = np.flatnonzero(~held)
    pattern = pattern_of([len(press.weights) for press in problem.presses], len(at))
    whole = partial(completed, at, free)

    # residuals and derivative come from one evaluation, and the solver asks for both at one point
    @lru_cache(maxsize=2)
    def rows(z: bytes) -> tuple[FloatArray, FloatArray]:
        return rows_of(problem, white, whole(np.frombuffer(z)))

    def jacobian(z: FloatArray) -> csr_matrix:
        return csr_matrix((rows(z.tobytes())[1], *pattern), shape=(pattern[1].size - 1, len(at)))[:, free]

    # x_scale "jac": the unknowns are mm, rad, px and bare numbers
    found = least_squares(lambda z: rows(z.tobytes())[0], at[free], jac=jacobian, x_scale="jac", method="trf")
    return _bundle(problem, white, whole(found.x))


def completed(at: FloatArray, free: IntArray, z: FloatArray) -> FloatArray:
    """All unknowns: those of `at`, with `z` for the free ones."""
    out = at.copy()
    out[free] = z
    return out


def pattern_of(sizes: Sequence[int], unknowns: int) -> tuple[FloatArray, FloatArray]:
    """Columns and row ends of the sparse derivative: rows of the priors, then of each press along u and along v."""
    # each shared unknown has a prior, and of a press its pull alone: x, y and theta are free
    priors = [np.arange(OF_ALL), OF_ALL + 3 + OF_PRESS * np.arange(len(sizes))]
    # one entry in each of these OF_ALL + m rows
    columns, counts = list(priors), [np.ones(unknowns - OF_ALL - (OF_PRESS - 1) * len(sizes) + OF_ALL, dtype=np.int64)]
    for i, n in enumerate(sizes):
        own = OF_ALL + OF_PRESS * i + np.arange(OF_PRESS)
        columns.append(np.tile(np.concatenate([np.arange(OF_ALL), own]), 2 * n))
        counts.append(np.full(2 * n, OF_ALL + OF_PRESS))
    ends = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
    return np.concatenate(columns), ends


def rows_of(problem: Problem, white: Sequence[FloatArray], z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Whitened residuals, and the entries of their derivative in the order of `pattern_of`."""
    seen = camera.seen_by(problem.sensor, z[: camera.COUNT])
    push, poses = float(z[camera.COUNT]), z[OF_ALL:].reshape(-1, OF_PRESS)
    before, sigmas = np.append(problem.prior, PUSH_MM), np.append(problem.prior_sigmas, PUSH_SIGMA_MM)
    left = [(z[:OF_ALL] - before) / sigmas, (poses[:, 3] - PULL) / PULL_SIGMA]
    entries = [1.0 / sigmas, np.full(len(poses), 1.0 / PULL_SIGMA)]
    for press, by, pose in zip(problem.presses, white, poses, strict=True):
        residual, shared, own = expected(press, seen, push, pose)
        # one matrix whitens both axes: the errors along u and v are alike and independent
        left.append((by @ residual).T.ravel())
        both = np.concatenate([shared, own], axis=2)
        entries.append((by @ both.transpose(1, 0, 2)).ravel())
    return np.concatenate(left), np.concatenate(entries)


def _bundle(problem: Problem, white: Sequence[FloatArray], z: FloatArray) -> Bundle:
    """The adjustment at a solution, with its covariance: presses are eliminated one by one (Schur's complement)."""
    values, push, poses = z[: camera.COUNT], float(z[camera.COUNT]), z[OF_ALL:].reshape(-1, OF_PRESS)
    free, seen = np.append(problem.free, True), camera.seen_by(problem.sensor, values)
    normal = np.diag(1.0 / np.append(problem.prior_sigmas, PUSH_SIGMA_MM) ** 2)
    residuals, alone, gains, known = [], [], [], []
    for press, by, pose in zip(problem.presses, white, poses, strict=True):
        residual, shared, own = expected(press, seen, push, pose)
        residuals.append(residual)
        a = (by @ shared.transpose(1, 0, 2)).reshape(-1, OF_ALL)
        b = (by @ own.transpose(1, 0, 2)).reshape(-1, OF_PRESS)
        # with a the press's whitened derivative by the shared unknowns and b by its own, the normal matrix has the blocks a^T a,
        # a^T b, b^T b
        inner = b.T @ b
        inner[3, 3] += 1.0 / PULL_SIGMA**2
        alone.append(np.linalg.inv(inner))
        # the press's information on the shared unknowns, its pose marginalised: a^T a - a^T b (b^T b)^-1 b^T a
        gains.append(a.T @ b @ alone[-1])
        known.append(a.T @ a - gains[-1] @ b.T @ a)
        normal += known[-1]
    by_dots = _inverse(normal, free)[: camera.COUNT, : camera.COUNT]
    covariance = by_dots + np.diag(problem.systematic**2)
    # an error in proportion to k1's own rows, weighed as dots are: where these tell little of k1, as in the image's middle or of
    # a gel that is displaced, it is a far larger k1. Of other parameters it was not seen: the mean error of ln of the scale was 0
    covariance[K1, K1] += 2 * sum(map(len, residuals)) * by_dots[K1, K1] * (ALIKE_MM / problem.errors.dot_mm) ** 2
    # the pose's covariance is (b^T b)^-1 + g^T C g with C that of the shared unknowns; here without what this press told
    anew = [i + g.T @ _inverse(normal - one, free) @ g for i, g, one in zip(alone, gains, known, strict=True)]
    return Bundle(
        sensor=camera.with_parameters(problem.sensor, values),
        values=values,
        covariance=covariance,
        free=problem.free,
        push_mm=push,
        poses=poses,
        poses_alone=np.array(alone),
        poses_anew=np.array(anew),
        residual_mm=tuple(residuals),
        errors=problem.errors,
    )


def _inverse(normal: FloatArray, free: BoolArray) -> FloatArray:
    """Inverse of the normal matrix over the free unknowns; rows and columns of the others are zero."""
    covariance = np.zeros(normal.shape)
    covariance[np.ix_(free, free)] = np.linalg.inv(normal[np.ix_(free, free)])
    return covariance


def agreeing(presses: Sequence[Press], bundle: Bundle, problem: Problem) -> list[Press]:
    """Presses with the dots that agree with an adjustment; those with too few of them are left out."""
    out, seen = [], camera.seen_by(problem.sensor, bundle.values)
    for press, pose in zip(presses, bundle.poses, strict=True):
        residual, _, _ = expected(press, seen, bundle.push_mm, pose)
        distance = np.hypot(residual[:, 0], residual[:, 1])
        # the median distance of two normal components is 1.177 sigma; 4 um at least, or a perfect fit would leave out rounding
        sigma = max(float(np.median(distance)) / 1.177, 0.004)
        # light dots err more, in inverse proportion to their height
        kept = distance <= AGREE_SIGMAS * sigma * np.maximum(1.0, 0.6 / press.weights)
        if kept.sum() >= LEAST_AGREEING:
            out.append(press.taken(kept).at(pose))
    return out


def designs_of(problem: Problem, bundle: Bundle) -> tuple[list[Design], FloatArray, FloatArray]:
    """Input of `errors.estimate_errors`: presses at a solution, and the precision of their unknowns before anything is seen."""
    kept, seen = np.append(problem.free, True), camera.seen_by(problem.sensor, bundle.values)
    designs = []
    for press, pose in zip(problem.presses, bundle.poses, strict=True):
        residual, shared, own = expected(press, seen, bundle.push_mm, pose)
        designs.append(Design(press=press, residual_mm=residual, shared=shared[:, :, kept], own=own))
    precision = np.diag(1.0 / np.append(problem.prior_sigmas, PUSH_SIGMA_MM)[kept] ** 2)
    return designs, precision, np.diag([0.0, 0.0, 0.0, 1.0 / PULL_SIGMA**2])
