"""README and reference say what the software does today."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest
from click import Option

from tactape_fab import Kit, Localization
from tactape_fab.cli import COMMANDS, command
from tactape_fab.kit.profiles import BACKING_ROLES, LIMIT_IDS, PROCESS_LIMIT_IDS, profile_names
from tactape_fab.kit.profiles.assembly import FORMATS
from tactape_fab.kit.profiles.parts import solid_elements
from tactape_fab.kit.spec.panel_options import PANEL_KEYS
from tactape_fab.kit.spec.tape_spec import KEYS
from tactape_fab.report.solid_view import MOST_TRIANGLES
from tactape_fab.sense.files.answers import object_json
from tactape_fab.texture.cpl import PLACEMENTS
from tactape_fab.verify.files import LATER, roles_of
from tactape_fab.verify.trip.round_trip import EDGE, INSIDE, QUICK
from tactape_fab.verify.trip.visible_parts import IN_PLACE_MM, SWALLOWED_MM
from tests.attacks import ATTACKS, MOST_BYTES, MOST_CPU_S

ROOT = Path(__file__).parents[2]


def script_of(name: str) -> Any:
    """A script of docs/ as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def test_tables_of_fabs_are_what_the_software_computes() -> None:
    page = (ROOT / "docs" / "fabs.md").read_text(encoding="utf-8")
    for name, table in script_of("make_fabs").TABLES.items():
        assert f"<!-- {name} -->\n{table()}<!-- /{name} -->\n" in page, "run docs/make_fabs.py"


def test_distances_at_the_default_origins_are_those_of_the_page() -> None:
    assert script_of("make_certify_numbers").default_row() in (ROOT / "docs" / "certify.md").read_text(encoding="utf-8")


def test_the_picture_of_dots_is_made_by_its_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It looks into a `Localizer`, whose inner names may change."""
    pytest.importorskip("matplotlib")
    script = script_of("make_dots_figure")
    width_height = script.FIGURE.read_bytes()[:24]  # PNG's signature and the first fields of IHDR
    monkeypatch.setattr(script, "FIGURE", tmp_path / "dots.png")
    script.main()
    assert script.FIGURE.read_bytes()[:24] == width_height


def test_numbers_of_the_default_kit_are_its_own(default_kit: Kit) -> None:
    script = script_of("make_numbers")
    page = (ROOT / "docs" / "verify.md").read_text(encoding="utf-8")
    for row in script.lasting_rows(default_kit):
        assert row in page, "run docs/make_numbers.py --write"


@pytest.mark.parametrize("name", COMMANDS)
def test_reference_names_every_option(name: str) -> None:
    reference = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    for parameter in command(name).params:
        for option in parameter.opts:
            if option.startswith("--"):
                assert f"`{option}" in reference or f"[{option}]" in reference, f"name {option} in docs/reference.md"


def test_reference_names_every_key_role_and_rule(small_kit: Kit) -> None:
    reference = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    for name in [*KEYS, *PANEL_KEYS, *roles_of(small_kit.tape, backings=BACKING_ROLES), *LATER, *LIMIT_IDS, *PROCESS_LIMIT_IDS]:
        assert f"`{name}`" in reference, f"name {name} in docs/reference.md"


def test_profiles_that_come_with_the_package_are_named() -> None:
    page = {name: (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("reference.md", "localization.md")}
    (part,) = (option.help for option in command("make").params if isinstance(option, Option) and "--part" in option.opts)
    assert f"; {', '.join(solid_elements())} are solid elements" in str(part), "name it in the help of --part"
    assert f"; {', '.join(f'`{name}`' for name in solid_elements())} are solid elements" in page["reference.md"]
    for name in profile_names("processes"):
        assert f"`{name}`, " in page["reference.md"], f"name {name} in docs/reference.md"
    for name in profile_names("sensors"):
        assert f"`{name}`" in page["localization.md"], f"name {name} in docs/localization.md"


def test_every_key_of_an_answer_is_explained() -> None:
    page = (ROOT / "docs" / "localization.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"^## What an answer means\n\n(.*?)\n\n", page, re.MULTILINE | re.DOTALL)
    told = {name for row in table.splitlines() for name in re.findall(r"`(\w+)`", row.split(" | ")[0])}
    answer = Localization(status="none", located=False).to_mapping(0, dots=True)
    assert told == {*answer, *object_json(None)}, "one row a key in the table of docs/localization.md"


def test_reference_says_how_much_of_a_solid_the_report_shows() -> None:
    reference = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    assert f"a piece of {MOST_TRIANGLES:,} triangles" in reference


def test_ordering_names_the_columns_of_every_format() -> None:
    page = (ROOT / "docs" / "ordering.md").read_text(encoding="utf-8")
    for name, house in FORMATS.items():
        assert f"| `{name}` |" in page, f"add a row of {name} to docs/ordering.md"
        for table in (PLACEMENTS[name], house.bom):
            assert f"`{','.join(table.headers)}`" in page, name


def test_the_page_on_verify_has_the_round_trip_s_numbers() -> None:
    page = (ROOT / "docs" / "verify.md").read_text(encoding="utf-8")
    assert (QUICK, INSIDE, EDGE) == (6, 96, 48) and "take six contacts" in page
    assert f"{INSIDE + EDGE} contacts" in page and f"of {(INSIDE + EDGE) // 3} contacts" in page
    assert f"nearer than {SWALLOWED_MM:g} mm to the outline" in page
    assert "a third of them over its edge" in page
    assert f"within {1000 * IN_PLACE_MM:g} µm" in page


def test_tables_of_limits_are_those_of_the_package_and_of_its_attacks() -> None:
    script = script_of("make_limits")
    page = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8")
    assert "\n".join(script.budget_rows()) in page, "run docs/make_limits.py --scores"
    assert "\n".join(script.mutant_rows()) in page, "run docs/make_limits.py --scores"
    table = page.partition("<!-- attacks -->")[2].partition("<!-- /attacks -->")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line.startswith("|")]
    assert [row[:2] for row in rows[2:]] == [[attack.kind, attack.tried] for attack in ATTACKS], "run docs/make_limits.py"
    assert {row[2] for row in rows[2:]} == {"refused"}
    counts = {kind: len(edits) for kind, edits in script.changes().items()}
    counted = [
        f"| {kind} | {count} | {count - (kind == 'report')} |" for kind, count in counts.items()
    ]  # a script of another version
    assert [row for row in counted if row not in page] == [], "run docs/make_limits.py --changes"
    assert max(float(row[3].removesuffix(" s")) for row in rows[2:]) <= MOST_CPU_S
    assert max(float(row[4].removesuffix(" MB")) for row in rows[2:]) <= MOST_BYTES / 2**20
