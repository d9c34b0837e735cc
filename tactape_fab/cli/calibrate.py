"""calibrate: a sensor's profile from presses on a tape."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.errors import Problem, SpecError, refuse, tried
from tactape_fab.base.fields import shown
from tactape_fab.cli.exits import answers, with_options
from tactape_fab.cli.options import pair
from tactape_fab.cli.printing import counted, echo_json, echo_lines, echo_lines_err, step_shown, table_lines

if TYPE_CHECKING:
    from tactape_fab.sense.calibrate.result import Calibration


@click.command()
@click.argument("frames", nargs=-1, metavar="FRAMES...")
@click.option("--tape", "kits", multiple=True, metavar="KIT...", help="Kits that were pressed, or a folder of kits.")
@click.option("--like", metavar="NAME|FILE.toml", default="generic", help="Sensor profile to start from.  [default: generic]")
@click.option("-o", "--output", metavar="SENSOR.toml", required=True, help="The profile.")
@click.option(
    "--known-theta", metavar="FRAME,DEG", help="A frame pressed in a known direction, and the sensor's turn on the tape."
)
@click.option("--hand-eye", metavar="POSES.csv", help="Poses of the robot's flange: solve where the sensor is on it, too.")
@click.option("--topic", metavar="NAME", help="Topic of an .mcap, feature of a LeRobot dataset.  [default: the only one]")
@click.option("--picture", metavar="DIR", help="Write pictures of residuals and of coverage.")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def calibrate(
    frames: Sequence[str],
    kits: Sequence[str],
    like: str,
    output: str,
    known_theta: str | None,
    hand_eye: str | None,
    topic: str | None,
    picture: str | None,
    as_json: bool,
) -> None:
    """Calibrate a sensor: press a tape some ten times, anywhere, and get the sensor's profile with the error of everything.

    FRAMES are .npz (array depth), .npy, .png of 16 bits, .tif of 16 or of floats of 32, or recordings as of decode; those that
    touch nothing are welcome.
    Of --like only size and mask must be right, and its px/mm within a factor of two. Exit status 2 where the presses do not say
    enough, with what to press.

    \b
    Example: tactape-fab calibrate presses.npz --tape tactape-s007 -o my-sensor.toml
    Example: tactape-fab calibrate presses.npz --tape tactape-s007 --known-theta 0,0 --picture pictures -o my-sensor.toml
    """
    with answers():
        from tactape_fab.base.libraries import library
        from tactape_fab.sense.files.jobs import told_apart

        library("scipy", "calibrate")
        from tactape_fab.sense.calibrate.files import write_profile

        frames, kits = told_apart(frames, kits)
        found, path = _calibrated(frames, kits, like, output, picture, known_theta, hand_eye, topic)
        files = write_profile(path, found)
        if picture is not None:
            from tactape_fab.sense.calibrate.picture import write_pictures

            files += write_pictures(Path(picture), found)
        echo_json(found.to_mapping()) if as_json else echo_lines(calibration_lines(found))
        echo_lines_err(str(file) for file in files)


def _calibrated(
    frames: Sequence[str],
    kits: Sequence[str],
    like: str,
    output: str,
    picture: str | None,
    known_theta: str | None,
    hand_eye: str | None,
    topic: str | None,
) -> tuple[Calibration, Path]:
    """The calibration, and the path of its profile; all invalid values are refused together."""
    from tactape_fab.base.picture_file import refuse_pictures
    from tactape_fab.sense import calibrate_sensor
    from tactape_fab.sense.calibrate.files import checked_output
    from tactape_fab.sense.calibrate.picture import PICTURES
    from tactape_fab.sense.files.arm_poses import read_arm_poses
    from tactape_fab.sense.files.jobs import open_presses
    from tactape_fab.sense.sensors import load_sensor
    from tactape_fab.texture.registry import read_tapes

    problems: list[Problem] = []
    path = tried(lambda: checked_output(output), problems)
    if picture is not None:
        tried(lambda: refuse_pictures(Path(picture), PICTURES, "picture"), problems)
    if not frames:
        problems.append(Problem("frames", "no file of frames is given; give FRAMES, such as presses.npz"))
    if not kits:
        problems.append(Problem("tape", "no tape is given; name the kit that was pressed with --tape"))
    sensor = tried(lambda: load_sensor(like, "like"), problems)
    opened = open_presses(frames, sensor, topic, problems)
    tapes = tried(lambda: read_tapes(kits), problems)
    known = None if known_theta is None else tried(lambda: _known(known_theta), problems)
    count = sum(file.count for file in opened)
    poses = None if hand_eye is None else tried(lambda: read_arm_poses(hand_eye, "hand_eye", count), problems)
    refuse(problems)
    assert path is not None and sensor is not None and tapes is not None
    images = (frame for file in opened for frame in file.frames())
    name, step = path.stem[:100], step_shown()
    return calibrate_sensor(images, tapes, sensor, name=name, known_theta=known, arm_poses=poses, progress=step), path


def _known(text: str) -> tuple[int, float]:
    found: list[Any] = pair(text)
    if len(found) != 2 or not isinstance(found[0], int) or isinstance(found[1], str):
        message = f"known_theta = {shown(text)} is not FRAME,DEG; give the frame's index and its angle, such as 0,90"
        raise SpecError(Problem("known_theta", message))
    return found[0], found[1]


def calibration_lines(found: Calibration) -> list[str]:
    """The calibration as lines."""
    sensor = found.sensor
    dots = sum(len(press.weights) for press in found.presses)
    valid = 1.0 if found.valid is None else float(found.valid.mean())
    mirror = "true" if sensor.mirror else "false"
    rows = [
        (
            q.name,
            f"{q.value:.6g}" if q.name != "corner" else "",
            "" if q.sigma is None else f"{q.sigma:.2g}",
            q.unit,
            q.note,
        )
        for q in found.quantities
    ]
    lines = [
        f"{counted(len(found.presses), 'press').replace('presss', 'presses')} of {counted(found.frames, 'frame')}, {dots} dots",
        f"sign = {sensor.sign}, mirror = {mirror}, rotate90 = {sensor.rotate90}; {100 * valid:.1f} % of the pixels carry depth",
        "",
        *table_lines(("quantity", "value", "sigma", "unit", ""), rows),
        "",
    ]
    if found.held_out is not None:
        out = found.held_out
        lines.append(
            f"dots scatter by {out.inside_um:.2f} um in the adjustment, {out.outside_um:.2f} um in presses left out of it "
            f"({out.folds} folds)"
        )
    if found.hand_eye is not None:
        lines += hand_eye_lines(found)
    return lines + [f"note: {with_options(remark)}" for remark in found.remarks]


def hand_eye_lines(found: Calibration) -> list[str]:
    """Both transforms as lines."""
    answer = found.hand_eye
    assert answer is not None
    values = answer.to_mapping()
    rows = []
    for name in ("sensor_to_flange", "tape_to_base"):
        at, sigma = values[name], values[f"{name}_sigma"]
        place = ", ".join(f"{row[3]:.3f}" for row in at[:3])
        rows.append((name, place, ", ".join(f"{s:.2g}" for s in sigma[:3]), ", ".join(f"{s:.2g}" for s in sigma[3:])))
    off = ", ".join(f"{v:.3g}" for v in values["left"])
    header = ("hand-eye", "x, y, z mm", "sigma mm (own axes)", "sigma rad (own axes)")
    return ["", *table_lines(header, rows), f"left over of x, y, z (mm) and turns (rad) of the sensor on the tape: {off}", ""]
