"""The benchmark's files: frames, tapes and sensor in a folder, and the truth in a file beside it."""

from __future__ import annotations

import functools
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.errors import TactapeError, reason_of, refuse, tried
from tactape_fab.base.fields import Fields, nearest, shown, shown_path
from tactape_fab.base.input_file import sha256_of
from tactape_fab.base.output_file import refuse_taken_place, sync_below, sync_folder, unfinished, write_file
from tactape_fab.base.templates import templates_folder
from tactape_fab.sense.benchmark.conditions import BARE_NAMES, CONDITIONS, FOREIGN, FOREIGN_NAMES, REGISTERED, tape_of
from tactape_fab.sense.sensors import load_sensor
from tactape_fab.sense.simulation.draw import Frame, iterate_frames
from tactape_fab.texture.manifest import MANIFEST_FORMAT

FORMAT, TRUTH_FORMAT = "tactape-benchmark/1", "tactape-truth/1"
INDEX, FRAMES, SENSOR = "benchmark.json", "frames.npy", "sensor.toml"
USUAL_FRAMES, USUAL_SEED = 64, 2026
MOST_FRAMES = 65
"""Frames a condition: 20 conditions of 65 frames take 200 MB."""
UNIT_MM = 2.0**-11
"""Millimetres in one count of a frame, half a micrometre: a quarter of the noise between two pixels, and far above what the
last bits of a Fourier transform change."""
_SENSOR_NAME = "gelsight-mini"

Progress = Callable[[str, int, int], None]


def truth_path(folder: Path) -> Path:
    """Where the truth of a data set is written: beside its folder, which can be handed out without it."""
    if folder.name in ("", ".."):  # as ".", from within it
        folder = folder.resolve()
    return folder.parent / f"{folder.name}-truth.jsonl"


def write_benchmark(
    folder: str | Path,
    *,
    frames: int = USUAL_FRAMES,
    seed: int = USUAL_SEED,
    only: Sequence[str] = (),
    progress: Progress = lambda *_: None,
) -> dict[str, str]:
    """Simulate the benchmark and write it.

    folder: Must not be there. It gets frames.npy (N, h, w) int16 in units of `UNIT_MM`, sensor.toml, a manifest for each tape
        that may be touched, and benchmark.json. The frames of all conditions are shuffled.
    frames: Of each condition.
    seed: Equal seeds give equal bytes.
    only: Conditions; all when left out.
    Returns: SHA-256 of each file, the truth's included, by its path.
    Raises SpecError for every invalid value, and where the folder or the truth is there.
    Raises TactapeError when they cannot be written.
    """
    folder = Path(folder)
    table = Fields({"frames": frames, "seed": seed})
    table.integer("frames", low=1, high=MOST_FRAMES)
    table.integer("seed", low=0, high=2**63)
    for name in only:
        if name not in CONDITIONS:
            close = nearest(name, list(CONDITIONS)) or next(iter(CONDITIONS))
            table.problem("only", f"only = {shown(name)} is no condition; give one such as {shown(close)}")
    for path in (folder, truth_path(folder)):
        tried(functools.partial(refuse_taken_place, path, "folder"), table.problems)
    refuse(table.problems)
    names = [name for name in CONDITIONS if name in only or not only]
    partial = unfinished(folder)
    try:
        (partial / "tapes").mkdir(parents=True)
        truth = _frames(partial / FRAMES, names, frames, seed, progress)
        (partial / SENSOR).write_bytes(sensor_text().encode())
        for sector in REGISTERED:
            tape = tape_of(sector)
            (partial / "tapes" / f"{tape.name}.json").write_bytes(_json({"format": MANIFEST_FORMAT, **tape.to_mapping()}))
        sums = {path.relative_to(partial).as_posix(): sha256_of(path) for path in sorted(partial.rglob("*.*")) if path.is_file()}
        lines = b"".join([_line({"format": TRUTH_FORMAT, "seed": seed}), *map(_line, truth)])
        truth_sum = hashlib.sha256(lines).hexdigest()
        index = {"format": FORMAT, "frames": len(truth), "unit_mm": UNIT_MM, "files": sums, "truth_sha256": truth_sum}
        (partial / INDEX).write_bytes(_json(index))
        sync_below(partial)
        write_file(truth_path(folder), lines, "folder", overwrite=False)
        partial.replace(folder)
        sync_folder(folder.parent)
    except OSError as error:
        raise TactapeError(f"{shown_path(folder)} cannot be written: {reason_of(error)}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return {**sums, INDEX: sha256_of(folder / INDEX), truth_path(folder).name: truth_sum}


def sensor_text() -> str:
    """The profile of the frames' sensor, with their unit."""
    text = (templates_folder() / "sensors" / f"{_SENSOR_NAME}.toml").read_text(encoding="utf-8")
    before, unit, after = text.partition("unit_mm = 1.0\n")
    assert unit
    return f"{before}unit_mm = {UNIT_MM!r}\n{after}"


def _frames(path: Path, names: Sequence[str], count: int, seed: int, progress: Progress) -> list[dict[str, Any]]:
    """Write the frames of all conditions, shuffled; their truth, in the order of the file."""
    total = count * len(names)
    # a stream of its own (9), so that the order changes no frame
    places = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(9,)))).permutation(total)
    stack = np.lib.format.open_memmap(path, mode="w+", dtype="<i2", shape=(total, *load_sensor(_SENSOR_NAME).frame_shape))
    truth: list[dict[str, Any]] = [{}] * total
    for k, (name, sector, frame) in enumerate(_drawn(names, count, seed)):
        # 16 bits of 2^-11 mm reach 16 mm either way
        counts = np.rint(frame.depth.astype(np.float64) / UNIT_MM)
        stack[places[k]] = np.clip(counts, -(2**15), 2**15 - 1).astype("<i2")
        hinted = name not in BARE_NAMES
        truth[places[k]] = {
            "frame": int(places[k]),
            "condition": name,
            "tape": tape_of(sector).name if hinted else None,
            "sector": sector if hinted else None,
            "registered": hinted and sector in REGISTERED,
            "position_mm": [round(float(v), 6) for v in frame.position_mm] if hinted else None,
            "theta_deg": round(float(frame.theta_deg), 6) if hinted else None,
        }
        progress("frames", k + 1, total)
    stack.flush()
    return truth


def _drawn(names: Sequence[str], count: int, seed: int) -> Iterator[tuple[str, int, Frame]]:
    """Condition, sector and frame; the tapes are touched in turn, and a condition's frames do not depend on the others."""
    for name in names:
        # by the place in the whole list, whatever conditions are asked for
        own = (seed + 1000 * list(CONDITIONS).index(name)) % 2**63
        sectors = [FOREIGN] if name in FOREIGN_NAMES else REGISTERED
        each = -(-count // len(sectors))
        streams = [
            iterate_frames(tape_of(sector), each, own + k, _SENSOR_NAME, CONDITIONS[name]) for k, sector in enumerate(sectors)
        ]
        for k in range(count):
            yield name, sectors[k % len(sectors)], next(streams[k % len(sectors)])


def _json(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, indent=1) + "\n").encode()


def _line(content: dict[str, Any]) -> bytes:
    return (json.dumps(content) + "\n").encode()
