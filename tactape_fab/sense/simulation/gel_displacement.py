"""Smooth random displacement of what a gel shows: a Gaussian process with the covariance rms^2 exp(-d^2 / 2 l^2) on each axis."""

from __future__ import annotations

import numpy as np

from tactape_fab.sense.simulation.view import View
from tactape_fab.texture.frames import FloatArray

_NODES_PER_LENGTH = 2.0
_REACH = 4.0
"""Correlation lengths beyond the field up to which there are nodes: farther ones count exp(-16) of a near one."""


def displacement_um(view: View) -> float:
    """Root mean square along each axis, um: the scene's, or that of the sensor's gel."""
    given = view.scene.gel_displacement_um
    return view.profile.gel.displacement_um if given is None else given


def displacements(view: View, at_mm: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Displacements of points in view, drawn anew; shape (n, 2), mm.

    White noise on nodes, each spread by exp(-d^2 / l^2): at l / 2 from node to node the covariance of the sum is that of the
    process within 1e-8, whatever the points are, and nothing is inverted.
    """
    given = view.scene.gel_correlation_mm
    length_mm = view.profile.gel.correlation_mm if given is None else given
    step_mm = length_mm / _NODES_PER_LENGTH
    counts = [int(np.ceil((half + _REACH * length_mm) / step_mm)) for half in view.half_field_mm]  # on each side of the centre
    across, down = (np.arange(-n, n + 1) * step_mm for n in counts)
    drawn = rng.standard_normal((2, len(across), len(down)))
    # exp(-(x - n)^2 / l^2) exp(-(y - n)^2 / l^2), summed over nodes n, is exp(-(x - y)^2 / 2 l^2) times a sum that hardly depends
    # on where between the nodes the points are
    of_u, of_v = (np.exp(-(((at_mm[:, k, None] - nodes) / length_mm) ** 2)) for k, nodes in enumerate((across, down)))
    # the squares of the spread over all nodes add up to (pi / 2) (l / step)^2
    gain = displacement_um(view) / 1000.0 / (np.sqrt(np.pi / 2) * _NODES_PER_LENGTH)
    return np.asarray(gain * np.einsum("nu,kuv,nv->nk", of_u, drawn, of_v, optimize=True))
