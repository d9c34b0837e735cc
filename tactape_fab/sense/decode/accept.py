"""A place -> an answer, or the reason why there is none: bounds on being wrong, the pose, and what is said of both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import degrees, exp, log
from typing import Any

import numpy as np

from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.grid.pose import Pose, fit_pose
from tactape_fab.sense.decode.rank import Reading, View
from tactape_fab.sense.decode.result import Localization
from tactape_fab.sense.decode.search.hypotheses import Registry
from tactape_fab.sense.decode.search.plane import CodePlane, PlanePlace
from tactape_fab.sense.decode.search.search import LEAST_DOTS, Place, rivals, strangers
from tactape_fab.texture.frames import DIRECTIONS_XY, BoolArray, FloatArray, IntArray, SymbolArray, texture_to_board

_PLACES = 1e6
"""Rivals are named where they are as sure as an answer would have to be among so many places."""
_BY_CHANCE = 1e-5
"""What p_tape may be, of all that p_false may be, where a tape that only looks like ours by chance need not be thought of."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What an answer has to keep.

    Attributes
    ----------
    max_p_false : float
        Largest bound on being wrong.
    max_p_tape : float or None
        Largest bound on the texture being none of ours; part of `max_p_false` where None.
    kappa : float
        Least lead, as a factor, over any single other place.
    """

    max_p_false: float
    max_p_tape: float | None
    kappa: float

    @property
    def precision(self) -> float:
        """What p_place may be too large by where that matters."""
        return self.max_p_false / 10.0

    @property
    def on_tape(self) -> float:
        """Largest p_tape that may do."""
        return self.max_p_false if self.max_p_tape is None else self.max_p_tape


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Doubt:
    """p_place, the lead (ln) over the next place, and the unregistered tape that fits at least as well."""

    p_place: float
    lead: float
    unregistered: str | None


def judge(
    empty: Localization, dots: Dots, reading: Reading, view: View, world: Registry | CodePlane, limits: Limits
) -> tuple[Localization, bool]:
    """The answer that a reading gives, and whether a tape that nobody registered explains the dots instead.

    Parameters
    ----------
    empty : Localization
        What is known of the contact without it.
    """
    place = reading.place
    inside, symbols = _on_tape(place, world)
    p_tape = exp(min(-reading.ln_bound, 0.0))
    doubt = _doubt(place, world, limits, p_tape)
    said: dict[str, Any] = {"p_tape": p_tape, "p_place": doubt.p_place, "p_false": min(1.0, p_tape + doubt.p_place)}
    other = doubt.unregistered is not None
    if inside.sum() < LEAST_DOTS:
        seen = "too few dots lie on a tape" if doubt.unregistered is None else _stranger(doubt.unregistered)
        return replace(empty, reason=seen, **said), other
    cells = place.cells[inside]
    nominal = cells * view.pitch_mm + view.displacement_mm * DIRECTIONS_XY[symbols]
    offset = dots.xy_px[inside] - view.centre_px
    weights = dots.weights[inside] * dots.trust[inside]
    pose = fit_pose(offset, nominal, weights, view.px_per_mm, fixed_scale=view.scale_tolerance == 0.0)
    if not (np.isfinite(pose.position_mm).all() and np.isfinite(pose.covariance).all() and np.isfinite(pose.px_per_mm)):
        return replace(empty, reason="the dots give no pose", **said), other
    said["n_agree"] = agree = int(pose.agree.sum())
    reason = _refusal(p_tape, doubt, limits, agree, int((dots.trust[inside] > 0.5).sum()))
    if reason is not None:
        return replace(empty, reason=reason, **said), other
    middle = dots.trust @ dots.xy_px / dots.trust.sum() - view.centre_px
    nearest = np.flatnonzero(pose.agree)[np.hypot(*(offset[pose.agree] - middle).T).argmin()]
    return replace(empty, located=True, **said, **_described(place, world, cells[nearest], nominal[nearest], pose)), False


def _on_tape(place: Place | PlanePlace, world: Registry | CodePlane) -> tuple[BoolArray, SymbolArray]:
    """Which dots lie on a part of the answer's tape (n,), and the symbols there (k,)."""
    cells = place.cells
    if isinstance(place, PlanePlace) or isinstance(world, CodePlane):
        assert isinstance(place, PlanePlace)
        return np.ones(len(cells), dtype=bool), (place.x_bits + 2 * place.y_bits).astype(np.uint8)
    tape = world.tapes[place.tape]
    column, row = cells.T
    inside: BoolArray = (column >= 0) & (column < tape.columns) & (row >= 0) & (row < tape.rows)
    if len(tape.omitted):
        inside[inside] = tape.placed[cells[inside, 1], cells[inside, 0]]
    return inside, tape.symbols[cells[inside, 1], cells[inside, 0]]


