"""What is printed, and how a command ends."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

import click

from tactape_fab.base.errors import DesignRuleError, Finding, FrameError, SpecError, TactapeError, VerifyError
from tactape_fab.base.libraries import missing
from tactape_fab.cli.printing import rule_lines

FAILED, USAGE, RULES, VERIFICATION = 1, 2, 3, 4
"""Exit status besides 0: failure, a refused value, a broken design rule, a kit that is not what it should be."""


def fail(status: int, lines: Sequence[str]) -> NoReturn:
    for line in lines:
        click.echo(f"error: {line}", err=True)
    sys.exit(status)


def answer(error: TactapeError) -> tuple[int, list[str]]:
    """Exit status and messages of what the package raises."""
    match error:
        case SpecError():
            return USAGE, [*(p.message for p in error.problems), *rule_lines(error.findings)]
        case DesignRuleError():
            return RULES, rule_lines(error.findings)
        case VerifyError():
            return VERIFICATION, [f"{c.name}: {c.message}" for c in error.checks if not c.passed and not c.warning]
    return USAGE if isinstance(error, FrameError) else FAILED, str(error).splitlines()


@contextmanager
def answers() -> Iterator[None]:
    """Turn what the package raises into messages and an exit status."""
    try:
        yield
    except TactapeError as error:
        fail(*answer(error))
    except ModuleNotFoundError as error:  # an installation without the package's own dependencies, as a robot's
        if error.name is None or error.name.startswith("tactape_fab"):
            raise
        fail(FAILED, [missing(error.name, "this command")])


def echo_json(content: Any) -> None:
    click.echo(json.dumps(content, indent=1, ensure_ascii=True))


def warn(findings: Sequence[Finding]) -> None:
    for finding in findings:
        if finding.level == "warn" and not finding.passed:
            click.echo(f"warning: {finding.rule}: {finding.message}", err=True)


def say_rules(findings: Sequence[Finding], *, force: bool) -> None:
    """Warnings, and what is made in spite of the rules."""
    warn(findings)
    if force:
        echo_lines_err(f"forced: {line}" for line in rule_lines(findings))


def echo_lines(lines: Iterable[str]) -> None:
    for line in lines:
        click.echo(line)


def echo_lines_err(lines: Iterable[str]) -> None:
    for line in lines:
        click.echo(line, err=True)


def clear_step() -> None:
    """Take progress off the line of the terminal that a message is to stand on."""
    if sys.stderr is not None and sys.stderr.isatty():
        click.echo("\r\033[K", err=True, nl=False)


def step_shown() -> Callable[[str, int, int], None]:
    """Progress as one line of a terminal, written over; nothing elsewhere."""
    if sys.stderr is None or not sys.stderr.isatty():
        return lambda *_: None
    return lambda text, done, count: click.echo(f"\r{text} {done} of {count}\033[K", err=True, nl=done == count)
