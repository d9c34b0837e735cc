"""A data set read back, and methods run on it: ours and the paper's; any function of a depth map can be compared with them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time
from typing import Any

import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, reason_of
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.input_file import read_regular, sha256_of
from tactape_fab.base.json_text import parse_json
from tactape_fab.sense.benchmark.answers import FORMAT as ANSWERS
from tactape_fab.sense.benchmark.write import FORMAT, FRAMES, INDEX, SENSOR, Progress
from tactape_fab.sense.files.depth_maps import FrameFile, open_frames
from tactape_fab.sense.sensors import SensorProfile, load_sensor
from tactape_fab.texture.manifest import safe_path
from tactape_fab.texture.tape import Tape

Locate = Callable[[npt.NDArray[Any]], Any]
"""Function from a frame of the file to a method's own result; its time is measured."""
Say = Callable[[Any], Mapping[str, Any]]
"""Function from that result to the keys of an answer (see `answers.read_answers`); its time is not measured."""
_MOST_BYTES = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Benchmark:
    """The part of a data set that a method may see: frames, their sensor, and the tapes that may be touched."""

    frames: FrameFile
    sensor: SensorProfile
    tapes: tuple[Tape, ...]


Adapter = Callable[[Benchmark], tuple[Locate, Say]]
"""Makes the functions that answer a data set's frames."""


def _ours(benchmark: Benchmark, **options: Any) -> tuple[Locate, Say]:
    from tactape_fab.sense.decode.localizer import Localizer

    return Localizer(benchmark.tapes, benchmark.sensor, **options).locate, lambda fix: fix.to_mapping(0)


ADAPTERS: Mapping[str, Adapter] = {
    "ml": _ours,
    "ml-pixels": partial(_ours, refine="pixels"),
    "paper": partial(_ours, method="paper"),
}
"""This package's methods by name; `ml` is what `decode` does."""


def read_index(folder: str | Path) -> dict[str, Any]:
    """The content of a data set's benchmark.json. Raises SpecError."""
    path = Path(folder) / INDEX
    try:
        content = parse_json(read_regular(path, _MOST_BYTES))
        if content.get("format") != FORMAT:
            raise ValueError(f"its format is {shown(content.get('format'))}, not {FORMAT}")
        table = Fields(content)
        files = table.table("files")
        if table.problems or any(safe_path(name) is None or not isinstance(value, str) for name, value in files.values.items()):
            raise ValueError("its files are not named by plain paths and sums")
        return dict(content)
    except (OSError, ValueError, AttributeError) as error:
        message = f"{shown_path(path)} is no benchmark: {reason_of(error)}; write one by python -m "
        message += "tactape_fab.sense.benchmark write FOLDER"
        raise SpecError(Problem("folder", message)) from error


def open_benchmark(folder: str | Path) -> Benchmark:
    """Open a data set for a method. Raises SpecError."""
    files, folder = read_index(folder)["files"], Path(folder)
    sensor = load_sensor(folder / SENSOR)
    (frames,) = open_frames([folder / FRAMES], sensor)
    tapes = tuple(Tape.load(folder / name) for name in sorted(files) if name.startswith("tapes/"))
    return Benchmark(frames=frames, sensor=sensor, tapes=tapes)


def changed_files(folder: str | Path) -> list[str]:
    """Files of a data set that are not what its index says. Raises SpecError."""
    changed = []
    for name, listed in read_index(folder)["files"].items():
        try:
            same = sha256_of(Path(folder) / name) == listed
        except OSError:
            same = False
        changed += [] if same else [name]
    return changed


def answer_lines(name: str, adapter: Adapter, benchmark: Benchmark, progress: Progress = lambda *_: None) -> Iterator[str]:
    """Lines of an answers file, the method's name first.

    Times are those of the processor: what else the machine does hardly counts. The first frame is located twice, so that what is
    loaded or compiled for it does not count either.
    """
    locate, line_of = adapter(benchmark)
    yield json.dumps({"format": ANSWERS, "method": name})
    for k, depth in enumerate(benchmark.frames.frames()):
        if k == 0:
            locate(depth)
        start = process_time()
        found = locate(depth)
        elapsed_ms = 1000.0 * (process_time() - start)
        progress("frames", k + 1, benchmark.frames.count)
        yield json.dumps({**line_of(found), "frame": k, "elapsed_ms": round(elapsed_ms, 4)}, allow_nan=False)
