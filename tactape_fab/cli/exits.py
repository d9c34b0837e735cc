"""Conversion of the package's errors to messages on standard error and an exit status."""

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

# a key that is not in a word, path, option or quotes; then its index; then an equals sign
# and the value of a flag or list, or, as lookahead, words that follow a key
_KEY = re.compile(
    r"(?<![\w.'-])(?:scene\.)?(\w+?)(?:\[(\d+)\])?(\[\d+\])?"
    r"(?: = (?:([Tt]rue|[Ff]alse)\b(?: \(--[\w-]+\))?|(\[[^\]]{0,200}\]))|(?= = | contradicts | is of ))"
)
"""Matches an option's key in a message, such as ``size_mm[0] = ``, which is replaced by the option as typed."""
_ARGUMENT = re.compile(r"(?<= )(\w+)=(?:'([\w-]+)'|([\w.-]+(?:,[\w.-]+)*))|(?<=give another )(\w+)")
"""Matches a Python argument in a remedy, such as ``world='open'`` or ``force=True``, which is replaced by the option."""
_KITS = re.compile(r"(?:name the tape's|give (?:its|the|one of its)) kits?\b(?! that)")
"""Matches the request for kits in a remedy, to which ``--tape`` is added."""
_PART = "\0"
"""Marks the place between a whole typed value and a message about one part of it, to make
``--size = '0x50': 0 mm is not above 0 mm``."""
_UNIT = re.compile(r"_(mm|deg|um|px|n|kpa)$")
_MOST_CHARACTERS = 4000
"""Most characters of a problem that are searched and printed: a key of a hostile file may have a megabyte."""
_MOST_TYPED = 200
"""Most characters of a typed value that are printed."""
_MOST_LINES = 200
"""Most problems that are printed: a hostile file may have one in each of 300,000 rows."""
FAILED, USAGE, RULES, VERIFICATION = 1, 2, 3, 4
"""Exit status besides 0: failure, a refused value, a broken design rule, a kit that failed its verification."""


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Context manager: SIGTERM, SIGHUP and Ctrl-C raise an exception in the block, so that unfinished files, temporary folders
    and child processes are removed. The exit status is that of the signal, even if a library converts the exception to another
    one. The caller's signal handlers are restored afterwards.
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
            # nohup ignores SIGHUP, which is respected; a calling program may have its own handler for Ctrl-C
            if handler != signal.SIG_IGN and (number != signal.SIGINT or handler == signal.default_int_handler):
                signal.signal(number, leave)
        yield
    except BaseException:
        # __set_name__ of Python 3.11 and reportlab's fonts convert exceptions to others
        if asked and asked[-1] == signal.SIGINT:
            raise KeyboardInterrupt from None
        if asked:
            sys.exit(128 + asked[-1])
        raise
    finally:
        for number, handler in before.items():
            if handler is not None:  # None: it was not set from Python
                signal.signal(number, handler)


def fail(status: int, lines: Sequence[str]) -> NoReturn:
    for line in lines:
        echo_line(f"error: {line}", err=True)
    sys.exit(status)


def _options() -> dict[str, tuple[str, Any]]:
    """Names and texts of the options and arguments that the user typed, by parameter name and by option name."""
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
    """A message in which keys given by an option are replaced by that option, and their values by the typed text."""

    def option(found: re.Match[str]) -> str:
        key, index, inner, flag, listed = found.groups()
        name, text = typed.get(key) or typed.get(_UNIT.sub("", key)) or ("", None)
        if isinstance(text, tuple):  # the option may be given several times
            text, index = text[int(index or 0)] if int(index or 0) < len(text) else None, inner
        # the message has a flag's value, but the typed option of that name has a text: it is another option
        if not name or (flag and isinstance(text, str)):
            return found[0]
        # the message is about one part of a value that was typed as a
        # whole, such as 0x50: the whole is shown, then the part
        if index is not None and isinstance(text, str):
            return f"{name} = {_cut(text)}:{_PART}"
        return f"{name} = {_cut(text)}" if listed and isinstance(text, str) else name + (f" = {listed}" if listed else "")

    return _KEY.sub(option, line).replace(f"{_PART} = ", " ").replace(f":{_PART}", "")


