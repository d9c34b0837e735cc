"""The ``[order]`` table of a fab profile: template of the order notes, and figures for the cost estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tactape_fab.base.fields import Fields
from tactape_fab.base.templates import templates_folder
from tactape_fab.kit.profiles.fab_tables import Origin

COSTS = {
    "setup": "once an order, one side",
    "stencil": "once an order",
    "fixture": "once an order",
    "feeder": "once an order for each kind of part",
    "joint": "each soldered joint",
    "part": "each part, bought",
}
"""Cost items of assembly, and how often each is charged."""
_ORIGIN_KEYS = ("source", "date", "confirmed")


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumption:
    """A figure used in an estimate, and its source."""

    value: float
    origin: Origin


@dataclass(frozen=True, slots=True, kw_only=True)
class Ordering:
    """``template`` is a file of templates/order without its ending; ``costs`` has one `Assumption` for each of COSTS, in
    ``currency``; ``placement`` is the time that a machine takes for one part, in seconds.
    """

    template: str
    currency: str
    costs: Mapping[str, Assumption]
    placement: Assumption


def order_templates() -> list[str]:
    """Names of the templates of order notes."""
    return sorted(path.stem for path in (templates_folder() / "order").glob("*.j2") if path.stem != "base")


def read_ordering(profile: Fields) -> Ordering:
    """Read a profile's ``[order]``; problems are collected in `profile`."""
    order = profile.table("order", ("template", "currency", "placement", *COSTS))
    currency = order.text("currency", pattern="[A-Z]{3}", remedy="give three capitals, such as USD")
    return Ordering(
        template=order.text("template", choices=order_templates()),
        currency=currency,
        costs={name: _assumption(order, name, "cost", currency) for name in COSTS},
        placement=_assumption(order, "placement", "seconds", "s"),
    )


def _assumption(order: Fields, name: str, key: str, unit: str) -> Assumption:
    table = order.table(name, (key, *_ORIGIN_KEYS))
    return Assumption(
        value=table.number(key, low=0.0, high=1e6, unit=unit),
        origin=Origin(source=table.text("source"), date=table.text("date"), confirmed=table.flag("confirmed")),
    )
