"""Simulated frames with their truth: one by `simulate`, many by `iterate_frames` and `simulate_frames`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import SpecError
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.simulation.arguments import checked_poses, checked_seed, edge_problems, profile_and_scene
from tactape_fab.sense.simulation.contact import contact_outline_mm, imprint, inside_mm
from tactape_fab.sense.simulation.drawn_poses import draw_poses
from tactape_fab.sense.simulation.elastic import imprint_of
from tactape_fab.sense.simulation.gel import BUMP_FOOT_MM, BUMP_HEIGHT, FloatImage, press, relief_of, sensed
from tactape_fab.sense.simulation.gel_displacement import displacement_um, displacements
from tactape_fab.sense.simulation.parts import Parts, as_parts, scattered
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.sense.simulation.view import View, make_view
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One frame and its truth.

    Attributes
    ----------
    depth : ndarray of float32, shape (h, w)
        As the sensor delivers it.
    position_mm : ndarray, shape (2,)
        Texture point under the image centre (texture frame, mm).
    theta_deg : float
        Turn of the sensor on the tape, degrees, counter-clockwise seen from above.
    contact_px : ndarray, shape (2,)
        Contact centre in the canonical image, px; the centre of pressure with an elastic gel.
    dots_px : ndarray, shape (k, 2)
        Where the centres of the parts that leave an imprint are seen in the canonical image: with their placement errors and the
        gel's displacement, by the true camera.
    dots_part : ndarray of int64, shape (k,)
        Index of each one's part in the tape, or in the given parts.
    dots_imprint : ndarray, shape (k,)
        Fraction of its height that is imprinted at each; at least 0.5 inside the contact's outline. With an elastic gel: fraction
        of the middle of its top that the gel touches.
    """

    depth: FloatImage
    position_mm: FloatArray
    theta_deg: float
    contact_px: FloatArray
    dots_px: FloatArray
    dots_part: IntArray
    dots_imprint: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frames:
    """Many frames and their truth, each attribute as in `Frame` with one entry per frame.

    Attributes
    ----------
    depth : ndarray of float32, shape (n, h, w)
    position_mm : ndarray, shape (n, 2)
    theta_deg : ndarray, shape (n,)
    contact_px : ndarray, shape (n, 2)
    dots_px, dots_part, dots_imprint : tuple of ndarray
        One array for each frame.
    """

    depth: FloatImage
    position_mm: FloatArray
    theta_deg: FloatArray
    contact_px: FloatArray
    dots_px: tuple[FloatArray, ...]
    dots_part: tuple[IntArray, ...]
    dots_imprint: tuple[FloatArray, ...]


def simulate(
    tape: Tape,
    position_mm: npt.ArrayLike,
    theta_deg: float,
    *,
    sensor: str | Path | SensorProfile = DEFAULT_SENSOR,
    scene: Scene | None = None,
    seed: int = 0,
    parts: Parts | npt.ArrayLike | None = None,
    **options: Any,
) -> FloatImage:
    """The depth map of a tape in contact.

    A pixel p of the canonical image sees the texture point S + (1/R) [[cos, sin], [-sin, cos]] (p - p0), with p0 the
    image centre ((width - 1) / 2, (height - 1) / 2) and R px/mm (paper, Eq. 12).

    Parameters
    ----------
    tape : Tape
    position_mm : array_like, shape (2,)
        S, the texture point under the image centre.
    theta_deg : float
        Turn of the sensor on the tape, counter-clockwise seen from above.
    sensor : str, Path or SensorProfile
        A profile, its name, or the path of its TOML file.
    scene : Scene, optional
        The contact; by default the default scene.
    seed : int
        Equal seeds give equal frames.
    parts : Parts or array_like, optional
        Places of parts, (x, y) or (x, y, rotation) rows in the board frame, instead of the tape's own.
    **options
        Attributes of `Scene` to replace.

    Returns
    -------
    ndarray of float32, shape `sensor.frame_shape`
        Depth in the sensor's unit, mm if it has none; larger where pushed further in, unless the sensor's sign is -1.

    Raises
    ------
    SpecError
        For an invalid pose, option, part or sensor.
    """
    profile, scene = profile_and_scene(tape, sensor, scene, options)
    view = make_view(tape, position_mm, theta_deg, profile, scene)
    return _frame(view, as_parts(tape, parts), np.random.SeedSequence(checked_seed(seed))).depth


