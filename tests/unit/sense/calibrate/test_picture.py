"""Pictures of a calibration: colours where dots and residuals of a small sensor belong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from tactape_fab.sense.calibrate.picture import draw_coverage, draw_residuals, write_pictures
from tactape_fab.sense.calibrate.result import HeldOut
from tests.unit.sense.calibrate.by_hand import calibration

ZOOM = 928 / 40
"""Picture px a px of the small sensor's image, whose field begins at (16, 64)."""
DOT, MEAN, EMPTY, BLIND, BACK = (240, 190, 90), (60, 230, 245), (50, 110, 245), (70, 60, 60), (36, 36, 36)


def at_px(u: float, v: float) -> tuple[int, int]:
    """Row and column in the picture of a place in the image, whose pixels have whole numbers in their middle."""
    return round((v + 0.5) * ZOOM + 64), round((u + 0.5) * ZOOM + 16)


def words(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is written on pictures."""
    said, put = list[str](), cv2.putText

    def kept(picture: Any, text: str, *rest: Any) -> Any:
        said.append(text)
        return put(picture, text, *rest)

    monkeypatch.setattr(cv2, "putText", kept)
    return said


def test_dots_are_drawn_where_they_were_seen_in_a_colour_for_each_press(monkeypatch: pytest.MonkeyPatch) -> None:
    said, mask = words(monkeypatch), np.ones((30, 40), dtype=bool)
    mask[20:, :10] = False
    found = calibration(sensor=replace(calibration().sensor, mask=mask))
    picture = draw_coverage(found)
    assert picture.shape == (64 + 696 + 16, 960, 3)
    assert tuple(picture[at_px(35.0, 25.0)]) == (240, 190, 90)  # of the first press alone
    assert tuple(picture[at_px(4.0, 5.0)]) == tuple(picture[at_px(10.0, 12.0)]) == (110, 220, 130)
    assert tuple(picture[at_px(20.0, 15.0)]) == BACK
    # a frame of one px about the field
    assert [tuple(picture[300, column]) for column in (15, 16, 17)] == [(0, 0, 0), (95, 95, 95), BACK]
    assert [tuple(picture[at_px(*at)]) for at in ((9.0, 20.0), (10.0, 20.0), (9.0, 19.0))] == [BLIND, BACK, BACK]
    assert (picture[:, :14] == 0).all() and (picture[-14:] == 0).all()
    # the upper left and the lower right have dots
    assert said == ["2 presses, 5 dots; a colour for each press", "no dot in the upper right, lower left"]
    quarter_u, quarter_v = int(19.5 / 2 * ZOOM), int(14.5 / 2 * ZOOM)
    right, low = 16 + int(39 * ZOOM) - quarter_u, 64 + int(29 * ZOOM) - quarter_v
    for row, column in ((64, right + 50), (64 + quarter_v, right + 50), (low, 16 + 50), (low + 50, 16 + quarter_u)):
        assert np.abs(picture[row - 3 : row + 4, column - 3 : column + 4].astype(int) - EMPTY).sum(axis=2).min() == 0
    for row, column in ((64, 16 + 50), (low, right + 50)):
        assert np.abs(picture[row - 1 : row + 4, column - 1 : column + 2].astype(int) - EMPTY).sum(axis=2).min() > 0
    corners = np.array([[1.0, 1.0], [38.0, 1.0], [1.0, 28.0], [38.0, 28.0]])
    full = SimpleNamespace(frame=0, seen_px=corners, weights=np.ones(4))
    draw_coverage(calibration(presses=(full,)))
    assert said[-1] == "dots near all four corners"


@pytest.mark.parametrize(
    ("off_um", "dot_um", "mean_um", "count"),
    [
        ((6.0, 0.0), 10, 10, 4),
        ((0.0, -19.0), 20, 20, 4),
        ((2.0, 0.0), 2, 2, 4),
        ((900.0, 0.0), 500, 500, 4),
        ((6.0, 0.0), 10, 10, 3),
    ],
)
def test_residuals_are_drawn_at_a_round_scale(
    off_um: tuple[float, float], dot_um: int, mean_um: int, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dots of one cell of 5 px, whose middle is at (12.5, 7.5) of pixels' corners; lengths on the scale are 0.45 of a cell."""
    said = words(monkeypatch)
    seen = np.array([[11.0, 6.0], [13.0, 6.0], [11.0, 9.0], [13.0, 9.0]])[:count]
    press = SimpleNamespace(frame=0, seen_px=seen, weights=np.ones(count))
    bundle = SimpleNamespace(rms_mm=0.0061, residual_mm=(np.tile(np.array(off_um) / 1000.0, (count, 1)),))
    held_out = HeldOut(inside_um=6.1, outside_um=7.25, folds=4) if count == 3 else None
    picture = draw_residuals(calibration(presses=(press,), bundle=bundle, held_out=held_out))
    assert said == [
        "residuals: 6.1 um rms along an axis" + (", 7.2 um in presses left out" if count == 3 else ""),
        f"a dot, this long: {dot_um} um",
        f"mean of a cell, this long: {mean_um} um",
    ]
    reach = 0.45 * 5.0
    for at in seen:
        for share in (0.0, 0.5, 1.0):
            row, column = at_px(*(at + share * np.array(off_um) / dot_um * reach))
            if row < 760 and column < 940:
                assert np.abs(picture[row - 1 : row + 2, column - 1 : column + 2].astype(int) - DOT).sum(axis=2).min() < 60
    behind = at_px(*(seen[0 if off_um[0] else 2] - 0.3 * np.array(off_um) / dot_um * reach))
    assert np.abs(picture[behind].astype(int) - DOT).sum() > 60
    drawn = [np.abs(picture[r - 1 : r + 2, c - 1 : c + 2].astype(int) - MEAN).sum(axis=2).min() for r, c in [at_px(12.5, 7.5)]]
    assert (drawn[0] < 60) == (count == 4)
    # the legend's lines are as long as their figures say
    for x in (24, 480):
        line = np.flatnonzero((picture[47, x : x + 58] > 50).all(axis=1))
        assert (line[0], line[-1]) == (pytest.approx(0, abs=2), pytest.approx(reach * ZOOM, abs=3))


def test_arrows_are_to_the_scale_of_the_largest_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two cells, of 6 and of 1 um, side by side."""
    said = words(monkeypatch)
    seen = np.array([[11.0, 6.0], [13.0, 6.0], [11.0, 9.0], [13.0, 9.0]])
    presses = tuple(SimpleNamespace(frame=k, seen_px=seen + np.array([10.0 * k, 0.0]), weights=np.ones(4)) for k in range(2))
    residuals = tuple(np.tile([um / 1000.0, 0.0], (4, 1)) for um in (6.0, 1.0))
    draw_residuals(calibration(presses=presses, bundle=SimpleNamespace(rms_mm=0.0995, residual_mm=residuals)))
    assert said[0] == "residuals: 99.5 um rms along an axis" and said[2] == "mean of a cell, this long: 10 um"


def test_pictures_are_written_as_they_are_drawn(tmp_path: Path) -> None:
    found = calibration()
    assert write_pictures(tmp_path, found) == [tmp_path / "coverage.png", tmp_path / "residuals.png"]
    for name, drawn in (("coverage", draw_coverage(found)), ("residuals", draw_residuals(found))):
        written = cv2.imread(str(tmp_path / f"{name}.png"))
        assert written is not None and np.array_equal(written, drawn)