def _doubt(place: Place | PlanePlace, world: Registry | CodePlane, limits: Limits, p_tape: float) -> _Doubt:
    """The answer held against all other places, those of tapes that nobody registered among them.

    Where p_tape refuses the answer already, these only count if one of them is to be named.
    """
    registered = _Doubt(p_place=place.others / (1.0 + place.others), lead=place.lead, unregistered=None)
    if isinstance(place, PlanePlace) or isinstance(world, CodePlane) or world.unregistered_share == 0.0:
        return registered
    clear, refused = log(_PLACES) - log(limits.max_p_false), p_tape > limits.on_tape
    if refused and place.most_said < clear:
        return registered
    if refused:
        found = strangers(world.families, place, world.unregistered_share, clear)
    else:
        chance = p_tape > _BY_CHANCE * limits.max_p_false
        found = rivals(world.families, place, world.unregistered_share, limits.precision, log(limits.kappa), beyond=chance)
    sure = found.score > clear and found.lead < log(limits.kappa)
    if refused and not sure:
        return registered
    weight = place.others + found.weight
    return _Doubt(p_place=weight / (1.0 + weight), lead=min(place.lead, found.lead), unregistered=found.name if sure else None)


def _stranger(name: str) -> str:
    return f"looks like {name}, which is not registered"


def _refusal(p_tape: float, doubt: _Doubt, limits: Limits, agree: int, good: int) -> str | None:
    """Why an answer cannot be trusted; None where it can. Of the good dots so many agree."""
    p_place, p_false = doubt.p_place, min(1.0, p_tape + doubt.p_place)
    if doubt.unregistered is not None:
        return _stranger(doubt.unregistered)
    if limits.max_p_tape is None and not p_false <= limits.max_p_false:
        what = "may be no tape of ours" if p_tape > p_place else "several places fit"
        return f"{what}: p_false {p_false:.1e} exceeds {limits.max_p_false:.1e}"
    if limits.max_p_tape is not None and p_tape > limits.max_p_tape:
        return f"may be no tape of ours: p_tape {p_tape:.1e} exceeds {limits.max_p_tape:.1e}"
    if not p_place <= limits.max_p_false:
        return f"several places fit: p_place {p_place:.1e} exceeds {limits.max_p_false:.1e}"
    if not doubt.lead >= log(limits.kappa):
        return f"another place fits nearly as well: it leads by a factor of {exp(doubt.lead):.1f}, less than {limits.kappa:g}"
    if agree < max(LEAST_DOTS, good // 2):
        return f"only {agree} of {good} dots agree with the place that their symbols name"
    return None


def _described(
    place: Place | PlanePlace, world: Registry | CodePlane, cell: IntArray, contact: FloatArray, pose: Pose
) -> dict[str, Any]:
    """The answer in words of the tape; `cell` and `contact` of the dot nearest the contact's middle."""
    column, row = (int(v) for v in cell)
    position_mm = (float(pose.position_mm[0]), float(pose.position_mm[1]))
    theta_deg = degrees(pose.theta_rad)
    found = {
        "theta_deg": 180.0 if theta_deg <= -180.0 else theta_deg,
        "px_per_mm": float(pose.px_per_mm),
        "covariance": pose.covariance,
    }
    if isinstance(place, PlanePlace) or isinstance(world, CodePlane):
        assert isinstance(place, PlanePlace)
        return {**found, "sector": place.sector, "index": (column, row), "plane_mm": position_mm}
    tape = world.tapes[place.tape]
    board = None if tape.surface is not None else texture_to_board(pose.position_mm, tape.board.texture_origin_mm)
    return {
        **found,
        "tape": tape.name,
        "sector": tape.sector,
        "position_mm": position_mm,
        "board_mm": None if board is None else (float(board[0]), float(board[1])),
        "contact_mm": (float(contact[0]), float(contact[1])),
        "cell": (column, row),
        "index": (tape.origin[0] + column, tape.origin[1] + row),
    }
