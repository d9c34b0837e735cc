"""inspect: measures the places of a tape's parts in scans."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tactape_fab.base.errors import Problem, SpecError, tried
from tactape_fab.cli.exits import VERIFICATION, answers, fail
from tactape_fab.cli.options import degrees, length, per_inch
from tactape_fab.cli.printing import counted, echo_json, echo_lines, echo_lines_err, step_shown, table_lines

if TYPE_CHECKING:
    from tactape_fab.sense.inspect.result import Inspection

MOST_SHOWN = 40
"""Most deviations that are printed; the CSV and the JSON have all."""


@click.command()
@click.argument("scans", nargs=-1, metavar="SCAN...")
@click.option("--tape", "kit", metavar="KIT", help="Kit of the tape, panel, or folder of kits of which the scans show one.")
@click.option("--dpi", metavar="N", help="Nominal resolution, where neither the file nor a tag says it.")
@click.option(
    "--photo", is_flag=True, help="The images are photographs: take out that parts are seen farther out than their lands."
)
@click.option("--tolerance", metavar="MM", help="Largest shift of a part that is not listed.  [default: 0.2]")
@click.option("--turn-tolerance", metavar="DEG", help="Largest turn of a part that is not listed.  [default: 10]")
@click.option(
    "-o", "output", metavar="AS-BUILT.json", help="Where the measured places go; the list of deviations beside it as CSV."
)
@click.option("--picture", metavar="DIR", help="Write pictures: every deviation enlarged, and a map of all shifts.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def inspect(
    scans: Sequence[str],
    kit: str | None,
    dpi: str | None,
    photo: bool,
    tolerance: str | None,
    turn_tolerance: str | None,
    output: str | None,
    picture: str | None,
    as_json: bool,
) -> None:
    """Measure where the parts of a made tape are, from flatbed scans or photographs from above: TIFF, PNG, JPEG, 600 to 4800 dpi.

    Several images may overlap and lie at any turn. Lists parts that are missing, tombstoned, turned or shifted, and foreign
    objects; the exit status is 4 if there are any.

    \b
    Example: tactape-fab inspect scan.png --tape tactape-s007 -o tactape-s007/as-built.json --picture deviations
    """
    with answers():
        if kit is None or output is None or not scans:
            given = {"SCAN": bool(scans), "--tape": kit is not None, "-o": output is not None}
            raise SpecError(
                [Problem(key, f"{key} is missing; see tactape-fab inspect --help") for key, has in given.items() if not has]
            )

        from tactape_fab.base.picture_file import refuse_pictures
        from tactape_fab.sense.inspect.inspection import inspect_with_views
        from tactape_fab.sense.inspect.outputs import check_output, output_paths, write_outputs
        from tactape_fab.sense.inspect.pictures import picture_names, write_pictures

        problems: list[Problem] = []
        tried(lambda: check_output(Path(output)), problems)
        if picture is not None:
            tried(lambda: refuse_pictures(Path(picture), [], "picture"), problems)
        options = {
            "dpi": None if dpi is None else per_inch(dpi),
            "tolerance_mm": None if tolerance is None else length(tolerance),
            "turn_tolerance_deg": None if turn_tolerance is None else degrees(turn_tolerance),
        }
        found = inspect_with_views(
            scans,
            kit,
            photo=photo,
            progress=step_shown(),
            refused=problems,
            **{k: v for k, v in options.items() if v is not None},
        )
        if picture is not None:
            names = [name for inspection in found.inspections for name in picture_names(inspection)]
            refuse_pictures(Path(picture), names, "picture")  # before any file is written
        written = write_outputs(output_paths(Path(output), found.inspections), found.inspections)
        for inspection, views in zip(found.inspections, found.views, strict=True):
            if picture is not None:
                written += write_pictures(Path(picture), inspection, views)
        if as_json:
            echo_json([inspection.to_mapping() for inspection in found.inspections])
        else:
            for inspection in found.inspections:
                echo_lines(inspection_lines(inspection))
        echo_lines_err([f"written: {path}" for path in written])
        count = sum(len(inspection.deviations()) for inspection in found.inspections)
        if count:
            fail(VERIFICATION, [f"{counted(count, 'deviation')} beyond the tolerances"])


def inspection_lines(inspection: Inspection) -> list[str]:
    """Summary of a tape, then its deviations as a table."""
    tape, present = inspection.tape, int(inspection.present.sum())
    mean, scatter = inspection.mean_shift_mm, inspection.scatter_mm
    found = inspection.deviations()
    lines = [
        f"{tape.name}: {present} of {tape.part_count} parts are in place, {counted(len(found), 'deviation')}",
        f"scatter of the places {1000 * scatter[0]:.1f} and {1000 * scatter[1]:.1f} um along x and y, "
        f"mean shift against the lands {1000 * mean[0]:.1f} and {1000 * mean[1]:.1f} um",
    ]
    for scan in inspection.scans:
        # px/mm to dots per inch
        u, v = (25.4 * s for s in scan.px_per_mm)
        if scan.growth is not None:
            lines.append(
                f"{scan.name}: a photograph; the mean shift, and that parts are seen {1e6 * scan.growth:.0f} um a metre "
                "farther out than their lands, are taken for parallax"
            )
        lines.append(
            f"{scan.name}: found by its {scan.found_by}; {u:.1f} and {v:.1f} dpi along board x and y, skew {scan.shear:+.5f}, "
            f"jitter of lines {scan.jitter_um:.1f} um; film and scanner are not told apart"
        )
    if found:
        rows = [
            (
                d.designator or "-",
                d.kind,
                f"{d.at_mm[0]:.2f}, {d.at_mm[1]:.2f}",
                "" if d.value is None else f"{d.value:.3f} {d.unit}",
                "" if d.limit is None else f"{d.limit:g} {d.unit}",
            )
            for d in found[:MOST_SHOWN]
        ]
        lines += table_lines(("part", "deviation", "at x, y mm", "measured", "limit"), rows)
        if len(found) > MOST_SHOWN:
            lines.append(f"and {len(found) - MOST_SHOWN} more, in the CSV")
    return lines
