"""What holds of localization for any frame: an answer or a clear refusal, right or not located, and nothing seen in noise."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tactape_fab import Localization, Localizer, Prior, TapeSpec
from tactape_fab.base.errors import FrameError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Scene, simulate
from tactape_fab.sense.simulation.dot_errors import DotErrors, Dots, dots_of
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray
from tests.thorough import some

TAPE = examine(TapeSpec(sector=7)).layout.tape
World = Literal["open", "closed"]
WORLDS: st.SearchStrategy[World] = st.sampled_from(get_args(World))
WIDTH_MM, HEIGHT_MM = (TAPE.columns - 1) * 1.5, (TAPE.rows - 1) * 1.5
quick = settings(deadline=None, derandomize=True, max_examples=60, suppress_health_check=[HealthCheck.too_slow])

ANY_VALUE = st.one_of(
    st.floats(width=64), st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e-310, 1e38, -1e38, 1e308, 255.0, 65535.0])
)
DTYPES = ["f2", "f4", "f8", "i1", "u1", "i2", "u2", "i4", "i8", "u8", "?", "c8", "U3", "O", "M8[s]", ">f4"]


@cache
def in_world(world: World) -> Localizer:
    """A localizer, made when a test first asks: it compiles the decoder where that was not done yet."""
    return Localizer([TAPE], world=world)


BOTH = WORLDS.map(in_world)


def is_right(fix: Localization, pose: tuple[float, float, float]) -> bool:
    if fix.position_mm is None or fix.theta_deg is None or fix.sector != TAPE.sector:
        return False
    turn = (fix.theta_deg - pose[2] + 180.0) % 360.0 - 180.0
    return bool(np.hypot(*(np.array(fix.position_mm) - pose[:2])) < 0.75 and abs(turn) < 10.0)


def check_answer(fix: Localization) -> None:
    """What every answer keeps, whatever was asked."""
    assert fix.status in ("none", "weak", "solid")
    assert (fix.reason is None) == fix.located
    assert fix.n_dots >= fix.n_agree >= 0
    for value in (fix.p_tape, fix.p_place, fix.p_false):
        assert value is None or 0.0 <= value <= 1.0
    if fix.located:
        assert fix.p_false is not None and fix.p_false <= 1e-4
        assert fix.covariance is not None and (np.linalg.eigvalsh(fix.covariance) > 0).all()
    else:
        assert fix.position_mm is None and fix.covariance is None and fix.tape is None


poses = st.tuples(st.floats(7.0, WIDTH_MM - 7.0), st.floats(7.0, HEIGHT_MM - 7.0), st.floats(-180.0, 180.0))


def contact(pose: tuple[float, float, float], seed: int, scene: Scene | None = None, errors: DotErrors | None = None) -> Dots:
    return dots_of(TAPE, pose, scene or Scene(), seed, errors or DotErrors())


# Frames


@quick
@given(
    shape=hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=40),
    dtype=st.sampled_from(DTYPES),
    data=st.data(),
)
def test_arrays_of_any_shape_and_type_are_refused_clearly(shape: tuple[int, ...], dtype: str, data: st.DataObject) -> None:
    frame = np.zeros(shape, dtype=dtype)
    if frame.size and dtype not in ("O", "M8[s]", "U3"):
        frame.flat[data.draw(st.integers(0, frame.size - 1))] = 1
    with pytest.raises(FrameError) as caught:
        in_world("open").locate(frame)
    assert len(str(caught.value)) > 20


@quick
@given(
    localizer=BOTH,
    dtype=st.sampled_from([d for d in DTYPES if d not in ("c8", "U3", "O", "M8[s]")]),
    seed=st.integers(0, 2**32 - 1),
)
def test_noise_of_any_type_is_never_located(localizer: Localizer, dtype: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    frame: npt.NDArray[Any] = rng.random((240, 320)) * rng.choice([1.0, 200.0, 6e4])
    kind = np.dtype(dtype)
    if kind.kind in "iu":
        frame = np.clip(frame, 0, np.iinfo(kind).max)
    fix = localizer.locate(frame.astype(kind))
    check_answer(fix)
    assert not fix.located


@quick
@given(world=WORLDS, values=st.lists(ANY_VALUE, min_size=1, max_size=6), seed=st.integers(0, 2**32 - 1), blocks=st.booleans())
@example(world="open", values=[np.nan], seed=0, blocks=False)
@example(world="open", values=[1e308, -1e308], seed=0, blocks=False)
@example(world="open", values=[0.0, 1e-310], seed=0, blocks=True)
def test_frames_of_any_values_have_an_answer(world: World, values: list[float], seed: int, blocks: bool) -> None:
    rng = np.random.default_rng(seed)
    picked = rng.integers(0, len(values), (15, 20) if blocks else (240, 320))
    frame = np.array(values)[np.kron(picked, np.ones((16, 16), dtype=np.int64)) if blocks else picked]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fix = in_world(world).locate(frame)
    check_answer(fix)
    assert not fix.located


@quick
@given(
    pose=poses,
    seed=st.integers(0, 1000),
    hole=st.tuples(st.integers(0, 239), st.integers(0, 319), st.integers(1, 120)),
    value=ANY_VALUE,
)
def test_a_spoilt_frame_is_right_or_not_located(
    pose: tuple[float, float, float], seed: int, hole: tuple[int, int, int], value: float
) -> None:
    frame = simulate(TAPE, pose[:2], pose[2], seed=seed).astype(np.float64)
    v, u, side = hole
    frame[v : v + side, u : u + side] = value
    fix = in_world("open").locate(frame)
    check_answer(fix)
    assert not fix.located or is_right(fix, pose)


@quick
@given(pose=poses, seed=st.integers(0, 1000), factor=st.floats(1e-6, 1e6), offset=st.floats(-1e3, 1e3))
@example(pose=(21.0, 35.0390625, 0.0), seed=364, factor=245575.0, offset=2.0)  # a tilt of 90 degrees, were it millimetres
def test_unit_and_zero_of_depth_do_not_matter(pose: tuple[float, float, float], seed: int, factor: float, offset: float) -> None:
    depth = simulate(TAPE, pose[:2], pose[2], seed=seed).astype(np.float64)
    fix = in_world("open").locate((depth + min(max(offset, -10.0), 10.0)) * factor)
    check_answer(fix)
    assert fix.located and is_right(fix, pose)


# Dots


@quick
@given(
    localizer=BOTH,
    xy=hnp.arrays(np.float64, st.tuples(st.integers(0, 80), st.just(2)), elements=st.floats(-1e6, 1e6)),
    data=st.data(),
)
def test_dots_anywhere_have_an_answer(localizer: Localizer, xy: FloatArray, data: st.DataObject) -> None:
    weights = data.draw(hnp.arrays(np.float64, len(xy), elements=st.floats(0.0, 100.0)))
    fix = localizer.locate_dots(xy, weights)
    check_answer(fix)
    assert not fix.located


@quick
@given(localizer=BOTH, count=st.integers(0, 120), seed=st.integers(0, 2**32 - 1), snapped=st.booleans())
def test_random_dots_are_never_located(localizer: Localizer, count: int, seed: int, snapped: bool) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform((0, 0), (319, 239), (count, 2))
    if snapped:  # on a grid of the right pitch, with random symbols
        cells = np.unique(np.rint(xy / 24.0), axis=0)
        xy = cells * 24.0 + 4.0 * DIRECTIONS_XY[rng.integers(0, 4, len(cells))] + rng.normal(0, 0.3, cells.shape)
    fix = localizer.locate_dots(xy)
    check_answer(fix)
    assert not fix.located


@settings(quick, max_examples=some(200))
@given(localizer=BOTH, pose=poses, seed=st.integers(0, 2**32 - 1))
def test_contacts_at_any_pose_are_right(localizer: Localizer, pose: tuple[float, float, float], seed: int) -> None:
    dots = contact(pose, seed)
    fix = localizer.locate_dots(dots.xy_px, dots.weights)
    check_answer(fix)
    assert fix.located and is_right(fix, pose)


@settings(quick, max_examples=some(200))
@given(localizer=BOTH, pose=poses, seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 1.0))
def test_wrong_symbols_are_right_or_not_located(
    localizer: Localizer, pose: tuple[float, float, float], seed: int, share: float
) -> None:
    """Dots of a true contact, some of them moved to another symbol's place of the same grid point."""
    rng = np.random.default_rng(seed)
    dots = contact(pose, seed)
    parts = np.flatnonzero(dots.part >= 0)
    flipped = parts[rng.random(len(parts)) < share]
    cells = TAPE.cells()[dots.part[flipped]]
    old = TAPE.symbols[cells[:, 1], cells[:, 0]]
    moved = (DIRECTIONS_XY[(old + rng.integers(1, 4, len(old))) % 4] - DIRECTIONS_XY[old]) * TAPE.displacement_mm * 16.0
    c, s = np.cos(np.radians(pose[2])), np.sin(np.radians(pose[2]))
    xy = dots.xy_px.copy()
    xy[flipped] += moved @ np.array([[c, s], [-s, c]])
    fix = localizer.locate_dots(xy, dots.weights)
    check_answer(fix)
    assert not fix.located or is_right(fix, pose)
    if len(flipped) <= 2:
        assert fix.located


