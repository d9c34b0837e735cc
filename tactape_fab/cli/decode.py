"""simulate, decode."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.cli.exits import answers, echo_lines, echo_lines_err, step_shown
from tactape_fab.cli.group import main
from tactape_fab.cli.options import (
    SENSOR_HELP,
    contact_size,
    length,
    number,
    pair,
)
from tactape_fab.cli.printing import FixTable, object_lines, simulated_line, summary_line
from tactape_fab.sense.files.answers import fix_json, object_json

if TYPE_CHECKING:
    from tactape_fab.sense.files.jobs import Job, Located
    from tactape_fab.sense.objects.taped_object import TapedObject


# Localization


@main.command()
@click.argument("kit")
@click.option("-o", "--output", metavar="FRAMES.npz", required=True, help="File of the frames.")
@click.option("--count", metavar="N", default="1", help="Number of frames.  [default: 1]")
@click.option("--seed", metavar="S", default="0", help="Of poses, noise and defects; equal seeds give equal bytes.  [default: 0]")
@click.option("--pose", metavar="X,Y,THETA", help="Pose of every frame, mm and degrees.  [default: spread over the tape]")
@click.option("--edge", is_flag=True, help="Spread the poses along the edge of the texture instead.")
@click.option("--sensor", metavar="NAME", default="gelsight-mini", help=SENSOR_HELP)
@click.option("--contact", metavar="AxB|pad", help="Axes of the elliptic contact, mm, or the whole field.  [default: 11x9]")
@click.option("--cylinder", metavar="R", help="The strip along which a cylinder of this radius touches, mm.")
@click.option("--missing", metavar="SHARE", help="Share of parts that are missing.  [default: 0]")
@click.option("--bumps", metavar="N", help="Bumps that belong to no tape.  [default: 0]")
@click.option("--noise", metavar="FACTOR", help="Factor on the sensor's noise.  [default: 1]")
@click.option("--placement", metavar="MM", help="Standard deviation of the parts' places.  [default: 0]")
@click.option("--elastomer", metavar="MM", help="How far the elastomer smooths, standard deviation.  [default: 0.15]")
@click.option("--scale-error", metavar="SHARE", help="The true px/mm is the profile's times 1 + SHARE.  [default: 0]")
@click.option("--from-cpl", is_flag=True, help="Take the parts' places from the kit's pick-and-place file.")
def simulate(kit: str, output: str, pose: str | None, edge: bool, sensor: str, from_cpl: bool, **given: str | None) -> None:
    """Write depth maps of a kit's tape in contact with a sensor, and where they were taken.

    \b
    Example: tactape-fab simulate tactape-s007 -o frames.npz --count 100 --seed 1
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    with answers():
        from tactape_fab.sense.files.simulated import simulate_file

        places = {"contact": contact_size, "cylinder": length, "placement": length, "elastomer": length}
        options = {name: places.get(name, number)(text) for name, text in given.items() if text is not None}
        made = simulate_file(
            kit,
            output,
            sensor=sensor,
            pose=None if pose is None else pair(pose),
            edge=edge,
            from_cpl=from_cpl,
            progress=step_shown(),
            **options,
        )
        click.echo(simulated_line(made.path, made.count, made.frame_shape, made.tape, made.sensor))


