"""advise: which design locates a contact of some size."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tactape_fab.base.errors import Problem, SpecError, tried
from tactape_fab.base.fields import shown_path
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.output_file import refuse_taken_place, write_file
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import SENSOR_HELP, length, number, size, workers_of, workers_option
from tactape_fab.cli.printing import echo_json, echo_lines, echo_lines_err, step_printed, step_shown, table_lines

if TYPE_CHECKING:
    from tactape_fab.advise.answer import Advice, Line
    from tactape_fab.advise.map import MapPoint
    from tactape_fab.sense import SensorProfile

_HEADER = ("W", "Δ", "part", "code", "directions", "coverlay", "contact", "error", "angle", "parts", "cost", "warnings")


@click.command()
@click.option("--contact", metavar="MM", help="Diameter of the smallest contact that is to be located. Required.")
@click.option("--sensor", metavar="NAME", help=SENSOR_HELP)
@click.option("--process", metavar="fpc|PROFILE", help="How it is made: fpc, or a process profile such as sla.  [default: fpc]")
@click.option("--fab", metavar="PROFILE", help="With fpc: fab profile, or a .toml file.  [default: generic-fpc]")
@click.option("--blur", metavar="MM", help="Standard deviation of what the gel smooths.  [default: that of the sensor, or 0.15]")
@click.option("--placement", metavar="MM", help="Standard deviation of the parts' places along each axis.  [default: 0]")
@click.option("--tapes", metavar="N", help="How many tapes will be registered.  [default: 1]")
@click.option("--size", "size_mm", metavar="WxH", help="Outline of one tape, mm.  [default: 100x50]")
@click.option("--simulate", "simulate_too", is_flag=True, help="Hold the first lines against simulated contacts.")
@click.option(
    "--map",
    "map_file",
    metavar="FILE.svg",
    help="Draw the smallest contact over W for every part and code, with parts and cost of a tape.",
)
@click.option("--overwrite", is_flag=True, help="Replace a file of the map's name.")
@workers_option("simulate contacts and draw the map", "one per processor")
@click.option("--explain", is_flag=True, help="Say what the columns are, and what the figures rest on.")
@click.option("--json", "as_json", is_flag=True, help="Print the lines as JSON.")
def advise(
    contact: str | None,
    sensor: str | None,
    process: str | None,
    fab: str | None,
    blur: str | None,
    placement: str | None,
    tapes: str | None,
    size_mm: str | None,
    simulate_too: bool,
    map_file: str | None,
    overwrite: bool,
    workers: str | None,
    explain: bool,
    as_json: bool,
) -> None:
    """Say which W, Δ and part locate a contact of some size: what the rules leave, what it locates and what it costs.

    \b
    Example: tactape-fab advise --contact 6 --sensor digit
    """
    lengths = {"contact_mm": contact, "blur_mm": blur, "placement_mm": placement}
    given = {key: length(text) for key, text in lengths.items() if text is not None}
    given |= {key: text for key, text in (("sensor", sensor), ("process", process), ("fab", fab)) if text is not None}
    given |= {} if tapes is None else {"tapes": number(tapes)}
    given |= {} if size_mm is None else {"size_mm": size(size_mm)}
    with answers():
        from tactape_fab.advise import advise as ask
        from tactape_fab.advise import checked, read_question

        problems: list[Problem] = []
        question, count = tried(lambda: read_question(given), problems), tried(lambda: workers_of(workers), problems)
        if map_file is not None:
            tried(lambda: refuse_map(Path(map_file), overwrite=overwrite), problems)
        if problems or question is None or count is None:
            raise SpecError(problems)
        advice = ask(question)
        points: Sequence[MapPoint] = ()
        if simulate_too:
            advice = checked(advice, step_printed("simulating, "), count)
        if map_file is not None:
            from tactape_fab.advise.map import map_of
            from tactape_fab.advise.map_picture import draw_map

            points = map_of(question, count, step_shown())
            write_file(Path(map_file), draw_map(advice, points), "map_file", overwrite=overwrite)
        if as_json:
            drawn = {"map": [point.to_mapping() for point in points]} if points else {}
            echo_json({**advice.to_mapping(), **drawn, **({"explained": list(_explained(advice))} if explain else {})})
        else:
            echo_lines(_advice_lines(advice))
            echo_lines([f"  {line}" for line in _explained(advice)] if explain else [])
        echo_lines_err([_verdict(advice)])


def refuse_map(path: Path, *, overwrite: bool) -> None:
    """Refuse a path for a map that is taken or does not end in .svg."""
    if path.suffix.lower() != ".svg":
        raise SpecError(Problem("map_file", f"map_file = {shown_path(path)} is drawn as SVG; give a name that ends in .svg"))
    refuse_taken_place(path, "map_file", overwrite=overwrite, ours=_is_map, kind="no map of this tool")


def _is_map(path: Path) -> bool:
    from tactape_fab.advise.map_picture import TITLE

    # the title follows the root element, which has some 200 bytes
    start = read_regular(path, 600)
    return start.startswith(b"<svg") and TITLE.encode() in start


def _advice_lines(advice: Advice) -> list[str]:
    """The recommended command first, then all lines as a table; lengths in mm, errors in µm and degrees."""
    first = advice.lines[0]
    header = [*_HEADER, *(["simulated"] if any(line.simulated for line in advice.lines) else [])]
    rows = [_row(line, advice) for line in advice.lines]
    return [first.command, "", *table_lines(header, [row[: len(header)] for row in rows])]


def _verdict(advice: Advice) -> str:
    """One line that says whether the requested contact is reached."""
    from tactape_fab.advise.answer import LOCATED

    asked, first = advice.question, advice.lines[0]
    what = f"contacts of {asked.contact_mm:g} mm under {asked.sensor.name}"
    if advice.reached:
        return f"{what}: the first line locates {LOCATED:.0%} of those from {first.least_mm:g} mm on"
    if first.least_mm is None:
        ways = [
            "a sensor with less noise",
            *(["a smaller --placement"] if asked.placement_mm else []),
            *(["--process sla"] if first.design.fab is not None else []),
        ]
        return f"{what}: nothing that {asked.making.name} makes is located at all; use {', or '.join(ways)}"
    return f"{what}: no line does; the nearest locates {LOCATED:.0%} from {first.least_mm:g} mm on"


def _row(line: Line, advice: Advice) -> tuple[str, ...]:
    design, sim = line.design, line.simulated
    body = "" if design.fab is not None else " " + "x".join(f"{side:g}" for side in design.body_mm)
    return (
        f"{design.pitch_mm:.2f}",
        f"{design.displacement_mm:.2f}",
        design.part + body,
        line.code.name,
        str(design.directions),
        design.coverlay or "-",
        "-" if line.least_mm is None else f"{line.least_mm:.1f}",
        "-" if line.error_um is None else f"{line.error_um:.0f}",
        "-" if line.angle_deg is None else f"{line.angle_deg:.2f}",
        str(line.parts),
        "-" if line.once is None else f"{line.once:.0f} + {line.each:.2f} {advice.currency}",
        " ".join(design.warnings) or "-",
        "-" if sim is None else f"{sim.located} of {sim.frames}",
    )


def _noise(sensor: SensorProfile) -> str:
    """The noise of a sensor's profile as text."""
    if sensor.slope_noise is not None:
        return f"slopes {sensor.slope_noise:g} rms a pixel, white"
    return f"{sensor.white_um:g} µm white, {sensor.correlated_um:g} µm in blobs of {sensor.correlated_px:g} px"


