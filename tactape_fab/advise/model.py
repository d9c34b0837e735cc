"""Model of the smallest contact that a design locates: the decoder's rule applied to random dots, without drawing frames.

A dot is at its part's place, displaced by noise and placement errors; its height is that of its imprint relative to the noise.
The evidence of a dot, and the required evidence of all dots, are by the decoder's rule (`sense.decode.rule`). `Loss` accounts for
detection and the search for the grid; it is calibrated with simulated frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, erf, exp, hypot, inf, log, pi, sqrt

import numpy as np

from tactape_fab.advise.noise import noise_of
from tactape_fab.sense.decode.rule import (
    GOOD_WEIGHT,
    GRID_SHARES,
    LEAST_DOTS,
    LEAST_GOOD,
    LEAST_HEIGHT,
    LEAST_NOISE,
    LEAST_SIGMA,
    MAX_P_FALSE,
    MOST_SIGMA,
    MOST_TURN_SHARE,
    SMOOTHING_MM,
    posteriors,
    squared_errors,
    trusted,
)
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.sense.simulation.scene import Scene
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.part import is_long
from tactape_fab.texture.plane import Plane, PlaneCode

_SCENE = Scene()
BODY_MM = 0.23
"""Height of an 0201, mm, for which the default scene's imprint is defined."""
IMPRINT_SHARE = _SCENE.texture_mm / BODY_MM
"""Fraction of a body's height that the gel is imprinted with, before smoothing."""
ROLL_OFF_MM = _SCENE.roll_off_mm
"""Width of a contact's rim, mm."""
CLEAN = 0.25
"""Largest error of dots, in displacements, at which the grid is always found."""
FLAT = 2.0
"""Length of a block's top that gel and decoder leave flat, in displacements, up to which it does no harm: in the falling depth at
a contact's rim such a top moves nearly as far as its symbol does, by 0.03 mm rms of 0402 in contacts of 9 mm."""
POSES = 240
_LATTICE = 33
_TOPS = 600
_FIRST_PITCHES, _GROWTH = 4.5, 1.25
"""First diameter of the search for the smallest contact, in pitches, and growth factor; large contacts are slow to evaluate."""
_SEED = 11


@dataclass(frozen=True, slots=True, kw_only=True)
class Code:
    """A code, and how similar its places are.

    A place of the same code may have all bits of one axis in common with the answer, so that only the other axis distinguishes
    them. `axis` is ln of the effective number of such places; -inf for a code whose places share nothing.
    """

    name: str
    axis: float


CODES = (
    Code(name="microdots-4x4", axis=0.0),
    Code(name="debruijn-4x4", axis=1.5),
    Code(name="anoto-6x6", axis=0.7),
    *(Code(name=name, axis=-inf) for name in ("trace-22", "touch-1", "touch-2")),
)
"""The codes that are proposed; the first that locates the contact is used. `axis` is from error-free contacts of 11 to 25
dots."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """Loss of information in frames, compared with the random dots.

    share: Fraction of the information that remains.
    noise: Median height of the noise's tops, relative to its rms.
    clutter_um: Rms of other structures with tops: rims, and the contact's own shape.
    tops: Number of the noise's tops per squared correlation length.
    scatter: Fraction by which a contact must be larger per displacement of dot error beyond `CLEAN`, as grids are missed.
    flat: Fraction by which it must be larger per displacement of a block's flat top beyond `FLAT`.
    eight: Factor by which a contact must be larger with eight directions, as a grid is fitted to dots at any of eight places.
    """

    share: float
    noise: float
    clutter_um: float
    tops: float
    scatter: float
    flat: float
    eight: float


LOSS = Loss(share=1.0, noise=0.79, clutter_um=2.5, tops=0.04, scatter=0.25, flat=0.25, eight=1.15)
"""The values that fit simulated contacts of 24 designs best: `python -m tests.bench.advise --fit`, which asks for `tops` and
`scatter`, with white and smooth noise. `clutter_um` is from the same designs with the slope noise of a GelSight Mini: without it
those whose parts rise 5 to 15 um were promised contacts 10 to 15 % too small (misfit 0.19, with it 0.09). `flat` is from nine
designs of 0402, W 1.77 to 2.2 and blurs of 0.1 to 0.25 mm: of the contact of which nine in ten are located they were promised
0.77 to 1.06 without it, 0.99 to 1.07 with it. `eight` was
chosen so that the predictions for 10 designs of eight directions hold with that noise, too: with 1.09 two blocks of them located
72 and 73 % of contacts. Without `--fit` predictions are tested on other designs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """A design as seen by a sensor.

    shape {"block", "dome"}
    points: Grid points of one tape.
    tapes: Registered tapes.
    blur_mm, placement_mm: Standard deviations of the gel's smoothing, and of the parts' places along each axis.
    directions: Number of displacement directions.
    """

    pitch_mm: float
    displacement_mm: float
    shape: str
    body_mm: tuple[float, float, float]
    points: int
    tapes: int
    sensor: SensorProfile
    blur_mm: float
    placement_mm: float
    directions: int = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """Height of a dot, and the noise around it.

    height_um: Height of its top over the background.
    noise_um, alike_mm: Rms of the noise about it, and its correlation length, after the decoder's filter.
    error_mm, pull_mm: Standard deviations of its top's displacement along one axis, by noise and by its neighbours.
    """

    height_um: float
    noise_um: float
    alike_mm: float
    error_mm: float
    pull_mm: float


