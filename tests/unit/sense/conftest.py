"""The default tape and its localizer, for tests that do not change them."""

from __future__ import annotations

import pytest

from tactape_fab import Localizer, Tape
from tests.contacts import TAPE


@pytest.fixture(scope="session")
def tape() -> Tape:
    return TAPE


@pytest.fixture(scope="session")
def localizer() -> Localizer:
    return Localizer([TAPE])
