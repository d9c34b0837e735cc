"""Files that an inspection writes: as-built places, one file a tape, and the list of deviations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown_path
from tactape_fab.base.output_file import write_file
from tactape_fab.sense.inspect.complaint import complaint_csv
from tactape_fab.sense.inspect.result import Inspection


def check_output(output: Path) -> None:
    """Refuse a path that cannot take the places, before the work.

    Raises
    ------
    SpecError
        If it is no .json file in a folder that exists.
    """
    if output.suffix.lower() != ".json" or output.is_dir():
        raise SpecError(Problem("o", f"-o {shown_path(output)} is no file of places; give the name of a .json file"))
    if not output.parent.is_dir():
        raise SpecError(Problem("o", f"-o {shown_path(output)}: there is no folder {shown_path(output.parent)}; make it first"))


def output_paths(output: Path, inspections: Sequence[Inspection]) -> list[Path]:
    """The as-built file of each tape: the path itself for one tape, NAME-TAPE.json beside it for several."""
    if len(inspections) == 1:
        return [output]
    return [output.with_name(f"{output.stem}-{i.tape.name}.json") for i in inspections]


def write_outputs(paths: Sequence[Path], inspections: Sequence[Inspection]) -> list[Path]:
    """Write the places and, beside the first file, the deviations of all tapes as ...-deviations.csv.

    Raises
    ------
    TactapeError
        If a file cannot be written; what stood there is as it was.
    """
    written = [inspection.as_built().write(path) for path, inspection in zip(paths, inspections, strict=True)]
    stem = paths[0].stem if len(paths) == 1 else paths[0].stem.removesuffix(f"-{inspections[0].tape.name}")
    table = paths[0].with_name(f"{stem}-deviations.csv")
    write_file(table, complaint_csv(inspections).encode("utf-8"), "o", overwrite=True)
    return [*written, table]
