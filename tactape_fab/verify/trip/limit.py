"""Information limit of a contact: the decision rule's answer for an ideal reader of its dots.

An ideal reader knows which dots are parts under the contact, and their symbols. `error_free`: it knows the grid as well, so that
only too few dots can prevent an answer. `as_seen`: it has the tops in a frame, which noise has moved, and to which noise adds
tops that look like those of parts; it estimates place, rotation and scale of the grid, and the error of tops, from the tops of
the known parts.

This is the limit of dots, not of the depth map: a reader with a model of the imprint could distinguish more tops from parts.
Formulas and constants are those of `sense.decode.rule`. No result of the decoder is used, neither its grid nor its choice of
dots.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

import numpy as np

from tactape_fab.sense.decode.accept import accept_place
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.elongation import square_pixels, turn_weights
from tactape_fab.sense.decode.dots.frame_dots import frame_dots
from tactape_fab.sense.decode.dots.inputs import canonical_frame
from tactape_fab.sense.decode.dots.rim import settled
from tactape_fab.sense.decode.grid.beliefs import beliefs_of
from tactape_fab.sense.decode.grid.fit import posteriors
from tactape_fab.sense.decode.rank import Reading, View
from tactape_fab.sense.decode.result import Localization, status_of
from tactape_fab.sense.decode.rule import (
    EVEN_TURNS,
    GOOD_WEIGHT,
    GRID_SHARES,
    KAPPA,
    LEAST_DOTS,
    MAX_P_FALSE,
    UNREGISTERED_SHARE,
    USUAL_SIGMA,
    Limits,
    sigma_of,
    squared_errors,
)
from tactape_fab.sense.decode.search.hypotheses import Registry, register
from tactape_fab.sense.decode.search.search import search
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.simulation.gel import FloatImage
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.sense.simulation.view import View as Seen
from tactape_fab.sense.simulation.view import make_view
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import DIRECTIONS_XY, BoolArray, FloatArray, board_to_texture
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.trip.visible_parts import parts_shown

_AROUND = {count: directions.xy[directions.clockwise] for count, directions in DIRECTIONS.items()}
"""Unit displacements in clockwise order from E, by the number of directions: E, S, W, N, or E, SE, S, ..."""
MARGIN = 1.5
"""Largest factor, in 99 of 100 contacts with barely enough information, by which the error bounds of a grid fitted without the
symbols exceed those of one fitted with them (measured on 2,099 contacts of random tapes: 1.44 for p_tape, 1.6 for p_place)."""
_OWN_PLACE = 0.12
"""Largest distance of a top from its part, in pitches, at which it is used to fit the grid."""
_FIT_STEPS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rule:
    """Decision rule for one tape that may not be the one touched (open world); see `rule_of`."""

    tape: Tape
    sensor: SensorProfile
    world: Registry
    limits: Limits
    view: View


def rule_of(tape: Tape, sensor: SensorProfile, margin: float = 1.0) -> Rule:
    """The rule of a `Localizer` with that tape and sensor, stricter by the factor `margin`."""
    view = View(
        pitch_mm=tape.pitch_mm,
        displacement_mm=tape.displacement_mm,
        part=tape.part,
        px_per_mm=sensor.px_per_mm[0],
        scale_tolerance=0.0,
        centre_px=np.zeros(2),
        beliefs=beliefs_of(sensor, fixed_scale=True),
        directions=tape.directions,
    )
    return Rule(
        tape=tape,
        sensor=sensor,
        world=register([tape], unregistered_share=UNREGISTERED_SHARE),
        # one factor for both limits, as a grid fitted to known symbols improves both bounds (see `MARGIN`)
        limits=Limits(max_p_false=MAX_P_FALSE / margin, kappa=KAPPA * margin),
        view=view,
    )


def error_free(rule: Rule, pose: FloatArray, scene: Scene) -> Localization:
    """The rule's answer for a contact with error-free dots; the shape of the tops is not used.

    pose (3,): x mm, y mm (texture frame), theta deg.
    scene: Noise and elastomer are ignored.
    """
    return _verdict(rule, *_parts_shown(rule, pose, scene), EVEN_TURNS, USUAL_SIGMA)


def as_seen(rule: Rule, pose: FloatArray, scene: Scene, depth: FloatImage, *, known_parts: bool) -> Localization:
    """The rule's answer for the tops in a frame, on the grid that fits the parts' tops best.

    Grid and error of the tops are estimated with the true symbols. The shape of the tops counts for the quarter turn as in this
    frame.

    depth: Depth map of the tape's own parts at that pose.
    known_parts: Whether the reader knows which tops are those of parts that the contact shows, which then have full trust, as
        have such parts without a top. All other dots (parts at the rim or outside the contact's outline, tops of noise or of the
        board's edge) have the decoder's trust.
    """
    dots, view = _dots_of(rule, depth), make_view(rule.tape, pose[:2], float(pose[2]), rule.sensor, scene)
    board = view.to_board(view.from_px(dots.xy_px))
    # in pitches on the true grid, whose points are integers
    at = board_to_texture(board, rule.tape.board.texture_origin_mm) / rule.tape.pitch_mm
    weights, trust = dots.weights, dots.trust
    turns = turn_weights(dots.elongation, dots.weights, dots.trust, _grid_of(rule, view), rule.tape.part)
    if known_parts:
        at, weights, trust = _known_parts(at, weights, trust, *_parts_shown(rule, pose, scene))
    if not len(at):
        return Localization(status=status_of(0), located=False, n_dots=0)
    at, sigma = _on_own_grid(rule, at, weights, trust)
    return _verdict(rule, at, weights, trust, turns, sigma)


def _known_parts(
    at: FloatArray, weights: FloatArray, trust: FloatArray, part_at: FloatArray, part_weights: FloatArray, part_trust: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Parts, each at the nearest top of its grid point if there is one, and all dots of other grid points."""
    # a top belongs to a part if both are nearest to one grid point; (tops, parts)
    same = (np.rint(at)[:, None] == np.rint(part_at)).all(axis=2)
    beside, topped = ~same.any(axis=1), same.any(axis=0)
    if topped.any():
        far = np.where(same, ((at[:, None] - part_at) ** 2).sum(axis=2), np.inf)
        top = far.argmin(axis=0)[topped]
        # place and height are those of the top; trust stays 1, since it is known to be a part
        part_at[topped], part_weights[topped] = at[top], weights[top]
    return (
        np.concatenate([part_at, at[beside]]),
        np.concatenate([part_weights, weights[beside]]),
        np.concatenate([part_trust, trust[beside]]),
    )


def _on_own_grid(rule: Rule, at: FloatArray, weights: FloatArray, trust: FloatArray) -> tuple[FloatArray, float]:
    """Places on the grid fitted to the tops of known parts, (n, 2) in its pitches, from those on the true grid; and a top's
    error.

    Rotation, translation and scale are fitted by weighted least squares; the error is estimated by `rule.sigma_of`.
    """
    tape, nodes = rule.tape, np.rint(at).astype(np.int64)
    inside = (nodes >= 0) & (nodes < (tape.columns, tape.rows))
    on_tape: BoolArray = inside[:, 0] & inside[:, 1]
    column, row = np.where(on_tape[:, None], nodes, 0).T
    # the part's place by its true symbol, so that the fit does not estimate symbols
    own = nodes + rule.view.shift * DIRECTIONS_XY[tape.symbols[row, column]]
    # tops farther away belong to other parts or to noise, and are not used in the fit
    known = np.where(on_tape & tape.placed[row, column] & (np.hypot(*(at - own).T) < _OWN_PLACE), trust, 0.0)
    good = np.where(weights >= GOOD_WEIGHT, known, 0.0)
    to, sigma, placed = own @ (1.0, 1.0j), USUAL_SIGMA, at @ (1.0, 1.0j)
    # too few for four unknowns and an error: the true grid is used, with the default error
    if np.count_nonzero(known) < LEAST_DOTS:
        return at, sigma
    # with points as complex numbers, rotation and scale are one factor, for which least squares are linear
    for _ in range(_FIT_STEPS):
        # weights depend on the error, and that on the fit: three iterations converge
        w = known / squared_errors(weights, sigma)
        middle, aim = w @ placed / w.sum(), w @ to / w.sum()
        # minimises sum w |aim + f (p - middle) - to|^2 over the complex f, by its normal equation about both means
        factor = (w * np.conj(placed - middle)) @ (to - aim) / (w @ np.abs(placed - middle) ** 2)
        placed = aim + factor * (placed - middle)
        # good dots only, as sigma is their error
        sigma = sigma_of(float(good @ np.abs(placed - to) ** 2), float(good.sum()))
    return np.stack([placed.real, placed.imag], axis=1), sigma


def _parts_shown(rule: Rule, pose: FloatArray, scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The parts that the contact shows as error-free dots: places in pitches (n, 2), weights and trust."""
    shown = parts_shown(rule.tape, pose, scene, rule.sensor)
    at = board_to_texture(rule.tape.part_xy_mm()[shown], rule.tape.board.texture_origin_mm) / rule.tape.pitch_mm
    return at, np.ones(len(shown)), np.ones(len(shown))


def _dots_of(rule: Rule, depth: FloatImage) -> Dots:
    """The dots of a frame: places in the canonical image, elongations as in square pixels."""
    sensor = rule.sensor
    dots = frame_dots(canonical_frame(depth, sensor), sensor)
    # scale of rows that makes pixels square, as distances and directions of dots are compared
    aspect = sensor.px_per_mm[0] / sensor.px_per_mm[1]
    square, elongation = np.array([1.0, aspect]), square_pixels(dots.elongation, aspect)
    dots = settled(replace(dots, xy_px=dots.xy_px * square, elongation=elongation), rule.view.pitch_px, rule.view.shift)
    return replace(dots, xy_px=dots.xy_px / square)


def _grid_of(rule: Rule, view: Seen) -> FloatArray:
    """The true grid in the frame in the form of `grid.fit.fit_grid`, but without place: the texture's x axis, square pixels."""
    # the inverse of the rotation from image to texture maps the texture's x axis into the image
    along = view.turn.T @ np.array([1.0, 0.0])
    return np.array([*(rule.view.pitch_px * along), 0.0, 0.0])


def _verdict(rule: Rule, at: FloatArray, weights: FloatArray, trust: FloatArray, turns: FloatArray, sigma: float) -> Localization:
    """The rule's answer for dots at places on the grid, (n, 2) in pitches; good dots have the error `sigma`."""
    n, shift, limits = len(at), rule.view.shift, rule.limits
    empty = Localization(status=status_of(n), located=False, n_dots=n)
    if n < LEAST_DOTS:
        return empty
    nodes = np.rint(at).astype(np.int64)
    # squared distance from each symbol's place around the dot's grid point, in pitches squared, as in the decoder's fit
    squares = ((at[:, None] - nodes[:, None] - shift * _AROUND[rule.view.directions]) ** 2).sum(axis=2)
    q = posteriors(nodes, squares, weights, trust, sigma)
    # axis along x and origin 0: `at` times the pitch are pixels of an image aligned with the texture
    grid = np.array([rule.view.pitch_px, 0.0, 0.0, 0.0])
    tapes, families, centre_px = rule.world.tapes, rule.world.families, rule.view.centre_px
    place = search(tapes, families, nodes, q, turns, grid, centre_px, None, limits.precision)
    if place is None:
        return empty
    dots = Dots(xy_px=at * rule.view.pitch_px, weights=weights, trust=trust)
    # the true grid is known, so it has the prior weight of the first grid that the decoder tries
    return accept_place(dots, Reading(place=place, grid_weight=log(GRID_SHARES[0])), rule.view, rule.world, limits)[0]
