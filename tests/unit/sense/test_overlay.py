"""Pictures of frames: which tape is drawn, and where."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import Localizer
from tactape_fab.sense import load_sensor, overlay, simulate
from tactape_fab.sense.geometry import Geometry
from tactape_fab.sense.overlay import View, draw_overlay, placed_mm
from tests.contacts import TAPE, tape_of


def test_of_two_tapes_of_one_name_that_of_the_answer_is_drawn() -> None:
    other = replace(tape_of(30), name=TAPE.name)
    depth = simulate(other, (30.0, 20.0), 37.0)
    fix = Localizer([TAPE, other]).locate(depth)
    assert fix.sector == 30
    drawn, alone = (draw_overlay(depth, load_sensor("gelsight-mini"), tapes, fix, 0) for tapes in ([TAPE, other], [other]))
    assert np.array_equal(drawn, alone)


@pytest.mark.parametrize(
    "geometry",
    [Geometry(), Geometry(aspect=0.05, shear=0.03, k1=-0.06), Geometry(k1=0.05, center_px=(120.0, 150.0))],
)
def test_parts_are_drawn_where_the_profile_s_camera_sees_them(geometry: Geometry) -> None:
    sensor = replace(load_sensor("gelsight-mini"), geometry=geometry)
    depth = simulate(TAPE, (40.0, 22.0), 20.0, sensor=sensor, contact_mm=(12.0, 10.0), contact_offset_mm=(3.0, 2.0))
    fix = Localizer([TAPE], sensor).locate(depth)
    assert fix.dots is not None
    view, agree = View(sensor, fix, 1), fix.dots.inlier
    number = np.full((TAPE.rows, TAPE.columns), -1)
    number[TAPE.placed] = np.arange(TAPE.part_count)
    column, row = fix.dots.cell[agree].T
    off = view.to_px(placed_mm(TAPE)[number[row, column]]) - fix.dots.uv_px[agree]
    assert np.median(np.hypot(*off.T)) < 0.6 and np.quantile(np.hypot(*off.T), 0.9) < 1.5  # the rim draws its dots
    corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) * (sensor.width_px - 1.0, sensor.height_px - 1.0)
    np.testing.assert_allclose(view.to_px(view.corners_mm), corners, atol=1e-6)


def test_what_a_mask_hides_is_drawn_as_no_dots() -> None:
    v, u = np.mgrid[:240, :320]
    shown = ~((((u + 12) % 40 - 20) ** 2 + ((v + 7) % 40 - 20) ** 2) <= 2.5**2)
    sensor = replace(load_sensor("gelsight-mini"), mask=shown)
    depth = simulate(TAPE, (40.0, 22.0), 20.0, sensor=sensor)
    marked = np.where(shown, depth, depth.max() + 1.0)
    fix = Localizer([TAPE], sensor).locate(marked)
    assert fix.located
    drawn, clean = (draw_overlay(frame, sensor, [TAPE], fix, 0) for frame in (marked, np.where(shown, depth, np.nan)))
    assert np.array_equal(drawn, clean)


def test_grid_lines_go_through_all_grid_points_that_a_lens_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    sensor = replace(load_sensor("gelsight-mini"), geometry=Geometry(k1=0.05))
    depth = simulate(TAPE, (40.0, 22.0), 20.0, sensor=sensor)
    fix, lines = Localizer([TAPE], sensor).locate(depth), list[np.ndarray]()
    monkeypatch.setattr(overlay, "_line", lambda picture, points, *args, **options: lines.append(points))
    draw_overlay(depth, sensor, [TAPE], fix, 0)
    view = View(sensor, fix, 3)
    middle = view.to_px(TAPE.pitch_mm * np.array([27.0, 15.0]))
    assert sum(bool((np.abs(line - middle).max(axis=1) < 1e-6).any()) for line in lines) == 2
