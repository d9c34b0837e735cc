"""Dots as some detector found them in depth maps, drawn again for other poses: very many frames without an image.

What is kept is no formula but what happened: which parts were found at what imprint, how far off, how high, and what was
found where there is no part. Beside a tape the edge of its film is felt, too: there a frame's false dots are those of a
recorded frame that lay alike to the tape's outline.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.sense import Frame, Parts, Scene, SensorProfile
from tactape_fab.sense.sensors import as_sensor
from tactape_fab.sense.simulation.contact import contact_outline_mm, inwards
from tactape_fab.sense.simulation.dot_errors import NOT_A_PART, Dots
from tactape_fab.sense.simulation.parts import as_parts
from tactape_fab.sense.simulation.true_camera import true_camera
from tactape_fab.sense.simulation.view import make_view
from tactape_fab.texture.frames import FloatArray, IntArray, board_to_texture
from tactape_fab.texture.tape import Tape
from tests.bench.touched import LEAST_IMPRINT, touched_parts

MATCH_MM = 0.45
"""A dot farther from every part is none."""
APART_MM = 0.9
"""False dots stand in gaps between parts' dots: one is moved into a gap until it has as much room as it had, up to this."""
_LIKE = 30
"""Of so many records of next lower, and of next higher imprint one is drawn."""
_WHOLE = 1.0 - 1e-9
_TURN_MM = 3.0
"""Nearness of frames to one another: a turn of the outline by a radian counts as so far a shift."""
_CHOICE = 4
_MOVES = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DotRecords:
    """What a detector made of one scene.

    Attributes
    ----------
    scene : Scene
    sensor : SensorProfile
    imprint : ndarray, shape (k,)
        Of every part that was in view, ascending.
    found : ndarray of bool, shape (k,)
    off_px : ndarray, shape (k, 2)
        Error of the dot's centre, away from the contact's outline and across that; NaN where it was not found.
    weights : ndarray, shape (k,)
    outline : ndarray, shape (n, 3)
        By frame: the image centre's distance mm from the board's outline, inside positive, and the unit vector in view
        towards it; NaN where the contact does not reach so far.
    false_first : ndarray of int64, shape (n + 1,)
        Dots that are no part: those of frame k are at `false_first[k]` to `false_first[k + 1]`.
    false_px : ndarray, shape (m, 2)
        Where they were in the canonical image.
    false_weights : ndarray, shape (m,)
    false_room_px : ndarray, shape (m,)
        From the nearest part's dot.
    """

    scene: Scene
    sensor: SensorProfile
    imprint: FloatArray
    found: npt.NDArray[np.bool_]
    off_px: FloatArray
    weights: FloatArray
    outline: FloatArray
    false_first: IntArray
    false_px: FloatArray
    false_weights: FloatArray
    false_room_px: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DotFrames:
    """Dots of many frames, one after the other: those of frame k are at `first[k]` to `first[k + 1]`.

    Attributes
    ----------
    first : ndarray of int64, shape (frames + 1,)
    xy_px, weights, part, true_px
        As in `Dots`.
    """

    first: IntArray
    xy_px: FloatArray
    weights: FloatArray
    part: IntArray
    true_px: FloatArray

    def __len__(self) -> int:
        return len(self.first) - 1

    def __getitem__(self, k: int) -> Dots:
        """One frame."""
        at = slice(self.first[k], self.first[k + 1])
        return Dots(xy_px=self.xy_px[at], weights=self.weights[at], part=self.part[at], true_px=self.true_px[at])


def record_dots(
    tape: Tape,
    frames: Iterable[tuple[Frame, FloatArray, FloatArray]],
    scene: Scene,
    sensor: str | SensorProfile = "gelsight-mini",
) -> DotRecords:
    """Records of a tape's simulated frames, each with the centres (n, 2) px and weights (n,) of the dots that were found.

    Raises
    ------
    SpecError
        When no part was wholly imprinted in any of them.
    """
    profile = as_sensor(sensor)
    rows: list[FloatArray] = []
    false: list[FloatArray] = []
    poses = []
    for frame, xy_px, weights in frames:
        near = _matches(frame.dots_px, xy_px, MATCH_MM * float(np.mean(profile.px_per_mm)))
        inward = _inward(scene, profile, frame.dots_px, frame.dots_imprint)
        off = np.where((near >= 0)[:, None], xy_px[near] - frame.dots_px, np.nan) if len(xy_px) else np.nan * frame.dots_px
        weight = weights[near] if len(weights) else np.full(len(near), np.nan)
        across = off[:, 1] * inward[:, 0] - off[:, 0] * inward[:, 1]
        rows.append(np.column_stack([frame.dots_imprint, near >= 0, (off * inward).sum(axis=1), across, weight]))
        no_part = np.ones(len(xy_px), dtype=bool)
        no_part[near[near >= 0]] = False
        apart = np.hypot(*(xy_px[no_part][:, None] - xy_px[~no_part][None]).transpose(2, 0, 1))
        false.append(np.column_stack([xy_px[no_part], weights[no_part], apart.min(axis=1, initial=np.inf)]))
        poses.append((*frame.position_mm, frame.theta_deg))
    table = np.concatenate(rows) if rows else np.empty((0, 5))
    table = table[(table[:, 0] >= LEAST_IMPRINT)]
    table = table[np.argsort(table[:, 0], kind="stable")]
    if not (table[:, 0] >= _WHOLE).any():
        raise SpecError(Problem("frames", "frames show no part that is wholly imprinted; give more of them, or a larger contact"))
    others = np.concatenate(false)
    return DotRecords(
        scene=scene,
        sensor=profile,
        imprint=table[:, 0],
        found=table[:, 1] > 0,
        off_px=table[:, 2:4],
        weights=table[:, 4],
        outline=_outline(tape, np.array(poses), scene, profile),
        false_first=np.concatenate([[0], np.cumsum([len(part) for part in false])]),
        false_px=others[:, :2],
        false_weights=others[:, 2],
        false_room_px=others[:, 3],
    )


