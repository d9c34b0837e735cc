"""Order notes: values for the fab's order form and text for its remarks, from the profile's template."""

from __future__ import annotations

from functools import cache
from math import ceil
from pathlib import Path
from typing import Any

from tactape_fab.base.templates import templates_folder
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.order_facts import OrderFacts
from tactape_fab.kit.profiles import COSTS, Assumption, Ordering
from tactape_fab.texture.cpl import PLACEMENTS

LAMINATES = {"FR4": "FR-4"}
"""Names of base materials in order forms, where they differ."""
# 1 oz of copper on a square foot is about 35 um thick
COPPER_OZ = {12.0: "1/3 oz", 18.0: "1/2 oz", 35.0: "1 oz", 70.0: "2 oz"}


class _Row(str):
    """A line that is already laid out."""

    __slots__ = ()


def in_a_line(value: object) -> str:
    """A value of a profile, which a user may have written, as text on one line."""
    return " ".join("".join(c if c.isprintable() else " " for c in str(value)).split())


def render_order_notes(facts: OrderFacts) -> tuple[Artifact]:
    """The notes of one order, which are for the user and not in the fab's zip."""
    template = _environment(templates_folder() / "order").get_template(f"{facts.fab.order.template}.j2")
    text = template.render(
        f=facts,
        tape=facts.tape,
        fab=facts.fab,
        material=facts.fab.material,
        laminate=LAMINATES.get(facts.fab.material.base, facts.fab.material.base),
        part=facts.part,
        placements=PLACEMENTS[facts.fab.assembly],
        files=facts.files,
        copper=COPPER_OZ.get(facts.fab.material.copper_um, f"{facts.fab.material.copper_um:g} um"),
        figures=_figures(facts),
        money=lambda both: _money(facts.fab.order.currency, both),
        reels=lambda parts: _reels(facts.fab.order, parts),
    )
    path = f"{facts.name}-order-notes.txt"
    return (Artifact(role="order-notes", path=path, data=text.encode("utf-8")),)


def _figures(facts: OrderFacts) -> list[tuple[str, Assumption, str, str]]:
    """Every figure of the estimate: name, figure, the item that it applies to, and unit."""
    order = facts.fab.order
    of_costs = [(name, cost, COSTS[name], order.currency) for name, cost in order.costs.items()]
    others = [
        ("board", order.board, "bare", order.currency),
        ("attrition", order.attrition, "share of parts that the line loses", ""),
        ("reel", order.reel, "on one", "parts"),
        ("placement", order.placement, "of a part", "s"),
    ]
    return of_costs + [(name, known, words, unit) for name, known, words, unit in others if known is not None]


def _money(currency: str, both: tuple[float, float]) -> str:
    least, most = (f"{value:.2f}" for value in both)
    return f"{currency} {most}" if least == most else f"{currency} {least} to {most}"


def _reels(order: Ordering, parts: int) -> str:
    """Text for the number of reels that hold the parts."""
    if order.reel is None:
        return ""
    # the more parts are on a reel, the fewer reels are needed
    fewest, most = ceil(parts / order.reel.value), ceil(parts / order.reel.least)
    return f"; {fewest} reel{'s' * (fewest > 1)}" if fewest == most else f"; {fewest} or {most} reels"


@cache
def _environment(folder: Path) -> Any:
    """Template environment: loads and compiles templates once for all notes of a process."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(folder),
        # a misspelt name in a template is an error, not a gap in the notes
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
        optimized=False,  # folding constants takes a fifth of the time to compile, and saves less
        # values of profiles and names come from a user, and must not contain line breaks
        finalize=lambda value: value if isinstance(value, _Row) else in_a_line(value),
    )
    environment.globals["row"] = lambda label, value: _Row(f"   {in_a_line(label):<34} {in_a_line(value)}")
    environment.filters["figures"] = lambda a: f"{a.value:g}" if a.least == a.value else f"{a.least:g} to {a.value:g}"
    # to 1 nm first, as verify, so that half a micrometre is rounded alike however the place was reckoned
    environment.filters["length"] = lambda value_mm: f"{round(value_mm, 6):.3f}".rstrip("0").rstrip(".")
    environment.filters["box"] = lambda box: f"x {box[0]:.1f} to {box[2]:.1f} mm, y {box[1]:.1f} to {box[3]:.1f} mm"
    return environment
