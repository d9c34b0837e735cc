"""The information limit of a contact: what the decoder's rule says where nothing is lost on the way to the symbols.

Whoever reads a contact without a fault knows how the grid lies, which dots are parts under the contact, and their symbols. What
can still keep him from an answer is that these are too few, or tops of the noise beside them, whose heights and places are those
of parts. It is the limit of such dots, not of the depth map: who knows how a part is imprinted could tell more tops from parts.
Neither the detection of parts nor the fit of the grid plays a part in what is said here: only the rule that answers have to keep.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log, radians

import numpy as np

from tactape_fab.decode.detect import Dots, detect
from tactape_fab.decode.door import canonical_frame
from tactape_fab.decode.elongation import turn_weights
from tactape_fab.decode.judge import Limits, judge
from tactape_fab.decode.localizer import KAPPA, MAX_P_FALSE, UNREGISTERED_SHARE
from tactape_fab.decode.reading import GRID_SHARES, Reading, View
from tactape_fab.decode.registry import Registry, register
from tactape_fab.decode.result import Localization, status_of
from tactape_fab.decode.rim import chosen, settled
from tactape_fab.decode.search import LEAST_DOTS, search
from tactape_fab.decode.symbols import USUAL_SIGMA, posteriors
from tactape_fab.profiles.sensors import SensorProfile
from tactape_fab.simulate import Scene
from tactape_fab.simulate.gel import FloatImage
from tactape_fab.simulate.view import make_view
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray, board_to_texture
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.shown import parts_shown

_AROUND = DIRECTIONS_XY[[2, 3, 1, 0]]
"""E, S, W, N: the directions as they follow each other along a grid's axes."""
_SURE = 0.9
"""Elongation of tops that leave no doubt."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rule:
    """What an answer about one tape has to keep in an open world; from `rule_of`."""

    tape: Tape
    sensor: SensorProfile
    world: Registry
    limits: Limits
    view: View
    turns: FloatArray


def rule_of(tape: Tape, sensor: SensorProfile) -> Rule:
    """The rule of a `Localizer` of that tape and sensor."""
    view = View(
        pitch_mm=tape.pitch_mm,
        displacement_mm=tape.displacement_mm,
        part=tape.part,
        px_per_mm=sensor.px_per_mm[0],
        scale_tolerance=0.0,
        centre_px=np.zeros(2),
    )
    return Rule(
        tape=tape,
        sensor=sensor,
        world=register([tape], unregistered_share=UNREGISTERED_SHARE),
        limits=Limits(max_p_false=MAX_P_FALSE, max_p_tape=None, kappa=KAPPA),
        view=view,
        turns=_sure_turns(tape),
    )


def error_free(rule: Rule, pose: FloatArray, scene: Scene) -> Localization:
    """The rule's verdict on a contact all of whose symbols are read as they are, and nothing else.

    Parameters
    ----------
    rule : Rule
    pose : ndarray, shape (3,)
        x mm, y mm (texture frame), theta deg.
    scene : Scene
        Its noise and its elastomer play no part.
    """
    return _verdict(rule, *_parts_shown(rule, pose, scene))


def as_seen(rule: Rule, pose: FloatArray, scene: Scene, depth: FloatImage) -> Localization:
    """The same of a frame: all those symbols as they are, and beside them every other dot that the frame shows.

    Those dots are parts at the rim, outside the contact's outline, and tops of the noise or of the board's edge. Which of them
    are which is not given: each counts as far as the decoder trusts it, a trust that is not judged here.

    Parameters
    ----------
    depth : ndarray, shape `sensor.frame_shape`
        What the sensor delivers of the tape's own parts at that pose.
    """
    at, weights, trust = _parts_shown(rule, pose, scene)
    dots, view = _dots_of(rule, depth), make_view(rule.tape, pose[:2], float(pose[2]), rule.sensor, scene)
    board = view.to_board((dots.xy_px - rule.sensor.centre_px) / view.px_per_mm)
    others = board_to_texture(board, rule.tape.board.texture_origin_mm) / rule.tape.pitch_mm
    beside = ~(np.rint(others)[:, None] == np.rint(at)).all(axis=2).any(axis=1)
    return _verdict(
        rule,
        np.concatenate([at, others[beside]]),
        np.concatenate([weights, dots.weights[beside]]),
        np.concatenate([trust, dots.trust[beside]]),
    )


def _parts_shown(rule: Rule, pose: FloatArray, scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Those parts as dots without a fault: places in pitches (n, 2), weights and trust."""
    shown = parts_shown(rule.tape, pose, scene, rule.sensor)
    ones = np.ones(len(shown))
    return board_to_texture(rule.tape.part_xy_mm()[shown], rule.tape.board.texture_origin_mm) / rule.tape.pitch_mm, ones, ones


def _dots_of(rule: Rule, depth: FloatImage) -> Dots:
    """What the decoder takes for dots; canonical image."""
    sensor = rule.sensor
    dots = detect(canonical_frame(depth, sensor), float(np.sqrt(np.prod(sensor.px_per_mm))))
    if sensor.mask is not None and len(dots.weights):
        u, v = np.rint(dots.xy_px).astype(np.int64).T
        dots = chosen(dots, sensor.mask[v, u])
    square = np.array([1.0, sensor.px_per_mm[0] / sensor.px_per_mm[1]])
    dots = settled(Dots(xy_px=dots.xy_px * square, weights=dots.weights, trust=dots.trust), rule.view.pitch_px, rule.view.shift)
    return Dots(xy_px=dots.xy_px / square, weights=dots.weights, trust=dots.trust)


def _verdict(rule: Rule, at: FloatArray, weights: FloatArray, trust: FloatArray) -> Localization:
    """What the rule says of dots at some places on the true grid, (n, 2) in pitches of the texture."""
    n, shift, limits = len(at), rule.view.shift, rule.limits
    empty = Localization(status=status_of(n), located=False, n_dots=n)
    if n < LEAST_DOTS:
        return empty
    nodes = np.rint(at).astype(np.int64)
    squares = ((at[:, None] - nodes[:, None] - shift * _AROUND) ** 2).sum(axis=2)
    q = posteriors(nodes, squares, weights, trust, USUAL_SIGMA)
    grid = np.array([rule.view.pitch_px, 0.0, 0.0, 0.0])
    tapes, families, centre_px = rule.world.tapes, rule.world.families, rule.view.centre_px
    place = search(tapes, families, nodes, q, rule.turns, grid, centre_px, None, limits.precision)
    if place is None:
        return empty
    dots = Dots(xy_px=at * rule.view.pitch_px, weights=weights, trust=trust)
    return judge(empty, dots, Reading(place=place, grid_weight=log(GRID_SHARES[0])), rule.view, rule.world, limits)[0]


def _sure_turns(tape: Tape) -> FloatArray:
    """Weights of the quarter turns where the shape of the tops leaves no doubt, the grid's first axis being the texture's x."""
    length_mm, width_mm = tape.part.body_mm[:2]
    twice = 2.0 * radians(-tape.part.rotation_deg + (0.0 if length_mm >= width_mm else 90.0))
    elongation = np.tile(-_SURE * np.array([np.cos(twice), np.sin(twice)]), (LEAST_DOTS, 1))
    ones = np.ones(LEAST_DOTS)
    return turn_weights(elongation, ones, ones, np.array([1.0, 0.0, 0.0, 0.0]), tape.part)
