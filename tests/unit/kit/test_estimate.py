"""Costs of an order against figures worked by hand."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tactape_fab.kit.estimate import estimate
from tactape_fab.kit.profiles import load_fab


def test_the_estimate_is_what_its_figures_make() -> None:
    """Of a tape of 40 parts: 100 an order, 0.5 for each of two joints and 0.25 for each part, 3 s a part, 10 % of parts lost."""
    fab = load_fab("jlcpcb-fpc")
    values = {"setup": 10.0, "stencil": 20.0, "fixture": 30.0, "feeder": 40.0, "joint": 0.5, "part": 0.25}
    costs = {name: replace(assumption, value=values[name]) for name, assumption in fab.order.costs.items()}
    order = replace(fab.order, costs=costs, placement=replace(fab.order.placement, value=3.0))
    found = estimate(40, replace(fab, order=order))
    assert (found.joints, found.once, found.each) == (80, 100.0, 50.0)
    assert found.minutes == pytest.approx(2.0)
    assert [(q.count, q.cost[1], q.parts) for q in found.quantities] == [(1, 150.0, 44), (5, 350.0, 220), (20, 1100.0, 880)]
