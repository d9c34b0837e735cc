"""The paper's method on whole frames: drawn here from the tape's own positions, simulated, and degenerate."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, cos, degrees, hypot, pi, radians, sin, sqrt
from time import thread_time
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localization, Tape, TapeSpec
from tactape_fab.base.errors import SpecError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense.decode.paper import PaperTrace, estimate_scale, locate_paper, locate_paper_dots, method
from tactape_fab.sense.decode.paper.dot_grid import turned
from tactape_fab.sense.decode.paper.preprocess import contact_dot
from tactape_fab.texture.frames import FloatArray, board_to_texture

TAPE = examine(TapeSpec(sector=7)).layout.tape
TEXTURE_MM = board_to_texture(TAPE.part_xy_mm(), TAPE.board.texture_origin_mm)
WIDTH, HEIGHT, R = 320, 240, 16.0
SIZE = (WIDTH, HEIGHT)
CENTRE = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])


def image_dots(position_mm: FloatArray, theta_rad: float, semi_mm: tuple[float, float], px_per_mm: float = R) -> FloatArray:
    """Image places of the parts inside an ellipse about the image centre: the mapping of the texture frame, solved for p."""
    x, y = (TEXTURE_MM - position_mm).T
    c, s = cos(theta_rad), sin(theta_rad)
    u, v = c * x - s * y, s * x + c * y
    inside = (u / semi_mm[0]) ** 2 + (v / semi_mm[1]) ** 2 < 1
    return np.asarray(np.stack([u, v], axis=1)[inside] * px_per_mm + CENTRE)


def poses(count: int, seed: int) -> list[tuple[FloatArray, float]]:
    rng = np.random.default_rng(seed)
    high = ((TAPE.columns - 1) * TAPE.pitch_mm - 7, (TAPE.rows - 1) * TAPE.pitch_mm - 7)
    return [(rng.uniform((7, 7), high), float(rng.uniform(-pi, pi))) for _ in range(count)]


def draw(dots: FloatArray, theta_rad: float, rng: np.random.Generator, size: tuple[int, int] = SIZE) -> FloatArray:
    """A depth map, mm: elongated bumps of 0201 bodies at 45 degrees, a dome and a tilt, white and correlated noise."""
    v, u = np.mgrid[: size[1], : size[0]]
    depth = 0.2 * np.exp(-((u - 150.0) ** 2 + (v - 110.0) ** 2) / 100.0**2) + 0.0005 * u
    angle = theta_rad - pi / 4  # image y is down
    along, across = (hypot(side / sqrt(12), 0.15) * R for side in (0.6, 0.3))
    for x, y in dots:
        a = (u - x) * cos(angle) + (v - y) * sin(angle)
        b = (v - y) * cos(angle) - (u - x) * sin(angle)
        depth += 0.06 * np.exp(-0.5 * ((a / along) ** 2 + (b / across) ** 2))
    fu, fv = np.fft.rfftfreq(size[0]), np.fft.fftfreq(size[1])[:, None]
    smooth = np.fft.irfft2(
        np.fft.rfft2(rng.normal(size=depth.shape)) * np.exp(-2 * (pi * 6) ** 2 * (fu**2 + fv**2)), s=depth.shape
    )
    return np.asarray(depth + 0.01 * smooth / smooth.std() + rng.normal(scale=0.004, size=depth.shape))


def is_right(fix: Localization, position_mm: FloatArray, theta_rad: float) -> bool:
    if fix.position_mm is None or fix.theta_deg is None:
        return False
    turn = (fix.theta_deg - degrees(theta_rad) + 180) % 360 - 180
    return hypot(*(np.array(fix.position_mm) - position_mm)) < TAPE.pitch_mm / 2 and abs(turn) < 10


# Whole frames


def test_error_free_dots_are_located_at_any_pose() -> None:
    right, angles, offsets = 0, [], []
    for position, theta in poses(300, seed=5):
        fix, _ = locate_paper_dots(image_dots(position, theta, (5.5, 4.5)), [TAPE], SIZE, px_per_mm=R)
        right += is_right(fix, position, theta)
        if fix.located:
            assert fix.theta_deg is not None and fix.position_mm is not None
            angles.append(abs((fix.theta_deg - degrees(theta) + 180) % 360 - 180))
            offsets.append(float(np.abs(np.array(fix.position_mm) - position).max()))
    print(f"right {right} of 300")
    assert right >= 297
    assert max(angles) < 1e-4
    assert max(offsets) < 1e-5


def test_every_field_of_an_answer() -> None:
    position, theta = np.array([20.0, 12.0]), radians(30.0)
    dots = image_dots(position, theta, (6.0, 6.0))
    fix, trace = locate_paper_dots(dots, [TAPE], SIZE, px_per_mm=R)
    assert fix.located and fix.status == "solid" and fix.reason is None
    assert (fix.tape, fix.sector) == (TAPE.name, 7)
    assert fix.position_mm == pytest.approx((20.0, 12.0), abs=1e-6)
    assert fix.theta_deg == pytest.approx(30.0, abs=1e-6)
    x0, y0 = TAPE.board.texture_origin_mm
    assert fix.board_mm == pytest.approx((x0 + 20.0, y0 - 12.0), abs=1e-6)
    assert fix.cell is not None and fix.index == (fix.cell[0] + TAPE.origin[0], fix.cell[1] + TAPE.origin[1])
    assert fix.contact_mm is not None
    assert np.hypot(*(TEXTURE_MM - fix.contact_mm).T).min() < 1e-6
    assert hypot(fix.contact_mm[0] - 20.0, fix.contact_mm[1] - 12.0) < 1.5
    assert (fix.px_per_mm, fix.n_dots, fix.n_agree) == (R, len(dots), 25)
    assert (fix.p_tape, fix.p_place, fix.p_false, fix.covariance) == (None, None, None, None)
    assert fix.elapsed_ms > 0
    assert trace.lost_at is None
    assert trace.chosen is not None and trace.slope_rad is not None
    assert degrees(trace.slope_rad) + 90 * trace.chosen.quarter_turns == pytest.approx(30.0, abs=1e-6)
    assert fix.to_mapping(0)["located"] is True


def test_a_texture_on_no_board_has_no_board_position() -> None:
    from tactape_fab.texture.board import Surface

    surface = Surface(source="cap.step", sha256="0" * 64, centre_mm=(0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), radius_mm=None)
    fix, _ = locate_paper_dots(
        image_dots(np.array([20.0, 12.0]), 0.0, (6.0, 6.0)), [replace(TAPE, surface=surface)], SIZE, px_per_mm=R
    )
    assert fix.located and fix.board_mm is None


def test_frames_with_noisy_dots() -> None:
    rng = np.random.default_rng(6)
    right = located = 0
    for position, theta in poses(50, seed=7):
        dots = image_dots(position, theta, (5.5, 4.5))
        fix, _ = locate_paper_dots(dots + rng.normal(scale=0.3, size=dots.shape), [TAPE], SIZE, px_per_mm=R)
        right += is_right(fix, position, theta)
        located += fix.located
    print(f"right {right}, wrong {located - right} of 50")
    assert right >= 35
    assert located - right <= 2


def test_depth_maps_of_the_default_scene() -> None:
    rng = np.random.default_rng(8)
    right = located = 0
    errors, times = [], []
    for position, theta in poses(30, seed=9):
        depth = draw(image_dots(position, theta, (5.5, 4.5)), theta, rng)
        start = thread_time()
        fix, _ = locate_paper(depth, [TAPE], px_per_mm=R)
        times.append(1e3 * (thread_time() - start))  # of the processor: other processes may be at work
        right += is_right(fix, position, theta)
        located += fix.located
        if fix.position_mm is not None:
            errors.append(float(np.hypot(*(np.array(fix.position_mm) - position))))
    print(f"right {right}, wrong {located - right} of 30, {1e3 * np.median(errors):.0f} um, {np.median(times):.1f} ms")
    assert right >= 25
    assert located - right <= 1
    assert np.median(errors) < 0.06
    assert min(times) < 20


@pytest.mark.parametrize(
    ("options", "least_right", "lost_at"),
    [({}, 21, None), ({"missing": 0.1}, 2, "symbols"), ({"contact_mm": (6.0, 6.0)}, 0, "detect")],
)
def test_simulated_frames_and_what_loses_them(options: dict[str, Any], least_right: int, lost_at: str | None) -> None:
    from tactape_fab.sense import Scene, iterate_frames

    right = 0
    steps: list[str] = []
    for frame in iterate_frames(TAPE, 24, 3, "gelsight-mini", Scene(**options)):
        fix, trace = locate_paper(frame.depth, [TAPE], px_per_mm=R)
        right += is_right(fix, frame.position_mm, radians(frame.theta_deg))
        steps += [] if trace.lost_at is None else [trace.lost_at]
    print(f"{options}: right {right} of 24, lost {sorted(steps)}")
    assert right >= least_right
    assert lost_at is None or steps.count(lost_at) >= 8


def test_a_frame_of_unknown_scale_is_tried_with_the_estimate() -> None:
    position, theta = np.array([50.0, 25.0]), 0.3
    depth = draw(image_dots(position, theta, (5.5, 4.5)), theta, np.random.default_rng(10))
    fix, trace = locate_paper(depth, [TAPE], px_per_mm=None)
    scale = estimate_scale(trace.dots_px, TAPE.pitch_mm, TAPE.displacement_mm)
    assert scale == fix.px_per_mm == pytest.approx(R, rel=0.08)


@pytest.mark.parametrize("px_per_mm", [None, 20.0])
def test_only_a_frame_of_unknown_scale_is_looked_at_twice(px_per_mm: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """First at the paper's own scale, and then at the one estimated."""
    dots, scales = image_dots(np.array([50.0, 25.0]), 0.3, (5.5, 4.5), 20.0), list[float]()

    def detect(depth: FloatArray, scale: float, body_mm2: float) -> FloatArray:
        scales.append(scale)
        assert body_mm2 == pytest.approx(0.6 * 0.3)
        return dots

    monkeypatch.setattr(method, "detect_dots", detect)
    locate_paper(np.zeros((240, 320)), [TAPE], px_per_mm=px_per_mm)
    assert scales == ([20.0] if px_per_mm else [16.0, estimate_scale(dots, TAPE.pitch_mm, TAPE.displacement_mm)])
    assert scales[-1] == pytest.approx(20.0, rel=0.05)


