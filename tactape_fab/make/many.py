"""Many kits: made in several processes, each by `make_kit`, and their tapes packed into panels."""

from __future__ import annotations

import os
from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import TactapeError
from tactape_fab.base.pool import LostProcessError, ProcessPool
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.examine.tape_lists import Planned
from tactape_fab.kit.output_place import Overwrite
from tactape_fab.kit.panel.packing import Packing, pack, sheet_room_mm
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.make.kit import make_examined

DEFAULT_FOLDER = "tactape-kits"


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeKit:
    """Summary of a finished kit of a list."""

    path: Path
    name: str
    sector: int
    code: str
    origin: tuple[int, int]
    columns: int
    rows: int
    parts: int
    size_mm: tuple[float, float]
    files: Mapping[str, str]
    checks: int

    def to_mapping(self) -> dict[str, Any]:
        """The kit as one entry of ``kits`` in the JSON object that `tactape-fab make --json` prints for a list."""
        return {**asdict(self), "path": str(self.path), "origin": list(self.origin), "size_mm": list(self.size_mm)}


@dataclass(frozen=True, slots=True, kw_only=True)
class FailedKit:
    """A kit of a list that was not made, and the reason."""

    path: Path
    name: str
    sector: int
    error: TactapeError


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedFilm:
    """Tapes that fit on one kind of film, packed into sheets: panels of the fab without their rails."""

    fab: FabProfile
    tapes: tuple[Planned, ...]
    packing: Packing

    @property
    def shares(self) -> list[float]:
        """Fraction of each sheet's area covered by tapes."""
        width_mm, height_mm = self.fab.panel.largest_mm
        return [float(area) / (width_mm * height_mm) for area in self.packing.tape_area_mm2()]

    def to_mapping(self) -> dict[str, Any]:
        """Sheets with the places of their tapes, in the frame of the panel: its lower left corner, rails included."""
        packing, panel = self.packing, self.fab.panel
        offsets_mm = packing.offset_mm + panel.rail_mm + panel.gap_mm
        sheets = [
            {
                "share": round(share, 6),
                "tapes": [
                    {
                        "name": self.tapes[i].spec.name,
                        "offset_mm": [round(float(v), 6) for v in offsets_mm[i]],
                        "rotation_deg": 90.0 if packing.turned[i] else 0.0,
                    }
                    for i in (packing.sheet == sheet).nonzero()[0].tolist()
                ],
            }
            for sheet, share in enumerate(self.shares)
        ]
        share = sum(self.shares) / len(sheets)
        return {"fab": self.fab.name, "panel_mm": list(panel.largest_mm), "share": round(share, 6), "panels": sheets}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Order:
    """Request to a process."""

    spec: TapeSpec
    path: Path
    overwrite: Overwrite
    verify: bool
    force: bool


def make_kits(
    tapes: Sequence[Planned],
    folder: Path,
    *,
    overwrite: Overwrite = False,
    verify: bool = True,
    force: bool = False,
    jobs: int,
) -> Generator[MadeKit | FailedKit]:
    """Make the kits of a list, each in the folder under its tape's name.

    Close the iterator to stop early: unfinished kits leave no files.

    Parameters
    ----------
    tapes : sequence of Planned
        From `list_tapes`.
    folder : Path
    overwrite : bool or "edits"
    verify, force : bool
        As for `make_kit`.
    jobs : int
        Number of processes.

    Yields
    ------
    MadeKit or FailedKit
        In the order of the list, each as soon as it is known.

    Raises
    ------
    TactapeError
        If the folder cannot be made.
    """
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TactapeError(f"{folder} cannot be made: {error.strerror or error}; use -o to name another folder") from error
    orders = [
        _Order(spec=tape.spec, path=folder / tape.spec.name, overwrite=overwrite, verify=verify, force=force) for tape in tapes
    ]
    try:
        pool = ProcessPool(min(jobs, len(orders)))
        try:
            futures = [pool.submit(_make, order, Path.cwd()) for order in orders]
            for order, future in zip(orders, futures, strict=True):
                try:
                    yield future.result()
                except LostProcessError as lost:
                    yield _lost(order, lost)
        finally:
            pool.stop()
    finally:
        for parent in missing:  # innermost first; a folder that holds a kit is kept
            with suppress(OSError):
                parent.rmdir()


def _make(order: _Order, folder: Path) -> MadeKit | FailedKit:
    """Make one kit in its own process, in the user's current folder so that relative paths are resolved there."""
    import cv2

    os.chdir(folder)
    cv2.setNumThreads(1)
    try:
        kit = make_examined(examine(order.spec), order.path, overwrite=order.overwrite, verify=order.verify, force=order.force)
    except TactapeError as error:
        return _failed(order, error)
    except Exception as error:  # the others continue
        return _failed(order, TactapeError(f"{type(error).__name__}: {error}; this should not happen, please report it"))
    tape = kit.tape
    width_mm, height_mm = tape.board.size_mm
    return MadeKit(
        path=kit.path,
        name=tape.name,
        sector=tape.sector,
        code=tape.code,
        origin=tape.origin,
        columns=tape.columns,
        rows=tape.rows,
        parts=tape.part_count,
        size_mm=(width_mm, height_mm),
        checks=len(kit.checks),
        files=kit.files,
    )


def _failed(order: _Order, error: TactapeError) -> FailedKit:
    return FailedKit(path=order.path, name=order.spec.name, sector=order.spec.sector, error=error)


def _lost(order: _Order, lost: LostProcessError) -> FailedKit:
    status = lost.exit_status
    how = f"was ended by signal {-status}" if status < 0 else f"ended with status {status}"
    return _failed(order, TactapeError(f"its process {how}; where memory is short, use fewer --jobs"))


# Packing


def pack_tapes(tapes: Sequence[Planned]) -> list[PackedFilm]:
    """Pack the tapes of a list into panels of their fabs; only tapes of one fab and one laminate share a panel."""
    kinds: dict[tuple[object, ...], list[Planned]] = {}
    for tape in tapes:
        kinds.setdefault((tape.spec.fab, tape.spec.stiffener, tape.spec.adhesive), []).append(tape)
    return [_packed_film(alike) for alike in kinds.values()]


def _packed_film(tapes: Sequence[Planned]) -> PackedFilm:
    fab = tapes[0].fab
    assert fab is not None
    packing = pack([tape.spec.size_mm for tape in tapes], sheet_room_mm(fab), fab.panel.gap_mm)
    return PackedFilm(fab=fab, tapes=tuple(tapes), packing=packing)
