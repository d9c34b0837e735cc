"""Conventions by which poses of a flange may have been written, each held against the presses by its likelihood.

Poses of a wrong convention fit presses that hardly turn to a few tenths of a millimetre, as right ones of a worse arm do: no
limit tells them apart. But taken as they were meant they fit far better, to the errors of arm and gel. A wrong convention is k
times as likely as the right one by chance with a probability of 1 / k at most (Royall, Statistical evidence, 1997, section 1.4).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import pi

import numpy as np
from scipy.spatial.transform import Rotation

from tactape_fab.sense.calibrate.misfits import FAR_MM, LEAST_SIGMAS, SIGMAS, matrix_of, on_tape, turned_starts
from tactape_fab.texture.frames import FloatArray

LEAST_GAIN = 10.0
"""Least ln of the ratio of likelihoods at which another convention is the one that was meant. It was 5.1 at most in 511 random
campaigns of right poses on flat tapes: 6 to 15 poses, turned by 1 to 360 deg, errors up to 0.3 mm, 1.5 mm of height and 11 deg of
tilt, some with heavy tails. Of 675 sets of poses in a wrong convention 98 in 100 have more."""
_STEPS = (14, 4, 4, 4)
"""Steps of a fit with the initial sizes of errors, and then with those of what is left over."""
_DAMP, _MOST_DAMP = 1e-3, 1e3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Convention:
    """How poses are to be taken, and root mean squares of x, y, z (mm) and turns (rad) left over as read and taken so."""

    words: str
    as_read: FloatArray
    left: FloatArray


def better_convention(arm: FloatArray, poses: FloatArray, origin_mm: FloatArray, start: FloatArray) -> Convention | None:
    """The convention of poses, if it is far likelier than the one by which they were read; None if that may be right.

    arm (m, 4, 4), poses (m, 3), start (12,): As of `misfits`; `start` is a solution for the poses as they were read.
    """
    taken = np.stack([arm, *(meant(arm) for meant in MEANT.values())])
    seen = on_tape(poses, origin_mm)
    guesses = np.concatenate([turned_starts(), matrix_of(start[None, :6])])
    left = fitted_all(taken, seen, guesses)
    # errors of each kind have their own size, which is estimated: ln L is - m ln of it, up to a constant
    minus_ln = len(arm) * np.log(np.maximum(left, LEAST_SIGMAS)).sum(axis=-1)
    best = minus_ln.argmin(axis=1)
    least = minus_ln.min(axis=1)
    k = int(least[1:].argmin()) + 1
    if least[0] - least[k] < LEAST_GAIN:
        return None
    return Convention(words=list(MEANT)[k - 1], as_read=left[0, best[0]], left=left[k, best[k]])


def fitted_all(taken: FloatArray, seen: FloatArray, guesses: FloatArray) -> FloatArray:
    """Root mean squares of what is left over of each kind, of fits of every candidate from every guess (Marquardt's method).

    taken (c, m, 4, 4): Poses of the flange, as each convention has them.
    seen (m, 4, 4): Of the sensor on the tape.
    guesses (s, 4, 4): Of the sensor on the flange.
    Returns: (c, s, 6).
    """
    arm, inverse = np.repeat(taken, len(guesses), axis=0), _inverted(seen)
    sensor = np.tile(guesses, (len(taken), 1, 1))
    # Y = B X P^-1: the first press fits exactly
    tape = arm[:, 0] @ sensor @ inverse[0]
    sigmas, damp = np.tile(SIGMAS, (len(arm), 1)), np.full(len(arm), _DAMP)
    back = _adjoints(inverse)
    for steps in _STEPS:
        off, left, cost = _misfits(arm, inverse, sensor, tape, sigmas)
        for _ in range(steps):
            step = _step(off, left, sensor, tape, sigmas, damp, back)
            moved = np.asarray(sensor @ matrix_of(step[:, :6])), np.asarray(tape @ matrix_of(step[:, 6:]))
            after = _misfits(arm, inverse, *moved, sigmas)
            better = after[2] < cost
            by = better[:, None, None]
            sensor, tape, left = np.where(by, moved[0], sensor), np.where(by, moved[1], tape), np.where(by, after[1], left)
            off, cost = np.where(by[..., None], after[0], off), np.where(better, after[2], cost)
            damp = np.where(better, 0.1 * damp, np.minimum(10.0 * damp, _MOST_DAMP))
        rms = np.asarray(np.sqrt((left**2).mean(axis=1)), dtype=np.float64)
        sigmas, damp = np.maximum(rms, LEAST_SIGMAS), np.full(len(arm), _DAMP)
    return rms.reshape(len(taken), len(guesses), 6)


def _misfits(
    arm: FloatArray, inverse: FloatArray, sensor: FloatArray, tape: FloatArray, sigmas: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """P^-1 Y^-1 B X (n, m, 4, 4), the same as translations (mm) and rotation vectors (rad), and the sums of weighted squares."""
    off = inverse @ (_inverted(tape)[:, None] @ arm @ sensor[:, None])
    turns = Rotation.from_matrix(off[..., :3, :3].reshape(-1, 3, 3)).as_rotvec().reshape(*off.shape[:-2], 3)
    left = np.concatenate([off[..., :3, 3], turns], axis=-1)
    far = (sensor[:, :3, 3] ** 2 + tape[:, :3, 3] ** 2).sum(axis=1) / FAR_MM**2
    return off, left, ((left / sigmas[:, None]) ** 2).sum(axis=(1, 2)) + far


def _step(
    off: FloatArray,
    left: FloatArray,
    sensor: FloatArray,
    tape: FloatArray,
    sigmas: FloatArray,
    damp: FloatArray,
    back: FloatArray,
) -> FloatArray:
    """Motions of both transforms in their own frames by the normal equations; (n, 12)."""
    # X exp(s), Y exp(t): off exp(s), and exp(-Ad t) off with Ad that of P^-1; turns to first order
    turn = off[..., :3, :3]
    rates = np.zeros((*left.shape, 12))
    rates[..., :3, :3], rates[..., 3:, 3:6] = turn, np.eye(3)
    rates[..., :3, 6:] = _cross(off[..., :3, 3]) @ back[:, 3:] - back[:, :3]
    rates[..., 3:, 6:] = -np.swapaxes(turn, -1, -2) @ back[:, 3:]
    rows = (rates / sigmas[:, None, :, None]).reshape(len(left), -1, 12)
    values = (left / sigmas[:, None]).reshape(len(left), -1, 1)
    normal, right = np.swapaxes(rows, 1, 2) @ rows, (np.swapaxes(rows, 1, 2) @ values)[..., 0]
    for first, transform in ((0, sensor), (6, tape)):  # both translations' priors
        three = np.arange(first, first + 3)
        normal[:, three, three] += 1.0 / FAR_MM**2
        right[:, three] += (np.swapaxes(transform[:, :3, :3], 1, 2) @ transform[:, :3, 3:])[..., 0] / FAR_MM**2
    every = np.arange(12)
    normal[:, every, every] *= 1.0 + damp[:, None]
    return np.asarray(-np.linalg.solve(normal, right[..., None])[..., 0], dtype=np.float64)


def _cross(v: FloatArray) -> FloatArray:
    """Matrices of the cross products by vectors; (..., 3) to (..., 3, 3)."""
    return np.asarray(np.cross(v[..., None, :], np.eye(3)), dtype=np.float64).swapaxes(-1, -2)


def _adjoints(poses: FloatArray) -> FloatArray:
    """Matrices from small motions in a pose's own frame, shift (mm) and turn (rad), to those outside; (m, 4, 4) to (m, 6, 6)."""
    out, turn = np.zeros((len(poses), 6, 6)), poses[:, :3, :3]
    out[:, :3, :3] = out[:, 3:, 3:] = turn
    out[:, :3, 3:] = _cross(poses[:, :3, 3]) @ turn
    return out


def _inverted(arm: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(arm), dtype=np.float64)


def _with_turns(arm: FloatArray, turns: FloatArray) -> FloatArray:
    out = arm.copy()
    out[:, :3, :3] = turns
    return out


def _rolled(by: int, arm: FloatArray) -> FloatArray:
    """Poses whose quaternions, last entry qw, have their entries moved on."""
    quaternions = np.roll(Rotation.from_matrix(arm[:, :3, :3]).as_quat(), by, axis=1)
    return _with_turns(arm, Rotation.from_quat(quaternions).as_matrix())


def _angles(made: str, meant: str, arm: FloatArray) -> FloatArray:
    """Poses whose angles were turned about axes in another order, of scipy's words for these."""
    with warnings.catch_warnings():
        # a pose at which two axes coincide has angles of many kinds: one of them is as good
        warnings.simplefilter("ignore")
        angles = Rotation.from_matrix(arm[:, :3, :3]).as_euler(made)
    return _with_turns(arm, Rotation.from_euler(meant, angles).as_matrix())


def _rotation_vectors(read: str, arm: FloatArray) -> FloatArray:
    """Poses whose rotation vectors were taken for angles about axes, of scipy's words for these."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        angles = Rotation.from_matrix(arm[:, :3, :3]).as_euler(read)
    # the same turns by the other three angles: a rotation vector is the shorter of both if its entries add up to 1.5 pi at most
    other = (angles * (1.0, -1.0, 1.0) + 2.0 * pi) % (2.0 * pi) - pi
    shorter = (angles**2).sum(axis=1) <= (other**2).sum(axis=1)
    return _with_turns(arm, Rotation.from_rotvec(np.where(shorter[:, None], angles, other)).as_matrix())


def _of_metres(arm: FloatArray) -> FloatArray:
    out = arm.copy()
    out[:, :3, 3] *= 1000.0
    return out


_READ = ("xyz", "XYZ")
_ORDER = "with angles about {} where they were turned about {}"
MEANT: dict[str, Callable[[FloatArray], FloatArray]] = {
    "as the base in the flange, the inverse": _inverted,
    "with the rotation alone inverted": lambda arm: _with_turns(arm, np.swapaxes(arm[:, :3, :3], 1, 2)),
    "with the quaternions as qx,qy,qz,qw": partial(_rolled, 1),
    "with quaternions of qw first that were read as those of qw last": partial(_rolled, -1),
    "with x, y, z in m": _of_metres,
    **{f"with rotation vectors that were read as angles about {read}": partial(_rotation_vectors, read) for read in _READ},
    **{
        _ORDER.format(meant, made): partial(_angles, made, meant)
        for meant, made in (("xyz", "XYZ"), ("XYZ", "xyz"), ("xyz", "zyx"), ("zyx", "xyz"), ("ZYX", "XYZ"), ("XYZ", "ZYX"))
    },
}
"""How poses may have been meant, by words for that. Orders of angles are as of scipy: small letters for fixed axes, capitals for
axes that turn along."""
