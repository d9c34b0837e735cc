"""Acceptance of a place: an answer or the reason of refusal, from p_tape, p_place and the pose against `rule.Limits`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import cos, degrees, exp, log, sin
from typing import Any

import numpy as np

from tactape_fab.sense.decode.contact.edge import off_edge
from tactape_fab.sense.decode.contact.surface import ContactView, contact_surface
from tactape_fab.sense.decode.contact.tilted import USUAL_PART_MM, tilted_pose
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.elongation import parity_log_ratio
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.grid.displaced import displaced
from tactape_fab.sense.decode.grid.pose import Pose, fit_pose
from tactape_fab.sense.decode.located_dots import LazyDots, located_dots, strain_of
from tactape_fab.sense.decode.pixels.refine import Pixels, refine
from tactape_fab.sense.decode.rank import Reading, View
from tactape_fab.sense.decode.result import Localization, status_of
from tactape_fab.sense.decode.rule import (
    GOOD_TRUST,
    LEAST_DOTS,
    MOST_ACROSS,
    SCALE_ERROR,
    Limits,
    bound_of,
    least_agreeing,
    share_of_others,
)
from tactape_fab.sense.decode.search.hypotheses import Registry
from tactape_fab.sense.decode.search.plane import CodePlane, PlanePlace
from tactape_fab.sense.decode.search.rivals import best_unregistered, rivals
from tactape_fab.sense.decode.search.search import Place
from tactape_fab.sense.decode.search.single_place import parts_under
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import DIRECTIONS_XY, BoolArray, FloatArray, IntArray, texture_to_board
from tactape_fab.texture.tape import Tape

_PLACES = 1e6
"""An unregistered tape is named in a reason where E of its place exceeds this / max_p_false: it would be accepted itself, were
there so many registered places of even weight. 256 tapes of the default size have 2e6 places in four turns."""
_BY_CHANCE = 1e-5
"""Share of max_p_false. Where p_tape is below it, chance does not explain the dots; nor can an unregistered tape at its default
origin by its edge, where dots beyond it may be anything."""
NOT_REGISTERED = "which is not registered"
_TILTED = "the contact is tilted or bent: its pressure falls across the parts, which the dots' heights tell and pixels do not"
_ON_FLANK = "the tape is bent away from under the image centre, so that no place is under it; press nearer to the image's middle"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Doubt:
    """p_place, ln of the lead over the next place, and the unregistered tape that fits at least as well."""

    p_place: float
    lead: float
    unregistered: str | None


def accept_place(
    dots: Dots,
    reading: Reading,
    view: View,
    world: Registry | CodePlane,
    limits: Limits,
    pixels: Pixels | None = None,
    pressed: tuple[ContactView, Image, Image] | None = None,
    sharper: Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray | None]] | None = None,
) -> tuple[Localization, bool]:
    """Accept or refuse the place of a reading.

    dots: Places in px of square pixels.
    reading: From `rank.read`.
    pixels: The frame, where its pixels are to refine the pose of an answer that is accepted.
    pressed (ContactView, Image, Image): How its depths are millimetres, the canonical frame, and as dots were detected in it.
    sharper: Function of the dots' detected positions (px of the frame), their offsets from the image centre (square pixels) and
        their nominal positions (mm), each (n, 2): `SquareImage.shifts`. Only the pose is fitted to corrected dots: search,
        acceptance and the contact dot use the uncorrected ones.
    Returns answer: Located, or with the reason of refusal.
    Returns explained: Whether the dots fit an unregistered tape instead.
    """
    place = reading.place
    tape = world.tapes[place.tape] if isinstance(world, Registry) and isinstance(place, Place) else None
    on = _on_tape(dots, place, view, tape)
    p_tape = bound_of(reading.ln_bound)
    doubt = _doubt(place, world, limits, p_tape)
    # two ways to be wrong: an unregistered texture, or another place of a registered one; so at most the sum (union bound)
    fields: dict[str, Any] = {"p_tape": p_tape, "p_place": doubt.p_place, "p_false": min(1.0, p_tape + doubt.p_place)}
    fields |= {"status": status_of(len(dots.weights)), "n_dots": len(dots.weights)}
    other = doubt.unregistered is not None
    if len(on.cells) < LEAST_DOTS:
        seen = "too few dots lie on a tape" if doubt.unregistered is None else _unregistered(doubt.unregistered)
        return Localization(located=False, reason=seen, **fields), other
    seen_px = dots.seen_px if dots.seen_px is None or len(on.cells) == len(dots.seen_px) else dots.seen_px[on.inside]
    sharp = None if sharper is None or seen_px is None else sharper(seen_px, on.offset_px, on.nominal_mm)
    shift_px, heights, unsure = sharp or (np.zeros(2), on.weights, None)
    # what corrects maxima is left out as far as the dots are at middles instead
    by_maxima = 1.0 - dots.by_edges
    offset_px = on.offset_px + by_maxima * shift_px
    built_mm, placed_mm, drift_mm = _built_at(world, place, on)
    # before the decision: how many dots agree is a part of it
    pose = fit_pose(offset_px, built_mm, on.weights, view.px_per_mm, view.beliefs, by_edges=dots.by_edges, placed_mm=placed_mm)
    if not pose.finite:
        return Localization(located=False, reason="the dots give no pose", **fields), other
    fields["n_agree"] = agree = int(np.count_nonzero(pose.agree))
    reason = _refusal(p_tape, doubt, limits, agree, on.good) or _off_scale(pose.px_per_mm, view) or _across(dots, pose, tape)
    if reason is not None:
        return Localization(located=False, reason=reason, **fields), other
    as_seen_px, drawn = offset_px, False
    gel, turn_rad = None if pressed is None else pressed[0].in_mm(heights, _part_mm(view)), 0.0
    if pressed is not None and gel is not None and seen_px is not None:
        contact = contact_surface(gel, *pressed[1:], seen_px, pose.agree, on.weights, view.pitch_mm)
        fields["contact"] = None if gel.rough else contact
        lie = contact.lie()
        turn_rad = contact.unsure_turn(_part_mm(view)) if lie is None or lie.bend is None else 0.0
        if lie is not None:
            if lie.bend is not None and lie.bend.on_flank:
                return Localization(located=False, reason=_ON_FLANK, **fields), other
            maxima_px = gel.on_gel(seen_px) * view.px_per_mm + shift_px
            places = (offset_px, offset_px + by_maxima * (maxima_px - offset_px), built_mm)
            rim = on.weights, heights, gel.from_border_mm(seen_px)
            pose, offset_px, drawn = tilted_pose(pose, lie, *places, *rim, view, by_maxima)
    pose = displaced(pose, view.beliefs, on.weights)
    # the contact's centre, and of the dots that agree the one nearest to it: the contact dot (paper, Eqs. 2 and 3)
    u, v = (on.offset_px - (dots.trust @ dots.xy_px / dots.trust.sum() - view.centre_px)).T
    nearest = np.where(pose.agree, np.hypot(u, v), np.inf).argmin()
    on_places = ("as-built" if place.as_built else "nominal") if isinstance(place, Place) else None
    fields |= {"refined": "dots", "places": on_places}
    if pixels is not None:
        rest = (None if tape is None else tape.part, offset_px, built_mm, pose, placed_mm)
        # the pixels are where the gel shows them: dots that were moved to where a flat tape would show them have no others
        pose, fields["refine_reason"] = refine(pixels, view, *rest) if offset_px is as_seen_px else (pose, _TILTED)
        fields["refined"] = "pixels" if fields["refine_reason"] is None else "dots"
    fields |= strain_of(pose, view)
    if reading.q is not None:
        args = (dots, reading.q, place.turn, on.cells, on.inside, offset_px, built_mm, pose, view)
        fields["dots"] = LazyDots(partial(located_dots, *args))
    # by the heights of dots that are not corrected otherwise
    by_heights = None if drawn or unsure is None or fields["refined"] == "pixels" else by_maxima**2 * unsure
    pose = _less_sure(pose, by_heights, drift_mm, turn_rad)
    return Localization(
        located=True, **fields, **_described(place, world, on.cells[nearest], on.nominal_mm[nearest], pose)
    ), False


def _part_mm(view: View) -> float:
    """Height of the tapes' parts; the usual one where they differ."""
    return USUAL_PART_MM if view.part is None else view.part.body_mm[2]


