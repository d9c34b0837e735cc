"""verify: reads a written kit back, and compares it with its manifest."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.errors import Problem, refuse, tried
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import SENSOR_HELP, contact_size, workers_of, workers_option
from tactape_fab.cli.printing import clear_step, echo_check, echo_json, echo_line, step_shown, verified_line

_STAND_IN = ("written form", "fab-zip", "job", "bom", "cpl rows", "order-notes", "fab-dxf", "fab-drawing")
"""Lines that read what the fab gets, where a kit is not made again; printed kits have none of them."""

if TYPE_CHECKING:
    from tactape_fab.base.errors import Check
    from tactape_fab.verify import Verification
    from tactape_fab.verify.verification import OnCheck


@click.command()
@click.argument("kit")
@click.option("--quick", is_flag=True, help="Leave out CAD kernels, other programs, the second tag detector; few contacts.")
@click.option(
    "--contact", metavar="AxB|pad", help="Axes of the contacts that are decoded, mm, or the whole field.  [default: 11x9]"
)
@click.option("--sensor", metavar="NAME", help=SENSOR_HELP)
@click.option("--map", "map_file", metavar="FILE.png", help="Write a picture of where contacts can be located on the tape.")
@click.option("--overwrite", is_flag=True, help="Replace a file of the map's name.")
@click.option("--reproduce", is_flag=True, help="Only make the kit again from its manifest, and compare every byte.")
@click.option("--key", metavar="PUB", help="Public key of who should have made it; nothing else is read where they did not sign.")
@workers_option("read the kits of a panel", "1")
@click.option("--json", "as_json", is_flag=True, help="Print the checks as JSON.")
def verify(
    kit: str,
    quick: bool,
    contact: str | None,
    sensor: str | None,
    map_file: str | None,
    overwrite: bool,
    reproduce: bool,
    key: str | None,
    workers: str | None,
    as_json: bool,
) -> None:
    """Read a written kit back with software that is not ours, decode contacts of the parts that it places, and make it again.

    \b
    Example: tactape-fab verify tactape-s007 --contact 6x6 --map map.png
    """
    with answers():
        on_check = (lambda _: None) if as_json else echo_check
        verification = None if key is None else _signed(kit, key, on_check)
        if verification is None or verification.passed:
            before = () if verification is None else verification.checks
            how: dict[str, Any] = {"overwrite": overwrite, "quick": quick, "reproduce": reproduce}
            verification = _verified(kit, contact, sensor, map_file, on_check, workers, **how)
            # without a key the signature comes last: a signed kit gets a warning, an unsigned one no line
            verification = replace(verification, checks=(*verification.checks, *(before or _signed(kit, None, on_check).checks)))
        clear_step()
        if as_json:
            echo_json(
                {"name": verification.name, "passed": verification.passed, "checks": [asdict(c) for c in verification.checks]}
            )
        verification.raise_if_failed()
        echo_line(verified_line(verification.checks), err=True)
        if not quick and not reproduce:
            from tactape_fab.make.reproduce import NAME

            if not all(check.passed for check in verification.checks if check.name == NAME):
                there = [name for name in _STAND_IN if any(check.name == name for check in verification.checks)]
                for_fab = f"for what the fab gets {', '.join(there)} and the places of parts stand in for it, " if there else ""
                message = "warning: the kit was NOT made again, so not every byte of it is proved; "
                rest = "for what pictures, drawing and report show nothing does; the line 'reproduced' says why, and what helps"
                echo_line(message + for_fab + rest, err=True)


def _verified(
    kit: str,
    contact: str | None,
    sensor: str | None,
    map_file: str | None,
    on_check: OnCheck,
    workers: str | None,
    *,
    overwrite: bool,
    quick: bool,
    reproduce: bool,
) -> Verification:
    """The verification of a kit; draws its map if asked for. All invalid values are refused together."""
    from tactape_fab.verify import read_contact, verify_kit

    problems: list[Problem] = []
    given = {"--contact": contact, "--sensor": sensor, "--map": map_file}
    asked = ", ".join(option for option, value in given.items() if value is not None)
    if quick and asked:
        problems.append(Problem("quick", f"--quick has its own few contacts and draws no map; leave out --quick, or {asked}"))
    if reproduce and (asked or quick):
        other = ", ".join(["--quick"] * quick + [asked] * bool(asked))
        message = f"--reproduce makes the kit again and does nothing else; leave out --reproduce, or {other}"
        problems.append(Problem("reproduce", message))
    size = None if contact is None else contact_size(contact)
    touched = tried(lambda: read_contact(sensor or DEFAULT_SENSOR, size), problems)
    count = tried(lambda: workers_of(workers, 1), problems)
    path = None
    if map_file is not None:
        from tactape_fab.verify.trip.map import refuse_map

        path = tried(lambda: refuse_map(kit, map_file, overwrite=overwrite), problems)
    refuse(problems)
    if reproduce:
        return _reproduced(kit, on_check, required=True)
    step = step_shown()

    def again() -> tuple[Check, ...]:
        if quick:
            return ()
        step("made again: kit", 0, 1)
        return _reproduced(kit, lambda _: None, required=False).checks

    verification = verify_kit(
        kit, quick=quick, contact=touched, progress=step, on_check=on_check, beside=again, workers=count or 1
    )
    if path is not None and touched is not None and verification.checks[0].passed:  # only if the manifest can be read
        from tactape_fab.verify.trip.map import map_kit

        map_kit(kit, path, touched, verification.trips, step, overwrite=overwrite)
    return verification


def _signed(kit: str, key: str | None, on_check: OnCheck) -> Verification:
    """Verification of a kit's signature, before anything else of the kit is read."""
    from tactape_fab.verify.signature import check_signed
    from tactape_fab.verify.verification import collected

    return collected(Path(kit).resolve().name, check_signed(kit, key), on_check)


def _reproduced(kit: str, on_check: OnCheck, *, required: bool) -> Verification:
    from tactape_fab.make.reproduce import reproduce_kit

    verification = reproduce_kit(kit, required=required)
    for check in verification.checks:
        on_check(check)
    return verification
