"""Part profiles: parts with lands, and solid elements for printing and milling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, pi

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import Fields, shown
from tactape_fab.base.templates import profile_names, profile_table, read_once, refuse_problems
from tactape_fab.kit.profiles.assembly import read_part_numbers
from tactape_fab.kit.profiles.chips import chip_code_problem
from tactape_fab.texture.part import PART_SHAPES

LEAST_BODY_MM, LARGEST_BODY_MM = 0.01, 20.0
_LAND_KEYS = ("size_mm", "corner_radius_mm", "offset_mm")


@dataclass(frozen=True, slots=True, kw_only=True)
class LandPattern:
    """A pair of rounded rectangles at (-offset, 0) and (+offset, 0) of the unturned part."""

    size_mm: tuple[float, float]
    corner_radius_mm: float
    offset_mm: float

    @property
    def area_mm2(self) -> float:
        """Exact area of one of the two lands, mm^2."""
        # a rounded rectangle is smaller than its box by four squares of r^2 less a circle: (4 - pi) r^2
        return self.size_mm[0] * self.size_mm[1] - (4 - pi) * self.corner_radius_mm**2


@dataclass(frozen=True, slots=True, kw_only=True)
class PartProfile:
    """A part with lands, to be placed at the grid points; unrotated, with its long axis along x.

    ``part_numbers`` holds a number for each assembly format that has one.
    """

    name: str
    shape: str
    value: str
    description: str
    footprint: str
    body_mm: tuple[float, float, float]
    body_tolerance_mm: float
    pads: LandPattern
    paste: LandPattern
    courtyard_mm: tuple[float, float]
    part_numbers: Mapping[str, str] = field(default_factory=dict)

    @property
    def lands_mm(self) -> tuple[float, float]:
        """Length and width of both lands together, mm."""
        return 2 * self.pads.offset_mm + self.pads.size_mm[0], self.pads.size_mm[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class ElementProfile:
    """A solid element for printing and milling, without lands; unrotated.

    ``body_mm`` is (length, width, height) of a ``block``, (diameter, diameter, height) of a ``dome``, which is a
    spherical cap, or a truncated cone whose flat top has the diameter ``top_mm``.
    """

    name: str
    shape: str
    description: str
    body_mm: tuple[float, float, float]
    body_tolerance_mm: float
    top_mm: float | None = None


@read_once("parts")
def read_part(name: str) -> PartProfile | ElementProfile:
    """A part profile by name, or by the path of a TOML file; one without ``[pads]`` is a solid element.

    Raises SpecError: every problem found in it.
    """
    table = profile_table("parts", "part", name)
    profile = _part_with_lands(table) if {"pads", "paste", "courtyard"} & table.values.keys() else _element(table)
    refuse_problems(table)
    return profile


def solid_elements() -> list[str]:
    """Names of the solid elements that come with the package."""
    return [name for name in profile_names("parts") if isinstance(read_part(name), ElementProfile)]


def load_part(name: str) -> PartProfile:
    """A part profile with lands; see `read_part`. Raises SpecError: every problem found in it, or that it is a solid element."""
    part = read_part(name)
    if isinstance(part, ElementProfile):
        raise SpecError(Problem("part", f"part = {shown(name)} is a solid element without lands; give a part with [pads]"))
    return part


def _part_with_lands(table: Fields) -> PartProfile:
    table.refuse_unknown(
        ("name", "shape", "value", "description", "footprint", "body", "pads", "paste", "courtyard", "part_numbers")
    )
    body = table.table("body", ("size_mm", "tolerance_mm"))
    length, width, height = body.numbers("size_mm", 3, low=LEAST_BODY_MM, high=LARGEST_BODY_MM)
    courtyard = table.table("courtyard", ("size_mm",)).numbers("size_mm", 2, low=LEAST_BODY_MM, high=40.0)
    profile = PartProfile(
        name=_part_name(table),
        shape=table.text("shape", choices=("block",), remedy="a part with lands is a block"),
        value=_attribute_text(table, "value"),
        description=_attribute_text(table, "description"),
        footprint=_attribute_text(table, "footprint"),
        body_mm=(length, width, height),
        body_tolerance_mm=body.number("tolerance_mm", low=0.0, high=1.0),
        pads=read_land(table.table("pads", _LAND_KEYS)),
        paste=read_land(table.table("paste", _LAND_KEYS)),
        courtyard_mm=(courtyard[0], courtyard[1]),
        part_numbers=read_part_numbers(table),
    )
    for key in ("value", "footprint", "description") if isfinite(length) else ():
        if (problem := chip_code_problem(getattr(profile, key), profile.body_mm)) is not None:
            table.problem(key, f"{key} = {shown(getattr(profile, key))} {problem}")
    return profile


def _element(table: Fields) -> ElementProfile:
    table.refuse_unknown(("name", "shape", "description", "body"))
    body = table.table("body", ("size_mm", "top_mm", "tolerance_mm"))
    shape = table.text("shape", choices=PART_SHAPES)
    size = body.numbers("size_mm", 3, low=LEAST_BODY_MM, high=LARGEST_BODY_MM)
    top_mm = body.number("top_mm") if "top_mm" in body.values else None
    problem = element_problem(shape, size, top_mm)
    if problem is not None and not table.problems:
        body.problem(*problem)
    return ElementProfile(
        name=_part_name(table),
        shape=shape,
        description=_attribute_text(table, "description"),
        body_mm=(size[0], size[1], size[2]),
        body_tolerance_mm=body.number("tolerance_mm", low=0.0, high=1.0),
        top_mm=top_mm,
    )


def element_problem(
    shape: str, size_mm: Sequence[float], top_mm: float | None, *, size_key: str = "size_mm", top_key: str = "top_mm"
) -> tuple[str, str] | None:
    """Reason why an element of this shape cannot have this size, as (key, message); None if it can.

    size_mm: Length, width, height in mm; for a dome the diameter twice and the height.
    size_key, top_key: Names of the two values in messages.
    """
    length_mm, width_mm, height_mm = size_mm
    if shape == "block":
        message = f"{top_key} is for a dome, and this is a block; leave it out"
        return None if top_mm is None else (top_key, message)
    if length_mm != width_mm:
        message = (
            f"{size_key} = {length_mm:g} x {width_mm:g} x {height_mm:g} mm stands on no circle; a dome has one diameter, give it"
        )
        return size_key, message
    if top_mm is not None:
        message = f"{top_key} = {top_mm:g} mm is not between 0 and {length_mm:g} mm, the diameter of the foot; use a smaller top"
        return None if 0.0 < top_mm < length_mm else (top_key, message)
    message = (
        f"{size_key} = {length_mm:g} x {height_mm:g} mm is no spherical cap, whose height is below its radius "
        f"{length_mm / 2:g} mm; use a lower dome, or a flat top"
    )
    # a cap of height h on a circle of radius a is part of a sphere of radius (a^2 + h^2) / (2 h); at h = a it is a half sphere
    return None if height_mm < length_mm / 2 else (size_key, message)


def _part_name(table: Fields) -> str:
    return table.text("name", pattern=r"[A-Za-z0-9._-]{1,64}", remedy="use letters, digits, '.', '_', '-'")


def _attribute_text(table: Fields, key: str) -> str:
    """A text that is valid in a Gerber attribute and in a table cell: one line of plain characters that is not a formula."""
    remedy = "use plain letters, digits and ._()+/,-, the first a letter or digit"
    return table.text(key, pattern=r"[A-Za-z0-9][A-Za-z0-9 ._()+/,-]{0,199}", remedy=remedy)


def read_land(table: Fields) -> LandPattern:
    """Read a land pattern from a table of a part profile or a manifest; problems are collected in `table`."""
    size = table.numbers("size_mm", 2, low=LEAST_BODY_MM, high=20.0)
    return LandPattern(
        size_mm=(size[0], size[1]),
        corner_radius_mm=table.number("corner_radius_mm", low=0.0, high=min(size) / 2),
        # the gap between both lands is 2 offset - length
        offset_mm=table.number("offset_mm", above=size[0] / 2, high=20.0, remedy="the two pads must not touch"),
    )