def test_several_tapes_of_several_codes() -> None:
    anoto = examine(TapeSpec(sector=7, code="anoto-6x6", name="anoto")).layout.tape
    other = examine(TapeSpec(sector=8)).layout.tape
    dots = image_dots(np.array([40.0, 20.0]), 1.0, (6.0, 6.0))
    fix, _ = locate_paper_dots(dots, [anoto, other, TAPE], SIZE, px_per_mm=R)
    assert fix.tape == TAPE.name
    fix, trace = locate_paper_dots(dots, [other], SIZE, px_per_mm=R)
    assert not fix.located and trace.lost_at == "bounds"


def test_the_6x6_code_is_read_with_windows_of_its_own_size() -> None:
    tape = examine(TapeSpec(sector=7, code="anoto-6x6", name="anoto")).layout.tape
    mm = board_to_texture(tape.part_xy_mm(), tape.board.texture_origin_mm) - (40.0, 20.0)
    dots = mm[np.hypot(*mm.T) < 9.0] * R + CENTRE
    fix, trace = locate_paper_dots(dots, [tape], SIZE, px_per_mm=R)
    assert fix.located and fix.position_mm == pytest.approx((40.0, 20.0), abs=1e-6)
    assert trace.symbols is not None and trace.symbols.shape == (7, 7)