def _less_sure(pose: Pose, unsure: FloatArray | None, drift_mm: float, turn_rad: float) -> Pose:
    """The pose with more covariance: of what all dots err by alike, of a drift of the tape's measured places, and of the turn.

    unsure (3, 3): Of u mm and v mm, along the image's axes, and theta rad.
    drift_mm: It moves the texture under all dots alike: it is in the position, not in the turn.
    """
    if unsure is None and drift_mm == turn_rad == 0.0:
        return pose
    covariance = pose.covariance + np.diag([drift_mm**2, drift_mm**2, turn_rad**2])
    if unsure is not None:
        turn, c, s = np.eye(3), cos(pose.theta_rad), sin(pose.theta_rad)
        turn[:2, :2] = [[c, s], [-s, c]]  # R(theta) (paper, Eq. 12)
        covariance += turn @ unsure @ turn.T
    return replace(pose, covariance=covariance)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _OnTape:
    """Dots on a grid point with a part of the answer's tape, k of all n.

    inside (n,); cells (k, 2)
    nominal_mm (k, 2): C of each: where its part stands in the texture frame (paper, Eqs. 9 and 10).
    offset_px (k, 2): t of each, here from the image centre to the dot (paper, Eq. 11).
    weights (k,): Lower and doubtful dots weigh less, and those beside the edge of a plate.
    good: How many are of `GOOD_TRUST`.
    """

    inside: BoolArray
    cells: IntArray
    nominal_mm: FloatArray
    offset_px: FloatArray
    weights: FloatArray
    good: int


