"""Normal equations of a bundle: the parts eliminated, the rest solved by Cholesky, variances of both; see `adjust`."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, block_diag, cho_factor, cho_solve
from scipy.sparse import coo_matrix, csr_matrix, vstack

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.sense.survey.bend import Bend
from tactape_fab.sense.survey.residuals import COMMON, Rows
from tactape_fab.sense.survey.robot_frame import RobotFrame
from tactape_fab.texture.frames import FloatArray

PATCH_MM, PATCHES = 4.0, 50
"""Radius of a patch of neighbouring parts, about that of a contact; number of patches from which drift is computed."""


class NormalEquations:
    """Normal equations of a round, the parts eliminated."""

    def __init__(
        self,
        rows: Rows,
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
        self, towards: FloatArray, sigmas: FloatArray, parts_towards: FloatArray, frame: RobotFrame, poses: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Steps of camera, poses and the robot's frame, and of the parts (k, 2)."""
        size = self.size + frame.unknowns
        normal, right = np.zeros((size, size)), np.zeros(size)
        normal[: self.size, : self.size], right[: self.size] = self.poses, self.right
        index = np.arange(len(sigmas))
        normal[index, index] += 1.0 / sigmas**2
        right[index] += towards
        if frame.unknowns:
            frame.added(normal, right, poses)
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