# What is lost, and where


def lost(dots: Any, **options: Any) -> tuple[Localization, PaperTrace]:
    fix, trace = locate_paper_dots(dots, [TAPE], SIZE, **{"px_per_mm": R, **options})
    assert not fix.located
    assert fix.reason
    assert (fix.tape, fix.position_mm, fix.theta_deg, fix.index) == (None, None, None, None)
    return fix, trace


@pytest.mark.parametrize("count", [0, 1, 3, 15])
@pytest.mark.parametrize("px_per_mm", [R, None])
def test_too_few_dots_are_lost_at_once(count: int, px_per_mm: float | None) -> None:
    dots = image_dots(np.array([20.0, 12.0]), 0.0, (6.0, 6.0))[:count]
    fix, trace = lost(dots, px_per_mm=px_per_mm)
    assert trace.lost_at == "detect"
    assert fix.status == ("none" if count == 0 else "weak")
    assert fix.reason == f"dots found: {count}; the window of code 'microdots-4x4' needs 16, and more than 1000 are noise"


@pytest.mark.parametrize("px_per_mm", [R, None])
def test_degenerate_dots_are_lost_and_never_a_crash(px_per_mm: float | None) -> None:
    assert lost(np.full((30, 2), 100.0), px_per_mm=px_per_mm)[1].lost_at == "baseline"
    assert lost(np.full((30, 2), np.nan), px_per_mm=px_per_mm)[1].lost_at == "detect"
    assert lost(np.random.default_rng(17).uniform(0, 1e-200, (30, 2)), px_per_mm=px_per_mm)[1].lost_at == "baseline"
    assert lost(np.full((30, 2), 1e300), px_per_mm=px_per_mm)[1].lost_at == "detect"
    assert lost(np.random.default_rng(11).uniform(0, 240, (5000, 2)), px_per_mm=px_per_mm)[1].lost_at == "detect"
    line = np.stack([np.arange(30.0) * 24, np.zeros(30)], axis=1)
    assert lost(line, px_per_mm=px_per_mm)[1].lost_at in ("baseline", "grid")


