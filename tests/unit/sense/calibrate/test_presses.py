"""Presses: dots of located frames, at the parts that they name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense import ElasticContact, Scene, simulate
from tactape_fab.sense.calibrate.presses import interior, located
from tests.measured import measured
from tests.unit.sense.calibrate.sensors import TAPE, TRUE, off_mm, presses


def test_dots_of_a_press_are_at_the_parts_that_they_name() -> None:
    made = presses()
    told = list[tuple[int, int]]()
    empty = np.zeros_like(made.frames[0])
    found, answers = located([*made.frames[:2], empty, made.frames[2]], [TAPE], TRUE, lambda *words: told.append(words))
    assert [press.frame for press in found] == [0, 1, 3] and [fix.located for fix in answers] == [True, True, False, True]
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    for press, pose in zip(found, made.poses, strict=False):
        assert press.tape == TAPE.name and 0.15 < press.weights.min() <= press.weights.max() <= 1.0
        off = np.hypot(*off_mm(press, pose).T)
        assert np.median(off) < 0.03 and off.max() < 0.2
        assert 0.3 < press.interior.mean() < 0.9
        some = press.taken(press.interior)
        assert (
            np.array_equal(some.texture_mm, press.texture_mm[press.interior]) and some.interior.all() and some.tape == TAPE.name
        )
        moved = press.at(np.array([1.0, 2.0, 0.5, 9.0]))
        assert (moved.position_mm, moved.theta_rad, moved.frame) == ((1.0, 2.0), 0.5, press.frame)


def test_dots_of_sharp_tops_are_middles_that_nothing_draws() -> None:
    """By maxima they err by 19 um."""
    pose = np.array([40.0, 24.0, 20.0])
    scene = Scene(elastic=ElasticContact(force_n=2.0), slope_noise=0.032)
    frame = simulate(TAPE, pose[:2].tolist(), pose[2], sensor=TRUE, scene=scene, seed=2)
    ((press,), _), soft = located([frame], [TAPE], TRUE), located(presses().frames[:1], [TAPE], TRUE)[0][0]
    off = off_mm(press, pose)
    assert 0.9 < press.by_edges == press.taken(press.interior).by_edges and np.sqrt(np.mean(off**2)) < 0.008
    # the correction of maxima at the rim is up to 0.1 mm
    assert press.weights.min() < 0.5 and np.abs(press.rim_mm).max() < 0.01
    # soft ones are maxima
    assert soft.by_edges == 0.0
    for name in ("pushed", "pulled"):
        assert np.abs(getattr(press, name)).max() < 0.2 * np.abs(getattr(soft, name)).max()


def test_dots_on_no_part_and_those_at_the_image_s_sides_do_not_count() -> None:
    """A film that has parts where the tape has none, in a corner of the image, whose sides cut dots."""
    gone = np.array([(x, y) for x in (20, 21, 22) for y in (10, 11)])
    scene = Scene(contact_mm=(12.0, 10.0), contact_offset_mm=(6.5, 4.0))
    frame = simulate(TAPE, (24.5, 12.0), 0.0, sensor=TRUE, scene=scene, seed=4)
    (press,), (fix,) = located([frame], [replace(TAPE, omitted=gone)], TRUE)
    assert fix.dots is not None
    on_part = fix.dots.cell[:, 0] >= 0
    assert np.count_nonzero(~on_part) >= 4 and len(press.weights) <= np.count_nonzero(on_part)
    cells = np.rint(press.texture_mm / TAPE.pitch_mm)
    assert np.abs(press.texture_mm - cells * TAPE.pitch_mm).max(axis=1) == pytest.approx(TAPE.displacement_mm)
    from_side_px = np.minimum(press.seen_px, 2.0 * np.array(TRUE.centre_px) - press.seen_px).min(axis=1)
    assert from_side_px[~press.interior].min() < 10.0 < from_side_px[press.interior].min()


def test_parts_at_the_tape_s_edges_count() -> None:
    """A contact over its corner shows its first column and row."""
    frame = simulate(TAPE, (3.0, 3.0), 10.0, sensor=TRUE, seed=1)
    (press,), _ = located([frame], [TAPE], TRUE)
    cells = np.rint(press.texture_mm / TAPE.pitch_mm)
    assert np.count_nonzero(cells == 0.0, axis=0).min() >= 4


def test_dots_with_others_on_all_sides_are_inner() -> None:
    at = np.array([(x, y) for y in range(6) for x in range(7)], dtype=float) * 1.5
    column, row = np.rint(at / 1.5).astype(int).T
    amid = (column > 0) & (column < 6) & (row > 0) & (row < 5)
    corner = np.isin(column, (0, 6)) & np.isin(row, (0, 5))
    found = interior(at, np.ones(len(at), dtype=bool), 1.6 * 1.5)
    assert found[amid].all() and not found[corner].any()
    # and on tapes of any pitch
    assert np.array_equal(interior(0.5 * at, np.ones(len(at), dtype=bool), 1.6 * 0.75), found)
    # those that do not count are no neighbours: without a column, there are four more corners
    of = column != 3
    found = interior(at, of, 1.6 * 1.5)
    corner |= np.isin(column, (2, 4)) & np.isin(row, (0, 5))
    assert not found[corner].any() and found[amid & np.isin(column, (1, 5))].all()
    # a dot is no neighbour of its own: of a corner without the dot across it two are left, at a right angle
    assert not interior(at, (column != 1) | (row != 1), 1.6 * 1.5)[(column == 0) & (row == 0)].any()
    # where fewer than twelve are amid others, all count: those are as many as sit on four sides and inside them
    for columns, rows in ((4, 3), (4, 4), (5, 4)):
        few = at[(column < columns) & (row < rows)]
        amid_n = len(few) - 4
        assert np.count_nonzero(interior(few, np.ones(len(few), dtype=bool), 1.6 * 1.5)) == (len(few) if amid_n < 12 else amid_n)


def test_parts_that_were_measured_are_where_they_stand() -> None:
    tape, parts = measured(TAPE, 0.05, seed=2)
    pose = np.array([40.0, 24.0, 30.0])
    frame = simulate(tape, pose[:2].tolist(), pose[2], sensor=TRUE, parts=parts, seed=1)
    built, design = (np.median(np.hypot(*off_mm(located([frame], [one], TRUE)[0][0], pose).T)) for one in (tape, TAPE))
    assert built < 0.02 and design > 0.04