@lru_cache(maxsize=64)
def signal_of(seen: Seen) -> Signal:
    """Height of a top, rms of the noise around it, and its displacement by noise along one axis, after the decoder's smoothing.

    The bump is the body smoothed by gel and decoder, less the mean over the pitch; a top moves by the noise's slope over the
    bump's curvature.
    """
    s_mm = hypot(seen.blur_mm, SMOOTHING_MM)
    # consecutive Gaussian filters are one with the sum of the variances
    peak, curvature, area_mm2 = _bump(seen, s_mm)
    high_um = 1000.0 * IMPRINT_SHARE * seen.body_mm[2]
    # the detector subtracts the mean of the smoothed relief: a body's volume over a cell's area, W^2
    height_um = high_um * (peak - min(area_mm2 / seen.pitch_mm**2, 1.0))
    noise_um, alike_mm, slope_um_mm = noise_of(seen.sensor)
    # the top is where the slope is zero: - curvature x + noise's slope = 0
    error_mm = slope_um_mm / max(high_um * curvature, 1e-9)
    return Signal(
        height_um=height_um,
        noise_um=noise_um,
        alike_mm=alike_mm,
        error_mm=error_mm,
        pull_mm=_pull_mm(seen, s_mm),
    )


def _pull_mm(seen: Seen, s_mm: float) -> float:
    """Standard deviation, along one axis, of a top's displacement towards its two neighbours; bumps are taken as Gaussians.

    It is taken over all pairs of symbols, which change the distance of the neighbours.
    """
    # a box of side a has the variance a^2 / 12, and the mean of both axes is taken
    width2_mm2 = s_mm**2 + (seen.body_mm[0] ** 2 + seen.body_mm[1] ** 2) / 24.0
    along = _around(seen.directions)[:, 0]
    steps, pairs = np.subtract.outer(along, along).ravel(), np.full(len(along) ** 2, 1.0 / len(along) ** 2)
    apart_mm = seen.pitch_mm + steps * seen.displacement_mm
    # a Gaussian of width s at distance d has the slope d / s^2 exp(-d^2 / 2 s^2) at the top, whose own curvature is 1 / s^2
    drawn_mm = apart_mm * np.exp(-(apart_mm**2) / (2.0 * width2_mm2))
    mean_mm = float(pairs @ drawn_mm)
    # neighbours on both sides pull in opposite directions, so that means cancel and variances add
    return sqrt(2.0 * float(pairs @ (drawn_mm - mean_mm) ** 2))


def _bump(seen: Seen, s_mm: float) -> tuple[float, float, float]:
    """Height of a smoothed body of height 1, its effective curvature over both axes (1/mm²), and its volume (mm²)."""
    if seen.shape == "block":
        lengths = seen.body_mm[:2]
        # a box of side a smoothed along one axis has the height Phi(a / 2 s) - Phi(-a / 2 s) at its middle, and the second
        # derivative - a exp(-a^2 / 8 s^2) / (sqrt(2 pi) s^3)
        along, across = (erf(side / (2.0 * sqrt(2.0) * s_mm)) for side in lengths)
        bend = [side / (sqrt(2.0 * pi) * s_mm**3) * exp(-(side**2) / (8.0 * s_mm**2)) for side in lengths]
        # a top moves by slope over curvature, so the mean square of the inverse curvatures matters
        first, second = 1.0 / max(bend[0] * across, 1e-9), 1.0 / max(bend[1] * along, 1e-9)
        return along * across, 1.0 / sqrt((first**2 + second**2) / 2.0), lengths[0] * lengths[1]
    radius, high = seen.body_mm[0] / 2.0, seen.body_mm[2]
    r = (np.arange(200) + 0.5) / 200.0 * radius
    # radius of the sphere of which the dome is a cap
    ball = (radius**2 + high**2) / (2.0 * high)
    profile = (np.sqrt(np.maximum(ball**2 - r**2, 0.0)) - (ball - high)) / high
    # the Gaussian 1 / (2 pi s^2) exp(-r^2 / 2 s^2) over rings of 2 pi r dr; its second derivative along one axis, on the mean of
    # a ring, is that times (r^2 / 2 s^2 - 1) / s^2
    step, kernel = radius / 200.0, np.exp(-(r**2) / (2.0 * s_mm**2)) / s_mm**2
    peak = float((profile * kernel * r).sum() * step)
    curvature = float((profile * kernel * r * (1.0 - r**2 / (2.0 * s_mm**2))).sum() * step) / s_mm**2
    return peak, max(curvature, 1e-9), float((profile * 2.0 * pi * r).sum() * step)


