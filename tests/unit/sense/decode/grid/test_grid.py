"""The steps from a depth map to a pose, each against something worked out by hand or by enumeration."""

from __future__ import annotations

from math import cos, log, radians, sin

import numpy as np
import pytest
from scipy.special import ndtr

from tactape_fab import Tape, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.sense.decode.dots.detect import detect
from tactape_fab.sense.decode.grid.fit import fit_grid, posteriors
from tactape_fab.sense.decode.grid.lattice import find_lattices
from tactape_fab.sense.decode.rule import trusted
from tactape_fab.sense.decode.search.evidence import turned
from tactape_fab.texture.frames import FloatArray, IntArray

R, PITCH = 16.0, 24.0
DIRECTION = {"N": (0.0, -1.0), "S": (0.0, 1.0), "W": (-1.0, 0.0), "E": (1.0, 0.0)}


def bumps(at: FloatArray, height: float = 0.06, size: tuple[int, int] = (320, 240), sigma_px: float = 3.0) -> FloatArray:
    v, u = np.mgrid[: size[1], : size[0]]
    depth = np.zeros(u.shape)
    for x, y in at:
        depth += height * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * sigma_px**2))
    return depth


def found_near(xy: FloatArray, at: FloatArray) -> FloatArray:
    """Distance of the nearest dot from each true place."""
    return np.asarray(np.hypot(*(xy[None] - at[:, None]).transpose(2, 0, 1)).min(axis=1))


# Detection


def test_dots_have_their_sub_pixel_centres() -> None:
    at = np.array([(60.3, 50.0), (100.0, 80.4), (200.25, 120.75), (250.0, 200.0), (140.6, 180.2), (60.0, 150.9)])
    dots = detect(bumps(at).astype(np.float32), R)
    assert len(dots.weights) == len(at)
    assert found_near(dots.xy_px, at).max() < 0.05
    assert dots.weights == pytest.approx(np.ones(len(at)), abs=0.05)


def test_a_top_between_two_pixels_is_one_dot() -> None:
    at = np.array([(60.3, 50.0), (100.0, 80.5), (200.25, 120.75), (250.0, 200.0), (140.6, 180.2), (60.0, 150.9)])
    for bits in (8, 12, None):  # frames of whole numbers have tops of several equal pixels
        depth = bumps(at)
        dots = detect((depth if bits is None else np.rint(depth / depth.max() * 2**bits)).astype(np.float32), R)
        assert found_near(dots.xy_px, at).max() < 0.2
        assert len(dots.weights) == len(at), bits


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e6])
def test_the_unit_of_depth_and_a_smooth_background_do_not_matter(factor: float) -> None:
    at = np.array([(x + 0.3, y - 0.2) for x in range(70, 260, 30) for y in range(60, 200, 30)])
    v, u = np.mgrid[:240, :320]
    background = 0.3 * (1 - ((u - 160) / 400) ** 2 - ((v - 120) / 400) ** 2) + 0.001 * u + 5.0
    plain = detect(bumps(at).astype(np.float32), R)
    dots = detect(((bumps(at) + background) * factor).astype(np.float32), R)
    assert found_near(dots.xy_px, at).max() < 0.1
    near = np.hypot(*(dots.xy_px[:, None] - at[None]).transpose(2, 0, 1)).min(axis=1) < 1.0
    assert near.sum() == len(plain.weights) == len(at)


