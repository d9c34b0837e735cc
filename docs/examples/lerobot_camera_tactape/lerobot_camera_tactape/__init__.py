"""A tactile sensor as a camera of LeRobot: its image is the depth map, `fix` and `observation` say where it was touched."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from lerobot.cameras import Camera, CameraConfig

from tactape_fab import read_tapes
from tactape_fab.sense import LiveSensor, load_sensor, observation, observation_names

WARMUP_S = 300.0
"""The locator compiles at the first start: half a minute of processor time, more on a small or busy computer."""


@CameraConfig.register_subclass("tactape")
@dataclass(kw_only=True)
class TactapeCameraConfig(CameraConfig):
    """`source`, `kits`, `sensor` and the rest are those of `tactape-fab watch`; width and height come from the sensor."""

    source: str
    kits: list[str] = field(default_factory=list)
    sensor: str = "gelsight-mini"
    rate: float | None = None
    raw: bool = False
    background: str | None = None
    weights: str | None = None
    crop: list[int] | None = None
    world: str = "open"
    white_mm: float = 1.5  # depth that is shown white; 0 is black

    def __post_init__(self) -> None:
        profile = load_sensor(self.sensor)
        self.height, self.width = profile.height_px, profile.width_px


class TactapeCamera(Camera):
    """Reads what `tactape-fab watch` reads, and locates every frame on a thread."""

    def __init__(self, config: TactapeCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._live: LiveSensor | None = None
        self._last: Any = None

    @property
    def is_connected(self) -> bool:
        return self._live is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        return []  # a folder or a pipe cannot be found by looking

    def connect(self, warmup: bool = True) -> None:
        if self._live is not None:
            raise ConnectionError("the camera is connected; call disconnect() first")
        given = {name: getattr(self.config, name) for name in ("rate", "raw", "background", "weights", "crop", "world")}
        self._live = LiveSensor(self.config.source, self.config.kits, self.config.sensor, **given)
        if warmup:
            try:
                self._take(-1, WARMUP_S)
            except BaseException:  # its thread would keep the source, and the next attempt find it busy
                self.disconnect()
                raise

    def read(self) -> np.ndarray:
        return self.async_read(1000 * WARMUP_S)

    def async_read(self, timeout_ms: float = 200) -> np.ndarray:
        """The next frame that was not read yet."""
        return self._take(-1 if self._last is None else self._last.frame, timeout_ms / 1000)

    def read_latest(self, max_age_ms: int = 500) -> np.ndarray:
        """The latest frame, read before or not. Raises TimeoutError when it is older, TactapeError when the source has ended."""
        return self._take(-1, 0.0, max_age_ms / 1000)

    def disconnect(self) -> None:
        if self._live is not None:
            self._live.close()
        self._live = self._last = None

    @property
    def fix(self) -> Any:
        """The answer of the frame that was read last: a `tactape_fab.Localization`."""
        return None if self._last is None else self._last.fix

    @cached_property
    def features(self) -> dict[str, type]:
        """Names of `observation`, for a robot's `observation_features`: `lerobot-record` asks for them before it connects."""
        return dict.fromkeys(observation_names(read_tapes(self.config.kits)), float)

    def observation(self) -> dict[str, float]:
        """Where the frame that was read last was touched, for a robot's `get_observation`."""
        tapes = self._connected().tapes
        if self._last is None:
            raise RuntimeError("no frame was read yet")
        return observation(self._last.fix, tapes)

    def _connected(self) -> LiveSensor:
        if self._live is None:
            raise ConnectionError("the camera is not connected; call connect() first")
        return self._live

    def _take(self, after: int, timeout_s: float, max_age_s: float | None = None) -> np.ndarray:
        live = self._connected()
        self._last = live.read(after=after, timeout_s=timeout_s, max_age_s=max_age_s)
        depth = live.sensor.canonical(np.asarray(self._last.depth, dtype=np.float32)) * (live.sensor.depth_unit_mm or 1.0)
        gray = np.clip(np.nan_to_num(depth, posinf=0.0, neginf=0.0) * (255 / self.config.white_mm), 0, 255).astype(np.uint8)
        return np.repeat(gray[..., None], 3, axis=2)
