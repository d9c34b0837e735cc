"""Images that a sensor would take of a depth map, made by turning its network round, and weights written by hand."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

Layers = Sequence[tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]]
Image = npt.NDArray[np.uint8]


def sensor_data() -> Path:
    """Folder of a real sensor's files: background.png and nnmodel.pth of a GelSight Mini (rpl-cmu/normalflow, MIT)."""
    folder = os.environ.get("TACTAPE_SENSOR_DATA")
    if not folder:
        pytest.skip("TACTAPE_SENSOR_DATA names no folder with background.png and nnmodel.pth of a real sensor")
    return Path(folder)


def plain_layers(tensors: dict[str, npt.NDArray[np.float32]]) -> Layers:
    return [(tensors[f"fc{i}.weight"], tensors[f"fc{i}.bias"]) for i in range(1, len(tensors) // 2 + 1)]


def features(image: Image) -> npt.NDArray[np.float32]:
    """Rows of blue, green, red, x and y for each pixel."""
    h, w = image.shape[:2]
    v, u = np.mgrid[:h, :w]
    return np.concatenate([image / 255.0, np.stack([u / w, v / h], axis=-1)], axis=-1).reshape(-1, 5).astype(np.float32)


def angles(rows: npt.NDArray[np.float32], layers: Layers) -> npt.NDArray[np.float32]:
    """The network's outputs, as anybody would write them down; shape (n, 2)."""
    for weight, bias in layers[:-1]:
        rows = np.maximum(rows @ weight.T + bias, 0.0)
    return rows @ layers[-1][0].T + layers[-1][1]


def _with_jacobian(rows: npt.NDArray[np.float32], layers: Layers) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    active = []
    for weight, bias in layers[:-1]:
        rows = np.maximum(rows @ weight.T + bias, 0.0)
        active.append(rows > 0.0)
    jacobian = np.broadcast_to(layers[-1][0], (len(rows), *layers[-1][0].shape))
    for (weight, _), on in zip(reversed(layers[:-1]), reversed(active), strict=True):
        jacobian = (jacobian * on[:, None, :]) @ weight
    return rows @ layers[-1][0].T + layers[-1][1], jacobian[:, :, :3]


def image_of(
    depth_mm: npt.NDArray[np.float32],
    background: Image,
    layers: Layers,
    px_per_mm: float,
    noise_grey: float = 0.0,
    seed: int = 0,
    steps: int = 5,
) -> Image:
    """The image, of 8 bits, in which the network sees the slopes of a depth map: for each pixel the nearest such colour.

    Newton's method from the background's colours, each step as short as can be; noise is white, in grey levels.
    """
    slopes = np.stack([-np.gradient(depth_mm, axis=axis) * px_per_mm for axis in (1, 0)], axis=-1).reshape(-1, 2)
    rows = features(background)
    felt = np.flatnonzero(np.abs(slopes).max(axis=1) > 1e-3)
    rows_felt = rows[felt]
    wanted = np.arctan(np.tan(angles(rows_felt, layers)) + slopes[felt]).astype(np.float32)
    for _ in range(steps):
        found, jacobian = _with_jacobian(rows_felt, layers)
        along, across = jacobian[:, 0], jacobian[:, 1]
        a, b, c = ((x * y).sum(axis=1) for x, y in ((along, along), (along, across), (across, across)))
        a, c = a + np.float32(1e-3), c + np.float32(1e-3)
        du, dv = (wanted - found).T / (a * c - b * b)
        step = (c * du - b * dv)[:, None] * along + (a * dv - b * du)[:, None] * across
        rows_felt[:, :3] = np.clip(rows_felt[:, :3] + np.clip(step, -0.1, 0.1), 0.0, 1.0)
    rows[felt] = rows_felt
    grey = 255.0 * rows[:, :3] + np.random.default_rng(seed).normal(0.0, 1.0, (len(rows), 3)) * noise_grey
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8).reshape(background.shape)
