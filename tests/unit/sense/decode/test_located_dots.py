"""What each dot of an answer says, against the truth of simulated frames and dots put together by hand."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest

from tactape_fab import Localization, Localizer, TapeSpec, texture_to_board
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import LocatedDots, Scene, load_sensor, simulate, simulate_frames
from tactape_fab.sense.decode import accept
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.grid.beliefs import Beliefs
from tactape_fab.sense.decode.grid.pose import Pose
from tactape_fab.sense.decode.located_dots import ALIKE, OBSERVED, LazyDots, located_dots, strain_of
from tactape_fab.sense.decode.rank import View
from tactape_fab.sense.geometry import Geometry
from tactape_fab.sense.simulation.draw import Frames
from tactape_fab.texture.code import TOUCH_CODE
from tactape_fab.texture.frames import FloatArray
from tests.contacts import CENTRE, DELTA, POSE, TAPE, R, W, dots, is_near, seen

CELLS = TAPE.cells()
NOISE_MM = 0.03
BENT = Geometry(aspect=0.05, shear=0.04, k1=0.05, center_px=(170.0, 100.0))


def dots_of(fix: Localization) -> LocatedDots:
    assert fix.located and fix.dots is not None, fix.reason
    assert len({len(a) for a in (fix.dots.uv_px, fix.dots.cell, fix.dots.symbol, fix.dots.residual_mm, fix.dots.inlier)}) == 1
    return fix.dots


def assert_true(frames: Frames, found: LocatedDots, k: int) -> None:
    """Places and cells of a frame's dots are those of its parts, for all that agree."""
    off = np.hypot(*np.moveaxis(found.uv_px[found.inlier, None] - frames.dots_px[k], 2, 0))
    # the rim draws dots inwards, and `uv_px` are dots as detected: those of parts that are mostly imprinted are within a pixel
    whole = frames.dots_imprint[k][off.argmin(axis=1)] > 0.8
    assert whole.sum() > 8 and (off.min(axis=1)[whole] < 1.0).all()
    assert off.min() < 0.3 and off.min(axis=1).max() < 4.0
    assert (found.cell[found.inlier] == CELLS[frames.dots_part[k][off.argmin(axis=1)]]).all()


# Frames


@pytest.mark.parametrize("bent", [False, True])
def test_dots_are_where_the_parts_are_seen(bent: bool) -> None:
    sensor = load_sensor("gelsight-mini")
    sensor = replace(sensor, px_per_mm=(16.0, 13.0), geometry=BENT) if bent else sensor
    localizer = Localizer([TAPE], sensor)
    frames = simulate_frames(TAPE, 6, 3, sensor)
    answers = [localizer.locate(depth) for depth in frames.depth]
    assert sum(fix.located for fix in answers) >= 5
    for k, fix in enumerate(answers):
        if fix.located:
            found = dots_of(fix)
            assert (len(found.uv_px), found.inlier.sum()) == (fix.n_dots, fix.n_agree)
            assert_true(frames, found, k)
            assert np.abs(found.residual_mm[found.inlier]).max() < 0.2
            assert np.median(np.abs(found.residual_mm[found.inlier])) < NOISE_MM
            assert fix.cell in {tuple(cell) for cell in found.cell[found.inlier].tolist()}


def test_symbols_are_probabilities_in_the_order_of_the_tape(localizer: Localizer) -> None:
    for theta_deg in (20.0, 110.0, -160.0, -70.0):
        found = dots_of(localizer.locate_dots(dots(POSE[0], theta_deg)))
        assert found.symbol.shape == (len(found.cell), 4)
        assert found.symbol.sum(axis=1) == pytest.approx(1.0)
        true = TAPE.symbols[found.cell[:, 1], found.cell[:, 0]]
        assert (found.symbol[np.arange(len(true)), true] > 0.95).all()


def test_eight_directions_have_eight_symbols() -> None:
    spec = TapeSpec(sector=1, size_mm=(40.0, 24.0), code=TOUCH_CODE, directions=8, part="block", pitch_mm=1.06)
    tape = examine(spec).tape
    localizer = Localizer([tape])
    for theta_deg in (10.0, 100.0, -170.0, -80.0):
        found = dots_of(localizer.locate(simulate(tape, (18.0, 11.0), theta_deg, contact_mm=(8.0, 8.0))))
        assert found.symbol.shape == (len(found.cell), 8)
        assert found.symbol.sum(axis=1) == pytest.approx(1.0)
        column, row = found.cell[found.inlier].T
        assert (found.symbol[found.inlier].argmax(axis=1) == tape.symbols[row, column]).mean() > 0.9


