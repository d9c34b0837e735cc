"""Expected properties of a kit's models, computed from the manifest: volumes, faces, centres of mass, tolerances."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import pi

import numpy as np

from tactape_fab.solids.elements import element_volume_mm3
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.volume import solid_volume_mm3
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.models.meshes import mesh_volume_tolerance_mm3
from tactape_fab.verify.models.step_text import StepText, written_steps

VOLUME_TOLERANCE = 1e-7
"""Relative tolerance of a STEP solid's volume against the formulas."""
COARSE_VOLUME_TOLERANCE = 1e-6
"""The same for spheres bounded by splines, which readers integrate at fixed Gauss points."""
LOOSE_VOLUME_TOLERANCE = 1e-5
"""The same for blocks on a cylinder if a reader approximates ellipses to the file's precision of 1e-6 mm: 1e-6 at 150 x 80 mm."""
EMBOSSED_VOLUME_TOLERANCE = 1e-3
"""Relative tolerance of an embossed STEP solid's volume against its mesh, which approximates curves by chords."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expected:
    """Properties that every reader must find.

    tolerance: Relative tolerance of a STEP solid's volume.
    loose_tolerance: The same for readers that use the file's precision.
    faces: Number of faces in the text of the STEP solid; 0 without one.
    centre_mm (3,): Centre of mass of the STEP solid, mm, if a short formula gives it.
    steps: The STEP files that this version writes, by role; empty for the user's own part.
    """

    volume_mm3: float
    tolerance: float
    loose_tolerance: float
    mesh_tolerance_mm3: float
    faces: int
    bodies: int
    centre_mm: FloatArray | None
    steps: Mapping[str, StepText]


def faces_of(files: Mapping[str, WrittenFile]) -> int:
    """Number of faces in the text of the STEP solid."""
    return len(re.findall(rb"=\s*ADVANCED_FACE\s*\(", files["step-solid"].data)) if "step-solid" in files else 0


def expected_of_kit(tape: Tape, form: SolidForm, files: Mapping[str, WrittenFile]) -> Expected:
    """Expected properties of the models of a tape."""
    splines = tape.part.shape == "dome" and form.cylinder is not None
    tolerance = COARSE_VOLUME_TOLERANCE if splines else VOLUME_TOLERANCE
    return Expected(
        volume_mm3=solid_volume_mm3(tape, form),
        tolerance=tolerance,
        loose_tolerance=tolerance if form.cylinder is None else LOOSE_VOLUME_TOLERANCE,
        mesh_tolerance_mm3=mesh_volume_tolerance_mm3(tape, form),
        faces=faces_of(files),
        bodies=1,
        centre_mm=solid_centre_mm(tape, form),
        steps=written_steps(tape, form, files),
    )


def expected_of_embossed(volume_mm3: float, bodies: int, files: Mapping[str, WrittenFile]) -> Expected:
    """Expected properties of the models of an embossed part, from its mesh as the manifest records it."""
    return Expected(
        volume_mm3=volume_mm3,
        tolerance=EMBOSSED_VOLUME_TOLERANCE,
        loose_tolerance=EMBOSSED_VOLUME_TOLERANCE,
        # the manifest's volume is that of this mesh, but readers may sum it in single precision
        mesh_tolerance_mm3=1e-4 * volume_mm3,
        faces=faces_of(files),
        bodies=bodies,
        centre_mm=None,
        steps={},
    )


def film_centre_mm(tape: Tape) -> tuple[float, float, float]:
    """Centre of mass of the bare board with its holes (the outline is symmetrical), mm."""
    (w, h), r = tape.board.size_mm, tape.board.corner_radius_mm
    whole = w * h - (4 - pi) * r**2
    holes = np.array(tape.board.holes).reshape(-1, 3)
    areas = pi / 4 * holes[:, 2] ** 2
    # first moments: that of the symmetric outline about its middle, less that of each hole
    middle = (whole * np.array([w, h]) / 2 - areas @ holes[:, :2]) / (whole - areas.sum())
    return float(middle[0]), float(middle[1]), -tape.board.thickness_mm / 2


def solid_centre_mm(tape: Tape, form: SolidForm) -> FloatArray | None:
    """Centre of mass of a flat solid of blocks without a mark, mm; None if no short formula gives it."""
    if form.cylinder is not None or tape.part.shape != "block":
        return None
    if form.mark:
        return None
    x, y, _ = film_centre_mm(tape)
    element, height = element_volume_mm3(tape.part), tape.part.body_mm[2]
    parts = tape.part_count * element
    middle = np.array([*tape.part_xy_mm().mean(axis=0), height / 2])
    if form.negative:
        # a slab as high as cavities and base together, less the cavities, which in this frame extend from z = 0 to the height
        base = solid_volume_mm3(tape, form) + parts
        centre = (base * np.array([x, y, (height + form.base_mm) / 2]) - parts * middle) / (base - parts)
        # half a turn about board y, as the file has it
        return centre * (-1.0, 1.0, -1.0)
    base = solid_volume_mm3(tape, form) - parts
    return (base * np.array([x, y, -form.base_mm / 2]) + parts * middle) / (base + parts)
