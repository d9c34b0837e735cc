"""Artifact: one file of the kit as bytes, before anything is written; a large one as pieces that are made as it is written."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifact:
    """A file: its role in the manifest, its path relative to the kit's folder (with '/'), its bytes."""

    role: str
    path: str
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class LongArtifact:
    """A file that is made piece by piece, each time it is asked for: of 200,000 parts a STEP file has a gigabyte."""

    role: str
    path: str
    pieces: Callable[[], Iterable[bytes]]

    @property
    def data(self) -> bytes:
        return b"".join(self.pieces())


AnyArtifact = Artifact | LongArtifact
