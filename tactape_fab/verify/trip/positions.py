"""Positions of a kit's parts, from each file that contains them: CPL, copper, STL."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tactape_fab.sense.simulation.parts import Parts
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.stl import patches
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.wrap import unwrapped
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.layers.lands import LandPairs, pair_lands
from tactape_fab.verify.models.raised import bounds_of_groups, is_raised


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Source:
    """Parts in one file of a kit: the file's name for the user; centres (mm) and rotations (deg) in the board frame."""

    name: str
    parts: Parts


def cpl_source(cpl: CplContent) -> Source:
    """Parts at their CPL places."""
    return Source(name="CPL", parts=Parts(xy_mm=cpl.xy_mm.copy(), rotation_deg=cpl.rotation_deg.copy()))


def copper_source(flash_xy_mm: FloatArray, offset_mm: float, rotation_deg: float, pairs: LandPairs | None = None) -> Source:
    """Parts at the middles of the pairs of pads in a copper layer.

    flash_xy_mm (m, 2)
    offset_mm, rotation_deg: Half the distance of the lands of a pair, and its direction, which is also tried mirrored and turned
        by 90 degrees.
    pairs: Pairs in that direction, if known.
    """
    tried = [pair_lands(flash_xy_mm, offset_mm, rotation_deg) if pairs is None else pairs]
    # also finds the parts of a mirrored or turned copper layer, so that the round trip can say what is wrong
    for turn_deg in dict.fromkeys((180.0 - rotation_deg, rotation_deg + 90.0)):
        if not len(tried[-1].alone):
            break
        tried.append(pair_lands(flash_xy_mm, offset_mm, turn_deg))
    best = max(tried, key=lambda found: len(found.centre_mm))
    rotation = np.degrees(np.arctan2(best.axis_mm[:, 1], best.axis_mm[:, 0]))
    return Source(name="copper", parts=Parts(xy_mm=best.centre_mm.copy(), rotation_deg=rotation))


def stl_source(tape: Tape, form: SolidForm, mesh: Mesh) -> Source:
    """Elements of a solid: each connected part of its mesh that is well above the base."""
    points = unwrapped(mesh.vertices_mm, tape, form)
    # triangles with all corners raised: a top is connected, and no wall joins two tops
    faces = mesh.faces[is_raised(tape, form, points)[mesh.faces].all(axis=1)]
    patch = patches(faces, len(points))
    used = np.unique(faces)
    _, number = np.unique(patch[used], return_inverse=True)
    count = int(number.max(initial=-1)) + 1
    low, most = bounds_of_groups(count, number, points[used, :2])
    # the middle of the bounds, as vertices are denser where cuts of a cylinder cross
    return Source(name="STL", parts=Parts(xy_mm=(low + most) / 2, rotation_deg=np.full(count, tape.part.rotation_deg)))
