"""Checks of solid models by independent software: OCCT, FreeCAD, PrusaSlicer and trimesh, each in a process of its own."""

from __future__ import annotations

import json
import re
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base import launch
from tactape_fab.base.errors import Check
from tactape_fab.base.fields import counted, named, shown_path
from tactape_fab.base.pool import core_count
from tactape_fab.solids.elements import element_volume_mm3
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.volume import solid_volume_mm3
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.layers.lands import nearest, point_tree
from tactape_fab.verify.models.expected import VOLUME_TOLERANCE, Expected, film_centre_mm
from tactape_fab.verify.models.step_text import foreign_entities, step_text

PLACE_TOLERANCE_MM = 0.001
DIRECTION_TOLERANCE = 1e-6
_MOST_GAP_MM = 1e-4
"""Largest gap between an edge or a vertex and its faces, in solids that this tool writes; OCCT finds 1e-7 mm in them."""
_TIMEOUT_S = 1800
CPU_S, CPU_S_OF_OWN = 5.0, 30.0
"""Limits of a reader's processor time per MB, at least one, after loading: for an untrusted file, and for one that this version
writes, which is known to end and may take longer on a slow machine. A MB of boxes takes OCCT 0.9 s, of domes 0.9,
of domes round a cylinder 2.5; FreeCAD 1.2, 1.5 and 3.3; meshes less than 0.3 s in trimesh and PrusaSlicer."""
_LOADED_S = 5
MEMORY_BYTES, MEMORY_PER_BYTE = 1 << 30, 400
"""Limit of a reader's memory: a kit of 1,188 parts, 4.9 MB of STEP, takes each of them less than 0.5 GiB."""
_FILE_NAMES = {"step-solid": "solid.step", "step-assembly": "assembly.step", "stl": "a.stl", "3mf": "a.3mf"}
_FREECAD = """
import json, sys
import Part
try:
    import resource
except ImportError:
    pass
else:
    used = resource.getrusage(resource.RUSAGE_SELF)
    last = max(1, int(used.ru_utime + used.ru_stime + {cpu_s}))
    resource.setrlimit(resource.RLIMIT_CPU, (last, resource.getrlimit(resource.RLIMIT_CPU)[1]))
answer = {{}}
for key, path in {files!r}.items():
    shape = Part.Shape()
    shape.read(path)
    solids = shape.Solids
    if key == "assembly":
        answer[key] = {{"centres": [list(s.CenterOfMass) + [s.Volume] for s in solids]}}
        continue
    answer[key] = {{
        "solids": len(solids), "faces": len(shape.Faces), "valid": bool(shape.isValid()),
        "volume_mm3": sum(s.Volume for s in solids),
        "centre_mm": list(solids[0].CenterOfMass) if len(solids) == 1 else None,
    }}
with open({answer!r}, "w") as stream:
    json.dump(answer, stream)
"""
# bodies: every face takes the least label of its neighbours until nothing changes; trimesh's own function needs scipy
_TRIMESH = """
import json, sys
import numpy as np
import trimesh
answer = {}
for path in sys.argv[1:]:
    mesh = trimesh.load_mesh(path, process=True)
    a, b = mesh.face_adjacency.T
    body, before = np.arange(len(mesh.faces)), None
    while before is None or (body != before).any():
        before = body.copy()
        least = np.minimum(body[a], body[b])
        np.minimum.at(body, before[a], least)
        np.minimum.at(body, before[b], least)
        body = body[body]
    bodies = len(np.unique(body))
    answer[path] = [bool(mesh.is_watertight), bool(mesh.is_winding_consistent), bodies, float(mesh.volume)]
print("ANSWER " + json.dumps(answer))
"""


_Reader = Callable[[Tape, Expected, Mapping[str, Path], "CplContent | None"], list[Check]]


