"""Advice in words: the command to paste, the table, and where the figures come from."""

from __future__ import annotations

from collections.abc import Iterator

from tactape_fab.advise.answer import LOCATED, Advice, Line
from tactape_fab.advise.model import IMPRINT_SHARE, LOSS, ROLL_OFF_MM
from tactape_fab.cli.printing import table_lines
from tactape_fab.kit.profiles import FabProfile

HEADER = ("W", "Δ", "part", "code", "directions", "coverlay", "contact", "error", "angle", "parts", "cost", "warnings")


def advice_lines(advice: Advice) -> list[str]:
    """The recommended command first, then all lines as a table; lengths in mm, errors in µm and degrees."""
    first = advice.lines[0]
    header = [*HEADER, *(["simulated"] if any(line.simulated for line in advice.lines) else [])]
    rows = [_row(line, advice) for line in advice.lines]
    return [first.command, "", *table_lines(header, [row[: len(header)] for row in rows])]


def verdict(advice: Advice) -> str:
    """Whether the contact asked for is reached, in one line."""
    asked, first = advice.question, advice.lines[0]
    what = f"contacts of {asked.contact_mm:g} mm under {asked.sensor.name}"
    if advice.reached:
        return f"{what}: the first line locates {LOCATED:.0%} of those from {first.least_mm:g} mm on"
    if first.least_mm is None:
        return f"{what}: nothing that {asked.making.name} makes is located at all; use a sensor with less noise, or --process sla"
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
        f"{line.error_um:.0f}",
        f"{line.angle_deg:.2f}",
        str(line.parts),
        "-" if line.once is None else f"{line.once:.0f} + {line.each:.2f} {advice.currency}",
        " ".join(design.warnings) or "-",
        "-" if sim is None else f"{sim.located} of {sim.frames}",
    )


def explained(advice: Advice) -> Iterator[str]:
    """What each column is, and what the figures rest on."""
    asked = advice.question
    width_mm, height_mm = asked.size_mm
    yield f"contact: smallest round contact, mm, of which {LOCATED:.0%} are located anywhere on a tape, at the usual trust"
    yield f"error, angle: medians, µm and degrees, of contacts of {asked.contact_mm:g} mm, or of the smallest where that is more"
    yield f"parts: of a tape of {width_mm:g}x{height_mm:g} mm; cost: estimate of assembly, order + each tape, without the board"
    if any(not line.design.points_in.usual for line in advice.lines):
        yield "directions: eight say three bits a part, for printed and milled elements with touch-1; no decoder knows both kinds"
    yield "warnings: rules that check warns of; what a rule refuses is not listed, nor what another line beats in all"
    yield (
        f"assumed: {asked.tapes} registered {'tape' if asked.tapes == 1 else 'tapes'}, gel blur {asked.blur_mm:g} mm, parts off "
        f"by {asked.placement_mm:g} mm (--tapes, --blur, --placement), {IMPRINT_SHARE:.0%} of a part's height imprinted, rims of "
        f"{ROLL_OFF_MM:g} mm"
    )
    yield (
        f"noise of {asked.sensor.name}: {asked.sensor.white_um:g} µm white, {asked.sensor.correlated_um:g} µm in blobs of "
        f"{asked.sensor.correlated_px:g} px; a part must stand out of it"
    )
    for line in advice.lines:
        yield (
            f"W {line.design.pitch_mm:.2f} {line.design.part}: a dot stands {line.height_um:.0f} µm over its background, "
            f"the noise is {line.noise_um:.0f} µm"
        )
    kind = "fab" if isinstance(asked.making, FabProfile) else "process"
    yield f"rules: {kind} {asked.making.name}; tactape-fab check with the options of a command says all of them"
    yield (
        f"model: the decoder's rule on imagined dots; what frames lose (tops of noise {LOSS.tops:g}, grids missed "
        f"{LOSS.scatter:g}) is borne out by python -m tests.bench.advise; --simulate asks simulated depth maps"
    )
