"""Options of a spec for the solid models (element, process, base, mould, cylinder), and their contradictions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tactape_fab.base.errors import tried
from tactape_fab.base.fields import Fields, shown
from tactape_fab.kit.profiles import LARGEST_BODY_MM, LEAST_BODY_MM, ElementProfile, PartProfile, element_problem, load_process
from tactape_fab.kit.profiles.parts import solid_elements
from tactape_fab.kit.spec.film_options import FILM_KEYS, FLAGS
from tactape_fab.solids.forms import AXES, DEFAULT_BASE_MM, SHELLS, TOPS
from tactape_fab.texture.frames import snap_mm

LEAST_BASE_MM, MOST_BASE_MM = 0.2, 50.0
MOST_CYLINDER_MM = 100_000.0
DEFAULT_PROCESS = "sla"
OPTIONS = {
    "fab": "--fab",
    "assembly": "--assembly",
    "part_number": "--part-number",
    "x2": "--x2",
    "tag_id": "--tag-id",
    "body_mm": "--body",
    "dome_top_mm": "--dome-top",
    "process": "--process",
    "base_mm": "--base",
    "top": "--top",
    "cylinder_mm": "--cylinder",
    "around": "--around",
    "shell": "--shell",
}
"""Option on the command line for each key that can contradict another."""
_OF_A_FILM = ("fab", "assembly", "part_number", "x2", "tag_id")
_OF_MODELS = ("process", "base_mm", "top", "cylinder_mm", "around", "shell")
_OF_A_CYLINDER = ("around", "shell")

Part = PartProfile | ElementProfile


def without_film(values: Mapping[str, Any]) -> str:
    """Given options that a solid element cannot have, as words of a remedy: `` without --fab, --no-3d``; "" if there are none."""
    keys = [key for key in (*_OF_A_FILM, *FILM_KEYS, "tag") if values.get(key, "none") != "none"]
    options = [OPTIONS.get(key, FLAGS.get(key, f"--{key}")) for key in keys] + ["--no-3d"] * (values.get("models") is False)
    return f" without {', '.join(options)}" if options else ""


def read_solid_options(table: Fields, part: Part | None) -> dict[str, Any]:
    """Values of these options in their final form; None for an option that does not apply.

    table: All values given; problems are collected in it.
    part: The spec's part; None if it cannot be read, in which case nothing is checked against it.
    """
    models = table.flag("models", default=True)
    negative, sim = table.flag("negative"), table.flag("sim")
    if sim and negative:
        _contradiction(table, "negative", "sim = true (--sim): nobody touches a mould", "leave out one of them")
    element = part if isinstance(part, ElementProfile) else None
    if element is not None:
        _refuse_film_options(table, element, models=models)
    elif not models:
        for key in _given(table, _OF_MODELS):
            _contradiction(table, key, "models = false (--no-3d)", "give one of them")
        if negative:
            _contradiction(table, "negative", "models = false (--no-3d)", "give one of them")
    if element is None and part is not None and "mark" in table.values:
        remedy = "leave out --no-mark, in TOML and Python mark"
        _contradiction(table, "mark", f"part = '{part.name}', whose film prints its sector", remedy)
    with_models = models or element is not None
    body_mm, top_mm = _body(table, part)
    return {
        "models": with_models,
        "body_mm": body_mm,
        "dome_top_mm": top_mm,
        "base_mm": _base(table) if with_models else None,
        "negative": negative,
        "sim": sim,
        "mark": None if part is None or element is None else _mark(table),
        "top": table.choice("top", TOPS) if with_models else None,
        **_cylinder(table),
    }


def _mark(table: Fields) -> bool:
    """Whether the back has a mark; by default as the process profile says."""
    if "mark" in table.values:
        return table.flag("mark")
    name = table.values.get("process", DEFAULT_PROCESS)
    # a profile that cannot be read is reported when the tape is examined
    process = tried(lambda: load_process(name), []) if isinstance(name, str) else None
    return process is None or process.mark


def _given(table: Fields, keys: tuple[str, ...]) -> list[str]:
    return [key for key in keys if key in table.values]


def _contradiction(table: Fields, key: str, other: str, remedy: str) -> None:
    table.problem(key, f"{key} = {shown(table.values[key])} contradicts {other}; {remedy}")


def _refuse_film_options(table: Fields, element: ElementProfile, *, models: bool) -> None:
    """Check that options of a film (PCB fab, ink) are not used with a solid element."""
    what = f"part = '{element.name}', a solid element"
    for key in _given(table, _OF_A_FILM):
        _contradiction(table, key, f"{what} without film or ink", f"leave out {OPTIONS[key]}")
    if table.values.get("tag", "none") != "none":
        _contradiction(table, "tag", f"{what} without film or ink", "leave out --tag")
    if not models:
        table.problem("models", f"models = false (--no-3d) contradicts {what}: there is nothing but models; leave out --no-3d")


def _body(table: Fields, part: Part | None) -> tuple[tuple[float, ...] | None, float | None]:
    """Size of the element and diameter of its flat top, mm: the given ones or the profile's; None for a part with lands."""
    if isinstance(part, PartProfile):
        for key in _given(table, ("body_mm", "dome_top_mm")):
            remedy = f"use --part {' or '.join(solid_elements())}"
            _contradiction(table, key, f"part = '{part.name}', whose size is fixed", remedy)
    if not isinstance(part, ElementProfile):
        return None, None
    problems = len(table.problems)
    size_mm, top_mm = part.body_mm, part.top_mm
    if "body_mm" in table.values:
        size_mm = _size(table, part)
    if "dome_top_mm" in table.values:
        top_mm = table.number("dome_top_mm", above=0.0, high=LARGEST_BODY_MM)
    if len(table.problems) == problems:
        problem = element_problem(part.shape, size_mm, top_mm, size_key="body_mm", top_key="dome_top_mm")
        if problem is not None:
            table.problem(*problem)
    return (size_mm, top_mm) if len(table.problems) == problems else (part.body_mm, part.top_mm)


