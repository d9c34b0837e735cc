"""Codes without a plane: each tape's matrix of symbols is designed, and stored in its manifest."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from tactape_fab.base.errors import refuse
from tactape_fab.base.fields import Fields
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.frames import SymbolArray, symbols_to_rows
from tactape_fab.texture.touch.design import Rungs, design


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignedCode:
    """A code whose tapes are designed one by one; `texture.code.Code` documents the common attributes.

    sectors: Number of designs of each size, one per sector.
    rungs: Required distances of the designs.
    half_turns: Whether designs require larger distances at 0 and 180 degrees if the parts show a quarter turn.
    """

    name: str
    window: int
    sectors: int
    range: int
    most_points: int
    rungs: Rungs
    half_turns: bool = False
    directions: ClassVar[tuple[int, ...]] = tuple(DIRECTIONS)
    plane: ClassVar[None] = None
    sequences: ClassVar[None] = None
    proven: ClassVar[Mapping[str, int]] = {}
    another: ClassVar[str] = "another --sector"
    proven_by: ClassVar[str] = "of the digest beside them"

    def default_origin(self, sector: int) -> tuple[int, int]:
        return 0, 0

    def symbols(
        self,
        sector: int,
        origin: tuple[int, int],
        shape: tuple[int, int],
        avoid: Sequence[SymbolArray],
        directions: int,
        *,
        half_turns: bool = False,
    ) -> SymbolArray:
        """The design for a sector and shape whose patches differ from those of existing tapes."""
        return design(sector, shape, avoid, directions, rungs=self.rungs, half_turns=half_turns and self.half_turns)

    def extended(self, symbols: SymbolArray, sector: int, origin: tuple[int, int], shape: tuple[int, int]) -> SymbolArray:
        return symbols  # equal textures have equal shapes

    def texture_key(self, sector: int, origin: tuple[int, int], symbols: SymbolArray) -> tuple[Hashable, ...]:
        return self.name, sector, origin, symbols.shape, symbols.tobytes()

    def digest_entry(self, symbols: SymbolArray) -> dict[str, str]:
        return {"symbols_sha256": symbols_sha256(symbols)}

    def check_symbols(self, symbols: SymbolArray, sector: int, origin: tuple[int, int], table: Fields) -> None:
        """Refuse symbols that do not match their digest, the only proof of a designed matrix."""
        remedy = f"a tape of code '{self.name}' has the digest of its symbols"
        digest = table.text("symbols_sha256", pattern=r"[0-9a-f]{64}", remedy=remedy)
        found = symbols_sha256(symbols)
        if digest and digest != found:
            table.problem(
                "symbols_sha256",
                f"symbols_sha256 = {digest} is not that of symbols, {found}: one of them was changed; take the manifest that was "
                "made with the tape",
            )
        if origin != self.default_origin(sector):
            table.problem(
                "origin", f"origin = {list(origin)} of code '{self.name}' is not [0, 0]: its symbols are the tape's own"
            )
        refuse(table.problems)


def symbols_sha256(symbols: SymbolArray) -> str:
    """SHA-256 of a matrix of symbols: of its rows as in the manifest, in ASCII, each followed by a line feed."""
    return hashlib.sha256("".join(f"{row}\n" for row in symbols_to_rows(symbols)).encode("ascii")).hexdigest()
