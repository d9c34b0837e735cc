"""Dots -> the place that their symbols name: the likeliest grids, each held against every place of every tape."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, log

import numpy as np

from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.elongation import turn_weights
from tactape_fab.sense.decode.grid.fit import Fit, fit_grid, posteriors
from tactape_fab.sense.decode.grid.lattice import find_lattices
from tactape_fab.sense.decode.search.hypotheses import Registry
from tactape_fab.sense.decode.search.plane import CodePlane, PlanePlace
from tactape_fab.sense.decode.search.search import Place, Prior, search
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import TapePart

GRID_SHARES = (0.9, 0.05, 0.05)
"""Weights of the grids tried, best first, in the bound: it is their sum that must not exceed 1. The best one is that with the
most power, or the likeliest fit where the fit to that is not as it should be: known before any symbol is held against a tape."""
LEAST_GRID_POWER = 0.12
EVEN_TURNS = np.full(4, 0.25)
_CLEAR = 2.0
"""A place that is better than asked by this (ln) is not doubted: no other grid is tried."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """What is known of every frame before it is seen. Square pixels.

    Attributes
    ----------
    pitch_mm, displacement_mm : float
    part : TapePart or None
        The bodies, if all tapes have the same.
    px_per_mm : float
    scale_tolerance : float
        By how much, as a share, the scale may be off; 0 where it is fixed.
    centre_px : ndarray, shape (2,)
        The image centre p0.
    directions : int
        That parts are displaced in.
    """

    pitch_mm: float
    displacement_mm: float
    part: TapePart | None
    px_per_mm: float
    scale_tolerance: float
    centre_px: FloatArray
    directions: int = 4

    @property
    def pitch_px(self) -> float:
        return self.pitch_mm * self.px_per_mm

    @property
    def shift(self) -> float:
        """Displacement as a share of the pitch."""
        return self.displacement_mm / self.pitch_mm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reading:
    """The best place of all grids tried, and ln of its grid's weight."""

    place: Place | PlanePlace
    grid_weight: float

    @property
    def ln_bound(self) -> float:
        """Ln of 1 / p_tape."""
        return self.place.score + self.place.weight + self.grid_weight


def read(
    dots: Dots, view: View, world: Registry | CodePlane, prior: Prior | None, max_p_tape: float, precision: float
) -> Reading | None:
    """Find the place that some dots name, if there is any.

    Parameters
    ----------
    dots : Dots
        At least one of them trusted.
    max_p_tape : float
        Other grids are tried unless the first one's place is clearly better than this asks for.
    precision : float
        What the weight of other places may be too large by.
    """
    middle = dots.trust @ dots.xy_px / dots.trust.sum()
    xy = dots.xy_px - middle
    fits = _fits(dots, xy, view, 1)
    if fits and not fits[0].expected:
        fits = sorted(_fits(dots, xy, view, len(GRID_SHARES)), key=lambda fit: -fit.value)
    best: Reading | None = None
    for rank in range(len(GRID_SHARES)):
        if rank == 1 and len(fits) < 2:  # the best grid is nearly always the one
            fits = _fits(dots, xy, view, len(GRID_SHARES))
        if rank >= len(fits):
            break
        place = _place(dots, fits[rank], view, world, view.centre_px - middle, prior, precision)
        if place is None or not isfinite(place.score):
            continue
        reading = Reading(place=place, grid_weight=log(GRID_SHARES[rank]))
        if best is None or reading.ln_bound > best.ln_bound:
            best = reading
        if rank == 0 and -best.ln_bound < log(max_p_tape) - _CLEAR:
            break
    return best


def _fits(dots: Dots, xy: FloatArray, view: View, most: int) -> list[Fit]:
    """The likeliest lattices of dots about their middle, best first, each with its grid; those that hardly are any left out."""
    strength = dots.trust * np.minimum(dots.weights, 1.0)
    lattices = find_lattices(xy, strength, view.pitch_px, view.scale_tolerance, most)
    free = view.scale_tolerance > 0.0
    fits = [
        fit_grid(xy, dots.weights, dots.trust, angle, pitch, phase_a, phase_b, view.shift, free, view.directions)
        for angle, pitch, phase_a, phase_b, power in lattices.tolist()
        if power >= LEAST_GRID_POWER
    ]
    return [fit for fit in fits if np.isfinite(fit.grid).all()]


def _place(
    dots: Dots,
    fit: Fit,
    view: View,
    world: Registry | CodePlane,
    centre_px: FloatArray,
    prior: Prior | None,
    precision: float,
) -> Place | PlanePlace | None:
    q = posteriors(fit.nodes, fit.squares, dots.weights, dots.trust, fit.sigma)
    if isinstance(world, CodePlane):
        return world.search(fit.nodes, q)
    part = view.part
    turns = EVEN_TURNS if part is None else turn_weights(dots.elongation, dots.weights, dots.trust, fit.grid, part)
    return search(world.tapes, world.families, fit.nodes, q, turns, fit.grid, centre_px, prior, precision)