def draw_dots(
    tape: Tape,
    poses: FloatArray,
    records: DotRecords,
    rng: np.random.Generator,
    *,
    parts: Parts | npt.ArrayLike | None = None,
    mirrored: bool = False,
) -> DotFrames:
    """Dots of many poses, as they were recorded of parts alike.

    Parameters
    ----------
    poses : ndarray, shape (n, 3)
        x mm, y mm (texture frame), theta deg.
    parts
        As in `simulate`.
    mirrored : bool
        Of the tape's mirror image.
    """
    scene = records.scene.changed({"mirrored_tape": mirrored})
    touched = touched_parts(tape, poses, records.sensor, scene, as_parts(tape, parts), rng)
    like = _alike(records.imprint, touched.imprint, rng)
    kept = np.flatnonzero(records.found[like])
    like, frame, true_px = like[kept], touched.pose[kept], touched.px[kept]
    inward = _inward(records.scene, records.sensor, true_px, touched.imprint[kept])
    along, across = records.off_px[like].T
    off = np.stack([inward[:, 0] * along - inward[:, 1] * across, inward[:, 1] * along + inward[:, 0] * across], axis=-1)
    xy_px = true_px + off
    false_frame, which, false_px = _false(_outline(tape, poses, scene, records.sensor), records, rng)
    room_px = np.minimum(records.false_room_px[which], APART_MM * float(np.mean(records.sensor.px_per_mm)))
    false_px = _with_room(false_frame, false_px, room_px, frame, xy_px)
    frames = np.concatenate([frame, false_frame])
    order = np.argsort(frames, kind="stable")
    return DotFrames(
        first=np.concatenate([[0], np.cumsum(np.bincount(frames, minlength=len(poses)))]),
        xy_px=np.concatenate([xy_px, false_px])[order],
        weights=np.concatenate([records.weights[like], records.false_weights[which]])[order],
        part=np.concatenate([touched.part[kept], np.full(len(false_px), NOT_A_PART)])[order],
        true_px=np.concatenate([true_px, np.full((len(false_px), 2), np.nan)])[order],
    )


def _matches(true_px: FloatArray, xy_px: FloatArray, most_px: float) -> IntArray:
    """The dot of each part, -1 where there is none: each is the other's nearest."""
    if not len(xy_px) or not len(true_px):
        return np.full(len(true_px), -1, dtype=np.int64)
    apart = np.hypot(*(true_px[:, None] - xy_px[None]).transpose(2, 0, 1))
    dot = apart.argmin(axis=1)
    mutual = (apart.argmin(axis=0)[dot] == np.arange(len(dot))) & (apart.min(axis=1) <= most_px)
    return np.where(mutual, dot, -1)


def _inward(scene: Scene, profile: SensorProfile, px: FloatArray, share: FloatArray) -> FloatArray:
    """Unit vectors away from the contact's outline; of parts wholly imprinted, which nothing draws anywhere, along u."""
    unit = np.tile([1.0, 0.0], (len(px), 1))
    rim = np.flatnonzero(share < _WHOLE)
    if scene.contact != "pad" and len(rim):
        unit[rim] = inwards(scene, true_camera(profile, scene).from_px(px[rim]))
    return unit


def _alike(recorded: FloatArray, imprint: FloatArray, rng: np.random.Generator) -> IntArray:
    """For each imprint the index of one of the records nearest to it."""
    whole = int(np.searchsorted(recorded, _WHOLE))
    index = rng.integers(whole, len(recorded), len(imprint))
    rim = np.flatnonzero(imprint < _WHOLE)
    if whole:
        low = np.clip(np.searchsorted(recorded[:whole], imprint[rim]) - _LIKE, 0, max(whole - 2 * _LIKE, 0))
        index[rim] = np.minimum(low + rng.integers(0, 2 * _LIKE, len(rim)), whole - 1)
    return index


