"""Ranking of places from dots: the likeliest grids, each compared with every place of every tape."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, log

import numpy as np

from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.elongation import turn_weights
from tactape_fab.sense.decode.grid.beliefs import Beliefs
from tactape_fab.sense.decode.grid.fit import Fit, fit_grid, posteriors
from tactape_fab.sense.decode.grid.lattice import find_lattices
from tactape_fab.sense.decode.rule import EVEN_TURNS, GRID_SHARES, LEAST_GRID_POWER
from tactape_fab.sense.decode.search.built_places import as_built
from tactape_fab.sense.decode.search.hypotheses import Registry
from tactape_fab.sense.decode.search.plane import CodePlane, PlanePlace
from tactape_fab.sense.decode.search.prior import Prior
from tactape_fab.sense.decode.search.search import Place, search
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart

_CLEAR = 2.0
"""ln by which the first grid's bound must be better than is asked for: then no other grid is tried, whose place would need 18
times the evidence to win (`GRID_SHARES`)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """The design of the tapes and the sensor's view of it, in square pixels: known before a frame is seen.

    pitch_mm, displacement_mm: W and Delta.
    part: The parts, if all tapes have the same.
    px_per_mm: R, from the sensor's profile.
    scale_tolerance: Relative tolerance of the scale; 0 if it is fixed.
    centre_px (2,): The image centre p0.
    beliefs: What is known of camera and gel.
    directions: Number of displacement directions.
    """

    pitch_mm: float
    displacement_mm: float
    part: TapePart | None
    px_per_mm: float
    scale_tolerance: float
    centre_px: FloatArray
    beliefs: Beliefs
    directions: int = 4

    @property
    def pitch_px(self) -> float:
        """Grid width w = W R (paper, Eq. 13)."""
        return self.pitch_mm * self.px_per_mm

    @property
    def shift(self) -> float:
        """Displacement as a share of the pitch, delta / w: 1/6 in the paper's design."""
        return self.displacement_mm / self.pitch_mm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reading:
    """The best place of all grids tried, and ln of its grid's weight.

    A hypothesis is a grid together with a place, a tape and a turn; its weight is that of the grid times that of the rest, and
    all of them add up to 1. This holds as no weight of a grid depends on a tape: the order of the grids comes from the dots.
    `q` are the probabilities of the dots' symbols in the grid's axes, shape (n, directions); None where they are not kept.
    """

    place: Place | PlanePlace
    grid_weight: float
    q: FloatArray | None = None

    @property
    def ln_bound(self) -> float:
        """Ln of w E, which is 1 / p_tape (`rule.bound_of`)."""
        return self.place.score + self.place.weight + self.grid_weight


def read(
    dots: Dots,
    view: View,
    world: Registry | CodePlane,
    prior: Prior | None,
    max_p_tape: float,
    precision: float,
    least: float = -inf,
) -> Reading | None:
    """Find the place that fits some dots best.

    dots: At least one of them trusted.
    max_p_tape: Other grids are tried unless the first one's place is clearly better than this asks for.
    prior: Expected region of the contact.
    precision: Largest error, upward, of the weight of other places.
    least: A reading of a smaller `Reading.ln_bound` is of no use; one may be returned all the same.
    Returns: None if there is no grid, or no place with enough dots on a tape or of use.
    """
    # the contact's centre (paper, Eq. 2), each dot by its trust: about it, turn and phases of a grid depend least on each other
    middle = dots.trust @ dots.xy_px / dots.trust.sum()
    xy = dots.xy_px - middle
    # the grid from all dots at once, where the paper goes line by line (Eqs. 4 to 8)
    fits = _fits(dots, xy, view, 1)
    if fits and not fits[0].expected:  # likelihoods of several grids then say which one comes first
        fits = sorted(_fits(dots, xy, view, len(GRID_SHARES)), key=lambda fit: -fit.value)
    best: Reading | None = None
    for rank in range(len(GRID_SHARES)):
        if rank == 1 and len(fits) < 2:  # only now: the first grid is nearly always the right one
            fits = _fits(dots, xy, view, len(GRID_SHARES))
        if rank >= len(fits):
            break
        # the posteriors of the symbols are fixed here, before a tape is looked at: the bound rests on it
        q = posteriors(fits[rank].nodes, fits[rank].squares, dots.weights, dots.trust, fits[rank].sigma)
        of_use = (least if best is None else max(least, best.ln_bound)) - log(GRID_SHARES[rank])
        place = _place(dots, fits[rank], q, view, world, view.centre_px - middle, prior, precision, of_use)
        if place is None or not isfinite(place.score):
            continue
        if isinstance(world, Registry) and isinstance(place, Place) and world.built:
            design, free = (view.pitch_mm, view.shift), view.scale_tolerance > 0.0
            place, q = as_built(place, q, fits[rank], xy, dots, design, free, world.tapes, world.built, world.families)
        # each grid has its own weight, so that the best of several is still within the bound
        reading = Reading(place=place, grid_weight=log(GRID_SHARES[rank]), q=q)
        if best is None or reading.ln_bound > best.ln_bound:
            best = reading
        if rank == 0 and -best.ln_bound < log(max_p_tape) - _CLEAR:
            break
    return best


def _fits(dots: Dots, xy: FloatArray, view: View, most: int) -> list[Fit]:
    """Fits of the grids of most power, best first, without those below `LEAST_GRID_POWER`; xy: dots from their centroid."""
    # a dot that may be noise, or is low and so imprecise, weighs less in the grid
    strength = dots.trust * np.minimum(dots.weights, 1.0)
    lattices = find_lattices(xy, strength, view.pitch_px, view.scale_tolerance, most)
    free = view.scale_tolerance > 0.0
    fits = [
        fit_grid(xy, dots.weights, dots.trust, angle, pitch, phase_a, phase_b, view.shift, free, view.directions)
        for angle, pitch, phase_a, phase_b, power in lattices.tolist()
        if power >= LEAST_GRID_POWER
    ]
    return [fit for fit in fits if all(map(isfinite, fit.grid.tolist()))]


def _place(
    dots: Dots,
    fit: Fit,
    q: FloatArray,
    view: View,
    world: Registry | CodePlane,
    centre_px: FloatArray,
    prior: Prior | None,
    precision: float,
    least: float,
) -> Place | PlanePlace | None:
    if isinstance(world, CodePlane):
        return world.search(fit.nodes, q)
    part = view.part
    turns = EVEN_TURNS if part is None else turn_weights(dots.elongation, dots.weights, dots.trust, fit.grid, part)
    return search(
        world.tapes,
        world.families,
        fit.nodes,
        q,
        turns,
        fit.grid,
        centre_px,
        prior,
        precision,
        least=least,
        built=bool(world.built),
    )