def _size(table: Fields, part: ElementProfile) -> tuple[float, float, float]:
    """Length, width and height, mm; a dome's diameter may be given once."""
    given = table.values["body_mm"]
    once = part.shape == "dome" and isinstance(given, list | tuple) and len(given) == 2
    values = {"body_mm": [given[0], given[0], given[1]] if once else given}
    words = "DIAMETERxHEIGHT", "[DIAMETER, HEIGHT]"
    words = words if part.shape == "dome" else ("LENGTHxWIDTHxHEIGHT", "[LENGTH, WIDTH, HEIGHT]")
    size = Fields(values, "", table.problems).numbers(
        "body_mm",
        3,
        low=LEAST_BODY_MM,
        high=LARGEST_BODY_MM,
        remedy=f"give {words[0]} in mm, each at most {LARGEST_BODY_MM:g}, or {words[1]} in TOML and Python",
        default=part.body_mm,
    )
    if once:  # a diameter that was given once is reported once
        table.problems[:] = [p for p in table.problems if p.key != "body_mm[1]"]
    length_mm, width_mm, height_mm = (float(snap_mm(value)) for value in size)
    return length_mm, width_mm, height_mm


def _base(table: Fields) -> float:
    if "base_mm" not in table.values:
        return DEFAULT_BASE_MM
    remedy = f"--base is the thickness under the texture, {LEAST_BASE_MM} to {MOST_BASE_MM:g} mm, usually {DEFAULT_BASE_MM}"
    base_mm = table.number("base_mm", low=LEAST_BASE_MM, high=MOST_BASE_MM, remedy=remedy, default=DEFAULT_BASE_MM)
    return float(snap_mm(base_mm))


def _cylinder(table: Fields) -> dict[str, Any]:
    if "cylinder_mm" not in table.values:
        for key in _given(table, _OF_A_CYLINDER):
            message = f"{key} = {shown(table.values[key])} has no effect without a cylinder"
            table.problem(key, f"{message}; give --cylinder RADIUS too, or leave out {OPTIONS[key]}")
        return {"cylinder_mm": None, "around": None, "shell": None}
    remedy = "--cylinder is the radius of the surface under the texture, in millimetres"
    radius_mm = table.number("cylinder_mm", above=0.0, high=MOST_CYLINDER_MM, remedy=remedy, default=MOST_CYLINDER_MM)
    return {
        "cylinder_mm": float(snap_mm(radius_mm)),
        "around": table.choice("around", AXES),
        "shell": table.choice("shell", SHELLS),
    }
