"""The manifest of a panel: its kits and their places."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import Fields
from tactape_fab.texture.board import LONGEST_MM
from tactape_fab.texture.manifest import MANIFEST_NAME, PANEL_FORMAT, find_manifest, read_any_manifest

KITS_FOLDER = "tapes"
MOST_PLACED = 10_000
_KIT_PATH = rf"{KITS_FOLDER}/[A-Za-z0-9][A-Za-z0-9._-]{{0,63}}/{MANIFEST_NAME}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedTape:
    """A tape on a panel: p_panel = offset_mm + R_ccw(rotation_deg) p_board.

    manifest: Path of its kit's manifest, relative to the panel's folder.
    sha256: SHA-256 of that manifest.
    first_designator: The panel's designator of the tape's R1.
    """

    manifest: str
    sha256: str
    offset_mm: tuple[float, float]
    rotation_deg: float
    first_designator: str

    @property
    def first_number(self) -> int:
        """Number of its first part among the parts of the panel, from 1."""
        return int(self.first_designator[1:])


def is_panel(content: Mapping[str, Any]) -> bool:
    """Whether a manifest is that of a panel."""
    return content.get("format") == PANEL_FORMAT


def read_placed(table: Fields) -> tuple[PlacedTape, ...]:
    """The tapes that a panel's manifest lists; problems are collected in `table`."""
    placed = []
    for i, row in enumerate(table.rows("tapes", longest=MOST_PLACED)):
        entry = Fields(row if isinstance(row, Mapping) else {}, f"tapes[{i}].", table.problems)
        x, y = entry.numbers("offset_mm", 2, low=0.0, high=LONGEST_MM)
        placed.append(
            PlacedTape(
                manifest=entry.text("manifest", pattern=_KIT_PATH, remedy=f"give {KITS_FOLDER}/NAME/{MANIFEST_NAME}"),
                sha256=entry.text("sha256", pattern="[0-9a-f]{64}", remedy="give 64 hexadecimal digits"),
                offset_mm=(x, y),
                rotation_deg=_turn(entry),
                first_designator=entry.text("first_designator", pattern="R[1-9][0-9]{0,8}", remedy="give R and a number"),
            )
        )
    if not placed:
        table.problem("tapes", "tapes names no tape; a panel has one or more")
    if len({p.manifest for p in placed}) < len(placed):
        table.problem("tapes", "tapes names a kit twice; each stands on the panel once")
    return tuple(placed)


def _turn(entry: Fields) -> float:
    turn_deg = entry.number("rotation_deg", low=0.0, high=90.0, unit="deg", remedy="give 0 or 90")
    if 0.0 < turn_deg < 90.0:
        entry.problem("rotation_deg", f"rotation_deg = {turn_deg:g} deg is no turn of a tape on a panel; give 0 or 90")
    return turn_deg


def kits_of(path: Path) -> list[Path]:
    """Folders of a panel's kits, given its folder or manifest; the path itself alone if it is not a panel.

    Raises SpecError if it is a panel whose manifest cannot be read.
    """
    try:
        file = find_manifest(path)
        content = read_any_manifest(file)
    except SpecError:  # the error is reported when the path is read as a kit
        return [path]
    if not is_panel(content):
        return [path]
    table = Fields(content)
    placed = read_placed(table)
    if table.problems:
        raise SpecError([Problem("tape", p.message) for p in table.problems])
    return [file.parent / PurePosixPath(tape.manifest).parent for tape in placed]
