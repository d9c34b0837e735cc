"""Layout of a texture on a surface: places of all elements, measurement of the distortion, and refusal if it is too large."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, refuse
from tactape_fab.solids.elements import element_volume_mm3, foot_area_mm2, reach_mm
from tactape_fab.solids.surface.charts import Chart, Frames
from tactape_fab.solids.surface.patch import (
    SINK_MM,
    beyond_edge,
    collisions,
    fitted_radius_mm,
    folds,
    gaps_mm,
    pitch_errors,
    probed_radius_mm,
    too_curved,
    too_distorted,
)
from tactape_fab.texture.frames import FloatArray, texture_to_board
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.shapes import rotate
from tactape_fab.texture.tape import Tape

MOST_ELEMENTS = 50_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Distortion:
    """Distortion of a texture on its surface.

    pitch_error_min, pitch_error_median, pitch_error_max: Relative error of the distance of neighbouring grid points along the
        surface.
    closest_gap_mm: Least distance of two elements; None if none are near each other.
    reach_mm: Distance of the farthest grid point from the middle, on the flat board.
    usable_radius_mm: Largest radius about the middle without edge, collision or fold, and with a pitch error of at most
        `MOST_PITCH_ERROR`; searched up to four times the reach.
    deepest_sink_mm: Depth of the deepest foot below its tangent plane.
    """

    pitch_error_min: float
    pitch_error_median: float
    pitch_error_max: float
    closest_gap_mm: float | None
    reach_mm: float
    usable_radius_mm: float
    deepest_sink_mm: float

    def to_mapping(self) -> dict[str, float | None]:
        """The figures as the manifest records them, to 6 decimals."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: None if value is None else round(float(value), 6) for name, value in values.items()}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaidOut:
    """A texture laid out on a surface.

    centre: Frame at the middle of the grid.
    elements: Frame at the middle of every element's foot, designator order.
    grid: Frame at the grid point of every element.
    sink_mm (n,): Depth of each element's solid below its tangent plane.
    volume_mm3, volume_error_mm3 (n,): Expected volume of each element above the surface, and its largest error.
    radius_mm: Radius if the patch is a sphere or cylinder within 1 %: positive if convex, negative if concave; else None.
    """

    tape: Tape
    centre: Frames
    elements: Frames
    grid: Frames
    sink_mm: FloatArray
    volume_mm3: FloatArray
    volume_error_mm3: FloatArray
    distortion: Distortion
    radius_mm: float | None


def texture_size_mm(tape: Tape) -> tuple[float, float]:
    """Width and height of the grid."""
    return (tape.columns - 1) * tape.pitch_mm, (tape.rows - 1) * tape.pitch_mm


def refuse_tape(tape: Tape) -> None:
    """Raise SpecError for a tape with too many elements, or with elements larger than their cell."""
    problems = []
    if tape.part_count > MOST_ELEMENTS:
        message = f"the kit has {tape.part_count} elements, more than {MOST_ELEMENTS}; use a smaller --size"
        problems.append(Problem("columns", message))
    if tape.part_count == 0:
        problems.append(Problem("omitted", "the kit has no elements: every grid point is omitted; give another kit"))
    reach = max(reach_mm(tape.part)) + tape.displacement_mm
    if reach >= tape.pitch_mm / 2:
        problems.append(
            Problem(
                "part",
                f"an element of part '{tape.part.name}' reaches {reach:.3f} mm from its grid point, displaced, and its cell "
                f"only {tape.pitch_mm / 2:.3f} mm; make the kit with a larger --w, a smaller --delta or a smaller part",
            )
        )
    refuse(problems)


