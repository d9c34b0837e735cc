"""The tapes of the benchmark, and the scenes of both simulators."""

from __future__ import annotations

from collections.abc import Mapping
from math import radians, tan

import numpy as np

from tactape_fab.sense.simulation.elastic_contact import ElasticContact
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.texture.board import Board
from tactape_fab.texture.code import default_origin, get_plane
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.plane import encode
from tactape_fab.texture.tape import Tape

REGISTERED, FOREIGN = (7, 24, 100, 201), 150
"""Sectors whose tapes are handed out with the frames, and the one whose tape is touched and not named."""
CODE, GRID, PITCH_MM, DISPLACEMENT_MM = "microdots-4x4", (62, 32), 1.5, 0.25
"""Texture of the default kit of 100 x 50 mm."""
FOREIGN_NAMES = ("imprint, tape that is not named", "elastic, tape that is not named")
BARE_NAMES = ("imprint, film without parts", "elastic, film without parts")


def _pressed(force_n: float = 2.0, missing: float = 0.0, **options: float | bool | tuple[float, float]) -> Scene:
    return Scene(elastic=ElasticContact(force_n=force_n, **options), missing=missing)  # type: ignore[arg-type]


CONDITIONS: Mapping[str, Scene] = {
    "imprint, 11x9 mm": Scene(),
    "imprint, 7x7 mm": Scene(contact_mm=(7.0, 7.0)),
    "imprint, strip of 6 mm": Scene(contact="strip", strip_width_mm=6.0, cylinder_radius_mm=15.7),
    "imprint, noise x2": Scene(noise=2.0),
    "imprint, placement 0.05 mm": Scene(placement_mm=0.05),
    "imprint, 20 % missing, 5 bumps": Scene(missing=0.2, bumps=5),
    "imprint, gel displaced 0.05 mm": Scene(gel_displacement_um=50.0),
    "imprint, off-centre, scale 1 %, aspect 3 %": Scene(contact_offset_mm=(3.0, 2.0), scale_error=0.01, aspect_error=0.03),
    "imprint, slope 5°": Scene(tilt_mm_per_mm=(tan(radians(5.0)), 0.0)),
    FOREIGN_NAMES[0]: Scene(),
    BARE_NAMES[0]: Scene(missing=1.0),
    "elastic, 0.5 N": _pressed(0.5),
    "elastic, 2 N": _pressed(),
    "elastic, 10 N": _pressed(10.0),
    "elastic, tilt 5°": _pressed(tilt_deg=(5.0, 0.0)),
    "elastic, cylinder of 15.7 mm": _pressed(cylinder_radius_mm=15.7),
    "elastic, printed markers": _pressed(markers=True),
    "elastic, placement 0.05 mm": Scene(elastic=ElasticContact(), placement_mm=0.05),
    FOREIGN_NAMES[1]: _pressed(),
    BARE_NAMES[1]: _pressed(missing=1.0),
}
"""Scenes by name, in the order of the table; the simulator comes first in each."""


def tape_of(sector: int) -> Tape:
    """A tape as `tactape-fab make --sector N` has it, without its tag strip."""
    origin, (columns, rows) = default_origin(CODE, sector), GRID
    size_mm = (PITCH_MM * (columns - 1) + 6.0, PITCH_MM * (rows - 1) + 3.5)
    return Tape(
        name=f"tactape-s{sector:03d}",
        sector=sector,
        code=CODE,
        origin=origin,
        columns=columns,
        rows=rows,
        pitch_mm=PITCH_MM,
        displacement_mm=DISPLACEMENT_MM,
        symbols=encode(get_plane(CODE), sector, origin, (rows, columns)),
        omitted=np.zeros((0, 2), dtype=np.int64),
        board=Board(size_mm=size_mm, texture_origin_mm=(3.0, size_mm[1] - 1.75), corner_radius_mm=1.0, thickness_mm=0.11),
        part=TapePart(name="r0201", shape="block", body_mm=(0.6, 0.3, 0.23), rotation_deg=45.0),
        tag=None,
    )
