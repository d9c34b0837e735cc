"""Files that an inspection writes: as-built places, one file a tape, and the list of deviations."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tactape_fab.base.errors import Problem, SpecError, refuse, tried
from tactape_fab.base.fields import shown_path
from tactape_fab.base.input_file import begins_with
from tactape_fab.base.output_file import refuse_taken_place, write_file
from tactape_fab.sense.inspect.result import Inspection
from tactape_fab.texture.as_built import refuse_other_kit, refuse_other_places

HEADER = "Tape,Designator,Deviation,Mid X,Mid Y,Shift X,Shift Y,Turn,Value,Limit,Unit"


def check_output(output: Path) -> None:
    """Refuse a path that cannot take the places, before the work.

    Raises SpecError if it is no .json file in a folder that exists, or holds something else than measured places.
    """
    if output.suffix.lower() != ".json":
        raise SpecError(Problem("output", f"output = {shown_path(output)} is no file of places; give the name of a .json file"))
    _refuse_other([output], _table_beside(output, output.stem))


def _table_beside(places: Path, stem: str) -> Path:
    return places.with_name(f"{stem}-deviations.csv")


def _refuse_other(places: Sequence[Path], table: Path) -> None:
    """Refuse files that are there and that no inspection wrote."""
    problems: list[Problem] = []
    for path in places:
        tried(partial(refuse_other_places, path, "output"), problems)
    if not problems:
        ours, kind = partial(begins_with, mark=HEADER), "no list of deviations, which stands beside the places"
        tried(partial(refuse_taken_place, table, "output", ours=ours, kind=kind), problems)
    refuse(problems)


def output_paths(output: Path, inspections: Sequence[Inspection]) -> list[Path]:
    """The as-built file of each tape: the path itself for one tape, NAME-TAPE.json beside it for several."""
    if len(inspections) == 1:
        return [output]
    return [output.with_name(f"{output.stem}-{i.tape.name}.json") for i in inspections]


def write_outputs(paths: Sequence[Path], inspections: Sequence[Inspection]) -> list[Path]:
    """Write the places and, beside the first file, the deviations of all tapes as ...-deviations.csv.

    Raises SpecError if a file is there that no inspection wrote, or it is in another kit; nothing is written then.
    Raises TactapeError if a file cannot be written; an older file is left unchanged.
    """
    stem = paths[0].stem if len(paths) == 1 else paths[0].stem.removesuffix(f"-{inspections[0].tape.name}")
    table = _table_beside(paths[0], stem)
    _refuse_other(paths, table)
    for path, inspection in zip(paths, inspections, strict=True):
        refuse_other_kit(path, inspection.manifest_sha256, "output")
    written = [inspection.as_built().write(path) for path, inspection in zip(paths, inspections, strict=True)]
    write_file(table, complaint_csv(inspections).encode("utf-8"), "o", overwrite=True)
    return [*written, table]


def complaint_csv(inspections: Sequence[Inspection]) -> str:
    """Rows of all tapes: nominal places and shifts in mm (board frame), turns in degrees counter-clockwise."""
    lines = [HEADER]
    for inspection in inspections:
        number = {name: i for i, name in enumerate(inspection.tape.designators())}
        for d in inspection.deviations():
            i = number.get(d.designator)
            measured = ["", "", ""]
            if i is not None and inspection.present[i]:
                dx, dy = inspection.shift_mm[i]
                measured = [f"{dx:.4f}", f"{dy:.4f}", f"{inspection.turn_deg[i]:.2f}"]
            value = "" if d.value is None else f"{d.value:.4f}"
            limit = "" if d.limit is None else f"{d.limit:g}"
            cells = [inspection.tape.name, d.designator, d.kind, f"{d.at_mm[0]:.4f}", f"{d.at_mm[1]:.4f}", *measured]
            lines.append(",".join([*cells, value, limit, d.unit]))
    return "\n".join(lines) + "\n"