def _around(directions: int) -> FloatArray:
    """Unit displacements in clockwise order from E; shape (directions, 2)."""
    of = DIRECTIONS[directions]
    return of.xy[of.clockwise]


@lru_cache(maxsize=2)
def _drawn(directions: int) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Random draws that all designs share.

    Symbols (p, k), phases (p, 1, 2), directions (p, k, 2), unit errors (p, k, 2), and tops of noise (m, 4): of these the places
    in a cell, the heights over their median, and a symbol.
    """
    rng = np.random.default_rng(_SEED)
    phases = rng.uniform(-0.5, 0.5, (POSES, 1, 2))
    symbols = rng.integers(0, directions, (POSES, _LATTICE**2))
    errors = rng.standard_normal((POSES, _LATTICE**2, 2))
    tops = np.column_stack(
        [rng.uniform(-0.5, 0.5, (_TOPS, 2)), 1.0 + 0.6 * rng.standard_normal(_TOPS), rng.integers(0, directions, _TOPS)]
    )
    return symbols, phases, _around(directions)[symbols], errors, tops


@lru_cache(maxsize=1)
def _nodes() -> FloatArray:
    """Grid points sorted by their distance from the centre; shape (k, 2)."""
    span = np.arange(_LATTICE) - _LATTICE // 2
    nodes = np.stack(np.meshgrid(span, span), axis=-1).reshape(-1, 2).astype(np.float64)
    return nodes[np.argsort(np.hypot(*nodes.T), kind="stable")]


def located_share(seen: Seen, contact_mm: float, code: Code, loss: Loss, plane: Plane | None = None) -> float:
    """Fraction of round contacts of a diameter, within the field of parts, that are located, by p_tape + p_place as in `rule`.

    With `plane`, no tape is registered, and all places of the plane in all sectors are compared.
    """
    gain, per_axis, dots, turn = _information(seen, contact_mm, loss)
    # 1 / (w E): places of equal weight, in four turns each, on the best grid
    ln_places, axis = log(4.0 * seen.points * seen.tapes), code.axis
    if plane is not None:
        ln_places, turn = log(4.0 * plane.range**2 * plane.sectors), np.zeros_like(turn)
        axis = log(plane.range * plane.main.length) if isinstance(plane, PlaneCode) else -inf
    p_tape = np.exp(np.minimum(ln_places - log(GRID_SHARES[0]) - loss.share * gain - turn, 50.0))
    # rivals that share an axis, over the evidence of the other axis; small, so others / (1 + others) is others
    p_place = np.exp(np.minimum(axis - loss.share * per_axis, 50.0)).sum(axis=1)
    return float(((p_tape + p_place < MAX_P_FALSE) & (dots >= LEAST_DOTS)).mean())


def _dots(seen: Seen, contact_mm: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Parts that may be in each pose's contact: places from its middle (p, k, 2), pitches, weights (p, k), and squared errors.

    Errors (p, k), along one axis, in pitches squared: those of tops increase towards the rim, those of places do not.
    """
    _, phases, directions, _, _ = _drawn(seen.directions)
    pitch, shift, signal = seen.pitch_mm, seen.displacement_mm / seen.pitch_mm, signal_of(seen)
    # nodes whose part can be in the contact, nearer by its displacement and half a cell's diagonal (0.71), in pitches
    reach = (contact_mm + ROLL_OFF_MM) / 2.0 / pitch + shift + 0.8
    count = int(np.count_nonzero(np.hypot(*_nodes().T) < reach))
    # the contact's middle is anywhere in its cell
    at = _nodes()[:count] + shift * directions[:, :count] - phases
    inside = contact_mm / 2.0 - pitch * np.hypot(at[..., 0], at[..., 1])
    t = np.clip(0.5 + inside / ROLL_OFF_MM, 0.0, 1.0)
    weight = t * t * (3.0 - 2.0 * t)  # the rim of a simulated contact
    return at, weight, squared_errors(weight, signal.error_mm / pitch) + (_placed_mm(seen, signal) / pitch) ** 2


