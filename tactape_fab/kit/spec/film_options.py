"""Options of a spec for coverlay, anchors, laminated backings and bending."""

from __future__ import annotations

import re
from typing import Any

from tactape_fab.base.fields import Fields, shown
from tactape_fab.kit.profiles import COVERLAY_MODES
from tactape_fab.texture.frames import snap_mm

ANCHOR_MODES = ("none", "spur", "mesh")
BEND_AXES = ("x", "y")
LEAST_BEND_MM = 0.1
MOST_BEND_MM = 100_000.0
FILM_KEYS = ("coverlay", "anchor", "stiffener", "adhesive", "bend_axis", "bend_radius_mm")
FLAGS = {key: "--" + key.removesuffix("_mm").replace("_", "-") for key in FILM_KEYS}
_BACKING = r"[A-Za-z0-9]{1,20}[ :]\d{1,2}(\.\d{1,3})?( ?mm)?"


def read_film_options(table: Fields, *, solid: bool) -> dict[str, Any]:
    """Values of these options in their final form; None for an option that is not set.

    table: All values given; problems are collected in it.
    solid: Whether the part is a solid element, which has no film.
    """
    if solid:
        for key in (k for k in FILM_KEYS if k in table.values and table.values[k] != "none"):
            message = f"{key} = {shown(table.values[key])} contradicts a solid element, which has no film"
            table.problem(key, f"{message}; leave out {FLAGS[key]}")
        return {**dict.fromkeys(FILM_KEYS), "anchor": "none"}
    values = {
        "coverlay": table.text("coverlay", choices=COVERLAY_MODES) or None if "coverlay" in table.values else None,
        "anchor": table.choice("anchor", ANCHOR_MODES),
        "stiffener": _backing(table, "stiffener"),
        "adhesive": _backing(table, "adhesive"),
        **_bend(table),
    }
    if values["anchor"] != "none" and values["coverlay"] == "gang":
        message = f"anchor = '{values['anchor']}' contradicts coverlay = 'gang', which leaves no coverlay to hold an anchor"
        table.problem("anchor", f"{message}; give one of them")
        values["anchor"] = "none"
    return values


def _backing(table: Fields, key: str) -> str | None:
    """Material and thickness in the form of the profiles: ``FR4 0.2``."""
    if key not in table.values:
        return None
    remedy = f"give MATERIAL:MM, such as {'FR4:0.2' if key == 'stiffener' else '3M468:0.13'}"
    text = table.text(key, pattern=_BACKING, remedy=remedy)
    if not text:
        return None
    material, thickness = re.split(r"[ :]", text.removesuffix("mm").rstrip(), maxsplit=1)
    return f"{material} {float(thickness):g}"


def _bend(table: Fields) -> dict[str, Any]:
    """Check that axis and radius are given together."""
    given = [key for key in ("bend_axis", "bend_radius_mm") if key in table.values]
    remedy = f"--bend-radius is the radius that the tape is bent to, {LEAST_BEND_MM} to {MOST_BEND_MM:g} mm"
    radius_mm = MOST_BEND_MM
    if "bend_radius_mm" in given:
        radius_mm = table.number("bend_radius_mm", low=LEAST_BEND_MM, high=MOST_BEND_MM, remedy=remedy, default=MOST_BEND_MM)
    if len(given) == 1:
        missing = "--bend-radius MM" if given[0] == "bend_axis" else "--bend-axis x or y"
        message = f"{given[0]} = {shown(table.values[given[0]])} has no effect alone"
        table.problem(given[0], f"{message}; give {missing} too, or leave out {FLAGS[given[0]]}")
    if len(given) < 2:
        return {"bend_axis": None, "bend_radius_mm": None}
    return {
        "bend_axis": table.text("bend_axis", choices=BEND_AXES, default=BEND_AXES[0]),
        "bend_radius_mm": float(snap_mm(radius_mm)),
    }
