"""Elements as open meshes of sides and top; the foot has a vertex wherever a cut of the surface crosses it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import pi

import numpy as np

from tactape_fab.solids.elements import (
    block_corners_mm,
    cap_faces,
    dome_points,
    dome_rings,
    has_apex,
    ring_faces,
    sphere_radius_mm,
)
from tactape_fab.solids.rise import foot_radius_mm
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.part import TapePart

_LEAST_SHARE = 1e-6
_LEAST_TURN_RAD = 0.02
_BISECTIONS = 60


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shell:
    """An element's sides and top, open at the foot.

    foot (m, 2): Counter-clockwise, in the part's frame.
    above (k, 3): The other vertices, in the part's frame (height over the tangent plane).
    faces (f, 3): Indices: foot vertices first, then those above.
    """

    foot: FloatArray
    above: FloatArray
    faces: IntArray


def element_shells(part: TapePart, cuts_mm: Sequence[FloatArray], radius_mm: float | None) -> list[Shell]:
    """Shells of an element on a plane or, with `radius_mm`, on a cylinder, one for each set of cuts.

    cuts_mm: Tangential offsets at which the surface is cut; the foot has a vertex exactly on each one that crosses it.
    """
    if part.shape == "block":
        return [_block_shell(part, cuts) for cuts in cuts_mm]

    def foot_radius(angle: FloatArray) -> FloatArray:
        if radius_mm is None:
            return np.full_like(angle, part.body_mm[0] / 2)
        return foot_radius_mm(part, radius_mm, angle)

    feet = _foot_angles(dome_points(part), cuts_mm, foot_radius)
    return [_dome_shell(part, angle, on_cut, foot_radius(angle)) for angle, on_cut in feet]


def _block_shell(part: TapePart, cuts_mm: FloatArray) -> Shell:
    """Every side is a fan from the foot's vertices to the straight edge on top."""
    corners = block_corners_mm(part)
    foot: list[tuple[float, float]] = []
    firsts = []
    for k in range(4):
        (px, py), (qx, qy) = corners[k].tolist(), corners[(k + 1) % 4].tolist()
        firsts.append(len(foot))
        foot.append((px, py))
        # a side along the cylinder's axis meets no cut, or lies along one
        if abs(qx - px) > _LEAST_SHARE:
            # the vertex's x is exactly the cut's, as in the strips on both sides
            shares = sorted(((cut - px) / (qx - px), cut) for cut in cuts_mm.tolist())
            foot += [(cut, py + s * (qy - py)) for s, cut in shares if _LEAST_SHARE < s < 1 - _LEAST_SHARE]
    m = len(foot)
    faces = []
    for k in range(4):
        ends = [*range(firsts[k], firsts[k + 1] if k < 3 else m), firsts[(k + 1) % 4]]
        # on a cylinder the foot of a side is an elliptic arc in the side's plane; a fan uses each of its vertices
        faces += [(a, b, m + (k + 1) % 4) for a, b in pairwise(ends)]
        faces.append((ends[0], m + (k + 1) % 4, m + k))
    faces += [(m, m + 1, m + 2), (m, m + 2, m + 3)]
    above = np.column_stack([corners, np.full(4, part.body_mm[2])])
    return Shell(foot=np.array(foot), above=above, faces=np.array(faces, dtype=np.int64))


def _dome_shell(part: TapePart, angle: FloatArray, on_cut: FloatArray, reach: FloatArray) -> Shell:
    """A cap or cone in rings of equal directions; `reach` is the radius of its foot in each."""
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    foot = reach[:, None] * direction
    # exactly on the cut, which bisection finds within rounding only
    foot[:, 0] = np.where(np.isnan(on_cut), foot[:, 0], on_cut)
    height_mm = part.body_mm[2]
    if part.top_mm is not None:
        radii, heights = np.full((1, len(angle)), part.top_mm / 2), np.full((1, len(angle)), height_mm)
    else:
        sphere_mm, rings_n = sphere_radius_mm(part), dome_rings(part)
        # on a cylinder the foot depends on the direction: rings divide the angle from foot to apex in each
        polar = np.arcsin(np.minimum(reach / sphere_mm, 1.0)) * (1 - np.arange(1, rings_n) / rings_n)[:, None]
        radii, heights = sphere_mm * np.sin(polar), sphere_mm * np.cos(polar) + height_mm - sphere_mm
    above = np.concatenate([radii[..., None] * direction, heights[..., None]], axis=2).reshape(-1, 3)
    rings, points = len(radii) + 1, len(angle)
    apex = None
    if has_apex(part):
        apex = rings * points
        above = np.vstack([above, (0.0, 0.0, height_mm)])
    faces = np.concatenate([ring_faces(rings, points), cap_faces((rings - 1) * points, points, apex)])
    return Shell(foot=foot, above=above, faces=faces)


def _foot_angles(
    count: int, cuts_mm: Sequence[FloatArray], foot_radius: Callable[[FloatArray], FloatArray]
) -> list[tuple[FloatArray, FloatArray]]:
    """For each set of cuts the ascending directions of a foot's vertices, `count` regular ones and those on cuts, and the cut of
    each (NaN for none).
    """
    regular = np.arange(count) * (2 * pi / count)
    # a cut beyond the foot's ends along the tangent does not cross it
    ends = foot_radius(np.array([0.0, pi]))
    crossed = [cuts[(cuts > -ends[1]) & (cuts < ends[0])] for cuts in cuts_mm]
    # each cut crosses the foot twice: between 0 and pi, and between pi and 2 pi; all sets are bisected at once
    target = np.concatenate([np.tile(cuts, 2) for cuts in crossed])
    near, far = np.concatenate([np.repeat([0.0, 2 * pi], len(cuts)) for cuts in crossed]), np.full(len(target), pi)
    for _ in range(_BISECTIONS):  # the offset decreases monotonically from end to end
        middle = (near + far) / 2
        beyond = foot_radius(middle) * np.cos(middle) > target
        near, far = np.where(beyond, middle, near), np.where(beyond, far, middle)
    ends_at = np.cumsum([2 * len(cuts) for cuts in crossed])[:-1]
    found = []
    for crossing, on in zip(np.split((near + far) / 2, ends_at), np.split(target, ends_at), strict=True):
        # a regular vertex next to a crossing would make a sliver
        apart = np.abs((regular[:, None] - crossing + pi) % (2 * pi) - pi).min(axis=1, initial=pi) > _LEAST_TURN_RAD
        angle = np.concatenate([regular[apart], crossing])
        on_cut = np.concatenate([np.full(int(apart.sum()), np.nan), on])
        order = np.argsort(angle)
        found.append((angle[order], on_cut[order]))
    return found
