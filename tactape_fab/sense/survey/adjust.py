"""Bundle adjustment of a tape: places of parts, poses of contacts, the sensor's camera, by robust sparse least squares.

A dot i of a contact c shows its part j at

    S_c + R(theta_c) (q_i - push u_i + pull v_i) = nominal_j + d_j + error,

with q_i the dot's place on the gel by the camera, whose scale, aspect, shear and radial distortion are common to all contacts
(docs/frames.md; `sense.geometry`), and u_i, v_i what neighbours and the rim do (`decode.grid.posterior`). The d_j have normal
priors: of the scatter of all parts, which is estimated, or of an inspection. These hold the gauge: a shift, turn, scale or smooth
drift of all parts together cannot be told from one of all poses. The poses of a robot hold it: then a stretch and a bend of the
whole tape are unknowns as well, about which the d_j scatter (`bend.Bend`).

Each part is a block of its own given poses and camera, so parts are eliminated (Schur complement; Triggs et al., Bundle
adjustment, 2000, section 6), the rest is solved by Cholesky, and the variances of the d_j are exact for the linear problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, block_diag, cho_factor, cho_solve
from scipy.sparse import coo_matrix, csr_matrix, vstack

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.sense.decode.grid.posterior import PULL, PULL_SIGMA, PUSH_MM, PUSH_SIGMA_MM, beliefs_of
from tactape_fab.sense.geometry import Camera
from tactape_fab.sense.geometry import camera as camera_of
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.survey.bend import Bend
from tactape_fab.sense.survey.contacts import Contact, SeenDots
from tactape_fab.sense.survey.copies import refuse_copies, refuse_other_start
from tactape_fab.sense.survey.poses import RobotPose
from tactape_fab.texture.frames import FloatArray, IntArray

COMMON = ("px_per_mm", "aspect", "shear", "k1", "push", "pull")
"""Unknowns common to all contacts: ln of the scale, corrections of the profile's camera, push (mm at 1 mm), pull."""
ROUNDS, SETTLED_MM = 12, 2e-5
TRUSTING = 2
"""Number of first rounds without robust weights: residuals are large until a part has moved from its design's position."""
HUBER, FARTHEST = 2.0, 6.0
"""Residuals, in standard deviations, from which on a dot weighs less (Huber), and from which on it has no weight."""
LEAST_SIGMA_MM, USUAL_SIGMA_MM, MOST_SIGMA_MM = 0.0005, 0.006, 0.2
"""Standard deviation of a full dot: least, initial and largest."""
LEAST_SCATTER_MM, USUAL_SCATTER_MM, MOST_SCATTER_MM = 0.002, 0.05, 0.3
"""Standard deviation of the parts about the design: least, initial and largest."""
MOST_LEFT_MM, MOST_LEFT_RAD, MOST_LEFT_SIGMAS = 1.0, 0.1, 3.0
"""Limits of the median residual of a robot's poses, absolute or in their own sigmas; poses of other frames exceed them."""

LEAST_POSES = 20
"""Fewest poses of a robot for an estimate of stretch and bend: ten, with 80 contacts on a flat tape, make parts less exact."""

