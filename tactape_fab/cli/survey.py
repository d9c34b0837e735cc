"""survey: measures the places of a tape's parts in frames of its use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import SENSOR_HELP, number, workers_option
from tactape_fab.cli.printing import counted, echo_json, echo_lines, echo_lines_err, step_shown

if TYPE_CHECKING:
    from tactape_fab.sense.survey.survey import Survey


@click.command()
@click.argument("frames", nargs=-1, metavar="FRAMES...")
@click.option("--tape", "kit", metavar="KIT", required=True, help="The kit of the tape that was touched.")
@click.option("--sensor", metavar="NAME|FILE.toml", default=DEFAULT_SENSOR, help=SENSOR_HELP)
@click.option("--poses", metavar="POSES.csv", help="Poses of the robot's flange, as for calibrate --hand-eye.")
@click.option("--hand-eye", metavar="FILE.json", help="With --poses: where the sensor is on the flange, as calibrate wrote it.")
@click.option("--from", "inspected", metavar="AS-BUILT.json", help="Measured places to start from: an inspection, or a survey.")
@click.option("-o", "--output", metavar="AS-BUILT.json", required=True, help="File of the measured places, or the kit's folder.")
@workers_option("locate frames", "1")
@click.option("--json", "as_json", is_flag=True, help="Print the figures as JSON.")
def survey(
    frames: Sequence[str],
    kit: str,
    sensor: str,
    poses: str | None,
    hand_eye: str | None,
    inspected: str | None,
    output: str,
    workers: str | None,
    as_json: bool,
) -> None:
    """Measure where the parts of a tape stand, from many frames of its use.

    \b
    Example: tactape-fab survey frames.npz --tape tactape-s007 -o tactape-s007/as-built.json
    """
    with answers():
        from tactape_fab.sense.survey.survey import survey_files

        found = survey_files(
            frames,
            kit,
            sensor=sensor,
            poses=poses,
            hand_eye=hand_eye,
            inspected=inspected,
            output=output,
            progress=step_shown(),
            workers=None if workers is None else number(workers),
        )
        path = found.as_built.write(output)
        if found.posed is not None and found.posed < found.contacts:
            echo_lines_err([posed_line(found.posed, found.contacts)])
        echo_json(found.to_mapping()) if as_json else echo_lines([*survey_lines(found), f"written: {path}"])


def posed_line(posed: int, contacts: int) -> str:
    """The note that only some contacts have a pose."""
    from tactape_fab.sense.survey.adjust import LEAST_POSES

    line = f"note: --poses: {posed} of {counted(contacts, 'contact')} have a pose; the others are placed by their dots alone"
    return (
        line
        if posed >= LEAST_POSES
        else f"{line}, and stretch and bend of the whole tape are not found: that takes {LEAST_POSES}"
    )


def survey_lines(found: Survey) -> list[str]:
    """The result of a survey as lines."""
    facts = found.to_mapping()
    return [
        f"{facts['tape']}: {facts['contacts']} of {counted(facts['frames'], 'frame')} located and used",
        f"parts: {facts['touched']} of {facts['parts']} touched, {facts['missing']} missing, the others "
        f"{facts['scatter_mm'] * 1000:.1f} um off the design (rms per axis)",
        f"places: known to {facts['sigma_mm'] * 1000:.1f} um (median); neighbours share {facts['drift_mm'] * 1000:.1f} um of it",
        f"dots: {facts['dot_mm'] * 1000:.1f} um (rms per axis), {facts['far_off']:.1%} far off and left out",
    ]
