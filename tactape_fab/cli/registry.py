"""registry: lists tapes, their conflicts, and their distances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

import click

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import counted, shown_path
from tactape_fab.cli.certify import proven_lines
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import workers_of, workers_option
from tactape_fab.cli.printing import echo_json, echo_lines, echo_lines_err, step_shown, table_lines

if TYPE_CHECKING:
    from tactape_fab.texture.certify.kits import Registry
    from tactape_fab.texture.tape import Tape

MOST_COLUMNS = 12
"""Most tapes for which a matrix of distances is printed; for more, the nearest tapes are printed."""
MOST_CONFLICTS = 40
_NEAREST_TAPES = 20


@click.command()
@click.argument("kits", nargs=-1, required=True, metavar="KITS...")
@workers_option("compare windows of tapes", "1")
@click.option("--json", "as_json", is_flag=True, help="Print the registry as JSON.")
@click.option("--pack", metavar="FILE", help="Write their designs to one file instead, which --tape takes.")
@click.option("--overwrite", is_flag=True, help="Replace the file of --pack.")
def registry(kits: Sequence[str], workers: str | None, as_json: bool, pack: str | None, overwrite: bool) -> None:
    """List tapes, their conflicts, and how far every two of them are apart: kits, manifests, or folders of kits.

    \b
    Example: tactape-fab registry tapes
    Example: tactape-fab registry tapes --pack tapes.registry
    """
    with answers():
        if pack is not None:
            beside = [name for name, chosen in {"--json": as_json, "--workers": workers is not None}.items() if chosen]
            if beside:
                message = "--pack writes a file and compares nothing"
                raise SpecError([Problem(name[2:], f"{name} contradicts --pack: {message}; leave out {name}") for name in beside])
            echo_lines(_packed(kits, Path(pack), overwrite))
            return
        from tactape_fab.texture.certify.kits import registry as read_registry

        result = read_registry(kits, step_shown(), workers=workers_of(workers, 1))
        echo_lines_err([f"note: {line}" for line in result.again])
        echo_json(result.to_mapping()) if as_json else echo_lines(registry_lines(result))


def _packed(kits: Sequence[str], path: Path, overwrite: bool) -> list[str]:
    """Write the packed registry of some kits; returns lines about it."""
    from tactape_fab.base.output_file import refuse_taken_place, write_file
    from tactape_fab.texture.packed import is_packed, pack
    from tactape_fab.texture.registry import read_registered, taken_once

    refuse_taken_place(path, "--pack", overwrite=overwrite, ours=is_packed, kind="no packed registry")
    entries, again = taken_once(read_registered(kits))
    echo_lines_err([f"note: {line}" for line in again])
    data = pack([entry.tape for entry in entries], [entry.fab for entry in entries])
    write_file(path, data, "--pack", overwrite=overwrite)
    count = counted(len(entries), "tape", "tapes")
    return [f"{count} in {shown_path(path)}, {len(data)} bytes; give it as --tape {quote(str(path))}"]


def registry_lines(result: Registry) -> list[str]:
    """The tapes, their conflicts, and the distance of every two, as lines."""
    names = result.names
    header = ("tape", "sector", "code", "origin", "grid", "size mm", "pitch mm", "tag", "fab")
    lines = [*table_lines(header, [_entry_row(n, e.tape, e.fab) for n, e in zip(names, result.entries, strict=True)]), ""]
    lines += [f"conflict: {c.message}" for c in result.conflicts[:MOST_CONFLICTS]]
    if len(result.conflicts) > MOST_CONFLICTS:
        kinds = sorted(Counter(c.kind for c in result.conflicts).items())
        lines.append(f"{len(result.conflicts)} conflicts: {', '.join(f'{n} of kind {kind}' for kind, n in kinds)}")
    if not result.conflicts:
        lines.append("no conflicts")
    if len(result.entries) == 1:
        return lines
    lines += ["", "least number of differing symbols of windows of two tapes, 4x4/5x5/6x6:"]
    lines += _matrix(result) if len(result.entries) <= MOST_COLUMNS else _nearest(result)
    return lines + proven_lines(result.tapes)


def _entry_row(name: str, tape: Tape, fab: str) -> tuple[str, ...]:
    width_mm, height_mm = tape.board.size_mm
    return (
        name,
        str(tape.sector),
        tape.code,
        f"{tape.origin[0]},{tape.origin[1]}",
        f"{tape.columns} x {tape.rows}",
        f"{width_mm:g} x {height_mm:g}" if tape.surface is None else "on a part",
        f"{tape.pitch_mm:g}",
        "-" if tape.tag is None else str(tape.tag.id),
        fab or "-",
    )


def _apart(result: Registry, a: int, b: int) -> str:
    return "/".join(_distance(int(w.matrix[a, b])) for w in result.across)


def _distance(value: int) -> str:
    from tactape_fab.texture.certify.pairs import BEYOND, NO_WINDOWS

    return "-" if value == NO_WINDOWS else f"{value}+" if value == BEYOND else str(value)


def _matrix(result: Registry) -> list[str]:
    names = result.names
    # the lower triangle, as the matrix is symmetric
    rows = [
        (name, *("" if b >= a else _apart(result, a, b) for b in range(len(names) - 1))) for a, name in enumerate(names) if a > 0
    ]
    return table_lines(("", *names[:-1]), rows)


def _nearest(result: Registry) -> list[str]:
    from tactape_fab.texture.certify.kits import nearest_tapes
    from tactape_fab.texture.certify.pairs import NO_WINDOWS

    names = result.names
    lines = []
    for windows in result.across:
        count = Counter(int(d) for d in windows.matrix[windows.matrix != NO_WINDOWS])
        # the matrix contains each pair twice
        distances = ", ".join(f"{_distance(d)}: {n // 2} pairs" for d, n in sorted(count.items()))
        lines.append(f"{windows.side}x{windows.side}: {distances or 'no windows'}")
    near = nearest_tapes(result.across[0], _NEAREST_TAPES)
    lines += ["", "the nearest tapes:", *(f"  {names[a]} and {names[b]}: {_apart(result, a, b)}" for a, b, _ in near)]
    return lines