def test_low_dots_weigh_less_and_are_trusted_less() -> None:
    at = np.array([(60.0 + 36 * k, 60.0 + 40 * row) for row in range(4) for k in range(6)])
    depth = bumps(at) + bumps(np.array([(230.0, 200.0)]), 0.03)
    dots = detect(depth.astype(np.float32), R)
    low = int(np.hypot(*(dots.xy_px - (230.0, 200.0)).T).argmin())
    assert dots.weights[low] == pytest.approx(0.5, abs=0.05)
    assert (np.diff(trusted(np.linspace(0.0, 1.2, 50))) >= 0).all()
    assert trusted(np.array([0.0]))[0] < 0.01 and trusted(np.array([1.0]))[0] > 0.99


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 45.0, 90.0, 135.0])
def test_a_long_dot_says_which_way_it_lies(angle_deg: float) -> None:
    v, u = np.mgrid[:240, :320]
    along = (u - 160.2) * cos(radians(angle_deg)) + (v - 120.4) * sin(radians(angle_deg))
    across = (v - 120.4) * cos(radians(angle_deg)) - (u - 160.2) * sin(radians(angle_deg))
    dots = detect(np.exp(-0.5 * ((along / 4.0) ** 2 + (across / 3.0) ** 2)).astype(np.float32), R)
    assert dots.elongation is not None
    first = dots.elongation[int(dots.weights.argmax())]
    drawn = np.hypot(*first)
    assert 0.1 < drawn < 0.5
    assert -first / drawn == pytest.approx([cos(radians(2 * angle_deg)), sin(radians(2 * angle_deg))], abs=0.1)


def test_elongations_are_those_of_the_dots_beside_them() -> None:
    at = np.array([(60.0 + 36 * k, 60.0 + 40 * row) for row in range(4) for k in range(6)])
    v, u = np.mgrid[:240, :320]
    long_along_u = 0.05 * np.exp(-((u - 60) ** 2 / 40 + (v - 60) ** 2 / 18))
    dots = detect((bumps(at[1:]) + long_along_u).astype(np.float32), R)
    assert dots.elongation is not None and dots.elongation.shape == dots.xy_px.shape
    longest = int(np.hypot(*dots.elongation.T).argmax())
    assert np.hypot(*(dots.xy_px[longest] - at[0])) < 0.5
    assert dots.elongation[longest, 0] < -0.1


@pytest.mark.parametrize("value", [0.0, 1.0, -7.5, 1e30])
def test_a_constant_frame_has_no_dots(value: float) -> None:
    assert len(detect(np.full((240, 320), value, dtype=np.float32), R).weights) == 0


def test_level_ground_of_any_height_has_no_tops_of_rounding() -> None:
    at = np.array([(x, y) for x in range(70, 260, 30) for y in range(60, 200, 30)], dtype=np.float64)
    for level in (0.0, 5.1, 700.3):
        assert len(detect((bumps(at) + level).astype(np.float32), R).weights) == len(at)


def test_a_single_wild_pixel_hides_no_dots() -> None:
    at = np.array([(x + 0.3, y - 0.2) for x in range(70, 260, 30) for y in range(60, 200, 30)])
    for v, u in ((120, 160), (60, 80), (31, 17)):  # also those that the image's level is taken from
        depth = bumps(at)
        depth[v, u] = 1e8
        assert np.median(found_near(detect(depth.astype(np.float32), R).xy_px, at)) < 0.05


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 45.0, 110.0])
@pytest.mark.parametrize("height", [0.09, 0.15, 0.3])
def test_the_ridge_along_a_step_has_no_dots_and_hides_none(height: float, angle_deg: float) -> None:
    v, u = np.mgrid[:240, :320]
    c, s = cos(radians(angle_deg)), sin(radians(angle_deg))
    across, along = (u - 160) * c + (v - 120) * s, (v - 120) * c - (u - 160) * s
    at = np.array([(x + 0.3, y - 0.2) for x in range(40, 300, 24) for y in range(40, 220, 24)])
    at = at[(at - (160, 120)) @ (c, s) > 18.0]  # nearer no part stands to the outline: a body 1 mm from it
    uneven = 1.0 + 0.08 * np.cos(along / 9.0) * np.exp(-(along**2) / 60.0**2)  # so that the ridge has tops at all
    depth = bumps(at) + height * uneven * np.array(ndtr(across / 2.4))
    dots = detect(depth.astype(np.float32), R)
    assert len(dots.weights) == len(at)
    assert found_near(dots.xy_px, at).max() < 1.0
    assert 0.85 < np.median(dots.weights) < 1.1  # nor do its tops say how high a good dot is