@contextmanager
def read_by_others(
    tape: Tape,
    expected: Expected,
    files: Mapping[str, WrittenFile],
    cpl: CplContent | None,
    progress: Callable[[str, int, int], None],
) -> Iterator[Iterator[Check]]:
    """Context manager: every installed reader reads a kit's models, in parallel on the available cores.

    Yields an iterator of their lines in a fixed order, the slowest reader last, which waits for the results. A missing reader is
    a line that is not a failure.
    """
    children = launch.Children()
    threads = ThreadPoolExecutor(core_count(), initializer=children.register_thread)
    with tempfile.TemporaryDirectory(prefix="tactape-verify-") as scratch, threads as pool:
        paths = {}
        for role, name in _FILE_NAMES.items():
            if role in files:
                paths[role] = Path(scratch) / name
                paths[role].write_bytes(files[role].data)
        readers = _READERS
        if "step-solid" in files and not _is_own(expected, paths):
            readers = {"CAD kernels": _kernels} | {name: read for name, read in readers.items() if read not in (_occt, _freecad)}
        # threads, as each only waits for a child process
        runs = [(name, pool.submit(read, tape, expected, paths, cpl)) for name, read in readers.items()]
        try:
            yield _lines(runs[::-1], progress)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            children.stop()  # after Ctrl-C or SIGTERM some might run for minutes


def _lines(runs: Sequence[tuple[str, Future[list[Check]]]], progress: Callable[[str, int, int], None]) -> Iterator[Check]:
    for done, (name, run) in enumerate(runs):
        progress(f"models read by {name}: reader", done, len(runs))
        yield from run.result()


def _limits(files: Iterable[Path], *, own: bool = False) -> tuple[float, int]:
    """Limits of processor time (s) and memory (bytes) of a reader, by the size of its files; `own`: this version writes them."""
    size = sum(file.stat().st_size for file in files)
    return (CPU_S_OF_OWN if own else CPU_S) * max(1.0, size / 1e6), MEMORY_BYTES + MEMORY_PER_BYTE * size


def _run(arguments: list[str], limits: tuple[float, int], scratch: Path | None = None) -> subprocess.CompletedProcess[str] | str:
    """Result of a program, or the reason why there is none; readers set a lower time limit themselves once they are loaded."""
    cpu_s, memory_bytes = limits
    # also limited from outside, in case a reader hangs before it limits itself
    within = launch.limited(arguments, cpu_s=ceil(cpu_s) + _LOADED_S, memory_bytes=memory_bytes)
    try:
        run = launch.run(within, timeout_s=_TIMEOUT_S, scratch=scratch)
        return _TOO_LONG.format(cpu_s=cpu_s) if launch.too_long(run.returncode) else run
    except subprocess.TimeoutExpired:
        return f"no answer within {_TIMEOUT_S} s"
    except OSError as error:
        return str(error)


def _answer(run: subprocess.CompletedProcess[str] | str) -> dict[str, Any]:
    """The JSON printed by a reader, or ``{"error": reason}``."""
    if isinstance(run, str):
        return {"error": run}
    found = re.search(r"^ANSWER (.*)$", run.stdout, re.MULTILINE)
    if found is None:
        tail = run.stderr.strip().splitlines()[-1:] or [f"exit status {run.returncode}"]
        return {"error": f"it could not be read: {tail[0][:200]}"}
    answer: dict[str, Any] = json.loads(found[1])
    return answer


_TOO_LONG = (
    "it took more than {cpu_s:.0f} s of processor time, and kits of its size take less; do not trust it where its maker is not "
    "known; on a slow machine use verify --quick, or verify of the version that made it"
)


def _is_own(expected: Expected, paths: Mapping[str, Path]) -> bool:
    """Whether the data sections are those that this version writes."""
    return bool(expected.steps) and all(
        step_text(paths[role].read_bytes()).digest == step.digest for role, step in expected.steps.items()
    )


def _kernels(tape: Tape, expected: Expected, paths: Mapping[str, Path], cpl: CplContent | None) -> list[Check]:
    """Read STEP files that this version does not write: entities are counted first, and FreeCAD reads what passes in OCCT."""
    for role, own in expected.steps.items():
        if (problem := foreign_entities(step_text(paths[role].read_bytes()), own)) is not None:
            return [Check(name=f"{role} by CAD kernels", passed=False, message=f"not given to one: {problem}")]
    checks = _occt(tape, expected, paths, cpl)
    right = all(check.passed or check.warning for check in checks)
    return [*(_freecad(tape, expected, paths, cpl) if right else []), *checks]


# OCCT