def _placed_mm(seen: Seen, signal: Signal) -> float:
    """Standard deviation of a dot along one axis that does not depend on its height."""
    return hypot(seen.placement_mm, signal.pull_mm)


@lru_cache(maxsize=64)  # codes are compared by the same contacts of a design, one after the other
def _information(seen: Seen, contact_mm: float, loss: Loss) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Evidence of each pose's dots in nats: total (p,), by axis (p, 2), number of dots (p,), and by shape for the turn (p,)."""
    symbols, _, _, errors, _ = _drawn(seen.directions)
    pitch, shift, signal = seen.pitch_mm, seen.displacement_mm / seen.pitch_mm, signal_of(seen)
    _, weight, squares = _dots(seen, contact_mm)
    true, count = np.sqrt(squares), weight.shape[1]
    tops_um = loss.noise * hypot(signal.noise_um, loss.clutter_um)
    noise = max(tops_um / max(signal.height_um, 1e-9), LEAST_NOISE)
    sigma = min(max(hypot(signal.error_mm, _placed_mm(seen, signal)) / pitch, LEAST_SIGMA), MOST_SIGMA)
    # errors along the symbol's own direction, and across it
    e, f = true * errors[:, :count, 0], true * errors[:, :count, 1]
    q = posteriors(_squared_distances(e, f, shift, seen.directions), squared_errors(weight, sigma), trusted(weight, noise))
    seen_dots = weight >= LEAST_HEIGHT
    first, *others = (np.where(seen_dots, evidence, 0.0).sum(axis=1) for evidence in _bit_evidence(q, symbols[:, :count]))
    second = np.sum(others, axis=0)
    good = np.count_nonzero(weight >= GOOD_WEIGHT, axis=1)
    turn = np.where((good >= LEAST_GOOD) & is_long(seen.shape, seen.body_mm), log(2.0 * MOST_TURN_SHARE), 0.0)
    # number of the noise's tops in the sensor's field, times the mean loss by one
    lost = loss.tops * _lost_to_noise(noise, sigma, shift, seen.directions) * _field_mm2(seen.sensor) / signal.alike_mm**2
    # a top of noise is evidence against both axes equally
    per_axis = np.stack([first, second], axis=1) - lost / 2.0
    return first + second - lost, per_axis, seen_dots.sum(axis=1), turn


def _squared_distances(e: FloatArray, f: FloatArray, shift: float, directions: int) -> FloatArray:
    """Squared distances of dots with given errors to all symbols' places around a grid point, the dot's own first."""
    # in a frame in which the dot's symbol points along x: the dot is at (shift + e, f), a place at shift (x, y)
    return np.stack([(e + shift * (1.0 - x)) ** 2 + (f - shift * y) ** 2 for x, y in _around(directions).tolist()])


def _bit_evidence(q: FloatArray, symbols: IntArray) -> list[FloatArray]:
    """Evidence of dots for each bit of their symbols, nats, from that of all places, their own first.

    With four directions each neighbouring symbol has one of the two bits in common. With eight, bits are `Directions.gray_codes`.
    """
    if len(q) == 4:
        # q of a bit is the sum over the symbols with that bit: the dot's own and one neighbour; 2 q is the factor of evidence
        return [np.log(2.0 * (q[0] + q[k])) for k in (1, 3)]
    bits, found = _BITS_AROUND, []
    for of in bits:
        # whether the symbol k places further has the same bit
        alike = np.stack([of == np.roll(of, -k) for k in range(8)])
        found.append(np.log(2.0 * (q * alike[:, symbols]).sum(axis=0)))
    return found


_BITS_AROUND = np.array([DIRECTIONS[8].gray_codes[DIRECTIONS[8].clockwise] >> bit & 1 for bit in range(3)])
"""Bits of the symbols in the order of `_around`: E, SE, S, ...; shape (3, 8)."""


