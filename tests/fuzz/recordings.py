"""Entry points of recordings and of the public benchmark's files, and valid ones to begin with."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow as pa
from mcap.writer import CompressionType

from tactape_fab.sense import load_sensor
from tactape_fab.sense.benchmark.adapters import changed_files, open_benchmark
from tactape_fab.sense.benchmark.answers import FORMAT, read_answers
from tactape_fab.sense.benchmark.score import calibration, read_truth, score
from tactape_fab.sense.benchmark.write import truth_path, write_benchmark
from tactape_fab.sense.files.recordings import open_recording
from tactape_fab.sense.live.cdr import IMAGE
from tests.recordings import dataset, film, image_message, mcap, pictures

Read = Callable[[bytes, Path], object]
_HEIGHT, _WIDTH, _COUNT = 6, 8, 4
_SENSOR = replace(load_sensor("gelsight-mini"), height_px=_HEIGHT, width_px=_WIDTH)
_FRAMES = [np.full((_HEIGHT, _WIDTH), 50 * k, dtype=np.uint16) for k in range(_COUNT)]


def recording_entries() -> dict[str, tuple[Read, list[bytes]]]:
    """What reads the bytes, and valid ones, by the entry point's name."""
    with TemporaryDirectory(prefix="tactape-seeds-") as folder:
        return {**_bags(Path(folder)), **_datasets(Path(folder)), **_benchmarks(Path(folder))}


def _read(path: Path, *, colour: bool = False) -> object:
    return list(open_recording(path, _SENSOR, colour=colour).frames())


def _bags(here: Path) -> dict[str, tuple[Read, list[bytes]]]:
    sent = [IMAGE.encode(image_message(image, "16UC1", k)) for k, image in enumerate(_FRAMES)]
    # without checksums, which would keep what is behind them from every changed file
    bags = [mcap(here / f"{kind.name}.mcap", {"/gel": sent}, compression=kind, enable_crcs=False) for kind in CompressionType]
    seeds = [path.read_bytes() for path in bags]

    def alone(data: bytes, folder: Path) -> object:
        (folder / "a.mcap").write_bytes(data)
        return _read(folder / "a.mcap")

    def bag(data: bytes, folder: Path) -> object:
        (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
        (folder / "a_0.mcap").write_bytes(seeds[0])
        (folder / "a_1.mcap").write_bytes(data)
        return _read(folder)

    return {"recording.mcap": (alone, seeds), "rosbag2": (bag, seeds)}


def _datasets(here: Path) -> dict[str, tuple[Read, list[bytes]]]:
    shape = [_HEIGHT, _WIDTH]
    arrays = pa.array([image.astype(np.float32).tolist() for image in _FRAMES], type=pa.list_(pa.list_(pa.float32())))
    made = {
        "images": dataset(here / "images", {"dtype": "image", "shape": [*shape, 1]}, pictures(_FRAMES), _COUNT),
        "arrays": dataset(here / "arrays", {"dtype": "float32", "shape": shape}, arrays, _COUNT),
        "film": dataset(here / "film", {"dtype": "video", "shape": [*shape, 3]}, None, _COUNT),
    }
    film(here / "film" / "videos" / "touch" / "chunk-000" / "file-000.mp4", [np.full((*shape, 3), 40, dtype=np.uint8)] * _COUNT)

    def entry(name: str, changed: str, **options: Any) -> tuple[Read, list[bytes]]:
        kept = {path.relative_to(made[name]): path.read_bytes() for path in made[name].rglob("*") if path.is_file()}

        def read(data: bytes, folder: Path) -> object:
            for path, content in {**kept, Path(changed): data}.items():
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                (folder / path).write_bytes(content)
            return _read(folder, **options)

        return read, [kept[Path(changed)]]

    table = "data/chunk-000/file-000.parquet"
    return {
        "dataset: info": entry("images", "meta/info.json"),
        "dataset: images": entry("images", table),
        "dataset: arrays": entry("arrays", table),
        "dataset: film": entry("film", "videos/touch/chunk-000/file-000.mp4", colour=True),
    }


def _benchmarks(here: Path) -> dict[str, tuple[Read, list[bytes]]]:
    made = here / "touch"
    write_benchmark(made, frames=1, only=["imprint, 7x7 mm", "imprint, film without parts"])
    said = {"position_mm": [1.0, 2.0], "theta_deg": 30.0, "tape": "tactape-s007", "covariance": np.eye(3).tolist()}
    lines = [{"format": FORMAT, "method": "ours"}, {"frame": 0, "located": True, **said, "p_false": 1e-5, "elapsed_ms": 1.5}]
    answers = "".join(f"{json.dumps(line)}\n" for line in [*lines, {"frame": 1, "located": False}]).encode()
    truth, index = truth_path(made).read_bytes(), (made / "benchmark.json").read_bytes()
    others = {path.relative_to(made): path.read_bytes() for path in made.rglob("*") if path.is_file()}

    def scored(data: bytes, true: bytes, folder: Path) -> object:
        (folder / "truth.jsonl").write_bytes(true)
        (folder / "a.jsonl").write_bytes(data)
        found = read_truth(folder / "truth.jsonl")
        _, answers = read_answers(folder / "a.jsonl", len(found))
        return score(answers, found), calibration(answers, found)

    def opened(data: bytes, folder: Path) -> object:
        for path, content in others.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        (folder / "benchmark.json").write_bytes(data)
        return open_benchmark(folder), changed_files(folder)

    return {
        "benchmark: answers": (lambda data, folder: scored(data, truth, folder), [answers]),
        "benchmark: truth": (lambda data, folder: scored(answers, data, folder), [truth]),
        "benchmark: index": (opened, [index]),
    }
