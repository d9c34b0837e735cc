"""Makes the tables of touch-code.md of touch.json, which `python -m tests.bench.touch` writes. Run: python docs/make_touch.py"""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a dependency installs a package `tests`, too

from tests.bench.marks import all_replaced, measured_line

PAGE = Path(__file__).parent / "touch-code.md"
FIGURES = Path(__file__).parent / "touch.json"
ADVISE = Path(__file__).parent / "advise.json"
CODES = ("microdots-4x4", "touch-1")
WORLDS = ("open", "closed")

Content = dict[str, Any]


def rows_table(content: Content) -> str:
    """Rates of both codes in both worlds, a line for each contact, share of missing parts and registry."""
    return _rates(content, told=False)


def told_table(content: Content) -> str:
    """The same for those who know that nothing but tapes is in reach."""
    return _rates(content, told=True)


def _rates(content: Content, *, told: bool) -> str:
    head = [
        "| contact | parts missing | tapes | frames | "
        + " | ".join(f"`{code}`, {world}" for code in CODES for world in WORLDS)
        + " |",
        "|---|---|---|---|---|---|---|---|",
    ]
    out = []
    for row in content["rows"].values():
        if (row.get("max_p_tape") is not None) != told:
            continue
        rates = []
        for code in CODES:
            for world in WORLDS:
                cell = row[code][world]
                wrong = f", {cell['wrong']} wrong" if cell["wrong"] else ""
                rates.append(f"{100 * cell['right'] / row['frames']:.1f} %{wrong}")
        what = f"{row['contact_mm']:g} mm | {100 * row['missing']:g} % | {row['tapes']} | {row['frames']:,}"
        out.append(f"| {what} | {' | '.join(rates)} |")
    return "\n".join([*head, *out]) + "\n"


def foreign_table(content: Content) -> str:
    """Located frames of what is no registered tape; tapes of a code together, and the worst of them."""
    return _located(content["foreign"], {code: f"another tape of `{code}`" for code in CODES})


def foreign_eight_table(content: Content) -> str:
    """The same against a tape of eight directions."""
    others = {"microdots-4x4": "a tape of `microdots-4x4`", "touch-1": "a touch tape of four directions"}
    return _located(content["foreign_eight"], {**others, "eight": "another tape of eight directions"})


def _located(found: Content, names: dict[str, str]) -> str:
    out = ["| what is touched | world | frames | located | rate below | worst of them |", "|---|---|---|---|---|---|"]
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in found.values():
        subject = row["subject"]
        kind = next((name for code, name in names.items() if subject.startswith(f"{code} ")), subject)
        groups.setdefault((kind, row["world"]), []).append(row)
    for (kind, world), rows in groups.items():
        frames, located = sum(row["frames"] for row in rows), sum(row["located"] for row in rows)
        worst = max(rows, key=lambda row: row["located"] / row["frames"])
        named = f"{worst['located']} of {worst['frames']:,}" if len(rows) > 1 else ""
        out.append(f"| {kind} | {world} | {frames:,} | {located} | {upper_bound(located, frames):.1e} | {named} |")
    return "\n".join(out) + "\n"


def upper_bound(successes: int, trials: int) -> float:
    """The largest rate that so few successes do not speak against, at 95 % confidence (Clopper and Pearson, one-sided)."""
    from scipy.stats import beta

    return float(beta.ppf(0.95, successes + 1, trials - successes))


def registry_table(content: Content) -> str:
    found = content["registry"]["16 tapes"]
    names = list(found["across"])
    lines = [("of one tape", found["alone"]), ("of two tapes", found["across"])]
    head = [f"| patches | {' | '.join(names)} |", "|---|" + "---|" * len(names)]
    return "\n".join([*head, *(f"| {what} | {' | '.join(str(bits[n]) for n in names)} |" for what, bits in lines)]) + "\n"


def eight_table(_: Content) -> str:
    """The variants of `python -m tests.bench.advise` that differ in directions alone, side by side."""
    rows = {row["name"]: row for row in json.loads(ADVISE.read_text(encoding="utf-8"))["variants"]}
    out = ["| tape | 4 directions | 8 directions | estimate of hard symbols, 8 directions |", "|---|---|---|---|"]
    for name, row in rows.items():
        eight = rows.get(f"{name}, 8 directions")
        if eight is not None:
            out.append(f"| {name} | {row['simulated_mm']:g} mm | {eight['simulated_mm']:g} mm | {eight['before_mm']:g} mm |")
    return "\n".join(out) + "\n"


def speed_table(content: Content) -> str:
    out = ["| code | registered tapes | ms |", "|---|---|---|"]
    for name, ms in content["speed"]["11x9 mm"].items():
        code, _, tapes = name.partition(", ")
        out.append(f"| `{code}` | {tapes} | {ms:.2f} |")
    return "\n".join(out) + "\n"


TABLES: dict[str, Callable[[Content], str]] = {
    "registry": registry_table,
    "rows": rows_table,
    "told": told_table,
    "foreign": foreign_table,
    "eight": eight_table,
    "foreign_eight": foreign_eight_table,
    "speed": speed_table,
}


def made_anew(text: str, content: Content) -> str:
    """The page's text with its tables as the figures have them."""
    stamps = {section: list(keys.values()) for section, keys in content["measured"].items()}
    stamps |= {"told": stamps["rows"], "eight": [json.loads(ADVISE.read_text(encoding="utf-8"))["about"]]}
    return all_replaced(text, {name: table(content) + measured_line(stamps[name]) for name, table in TABLES.items()})


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    figures = json.loads(FIGURES.read_text(encoding="utf-8"))
    PAGE.write_text(made_anew(PAGE.read_text(encoding="utf-8"), figures), encoding="utf-8")
