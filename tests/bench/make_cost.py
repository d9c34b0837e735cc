"""What `make` and `advise` cost, as ratios of one run: `python -m tests.bench.make_cost [--parts N]`.

Processor time of a cold `make`, with and without verification, over that of `import numpy`; and for a kit of N parts (0: none)
over that of writing as many bytes, with the peak memory of its process. All are timed with compiled modules, as an installation
has them, wherever this one keeps them, and make new folders. Then how fast a 3MF is written, and what its deflate alone takes.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from io import BytesIO
from pathlib import Path
from time import process_time
from zipfile import ZipFile

from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.triangles import _DEFLATE_LEVEL, threemf_bytes
from tests.bench.measure import large_spec, planned

_CHILD = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
"""
_WRITE = """
import sys
block = bytes(1 << 20)
with open(sys.argv[1], "wb") as stream:
    for _ in range(int(sys.argv[2]) >> 20):
        stream.write(block)
"""
RUNS = 5
ADVISE = {"advise, film": ["--contact", "6"], "advise, sla": ["--contact", "5", "--process", "sla", "--tapes", "16"]}
PARTS_OF_MESH = 10_000


def cost(command: Sequence[str], env: Mapping[str, str]) -> tuple[float, float]:
    """Processor seconds and peak MB of a command, measured from a small process: a child's peak begins with its parent's."""
    done = subprocess.run([sys.executable, "-S", "-c", _CHILD, *command], check=True, capture_output=True, text=True, env=env)
    seconds, peak_mb = map(float, done.stdout.split())
    return seconds, peak_mb


def threemf_line() -> str:
    """Rate of a 3MF, in bytes of its XML, and of its compression alone."""
    mesh, title, date = (
        texture_mesh(planned(large_spec(PARTS_OF_MESH)), SolidForm()),
        "t",
        datetime(2020, 1, 1, tzinfo=timezone.utc),
    )
    start = process_time()
    data = threemf_bytes(mesh, title, {}, date)
    whole_s = process_time() - start
    with ZipFile(BytesIO(data)) as archive:
        text = archive.read("3D/3dmodel.model")
    deflate_s = []
    for level in (_DEFLATE_LEVEL, zlib.Z_DEFAULT_COMPRESSION):
        start = process_time()
        packed = len(zlib.compress(text, level))
        deflate_s.append((process_time() - start, packed))
    mb = len(text) / 1e6
    (own_s, own), (usual_s, usual) = deflate_s
    return (
        f"3MF of {PARTS_OF_MESH} blocks: {mb:.0f} MB of XML at {mb / whole_s:.0f} MB/s; deflate alone {mb / own_s:.0f} MB/s, "
        f"at zlib's own level {mb / usual_s:.0f} MB/s for {1.0 - usual / own:.1%} fewer bytes"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.make_cost", description=__doc__)
    parser.add_argument("--parts", type=int, default=50_000, metavar="N")
    chosen = parser.parse_args()
    make = [sys.executable, "-m", "tactape_fab", "make", "--sector", "7", "--w", "1.5", "--delta", "0.25", "-o"]
    with tempfile.TemporaryDirectory() as folder:
        env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        env["PYTHONPYCACHEPREFIX"] = str(Path(folder, "modules"))

        def commands(run: int) -> dict[str, list[str]]:
            kit = str(Path(folder, f"kit-{run}"))
            numpy = [sys.executable, "-c", "import numpy"]
            advise = {name: [*make[:3], "advise", *options] for name, options in ADVISE.items()}
            return {"numpy": numpy, "make": [*make, kit], "no-verify": [*make, f"{kit}-0", "--no-verify"], **advise}

        timed = [{name: cost(command, env)[0] for name, command in commands(run).items()} for run in range(RUNS + 1)]
        runs = timed[1:]  # the first run compiled the modules
        least = {name: min(run[name] for run in runs) for name in runs[0]}
        print(f"load {os.getloadavg()[0]:.1f}; import numpy {least['numpy']:.3f} s of the processor, best of {RUNS}")
        print(f"make, cold:             {least['make'] / least['numpy']:.1f} x, {least['make']:.2f} s")
        print(f"make --no-verify, cold: {least['no-verify'] / least['numpy']:.1f} x, {least['no-verify']:.2f} s")
        for name in ADVISE:
            print(f"{name}: {least[name] / least['numpy']:.1f} x, {least[name]:.2f} s")
        print(threemf_line(), flush=True)
        if chosen.parts:
            width_mm, height_mm = large_spec(chosen.parts).size_mm
            large = ["--origin", "0,0", "--size", f"{width_mm:g}x{height_mm:g}", "--no-verify", "--force"]
            seconds, peak_mb = cost([*make, str(Path(folder, "large")), *large], env)
            size = sum(file.stat().st_size for file in Path(folder, "large").rglob("*") if file.is_file())
            written_s, _ = cost([sys.executable, "-c", _WRITE, str(Path(folder, "bytes")), str(size)], env)
            print(f"{chosen.parts} parts, --no-verify: {size / 1e6:.0f} MB, {seconds:.1f} s, {size / 1e6 / seconds:.0f} MB/s")
            print(f"                         {seconds / written_s:.1f} x writing as many bytes, peak {peak_mb:.0f} MB")


if __name__ == "__main__":
    main()
