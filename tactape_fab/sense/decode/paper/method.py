"""The whole pipeline of the paper, from a depth map or from dots, and the trace of where a frame was lost."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import degrees, pi
from typing import Literal

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, refuse
from tactape_fab.sense.decode.paper.dot_grid import find_baseline, find_grid, read_symbols, turned
from tactape_fab.sense.decode.paper.preprocess import REFERENCE_PX_PER_MM, contact_dot, detect_dots, estimate_scale
from tactape_fab.sense.decode.paper.windows_read import (
    Reading,
    agreeing,
    choose,
    contact_position_mm,
    on_tape,
    read_windows,
)
from tactape_fab.sense.decode.result import Localization, status_of
from tactape_fab.texture.code import ALL_CODE_NAMES, CODE_NAMES, get_plane, has_plane
from tactape_fab.texture.frames import FloatArray, IntArray, texture_to_board
from tactape_fab.texture.tape import Tape

LostAt = Literal["detect", "baseline", "grid", "symbols", "decode", "bounds"]
MOST_DOTS = 1000
"""Most dots: more than in any sensor's field are noise, refused before n x n distances are built."""
_LEAST_SCALE, _MOST_SCALE = 1e-3, 1e6  # px/mm

_REASONS: dict[LostAt, str] = {
    "detect": "dots found: {n}; the window of code '{code}' needs {least}, and more than {most} are noise",
    "baseline": "no line through the contact dot fits the grid's spacing",
    "grid": "no two dot coordinates are one displacement apart, so no grid line is known",
    "symbols": "no whole {side}x{side} window of symbols around the contact dot",
    "decode": "the windows around the contact dot decode to no one place",
    "bounds": "the windows decode to places that lie on no registered tape",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PaperTrace:
    """Result of each step of the paper's method for one frame.

    dots_px (n, 2)
    contact_dot: Index of the contact dot (Eq. 3).
    slope_rad: theta_slope (Eq. 5), in [-pi/4, pi/4].
    symbols (side, side): Symbols around the contact dot as read, before theta_A; -1 where missing.
    lost_at {"detect", "baseline", "grid", "symbols", "decode", "bounds"}: The step that failed; None if the frame is located.
    """

    dots_px: FloatArray
    contact_dot: int | None = None
    slope_rad: float | None = None
    symbols: IntArray | None = None
    chosen: Reading | None = None
    lost_at: LostAt | None = None


def grid_px(pitch_mm: float, displacement_mm: float, px_per_mm: float) -> tuple[float, float]:
    """Grid width w and displacement delta in the image, px (Eq. 13)."""
    return pitch_mm * px_per_mm, displacement_mm * px_per_mm


def sensor_position_mm(
    contact_mm: tuple[float, float], dot_px: npt.ArrayLike, image_size: tuple[float, float], px_per_mm: float, theta_rad: float
) -> tuple[float, float]:
    """S, the texture point under the image centre, mm (Eq. 11 and 12).

    Reading: the paper's ``(width / 2, height / 2)`` counts from the frame's corner; here integer pixels are their
    centres, so that the centre is ``((width - 1) / 2, (height - 1) / 2)``.

    contact_mm: C, texture frame.
    dot_px (2,): The contact dot (u, v).
    image_size: Width and height, px.
    theta_rad: Turn of the sensor on the tape, counter-clockwise seen from above.
    """
    width, height = image_size
    t_px = np.array([(width - 1) / 2, (height - 1) / 2]) - np.asarray(dot_px, dtype=np.float64)
    x, y = (np.asarray(contact_mm) + turned(t_px, theta_rad) / px_per_mm).tolist()
    return x, y


def locate_paper(depth: npt.ArrayLike, tapes: Sequence[Tape], *, px_per_mm: float | None) -> tuple[Localization, PaperTrace]:
    """Locate one frame by the paper's method.

    depth (h, w): Canonical depth map: larger is deeper, not mirrored, square pixels.
    tapes: The registry. Tapes of different code, W or Delta are tried one kind after the other; the kind whose place most windows
        read is the answer.
    px_per_mm: R. None estimates it from the dots (Eq. 14-16), which are looked for with the paper's R first.
    Returns (Localization, PaperTrace): ``located`` is the paper's own verdict: bounds on being wrong and covariance stay None.
    Raises SpecError if `tapes` is empty or `px_per_mm` is not a valid scale.
    """
    start = time.perf_counter()
    _check(tapes, px_per_mm)
    array = np.asarray(depth, dtype=np.float64)
    answers = []
    for kind in _kinds(tapes):
        tape = kind[0]
        body_mm2 = tape.part.body_mm[0] * tape.part.body_mm[1]
        scale = REFERENCE_PX_PER_MM if px_per_mm is None else px_per_mm
        dots = detect_dots(array, scale, body_mm2)
        if px_per_mm is None:
            # dots are looked for a second time: mean filter and least area follow from the scale
            scale = _scale(dots, tape) or scale
            dots = detect_dots(array, scale, body_mm2)
        size = (array.shape[1], array.shape[0]) if array.ndim == 2 else (1, 1)
        answers.append(_locate(dots, kind, size, px_per_mm))
    return _best(answers, start)


def locate_paper_dots(
    xy_px: npt.ArrayLike, tapes: Sequence[Tape], image_size: tuple[float, float], *, px_per_mm: float | None
) -> tuple[Localization, PaperTrace]:
    """Locate a frame from its dots, by the paper's method; see `locate_paper`.

    xy_px (n, 2): Dots (u, v), px; those that are not finite are dropped.
    image_size: Width and height, px.
    """
    start = time.perf_counter()
    _check(tapes, px_per_mm)
    dots = np.asarray(xy_px, dtype=np.float64).reshape(-1, 2)
    dots = dots[(np.abs(dots) < 1e9).all(axis=1)]
    return _best([_locate(dots, kind, image_size, px_per_mm) for kind in _kinds(tapes)], start)


_PLANELESS_CODES = " or ".join(f"'{name}'" for name in ALL_CODE_NAMES if name not in CODE_NAMES)
PLANELESS = (
    f"method 'paper' reads windows of a code's plane, which {_PLANELESS_CODES} has not; use method='ml', or tapes of another code"
)


def _check(tapes: Sequence[Tape], px_per_mm: float | None) -> None:
    problems = []
    if not tapes:
        problems.append(Problem("tapes", "tapes is empty; give at least one tape to look for"))
    if not all(has_plane(tape.code) for tape in tapes):
        problems.append(Problem("method", PLANELESS))
    if px_per_mm is not None and not _LEAST_SCALE <= px_per_mm <= _MOST_SCALE:
        message = f"px_per_mm = {px_per_mm} px/mm is not from {_LEAST_SCALE:g} to {_MOST_SCALE:g}; give the sensor's"
        problems.append(Problem("px_per_mm", message))
    refuse(problems)


def _kinds(tapes: Sequence[Tape]) -> list[list[Tape]]:
    """Tapes by code, W and Delta, in the order of their first ones."""
    kinds: dict[tuple[str, float, float], list[Tape]] = {}
    for tape in tapes:
        kinds.setdefault((tape.code, tape.pitch_mm, tape.displacement_mm), []).append(tape)
    return list(kinds.values())


def _scale(dots: FloatArray, tape: Tape) -> float | None:
    """Scale from Eq. 14-16, px/mm, if there are enough dots and the result is a valid scale."""
    scale = estimate_scale(dots, tape.pitch_mm, tape.displacement_mm) if len(dots) <= MOST_DOTS else None
    return scale if scale is not None and _LEAST_SCALE <= scale <= _MOST_SCALE else None


def _best(answers: list[tuple[Localization, PaperTrace]], start: float) -> tuple[Localization, PaperTrace]:
    """The located answer that most windows read, else the first."""
    fix, trace = max(answers, key=lambda a: (a[0].located, a[1].chosen.windows if a[1].chosen else 0))
    return replace(fix, elapsed_ms=(time.perf_counter() - start) * 1e3), trace


def _locate(
    dots: FloatArray, tapes: Sequence[Tape], image_size: tuple[float, float], px_per_mm: float | None
) -> tuple[Localization, PaperTrace]:
    """The pipeline after the dots, for tapes of one code, W and Delta."""
    tape = tapes[0]
    code = get_plane(tape.code)
    trace = PaperTrace(dots_px=dots)
    if not code.window**2 <= len(dots) <= MOST_DOTS:
        return _lost(trace, "detect", tape, px_per_mm)
    scale = _scale(dots, tape) if px_per_mm is None else px_per_mm
    contact = contact_dot(dots)
    trace = replace(trace, contact_dot=contact)
    if scale is None:
        return _lost(trace, "baseline", tape, None)
    w_px, delta_px = grid_px(tape.pitch_mm, tape.displacement_mm, scale)
    slope = find_baseline(dots, contact, w_px, delta_px)
    if slope is None:
        return _lost(trace, "baseline", tape, scale)
    # about the contact dot, so that turning rounds near 0 and the contact dot is the origin
    upright = turned(dots - dots[contact], slope)
    point = find_grid(upright, contact, delta_px)
    trace = replace(trace, slope_rad=slope)
    if point is None:
        return _lost(trace, "grid", tape, scale)
    symbols = read_symbols(upright, contact, point, w_px, delta_px, code.window + 1)
    trace = replace(trace, symbols=symbols)
    if not (np.lib.stride_tricks.sliding_window_view(symbols, (code.window,) * 2) >= 0).all(axis=(2, 3)).any():
        return _lost(trace, "symbols", tape, scale)
    chosen, lost_at = choose(code, read_windows(code, symbols), tapes)
    trace = replace(trace, chosen=chosen)
    if chosen is None:
        return _lost(trace, lost_at, tape, scale)
    return _answer(trace, chosen, tapes, image_size, scale), trace


def _lost(trace: PaperTrace, lost_at: LostAt, tape: Tape, scale: float | None) -> tuple[Localization, PaperTrace]:
    side = get_plane(tape.code).window
    n = len(trace.dots_px)
    reason = _REASONS[lost_at].format(n=n, code=tape.code, least=side**2, most=MOST_DOTS, side=side)
    fix = Localization(status=status_of(n), located=False, reason=reason, px_per_mm=scale, n_dots=n)
    return fix, replace(trace, lost_at=lost_at)


def _answer(
    trace: PaperTrace, chosen: Reading, tapes: Sequence[Tape], image_size: tuple[float, float], scale: float
) -> Localization:
    """The paper's output of a decoded frame: S_ID, S, theta, C and the status (section III-B.2)."""
    assert trace.contact_dot is not None and trace.slope_rad is not None and trace.symbols is not None
    code = get_plane(tapes[0].code)
    tape = on_tape(chosen, code, tapes)
    assert tape is not None
    theta_rad = trace.slope_rad + chosen.quarter_turns * pi / 2  # Eq. 5
    # to (-pi, pi]
    theta_rad -= 2 * pi * np.ceil((theta_rad - pi) / (2 * pi))
    contact_mm = contact_position_mm(chosen, tape.origin, tape.pitch_mm, tape.displacement_mm)
    position_mm = sensor_position_mm(contact_mm, trace.dots_px[trace.contact_dot], image_size, scale, theta_rad)
    board_mm = None
    if tape.surface is None:
        x, y = texture_to_board(position_mm, tape.board.texture_origin_mm).tolist()
        board_mm = (x, y)
    return Localization(
        status=status_of(len(trace.dots_px)),
        located=True,
        sector=chosen.sector,
        theta_deg=degrees(theta_rad),
        index=chosen.index,
        px_per_mm=scale,
        n_dots=len(trace.dots_px),
        n_agree=agreeing(code, chosen, trace.symbols),
        tape=tape.name,
        position_mm=position_mm,
        board_mm=board_mm,
        contact_mm=contact_mm,
        cell=(chosen.index[0] - tape.origin[0], chosen.index[1] - tape.origin[1]),
    )
