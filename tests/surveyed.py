"""Contacts of a small tape without images, and poses of a robot, for what a survey solves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tactape_fab.sense import load_sensor
from tactape_fab.sense.survey.contacts import Contact
from tactape_fab.sense.survey.poses import RobotPose
from tactape_fab.texture.frames import FloatArray, IntArray

SENSOR = replace(load_sensor("gelsight-mini"), px_per_mm=(16.0, 8.0))
NOMINAL_MM = 1.5 * np.array([(c, r) for r in range(9) for c in range(14)])
DOT_MM = 0.006


def drawn(rng: np.random.Generator, shift_mm: FloatArray, count: int) -> tuple[list[Contact], FloatArray]:
    """Contacts of a small tape whose dots err by 6 um along each axis, and their true poses."""
    contacts, poses = [], np.column_stack([rng.uniform((2.0, 2.0), (18.0, 10.0), (count, 2)), rng.uniform(-np.pi, np.pi, count)])
    for k, (x, y, theta) in enumerate(poses.tolist()):
        part = np.flatnonzero(np.hypot(*(NOMINAL_MM - (x, y)).T) < 4.5)
        c, s = np.cos(theta), np.sin(theta)
        # q = R(theta)^T (T - S), seen on the gel with an error
        gel_mm = (NOMINAL_MM[part] + shift_mm[part] - (x, y)) @ np.array([[c, s], [-s, c]])
        contacts.append(contact_of(k, part, gel_mm + rng.normal(0.0, DOT_MM, gel_mm.shape), poses[k] + rng.normal(0.0, 0.003, 3)))
    return contacts, poses


def contact_of(frame: int, part: IntArray, gel_mm: FloatArray, start: FloatArray) -> Contact:
    none = np.zeros_like(gel_mm)
    return Contact(
        frame=frame,
        part=part,
        seen_px=SENSOR.camera.to_px(gel_mm + SENSOR.camera.from_px(SENSOR.centre_px)),
        own=np.ones(len(part)),
        rim_mm2=np.zeros(len(part)),
        pushed=none,
        pulled=none,
        start=start,
        expected=np.zeros(0, dtype=np.int64),
    )


def by_robot(poses: FloatArray, frame: FloatArray, sigma: tuple[float, float] = (0.01, 0.1)) -> list[RobotPose]:
    """Poses in a frame at x mm, y mm, turned by rad; texture y is down, the robot's up."""
    turn = Rotation.from_euler("z", frame[2]).as_matrix()[:2, :2]
    xy_mm = frame[:2] + poses[:, :2] * (1, -1) @ turn.T
    deg = np.degrees(poses[:, 2] + frame[2])
    return [
        RobotPose(frame=k, x_mm=x, y_mm=y, theta_deg=theta, sigma_mm=sigma[0], sigma_deg=sigma[1])
        for k, (x, y, theta) in enumerate(np.column_stack([xy_mm, deg]).tolist())
    ]
