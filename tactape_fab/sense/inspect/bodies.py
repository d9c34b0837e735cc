"""Positions and rotations of the bodies relative to the film."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from tactape_fab.sense.inspect.align import Nuisance, Step, Template, gradients, learn_template, step
from tactape_fab.sense.inspect.colours import LIKE_BODY, Palette
from tactape_fab.sense.inspect.film import symmetry_offset
from tactape_fab.sense.inspect.patches import FINEST_PX_PER_MM, PatchGrid, Samples, patch_grid, sample
from tactape_fab.sense.inspect.scan_files import Picture
from tactape_fab.sense.inspect.warp import Warp
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray
from tactape_fab.texture.tape import Tape

_LEARNINGS = 3
_STEPS = 3
_MARGIN_MM = 0.05
"""Margin of film, land or solder around a body in its patch."""
_MOST_LEARNED = 400
"""Parts, evenly chosen, that the template is learned from."""
_CENTRE_MARGIN_MM = 0.07
_MOST_SHADOW_MM = 0.006
"""Largest shift across a body that is taken for a shadow's: it is 1.7 um in usual drawn scans, and 5 um in blurred ones
(0.045 mm) with dark shadows (0.7); a larger one has another cause."""
_USUAL_SHADOW_MM = 0.002
"""Largest such shift that leaves no doubt: beside brighter bodies, or on green film, all places were 6 um off across parts."""
_LEAST_PX_PER_MM = 40.0
"""Samples of a template: an edge of a scan at 600 dpi that is sampled at its pixels alone lies in a whole pixel."""
_USUAL = 0.5
_LEAST_BODIES = 20
_MOST_STEP_MM, _MOST_STEP_RAD = 0.06, 0.2
_END_MM = 0.02
"""Scatter of the length of a part's metal ends that the fit starts from; the scan then says how much it is."""
_LEAST_END_MM = 0.001
_BRIGHTER = 1.0
"""Prior sigma of the brightness of metal and solder, in units of the film's: wide, as brightness does not tell a position."""
_TURNS_DEG = np.arange(-90.0, 90.0, 15.0)
_SAME_TURN_DEG = 15.0
_POOR, _BETTER, _VERY_POOR = 1.2, 0.45, 2.5
"""Misfit, in units of the usual one, from which on a part is looked at in all turns; share of it that another turn may have at
most to be taken; and misfit from which on a little more is enough. By drawn scans of 600 to 2400 dpi: where parts are placed to
0.05 mm, those turned by 60 to 90 degrees have more than 1.3, and 0.2 to 0.45 of it in their own turn. Where to 0.1 mm, or where
solder and metal ends differ much from part to part, the usual misfit is larger: 13 of 32 such parts, and up to 22 of 40, have
less than 1.4 or more than that share, and are not seen to be turned. Good parts are many: of 23,700 nine have less than 0.8 of
their misfit across, and none 0.45.
"""
_BETTER_IF_VERY_POOR = 0.55
"""Of 79 drawn parts that are turned and have more than that misfit, four have more than this share of it in their own turn; of
the six good ones that fit better across (glare, a coat printed off the middle) none has less than 0.59."""
_COVERED = 3.2
"""Misfit in all turns from which on something lies on the part, or it is none of the others' kind. Of 1,984 good parts at 2400
dpi four reach 2.6."""
_MOST_AREA = 2.0
"""Area of body colour about a part from which on something lies on it or touches it: the fit takes the edge of a dark speck for
the part's, and is off by up to 0.3 mm without a poor misfit. In drawn scans nine such parts of ten have 2.1 to 4.8, and of 15,000
others none more than 1.97."""
_MIDDLE, _MOSTLY, _SEARCHED = (0.2, 0.35), 0.5, 2
"""Half of the middle of a part, over its length and width; the share of it that has the colour of bodies at least; and steps of
half a width to each side that a part which is not at its place is looked for."""
_LEAST_USUAL = 1.8
"""Usual misfit, in scatters, of scans with glare; without it parts are more alike, and 4 good ones of 400 looked covered."""
_COVERED_SIGMA_MM = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bodies:
    """The parts that a scan shows.

    shift_mm (n, 2): From the nominal place, board frame.
    turn_deg (n,): From the nominal rotation, counter-clockwise, -90 to 90.
    sigma_mm (n,)
    common_mm: Standard deviation, along each axis, of the error of all of them together, by shadows; it is in `sigma_mm`.
    area (n,): Of body colour around the place, in units of the usual one: 0 where no part is.
    misfit (n,): How unlike the usual part it looks, 1 being usual.
    """

    shift_mm: FloatArray
    turn_deg: FloatArray
    sigma_mm: FloatArray
    area: FloatArray
    misfit: FloatArray
    common_mm: float = 0.0

    @property
    def covered(self) -> BoolArray:
        """Where something lies on the part, or it is none of the others' kind: its place is not to be relied on; (n,)."""
        return _covered(self.misfit, self.area)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Scene:
    """Where patches are taken from."""

    picture: Picture
    warp: Warp
    tape: Tape
    palette: Palette
    grid: PatchGrid

    def patches(self, sites_mm: FloatArray, state: _State) -> Samples:
        turn = self.tape.part.rotation_deg + state.turn_deg
        return _channels(sample(self.picture, self.warp, sites_mm + state.shift_mm, turn, self.grid), self.palette)

    def bodies_at(self, sites_mm: FloatArray, state: _State) -> BoolArray:
        """Where the middles of parts, at their places so far, have the colour of bodies; (n,)."""
        length, width, _ = self.tape.part.body_mm
        grid = patch_grid(_MIDDLE[0] * length, _MIDDLE[1] * width, self.warp.px_per_mm)
        turn = self.tape.part.rotation_deg + state.turn_deg
        seen = sample(self.picture, self.warp, sites_mm + state.shift_mm, turn, grid)
        return np.asarray(self.palette.are_bodies(seen).mean(axis=1) > _MOSTLY)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _State:
    """Shift and turn of each part so far, and the fit that led there; ``sigma_mm`` (n, 2) is along and across the part."""

    shift_mm: FloatArray
    turn_deg: FloatArray
    sigma_mm: FloatArray
    misfit: FloatArray

    def of(self, chosen: IntArray) -> _State:
        return _State(
            shift_mm=self.shift_mm[chosen],
            turn_deg=self.turn_deg[chosen],
            sigma_mm=self.sigma_mm[chosen],
            misfit=self.misfit[chosen],
        )

    def put(self, chosen: IntArray, fitted: _State) -> None:
        """Enter the fit of the chosen parts."""
        self.shift_mm[chosen], self.turn_deg[chosen] = fitted.shift_mm, fitted.turn_deg
        self.sigma_mm[chosen], self.misfit[chosen] = fitted.sigma_mm, fitted.misfit


