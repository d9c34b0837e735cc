"""A calibration made by hand: nothing in it was adjusted."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from types import SimpleNamespace
from typing import Any

import numpy as np

from tactape_fab.sense import Calibration
from tactape_fab.sense.calibrate.result import Quantity
from tactape_fab.sense.geometry import Gel, Geometry
from tests.unit.sense.calibrate.sensors import STOCK


def calibration(**said: Any) -> Calibration:
    """Of a small sensor and two presses, with what is said."""
    sensor = replace(
        STOCK,
        name="mine",
        title='My "sensor"',
        width_px=40,
        height_px=30,
        px_per_mm=(15.1234567891, 16.0),
        sign=-1,
        mirror=True,
        rotate90=3,
        depth_unit_mm=None,
        slope_noise=None,
        white_um=1.25,
        scale_tolerance=0.01,
        geometry=Geometry(aspect=0.01, shear=-0.02, k1=0.03, sigma_aspect=0.001, sigma_shear=0.002, sigma_k1=0.9),
        gel=Gel(displacement_um=30.0, blur_mm=0.08, poisson=0.4),
    )
    at_px = np.array([[4.0, 5.0], [10.0, 12.0], [35.0, 25.0]])
    press = SimpleNamespace(frame=3, seen_px=at_px, weights=np.ones(3))
    off_mm = np.full((3, 2), 0.002)
    fields: dict[str, Any] = {
        "sensor": sensor,
        "quantities": (
            Quantity("k1", 0.03, 0.00125, "", "a note"),
            Quantity("scale", 15.5, None, "px/mm"),
            Quantity("x", 1.0, inf),
        ),
        "held_out": None,
        "frames": 5,
        "presses": (press, SimpleNamespace(frame=4, seen_px=at_px[:2], weights=np.ones(2))),
        "bundle": SimpleNamespace(rms_mm=0.0021, residual_mm=(off_mm, off_mm[:2])),
        "valid": None,
        "hand_eye": None,
        "remarks": ("press more often",),
    }
    return Calibration(**fields | said)
