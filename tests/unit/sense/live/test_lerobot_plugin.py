"""Pictures of LeRobot's plugin, with a stub of what it uses of LeRobot; `tests/readers/test_lerobot.py` runs it in LeRobot."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab.sense import load_sensor

PLUGIN = Path(__file__).parents[4] / "docs" / "examples" / "lerobot_camera_tactape"


class Camera:
    def __init__(self, config: Any) -> None:
        pass


class CameraConfig:
    @classmethod
    def register_subclass(cls, _: str) -> Any:
        return lambda kind: kind


def test_a_hole_is_black_whatever_it_is_marked_by(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras: Any = ModuleType("lerobot.cameras")
    cameras.Camera, cameras.CameraConfig = Camera, CameraConfig
    for module in (ModuleType("lerobot"), cameras):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.syspath_prepend(str(PLUGIN))
    plugin = import_module("lerobot_camera_tactape")
    del sys.modules["lerobot_camera_tactape"]  # that of the stub is nobody else's
    camera = plugin.TactapeCamera(plugin.TactapeCameraConfig(source="frames.npz"))
    depth = np.full((240, 320), 0.75, dtype=np.float32)
    depth[0, :3] = np.inf, -np.inf, np.nan
    camera._live = SimpleNamespace(sensor=load_sensor("gelsight-mini"), read=lambda **_: SimpleNamespace(frame=0, depth=depth))
    picture = camera.read_latest()
    assert picture.shape == (240, 320, 3) and picture[0, :5, 0].tolist() == [0, 0, 0, 127, 127]
