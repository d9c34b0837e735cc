"""The first time ever: another process compiles the search while this one compiles the rest, each half of the whole."""

from __future__ import annotations

import gc
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from tactape_fab.base.jit import KEPT
from tactape_fab.base.launch import python_command, start
from tactape_fab.sense.decode.dots.detect import Dots, detect
from tactape_fab.sense.decode.dots.elongation import turn_weights
from tactape_fab.sense.decode.dots.rim import settled
from tactape_fab.sense.decode.grid.fit import fit_grid, posteriors
from tactape_fab.sense.decode.grid.lattice import find_lattices
from tactape_fab.sense.decode.grid.pose import fit_pose
from tactape_fab.sense.decode.rank import View
from tactape_fab.sense.decode.rule import LEAST_DOTS
from tactape_fab.sense.decode.search.all_places import compile_weighing
from tactape_fab.sense.decode.search.evidence import tables_of, turned
from tactape_fab.sense.decode.search.groups import count_places, groups_of
from tactape_fab.sense.decode.search.matrices import LARGEST_CONTACT
from tactape_fab.sense.decode.search.plane_sites import sites_of
from tactape_fab.sense.decode.search.single_place import compile_near
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.frames import FloatArray

_LONGEST_S = 60.0
"""A process that takes longer is not waited for: what it would have compiled is compiled here then."""

_log = logging.getLogger("tactape_fab")


@contextmanager
def search_compiled(*, needed: bool = True) -> Iterator[None]:
    """While the block runs, another process compiles the search, where compiled functions are not on the disk yet; and a word.

    A code without tapes is searched otherwise: the search is not needed then.
    Where no other process can be started, or there is one core, the search is compiled when it is first called.
    """
    if compiled():
        yield
        return
    if not KEPT:
        _log.warning(
            "tactape-fab compiles its decoder, and will each time: no folder keeps compiled functions; "
            "set NUMBA_CACHE_DIR to one that can be written"
        )
        yield
        return
    _log.warning("tactape-fab compiles its decoder, once on this machine; it takes some ten seconds")
    scratch = tempfile.TemporaryDirectory(prefix="tactape-compile-", ignore_cleanup_errors=True)
    process = _started(Path(scratch.name)) if needed else None
    try:
        yield
        if process is not None:
            with suppress(subprocess.TimeoutExpired):
                process.wait(_LONGEST_S)
    finally:
        if process is not None and process.poll() is None:
            process.kill()
            process.wait()
        scratch.cleanup()


def cache_folder() -> Path | None:
    """Where compiled functions are kept; None where no folder can be written."""
    return Path(str(turned.stats.cache_path)) if KEPT else None


def compiled() -> bool:
    """Whether a function of the search is here, or on the disk and of these sources; without a file nothing has to be tried."""
    if turned.signatures:
        return True
    folder = cache_folder()
    if folder is None or not any(folder.glob("*.turned-*")):
        return False
    turned(np.empty((0, 2), dtype=np.int64), np.empty((0, 4)), 0, np.empty((0, 2), dtype=np.int64), np.empty((0, 3)))
    return sum(turned.stats.cache_misses.values()) == 0


def _started(scratch: Path) -> subprocess.Popen[bytes] | None:
    """A process that compiles the search; None where this one is no Python to be started again, or has but one core."""
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    if cores == 1 or getattr(sys, "frozen", False) or not Path(sys.executable or "").name.startswith("python"):
        return None
    quiet = subprocess.DEVNULL
    command = python_command(f"from {__name__} import compile_search; compile_search()")
    try:
        return start(command, scratch, stdin=quiet, stdout=quiet, stderr=quiet)
    except OSError:
        return None


def compile_search() -> None:
    """Compile what makes tables and groups of places and holds dots against them, for one dot and a tape that nobody made."""
    gc.disable()
    one = np.zeros((1, 2), dtype=np.int64)
    sites = sites_of(get_plane("microdots-4x4"), [(8, 8)], origins=one, size_of=one[:, 0], sectors=one)
    tables = tables_of(one, np.full((1, 4), 0.25), sites.signs, LARGEST_CONTACT)
    groups = groups_of(tables, sites.sizes, LEAST_DOTS)
    compile_weighing(tables, sites, groups)


def rehearse(dots: Dots, ripple: FloatArray, view: View) -> None:
    """Call all the rest once, on made-up dots and a made-up depth map."""
    detect(ripple.astype(np.float32), view.px_per_mm)
    dots = settled(dots, view.pitch_px, view.shift)
    xy = dots.xy_px - dots.xy_px.mean(axis=0)
    angle, pitch, phase_a, phase_b, _ = find_lattices(xy, dots.weights, view.pitch_px, view.scale_tolerance, 1)[0].tolist()
    start = (angle, pitch, phase_a, phase_b)
    grid, nodes, squares, sigma, *_ = fit_grid(xy, dots.weights, dots.trust, *start, view.shift, True, view.directions)
    posteriors(nodes, squares, dots.weights, dots.trust, sigma)
    if view.part is not None:
        turn_weights(dots.elongation, dots.weights, dots.trust, grid, view.part)
    count_places(
        np.empty((0, 9), dtype=np.int64), np.zeros((4, 1, 2), dtype=np.int64), np.empty((0, 3)), np.empty((0, 6), dtype=np.int64)
    )
    compile_near()
    fit_pose(xy, nodes * np.float64(view.pitch_mm), dots.weights, view.px_per_mm, fixed_scale=False)
