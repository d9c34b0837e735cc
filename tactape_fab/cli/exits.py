"""Errors of the package -> messages on standard error and an exit status."""

from __future__ import annotations

import re
import signal
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from types import FrameType
from typing import Any, NoReturn

import click
from click.core import ParameterSource

from tactape_fab.base.errors import DesignRuleError, FrameError, Problem, SpecError, TactapeError, VerifyError
from tactape_fab.base.libraries import missing
from tactape_fab.cli.printing import echo_line, rule_lines

# not within a word, a path, an option or quotes; then its index, and an equals
# sign with a flag's or a list's text, or words that mean the value
_KEY = re.compile(
    r"(?<![\w.'-])(?:scene\.)?(\w+?)(?:\[(\d+)\])?(\[\d+\])?"
    r"(?: = (?:([Tt]rue|[Ff]alse)\b(?: \(--[\w-]+\))?|(\[[^\]]{0,200}\]))|(?= = | contradicts | is of ))"
)
"""A key of the package in a message, with the value of a flag or a list."""
_ARGUMENT = re.compile(r"(?<= )(\w+)=(?:'([\w-]+)'|([\w.-]+(?:,[\w.-]+)*))|(?<=give another )(\w+)")
"""An argument that a remedy names as Python has it, ``world='open'``, with its value; a flag's is True."""
_KITS = re.compile(r"(?:name the tape's|give (?:its|the|one of its)) kits?\b(?! that)")
"""The kits that a remedy asks for, which are arguments of their own in Python."""
_PART = "\0"
"""Behind the whole value that was typed, where a message is of a part of it: ``--size = '0x50': 0 mm is not above 0 mm``."""
_UNIT = re.compile(r"_(mm|deg|um|px|n|kpa)$")
_MOST_CHARACTERS = 4000
"""Of a problem that are printed, and looked at: a key of a hostile file has a megabyte."""
_MOST_LINES = 200
"""Problems that are printed: a hostile file has one in each of 300,000 rows."""
FAILED, USAGE, RULES, VERIFICATION = 1, 2, 3, 4
"""Exit status besides 0: failure, a refused value, a broken design rule, a kit that failed its verification."""


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Context manager: a stop request, or a terminal that is closed, ends the command as an error does. Unfinished files are
    removed, and so are temporary folders and processes. The program that calls the command has its own handlers again afterwards.
    The exit status is the signal's, also if a library made an error of its own of it.
    """
    asked: list[int] = []

    def leave(number: int, frame: FrameType | None) -> NoReturn:
        asked.append(number)
        if number == signal.SIGINT:
            signal.default_int_handler(number, frame)
        sys.exit(128 + number)

    before: dict[int, Any] = {}
    # Windows has no SIGHUP, and only a main thread may have handlers
    if threading.current_thread() is threading.main_thread():
        numbers = (getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP", "SIGINT"))
        before = {int(n): signal.getsignal(n) for n in numbers if n}
    try:
        for number, handler in before.items():
            # nohup has one ignored, and the command goes on; a program that calls this one may have its own for Ctrl-C
            if handler != signal.SIG_IGN and (number != signal.SIGINT or handler == signal.default_int_handler):
                signal.signal(number, leave)
        yield
    except BaseException:
        # libraries turn what ends the command into an error of their own: __set_name__ of Python 3.11, reportlab's fonts
        if asked and asked[-1] == signal.SIGINT:
            raise KeyboardInterrupt from None
        if asked:
            sys.exit(128 + asked[-1])
        raise
    finally:
        for number, handler in before.items():
            if handler is not None:  # one that no Python function set
                signal.signal(number, handler)


def fail(status: int, lines: Sequence[str]) -> NoReturn:
    for line in lines:
        echo_line(f"error: {line}", err=True)
    sys.exit(status)


def _options() -> dict[str, tuple[str, Any]]:
    """The options and arguments that the user typed, with their texts, by the names of their values and their own."""
    context = click.get_current_context(silent=True)
    if context is None:
        return {}
    typed = {}
    for given in context.command.params:
        if given.name is not None and context.get_parameter_source(given.name) is ParameterSource.COMMANDLINE:
            option = given.opts[0] if isinstance(given, click.Option) else given.make_metavar(context).strip("[]")
            for name in (given.name, given.opts[0].lstrip("-").replace("-", "_")):
                typed[name] = (option, context.params.get(given.name))
    return typed


def _as_typed(line: str, typed: Mapping[str, tuple[str, Any]]) -> str:
    """A message with options in place of keys whose values were given by one, and lists as typed."""

    def option(found: re.Match[str]) -> str:
        key, index, inner, flag, listed = found.groups()
        name, text = typed.get(key) or typed.get(_UNIT.sub("", key)) or ("", None)
        if isinstance(text, tuple):  # of an option that may be given several times
            text, index = text[int(index or 0)] if int(index or 0) < len(text) else None, inner
        # a flag's value in the message and a text that was typed: another option of that name
        if not name or (flag and isinstance(text, str)):
            return found[0]
        # of a value that was typed as a whole, such as 0x50, a message
        # is about one part: the whole is shown, and the part behind it
        if index is not None and isinstance(text, str):
            return f"{name} = {text!r}:{_PART}"
        return f"{name} = {text!r}" if listed and isinstance(text, str) else name + (f" = {listed}" if listed else "")

    return _KEY.sub(option, line).replace(f"{_PART} = ", " ").replace(f":{_PART}", "")


def _within(line: str) -> str:
    """A message without what makes it too long; its end, which says the remedy, is kept."""
    more = len(line) - _MOST_CHARACTERS
    return (
        line
        if more <= 0
        else f"{line[: _MOST_CHARACTERS // 2]} ... ({more} more characters) ... {line[-_MOST_CHARACTERS // 2 :]}"
    )


def _ways_of(names: Sequence[str], line: str) -> str:
    """A message without those ways out that are options of other commands: tapes of a size are made by several."""
    said, use, remedy = line.rpartition("; use ")
    ways = re.split(r",? or (?=--|a )", remedy)
    known = [way for way in ways if set(re.findall(r"--([\w-]+)", way)) <= {*names}]
    return line if not (use and names) or len(known) in (0, len(ways)) else f"{said}{use}{', or '.join(known)}"


def with_options(line: str) -> str:
    """A message with options in place of arguments that its remedy names: ``--world open``; kits by ``--tape``."""
    context = click.get_current_context(silent=True)
    names = [option.lstrip("-") for p in (context.command.params if context else ()) for option in p.opts]

    def option(found: re.Match[str]) -> str:
        name = (found[1] or found[4]).replace("_", "-")
        value = found[2] or found[3]
        return found[0] if name not in names else f"--{name} {value}" if value and value != "True" else f"--{name}"

    if names and "as-built" not in names:  # a command that takes the kit's file as it is
        way = "leave out --from" if "from" in names else "move its as-built.json away"
        line = line.replace("give as_built='none' for", f"{way} for")
    line = _ways_of(names, _ARGUMENT.sub(option, line))
    return _KITS.sub(r"\g<0> with --tape", line) if "tape" in names else line


def _as_in_file(problem: Problem, typed: Mapping[str, tuple[str, Any]]) -> str:
    """A problem's message: what is to be left out is named as in the spec file, where no option gave it."""
    key = problem.root
    name = _UNIT.sub("", key)
    if key in typed or name in typed:
        return problem.message
    return re.sub(rf"(?<=leave )(out )?--{re.escape(name.replace('_', '-'))}(?![\w-])", rf"\g<1>{key}", problem.message)


