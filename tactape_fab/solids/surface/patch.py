"""Distortion of a texture on a surface: pitch, edges, folds, gaps, curvature, each with the radius at which it first fails."""

from __future__ import annotations

import numpy as np

from tactape_fab.solids.elements import element_rings_mm, reach_mm
from tactape_fab.solids.surface.charts import Chart, Frames, nearest
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.shapes import rotate
from tactape_fab.texture.tape import Tape

SINK_MM = 0.05
"""Depth of an element's foot below the lowest point of the surface beneath it, mm."""
MOST_PITCH_ERROR = 0.10
"""Largest relative error of the pitch at a usable place."""
MOST_PITCH_ERROR_AT_ALL = 0.25
"""Relative error of the pitch beyond which a texture is refused, as grid points could be mistaken for neighbours."""
LEAST_GAP_MM = 0.01
"""Distance below which two elements collide."""

_STEEPEST = 0.5
_PROBE_DIRECTIONS = 48
_PROBE_RINGS = 40
_PROBE_REACH = 4.0
_NEAREST = 13
_FIT = 0.01
_FLAT = 2e-3


def pitch_errors(tape: Tape, grid: Frames, offset_mm: FloatArray) -> tuple[FloatArray, float]:
    """Errors of the pitch between all neighbouring grid points, and the radius of the first that is too large."""
    index = np.arange(tape.rows * tape.columns).reshape(tape.rows, tape.columns)
    a = np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()])
    b = np.concatenate([index[:, 1:].ravel(), index[1:].ravel()])
    whole = grid.arrived[a] & grid.arrived[b]
    a, b = a[whole], b[whole]
    errors = _arc_mm(grid[a], grid[b]) / tape.pitch_mm - 1
    if not len(errors):
        return np.zeros(1), np.inf
    wrong = np.abs(errors) > MOST_PITCH_ERROR
    radius = np.hypot(*offset_mm.T)
    return errors, float(np.minimum(radius[a], radius[b])[wrong].min()) if wrong.any() else np.inf


def too_distorted(errors: FloatArray, radius_mm: float) -> tuple[float, str]:
    """Problem of a pitch that is off by too much on the surface: `radius_mm` and its words, empty if there is none."""
    worst = float(errors[np.abs(errors).argmax()])
    if abs(worst) <= MOST_PITCH_ERROR_AT_ALL:
        return radius_mm, ""
    return radius_mm, f"the pitch is off by up to {worst:+.0%}, more than {MOST_PITCH_ERROR_AT_ALL:.0%}"


def _arc_mm(a: Frames, b: Frames) -> FloatArray:
    """Distance of places along the surface: the length of a circular arc with their chord and the angle of their normals."""
    chord = np.linalg.norm(a.points_mm - b.points_mm, axis=1)
    # two unit vectors at an angle t are 2 sin(t / 2) apart; on a circle chord = 2 R sin(t / 2) and arc = R t
    half = np.arcsin(np.clip(np.linalg.norm(a.normal - b.normal, axis=1) / 2, 0.0, 1.0))
    return np.asarray(chord * np.where(half > 1e-6, half / np.where(half > 1e-6, np.sin(half), 1.0), 1.0))


def beyond_edge(offset_mm: FloatArray, elements: Frames, on_surface: BoolArray) -> tuple[float, str]:
    """Problem of elements off the surface: distance of the first from the middle, mm, and its words, empty if there is none."""
    off = ~(elements.arrived & on_surface.all(axis=1))
    if not off.any():
        return np.inf, ""
    radius = float(np.where(elements.arrived, np.hypot(*offset_mm.T), elements.walked_mm)[off].min())
    count = f"{int(off.sum())} of {len(off)} elements"
    return (
        radius,
        f"the texture runs off the surface: {count} would lie on or beyond an edge, the first {radius:.1f} mm from the middle",
    )


