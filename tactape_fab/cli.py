"""Command line: parse, call one function, print. The only module that knows click."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

import click

from tactape_fab import __version__
from tactape_fab.errors import Check, DesignRuleError, Finding, SpecError, TactapeError, VerifyError

if TYPE_CHECKING:
    from tactape_fab.emboss import Embossed
    from tactape_fab.make import Examined, Kit

FAILED, USAGE, RULES, VERIFICATION = 1, 2, 3, 4
"""Exit status besides 0: failure, a refused value, a broken design rule, a kit that is not what it should be."""

F = TypeVar("F", bound=Callable[..., Any])


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
        _pair,
        metavar="COL,ROW",
        help="Place of grid point 0,0 in the code plane.  [default: the sector's]",
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
        ["--assembly"], "assembly", _same, metavar="generic|jlcpcb", help="Columns of the BOM.  [default: the profile's]"
    ),
    _TapeOption(["--x2"], "x2", _same, metavar="full|comments|off", help="Gerber attributes.  [default: the profile's]"),
    _TapeOption(
        ["--corner-radius"], "corner_radius_mm", _length, metavar="MM", help="Corner radius of the outline.  [default: 1]"
    ),
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


def _tape_options(command: F) -> F:
    """Add SPEC.toml and every option of the spec."""
    for option in reversed(_TAPE_OPTIONS):
        command.params.insert(0, option)  # type: ignore[attr-defined]
    command.params.insert(0, click.Argument(["spec_file"], required=False, metavar="[SPEC.toml]"))  # type: ignore[attr-defined]
    return command


def _examined(spec_file: str | None, options: dict[str, Any], *, output: str | None = None, overwrite: bool = False) -> Examined:
    from tactape_fab.kit.spec import read_spec_file
    from tactape_fab.make import examine_values

    values = read_spec_file(Path(spec_file)) if spec_file is not None else {}
    given = {
        o.name: o.read(options[o.name]) for o in _TAPE_OPTIONS if o.name is not None and options[o.name] not in (None, (), False)
    }
    return examine_values({**values, **given}, output=output, overwrite=overwrite)


# Printing


def _fail(status: int, lines: Sequence[str]) -> NoReturn:
    for line in lines:
        click.echo(f"error: {line}", err=True)
    sys.exit(status)


def _rule_lines(findings: Sequence[Finding]) -> list[str]:
    return [f"{f.rule}: {f.message}{_at(f)}" for f in findings if f.blocks]


def _at(finding: Finding) -> str:
    return "" if finding.at_mm is None else f" (at {finding.at_mm[0]:.2f}, {finding.at_mm[1]:.2f} mm)"


@contextmanager
def _answers() -> Iterator[None]:
    """Turn what the package raises into messages and an exit status."""
    try:
        yield
    except SpecError as error:
        _fail(USAGE, [*(p.message for p in error.problems), *_rule_lines(error.findings)])
    except DesignRuleError as error:
        _fail(RULES, _rule_lines(error.findings))
    except VerifyError as error:
        _fail(VERIFICATION, [f"{c.name}: {c.message}" for c in error.checks if not c.passed and not c.warning])
    except TactapeError as error:
        _fail(FAILED, str(error).splitlines())


def _echo_json(content: Any) -> None:
    click.echo(json.dumps(content, indent=1, ensure_ascii=True))


def _warn(findings: Sequence[Finding]) -> None:
    for finding in findings:
        if finding.level == "warn" and not finding.passed:
            click.echo(f"warning: {finding.rule}: {finding.message}", err=True)


def _finding_row(finding: Finding) -> tuple[str, ...]:
    verdict = "ok" if finding.passed else finding.level
    value = "" if finding.value is None else f"{finding.value:.3f}"
    limit = "" if finding.limit is None else f"{finding.limit:.3f}"
    at = "" if finding.at_mm is None else f"{finding.at_mm[0]:.2f}, {finding.at_mm[1]:.2f}"
    return finding.rule, verdict, value, limit, at


def _echo_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    for row in [header, *rows]:
        click.echo("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def _echo_checks(checks: Sequence[Check]) -> None:
    width = max(len(c.name) for c in checks)
    for c in checks:
        verdict = "ok  " if c.passed else "warn" if c.warning else "FAIL"
        click.echo(f"{verdict}  {c.name.ljust(width)}  {c.message}")


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


@_tape_options
@main.command()
@click.option("-o", "--output", metavar="DIR", help="Folder of the kit.  [default: the tape's name]")
@click.option("--overwrite", is_flag=True, help="Replace an older kit of this tool.")
@click.option("--no-verify", is_flag=True, help="Do not read the written files back.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def make(spec_file: str | None, output: str | None, overwrite: bool, no_verify: bool, as_json: bool, **options: Any) -> None:
    """Write a tape's kit: everything that fab and assembly line need, or printer and mill, verified from the written files.

    \b
    Examples: tactape-fab make --sector 7 --w 1.5 --delta 0.25
              tactape-fab make --sector 7 --part dome --process sla
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # a polite end leaves nothing behind
    with _answers():
        from tactape_fab.make import make_examined

        examined = _examined(spec_file, options, output=output, overwrite=overwrite)
        _warn(examined.findings)
        kit = make_examined(
            examined,
            output,
            overwrite=overwrite,
            verify=not no_verify,
            progress=lambda text: click.echo(f"{text} ...", err=True) if sys.stderr is not None and sys.stderr.isatty() else None,
        )
        _echo_json(_kit_json(kit)) if as_json else _echo_kit(kit)


