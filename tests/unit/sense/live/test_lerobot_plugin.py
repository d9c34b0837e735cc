"""Pictures of LeRobot's plugin, with a stub of what it uses of LeRobot; `tests/readers/test_lerobot.py` runs it in LeRobot."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab import Kit
from tactape_fab.sense import load_sensor, observation_names

PLUGIN = Path(__file__).parents[4] / "docs" / "examples" / "lerobot_camera_tactape"


class Camera:
    def __init__(self, config: Any) -> None:
        pass


class CameraConfig:
    @classmethod
    def register_subclass(cls, _: str) -> Any:
        return lambda kind: kind


@pytest.fixture
def plugin(monkeypatch: pytest.MonkeyPatch) -> Any:
    cameras: Any = ModuleType("lerobot.cameras")
    cameras.Camera, cameras.CameraConfig = Camera, CameraConfig
    for module in (ModuleType("lerobot"), cameras):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.syspath_prepend(str(PLUGIN))
    plugin = import_module("lerobot_camera_tactape")
    del sys.modules["lerobot_camera_tactape"]  # that of the stub is nobody else's
    return plugin


def test_a_hole_is_black_whatever_it_is_marked_by(plugin: Any) -> None:
    camera = plugin.TactapeCamera(plugin.TactapeCameraConfig(source="frames.npz"))
    depth = np.full((240, 320), 0.75, dtype=np.float32)
    depth[0, :3] = np.inf, -np.inf, np.nan
    camera._live = SimpleNamespace(sensor=load_sensor("gelsight-mini"), read=lambda **_: SimpleNamespace(frame=0, depth=depth))
    picture = camera.read_latest()
    assert picture.shape == (240, 320, 3) and picture[0, :5, 0].tolist() == [0, 0, 0, 127, 127]


def test_a_camera_that_gives_no_frame_is_not_connected_and_one_that_is_connected_stays(
    plugin: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def late(**_: Any) -> None:
        raise TimeoutError

    closed: list[int] = []
    monkeypatch.setattr(plugin, "LiveSensor", lambda *_, **__: SimpleNamespace(read=late, close=lambda: closed.append(1)))
    camera = plugin.TactapeCamera(plugin.TactapeCameraConfig(source="frames.npz"))
    with pytest.raises(TimeoutError):
        camera.connect()
    assert closed == [1] and not camera.is_connected
    camera.connect(warmup=False)
    with pytest.raises(ConnectionError, match="disconnect"):
        camera.connect()
    assert closed == [1] and camera.is_connected


def test_features_are_known_before_it_is_connected(plugin: Any, default_kit: Kit) -> None:
    camera = plugin.TactapeCamera(plugin.TactapeCameraConfig(source="frames.npz", kits=[str(default_kit.path)]))
    assert list(camera.features) == observation_names([default_kit.tape]) and not camera.is_connected
