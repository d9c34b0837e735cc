"""Which turn a part has that looks like no other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tactape_fab.sense.inspect import bodies
from tactape_fab.sense.inspect.bodies import _State


@pytest.mark.parametrize(("across", "turned"), [(0.6, True), (1.5, True), (1.8, False), (2.6, False), (4.0, False)])
def test_a_part_that_fits_a_little_better_across_is_not_turned(
    across: float, turned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A good part under glare was listed as turned by 86 degrees, 28 um off at a sigma of 9 um."""

    def moved(_scene: Any, _sites: Any, state: _State, _template: Any, _ends: Any, *, robust: bool) -> tuple[_State, None]:
        assert robust
        misfit = np.where(np.abs(state.turn_deg) > 80.0, across, 9.0)
        return _State(shift_mm=state.shift_mm, turn_deg=state.turn_deg, sigma_mm=state.sigma_mm, misfit=misfit), None

    monkeypatch.setattr(bodies, "_moved", moved)
    state = _State(shift_mm=np.zeros((1, 2)), turn_deg=np.zeros(1), sigma_mm=np.ones((1, 2)), misfit=np.array([2.9]))
    best = bodies._all_turns(None, np.zeros((1, 2)), state, state, np.array([0]), None, None, 1.0)  # type: ignore[arg-type]
    assert (abs(best.turn_deg[0]) > 80.0) == turned
