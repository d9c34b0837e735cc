"""Answers as measurements of a pose graph: factors of GTSAM, and edges of g2o's text."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.given_value import as_numbers
from tactape_fab.base.libraries import library
from tactape_fab.sense.decode.result import OnObject, state_of, surface_of
from tactape_fab.sense.decode.space import Surface, image_pose
from tactape_fab.sense.geometry import is_rotation
from tactape_fab.sense.objects.rigid import to_quaternion
from tactape_fab.texture.frames import FloatArray

if TYPE_CHECKING:
    from tactape_fab.sense.decode.result import Localization

_STEP = 1e-6
_MM_TO_M = 1e-3
_LEAST_EIGENVALUE = 1e-12
"""Eigenvalue of the scaled information matrix below which a direction counts as unobserved."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseMeasurement:
    """A measured pose of the sensor, and what is known of its error.

    The error is a small motion of the sensor in its own frame (x along image u, y along v, z into the tape): the true pose is
    ``pose @ Exp(error)``, as in GTSAM and g2o. A frame that the sensor is seen from may be moved without changing it.

    Attributes
    ----------
    pose : ndarray, shape (4, 4)
        Of the sensor in a frame: that of a tape, of an object, or the world; in m.
    information : ndarray, shape (6, 6)
        Inverse covariance of the error, in GTSAM's order: turns about x, y, z in rad, then shifts along x, y, z in m. Directions
        that a contact does not show have no information: rows of zeros, not a large variance.
    """

    pose: FloatArray
    information: FloatArray

    def noise_model(self) -> Any:
        """The error as a GTSAM noise model.

        Returns
        -------
        gtsam.noiseModel.Base
            To be wrapped in a robust one where a wrong answer in `max_p_false` of the frames is too many.

        Raises
        ------
        MissingLibraryError
            When gtsam is not installed.
        """
        gtsam = library("gtsam", "a factor of GTSAM")
        return gtsam.noiseModel.Gaussian.SqrtInformation(square_root(self.information), False)

    def prior_factor(self, sensor: int, noise_model: Any = None) -> Any:
        """The pose as a factor on one variable.

        Parameters
        ----------
        sensor : int
            Key of the sensor's pose.
        noise_model : gtsam.noiseModel.Base, optional
            By default `noise_model`.

        Returns
        -------
        gtsam.PriorFactorPose3

        Raises
        ------
        MissingLibraryError
            When gtsam is not installed.
        """
        gtsam = library("gtsam", "a factor of GTSAM")
        return gtsam.PriorFactorPose3(sensor, gtsam.Pose3(self.pose), noise_model or self.noise_model())

    def between_factor(self, frame: int, sensor: int, noise_model: Any = None) -> Any:
        """The pose as a factor between the frame that it is given in, where that is a variable itself, and the sensor.

        Parameters
        ----------
        frame : int
            Key of the pose of the tape or object.
        sensor : int
            Key of the sensor's pose.
        noise_model : gtsam.noiseModel.Base, optional
            By default `noise_model`.

        Returns
        -------
        gtsam.BetweenFactorPose3

        Raises
        ------
        MissingLibraryError
            When gtsam is not installed.
        """
        gtsam = library("gtsam", "a factor of GTSAM")
        return gtsam.BetweenFactorPose3(frame, sensor, gtsam.Pose3(self.pose), noise_model or self.noise_model())

    def g2o_edge(self, frame: int, sensor: int) -> str:
        """The pose as a line of g2o's text, an EDGE_SE3:QUAT.

        g2o's error is the shift, then the vector part of the turn's quaternion, half of a small angle. The information is of it.

        Parameters
        ----------
        frame : int
            Vertex of the tape or object; fixed, where its pose is known.
        sensor : int
            Vertex of the sensor.

        Returns
        -------
        str
            Without a line end.
        """
        # errors in GTSAM's order and terms from g2o's, e = F e': turn = 2 vector part, shift as it is; the information is F^T I F
        from_g2o = np.zeros((6, 6))
        from_g2o[:3, 3:], from_g2o[3:, :3] = 2.0 * np.eye(3), np.eye(3)
        information = from_g2o.T @ self.information @ from_g2o
        values = [*self.pose[:3, 3].tolist(), *to_quaternion(self.pose[:3, :3]), *information[np.triu_indices(6)].tolist()]
        return f"EDGE_SE3:QUAT {frame} {sensor} " + " ".join(f"{value:.12g}" for value in values)


