"""Tables of a fab profile other than its limits: coverlay, anchors, backings, stencil, bending, parts and panels."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Literal, cast

from tactape_fab.base.errors import Level
from tactape_fab.base.fields import Fields, shown
from tactape_fab.kit.profiles.limits import ORIGIN_KEYS, Origin, read_level, read_origin

CoverlayMode = Literal["per-part", "lpi", "gang"]
COVERLAY_MODES: tuple[CoverlayMode, ...] = ("per-part", "lpi", "gang")
_BACKING = r"[A-Za-z0-9]{1,20} \d{1,2}(\.\d{1,3})?"


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorRules:
    """Anchors under the coverlay: line width, clearance from other parts' openings, and overlap with the coverlay, mm."""

    web_mm: float
    opening_mm: float
    overlap_mm: float
    origin: Origin


@dataclass(frozen=True, slots=True, kw_only=True)
class Backing:
    """Stiffeners or adhesives on offer: ``choices`` such as ``"FR4 0.2"``, material and thickness in mm."""

    choices: tuple[str, ...]
    origin: Origin


@dataclass(frozen=True, slots=True, kw_only=True)
class StencilRules:
    """Thickness of the stencil, and the least area ratio of an aperture (its area over that of its walls)."""

    thickness_mm: float
    least_ratio: float
    origin: Origin


@dataclass(frozen=True, slots=True, kw_only=True)
class BendRules:
    """Least bend radius, in multiples of the thickness."""

    least_thicknesses: float
    origin: Origin


@dataclass(frozen=True, slots=True, kw_only=True)
class PartsLimit:
    """Limits up to which the fab need not be asked: number of parts, and length of the smallest chip that the line places."""

    most: int
    smallest_mm: float
    level: Level
    origin: Origin
    smallest_origin: Origin


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelRules:
    """Panels that assembly accepts: sizes as (longer side, shorter side) in mm, rails, marks, holes and tabs.

    ``make`` is ``auto`` if tapes are put on a panel by default. ``tab_pitch_mm`` is the largest distance between tabs of
    a side.
    """

    make: str
    smallest_mm: tuple[float, float]
    largest_mm: tuple[float, float]
    rail_mm: float
    gap_mm: float
    fiducials: int
    fiducial_mm: float
    fiducial_opening_mm: float
    fiducial_shift_mm: float
    tooling_holes: int
    tooling_hole_mm: float
    tab_mm: float
    tab_pitch_mm: float
    origin: Origin


def material_words(backing: str) -> str:
    """A backing as text for file names, such as ``FR4_0.2mm`` for ``FR4 0.2``."""
    return f"{backing.replace(' ', '_')}mm"


def read_modes(coverlay: Fields) -> tuple[CoverlayMode, ...]:
    """Ways in which the fab opens the coverlay, the preferred one first."""
    modes = list(coverlay.rows("modes", longest=len(COVERLAY_MODES)))
    wrong = [mode for mode in modes if mode not in COVERLAY_MODES]
    given = f"modes = {shown(modes)}"
    if wrong:
        coverlay.problem("modes", f"{given} holds {shown(wrong[0])}, which is none of: {', '.join(COVERLAY_MODES)}; correct it")
    elif len(set(modes)) != len(modes) or (not modes and isinstance(coverlay.values.get("modes"), list)):
        coverlay.problem("modes", f"{given} must name one mode or more, each once; correct it")
    elif {"per-part", "lpi"} <= set(modes):
        coverlay.problem("modes", f"{given} holds both 'per-part' and 'lpi', whose limits differ; give each a profile of its own")
    else:
        return tuple(cast(CoverlayMode, mode) for mode in modes) or COVERLAY_MODES[:1]
    return COVERLAY_MODES[:1]


def read_anchor(profile: Fields) -> AnchorRules:
    table = profile.table("anchor", ("web_mm", "opening_mm", "overlap_mm", *ORIGIN_KEYS))
    return AnchorRules(
        web_mm=table.number("web_mm", above=0.0, high=10.0),
        opening_mm=table.number("opening_mm", low=0.0, high=10.0),
        overlap_mm=table.number("overlap_mm", above=0.0, high=10.0),
        origin=read_origin(table),
    )