def test_a_part_that_is_displaced_shows(localizer: Localizer) -> None:
    shift = np.array([0.06, -0.08])  # texture frame
    moved = int(np.hypot(*(CELLS - np.array(POSE[0]) / W - (1.0, 0.5)).T).argmin())
    origin_mm = TAPE.board.texture_origin_mm
    parts = TAPE.part_xy_mm()
    parts[moved] += texture_to_board(shift, origin_mm) - texture_to_board(np.zeros(2), origin_mm)
    found = dots_of(localizer.locate(simulate(TAPE, *POSE, parts=np.c_[parts, np.full(len(parts), TAPE.part.rotation_deg)])))
    (row,) = np.flatnonzero((found.cell == CELLS[moved]).all(axis=1))
    assert found.residual_mm[row] == pytest.approx(shift, abs=NOISE_MM)
    assert not found.inlier[row]
    others = np.abs(np.delete(found.residual_mm, row, axis=0)[np.delete(found.inlier, row)])
    assert others.max() < 0.06


# Dots


def test_residuals_are_the_errors_of_exact_dots_beyond_the_pose(localizer: Localizer) -> None:
    xy = dots()
    found = dots_of(localizer.locate_dots(xy))
    assert found.uv_px == pytest.approx(xy)
    # no more than what neighbours are believed to push each other
    assert np.abs(found.residual_mm).max() < 0.02
    k = 20
    xy[k] += (1.0, 0.0)
    residual = dots_of(localizer.locate_dots(xy)).residual_mm[k] - found.residual_mm[k]
    turn = np.radians(POSE[1])
    assert residual == pytest.approx(np.array([np.cos(turn), -np.sin(turn)]) / R, abs=0.004)


@pytest.mark.parametrize("known", [False, True])
def test_residuals_are_seen_through_the_camera(known: bool) -> None:
    """Of a bent camera, in the profile or found by the fit: with the pose alone they are ten times as large."""
    geometry = Geometry(aspect=0.02, shear=-0.015, k1=0.03, center_px=(170.0, 100.0))
    sensor = replace(load_sensor("gelsight-mini"), geometry=geometry)
    xy = sensor.camera.to_px((dots() - CENTRE) / R + sensor.camera.from_px(sensor.centre_px))
    centre = replace(sensor, geometry=Geometry(center_px=geometry.center_px))
    fix = Localizer([TAPE], sensor if known else centre).locate_dots(xy)
    found = dots_of(fix)
    assert found.uv_px == pytest.approx(xy, abs=1e-9)
    assert np.median(np.hypot(*found.residual_mm.T)) < 0.012
    assert fix.position_mm is not None and fix.theta_deg is not None and fix.px_per_mm is not None
    nominal = seen(np.asarray(found.cell * W, dtype=np.float64), fix.position_mm, fix.theta_deg, fix.px_per_mm)
    alone = np.hypot(*(xy - nominal).T) / R - DELTA  # from the grid point, less a part's displacement
    assert known or np.abs(alone).max() > 0.08


def test_dots_off_the_tape_and_off_its_parts_have_no_cell() -> None:
    holed = examine(TapeSpec(sector=7, holes_mm=[(47.0, 26.0, 3.0)])).layout.tape
    hole = holed.omitted.mean(axis=0) * W
    for position_mm, some in (((2.0, 20.0), TAPE), ((hole[0] + 2.0, hole[1]), holed)):
        xy = dots(position_mm, 30.0)
        there: FloatArray = np.array([(-1.3, 20.0)]) if some is TAPE else holed.omitted[:1] * W + np.array((0.0, DELTA))
        beyond = seen(there, position_mm, 30.0)
        fix = Localizer([some]).locate_dots(np.concatenate([xy, beyond]))
        found = dots_of(fix)
        near = np.flatnonzero(np.hypot(*(found.uv_px - beyond[0]).T) < 1e-9)
        assert len(near) == 1 and found.cell[near[0]].tolist() == [-1, -1]
        assert np.isnan(found.residual_mm[near[0]]).all() and not found.inlier[near[0]]
        assert (np.isnan(found.residual_mm).any(axis=1) == (found.cell < 0).all(axis=1)).all()
        assert found.inlier.sum() == fix.n_agree


