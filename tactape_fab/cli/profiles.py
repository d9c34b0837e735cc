"""profiles: the fab profiles, or one explained."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.cli.exits import answers
from tactape_fab.cli.printing import echo_json, echo_lines, table_lines

if TYPE_CHECKING:
    from tactape_fab.kit.profiles import FabProfile


@click.command()
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
    """One fab profile explained, from the mapping of `explain_fab`."""
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
            " x ".join(f"{v:g}" for v in row["value"]) if isinstance(row["value"], list) else f"{row['value']:g}",
            row["unit"],
            "yes" if row["confirmed"] else "no",
            row["date"],
            row["source"],
        )
        for row in profile["thresholds"]
    ]
    return [*head, *table_lines(("threshold", "level", "value", "unit", "confirmed", "date", "source"), rows)]