def _cut(text: str) -> str:
    """A typed text in quotes, without the middle of a long one: that of a path has a name at its end."""
    whole, half = repr(text), _MOST_TYPED // 2
    return whole if len(whole) <= _MOST_TYPED else f"{whole[:half]}...{whole[-half:]}"


def _shortened(line: str) -> str:
    """A message shortened to `_MOST_CHARACTERS`; its end, which has the remedy, is kept."""
    more = len(line) - _MOST_CHARACTERS
    return (
        line
        if more <= 0
        else f"{line[: _MOST_CHARACTERS // 2]} ... ({more} more characters) ... {line[-_MOST_CHARACTERS // 2 :]}"
    )


def _own_remedies(names: Sequence[str], line: str) -> str:
    """A message without remedies that are options of other commands, as several commands share the code that refuses."""
    message, use, remedy = line.rpartition("; use ")
    ways = re.split(r",? or (?=--|a )", remedy)
    known = [way for way in ways if set(re.findall(r"--([\w-]+)", way)) <= {*names}]
    return line if not (use and names) or len(known) in (0, len(ways)) else f"{message}{use}{', or '.join(known)}"


def with_options(line: str) -> str:
    """A message whose remedy has options in place of Python arguments: ``--world open``, and ``--tape`` for kits."""
    context = click.get_current_context(silent=True)
    names = [option.lstrip("-") for p in (context.command.params if context else ()) for option in p.opts]

    def option(found: re.Match[str]) -> str:
        name = (found[1] or found[4]).replace("_", "-")
        value = found[2] or found[3]
        return found[0] if name not in names else f"--{name} {value}" if value and value != "True" else f"--{name}"

    if names and "as-built" not in names:  # the command always uses the kit's own file
        way = "leave out --from" if "from" in names else "move its as-built.json away"
        line = line.replace("give as_built='none' for", f"{way} for")
    line = _own_remedies(names, _ARGUMENT.sub(option, line))
    return _KITS.sub(r"\g<0> with --tape", line) if "tape" in names else line


def _as_in_file(problem: Problem, typed: Mapping[str, tuple[str, Any]]) -> str:
    """A problem's message; a remedy that leaves out an option names the spec file's key, if no option gave the value."""
    key = problem.root
    name = _UNIT.sub("", key)
    if key in typed or name in typed:
        return problem.message
    return re.sub(rf"(?<=leave )(out )?--{re.escape(name.replace('_', '-'))}(?![\w-])", rf"\g<1>{key}", problem.message)


def answer(error: TactapeError, typed: Mapping[str, tuple[str, Any]] | None = None) -> tuple[int, list[str]]:
    """Exit status and messages of an error of the package.

    typed: The typed options, which replace keys in messages; keys of a file are kept.
    """

    def as_typed(lines: Iterable[str]) -> list[str]:
        return [_as_typed(_shortened(line), typed or {}) for line in lines]

    match error:
        case SpecError():
            short = [replace(p, message=_shortened(p.message)) for p in error.problems]
            problems = [p.message if p.of_file else _as_typed(_as_in_file(p, typed or {}), typed or {}) for p in short]
            return USAGE, [*problems, *as_typed(rule_lines(error.findings))]
        case DesignRuleError():
            return RULES, as_typed(rule_lines(error.findings))
        case VerifyError():
            return VERIFICATION, as_typed(f"{c.name}: {c.message}" for c in error.checks if not c.passed and not c.warning)
    return USAGE if isinstance(error, FrameError) else FAILED, as_typed(str(error).splitlines())


@contextmanager
def answers() -> Iterator[None]:
    """Context manager: turns an error of the package into messages, which name options as typed, and an exit status."""
    try:
        yield
    except TactapeError as error:
        status, lines = answer(error, _options())
        lines = list(dict.fromkeys(map(with_options, lines)))  # for 0x0 both parts give the same message
        more = [f"{len(lines) - _MOST_LINES} more problems; correct these first"] if len(lines) > _MOST_LINES else []
        fail(status, [*lines[:_MOST_LINES], *more])
    except ModuleNotFoundError as error:  # an installation without all dependencies, as on a robot
        if error.name is None or error.name.startswith("tactape_fab"):
            raise
        fail(FAILED, [missing(error.name, "this command")])
