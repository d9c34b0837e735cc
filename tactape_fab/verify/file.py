"""verify as the command line has it: the contacts that a user asks for, and the map beside the checks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactape_fab.base.errors import Problem, SpecError, tried
from tactape_fab.texture.tape import Tape
from tactape_fab.verify import Verification, read_contact, verify_kit

if TYPE_CHECKING:
    from tactape_fab.verify.trip.round_trip import Progress


def verify_file(
    kit: str,
    *,
    quick: bool = False,
    size: object = None,
    sensor: str | None = None,
    map_file: str | None = None,
    progress: Progress = lambda *_: None,
) -> Verification:
    """Verify a kit, and draw where contacts can be located on it.

    Parameters
    ----------
    kit : str
    quick : bool
        As in `verify_kit`.
    size, sensor : optional
        As in `read_contact`.
    map_file : str, optional
        PNG of the map; written where the manifest can be read, whatever the checks say.
    progress : callable
        Gets a text, how much is done, and of how much.

    Raises
    ------
    SpecError
        Every value that cannot be used, all together.
    TactapeError
        When the map cannot be written.
    """
    problems: list[Problem] = []
    given = {"--contact": size, "--sensor": sensor, "--map": map_file}
    asked = ", ".join(option for option, value in given.items() if value is not None)
    if quick and asked:
        problems.append(Problem("quick", f"--quick has its own few contacts and draws no map; leave out --quick, or {asked}"))
    contact = tried(lambda: read_contact(sensor or "gelsight-mini", size), problems)
    path = None
    if map_file is not None:
        from tactape_fab.verify.trip.map import refuse_map

        path = tried(lambda: refuse_map(kit, map_file), problems)
    if problems:
        raise SpecError(problems)
    verification = verify_kit(kit, quick=quick, contact=contact, progress=progress)
    if path is not None and contact is not None and verification.checks[0].passed:
        from tactape_fab.verify.trip.coverage import coverage_of
        from tactape_fab.verify.trip.map import draw_map, write_map

        tape = Tape.load(kit)
        if tape.surface is None:
            write_map(path, draw_map(tape, coverage_of(tape, contact, progress), contact, verification.trips))
    return verification