def _kit_json(kit: Kit) -> dict[str, Any]:
    tape = kit.tape
    return {
        "path": str(kit.path),
        "name": tape.name,
        "sector": tape.sector,
        "code": tape.code,
        "origin": list(tape.origin),
        "columns": tape.columns,
        "rows": tape.rows,
        "parts": tape.part_count,
        "files": dict(kit.files),
        "findings": [asdict(f) for f in kit.findings],
        "checks": [asdict(c) for c in kit.checks],
    }


_PURPOSES = (
    ("for the fab", ("fab-zip",)),
    ("for assembly", ("cpl", "bom")),
    ("for CAD and milling", ("step-assembly", "step-solid")),
    ("for printing", ("stl", "3mf")),
)
"""What a user does with which files, in the order in which make names them."""


def _echo_kit(kit: Kit) -> None:
    tape = kit.tape
    width, height = tape.board.size_mm
    click.echo(
        f"{kit.path}: {tape.part_count} parts on {tape.columns} x {tape.rows} grid points, board {width:g} x {height:g} mm"
    )
    click.echo(
        f"sector {tape.sector} of {tape.code} at origin {tape.origin[0]},{tape.origin[1]}; "
        f"pitch {tape.pitch_mm:g} mm, displacement {tape.displacement_mm:g} mm"
    )
    click.echo(f"verified: {len(kit.checks)} checks of the written files" if kit.checks else "not verified")
    for purpose, roles in _PURPOSES:
        paths = [str(kit.path / kit.files[role]) for role in roles if role in kit.files]
        if paths:
            click.echo(f"{purpose}: {', '.join(paths)}")


@_tape_options
@main.command()
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def check(spec_file: str | None, as_json: bool, **options: Any) -> None:
    """Measure a tape against the design rules of its fab or process; nothing is written."""
    with _answers():
        findings = _examined(spec_file, options).findings
        if as_json:
            _echo_json([asdict(f) for f in findings])
        else:
            _echo_table(("rule", "verdict", "measured mm", "limit mm", "at x, y mm"), [_finding_row(f) for f in findings])
            _warn(findings)
        if any(f.blocks for f in findings):
            raise DesignRuleError(findings)


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
        if as_json:
            _echo_json(
                {
                    "path": str(made.path),
                    "name": made.tape.name,
                    "surface": dict(made.surface),
                    "files": dict(made.files),
                    "checks": [asdict(c) for c in made.checks],
                }
            )
        else:
            _echo_embossed(made)


def _step_shown() -> Callable[[str, int, int], None]:
    """Progress as one line of a terminal, written over; nothing elsewhere."""
    if sys.stderr is None or not sys.stderr.isatty():
        return lambda *_: None
    return lambda text, done, count: click.echo(f"\r{text} {done} of {count}\033[K", err=True, nl=done == count)


def _echo_embossed(made: Embossed) -> None:
    surface, distortion = made.surface, made.surface["distortion"]
    centre = ", ".join(f"{v:.3f}" for v in surface["centre_mm"])
    click.echo(f"{made.path}: {made.tape.part_count} elements of {made.tape.name} on {surface['source']} round ({centre}) mm")
    click.echo(
        f"pitch error {distortion['pitch_error_min']:+.2%} to {distortion['pitch_error_max']:+.2%}, median "
        f"{distortion['pitch_error_median']:+.2%}; the texture reaches {distortion['reach_mm']:.1f} mm, usable are "
        f"{distortion['usable_radius_mm']:.1f} mm"
    )
    click.echo(f"verified: {len(made.checks)} checks of the written files")
    for purpose, roles in _PURPOSES:
        paths = [str(made.path / made.files[role]) for role in roles if role in made.files]
        if paths:
            click.echo(f"{purpose}: {', '.join(paths)}")


@main.command()
@click.argument("kit")
@click.option("--quick", is_flag=True, help="Leave out CAD kernels, other programs and the second tag detector.")
@click.option("--json", "as_json", is_flag=True, help="Print the checks as JSON.")
def verify(kit: str, quick: bool, as_json: bool) -> None:
    """Read a written kit back with software that is not ours, and decode it."""
    with _answers():
        from tactape_fab.verify import verify_kit

        verification = verify_kit(kit, quick=quick)
        if as_json:
            _echo_json(
                {"name": verification.name, "passed": verification.passed, "checks": [asdict(c) for c in verification.checks]}
            )
        else:
            _echo_checks(verification.checks)
        verification.raise_if_failed()
        click.echo(f"verified: {len(verification.checks)} checks of the written files", err=True)


if __name__ == "__main__":
    main()
