"""Lists of kits, made in several processes, and packing of their tapes into panels."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import partial
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tactape_fab.base.build_date import build_date, dated
from tactape_fab.base.errors import Finding, LostProcessError, Problem, SpecError, TactapeError, reason_of, refuse, tried
from tactape_fab.base.fields import shown
from tactape_fab.base.given_path import as_path
from tactape_fab.base.pool import Workers, checked_workers, mapped
from tactape_fab.kit.examine.order import ExaminedPanel
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.examine.tape_lists import Planned
from tactape_fab.kit.output_place import Overwrite, refuse_taken
from tactape_fab.kit.panel.geometry import Panel
from tactape_fab.kit.panel.packing import PackedPanel, pack_panels
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.make.kit import make_examined, refuse_wrong_how
from tactape_fab.make.panel import PanelKit, make_panel
from tactape_fab.texture.manifest import MANIFEST_NAME

if TYPE_CHECKING:
    from tactape_fab.verify.signature import Signer

DEFAULT_FOLDER = "tactape-kits"
_SHARED = "work in a folder that all machines of the cluster share under one path"


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeKit:
    """Summary of a finished kit of a list; `findings` are the design rules that it does not meet."""

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
    findings: tuple[Finding, ...]

    def to_mapping(self) -> dict[str, Any]:
        """The kit as one entry of ``kits`` in the JSON object that `tactape-fab make --json` prints for a list."""
        content = {**asdict(self), "path": str(self.path), "origin": list(self.origin), "size_mm": list(self.size_mm)}
        del content["findings"]
        return content


@dataclass(frozen=True, slots=True, kw_only=True)
class FailedKit:
    """A kit of a list that was not made, and the reason."""

    path: Path
    name: str
    sector: int
    error: TactapeError


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedFilm:
    """Tapes of one fab, part and laminate, packed into panels, and the panels' names."""

    fab: FabProfile
    tapes: tuple[Planned, ...]
    panels: tuple[PackedPanel, ...]
    names: tuple[str, ...]

    @property
    def shares(self) -> list[float]:
        """Fraction of each panel's area covered by tapes."""
        return [sum(prod(p.size_mm) for p in panel.panel.places) / prod(panel.panel.size_mm) for panel in self.panels]

    def to_mapping(self) -> dict[str, Any]:
        """Panels with the places of their tapes, in the panel's frame: origin at its lower left corner, rails included."""
        panels = [
            {
                "name": name,
                "size_mm": list(packed.panel.size_mm),
                "share": round(share, 6),
                "tapes": [
                    {
                        "name": self.tapes[i].spec.name,
                        "offset_mm": [round(v, 6) for v in place.offset_mm],
                        "rotation_deg": place.rotation_deg,
                    }
                    for i, place in zip(packed.tapes, packed.panel.places, strict=True)
                ],
            }
            for name, packed, share in zip(self.names, self.panels, self.shares, strict=True)
        ]
        share = sum(self.shares) / len(panels)
        return {"fab": self.fab.name, "share": round(share, 6), "panels": panels}


@dataclass(frozen=True, slots=True, kw_only=True)
class Ordered:
    """A kit or panel for a worker to make: the tapes' specs, and the settings."""

    name: str
    specs: tuple[TapeSpec, ...]
    path: Path
    how: Mapping[str, Any]
    panel: Panel | None = None

    def settings(self, again: bool) -> dict[str, Any]:
        """Arguments for making it; with `again` it may replace its equal, which a process that died may have left."""
        return {**self.how, "overwrite": self.how["overwrite"] or ("same" if again else False)}


Result = TypeVar("Result")


