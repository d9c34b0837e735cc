"""Change between two frames of one contact, from the dots that both show: what the frames have in common cancels.

Errors by the camera, by the placement of parts and by the contact's rim are nearly the same in both poses, and cancel in the
difference of each dot: a rigid tape moves all its dots as one. What a tilt or a bend does to a dot is another in each frame:
places are those that the answers were fitted to, which are free of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, radians

import numpy as np

from tactape_fab.sense.decode.result import Localization, LocatedDots
from tactape_fab.sense.decode.rule import AGREE_SIGMAS
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray, IntArray

LEAST_COMMON = 6
"""Fewest dots that both frames must show."""
STEPS = 2
LEAST_SIGMA_MM = 0.0003
CAMERA_SHARE = 0.005
"""Relative error of a change, by the uncertainty of scale, aspect, shear and distortion of a frame of 30 dots, 3 mm off."""

CORRECTION_SHARE = 0.25
"""Error, as a share, of what the answers' corrections by tilt, bend and rim change a change by: `tilted.DRAWN_ERROR`."""
STRAIN_SHARE = 0.2
"""The same of a strain: all of one that answers take off is 5 standard deviations, less than `Motion.slip_sigmas`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Change:
    """Change of a pose, and of the shape of what is seen.

    shift (3,): Of (x mm, y mm, theta rad).
    covariance (3, 3)
    strain (3,): Of ln of the scale, aspect and shear of the image, in the terms of `Localization.strain`. A rigid tape that
        slides or turns leaves them as they are.
    strain_covariance (3, 3)
    dots: Dots that both frames show and that moved as one.
    """

    shift: FloatArray
    covariance: FloatArray
    strain: FloatArray
    strain_covariance: FloatArray
    dots: int


def change_between(old: Localization, new: Localization, sensor: SensorProfile) -> Change | None:
    """How pose and image have changed between two located frames of a sensor; None where they have too few dots in common."""
    if old.dots is None or new.dots is None or old.tape != new.tape or old.theta_deg is None or new.theta_deg is None:
        return None
    first, second = _common(old.dots, new.dots)
    n = len(first)
    if n < LEAST_COMMON:
        return None
    seen_px = np.concatenate([old.dots.uv_px[first], new.dots.uv_px[second], sensor.centre_px[None]])
    on_gel = _on_gel(seen_px, _camera(sensor, old, new), sensor)
    before, after = on_gel[:n], on_gel[n:]
    # T = S + R(theta) q for both frames (paper, Eq. 12): q' = R(theta - theta') q + t with t = R(theta')^T (S - S')
    turn = radians((new.theta_deg - old.theta_deg + 180.0) % 360.0 - 180.0)
    turned = before @ _rotation(-turn).T
    middle, as_seen = turned.sum(axis=0) / n, after - turned
    residuals = np.stack([old.dots.residual_mm[first], new.dots.residual_mm[second]])
    left = _answered(old, new, residuals, np.stack([before, after]), sensor)
    x, y = (turned - middle).T
    rates = np.zeros((n, 2, 6))
    # columns: shift along u and v, small turn, then ln of the scale, aspect and shear; about the dots' middle, where a turn and a
    # shift do not mix
    rates[:, 0, 0] = rates[:, 1, 1] = 1.0
    rates[:, 0, 2], rates[:, 1, 2] = -y, x
    rates[:, 0, 3], rates[:, 1, 3] = x, y
    rates[:, 0, 4], rates[:, 1, 4] = 0.5 * x, -0.5 * y
    rates[:, 0, 5] = y
    keep = _moved_as_one(rates[..., :3], left)
    rates, left, as_seen = rates[keep], left[keep], as_seen[keep]
    # the rigid fit gives the pose's change; scale, aspect and shear would absorb part of it, and are fitted apart, to be reported
    (moved, spread), (bent, bent_spread) = _solved(rates[..., :3], left), _solved(rates, as_seen)
    # answers have taken off a part of a shear, too, so that it is told from what is seen: as far as that is not what a tilt or a
    # force does
    not_bent = STRAIN_SHARE * (bent - _solved(rates, left)[0])[3:]
    put_right = CORRECTION_SHARE * (moved - _solved(rates[..., :3], as_seen)[0])
    spread = spread + np.outer(put_right, put_right)
    # t at the image centre from that at the dots' middle
    lever = np.array([[1.0, 0.0, middle[1]], [0.0, 1.0, -middle[0]], [0.0, 0.0, 1.0]])
    back = np.zeros((3, 3))
    # S' - S = -R(theta') t
    back[:2, :2], back[2, 2] = -_rotation(radians(new.theta_deg)), 1.0
    out = back @ lever
    shift = out @ moved
    shift[2] += turn
    far = (after - before).sum(axis=0) / n
    share_mm, share_rad = CAMERA_SHARE * hypot(far[0], far[1]), CAMERA_SHARE * abs(float(shift[2]))
    return Change(
        shift=shift,
        covariance=out @ spread @ out.T + np.diag([share_mm**2, share_mm**2, share_rad**2]),
        strain=bent[3:],
        strain_covariance=bent_spread[3:, 3:] + np.outer(not_bent, not_bent) + share_rad**2 * np.eye(3),
        dots=int(keep.sum()),
    )


def _common(old: LocatedDots, new: LocatedDots) -> tuple[IntArray, IntArray]:
    """Indices of the parts that both frames show, in both frames' dots, of those that agree with their answers; shapes (n,)."""
    first, second = np.flatnonzero(old.inlier), np.flatnonzero(new.inlier)
    old_cell, new_cell = old.cell[first], new.cell[second]
    wide = int(max(old_cell.max(initial=0), new_cell.max(initial=0))) + 1
    # one number for each cell: column + wide row, wide more than any column
    _, of_old, of_new = np.intersect1d(old_cell @ [1, wide], new_cell @ [1, wide], return_indices=True)
    return first[of_old], second[of_new]


