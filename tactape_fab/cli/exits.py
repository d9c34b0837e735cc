"""Errors of the package -> messages on standard error and an exit status."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NoReturn

import click
from click.core import ParameterSource

from tactape_fab.base.errors import DesignRuleError, FrameError, SpecError, TactapeError, VerifyError
from tactape_fab.base.libraries import missing
from tactape_fab.cli.printing import echo_line, rule_lines

_KEY = re.compile(r"(?:scene\.)?(\w+)(?:\[\d+\])*(?= = | contradicts )")
_UNIT = re.compile(r"_(mm|deg|um|px|n|kpa)$")
FAILED, USAGE, RULES, VERIFICATION = 1, 2, 3, 4
"""Exit status besides 0: failure, a refused value, a broken design rule, a kit that failed its verification."""


def fail(status: int, lines: Sequence[str]) -> NoReturn:
    for line in lines:
        echo_line(f"error: {line}", err=True)
    sys.exit(status)


def _options() -> dict[str, str]:
    """The options that the user typed, by the names of their values."""
    context = click.get_current_context(silent=True)
    if context is None:
        return {}
    typed = (p for p in context.command.params if context.get_parameter_source(p.name or "") is ParameterSource.COMMANDLINE)
    return {p.name: p.opts[0] for p in typed if isinstance(p, click.Option) and p.name is not None}


def _as_typed(line: str, typed: Mapping[str, str]) -> str:
    """A message that begins with a key: with the option in its place, if the value was given by one; a file's key stays."""
    found = _KEY.match(line)
    option = None if found is None else typed.get(found[1]) or typed.get(_UNIT.sub("", found[1]))
    return line if found is None or option is None else option + line[found.end() :]


def answer(error: TactapeError) -> tuple[int, list[str]]:
    """Exit status and messages of an error of the package."""
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
    """Turn an error of the package into messages and an exit status; a message names an option as it was typed."""
    try:
        yield
    except TactapeError as error:
        status, lines = answer(error)
        typed = _options()
        fail(status, [_as_typed(line, typed) for line in lines])
    except MemoryError:
        fail(FAILED, ["there is not enough memory for this; free some, or give a smaller input"])
    except ModuleNotFoundError as error:  # an installation without the package's dependencies, as on a robot
        if error.name is None or error.name.startswith("tactape_fab"):
            raise
        fail(FAILED, [missing(error.name, "this command")])