def _outline(tape: Tape, poses: FloatArray, scene: Scene, profile: SensorProfile) -> FloatArray:
    """How the board's outline lies to each pose, as in `DotRecords`."""
    corners = board_to_texture(np.array([(0.0, 0.0), tape.board.size_mm]), tape.board.texture_origin_mm)
    low, high = corners.min(axis=0), corners.max(axis=0)
    inside = np.column_stack([poses[:, :2] - low, high - poses[:, :2]])
    side = inside.argmin(axis=1)
    distance = inside[np.arange(len(poses)), side]
    x, y = np.array([(-1.0, 0.0), (0.0, -1.0), (1.0, 0.0), (0.0, 1.0)])[side].T
    angle = np.radians(poses[:, 2])
    c, s = np.cos(angle), np.sin(angle)
    lie = np.column_stack([distance, c * x - s * y, s * x + c * y])
    around = contact_outline_mm(scene, make_view(tape, (0.0, 0.0), 0.0, profile, scene).half_field_mm)
    u, v = around[:, 0, None], around[:, 1, None]
    x, y = c * u + s * v + poses[:, 0], c * v - s * u + poses[:, 1]
    (left, top), (right, bottom) = low + scene.roll_off_mm / 2, high - scene.roll_off_mm / 2
    within = (x.min(axis=0) > left) & (x.max(axis=0) < right) & (y.min(axis=0) > top) & (y.max(axis=0) < bottom)
    lie[within] = np.nan
    return lie


def _false(lie: FloatArray, records: DotRecords, rng: np.random.Generator) -> tuple[IntArray, IntArray, FloatArray]:
    """False dots of frames that lie so to the outline: frame, record and centre px of each."""
    recorded = records.outline
    like = rng.integers(0, len(recorded), len(lie))
    beside, recorded_beside = np.flatnonzero(np.isfinite(lie[:, 0])), np.flatnonzero(np.isfinite(recorded[:, 0]))
    inland = np.flatnonzero(np.isnan(recorded[:, 0]))
    if len(inland):
        like = inland[rng.integers(0, len(inland), len(lie))]
    turn = np.tile([1.0, 0.0], (len(lie), 1))
    if len(beside) and len(recorded_beside):
        from scipy.spatial import cKDTree

        scale = np.array([1.0, _TURN_MM, _TURN_MM])
        most = min(_CHOICE, len(recorded_beside))
        _, near = cKDTree(recorded[recorded_beside] * scale).query(lie[beside] * scale, k=[*range(1, most + 1)])
        like[beside] = recorded_beside[near[np.arange(len(beside)), rng.integers(0, most, len(beside))]]
        (u, v), (to_u, to_v) = recorded[like[beside], 1:].T, lie[beside, 1:].T
        turn[beside] = np.column_stack([u * to_u + v * to_v, u * to_v - v * to_u])
    counts = np.diff(records.false_first)[like]
    frame = np.repeat(np.arange(len(lie)), counts)
    which = np.arange(len(frame)) - np.repeat(np.cumsum(counts) - counts, counts) + records.false_first[like][frame]
    u, v = (records.false_px[which] - records.sensor.centre_px).T
    c, s = turn[frame].T
    px = np.column_stack([c * u - s * v, s * u + c * v])
    seen = (np.abs(px) <= records.sensor.centre_px).all(axis=1)
    return frame[seen], which[seen], px[seen] + records.sensor.centre_px


def _with_room(
    false_frame: IntArray, false_px: FloatArray, room_px: FloatArray, frame: IntArray, xy_px: FloatArray
) -> FloatArray:
    """False dots moved, a few times, straight away from their frame's nearest other dot until they have their room."""
    if not len(false_px) or not len(xy_px):
        return false_px
    frames = int(max(false_frame[-1], frame[-1])) + 1
    first, own = np.searchsorted(frame, np.arange(frames)), np.bincount(frame, minlength=frames)
    moved, which = false_px.copy(), np.flatnonzero(own[false_frame])
    for _ in range(_MOVES):
        counts = own[false_frame[which]]
        start = np.cumsum(counts) - counts
        pair = np.repeat(np.arange(len(which)), counts)
        dot = np.arange(len(pair)) + (first[false_frame[which]] - start)[pair]
        away = moved[which][pair] - xy_px[dot]
        square = away[:, 0] ** 2 + away[:, 1] ** 2
        least = np.minimum.reduceat(square, start)
        nearest = np.flatnonzero((square == least[pair]) & (square < (room_px[which] ** 2)[pair]))
        if not len(nearest):
            break
        short = which[pair[nearest]]
        length = np.maximum(np.sqrt(square[nearest]), 1e-6)
        moved[short] = xy_px[dot[nearest]] + away[nearest] * (room_px[short] / length)[:, None]
        which = np.unique(short)
    return moved
