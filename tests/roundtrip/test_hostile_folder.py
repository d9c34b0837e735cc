"""Commands that are started in an untrusted kit run nothing that lies in it.

Python puts the current folder first on the search path of `-c` and `-m`; numba reads settings there; some programs load modules
from where they stand. The kit of these tests holds a module for each name that any of them might import: one that is imported
leaves a mark.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from tactape_fab import Kit, TapeSpec, make_kit
from tests.thorough import thorough

NAMES = (
    *("json", "re", "os", "io", "abc", "typing", "pathlib", "tempfile", "subprocess", "multiprocessing", "threading", "signal"),
    *("pickle", "struct", "random", "logging", "dataclasses", "collections", "functools", "argparse", "inspect", "shutil"),
    *("zipfile", "hashlib", "warnings", "site", "sitecustomize", "usercustomize", "encodings", "codecs", "locale", "copy"),
    *("numpy", "numba", "llvmlite", "scipy", "shapely", "trimesh", "build123d", "OCP", "manifold3d", "cv2", "click", "jinja2"),
    *("gerbonara", "yaml", "Part", "FreeCAD", "tactape_fab", "resource", "xml", "pyexpat", "ctypes", "cryptography", "reportlab"),
    *("FreeCADInit", "InitGui", "importlib", "runpy", "csv", "string", "queue", "concurrent", "secrets", "datetime", "math"),
)
HARDEST = ("verify .", "doctor")
"""Commands that start every other program, or look for all: with the current folder on the path they run nothing of it either."""
COMMANDS = (
    "check --sector 3 --size 20x20",
    "make --sectors 1,2 --size 20x20 --no-3d --jobs 2 -o made",
    "make --sectors 3,4 --size 40x60 --no-3d --panel 2x1 --sign shop -o panel",
    "verify panel --key shop.pub --quick",
    "verify . --reproduce",
    "certify .",
    "registry .",
    "simulate . -o frames.npz --count 2",
    "decode frames.npz --tape .",
    "watch frames.npz --tape . --rate max --json",
    "survey frames.npz --tape . -o places.json",
    "calibrate frames.npz --tape . -o sensor.toml",
    "inspect scan.png --tape . -o places.json",
    "profiles",
    "advise --contact 6",
    "emboss . plate.stl -o embossed",
)
TOO_LITTLE = ("survey", "calibrate", "inspect")
"""Commands that refuse two frames, or a scan of nothing, after they have read it."""
PLATE = """solid plate
{}endsolid plate
"""


def plate_stl() -> str:
    """A plate of 60 x 60 x 5 mm around the origin, its top at z = 0, as twelve triangles."""
    x = [(-30, -30, -5), (30, -30, -5), (30, 30, -5), (-30, 30, -5), (-30, -30, 0), (30, -30, 0), (30, 30, 0), (-30, 30, 0)]
    quads = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join("vertex {} {} {}\n".format(*x[i]) for i in t) + "endloop\nendfacet\n"
        for t in triangles
    )
    return PLATE.format(facets)


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    """A kit with a module of every name beside its files, as packages and as files."""
    folder = tmp_path_factory.mktemp("stranger")
    kit = make_kit(TapeSpec(sector=9, part="block", size_mm=(20.0, 20.0), tag="none"), folder / "kit")
    (kit.path / "plate.stl").write_text(plate_stl(), encoding="ascii")
    noise = np.random.default_rng(1).integers(0, 255, (400, 400, 3)).astype(np.uint8)
    (kit.path / "scan.png").write_bytes(cv2.imencode(".png", noise)[1].tobytes())
    shop = Ed25519PrivateKey.from_private_bytes(b"s" * 32)
    encoding, none = serialization.Encoding.PEM, serialization.NoEncryption()
    (kit.path / "shop").write_bytes(shop.private_bytes(encoding, serialization.PrivateFormat.PKCS8, none))
    public = shop.public_key().public_bytes(encoding, serialization.PublicFormat.SubjectPublicKeyInfo)
    (kit.path / "shop.pub").write_bytes(public)
    for name in NAMES:
        mark = f"import sys\nopen({str(folder / 'ran')!r}, 'a').write({name!r} + ' ' + repr(sys.argv) + chr(10))\n"
        (kit.path / f"{name}.py").write_text(mark, encoding="utf-8")
    (kit.path / ".numba_config.yaml").write_text("disable_jit: 1\ncache_dir: cache\n", encoding="ascii")
    for program in ("freecadcmd", "FreeCADCmd", "prusa-slicer", "node"):
        script = kit.path / program
        script.write_text(f"#!/bin/sh\necho {program} >> {folder / 'ran'}\n", encoding="ascii")
        script.chmod(0o755)
    return kit


def tactape_fab() -> str:
    """The command of this environment."""
    found = shutil.which("tactape-fab", path=str(Path(sys.executable).parent))
    assert found is not None
    return found


@pytest.mark.parametrize("search", [thorough("absolute"), "with the current folder"])
def test_nothing_that_lies_in_the_folder_is_run(hostile: Kit, search: str) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    if search == "with the current folder":
        environment["PATH"] = os.pathsep.join((".", "", environment["PATH"]))
    for command in COMMANDS if search == "absolute" else HARDEST:
        argv = [tactape_fab(), *command.split()]
        allowed = (0, 2, 4) if command.startswith(TOO_LITTLE) else (0, 4)
        run = subprocess.run(argv, cwd=hostile.path, env=environment, capture_output=True, encoding="utf-8", check=False)
        ran = hostile.path.parent / "ran"
        assert not ran.exists(), f"{command} ran {ran.read_text()}"
        assert "Traceback" not in run.stderr and run.returncode in allowed, f"{command}: {run.stderr}"
    assert not (hostile.path / "cache").exists()
