"""make, check, profiles, emboss."""

from __future__ import annotations

import gc
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.errors import DesignRuleError, Problem, SpecError
from tactape_fab.cli.exits import answer, answers, clear_step, echo_json, echo_lines, echo_lines_err, say_rules, step_shown, warn
from tactape_fab.cli.group import main
from tactape_fab.cli.options import (
    given_values,
    number,
    pair,
    tape_options,
)
from tactape_fab.cli.printing import (
    embossed_json,
    embossed_lines,
    finding_lines,
    kit_json,
    kit_lines,
    panel_json,
    panel_lines,
    profile_lines,
    profiles_lines,
    remark_lines,
)

if TYPE_CHECKING:
    from tactape_fab.kit.examine.order import ExaminedPanel
    from tactape_fab.kit.examine.tape import Examined


_OBJECTS_A_COLLECTION = 50_000
"""Loading modules makes many objects and hardly any rings of them: the collector would look at all of them over and over."""


def _values(spec_file: str | None) -> dict[str, Any]:
    from tactape_fab.kit.spec.tape_list import read_list_file

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
        if problems:  # say what else is refused, too
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


_avoid_option = click.option(
    "--avoid",
    metavar="KITS",
    multiple=True,
    help="Choose the origin, and the sector if none is given, far from these kits; may be repeated.",
)


@tape_options
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
    gc.set_threshold(_OBJECTS_A_COLLECTION)
    with answers():
        from tactape_fab.kit.examine.tape import Examined
        from tactape_fab.make.kit import make_examined
        from tactape_fab.make.panel import make_panel

        values, given = _values(spec_file), given_values(options)
        if _is_list(values, given, avoid):
            settings = {"overwrite": overwrite, "verify": not no_verify, "force": force}
            _make_list(values, given, output, settings, pack=pack, jobs=jobs, as_json=as_json)
            return
        examined = _examined(values, given, avoid, {"pack": pack, "jobs": jobs}, output=output, overwrite=overwrite)
        say_rules(examined.findings, force=force)
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
            echo_json(kit_json(kit)) if as_json else echo_lines(kit_lines(kit))
        else:
            panel = make_panel(examined, output, **how)
            echo_json(panel_json(panel)) if as_json else echo_lines(panel_lines(panel))


def _is_list(values: dict[str, Any], given: dict[str, Any], avoid: Sequence[str] = ()) -> bool:
    """Whether several tapes are asked for, each with a kit of its own; a panel is one thing, whatever stands on it."""
    from tactape_fab.kit.spec.tape_list import is_list

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
    from tactape_fab.cli.many_lines import KitTable, failed_json, made_json, many_summary, packed_json, packed_lines
    from tactape_fab.kit.examine.tape_lists import list_tapes
    from tactape_fab.make.many import DEFAULT_FOLDER, FailedKit, make_kits, pack_tapes

    folder = Path(DEFAULT_FOLDER if output is None else output)
    count = None if jobs is None else number(jobs)
    overwrite, force = settings["overwrite"], settings["force"]
    listed = list_tapes(values, given, folder, jobs=count, overwrite=overwrite, force=force, packed=pack)
    say_rules(listed.findings, force=force)
    packed = pack_tapes(listed.tapes) if pack else []
    table, begin = KitTable(listed.tapes), time.monotonic()
    rows_shown = not as_json and sys.stdout is not None and sys.stdout.isatty()
    show = (lambda *_: None) if rows_shown else step_shown()  # rows are progress enough
    made, failed, statuses = [], [], [0]
    echo_lines([] if as_json else [table.header()])
    try:
        with closing(make_kits(listed.tapes, folder, jobs=listed.jobs, **settings)) as kits:
            for done, (kit, tape) in enumerate(zip(kits, listed.tapes, strict=True), start=1):
                if isinstance(kit, FailedKit):
                    status, lines = answer(kit.error)
                    statuses.append(status)
                    failed.append(failed_json(kit, status, lines))
                    clear_step()
                    echo_lines_err(f"error: {kit.name}: {line}" for line in lines)
                else:
                    made.append(made_json(kit))
                echo_lines([] if as_json else [table.row(kit, tape)])
                show("kits", done, len(listed.tapes))
    except (KeyboardInterrupt, SystemExit):
        click.echo(f"stopped; the kits that stand in {folder} are whole", err=True)
        raise
    if as_json:
        echo_json({"folder": str(folder), "kits": made, "failed": failed, **({"packed": packed_json(packed)} if pack else {})})
    else:
        echo_lines(packed_lines(packed))
    click.echo(many_summary(len(made), len(listed.tapes), folder, time.monotonic() - begin), err=True)
    sys.exit(max(statuses))


@tape_options
@main.command()
@_avoid_option
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def check(spec_file: str | None, avoid: Sequence[str], as_json: bool, **options: Any) -> None:
    """Measure a tape against the design rules of its fab or process; nothing is written."""
    with answers():
        values, given = _values(spec_file), given_values(options)
        if _is_list(values, given):
            what = "sectors names" if spec_file is None else f"{spec_file} is"
            raise SpecError(f"{what} a list of tapes; check takes one, make checks them all before it writes any")
        findings = _examined(values, given, avoid).findings
        if as_json:
            echo_json([asdict(f) for f in findings])
        else:
            echo_lines(finding_lines(findings))
            echo_lines_err(f"note: {line}" for line in remark_lines(findings))
            warn(findings)
        if any(f.blocks for f in findings):
            raise DesignRuleError(findings)


@main.command()
@click.argument("name", required=False, metavar="[NAME]")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def profiles(name: str | None, as_json: bool) -> None:
    """List the fab profiles, or explain one: its thresholds, and where each comes from. NAME may be a .toml file of yours."""
    with answers():
        from tactape_fab.base.templates import profile_names
        from tactape_fab.kit.profiles import explain_fab, load_fab

        fabs = [load_fab(known) for known in (profile_names("fabs") if name is None else [name])]
        if as_json:
            echo_json([explain_fab(fab) for fab in fabs] if name is None else explain_fab(fabs[0]))
        else:
            echo_lines(profiles_lines(fabs) if name is None else profile_lines(explain_fab(fabs[0])))


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
    with answers():
        from tactape_fab.make.emboss import emboss_kit
        from tactape_fab.solids.surface.charts import read_placement

        given = {"at_mm": place["at"], "up": place["up"], "face": place["face"]}
        placement = read_placement(
            {key: number(text) if key == "face" else pair(text) for key, text in given.items() if text is not None}
        )
        made = emboss_kit(kit, surface, output, placement=placement, overwrite=overwrite, unit=unit, progress=step_shown())
        echo_json(embossed_json(made)) if as_json else echo_lines(embossed_lines(made))