def _answered(old: Localization, new: Localization, off_mm: FloatArray, places: FloatArray, sensor: SensorProfile) -> FloatArray:
    """How far dots are from where they would be had nothing moved, by the places that the answers were fitted to; (n, 2), mm.

    These are free of what each frame's tilt, bend and rim did to its dots, but each by its own camera: they are taken to that of
    both frames.

    off_mm, places (2, n, 2): In the old frame and in the new one, the dots' residuals, texture frame, and places on the gel, mm.
    """
    back_px = np.linalg.inv(_camera(sensor, old, new))
    off = [
        left + place @ (np.eye(2) - _camera(sensor, fix) @ back_px).T @ _rotation(radians(fix.theta_deg or 0.0)).T
        for fix, left, place in zip((old, new), off_mm, places, strict=True)
    ]
    assert old.position_mm is not None and new.position_mm is not None and new.theta_deg is not None
    back = np.subtract(old.position_mm, new.position_mm)
    # R(theta')^T of (the new residuals less the old ones + S - S')
    return np.asarray((off[1] - off[0] + back) @ _rotation(radians(new.theta_deg)))


def _camera(sensor: SensorProfile, *fixes: Localization) -> FloatArray:
    """Inverse of the mean of fits' corrections of the profile's camera; shape (2, 2)."""
    aspect, shear = (sum((one.strain or (0.0, 0.0, None))[k] or 0.0 for one in fixes) / len(fixes) for k in (0, 1))
    scale = sum((one.px_per_mm or sensor.px_per_mm[0]) / sensor.px_per_mm[0] for one in fixes) / len(fixes)
    along, down = 1.0 + 0.5 * aspect, 1.0 - 0.5 * aspect
    # inverse of [[along, shear], [0, down]] times the scale
    return np.array([[1.0 / along, -shear / (along * down)], [0.0, 1.0 / down]]) / scale


def _on_gel(uv_px: FloatArray, undo: FloatArray, sensor: SensorProfile) -> FloatArray:
    """Positions on the gel, mm, of all pixels but the last, relative to the last, which is the image centre."""
    at = sensor.camera.from_px(uv_px)
    return np.asarray((at[:-1] - at[-1]) @ undo.T)


def _rotation(angle_rad: float) -> FloatArray:
    """R(theta) of Eq. 12 of the paper."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, s], [-s, c]])


def _moved_as_one(rates: FloatArray, seen: FloatArray) -> FloatArray:
    """Mask of the inliers: dots that moved as most of them did."""
    n, keep = len(seen), np.ones(len(seen), dtype=bool)
    for _ in range(STEPS):
        at, _ = _solved(rates[keep], seen[keep])
        apart = np.hypot(*(seen - rates @ at).T)
        # the median distance of two normal axes is 1.177 sigma (Rayleigh)
        sigma = max(float(np.partition(apart, n // 2)[n // 2]) / 1.177, LEAST_SIGMA_MM)
        keep = apart <= AGREE_SIGMAS * sigma * (1.0 + 4.0 / n)
    return keep


def _solved(rates: FloatArray, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least-squares solution, and its covariance with the errors' variance estimated from the residuals."""
    flat, target = rates.reshape(-1, rates.shape[-1]), seen.reshape(-1)
    inverse = np.asarray(np.linalg.inv(flat.T @ flat), dtype=np.float64)
    at = inverse @ (flat.T @ target)
    left = target - flat @ at
    # the mean of the variance's posterior: a t distribution's covariance
    freedom = max(len(target) - len(at) - 2, 1)
    variance = max(float(left @ left) / freedom, LEAST_SIGMA_MM**2)
    return at, variance * inverse