def _on_tape(dots: Dots, place: Place | PlanePlace, view: View, tape: Tape | None) -> _OnTape:
    """The dots on the answer's tape; without a tape, all dots, at the symbols that the code's plane has there (bits x + 2 y)."""
    if isinstance(place, PlanePlace):
        return _OnTape(
            inside=np.ones(len(place.cells), dtype=bool),
            cells=place.cells,
            nominal_mm=place.cells * view.pitch_mm + view.displacement_mm * DIRECTIONS_XY[place.x_bits + 2 * place.y_bits],
            offset_px=dots.xy_px - view.centre_px,
            weights=dots.weights * np.minimum(dots.trust / GOOD_TRUST, 1.0),
            good=int((dots.trust > GOOD_TRUST).sum()),
        )
    n = len(place.cells)
    inside, cells, weights = np.empty(n, dtype=np.bool_), np.empty((n, 2), dtype=np.int64), np.empty(n)
    nominal_mm, offset_px = np.empty((n, 2)), np.empty((n, 2))
    seen = (dots.xy_px, dots.weights, dots.trust)
    out = (inside, cells, nominal_mm, offset_px, weights)
    around_mm = _around_mm(view.displacement_mm, view.directions)
    k, good = parts_under(place.cells, place.shown, *seen, view.pitch_mm, around_mm, view.centre_px, *out)
    nominal_mm, weights = nominal_mm[:k], weights[:k]
    weights = weights if tape is None else off_edge(weights, nominal_mm, tape)
    return _OnTape(inside=inside, cells=cells[:k], nominal_mm=nominal_mm, offset_px=offset_px[:k], weights=weights, good=good)


def _built_at(world: Registry | CodePlane, place: Place | PlanePlace, on: _OnTape) -> tuple[FloatArray, FloatArray | None, float]:
    """Places in the texture frame that a pose is fitted to, mm (k, 2): as measured, with their standard deviations (k,) and the
    tape's drift since then, mm; or the design's, with None and 0.
    """
    built = world.built[place.tape] if isinstance(world, Registry) and isinstance(place, Place) and place.as_built else None
    if built is None:
        return on.nominal_mm, None, 0.0
    column, row = on.cells.T
    return on.nominal_mm + built.shift_mm[row, column], built.sigma_mm[row, column], built.drift_mm


@lru_cache(maxsize=8)
def _around_mm(displacement_mm: float, directions: int) -> FloatArray:
    """Displacement of each symbol, as `single_place.shown_by` has them; shape (directions, 2)."""
    around_mm: FloatArray = displacement_mm * DIRECTIONS[directions].xy[np.argsort(DIRECTIONS[directions].gray_codes)]
    around_mm.setflags(write=False)
    return around_mm


def _doubt(place: Place | PlanePlace, world: Registry | CodePlane, limits: Limits, p_tape: float) -> _Doubt:
    """Compare the answer with all other places, including those of unregistered tapes.

    With rho the weight of all unregistered tapes together, the registered ones weigh 1 - rho, and `others` are multiples of the
    answer's weight: so `rivals` counts places of unregistered tapes rho / (1 - rho) times.

    If p_tape already refuses the answer, p_place cannot change that: unregistered tapes are then compared only to name one
    of them in the reason.
    """
    registered = _Doubt(p_place=share_of_others(place.others, p_tape), lead=place.lead, unregistered=None)
    if isinstance(place, PlanePlace) or isinstance(world, CodePlane) or world.unregistered_share == 0.0:
        return registered
    # `most_evidence` is the largest evidence that these dots can have anywhere: below `clear` there is no tape to be named
    clear, refused = log(_PLACES) - log(limits.max_p_false), p_tape > limits.on_tape
    if refused and place.most_evidence < clear:
        return registered
    if refused:
        found = best_unregistered(world.families, place, world.unregistered_share, clear)
    else:
        # a smaller precision takes longer: p_place only has to be known to a tenth of what is allowed
        chance = p_tape > _BY_CHANCE * limits.max_p_false
        found = rivals(world.families, place, world.unregistered_share, limits.precision, log(limits.kappa), beyond=chance)
    # the credit of measured places counts against all places that were not measured, unregistered ones as well
    if place.credit > 0.0:
        found = replace(found, weight=found.weight * exp(-place.credit), lead=found.lead + place.credit)
    # it is named if it would be accepted itself, and the answer does not lead over it
    sure = found.score > clear and found.lead < log(limits.kappa)
    if refused and not sure:
        return registered
    return _Doubt(
        p_place=share_of_others(place.others + found.weight, p_tape),
        lead=min(place.lead, found.lead),
        unregistered=found.name if sure else None,
    )


