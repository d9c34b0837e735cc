"""A measured value against a limit: to the last bit at both thresholds, with the words that go with each."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tactape_fab.base.errors import Finding
from tactape_fab.kit.plan import TOLERANCE_MM
from tactape_fab.kit.profiles import FabProfile, load_fab, load_part
from tactape_fab.kit.rules.spacing import _own_gap_mm, finding

LIMIT_MM, WARN_MM = 0.1, 0.2


@pytest.fixture(scope="module")
def fab() -> FabProfile:
    """A fab that blocks below 0.1 mm and warns below 0.2 mm."""
    fab = load_fab("generic-fpc")
    limit = replace(fab.limits["pad-pad"], value_mm=LIMIT_MM, warn_mm=WARN_MM, level="block")
    return replace(fab, limits={**fab.limits, "pad-pad": limit, "body-body": replace(limit, warn_mm=None)})


def found(fab: FabProfile, value_mm: float, rule: str = "pad-pad") -> Finding:
    return finding(fab, rule, (value_mm, (1.0, 2.0)), "a gap", lambda limit_mm: f"make it {limit_mm:g}")


@pytest.mark.parametrize(
    ("value_mm", "level", "passed", "limit_mm"),
    [
        (LIMIT_MM - TOLERANCE_MM - 1e-9, "block", False, LIMIT_MM),
        (LIMIT_MM - TOLERANCE_MM, "warn", False, WARN_MM),
        (LIMIT_MM, "warn", False, WARN_MM),
        (WARN_MM - TOLERANCE_MM - 1e-9, "warn", False, WARN_MM),
        (WARN_MM - TOLERANCE_MM, "block", True, LIMIT_MM),
        (WARN_MM, "block", True, LIMIT_MM),
    ],
    ids=str,
)
def test_a_value_between_two_limits_is_a_warning(
    value_mm: float, level: str, passed: bool, limit_mm: float, fab: FabProfile
) -> None:
    said = found(fab, value_mm)
    assert (said.level, said.passed, said.limit, said.value, said.at_mm) == (level, passed, limit_mm, value_mm, (1.0, 2.0))
    relation = "meets" if passed else "is below"
    kind = "limit without asking" if level == "warn" else "limit"
    end = "" if passed else f"; make it {limit_mm:g}"
    assert said.message == f"a gap {value_mm:.3f} mm {relation} the {kind} {limit_mm:.3f} mm of generic-fpc{end}"


def test_without_a_second_limit_there_is_no_warning(fab: FabProfile) -> None:
    assert [found(fab, value_mm, "body-body").passed for value_mm in (LIMIT_MM - 2 * TOLERANCE_MM, LIMIT_MM)] == [False, True]


def test_a_remedy_may_be_a_text(fab: FabProfile) -> None:
    said = finding(fab, "pad-pad", (0.0, None), "a gap", "ask")
    assert said.message.endswith("; ask") and said.at_mm is None


def test_the_gap_of_a_part_s_own_pads_is_between_their_facing_edges() -> None:
    assert _own_gap_mm(load_part("r0201")) == pytest.approx(2 * 0.32 - 0.46)