def fit_bodies(picture: Picture, warp: Warp, tape: Tape, palette: Palette, sites_mm: FloatArray) -> Bodies:
    """Fit every body: first the centroid of its colour, then a template that is learned from all bodies.

    picture (h, w, 3)
    warp: Fitted to the lands.
    sites_mm (n, 2): Nominal positions, all whole in the picture.
    """
    start_mm, area = _centroids(picture, warp, tape, palette, sites_mm)
    n, usual = len(sites_mm), area > _USUAL
    start = _State(shift_mm=start_mm, turn_deg=np.zeros(n), sigma_mm=np.full((n, 2), 0.1), misfit=np.full(n, np.inf))
    if usual.sum() < _LEAST_BODIES:
        sigma_mm = start.sigma_mm[:, 0]
        return Bodies(shift_mm=start_mm, turn_deg=start.turn_deg, sigma_mm=sigma_mm, area=area, misfit=np.ones(n))
    length, width, _ = tape.part.body_mm
    # barely larger than the body, as lands do not move with it
    grid = patch_grid(length / 2 + _MARGIN_MM, width / 2 + _MARGIN_MM, max(warp.px_per_mm, _LEAST_PX_PER_MM))
    scene = _Scene(picture=picture, warp=warp, tape=tape, palette=palette, grid=grid)
    state, template, ends, misfit = _fitted(scene, sites_mm, start, usual)
    farther = _ends_apart(scene, sites_mm, state, usual, template, ends)
    # the template is turned as parts are on the median: turns count from there
    middle = float(np.median(state.turn_deg[usual]))
    poor = np.flatnonzero(usual & (state.misfit > _POOR))
    if len(poor):
        state = _all_turns(scene, sites_mm, state, start, poor, template, ends, misfit)
    if palette.like_lands:
        state, there = _searched(scene, sites_mm, state, template, ends, misfit)
        area *= there
        usual = area > _USUAL
    state.sigma_mm[:, 0] *= farther
    start_mm[area > _MOST_AREA] = np.median(state.shift_mm[usual], axis=0)  # the colour's centroid is the speck's
    covered = usual & _covered(state.misfit, area)
    state.shift_mm[covered], state.turn_deg[covered], state.sigma_mm[covered] = start_mm[covered], middle, _COVERED_SIGMA_MM
    # parts were fitted to the template, whose own centre is somewhere beside that of its grid
    centre, common_mm = _centre(scene, sites_mm, state, usual, template)
    shift = state.shift_mm + _along(tape, state.turn_deg, *centre)
    # a box looks the same after half a turn
    turn = (state.turn_deg - middle + 90.0) % 180.0 - 90.0
    # the mean of both axes' variances
    sigma_mm = np.sqrt(np.square(state.sigma_mm).mean(axis=1) + common_mm**2)
    return Bodies(shift_mm=shift, turn_deg=turn, sigma_mm=sigma_mm, area=area, misfit=state.misfit, common_mm=common_mm)


