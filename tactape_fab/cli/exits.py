"""Errors of the package -> messages on standard error and an exit status."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NoReturn

from tactape_fab.base.errors import DesignRuleError, FrameError, SpecError, TactapeError, VerifyError
from tactape_fab.base.libraries import missing
from tactape_fab.cli.printing import echo_line, rule_lines

_KEY = re.compile(r"(\w+)(?:\[\d\])?(?= = )")
FAILED, USAGE, RULES, VERIFICATION = 1, 2, 3, 4
"""Exit status besides 0: failure, a refused value, a broken design rule, a kit that failed its verification."""


def fail(status: int, lines: Sequence[str]) -> NoReturn:
    for line in lines:
        echo_line(f"error: {line}", err=True)
    sys.exit(status)


def _as_typed(line: str, typed: Mapping[str, str]) -> str:
    found = _KEY.match(line)
    return typed[found[1]] + line[found.end() :] if found is not None and found[1] in typed else line


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
def answers(typed: Mapping[str, str] | None = None) -> Iterator[None]:
    """Turn an error of the package into messages and an exit status.

    ``typed`` are keys of values and the options that they were typed as: a message begins with the option.
    """
    try:
        yield
    except TactapeError as error:
        status, lines = answer(error)
        fail(status, [_as_typed(line, typed or {}) for line in lines])
    except MemoryError:
        fail(FAILED, ["there is not enough memory for this; free some, or give a smaller input"])
    except ModuleNotFoundError as error:  # an installation without the package's dependencies, as on a robot
        if error.name is None or error.name.startswith("tactape_fab"):
            raise
        fail(FAILED, [missing(error.name, "this command")])
