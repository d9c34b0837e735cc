"""Small inputs that are dear to read: none costs more than a few seconds or a gigabyte, and each is answered."""

from __future__ import annotations

import pytest

from tactape_fab import Kit, TapeSpec, make_kit
from tests.attacks import ATTACKS, MOST_BYTES, MOST_CPU_S, Attack, cost_of
from tests.thorough import first

_AT_DESK = 6


@pytest.fixture(scope="module")
def victim(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    """A kit with models and a hole."""
    return make_kit(TapeSpec(sector=9, size_mm=(24.0, 20.0), holes_mm=((18.0, 10.0, 2.0),)), tmp_path_factory.mktemp("v") / "kit")


CASES = [pytest.param(attack, id=f"{attack.kind}: {attack.tried}") for attack in ATTACKS]


@pytest.mark.parametrize("attack", first(_AT_DESK, sorted(CASES, key=lambda case: str(case.id)[::-1])))
def test_an_attack_is_answered_at_a_small_cost(attack: Attack, victim: Kit) -> None:
    cost = cost_of(attack, victim.path)
    assert cost.status == attack.status, cost.output
    assert attack.said in cost.output and "Traceback" not in cost.output
    assert cost.cpu_s <= MOST_CPU_S
    assert cost.peak_bytes <= MOST_BYTES
