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

from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.survey.bend import Bend
from tactape_fab.sense.survey.contacts import Contact
from tactape_fab.sense.survey.copies import refuse_copies, refuse_other_start
from tactape_fab.sense.survey.normal_equations import NormalEquations
from tactape_fab.sense.survey.poses import RobotPose
from tactape_fab.sense.survey.residuals import COMMON, common_prior, huber, residuals, rows_of
from tactape_fab.sense.survey.robot_frame import RobotFrame
from tactape_fab.texture.frames import FloatArray, IntArray

ROUNDS, SETTLED_MM = 12, 2e-5
TRUSTING = 2
"""Number of first rounds without robust weights: residuals are large until a part has moved from its design's position."""
FARTHEST = 6.0
"""Residual, in standard deviations, from which on a dot has no weight: it is another part's."""
LEAST_SIGMA_MM, USUAL_SIGMA_MM, MOST_SIGMA_MM = 0.0005, 0.006, 0.2
"""Standard deviation of a full dot: least, initial and largest."""
LEAST_SCATTER_MM, USUAL_SCATTER_MM, MOST_SCATTER_MM = 0.002, 0.05, 0.3
"""Standard deviation of the parts about the design: least, initial and largest."""
LEAST_POSES = 20
"""Fewest poses of a robot for an estimate of stretch and bend: ten, with 80 contacts on a flat tape, make parts less exact."""


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
    touched, rows = rows_of(contacts)
    poses = np.array([c.start for c in contacts])
    before = prior.shift_mm[touched]
    known_mm = prior.sigma_mm[touched]
    free = np.isnan(known_mm)
    scatter = USUAL_SCATTER_MM if free.any() else None
    sigma_before = np.where(free, USUAL_SCATTER_MM, known_mm)
    shift, sigma = before.copy(), USUAL_SIGMA_MM
    mean, sigmas = common_prior(sensor)
    common = mean.copy()
    frame = RobotFrame(robot, contacts, poses)
    bend = Bend(nominal_mm[touched], held=len(frame.contact) >= LEAST_POSES)
    normal = None
    for turn in range(ROUNDS):
        left, turn_rates, common_rates = residuals(rows, sensor, common, poses, nominal_mm[touched] + shift)
        variance = sigma**2 * rows.own + rows.rim_mm2
        # distance over its standard deviation, root mean square of both axes
        apart = np.sqrt((left**2).sum(axis=1) / variance / 2.0)
        weight = (np.where(apart > FARTHEST, 0.0, huber(apart)) if turn >= TRUSTING else 1.0) / variance
        # normal matrix of a part by itself: alike along x and y, and no term between them, as errors of a dot are alike along
        # both
        own = np.bincount(rows.part, weight, len(touched)) + 1.0 / sigma_before**2
        normal = NormalEquations(rows, weight, own, left, turn_rates, common_rates, len(contacts), len(touched))
        towards = (before + bend.shift_mm - shift) / sigma_before[:, None] ** 2
        normal.bent(bend, 1.0 / sigma_before**2, towards)
        step, moved = normal.solved((mean - common) / sigmas**2, sigmas, towards, frame, poses)
        common = common + step[: len(COMMON)]
        poses = poses + step[len(COMMON) : len(COMMON) + poses.size].reshape(-1, 3)
        frame.move(step[normal.size :])
        if len(bend.modes):
            of_bend = slice(normal.size - len(bend.modes), normal.size)
            bend.move(step[of_bend], normal.variances(of_bend))
        shift = shift + moved
        # residuals over their degrees of freedom: two per dot, minus three per contact and those of the parts, where 1 - prior /
        # own is the share of a part's place that the dots decide
        freedom = 2.0 * (weight > 0.0).sum() - poses.size - 2.0 * (1.0 - 1.0 / sigma_before**2 / own).sum()
        # the floor is for contacts that share few parts
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
    frame.refuse_others(poses)
    bend.refuse_other_units()
    refuse_copies([c.frame for c in contacts], rows.contact, rows.part, left, nominal_mm[touched])
    refuse_other_start(rows.part, left, shift, before, np.where(free, np.inf, known_mm))
    known, drift, common_sigma = normal.sigmas(nominal_mm[touched])
    return Adjusted(
        part=touched,
        shift_mm=shift,
        sigma_mm=known,
        touched=np.bincount(rows.part),
        drift_mm=drift,
        common=common,
        common_sigma=common_sigma,
        dot_mm=sigma,
        scatter_mm=scatter,
        left=float((apart > FARTHEST).mean()),
    )
