"""Images that real sensors took of anything but a tape of ours: none of them may be located.

TACTAPE_REAL_IMAGES=FOLDER names them: colour images (.png, .jpg), and depth maps (.npy). Colour images become depth by the
network and the untouched gel in TACTAPE_SENSOR_DATA. They may be of any size; a profile of that size with the field of view of a
GelSight Mini is used. `test_images_of_our_own_making` holds this test itself to what it says.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab import Localizer
from tactape_fab.sense import Reconstruction, Scene, SensorProfile, load_network, load_sensor, make_reconstruction, simulate
from tactape_fab.sense.raw.torch_file import read_tensors
from tests.contacts import TAPE
from tests.raw_images import image_of, plain_layers, sensor_data

COLOUR = (".png", ".jpg", ".jpeg")
SIGNS = (1, -1)
"""Whether a larger depth means pushed in is not known of a stranger's images."""


def foreign_folder() -> Path:
    folder = os.environ.get("TACTAPE_REAL_IMAGES")
    if not folder:
        pytest.skip("TACTAPE_REAL_IMAGES names no folder with images of real sensors")
    return Path(folder)


def images_in(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in (*COLOUR, ".npy"))


def depths_of(path: Path) -> Iterator[npt.NDArray[np.float32]]:
    """Depth maps of a file: one of an image, one or more of an array."""
    if path.suffix.lower() != ".npy":
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        assert image is not None, f"{path} is no image"
        yield reconstruction_of(image.shape[:2]).depth(np.asarray(image, dtype=np.uint8))
        return
    array = np.asarray(np.load(path), dtype=np.float32)
    assert array.ndim in (2, 3), f"{path} is no depth map: {array.shape}"
    yield from array if array.ndim == 3 else array[None]


@lru_cache(maxsize=8)
def reconstruction_of(shape: tuple[int, int]) -> Reconstruction:
    """That of the sensor's data, its untouched gel resized to the images."""
    folder = sensor_data()
    background = cv2.imread(str(folder / "background.png"), cv2.IMREAD_COLOR)
    assert background is not None
    resized = np.asarray(cv2.resize(background, shape[::-1], interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return make_reconstruction(resized, load_network(folder / "nnmodel.pth"), sensor_of(shape).px_per_mm)


@lru_cache(maxsize=8)
def sensor_of(shape: tuple[int, int], sign: int = 1) -> SensorProfile:
    """A GelSight Mini of an image's size."""
    mini = load_sensor("gelsight-mini")
    scale = (mini.px_per_mm[0] * shape[1] / mini.width_px, mini.px_per_mm[1] * shape[0] / mini.height_px)
    return replace(mini, width_px=shape[1], height_px=shape[0], px_per_mm=scale, sign=sign)


@lru_cache(maxsize=8)
def localizer_of(shape: tuple[int, int], sign: int) -> Localizer:
    return Localizer([TAPE], sensor_of(shape, sign))


def located_in(folder: Path) -> tuple[int, list[str]]:
    """Decoded frames, and the names of those that were located."""
    decoded, located = 0, []
    for path in images_in(folder):
        for depth in depths_of(path):
            for sign in SIGNS:
                decoded += 1
                fix = localizer_of(depth.shape, sign).locate(depth)
                if fix.located:
                    located.append(f"{path.name}, sign {sign}: {fix.position_mm}, p_false {fix.p_false}")
    return decoded, located


def test_no_foreign_image_is_located() -> None:
    folder = foreign_folder()
    decoded, located = located_in(folder)
    print(f"{len(located)} of {decoded} decodes of {folder} located")
    assert decoded > 0, f"{folder} holds no .png, .jpg or .npy"
    assert not located


def test_images_of_our_own_making(tmp_path: Path) -> None:
    """The untouched gel at two sizes, and noise, are not located; a contact with the tape is, if it gets among them."""
    folder = sensor_data()
    gel = cv2.imread(str(folder / "background.png"), cv2.IMREAD_COLOR)
    assert gel is not None
    noisy = np.clip(gel + np.random.default_rng(1).normal(0.0, 2.0, gel.shape), 0, 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "gel.png"), noisy)
    cv2.imwrite(str(tmp_path / "small.jpg"), cv2.resize(noisy, (240, 180), interpolation=cv2.INTER_AREA))
    (tmp_path / "deeper").mkdir()
    np.save(tmp_path / "deeper" / "depth.npy", np.random.default_rng(2).normal(0.0, 0.01, (2, 240, 320)))
    decoded, located = located_in(tmp_path)
    assert (decoded, located) == (8, [])
    layers = plain_layers(read_tensors(folder / "nnmodel.pth"))
    tape = image_of(simulate(TAPE, (40.0, 22.0), 25.0, scene=Scene(noise=0.0)), gel, layers, 16.0, 1.5, seed=1)
    cv2.imwrite(str(tmp_path / "tape.png"), tape)
    decoded, located = located_in(tmp_path)
    assert decoded == 10 and [name[: len("tape.png, sign 1")] for name in located] == ["tape.png, sign 1"]