def make_kits(
    tapes: Sequence[Planned],
    folder: Path,
    *,
    overwrite: Overwrite = False,
    verify: bool = True,
    force: bool = False,
    signer: Signer | None = None,
    workers: Workers,
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
    signer : Signer, optional
        As for `make_kit`.
    workers : int or str
        Number of processes, or the address of a Dask scheduler whose workers see the same folders.

    Yields
    ------
    MadeKit or FailedKit
        In the order of the list, each as soon as it is known.

    Raises
    ------
    TactapeError
        If the folder cannot be made.
    """
    folder = as_path(folder, "folder", "the folder for the kits")
    of_workers: list[Problem] = []
    workers = checked_workers(workers, of_workers)
    refuse(of_workers)
    if not isinstance(tapes, Sequence) or not all(isinstance(tape, Planned) for tape in tapes):
        raise SpecError(Problem("tapes", f"tapes = {shown(tapes)} is no list of planned tapes; give list_tapes(...).tapes"))
    refuse_wrong_how(verify=verify, force=force, signer=signer)
    orders = [
        Ordered(
            name=tape.spec.name,
            specs=(tape.spec,),
            path=folder / tape.spec.name,
            how={"overwrite": overwrite, "verify": verify, "force": force, "signer": signer},
        )
        for tape in tapes
    ]
    with _made_folder(folder):
        yield from _in_processes(_make_kit, orders, workers)


@contextmanager
def _made_folder(folder: Path) -> Generator[None]:
    """Context manager: makes the folder of a list; new folders that are empty at the end are removed."""
    # before mkdir: these folders are new
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TactapeError(f"{folder} cannot be made: {reason_of(error)}; use -o to name another folder") from error
    try:
        yield
    finally:
        for parent in missing:  # innermost first; a folder that contains a kit is kept
            with suppress(OSError):
                parent.rmdir()


def _in_processes(
    make: Callable[[Ordered, bool], Result], orders: Sequence[Ordered], workers: Workers
) -> Generator[Result | FailedKit]:
    """Results in the order of `orders`, each as soon as it is known."""
    # a worker of a cluster has an environment of its own
    answered = partial(_answered, make, Path.cwd(), build_date(), time.time())
    results = mapped(answered, orders, workers, lost=_lost, isolated=True)
    with closing(results):
        for order, result in zip(orders, results, strict=True):
            # a worker of a cluster may have written on a disk of its own
            there = isinstance(result, FailedKit) or order.path.is_dir()
            yield result if there else _failed(order, TactapeError(f"{order.path} was made on another disk; {_SHARED}"))


def _answered(
    make: Callable[[Ordered, bool], Result], folder: Path, date: datetime, since: float, order: Ordered
) -> Result | FailedKit:
    """Make one order in a worker with the user's build date and current folder, in which relative paths are resolved."""
    import cv2

    # the workers use all cores, so that OpenCV's threads would only compete with them
    cv2.setNumThreads(1)
    try:
        os.chdir(folder)
    except OSError:
        return _failed(order, TactapeError(f"a worker does not see {folder}; {_SHARED}"))
    try:
        with dated(date):
            return make(order, _stands(order.path, since))
    except TactapeError as error:
        return _failed(order, error)
    except Exception as error:  # the others continue
        return _failed(order, TactapeError(f"{type(error).__name__}: {error}; this should not happen, please report it"))


def _stands(path: Path, since: float) -> bool:
    """Whether a kit was made since: by a process of this run that died before it could answer, or by another run."""
    try:
        # an older kit was refused
        return (path / MANIFEST_NAME).stat().st_mtime >= since
    except OSError:
        return False


def _make_kit(order: Ordered, again: bool) -> MadeKit:
    kit = make_examined(examine(order.specs[0]), order.path, **order.settings(again))
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
        findings=tuple(finding for finding in kit.findings if not finding.passed),
    )


def _failed(order: Ordered, error: TactapeError) -> FailedKit:
    return FailedKit(path=order.path, name=order.name, sector=order.specs[0].sector, error=error)


def _lost(order: Ordered, lost: LostProcessError) -> FailedKit:
    return _failed(order, TactapeError(f"its process {lost}, twice; where memory is short, use fewer --workers"))


# Packing


def pack_tapes(tapes: Sequence[Planned]) -> list[PackedFilm]:
    """Pack the tapes of a list into panels; only tapes of one fab, part and laminate share a panel."""
    kinds: dict[tuple[object, ...], list[Planned]] = {}
    for tape in tapes:
        spec = tape.spec
        own = (spec.part, spec.rotation_deg, spec.assembly, spec.part_number, spec.x2)
        kinds.setdefault((spec.fab, spec.stiffener, spec.adhesive, *own), []).append(tape)
    films, number = [], 0
    for alike in kinds.values():
        fab = alike[0].fab
        assert fab is not None
        _, panels = pack_panels([(tape.spec.size_mm, tape.spec.corner_radius_mm) for tape in alike], fab)
        names = tuple(f"tactape-panel-{number + i}" for i in range(1, len(panels) + 1))
        films.append(PackedFilm(fab=fab, tapes=tuple(alike), panels=tuple(panels), names=names))
        number += len(panels)
    return films


def make_packed(
    films: Sequence[PackedFilm],
    folder: Path,
    *,
    overwrite: Overwrite = False,
    verify: bool = True,
    force: bool = False,
    signer: Signer | None = None,
    workers: Workers,
) -> Generator[PanelKit | FailedKit]:
    """Make packed panels with all their kits, each in the folder under its name; arguments as for `make_kits`.

    Raises SpecError if the path of a panel is taken; nothing is made then.
    """
    how = {"overwrite": overwrite, "verify": verify, "force": force, "signer": signer}
    orders = [
        Ordered(
            name=name,
            panel=packed.panel,
            specs=tuple(film.tapes[i].spec for i in packed.tapes),
            path=folder / name,
            how=how,
        )
        for film in films
        for name, packed in zip(film.names, film.panels, strict=True)
    ]
    problems: list[Problem] = []
    for order in orders:
        tried(lambda path=order.path: refuse_taken(path, overwrite=overwrite), problems)  # type: ignore[misc]
    refuse(problems)
    with _made_folder(folder):
        yield from _in_processes(_make_panel, orders, workers)


def _make_panel(order: Ordered, again: bool) -> PanelKit:
    assert order.panel is not None
    tapes = tuple(examine(spec) for spec in order.specs)
    examined = ExaminedPanel(name=order.name, tapes=tapes, panel=order.panel, remarks=())
    return make_panel(examined, order.path, **order.settings(again))