def _covered(misfit: FloatArray, area: FloatArray) -> BoolArray:
    return np.asarray((misfit > _COVERED) | (area > _MOST_AREA))


def _fitted(scene: _Scene, sites_mm: FloatArray, state: _State, usual: BoolArray) -> tuple[_State, Template, Nuisance, float]:
    """Learn a template where some parts are thought to be, fit them to it, and again; then fit the others.

    Also the usual misfit, in units of which those of the state are. Parts whose place is empty stay as they are.
    """
    used = np.ones(scene.grid.count, dtype=bool)
    # five kinds of difference for each of two ends, in the order of `_ends`
    strength = np.tile([_END_MM, _BRIGHTER, _BRIGHTER, _BRIGHTER, _BRIGHTER], 2)
    seen: Step | None = None
    there = np.flatnonzero(usual)
    some = _evenly(usual)
    fewer = state.of(some)
    for learning in range(_LEARNINGS):
        template = learn_template(scene.patches(sites_mm[some], fewer), used)
        if seen is not None:
            template = replace(template, sigma=seen.scatter, tail=seen.tail)
        # a robust step costs twice as much, and is worth it from near the place only
        for last in (False,) * (_STEPS - learning - 1) + (True,):
            ends = Nuisance(pictures=_ends(template, scene.grid, scene.tape), sigma=strength)
            fewer, fit = _moved(scene, sites_mm[some], fewer, template, ends, robust=last)
            # only where the inner edges lie is learned; how much brighter ends may be does not matter (`_BRIGHTER`)
            strength[::5] = np.clip(fit.nuisance[::5], _LEAST_END_MM, 2 * _END_MM)
        seen = fit
    state.put(some, fewer)
    others = np.setdiff1d(there, some)
    if len(others):
        rest = state.of(others)
        for last in (False, False, True):
            rest, _ = _moved(scene, sites_mm[others], rest, template, ends, robust=last)
        state.put(others, rest)
    # in units of the usual part: glare makes all of them fit worse
    misfit = max(float(np.median(state.misfit[usual])), _LEAST_USUAL)
    return replace(state, misfit=state.misfit / misfit), template, ends, misfit


def _ends_apart(
    scene: _Scene, sites_mm: FloatArray, state: _State, usual: BoolArray, template: Template, ends: Nuisance
) -> float:
    """How much farther off parts are along them than the fit says, 1 or more: by where each end alone would have them.

    Ends differ by where their metal begins, and a fit takes half of the difference for a shift: where the outer ends are
    blurred, or have no colour of their own, nothing else says it. Both ends differ independently, so that their mean, the place,
    scatters as half of what lies between them. Bodies that are longer than others count as well, which says a little too much.
    """
    some = _evenly(usual)
    channels, grid = scene.patches(sites_mm[some], state.of(some)), scene.grid
    halves = [replace(template, used=template.used & (end * grid.a_mm > 0)) for end in (-1, 1)]
    low, high = (step(channels, half, grid, turns=False, nuisance=ends).move[:, 0] for half in halves)
    apart = high - low
    scatter = 1.4826 * float(np.median(np.abs(apart - np.median(apart))))
    return max(1.0, scatter / 2 / float(np.median(state.sigma_mm[some, 0])))