def folds(tape: Tape, grid: Frames, offset_mm: FloatArray) -> tuple[float, str]:
    """Problem of folded cells, and of places that are near each other on the surface but not on the board."""
    radius = np.hypot(*offset_mm.T)
    index = np.arange(tape.rows * tape.columns).reshape(tape.rows, tape.columns)
    corner, right, below = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, :-1].ravel()
    whole = grid.arrived[corner] & grid.arrived[right] & grid.arrived[below]
    corner, right, below = corner[whole], right[whole], below[whole]
    points = grid.points_mm
    # rows count downward: -y x x = z, so the product is along the normal unless the cell is folded
    facing = np.cross(points[below] - points[corner], points[right] - points[corner])
    over = np.einsum("ij,ij->i", facing, grid.normal[corner]) <= 0
    radii = list(radius[corner[over]])
    there = np.flatnonzero(grid.arrived)
    if len(there) > 1:
        # itself and 12 others, more than a regular grid has within one pitch; missing ones have the index len(points)
        _, other = nearest(points[there], points[there], min(_NEAREST, len(there)), tape.pitch_mm)
        a, k = np.nonzero(other < len(there))
        a, b = there[a], there[other[a, k]]
        apart = np.maximum(np.abs(a % tape.columns - b % tape.columns), np.abs(a // tape.columns - b // tape.columns))
        # opposite normals are those of two sides of a thin wall, which may be near each other
        meets = (apart >= 2) & (np.einsum("ij,ij->i", grid.normal[a], grid.normal[b]) > 0)
        radii += list(np.maximum(radius[a], radius[b])[meets])
    if not radii:
        return np.inf, ""
    least = float(min(radii))
    return least, f"the texture folds or meets itself {least:.1f} mm from the middle"


def gaps_mm(tape: Tape, elements: Frames) -> tuple[FloatArray, IntArray]:
    """Gaps between elements that are near each other, and their pairs; shapes (p,), (p, 2).

    Both elements, foot and top, are projected along the normal of either one; the gap is the largest along the directions of
    their sides (separating axes), so at most their distance, and negative if they overlap.
    """
    there = np.flatnonzero(elements.arrived)
    if len(there) < 2:
        return np.zeros(0), np.zeros((0, 2), dtype=np.int64)
    points = elements.points_mm[there]
    # on a plane feet whose middles are a diagonal apart cannot touch; the margin is for surfaces that curve inward
    near_mm = max(2.2 * float(np.hypot(*np.array(tape.part.body_mm[:2]))), 1.5 * tape.pitch_mm)
    _, other = nearest(points, points, min(_NEAREST, len(there)), near_mm)
    a, k = np.nonzero(other < len(there))
    pairs = np.stack([there[a], there[other[a, k]]], axis=1)
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    between = elements.points_mm[pairs[:, 1]] - elements.points_mm[pairs[:, 0]]
    # pairs above each other, on two sheets of the surface, would overlap in projection without being near
    over = np.abs(np.einsum("ij,ij->i", between, elements.normal[pairs[:, 0]]))
    pairs = pairs[over < tape.part.body_mm[2] + np.hypot(*reach_mm(tape.part)) + 2 * SINK_MM]
    # each projection gives a lower bound of the distance, of which the larger one is better
    gaps = np.maximum(_seen_from(tape.part, elements, pairs), _seen_from(tape.part, elements, pairs[:, ::-1]))
    return gaps, pairs


def _seen_from(part: TapePart, elements: Frames, pairs: IntArray) -> FloatArray:
    """Largest gap of each pair along the side directions of its first element; shape (p,)."""
    one, two = elements[pairs[:, 0]], elements[pairs[:, 1]]
    # foot and top bound a convex element, also an inclined neighbour
    rings = element_rings_mm(part)[[0, -1]]
    axes = np.stack([two.x_axis, two.y_axis, two.normal], axis=1)
    if part.shape == "dome":
        # circles: points of the inclined neighbour's projection are within its radius of its middle
        heights, radii = rings[:, :, 2].mean(axis=1), np.hypot(rings[:, :, 0], rings[:, :, 1]).max(axis=1)
        middles = (two.points_mm - one.points_mm)[:, None] + heights[:, None] * two.normal[:, None]
        seen = np.stack([np.einsum("ijk,ik->ij", middles, axis) for axis in (one.x_axis, one.y_axis)], axis=2)
        return np.asarray((np.linalg.norm(seen, axis=2) - radii).min(axis=1) - part.body_mm[0] / 2)
    corners = (two.points_mm - one.points_mm)[:, None] + rings.reshape(-1, 3) @ axes
    flat = np.stack([np.einsum("ijk,ik->ij", corners, axis) for axis in (one.x_axis, one.y_axis)], axis=2)
    own = rotate(flat, -part.rotation_deg)
    half = np.array(part.body_mm[:2]) / 2
    # distance of all corners beyond either end of the body, along its length and its width, of which the larger separates them
    return np.asarray(np.maximum(own.min(axis=1) - half, -half - own.max(axis=1)).max(axis=1))


def collisions(offset_mm: FloatArray, gap_mm: FloatArray, pairs: IntArray) -> tuple[float, str]:
    """Problem of pairs of elements that nearly touch: distance of the first from the middle, mm, and its words."""
    close = gap_mm < LEAST_GAP_MM
    if not close.any():
        return np.inf, ""
    radius = float(np.hypot(*offset_mm.T)[pairs].max(axis=1)[close].min())
    gap = float(gap_mm.min())
    how = f"overlap by up to {-gap:.3f} mm" if gap < 0 else f"come within {gap:.3f} mm"
    return radius, (
        f"{int(close.sum())} pairs of elements {how}, less than {LEAST_GAP_MM} mm apart; "
        f"the first is {radius:.1f} mm from the middle"
    )


def too_curved(part: TapePart, offset_mm: FloatArray, height_mm: FloatArray, on_surface: BoolArray) -> tuple[float, str]:
    """Least radius of an element whose foot deviates from the surface by half its height (inf if none), and a message."""
    most_mm = _STEEPEST * part.body_mm[2]
    off = np.where(on_surface, np.abs(height_mm), 0.0).max(axis=1)
    wrong = off > most_mm
    if not wrong.any():
        return np.inf, ""
    radius = float(np.hypot(*offset_mm.T)[wrong].min())
    return radius, (
        f"the surface is too curved or rough for {int(wrong.sum())} elements: it leaves their feet by up to {off.max():.3f} mm, "
        f"more than {most_mm:.3f} mm"
    )


def probed_radius_mm(tape: Tape, chart: Chart, reach_mm: float) -> float:
    """Radius about the middle at which the surface ends, meets itself, or the circumference of rings is too short or too long."""
    most_mm = _PROBE_REACH * reach_mm
    radii = np.arange(1, _PROBE_RINGS + 1) * (most_mm / _PROBE_RINGS)
    angle = np.arange(_PROBE_DIRECTIONS) * (2 * np.pi / _PROBE_DIRECTIONS)
    course = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    probes = chart.frames((radii[:, None, None] * course).reshape(-1, 2))
    limits = [most_mm, float(probes.walked_mm[~probes.arrived].min()) if not probes.arrived.all() else most_mm]
    shape = (_PROBE_RINGS, _PROBE_DIRECTIONS)
    index = np.arange(_PROBE_RINGS * _PROBE_DIRECTIONS).reshape(shape)
    # on a plane neighbours on a ring are a side of a regular polygon apart, 2 r sin(pi / n)
    side = _arc_mm(probes[index.ravel()], probes[np.roll(index, -1, axis=1).ravel()]).reshape(shape)
    stretch = side / (2 * radii[:, None] * np.sin(np.pi / _PROBE_DIRECTIONS)) - 1
    # steps between two directions, the shorter way; places more than a twelfth of a turn apart should not be near each other
    between = np.abs(index[0][:, None] - index[0])
    across = np.minimum(between, _PROBE_DIRECTIONS - between) > _PROBE_DIRECTIONS // 12
    for k in range(1, _PROBE_RINGS):
        if radii[k] >= limits[-1]:
            break
        ring = probes.points_mm[index[k]]
        distance = np.linalg.norm(ring[:, None] - ring, axis=2)
        # not on small rings, on which all points are within a pitch
        meets = radii[k] > 3 * tape.pitch_mm and (distance[across] < tape.pitch_mm).any()
        worst, before = float(np.abs(stretch[k]).max()), float(np.abs(stretch[k - 1]).max())
        if worst > MOST_PITCH_ERROR:
            # the error grows from ring to ring; interpolated linearly at the limit
            part = (MOST_PITCH_ERROR - before) / (worst - before) if worst > before else 0.0
            limits.append(float(radii[k - 1] + np.clip(part, 0, 1) * (radii[k] - radii[k - 1])))
            break
        if meets:
            limits.append(float(radii[k - 1]))
            break
    return min(limits)


def fitted_radius_mm(grid: Frames) -> float | None:
    """Radius of a patch that is a sphere or a cylinder within 1 %; None for a plane and any other shape.

    On a sphere about c every place is c + R n with its normal n; on a cylinder this holds perpendicular to the axis.
    """
    points, normals = grid.points_mm, grid.normal
    # p = c + R n for all places: relative to the means c cancels, and least squares give R = sum p . n / sum n . n
    points, normals = points - points.mean(axis=0), normals - normals.mean(axis=0)
    # normals of a cylinder vary in two directions; the third is its axis, along which p does not depend on R
    directions = np.linalg.svd(normals, full_matrices=False)[2]
    if np.linalg.norm(normals, axis=1).max() < _FLAT:
        return None
    for kept in (3, 2):
        p, n = points @ directions[:kept].T, normals @ directions[:kept].T
        turn = float((n * n).sum())
        radius = float((p * n).sum()) / turn
        misfit = float(np.sqrt(((p - radius * n) ** 2).sum() / max(float((p * p).sum()), 1e-12)))
        if misfit <= _FIT:
            return radius
    return None
