"""The solid models by a CAD kernel: programs for processes of their own, each of which imports only what it needs."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from tactape_fab import Tape
from tactape_fab.solids.forms import SolidForm
from tests.bench.measure import peak_memory_mb

PEER = """
import json, resource, sys
from copy import copy
from time import perf_counter, process_time
from build123d import Box, Compound, Pos, Rot, Rectangle, export_step, export_stl, extrude, fillet
tape = json.load(open(sys.argv[1]))
(w, h), base, radius = tape["size_mm"], tape["base_mm"], tape["radius_mm"]
length, width, height = tape["body_mm"]
turn = Rot(0, 0, tape["rotation_deg"])
answer = {}

def timed(name, function):
    elapsed, processor = perf_counter(), process_time()
    result = function()
    answer[name + "_s"], answer[name + "_cpu_s"] = perf_counter() - elapsed, process_time() - processor
    return result

def board():
    face = Rectangle(w, h)
    return Pos(w / 2, h / 2, -base) * extrude(fillet(face.vertices(), radius), base)

def fused():
    return board() + [Pos(x, y, height / 2) * turn * Box(length, width, height) for x, y in tape["xy_mm"]]

def assembled():
    box, parts = Box(length, width, height), []
    for number, (x, y) in enumerate(tape["xy_mm"], 1):
        placed = copy(box).moved(Pos(x, y, height / 2) * turn)
        placed.label = f"R{number}"
        parts.append(placed)
    return Compound(label="t", children=[board(), *parts])

part = timed("build", fused)
assert len(part.solids()) == 1
timed("export", lambda: export_step(part, sys.argv[2]))
answer["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6
if len(sys.argv) > 4:
    timed("stl", lambda: export_stl(part, sys.argv[4]))
    whole = timed("assemble", assembled)
    timed("assembly", lambda: export_step(whole, sys.argv[5]))
with open(sys.argv[3], "w") as stream:
    json.dump(answer, stream)
"""
"""build123d: one box for each part, fused with the board at once, as STEP; with two more paths, that as STL, and the same
boxes as an assembly whose parts share one shape."""
OURS = """
import json, sys
from datetime import datetime, timezone
from time import perf_counter
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.step.solid import solid_step_chunks
from tactape_fab.texture.tape import Tape
tape = Tape.from_mapping(json.load(open(sys.argv[1])))
seconds = []
for _ in range(int(sys.argv[3])):
    start = perf_counter()
    with open(sys.argv[2], "wb") as stream:
        for piece in solid_step_chunks(tape, SolidForm(), name="t", date=datetime(2026, 1, 1), rgb=(0.5, 0.5, 0.5)):
            stream.write(piece)
    seconds.append(perf_counter() - start)
print("ANSWER", json.dumps({"write_s": min(seconds), "first_s": seconds[0]}))
"""
READ = """
import json, sys
from time import perf_counter
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp_Explorer
start = perf_counter()
reader = STEPControl_Reader()
reader.ReadFile(sys.argv[1])
reader.TransferRoots()
shape = reader.OneShape()
seconds = perf_counter() - start
explorer, solids = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_SOLID), 0
while explorer.More():
    solids += 1
    explorer.Next()
print("ANSWER", json.dumps({"read_s": seconds, "solids": solids}))
"""


def with_build123d(tape: Tape, step: Path, *more: Path) -> dict[str, float]:
    """What `PEER` says of a tape, in a process of its own; its files are `step` and `more`, beside files of its own."""
    given, said = step.with_suffix(".json"), step.with_suffix(".txt")
    given.write_text(json.dumps(peer_input(tape)), encoding="ascii")
    peak_memory_mb([sys.executable, "-c", PEER, *map(str, (given, step, said, *more))], step.parent)
    content: dict[str, float] = json.loads(said.read_bytes())
    return content


def peer_input(tape: Tape) -> dict[str, Any]:
    """A tape in the words of `PEER`."""
    return {
        "size_mm": tape.board.size_mm,
        "radius_mm": tape.board.corner_radius_mm,
        "base_mm": SolidForm().base_mm,
        "body_mm": tape.part.body_mm,
        "rotation_deg": tape.part.rotation_deg,
        "xy_mm": tape.part_xy_mm().tolist(),
    }


def answer(program: str, *arguments: str) -> dict[str, float]:
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, encoding="utf-8", check=True)
    lines = [line for line in done.stdout.splitlines() if line.startswith("ANSWER ")]
    content: dict[str, float] = json.loads(lines[-1].removeprefix("ANSWER "))
    return content