def iterate_frames(
    tape: Tape,
    count: int,
    seed: int = 0,
    sensor: str | Path | SensorProfile = DEFAULT_SENSOR,
    scene: Scene | None = None,
    *,
    poses: npt.ArrayLike | None = None,
    edge: bool = False,
    parts: Parts | npt.ArrayLike | None = None,
) -> Iterator[Frame]:
    """Frames one by one; frame k is the same whatever `count` is.

    Parameters
    ----------
    tape, sensor, scene, parts
        As in `simulate`.
    count : int
        Number of frames.
    seed : int
        Of poses, noise and defects.
    poses : array_like, shape (count, 3), optional
        (x mm, y mm, theta deg) per frame; `draw_poses` when left out.
    edge : bool
        Draw poses whose contact hangs over the edge of the texture.

    Yields
    ------
    Frame

    Raises
    ------
    SpecError
        As `simulate`, and for poses of another shape; on the first frame asked for.
    """
    profile, scene = profile_and_scene(tape, sensor, scene)
    if problems := edge_problems(edge, poses):
        raise SpecError(problems)
    drawn = draw_poses(tape, count, seed, profile, scene, edge=edge) if poses is None else checked_poses(poses, count)
    standing = as_parts(tape, parts)
    for k, pose in enumerate(drawn):
        yield _frame(make_view(tape, pose[:2], float(pose[2]), profile, scene), standing, _stream(seed, k))


def frame_at(
    tape: Tape,
    number: int,
    pose: FloatArray,
    seed: int = 0,
    sensor: str | Path | SensorProfile = DEFAULT_SENSOR,
    scene: Scene | None = None,
) -> Frame:
    """Frame `number` of `iterate_frames` with this pose; it raises the same errors."""
    profile, scene = profile_and_scene(tape, sensor, scene)
    view = make_view(tape, pose[:2], float(pose[2]), profile, scene)
    return _frame(view, as_parts(tape, None), _stream(seed, number))


def simulate_frames(
    tape: Tape,
    count: int,
    seed: int = 0,
    sensor: str | Path | SensorProfile = DEFAULT_SENSOR,
    scene: Scene | None = None,
    *,
    poses: npt.ArrayLike | None = None,
    edge: bool = False,
    parts: Parts | npt.ArrayLike | None = None,
) -> Frames:
    """Many frames at once, in memory.

    Parameters
    ----------
    tape, sensor, scene, parts
        As in `simulate`.
    count : int
        Number of frames.
    seed : int
        Of poses, noise and defects.
    poses : array_like, shape (count, 3), optional
        (x mm, y mm, theta deg) per frame; `draw_poses` when left out.
    edge : bool
        Draw poses whose contact hangs over the edge of the texture.

    Returns
    -------
    Frames

    Raises
    ------
    SpecError
        As `iterate_frames`.
    """
    frames = list(iterate_frames(tape, count, seed, sensor, scene, poses=poses, edge=edge, parts=parts))
    return Frames(
        depth=np.stack([f.depth for f in frames]),
        position_mm=np.stack([f.position_mm for f in frames]),
        theta_deg=np.array([f.theta_deg for f in frames]),
        contact_px=np.stack([f.contact_px for f in frames]),
        dots_px=tuple(f.dots_px for f in frames),
        dots_part=tuple(f.dots_part for f in frames),
        dots_imprint=tuple(f.dots_imprint for f in frames),
    )


def placed(
    view: View, parts: Parts, stream: np.random.SeedSequence
) -> tuple[IntArray, Parts, FloatArray, FloatArray, FloatArray, np.random.Generator]:
    """Parts in view as of `parts_in_view`, displaced by the gel, and bumps; and a generator of noise.

    Defects, noise and gel have separate random streams, so that none changes another.
    """
    of_parts, of_noise, of_gel = (
        np.random.Generator(np.random.PCG64(np.random.SeedSequence(stream.entropy, spawn_key=(*stream.spawn_key, i))))
        for i in (0, 1, 3)  # (0, 2) is that of poses
    )
    index, seen, at_mm = parts_in_view(view, parts, of_parts)
    if displacement_um(view) > 0.0:
        at_mm = at_mm + displacements(view, at_mm, of_gel)
    return index, seen, at_mm, *_draw_bumps(view, of_parts), of_noise