def test_dots_on_the_bare_grid_have_no_line() -> None:
    cells = np.stack(np.meshgrid(np.arange(6), np.arange(6)), axis=-1).reshape(-1, 2)
    assert lost(cells * 24.0 + 50.0)[1].lost_at == "grid"


def test_a_contact_dot_without_neighbours_on_all_sides_has_no_window() -> None:
    dots = image_dots(np.array([20.0, 12.0]), 0.0, (8.0, 8.0))
    middle = np.hypot(*(dots - dots[contact_dot(dots)]).T)
    _, trace = lost(dots[(middle < 5) | (middle > 40)])
    assert trace.lost_at == "symbols"


def test_a_wrong_sign_is_seen_only_by_the_votes() -> None:
    """One wrong symbol in the middle reaches all four windows: they decode, and no two agree on a place of the tape."""
    right = 0
    for position, theta in poses(40, seed=12):
        dots = image_dots(position, theta, (6.0, 6.0))
        at = contact_dot(dots)
        nearest = np.hypot(*(TEXTURE_MM - (position + turned(dots[at] - CENTRE, theta) / R)).T).argmin()
        cell = TAPE.cells()[nearest]
        offset = TEXTURE_MM[nearest] - cell * TAPE.pitch_mm
        dots[at] += turned(-2 * offset * R, -theta)
        fix, trace = locate_paper_dots(dots, [TAPE], SIZE, px_per_mm=R)
        right += fix.located
        assert fix.located or trace.lost_at in ("decode", "bounds")
    assert right <= 4


@pytest.mark.parametrize(
    "depth",
    [
        np.zeros((240, 320)),
        np.full((240, 320), np.nan),
        np.full((240, 320), 3.0, dtype=np.float32),
        np.zeros((1, 1)),
        np.zeros((0, 320)),
        np.zeros(7),
        np.where(np.eye(240, 320) > 0, np.inf, 1e300),
        np.random.default_rng(13).normal(size=(240, 320)),
        np.random.default_rng(14).integers(0, 2**16, (240, 320), dtype=np.uint16),
    ],
)
@pytest.mark.parametrize("px_per_mm", [R, None, 1e-3, 1e4])
def test_frames_without_a_tape_are_not_located(depth: FloatArray, px_per_mm: float | None) -> None:
    fix, trace = locate_paper(depth, [TAPE], px_per_mm=px_per_mm)
    assert not fix.located
    assert trace.lost_at in ("detect", "baseline", "grid", "symbols", "decode", "bounds")


def test_missing_depth_inside_a_frame_is_no_obstacle() -> None:
    position, theta = np.array([50.0, 25.0]), -2.0
    depth = draw(image_dots(position, theta, (5.5, 4.5)), theta, np.random.default_rng(15))
    depth[:20], depth[:, :20] = np.nan, -np.inf
    fix, _ = locate_paper(depth, [TAPE], px_per_mm=R)
    assert is_right(fix, position, theta)


def test_the_same_frame_gives_the_same_answer() -> None:
    depth = draw(image_dots(np.array([50.0, 25.0]), 0.5, (5.5, 4.5)), 0.5, np.random.default_rng(16))
    first, second = (replace(locate_paper(depth, [TAPE], px_per_mm=R)[0], elapsed_ms=0.0).to_mapping(0) for _ in range(2))
    assert first == second


@pytest.mark.parametrize("px_per_mm", [0.0, -16.0, 1e-200, 1e200, float("nan"), float("inf")])
def test_a_scale_that_is_none_is_refused(px_per_mm: float) -> None:
    with pytest.raises(SpecError) as caught:
        locate_paper_dots(np.zeros((3, 2)), [], SIZE, px_per_mm=px_per_mm)
    assert [p.key for p in caught.value.problems] == ["tapes", "px_per_mm"]


def test_theta_grows_counter_clockwise_and_the_pattern_turns_clockwise() -> None:
    """At theta = 10 degrees the texture's x axis points down to the right in the image (v is down)."""
    dots = image_dots(np.array([20.0, 12.0]), radians(10), (6.0, 6.0))
    _, trace = locate_paper_dots(dots, [TAPE], SIZE, px_per_mm=R)
    assert trace.slope_rad == pytest.approx(radians(10), abs=1e-9)
    x_axis = turned(np.array([(1.0, 0.0)]), -radians(10))[0]
    assert degrees(atan2(x_axis[1], x_axis[0])) == pytest.approx(10.0)


def test_the_tape_is_not_changed() -> None:
    before = TAPE.symbols.copy()
    locate_paper_dots(image_dots(np.array([20.0, 12.0]), 0.0, (6.0, 6.0)), [TAPE], SIZE, px_per_mm=R)
    assert np.array_equal(TAPE.symbols, before)
    assert isinstance(TAPE, Tape)
