"""Simulated dots without images, as a detector would find them, for statistics over very many frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, refuse
from tactape_fab.base.fields import Fields
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.sense.sensors import SensorProfile, as_sensor
from tactape_fab.sense.simulation.contact import imprint, inwards
from tactape_fab.sense.simulation.draw import parts_in_view, points_in_contact
from tactape_fab.sense.simulation.gel_displacement import displacement_um, displacements
from tactape_fab.sense.simulation.parts import parts_of
from tactape_fab.sense.simulation.scene import DEFAULT_SCENE, Scene
from tactape_fab.sense.simulation.view import make_view
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape

NOT_A_PART = -1


@dataclass(frozen=True, slots=True, kw_only=True)
class DotErrors:
    """Errors of a detector. The defaults are those of maxima of a band-pass (Gaussian 2 px, mean 25 px), default scene.

    sigma_px: Standard deviation per axis of the centre of a fully imprinted part.
    rim_sigma_px: Increase of it towards the rim, times 1 - imprint.
    rim_pull_px: Displacement of centres inwards at the rim, where one side of a part is imprinted less than the other, times (1 -
        imprint) ** 0.75.
    outliers: Fraction of dots whose centre is off by up to `outlier_px` per axis, uniformly distributed.
    lost: Fraction of dots that are not found at any imprint.
    least_imprint: Dots with a smaller fraction of their height imprinted are not found.
    false_dots: Mean number of dots inside the contact where there is no part (Poisson).
    weight_sigma: Relative standard deviation of the weights.
    """

    sigma_px: float = 0.28
    rim_sigma_px: float = 0.9
    rim_pull_px: float = 2.4
    outliers: float = 0.01
    outlier_px: float = 6.0
    lost: float = 0.01
    least_imprint: float = 0.2
    false_dots: float = 2.0
    weight_sigma: float = 0.1

    def __post_init__(self) -> None:
        """Refuse invalid values, all together."""
        table = Fields({f.name: getattr(self, f.name) for f in fields(self)}, "errors.")
        for name in ("outliers", "lost", "least_imprint"):
            table.number(name, low=0.0, high=1.0, unit="")
        for name in ("sigma_px", "rim_sigma_px", "rim_pull_px", "outlier_px", "false_dots", "weight_sigma"):
            table.number(name, low=0.0, high=1000.0, unit="px" if name.endswith("px") else "")
        refuse(table.problems)


DEFAULT_ERRORS = DotErrors()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dots:
    """Dots as input for `locate_dots`, with their true parts and centres.

    xy_px (n, 2): Canonical image.
    weights (n,): 1 for a part that is fully imprinted.
    part (n,): Index of the part, -1 for a false dot.
    true_px (n, 2): True centres; NaN for a false dot.
    """

    xy_px: FloatArray
    weights: FloatArray
    part: IntArray
    true_px: FloatArray


def dots_of(
    tape: Tape,
    pose: Sequence[float],
    scene: Scene | None = None,
    rng: np.random.Generator | int = 0,
    errors: DotErrors | None = None,
    *,
    sensor: str | SensorProfile = DEFAULT_SENSOR,
) -> Dots:
    """The dots of one frame, without a depth map.

    tape, sensor: As in `simulate`.
    pose: x mm, y mm (texture frame), theta deg.
    scene: Its bumps are dots with no part; noise and smoothing are not used.
    rng: A generator to draw from, or a seed.
    Raises SpecError as `simulate`, and for a scene with an elastic gel.
    """
    profile, scene, errors = as_sensor(sensor), scene or DEFAULT_SCENE, errors or DEFAULT_ERRORS
    if scene.elastic is not None:
        raise SpecError(Problem("scene", "scene.elastic needs a depth map, which dots_of does not make; use iterate_frames"))
    rng = rng if isinstance(rng, np.random.Generator) else np.random.default_rng(rng)
    *position_mm, theta_deg = pose
    view = make_view(tape, position_mm, theta_deg, profile, scene)
    index, _, at_mm = parts_in_view(view, parts_of(tape), rng)
    if displacement_um(view) > 0.0:
        at_mm = at_mm + displacements(view, at_mm, rng)
    share = imprint(scene, at_mm)
    true_px = view.to_px(at_mm)
    # a dot of no imprint has weight 0, and is none
    found = (share >= max(errors.least_imprint, 1e-3)) & (rng.random(len(share)) >= errors.lost)
    found &= (np.abs(true_px - profile.centre_px) <= profile.centre_px).all(axis=1)
    index, share, true_px, at_mm = index[found], share[found], true_px[found], at_mm[found]
    off = rng.standard_normal(true_px.shape) * (errors.sigma_px + errors.rim_sigma_px * (1 - share))[:, None]
    off += errors.rim_pull_px * ((1 - share) ** 0.75)[:, None] * inwards(scene, at_mm)
    off += rng.uniform(-errors.outlier_px, errors.outlier_px, off.shape) * (rng.random(len(off)) < errors.outliers)[:, None]
    weights = share * (1 + errors.weight_sigma * rng.standard_normal(len(share)))

    count = scene.bumps + int(rng.poisson(errors.false_dots))
    false_mm = points_in_contact(view, count, rng) if count else np.empty((0, 2))
    false_weights = rng.uniform(0.3, 1.0, len(false_mm))
    return Dots(
        xy_px=np.concatenate([true_px + off, view.to_px(false_mm)]),
        weights=np.maximum(np.concatenate([weights, false_weights]), 0.05),
        part=np.concatenate([index, np.full(len(false_mm), NOT_A_PART)]),
        true_px=np.concatenate([true_px, np.full((len(false_mm), 2), np.nan)]),
    )