PATCH_MM, PATCHES = 4.0, 50
"""Radius of a patch of neighbouring parts, about that of a contact; number of patches from which drift is computed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior:
    """Prior of the parts: shift (n, 2) from the design, texture frame, mm; sigma (n,), NaN where the scatter is estimated."""

    shift_mm: FloatArray
    sigma_mm: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjusted:
    """A solved bundle.

    part (k,): Parts that were touched, ascending.
    shift_mm (k, 2): From the design's places, texture frame.
    sigma_mm (k,): Standard deviation along each axis, that of a common drift included.
    touched (k,): Contacts that show each.
    drift_mm: Standard deviation along each axis of the mean of neighbouring parts: what they are wrong by together.
    common, common_sigma (6,): `COMMON`, and standard deviations.
    dot_mm: Error of a whole dot along an axis.
    scatter_mm: Scatter of the parts about the design; None where an inspection said where all of them are.
    left: Share of dots that were rejected as outliers.
    poses (contacts, 3): x mm, y mm, theta rad.
    """

    part: IntArray
    shift_mm: FloatArray
    sigma_mm: FloatArray
    touched: IntArray
    drift_mm: float
    common: FloatArray
    common_sigma: FloatArray
    dot_mm: float
    scatter_mm: float | None
    left: float
    poses: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rows(SeenDots):
    """All dots of all contacts: contact (m,), and part (m,) among those touched."""

    contact: IntArray


def adjust(
    contacts: Sequence[Contact],
    nominal_mm: FloatArray,
    sensor: SensorProfile,
    prior: Prior,
    robot: Sequence[RobotPose] = (),
) -> Adjusted:
    """Solve for the places of the parts that some contacts show.

    contacts: One or more.
    nominal_mm (n, 2): The design's places of all parts, texture frame.
    prior: Of all parts.
    robot: Of some of the frames.
    Raises SpecError where the poses of a robot contradict the contacts, or these are of two copies of the tape, or of another one
        than the prior.
    """
    # parts that no contact shows have no equation: they stay as they were
    touched, part = np.unique(np.concatenate([c.part for c in contacts]), return_inverse=True)
    rows = _Rows(
        contact=np.repeat(np.arange(len(contacts)), [len(c.part) for c in contacts]),
        part=part,
        **{
            name: np.concatenate([getattr(c, name) for c in contacts])
            for name in ("seen_px", "own", "rim_mm2", "pushed", "pulled")
        },
    )
    poses = np.array([c.start for c in contacts])
    before = prior.shift_mm[touched]
    known_mm = prior.sigma_mm[touched]
    free = np.isnan(known_mm)
    scatter = USUAL_SCATTER_MM if free.any() else None
    sigma_before = np.where(free, USUAL_SCATTER_MM, known_mm)
    shift, sigma = before.copy(), USUAL_SIGMA_MM
    mean, sigmas = _common_prior(sensor)
    common = mean.copy()
    arm = _Arm(robot, contacts, poses)
    bend = Bend(nominal_mm[touched], held=len(arm.contact) >= LEAST_POSES)
    count = np.bincount(part, minlength=len(touched))
    normal = None
    for turn in range(ROUNDS):
        left, turn_rates, common_rates = _residuals(rows, sensor, common, poses, nominal_mm[touched] + shift)
        variance = sigma**2 * rows.own + rows.rim_mm2
        # distance over its standard deviation, root mean square of both axes
        apart = np.sqrt((left**2).sum(axis=1) / variance / 2.0)
        # Huber's weight falls as 1 / |r| beyond the bend, so that such a dot pulls with constant force; one far off is another
        # part, and has none
        robust = np.where(apart > FARTHEST, 0.0, np.minimum(1.0, HUBER / np.maximum(apart, 1e-9)))
        weight = (robust if turn >= TRUSTING else np.ones_like(apart)) / variance
        # normal matrix of a part by itself: alike along x and y, and no term between them, as errors of a dot are alike along
        # both
        own = np.bincount(rows.part, weight, len(touched)) + 1.0 / sigma_before**2
        normal = _Normal(rows, weight, own, left, turn_rates, common_rates, len(contacts), len(touched))
        towards = (before + bend.shift_mm - shift) / sigma_before[:, None] ** 2
        normal.bent(bend, 1.0 / sigma_before**2, towards)
        step, moved = normal.solved((mean - common) / sigmas**2, sigmas, towards, arm, poses)
        common = common + step[: len(COMMON)]
        poses = poses + step[len(COMMON) : len(COMMON) + poses.size].reshape(-1, 3)
        arm = arm.moved(step[normal.size :])
        if len(bend.modes):
            of_bend = slice(normal.size - len(bend.modes), normal.size)
            bend.move(step[of_bend], normal.variances(of_bend))
        shift = shift + moved
        # residuals over their degrees of freedom: two per dot, minus three per contact and those of the parts
        freedom = 2.0 * (weight > 0.0).sum() - poses.size - 2.0 * (1.0 - 1.0 / sigma_before**2 / own).sum()
        # 1 - prior / own is the share of a part's place that the dots decide, of 2 unknowns; the floor is for contacts that share
        # few parts
        ratio = float((weight[:, None] * left**2).sum()) / max(freedom, 0.25 * len(left))
        sigma = float(np.clip(sigma * np.sqrt(np.clip(ratio, 0.25, 4.0)), LEAST_SIGMA_MM, MOST_SIGMA_MM))
        if scatter is not None:
            # step of expectation and maximisation: E d^2 is the estimate's square and its variance (Dempster, Laird and Rubin
            # 1977)
            squares = ((shift - before - bend.shift_mm)[free] ** 2).mean() + (1.0 / own[free]).mean()
            scatter = float(np.clip(np.sqrt(squares), LEAST_SCATTER_MM, MOST_SCATTER_MM))
            sigma_before = np.where(free, scatter, known_mm)
        # not before weights are robust: the first rounds settle on another optimum
        if turn > TRUSTING and np.abs(moved).max() < SETTLED_MM and abs(ratio - 1.0) < 0.01:
            break
    assert normal is not None
    arm.refuse_others(poses)
    bend.refuse_other_units()
    refuse_copies([c.frame for c in contacts], rows.contact, rows.part, left, nominal_mm[touched])
    refuse_other_start(rows.part, left, shift, before, np.where(free, np.inf, known_mm))
    known, drift, common_sigma = normal.sigmas(nominal_mm[touched])
    return Adjusted(
        part=touched,
        shift_mm=shift,
        sigma_mm=known,
        touched=count,
        drift_mm=drift,
        common=common,
        common_sigma=common_sigma,
        dot_mm=sigma,
        scatter_mm=scatter,
        left=float((apart > FARTHEST).mean()),
        poses=poses,
    )


def _common_prior(sensor: SensorProfile) -> tuple[FloatArray, FloatArray]:
    """Prior means and standard deviations of `COMMON`, as in the decoder."""
    sigmas = np.maximum(beliefs_of(sensor, fixed_scale=False).sigmas, 1e-9)
    return np.array([0.0, 0.0, 0.0, 0.0, PUSH_MM, PULL]), np.array([*sigmas, PUSH_SIGMA_MM, PULL_SIGMA])


def _residuals(
    rows: _Rows, sensor: SensorProfile, common: FloatArray, poses: FloatArray, places_mm: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Seen minus modelled positions (m, 2), texture frame; their derivatives by theta (m, 2) and `COMMON` (m, 2, 6)."""
    camera = _camera(sensor, common)
    centre = camera.from_px(sensor.centre_px)
    push, pull = common[4:].tolist()
    drawn = pull * rows.pulled - push * rows.pushed
    x, y, theta = poses[rows.contact].T
    c, s = np.cos(theta), np.sin(theta)
    turn = np.stack([np.stack([c, s], 1), np.stack([-s, c], 1)], 1)  # R(theta) (paper, Eq. 12)
    turned = np.einsum("mij,mj->mi", turn, camera.from_px(rows.seen_px) - centre + drawn)
    modelled = places_mm[rows.part] - np.stack([x, y], 1)
    # where a dot is modelled, not where it is seen: a seen place has the dot's own error in it, which is smaller under a larger
    # scale, so that each dot more would ask for a larger one
    rates = _rates(np.einsum("mji,mj->mi", turn, modelled) - drawn, centre, rows, sensor, camera)
    # dR / dtheta q = (-s q_x + c q_y, -c q_x - s q_y): R q with its components swapped and one negated
    by_theta = np.stack([turned[:, 1], -turned[:, 0]], 1)
    return turned - modelled, by_theta, np.einsum("mij,kmj->mik", turn, rates)


