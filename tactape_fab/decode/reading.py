"""Dots -> the place that their symbols name: the likeliest grids, each held against every place of every tape."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, log

import numpy as np

from tactape_fab.decode.detect import Dots
from tactape_fab.decode.elongation import turn_weights
from tactape_fab.decode.lattice import find_lattices
from tactape_fab.decode.plane import CodePlane, PlanePlace
from tactape_fab.decode.registry import Registry
from tactape_fab.decode.search import Place, Prior, search
from tactape_fab.decode.symbols import fit_grid, posteriors
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import TapePart

GRID_SHARES = (0.9, 0.05, 0.05)
"""Weights of the grids tried, best first, in the bound: it is their sum that must not exceed 1."""
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
    """

    pitch_mm: float
    displacement_mm: float
    part: TapePart | None
    px_per_mm: float
    scale_tolerance: float
    centre_px: FloatArray

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
    strength = dots.trust * np.minimum(dots.weights, 1.0)
    best: Reading | None = None
    tried = 0
    for most in (1, len(GRID_SHARES)):  # the best grid is nearly always the one
        lattices = find_lattices(xy, strength, view.pitch_px, view.scale_tolerance, most)
        for angle, pitch, phase_a, phase_b, power in lattices[tried:].tolist():
            grid_weight = log(GRID_SHARES[tried])
            tried += 1
            place = None
            if power >= LEAST_GRID_POWER:
                place = _place(dots, xy, (angle, pitch, phase_a, phase_b), view, world, view.centre_px - middle, prior, precision)
            if place is None or not isfinite(place.score):
                continue
            if best is None or place.score + place.weight + grid_weight > best.ln_bound:
                best = Reading(place=place, grid_weight=grid_weight)
        if best is not None and -best.ln_bound < log(max_p_tape) - _CLEAR:
            break
    return best


def _place(
    dots: Dots,
    xy: FloatArray,
    lattice: tuple[float, float, float, float],
    view: View,
    world: Registry | CodePlane,
    centre_px: FloatArray,
    prior: Prior | None,
    precision: float,
) -> Place | PlanePlace | None:
    free = view.scale_tolerance > 0.0
    grid, nodes, squares, sigma = fit_grid(xy, dots.weights, dots.trust, *lattice, view.shift, free)
    if not np.isfinite(grid).all():
        return None
    q = posteriors(nodes, squares, dots.weights, dots.trust, sigma)
    if isinstance(world, CodePlane):
        return world.search(nodes, q)
    part = view.part
    turns = EVEN_TURNS if part is None else turn_weights(dots.elongation, dots.weights, dots.trust, grid, part)
    return search(world.tapes, world.families, nodes, q, turns, grid, centre_px, prior, precision)