def test_a_round_plateau_has_no_dots() -> None:
    v, u = np.mgrid[:240, :320]
    assert len(detect((0.3 * ndtr((80.0 - np.hypot(u - 160, v - 120)) / 2.4)).astype(np.float32), R).weights) == 0


def test_where_there_is_no_step_all_dots_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    tape = examine(TapeSpec(sector=7)).layout.tape
    frames = list(iterate_frames(tape, 40, scene=Scene(noise=1.5)))
    found = [detect(frame.depth, R) for frame in frames]
    monkeypatch.setattr("tactape_fab.sense.decode.dots.detect.STEP_TOPS", 10**6)
    for dots, frame in zip(found, frames, strict=True):
        assert np.array_equal(dots.xy_px, detect(frame.depth, R).xy_px)


# Grid


def grid_dots(angle: float, pitch: float, symbols: IntArray | None, origin: tuple[float, float] = (3.3, -1.7)) -> FloatArray:
    """Dots on a 7 x 6 grid, displaced by a sixth of the pitch where symbols are given: 0 to 3 turn from the first axis on."""
    k, row = np.meshgrid(np.arange(7), np.arange(6))
    at = np.stack([k.ravel() - 3, row.ravel() - 2.5], axis=1)
    if symbols is not None:
        at = at + np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])[symbols] / 6
    c, s = cos(angle) * pitch, sin(angle) * pitch
    return np.asarray(at @ np.array([[c, s], [-s, c]]) + origin)


@pytest.mark.parametrize("angle_deg", [0.0, 3.0, 30.0, 44.9, 45.0, 71.0, 89.5])
@pytest.mark.parametrize("stretch", [1.0, 0.95, 1.06])
def test_the_grid_is_found_at_any_angle_and_scale(angle_deg: float, stretch: float) -> None:
    symbols = np.random.default_rng(1).integers(0, 4, 42)
    xy = grid_dots(radians(angle_deg), PITCH * stretch, symbols)
    xy = xy - xy.mean(axis=0)
    best = find_lattices(xy, np.ones(42), PITCH, 0.07, 3)[0]
    turn = (np.degrees(best[0]) - angle_deg + 45) % 90 - 45
    assert abs(turn) < 1.0
    assert best[1] == pytest.approx(PITCH * stretch, rel=0.015)
    assert best[4] > 0.5


def test_undisplaced_dots_are_all_the_power_of_a_grid() -> None:
    xy = grid_dots(radians(20), PITCH, None)
    best = find_lattices(xy - xy.mean(axis=0), np.ones(42), PITCH, 0.0, 1)[0]
    assert best[4] == pytest.approx(1.0, abs=1e-3)
    assert np.degrees(best[0]) == pytest.approx(20.0, abs=0.1)
    noise = np.random.default_rng(2).uniform(-80, 80, (42, 2))
    assert find_lattices(noise - noise.mean(axis=0), np.ones(42), PITCH, 0.0, 1)[0][4] < 0.4


@pytest.mark.parametrize("origin", [(3.3, -1.7), (-7.0, 9.5), (0.5, 12.0)])
@pytest.mark.parametrize("angle_deg", [3.0, 20.7, 41.3, 70.0])
def test_an_exact_grid_is_found_exactly_wherever_its_origin_is(angle_deg: float, origin: tuple[float, float]) -> None:
    """The steps end at 0.16 of 2.5 degrees and of 0.07 of the pitch, and the parabola's top is far nearer."""
    angle, pitch, *_, share = find_lattices(
        grid_dots(radians(angle_deg), 1.03 * PITCH, None, origin), np.ones(42), PITCH, 0.07, 1
    )[0]
    assert np.degrees(angle) == pytest.approx(angle_deg, abs=1e-3) and pitch == pytest.approx(1.03 * PITCH, rel=3e-4)
    assert share == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("seed", range(8))
