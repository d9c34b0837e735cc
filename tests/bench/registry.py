"""What many tapes cost the decoder: `python -m tests.bench.registry [--tapes 256 4096 65536] [--frames 100] [--page FILE]`.

Processor time of a frame (contacts of 11x9 mm) beside that with one tape, of a frame of a texture that nobody registered, of
loading a packed registry, and memory of each tape beyond its symbols, which stay in the file. Then 256 tapes that each have
holes beside 256 without, `anoto-6x6` about the smallest contacts that it locates, and loading the manifests of 4,096 kits.
Each row is measured in a process of its own.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any, get_args

import numpy as np

from tactape_fab import Localizer, Tape, TapeSpec, default_origin
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.sense.decode.settings import World
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.packed import MOST_HELD_BYTES, pack
from tactape_fab.texture.plane import encode
from tactape_fab.texture.registry import read_tapes
from tests.bench.code_trust import tape_of_code
from tests.bench.localization_rows import SECTOR, SEED, registered_tape
from tests.bench.marks import command, write_between

TAPES = (256, 4096, 65_536)
HOLES_MM = ((25.0, 12.5, 3.0), (75.0, 12.5, 3.0), (25.0, 37.5, 3.0), (75.0, 37.5, 3.0))
ANOTO, ANOTO_MM = "anoto-6x6", (6.0, 6.5, 7.0, 7.5)
MANIFESTS = 4096
_APART = (97, 131)
"""Columns and rows between tapes of one sector; with 62 x 32 grid points none lies on another."""


def tapes_like(like: Tape, count: int) -> Iterator[Tape]:
    """A tape, and others of its kind: all sectors, then all at another origin, and so on."""
    plane = get_plane(like.code)
    room = plane.range - max(like.columns, like.rows)
    sectors = [like.sector, *(s for s in range(plane.sectors) if s != like.sector)]
    for k in range(count):
        turn, sector = divmod(k, len(sectors))
        if k == 0:
            yield like
            continue
        u, v = default_origin(like.code, sectors[sector])
        origin = ((u + turn * _APART[0]) % room, (v + turn * _APART[1]) % room)
        symbols = encode(plane, sectors[sector], origin, (like.rows, like.columns))
        yield replace(like, name=f"tape-{k}", sector=sectors[sector], origin=origin, symbols=symbols, tag=None)


def frame_ms(localizer: Localizer, depths: Iterable[np.ndarray], rounds: int) -> tuple[list[float], int]:
    """Processor ms of each frame, the least of some rounds, and how many are located."""
    least, located = [], 0
    for depth in depths:
        times = []
        for _ in range(rounds):
            start = process_time()
            fix = localizer.locate(depth)
            times.append(1000.0 * (process_time() - start))
        least.append(min(times))
        located += fix.located
    return least, located


def anonymous_bytes() -> int:
    """Memory of this process that is not a file's."""
    gc.collect()
    rollup = Path("/proc/self/smaps_rollup").read_text(encoding="ascii")
    return 1024 * next(int(line.split()[1]) for line in rollup.splitlines() if line.startswith("Anonymous:"))


def measured(of: str, world: World, frames: int, rounds: int) -> dict[str, Any]:
    """One row, measured in this process: `of` is a packed registry, a folder of kits, or anoto at a size in mm."""
    if of.startswith(ANOTO):
        side = float(of.removeprefix(f"{ANOTO} "))
        tape, scene = tape_of_code(ANOTO), Scene(contact_mm=(side, side))
        found = Localizer([tape], world=world)
    else:
        if Path(of).is_dir():
            start = process_time()
            return {"tapes": len(read_tapes([of])), "loaded_s": process_time() - start}
        holed = replace(registered_tape(), omitted=np.array([[30, 10]]))
        for like in (registered_tape(), holed):  # loads all kernels, those of holes too: their memory is no tape's
            Localizer(list(tapes_like(like, 8)), world=world)
        first = Localizer([registered_tape()], world=world)
        before, start = anonymous_bytes(), process_time()
        tapes = read_tapes([of])
        loaded_s = process_time() - start
        found = Localizer(tapes, world=world)
        size = Path(of).stat().st_size
        held = size if size <= MOST_HELD_BYTES else 0
        ready_s, each = process_time() - start, (anonymous_bytes() - before - held) / len(tapes)
        tape, scene = tapes[0], Scene()
    depths = [frame.depth for frame in iterate_frames(tape, frames, SEED, scene=scene)]
    foreign = replace(tape, symbols=np.random.default_rng(SEED).integers(0, 4, tape.symbols.shape).astype(np.uint8))
    times, located = frame_ms(found, depths, rounds)
    p50, p99 = np.percentile(times, [50, 99]).tolist()
    row = {"p50": p50, "p99": p99, "located": located, "frames": frames}
    if of.startswith(ANOTO):
        return row
    one, _ = frame_ms(first, depths, rounds)
    others = [frame.depth for frame in iterate_frames(foreign, frames, SEED, scene=scene)]
    row["foreign"] = float(np.median(frame_ms(found, others, rounds)[0]))
    return {**row, "one": float(np.median(one)), "tapes": len(tapes), "loaded_s": loaded_s, "ready_s": ready_s, "bytes": each}