def read_backing(profile: Fields, key: str) -> Backing:
    table = profile.table(key, ("choices", *ORIGIN_KEYS))
    choices = table.rows("choices", longest=100)
    for choice in choices:
        if not isinstance(choice, str) or not re.fullmatch(_BACKING, choice) or float(choice.split()[1]) == 0.0:
            table.problem("choices", f"choices holds {shown(choice)}, not material and thickness in mm; give such as 'FR4 0.2'")
    return Backing(choices=tuple(map(str, choices)), origin=read_origin(table))


def read_stencil(profile: Fields) -> StencilRules:
    table = profile.table("stencil", ("thickness_mm", "least_ratio", *ORIGIN_KEYS))
    return StencilRules(
        thickness_mm=table.number("thickness_mm", above=0.0, high=1.0, default=0.1),
        least_ratio=table.number("least_ratio", low=0.0, high=10.0, unit=""),
        origin=read_origin(table),
    )


def read_bend(profile: Fields) -> BendRules | None:
    """None for a rigid board: its profile has no such table, or replaces an inherited one by ``bend = "none"``."""
    if profile.values.get("bend", "none") == "none":
        return None
    table = profile.table("bend", ("least_thicknesses", *ORIGIN_KEYS))
    return BendRules(
        least_thicknesses=table.number("least_thicknesses", above=0.0, high=1000.0, unit=""), origin=read_origin(table)
    )


def read_parts_limit(profile: Fields) -> PartsLimit:
    table = profile.table("parts", ("most", "smallest_mm", "smallest_source", "level", *ORIGIN_KEYS))
    origin = read_origin(table)
    return PartsLimit(
        most=table.integer("most", low=1, high=10_000_000),
        smallest_mm=table.number("smallest_mm", above=0.0, high=20.0),
        level=read_level(table),
        origin=origin,
        smallest_origin=replace(origin, source=table.text("smallest_source")),
    )


PANEL_MARKS = 4
"""Most fiducials, and most tooling holes, of a panel: one in each corner."""
LEAST_TAB_PITCH_MM = 1.0
"""A side of a tape has as many tabs as this fits into it, at most."""
_LEAST_PANEL_MM = 0.1
"""Slots, tabs and marks of nanometres vanish in the files."""


def read_panel(profile: Fields) -> PanelRules:
    spans = ("rail_mm", "gap_mm", "tab_mm")
    marks = ("fiducial_mm", "fiducial_opening_mm", "fiducial_shift_mm", "tooling_hole_mm")
    counts = ("fiducials", "tooling_holes")
    table = profile.table("panel", ("make", "smallest_mm", "largest_mm", *spans, "tab_pitch_mm", *marks, *counts, *ORIGIN_KEYS))
    smallest, largest = (table.numbers(key, 2, above=0.0) for key in ("smallest_mm", "largest_mm"))
    if min(largest) < min(smallest) or max(largest) < max(smallest):
        table.problem(
            "largest_mm",
            f"largest_mm = {shown(list(largest))} mm is smaller than smallest_mm = {shown(list(smallest))} mm; correct one",
        )
    rules = PanelRules(
        make=table.text("make", choices=("auto", "none")),
        smallest_mm=(max(smallest), min(smallest)),
        largest_mm=(max(largest), min(largest)),
        **{key: table.number(key, low=_LEAST_PANEL_MM, high=100.0) for key in (*spans, *marks)},  # type: ignore[arg-type]
        tab_pitch_mm=table.number("tab_pitch_mm", low=LEAST_TAB_PITCH_MM, high=100.0),
        **{key: table.integer(key, low=0, high=PANEL_MARKS) for key in counts},
        origin=read_origin(table),
    )
    # marks are in the middle of a rail, with at least half a millimetre of board on each side
    widest_mm = max(rules.fiducial_opening_mm * bool(rules.fiducials), rules.tooling_hole_mm * bool(rules.tooling_holes))
    if rules.fiducial_opening_mm < rules.fiducial_mm:
        table.problem(
            "fiducial_opening_mm",
            f"fiducial_opening_mm = {rules.fiducial_opening_mm:g} mm is smaller than the fiducial's {rules.fiducial_mm:g} mm; "
            "give a larger one",
        )
    if widest_mm and rules.rail_mm < widest_mm + 1.0:
        table.problem(
            "rail_mm",
            f"rail_mm = {rules.rail_mm:g} mm has no room for marks and holes of {widest_mm:g} mm; give {widest_mm + 1:g} or more",
        )
    return rules
