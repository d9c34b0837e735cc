"""Command line: parse, call one function, print. The only module that knows click."""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import click

from tactape_fab import __version__
from tactape_fab.console import (
    FixTable,
    check_lines,
    embossed_json,
    embossed_lines,
    finding_lines,
    fix_json,
    kit_json,
    kit_lines,
    panel_json,
    panel_lines,
    profile_lines,
    profiles_lines,
    remark_lines,
    rule_lines,
    simulated_line,
    summary_line,
)
from tactape_fab.errors import DesignRuleError, Finding, FrameError, Problem, SpecError, TactapeError, VerifyError

if TYPE_CHECKING:
    from tactape_fab.localize import Job, Locate, Located
    from tactape_fab.make import Examined
    from tactape_fab.make_panel import ExaminedPanel
    from tactape_fab.profiles.sensors import SensorProfile

FAILED, USAGE, RULES, VERIFICATION = 1, 2, 3, 4
"""Exit status besides 0: failure, a refused value, a broken design rule, a kit that is not what it should be."""

F = TypeVar("F", bound=Callable[..., Any])

_SENSOR_HELP = "Sensor profile, or a .toml file.  [default: gelsight-mini]"


# Option texts to values. What cannot be understood is passed on as it is: the one checker names it with all the rest.


def _number(text: str) -> Any:
    if "_" in text:
        return text
    for read in (int, float):
        try:
            return read(text)
        except ValueError:
            continue
    return text


def _length(text: str) -> Any:
    number = _number(text.strip().removesuffix("mm").rstrip())
    return text if isinstance(number, str) else number


def _lengths(text: str, separator: str) -> Any:
    return [_length(item) for item in text.split(separator)]


def _size(text: str) -> Any:
    return _lengths(text.replace("×", "x").replace("X", "x"), "x")


def _pair(text: str) -> Any:
    return [_number(item) for item in text.split(",")]


def _origin(text: str) -> Any:
    return text if text == "best" else _pair(text)


def _holes(texts: Sequence[str]) -> Any:
    return [_lengths(text, ",") for text in texts] or None


class _TapeOption(click.Option):
    """An option that stands for a key of the spec."""

    def __init__(self, declarations: Sequence[str], key: str, read: Callable[[Any], Any], **settings: Any) -> None:
        super().__init__([*declarations, key], **settings)
        self.read = read


def _same(text: str) -> str:
    return text


def _off(given: bool) -> bool:
    return not given