def _occt(tape: Tape, expected: Expected, paths: Mapping[str, Path], cpl: CplContent | None) -> list[Check]:
    steps = [paths[role] for role in ("step-solid", "step-assembly") if role in paths]
    names = [str(paths.get(role, "-")) for role in ("step-solid", "step-assembly")]
    if not steps:
        return []
    if find_spec("OCP") is None:
        return [_missing("OCCT", '; pip install "tactape-fab[cad]"')]
    limits = _limits(steps, own=_is_own(expected, paths))
    code = f"from tactape_fab.verify.models.occt_reader import main; main(precise={bool(expected.steps)})"
    found = _answer(_run(launch.python_command(code, *names, *map(str, limits)), limits))
    failed = found if "error" in found else None
    checks = []
    if "step-solid" in paths:
        checks.append(_check_solid(expected, "OCCT", failed or found["solid"]))
    if "step-assembly" in paths and cpl is not None:
        checks.append(_check_occurrences(tape, failed or found["assembly"], cpl))
    return checks


def _check_solid(expected: Expected, reader: str, found: dict[str, Any]) -> Check:
    """Check that the solids are valid, have all faces of the file, and have the computed volume and centre of mass."""
    name = f"step-solid by {reader}"
    if "error" in found:
        return Check(name=name, passed=False, message=str(found["error"]))
    relative = abs(found["volume_mm3"] - expected.volume_mm3) / expected.volume_mm3
    problems = []
    if found["solids"] != expected.bodies:
        problems.append(f"{counted(found['solids'], 'solid', 'solids')} instead of {expected.bodies}")
    # a wrong shell may have the right volume and be valid, so faces and solids are counted as well
    if found["faces"] != expected.faces:
        problems.append(f"{found['faces']} faces instead of {expected.faces}")
    if not found["valid"]:
        problems.append("the solid is not valid")
    if not relative <= expected.tolerance:
        problems.append(f"volume {found['volume_mm3']:.6f} mm3 is {relative:.1e} from {expected.volume_mm3:.6f} mm3")
    if expected.centre_mm is not None and found["centre_mm"] is not None:
        off = float(np.abs(np.array(found["centre_mm"]) - expected.centre_mm).max())
        # shows a common shift of all elements, which does not change the volume
        if off > PLACE_TOLERANCE_MM / 10:
            problems.append(f"its centre of mass is {off * 1000:.3f} um from where its shape has it")
    if expected.steps:
        problems += _gap_problems(found)
    right = f"one valid solid of {expected.faces} faces, volume within {relative:.0e} of {expected.volume_mm3:.4f} mm3"
    return Check(name=name, passed=not problems, message="; ".join(problems) or right, figure=relative)


def _gap_problems(found: dict[str, Any]) -> Iterator[str]:
    """Edges or vertices away from their faces, which a kernel bridges: the solid stays valid, often of the same volume."""
    # FreeCAD's answer has no gap
    if not found.get("gap_mm", 0.0) <= _MOST_GAP_MM:
        yield f"an edge or a vertex of it is {found['gap_mm'] * 1000:.3f} um off its faces"


def _check_occurrences(tape: Tape, found: dict[str, Any], cpl: CplContent) -> Check:
    """Check that every occurrence has the place, rotation and designator of its CPL row."""
    name = "step-assembly by OCCT"
    if "error" in found:
        return Check(name=name, passed=False, message=str(found["error"]))
    rows = {shown_path(row[0]): np.array(row[1:]) for row in found["occurrences"]}
    problems = [] if len(rows) == len(found["occurrences"]) else ["two occurrences have one name"]
    missing = [d for d in (*cpl.designators, "board") if d not in rows]
    extra = sorted(set(rows) - set(cpl.designators) - {"board"})
    if missing or extra:
        problems.append(f"occurrences that differ from the CPL: {named([*missing, *extra])}")
        return Check(name=name, passed=False, message="; ".join(problems))
    placed = np.array([rows[d] for d in cpl.designators])
    # z is 0, as the part's foot is on the film
    off = np.hypot(*(placed[:, :2] - cpl.xy_mm).T) + np.abs(placed[:, 2])
    angle = np.radians(cpl.rotation_deg)
    along = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    # columns 1 and 3 of the rotation, the part's x and z axes, which determine the second
    turn = np.abs(placed[:, 3:6] - along).max(axis=1) + np.abs(placed[:, 6:9] - (0.0, 0.0, 1.0)).max(axis=1)
    worst = int(off.argmax())
    if np.abs(rows["board"] - (0, 0, 0, 1, 0, 0, 0, 0, 1)).max() > PLACE_TOLERANCE_MM:
        problems.append("the board does not lie at the origin")
    if off[worst] > PLACE_TOLERANCE_MM:
        problems.append(f"{cpl.designators[worst]} is {off[worst] * 1000:.2f} um off its CPL row")
    if turn.max() > DIRECTION_TOLERANCE:
        problems.append(f"{cpl.designators[int(turn.argmax())]} is turned otherwise than its CPL row says")
    problems += [*_product_problems(tape, found["products"]), *_gap_problems(found)]
    message = "; ".join(problems) or f"{len(placed)} occurrences as in the CPL, within {off[worst] * 1e6:.1f} nm"
    return Check(name=name, passed=not problems, message=message, figure=float(off[worst] * 1000), unit="um")


