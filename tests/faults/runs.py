"""Commands that write, small, each in a folder that holds files of the user's, too."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.base.picture_file import write_picture
from tactape_fab.sense.overlay import write_overlay
from tactape_fab.texture.as_built import AsBuilt
from tests.faults.injected import Run, command

_SMALL = ("--sector", "100", "--size", "20x20", "--no-3d", "--no-verify")
_SPEC = TapeSpec(sector=101, size_mm=(20.0, 20.0), models=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A run, and what its folder holds before it besides the user's own files."""

    prepare: Callable[[Kit, Path], object]
    run: Run


def nothing(_: Kit, __: Path) -> None:
    pass


def a_kit(kit: Kit, folder: Path) -> None:
    shutil.copytree(kit.path, folder / "kit")


def a_kit_and_a_picture(kit: Kit, folder: Path) -> None:
    a_kit(kit, folder)
    write_picture(folder / "windows.png", np.zeros((2, 2, 3), dtype=np.uint8), "picture")


def a_part(kit: Kit, folder: Path) -> None:
    a_kit(kit, folder)
    (folder / "part.stl").write_bytes(trimesh.creation.box((30.0, 30.0, 5.0)).export(file_type="stl"))


def places(kit: Kit, folder: Path) -> None:
    a_kit(kit, folder)
    (folder / "kit" / "as-built.json").write_bytes(b"older")


def _write_places(folder: Path) -> None:
    manifest = json.loads((folder / "kit" / "manifest.json").read_bytes())
    columns = {key: [0.01] for key in ("dx_mm", "dy_mm", "rotation_deg", "sigma_mm")}
    parts = {"designator": ["R1"], "present": [True], **columns}
    content = {"format": "tactape-as-built/1", "tape": manifest["name"], "manifest_sha256": "0" * 64, "parts": parts}
    AsBuilt.from_mapping(content).write(folder / "kit")


def _draw(folder: Path) -> None:
    write_overlay(folder, np.zeros((24, 32, 3), dtype=np.uint8), 0)


CASES = {
    "make": Case(prepare=nothing, run=command("make", *_SMALL, "-o", "kit")),
    "make --overwrite": Case(prepare=a_kit, run=command("make", *_SMALL, "-o", "kit", "--overwrite")),
    "make --panel": Case(
        prepare=nothing, run=command("make", "--sector", "7", "--panel", "auto", "--size", "60x30", *_SMALL[4:], "-o", "panel")
    ),
    "emboss": Case(prepare=a_part, run=command("emboss", "kit", "part.stl", "--at", "0,0,2.5", "-o", "embossed")),
    "certify --picture": Case(prepare=a_kit, run=command("certify", "kit", "--picture", "windows.png")),
    "certify --overwrite": Case(
        prepare=a_kit_and_a_picture, run=command("certify", "kit", "--picture", "windows.png", "--overwrite")
    ),
    "simulate": Case(prepare=a_kit, run=command("simulate", "kit", "-o", "frames.npz", "--count", "1")),
    "overlay": Case(prepare=nothing, run=_draw),
    "as-built": Case(prepare=places, run=_write_places),
}


def small_kit(folder: Path) -> Kit:
    """The older kit that stands there."""
    return make_kit(_SPEC, folder / "older", verify=False)


def prepared(case: Case, kit: Kit, folder: Path) -> Path:
    """A fresh folder with what the user has, and what the run needs."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    (folder / "mine.txt").write_bytes(b"mine")
    (folder / "link").symlink_to("mine.txt")
    case.prepare(kit, folder)
    return folder
