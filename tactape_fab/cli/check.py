"""check: measures the design rules of a tape without writing anything. It has the options of a tape, which `make` shares."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from operator import not_
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tactape_fab.base.errors import DesignRuleError, Problem, SpecError, refuse, tried
from tactape_fab.base.fields import shown
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import degrees, length, lengths, number, pair, size
from tactape_fab.cli.printing import echo_json, echo_lines, echo_lines_err, finding_lines, remark_lines, warn

if TYPE_CHECKING:
    from tactape_fab.kit.examine.order import ExaminedPanel
    from tactape_fab.kit.examine.tape import Examined
    from tactape_fab.kit.output_place import Overwrite

F = TypeVar("F", bound=Callable[..., Any])


def origin(text: str) -> Any:
    return text if text == "best" else pair(text)


def holes(texts: Sequence[str]) -> Any:
    return [lengths(text, ",") for text in texts] or None


class _TapeOption(click.Option):
    """A command-line option for a key of the spec."""

    def __init__(
        self, option: str, key: str, read: Callable[[Any], Any], metavar: str | None, meaning: str, **settings: Any
    ) -> None:
        super().__init__([option, key], metavar=metavar, help=meaning, **settings)
        self.read = read


TAPE_OPTIONS = (
    _TapeOption("--sector", "sector", number, "N", "Sector of the code that the tape shows. Required."),
    _TapeOption("--w", "pitch_mm", length, "MM", "Grid pitch W.  [default: 1.5]"),
    _TapeOption("--delta", "displacement_mm", length, "MM", "Displacement Δ of each part.  [default: W/6]"),
    _TapeOption("--size", "size_mm", size, "WxH", "Outline, mm.  [default: 100x50]"),
    _TapeOption("--code", "code", str, "NAME", "microdots-4x4 (default), debruijn-4x4, anoto-6x6, trace-22, touch-1 or touch-2."),
    _TapeOption(
        "--directions",
        "directions",
        number,
        "4|8",
        "Directions that parts are displaced in; 8 of touch-1 and touch-2, for printed elements.  [default: 4]",
    ),
    _TapeOption(
        "--origin",
        "origin",
        origin,
        "COL,ROW|best",
        "Place of grid point 0,0 in the code plane, or search for the best.  [default: the sector's]",
    ),
    _TapeOption("--tag", "tag", str, "strip|none", "Strip with AprilTag and label, or none.  [default: strip]"),
    _TapeOption("--tag-id", "tag_id", number, "ID", "Id of the AprilTag.  [default: the sector]"),
    _TapeOption("--tag-cell", "tag_cell_mm", length, "MM", "Side of a cell of the AprilTag.  [default: 0.5]"),
    _TapeOption(
        "--part",
        "part",
        str,
        "NAME",
        "Part profile, or a .toml file; block, cone, dome are solid elements, to print or mill.  [default: r0201]",
    ),
    _TapeOption("--body", "body_mm", size, "LxWxH", "Size of a solid element; of the round ones DxH."),
    _TapeOption("--dome-top", "dome_top_mm", length, "MM", "Diameter of a dome's flat top."),
    _TapeOption("--rotation", "rotation_deg", degrees, "DEG", "Rotation of every part.  [default: 45]"),
    _TapeOption("--fab", "fab", str, "PROFILE", "Fab profile, or a .toml file.  [default: generic-fpc]"),
    _TapeOption(
        "--process",
        "process",
        str,
        "PROFILE",
        "Process profile, or a .toml file; warns of what it cannot make.  [default: sla for solid elements]",
    ),
    _TapeOption(
        "--assembly",
        "assembly",
        str,
        "HOUSE",
        "Format of CPL and BOM: generic, jlcpcb, pcbway, eurocircuits, macrofab or kicad.  [default: the profile's]",
    ),
    _TapeOption(
        "--part-number",
        "part_number",
        str,
        "NUMBER",
        "The part's number in the BOM, as that house takes it.  [default: the part profile's, or none]",
    ),
    _TapeOption("--x2", "x2", str, "full|comments|off", "Gerber attributes.  [default: the profile's]"),
    _TapeOption("--corner-radius", "corner_radius_mm", length, "MM", "Corner radius of the outline.  [default: 1]"),
    _TapeOption(
        "--coverlay",
        "coverlay",
        str,
        "per-part|lpi|gang",
        "How the coverlay is opened.  [default: the profile's first way that is legal]",
    ),
    _TapeOption("--anchor", "anchor", str, "none|spur|mesh", "Copper that holds pads under it.  [default: none]"),
    _TapeOption("--stiffener", "stiffener", str, "MATERIAL:MM", "Laminate a stiffener, such as FR4:0.2."),
    _TapeOption("--adhesive", "adhesive", str, "MATERIAL:MM", "Laminate an adhesive tape, such as 3M468:0.13."),
    _TapeOption("--bend-axis", "bend_axis", str, "x|y", "Board axis that goes round where the tape is bent."),
    _TapeOption("--bend-radius", "bend_radius_mm", length, "MM", "Radius that the tape is bent to."),
    _TapeOption("--hole", "holes_mm", holes, "X,Y,D", "Unplated hole, mm; may be repeated.", multiple=True),
    _TapeOption("--name", "name", str, "NAME", "Name of the tape and its files.  [default: tactape-s007 for sector 7]"),
    _TapeOption("--base", "base_mm", length, "MM", "Base of the solid models.  [default: 0.8]"),
    _TapeOption("--negative", "negative", bool, None, "Solid models of the mould, whose cast is the texture.", is_flag=True),
    _TapeOption("--top", "top", str, "tiles|single", "Top face in the STEP solid.  [default: tiles]"),
    _TapeOption("--cylinder", "cylinder_mm", length, "R", "Wrap the solid models round a radius, mm."),
    _TapeOption("--around", "around", str, "x|y", "Board axis that goes round the cylinder.  [default: x]"),
    _TapeOption("--shell", "shell", str, "segment|whole", "Base of a cylinder: the tape's, or closed.  [default: segment]"),
    _TapeOption("--no-3d", "models", not_, None, "Leave the 3D models out.", is_flag=True),
    _TapeOption("--no-mark", "mark", not_, None, "Leave sector and arrow out of the back of solid elements.", is_flag=True),
    _TapeOption("--sim", "sim", bool, None, "Add assets for simulators: MJCF, URDF, USD, glTF, a heightfield.", is_flag=True),
)


PANEL_OPTIONS = (
    _TapeOption(
        "--panel", "panel", str, "auto|CxR|none", "Put tapes on a panel, C columns and R rows.  [default: the profile's]"
    ),
    _TapeOption("--sectors", "sectors", str, "LIST", "Sectors of a panel's tapes, such as 7,8,20-23."),
    _TapeOption(
        "--same-sector", "same_sector", bool, None, "All tapes of a panel show the sector: copies, not told apart.", is_flag=True
    ),
    _TapeOption("--tabs", "tabs", str, "auto|x|y|xy", "Sides by which a panel holds its tapes.  [default: those with room]"),
)
"""Options of a panel of tapes."""


def tape_options(command: F) -> F:
    """Add SPEC.toml and every option of a tape and a panel."""
    # reversed, as each is inserted at the front, before the command's own
    for option in reversed((*TAPE_OPTIONS, *PANEL_OPTIONS)):
        command.params.insert(0, option)  # type: ignore[attr-defined]
    command.params.insert(0, click.Argument(["spec_file"], required=False, metavar="[SPEC.toml]"))  # type: ignore[attr-defined]
    return command


def given_values(options: dict[str, Any]) -> dict[str, Any]:
    """The values of the options that were given."""
    return {
        o.name: o.read(options[o.name])
        for o in (*TAPE_OPTIONS, *PANEL_OPTIONS)
        # typed values are strings, even "0"; options that were not typed are None, () or False
        if o.name is not None and options[o.name] not in (None, (), False)
    }


def spec_values(spec_file: str | None) -> dict[str, Any]:
    """The values of SPEC.toml; empty without one."""
    from tactape_fab.kit.spec.tape_list import read_list_file

    if spec_file is not None and spec_file.isdigit() and not Path(spec_file).exists():
        raise SpecError(Problem("sector", f"SPEC.toml = {spec_file} is no file; did you mean --sector {spec_file}?"))
    return read_list_file(Path(spec_file)) if spec_file is not None else {}


def is_list(values: dict[str, Any], given: dict[str, Any], avoid: Sequence[str] = (), *, alone: bool = False) -> bool:
    """Whether several tapes are asked for, each with its own kit; a panel is one order, and so not a list.

    Sectors are put on a panel if the fab's profile says so and they fill one, unless `alone`.
    """
    from tactape_fab.kit.examine.order import takes_panel
    from tactape_fab.kit.spec.tape_list import is_list as lists_tapes

    panel = {**values, **given}.get("panel", "none")
    if panel != "none" and "tapes" in values:
        message = (
            f"panel = {shown(panel)} is of tapes of one size, and [[tapes]] lists any; leave out --panel, and use --pack to put "
        )
        raise SpecError(Problem("panel", f"{message}them on panels"))
    if panel != "none" or not lists_tapes(values, given):
        return False
    if avoid:
        raise SpecError(
            Problem("avoid", "--avoid cannot be used with a list of tapes; make them one by one, or leave --avoid out")
        )
    if not alone and "tapes" not in values:
        together, remark = takes_panel({**values, **given})
        if together:
            return False
        echo_lines_err([remark] if remark else [])
    # only "none" can be left here, which lists do not accept
    for of in (values, given):
        of.pop("panel", None)
    return True


def examined_order(
    values: dict[str, Any],
    given: dict[str, Any],
    avoid: Sequence[str] = (),
    of_lists: Mapping[str, object] | None = None,
    *,
    output: str | None = None,
    overwrite: Overwrite = False,
) -> Examined | ExaminedPanel:
    """Examine one tape or panel; options for lists only (`of_lists`) are refused together with all other problems."""
    from tactape_fab.kit.examine.order import examine_order
    from tactape_fab.kit.examine.tape import examine
    from tactape_fab.kit.spec.panel_options import PANEL_KEYS
    from tactape_fab.texture.registry import read_tapes

    single = {**values, **given}
    panel = single.get("panel", "none")
    remedy = "is for lists of tapes; give --sectors or [[tapes]], or leave it out"
    if panel != "none" and "sectors" in single:
        remedy = f"is for lists of tapes, and panel = {shown(panel)} makes one panel of them; leave one of the two out"
    problems = [Problem(name, f"--{name} {remedy}") for name, value in (of_lists or {}).items() if value]
    # an option overrides the file: --sector replaces the file's sectors
    if "sector" in given and "sectors" not in given:
        single.pop("sectors", None)
    tapes = tried(lambda: read_tapes(avoid), problems)
    try:
        if problems:  # to report all other problems as well
            of_one = {key: value for key, value in single.items() if key not in PANEL_KEYS}
            examine({"sector": 0, **of_one}, output=output, overwrite=overwrite)
        else:
            examined, remarks = examine_order(single, output=output, overwrite=overwrite, avoid=tapes or ())
    except SpecError as error:
        raise SpecError([*problems, *error.problems], error.findings) from None
    refuse(problems)
    echo_lines_err(remarks)
    return examined


avoid_option = click.option(
    "--avoid",
    metavar="KITS",
    multiple=True,
    help="Choose the origin, and the sector if none is given, far from these kits; may be repeated.",
)


# The command


@tape_options
@click.command()
@avoid_option
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def check(spec_file: str | None, avoid: Sequence[str], as_json: bool, **options: Any) -> None:
    """Measure a tape against the design rules of its fab or process; nothing is written."""
    with answers():
        values, given = spec_values(spec_file), given_values(options)
        if is_list(values, given):
            what = "--sectors names" if spec_file is None else f"{spec_file} is"
            raise SpecError(f"{what} a list of tapes; check takes one, make checks them all before it writes any")
        findings = examined_order(values, given, avoid).findings
        if as_json:
            echo_json([asdict(f) for f in findings])
        else:
            echo_lines(finding_lines(findings))
            echo_lines_err(f"note: {line}" for line in remark_lines(findings))
            warn(findings)
        if any(f.blocks for f in findings):
            raise DesignRuleError(findings)