def _camera(sensor: SensorProfile, common: FloatArray) -> Camera:
    """The sensor's camera, changed by `COMMON`."""
    scale, aspect, shear, k1 = common[:4].tolist()
    g = sensor.geometry
    changed = type(g)(aspect=g.aspect + aspect, shear=g.shear + shear, k1=g.k1 + k1, center_px=g.center_px)
    u, v = sensor.px_per_mm
    stretch = float(np.exp(scale))
    return camera_of((u * stretch, v * stretch), (sensor.width_px, sensor.height_px), changed)


def _rates(q: FloatArray, centre: FloatArray, rows: _Rows, sensor: SensorProfile, camera: Camera) -> FloatArray:
    """Derivatives by `COMMON` of the dots' positions q (m, 2) on the gel, from the image centre; (6, m, 2)."""
    from_centre = q + centre
    rates = np.zeros((len(COMMON), *q.shape))
    # q = M^-1 (straightened px), to first order in aspect, shear and k1 about the profile: a Gauss-Newton step only needs the
    # direction, residuals are exact
    rates[0] = -q
    rates[1, :, 0], rates[1, :, 1] = -0.5 * q[:, 0], 0.5 * q[:, 1]
    rates[2, :, 0] = -q[:, 1]
    # squared distances from the lens' centre in corner radii; pixels may be oblong
    square, of_centre = (
        ((at * sensor.px_per_mm / camera.corner_px) ** 2).sum(axis=-1, keepdims=True) for at in (from_centre, centre)
    )
    rates[3] = -from_centre * square + centre * of_centre
    rates[4], rates[5] = -rows.pushed, rows.pulled
    return rates


