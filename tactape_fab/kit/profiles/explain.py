"""A fab profile as plain data: every threshold with its unit and source."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from tactape_fab.kit.profiles.fabs import FabProfile
from tactape_fab.kit.profiles.limits import Origin


def explain_fab(fab: FabProfile) -> dict[str, Any]:
    """A profile as JSON-compatible data.

    Returns: ``thresholds`` is a list of mappings with id, value, unit, level, source, date and confirmed.
    """
    return {
        "name": fab.name,
        "title": fab.title,
        "material": asdict(fab.material),
        "colours": {"coverlay": fab.coverlay_colour, "legend": fab.legend_colour},
        "coverlay": list(fab.coverlay_modes),
        "stiffener": list(fab.stiffener.choices),
        "adhesive": list(fab.adhesive.choices),
        "gerber": {"x2": fab.x2, "job_in_zip": fab.job_in_zip},
        "assembly": fab.assembly,
        "panel": fab.panel.make,
        "files": dict(fab.file_names),
        "thresholds": _thresholds(fab),
    }


def _thresholds(fab: FabProfile) -> list[dict[str, Any]]:
    rows = []
    for name, limit in fab.limits.items():
        rows.append(_row(name, limit.value_mm, "mm", limit.level, limit))
        if limit.warn_mm is not None:
            rows.append(_row(name, limit.warn_mm, "mm", "warn", limit))
    rows.append(_row("size", list(fab.size.largest_mm), "mm", fab.size.level, fab.size))
    for name in ("line_mm", "text_mm", "gap_mm", "bleed_mm", "edge_mm"):
        rows.append(_row(f"legend.{name[:-3]}", getattr(fab.legend, name), "mm", "block", fab.legend.origin))
    for name in ("web_mm", "opening_mm", "overlap_mm"):
        rows.append(_row(f"anchor.{name[:-3]}", getattr(fab.anchor, name), "mm", "block", fab.anchor.origin))
    rows.append(_row("stencil.thickness", fab.stencil.thickness_mm, "mm", "info", fab.stencil.origin))
    rows.append(_row("paste-ratio", fab.stencil.least_ratio, "", "warn", fab.stencil.origin))
    rows.append(_row("part-count", fab.parts.most, "", fab.parts.level, fab.parts.origin))
    rows.append(_row("chip-size", fab.parts.smallest_mm, "mm", "warn", fab.parts.smallest_origin))
    if fab.bend is not None:
        rows.append(_row("bend-radius", fab.bend.least_thicknesses, "thicknesses", "warn", fab.bend.origin))
    panel = ("smallest_mm", "largest_mm", "rail_mm", "gap_mm", "fiducials", "fiducial_mm", "fiducial_opening_mm")
    for name in (*panel, "fiducial_shift_mm", "tooling_holes", "tooling_hole_mm", "tab_mm", "tab_pitch_mm"):
        value = getattr(fab.panel, name)
        shown = list(value) if isinstance(value, tuple) else value
        rows.append(_row(f"panel.{name.removesuffix('_mm')}", shown, "mm" * name.endswith("_mm"), "info", fab.panel.origin))
    assumptions = {name: (cost, fab.order.currency) for name, cost in fab.order.costs.items()}
    others = {"board": fab.order.currency, "placement": "s", "attrition": "", "reel": "parts"}
    assumptions |= {name: (known, unit) for name, unit in others.items() if (known := getattr(fab.order, name)) is not None}
    for name, (assumption, unit) in assumptions.items():
        value = assumption.value if assumption.least == assumption.value else [assumption.least, assumption.value]
        rows.append(_row(f"order.{name}", value, unit, "info", assumption.origin))
    if (number := fab.order.number) is not None:
        rows.append(_row(f"order.number of {number.part}", number.number, "", "info", number.origin))
    return rows


def _row(name: str, value: object, unit: str, level: str, origin: Origin) -> dict[str, Any]:
    known = {"source": origin.source, "date": origin.date, "confirmed": origin.confirmed}
    return {"id": name, "value": value, "unit": unit, "level": level, **known}
