"""decode: locates the frames of files."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.errors import Problem, SpecError, tried
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import locating_options, locating_values, named_object
from tactape_fab.cli.printing import counted, echo_line, echo_lines, step_shown

if TYPE_CHECKING:
    from tactape_fab.sense.decode.result import Localization
    from tactape_fab.sense.files.jobs import Job, Located
    from tactape_fab.sense.objects.mount import ObjectPose
    from tactape_fab.sense.objects.taped_object import TapedObject
    from tactape_fab.texture.tape import Tape


@click.command()
@click.argument("frames", nargs=-1, metavar="FRAMES...")
@locating_options
@click.option("--raw", multiple=True, metavar="IMAGES", help="Colour images of the gel, or a folder of them, instead of FRAMES.")
@click.option("--background", metavar="IMAGE", help="With --raw: the gel while it touches nothing.")
@click.option("--weights", metavar="FILE.pth", help="With --raw: the network that turns the sensor's colours into slopes.")
@click.option("--topic", metavar="NAME", help="Topic of an .mcap, feature of a LeRobot dataset.  [default: the only one]")
@click.option("--overlay", metavar="DIR", help="Write a picture of every frame: dots, grid, axes.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per frame.")
@click.option("--dots", is_flag=True, help="With --json: what each dot of a located frame says, too.")
def decode(
    frames: Sequence[str],
    kits: Sequence[str],
    sensor: str,
    raw: Sequence[str],
    background: str | None,
    weights: str | None,
    topic: str | None,
    overlay: str | None,
    as_json: bool,
    dots: bool,
    object_file: str | None,
    **given: Any,
) -> None:
    """Locate contacts: which tape each frame touches, where and at what angle, or why that cannot be said.

    FRAMES are .npz (array depth), .npy, .png of 16 bits, or .tif of 16 or of floats of 32; after --raw, further PNG and JPEG
    images; or recordings: an .mcap, a folder of rosbag2, a LeRobot dataset.

    \b
    Example: tactape-fab decode frames.npz --tape tactape-s007
    Example: tactape-fab decode --raw images --background bg.png --weights nnmodel.pth --tape tactape-s007
    """
    with answers():
        if dots and not as_json:
            raise SpecError(Problem("dots", "--dots is part of JSON answers, and --json is not given; give it as well"))

        from tactape_fab.sense.files.jobs import Raw, localize, prepare, told_apart
        from tactape_fab.sense.objects.taped_object import refuse_ambiguous

        frames, kits = told_apart(frames, kits)
        options = locating_values(given)
        thing = named_object(object_file, options)
        colour = None
        if raw or background is not None or weights is not None:
            colour = Raw(images=[*raw, *frames] if raw else [], background=background, weights=weights)
        if thing is not None:
            kits = [*(str(entry.kit) for entry in thing.tapes), *kits]
        problems: list[Problem] = []
        if overlay is not None:
            from tactape_fab.sense.overlay import refuse_overlay

            tried(lambda: refuse_overlay(Path(overlay)), problems)
        job = tried(lambda: prepare(frames, kits, sensor, colour, topic, **options), problems)
        if problems or job is None:
            raise SpecError(problems)
        if thing is not None:
            refuse_ambiguous(thing, job.tapes)
        _print_answers(localize(job), job, thing, as_json=as_json, dots=dots, overlay=overlay)


def _print_answers(
    answers: Iterator[Located], job: Job, thing: TapedObject | None, *, as_json: bool, dots: bool, overlay: str | None
) -> None:
    from tactape_fab.base.libraries import library
    from tactape_fab.sense.files.answers import object_json
    from tactape_fab.sense.overlay import draw_overlay, write_overlay

    if overlay is not None:
        library("cv2", "--overlay")  # before the first answer
    table = FixTable(job.tapes, on_object=thing is not None)
    count = sum(file.count for file in job.files)
    show = step_shown() if sys.stdout is not None and not sys.stdout.isatty() else lambda *_: None  # on a terminal rows do
    located, elapsed_ms = 0, []
    for answer in answers:
        fix = answer.fix
        there = None if thing is None else thing.locate(fix)
        if as_json:
            more = {} if thing is None else object_json(there)
            click.echo(json.dumps({**fix.to_mapping(answer.frame, dots=dots), **more}, allow_nan=False))
        else:
            echo_lines([table.header()] * (answer.frame == 0) + [table.row(answer.frame, fix, there)])
        if overlay is not None:
            picture = draw_overlay(answer.depth, answer.sensor, job.tapes, fix, answer.frame)
            write_overlay(Path(overlay), picture, answer.frame)
        located += fix.located
        elapsed_ms.append(fix.elapsed_ms)
        if len(elapsed_ms) % 100 == 0 or len(elapsed_ms) == count:
            show("frames", len(elapsed_ms), count)
    echo_line(summary_line(located, len(elapsed_ms), elapsed_ms), err=True)


class FixTable:
    """Answers as rows of a table, printed one by one; column widths follow from the names of the tapes."""

    def __init__(self, tapes: Sequence[Tape], *, on_object: bool = False) -> None:
        self.on_object = on_object
        self.name_width = max([4, *(len(tape.name) for tape in tapes)])

    def header(self) -> str:
        row = self._row("frame", "status", "dots", "tape", "x mm", "y mm", "theta deg", "p_false")
        return row + "  on object: x, y, z mm" * self.on_object

    def row(self, frame: int, fix: Localization, there: ObjectPose | None = None) -> str:
        agreeing = f"{fix.n_agree}/{fix.n_dots}"
        if not fix.located:
            return f"{frame:>6}  {fix.status:<6}  {agreeing:>7}  not located: {fix.reason}"
        name = fix.tape or (f"sector {fix.sector}" if fix.sector is not None else "")
        x, y = (f"{v:.3f}" for v in fix.position_mm or fix.plane_mm or ()) if fix.position_mm or fix.plane_mm else ("", "")
        theta = "" if fix.theta_deg is None else f"{fix.theta_deg:.2f}"
        p_false = "" if fix.p_false is None else f"{fix.p_false:.1e}"
        on_object = "" if there is None else "  " + ", ".join(f"{v:.3f}" for v in there.position_mm)
        return self._row(str(frame), fix.status, agreeing, name, x, y, theta, p_false) + on_object

    def _row(self, frame: str, status: str, dots: str, name: str, x: str, y: str, theta: str, p_false: str) -> str:
        width = self.name_width
        return f"{frame:>6}  {status:<6}  {dots:>7}  {name:<{width}}  {x:>9}  {y:>9}  {theta:>9}  {p_false:>8}".rstrip()


def summary_line(located: int, count: int, elapsed_ms: Sequence[float]) -> str:
    # of two middle values the upper one, so that it is a measured time
    median = sorted(elapsed_ms)[len(elapsed_ms) // 2] if elapsed_ms else 0.0
    return f"located {located} of {counted(count, 'frame')}; median {median:.2f} ms"
