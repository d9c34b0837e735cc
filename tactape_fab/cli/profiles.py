"""profiles: lists the fab profiles, explains one, or confirms one by a coupon."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.errors import Problem, SpecError, tried
from tactape_fab.cli.exits import answers
from tactape_fab.cli.printing import echo_json, echo_lines, table_lines

if TYPE_CHECKING:
    from tactape_fab.kit.profiles import FabProfile


MOST_SECTORS = 1_000_000


@click.command()
@click.argument("fab", required=False, metavar="[NAME]")
@click.argument("coupon", required=False, metavar="[COUPON]")
@click.option("--held", metavar="SECTORS", help="With confirm: sectors of the coupon's tapes that came back whole.")
@click.option("--failed", metavar="SECTORS", help="With confirm: sectors of those that did not.")
@click.option("--date", metavar="YYYY-MM-DD", help="With confirm: when they were looked at.  [default: today]")
@click.option("-o", "--output", metavar="FILE.toml", help="With confirm: the profile to write.")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def profiles(fab: str | None, coupon: str | None, as_json: bool, **judged: str | None) -> None:
    """List the fab profiles, or explain one: its thresholds, and where each comes from. NAME may be a .toml file of yours.

    confirm COUPON writes a profile of what came back of a coupon: limits that its tapes confirmed or moved, with the date.

    \b
    Examples: tactape-fab profiles jlcpcb-fpc
              tactape-fab profiles confirm jlcpcb-fpc-coupon --held 0,1,5-8 --failed 2-4 -o my-jlc.toml
    """
    with answers():
        if fab == "confirm":
            _confirm(coupon, judged, as_json=as_json)
            return
        if strange := [f"--{key}" for key, value in judged.items() if value is not None] or ([coupon] if coupon else []):
            raise SpecError(f"{', '.join(strange)} is for profiles confirm COUPON; leave it out")
        from tactape_fab.base.templates import profile_names
        from tactape_fab.kit.profiles import explain_fab, load_fab

        fabs = [load_fab(known) for known in (profile_names("fabs") if fab is None else [fab])]
        if as_json:
            echo_json([explain_fab(fab) for fab in fabs] if fab is None else explain_fab(fabs[0]))
        else:
            echo_lines(profiles_lines(fabs) if fab is None else profile_lines(explain_fab(fabs[0])))


def _confirm(coupon: str | None, judged: Mapping[str, str | None], *, as_json: bool) -> None:
    """Write the fab profile that results from a returned coupon."""
    from tactape_fab.base.output_file import refuse_taken_place, write_file
    from tactape_fab.base.templates import is_profile_file
    from tactape_fab.kit.profiles import load_fab
    from tactape_fab.kit.profiles.confirm import confirm, read_trials
    from tactape_fab.kit.spec.sectors import read_sectors
    from tactape_fab.texture.manifest import find_manifest, read_any_manifest

    output = judged["output"]
    problems = []
    if coupon is None:
        problems.append(Problem("coupon", "profiles confirm needs the coupon's folder; give profiles confirm COUPON"))
    if output is None or not is_profile_file(output):
        problems.append(Problem("output", "profiles confirm writes a profile; give -o NAME.toml"))
    else:
        tried(lambda: refuse_taken_place(Path(output), "output"), problems)
    if judged["held"] is None and judged["failed"] is None:
        problems.append(Problem("held", "profiles confirm needs what came back; give --held SECTORS, --failed SECTORS, or both"))
    date = _date(judged["date"], problems)
    if problems or coupon is None or output is None:
        raise SpecError(problems)
    content = read_any_manifest(find_manifest(Path(coupon)))
    fab, trials = read_trials(content)
    held, failed = (read_sectors(judged[key], MOST_SECTORS, key) if judged[key] is not None else () for key in ("held", "failed"))
    source = f"coupon {content.get('name')}: sectors {judged['held'] or 'none'} held, {judged['failed'] or 'none'} failed"
    found = confirm(fab, trials, held, failed, date=date, source=source, place=Path(output))
    place = Path(output)
    write_file(place, found.text.encode("utf-8"), "output", overwrite=False)
    try:
        load_fab(output)
    except SpecError:  # for example because it extends too many others
        place.unlink()
        raise
    if as_json:
        echo_json({"profile": output, "said": list(found.lines)})
    else:
        echo_lines([*found.lines, f"wrote {place}; tactape-fab make --sector 7 --order {quote(output)}"])


def _date(text: str | None, problems: list[Problem]) -> str:
    try:
        return (date.today() if text is None else date.fromisoformat(text)).isoformat()
    except ValueError:
        problems.append(Problem("date", f"date = {text!r} is no date; give YYYY-MM-DD, such as 2026-11-23"))
        return ""


def _value(name: str, value: Any) -> str:
    if isinstance(value, list):
        return (" to " if name.startswith("order.") else " x ").join(f"{v:g}" for v in value)
    return value if isinstance(value, str) else f"{value:g}"


def profiles_lines(fabs: Sequence[FabProfile]) -> list[str]:
    """Fab profiles as rows of a table."""
    rows = [
        (
            fab.name,
            f"{fab.material.base} {fab.material.thickness_mm:g} mm",
            ", ".join(fab.coverlay_modes),
            f"{fab.limits['opening-bridge'].value_mm:g} mm",
            f"{fab.size.largest_mm[0]:g} x {fab.size.largest_mm[1]:g} mm",
            fab.title,
        )
        for fab in fabs
    ]
    return table_lines(("name", "material", "coverlay", "bridge", "largest", "title"), rows)


def profile_lines(profile: Mapping[str, Any]) -> list[str]:
    """One fab profile, from the mapping of `explain_fab`, as lines."""
    material, files = profile["material"], profile["files"]
    head = [
        f"{profile['name']}: {profile['title']}",
        f"{material['base']} {material['thickness_mm']:g} mm, {material['layers']} copper layer of {material['copper_um']:g} um, "
        f"{material['finish']}; {profile['colours']['coverlay']} with {profile['colours']['legend']} legend",
        f"coverlay: {', '.join(profile['coverlay'])}",
        *(f"{key}: {', '.join(profile[key]) or 'none'}" for key in ("stiffener", "adhesive")),
        f"Gerber attributes {profile['gerber']['x2']}, job file {'in' if profile['gerber']['job_in_zip'] else 'not in'} the zip, "
        f"part list as {profile['assembly']}",
        f"panel: {'tapes are put on panels unless told otherwise' if profile['panel'] == 'auto' else 'where it is asked for'}",
        f"files: {', '.join(files.values())}",
        "",
    ]
    rows = [
        (
            row["id"],
            row["level"],
            _value(row["id"], row["value"]),
            row["unit"],
            "yes" if row["confirmed"] else "no",
            row["date"],
            row["source"],
        )
        for row in profile["thresholds"]
    ]
    return [*head, *table_lines(("threshold", "level", "value", "unit", "confirmed", "date", "source"), rows)]