def test_the_grid_that_is_found_has_the_phases_and_the_power_of_plain_sums(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = grid_dots(rng.uniform(0.0, 1.5), PITCH * rng.uniform(0.95, 1.05), rng.integers(0, 4, 42)) + rng.normal(0, 0.5, (42, 2))
    xy, weights = xy - xy.mean(axis=0), rng.uniform(0.2, 1.0, 42)
    lattices = find_lattices(xy, weights, PITCH, 0.07, 3)
    assert len(lattices) >= 1
    for angle, pitch, phase_a, phase_b, share in lattices:
        c, s = cos(angle), sin(angle)
        a, b = (weights @ np.exp(2j * np.pi / pitch * (xy @ axis)) for axis in (np.array([c, s]), np.array([-s, c])))
        assert np.exp(1j * np.array([phase_a, phase_b])) == pytest.approx(np.array([a / abs(a), b / abs(b)]), abs=1e-8)
        assert share == pytest.approx((abs(a) ** 2 + abs(b) ** 2) / (2 * weights.sum() ** 2), abs=1e-9)


@pytest.mark.parametrize("angle_deg", [10.0, 60.0])
def test_displaced_dots_give_the_grid_and_their_symbols(angle_deg: float) -> None:
    symbols = np.random.default_rng(3).integers(0, 4, 42)
    angle = radians(angle_deg)
    xy = grid_dots(angle, PITCH * 1.01, symbols)
    middle = xy.mean(axis=0)
    ones = np.ones(42)
    lattice = find_lattices(xy - middle, ones, PITCH, 0.07, 1)[0]
    grid, nodes, squares, sigma, *_ = fit_grid(
        xy - middle, ones, ones, lattice[0], lattice[1], lattice[2], lattice[3], 1 / 6, True
    )
    assert np.hypot(grid[0], grid[1]) == pytest.approx(PITCH * 1.01, rel=1e-6)
    turn = round((np.degrees(np.arctan2(grid[1], grid[0])) - angle_deg) / 90)
    assert ((squares.argmin(axis=1) + turn) % 4 == symbols).all()
    assert squares.min(axis=1).max() < 1e-9
    assert len(np.unique(nodes, axis=0)) == 42
    assert sigma == pytest.approx(0.012)
    q = posteriors(nodes, squares, ones, ones, sigma)
    assert q.sum(axis=1) == pytest.approx(ones)
    assert q.max(axis=1).min() > 0.99


def test_a_dot_between_grid_points_is_no_overflow() -> None:
    shift, rng = 0.24, np.random.default_rng(3)
    k, row = np.divmod(np.arange(42), 6)
    across = np.array([(0.0, -shift), (-shift, 0.0), (shift, 0.0), (0.0, shift)])[rng.integers(0, 4, 42)]
    at = np.concatenate([np.stack([k - 3.0, row - 2.5], axis=1) + across, [(0.49, -0.5)]])  # half a pitch from all four places
    ones = np.ones(43)
    grid, nodes, squares, sigma, *_ = fit_grid(at * PITCH, ones, ones, 0.0, PITCH, 0.0, np.pi, shift, True)
    assert sigma == pytest.approx(0.012) and np.hypot(grid[0], grid[1]) == pytest.approx(PITCH, rel=1e-6)
    assert np.isfinite(posteriors(nodes, squares, ones, ones, sigma)).all()


def test_the_pitch_stays_where_the_scale_is_fixed() -> None:
    symbols = np.random.default_rng(3).integers(0, 4, 42)
    xy = grid_dots(0.2, PITCH * 1.01, symbols)
    lattice = find_lattices(xy - xy.mean(axis=0), np.ones(42), PITCH, 0.0, 1)[0]
    grid, *_ = fit_grid(xy - xy.mean(axis=0), np.ones(42), np.ones(42), lattice[0], PITCH, lattice[2], lattice[3], 1 / 6, False)
    assert np.hypot(grid[0], grid[1]) == pytest.approx(PITCH, rel=1e-9)


def test_dots_that_say_nothing_have_even_posteriors() -> None:
    squares = np.array([[0.0, 0.05, 0.1, 0.05], [0.2, 0.2, 0.2, 0.2], [0.0, 0.05, 0.1, 0.05]])
    nodes = np.array([(0, 0), (1, 0), (2, 0)])
    q = posteriors(nodes, squares, np.ones(3), np.array([1.0, 1.0, 0.0]), 0.03)
    assert q[0, 0] > 0.98
    assert q[1] == pytest.approx([0.25] * 4)
    assert q[2] == pytest.approx([0.25] * 4)
    rim = posteriors(nodes[:1], squares[:1], np.array([0.3]), np.ones(1), 0.03)
    assert 0.25 < rim[0, 0] < q[0, 0]


@pytest.mark.parametrize("second", [0.9, 1.0])
def test_the_bits_of_a_grid_point_are_tossed_once(second: float) -> None:
    """Two dots at one grid point: the mean of E over its four symbols is still 1, which the bound rests on."""
    squares = np.array([[0.0, 0.05, 0.1, 0.05], [0.001, 0.05, 0.1, 0.05], [0.0, 0.05, 0.1, 0.05]])
    nodes = np.array([(3, 4), (3, 4), (3, 5)])
    q = posteriors(nodes, squares, np.array([1.0, second, 1.0]), np.ones(3), 0.03)
    assert np.prod(4 * q[:2], axis=0).mean() == pytest.approx(1.0)
    assert q[0, 0] > 0.9 and q[2, 0] > 0.9


def test_few_dots_find_their_grid_from_a_start_half_a_displacement_off() -> None:
    """What displacements at random do to the first harmonic of a few dots: the grid seems shifted and turned."""
    rng = np.random.default_rng(4)
    right = tried = 0
    for _ in range(40):
        symbols = rng.integers(0, 4, 9)
        points = np.array([(k, m) for k in range(3) for m in range(3)], dtype=np.float64)
        steps = np.array([DIRECTION[c] for c in "ESWN"])[symbols] / 6
        xy = PITCH * (points + steps) + rng.normal(0.0, 0.3, (9, 2))
        middle = xy.mean(axis=0)
        phases = -2 * np.pi * (middle / PITCH + (0.08, -0.08))
        _, _, squares, *_ = fit_grid(xy - middle, np.ones(9), np.ones(9), 0.04, PITCH, phases[0], phases[1], 1 / 6, True)
        right += int((squares.argmin(axis=1) == symbols).all())
        tried += 1
    assert right >= 0.95 * tried


# Places


@pytest.fixture(scope="module")
def small_tape() -> Tape:
    return examine(TapeSpec(sector=100, size_mm=(30.0, 22.0), holes_mm=[(20.0, 10.0, 1.0)])).layout.tape


def random_contact(seed: int, n: int = 14) -> tuple[IntArray, FloatArray]:
    """Nodes and posteriors of a made-up contact."""
    rng = np.random.default_rng(seed)
    nodes = np.stack([rng.permutation(20)[:n] % 5, rng.permutation(20)[:n] // 5], axis=1).astype(np.int64)
    return nodes, rng.dirichlet(np.full(4, 0.3), n)


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_evidence_is_that_of_the_bits_of_the_turned_symbols(turn: int) -> None:
    nodes, q = random_contact(turn)
    cells, evidence = np.empty_like(nodes), np.empty((len(q), 3))
    turned(nodes, q, turn, cells, evidence)
    # the texture's x axis is the grid's first axis turned `turn` times from u towards v
    axes = [(1, 0), (0, 1), (-1, 0), (0, -1)]
    x_axis, y_axis = np.array(axes[turn]), np.array(axes[(turn + 1) % 4])
    assert (cells == np.stack([nodes @ x_axis, nodes @ y_axis], axis=1)).all()
    for i in range(len(q)):
        p = {"ESWN"[(k - turn) % 4]: q[i, k] for k in range(4)}
        x = {1: p["W"] + p["S"], 0: p["N"] + p["E"]}
        y = {1: p["E"] + p["S"], 0: p["N"] + p["W"]}
        for a in (0, 1):
            for b in (0, 1):
                score = evidence[i, 0] + (2 * a - 1) * evidence[i, 1] + (2 * b - 1) * evidence[i, 2]
                assert score == pytest.approx(log(2 * x[a]) + log(2 * y[b]))
