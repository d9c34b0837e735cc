"""check: design rules of a tape, measured; nothing is written. The options of a tape, which make has too, are here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tactape_fab.base.errors import DesignRuleError, Problem, SpecError
from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import length, lengths, number, pair, size
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

    def __init__(self, declarations: Sequence[str], key: str, read: Callable[[Any], Any], **settings: Any) -> None:
        super().__init__([*declarations, key], **settings)
        self.read = read


def _same(text: str) -> str:
    return text


def _off(given: bool) -> bool:
    return not given


TAPE_OPTIONS = (
    _TapeOption(["--sector"], "sector", number, metavar="N", help="Sector of the code that the tape shows. Required."),
    _TapeOption(["--w"], "pitch_mm", length, metavar="MM", help="Grid pitch W.  [default: 1.5]"),
    _TapeOption(["--delta"], "displacement_mm", length, metavar="MM", help="Displacement Δ of each part.  [default: W/6]"),
    _TapeOption(["--size"], "size_mm", size, metavar="WxH", help="Outline, mm.  [default: 100x50]"),
    _TapeOption(
        ["--code"],
        "code",
        _same,
        metavar="NAME",
        help="microdots-4x4 (default), debruijn-4x4, anoto-6x6, trace-22, touch-1 or touch-2.",
    ),
    _TapeOption(
        ["--directions"],
        "directions",
        number,
        metavar="4|8",
        help="Directions that parts are displaced in; 8 of touch-1 and touch-2, for printed elements.  [default: 4]",
    ),
    _TapeOption(
        ["--origin"],
        "origin",
        origin,
        metavar="COL,ROW|best",
        help="Place of grid point 0,0 in the code plane, or search for the best.  [default: the sector's]",
    ),
    _TapeOption(["--tag"], "tag", _same, metavar="strip|none", help="Strip with AprilTag and label, or none.  [default: strip]"),
    _TapeOption(["--tag-id"], "tag_id", number, metavar="ID", help="Id of the AprilTag.  [default: the sector]"),
    _TapeOption(["--tag-cell"], "tag_cell_mm", length, metavar="MM", help="Side of a cell of the AprilTag.  [default: 0.5]"),
    _TapeOption(
        ["--part"],
        "part",
        _same,
        metavar="NAME",
        help="Part profile, or a .toml file; block, dome, cone are for printing and milling.  [default: r0201]",
    ),
    _TapeOption(["--body"], "body_mm", size, metavar="LxWxH", help="Size of block, dome or cone; of the round ones DxH."),
    _TapeOption(["--dome-top"], "dome_top_mm", length, metavar="MM", help="Diameter of a dome's flat top."),
    _TapeOption(["--rotation"], "rotation_deg", number, metavar="DEG", help="Rotation of every part.  [default: 45]"),
    _TapeOption(["--fab"], "fab", _same, metavar="PROFILE", help="Fab profile, or a .toml file.  [default: generic-fpc]"),
    _TapeOption(
        ["--process"],
        "process",
        _same,
        metavar="sla|fdm|cnc",
        help="How the models are made, or a .toml file; warns of what it cannot make.  [default: sla for block, dome, cone]",
    ),
    _TapeOption(
        ["--assembly"],
        "assembly",
        _same,
        metavar="HOUSE",
        help="Format of CPL and BOM: generic, jlcpcb, pcbway, eurocircuits, macrofab or kicad.  [default: the profile's]",
    ),
    _TapeOption(
        ["--part-number"],
        "part_number",
        _same,
        metavar="NUMBER",
        help="The part's number in the BOM, as that house takes it.  [default: the part profile's, or none]",
    ),
    _TapeOption(["--x2"], "x2", _same, metavar="full|comments|off", help="Gerber attributes.  [default: the profile's]"),
    _TapeOption(
        ["--corner-radius"], "corner_radius_mm", length, metavar="MM", help="Corner radius of the outline.  [default: 1]"
    ),
    _TapeOption(
        ["--coverlay"],
        "coverlay",
        _same,
        metavar="per-part|lpi|gang",
        help="How the coverlay is opened.  [default: the profile's first way that is legal]",
    ),
    _TapeOption(
        ["--anchor"], "anchor", _same, metavar="none|spur|mesh", help="Copper that holds pads under it.  [default: none]"
    ),
    _TapeOption(["--stiffener"], "stiffener", _same, metavar="MATERIAL:MM", help="Laminate a stiffener, such as FR4:0.2."),
    _TapeOption(["--adhesive"], "adhesive", _same, metavar="MATERIAL:MM", help="Laminate an adhesive tape, such as 3M468:0.13."),
    _TapeOption(["--bend-axis"], "bend_axis", _same, metavar="x|y", help="Board axis that goes round where the tape is bent."),
    _TapeOption(["--bend-radius"], "bend_radius_mm", length, metavar="MM", help="Radius that the tape is bent to."),
    _TapeOption(["--hole"], "holes_mm", holes, metavar="X,Y,D", multiple=True, help="Unplated hole, mm; may be repeated."),
    _TapeOption(
        ["--name"], "name", _same, metavar="NAME", help="Name of the tape and its files.  [default: tactape-s007 for sector 7]"
    ),
    _TapeOption(["--base"], "base_mm", length, metavar="MM", help="Base of the solid models.  [default: 0.8]"),
    _TapeOption(["--negative"], "negative", bool, is_flag=True, help="Solid models of the mould, whose cast is the texture."),
    _TapeOption(["--top"], "top", _same, metavar="tiles|single", help="Top face in the STEP solid.  [default: tiles]"),
    _TapeOption(["--cylinder"], "cylinder_mm", length, metavar="R", help="Wrap the solid models round a radius, mm."),
    _TapeOption(["--around"], "around", _same, metavar="x|y", help="Board axis that goes round the cylinder.  [default: x]"),
    _TapeOption(
        ["--shell"],
        "shell",
        _same,
        metavar="segment|whole",
        help="Base of a cylinder: the tape's, or closed.  [default: segment]",
    ),
    _TapeOption(["--no-3d"], "models", _off, is_flag=True, help="Leave the 3D models out."),
    _TapeOption(
        ["--no-mark"], "mark", _off, is_flag=True, help="Leave sector and arrow out of the back of block, dome and cone."
    ),
    _TapeOption(["--sim"], "sim", bool, is_flag=True, help="Add assets for simulators: MJCF, URDF, USD, glTF, a heightfield."),
)


PANEL_OPTIONS = (
    _TapeOption(
        ["--panel"],
        "panel",
        _same,
        metavar="auto|CxR|none",
        help="Put tapes on a panel, C columns and R rows.  [default: the profile's]",
    ),
    _TapeOption(["--sectors"], "sectors", _same, metavar="LIST", help="Sectors of a panel's tapes, such as 7,8,20-23."),
    _TapeOption(
        ["--same-sector"], "same_sector", bool, is_flag=True, help="All tapes of a panel show the sector: copies, not told apart."
    ),
    _TapeOption(
        ["--tabs"],
        "tabs",
        _same,
        metavar="auto|x|y|xy",
        help="Sides by which a panel holds its tapes.  [default: those with room]",
    ),
)
"""Options of a panel of tapes."""


def tape_options(command: F) -> F:
    """Add SPEC.toml and every option of a tape and a panel."""
    for option in reversed((*TAPE_OPTIONS, *PANEL_OPTIONS)):
        command.params.insert(0, option)  # type: ignore[attr-defined]
    command.params.insert(0, click.Argument(["spec_file"], required=False, metavar="[SPEC.toml]"))  # type: ignore[attr-defined]
    return command


def given_values(options: dict[str, Any]) -> dict[str, Any]:
    """The values of the options that were given."""
    return {
        o.name: o.read(options[o.name])
        for o in (*TAPE_OPTIONS, *PANEL_OPTIONS)
        if o.name is not None and options[o.name] not in (None, (), False)
    }


def spec_values(spec_file: str | None) -> dict[str, Any]:
    """The values of SPEC.toml; empty without one."""
    from tactape_fab.kit.spec.tape_list import read_list_file

    if spec_file is not None and spec_file.isdigit() and not Path(spec_file).exists():
        raise SpecError(Problem("sector", f"SPEC.toml = {spec_file} is no file; did you mean --sector {spec_file}?"))
    return read_list_file(Path(spec_file)) if spec_file is not None else {}


def is_list(values: dict[str, Any], given: dict[str, Any], avoid: Sequence[str] = (), *, alone: bool = False) -> bool:
    """Whether several tapes are asked for, each with its own kit; the tapes of a panel are one order.

    Sectors go on a panel where the fab's profile says so and they fill one, but with `alone`.
    """
    from tactape_fab.kit.examine.order import takes_panel
    from tactape_fab.kit.spec.tape_list import is_list as lists_tapes

    if {**values, **given}.get("panel", "none") != "none" or not lists_tapes(values, given):
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
    """One tape or panel examined; options that are for lists only (`of_lists`) are refused together with all other problems."""
    from tactape_fab.kit.examine.order import examine_order
    from tactape_fab.kit.examine.tape import examine
    from tactape_fab.kit.spec.panel_options import PANEL_KEYS
    from tactape_fab.texture.registry import read_tapes

    problems = [
        Problem(name, f"--{name} is for lists of tapes; give --sectors or [[tapes]], or leave it out")
        for name, value in (of_lists or {}).items()
        if value
    ]
    single = {**values, **given}
    if "sector" in given and "sectors" not in given:
        single.pop("sectors", None)
    try:
        tapes = read_tapes(avoid)
    except SpecError as refused:
        problems += refused.problems
    try:
        if problems:  # report all other problems, too
            of_one = {key: value for key, value in single.items() if key not in PANEL_KEYS}
            examine({"sector": 0, **of_one}, output=output, overwrite=overwrite)
        else:
            examined, remarks = examine_order(single, output=output, overwrite=overwrite, avoid=tapes)
    except SpecError as error:
        raise SpecError([*problems, *error.problems], error.findings) from None
    if problems:
        raise SpecError(problems)
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
