"""Rows of the adjustment against plain formulas and differences, with oblong pixels and a lens off the middle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense.calibrate import camera
from tactape_fab.sense.calibrate.adjust import Bundle, expected
from tactape_fab.sense.calibrate.errors import Errors
from tactape_fab.sense.calibrate.posedness import corner_sigma_um
from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.sense.geometry import Geometry
from tactape_fab.texture.frames import FloatArray
from tests.unit.sense.calibrate.sensors import STOCK

GEOMETRY = Geometry(aspect=0.03, shear=-0.02, k1=-0.04, center_px=(170.0, 110.0))
OBLONG = replace(STOCK, px_per_mm=(16.0, 8.0), geometry=GEOMETRY)
PUSH_MM, POSE = 0.03, np.array([3.0, -2.0, 2.8, 0.1])
VALUES = camera.parameters(OBLONG)


def press() -> Press:
    rng = np.random.default_rng(1)
    return Press(
        frame=0,
        tape="",
        seen_px=rng.uniform(0.0, 200.0, (9, 2)),
        rim_mm=rng.normal(0.0, 0.1, (9, 2)),
        texture_mm=POSE[:2] + rng.uniform(-7.0, 7.0, (9, 2)),
        weights=np.ones(9),
        interior=np.ones(9, dtype=bool),
        pushed=rng.normal(0.0, 0.1, (9, 2)),
        pulled=rng.normal(0.0, 0.1, (9, 2)),
        position_mm=(0.0, 0.0),
        theta_rad=0.0,
    )


def on_gel_mm(one: Press) -> FloatArray:
    """Where dots are expected, dot by dot."""
    (x, y, theta, pull), out = POSE, []
    for at, pushed, pulled, rim in zip(one.texture_mm, one.pushed, one.pulled, one.rim_mm, strict=True):
        dx, dy = at - (x, y)
        q = np.array([np.cos(theta) * dx - np.sin(theta) * dy, np.sin(theta) * dx + np.cos(theta) * dy])
        out.append(q + PUSH_MM * pushed - pull * pulled - rim)
    return np.array(out)


def test_residuals_are_millimetres_along_both_axes() -> None:
    one, model = press(), OBLONG.camera
    middle = model.from_px(OBLONG.centre_px)
    # dots that are seen 1 um from where they are expected, on the gel
    off = 1e-3 * np.random.default_rng(2).standard_normal((9, 2))
    seen = replace(one, seen_px=model.to_px(on_gel_mm(one) + middle + off))
    residual, _, _ = expected(seen, camera.seen_by(OBLONG, VALUES), PUSH_MM, POSE)
    # but for aspect, shear and lens, some per cent
    assert residual == pytest.approx(off, abs=3e-4)


def test_derivatives_are_those_of_the_residuals() -> None:
    one, scale = press(), np.array(camera.seen_by(OBLONG, VALUES).scale)

    def px(z: FloatArray) -> FloatArray:
        """Residuals, px: the scale that divides them is held."""
        seen = camera.seen_by(OBLONG, z[:6])
        return expected(one, seen, float(z[6]), z[7:])[0] * seen.scale

    at, step = np.array([*VALUES, PUSH_MM, *POSE]), 1e-6
    _, shared, own = expected(one, camera.seen_by(OBLONG, VALUES), PUSH_MM, POSE)
    by = [(px(at + d) - px(at - d)) / (2 * step) / scale for d in step * np.eye(len(at))]
    assert np.concatenate([shared, own], axis=2) == pytest.approx(np.stack(by, axis=2), abs=1e-6)


def test_the_camera_s_error_at_the_corners_is_in_micrometres_along_both_axes() -> None:
    sensor = replace(OBLONG, geometry=Geometry())
    none = np.empty(0)
    bundle = Bundle(
        sensor=sensor,
        values=camera.parameters(sensor),
        covariance=np.diag([0.0, 1e-6, 0.0, 0.0, 0.0, 0.0]),
        free=none > 0.0,
        push_mm=0.0,
        poses=none,
        poses_alone=none,
        poses_anew=none,
        residual_mm=(),
        errors=Errors(),
    )
    # an aspect of 1e-3 moves the corner by half of that of its place, out along u and in along v
    u_mm, v_mm = sensor.centre_px / sensor.px_per_mm
    assert corner_sigma_um(bundle) == pytest.approx(0.5 * np.hypot(u_mm, v_mm) / np.sqrt(2.0))