def test_a_code_alone_gives_cells_of_its_plane() -> None:
    fix = Localizer.from_code("microdots-4x4", W, DELTA).locate_dots(dots(semi_mm=(7.0, 6.0)))
    found = dots_of(fix)
    near = np.array(fix.index) in found.cell
    assert near and fix.tape is None
    columns, rows = (found.cell - TAPE.origin).T
    true = TAPE.symbols[rows, columns]
    assert (found.symbol[np.arange(len(true)), true] > 0.9).all()
    assert np.abs(found.residual_mm).max() < 0.02


def test_arrays_are_read_only(localizer: Localizer) -> None:
    xy = dots()
    found = dots_of(localizer.locate_dots(xy))
    for name in LocatedDots.__slots__:
        with pytest.raises(ValueError, match="read-only"):
            getattr(found, name)[:] = 0
    xy += 1.0  # the caller's own
    assert found.uv_px == pytest.approx(xy - 1.0)


def test_nothing_is_said_without_an_answer(localizer: Localizer) -> None:
    lost = localizer.locate_dots(dots(semi_mm=(2.6, 2.6)))
    paper = Localizer([TAPE], method="paper").locate_dots(dots())
    assert not lost.located and paper.located
    for fix in (lost, paper):
        assert (fix.dots, fix.strain, fix.strain_sigma) == (None, None, None)


# Strain


def strains(scene: Scene, count: int = 12) -> tuple[FloatArray, FloatArray]:
    """Aspect and shear of located frames and their standard deviations; shape (n, 2)."""
    localizer = Localizer([TAPE])
    fixes = [localizer.locate(depth) for depth in simulate_frames(TAPE, count, 5, scene=scene).depth]
    told = [(fix.strain, fix.strain_sigma) for fix in fixes if fix.located]
    assert len(told) >= 0.75 * count
    assert all(entry is not None and entry[2] is None for pair in told for entry in pair)
    pairs = [[entry[:2] for entry in pair if entry is not None] for pair in told]
    values, sigmas = np.array(pairs, dtype=np.float64).swapaxes(0, 1)
    return values, sigmas


@pytest.mark.parametrize(("aspect", "shear"), [(0.0, 0.02), (0.0, -0.02), (0.03, 0.0), (-0.02, 0.01)])
def test_a_camera_unlike_its_profile_s_shows_as_strain(aspect: float, shear: float) -> None:
    values, sigmas = strains(Scene(aspect_error=aspect, shear_error=shear))
    assert (sigmas > 0).all() and (sigmas < 0.005).all()
    score = (values - (aspect, shear)) / sigmas
    assert (np.abs(score) < 3.0).mean() > 0.9 and np.abs(score).max() < 4.5
    assert values.mean(axis=0) == pytest.approx((aspect, shear), abs=0.004)


def test_strain_is_none_where_the_frame_says_no_more_than_the_profile(localizer: Localizer) -> None:
    sensor = load_sensor("gelsight-mini")
    known = replace(sensor, geometry=Geometry(sigma_aspect=1e-5, sigma_shear=0.02))
    exact = replace(sensor, geometry=Geometry(sigma_aspect=0.03, sigma_shear=0.0))
    aspect_known, shear_exact = (Localizer([TAPE], profile).locate_dots(dots()) for profile in (known, exact))
    for fix, told in ((aspect_known, (False, True, False)), (shear_exact, (True, False, False))):
        assert fix.strain is not None and fix.strain_sigma is not None
        assert tuple(value is not None for value in fix.strain) == told
        assert tuple(value is not None for value in fix.strain_sigma) == told


# JSON


def test_a_mapping_has_dots_only_if_asked_for(localizer: Localizer) -> None:
    fix = localizer.locate_dots(dots())
    told = fix.to_mapping(3)
    assert "dots" not in told and told["strain"] == fix.strain and told["strain_sigma"] == fix.strain_sigma
    asked = json.loads(json.dumps(fix.to_mapping(3, dots=True)))
    found = dots_of(fix)
    for name in LocatedDots.__slots__:
        assert np.array(asked["dots"][name]) == pytest.approx(getattr(found, name))
    del asked["dots"]
    assert asked == json.loads(json.dumps(told))
    lost = localizer.locate_dots(dots(semi_mm=(2.6, 2.6)))
    assert lost.to_mapping(dots=True)["dots"] is None
    assert is_near(fix, *POSE, mm=0.001, deg=0.01)


