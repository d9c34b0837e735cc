"""Errors against the Cramer-Rao bound for the dots' own error, and times beside those of AprilTag."""

from __future__ import annotations

import atexit
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import log
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab import Localizer
from tactape_fab.sense import Frame
from tactape_fab.sense.decode.dots.detect import Dots, detect
from tactape_fab.sense.decode.dots.elongation import parity_log_ratio
from tactape_fab.sense.decode.dots.rim import settled
from tactape_fab.sense.decode.grid.fit import fit_grid, posteriors
from tactape_fab.sense.decode.grid.lattice import find_lattices
from tactape_fab.sense.decode.rule import MOST_TURN_SHARE
from tactape_fab.texture.frames import FloatArray, IntArray
from tests.bench.localization_measure import error_of, is_right
from tests.bench.localization_rows import FELT, Row, frames_of, registered_tape

PX_PER_MM = 16.0
CENTRE_PX = np.array([159.5, 119.5])
IMPRINTS = np.array([FELT, 0.5, 0.7, 0.9, 0.99, 1.0 + 1e-9])
"""Dots of like imprint err alike."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """Errors of x, y (um) and theta (deg) in the default scene.

    Attributes
    ----------
    rms, bound : ndarray, shape (3,)
        As measured, and the least that any unbiased estimate from these dots can have, the scale being known.
    calibration : ndarray, shape (3,)
        Mean squared error of each over its reported variance.
    nees : float
        Mean of the normalised error squared over its expectation.
    dot_px : ndarray
        Error of a dot per axis by imprint (`IMPRINTS`).
    """

    rms: FloatArray
    bound: FloatArray
    calibration: FloatArray
    nees: float
    dot_px: FloatArray
    frames: int

    @property
    def ratio(self) -> FloatArray:
        return self.rms / self.bound


def accuracy_of(localizer: Localizer, row: Row, count: int) -> Accuracy:
    """Measure a row's frames that are located and right."""
    kept: list[tuple[Frame, FloatArray, FloatArray]] = []
    dots: list[tuple[FloatArray, FloatArray]] = []
    for frame in frames_of(row, count):
        fix = localizer.locate(frame.depth)
        if is_right(fix, frame):
            assert fix.covariance is not None
            kept.append((frame, error_of(fix, frame), fix.covariance))
            dots.append(_dot_errors(frame))
    imprint, error_px = (np.concatenate(values) for values in zip(*dots, strict=True))
    which = np.digitize(imprint, IMPRINTS) - 1
    dot_px = np.array([_sigma(error_px[which == k]) for k in range(len(IMPRINTS) - 1)])
    bounds = np.array([_bound(frame, dot_imprint, dot_px) for (frame, _, _), (dot_imprint, _) in zip(kept, dots, strict=True)])
    errors = np.array([error for _, error, _ in kept])
    covariances = np.array([covariance for _, _, covariance in kept])
    units = np.array([1000.0, 1000.0, np.degrees(1.0)])
    return Accuracy(
        rms=np.sqrt((errors**2).mean(axis=0)) * units,
        bound=np.sqrt(bounds.mean(axis=0)) * units,
        calibration=(errors**2 / covariances[:, [0, 1, 2], [0, 1, 2]]).mean(axis=0),
        nees=float(np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]).mean() / 3),
        dot_px=dot_px,
        frames=len(kept),
    )


def _dot_errors(frame: Frame) -> tuple[FloatArray, FloatArray]:
    """Imprints (k,) and errors (k, 2) in px of the true dots that were found."""
    found = detect(frame.depth, PX_PER_MM).xy_px
    apart = found[None] - frame.dots_px[:, None]
    nearest = np.hypot(apart[..., 0], apart[..., 1]).argmin(axis=1)
    error = apart[np.arange(len(nearest)), nearest]
    near = (np.hypot(*error.T) < 0.25 * PX_PER_MM) & (frame.dots_imprint > FELT)
    return frame.dots_imprint[near], error[near]


