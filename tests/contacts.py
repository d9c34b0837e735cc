"""Contacts drawn from the contract alone: where the parts of a tape are seen by a sensor at some pose."""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians, sin

import numpy as np

from tactape_fab import Localization, Tape, TapeSpec, default_origin
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Frame
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.plane import encode

R, W, DELTA = 16.0, 1.5, 0.25
CENTRE = np.array([159.5, 119.5])
SHIFT = {"N": (0.0, -1.0), "S": (0.0, 1.0), "W": (-1.0, 0.0), "E": (1.0, 0.0)}
TAPE = examine(TapeSpec(sector=7)).layout.tape
POSE = ((40.3, 22.1), 37.0)


def tape_of(sector: int, origin: tuple[int, int] | None = None, columns: int = 62, rows: int = 32) -> Tape:
    place = default_origin(TAPE.code, sector) if origin is None else origin
    symbols = encode(get_plane(TAPE.code), sector, place, (rows, columns))
    return replace(TAPE, name=f"s{sector}", sector=sector, origin=place, columns=columns, rows=rows, symbols=symbols)


def texture_of(tape: Tape) -> FloatArray:
    """Centres of all parts in the texture frame, by the letters of the manifest."""
    letters, omitted = tape.to_mapping()["symbols"], {tuple(c) for c in tape.omitted.tolist()}
    return np.array(
        [
            (c * W + DELTA * SHIFT[letters[r][c]][0], r * W + DELTA * SHIFT[letters[r][c]][1])
            for r in range(tape.rows)
            for c in range(tape.columns)
            if (c, r) not in omitted
        ]
    )


TEXTURE = texture_of(TAPE)


def seen(texture_mm: FloatArray, position_mm: tuple[float, float], theta_deg: float, px_per_mm: float = R) -> FloatArray:
    """Pixels of texture points: T = S + (1/R) [[cos, sin], [-sin, cos]] (p - p0), solved for p by hand."""
    c, s = cos(radians(theta_deg)), sin(radians(theta_deg))
    x, y = (texture_mm - np.asarray(position_mm)).T
    return np.asarray(np.stack([c * x - s * y, s * x + c * y], axis=1) * px_per_mm + CENTRE)


def dots(
    position_mm: tuple[float, float] = POSE[0],
    theta_deg: float = POSE[1],
    semi_mm: tuple[float, float] = (5.5, 4.5),
    texture_mm: FloatArray = TEXTURE,
    px_per_mm: float = R,
) -> FloatArray:
    """Dots inside an ellipse about the image centre."""
    px = seen(texture_mm, position_mm, theta_deg, px_per_mm)
    return np.asarray(px[(((px - CENTRE) / px_per_mm / semi_mm) ** 2).sum(axis=1) < 1])


def is_near(fix: Localization, position_mm: tuple[float, float], theta_deg: float, mm: float = 0.05, deg: float = 0.5) -> bool:
    if fix.position_mm is None or fix.theta_deg is None:
        return False
    turn = (fix.theta_deg - theta_deg + 180) % 360 - 180
    return bool(np.hypot(*(np.array(fix.position_mm) - position_mm)) < mm and abs(turn) < deg)


def pose_error(fix: Localization, frame: Frame) -> FloatArray:
    """Error of a located fix against a simulated frame's truth: x mm, y mm, theta rad."""
    assert fix.position_mm is not None and fix.theta_deg is not None
    turn = (fix.theta_deg - frame.theta_deg + 180.0) % 360.0 - 180.0
    return np.array([*(np.array(fix.position_mm) - frame.position_mm), np.radians(turn)])


def nees(fix: Localization, frame: Frame) -> float:
    """The squared error over its covariance, and over its three degrees of freedom: 1 on average where the covariance is true."""
    assert fix.covariance is not None
    return float(pose_error(fix, frame) @ np.linalg.solve(fix.covariance, pose_error(fix, frame)) / 3)