def _frame(view: View, parts: Parts, stream: np.random.SeedSequence) -> Frame:
    """One frame."""
    scene = view.scene
    index, seen, at_mm, bumps_mm, sizes, of_noise = placed(view, parts, stream)
    dots_px = view.to_px(at_mm)
    if scene.elastic is None:
        share, contact_px = imprint(scene, at_mm), view.to_px(np.asarray(scene.contact_offset_mm))
        depth = press(relief_of(view, seen, at_mm, bumps_mm, sizes), view.profile, scene, of_noise)
    else:
        pressed = imprint_of(view, seen, at_mm, bumps_mm, sizes)
        share, contact_px = pressed.touched(dots_px), pressed.contact_px
        depth = sensed(pressed.depth, view.profile, scene, of_noise)
    felt = (share > 0.0) & (np.abs(dots_px - view.profile.centre_px) <= view.profile.centre_px + 0.5).all(axis=1)
    return Frame(
        depth=depth,
        position_mm=view.position_mm,
        theta_deg=view.theta_deg,
        contact_px=contact_px,
        dots_px=dots_px[felt],
        dots_part=index[felt],
        dots_imprint=share[felt],
    )


def _stream(seed: int, number: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(checked_seed(seed), spawn_key=(number,))


def parts_in_view(view: View, parts: Parts, rng: np.random.Generator) -> tuple[IntArray, Parts, FloatArray]:
    """Parts within reach of the contact, with placement errors: their indices, places on the board, and in view (mm).

    The gel has not displaced them yet; those that it may bring into reach are among them.
    """
    scene, tape = view.scene, view.tape
    if scene.mirrored_tape:
        # about the board's middle; directions of parts are mirrored at the vertical
        mirrored = parts.xy_mm * (-1.0, 1.0) + (tape.board.size_mm[0], 0.0)
        parts = Parts(xy_mm=mirrored, rotation_deg=180.0 - parts.rotation_deg)
    reach_mm = float(np.hypot(*tape.part.body_mm[:2])) / 2
    # before anything is drawn of them: a tape has thousands of parts, and a contact shows some dozens
    near = np.flatnonzero(view.in_reach(parts, reach_mm + 4 * scene.placement_mm))
    standing, there = scattered(parts.taken(near), scene, rng)
    at_mm = view.from_board(standing.xy_mm)
    reach_mm += 4 * displacement_um(view) / 1000.0  # not before: other parts in reach would change all that is drawn of them
    felt = there & (inside_mm(scene, at_mm) > -scene.roll_off_mm / 2 - reach_mm)
    felt &= (np.abs(at_mm) <= view.half_field_mm + reach_mm).all(axis=1)
    return near[felt], standing.taken(felt), at_mm[felt]


def _draw_bumps(view: View, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Centres (k, 2) in view of spurious bumps inside the contact, mm, and their (diameter mm, relative height)."""
    count = view.scene.bumps
    if count == 0:
        return np.empty((0, 2)), np.empty((0, 2))
    inside = points_in_contact(view, count, rng)
    sizes = np.stack([rng.uniform(*BUMP_FOOT_MM, len(inside)), rng.uniform(*BUMP_HEIGHT, len(inside))], axis=-1)
    return inside, sizes


def points_in_contact(view: View, count: int, rng: np.random.Generator) -> FloatArray:
    """Points uniformly distributed over the visible contact; shape (count, 2) or fewer, mm from the image centre."""
    outline = contact_outline_mm(view.scene, view.half_field_mm)
    # 32 for each, as not all of the box is contact; there may be fewer
    candidates = rng.uniform(outline.min(axis=0), outline.max(axis=0), (32 * count, 2))
    seen = (np.abs(candidates) <= view.half_field_mm).all(axis=1) & (inside_mm(view.scene, candidates) > 0.0)
    return candidates[seen][:count]
