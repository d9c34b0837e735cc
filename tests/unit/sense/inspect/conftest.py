"""A tape with faults, and a scan of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactape_fab import Kit, Tape, TapeSpec, make_kit
from tests.conftest import Once
from tests.scans import Built, Picture, Scanner, assembled, scan

MISSING, TOMBSTONED, TURNED, SHIFTED = (3, 77, 150, 300), 42, 201, 111


@dataclass(frozen=True, kw_only=True)
class Scanned:
    """A kit, what was built of it, and its scan as a file."""

    kit: Path
    tape: Tape
    built: Built
    picture: Picture
    path: Path


@pytest.fixture(scope="session")
def kit_40(once: Once) -> Kit:
    """Not to be changed."""
    spec = TapeSpec(sector=7, size_mm=(40.0, 30.0), models=False)
    kit: Kit = once("forty", lambda folder: make_kit(spec, folder / "tactape-s007"))
    return kit


@pytest.fixture(scope="session")
def scanned(kit_40: Kit, once: Once) -> Scanned:
    """Everything goes wrong once; 1200 dpi. Not to be changed."""
    scanned: Scanned = once("scanned", lambda folder: _scanned(kit_40, folder))
    return scanned


def _scanned(kit_40: Kit, folder: Path) -> Scanned:
    tape = Tape.load(kit_40.path)
    sites = tape.part_xy_mm()
    between = sites[(sites < sites.max(axis=0) - 1.5).all(axis=1)] + (0.75, 0.75)
    bare = between[np.hypot(*(between[:, None] - sites[None]).transpose(2, 0, 1)).min(axis=1).argmax()]
    built = replace(assembled(tape, seed=5), specks=[(float(bare[0]), float(bare[1]), 0.16)])
    built.present[list(MISSING)] = False
    built.present[TOMBSTONED], built.tombstoned[TOMBSTONED] = False, True
    built.turn_deg[TURNED] = 35.0
    built.dx_mm[SHIFTED], built.dy_mm[SHIFTED] = 0.24, -0.05
    far = np.hypot(built.dx_mm, built.dy_mm) > 0.17
    far[SHIFTED] = False
    built.dx_mm[far], built.dy_mm[far] = 0.05, 0.05
    picture = scan(tape, built, Scanner(), seed=2)
    path = folder / "scan.png"
    write(path, picture)
    return Scanned(kit=kit_40.path, tape=tape, built=built, picture=picture, path=path)


def write(path: Path, picture: Picture, *settings: int) -> Path:
    path.write_bytes(cv2.imencode(path.suffix, picture, list(settings))[1].tobytes())
    return path
