"""Files that an inspection writes: as-built places, one file a tape, and the list of deviations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown_path
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.output_file import write_file
from tactape_fab.sense.inspect.complaint import HEADER, complaint_csv
from tactape_fab.sense.inspect.result import Inspection
from tactape_fab.texture.as_built import AsBuilt


def check_output(output: Path) -> None:
    """Refuse a path that cannot take the places, before the work.

    Raises SpecError if it is no .json file in a folder that exists, or holds something else than measured places.
    """
    if output.suffix.lower() != ".json" or output.is_dir():
        raise SpecError(Problem("o", f"-o {shown_path(output)} is no file of places; give the name of a .json file"))
    if not output.parent.is_dir():
        raise SpecError(Problem("o", f"-o {shown_path(output)}: there is no folder {shown_path(output.parent)}; make it first"))
    _refuse_other([output], _table_beside(output, output.stem))


def _table_beside(places: Path, stem: str) -> Path:
    return places.with_name(f"{stem}-deviations.csv")


def _refuse_other(places: Sequence[Path], table: Path) -> None:
    """Refuse files that are there and that no inspection wrote."""
    problems = []
    for path in (path for path in places if path.exists() or path.is_symlink()):
        try:
            AsBuilt.load(path)
        except SpecError:
            problems.append(Problem("o", f"-o {shown_path(path)} is there and holds no measured places; use another name"))
    if table.exists() or table.is_symlink():
        try:
            ours = read_regular(table, len(HEADER))[: len(HEADER)] == HEADER.encode("ascii")
        except OSError:
            ours = False
        if not ours:
            problems.append(Problem("o", f"{shown_path(table)} is there and holds no deviations; use another name for -o"))
    if problems:
        raise SpecError(problems)


def output_paths(output: Path, inspections: Sequence[Inspection]) -> list[Path]:
    """The as-built file of each tape: the path itself for one tape, NAME-TAPE.json beside it for several."""
    if len(inspections) == 1:
        return [output]
    return [output.with_name(f"{output.stem}-{i.tape.name}.json") for i in inspections]


def write_outputs(paths: Sequence[Path], inspections: Sequence[Inspection]) -> list[Path]:
    """Write the places and, beside the first file, the deviations of all tapes as ...-deviations.csv.

    Raises SpecError if a file is there that no inspection wrote; nothing is written then.
    Raises TactapeError if a file cannot be written; an older file is left unchanged.
    """
    stem = paths[0].stem if len(paths) == 1 else paths[0].stem.removesuffix(f"-{inspections[0].tape.name}")
    table = _table_beside(paths[0], stem)
    _refuse_other(paths, table)
    written = [inspection.as_built().write(path) for path, inspection in zip(paths, inspections, strict=True)]
    write_file(table, complaint_csv(inspections).encode("utf-8"), "o", overwrite=True)
    return [*written, table]
