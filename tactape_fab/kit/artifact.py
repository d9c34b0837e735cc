"""Artifact: one file of the kit as bytes, before anything is written."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifact:
    """A file: its role in the manifest, its path relative to the kit's folder (with '/'), its bytes."""

    role: str
    path: str
    data: bytes