def answer(error: TactapeError, typed: Mapping[str, tuple[str, Any]] | None = None) -> tuple[int, list[str]]:
    """Exit status and messages of an error of the package.

    typed: Options that messages name in place of keys, with their texts; the keys of a file stay.
    """

    def said(lines: Iterable[str]) -> list[str]:
        return [_as_typed(_within(line), typed or {}) for line in lines]

    match error:
        case SpecError():
            short = [replace(p, message=_within(p.message)) for p in error.problems]
            problems = [p.message if p.of_file else _as_typed(_as_in_file(p, typed or {}), typed or {}) for p in short]
            return USAGE, [*problems, *said(rule_lines(error.findings))]
        case DesignRuleError():
            return RULES, said(rule_lines(error.findings))
        case VerifyError():
            return VERIFICATION, said(f"{c.name}: {c.message}" for c in error.checks if not c.passed and not c.warning)
    return USAGE if isinstance(error, FrameError) else FAILED, said(str(error).splitlines())


@contextmanager
def answers() -> Iterator[None]:
    """Turn an error of the package into messages and an exit status; a message names an option as it was typed."""
    try:
        yield
    except TactapeError as error:
        status, lines = answer(error, _options())
        lines = list(dict.fromkeys(map(with_options, lines)))  # both sides of 0x0 say the same
        more = [f"{len(lines) - _MOST_LINES} more problems; correct these first"] if len(lines) > _MOST_LINES else []
        fail(status, [*lines[:_MOST_LINES], *more])
    except MemoryError:
        fail(FAILED, ["there is not enough memory for this; free some, or give a smaller input"])
    except ModuleNotFoundError as error:  # an installation without the package's dependencies, as on a robot
        if error.name is None or error.name.startswith("tactape_fab"):
            raise
        fail(FAILED, [missing(error.name, "this command")])
