"""simulate: writes depth maps of a kit's tape."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import click

from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import SENSOR_HELP, contact_size, degrees, kilopascals, length, micrometres, newtons, number, pair
from tactape_fab.cli.printing import counted, echo_line, step_shown

_READ: dict[str, Callable[[str], Any]] = {
    "contact": contact_size,
    "contact_model": str,
    "tilt": partial(pair, read=degrees),
    "force": newtons,
    "gel_modulus": kilopascals,
    "gel_displacement": micrometres,
    "places": str,
    "as_built": str,
    **dict.fromkeys(("cylinder", "placement", "elastomer", "gel_correlation", "gel_thickness"), length),
}


@click.command()
@click.argument("kit")
@click.option("-o", "--output", metavar="FRAMES.npz", required=True, help="File of the frames.")
@click.option("--count", metavar="N", default="1", help="Number of frames.  [default: 1]")
@click.option("--seed", metavar="S", default="0", help="Of poses, noise and defects; equal seeds give equal bytes.  [default: 0]")
@click.option("--pose", metavar="X,Y,THETA", help="Pose of every frame, mm and degrees.  [default: spread over the tape]")
@click.option("--edge", is_flag=True, help="Spread the poses along the edge of the texture instead.")
@click.option("--sensor", metavar="NAME", default=DEFAULT_SENSOR, help=SENSOR_HELP)
@click.option("--contact", metavar="AxB|pad", help="Axes of the elliptic contact, mm, or the whole field.  [default: 11x9]")
@click.option("--cylinder", metavar="R", help="The strip along which a cylinder of this radius touches, mm.")
@click.option(
    "--contact-model", metavar="imprint|elastic", help="Imprint of a given shape, or a solved contact.  [default: imprint]"
)
@click.option("--force", metavar="N", help="Elastic: normal force, N.  [default: 2]")
@click.option("--tilt", metavar="U,V", help="Elastic: tilt of the tape along image u and v, degrees.  [default: 0,0]")
@click.option("--gel-thickness", metavar="MM", help="Elastic: thickness of the gel.  [default: the sensor's, or 4]")
@click.option("--gel-modulus", metavar="KPA", help="Elastic: Young's modulus of the gel.  [default: the sensor's, or 275]")
@click.option("--markers", is_flag=True, help="Elastic: a gel with printed dots, 0.5 mm wide at 2 mm.")
@click.option("--missing", metavar="SHARE", help="Share of parts that are missing.  [default: 0]")
@click.option("--bumps", metavar="N", help="Bumps that belong to no tape.  [default: 0]")
@click.option("--noise", metavar="FACTOR", help="Factor on the sensor's noise.  [default: 1]")
@click.option(
    "--noise-model", metavar="sensor|slope|smooth", help="smooth is the older model.  [default: sensor, the one of its profile]"
)
@click.option("--placement", metavar="MM", help="Standard deviation of the parts' places.  [default: 0]")
@click.option(
    "--elastomer",
    metavar="MM",
    help="How far the gel smooths, standard deviation.  [default: the sensor's, or 0.15; elastic: 0.04]",
)
@click.option("--scale-error", metavar="SHARE", help="The true px/mm is the profile's times 1 + SHARE.  [default: 0]")
@click.option("--aspect-error", metavar="SHARE", help="The true aspect is the profile's plus SHARE.  [default: 0]")
@click.option("--shear-error", metavar="SHARE", help="The true shear is the profile's plus SHARE.  [default: 0]")
@click.option("--k1-error", metavar="SHARE", help="The true radial distortion is the profile's plus SHARE.  [default: 0]")
@click.option("--gel-displacement", metavar="UM", help="Smooth displacement of the gel, rms, µm.  [default: the sensor's own]")
@click.option("--gel-correlation", metavar="MM", help="How far it is alike, standard deviation.  [default: the sensor's own]")
@click.option("--from", "places", metavar="design|cpl|as-built", help="Source of the parts' places.  [default: design]")
@click.option("--as-built", metavar="FILE", help="With --from as-built: measured places.  [default: KIT/as-built.json]")
@click.option("--from-cpl", is_flag=True, help="The same as --from cpl.")
def simulate(
    kit: str, output: str, pose: str | None, edge: bool, sensor: str, from_cpl: bool, markers: bool, **given: str | None
) -> None:
    """Write depth maps of a kit's tape in contact with a sensor, and where they were taken.

    \b
    Example: tactape-fab simulate tactape-s007 -o frames.npz --count 100 --seed 1
    """
    with answers():
        from tactape_fab.sense.files.simulated import simulate_file

        options: dict[str, Any] = {name: _READ.get(name, number)(text) for name, text in given.items() if text is not None}
        if markers:
            options["markers"] = True
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
        if made.left_out:
            echo_line(
                f"warning: the pick-and-place file leaves out {counted(made.left_out, 'part')}; the frames lack them", err=True
            )
        if made.unrolled_mm is not None:
            radius = f"{made.unrolled_mm:g}"
            remedy = f"--cylinder {radius} draws what a flat gel sees of it"
            echo_line(f"warning: the kit is wrapped round a radius of {radius} mm, and drawn flat; {remedy}", err=True)
        frames = f"{counted(made.count, 'frame')} of {made.frame_shape[0]} x {made.frame_shape[1]} px"
        echo_line(f"{made.path}: {frames}, {made.tape} as {made.sensor} sees it")