def in_process(*arguments: object) -> dict[str, Any]:
    """`measured` in a process of its own."""
    command = [sys.executable, "-m", "tests.bench.registry", "--one", *map(str, arguments)]
    found: dict[str, Any] = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    return found


def packed_row(name: str, tapes: Sequence[Tape], folder: Path, world: World, frames: int, rounds: int) -> str:
    file = folder / "tapes.registry"
    file.write_bytes(pack(tapes, [""] * len(tapes)))
    row = in_process(file, world, frames, rounds)
    return (
        f"| {name} | {world} | {row['p50']:.2f} | {row['p99']:.2f} | {row['p50'] / row['one']:.1f} | "
        f"{row['located']} of {frames} | {row['foreign']:.1f} | "
        f"{row['loaded_s']:.2f} | {row['ready_s']:.2f} | {row['bytes'] / 1e3:.1f} |"
    )


def table(wanted: str | None, counts: Iterable[int], worlds: Sequence[World], frames: int, rounds: int) -> Iterator[str]:
    """Lines of Markdown, each when it is measured."""
    yield f"Load {os.getloadavg()[0]:.1f}; {frames} frames, the least of {rounds} rounds. Memory is beside the symbols.\n"
    with tempfile.TemporaryDirectory() as name:
        folder, holed = Path(name), examine(TapeSpec(sector=SECTOR, holes_mm=HOLES_MM)).layout.tape
        rows = [(f"{n:,}", registered_tape(), n) for n in counts] if wanted in (None, "registry") else []
        if wanted in (None, "holes"):
            rows.append((f"256, {len(holed.omitted)} points of each without a part", holed, 256))
        if rows:
            titles = ("tapes", "world", "p50, ms", "p99, ms", "p50 / one tape", "located", "foreign, p50, ms")
            yield "| " + " | ".join((*titles, "load, s", "ready, s", "kB a tape")) + " |"
            yield "|---" * 10 + "|"
        for title, like, count in rows:
            tapes = list(tapes_like(like, count))
            for world in worlds:
                yield packed_row(title, tapes, folder, world, frames, rounds)
        if wanted in (None, "anoto"):
            yield f"\n| {ANOTO}, contact | world | p50, ms | p99, ms | located |\n|---|---|---|---|---|"
            for side in ANOTO_MM:
                for world in get_args(World):
                    row = in_process(f"{ANOTO} {side}", world, frames, rounds)
                    yield f"| {side:g} mm | {world} | {row['p50']:.2f} | {row['p99']:.2f} | {row['located']} of {frames} |"
        if wanted in (None, "manifests"):
            for tape in tapes_like(registered_tape(), MANIFESTS):
                kit = folder / "kits" / tape.name
                kit.mkdir(parents=True)
                content = {"format": "tactape-manifest/1", "fab": {"name": "generic-fpc"}, **tape.to_mapping()}
                (kit / "manifest.json").write_text(json.dumps(content), encoding="utf-8")
            row = in_process(folder / "kits", "open", 0, 0)
            yield f"\nThe manifests of {row['tapes']:,} kits, not packed: {row['loaded_s']:.2f} s."


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.registry", description=__doc__.splitlines()[0])
    parser.add_argument("--tapes", type=int, nargs="*", default=TAPES, metavar="N")
    parser.add_argument("--frames", type=int, default=100, metavar="N")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="of which a frame's least time is taken")
    parser.add_argument("--only", choices=("registry", "holes", "anoto", "manifests"))
    parser.add_argument("--world", choices=get_args(World), help="of registries, both unless said; of Anoto always both")
    parser.add_argument("--page", type=Path, metavar="FILE", help="where the tables go, between its marks")
    parser.add_argument("--one", nargs=4, metavar=("OF", "WORLD", "FRAMES", "ROUNDS"), help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.one:
        of, world, frames, rounds = chosen.one
        print(json.dumps(measured(of, world, int(frames), int(rounds))))
        return
    lines = []
    worlds = (chosen.world,) if chosen.world else get_args(World)
    for line in table(chosen.only, chosen.tapes, worlds, chosen.frames, chosen.rounds):
        print(line, flush=True)
        lines.append(line)
    if chosen.page:
        write_between(chosen.page, "registry", "\n".join([*lines, f"\n({command('tests.bench.registry')})"]) + "\n")


if __name__ == "__main__":
    main()
