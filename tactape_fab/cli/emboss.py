"""emboss: puts a kit's texture on the user's own part."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.errors import Problem, tried
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import number, pair
from tactape_fab.cli.printing import echo_json, echo_lines, echo_lines_err, purpose_lines, step_shown, verified_line

if TYPE_CHECKING:
    from tactape_fab.kit.output_place import Overwrite
    from tactape_fab.make.emboss import Embossed


@click.command()
@click.argument("kit")
@click.argument("surface")
@click.option("--at", metavar="X,Y,Z", help="Point of the surface under the middle of the texture, mm.")
@click.option("--up", metavar="X,Y,Z", help="Direction of board +y there.  [default: +z, or +y on a level surface]")
@click.option("--face", metavar="N", help="Face of a STEP solid, from 0.  [default: the one at the point, or the largest]")
@click.option("--unit", metavar="mm|cm|m|inch", default="mm", help="Unit of an STL, OBJ or PLY file.  [default: mm]")
@click.option("--sim", is_flag=True, help="Add assets for simulators: MJCF, URDF, USD.")
@click.option("-o", "--output", metavar="DIR", help="Folder of the result.  [default: beside the part]")
@click.option("--overwrite", is_flag=True, help="Replace an older result of this tool.")
@click.option("--discard-edits", is_flag=True, help="Replace it even if files in it were edited since.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def emboss(
    kit: str,
    surface: str,
    unit: str,
    sim: bool,
    output: str | None,
    overwrite: bool,
    discard_edits: bool,
    as_json: bool,
    **place: str | None,
) -> None:
    """Put a kit's texture on a part of yours: SURFACE is an STL, 3MF, OBJ, PLY or STEP file.

    \b
    Example: tactape-fab emboss tactape-s007 handle.stl --at 0,0,25
    """
    with answers():
        from tactape_fab.make.emboss import emboss_kit
        from tactape_fab.solids.surface.charts import Placement, read_placement

        given = {"at_mm": place["at"], "up": place["up"], "face": place["face"]}
        values = {key: number(text) if key == "face" else pair(text) for key, text in given.items() if text is not None}
        problems: list[Problem] = []
        placement = tried(lambda: read_placement(values), problems) or Placement()
        replace: Overwrite = "edits" if discard_edits else overwrite
        how: dict[str, Any] = {"overwrite": replace, "unit": unit, "sim": sim, "progress": step_shown(), "known": problems}
        made = emboss_kit(kit, surface, output, placement=placement, **how)
        echo_lines_err(distortion_lines(made))
        echo_json(made.to_mapping()) if as_json else echo_lines(embossed_lines(made))


def distortion_lines(made: Embossed) -> list[str]:
    """Warning lines if the surface distorts the texture too much."""
    from tactape_fab.make.emboss import worst_pitch_error
    from tactape_fab.solids.surface.patch import MOST_PITCH_ERROR
    from tactape_fab.solids.surface.place import smaller_kit

    distortion = made.surface["distortion"]
    reach, usable = distortion["reach_mm"], distortion["usable_radius_mm"]
    if (worst := worst_pitch_error(distortion)) <= MOST_PITCH_ERROR:
        return []
    return [
        f"warning: distortion: the pitch is off by up to {worst:.0%}, more than {MOST_PITCH_ERROR:.0%}; the texture reaches "
        f"{reach:.1f} mm, usable are {usable:.1f} mm; use {smaller_kit(made.tape, reach, usable)}, "
        "or leave out --at to look for a better place"
    ]


def embossed_lines(made: Embossed) -> list[str]:
    surface, distortion = made.surface, made.surface["distortion"]
    centre = ", ".join(f"{round(v, 3) + 0.0:.3f}" for v in surface["centre_mm"])
    return [
        f"{made.path}: {made.tape.part_count} elements of {made.tape.name} on {surface['source']} round ({centre}) mm",
        f"pitch error {distortion['pitch_error_min']:+.2%} to {distortion['pitch_error_max']:+.2%}, median "
        f"{distortion['pitch_error_median']:+.2%}; the texture reaches {distortion['reach_mm']:.1f} mm, usable are "
        f"{distortion['usable_radius_mm']:.1f} mm",
        verified_line(made.checks),
        *purpose_lines(made.path, made.files),
    ]
