"""Times of what a tape's files take, ours and other libraries', on the same tape; `fabrication` is the page's section."""

from __future__ import annotations

import gc
import json
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

from tactape_fab import Tape
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.film.drawing import tape_drawing
from tactape_fab.kit.render.gerber import render_copper
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.triangles import Mesh, stl_bytes, threemf_bytes
from tactape_fab.solids.step.assembly import assembly_step
from tactape_fab.solids.step.solid import solid_step_chunks
from tests.bench.evidence.job import Result
from tests.bench.gerber_peers import PEERS
from tests.bench.measure import command, large_spec, peak_memory_mb, planned
from tests.bench.mesh_peers import stl_with_trimesh, threemf_with_lib3mf, united
from tests.bench.solid_peers import OURS as SOLID_PROGRAM
from tests.bench.solid_peers import with_build123d

US = "tactape-fab"
COPPER, KIT = "copper layer", "whole kit"
SOLID, ASSEMBLY, STL, THREEMF = "solid, STEP", "assembly, STEP", "mesh, STL", "mesh, 3MF"
ONLY_STL, ONLY_THREEMF = "STL of one mesh", "3MF of one mesh"
LIBRARIES = ("gerber_writer", "gerbonara", "build123d", "manifold3d", "trimesh", "lib3mf")
DATE = datetime(2026, 1, 1, tzinfo=timezone.utc)
BOARD_RGB, PART_RGB = (0.8, 0.5, 0.1), (0.1, 0.1, 0.1)
VOLUME_TOLERANCE = 1e-4

MAKE_PROGRAM = """
import json, shutil, sys
from pathlib import Path
from time import process_time
from tactape_fab import TapeSpec
from tactape_fab.make.kit import make_kit
spec, folder, calls = TapeSpec.from_mapping(json.loads(sys.argv[1])), Path(sys.argv[2]), int(sys.argv[3])
seconds = []
for _ in range(calls):
    shutil.rmtree(folder, ignore_errors=True)
    start = process_time()
    kit = make_kit(spec, folder, verify=False)
    seconds.append(process_time() - start)
size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
answer = {"parts": kit.tape.part_count, "seconds": min(seconds), "bytes": size}
with open(sys.argv[4], "w") as stream:
    json.dump(answer, stream)
"""


def in_turns(contenders: Mapping[str, Callable[[], object]], turns: int) -> dict[str, float]:
    """Least processor time of each (s), all of its threads; each turn calls all of them."""
    best = dict.fromkeys(contenders, float("inf"))
    gc.collect()
    gc.freeze()  # what is there already is not looked through for each of them
    for _ in range(turns):
        for name, function in contenders.items():
            gc.collect()
            start = process_time()
            function()
            best[name] = min(best[name], process_time() - start)
    gc.unfreeze()
    return best


def measure_copper(parts: int, turns: int, peers: bool) -> Result:
    """A copper layer from the layout's arrays to the file's bytes."""
    examined = examine(large_spec(parts))
    layout, fab = examined.layout, examined.fab
    data: dict[str, bytes] = {}

    def ours() -> None:
        (artifact,) = render_copper(tape_drawing(layout), fab)
        data[US] = artifact.data

    def theirs(name: str) -> Callable[[], None]:
        return lambda: data.__setitem__(name, PEERS[name](layout))

    seconds = in_turns({US: ours} | {name: theirs(name) for name in PEERS if peers}, turns)
    return {
        "parts": layout.tape.part_count,
        "seconds": {COPPER: seconds},
        "bytes": {COPPER: {name: len(content) for name, content in data.items()}},
    }


@dataclass(slots=True)
class _Files:
    """Seconds and bytes of each file by who wrote it."""

    seconds: dict[str, dict[str, float]]
    bytes: dict[str, dict[str, int]]

    def add(self, file: str, who: str, seconds: float, path: Path) -> None:
        self.seconds.setdefault(file, {})[who] = seconds
        self.bytes.setdefault(file, {})[who] = path.stat().st_size


def measure_models(parts: int, turns: int, writers: bool, union: bool, kernel: bool) -> Result:
    """All models from the tape to files: ours, and others'.

    Parameters
    ----------
    writers, union, kernel : bool
        Whether others write our mesh; whether a mesh library makes its own; whether a CAD kernel makes all of it.
    """
    tape, found = planned(large_spec(parts)), _Files({}, {})
    memory_mb: dict[str, dict[str, float]] = {}
    with TemporaryDirectory() as name:
        folder = Path(name)
        _exact_models(tape, turns, folder, found)
        _meshes(tape, turns, writers, union, folder, found)
        if kernel:
            said = _kernel_models(tape, folder, found)
            memory_mb[SOLID] = {US: _memory_of_a_solid_mb(tape, folder), "build123d": said}
    return {"parts": tape.part_count, "seconds": found.seconds, "bytes": found.bytes, "memory_mb": memory_mb}


def _exact_models(tape: Tape, turns: int, folder: Path, found: _Files) -> None:
    solid, assembly = folder / "solid.step", folder / "assembly.step"

    def write_solid() -> None:
        with solid.open("wb") as stream:
            for piece in solid_step_chunks(tape, SolidForm(), name="t", date=DATE, rgb=PART_RGB):
                stream.write(piece)

    def write_assembly() -> None:
        assembly.write_bytes(assembly_step(tape, name="t", date=DATE, board_rgb=BOARD_RGB, part_rgb=PART_RGB))

    best = in_turns({SOLID: write_solid, ASSEMBLY: write_assembly}, turns)
    found.add(SOLID, US, best[SOLID], solid)
    found.add(ASSEMBLY, US, best[ASSEMBLY], assembly)