def lay_out(tape: Tape, chart: Chart) -> LaidOut:
    """Lay out a tape's texture on a surface, with the middle of its grid at the chart's centre.

    Raises SpecError if the texture extends beyond the surface or folds, or elements collide or miss it: every problem with its
        distance from the middle, and the largest usable radius.
    """
    # middle of the grid, not of the board, as margins and strip are not used on the user's own part
    middle = (np.array([tape.columns, tape.rows]) - 1) / 2 * tape.pitch_mm
    middle_mm = texture_to_board(middle, tape.board.texture_origin_mm)
    offset_mm = tape.part_xy_mm() - middle_mm
    row, column = (a.ravel() for a in np.indices((tape.rows, tape.columns)))
    points_mm = np.stack([column, row], axis=1) * tape.pitch_mm
    point_offset_mm = texture_to_board(points_mm, tape.board.texture_origin_mm) - middle_mm
    elements, grid = chart.frames(offset_mm), chart.frames(point_offset_mm)
    outline_mm = foot_outline_mm(tape.part)
    height_mm, on_surface = chart.feet(elements, outline_mm)
    errors, pitch_radius = pitch_errors(tape, grid, point_offset_mm)
    gap_mm, pairs = gaps_mm(tape, elements)
    found = [
        beyond_edge(offset_mm, elements, on_surface),
        too_distorted(errors, pitch_radius),
        folds(tape, grid, point_offset_mm),
        collisions(offset_mm, gap_mm, pairs),
        too_curved(tape.part, offset_mm, height_mm, on_surface),
    ]
    reach = float(np.hypot(*point_offset_mm.T).max())
    usable = min([probed_radius_mm(tape, chart, reach), *(radius for radius, _ in found)])
    problems = [message for _, message in found if message]
    if problems:
        problems[-1] += (
            f"; the largest usable radius here is {usable:.1f} mm, the texture reaches {reach:.1f} mm; "
            f"use {smaller_kit(tape, reach, usable)}, or another place"
        )
        raise SpecError([Problem("surface", message) for message in problems])
    volume, volume_error = _volumes_mm3(tape.part, height_mm)
    # below the lowest point of the surface along the outline; a concave surface has none below the tangent plane
    sink_mm = np.maximum(-height_mm.min(axis=1), 0.0) + SINK_MM
    placed = np.flatnonzero(tape.placed.ravel())
    return LaidOut(
        tape=tape,
        centre=chart.centre,
        elements=elements,
        grid=grid[placed],
        sink_mm=sink_mm,
        volume_mm3=volume,
        volume_error_mm3=volume_error,
        radius_mm=fitted_radius_mm(grid),
        distortion=Distortion(
            pitch_error_min=float(errors.min()),
            pitch_error_median=float(np.median(errors)),
            pitch_error_max=float(errors.max()),
            closest_gap_mm=float(gap_mm.min()) if len(gap_mm) else None,
            reach_mm=reach,
            usable_radius_mm=usable,
            deepest_sink_mm=float(sink_mm.max()),
        ),
    )


def smaller_kit(tape: Tape, reach_mm: float, usable_mm: float) -> str:
    """Remedy for a texture that is too large: a kit with a proportionally smaller outline, if a window fits."""
    sides_mm = np.floor(usable_mm / reach_mm * np.array(tape.board.size_mm))
    if sides_mm.min() < 6 * tape.pitch_mm:
        return "a kit of a smaller --size"
    return f"a kit of --size {sides_mm[0]:g}x{sides_mm[1]:g}"


def foot_outline_mm(part: TapePart) -> FloatArray:
    """Points of a foot's outline: middles of the sides and corners of a rectangle, or points of a circle; shape (8, 2)."""
    if part.shape == "dome":
        angle = np.arange(8) * (np.pi / 4)
        return part.body_mm[0] / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    half = np.array(part.body_mm[:2]) / 2
    signs = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)], dtype=np.float64)
    return rotate(half * signs, part.rotation_deg)


def _volumes_mm3(part: TapePart, height_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Volume of each element above the surface, taken as a quadric below its foot, and the largest error of that."""
    # mean of z = (k1 u^2 + k2 v^2) / 2 + k12 uv: over a disc half its mean on the rim; over a rectangle of half sides a, b
    # (k1 a^2 + k2 b^2) / 6, a sixth of the sum over the middles of its sides, the first four points; uv has the mean 0
    mean_mm = height_mm.mean(axis=1) / 2 if part.shape == "dome" else height_mm[:, :4].sum(axis=1) / 6
    area, volume = foot_area_mm2(part), element_volume_mm3(part)
    # a surface below the tangent plane makes an element larger; the error allows for surfaces that are not quadrics
    return volume - area * mean_mm, 0.02 * volume + 0.5 * area * np.ptp(height_mm, axis=1)


def record(laid: LaidOut) -> dict[str, Any]:
    """The manifest's record of the place: centre, axes, radius, distortion."""
    centre = laid.centre
    return {
        "centre_mm": [round(float(v), 6) + 0.0 for v in centre.points_mm[0]],
        "up": [round(float(v), 9) + 0.0 for v in centre.y_axis[0]],
        "normal": [round(float(v), 9) + 0.0 for v in centre.normal[0]],
        "radius_mm": None if laid.radius_mm is None else round(laid.radius_mm, 6),
        "distortion": laid.distortion.to_mapping(),
    }