def _sigma(error_px: FloatArray) -> float:
    """Robust rms of both axes together: outliers carry no information, and none is counted."""
    return float(np.sqrt(np.median((error_px**2).sum(axis=1)) / (2 * np.log(2))))


def _bound(frame: Frame, imprint: FloatArray, dot_px: FloatArray) -> FloatArray:
    """Least variances of (x mm, y mm, theta rad) from dots of these errors."""
    at = frame.dots_px[frame.dots_imprint > FELT]
    sigma_px = dot_px[np.digitize(frame.dots_imprint[frame.dots_imprint > FELT], IMPRINTS) - 1]
    found = len(imprint) / max(len(at), 1)  # a few dots at the rim are not found; taken off evenly
    u, v = ((at - CENTRE_PX) / PX_PER_MM).T
    c, s = np.cos(np.radians(frame.theta_deg)), np.sin(np.radians(frame.theta_deg))
    x, y = c * u + s * v, c * v - s * u
    weight = found * (PX_PER_MM / sigma_px) ** 2
    ones, zero = np.ones_like(x), np.zeros_like(x)
    jacobian = np.stack([np.stack([ones, zero, y], axis=-1), np.stack([zero, ones, -x], axis=-1)], axis=1)
    information = np.einsum("n,nai,naj->ij", weight, jacobian, jacobian)
    return np.asarray(np.diag(np.linalg.inv(information)))


# Posteriors

CONFIDENCES = np.array([0.5, 0.7, 0.9, 0.97, 0.99, 0.999, 1.0 + 1e-9])


@dataclass(frozen=True, slots=True, kw_only=True)
class Reliability:
    """How often the likelier value of a bit is the true one, by what its posterior says (`CONFIDENCES`).

    A dot that is no part counts as half right, a fair coin.
    """

    bits: FloatArray
    said: FloatArray
    true: FloatArray


def _on_grid(frame: Frame) -> tuple[Dots, FloatArray, IntArray, FloatArray, float]:
    """Settled dots of a frame, and what `fit_grid` says of them."""
    tape = registered_tape()
    pitch_px, shift = tape.pitch_mm * PX_PER_MM, tape.displacement_mm / tape.pitch_mm
    dots = settled(detect(frame.depth, PX_PER_MM), pitch_px, shift)
    xy = dots.xy_px - dots.trust @ dots.xy_px / dots.trust.sum()
    best = find_lattices(xy, dots.trust * dots.weights, pitch_px, 0.07, 1)[0]
    return dots, *fit_grid(xy, dots.weights, dots.trust, best[0], best[1], best[2], best[3], shift, True)[:4]


def _turn(frame: Frame, grid: FloatArray) -> int:
    return round((frame.theta_deg - float(np.degrees(np.arctan2(grid[1], grid[0])))) / 90.0) % 4


def reliability_of(row: Row, count: int) -> Reliability:
    """Posteriors of the bits of all dots in a row's frames against the truth."""
    tape = registered_tape()
    said: list[FloatArray] = []
    true: list[FloatArray] = []
    for frame in frames_of(row, count):
        dots, grid, nodes, squares, sigma = _on_grid(frame)
        q = posteriors(nodes, squares, dots.weights, dots.trust, sigma)
        turn = _turn(frame, grid)
        e, s, w, _ = np.roll(q, -turn, axis=1).T
        apart = np.hypot(*(dots.xy_px[:, None] - frame.dots_px[None]).transpose(2, 0, 1))
        cells = tape.cells()[frame.dots_part[apart.argmin(axis=1)]]
        symbols = tape.symbols[cells[:, 1], cells[:, 0]]
        part = apart.min(axis=1) < 0.4 * PX_PER_MM
        for one, bit in ((w + s, symbols & 1), (e + s, symbols >> 1)):
            said.append(np.maximum(one, 1.0 - one))
            true.append(np.where(part, (one >= 0.5) == (bit == 1), 0.5))
    each, right = np.concatenate(said), np.concatenate(true)
    which = np.digitize(each, CONFIDENCES) - 1
    bits = np.bincount(which, minlength=len(CONFIDENCES) - 1)
    safe = np.maximum(bits, 1)
    return Reliability(
        bits=bits.astype(np.float64),
        said=np.bincount(which, each, len(CONFIDENCES) - 1) / safe,
        true=np.bincount(which, right, len(CONFIDENCES) - 1) / safe,
    )


