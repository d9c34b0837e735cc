"""Writes the tables of docs/limits.md: budgets of files as the package has them, and attacks with what each costs, measured here.

Run: python docs/make_limits.py; with --scores it writes budgets and changed code alone, with --changes these and changed kits.
A test holds the budgets, the scores, and which attacks and changes there are; figures are those of the machine.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a dependency installs a package `tests`, too

from tactape_fab import TapeSpec, make_kit
from tactape_fab.verify import verify_kit
from tactape_fab.verify.budgets import BUDGETS, OTHERS, most_bytes
from tests.attacks import ATTACKS, Attack, Cost, cost_of
from tests.bench import marks
from tests.roundtrip.kits import Edit, OpenKit, replaced, text_of
from tests.roundtrip.test_verify_kicad import CHANGES as BOARD_CHANGES
from tests.roundtrip.test_verify_kicad import RULES
from tests.unit.verify.test_fab_attacks import ATTACKS as KIT_CHANGES
from tests.unit.verify.test_other_versions import EDITS

PAGE = Path(__file__).parent / "limits.md"
SCORES = Path(__file__).parent.parent / "tests" / "mutants" / "scores.json"
PARTS = 1984


def budget_rows() -> list[str]:
    """The budgets of a kit's files, roles of one budget in one row."""
    kinds: dict[tuple[int, int], list[str]] = {}
    for role, budget in {**BUDGETS, "all others": OTHERS}.items():
        kinds.setdefault(budget, []).append(role if " " in role else f"`{role}`")
    return [
        f"| {', '.join(roles)} | {budget[0] >> 20} MiB | {budget[1]:,} | {most_bytes(roles[0].strip('`'), PARTS) / 1e6:.1f} MB |"
        for budget, roles in kinds.items()
    ]


def attack_row(attack: Attack, cost: Cost) -> str:
    said = "refused" if (cost.status, attack.said in cost.output) == (attack.status, True) else "NOT REFUSED"
    return f"| {attack.kind} | {attack.tried} | {said} | {cost.cpu_s:.1f} s | {cost.peak_bytes / 2**20:.0f} MB |"


def changes() -> dict[str, dict[str, Edit]]:
    """Changes of a kit that the tests try, by class."""
    board = {f"KiCad board: {name}": text_of("kicad-pcb", change) for name, (change, _) in BOARD_CHANGES.items()}
    rules = {f"KiCad board: rules, {name}": replaced("kicad-project", *texts) for name, texts in RULES.items()}
    kinds: dict[str, dict[str, Edit]] = {}
    for name, edit in {
        **board,
        **rules,
        **{name: edit for tried in (KIT_CHANGES, EDITS) for name, (edit, _) in tried.items()},
    }.items():
        kinds.setdefault(name.partition(":")[0], {})[name] = edit
    return dict(sorted(kinds.items(), key=lambda kind: kind[0].lower()))


def changed_rows() -> list[str]:
    """How many changes of each class the quick `verify` of a kit of another version tells, hashes made to fit."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        kit = make_kit(
            TapeSpec(sector=100, size_mm=(20.0, 20.0), holes_mm=((16.4, 10.0, 1.0),), models=False), Path(folder) / "kit"
        )
        for kind, edits in changes().items():
            caught = sum(is_caught(kit.path, Path(folder) / "changed", edit) for edit in edits.values())
            rows.append(f"| {kind} | {len(edits)} | {caught} |")
    return rows


def is_caught(kit: Path, folder: Path, edit: Edit) -> bool:
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(kit, folder)
    opened = OpenKit(folder)
    opened.manifest["tool"]["version"] = "0.0.9"
    edit(opened)
    return not verify_kit(opened.save(consistent=True), quick=True).passed


def mutant_rows() -> list[str]:
    """What became of the changes of each module that was tried, as `python -m tests.mutants --keep` wrote it."""
    return [
        f"| `{module}` | {row['tried']} of {row['changes']} | {row['noticed']} | {row['explained']} | {row['survivors']} |"
        for module, row in json.loads(SCORES.read_text()).items()
    ]


def with_table(page: str, name: str, rows: list[str]) -> str:
    """The page with other rows below the heading of a table."""
    head = page.partition(f"<!-- {name} -->\n")[2].splitlines()[:2]
    return marks.replaced(page, name, "\n".join([*head, *rows]) + "\n")


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--scores", action="store_true")
    parser.add_argument("--changes", action="store_true")
    asked = parser.parse_args()
    page = with_table(PAGE.read_text(encoding="utf-8"), "budgets", budget_rows())
    page = with_table(page, "mutants", mutant_rows())
    if not asked.scores:
        page = with_table(page, "changes", changed_rows())
    if not (asked.scores or asked.changes):
        with tempfile.TemporaryDirectory() as folder:
            kit = make_kit(TapeSpec(sector=9, size_mm=(34.0, 24.0), holes_mm=((20.0, 12.0, 2.0),)), Path(folder) / "kit")
            page = with_table(page, "attacks", [attack_row(attack, cost_of(attack, kit.path)) for attack in ATTACKS])
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
