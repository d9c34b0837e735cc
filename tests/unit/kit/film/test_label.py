"""The label of a strip."""

from __future__ import annotations

from tactape_fab.kit.film.label import compose_label


def test_a_strip_narrower_than_a_letter_has_no_label() -> None:
    """Its number of lines was negative, at which the search for line breaks ended `check` and `make`."""
    label = compose_label(["a", "b"], x_mm=(4.3, 1.7), y_mm=(0.0, 20.0), cap_mm=1.0)
    assert label.strokes_mm == ()
    assert label.left_out == ("'a'", "'b'", "the arrow for board +y")