def _evenly(usual: BoolArray) -> IntArray:
    """Of the parts that are there, those that the template is learned from."""
    there = np.flatnonzero(usual)
    return there[:: max(1, len(there) // _MOST_LEARNED)]


def _moved(
    scene: _Scene, sites_mm: FloatArray, state: _State, template: Template, ends: Nuisance, *, robust: bool
) -> tuple[_State, Step]:
    fit = step(scene.patches(sites_mm, state), template, scene.grid, turns=True, robust=robust, nuisance=ends)
    # the expansion holds for small moves alone
    a, b = np.clip(fit.move[:, :2], -_MOST_STEP_MM, _MOST_STEP_MM).T
    shift = state.shift_mm + _along(scene.tape, state.turn_deg, a, b)
    turn = state.turn_deg + np.degrees(np.clip(fit.move[:, 2], -_MOST_STEP_RAD, _MOST_STEP_RAD))
    return _State(shift_mm=shift, turn_deg=turn, sigma_mm=fit.sigma_mm, misfit=fit.misfit), fit


def _along(tape: Tape, turn_deg: FloatArray, a_mm: FloatArray, b_mm: FloatArray) -> FloatArray:
    """Shifts given along and across parts, converted to the board frame; (n, 2)."""
    angle = np.radians(tape.part.rotation_deg + turn_deg)
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * a_mm - s * b_mm, s * a_mm + c * b_mm], axis=1)


def _centre(scene: _Scene, sites_mm: FloatArray, state: _State, usual: BoolArray, template: Template) -> tuple[FloatArray, float]:
    """Where the body's centre lies in the template, (a, b) mm, and the standard deviation along each axis of what that is off.

    Across, from a colour that no shadow changes, where the body has one: film in a shadow is as dark as a body, and a shadow on
    one side moves all bodies by 0.7 um. Along, metal would be body in it. So would it beside bodies that are off their lands
    together, and the half-sized colours of a JPEG bring it there: all bodies would be moved by 0.1 mm.
    """
    length, width, _ = scene.tape.part.body_mm
    grid = scene.grid
    body = (np.abs(grid.a_mm) < length / 2 + 0.04) & (np.abs(grid.b_mm) < width / 2 + 0.04)
    a, b = symmetry_offset(template.value[0], grid, body)
    axis, unsure_mm = scene.palette.unshaded_axis(), 0.0
    if axis is not None:
        grid = patch_grid(0.15 * length, width / 2 + _CENTRE_MARGIN_MM, FINEST_PX_PER_MM)
        some = _evenly(usual)
        turn = scene.tape.part.rotation_deg + state.turn_deg[some]
        seen = sample(scene.picture, scene.warp, sites_mm[some] + state.shift_mm[some], turn, grid)
        own = symmetry_offset(np.median(np.clip(seen @ axis, -1.0, 2.0), axis=0), grid, np.ones(grid.count, dtype=bool))[1]
        # either may be right; what is off across a part is so along both axes
        unsure_mm = sqrt(max((own - b) ** 2 - _USUAL_SHADOW_MM**2, 0.0) / 2.0)
        b = own if abs(own - b) < _MOST_SHADOW_MM else b
    return np.array([a, b]), unsure_mm


def _all_turns(
    scene: _Scene,
    sites_mm: FloatArray,
    state: _State,
    start: _State,
    poor: IntArray,
    template: Template,
    ends: Nuisance,
    usual: float,
) -> _State:
    """Fit poor parts in all turns, and keep another turn where its fit is clearly better."""
    # turn by turn, all poor parts in each
    every = np.tile(poor, len(_TURNS_DEG))
    tried = replace(start.of(every), turn_deg=np.repeat(_TURNS_DEG, len(poor)))
    for _ in range(_STEPS):
        tried, _ = _moved(scene, sites_mm[every], tried, template, ends, robust=True)
    tried = replace(tried, misfit=tried.misfit / usual)
    first = tried.misfit.reshape(len(_TURNS_DEG), -1).argmin(axis=0) * len(poor) + np.arange(len(poor))
    before = state.misfit[poor]
    other = np.abs((tried.turn_deg[first] - state.turn_deg[poor] + 90.0) % 180.0 - 90.0) > _SAME_TURN_DEG
    # glare on a good part may fit a part across a little better; in its own turn any better fit serves
    share = np.where(before > _VERY_POOR, np.where(other, _BETTER_IF_VERY_POOR, 1.0), _BETTER)
    better = tried.misfit[first] < share * before
    # a copy: `put` writes into its arrays
    best = state.of(np.arange(len(state.misfit)))
    best.put(poor[better], tried.of(first[better]))
    return best


