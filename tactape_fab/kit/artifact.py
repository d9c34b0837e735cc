"""Artifact: one file of a kit, as bytes or, if it is large, as pieces that are generated while it is written."""

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
    """A file whose bytes are generated in pieces each time they are needed: a STEP file of 200,000 parts has a gigabyte."""

    role: str
    path: str
    pieces: Callable[[], Iterable[bytes]]

    @property
    def data(self) -> bytes:
        return b"".join(self.pieces())


AnyArtifact = Artifact | LongArtifact
