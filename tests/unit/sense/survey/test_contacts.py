"""Dots of a contact at the parts that they name, and parts that it should have shown: amid dots, and nowhere else."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from tactape_fab import Localization, Localizer
from tactape_fab.sense import ElasticContact, Scene, simulate
from tactape_fab.sense.decode.dots.frame_dots import contact_dots
from tactape_fab.sense.decode.grid.beliefs import RIM_AT_EDGES, RIM_MM
from tactape_fab.sense.decode.grid.drawn_dots import drawn
from tactape_fab.sense.decode.grid.pose import LEAST_WEIGHT
from tactape_fab.sense.decode.result import LocatedDots
from tactape_fab.sense.survey import contacts
from tactape_fab.sense.survey.contacts import LEAST_DOTS, _unseen, contact_of, ground_of
from tactape_fab.texture.frames import BoolArray, IntArray
from tests.tapes import tape_at
from tests.unit.sense.calibrate.sensors import TAPE as PRESSED
from tests.unit.sense.calibrate.sensors import TRUE, presses

TAPE = tape_at(7, (6, 5))
GRID = {(x, y) for x in range(6) for y in range(5)}


@pytest.mark.parametrize(
    ("gone", "omitted", "expected"),
    [
        ([], [], []),
        ([(2, 2)], [], [(2, 2)]),
        # a contact's rim has three or more that show none
        ([(2, 1), (2, 2)], [], [(2, 1), (2, 2)]),
        ([(2, 1), (2, 2), (2, 3)], [], [(2, 1), (2, 3)]),
        ([(1, 1), (3, 1), (2, 2)], [], [(1, 1), (3, 1)]),
        ([(0, 0), (1, 1), (2, 2)], [], [(2, 2)]),
        # at the tape's edge five neighbours are all there are, in its corner three are too few
        ([(2, 0)], [], [(2, 0)]),
        ([(0, 3)], [], [(0, 3)]),
        ([(5, 4)], [], []),
        ([(2, 0), (3, 0)], [], []),
        # where the tape has no part none is missed, and none is missing
        ([(2, 2)], [(2, 2)], []),
        ([(2, 1), (2, 2), (2, 3)], [(2, 1), (2, 3)], [(2, 2)]),
    ],
)
def test_parts_amid_dots_are_expected(
    gone: list[tuple[int, int]], omitted: list[tuple[int, int]], expected: list[tuple[int, int]]
) -> None:

    tape = replace(TAPE, omitted=np.array(omitted, dtype=np.int64).reshape(-1, 2))
    ground = ground_of(tape)
    cells = np.array([*sorted(GRID - set(gone)), (-1, -1)])
    assert _unseen(cells, ground).tolist() == sorted(ground.part_at[y, x] for x, y in expected)


def test_the_ground_has_each_part_at_its_design_s_place() -> None:
    ground = ground_of(TAPE)
    for number, (column, row) in enumerate(TAPE.cells().tolist()):
        assert ground.part_at[row, column] == number
        assert np.hypot(*(ground.nominal_mm[number] - np.array([column, row]) * 1.5)) == pytest.approx(0.25)


GROUND = ground_of(PRESSED)


@cache
def located(frame: int) -> Localization:
    """The answer to a press of a sensor whose camera is not perfect."""
    return Localizer(PRESSED, TRUE).locate(presses().frames[frame])


@pytest.mark.parametrize("frame", range(3))
def test_dots_of_a_contact_are_at_the_parts_that_they_name(frame: int) -> None:
    fix, depth = located(frame), presses().frames[frame]
    contact = contact_of(frame, depth, fix, GROUND, TRUE, GROUND.nominal_mm)
    assert contact is not None and contact.frame == frame and fix.dots is not None
    x, y, theta = presses().poses[frame] * (1.0, 1.0, np.pi / 180.0)
    assert contact.start == pytest.approx([x, y, theta], abs=0.01)
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    on_gel = TRUE.camera.from_px(contact.seen_px) - TRUE.camera.from_px(TRUE.centre_px)
    off = on_gel - (GROUND.nominal_mm[contact.part] - (x, y)) @ turn.T
    assert np.hypot(*off.T).max() < 0.12 and np.abs(np.median(off, axis=0)).max() < 0.01
    assert len(contact.part) >= np.count_nonzero(fix.dots.inlier) - 2
    # own is 1 / sqrt(weight), of which both variances are made
    weights = contact.own**-2.0
    assert 0.15 < weights.min() < 0.97 and weights.max() == pytest.approx(1.0)
    assert contact.rim_mm2 == pytest.approx(RIM_MM**2 * (1.0 - weights) ** 1.75)
    # a press of 9 x 8 mm in which no part is missing
    assert len(contact.expected) == 0


def test_oblong_pixels_and_a_lens_off_the_centre_move_no_dot_from_its_part() -> None:
    """Places on the gel count from the lens, poses from the image's centre, more than 2 mm beside it."""
    off_u, off_v = np.add(TRUE.centre_px, (30.0, -20.0)).tolist()
    sensor = replace(TRUE, px_per_mm=(15.0, 13.0), geometry=replace(TRUE.geometry, center_px=(off_u, off_v)))
    x, y, theta_deg = 40.0, 24.0, 20.0
    depth = simulate(PRESSED, (x, y), theta_deg, sensor=sensor, contact_mm=(9.0, 8.0), seed=3)
    contact = contact_of(0, depth, Localizer(PRESSED, sensor).locate(depth), GROUND, sensor, GROUND.nominal_mm)
    assert contact is not None and len(contact.part) > 20
    c, s = np.cos(np.radians(theta_deg)), np.sin(np.radians(theta_deg))
    from_centre_mm = (GROUND.nominal_mm[contact.part] - (x, y)) @ np.array([[c, s], [-s, c]])
    expected_px = sensor.camera.to_px(from_centre_mm + sensor.camera.from_px(sensor.centre_px))
    # dots at the rim are drawn outwards by a tenth of a millimetre
    assert np.hypot(*(contact.seen_px - expected_px).T).max() < 0.12 * 15.0