def _product_problems(tape: Tape, products: dict[str, list[list[float]]]) -> list[str]:
    """Check that the board and the one part are one solid each, with the right volume and centre of mass."""
    element = element_volume_mm3(tape.part)
    film = solid_volume_mm3(tape, SolidForm(base_mm=tape.board.thickness_mm)) - tape.part_count * element
    (length, width, height), thick = tape.part.body_mm, tape.board.thickness_mm
    expected = {
        "part": (element, (0.0, 0.0, height / 2), (-length / 2, -width / 2, 0.0), (length / 2, width / 2, height)),
        "board": (film, film_centre_mm(tape), (0.0, 0.0, -thick), (*tape.board.size_mm, 0.0)),
    }
    solids = [solids[0] for solids in products.values() if len(solids) == 1]
    if len(solids) != 2 or len(products) != 2:
        return [f"{len(products)} products with {sum(map(len, products.values()))} solids, not a board and a part of one each"]
    problems = []
    for what, (volume, centre, low, high) in expected.items():
        # identified by volume, as names of products are arbitrary
        volumes = [solid for solid in solids if np.isclose(solid[0], volume, rtol=VOLUME_TOLERANCE, atol=0.0)]
        if not volumes:
            problems.append(f"no product has the {what}'s {volume:.6f} mm3")
        elif np.abs(np.array(volumes[0][1:]) - (*centre, *low, *high)).max() > PLACE_TOLERANCE_MM / 2:
            problems.append(f"the {what}'s centre of mass or its bounds are not where its shape has them")
    return problems


# FreeCAD


def _freecad(tape: Tape, expected: Expected, paths: Mapping[str, Path], cpl: CplContent | None) -> list[Check]:
    if "step-solid" not in paths:
        return []
    program = launch.installed(launch.FREECAD)
    if program is None:
        return [_missing("FreeCAD")]
    folder = paths["step-solid"].parent
    script, answer = folder / "read.py", folder / "answer.json"
    files = {key: str(paths[role]) for key, role in (("solid", "step-solid"), ("assembly", "step-assembly")) if role in paths}
    limits = _limits(map(Path, files.values()), own=_is_own(expected, paths))
    script.write_text(_FREECAD.format(files=files, answer=str(answer), cpu_s=limits[0]), encoding="utf-8")
    run = _run([program, str(script)], limits, folder)
    try:
        found = json.loads(answer.read_bytes())
    except (OSError, ValueError):
        reason = run if isinstance(run, str) else (run.stderr.strip().splitlines()[-1:] or [f"exit status {run.returncode}"])[0]
        return [Check(name="step-solid by FreeCAD", passed=False, message=f"it could not be read: {reason[:200]}")]
    checks = [_check_solid(replace(expected, tolerance=expected.loose_tolerance), "FreeCAD", found["solid"])]
    if "assembly" in found and cpl is not None:
        checks.append(_check_centres(tape, found["assembly"]["centres"], cpl))
    return checks