@main.command()
@click.argument("frames", nargs=-1, metavar="FRAMES...")
@click.option("--tape", "kits", multiple=True, metavar="KIT...", help="Kits that can be touched, or a folder of kits.")
@click.option("--code", metavar="CODE", help="Without --tape: the code alone; it asks for many more dots.")
@click.option("--w", metavar="MM", help="Grid pitch W of --code.  [default: 1.5]")
@click.option("--delta", metavar="MM", help="Displacement Δ of --code.  [default: W/6]")
@click.option("--sensor", metavar="NAME|FILE.toml", default="gelsight-mini", help=SENSOR_HELP)
@click.option("--raw", multiple=True, metavar="IMAGES", help="Colour images of the gel, or a folder of them, instead of FRAMES.")
@click.option("--background", metavar="IMAGE", help="With --raw: the gel while it touches nothing.")
@click.option("--weights", metavar="FILE.pth", help="With --raw: the network that turns the sensor's colours into slopes.")
@click.option("--method", metavar="ml|paper", default="ml", help="How frames are located.  [default: ml]")
@click.option("--world", metavar="open|closed", help="Whether tapes that are not named may be touched, too.  [default: open]")
@click.option("--max-p-false", metavar="P", help="Largest chance of a wrong answer.  [default: 1e-4]")
@click.option("--max-p-tape", metavar="P", help="Largest chance that it is no tape of ours.  [default: within --max-p-false]")
@click.option("--object", "object_file", metavar="FILE.toml", help="The tapes of an object; answers in its frame, too.")
@click.option("--fixed-scale", is_flag=True, help="Take px/mm as it is instead of refining it from the frame.")
@click.option("--overlay", metavar="DIR", help="Write a picture of every frame: dots, grid, axes.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per frame.")
def decode(
    frames: Sequence[str],
    kits: Sequence[str],
    sensor: str,
    raw: Sequence[str],
    background: str | None,
    weights: str | None,
    overlay: str | None,
    as_json: bool,
    object_file: str | None,
    **given: Any,
) -> None:
    """Locate contacts: which tape each frame touches, where and at what angle, or why that cannot be said.

    FRAMES are .npz (array depth), .npy, or 16-bit .png and .tif; after --raw, further PNG and JPEG images.

    \b
    Example: tactape-fab decode frames.npz --tape tactape-s007
    Example: tactape-fab decode --raw images --background bg.png --weights nnmodel.pth --tape tactape-s007
    """
    with answers():
        from tactape_fab.sense.files.jobs import Raw, is_kit, localize, make_locator, prepare
        from tactape_fab.sense.objects.taped_object import read_object, refuse_strangers

        if kits:  # --tape A B, as a shell would have it
            kits = [*kits, *(f for f in frames if is_kit(f))]
            frames = [f for f in frames if not is_kit(f)]
        reads = {"w": length, "delta": length, "max_p_false": number, "max_p_tape": number}
        options = {name: reads[name](v) if name in reads and v is not None else v for name, v in given.items()}
        colour = None
        if raw or background is not None or weights is not None:
            colour = Raw(images=[*raw, *frames] if raw else [], background=background, weights=weights)
        thing = None if object_file is None else read_object(object_file)
        if thing is not None:
            refuse_code(options)
            kits = [*(str(entry.kit) for entry in thing.tapes), *kits]
            echo_lines_err(object_lines(thing))
        job = prepare(frames, kits, sensor, colour, **options)
        if thing is not None:
            refuse_strangers(thing, job.tapes)
        _print_answers(localize(job, make_locator), job, thing, as_json=as_json, overlay=overlay)


def refuse_code(options: Mapping[str, Any]) -> None:
    """An object names its tapes; the code alone is for where there are none."""
    bare = [f"--{name}" for name in ("code", "w", "delta") if options.get(name) is not None]
    if bare:
        message = f"{', '.join(bare)} and --object are given, but an object's kits say all of it; give either"
        raise SpecError(Problem("object", message))


def _print_answers(
    answers: Iterator[Located], job: Job, thing: TapedObject | None, *, as_json: bool, overlay: str | None
) -> None:
    from tactape_fab.base.libraries import library
    from tactape_fab.sense.overlay import draw_overlay, write_overlay

    if overlay is not None:
        library("cv2", "--overlay")  # before the first answer
    table = FixTable(job.tapes, on_object=thing is not None)
    count = sum(file.count for file in job.files)
    show = step_shown() if sys.stdout is not None and not sys.stdout.isatty() else lambda *_: None  # rows are progress enough
    located, elapsed_ms = 0, []
    for answer in answers:
        fix = answer.fix
        there = None if thing is None else thing.locate(fix)
        if as_json:
            more = {} if thing is None else object_json(there)
            click.echo(json.dumps({**fix_json(answer.frame, fix), **more}, allow_nan=False))
        else:
            echo_lines([table.header()] * (answer.frame == 0) + [table.row(answer.frame, fix, there)])
        if overlay is not None:
            picture = draw_overlay(answer.depth, answer.sensor, job.tapes, fix, answer.frame)
            write_overlay(Path(overlay), picture, answer.frame)
        located += fix.located
        elapsed_ms.append(fix.elapsed_ms)
        if len(elapsed_ms) % 100 == 0 or len(elapsed_ms) == count:
            show("frames", len(elapsed_ms), count)
    click.echo(summary_line(located, len(elapsed_ms), elapsed_ms), err=True)


if __name__ == "__main__":
    main()
