"""Answers of the decoder to the same frames, written by one version of it and compared with another's, digit for digit.

    python -m tests.bench.answers write OLD.jsonl [--frames 100]      in one checkout
    python -m tests.bench.answers compare OLD.jsonl [--frames 100]    in the other

The frames are those of the rows of the localization benchmark, so many of each: 10,000 by `--frames 460`. All are answered in
both worlds, those of the first row to the pixels as well. What is compared is all that an answer says but its time, its dots
among it, every number to its last digit. Run both once before: a process that compiles the decoder has another last digit in one
frame of a thousand than those that find it compiled (`rim.settled`).
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any
from zlib import adler32

import numpy as np

from tactape_fab import Localizer
from tests.bench.localization_measure import WORLDS, localizer_of, prior_of
from tests.bench.localization_rows import ROWS, frames_of, tapes_of

SHOWN = 10


def answers(frames: int) -> Iterator[dict[str, Any]]:
    """One mapping for each answer, with the row, the world and the frame that it is for."""
    for row in ROWS:
        localizers = {f"{world} world": localizer_of(row.tapes, world, row.max_p_tape) for world in WORLDS}
        if row is ROWS[0]:
            localizers["to the pixels"] = Localizer(tapes_of(row), refine="pixels")
        rng = np.random.default_rng(row.seed)
        for k, frame in enumerate(frames_of(row, max(frames // row.fewer, 1))):
            prior = prior_of(frame, rng) if row.prior else None
            for name, localizer in localizers.items():
                said = localizer.locate(frame.depth, prior=prior).to_mapping(dots=True)
                del said["elapsed_ms"]
                yield {"row": row.name, "how": name, "frame": k, "pixels": adler32(frame.depth.tobytes())} | said


def differences(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Names of what is not the same in two answers, as text, so that NaN equals NaN and 0.0 is not -0.0."""
    return [name for name in sorted(old.keys() | new.keys()) if repr(old.get(name)) != repr(new.get(name))]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.answers", description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["write", "compare"])
    parser.add_argument("file", type=Path)
    parser.add_argument("--frames", type=int, default=100, help="of each row")
    asked = parser.parse_args()
    if asked.what == "write":
        with asked.file.open("w", encoding="utf-8") as file:
            file.writelines(json.dumps(said) + "\n" for said in answers(asked.frames))
        return
    count, located, changed = 0, 0, Counter[str]()
    with asked.file.open(encoding="utf-8") as file:
        for line, said in zip_longest(file, answers(asked.frames)):
            if line is None or said is None:
                raise SystemExit(f"{asked.file} has not as many answers; write it with --frames {asked.frames}")
            old, new = json.loads(line), json.loads(json.dumps(said))
            found = differences(old, new)
            if found and changed.total() < SHOWN:
                what = "; ".join(f"{name} {str(old.get(name))[:60]} -> {str(new.get(name))[:60]}" for name in found)
                print(f"{new['row']}, {new['how']}, frame {new['frame']}: {what}")
            count, located = count + 1, located + new["located"]
            changed.update([", ".join(found)] if found else [])
    print(f"{count} answers, {located} located: {changed.total()} differ")
    for names, times in changed.most_common():
        print(f"{times:8}  {names}")
    if changed:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