def _unregistered(name: str) -> str:
    return f"looks like {name}, {NOT_REGISTERED}"


def _refusal(p_tape: float, doubt: _Doubt, limits: Limits, agree: int, good: int) -> str | None:
    """Reason why an answer is refused, None if it is accepted; from the good dots on the tape, and those that fit the pose.

    The bounds come first, as `not p <= limit`, so that NaN is refused. Then the lead, which does not depend
    on the weights of places: two equal ones are never told apart. Last the pose: dots may fit the symbols of a place but not
    the geometry of a flat tape, if it is bent, or if two tapes lie side by side.
    """
    p_place, p_false = doubt.p_place, min(1.0, p_tape + doubt.p_place)
    if doubt.unregistered is not None:
        return _unregistered(doubt.unregistered)
    if limits.max_p_tape is None and not p_false <= limits.max_p_false:
        what = "may be no tape of ours" if p_tape >= p_place else "several places fit"
        return f"{what}: p_false {p_false:.1e} exceeds {limits.max_p_false:.1e}"
    if limits.max_p_tape is not None and not p_tape <= limits.max_p_tape:
        return f"may be no tape of ours: p_tape {p_tape:.1e} exceeds {limits.max_p_tape:.1e}"
    if not p_place <= limits.max_p_false:
        return f"several places fit: p_place {p_place:.1e} exceeds {limits.max_p_false:.1e}"
    if not doubt.lead >= log(limits.kappa):
        return f"another place fits nearly as well: it leads by a factor of {exp(doubt.lead):.1f}, less than {limits.kappa:g}"
    if agree < least_agreeing(good):
        return f"only {agree} of {good} dots agree with the place that their symbols name"
    return None


def _off_scale(px_per_mm: float, view: View) -> str | None:
    """Reason why a scale is not that of the tapes and the sensor; None if it may be.

    Symbols say nothing of a pitch: a tape of another W is one of these at another scale, and its places are off by that share.
    """
    off = px_per_mm / view.px_per_mm - 1.0
    if abs(off) <= view.scale_tolerance + SCALE_ERROR:
        return None
    w_mm = view.pitch_mm * (1.0 + off)
    return (
        f"the tape is seen at {px_per_mm:.4g} px/mm, {off:+.1%} off the sensor profile's {view.px_per_mm:g}, which is right to "
        f"{view.scale_tolerance:.1%}: another scale, or a tape of W {w_mm:.3g} mm"
    )


def _across(dots: Dots, pose: Pose, tape: Tape | None) -> str | None:
    """Reason why the bodies' direction is not that of the answer; None if it may be.

    Weights of turns leave a fiftieth to the wrong pair (`MOST_TURN_SHARE`), however plainly all bodies contradict it. Symbols can
    make up for that where dots are read on a wrong grid: they are not at random then.
    """
    if tape is None:
        return None
    # ln odds of the turns 0 and 2 of a grid that lies as the answer does
    grid = np.array([cos(pose.theta_rad), sin(pose.theta_rad)])
    if parity_log_ratio(dots.elongation, dots.weights, dots.trust, grid, tape.part) >= -MOST_ACROSS:
        return None
    as_seen = (tape.part.rotation_deg + 90.0) % 180.0
    return (
        "the parts lie across the direction that they have on the tape: it is another place, or they were soldered a quarter "
        f"turn off: for these make the kit with a rotation of {as_seen:g} deg"
    )


def _described(
    place: Place | PlanePlace, world: Registry | CodePlane, cell: IntArray, contact: FloatArray, pose: Pose
) -> dict[str, Any]:
    """Fields of a located answer; `cell` and `contact` are of the contact dot (paper, Eq. 3).

    S is the texture point under the image centre (paper, Eq. 12, fitted to all dots instead of one).
    """
    column, row = cell.tolist()
    position_mm = (float(pose.position_mm[0]), float(pose.position_mm[1]))
    theta_deg = degrees(pose.theta_rad)
    found = {
        # `remainder` gives -180 for what is written as 180: the interval is (-180, 180]
        "theta_deg": 180.0 if theta_deg <= -180.0 else theta_deg,
        "px_per_mm": float(pose.px_per_mm),
        "covariance": pose.covariance,
    }
    if isinstance(place, PlanePlace) or isinstance(world, CodePlane):
        assert isinstance(place, PlanePlace)
        return {**found, "sector": place.sector, "index": (column, row), "plane_mm": position_mm}
    tape = world.tapes[place.tape]
    on_board = tape.surface is None and place.tape not in world.boards_differ
    board = texture_to_board(pose.position_mm, tape.board.texture_origin_mm) if on_board else None
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