def test_dots_are_computed_when_they_are_asked_for(localizer: Localizer, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def counted(*args: object) -> LocatedDots:
        asked.append(args)
        return located_dots(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(accept, "located_dots", counted)
    fix = localizer.locate(simulate_frames(TAPE, 1, 3).depth[0])
    assert fix.located and fix.dots is not None
    assert json.dumps(fix.to_mapping(0)) and not asked
    dots = replace(fix, timestamp=1.0).dots
    assert dots is not None and len(dots.cell) == fix.n_dots and len(asked) == 1
    assert fix.to_mapping(dots=True)["dots"] == dots.to_mapping() and len(asked) == 1
    without = LocatedDots(
        **{**{name: getattr(dots, name) for name in LocatedDots.__slots__}, "residual_mm": np.full((1, 2), np.nan)}
    )
    assert without.to_mapping()["residual_mm"] == [[None, None]] and json.dumps(
        replace(fix, dots=without).to_mapping(dots=True), allow_nan=False
    )
    with pytest.raises(AttributeError, match="cells"):
        _ = dots.cells  # type: ignore[attr-defined]


def test_dots_pass_to_other_processes_whether_asked_for_or_not(localizer: Localizer) -> None:
    fix = localizer.locate(simulate_frames(TAPE, 1, 3).depth[0])
    there = pickle.loads(pickle.dumps(fix))
    assert isinstance(there.dots, LocatedDots)
    assert there.dots.to_mapping() == dots_of(fix).to_mapping()


# Put together by hand: every number is another

SAID = View(
    pitch_mm=W,
    displacement_mm=DELTA,
    part=None,
    px_per_mm=16.0,
    scale_tolerance=0.06,
    centre_px=CENTRE,
    beliefs=Beliefs(sigmas=np.array([0.05, 0.03, 0.02, 0.04]), corner_mm=np.array([12.0, 11.0]), centre_mm=np.array([0.9, -0.6])),
)
FITTED = Pose(
    position_mm=np.array([12.0, 7.5]),
    theta_rad=radians(25.0),
    px_per_mm=15.2,
    covariance=np.eye(3),
    agree=np.array([True, False, True]),
    sigma_mm=0.01,
    camera=np.array([(0.08, -0.05, 0.06), (0.001, 0.002, 0.003)]),
)
OFFSETS = np.array([(0.0, 0.0), (70.0, -40.0), (-55.0, 65.0)])
SEEN = np.array([(10.0, 20.0), (30.0, 40.0), (50.0, 60.0), (70.0, 80.0), (90.0, 15.0)])
INSIDE = np.array([False, True, True, False, True])


def on_texture(offset_px: FloatArray) -> FloatArray:
    """Where a pixel's point is by the fit, as `posterior` has it: lens, then aspect and shear, then turn and scale."""
    aspect, shear, k1 = FITTED.camera[0]
    lens_mm, corner_mm = SAID.beliefs.centre_mm, SAID.beliefs.corner_mm

    def straight(seen_mm: FloatArray) -> FloatArray:
        out = seen_mm
        for _ in range(100):  # out (1 + k1 |out / corner|^2) = seen
            out = seen_mm / (1.0 + k1 * ((out / corner_mm) ** 2).sum())
        return out

    c, s = cos(FITTED.theta_rad), sin(FITTED.theta_rad)
    drawn = FITTED.px_per_mm / SAID.px_per_mm * np.array([(1.0 + aspect / 2, shear), (0.0, 1.0 - aspect / 2)])
    from_centre = straight(offset_px / SAID.px_per_mm - lens_mm) - straight(-lens_mm)
    return np.asarray(FITTED.position_mm + np.array([(c, s), (-s, c)]) @ np.linalg.solve(drawn, from_centre))


def put_together(nominal_mm: FloatArray, **changed: object) -> LocatedDots:
    q = np.arange(20.0).reshape(5, 4)
    said = {
        "turn": 1,
        "inside": INSIDE,
        "cells": np.array([(3, 4), (5, 6), (7, 8)]),
        "offset_px": OFFSETS,
        "pose": FITTED,
    } | changed
    dots = Dots(xy_px=SEEN + 0.5, weights=np.ones(5), trust=np.ones(5), seen_px=said.pop("seen_px", SEEN))  # type: ignore[arg-type]
    return located_dots(dots, q, nominal_mm=nominal_mm, view=SAID, **said)  # type: ignore[arg-type]


def test_each_row_is_its_dot_s() -> None:
    there = np.array([on_texture(offset) for offset in OFFSETS])
    found = put_together(there - [(0.1, 0.2), (0.3, -0.4), (-0.5, 0.6)])
    assert found.uv_px.tolist() == SEEN.tolist() and found.uv_px is not SEEN
    assert found.cell.tolist() == [[-1, -1], [3, 4], [5, 6], [-1, -1], [7, 8]]
    assert found.inlier.tolist() == [False, True, False, False, True]
    assert found.residual_mm[INSIDE] == pytest.approx(np.array([(0.1, 0.2), (0.3, -0.4), (-0.5, 0.6)]), abs=2e-5)
    assert np.isnan(found.residual_mm[~INSIDE]).all()
    assert put_together(there, seen_px=None).uv_px == pytest.approx(SEEN + 0.5)


def test_the_image_s_centre_is_at_the_answer_s_position() -> None:
    found = put_together(np.tile(FITTED.position_mm, (3, 1)))
    assert found.residual_mm[1] == pytest.approx((0.0, 0.0), abs=1e-12)


def test_without_a_dot_beside_the_tape_the_arrays_are_copies() -> None:
    all_on = {"inside": np.ones(3, dtype=bool), "cells": np.array([(3, 4), (5, 6), (7, 8)])}
    found = put_together(np.zeros((3, 2)), **all_on)
    assert found.cell.tolist() == all_on["cells"].tolist() and found.inlier.tolist() == FITTED.agree.tolist()
    assert found.cell is not all_on["cells"] and all_on["cells"].flags.writeable and FITTED.agree.flags.writeable


def test_symbols_of_a_turned_grid_are_the_texture_s() -> None:
    q = np.arange(20.0).reshape(5, 4)
    for turn in (1, 5, -3):
        assert put_together(np.zeros((3, 2)), turn=turn).symbol.tolist() == q[:, [0, 3, 1, 2]].tolist()


def test_strain_is_told_where_the_frame_leaves_less_than_the_share_of_the_profile_s_deviation() -> None:
    below, above = OBSERVED - 1e-9, OBSERVED + 1e-9
    for shares, told in (((below, above), (True, False)), ((above, below), (False, True)), ((below, below), (True, True))):
        sigmas = np.array(shares) * SAID.beliefs.sigmas[1:3]
        pose = replace(FITTED, camera=np.array([(0.08, -0.05, 0.06), (*sigmas, 0.003)]))
        found = strain_of(pose, SAID)
        assert found["strain"] == (0.08 if told[0] else None, -0.05 if told[1] else None, None)
        expected = [ALIKE * sigma if is_told else None for sigma, is_told in zip(sigmas, told, strict=True)]
        assert found["strain_sigma"] == (*expected, None)
    exact = replace(FITTED, camera=np.array([(0.08, -0.05, 0.06), (OBSERVED * 0.03, OBSERVED * 0.02, 0.0)]))
    assert strain_of(exact, SAID) == {"strain": (None, None, None), "strain_sigma": (None, None, None)}


def test_lazy_dots_are_computed_once_and_have_no_other_fields() -> None:
    asked = []

    def compute() -> LocatedDots:
        asked.append(1)
        return put_together(np.zeros((3, 2)))

    lazy = LazyDots(compute)
    with pytest.raises(AttributeError, match="'LazyDots' object has no attribute 'cells'"):
        _ = lazy.cells
    assert not asked
    assert lazy.inlier.tolist() == [False, True, False, False, True]
    assert lazy.cell[1].tolist() == [3, 4] and lazy.uv_px.tolist() == SEEN.tolist() and asked == [1]


def test_dots_not_yet_computed_can_be_replaced() -> None:
    lazy = LazyDots(lambda: put_together(np.zeros((3, 2))))
    changed = pickle.loads(pickle.dumps(replace(lazy, inlier=np.ones(5, dtype=bool))))
    assert changed.inlier.all() and changed.uv_px.tolist() == SEEN.tolist()
    with pytest.raises(TypeError, match="cells"):
        replace(lazy, cells=SEEN)  # type: ignore[call-arg]


def test_residuals_are_those_of_the_answer_that_pixels_refined() -> None:
    """They were those of the pose by dots, beside a position by pixels."""
    frame = simulate(TAPE, *POSE)
    by_dots, by_pixels = (Localizer([TAPE], refine=refine).locate(frame) for refine in ("dots", "pixels"))
    assert by_pixels.refined == "pixels" and by_dots.position_mm != by_pixels.position_mm
    moved = np.subtract(by_pixels.position_mm or np.nan, by_dots.position_mm or np.nan)
    residuals = [dots_of(fix).residual_mm[dots_of(fix).inlier].mean(axis=0) for fix in (by_dots, by_pixels)]
    # near the image centre, where the turn moves nothing, all places move with the answer's
    assert residuals[1] - residuals[0] == pytest.approx(moved, abs=0.2 * np.abs(moved).max())
