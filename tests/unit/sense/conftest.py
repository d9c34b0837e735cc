"""The default tape, its localizer and a frame of it, for tests that do not change them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab import Localizer, Tape
from tactape_fab.sense import simulate
from tests.contacts import POSE, TAPE


@pytest.fixture(scope="session")
def tape() -> Tape:
    return TAPE


@pytest.fixture(scope="session")
def localizer() -> Localizer:
    return Localizer([TAPE])


@pytest.fixture(scope="session")
def depth() -> npt.NDArray[np.float32]:
    return simulate(TAPE, *POSE, seed=4)
