"""Compilation of all kernels that a registry needs, before its first frame."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from tactape_fab.base.jit import COMPILED, KEPT
from tactape_fab.sense.decode.contact.layer import factor
from tactape_fab.sense.decode.contact.plane import robust_surface
from tactape_fab.sense.decode.contact.surface import taken
from tactape_fab.sense.decode.dots.detect import Dots, detect
from tactape_fab.sense.decode.dots.elongation import turn_weights
from tactape_fab.sense.decode.dots.holes import filled
from tactape_fab.sense.decode.dots.inputs import span
from tactape_fab.sense.decode.dots.middles import rehearse_middles
from tactape_fab.sense.decode.dots.rim import settled
from tactape_fab.sense.decode.dots.subpixel import sharp_tops
from tactape_fab.sense.decode.grid.fit import fit_grid, posteriors
from tactape_fab.sense.decode.grid.lattice import find_lattices
from tactape_fab.sense.decode.grid.long_parts import drawn_px
from tactape_fab.sense.decode.grid.pose import fit_pose
from tactape_fab.sense.decode.rank import View
from tactape_fab.sense.decode.search.evidence import turned
from tactape_fab.sense.decode.search.hypotheses import Registry
from tactape_fab.sense.decode.search.search import rehearse_search
from tactape_fab.texture.frames import FloatArray

_log = logging.getLogger("tactape_fab")


def announce() -> None:
    """Print that kernels will be compiled, unless they are already."""
    if compiled():
        return
    if KEPT:
        _log.warning("tactape-fab compiles its decoder, once on this machine; it takes some twenty seconds")
    else:
        _log.warning(
            "tactape-fab compiles its decoder, and will each time: no folder keeps compiled functions; "
            "set NUMBA_CACHE_DIR to one that can be written"
        )


def cache_folder() -> Path | None:
    """Folder of the compiled functions; None if none is writable."""
    return Path(str(turned.stats.cache_path)) if KEPT else None


def compiled() -> bool:
    """Whether no kernel has to be compiled: they are in memory, in an up-to-date cache on disk, or plain Python."""
    if not COMPILED or turned.signatures:
        return True
    folder = cache_folder()
    if folder is None or not any(folder.glob("*.turned-*")):
        return False
    # numba looks into its cache when a kernel is called: on no dots nothing is computed, and a miss is counted
    turned(np.empty((0, 2), dtype=np.int64), np.empty((0, 4)), 0, np.empty((0, 2), dtype=np.int64), np.empty((0, 3)))
    return not any(turned.stats.cache_misses.values())


def rehearse(dots: Dots, ripple: FloatArray, view: View, registry: Registry | None, *, elastic: bool) -> None:
    """Call every kernel once, on made-up dots and a made-up depth map; of the search those that the registry's tapes need.

    elastic: Whether frames are asked for forces, which need a gel of known thickness and modulus.
    """
    if not COMPILED:
        return
    image = ripple.astype(np.float32)
    span(image)
    filled(image, np.ones(image.shape, dtype=np.bool_), view.px_per_mm)
    _, heights = sharp_tops(image, view.px_per_mm, dots.xy_px)
    if view.part is not None:
        drawn_px(view.part, heights, dots.xy_px, dots.xy_px, view.px_per_mm)
    rehearse_middles(dots, image, view.part)
    detect(image, view.px_per_mm)
    n = len(dots.xy_px)
    agree = np.ones(n, dtype=bool)
    line, normal = np.empty(image.shape[1]), np.zeros((7, 7))
    taken(image, image, dots.xy_px, agree, dots.weights, 1, 1, np.empty(n), np.empty((0, 0)), line, normal)
    robust_surface(dots.xy_px, dots.weights, dots.weights, np.zeros(3))
    if elastic:
        factor(np.eye(2), np.eye(2), np.zeros(2), np.arange(2), np.ones(2), 1.0, np.empty((5, 2)))
    dots = settled(dots, view.pitch_px, view.shift)
    xy = dots.xy_px - dots.xy_px.mean(axis=0)
    angle, pitch, phase_a, phase_b, _ = find_lattices(xy, dots.weights, view.pitch_px, view.scale_tolerance, 1)[0].tolist()
    start = (angle, pitch, phase_a, phase_b)
    grid, nodes, squares, sigma, *_ = fit_grid(xy, dots.weights, dots.trust, *start, view.shift, True, view.directions)
    posteriors(nodes, squares, dots.weights, dots.trust, sigma)
    if view.part is not None:
        turn_weights(dots.elongation, dots.weights, dots.trust, grid, view.part)
    if registry is not None:
        rehearse_search(registry.families, view.directions)
    fit_pose(xy, nodes * np.float64(view.pitch_mm), dots.weights, view.px_per_mm, view.beliefs)