@lru_cache(maxsize=64)
def _lost_to_noise(noise: float, sigma: float, shift: float, directions: int) -> float:
    """Mean loss by a top of the noise, nats, which is anywhere in its cell, with a trust that depends on its height."""
    e, f, height, symbol = _drawn(directions)[4].T
    weight = noise * height
    away = np.stack([(e - a * shift) ** 2 + (f - b * shift) ** 2 for a, b in _around(directions).tolist()])
    q = posteriors(away, squared_errors(weight, sigma), trusted(weight, noise))
    one = symbol.astype(np.int64)
    # the symbol of the hypothesis is random, and has to come first
    around = np.stack([np.take_along_axis(q, ((one + k) % directions)[None], axis=0)[0] for k in range(directions)])
    evidence = np.sum(_bit_evidence(around, one), axis=0)
    return float(np.where(weight >= LEAST_HEIGHT, -evidence, 0.0).mean())


def _field_mm2(sensor: SensorProfile) -> float:
    return sensor.width_px / sensor.px_per_mm[0] * sensor.height_px / sensor.px_per_mm[1]


def least_contact_mm(
    seen: Seen, code: Code, loss: Loss, share: float, most_mm: float, plane: Plane | None = None
) -> float | None:
    """The smallest contact located with that probability, rounded up to 0.1 mm; None if none up to `most_mm` is.

    None for parts lower than the noise.
    """
    signal = signal_of(seen)
    if signal.noise_um > signal.height_um:
        return None
    # errors in displacements of four directions with the same distance of neighbouring places
    apart_mm = seen.displacement_mm * DIRECTIONS[seen.directions].spacing
    missed = hypot(signal.error_mm, seen.placement_mm, signal.pull_mm) / apart_mm - CLEAN
    larger = (1.0 + loss.scatter * max(missed, 0.0)) * {4: 1.0, 8: loss.eight}[seen.directions]
    larger *= 1.0 + loss.flat * max(_flat_top_mm(seen) / apart_mm - FLAT, 0.0)
    # sizes as integers in tenths of a millimetre, so that the bisection terminates; 1e-9 against rounding errors
    low, most = 10, int(most_mm / larger * 10.0 + 1e-9)
    high = min(int(10.0 * _FIRST_PITCHES * seen.pitch_mm), most)
    while high <= low or located_share(seen, high / 10.0, code, loss, plane) < share:
        if high >= most:
            return None
        low, high = max(low, high), min(int(_GROWTH * high) + 1, most)
    # high reaches the fraction and low does not, as 1 mm has fewer than six dots; larger contacts show more
    while high - low > 1:
        middle = (low + high) // 2
        if located_share(seen, middle / 10.0, code, loss, plane) >= share:
            high = middle
        else:
            low = middle
    return ceil(high * larger - 1e-9) / 10.0


def _flat_top_mm(seen: Seen) -> float:
    """Length of a body's top that stays flat after the smoothing by gel and decoder; 0 of domes and of small blocks."""
    if seen.shape != "block":
        return 0.0
    return max(max(seen.body_mm[:2]) - 2.0 * hypot(seen.blur_mm, SMOOTHING_MM), 0.0)


def accuracy(seen: Seen, contact_mm: float) -> tuple[float, float]:
    """Median error of the position of the contact's middle (mm), and of the angle (deg), for a contact of a diameter.

    By least squares for x, y, the angle and the camera's shear, which has the profile's prior; dots weigh by their errors.
    """
    at, weight, squares = _dots(seen, contact_mm)
    each = np.where(weight >= LEAST_HEIGHT, 1.0 / squares, 0.0)
    all_dots = each.sum(axis=1)
    middle = (each[..., None] * at).sum(axis=1) / all_dots[:, None]
    # sum of r^2 / sigma^2 from the dots' centroid; half of it is along each axis
    around = (each * ((at - middle[:, None]) ** 2).sum(axis=-1)).sum(axis=1)
    # shear moves dots along u in proportion to v, as half of a turn does: a shear that is not known leaves the angle half of the
    # information. Of the 2 x 2 normal matrix [[around, around / 2], [around / 2, around / 2 + 1 / sigma_shear^2]]
    sheared = 0.5 * around * seen.sensor.geometry.sigma_shear**2
    turn = 1.0 / (around * (1.0 - 0.5 * sheared / (sheared + 1.0)))
    place = 1.0 / all_dots + 0.5 * (middle**2).sum(axis=1) * turn
    # medians of the length of two equal normal components, and of the absolute value of one
    place_mm = 1.1774 * seen.pitch_mm * float(np.sqrt(np.median(place)))
    return place_mm, float(np.degrees(0.6745 * np.sqrt(np.median(turn))))