def test_dots_of_sharp_tops_are_middles_that_nothing_draws() -> None:
    """By maxima they err by 19 um, and by twice as much at the rim."""
    pose = np.array([40.0, 24.0, 20.0])
    depth = simulate(
        PRESSED,
        pose[:2].tolist(),
        pose[2],
        sensor=TRUE,
        scene=Scene(elastic=ElasticContact(force_n=2.0), slope_noise=0.032),
        seed=2,
    )
    contact = contact_of(0, depth, Localizer(PRESSED, TRUE).locate(depth), GROUND, TRUE, GROUND.nominal_mm)
    assert contact is not None and len(contact.part) > 40
    theta = np.radians(pose[2])
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    on_gel = TRUE.camera.from_px(contact.seen_px) - TRUE.camera.from_px(TRUE.centre_px)
    off = on_gel - (GROUND.nominal_mm[contact.part] - pose[:2]) @ turn.T
    assert np.sqrt(np.mean(off**2)) < 0.008 and np.abs(off).max() < 0.025
    # tops of 15 px/mm do not count in full
    by_edges, weights = contact_dots(depth, TRUE, PRESSED).by_edges, contact.own**-2.0
    of_rim = (1.0 - by_edges) * RIM_MM + by_edges * RIM_AT_EDGES * RIM_MM
    assert 0.9 < by_edges < 1.0 and weights.min() < 0.5 and contact.rim_mm2 == pytest.approx(of_rim**2 * (1.0 - weights) ** 1.75)
    shifts = drawn(GROUND.nominal_mm[contact.part], weights, contact.start[2], by_edges)
    assert np.allclose(contact.pushed, shifts[0]) and np.allclose(contact.pulled, shifts[1])


def test_dots_count_by_their_height_and_their_trust(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the tape's left edge, whose parts are of column 0."""
    depth = simulate(PRESSED, (4.0, 20.0), 10.0, sensor=TRUE, contact_mm=(9.0, 8.0), seed=1)
    fix = Localizer(PRESSED, TRUE).locate(depth)
    assert fix.dots is not None and fix.located
    heights, trust = np.linspace(0.05, 1.6, len(fix.dots.cell)), np.tile((1.0, 0.8), len(fix.dots.cell))[: len(fix.dots.cell)]
    monkeypatch.setattr(contacts, "contact_dots", lambda *words: replace(contact_dots(*words), weights=heights, trust=trust))
    contact = contact_of(0, depth, fix, GROUND, TRUE, GROUND.nominal_mm)
    assert contact is not None
    weights = np.minimum(heights * trust, 1.0)
    used = fix.dots.inlier & (weights > LEAST_WEIGHT)
    assert contact.own == pytest.approx(weights[used] ** -0.5)
    assert 0 in PRESSED.cells()[contact.part, 0] and contact.part.tolist() == [
        GROUND.part_at[row, column] for column, row in fix.dots.cell[used].tolist()
    ]


def test_a_contact_of_few_or_doubtful_dots_is_none() -> None:
    fix, depth = located(0), presses().frames[0]
    assert fix.dots is not None
    dots = LocatedDots(**{field.name: getattr(fix.dots, field.name) for field in fields(LocatedDots)})
    sure = np.flatnonzero(dots.inlier)

    def parts(**changes: BoolArray | IntArray) -> int | None:
        changed = replace(fix, dots=replace(dots, **changes))  # type: ignore[arg-type]
        found = contact_of(0, depth, changed, GROUND, TRUE, GROUND.nominal_mm)
        return None if found is None else len(found.part)

    of = np.zeros_like(dots.inlier)
    of[sure[:LEAST_DOTS]] = True
    assert parts(inlier=of) == LEAST_DOTS
    of[sure[0]] = False
    assert parts(inlier=of) is None
    # two dots on one part
    twice = dots.cell.copy()
    twice[sure[0]] = twice[sure[1]]
    assert parts(cell=twice) is None
    # an answer that has not the dots that are detected here
    assert parts(cell=dots.cell[:-1]) is None