def measure_pose(
    fix: Localization,
    frame: str = "board",
    *,
    on: OnObject | None = None,
    origin: str = "tape",
    at: npt.ArrayLike | None = None,
) -> PoseMeasurement | None:
    """A located answer as a measurement of the sensor's pose.

    Errors of answers on the same parts have those parts' placement errors in common, and so are not quite independent. Those on
    one tape of an object have its mount's: where that counts, take answers in the board frame, and the tape's pose as a variable.

    Parameters
    ----------
    fix : Localization
    frame, on, origin
        As for `Localization.transform`. With origin "tape" nothing is said of the sensor's place along its own axis.
    at : array_like, shape (4, 4), optional
        Pose of that frame in the world, m: the measurement is in the world then.

    Returns
    -------
    PoseMeasurement or None
        None where `Localization.transform` is None, or the method states no covariance.

    Raises
    ------
    SpecError
        As `Localization.transform`, and if `at` is not a pose.
    """
    base = np.eye(4) if at is None else as_numbers(at, (4, 4), "at", "a 4 x 4 matrix of a rotation and a position in m")
    if not (is_rotation(base[:3, :3]) and np.allclose(base[3], (0.0, 0.0, 0.0, 1.0))):
        remedy = "give a 4 x 4 matrix of a rotation and, in its last column, a position in m"
        raise SpecError(Problem("at", f"at is no pose: {remedy}"))
    surface, state = surface_of(fix, frame, on), state_of(fix, origin)
    if surface is None or state is None or state[1] is None:
        return None
    covariance = state[1].copy()
    if origin == "tape":
        covariance[5, 5] = inf  # that origin is where the axis meets the tape, however far the sensor is
    known = np.isfinite(covariance.diagonal())
    # the limit of an infinite variance: no information, and none shared with the others
    of_state = np.zeros((6, 6))
    of_state[np.ix_(known, known)] = np.linalg.inv(covariance[np.ix_(known, known)])
    here, motion = _motion(surface, state[0])
    mounted = None if on is None else on.mount_covariance(fix, here[:3, 3])
    here[:3, 3] *= _MM_TO_M
    # the error of the state is motion^-1 times that of the pose
    back = np.linalg.inv(motion)
    information = back.T @ of_state @ back
    if mounted is not None:
        # A and B: (A^-1 + B)^-1 = (1 + A B)^-1 A, also where A is singular
        information = np.linalg.solve(np.eye(6) + information @ _in_own_frame(mounted, here[:3, :3]), information)
    # rounding leaves it not quite symmetric, and solvers look at one half
    return PoseMeasurement(pose=base @ here, information=(information + information.T) / 2)


def _in_own_frame(covariance: FloatArray, rotation: FloatArray) -> FloatArray:
    """Covariance of a pose's small motion in its own frame, (6, 6), turns in rad, then shifts in m.

    covariance (6, 6): Of its shift in mm, then its turns, along the axes that `rotation` turns its own to.
    """
    out, turn = np.zeros((6, 6)), rotation.T
    out[:3, 3:], out[3:, :3] = turn, _MM_TO_M * turn
    return np.asarray(out @ covariance @ out.T)


def _motion(surface: Surface, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`image_pose`, and the Jacobian of its motion in its own frame by the state, (6, 6): turns in rad, then shifts in m."""
    here, motion = image_pose(surface, state), np.empty((6, 6))
    back = np.linalg.inv(here)
    for k, unit in enumerate(np.eye(6)):
        # T^-1 dT is a small motion in the pose's own frame: a skew matrix of the turn, and the shift; halves of differences take
        # rounding out
        rate = back @ (image_pose(surface, state + _STEP / 2 * unit) - image_pose(surface, state - _STEP / 2 * unit)) / _STEP
        motion[:3, k] = (rate[2, 1] - rate[1, 2]) / 2, (rate[0, 2] - rate[2, 0]) / 2, (rate[1, 0] - rate[0, 1]) / 2
        motion[3:, k] = rate[:3, 3] * _MM_TO_M
    return here, motion


def square_root(information: FloatArray) -> FloatArray:
    """R with RᵀR = information, also where that is singular, as Cholesky's is not; rows of zeros for what is unknown."""
    # radians and metres have information of different size: scaled to a diagonal of ones, eigenvalues can be held against one
    # limit
    scale = np.sqrt(information.diagonal())
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    kept = np.where(values > _LEAST_EIGENVALUE, values, 0.0)
    return np.asarray(np.sqrt(kept)[:, None] * vectors.T * scale)
