"""Output that several commands share: tables, design rules, checks, progress, JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from tactape_fab.base.errors import Check, Finding
from tactape_fab.base.plain_text import one_line

PURPOSES = (
    ("for the fab", ("fab-zip",)),
    ("for assembly", ("cpl", "bom")),
    ("for the order", ("order-notes", "fab-drawing", "fab-dxf")),
    ("for CAD and milling", ("step-assembly", "step-solid")),
    ("for printing", ("stl", "3mf")),
    ("for simulators", ("sim",)),
    ("to look at", ("report",)),
)
"""Purposes of files, with their roles, in the order in which make prints them."""

_CHECK_WIDTH, _MOST_NAMED = 24, 4
_OF_ORDERS = ("part-count", "assembly-size", "together", "mark")
"""Rules about an order, whose remarks make prints as well."""


def rule_lines(findings: Sequence[Finding]) -> list[str]:
    """The broken blocking rules as lines."""
    return [f"{f.rule}: {f.message}{_at(f)}" for f in findings if f.blocks]


def _at(finding: Finding) -> str:
    return "" if finding.at_mm is None else f" (at {finding.at_mm[0]:.2f}, {finding.at_mm[1]:.2f} mm)"


def finding_lines(findings: Sequence[Finding]) -> list[str]:
    """Every rule as a row of a table."""
    header = ("rule", "verdict", "measured", "limit", "unit", "at x, y mm", "limit from")
    return table_lines(header, [_finding_row(f) for f in findings])


def remark_lines(findings: Sequence[Finding]) -> list[str]:
    """Findings of level info as lines: the coverlay, anchor and bend in use, and limits that are not met."""
    remarks = [
        f for f in findings if f.level == "info" and (not f.passed or f.rule.startswith(("coverlay", "anchor", "bend", "mark")))
    ]
    return [f"{f.rule}: {f.message}" for f in remarks]


def _finding_row(finding: Finding) -> tuple[str, ...]:
    verdict = "ok" if finding.passed else finding.level
    value = "" if finding.value is None else f"{round(finding.value, 3) + 0.0:.3f}"
    limit = "" if finding.limit is None else f"{finding.limit:.3f}"
    at = "" if finding.at_mm is None else f"{finding.at_mm[0]:.2f}, {finding.at_mm[1]:.2f}"
    source = f"{finding.source}{' (confirmed)' * finding.confirmed}"
    return finding.rule, verdict, value, limit, finding.unit if value else "", at, source


def table_lines(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as aligned columns."""
    rows = [[one_line(cell) for cell in row] for row in rows]
    # widths in characters: names are ASCII, and the Greek letters of headers are one column wide
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in [header, *rows]]


def echo_check(check: Check) -> None:
    """Print one line of a verification, replacing the progress on a terminal."""
    verdict = "ok  " if check.passed else "warn" if check.warning else "FAIL"
    clear_step()
    echo_line(f"{verdict}  {check.name.ljust(_CHECK_WIDTH)}  {check.message}")


def verified_line(checks: Sequence[Check]) -> str:
    """Text with the number of checks, and of those that were skipped, with the reasons."""
    skipped = sum(check.skipped for check in checks)
    line = f"verified: {counted(len(checks) - skipped, 'check')} of the written files"
    return line + (f", {skipped} not run: {_why(checks)}" if skipped else "")


def _why(checks: Sequence[Check]) -> str:
    """Reasons why checks were skipped."""
    names = [check.name for check in checks if check.skipped]
    return f"{', '.join(names[:_MOST_NAMED])}{' and others' * (len(names) > _MOST_NAMED)}"


def purpose_lines(folder: Path, files: Mapping[str, str]) -> list[str]:
    """The files of a result by purpose, as lines; `files` has paths by role, relative to the folder."""
    lines = []
    for purpose, roles in PURPOSES:
        paths = [str(folder / files[role]) for role in roles if role in files]
        if paths:
            lines.append(f"{purpose}: {', '.join(paths)}")
    return lines


def counted(count: int, noun: str) -> str:
    """A number with its noun, such as ``1 kit`` or ``2 kits``."""
    return f"{count} {noun}{'s' * (count != 1)}"


def echo_json(content: Any) -> None:
    click.echo(json.dumps(content, indent=1, ensure_ascii=True))


def echo_line(line: str, *, err: bool = False) -> None:
    """Print one line; control characters are escaped, as a name may come from an untrusted file."""
    try:
        click.echo(one_line(line), err=err)
    except OSError:
        if not err:
            raise
        sys.stderr = None  # a closed stderr must not stop the work, and flushing its buffer would fail again


def echo_lines(lines: Iterable[str]) -> None:
    for line in lines:
        echo_line(line)


def echo_lines_err(lines: Iterable[str]) -> None:
    for line in lines:
        echo_line(line, err=True)


def warn(findings: Sequence[Finding]) -> None:
    for finding in findings:
        if finding.level == "warn" and not finding.passed:
            echo_line(f"warning: {finding.rule}: {finding.message}", err=True)


def print_rules(findings: Sequence[Finding], *, force: bool) -> None:
    """Print remarks on the order, warnings and, with `force`, the broken blocking rules."""
    echo_lines_err(
        f"note: {f.rule}: {f.message}" for f in findings if f.level == "info" and not f.passed and f.rule in _OF_ORDERS
    )
    warn(findings)
    if force:
        echo_lines_err(f"forced: {line}" for line in rule_lines(findings))


def clear_step() -> None:
    """Clear the progress line of the terminal before a message."""
    if sys.stderr is not None and sys.stderr.isatty():
        with suppress(OSError):
            # carriage return, then erase in line (ECMA-48, EL)
            click.echo("\r\033[K", err=True, nl=False)


def step_shown() -> Callable[[str, int, int], None]:
    """Progress function that overwrites one line of the terminal; it prints nothing if stderr is not a terminal."""
    if sys.stderr is None or not sys.stderr.isatty():
        return lambda *_: None
    return lambda text, done, count: click.echo(f"\r{one_line(text)} {done} of {count}\033[K", err=True, nl=done == count)


def step_printed(before: str) -> Callable[[str, int, int], None]:
    """Progress function for long work: on a terminal as `step_shown`, else a line when a step begins, and one when it ends."""
    if sys.stderr is None or sys.stderr.isatty():
        return step_shown()
    last = ""

    def show(text: str, done: int, count: int) -> None:
        nonlocal last
        if text != last or done == count:
            echo_line(f"{before}{text} {done} of {count}", err=True)
        last = text

    return show
