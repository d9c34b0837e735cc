"""Makes cli.md, and the tables of manifest.md and codes.md. Run: python docs/make_reference.py (a test holds the pages to it)"""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from math import log2
from pathlib import Path
from typing import Any

import click

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a dependency installs a package `tests`, too

from tactape_fab.cli import COMMANDS, command
from tactape_fab.texture.code import CODE_NAMES, get_plane
from tactape_fab.texture.plane import Plane
from tests.bench.marks import all_replaced

DOCS = Path(__file__).parent
RANGES = (("from", "minimum"), ("above", "exclusiveMinimum"), ("to", "maximum"))
SCHEMA = json.loads((DOCS / "manifest.schema.json").read_text(encoding="utf-8"))


# The command line


def command_page() -> str:
    """Every command with its arguments and options, as `--help` has them."""
    lines = [
        *(
            "# Command line",
            "",
            "What `tactape-fab COMMAND --help` says, of every command. [What they are for](reference.md#commands).",
        ),
        *("", "Made by `python docs/make_reference.py` from the commands themselves.", ""),
    ]
    for name in COMMANDS:
        lines += command_lines(name, command(name))
    return "\n".join(lines)


def command_lines(name: str, command: click.Command) -> list[str]:
    context = click.Context(command, info_name=f"tactape-fab {name}")
    text, _, example = (command.help or "").partition("\b")
    usage = " ".join(["tactape-fab", name, *command.collect_usage_pieces(context)])
    lines = [f"## `tactape-fab {name}`", "", " ".join(text.split()), "", "```text", usage, "```", ""]
    if example:
        lines[-4:-1] = ["```text", usage, "", *(line.strip() for line in example.strip().splitlines()), "```"]
    options = [p for p in command.params if isinstance(p, click.Option)]
    lines += [f"- {option_line(option)}" for option in options]
    return [*lines, "- `-h`, `--help`: Show this message and exit.", ""]


def option_line(option: click.Option) -> str:
    names = ", ".join(f"`{name}`" for name in option.opts)
    if option.is_flag:
        return f"{names}: {option.help}"
    return f"{names} `{option.metavar or (option.name or '').upper()}`: {option.help}"


# The manifest


def manifest_table(kind: str) -> str:
    """Keys of a kit's or a panel's manifest, from the schema."""
    rows = ["| key | | what |", "|---|---|---|"]
    for path, needed, what in key_rows(SCHEMA["$defs"][kind], ""):
        rows.append(f"| `{path}` | {'' if needed else 'optional'} | {what} |")
    return "\n".join(rows) + "\n"


def key_rows(part: dict[str, Any], prefix: str) -> Iterator[tuple[str, bool, str]]:
    for key, found in part.get("properties", {}).items():
        value = SCHEMA["$defs"][found["$ref"].rpartition("/")[2]] if "$ref" in found else found
        null = [choice for choice in value.get("oneOf", []) if choice.get("type") == "null"]
        whole = next((choice for choice in value.get("oneOf", []) if choice not in null), value)
        yield f"{prefix}{key}", key in part["required"], kind_of(whole, value.get("description", ""), bool(null))
        yield from key_rows(whole, f"{prefix}{key}.")
        items = whole.get("items", {})
        if isinstance(items, dict):
            yield from key_rows(items, f"{prefix}{key}[].")


def kind_of(value: dict[str, Any], text: str, nullable: bool) -> str:
    """A value in words: its kind and range, and its description."""
    if "const" in value:
        kind = f"`{value['const']}`"
    elif "enum" in value:
        kind = " or ".join(f"`{word}`" for word in value["enum"])
    elif value.get("type") == "array":
        count = f"{value['maxItems']} " if "maxItems" in value else ""
        kind = f"list of {count}{value['items'].get('type', 'value')}s" if isinstance(value.get("items"), dict) else "list"
    else:
        names = value.get("type", "value")
        kind = " or ".join(names) if isinstance(names, list) else names
    ranges = [(word, value[key]) for word, key in RANGES if key in value]
    kind += "".join(f" {word} {limit}" for word, limit in ranges) + ", or null" * nullable
    words = text or value.get("description", "")
    return f"{kind}. {words}" if words else kind


# The codes


def code_table() -> str:
    """What a window of each code carries, and what it would have to."""
    rows = [
        "| code | window | bits of a window | places, sectors and turns | bits of these | patterns that read as some place |",
        "|---|---|---|---|---|---|",
    ]
    for name in CODE_NAMES:
        code = get_plane(name)
        n, bits = code.window, 2 * code.window**2
        needed = 2 * log2(code.range) + log2(code.sectors) + 2
        places = f"{code.range:,}² x {code.sectors} x 4"
        rows.append(f"| `{name}` | {n}x{n} | {bits} | {places} | {needed:.1f} | {share_that_reads(code):.3g} of all |")
    return "\n".join(rows) + "\n"


def share_that_reads(code: Plane) -> float:
    """Share of all patterns of one window that are a window of the code: as many as there are places, each another pattern."""
    return code.range**2 * code.sectors / 2.0 ** (2 * code.window**2)


TABLES: dict[str, dict[str, Callable[[], str]]] = {
    "manifest.md": {"kit": lambda: manifest_table("tape"), "panel": lambda: manifest_table("panel")},
    "codes.md": {"codes": code_table},
}


def fresh(page: str, text: str) -> str:
    """A page with its tables made anew, between `<!-- name -->` and `<!-- /name -->`."""
    return all_replaced(text, {name: table() for name, table in TABLES[page].items()})


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    (DOCS / "cli.md").write_text(command_page(), encoding="utf-8")
    for page in TABLES:
        (DOCS / page).write_text(fresh(page, (DOCS / page).read_text(encoding="utf-8")), encoding="utf-8")