RATIOS = np.array([0.0, 0.5, 1.0, 2.0, log(MOST_TURN_SHARE / (1.0 - MOST_TURN_SHARE)), np.inf])
"""ln ratios of the two pairs of turns, up to the one from which no more is believed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Turns:
    """How often the dots' elongation speaks for the wrong pair of quarter turns, and how often it says so, by `RATIOS`."""

    frames: IntArray
    wrong: FloatArray
    said: FloatArray


def turn_said(frame: Frame) -> float | None:
    """Ln of how much likelier the elongation makes the true pair of turns than the other; None where no grid is found."""
    dots, grid, *_ = _on_grid(frame)
    off_deg = frame.theta_deg - float(np.degrees(np.arctan2(grid[1], grid[0])))
    if not abs((off_deg + 45.0) % 90.0 - 45.0) < 5.0:
        return None
    ratio = parity_log_ratio(dots.elongation, dots.weights, dots.trust, grid, registered_tape().part)
    return ratio if _turn(frame, grid) % 2 == 0 else -ratio


def doubt_said(ratio: FloatArray) -> FloatArray:
    """Weight that the decoder leaves to the less likely pair of turns, by the ln ratios of both."""
    return np.maximum(1.0 / (1.0 + np.exp(np.abs(ratio))), 1.0 - MOST_TURN_SHARE)


def turns_of(rows: Sequence[Row], count: int) -> Turns:
    """What the elongation says of the turns in frames whose grid is found."""
    said = (turn_said(frame) for row in rows for frame in frames_of(row, count))
    ratio = np.array([one for one in said if one is not None])
    which = np.digitize(np.abs(ratio), RATIOS) - 1
    frames = np.bincount(which, minlength=len(RATIOS) - 1)
    return Turns(
        frames=frames,
        wrong=np.bincount(which, ratio < 0.0, len(RATIOS) - 1) / np.maximum(frames, 1),
        said=np.bincount(which, doubt_said(ratio), len(RATIOS) - 1) / np.maximum(frames, 1),
    )


# Time


def times_ms(function: Callable[[Any], object], inputs: list[Any], rounds: int) -> FloatArray:
    """Milliseconds of every call, the first round left out."""
    for value in inputs:
        function(value)
    times = []
    for _ in range(rounds):
        for value in inputs:
            start = perf_counter()
            function(value)
            times.append((perf_counter() - start) * 1000.0)
    return np.array(times)


@cache
def tag_detector() -> Any:
    """A pupil-apriltags detector, full resolution, that lives as long as the process.

    Its destructor frees the tag family before the detector that points to it (pupil-apriltags 1.0.4); without a pointer
    the destructor does nothing.
    """
    from pupil_apriltags import Detector

    detector = Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)
    atexit.register(setattr, detector, "tag_detector_ptr", None)
    return detector


def tag_frames(count: int, size: tuple[int, int] = (320, 240), side_px: int = 150) -> list[npt.NDArray[np.uint8]]:
    """Grey frames, (width, height) px, with one tag36h11 each at any angle, a little blurred and noisy."""
    import cv2

    rng = np.random.default_rng(1)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    frames = []
    for k in range(count):
        tag = cv2.copyMakeBorder(
            cv2.aruco.generateImageMarker(family, k % 587, side_px), 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=255
        )
        middle = (tag.shape[1] - 1) / 2
        move = cv2.getRotationMatrix2D((middle, middle), float(rng.uniform(-180, 180)), 1.0)
        move[:, 2] += [(size[0] - 1) / 2 - middle, (size[1] - 1) / 2 - middle]
        frame = cv2.warpAffine(tag, move, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=200)
        frame = cv2.GaussianBlur(frame, (0, 0), 0.8).astype(np.float64) + rng.normal(0.0, 3.0, frame.shape)
        frames.append(np.clip(frame, 0, 255).astype(np.uint8))
    return frames
