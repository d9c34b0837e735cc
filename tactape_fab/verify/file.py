"""verify: a kit or a panel by its path, and as the command line has it, with contacts that a user asks for and the map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Problem, SpecError, tried
from tactape_fab.texture.manifest import MANIFEST_NAME, find_manifest, read_any_manifest
from tactape_fab.texture.panel_manifest import is_panel
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.kit import verify_folder
from tactape_fab.verify.panel import verify_panel_folder
from tactape_fab.verify.trip.round_trip import Contact, Progress, read_contact
from tactape_fab.verify.verification import Verification


def verify_kit(
    path: str | Path,
    *,
    quick: bool = False,
    contact: Contact | None = None,
    progress: Progress = lambda *_: None,
) -> Verification:
    """Verify a kit, or a panel with every kit on it, by its folder or its manifest.json.

    Parameters
    ----------
    path : str or Path
    quick : bool
        Leave out what needs a CAD kernel, another program or an extra: OCCT, FreeCAD, PrusaSlicer, the second tag detector.
        The round trip is a few contacts then.
    contact : Contact, optional
        Sensor and size of the contacts of the round trip that is not quick.
    progress : callable
        Told what is being done, how much of it is done, and of how much.

    Returns
    -------
    Verification
        Every line, also when some failed; an unreadable manifest is a failed line.

    Raises
    ------
    SpecError
        When there is no kit at `path`.
    """
    file = find_manifest(path)
    if file.name != MANIFEST_NAME:
        raise SpecError(f"{path} is no kit; give the kit's folder or its {MANIFEST_NAME}")
    if is_panel(_format_of(file)):
        return verify_panel_folder(file, quick=quick, contact=contact, progress=progress)
    return verify_folder(file, quick=quick, contact=contact, progress=progress)


def _format_of(file: Path) -> dict[str, Any]:
    """Content of a manifest; nothing where it cannot be read, which is said where it is read as a kit's."""
    try:
        return read_any_manifest(file)
    except SpecError:
        return {}


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