def _explained(advice: Advice) -> Iterator[str]:
    """Explanations of the columns and of the assumptions behind the figures, as lines."""
    from tactape_fab.advise.answer import LOCATED, contacts_by_code
    from tactape_fab.advise.model import IMPRINT_SHARE, LOSS, ROLL_OFF_MM
    from tactape_fab.kit.profiles import FabProfile

    asked = advice.question
    width_mm, height_mm = asked.size_mm
    yield f"contact: smallest round contact, mm, of which {LOCATED:.0%} are located within the field of parts, at the usual trust"
    yield f"error, angle: medians, µm and degrees, of contacts of {asked.contact_mm:g} mm, or of the smallest where that is more"
    yield f"parts: of a tape of {width_mm:g}x{height_mm:g} mm; cost: estimate of assembly, order + each tape, without the board"
    if any(not line.design.points_in.usual for line in advice.lines):
        yield "directions: eight say three bits a part, for printed and milled elements with touch-1; one decoder takes one kind"
    yield "warnings: rules that check warns of, less those of an order (part-count); what a rule refuses is not listed, nor what"
    yield "  another line beats in all"
    yield (
        f"assumed: {asked.tapes} registered {'tape' if asked.tapes == 1 else 'tapes'}, gel blur {asked.blur_mm:g} mm, parts off "
        f"by {asked.placement_mm:g} mm (--tapes, --blur, --placement), {IMPRINT_SHARE:.0%} of a part's height imprinted, rims of "
        f"{ROLL_OFF_MM:g} mm"
    )
    yield f"noise of {asked.sensor.name}: {_noise(asked.sensor)}; a part must stand out of it"
    for line in advice.lines:
        yield (
            f"W {line.design.pitch_mm:.2f} {line.design.part}: a dot stands {line.height_um:.0f} µm over its background, "
            f"the noise is {line.noise_um:.0f} µm"
        )
    yield "codes of the first line, smallest contact with the manifest, and by decode --code alone:"
    for found in contacts_by_code(advice.lines[0], asked):
        known, alone = (f"{mm:.1f} mm" if mm else "-" for mm in (found["least_contact_mm"], found["without_manifest_mm"]))
        yield f"  {found['code']}: {known}, {alone}"
    kind = "fab" if isinstance(asked.making, FabProfile) else "process"
    yield f"rules: {kind} {asked.making.name}; tactape-fab check with the options of a command says all of them"
    yield (
        f"model: the decoder's rule on imagined dots; what frames lose (tops of noise {LOSS.tops:g}, grids missed "
        f"{LOSS.scatter:g}) is borne out by python -m tests.bench.advise; --simulate asks simulated depth maps"
    )
