"""The information limit of a contact: what the decoder's rule says where nothing is lost on the way to the symbols.

Whoever reads a contact without a fault knows how the grid lies, which dots are parts under the contact, and their symbols. What
can still keep him from an answer is that these are too few; and, where he has the frame alone, that noise has moved their tops,
or has tops of its own beside them, whose heights and places are those of parts. It is the limit of such dots, not of the depth
map: who knows how a part is imprinted could tell more tops from parts. Neither the detection of parts nor the fit of the grid
plays a part in what is said here: only the rule that answers have to keep.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

import numpy as np

from tactape_fab.decode.detect import Dots, detect
from tactape_fab.decode.door import canonical_frame
from tactape_fab.decode.elongation import square_pixels, turn_weights
from tactape_fab.decode.judge import Limits, judge
from tactape_fab.decode.localizer import KAPPA, MAX_P_FALSE, UNREGISTERED_SHARE
from tactape_fab.decode.reading import EVEN_TURNS, GRID_SHARES, Reading, View
from tactape_fab.decode.registry import Registry, register
from tactape_fab.decode.result import Localization, status_of
from tactape_fab.decode.rim import chosen, settled
from tactape_fab.decode.search import LEAST_DOTS, search
from tactape_fab.decode.symbols import USUAL_SIGMA, posteriors
from tactape_fab.profiles.sensors import SensorProfile
from tactape_fab.simulate import Scene
from tactape_fab.simulate.gel import FloatImage
from tactape_fab.simulate.view import View as Seen
from tactape_fab.simulate.view import make_view
from tactape_fab.texture.frames import DIRECTIONS_XY, FloatArray, board_to_texture
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.shown import parts_shown

_AROUND = DIRECTIONS_XY[[2, 3, 1, 0]]
"""E, S, W, N: the directions as they follow each other along a grid's axes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rule:
    """What an answer about one tape has to keep in an open world; from `rule_of`."""

    tape: Tape
    sensor: SensorProfile
    world: Registry
    limits: Limits
    view: View


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
    )


def error_free(rule: Rule, pose: FloatArray, scene: Scene) -> Localization:
    """The rule's verdict on a contact all of whose symbols are read as they are, and nothing else: not the shape of the tops.

    Parameters
    ----------
    rule : Rule
    pose : ndarray, shape (3,)
        x mm, y mm (texture frame), theta deg.
    scene : Scene
        Its noise and its elastomer play no part.
    """
    return _verdict(rule, *_parts_shown(rule, pose, scene), EVEN_TURNS)


def as_seen(rule: Rule, pose: FloatArray, scene: Scene, depth: FloatImage) -> Localization:
    """The same of a frame: all those parts, each where the frame shows its top, and every other dot of the frame.

    Parts are known to be parts, and those without a top are where they are. The other dots are parts at the rim, outside the
    contact's outline, and tops of the noise or of the board's edge. Which of them are which is not given: each counts as far as
    the decoder trusts it, a trust that is not judged here. The shape of the tops speaks for the turns that it speaks for in this
    frame.

    Parameters
    ----------
    depth : ndarray, shape `sensor.frame_shape`
        What the sensor delivers of the tape's own parts at that pose.
    """
    at, weights, trust = _parts_shown(rule, pose, scene)
    dots, view = _dots_of(rule, depth), make_view(rule.tape, pose[:2], float(pose[2]), rule.sensor, scene)
    board = view.to_board((dots.xy_px - rule.sensor.centre_px) / view.px_per_mm)
    others = board_to_texture(board, rule.tape.board.texture_origin_mm) / rule.tape.pitch_mm
    turns = turn_weights(dots.elongation, dots.weights, dots.trust, _grid_of(rule, view), rule.tape.part)
    same = (np.rint(others)[:, None] == np.rint(at)).all(axis=2)
    beside, topped = ~same.any(axis=1), same.any(axis=0)
    if topped.any():
        far = np.where(same, ((others[:, None] - at) ** 2).sum(axis=2), np.inf)
        top = far.argmin(axis=0)[topped]
        at[topped], weights[topped] = others[top], dots.weights[top]
    return _verdict(
        rule,
        np.concatenate([at, others[beside]]),
        np.concatenate([weights, dots.weights[beside]]),
        np.concatenate([trust, dots.trust[beside]]),
        turns,
    )


def _parts_shown(rule: Rule, pose: FloatArray, scene: Scene) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Those parts as dots without a fault: places in pitches (n, 2), weights and trust."""
    shown = parts_shown(rule.tape, pose, scene, rule.sensor)
    at = board_to_texture(rule.tape.part_xy_mm()[shown], rule.tape.board.texture_origin_mm) / rule.tape.pitch_mm
    return at, np.ones(len(shown)), np.ones(len(shown))


def _dots_of(rule: Rule, depth: FloatImage) -> Dots:
    """What the decoder takes for dots; canonical image, elongations as in square pixels."""
    sensor = rule.sensor
    dots = detect(canonical_frame(depth, sensor), float(np.sqrt(np.prod(sensor.px_per_mm))))
    if sensor.mask is not None and len(dots.weights):
        u, v = np.rint(dots.xy_px).astype(np.int64).T
        dots = chosen(dots, sensor.mask[v, u])
    aspect = sensor.px_per_mm[0] / sensor.px_per_mm[1]
    square, elongation = np.array([1.0, aspect]), square_pixels(dots.elongation, aspect)
    dots = settled(replace(dots, xy_px=dots.xy_px * square, elongation=elongation), rule.view.pitch_px, rule.view.shift)
    return replace(dots, xy_px=dots.xy_px / square)


def _grid_of(rule: Rule, view: Seen) -> FloatArray:
    """The true grid in the frame, as `symbols.fit_grid` would have it but for its place: the texture's x axis, square pixels."""
    along = view.turn.T @ np.array([1.0, 0.0])
    return np.array([*(rule.view.pitch_px * along), 0.0, 0.0])


def _verdict(rule: Rule, at: FloatArray, weights: FloatArray, trust: FloatArray, turns: FloatArray) -> Localization:
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
    place = search(tapes, families, nodes, q, turns, grid, centre_px, None, limits.precision)
    if place is None:
        return empty
    dots = Dots(xy_px=at * rule.view.pitch_px, weights=weights, trust=trust)
    return judge(empty, dots, Reading(place=place, grid_weight=log(GRID_SHARES[0])), rule.view, rule.world, limits)[0]
