"""Hand-eye: where the sensor is on the robot's flange and the tape in its base, in one solve with the camera and all presses.

B X = Y P: B is the flange in the base by the robot, X the sensor on the flange, Y the tape in the base, P the sensor on the
tape. A press gives three of P's six degrees of freedom; its height and tilt are those of a sensor that lies flat on the tape,
within `SIGMAS`. Robot and gel err by far more than the camera: the sizes of their errors are estimated from the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.optimize import least_squares
from scipy.sparse import bmat, csr_matrix
from scipy.spatial.transform import Rotation
from scipy.special import fdtrc

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.sense.calibrate.adjust import OF_ALL, OF_PRESS, Bundle, completed, pattern_of, problem_of, rows_of, start
from tactape_fab.sense.calibrate.conventions import Convention, better_convention
from tactape_fab.sense.calibrate.errors import whitening
from tactape_fab.sense.calibrate.misfits import FAR_MM, LEAST_SIGMAS, SIGMAS, matrix_of, misfits, on_tape, turned_starts
from tactape_fab.sense.calibrate.odd_pose import odd_poses
from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.sense.files.arm_poses import HAND_EYE_FORMAT, ArmPose
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape

MOST_LEFT_MM, MOST_HEIGHT_MM, MOST_LEFT_RAD = 1.0, 3.0, 0.1
"""Largest residuals (rms) in the tape's plane, along its normal and about it: poses of other presses, or in other units, have
larger ones. Heights of right poses on flat tapes, with errors of 0.5 mm at most, were 1.4 mm at most in 452 random campaigns; of
152 sets in a wrong convention that keep the other two limits 20 have more than 3 mm."""
LEAST_POSES = 6
"""With five, squared errors were 2.6 times those of the stated covariance on average of 42 random campaigns, and 25 times in one;
with six 0.97 times: the sizes of errors are estimated from what the poses leave over twelve unknowns."""
_A_FIFTH = 5
OBSERVED_MM, OBSERVED_RAD = 5.0, 0.1
LEAST_BEYOND_MM, BEYOND_SIGMAS = 10.0, 3.0
"""The flange is reported as beyond the tape from this distance and so many sigmas on: a tool's frame may be in the gel."""
FACE_DOWN = 0.7
"""Cosine of the angle between the tape's normal and the base's z axis, downward, from where on the tape faces down: 45 deg."""
MOST_TILT_RAD = 0.1
"""Largest tilts of presses on a flat tape (rms): a sensor that is tilted farther loses the contact."""
BY_CHANCE = 1e-3
"""Probability below which tilts that go with the places of presses are those of a bent tape."""
MOST_SHARE = 0.5
"""Largest share of the variance of tilts by the arm's own errors; above it, tilts do not tell how far the sensor reaches out."""
LEAST_PIVOT = 1e-7
"""Least pivot of a normal matrix with a diagonal of ones. An open reach, which its prior alone holds, has 1e-5 to 1e-4."""
_MISFIT = "poses of the flange do not fit the presses: "
_POSES = "give poses of the flange in the base, x, y, z in mm, the quaternion as qw,qx,qy,qz with qw first"
_ROUNDS = 3
_MOST_STEPS = 60
"""Largest number of steps of a solve: poses that fit take five to ten, those of other frames would take hundreds."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandEye:
    """Two transforms with their covariances.

    Attributes
    ----------
    sensor_to_flange, tape_to_base : ndarray, shape (4, 4)
        mm. The sensor's frame is that of `Localization.transform`: origin at the image centre, x along u, y along v, z into the
        tape. The tape's is its board frame.
    covariance : ndarray, shape (12, 12)
        Translation (mm) and small turns (rad), each in the sensor's own frame and in the tape's own, of both in this order.
    tape : str
    frames : tuple of int
        Frames used.
    left : ndarray, shape (6,)
        Root mean square of the residuals of x, y, z (mm) and turns (rad) of the sensor on the tape.
    remarks : tuple of str
        What cannot be observed.
    """

    sensor_to_flange: FloatArray
    tape_to_base: FloatArray
    covariance: FloatArray
    tape: str
    frames: tuple[int, ...]
    left: FloatArray
    remarks: tuple[str, ...]

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        sigma = np.sqrt(np.diag(self.covariance))
        return {
            "format": HAND_EYE_FORMAT,
            "tape": self.tape,
            "frames": list(self.frames),
            "sensor_to_flange": self.sensor_to_flange.tolist(),
            "sensor_to_flange_sigma": sigma[:6].tolist(),
            "tape_to_base": self.tape_to_base.tolist(),
            "tape_to_base_sigma": sigma[6:].tolist(),
            "covariance": self.covariance.tolist(),
            "left": self.left.tolist(),
            "remarks": list(self.remarks),
        }


def find_hand_eye(bundle: Bundle, presses: Sequence[Press], tapes: Sequence[Tape], arm_poses: Sequence[ArmPose]) -> HandEye:
    """Solve both transforms together with the camera and the presses.

    bundle: To start from.
    presses: Its presses.
    arm_poses: Those of frames that are no press are not used.
    Raises SpecError for fewer than six presses with a pose on one tape, for equal textures on boards that differ, and for poses
        that do not fit the presses.
    """
    flange = {pose.frame: pose.flange_to_base for pose in arm_poses}
    names = [press.tape for press in presses if press.frame in flange]
    name = max(sorted(set(names)), key=names.count) if names else ""
    on_board = {tape.name: tape for tape in tapes}.get(name)
    which = [k for k, press in enumerate(presses) if press.frame in flange and press.tape == name]
    if len(which) < LEAST_POSES or on_board is None or on_board.surface is not None:
        message = (
            f"{len(which)} of {len(presses)} presses have a pose of the flange, and {LEAST_POSES} on one flat tape are needed; "
            "name the frames by their index from 0 in the column frame"
        )
        raise SpecError(Problem("hand_eye", message))
    places = {t.board.texture_origin_mm if t.surface is None else None for t in tapes if t.texture_key == on_board.texture_key}
    if len(places) > 1:
        message = f"tapes have the texture of {name} elsewhere on their boards, and a touch does not tell which is pressed"
        raise SpecError(Problem("tape", f"{message}; give only that one"))
    origin = np.array(on_board.board.texture_origin_mm)
    which, arm, both, odd = _agreeing(which, np.array([flange[presses[k].frame] for k in which]), bundle, presses, origin)
    _refuse_convention(better_convention(arm, bundle.poses[which], origin, both))
    sigmas = SIGMAS
    problem = problem_of(presses, bundle.sensor, bundle.errors, bundle.free)
    z = np.concatenate([start(problem), both])
    z[: len(bundle.values)] = bundle.values
    z[OF_ALL : OF_ALL + bundle.poses.size] = bundle.poses.ravel()
    for _ in range(_ROUNDS):
        z, left, freedom, covariance = _Joint(bundle, presses, arm, np.array(which), origin, sigmas).solved(z)
        # errors of arm and gel are estimated from the residuals, kind by kind; then the problem is solved with new weights. The
        # mean of the variance's posterior, of what the unknowns leave of a kind: a t distribution's covariance
        sigmas = np.maximum(np.sqrt((left**2).sum(axis=0) / np.maximum(freedom - 2.0, 1.0)), LEAST_SIGMAS)
        rms = np.sqrt((left**2).mean(axis=0))
        if rms[:2].max() > 3.0 * MOST_LEFT_MM:  # other sizes of errors do not mend that
            break
    if not _fits(rms):
        most = np.array([MOST_LEFT_MM, 0.0, MOST_HEIGHT_MM, 0.0, 0.0, MOST_LEFT_RAD])
        message = (
            f"{_MISFIT}{_said(rms)} are left over on the tape (rms), more than {_said(most, 'or')}; {_POSES}, at these frames"
        )
        raise SpecError(Problem("hand_eye", f"{message}, of presses on a tape that lies on a plane"))
    # the unknowns are places in the outer frame and rotation vectors, whose changes are no turns about any frame's axes
    own = block_diag(_own_motion(z[-12:-6]), _own_motion(z[-6:]))
    arm_rad = np.radians([pose.sigma_deg for pose in arm_poses if pose.frame in {presses[k].frame for k in which}])
    covariance = own @ covariance @ own.T + _drawn(matrix_of(z[-12:-6]), rms, arm_rad)
    radius_mm = _radius_mm(z[OF_ALL:-12].reshape(-1, OF_PRESS)[which], left)
    return HandEye(
        sensor_to_flange=matrix_of(z[-12:-6]),
        tape_to_base=matrix_of(z[-6:]),
        covariance=covariance,
        tape=name,
        frames=tuple(presses[k].frame for k in which),
        left=rms,
        remarks=(*odd, *_remarks(covariance, rms, radius_mm), *_mirrored(matrix_of(z[-12:-6]), matrix_of(z[-6:]), covariance)),
    )


def _fits(left: FloatArray) -> bool:
    """Whether poses may be those of the presses, by what is left over of x, y, z (mm) and turns (rad), (6,).

    Presses observe x, y and the turn about z alone; tilts are assumed. But heights are of one plane, to a gel's depth.
    """
    return bool((left[[0, 1, 2, 5]] <= (MOST_LEFT_MM, MOST_LEFT_MM, MOST_HEIGHT_MM, MOST_LEFT_RAD)).all())


def _refuse_convention(other: Convention | None) -> None:
    """Refuse poses that fit by another convention, and far better. Raises SpecError."""
    if other is not None and _fits(other.left):
        message = f"{_MISFIT}{_said(other.as_read)} are left over on the tape (rms), and taken {other.words} {_said(other.left)}"
        raise SpecError(Problem("hand_eye", f"{message}; {_POSES}"))


def _said(left: FloatArray, last: str = "and") -> str:
    return f"{left[:2].max():.2g} mm along it, {left[2]:.2g} mm of height {last} {np.degrees(left[5]):.2g} deg"


def _agreeing(
    which: list[int], arm: FloatArray, bundle: Bundle, presses: Sequence[Press], origin_mm: FloatArray
) -> tuple[list[int], FloatArray, FloatArray, list[str]]:
    """Presses, poses of the arm and both transforms roughly, without poses that all others contradict; and what is said of those.

    At most a fifth are left out: more are another fault, which what is left over tells.
    """
    remarks: list[str] = []
    most = len(which) // _A_FIFTH
    while True:
        poses = bundle.poses[which]
        both = _first(arm, poses, origin_mm)
        if len(remarks) == most or len(which) <= LEAST_POSES:
            return which, arm, both, remarks
        left = partial(misfits, arm, poses, origin_mm)
        prior = np.array([*[1.0 / FAR_MM] * 3, 0.0, 0.0, 0.0] * 2)
        odd = odd_poses(left, both, SIGMAS, LEAST_SIGMAS, prior, most - len(remarks))
        if not odd:
            return which, arm, both, remarks
        remarks += [
            f"hand-eye: the pose of frame {presses[which[one.index]].frame} is left out: by all others it is "
            f"{one.off_mm:.2g} mm and {np.degrees(one.off_rad):.2g} deg off on the tape; did the arm still move, or is it the "
            "row of another frame?"
            for one in odd
        ]
        gone = [one.index for one in odd]
        which, arm = np.delete(which, gone).tolist(), np.delete(arm, gone, axis=0)


class _Joint:
    """The joint least-squares problem: rows of the camera's adjustment, and six for each pose of the arm."""

    def __init__(
        self, bundle: Bundle, presses: Sequence[Press], arm: FloatArray, which: FloatArray, origin: FloatArray, sigmas: FloatArray
    ) -> None:
        self.problem = problem_of(presses, bundle.sensor, bundle.errors, bundle.free)
        self.white = [whitening(press, bundle.errors) for press in presses]
        self.arm, self.which, self.origin, self.sigmas = arm, which, origin, sigmas
        self.count = OF_ALL + OF_PRESS * len(presses)
        self.pattern = pattern_of([len(press.weights) for press in presses], self.count)

    def solved(self, z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Solution, residuals of the arm's rows (m, 6), their degrees of freedom (6,), covariance of both transforms (12, 12)."""
        held = np.concatenate([~self.problem.free, np.zeros(len(z) - len(self.problem.free), dtype=bool)])
        free = np.flatnonzero(~held)
        whole = partial(completed, z, free)
        found = least_squares(
            lambda x: self.rows(whole(x)),
            z[free],
            jac=lambda x: self.derivative(whole(x))[:, free],
            x_scale="jac",
            method="trf",
            max_nfev=_MOST_STEPS,
        )
        at = whole(found.x)
        derivative = self.derivative(at)[:, free]
        covariance = _inverse((derivative.T @ derivative).toarray())
        first, count = self.pattern[1].size - 1, 6 * len(self.which)
        arm = derivative[first : first + count].toarray()
        # leverage of each row, the diagonal of J C J^T: 1 for a row that the unknowns fit exactly
        taken = np.einsum("ij,jk,ik->i", arm, covariance, arm).reshape(-1, 6)
        left = self.arm_rows(at)[:count].reshape(-1, 6) * self.sigmas
        return at, left, (1.0 - taken).sum(axis=0), covariance[-12:, -12:]

    def rows(self, z: FloatArray) -> FloatArray:
        return np.concatenate([rows_of(self.problem, self.white, z[:-12])[0], self.arm_rows(z)])

    def arm_rows(self, z: FloatArray) -> FloatArray:
        """Whitened residuals of the arm's poses, and of the priors of both translations."""
        poses = z[..., OF_ALL:-12].reshape(*z.shape[:-1], -1, OF_PRESS)[..., self.which, :]
        left = misfits(self.arm, poses, self.origin, z[..., -12:]) / self.sigmas
        return np.concatenate([left.reshape(*z.shape[:-1], -1), z[..., -12:-9] / FAR_MM, z[..., -6:-3] / FAR_MM], axis=-1)

    def derivative(self, z: FloatArray) -> csr_matrix:
        entries = rows_of(self.problem, self.white, z[:-12])[1]
        seen = csr_matrix((entries, *self.pattern), shape=(self.pattern[1].size - 1, self.count))
        # the arm's rows depend on x, y and theta of its presses (not on the pull) and on both transforms alone
        poses = [OF_ALL + OF_PRESS * k + j for k in self.which for j in range(3)]
        columns = np.array([*poses, *range(self.count, self.count + 12)])
        step = 1e-6
        # central differences of dense rows, which are few: 6 a pose
        steps = step * np.eye(len(z))[columns]
        by = (self.arm_rows(z + steps) - self.arm_rows(z - steps)).T / (2 * step)
        rows = np.repeat(np.arange(len(by)), len(columns))
        own = csr_matrix((by.ravel(), (rows, np.tile(columns, len(by)))), shape=(len(by), self.count + 12))
        empty = csr_matrix((seen.shape[0], 12))
        return csr_matrix(bmat([[bmat([[seen, empty]])], [own]]))


def _inverse(normal: FloatArray) -> FloatArray:
    """Inverse of a normal matrix. Raises SpecError where poses leave it singular, as those that are all the same do."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    try:
        # by Cholesky, so that no variance is negative where poses leave much open; mm and rad are scaled to the same size
        lower = np.linalg.cholesky(normal * np.outer(scale, scale))
    except np.linalg.LinAlgError:
        lower = np.zeros_like(normal)
    # a pivot is one over the factor by which the other unknowns enlarge a standard deviation: rounding has more than the rest
    if np.diag(lower).min() < LEAST_PIVOT:
        message = "poses of the flange do not say where the sensor is on it: they are all the same, or nearly"
        remedy = "give the pose at each of these frames, of presses at places and turns that differ"
        raise SpecError(Problem("hand_eye", f"{message}; {remedy}"))
    back = solve_triangular(lower, np.diag(scale), lower=True)
    return np.asarray(back.T @ back)


def _own_motion(values: FloatArray) -> FloatArray:
    """Jacobian of the small motion of `matrix_of` in its own frame, shift (mm) and turn (rad), by its values; shape (6, 6)."""
    back, step, out = np.linalg.inv(matrix_of(values)), 1e-6, np.empty((6, 6))
    for k, d in enumerate(step * np.eye(6)):
        # T^-1 dT: the skew matrix of the turn, and the shift
        rate = back @ (matrix_of(values + d) - matrix_of(values - d)) / (2 * step)
        out[:3, k], out[3:, k] = rate[:3, 3], (rate[2, 1], rate[0, 2], rate[1, 0])
    return out


def _drawn(sensor_to_flange: FloatArray, left: FloatArray, arm_rad: FloatArray) -> FloatArray:
    """Covariance (12, 12) of how far the sensor reaches out, which the arm's own errors of tilt draw towards the flange.

    It is the slope of places over tilts. Errors of these make it smaller by their share of the tilts' variance (Fuller,
    Measurement error models, 1987, section 1.1), and leave nothing over that would say so.

    left (6,): As of `HandEye`: a flat tape's presses are tilted by what is left over.
    arm_rad (m,): Errors of the arm's turns, rad.
    """
    share = 2.0 * float((arm_rad**2).mean()) / max(float((left[3:5] ** 2).sum()), 1e-18)
    reach_mm = abs(float(sensor_to_flange[:3, 2] @ sensor_to_flange[:3, 3]))
    drawn_mm = reach_mm * share / (1.0 - share) if share < MOST_SHARE else FAR_MM
    # the sensor's z axis goes into the tape, the board's out of it: both translations are off by the same amount
    along = np.zeros(12)
    along[2], along[8] = drawn_mm, -drawn_mm
    return np.outer(along, along)


def _first(arm: FloatArray, poses: FloatArray, origin_mm: FloatArray) -> FloatArray:
    """Initial values of both transforms: the best of several starts, which differ in the turns that flat presses leave open."""
    seen = on_tape(poses, origin_mm)
    prior, steps = np.eye(12)[[0, 1, 2, 6, 7, 8]] / FAR_MM, 1e-6 * np.eye(12)

    def rows(z: FloatArray) -> FloatArray:
        return np.concatenate([(misfits(arm, poses, origin_mm, z) / SIGMAS).ravel(), prior @ z])

    # all unknowns are moved in one call: one by one they took most of the time
    def derivative(z: FloatArray) -> FloatArray:
        either = misfits(arm, poses, origin_mm, z + steps) - misfits(arm, poses, origin_mm, z - steps)
        return np.concatenate([(either / (2e-6 * SIGMAS)).reshape(12, -1).T, prior])

    best, least = np.zeros(12), np.inf
    for guess in turned_starts():
        # Y = B X P^-1: the first press fits exactly
        base = arm[0] @ guess @ np.linalg.inv(seen[0])
        at = np.concatenate([[0.0, 0.0, 0.0], Rotation.from_matrix(guess[:3, :3]).as_rotvec()])
        at = np.concatenate([at, base[:3, 3], Rotation.from_matrix(base[:3, :3]).as_rotvec()])
        found = least_squares(rows, at, derivative, max_nfev=40)
        if found.cost < least:
            best, least = found.x, found.cost
    # the search may end whole turns away, where the covariance of a rotation vector is another one
    for turn in (best[3:6], best[9:12]):
        turn[:] = Rotation.from_rotvec(turn).as_rotvec()
    return best


def _mirrored(sensor_to_flange: FloatArray, tape_to_base: FloatArray, covariance: FloatArray) -> list[str]:
    """A remark where poses may be those of a mirrored base: the flange lies beyond the surface that is touched.

    Poses B of a base with one axis mirrored, M B M, fit as exactly as the true ones: with N the mirror of z, M B M (M X N) =
    (M Y N) (N P N) holds, both transforms in brackets are rotations with places, and N P N is P with its height and tilts
    negated, which no press shows. Nothing that is left over tells that. But the sensor then looks to where the flange is; and
    where that is not known, a tape that lies face up in its base looks down, if it is x or y that is mirrored.
    """
    beyond_mm, sigma_mm = -float(sensor_to_flange[:3, 2] @ sensor_to_flange[:3, 3]), float(np.sqrt(covariance[2, 2]))
    if beyond_mm > max(LEAST_BEYOND_MM, BEYOND_SIGMAS * sigma_mm):
        seen = f"the flange is {beyond_mm:.0f} mm beyond the tape, on the side to which the sensor looks"
        unless = "the sensor does look back to the flange"
    elif sigma_mm > OBSERVED_MM and tape_to_base[2, 2] < -FACE_DOWN:
        seen, unless = "the tape faces down in the base, against its z axis", "it does"
    else:
        return []
    return [
        f"hand-eye: {seen}; so poses say of a base with one axis mirrored, such as y counted the other way, and fit as well, but "
        f"the sensor's z axis is the wrong way round then: check that x, y and z of the base are right-handed, unless {unless}"
    ]


def _radius_mm(poses: FloatArray, left: FloatArray) -> float | None:
    """The smaller radius of the surface that presses are tilted as on; None where it may be a plane.

    poses (m, 3), left (m, 6): As of `misfits`.
    """
    # the normal of a second-order surface turns as a symmetric matrix times the place: an F test of its three curvatures
    turns = on_tape(poses, np.zeros(3))[:, :2, :2] @ np.stack([left[:, 4], -left[:, 3]], axis=1)[..., None]
    x, y = (poses[:, :2] - poses[:, :2].mean(axis=0)).T * [[1.0], [-1.0]]
    one, none = np.ones_like(x), np.zeros_like(x)
    terms = np.stack([np.concatenate(both) for both in ((one, none), (none, one), (x, none), (none, y), (y, x))], axis=1)
    found = turns[..., 0].T.ravel()
    curved, flat = (np.linalg.lstsq(terms[:, :count], found, rcond=None)[0] for count in (5, 2))
    least, most = (float(((found - terms[:, : len(by)] @ by) ** 2).sum()) for by in (curved, flat))
    freedom = len(found) - len(curved)
    if fdtrc(3, freedom, (most - least) / 3 / max(least / freedom, 1e-18)) > BY_CHANCE:
        return None
    uu, vv, uv = curved[2:].tolist()
    return float(1.0 / np.abs(np.linalg.eigvalsh([[uu, uv], [uv, vv]])).max())


def _remarks(covariance: FloatArray, left: FloatArray, radius_mm: float | None) -> list[str]:
    """Remarks on motions that the arm's poses do not determine, and on tilts that no flat tape allows."""
    remarks = []
    # the directions that matter: across and along the sensor's axis
    sigma = np.sqrt(np.diag(covariance))
    if sigma[:2].max() > OBSERVED_MM or sigma[5] > OBSERVED_RAD:
        remarks.append(
            "hand-eye: where the sensor is on the flange is open: turn the sensor between presses, by a quarter or more"
        )
    if sigma[2] > OBSERVED_MM:
        remarks.append(
            "hand-eye: how far the sensor reaches out from the flange is open, as all presses have the flange at one tilt; "
            "the sum of that and of the tape's height is known"
        )
    if (tilt_rad := left[3:5].max()) > MOST_TILT_RAD:
        remarks.append(
            f"hand-eye: presses are tilted by {np.degrees(tilt_rad):.2g} deg (rms), as on a tape that is not flat, and both "
            "transforms are off by more than is said; press one that lies on a plane"
        )
    elif radius_mm is not None:
        remarks.append(
            f"hand-eye: presses are tilted by where they are, as on a tape bent with a radius of some {radius_mm:.0f} mm, and "
            "both transforms are off by more than is said; press one that lies on a plane"
        )
    return remarks
