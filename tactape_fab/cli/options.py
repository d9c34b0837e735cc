"""Options that several commands share, and conversion of their texts to values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tactape_fab.base.errors import Problem, SpecError, refuse
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.cli.printing import echo_lines_err

if TYPE_CHECKING:
    from tactape_fab.base.pool import Workers
    from tactape_fab.sense.objects.taped_object import TapedObject

F = TypeVar("F", bound=Callable[..., Any])

SENSOR_HELP = f"Sensor profile, or a .toml file.  [default: {DEFAULT_SENSOR}]"


# Texts to values. A text that cannot be read is passed on unchanged: it is reported with all other invalid values.


def number(text: str) -> Any:
    # Python's int and float accept 1_000, which is a typing error here, and digits of other scripts
    if "_" in text or not text.isascii():
        return text
    for read in (int, float):
        try:
            return read(text)
        except ValueError:
            continue
    return text


def in_unit(unit: str) -> Callable[[str], Any]:
    """Reader of a number with or without its unit, case-insensitive, such as 2N or 45 deg."""

    def read(text: str) -> Any:
        # the micro sign (U+00B5) and the Greek letter (U+03BC) look the same
        bare = text.strip().replace("µm", "um").replace("μm", "um")
        found = number(bare[: -len(unit)].rstrip() if bare.lower().endswith(unit.lower()) else bare)
        return text if isinstance(found, str) else found

    return read


length, degrees, micrometres, newtons, hertz, per_inch, kilopascals, seconds = map(
    in_unit, ("mm", "deg", "um", "N", "Hz", "dpi", "kPa", "s")
)


def lengths(text: str, separator: str) -> Any:
    return [length(item) for item in text.split(separator)]


def size(text: str) -> Any:
    parts = text.replace("×", "x").replace("X", "x")
    # "1xx2" or "x5" is not a size, and is reported as typed
    return text if "" in parts.split("x") else lengths(parts, "x")


def contact_size(text: str) -> Any:
    """Width and height of a contact, or the name of one; any other text is returned unchanged."""
    axes = size(text)
    return axes if len(axes) == 2 else text


def pair(text: str, read: Callable[[str], Any] = number) -> Any:
    return [read(item) for item in text.split(",")]


def workers_option(what: str, usual: str, *others: str) -> Callable[[F], F]:
    """Option --workers: a number of processes, or a Dask cluster."""
    text = f"Processes that {what}, or a Dask scheduler to give them to.  [default: {usual}]"
    return click.option("--workers", *others, "workers", metavar="N|tcp://HOST:PORT", help=text)


def workers_of(text: str | None, usual: Workers | None = None) -> Workers:
    """The value of --workers; by default `usual`, or one for each core.

    Raises SpecError if it is neither a number of processes nor an address.
    """
    from tactape_fab.base.pool import checked_workers

    problems: list[Problem] = []
    chosen = checked_workers(None if text is None else number(text), problems, usual=usual)
    refuse(problems)
    return chosen


# Options of commands that locate


_LOCATING_OPTIONS = (
    click.option("--tape", "kits", multiple=True, metavar="KIT...", help="Kits that can be touched, or a folder of kits."),
    click.option(
        "--as-built",
        multiple=True,
        metavar="FILE|none",
        help="Measured places of a kit's parts; none: those of the design.  [default: KIT/as-built.json]",
    ),
    click.option("--code", metavar="CODE", help="Without --tape: the code alone; it asks for many more dots."),
    click.option("--w", metavar="MM", help="Grid pitch W of --code.  [default: 1.5]"),
    click.option("--delta", metavar="MM", help="Displacement Δ of --code.  [default: W/6]"),
    click.option("--method", metavar="ml|paper", default="ml", help="How frames are located.  [default: ml]"),
    click.option("--world", metavar="open|closed", help="Whether tapes that are not named may be touched, too.  [default: open]"),
    click.option("--max-p-false", metavar="P", help="Largest chance of a wrong answer.  [default: 1e-4]"),
    click.option("--max-p-tape", metavar="P", help="Largest chance that it is no tape of ours.  [default: within --max-p-false]"),
    click.option("--fixed-scale", is_flag=True, help="Take px/mm as it is instead of refining it from the frame."),
    click.option(
        "--refine",
        metavar="dots|pixels",
        help="What poses are fitted to: dots, or the pixels too.  [default: pixels where the sensor's blur is known, else dots]",
    ),
    click.option("--object", "object_file", metavar="FILE.toml", help="The tapes of an object; answers in its frame, too."),
)
_LOCATING_TEXTS: dict[str, Callable[[str], Any]] = {
    "w": length,
    "delta": length,
    "max_p_false": number,
    "max_p_tape": number,
}


_SENSOR = click.option("--sensor", metavar="NAME|FILE.toml", default=DEFAULT_SENSOR, help=SENSOR_HELP)
SENSORS = click.option(
    "--sensor",
    "sensors",
    multiple=True,
    metavar="NAME|FILE.toml",
    help=f"Sensor profile, or a .toml file; NAME=SENSOR:SOURCE for several sensors.  [default: {DEFAULT_SENSOR}]",
)
_AFTER = 5
"""Index of the sensor's option among the others."""


def locating_options(command: F, sensor: Callable[[Any], Any] = _SENSOR) -> F:
    """Add the options of commands that locate: registry, sensor, method and limits."""
    for option in reversed((*_LOCATING_OPTIONS[:_AFTER], sensor, *_LOCATING_OPTIONS[_AFTER:])):
        command = option(command)
    return command


def locating_values(given: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a job (`sense.files.jobs.prepare`) from the texts of options; None for an option that was not given."""
    names = ("as_built", "code", "w", "delta", "method", "world", "max_p_false", "max_p_tape", "fixed_scale", "refine")
    return {n: _LOCATING_TEXTS[n](given[n]) if n in _LOCATING_TEXTS and given[n] is not None else given[n] for n in names}


def named_object(file: str | None, settings: Mapping[str, Any]) -> TapedObject | None:
    """The object of --object; prints the misfit of its tags' measured corners, and how the films lie by them.

    An object's kits give code, W and Δ: these options are refused together with --object.
    """
    if file is None:
        return None
    from tactape_fab.sense.objects.taped_object import directions_of, read_object

    bare = [f"--{name}" for name in ("code", "w", "delta") if settings.get(name) is not None]
    if bare:
        message = f"{', '.join(bare)} and --object are given, but an object's kits say all of it; give either"
        raise SpecError(Problem("object", message))
    thing = read_object(file)
    for entry in thing.tapes:
        if entry.misfit_mm is not None:
            # corners in another order fit as well: of a square all begin alike, and from behind they go round the other way
            right, out = (f"({', '.join(f'{v:.2f}' for v in (axis + 0.0).tolist())})" for axis in directions_of(entry).round(2).T)
            fit = f"{entry.tape.name} on {thing.name}: the tag's corners fit within {entry.misfit_mm:.3f} mm (rms)"
            echo_lines_err([f"{fit}; the film faces {out}, its x runs along {right}"])
    return thing
