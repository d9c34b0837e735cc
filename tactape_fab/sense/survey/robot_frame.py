"""The frame of a robot whose poses hold a survey: where it lies on the board, and what its poses add to the equations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.sense.survey.contacts import Contact
from tactape_fab.sense.survey.poses import RobotPose
from tactape_fab.sense.survey.residuals import COMMON, huber
from tactape_fab.texture.frames import FloatArray

MOST_LEFT_MM, MOST_LEFT_RAD, MOST_LEFT_SIGMAS = 1.0, 0.1, 3.0
"""Limits of the median residual of a robot's poses, absolute or in their own sigmas; poses of other frames exceed them."""


class RobotFrame:
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

    def move(self, step: FloatArray) -> None:
        """By a step of its unknowns, none where no frame has a pose."""
        if len(step):
            self.at = self.at + step

    @property
    def unknowns(self) -> int:
        """Number of its unknowns, x mm, y mm and theta rad: 0 where no frame has a pose."""
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
        # for each of x, y and the angle by itself
        weight = huber(np.abs(left) / self.sigma) / self.sigma**2
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
