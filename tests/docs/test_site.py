"""The documentation as a whole: links and anchors, pages that scripts make, the site, and the manifest's schema."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.base.templates import read_toml
from tactape_fab.cli import COMMANDS
from tactape_fab.kit.film.coverlay import worst_box_gap_mm
from tactape_fab.kit.spec.scatter import MOST_SYMBOL_ERRORS, PLACEMENT_MM, least_displacement_mm
from tactape_fab.make.panel import PanelKit
from tactape_fab.texture.code import ALL_CODE_NAMES, get_plane
from tactape_fab.texture.plane import locate_windows
from tactape_fab.texture.touch.design import ALONE, ALONE_OF_EIGHT, MOST_TOUCH_POINTS
from tests.docs.test_docs import script_of
from tests.surfaces import box, emboss
from tests.thorough import costly, only_thorough

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")), *sorted(DOCS.glob("*.md"))]
LINK = re.compile(r"\]\(([^)\s]+)\)")
FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def prose(page: Path) -> str:
    return FENCED.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as repositories and the site have them, and those that it names itself."""
    text = prose(page)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", re.sub(r"`|\[|\]\([^)]*\)", "", heading)) for heading in headings]
    return {heading.strip().lower().replace(" ", "-") for heading in plain} | set(re.findall(r'<a id="([^"]+)"', text))


def links() -> Iterator[tuple[Path, str]]:
    for page in PAGES:
        yield from ((page, link) for link in LINK.findall(prose(page)) if not link.startswith(("http:", "https:")))


def test_no_link_is_dead() -> None:
    found = list(links())
    assert len(found) > 100
    dead = []
    for page, link in found:
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            dead.append(f"{page.name}: {link}")
    assert dead == []


def test_every_page_can_be_reached() -> None:
    config = read_toml(DOCS / "site" / "zensical.toml", "site")
    start, *kinds = config["project"]["nav"]
    assert start == {"What it is": "index.md"}
    readers = ["Start", "Order or print a tape", "Put it on a robot", "Study how it works", "Reference"]
    assert [kind for section in kinds for kind in section] == readers
    pages = [path for section in kinds for entries in section.values() for entry in entries for path in entry.values()]
    assert sorted(pages) == sorted([*(page.name for page in DOCS.glob("*.md")), "changelog.md", "contributing.md", "security.md"])


@only_thorough
@pytest.mark.skipif(find_spec("zensical") is None, reason="zensical is missing; pip install .[docs], with Python 3.11 or newer")
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, str(DOCS / "site" / "build.py"), str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    page = (tmp_path / "api" / "index.html").read_text(encoding="utf-8")
    assert 'id="tactape_fab.Localizer.locate"' in page and "array_like" in page
    loaded = re.findall(r'<(?:script|img|link)[^>]*(?:src|href)="(https?:[^"]+)"', page)
    assert loaded == []
    assert (tmp_path / "manifest.schema.json").is_file() and not list(tmp_path.rglob("*.py"))


def test_the_command_line_s_page_is_current() -> None:
    page = (DOCS / "cli.md").read_text(encoding="utf-8")
    assert page == script_of("make_reference").command_page(), "run docs/make_reference.py"
    assert all(f"## `tactape-fab {name}`" in page for name in COMMANDS)


@pytest.mark.parametrize("page", ["manifest.md", "codes.md"])
def test_tables_are_current(page: str) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    assert text == script_of("make_reference").fresh(page, text), "run docs/make_reference.py"
    assert text.count("|") > 20


def test_messages_are_those_that_commands_print(default_kit: Kit, here: Path) -> None:
    script = script_of("make_messages")
    text = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    script.prepare(default_kit.path)
    assert text == script.made_anew(text), "run docs/make_messages.py"
    for block in script.BLOCK.findall(text):
        assert re.search(r"^(error:|Error:|FAIL )", block, re.MULTILINE), block


def test_tables_of_choices_are_made_of_the_figures_beside_them() -> None:
    script, text = script_of("make_choose"), (DOCS / "choose.md").read_text(encoding="utf-8")
    content = json.loads((DOCS / "choose.json").read_text(encoding="utf-8"))
    assert text == script.made_anew(text, content), "run docs/make_choose.py"
    assert tuple(row["pitch_mm"] for row in content["pitch"]) == script.PITCHES_MM
    assert tuple(row["displacement_mm"] for row in content["displacement"]) == script.DISPLACEMENTS_MM
    content["pitch"][2]["least_size_mm"]["digit"] = None
    assert f"| 7 mm | above {script.SIZES_MM[-1]:g} mm |" in script.made_anew(text, content)


def test_tables_of_the_touch_code_are_made_of_the_figures_beside_them() -> None:
    script, text = script_of("make_touch"), (DOCS / "touch-code.md").read_text(encoding="utf-8")
    content = json.loads((DOCS / "touch.json").read_text(encoding="utf-8"))
    assert text == script.made_anew(text, content), "run docs/make_touch.py"
    row = content["rows"]["7 mm, 0 % missing, 1 tapes"]
    row["touch-1"]["open"] = {"right": row["frames"] // 2, "wrong": 1, "ms": 1.0}
    assert "50.0 %, 1 wrong" in script.made_anew(text, content)


def test_the_page_on_the_touch_code_says_what_is_designed_for() -> None:
    text = (DOCS / "touch-code.md").read_text(encoding="utf-8")
    assert f"| {' | '.join(map(str, ALONE[-1]))} |" in text
    assert f"**Its size is bounded**: {MOST_TOUCH_POINTS:,} grid points" in text
    assert f"| {' | '.join(map(str, ALONE_OF_EIGHT[-1]))} |\n\nand a 5x5" in text
    scatter = f"taken for {PLACEMENT_MM:g} mm along\n  each axis, and a tape of which more than {100 * MOST_SYMBOL_ERRORS:g} %"
    assert scatter in text and f"Δ below {least_displacement_mm():g} mm" in text
    apart, across = 2 * np.sin(np.pi / 8), 2 * np.sin(np.pi / 4)
    assert f"{apart:.2f} Δ instead of {across:.2f} Δ" in text
    gaps = [worst_box_gap_mm((0.6, 0.3), 45.0, w, w / 6, n) for n, w in ((8, 1.06), (4, 0.96), (8, 1.05), (4, 0.95))]
    assert [round(gap, 3) >= 0.15 for gap in gaps] == [True, True, False, False]
    assert "from W 1.06 with Δ = W/6 on, where four\n  directions need W 0.96" in text


@only_thorough
def test_the_smallest_contact_of_the_page_is_what_is_simulated() -> None:
    """One row: the whole takes a minute, and other processors round otherwise."""
    script, content = script_of("make_choose"), json.loads((DOCS / "choose.json").read_text(encoding="utf-8"))
    (row,) = (row for row in content["pitch"] if row["pitch_mm"] == 1.5)
    assert script.least_size_mm(script.tape_of(1.5, 0.25), "gelsight-mini") == row["least_size_mm"]["gelsight-mini"]


@costly
@pytest.mark.parametrize("name", ["microdots-4x4", "debruijn-4x4"])
def test_as_many_patterns_read_as_the_page_on_codes_proves(name: str) -> None:
    patterns = np.random.default_rng(4).integers(4, size=(20_000, 16), dtype=np.uint8)
    share = float(np.mean([locate_windows(get_plane(name), p.reshape(4, 4)).valid.all() for p in patterns[:4000]]))
    assert share == pytest.approx(script_of("make_reference").share_that_reads(get_plane(name)), abs=0.03)


# The manifest's schema


@pytest.fixture(scope="module")
def schema() -> Any:
    content = json.loads((DOCS / "manifest.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(content)
    return jsonschema.Draft202012Validator(content)


def manifest(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    return content


SMALL = {"size_mm": (24.0, 20.0), "models": False}
SPECS = {
    "anchored": {"sector": 7, "anchor": "spur", "adhesive": "3M468:0.13", "pitch_mm": 1.6, **SMALL},
    "forced": {"sector": 8, "displacement_mm": 0.5, **SMALL},
    "best": {"sector": 3, "origin": "best", **SMALL},
    "anoto": {"sector": 3000, "code": "anoto-6x6", "tag": "none", **SMALL},
    "touch": {"sector": 4000, "code": "touch-1", "tag": "none", **SMALL},
    "eight": {"sector": 7, "code": "touch-1", "directions": 8, "part": "block", "size_mm": (16.0, 12.0)},
    "dome": {"sector": 7, "part": "dome", "size_mm": (16.0, 12.0)},
    "cone": {"sector": 7, "part": "cone", "size_mm": (16.0, 12.0), "cylinder_mm": 12.0},
}


@pytest.mark.parametrize("name", SPECS)
def test_manifests_of_every_kind_fit_the_schema(name: str, schema: Any, tmp_path: Path) -> None:
    make_kit(TapeSpec(**SPECS[name]), tmp_path / "kit", verify=False, force=name == "forced")  # type: ignore[arg-type]
    schema.validate(manifest(tmp_path / "kit"))


def test_the_schema_has_every_code(schema: Any) -> None:
    assert tuple(schema.schema["$defs"]["tape"]["properties"]["code"]["enum"]) == ALL_CODE_NAMES, (
        "name the codes in docs/manifest.schema.json, in the order of CODES"
    )


def test_kits_panels_and_embossed_parts_fit_it(schema: Any, small_kit: Kit, panel_2: PanelKit, tmp_path: Path) -> None:
    schema.validate(manifest(small_kit.path))
    schema.validate(manifest(panel_2.path))
    for kit in panel_2.kits:
        schema.validate(manifest(panel_2.path / kit))
    block = make_kit(TapeSpec(sector=7, part="block", size_mm=(14.0, 14.0)), tmp_path / "block", verify=False)
    schema.validate(manifest(emboss(block.path, box()).path))


def test_a_key_that_is_missing_or_wrong_does_not_fit(schema: Any, small_kit: Kit, panel_2: PanelKit) -> None:
    for folder, kind in ((small_kit.path, "tape"), (panel_2.path, "panel")):
        whole = manifest(folder)
        for key in schema.schema["$defs"][kind]["required"]:
            assert not schema.is_valid({k: v for k, v in whole.items() if k != key}), key
        for key, value in (("sector", -1), ("symbols", ["NEXT"]), ("pitch_mm", 0), ("origin", [1]), ("files", [{"role": "x"}])):
            if key in whole:
                assert not schema.is_valid({**whole, key: value}), key
        outside = [{**whole["files"][0], "path": "../elsewhere"}]
        assert not schema.is_valid({**whole, "files": outside})


def test_scripts_find_the_tests_of_the_checkout_before_those_of_a_dependency() -> None:
    """Hershey-Fonts installs a package `tests`, and an editable checkout comes after it on the path."""
    found = {}
    for script in DOCS.rglob("*.py"):
        text = script.read_text(encoding="utf-8")
        if (first := re.search(r"^from tests\b", text, re.MULTILINE)) is not None:
            found[script.name] = (
                re.search(r"^sys\.path\.insert\(0, |^from common ", text[: first.start()], re.MULTILINE) is not None
            )
    assert len(found) > 9 and all(found.values()), found
