"""verify, certify, registry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.cli.exits import answers, echo_json, echo_lines, step_shown
from tactape_fab.cli.group import main
from tactape_fab.cli.options import (
    SENSOR_HELP,
    contact_size,
    size,
)
from tactape_fab.cli.printing import check_lines

if TYPE_CHECKING:
    from tactape_fab.texture.tape import Tape


@main.command()
@click.argument("kit")
@click.option("--quick", is_flag=True, help="Leave out CAD kernels, other programs, the second tag detector; few contacts.")
@click.option(
    "--contact", metavar="AxB|pad", help="Axes of the contacts that are decoded, mm, or the whole field.  [default: 11x9]"
)
@click.option("--sensor", metavar="NAME", help=SENSOR_HELP)
@click.option("--map", "map_file", metavar="FILE.png", help="Write a picture of where contacts can be located on the tape.")
@click.option("--json", "as_json", is_flag=True, help="Print the checks as JSON.")
def verify(kit: str, quick: bool, contact: str | None, sensor: str | None, map_file: str | None, as_json: bool) -> None:
    """Read a written kit back with software that is not ours, and decode contacts of the parts that it places.

    \b
    Example: tactape-fab verify tactape-s007 --contact 6x6 --map map.png
    """
    with answers():
        from tactape_fab.verify.file import verify_file

        size = None if contact is None else contact_size(contact)
        verification = verify_file(kit, quick=quick, size=size, sensor=sensor, map_file=map_file, progress=step_shown())
        if as_json:
            echo_json(
                {"name": verification.name, "passed": verification.passed, "checks": [asdict(c) for c in verification.checks]}
            )
        else:
            echo_lines(check_lines(verification.checks))
        verification.raise_if_failed()
        click.echo(f"verified: {len(verification.checks)} checks of the written files", err=True)


# What windows can tell apart


@main.command()
@click.argument("kits", nargs=-1, metavar="KITS...")
@click.option("--code", metavar="CODE", help="Without kits: the tapes of this code's sectors, as make would make them.")
@click.option("--size", "size_mm", metavar="WxH", help="Outline of the tapes of --code, mm.  [default: 100x50]")
@click.option("--picture", metavar="FILE.png", help="Write a map of the tape, or of several the distances of every two.")
@click.option("--json", "as_json", is_flag=True, help="Print the certificates as JSON.")
def certify(kits: Sequence[str], code: str | None, size_mm: str | None, picture: str | None, as_json: bool) -> None:
    """Say what every 4x4, 5x5 and 6x6 window of these tapes can tell apart: kits, manifests, or folders of kits.

    \b
    Example: tactape-fab certify tactape-s007 --picture windows.png
    """
    with answers():
        from tactape_fab.cli.certify_lines import certified_lines
        from tactape_fab.texture.certify.kits import certified

        given = {"code": code, "size_mm": None if size_mm is None else size(size_mm)}
        options = {key: value for key, value in given.items() if value is not None}
        result = certified(*tapes_to_certify(kits, options), step_shown())
        echo_json(result.to_mapping()) if as_json else echo_lines(certified_lines(result))
        if picture is not None:
            from tactape_fab.report.certify_picture import draw_certified, write_picture

            write_picture(Path(picture), draw_certified(result))


@main.command()
@click.argument("kits", nargs=-1, required=True, metavar="KITS...")
@click.option("--json", "as_json", is_flag=True, help="Print the registry as JSON.")
def registry(kits: Sequence[str], as_json: bool) -> None:
    """List tapes, their conflicts, and how far every two of them are apart: kits, manifests, or folders of kits.

    \b
    Example: tactape-fab registry tapes
    """
    with answers():
        from tactape_fab.cli.certify_lines import registry_lines
        from tactape_fab.texture.certify.kits import registry as read_registry

        result = read_registry(kits, step_shown())
        echo_json(result.to_mapping()) if as_json else echo_lines(registry_lines(result))


def tapes_to_certify(kits: Sequence[str], options: Mapping[str, Any]) -> tuple[list[Tape], tuple[str, ...]]:
    """Tapes of kits, or of a code's sectors as `make` plans them, and what each is called.

    Parameters
    ----------
    kits : sequence of path
    options : mapping
        ``code`` and ``size_mm``, where they are given.

    Raises
    ------
    SpecError
        What is wrong with any of them.
    """
    if kits and options:
        raise SpecError(Problem("code", "kits and --code or --size are given, but a kit says all of it; give either"))
    from tactape_fab.texture.registry import labels, read_registered

    if kits:
        entries = read_registered(kits)
        return [e.tape for e in entries], labels(entries)
    if "code" not in options:
        said = "--size says nothing without --code" if options else "nothing to certify is given"
        raise SpecError(Problem("code", f"{said}; name kits, or a code with --code"))
    from tactape_fab.kit.examine.code_tapes import default_tapes

    tapes = default_tapes(**options)
    return tapes, tuple(t.name for t in tapes)