class _Arm:
    """Poses by a robot in its own frame, which is unknown too: board point p is at t + R_ccw(phi) p there; `at` is (t, phi)."""

    def __init__(self, robot: Sequence[RobotPose], contacts: Sequence[Contact], poses: FloatArray) -> None:
        known = {pose.frame: pose for pose in robot}
        self.contact = np.array([k for k, c in enumerate(contacts) if c.frame in known], dtype=np.int64)
        priors = [known[contacts[k].frame] for k in self.contact]
        self.given = np.array([(p.x_mm, p.y_mm, np.radians(p.theta_deg)) for p in priors]).reshape(-1, 3)
        self.sigma = np.array([(p.sigma_mm, p.sigma_mm, np.radians(p.sigma_deg)) for p in priors]).reshape(-1, 3)
        self.at = np.zeros(3)
        if priors:
            _, phi = self._of(poses)
            # mean of directions, which has no step at 180 degrees
            turn = float(np.angle(np.exp(1j * (self.given[:, 2] - phi)).mean()))
            # texture y is down, the board's is up; the unknown shift of the frame takes the origin
            board = poses[self.contact, :2] * (1.0, -1.0)
            c, s = np.cos(turn), np.sin(turn)
            self.at = np.array([*(self.given[:, :2] - board @ np.array([[c, s], [-s, c]])).mean(axis=0), turn])

    def _of(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        return poses[self.contact, :2] * (1.0, -1.0), poses[self.contact, 2]

    def moved(self, step: FloatArray) -> _Arm:
        if len(step):
            self.at = self.at + step
        return self

    @property
    def unknowns(self) -> int:
        return 3 if len(self.contact) else 0

    def _left(self, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals of the poses (n, 3), the rotation of the robot's frame (2, 2), and the rotated board points (n, 2)."""
        board, theta = self._of(poses)
        c, s = np.cos(self.at[2]), np.sin(self.at[2])
        turn = np.array([[c, -s], [s, c]])
        along = board @ turn.T
        off = np.angle(np.exp(1j * (theta + self.at[2] - self.given[:, 2])))
        return np.column_stack([self.at[:2] + along - self.given[:, :2], off]), turn, along

    def refuse_others(self, poses: FloatArray) -> None:
        """Refuse poses that are not those of the contacts: their median residual is too large. Raises SpecError."""
        if not len(self.contact):
            return
        left, _, _ = self._left(poses)
        off = np.column_stack([np.hypot(left[:, 0], left[:, 1]), np.abs(left[:, 2])])
        most = np.maximum((MOST_LEFT_MM, MOST_LEFT_RAD), MOST_LEFT_SIGMAS * self.sigma[:, 1:])
        mm, rad = np.median(off, axis=0).tolist()
        if (np.median(off / most, axis=0) > 1.0).any():
            message = f"poses of the robot do not fit the contacts: half of them are {mm:.2g} mm or {np.degrees(rad):.2g} deg off"
            remedy = (
                "give those of these frames, counted from 0, x, y, z in mm, the quaternion as qw,qx,qy,qz with qw first, of the "
                "sensor itself, or of the flange with --hand-eye"
            )
            raise SpecError(Problem("poses", f"{message}; {remedy}"))

    def added(self, normal: FloatArray, right: FloatArray, poses: FloatArray) -> None:
        """Add the robot's poses to the normal equations; their unknowns: `COMMON`, three per contact, three of its frame."""
        left, turn, along = self._left(poses)
        # Huber's weight for each of x, y and the angle by itself
        weight = np.minimum(1.0, HUBER / np.maximum(np.abs(left) / self.sigma, 1e-9)) / self.sigma**2
        last = len(normal) - 3
        for row, contact in enumerate(self.contact.tolist()):
            rates = np.zeros((3, 6))
            # columns: x, y and theta of the contact, then the frame's shift and turn
            rates[:2, :2] = turn * (1.0, -1.0)
            rates[2, 2] = rates[2, 5] = rates[0, 3] = rates[1, 4] = 1.0
            # d R_ccw(phi) p / dphi is R p turned by a quarter
            rates[:2, 5] = (-along[row, 1], along[row, 0])
            of = [*range(len(COMMON) + 3 * contact, len(COMMON) + 3 * contact + 3), *range(last, last + 3)]
            weighted = rates.T * weight[row]
            normal[np.ix_(of, of)] += weighted @ rates
            right[of] -= weighted @ left[row]


class _Normal:
    """Normal equations of a round, the parts eliminated."""

    def __init__(
        self,
        rows: _Rows,
        weight: FloatArray,
        own: FloatArray,
        left: FloatArray,
        turn_rates: FloatArray,
        common_rates: FloatArray,
        contacts: int,
        parts: int,
    ) -> None:
        m, shared = len(weight), len(COMMON)
        # a column for every unknown of poses and camera; two rows a dot, x and y of all one after the other
        columns, values, at = [], [], []
        for axis in range(2):
            at += [np.arange(m) + axis * m] * (shared + 2)
            columns += [*(np.full(m, k) for k in range(shared)), shared + 3 * rows.contact + axis, shared + 3 * rows.contact + 2]
            values += [*common_rates[:, axis].T, np.ones(m), turn_rates[:, axis]]
        size = shared + 3 * contacts
        jacobian: csr_matrix = coo_matrix(
            (np.concatenate(values), (np.concatenate(at), np.concatenate(columns))), shape=(2 * m, size)
        ).tocsr()
        # the order of rows: x of all dots, then y of all
        twice = np.tile(weight, 2)
        of = coo_matrix(
            (np.ones(2 * m), (np.arange(2 * m), np.concatenate([rows.part, parts + rows.part]))), shape=(2 * m, 2 * parts)
        )
        weighted = jacobian.multiply(twice[:, None]).tocsr()
        # J^T W P, with P the sparse matrix of which dot shows which part; the parts' derivative is -P
        self.cross: csr_matrix = (weighted.T @ of.tocsr()).tocsr()
        self.poses = (weighted.T @ jacobian).toarray()
        self.own = np.tile(own, 2)
        flat = left.T.ravel()
        # Gauss-Newton: J^T W J step = -J^T W left, and P^T W left for the parts
        self.right = -(weighted.T @ flat)
        self.right_parts = np.concatenate([np.bincount(rows.part, weight * left[:, axis], parts) for axis in range(2)])
        self.size, self.factor = size, (np.empty((0, 0)), False)
        self.over: csr_matrix = self.cross

    def bent(self, bend: Bend, weight: FloatArray, towards: FloatArray) -> None:
        """Add the unknowns of a bend to the normal equations.

        weight (k,): Inverse variance of each part about the bend.
        towards (k, 2): Prior minus current shift of each part, weighted.
        """
        if not len(bend.modes):
            return
        weighted = bend.modes * np.tile(weight, 2)
        own = weighted @ bend.modes.T + np.eye(len(bend.modes)) / bend.sigma_mm**2
        self.poses = block_diag(self.poses, own)
        # as for a dot, the part's derivative is -1
        self.cross = vstack([self.cross, csr_matrix(weighted)]).tocsr()
        self.right = np.concatenate([self.right, -bend.modes @ towards.T.ravel() - bend.amplitude_mm / bend.sigma_mm**2])
        self.size += len(bend.modes)

    def variances(self, of: slice) -> FloatArray:
        """Variances of some unknowns, after `solved`."""
        columns = np.eye(len(self.factor[0]))[:, of]
        return np.asarray(cho_solve(self.factor, columns, check_finite=False)[of].diagonal(), dtype=np.float64)

    def solved(
        self, towards: FloatArray, sigmas: FloatArray, parts_towards: FloatArray, arm: _Arm, poses: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Steps of camera, poses and the robot's frame, and of the parts (k, 2)."""
        size = self.size + arm.unknowns
        normal, right = np.zeros((size, size)), np.zeros(size)
        normal[: self.size, : self.size], right[: self.size] = self.poses, self.right
        index = np.arange(len(sigmas))
        normal[index, index] += 1.0 / sigmas**2
        right[index] += towards
        if arm.unknowns:
            arm.added(normal, right, poses)
        parts = self.right_parts + parts_towards.T.ravel()
        # diagonal blocks of one number: their inverse is a division, and the elimination costs no more than the sparse product
        over = self.cross.multiply(1.0 / self.own[None, :]).tocsr()
        # the parts' own unknowns enter with a minus sign: seen less modelled
        normal[: self.size, : self.size] -= (over @ self.cross.T).toarray()
        right[: self.size] += over @ parts
        try:
            self.factor = cho_factor(normal, overwrite_a=True, check_finite=False)
        except LinAlgError as error:
            message = "the contacts leave a pose open; press with more of the gel, or leave out --poses that contradict them"
            raise SpecError(Problem("frames", message)) from error
        step: FloatArray = cho_solve(self.factor, right, check_finite=False)
        # back substitution: own moved = parts + cross^T step
        moved = (parts + self.cross.T @ step[: self.size]) / self.own
        self.over = over
        return step, moved.reshape(2, -1).T

    def sigmas(self, nominal_mm: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        """Standard deviations along an axis of the parts (k,) and of the mean of neighbouring parts, and those of `COMMON`."""
        inverse = cho_solve(self.factor, np.eye(len(self.factor[0])), overwrite_b=True, check_finite=False)[
            : self.size, : self.size
        ]
        # variance of a part: 1 / own if poses and camera were known, and what their covariance C brings through D = own^-1
        # cross^T: diag(D C D^T)
        through = self.over.T.tocsr()
        variance = 1.0 / self.own + np.asarray(through.multiply(through @ inverse).sum(axis=1)).ravel()
        n, drift = len(nominal_mm), []
        for middle in nominal_mm[:: max(n // PATCHES, 1)]:
            near = np.flatnonzero(((nominal_mm - middle) ** 2).sum(axis=1) <= PATCH_MM**2)
            for axis in range(2):
                # the parts' own errors average out over neighbours; those of poses and camera are common to them
                mean = np.asarray(through[near + axis * n].mean(axis=0)).ravel()
                drift.append(mean @ inverse @ mean)
        sigma = np.sqrt(variance.reshape(2, -1).mean(axis=0))
        return sigma, float(np.sqrt(np.mean(drift))), np.sqrt(inverse.diagonal()[: len(COMMON)])