@settings(quick, max_examples=some(200))
@given(
    localizer=BOTH,
    pose=poses,
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(2.0, 11.0),
    missing=st.floats(0.0, 0.8),
    bumps=st.integers(0, 12),
    sigma_px=st.floats(0.05, 2.5),
    scale=st.floats(-0.12, 0.12),
)
def test_bad_contacts_are_right_or_not_located(
    localizer: Localizer,
    pose: tuple[float, float, float],
    seed: int,
    size: float,
    missing: float,
    bumps: int,
    sigma_px: float,
    scale: float,
) -> None:
    scene = Scene(contact_mm=(size, size), missing=missing, bumps=bumps, scale_error=scale)
    dots = contact(pose, seed, scene, DotErrors(sigma_px=sigma_px))
    fix = localizer.locate_dots(dots.xy_px, dots.weights)
    check_answer(fix)
    assert not fix.located or is_right(fix, pose)


@settings(quick, max_examples=some(150))
@given(
    localizer=BOTH,
    pose=poses,
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(3.0, 9.0),
    x_mm=st.floats(-20.0, 120.0),
    y_mm=st.floats(-20.0, 80.0),
    theta_deg=st.floats(-720.0, 720.0),
    radius_mm=st.floats(0.0, 50.0),
    angle_deg=st.floats(0.0, 360.0),
)
def test_a_wrong_prior_does_not_deceive(
    localizer: Localizer, pose: tuple[float, float, float], seed: int, size: float,
    x_mm: float, y_mm: float, theta_deg: float, radius_mm: float, angle_deg: float,
) -> None:  # fmt: skip
    dots = contact(pose, seed, Scene(contact_mm=(size, size)))
    prior = Prior(position_mm=(x_mm, y_mm), theta_deg=theta_deg, radius_mm=radius_mm, angle_deg=angle_deg)
    fix = localizer.locate_dots(dots.xy_px, dots.weights, prior=prior)
    check_answer(fix)
    assert not fix.located or is_right(fix, pose)
    right = Prior(position_mm=(pose[0], pose[1]), theta_deg=pose[2])
    plain, helped = localizer.locate_dots(dots.xy_px, dots.weights), localizer.locate_dots(dots.xy_px, dots.weights, prior=right)
    assert helped.located or not plain.located or (plain.p_false or 0.0) > 2e-5


@quick
@given(pose=poses, seed=st.integers(0, 2**32 - 1))
def test_a_mirrored_contact_is_not_located(pose: tuple[float, float, float], seed: int) -> None:
    dots = contact(pose, seed)
    fix = in_world("open").locate_dots(dots.xy_px * (-1.0, 1.0) + (319.0, 0.0), dots.weights)
    check_answer(fix)
    assert not fix.located