def _meshes(tape: Tape, turns: int, writers: bool, union: bool, folder: Path, found: _Files) -> None:
    """Meshes and their files, and the files of one mesh by writers alone."""
    form = SolidForm()
    meshes: dict[str, Mesh] = {}

    def build(who: str, mesh_of: Callable[[], Mesh]) -> None:
        meshes[who] = mesh_of()

    builders = {US: lambda: build(US, lambda: texture_mesh(tape, form))}
    if union:
        builders["union"] = lambda: build("union", lambda: united(tape, form.base_mm))
    built = in_turns(builders, turns)
    write = _writers(meshes[US], folder / "ours", US, stl_with_us, threemf_with_us)
    if writers:
        write |= _writers(meshes[US], folder / "same", "same", stl_with_trimesh, threemf_with_lib3mf)
    if union:
        assert abs(meshes["union"].volume_mm3 / meshes[US].volume_mm3 - 1.0) < VOLUME_TOLERANCE
        write |= _writers(meshes["union"], folder / "theirs", "union", stl_with_trimesh, threemf_with_lib3mf)
    written = in_turns(write, turns)
    for file, alone, ending, library in ((STL, ONLY_STL, "stl", "trimesh"), (THREEMF, ONLY_THREEMF, "3mf", "lib3mf")):
        path, same = folder / f"ours.{ending}", folder / f"same.{ending}"
        found.add(file, US, built[US] + written[f"{US} {ending}"], path)
        if union:
            theirs_s = built["union"] + written[f"union {ending}"]
            found.add(file, f"manifold3d, {library}", theirs_s, folder / f"theirs.{ending}")
        found.add(alone, US, written[f"{US} {ending}"], path)
        if writers:
            found.add(alone, library, written[f"same {ending}"], same)


def _writers(
    mesh: Mesh, stem: Path, who: str, stl: Callable[[Mesh, Path], None], threemf: Callable[[Mesh, Path], None]
) -> dict[str, Callable[[], object]]:
    return {
        f"{who} stl": lambda: stl(mesh, stem.with_suffix(".stl")),
        f"{who} 3mf": lambda: threemf(mesh, stem.with_suffix(".3mf")),
    }


def stl_with_us(mesh: Mesh, path: Path) -> None:
    path.write_bytes(stl_bytes(mesh, "t"))


def threemf_with_us(mesh: Mesh, path: Path) -> None:
    path.write_bytes(threemf_bytes(mesh, "t", {}, DATE))


def _kernel_models(tape: Tape, folder: Path, found: _Files) -> float:
    """What build123d makes of the tape; its peak memory up to the solid's file (MB)."""
    solid, stl, assembly = (folder / f"kernel-{name}" for name in ("solid.step", "mesh.stl", "assembly.step"))
    said = with_build123d(tape, solid, stl, assembly)
    found.add(SOLID, "build123d", said["build_cpu_s"] + said["export_cpu_s"], solid)
    found.add(ASSEMBLY, "build123d", said["assemble_cpu_s"] + said["assembly_cpu_s"], assembly)
    found.add(STL, "build123d", said["build_cpu_s"] + said["stl_cpu_s"], stl)
    return said["peak_mb"]


def _memory_of_a_solid_mb(tape: Tape, folder: Path) -> float:
    given = folder / "tape.json"
    given.write_text(json.dumps(tape.to_mapping()), encoding="ascii")
    return peak_memory_mb([sys.executable, "-c", SOLID_PROGRAM, str(given), str(folder / "again.step"), "1"], folder)


def measure_kit(parts: int, turns: int) -> Result:
    """`make --no-verify` from a spec to a folder, its imports done, in a process of its own; and that one's memory."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        spec, said = json.dumps(large_spec(parts).to_mapping()), folder / "said.json"
        program = [sys.executable, "-c", MAKE_PROGRAM, spec, str(folder / "kit"), str(turns), str(said)]
        memory_mb = peak_memory_mb(program, folder)
        answer = json.loads(said.read_bytes())
    return {
        "parts": answer["parts"],
        "seconds": {KIT: {US: answer["seconds"]}},
        "bytes": {KIT: {US: answer["bytes"]}},
        "memory_mb": {KIT: {US: memory_mb}},
    }


def measure_processes(turns: int) -> Result:
    """Whole processes: the least seconds of each on the clock, and of the processor; and the versions of all libraries."""
    main_job = [command(), "make", "--sector", "7"]
    programs = {
        "`make`": main_job,
        "`make --no-verify`": [*main_job, "--no-verify"],
        "`--help`": [command(), "--help"],
        **{f"`python -c 'import {name}'`": [sys.executable, "-c", f"import {name}"] for name in ("build123d", "gerbonara")},
        "`python -c ''`": [sys.executable, "-c", ""],
    }
    best = {name: {"elapsed_s": float("inf"), "cpu_s": float("inf")} for name in programs}
    for _ in range(turns):
        for name, arguments in programs.items():
            for key, value in _seconds_of_a_process(arguments).items():
                best[name][key] = min(best[name][key], value)
    return {"processes": best, "versions": {name: version(name) for name in LIBRARIES}}


def _seconds_of_a_process(arguments: list[str]) -> dict[str, float]:
    import resource  # not on every system that makes the page

    with TemporaryDirectory() as folder:
        start, before = perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(arguments, check=True, capture_output=True, cwd=folder)
        elapsed, after = perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return {"elapsed_s": elapsed, "cpu_s": after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime}
