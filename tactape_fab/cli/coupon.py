"""coupon: a small panel of different tapes, to confirm a fab profile's limits with one cheap order."""

from __future__ import annotations

from shlex import quote

import click

from tactape_fab.cli.exits import answers
from tactape_fab.cli.options import number
from tactape_fab.cli.printing import echo_json, echo_lines, echo_lines_err, purpose_lines, table_lines, verified_line


@click.command()
@click.option("--fab", metavar="PROFILE", help="Fab profile, or a .toml file.  [default: generic-fpc]")
@click.option("--first-sector", metavar="N", help="Sector of the first tape; the others follow.  [default: 0]")
@click.option("--name", metavar="NAME", help="Name of the coupon and its files.  [default: PROFILE-coupon]")
@click.option("-o", "--output", metavar="DIR", help="Folder of the coupon.  [default: its name]")
@click.option("--overwrite", is_flag=True, help="Replace an older one of this tool.")
@click.option("--discard-edits", is_flag=True, help="Replace it even if files in it were edited since.")
@click.option("--no-verify", is_flag=True, help="Do not read the written files back.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def coupon(
    fab: str | None,
    first_sector: str | None,
    name: str | None,
    output: str | None,
    overwrite: bool,
    discard_edits: bool,
    no_verify: bool,
    as_json: bool,
) -> None:
    """Write a coupon: one small panel of tapes at and beyond a fab's limits. What came back goes to profiles confirm.

    \b
    Example: tactape-fab coupon --fab jlcpcb-fpc
    """
    with answers():
        from tactape_fab.base.errors import Problem, SpecError
        from tactape_fab.kit.examine.coupon import examine_coupon
        from tactape_fab.kit.spec.options import DEFAULT_FAB
        from tactape_fab.make.panel import make_panel

        first = 0 if first_sector is None else number(first_sector)
        if not isinstance(first, int):
            raise SpecError(Problem("first_sector", f"first_sector = {first} is no sector; give a whole number from 0"))
        examined = examine_coupon(fab or DEFAULT_FAB, first, name)
        echo_lines_err(examined.remarks)
        made = make_panel(examined, output, overwrite="edits" if discard_edits else overwrite, verify=not no_verify, force=True)
        if as_json:
            echo_json({**made.to_mapping(), "trials": [trial.to_mapping() for trial in examined.trials]})
            return
        width, height = made.panel.size_mm
        parts = sum(tape.part_count for tape in made.tapes)
        rows = [
            (
                str(tape.sector),
                trial.tests,
                "" if trial.value_mm is None else f"{trial.value_mm:g} mm",
                f"{tape.pitch_mm:g}",
                f"{tape.displacement_mm:g}",
                trial.coverlay,
            )
            for tape, trial in zip(made.tapes, examined.trials, strict=True)
        ]
        echo_lines(
            [
                f"{made.path}: {made.panel.words}, panel {width:g} x {height:g} mm, {parts} parts",
                *table_lines(("sector", "tests", "at", "W", "Δ", "coverlay"), rows),
                verified_line(made.checks) if made.checks else "not verified",
                *purpose_lines(made.path, made.files),
            ]
        )
        kit = quote(str(made.path))
        echo_lines_err([f"when it came: tactape-fab profiles confirm {kit} --held SECTORS --failed SECTORS -o my-fab.toml"])
