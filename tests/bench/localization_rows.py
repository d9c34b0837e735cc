"""Rows of the localization benchmark: the scene of each, what is registered, and the rate that is asked for."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from tactape_fab import Tape, TapeSpec, default_origin
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Frame, Scene, SensorProfile, draw_poses, iterate_frames, load_sensor
from tactape_fab.sense.geometry import Gel
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.frames import IntArray
from tactape_fab.texture.plane import encode

SECTOR = 7
SEED = int(os.environ.get("TACTAPE_BENCH_SEED", "2026"))
COUNT = int(os.environ.get("TACTAPE_BENCH_N", "1000"))
FELT = 0.3
"""Imprint from which a dot is found more often than not: those are really there."""
INSIDE = 0.5
"""Imprint on the contact's outline."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One row of the table.

    Attributes
    ----------
    scenes : tuple of Scene
        Taken in turn.
    target : float or None
        Share of the frames that must be located and right in both worlds; None: 0.9 of the information limit.
    tapes : int
        Registered tapes; the touched one is among them.
    max_p_tape : float or None
    prior : bool
        A prior of 2 mm and 10 degrees goes with every frame.
    edge : bool
        Contacts over the tape's edge with at least 20 dots, at least 4 in each of 4 columns and of 4 rows.
    paper_scale : float or None
        px/mm that the paper's method is told; None lets it estimate.
    fewer : int
        The row's frames are so many times fewer.
    """

    name: str
    scenes: tuple[Scene, ...] = (Scene(),)
    target: float | None = None
    tapes: int = 1
    max_p_tape: float | None = None
    prior: bool = False
    edge: bool = False
    paper_scale: float | None = 16.0
    fewer: int = 1
    seed: int = field(default=SEED)


def plane_gel() -> SensorProfile:
    """The stock sensor without its gel's crown: by one, contacts of the imprint model off the image's centre were tilted."""
    return replace(load_sensor("gelsight-mini"), gel=Gel())


def _contact(name: str, side_mm: float, **options: float) -> Row:
    return Row(name=name, scenes=(Scene(contact_mm=(side_mm, side_mm)),), **options)  # type: ignore[arg-type]


def _strip(width_mm: float, radius_mm: float) -> Scene:
    return Scene(contact="strip", strip_width_mm=width_mm, cylinder_radius_mm=radius_mm)


STRIPS = {width: _strip(width, radius) for width, radius in ((6.0, 15.7), (5.0, 10.0), (4.5, 8.4), (3.0, 3.8))}

ROWS = (
    Row(name="contact 11x9", target=0.999),
    Row(name="10 % parts missing", scenes=(Scene(missing=0.1),), target=0.999),
    Row(name="5 spurious bumps", scenes=(Scene(bumps=5),), target=0.999),
    Row(name="placement 0.05 mm", scenes=(Scene(placement_mm=0.05),), target=0.999),
    Row(name="noise x2", scenes=(Scene(noise=2.0),), target=0.995),
    Row(name="blur 0.25 mm", scenes=(Scene(elastomer_mm=0.25),), target=0.995),
    Row(name="scale off by 6 %", scenes=(Scene(scale_error=0.06), Scene(scale_error=-0.06)), target=0.995, paper_scale=None),
    Row(name="30 % parts missing", scenes=(Scene(missing=0.3),), target=0.98),
    _contact("8x8", 8.0, target=0.99),
    _contact("8x8, 256 tapes", 8.0, target=0.98, tapes=256, fewer=5),
    _contact("7x7", 7.0),
    _contact("6x6", 6.0),
    _contact("5x5", 5.0),
    _contact("7x7, prior", 7.0, prior=True),
    _contact("6x6, prior", 6.0, prior=True),
    _contact("5x5, prior", 5.0, prior=True),
    _contact("7x7, max-p-tape 1e-2", 7.0, max_p_tape=1e-2),
    _contact("6x6, max-p-tape 1e-2", 6.0, max_p_tape=1e-2),
    _contact("5x5, max-p-tape 1e-2", 5.0, max_p_tape=1e-2),
    Row(name="strip 6 mm", scenes=(STRIPS[6.0],)),
    Row(name="strip 5 mm", scenes=(STRIPS[5.0],)),
    Row(name="strip 4.5 mm", scenes=(STRIPS[4.5],)),
    Row(name="over the edge", edge=True),
)


CODE_ROWS = (
    Row(name="code alone, 11x9", target=0.985),
    Row(name="code alone, 14x12", scenes=(Scene(contact_mm=(14.0, 12.0)),), target=0.995),
)
"""Rows where no tape is registered; the targets are what hard decoding of the same contacts reaches."""


@cache
def registered_tape() -> Tape:
    """The tape of the main job, 100 x 50 mm, sector 7."""
    return examine(TapeSpec(sector=SECTOR)).layout.tape


@cache
def tape_of(sector: int, origin: tuple[int, int] | None = None) -> Tape:
    """The same tape as another sector has it, at its default origin unless said."""
    like = registered_tape()
    place = default_origin(like.code, sector) if origin is None else origin
    symbols = encode(get_plane(like.code), sector, place, (like.rows, like.columns))
    return replace(like, name=f"tactape-s{sector:03d}", sector=sector, origin=place, symbols=symbols, tag=None)


def tapes_of(row: Row) -> list[Tape]:
    """The registry of a row."""
    others = [tape_of(s) for s in range(256) if s != SECTOR]
    return [registered_tape(), *others[: row.tapes - 1]]


def frames_of(row: Row, count: int) -> Iterator[Frame]:
    """The frames of a row; the same ones for every method and world."""
    tape = registered_tape()
    if row.edge:
        yield from _edge_frames(row, count)
        return
    streams = [
        iterate_frames(tape, -(-count // len(row.scenes)), row.seed + k, scene=scene) for k, scene in enumerate(row.scenes)
    ]
    for k in range(count):
        yield next(streams[k % len(streams)])


def _edge_frames(row: Row, count: int) -> Iterator[Frame]:
    tape, scene = registered_tape(), row.scenes[0]
    poses = draw_poses(tape, 50 * count, row.seed, scene=scene, edge=True)
    drawn = 0
    for frame in iterate_frames(tape, len(poses), row.seed, scene=scene, poses=poses):
        cells = tape.cells()[frame.dots_part[frame.dots_imprint >= INSIDE]]
        if drawn < count and len(cells) >= 20 and min(lines_of_four(cells)) >= 4 and hangs_over(frame, tape, scene):
            drawn += 1
            yield frame
        elif drawn == count:
            return


def lines_of_four(cells: IntArray) -> tuple[int, int]:
    """How many columns, and how many rows, hold at least 4 of some grid points (n, 2)."""
    columns, rows = ((np.unique(cells[:, axis], return_counts=True)[1] >= 4).sum() for axis in (0, 1))
    return int(columns), int(rows)


def hangs_over(frame: Frame, tape: Tape, scene: Scene) -> bool:
    """Whether an elliptic contact reaches beyond the grid's outermost lines."""
    turn = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    rim = np.stack([np.cos(turn), np.sin(turn)], axis=-1) * np.asarray(scene.contact_mm) / 2
    c, s = np.cos(np.radians(frame.theta_deg)), np.sin(np.radians(frame.theta_deg))
    on_tape = frame.position_mm + rim @ np.array([[c, -s], [s, c]])
    high = np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm
    return bool(((on_tape < 0) | (on_tape > high)).any())