_TAPE_OPTIONS = (
    _TapeOption(["--sector"], "sector", _number, metavar="N", help="Sector of the code that the tape shows. Required."),
    _TapeOption(["--w"], "pitch_mm", _length, metavar="MM", help="Grid pitch W.  [default: 1.5]"),
    _TapeOption(["--delta"], "displacement_mm", _length, metavar="MM", help="Displacement Δ of each part.  [default: W/6]"),
    _TapeOption(["--size"], "size_mm", _size, metavar="WxH", help="Outline, mm.  [default: 100x50]"),
    _TapeOption(["--code"], "code", _same, metavar="NAME", help="microdots-4x4 (default), debruijn-4x4 or anoto-6x6."),
    _TapeOption(
        ["--origin"],
        "origin",
        _origin,
        metavar="COL,ROW|best",
        help="Place of grid point 0,0 in the code plane, or search for the best.  [default: the sector's]",
    ),
    _TapeOption(["--tag"], "tag", _same, metavar="strip|none", help="Strip with AprilTag and label, or none.  [default: strip]"),
    _TapeOption(["--tag-id"], "tag_id", _number, metavar="ID", help="Id of the AprilTag.  [default: the sector]"),
    _TapeOption(["--tag-cell"], "tag_cell_mm", _length, metavar="MM", help="Side of a cell of the AprilTag.  [default: 0.5]"),
    _TapeOption(
        ["--part"],
        "part",
        _same,
        metavar="NAME",
        help="Part profile, or a .toml file; block, dome, cone are for printing and milling.  [default: r0201]",
    ),
    _TapeOption(["--body"], "body_mm", _size, metavar="LxWxH", help="Size of block, dome or cone; of the round ones DxH."),
    _TapeOption(["--dome-top"], "dome_top_mm", _length, metavar="MM", help="Diameter of a dome's flat top."),
    _TapeOption(["--rotation"], "rotation_deg", _number, metavar="DEG", help="Rotation of every part.  [default: 45]"),
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
        ["--corner-radius"], "corner_radius_mm", _length, metavar="MM", help="Corner radius of the outline.  [default: 1]"
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
    _TapeOption(["--bend-radius"], "bend_radius_mm", _length, metavar="MM", help="Radius that the tape is bent to."),
    _TapeOption(["--hole"], "holes_mm", _holes, metavar="X,Y,D", multiple=True, help="Unplated hole, mm; may be repeated."),
    _TapeOption(
        ["--name"], "name", _same, metavar="NAME", help="Name of the tape and its files.  [default: tactape-s007 for sector 7]"
    ),
    _TapeOption(["--base"], "base_mm", _length, metavar="MM", help="Base of the solid models.  [default: 0.8]"),
    _TapeOption(["--negative"], "negative", bool, is_flag=True, help="Solid models of the mould, whose cast is the texture."),
    _TapeOption(["--top"], "top", _same, metavar="tiles|single", help="Top face in the STEP solid.  [default: tiles]"),
    _TapeOption(["--cylinder"], "cylinder_mm", _length, metavar="R", help="Wrap the solid models round a radius, mm."),
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


_PANEL_OPTIONS = (
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


def _tape_options(command: F) -> F:
    """Add SPEC.toml and every option of a tape and a panel."""
    for option in reversed((*_TAPE_OPTIONS, *_PANEL_OPTIONS)):
        command.params.insert(0, option)  # type: ignore[attr-defined]
    command.params.insert(0, click.Argument(["spec_file"], required=False, metavar="[SPEC.toml]"))  # type: ignore[attr-defined]
    return command


def _given(options: dict[str, Any]) -> dict[str, Any]:
    """The values of the options that were given."""
    return {
        o.name: o.read(options[o.name])
        for o in (*_TAPE_OPTIONS, *_PANEL_OPTIONS)
        if o.name is not None and options[o.name] not in (None, (), False)
    }


def _values(spec_file: str | None) -> dict[str, Any]:
    from tactape_fab.kit.tape_list import read_list_file

    return read_list_file(Path(spec_file)) if spec_file is not None else {}


def _examined(
    values: dict[str, Any],
    given: dict[str, Any],
    avoid: Sequence[str] = (),
    of_lists: Mapping[str, object] | None = None,
    *,
    output: str | None = None,
    overwrite: bool = False,
) -> Examined | ExaminedPanel:
    """One tape or panel examined; options that only a list of tapes has are refused with all the rest."""
    from tactape_fab.kit.panel_options import PANEL_KEYS
    from tactape_fab.make import examine_values
    from tactape_fab.make_panel import examine_order
    from tactape_fab.tapes import read_tapes

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
    _echo_lines_err(remarks)
    return examined


# Printing


def _fail(status: int, lines: Sequence[str]) -> NoReturn:
    for line in lines:
        click.echo(f"error: {line}", err=True)
    sys.exit(status)


def _answer(error: TactapeError) -> tuple[int, list[str]]:
    """Exit status and messages of what the package raises."""
    match error:
        case SpecError():
            return USAGE, [*(p.message for p in error.problems), *rule_lines(error.findings)]
        case DesignRuleError():
            return RULES, rule_lines(error.findings)
        case VerifyError():
            return VERIFICATION, [f"{c.name}: {c.message}" for c in error.checks if not c.passed and not c.warning]
    return USAGE if isinstance(error, FrameError) else FAILED, str(error).splitlines()


@contextmanager
def _answers() -> Iterator[None]:
    """Turn what the package raises into messages and an exit status."""
    try:
        yield
    except TactapeError as error:
        _fail(*_answer(error))


def _echo_json(content: Any) -> None:
    click.echo(json.dumps(content, indent=1, ensure_ascii=True))


def _warn(findings: Sequence[Finding]) -> None:
    for finding in findings:
        if finding.level == "warn" and not finding.passed:
            click.echo(f"warning: {finding.rule}: {finding.message}", err=True)


def _say_rules(findings: Sequence[Finding], *, force: bool) -> None:
    """Warnings, and what is made in spite of the rules."""
    _warn(findings)
    if force:
        _echo_lines_err(f"forced: {line}" for line in rule_lines(findings))


def _echo_lines(lines: Iterable[str]) -> None:
    for line in lines:
        click.echo(line)


def _echo_lines_err(lines: Iterable[str]) -> None:
    for line in lines:
        click.echo(line, err=True)


# Commands


class _Group(click.Group):
    """The group of commands; names of files may hold what an ASCII terminal cannot show."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
        return super().main(*args, **kwargs)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="tactape-fab")
def main() -> None:
    """Make tactile fiducial tapes that a PCB fab can build, and prove them from the written files."""


_avoid_option = click.option(
    "--avoid",
    metavar="KITS",
    multiple=True,
    help="Choose the origin, and the sector if none is given, far from these kits; may be repeated.",
)


@_tape_options
@main.command()
@_avoid_option
@click.option("--pack", is_flag=True, help="Lay the tapes of a list out on the fab's largest panels, and say how full they are.")
@click.option("--jobs", metavar="N", help="Processes that make the kits of a list.  [default: one per processor]")
@click.option(
    "-o",
    "--output",
    metavar="DIR",
    help="Folder of the kit, or of the kits of a list.  [default: the tape's name, or tactape-kits]",
)
@click.option("--overwrite", is_flag=True, help="Replace older kits of this tool.")
@click.option("--no-verify", is_flag=True, help="Do not read the written files back.")
@click.option("--force", is_flag=True, help="Write the kit in spite of broken design rules; the manifest records them.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def make(
    spec_file: str | None,
    avoid: Sequence[str],
    pack: bool,
    jobs: str | None,
    output: str | None,
    overwrite: bool,
    no_verify: bool,
    force: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Write a tape's kit: everything that fab and assembly line need, or printer and mill, verified from the written files.

    With --sectors, or a SPEC.toml with [[tapes]], a kit for each tape of the list.

    \b
    Examples: tactape-fab make --sector 7 --w 1.5 --delta 0.25
              tactape-fab make --sectors 7,8,9 --panel auto
              tactape-fab make --sector 7 --part dome --process sla
              tactape-fab make --sectors 0-9,20 --no-3d -o lab
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # a polite end leaves nothing behind
    with _answers():
        from tactape_fab.make import Examined, make_examined
        from tactape_fab.make_panel import make_panel

        values, given = _values(spec_file), _given(options)
        if _is_list(values, given, avoid):
            settings = {"overwrite": overwrite, "verify": not no_verify, "force": force}
            _make_list(values, given, output, settings, pack=pack, jobs=jobs, as_json=as_json)
            return
        examined = _examined(values, given, avoid, {"pack": pack, "jobs": jobs}, output=output, overwrite=overwrite)
        _say_rules(examined.findings, force=force)
        how: dict[str, Any] = {
            "overwrite": overwrite,
            "verify": not no_verify,
            "force": force,
            "progress": lambda text: (
                click.echo(f"{text} ...", err=True) if sys.stderr is not None and sys.stderr.isatty() else None
            ),
        }
        if isinstance(examined, Examined):
            kit = make_examined(examined, output, **how)
            _echo_json(kit_json(kit)) if as_json else _echo_lines(kit_lines(kit))
        else:
            panel = make_panel(examined, output, **how)
            _echo_json(panel_json(panel)) if as_json else _echo_lines(panel_lines(panel))


def _is_list(values: dict[str, Any], given: dict[str, Any], avoid: Sequence[str] = ()) -> bool:
    """Whether several tapes are asked for, each with a kit of its own; a panel is one thing, whatever stands on it."""
    from tactape_fab.kit.tape_list import is_list

    if {**values, **given}.get("panel", "none") != "none" or not is_list(values, given):
        return False
    if avoid:
        raise SpecError(Problem("avoid", "avoid cannot be used with a list of tapes; make them one by one, or leave --avoid out"))
    for of in (values, given):
        of.pop("panel", None)
    return True


def _make_list(
    values: dict[str, Any],
    given: dict[str, Any],
    output: str | None,
    settings: dict[str, bool],
    *,
    pack: bool,
    jobs: str | None,
    as_json: bool,
) -> None:
    """Make the kits of a list: a row for each, errors of one beside it; the exit status is the highest of all."""
    from tactape_fab.list_tapes import list_tapes
    from tactape_fab.make_many import DEFAULT_FOLDER, FailedKit, make_kits, pack_tapes
    from tactape_fab.many_lines import KitTable, failed_json, made_json, many_summary, packed_json, packed_lines

    folder = Path(DEFAULT_FOLDER if output is None else output)
    count = None if jobs is None else _number(jobs)
    overwrite, force = settings["overwrite"], settings["force"]
    listed = list_tapes(values, given, folder, jobs=count, overwrite=overwrite, force=force, packed=pack)
    _say_rules(listed.findings, force=force)
    packed = pack_tapes(listed.tapes) if pack else []
    table, begin = KitTable(listed.tapes), time.monotonic()
    rows_shown = not as_json and sys.stdout is not None and sys.stdout.isatty()
    show = (lambda *_: None) if rows_shown else _step_shown()  # rows are progress enough
    made, failed, statuses = [], [], [0]
    _echo_lines([] if as_json else [table.header()])
    try:
        with closing(make_kits(listed.tapes, folder, jobs=listed.jobs, **settings)) as kits:
            for done, (kit, tape) in enumerate(zip(kits, listed.tapes, strict=True), start=1):
                if isinstance(kit, FailedKit):
                    status, lines = _answer(kit.error)
                    statuses.append(status)
                    failed.append(failed_json(kit, status, lines))
                    _clear_step()
                    _echo_lines_err(f"error: {kit.name}: {line}" for line in lines)
                else:
                    made.append(made_json(kit))
                _echo_lines([] if as_json else [table.row(kit, tape)])
                show("kits", done, len(listed.tapes))
    except (KeyboardInterrupt, SystemExit):
        click.echo(f"stopped; the kits that stand in {folder} are whole", err=True)
        raise
    if as_json:
        _echo_json({"folder": str(folder), "kits": made, "failed": failed, **({"packed": packed_json(packed)} if pack else {})})
    else:
        _echo_lines(packed_lines(packed))
    click.echo(many_summary(len(made), len(listed.tapes), folder, time.monotonic() - begin), err=True)
    sys.exit(max(statuses))


@_tape_options
@main.command()
@_avoid_option
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def check(spec_file: str | None, avoid: Sequence[str], as_json: bool, **options: Any) -> None:
    """Measure a tape against the design rules of its fab or process; nothing is written."""
    with _answers():
        values, given = _values(spec_file), _given(options)
        if _is_list(values, given):
            what = "sectors names" if spec_file is None else f"{spec_file} is"
            raise SpecError(f"{what} a list of tapes; check takes one, make checks them all before it writes any")
        findings = _examined(values, given, avoid).findings
        if as_json:
            _echo_json([asdict(f) for f in findings])
        else:
            _echo_lines(finding_lines(findings))
            _echo_lines_err(f"note: {line}" for line in remark_lines(findings))
            _warn(findings)
        if any(f.blocks for f in findings):
            raise DesignRuleError(findings)


@main.command()
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def profiles(name: str | None, as_json: bool) -> None:
    """List the fab profiles, or explain one: its thresholds, and where each comes from. NAME may be a .toml file of yours."""
    with _answers():
        from tactape_fab.profiles import explain_fab, load_fab, profile_names

        fabs = [load_fab(known) for known in (profile_names("fabs") if name is None else [name])]
        if as_json:
            _echo_json([explain_fab(fab) for fab in fabs] if name is None else explain_fab(fabs[0]))
        else:
            _echo_lines(profiles_lines(fabs) if name is None else profile_lines(explain_fab(fabs[0])))


@main.command()
@click.argument("kit")
@click.argument("surface")
@click.option("--at", metavar="X,Y,Z", help="Point of the surface under the middle of the texture, mm.")
@click.option("--up", metavar="X,Y,Z", help="Direction of board +y there.  [default: +z, or +y on a level surface]")
@click.option("--face", metavar="N", help="Face of a STEP solid, from 0.  [default: the one at the point, or the largest]")
@click.option("--unit", metavar="mm|cm|m|inch", default="mm", help="Unit of an STL, OBJ or PLY file.  [default: mm]")
@click.option("-o", "--output", metavar="DIR", help="Folder of the result.  [default: beside the part]")
@click.option("--overwrite", is_flag=True, help="Replace an older result of this tool.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def emboss(kit: str, surface: str, unit: str, output: str | None, overwrite: bool, as_json: bool, **place: str | None) -> None:
    """Put a kit's texture on a part of yours: SURFACE is an STL, 3MF, OBJ, PLY or STEP file.

    \b
    Example: tactape-fab emboss tactape-s007 handle.stl --at 0,0,25
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    with _answers():
        from tactape_fab.emboss import emboss_kit
        from tactape_fab.solids.charts import read_placement

        given = {"at_mm": place["at"], "up": place["up"], "face": place["face"]}
        placement = read_placement(
            {key: _number(text) if key == "face" else _pair(text) for key, text in given.items() if text is not None}
        )
        made = emboss_kit(kit, surface, output, placement=placement, overwrite=overwrite, unit=unit, progress=_step_shown())
        _echo_json(embossed_json(made)) if as_json else _echo_lines(embossed_lines(made))


def _clear_step() -> None:
    """Take progress off the line of the terminal that a message is to stand on."""
    if sys.stderr is not None and sys.stderr.isatty():
        click.echo("\r\033[K", err=True, nl=False)


def _step_shown() -> Callable[[str, int, int], None]:
    """Progress as one line of a terminal, written over; nothing elsewhere."""
    if sys.stderr is None or not sys.stderr.isatty():
        return lambda *_: None
    return lambda text, done, count: click.echo(f"\r{text} {done} of {count}\033[K", err=True, nl=done == count)


@main.command()
@click.argument("kit")
@click.option("--quick", is_flag=True, help="Leave out CAD kernels, other programs, the second tag detector; few contacts.")
@click.option(
    "--contact", metavar="AxB|pad", help="Axes of the contacts that are decoded, mm, or the whole field.  [default: 11x9]"
)
@click.option("--sensor", metavar="NAME", help=_SENSOR_HELP)
@click.option("--map", "map_file", metavar="FILE.png", help="Write a picture of where contacts can be located on the tape.")
@click.option("--json", "as_json", is_flag=True, help="Print the checks as JSON.")
def verify(kit: str, quick: bool, contact: str | None, sensor: str | None, map_file: str | None, as_json: bool) -> None:
    """Read a written kit back with software that is not ours, and decode contacts of the parts that it places.

    \b
    Example: tactape-fab verify tactape-s007 --contact 6x6 --map map.png
    """
    with _answers():
        from tactape_fab.verify_file import verify_file

        size = None if contact is None else _contact(contact)
        verification = verify_file(kit, quick=quick, size=size, sensor=sensor, map_file=map_file, progress=_step_shown())
        if as_json:
            _echo_json(
                {"name": verification.name, "passed": verification.passed, "checks": [asdict(c) for c in verification.checks]}
            )
        else:
            _echo_lines(check_lines(verification.checks))
        verification.raise_if_failed()
        click.echo(f"verified: {len(verification.checks)} checks of the written files", err=True)


# What windows can tell apart


@main.command()
@click.argument("kits", nargs=-1, metavar="KITS...")
@click.option("--code", metavar="NAME", help="Without kits: the tapes of this code's sectors, as make would make them.")
@click.option("--size", "size_mm", metavar="WxH", help="Outline of the tapes of --code, mm.  [default: 100x50]")
@click.option("--picture", metavar="FILE.png", help="Write a map of the tape, or of several the distances of every two.")
@click.option("--json", "as_json", is_flag=True, help="Print the certificates as JSON.")
def certify(kits: Sequence[str], code: str | None, size_mm: str | None, picture: str | None, as_json: bool) -> None:
    """Say what every 4x4, 5x5 and 6x6 window of these tapes can tell apart: kits, manifests, or folders of kits.

    \b
    Example: tactape-fab certify tactape-s007 --picture windows.png
    """
    with _answers():
        from tactape_fab.certified import certified, tapes_to_certify
        from tactape_fab.certify_lines import certified_lines

        given = {"code": code, "size_mm": None if size_mm is None else _size(size_mm)}
        options = {key: value for key, value in given.items() if value is not None}
        result = certified(*tapes_to_certify(kits, options), _step_shown())
        _echo_json(result.to_mapping()) if as_json else _echo_lines(certified_lines(result))
        if picture is not None:
            from tactape_fab.certify_picture import draw_certified, write_picture

            write_picture(Path(picture), draw_certified(result))


@main.command()
@click.argument("kits", nargs=-1, required=True, metavar="KITS...")
@click.option("--json", "as_json", is_flag=True, help="Print the registry as JSON.")
def registry(kits: Sequence[str], as_json: bool) -> None:
    """List tapes, their conflicts, and how far every two of them are apart: kits, manifests, or folders of kits.

    \b
    Example: tactape-fab registry tapes
    """
    with _answers():
        from tactape_fab.certified import registry as read_registry
        from tactape_fab.certify_lines import registry_lines

        result = read_registry(kits, _step_shown())
        _echo_json(result.to_mapping()) if as_json else _echo_lines(registry_lines(result))


# Localization


@main.command()
@click.argument("kit")
@click.option("-o", "--output", metavar="FRAMES.npz", required=True, help="File of the frames.")
@click.option("--count", metavar="N", default="1", help="Number of frames.  [default: 1]")
@click.option("--seed", metavar="S", default="0", help="Of poses, noise and defects; equal seeds give equal bytes.  [default: 0]")
@click.option("--pose", metavar="X,Y,THETA", help="Pose of every frame, mm and degrees.  [default: spread over the tape]")
@click.option("--edge", is_flag=True, help="Spread the poses along the edge of the texture instead.")
@click.option("--sensor", metavar="NAME", default="gelsight-mini", help=_SENSOR_HELP)
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
    with _answers():
        from tactape_fab.simulate_file import simulate_file

        places = {"contact": _contact, "cylinder": _length, "placement": _length, "elastomer": _length}
        options = {name: places.get(name, _number)(text) for name, text in given.items() if text is not None}
        made = simulate_file(
            kit,
            output,
            sensor=sensor,
            pose=None if pose is None else _pair(pose),
            edge=edge,
            from_cpl=from_cpl,
            progress=_step_shown(),
            **options,
        )
        click.echo(simulated_line(made.path, made.count, made.frame_shape, made.tape, made.sensor))


def _contact(text: str) -> Any:
    """Both axes, or the name; what has not two parts is passed on as it is."""
    axes = _size(text)
    return axes if len(axes) == 2 else text


@main.command()
@click.argument("frames", nargs=-1, metavar="FRAMES...")
@click.option("--tape", "kits", multiple=True, metavar="KIT...", help="Kits that can be touched, or a folder of kits.")
@click.option("--code", metavar="NAME", help="Without --tape: the code alone; it asks for many more dots.")
@click.option("--w", metavar="MM", help="Grid pitch W of --code.  [default: 1.5]")
@click.option("--delta", metavar="MM", help="Displacement Δ of --code.  [default: W/6]")
@click.option("--sensor", metavar="NAME|FILE.toml", default="gelsight-mini", help=_SENSOR_HELP)
@click.option("--method", metavar="ml|paper", default="ml", help="How frames are located.  [default: ml]")
@click.option("--world", metavar="open|closed", help="Whether tapes that are not named may be touched, too.  [default: open]")
@click.option("--max-p-false", metavar="P", help="Largest chance of a wrong answer.  [default: 1e-4]")
@click.option("--max-p-tape", metavar="P", help="Largest chance that it is no tape of ours.  [default: within --max-p-false]")
@click.option("--fixed-scale", is_flag=True, help="Take px/mm as it is instead of refining it from the frame.")
@click.option("--overlay", metavar="DIR", help="Write a picture of every frame: dots, grid, axes.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per frame.")
def decode(frames: Sequence[str], kits: Sequence[str], sensor: str, overlay: str | None, as_json: bool, **given: Any) -> None:
    """Locate contacts: which tape each frame touches, where and at what angle, or why that cannot be said.

    FRAMES are .npz (array depth), .npy, or 16-bit .png and .tif.

    \b
    Example: tactape-fab decode frames.npz --tape tactape-s007
    """
    with _answers():
        from tactape_fab.localize import is_kit, localize, prepare

        if kits:  # --tape A B, as a shell would have it
            kits = [*kits, *(f for f in frames if is_kit(f))]
            frames = [f for f in frames if not is_kit(f)]
        reads = {"w": _length, "delta": _length, "max_p_false": _number, "max_p_tape": _number}
        options = {name: reads[name](v) if name in reads and v is not None else v for name, v in given.items()}
        job = prepare(frames, kits, sensor, **options)
        _print_answers(localize(job, _with_a_word), job, as_json=as_json, overlay=overlay)


def _with_a_word(job: Job, sensor: SensorProfile) -> Locate:
    """The locator, with a word on stderr where getting ready takes long: the first time, something is compiled."""
    from tactape_fab.localize import make_locator

    word = threading.Timer(2.0, lambda: click.echo("getting the decoder ready, which takes longest the first time ...", err=True))
    word.daemon = True
    word.start()
    try:
        return make_locator(job, sensor)
    finally:
        word.cancel()


def _print_answers(answers: Iterator[Located], job: Job, *, as_json: bool, overlay: str | None) -> None:
    from tactape_fab.overlay import draw_overlay, write_overlay

    table = FixTable(job.tapes)
    count = sum(file.count for file in job.files)
    show = _step_shown() if sys.stdout is not None and not sys.stdout.isatty() else lambda *_: None  # rows are progress enough
    located, elapsed_ms = 0, []
    for answer in answers:
        fix = answer.fix
        if as_json:
            click.echo(json.dumps(fix_json(answer.frame, fix), allow_nan=False))
        else:
            _echo_lines([table.header()] * (answer.frame == 0) + [table.row(answer.frame, fix)])
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
