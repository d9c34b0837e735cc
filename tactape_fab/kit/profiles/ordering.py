"""The ``[order]`` table of a fab profile: template of the order notes, and figures for the cost estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tactape_fab.base.fields import Fields
from tactape_fab.base.templates import templates_folder
from tactape_fab.kit.profiles.assembly import PART_NUMBER_PATTERN, PART_NUMBER_REMEDY
from tactape_fab.kit.profiles.limits import ORIGIN_KEYS, Origin, read_origin

COSTS = {
    "setup": "once an order, one side",
    "stencil": "once an order",
    "fixture": "once an order",
    "feeder": "once an order for each kind of part",
    "joint": "each soldered joint",
    "part": "each part, bought",
}
"""Cost items of assembly, and how often each is charged."""
OPTIONAL = ("board", "number", "attrition", "reel")
"""Tables that a profile may leave out; the notes then call these figures unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumption:
    """A figure of the estimate, and its source; ``least`` is the lower end of its range, if known."""

    value: float
    least: float
    origin: Origin


@dataclass(frozen=True, slots=True, kw_only=True)
class PartNumber:
    """The house's part number for the part of a profile, and its description."""

    part: str
    number: str
    names: str
    origin: Origin


@dataclass(frozen=True, slots=True, kw_only=True)
class Ordering:
    """``template`` is a file of templates/order without its ending; ``costs`` has one `Assumption` for each of COSTS, in
    ``currency``; ``placement`` is the time that a machine takes for one part, in seconds. ``board`` is the cost of one bare
    board, ``attrition`` the fraction of parts that a line loses, ``reel`` the number of parts on a reel; None if not known.
    """

    template: str
    currency: str
    costs: Mapping[str, Assumption]
    placement: Assumption
    board: Assumption | None = None
    number: PartNumber | None = None
    attrition: Assumption | None = None
    reel: Assumption | None = None


def order_templates() -> list[str]:
    """Names of the templates of order notes."""
    return sorted(path.stem for path in (templates_folder() / "order").glob("*.j2") if path.stem != "base")


def read_ordering(profile: Fields) -> Ordering:
    """Read a profile's ``[order]``; problems are collected in `profile`."""
    order = profile.table("order", ("template", "currency", "placement", *COSTS, *OPTIONAL))
    currency = order.text("currency", pattern="[A-Z]{3}", remedy="give three capitals, such as USD")

    def known(name: str, key: str, unit: str, low: float = 0.0) -> Assumption | None:
        return _assumption(order, name, key, unit, low) if name in order.values else None

    return Ordering(
        template=order.text("template", choices=order_templates()),
        currency=currency,
        costs={name: _assumption(order, name, "cost", currency) for name in COSTS},
        placement=_assumption(order, "placement", "seconds", "s"),
        board=known("board", "cost", currency),
        number=_number(order) if "number" in order.values else None,
        attrition=known("attrition", "share", ""),
        reel=known("reel", "parts", "", 1.0),  # the notes divide by it
    )


def _assumption(order: Fields, name: str, key: str, unit: str, low: float = 0.0) -> Assumption:
    table = order.table(name, (key, "least", *ORIGIN_KEYS))
    value = table.number(key, low=low, high=1e6, unit=unit)
    return Assumption(
        value=value,
        least=min(value, table.number("least", low=low, high=1e6, unit=unit)) if "least" in table.values else value,
        origin=read_origin(table),
    )


def _number(order: Fields) -> PartNumber:
    table = order.table("number", ("part", "number", "names", *ORIGIN_KEYS))
    return PartNumber(
        part=table.text("part"),
        number=table.text("number", pattern=PART_NUMBER_PATTERN, remedy=PART_NUMBER_REMEDY),
        names=table.text("names"),
        origin=read_origin(table),
    )
