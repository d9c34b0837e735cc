"""Tapes of solid elements without a spec, and every kind of form, for the tests of the solid models."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timezone
from typing import Any

import numpy as np

from tactape_fab.solids.elements import reach_mm
from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.step.solid import solid_step
from tactape_fab.texture.board import Board
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.plane import encode
from tactape_fab.texture.tape import Tape

DATE = datetime(2026, 1, 1, tzinfo=timezone.utc)
BLOCK = TapePart(name="block", shape="block", body_mm=(0.6, 0.3, 0.23), rotation_deg=45.0)
DOME = TapePart(name="dome", shape="dome", body_mm=(0.6, 0.6, 0.23), rotation_deg=0.0)
CONE = replace(DOME, name="cone", top_mm=0.3)
PARTS = {"block": BLOCK, "dome": DOME, "cone": CONE}
FORMS = {
    "flat": SolidForm(),
    "single": SolidForm(top="single"),
    "negative": SolidForm(negative=True),
    "R16": SolidForm(cylinder=Cylinder(radius_mm=16.0)),
    "R25 round y": SolidForm(cylinder=Cylinder(radius_mm=25.0, around="y")),
    "R50 single": SolidForm(top="single", cylinder=Cylinder(radius_mm=50.0)),
    "R6 whole": SolidForm(cylinder=Cylinder(radius_mm=6.0, shell="whole")),
    "R6 negative": SolidForm(negative=True, cylinder=Cylinder(radius_mm=6.0)),
    "R6 whole negative round y": SolidForm(negative=True, cylinder=Cylinder(radius_mm=6.0, around="y", shell="whole")),
}


def tape_of(part: TapePart = BLOCK, columns: int = 7, rows: int = 5, **values: Any) -> Tape:
    """A tape with a margin of 1.1 mm round its elements.

    Parameters
    ----------
    values
        pitch_mm, displacement_mm, margin_mm, radius_mm (of the corners), holes_mm (from the board's lower left corner),
        omitted (further cells), sector.
    """
    pitch_mm = values.get("pitch_mm", 1.5)
    displacement_mm = values.get("displacement_mm", pitch_mm / 6)
    radius_mm, holes = values.get("radius_mm", 1.0), tuple(values.get("holes_mm", ()))
    sector = values.get("sector", 7)
    reach_x, reach_y = (reach + displacement_mm + values.get("margin_mm", 1.1) for reach in reach_mm(part))
    x0, y0 = float(np.round(reach_x, 6)), float(np.round(reach_y, 6))
    size_mm = (2 * x0 + (columns - 1) * pitch_mm, 2 * y0 + (rows - 1) * pitch_mm)
    size_mm = (round(size_mm[0], 6), round(size_mm[1], 6))
    origin_mm = (x0, round(size_mm[1] - y0, 6))
    code = get_plane("microdots-4x4")
    tape = Tape(
        name="t",
        sector=sector,
        code=code.name,
        origin=(0, 0),
        columns=columns,
        rows=rows,
        pitch_mm=pitch_mm,
        displacement_mm=displacement_mm,
        symbols=encode(code, sector, (0, 0), (rows, columns)),
        omitted=np.empty((0, 2), dtype=np.int64),
        board=Board(size_mm=size_mm, texture_origin_mm=origin_mm, corner_radius_mm=radius_mm, thickness_mm=0.11, holes=holes),
        part=part,
        tag=None,
    )
    return replace(tape, omitted=_omitted(tape, list(values.get("omitted", ()))))


def _omitted(tape: Tape, cells: list[tuple[int, int]]) -> Any:
    """Cells that are asked for, and those whose element comes near a hole or leaves a rounded corner."""
    reach = float(np.hypot(*reach_mm(tape.part)))
    (width, height), r = tape.board.size_mm, tape.board.corner_radius_mm
    x, y = tape.part_xy_mm().T
    cx, cy = (np.maximum(np.maximum(r - at, at - side + r), 0.0) for at, side in ((x, width), (y, height)))
    left_out = (cx > 0) & (cy > 0) & (np.hypot(cx, cy) > r - reach - 0.1)
    for hx, hy, d in tape.board.holes:
        left_out |= np.hypot(x - hx, y - hy) < d / 2 + reach + 0.1
    cells += [(column, row) for column, row in tape.cells()[left_out].tolist()]
    return np.array(sorted(set(cells), key=lambda cell: cell[::-1]), dtype=np.int64).reshape(-1, 2)


def step_of(tape: Tape, form: SolidForm) -> bytes:
    return solid_step(tape, form, name=tape.name, date=DATE, rgb=(0.5, 0.5, 0.5))


def element_volume_mm3(part: TapePart, radius_mm: float | None, turn_deg: float) -> float:
    """Volume between an element and the surface under it, by sums over thin columns.

    Parameters
    ----------
    radius_mm
        Of the cylinder; None for a plane.
    turn_deg
        Of a block from the direction that runs round the cylinder.
    """
    length, width, height = part.body_mm

    def fall(t: Any) -> Any:
        return 0.0 if radius_mm is None else radius_mm - np.sqrt(radius_mm**2 - t**2)

    if part.shape == "block":
        u = (np.arange(600) + 0.5) / 600 - 0.5
        x, y = np.meshgrid(u * length, u * width)
        c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
        return float(np.mean(height + fall(c * x - s * y)) * length * width)
    foot = length / 2
    angle = (np.arange(90) + 0.5) * (np.pi / 180)  # one quarter
    top_mm = part.top_mm
    if top_mm is None:
        sphere = (foot**2 + height**2) / (2 * height)

        def rise(r: Any) -> Any:
            return height - sphere + np.sqrt(np.maximum(sphere**2 - r**2, 0.0))
    else:

        def rise(r: Any) -> Any:
            return np.minimum(height, height * (foot - r) / (foot - top_mm / 2))

    low, high = np.full(90, foot), np.full(90, foot * 1.3 if top_mm is not None else min(foot * 1.3, sphere))
    for _ in range(50):
        middle = (low + high) / 2
        over = rise(middle) + fall(middle * np.cos(angle)) > 0
        low, high = np.where(over, middle, low), np.where(over, high, middle)
    share = (np.arange(4000) + 0.5) / 4000
    r = share[:, None] * low
    return float(((rise(r) + fall(r * np.cos(angle))) * r).mean(axis=0) @ low * 2 * np.pi / 90)


def volume_mm3(tape: Tape, form: SolidForm) -> float:
    """Volume of a tape's solid by formulas of our own."""
    (w, h), r = tape.board.size_mm, tape.board.corner_radius_mm
    cylinder, height = form.cylinder, tape.part.body_mm[2]
    thickness = height + form.base_mm if form.negative else form.base_mm
    sign = -1.0 if form.negative else 1.0
    if cylinder is None:
        area = (w - 2 * r) * h + 2 * r * (h - 2 * r) + np.pi * r * r
        area -= sum(np.pi * (d / 2) ** 2 for _, _, d in tape.board.holes)
        return float(area * thickness + sign * tape.part_count * element_volume_mm3(tape.part, None, 0.0))
    around, along = (w, h) if cylinder.around == "x" else (h, w)
    if cylinder.shell == "whole":
        around = 2 * np.pi * cylinder.radius_mm
    # a ring's area is its middle circle's length times its thickness
    middle = cylinder.radius_mm - sign * thickness / 2
    turn = tape.part.rotation_deg - (0.0 if cylinder.around == "x" else 90.0)
    elements = tape.part_count * element_volume_mm3(tape.part, cylinder.radius_mm, turn)
    return float(around / cylinder.radius_mm * middle * thickness * along + sign * elements)


def element_height_mm(part: TapePart) -> float:
    """Height of an element's centre of mass over a plane."""
    length, _, height = part.body_mm
    if part.shape == "block":
        return height / 2
    z = (np.arange(200_000) + 0.5) / 200_000 * height
    if part.top_mm is None:
        sphere = ((length / 2) ** 2 + height**2) / (2 * height)
        area = sphere**2 - (z - height + sphere) ** 2
    else:
        area = (length / 2 + (part.top_mm - length) / 2 * z / height) ** 2
    return float(area @ z / area.sum())


def centre_mm(tape: Tape, form: SolidForm) -> Any:
    """Centre of mass of a flat solid, in the file's frame; None for a wrapped one."""
    if form.cylinder is not None:
        return None
    (w, h), r = tape.board.size_mm, tape.board.corner_radius_mm
    height = tape.part.body_mm[2]
    low, high = (0.0, height + form.base_mm) if form.negative else (-form.base_mm, 0.0)
    middle = (low + high) / 2
    pieces = [(w * h - (4 - np.pi) * r * r, (w / 2, h / 2, middle))]
    pieces += [(-np.pi / 4 * d * d, (x, y, middle)) for x, y, d in tape.board.holes]
    rows = [(area * (high - low), place) for area, place in pieces]
    element = element_volume_mm3(tape.part, None, 0.0) * (-1.0 if form.negative else 1.0)
    rows += [(element, (x, y, element_height_mm(tape.part))) for x, y in tape.part_xy_mm().tolist()]
    volume = np.array([row[0] for row in rows])
    centre = volume @ np.array([row[1] for row in rows]) / volume.sum()
    return centre * ((-1.0, 1.0, -1.0) if form.negative else (1.0, 1.0, 1.0))