def _check_centres(tape: Tape, centres: list[list[float]], cpl: CplContent) -> Check:
    """Check the parts' centres of mass, in any order, against the CPL."""
    name = "step-assembly by FreeCAD"
    rows = np.array(centres, dtype=np.float64).reshape(-1, 4)
    parts = rows[np.isclose(rows[:, 3], element_volume_mm3(tape.part), rtol=1e-6)]
    if len(parts) != len(cpl.xy_mm) or len(rows) != len(parts) + 1:
        message = f"{len(rows)} solids, {len(parts)} of them parts, where a board and {len(cpl.xy_mm)} parts should be"
        return Check(name=name, passed=False, message=message)
    row, distance = nearest(parts[:, :2], point_tree(cpl.xy_mm))
    off = distance + np.abs(parts[:, 2] - tape.part.body_mm[2] / 2)
    worst_mm = float(off.max())
    problems = [] if len(np.unique(row)) == len(row) else ["two solids are nearest to one row of the CPL"]
    if not worst_mm <= PLACE_TOLERANCE_MM:
        problems.append(f"the centre of a solid is {worst_mm * 1000:.2f} um off its CPL row")
    message = "; ".join(problems) or f"centres of {len(parts)} solids within {worst_mm * 1e6:.1f} nm of the CPL"
    return Check(name=name, passed=not problems, message=message, figure=worst_mm * 1000, unit="um")


# Meshes


def _slicer(tape: Tape, expected: Expected, paths: Mapping[str, Path], cpl: CplContent | None) -> list[Check]:
    program = launch.installed(launch.PRUSA_SLICER)
    if program is None:
        return [_missing("PrusaSlicer")]
    checks = []
    for role in ("stl", "3mf"):
        run = _run([program, "--info", str(paths[role])], _limits([paths[role]]))
        if isinstance(run, str):
            checks.append(Check(name=f"{role} by PrusaSlicer", passed=False, message=run))
            continue
        found = dict(re.findall(r"^(\w+) =\s*(\S+)", run.stdout, re.MULTILINE))
        volume = float(found.get("volume", "nan"))
        problems = [] if found.get("manifold") == "yes" else ["it is not manifold"]
        if found.get("number_of_parts") != str(expected.bodies):
            number = counted(found.get("number_of_parts", "no"), "part", "parts")
            problems.append(f"{number} instead of {expected.bodies}")
        if not abs(volume - expected.volume_mm3) <= expected.mesh_tolerance_mm3:
            problems.append(f"its volume is {volume:.3f} mm3, not {expected.volume_mm3:.3f}")
        message = "; ".join(problems) or f"manifold, {counted(expected.bodies, 'part', 'parts')}, {volume:.3f} mm3"
        checks.append(Check(name=f"{role} by PrusaSlicer", passed=not problems, message=message, figure=volume, unit="mm3"))
    return checks


def _trimesh(tape: Tape, expected: Expected, paths: Mapping[str, Path], cpl: CplContent | None) -> list[Check]:
    found = _answer(_run(launch.python_command(f"exec({_TRIMESH!r})", str(paths["stl"])), _limits([paths["stl"]])))
    if "error" in found:
        return [Check(name="stl by trimesh", passed=False, message=str(found["error"]))]
    watertight, consistent, bodies, volume = found[str(paths["stl"])]
    problems = [] if watertight else ["it is not watertight"]
    if not consistent:
        problems.append("neighbouring triangles face opposite ways")
    if bodies != expected.bodies:
        problems.append(f"{counted(bodies, 'body', 'bodies')} instead of {expected.bodies}")
    if not abs(volume - expected.volume_mm3) <= expected.mesh_tolerance_mm3:
        problems.append(f"its volume is {volume:.3f} mm3, not {expected.volume_mm3:.3f}")
    message = "; ".join(problems) or f"watertight, {counted(bodies, 'body', 'bodies')}, {volume:.3f} mm3"
    return [Check(name="stl by trimesh", passed=not problems, message=message, figure=float(volume), unit="mm3")]


_READERS: dict[str, _Reader] = {"FreeCAD": _freecad, "OCCT": _occt, "trimesh": _trimesh, "PrusaSlicer": _slicer}
"""Readers in the order in which they are started, the slowest first; its lines come last."""


def _missing(program: str, remedy: str = "") -> Check:
    """Line for a reader that is not installed, which is not a failure."""
    message = f"{program} is not installed: the models were not read with it{remedy}"
    return Check(name=program, passed=False, warning=True, skipped=True, message=message)
