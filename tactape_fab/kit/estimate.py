"""Cost of an order of some tapes, and the parts that it takes, by the figures of a fab's profile."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

from tactape_fab.kit.profiles import FabProfile

TAPES_AN_ORDER = (1, 5, 20)
"""Order quantities for which a cost is estimated."""
ONCE = ("setup", "stencil", "fixture", "feeder")
"""Costs per order, independent of the number of tapes."""
LANDS_PER_PART = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """An order of a number of tapes or panels: lowest and highest cost without bare boards, lowest and highest cost of bare
    boards (None if not known), and number of parts including the line's attrition (None if not known).
    """

    count: int
    cost: tuple[float, float]
    boards: tuple[float, float] | None
    parts: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Cost of assembly and parts in the profile's currency: ``once`` per order and ``each`` per tape, with the lower ends of
    both if figures are ranges; ``quantities`` for `TAPES_AN_ORDER`.
    """

    joints: int
    minutes: float
    once: float
    each: float
    least_once: float
    least_each: float
    quantities: tuple[Quantity, ...]


def estimate(parts: int, fab: FabProfile) -> Estimate:
    """Estimated cost of assembling tapes with this number of parts, from the figures of the fab's profile."""
    order, joints = fab.order, LANDS_PER_PART * parts
    most = {name: assumption.value for name, assumption in order.costs.items()}
    least = {name: assumption.least for name, assumption in order.costs.items()}
    (least_once, least_each), (once, each) = (
        (sum(costs[name] for name in ONCE), joints * costs["joint"] + parts * costs["part"]) for costs in (least, most)
    )
    quantities = [
        Quantity(
            count=count,
            cost=(least_once + count * least_each, once + count * each),
            boards=None if order.board is None else (count * order.board.least, count * order.board.value),
            # rounded before ceil: 100 * 1.1 is 110.00000000000001
            parts=None if order.attrition is None else ceil(round(count * parts * (1.0 + order.attrition.value), 6)),
        )
        for count in TAPES_AN_ORDER
    ]
    return Estimate(
        joints=joints,
        minutes=parts * order.placement.value / 60.0,
        once=once,
        each=each,
        least_once=least_once,
        least_each=least_each,
        quantities=tuple(quantities),
    )
