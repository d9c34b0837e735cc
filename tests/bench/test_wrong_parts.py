"""The table of wrong parts: where symbols are wrong, more answers are than they say, but no more of all contacts."""

from __future__ import annotations

import pytest

from tests.bench.wrong_parts import answers


@pytest.mark.parametrize(("kind", "share"), [("all right", 0.0), ("missing", 0.2), ("wrong symbol", 0.2)])
def test_of_all_contacts_no_more_are_located_wrongly_than_is_said(kind: str, share: float) -> None:
    contacts = 1500
    p, wrong = answers(kind, share, contacts).T
    assert len(p) > 0.1 * contacts
    for limit in (1e-1, 1e-2):
        # of so many contacts at most this share on the mean, and three standard deviations
        assert wrong[p <= limit].sum() <= contacts * limit + 3.0 * (contacts * limit) ** 0.5
    # of the answers more are wrong than they say, where symbols are
    assert (wrong.sum() > p.sum()) == (kind == "wrong symbol")
