"""Work on several cores and, on paper, on many machines: `python -m tests.bench.scaling [--workers 1 2]`.

Kits (written and verified, without models) and simulated contacts (drawn and located) by each number of workers in turn, all in
one run: seconds of the clock and of the processors, and how much faster than the first. The bytes of all answers must be equal.
Then what a million tapes and a thousand million contacts take, from these rates: core hours, bytes, and the price of both.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from itertools import islice
from pathlib import Path
from time import perf_counter, process_time
from typing import NamedTuple

import numpy as np

from tactape_fab import Localizer, TapeSpec
from tactape_fab.base.pool import Workers, mapped
from tactape_fab.kit.examine.tape import examine
from tactape_fab.make.kit import make_examined
from tactape_fab.sense.simulation.draw import frame_at
from tactape_fab.sense.simulation.drawn_poses import draw_poses
from tests.bench.localization_rows import SEED, registered_tape
from tests.bench.workers import workers

BLOCK = 25
"""Contacts of one item."""
TAPES, CONTACTS = 1_000_000, 1_000_000_000


class Measured(NamedTuple):
    """Seconds of the clock and of the processors, and a digest of the answers."""

    clock_s: float
    processor_s: float
    digest: str


def contacts(block: int) -> bytes:
    """What the decoder says of some simulated contacts, as a shard of a thousand million would keep it."""
    tape = registered_tape()
    numbers = np.arange(block * BLOCK, (block + 1) * BLOCK)
    poses = draw_poses(tape, int(numbers[-1]) + 1, SEED)
    localizer = Localizer([tape])
    said = []
    for k in numbers.tolist():
        fix = localizer.locate(frame_at(tape, k, poses[k], SEED).depth)
        place = (np.nan, np.nan, np.nan) if fix.position_mm is None else (*fix.position_mm, fix.theta_deg)
        said.append([*poses[k], *place, -1.0 if fix.p_false is None else fix.p_false])
    return np.array(said, dtype=np.float32).tobytes()


def kit(folder: Path, sector: int) -> bytes:
    """The manifest of a kit, which has the digest of every file."""
    folder.mkdir(exist_ok=True)
    made = make_examined(examine(TapeSpec(sector=sector, models=False)), folder / str(sector))
    return (made.path / "manifest.json").read_bytes()


def timed(function: Callable[[int], bytes], item: int) -> tuple[bytes, float]:
    """The answer for an item, and the processor seconds that it took its worker."""
    begin = process_time()
    return function(item), process_time() - begin


def measured(function: Callable[[int], bytes], count: int, chosen: Workers) -> Measured:
    """One run over items 0 to count - 1 in processes of their own; an item more for each worker comes before, to load modules."""
    warm = range(count, count + chosen) if isinstance(chosen, int) else range(0)
    with closing(mapped(partial(timed, function), [*warm, *range(count)], chosen, isolated=True)) as results:
        for _ in islice(results, len(warm)):
            pass
        clock = perf_counter()
        answers = list(results)
        clock_s = perf_counter() - clock
    whole = b"".join(answer for answer, _ in answers)
    return Measured(clock_s, sum(used for _, used in answers), hashlib.sha256(whole).hexdigest()[:16])


def table(
    name: str, functions: Sequence[Callable[[int], bytes]], count: int, each: int, wanted: Sequence[Workers]
) -> tuple[list[str], float]:
    """Rows of a table for each number of workers, and processor seconds of one thing by the first."""
    runs = [measured(function, count, chosen) for function, chosen in zip(functions, wanted, strict=True)]
    assert len({run.digest for run in runs}) == 1, f"{name}: the bytes depend on the workers"
    rows = [
        f"| {name} | {chosen} | {count * each} | {count * each / run.clock_s:.2f} | {runs[0].clock_s / run.clock_s:.2f} "
        f"| {run.processor_s / (count * each):.4f} | `{run.digest[:8]}` |"
        for chosen, run in zip(wanted, runs, strict=True)
    ]
    return rows, runs[0].processor_s / (count * each)


def plan(kit_s: float, kit_bytes: float, contact_s: float, core_hour: float, gb_month: float) -> list[str]:
    """The page's table of what much takes."""
    rows = [
        ("make and verify", TAPES, "tapes", kit_s, kit_bytes),
        ("draw and locate", CONTACTS, "contacts", contact_s, 28.0),  # seven float32
    ]
    out = [
        "| step | things | core s each | core hours | bytes each | GB | 1,000 cores, h | cores | disk, a month |",
        "|---" * 9 + "|",
    ]
    for step, number, noun, each_s, size in rows:
        hours, gb = number * each_s / 3600.0, number * size / 1e9
        out.append(
            f"| {step} | {number:,} {noun} | {each_s:.3f} | {hours:,.0f} | {size:,.0f} | {gb:,.0f} | {hours / 1000:,.1f} "
            f"| {hours * core_hour:,.0f} | {gb * gb_month:,.0f} |"
        )
    return out


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.scaling", description=__doc__)
    parser.add_argument("--workers", type=workers, nargs="+", default=[1, 2], metavar="N|tcp://HOST:PORT")
    parser.add_argument("--kits", type=int, default=12, metavar="N")
    parser.add_argument("--contacts", type=int, default=500, metavar="N")
    parser.add_argument("--core-hour", type=float, default=0.04, metavar="PRICE", help="of one core for an hour")
    parser.add_argument("--gb-month", type=float, default=0.02, metavar="PRICE", help="of a GB on a disk for a month")
    chosen = parser.parse_args()
    lines = ["| what | workers | things | things/s | faster | processor s each | bytes |", "|---" * 7 + "|"]
    with tempfile.TemporaryDirectory() as folder:
        folders = [Path(folder, str(k)) for k in range(len(chosen.workers))]
        kit_rows, kit_s = table("kits", [partial(kit, place) for place in folders], chosen.kits, 1, chosen.workers)
        sizes = [sum(f.stat().st_size for f in (folders[0] / str(i)).rglob("*") if f.is_file()) for i in range(chosen.kits)]
    rows, contact_s = table("contacts", [contacts] * len(folders), chosen.contacts // BLOCK, BLOCK, chosen.workers)
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n")
    print(
        "\n".join(
            [*lines, *kit_rows, *rows, "", *plan(kit_s, float(np.mean(sizes)), contact_s, chosen.core_hour, chosen.gb_month)]
        )
    )


if __name__ == "__main__":
    from tests.bench.scaling import main as of_module  # processes know its functions by this name

    of_module()