def _searched(
    scene: _Scene, sites_mm: FloatArray, state: _State, template: Template, ends: Nuisance, usual: float
) -> tuple[_State, BoolArray]:
    """Fit parts anew, from places all about, that show no body where they seem to be, or fit badly; also where any is, (n,)."""
    there = scene.bodies_at(sites_mm, state)
    lost = np.flatnonzero(~there | (state.misfit > _POOR))
    if not len(lost):
        return state, there
    steps = np.arange(-_SEARCHED, _SEARCHED + 1) * scene.tape.part.body_mm[1] / 2
    about = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    every = np.tile(lost, len(about))
    tried = replace(state.of(every), shift_mm=np.repeat(about, len(lost), axis=0))
    for _ in range(_STEPS):
        tried, _ = _moved(scene, sites_mm[every], tried, template, ends, robust=True)
    tried = replace(tried, misfit=tried.misfit / usual)
    near = np.hypot(*tried.shift_mm.T) < 0.45 * (scene.tape.pitch_mm - 2 * scene.tape.displacement_mm)
    right = near & scene.bodies_at(sites_mm[every], tried) & (tried.misfit < _COVERED)
    worth = np.where(right, tried.misfit, np.inf).reshape(len(about), -1)
    best = worth.argmin(axis=0) * len(lost) + np.arange(len(lost))
    better = worth.min(axis=0) < np.where(there, state.misfit, np.inf)[lost]
    # a copy: `put` writes into its arrays
    out = state.of(np.arange(len(state.misfit)))
    out.put(lost[better], tried.of(best[better]))
    there[lost[better]] = True
    return out, there


def _channels(samples: Samples, palette: Palette) -> Samples:
    """Body-ness and brightness of the samples; (n, 2, m)."""
    return np.stack([palette.body_share(samples), np.minimum(palette.grey(samples), 2.2)], axis=1)


def _ends(template: Template, grid: PatchGrid, tape: Tape) -> FloatArray:
    """Ways in which the ends of parts differ; (10, channels, m).

    For each end: its inner edge lies elsewhere, its metal is brighter, the solder beyond it is brighter, or more like a body, and
    so is its metal.
    """
    length, width, _ = tape.part.body_mm
    da, _ = gradients(template.value, grid)
    broad = np.abs(grid.b_mm) < width / 2 + 0.02
    out = []
    for end in (-1, 1):
        a = end * grid.a_mm
        inner = broad & (a > 0.08 * length) & (a < 0.42 * length)
        beyond, metal = _rise(a - length / 2), _rise(a - 0.28 * length) - _rise(a - length / 2)
        none = np.zeros(grid.count)
        # channels are body-ness and brightness; an edge that lies elsewhere is the template's slope there
        out += [-da * inner, np.stack([none, metal]), np.stack([none, beyond]), np.stack([beyond, none])]
        out.append(np.stack([metal, none]))
    return np.stack(out)


def _rise(distance_mm: FloatArray) -> FloatArray:
    """A unit step blurred by the optics, at distances from it."""
    return 0.5 * (1.0 + np.tanh(distance_mm / 0.025))


def _centroids(picture: Picture, warp: Warp, tape: Tape, palette: Palette, sites_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shift of the centroid of body colour near each place, and its area in units of the usual one."""
    length = tape.part.body_mm[0]
    # not as far as the nearest that a neighbour may be
    reach = min(0.75 * length, 0.45 * (tape.pitch_mm - 2 * tape.displacement_mm))
    grid = patch_grid(reach, reach, min(warp.px_per_mm, 30.0))
    body = palette.body_share(sample(picture, warp, sites_mm, 0.0, grid))
    near = (np.hypot(grid.a_mm, grid.b_mm) < reach).astype(np.float32)
    body = np.where(body > LIKE_BODY, body, 0.0) * near
    mass = body.sum(axis=1, dtype=np.float64)
    # missing parts have little of the colour, and must not lower what is usual
    usual = float(np.median(mass[mass > 0.3 * np.percentile(mass, 90)])) if mass.any() else 1.0
    safe = np.maximum(mass, 1e-6)
    centre = np.stack([body @ grid.a_mm, body @ grid.b_mm], axis=1) / safe[:, None]
    centre[mass < 0.1 * usual] = 0.0
    return centre, mass / usual
