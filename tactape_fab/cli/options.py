"""Options that several commands share, and how their texts become values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.cli.printing import echo_lines_err

if TYPE_CHECKING:
    from tactape_fab.kit.examine.order import ExaminedPanel
    from tactape_fab.kit.examine.tape import Examined
    from tactape_fab.sense.objects.taped_object import TapedObject

F = TypeVar("F", bound=Callable[..., Any])

SENSOR_HELP = "Sensor profile, or a .toml file.  [default: gelsight-mini]"


# Texts to values. A text that cannot be read is passed on as it is: whoever checks the values names it with all others.


def number(text: str) -> Any:
    if "_" in text:
        return text
    for read in (int, float):
        try:
            return read(text)
        except ValueError:
            continue
    return text


def length(text: str) -> Any:
    found = number(text.strip().removesuffix("mm").rstrip())
    return text if isinstance(found, str) else found


def lengths(text: str, separator: str) -> Any:
    return [length(item) for item in text.split(separator)]


def size(text: str) -> Any:
    return lengths(text.replace("×", "x").replace("X", "x"), "x")


def contact_size(text: str) -> Any:
    """Both axes, or the name; a text that has not two parts is passed on as it is."""
    axes = size(text)
    return axes if len(axes) == 2 else text


def pair(text: str) -> Any:
    return [number(item) for item in text.split(",")]


def origin(text: str) -> Any:
    return text if text == "best" else pair(text)


def holes(texts: Sequence[str]) -> Any:
    return [lengths(text, ",") for text in texts] or None


class _TapeOption(click.Option):
    """An option that stands for a key of the spec."""

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
    _TapeOption(["--code"], "code", _same, metavar="NAME", help="microdots-4x4 (default), debruijn-4x4, anoto-6x6 or touch-1."),
    _TapeOption(
        ["--directions"],
        "directions",
        number,
        metavar="4|8",
        help="Directions that parts are displaced in; 8 of touch-1, for printed elements.  [default: 4]",
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
    """The values of SPEC.toml; none without one."""
    from tactape_fab.kit.spec.tape_list import read_list_file

    return read_list_file(Path(spec_file)) if spec_file is not None else {}


def is_list(values: dict[str, Any], given: dict[str, Any], avoid: Sequence[str] = ()) -> bool:
    """Whether several tapes are asked for, each with a kit of its own; the tapes of a panel are one order."""
    from tactape_fab.kit.spec.tape_list import is_list as lists_tapes

    if {**values, **given}.get("panel", "none") != "none" or not lists_tapes(values, given):
        return False
    if avoid:
        raise SpecError(Problem("avoid", "avoid cannot be used with a list of tapes; make them one by one, or leave --avoid out"))
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
    overwrite: bool = False,
) -> Examined | ExaminedPanel:
    """One tape or panel examined; options that are for lists only (`of_lists`) are refused together with all other problems."""
    from tactape_fab.kit.examine.order import examine_order
    from tactape_fab.kit.examine.values import examine_values
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
        if problems:  # say what else is refused, too
            of_one = {key: value for key, value in single.items() if key not in PANEL_KEYS}
            examine_values({"sector": 0, **of_one}, output=output, overwrite=overwrite)
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


# Options of commands that locate


_LOCATING_OPTIONS = (
    click.option("--tape", "kits", multiple=True, metavar="KIT...", help="Kits that can be touched, or a folder of kits."),
    click.option("--code", metavar="CODE", help="Without --tape: the code alone; it asks for many more dots."),
    click.option("--w", metavar="MM", help="Grid pitch W of --code.  [default: 1.5]"),
    click.option("--delta", metavar="MM", help="Displacement Δ of --code.  [default: W/6]"),
    click.option("--sensor", metavar="NAME|FILE.toml", default="gelsight-mini", help=SENSOR_HELP),
    click.option("--method", metavar="ml|paper", default="ml", help="How frames are located.  [default: ml]"),
    click.option("--world", metavar="open|closed", help="Whether tapes that are not named may be touched, too.  [default: open]"),
    click.option("--max-p-false", metavar="P", help="Largest chance of a wrong answer.  [default: 1e-4]"),
    click.option("--max-p-tape", metavar="P", help="Largest chance that it is no tape of ours.  [default: within --max-p-false]"),
    click.option("--fixed-scale", is_flag=True, help="Take px/mm as it is instead of refining it from the frame."),
    click.option("--object", "object_file", metavar="FILE.toml", help="The tapes of an object; answers in its frame, too."),
)
_LOCATING_TEXTS: dict[str, Callable[[str], Any]] = {
    "w": length,
    "delta": length,
    "max_p_false": number,
    "max_p_tape": number,
}


def locating_options(command: F) -> F:
    """Add the options of a command that locates: registry, sensor, method and limits."""
    for option in reversed(_LOCATING_OPTIONS):
        command = option(command)
    return command


def locating_values(given: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a job (`sense.files.jobs.prepare`) from option texts; None where an option is not given."""
    names = ("code", "w", "delta", "method", "world", "max_p_false", "max_p_tape", "fixed_scale")
    return {n: given[n] if given[n] is None else _LOCATING_TEXTS.get(n, _same)(given[n]) for n in names}


def named_object(file: str | None, settings: Mapping[str, Any]) -> TapedObject | None:
    """The object that --object names; how well measured corners of its tags fit is printed.

    An object's kits say code, W and Δ: those options beside it are refused.
    """
    if file is None:
        return None
    from tactape_fab.sense.objects.taped_object import read_object

    bare = [f"--{name}" for name in ("code", "w", "delta") if settings.get(name) is not None]
    if bare:
        message = f"{', '.join(bare)} and --object are given, but an object's kits say all of it; give either"
        raise SpecError(Problem("object", message))
    thing = read_object(file)
    echo_lines_err(
        f"{entry.tape.name} on {thing.name}: the tag's corners fit within {entry.misfit_mm:.3f} mm (rms)"
        for entry in thing.tapes
        if entry.misfit_mm is not None
    )
    return thing
