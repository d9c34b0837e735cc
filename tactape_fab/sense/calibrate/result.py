"""Calibration: what was found of a sensor, how sure it is, and what held-out presses say of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any

import numpy as np

from tactape_fab.sense.calibrate.adjust import Bundle
from tactape_fab.sense.calibrate.hand_eye import HandEye
from tactape_fab.sense.calibrate.presses import Press
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import BoolArray


@dataclass(frozen=True, slots=True)
class Quantity:
    """A figure with its standard deviation; None where that is not known."""

    name: str
    value: float
    sigma: float | None
    unit: str = ""
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOut:
    """Residuals of dots, root mean square along an axis: of all presses in the adjustment, and of each press left out of one.

    A press that is left out gives its own pose alone; the camera is that of the others.
    """

    inside_um: float
    outside_um: float
    folds: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """A calibrated sensor.

    Attributes
    ----------
    sensor : SensorProfile
        The profile, with standard deviations.
    quantities : tuple of Quantity
        Everything that was found.
    held_out : HeldOut or None
        None for fewer than four presses.
    frames : int
        How many there were.
    presses : tuple of Press
        Those that were located, with the dots that agree.
    bundle : Bundle
        The adjustment.
    valid : ndarray of bool, shape `sensor.frame_shape`, or None
        Pixels of a frame that carry depth and are clear of blind ones; None for all.
    hand_eye : HandEye or None
        Where the sensor is on the flange, and the tape in the robot's base.
    remarks : tuple of str
        What cannot be observed, and what would make it better.
    """

    sensor: SensorProfile
    quantities: tuple[Quantity, ...]
    held_out: HeldOut | None
    frames: int
    presses: tuple[Press, ...]
    bundle: Bundle
    valid: BoolArray | None
    hand_eye: HandEye | None
    remarks: tuple[str, ...]

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        sensor = self.sensor
        return {
            "sensor": sensor.name,
            "orientation": {"sign": sensor.sign, "mirror": sensor.mirror, "rotate90": sensor.rotate90},
            "frames": self.frames,
            "presses": [press.frame for press in self.presses],
            "dots": sum(len(press.weights) for press in self.presses),
            "quantities": {
                q.name: {"value": q.value, "sigma": _finite(q.sigma), "unit": q.unit, "note": q.note} for q in self.quantities
            },
            "held_out": None if self.held_out is None else asdict(self.held_out),
            "valid_share": 1.0 if self.valid is None else float(np.mean(self.valid)),
            "hand_eye": None if self.hand_eye is None else self.hand_eye.to_mapping(),
            "remarks": list(self.remarks),
        }


def _finite(value: float | None) -> float | None:
    return None if value is None or not isfinite(value) else value
