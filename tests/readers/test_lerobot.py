"""The plugin in LeRobot itself: found by its name, made of its configuration, and a dataset written and read back.

LeRobot brings PyTorch and is no part of the development environment. In one of its own with Python 3.12, after
``pip install ".[lerobot]" pytest pytest-benchmark pytest-xdist hypothesis``:
``python -m pytest -n 0 -o filterwarnings= tests/readers/test_lerobot.py``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import Kit
from tactape_fab.sense import load_sensor, simulate_frames
from tactape_fab.sense.files.recordings import open_recording

lerobot = pytest.importorskip("lerobot", reason="lerobot is not installed; see the first lines of this file")
pytestmark = pytest.mark.filterwarnings("ignore")
PLUGIN = Path(__file__).parents[2] / "docs" / "examples" / "lerobot_camera_tactape"
COUNT, FPS = 12, 20


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The plugin, installed as far as LeRobot's search is concerned: its name in the environment's metadata."""
    from lerobot.utils.import_utils import register_third_party_plugins

    info = tmp_path / "site" / "lerobot_camera_tactape-0.1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lerobot_camera_tactape\nVersion: 0.1.0\n", encoding="ascii")
    for path in (tmp_path / "site", PLUGIN):
        monkeypatch.syspath_prepend(str(path))
    register_third_party_plugins()
    return sys.modules["lerobot_camera_tactape"]


@pytest.fixture
def camera(plugin: Any, default_kit: Kit, tmp_path: Path) -> Any:
    """A camera on a replay of twelve frames, made by LeRobot of its configuration."""
    from lerobot.cameras.utils import make_cameras_from_configs

    depth = simulate_frames(default_kit.tape, COUNT, seed=5).depth
    depth[4] = 0.0
    np.savez(tmp_path / "frames.npz", depth=depth)
    config = plugin.TactapeCameraConfig(
        source=str(tmp_path / "frames.npz"), kits=[str(default_kit.path)], rate=2.0, fps=FPS, world="closed"
    )
    assert config.type == "tactape" and (config.height, config.width) == (240, 320)
    (made,) = make_cameras_from_configs({"touch": config}).values()
    assert type(made) is plugin.TactapeCamera
    return made


def test_a_dataset_is_read_back_by_lerobot(camera: Any, tmp_path: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    with camera:
        assert camera.is_connected
        names = list(camera.features)
        features = {
            "observation.images.touch": {
                "dtype": "image",
                "shape": (camera.height, camera.width, 3),
                "names": ["height", "width", "channels"],
            },
            "observation.state": {"dtype": "float32", "shape": (len(names),), "names": names},
        }
        made = LeRobotDataset.create("tactape/test", FPS, features, root=tmp_path / "dataset", use_videos=False)
        written = []
        for _ in range(6):
            image = camera.async_read(timeout_ms=600_000)
            state = np.array([camera.observation()[name] for name in names], dtype=np.float32)
            written.append((image, state))
            made.add_frame({"observation.images.touch": image, "observation.state": state, "task": "touch the tape"})
        made.save_episode()
        made.finalize()
    assert not camera.is_connected
    read = LeRobotDataset("tactape/test", root=tmp_path / "dataset")
    assert read.num_frames == 6 and read.features["observation.state"]["names"] == names
    located = names.index("located")
    for k, (image, state) in enumerate(written):
        item = read[k]
        assert item["observation.state"].numpy() == pytest.approx(state)
        picture = item["observation.images.touch"].numpy().transpose(1, 2, 0)
        assert picture == pytest.approx(image / 255, abs=1e-6)
        assert item["task"] == "touch the tape"
    assert sum(state[located] for _, state in written) >= 4
    assert all(np.isfinite(state).all() for _, state in written)
    recorded = open_recording(tmp_path / "dataset", load_sensor("gelsight-mini"))
    for (image, _), frame in zip(written, recorded.frames(), strict=True):
        np.testing.assert_array_equal(frame, image[:, :, 0])


def test_it_says_when_nothing_new_comes(camera: Any) -> None:
    with camera:
        camera.async_read(timeout_ms=600_000)
        assert camera.read_latest().shape == (240, 320, 3)
        with pytest.raises(TimeoutError):
            camera.async_read(timeout_ms=1)
        with pytest.raises(TimeoutError, match="in the last"):
            camera.read_latest(max_age_ms=0)
    with pytest.raises(ConnectionError):
        camera.read_latest()
