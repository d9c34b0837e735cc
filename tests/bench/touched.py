"""Which parts a contact feels, for many poses at once: where `frames.parts_in_view` looks at one.

Parts are kept in bins of one pitch; a pose looks into the bins around it, and all poses together are a few array operations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import pi

import numpy as np
import numpy.typing as npt

from tactape_fab.sense import Parts, Scene, SensorProfile
from tactape_fab.sense.simulation.contact import imprint
from tactape_fab.sense.simulation.view import bent, make_view
from tactape_fab.texture.frames import FloatArray, IntArray, board_to_texture
from tactape_fab.texture.tape import Tape

LEAST_IMPRINT = 1e-3
_BATCH = 256
"""Poses at a time: what they look into stays in the cache."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Touched:
    """Parts that leave an imprint inside the field, of all poses, in their order.

    Attributes
    ----------
    pose, part : ndarray of int64, shape (k,)
        Which pose, and which of the parts.
    at_mm : ndarray, shape (k, 2)
        Place in view: from the image centre, right and down.
    px : ndarray, shape (k, 2)
        The same in the canonical image.
    imprint : ndarray, shape (k,)
        Share of the height that is imprinted.
    """

    pose: IntArray
    part: IntArray
    at_mm: FloatArray
    px: FloatArray
    imprint: FloatArray


def touched_parts(
    tape: Tape, poses: FloatArray, profile: SensorProfile, scene: Scene, parts: Parts, rng: np.random.Generator
) -> Touched:
    """The parts that contacts feel.

    Parameters
    ----------
    poses : ndarray, shape (n, 3)
        x mm, y mm (texture frame), theta deg.
    parts : Parts
        Where parts stand.
    rng : Generator
        Of missing parts and placement errors, anew for every pose.
    """
    found = [_touched(tape, poses[k : k + _BATCH], profile, scene, parts, rng) for k in range(0, len(poses), _BATCH)]
    first = np.repeat(np.arange(0, len(poses), _BATCH), [len(t.pose) for t in found])
    return Touched(
        pose=np.concatenate([t.pose for t in found]) + first,
        part=np.concatenate([t.part for t in found]),
        at_mm=np.concatenate([t.at_mm for t in found]),
        px=np.concatenate([t.px for t in found]),
        imprint=np.concatenate([t.imprint for t in found]),
    )


def _touched(
    tape: Tape, poses: FloatArray, profile: SensorProfile, scene: Scene, parts: Parts, rng: np.random.Generator
) -> Touched:
    view = make_view(tape, (0.0, 0.0), 0.0, profile, scene)
    farthest_mm = _reach_mm(scene, view.half_field_mm) + 5 * scene.placement_mm
    bins = _bins(tape, parts, scene.mirrored_tape)
    pose, part = bins.near(poses[:, :2], farthest_mm)
    if scene.missing:
        there = rng.random(len(pose)) >= scene.missing
        pose, part = pose[there], part[there]
    angle = np.radians(poses[:, 2])
    c, s = np.cos(angle)[pose], np.sin(angle)[pose]
    x, y = bins.x_mm[part] - poses[pose, 0], bins.y_mm[part] - poses[pose, 1]
    at_mm = np.stack([c * x - s * y, s * x + c * y], axis=-1)
    if scene.contact == "strip":
        at_mm = bent(scene, at_mm, tape.part.body_mm[2])
    if scene.placement_mm:
        at_mm = at_mm + scene.placement_mm * rng.standard_normal(at_mm.shape)
    most_u, most_v = view.half_field_mm
    seen = np.flatnonzero((np.abs(at_mm[:, 0]) <= most_u) & (np.abs(at_mm[:, 1]) <= most_v))
    pose, part, at_mm = pose[seen], part[seen], at_mm[seen]
    share = imprint(scene, at_mm)
    px = view.to_px(at_mm)
    felt = np.flatnonzero((share >= LEAST_IMPRINT) & (np.abs(px - profile.centre_px) <= profile.centre_px).all(axis=1))
    return Touched(pose=pose[felt], part=part[felt], at_mm=at_mm[felt], px=px[felt], imprint=share[felt])


def _reach_mm(scene: Scene, half_field_mm: FloatArray) -> float:
    """Farthest from the image centre, on the tape, that a part can be and be felt."""
    field, rim = float(np.hypot(*half_field_mm)), scene.roll_off_mm / 2
    if scene.contact == "pad":
        return field
    off = float(np.hypot(*scene.contact_offset_mm))
    if scene.contact == "ellipse":
        # beyond the outline the distance along the ray counts, so nothing farther than the rim is felt
        return min(field, off + max(scene.contact_mm) / 2 + rim)
    across = pi / 2 * min(field + off, off + scene.strip_half_mm + rim)  # an arc is at most pi/2 times its chord
    return float(np.hypot(field, across + off))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Bins:
    """Parts by the grid point that they stand nearest to; `table` (rows, columns, k) is framed by empty bins."""

    x_mm: FloatArray
    y_mm: FloatArray
    pitch_mm: float
    low: tuple[int, int]
    table: npt.NDArray[np.int32]

    def near(self, centres_mm: FloatArray, reach_mm: float) -> tuple[IntArray, IntArray]:
        """Which centre, and which part, of all pairs that may be within reach."""
        most = int(np.ceil(reach_mm / self.pitch_mm)) + 1
        row, column = np.mgrid[-most : most + 1, -most : most + 1]
        # a part is up to half a bin's diagonal from its bin's middle, and so is the centre
        within = np.hypot(row, column) * self.pitch_mm <= reach_mm + 1.4143 * self.pitch_mm
        at = np.rint(centres_mm / self.pitch_mm).astype(np.int64) - self.low
        rows = np.clip(at[:, 1:] + row[within], 0, self.table.shape[0] - 1)
        columns = np.clip(at[:, :1] + column[within], 0, self.table.shape[1] - 1)
        parts = self.table[rows, columns].reshape(len(centres_mm), -1)
        centre, which = np.nonzero(parts >= 0)
        part = parts[centre, which].astype(np.int64)
        x, y = self.x_mm[part] - centres_mm[centre, 0], self.y_mm[part] - centres_mm[centre, 1]
        close = np.flatnonzero(x * x + y * y <= reach_mm * reach_mm)
        return centre[close], part[close]


@lru_cache(maxsize=16)
def _bins(tape: Tape, parts: Parts, mirrored: bool) -> _Bins:
    xy_mm = parts.xy_mm * (-1.0, 1.0) + (tape.board.size_mm[0], 0.0) if mirrored else parts.xy_mm
    texture_mm = board_to_texture(xy_mm, tape.board.texture_origin_mm)
    bins = np.rint(texture_mm / tape.pitch_mm).astype(np.int64)
    low = bins.min(axis=0) - 1
    columns, rows = bins.max(axis=0) - low + 2
    flat = (bins[:, 1] - low[1]) * columns + bins[:, 0] - low[0]
    order = np.argsort(flat, kind="stable")
    _, first, counts = np.unique(flat[order], return_index=True, return_counts=True)
    table = np.full((rows * columns, counts.max()), -1, dtype=np.int32)
    table[flat[order], np.arange(len(order)) - np.repeat(first, counts)] = order
    return _Bins(
        x_mm=texture_mm[:, 0].copy(),
        y_mm=texture_mm[:, 1].copy(),
        pitch_mm=tape.pitch_mm,
        low=(int(low[0]), int(low[1])),
        table=table.reshape(rows, columns, -1),
    )
