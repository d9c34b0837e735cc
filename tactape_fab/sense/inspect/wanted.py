"""The tapes to inspect: that of a kit, those of a panel with their places on it, or kits of which a scan shows one."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import Fields, shown_path
from tactape_fab.texture.as_built import manifest_digest
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.manifest import MANIFEST_NAME, find_manifest, read_any_manifest
from tactape_fab.texture.panel_manifest import is_panel, read_placed
from tactape_fab.texture.registry import read_registered, refuse_equal_names
from tactape_fab.texture.tape import Tape


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WantedTape:
    """A tape, the digest of its manifest, and its place and turn on a panel; None where it is by itself.

    The point p of its board is at offset_mm + turn @ p on the panel.
    """

    tape: Tape
    sha256: str
    offset_mm: FloatArray | None = None
    turn: FloatArray = field(default_factory=lambda: np.eye(2))


def read_wanted(kit: str | Path) -> list[WantedTape]:
    """The tapes of a kit, of a panel, or of a folder of kits.

    Raises SpecError if there is none, a tape is no film with parts, or two have one name.
    """
    entries = read_registered([kit])
    places = _places(Path(kit))
    solid = [e.tape.name for e in entries if e.tape.surface is not None or e.tape.part.shape != "block"]
    if solid:
        message = f"inspect reads scans of films with parts on them, and {', '.join(solid)} has none; name other kits"
        raise SpecError(Problem("tape", message))
    refuse_equal_names((entry.tape for entry in entries), "a file of places")
    found = []
    for entry in entries:
        file = find_manifest(entry.path)
        offset_mm, turn = places.get(file.resolve(), (None, np.eye(2)))
        found.append(WantedTape(tape=entry.tape, sha256=manifest_digest(file), offset_mm=offset_mm, turn=turn))
    return found


def _places(kit: Path) -> dict[Path, tuple[FloatArray, FloatArray]]:
    """Places and turns of a panel's kits by their manifests; empty if it is no panel."""
    file = kit / MANIFEST_NAME if kit.is_dir() else kit
    if not file.is_file():
        return {}
    content = read_any_manifest(file)
    if not is_panel(content):
        return {}
    table = Fields(content)
    placed = read_placed(table)
    if table.problems:
        raise SpecError([Problem("tape", f"{shown_path(file)}: {p.message}") for p in table.problems])
    return {(file.parent / p.manifest).resolve(): (np.array(p.offset_mm), _ccw(p.rotation_deg)) for p in placed}


def _ccw(angle_deg: float) -> FloatArray:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([(c, -s), (s, c)])
