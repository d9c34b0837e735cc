"""Images that a sensor would take of a depth map, made by turning its network round, and weights written by hand."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

Layers = Sequence[tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]]
Image = npt.NDArray[np.uint8]

MOST_AT_ONCE = 64
"""Pixels in one product of matrices: so few that no library shares it out between processors, which costs more than it saves."""


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
    """Angles (blocks, n, 2) of rows (blocks, n, 5), and what they change by with each colour, (blocks, 2, n, 3)."""
    active = []
    for weight, bias in layers[:-1]:
        rows = np.maximum(rows @ weight.T + bias, 0.0)
        active.append(rows > 0.0)
    jacobian: npt.NDArray[np.float32] = layers[-1][0][:, None, :]
    for (weight, _), on in zip(reversed(layers[:-1]), reversed(active), strict=True):
        jacobian = (jacobian * on[:, None]) @ weight
    return rows @ layers[-1][0].T + layers[-1][1], jacobian[..., :3]


def image_of(
    depth_mm: npt.NDArray[np.float32],
    background: npt.NDArray[Any],
    layers: Layers,
    px_per_mm: float,
    noise_grey: float = 0.0,
    seed: int = 0,
    steps: int = 3,
) -> Image:
    """The image, of 8 bits, in which the network sees the slopes of a depth map: for each pixel the nearest such colour.

    Newton's method from the background's colours, each step as short as can be; noise is white, in grey levels.
    """
    slopes = np.stack([-np.gradient(depth_mm, axis=axis) * px_per_mm for axis in (1, 0)], axis=-1)
    count = slopes.size // 2
    few = next(n for n in range(MOST_AT_ONCE, 0, -1) if count % n == 0)
    rows = features(np.asarray(background, dtype=np.uint8)).reshape(-1, few, 5)
    wanted = np.arctan(np.tan(_with_jacobian(rows, layers)[0]) + slopes.reshape(-1, few, 2)).astype(np.float32)
    for _ in range(steps):
        found, jacobian = _with_jacobian(rows, layers)
        along, across = jacobian[:, 0], jacobian[:, 1]
        a, b, c = ((x * y).sum(axis=-1) for x, y in ((along, along), (along, across), (across, across)))
        a, c = a + np.float32(1e-3), c + np.float32(1e-3)
        du, dv = np.moveaxis(wanted - found, -1, 0) / (a * c - b * b)
        step = (c * du - b * dv)[..., None] * along + (a * dv - b * du)[..., None] * across
        rows[..., :3] = np.clip(rows[..., :3] + np.clip(step, -0.1, 0.1), 0.0, 1.0)
    grey = 255.0 * rows[..., :3].reshape(-1, 3) + np.random.default_rng(seed).normal(0.0, 1.0, (count, 3)) * noise_grey
    return np.asarray(np.clip(np.rint(grey), 0, 255), dtype=np.uint8).reshape(background.shape)


# Weights as torch.save writes them, by hand (pickle protocol 2)


def text(value: str) -> bytes:
    data = value.encode()
    return b"X" + len(data).to_bytes(4, "little") + data


def whole(value: int) -> bytes:
    return b"J" + value.to_bytes(4, "little", signed=True)


def several(values: Sequence[int]) -> bytes:
    return b"(" + b"".join(whole(value) for value in values) + b"t"


def storage(key: str, count: int, kind: str = "FloatStorage") -> bytes:
    return b"(" + text("storage") + b"ctorch\n" + kind.encode() + b"\n" + text(key) + text("cpu") + whole(count) + b"tQ"


def tensor(stored: bytes, shape: Sequence[int], offset: int = 0, strides: Sequence[int] | None = None) -> bytes:
    if strides is None:
        strides = [int(np.prod(shape[i + 1 :])) for i in range(len(shape))]
    arguments = stored + whole(offset) + several(shape) + several(strides) + b"\x89" + EMPTY
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + arguments + b"tR"


EMPTY = b"ccollections\nOrderedDict\n)R"


def table(tensors: dict[str, bytes]) -> bytes:
    return b"\x80\x02" + EMPTY + b"(" + b"".join(text(name) + value for name, value in tensors.items()) + b"u."


def archive(entries: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as file:
        for name, data in entries.items():
            file.writestr(zipfile.ZipInfo(name), data, compress_type=compression)
    return stream.getvalue()


def tensors_of(layers: Layers) -> dict[str, npt.NDArray[np.float32]]:
    return {
        f"fc{i + 1}.{what}": array for i, pair in enumerate(layers) for what, array in zip(("weight", "bias"), pair, strict=True)
    }


def weights_file(path: Path, tensors: dict[str, npt.NDArray[np.float32]]) -> Path:
    """A .pth with these tensors."""
    pickled = table({name: tensor(storage(str(k), a.size), a.shape) for k, (name, a) in enumerate(tensors.items())})
    data = {f"net/data/{k}": a.astype("<f4").tobytes() for k, a in enumerate(tensors.values())}
    path.write_bytes(archive({"net/data.pkl": pickled, **data, "net/version": b"3\n"}))
    return path


def random_layers(widths: Sequence[int], seed: int = 0) -> Layers:
    rng = np.random.default_rng(seed)
    pairs = [(rng.normal(0.0, (2.0 / a) ** 0.5, (b, a)), rng.normal(0.0, 0.1, b)) for a, b in pairwise(widths)]
    return [(weight.astype(np.float32), bias.astype(np.float32)) for weight, bias in pairs]


def plain_network() -> Layers:
    """Two layers in which blue tells the slope along u, and green that along v: an angle of 0 where they are half."""
    hidden = np.zeros((4, 5), dtype=np.float32)
    hidden[[0, 1], [0, 1]], hidden[[2, 3], [0, 1]] = 1.0, -1.0
    out = np.array([[2, 0, -2, 0], [0, 2, 0, -2]], dtype=np.float32)
    return [(hidden, np.array([-0.5, -0.5, 0.5, 0.5], dtype=np.float32)), (out, np.zeros(2, dtype=np.float32))]
