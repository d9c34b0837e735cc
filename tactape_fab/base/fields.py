"""Reader of untrusted mappings (options, TOML, JSON), field by field, that collects every problem."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from datetime import date, time
from numbers import Integral, Real
from typing import Any

from tactape_fab.base.errors import Problem

_SHOWN_CHARACTERS = 60
_MOST_UNKNOWN = 20
"""Most unknown keys of one table that are reported one by one."""
_SHOWN_PATH = 200


def shown(value: object) -> str:
    """A value as text for a message: one short line."""
    try:
        # dates as TOML writes them; the repr of an array has line breaks
        text = str(value) if isinstance(value, date | time) else re.sub(r"\s*\n\s*", " ", repr(value))
    except (ValueError, RecursionError):  # an integer of thousands of digits (sys.int_info), or tables within tables
        text = f"<{type(value).__name__} too long to show>"
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 3] + "..."


def shown_path(path: object) -> str:
    """A path as text for a message; a long one is cut at its beginning, so that the file's name stays."""
    text = str(path)
    text = text if text.isprintable() else repr(text)
    return text if len(text) <= _SHOWN_PATH else "..." + text[-_SHOWN_PATH:]


def named(items: Sequence[str], most: int = 5) -> str:
    """The first few items of a list, and the number of the others, for a message."""
    more = len(items) - most
    return ", ".join(items[:most]) + (f" and {more} more" if more > 0 else "")


def counted(number: object, one: str, many: str) -> str:
    """A number and what it counts, for a message: ``1 body``, ``2 bodies``."""
    return f"{number} {one if number in (1, '1') else many}"


def _range_text(low: float, high: float, above: float, below: float, of_unit: str) -> str:
    """Text of the bounds, for a message without a better remedy."""
    least = f"from {low:g}" if math.isfinite(low) else f"above {above:g}" if math.isfinite(above) else ""
    most = f"to {high:g}" if math.isfinite(high) else f"and below {below:g}" if math.isfinite(below) else ""
    return " ".join(["a number", *filter(None, (least, most if least else most.removeprefix("and ")))]) + of_unit


def nearest(value: str, known: Sequence[str]) -> str | None:
    """The known name that was probably meant: it differs in case or by a letter, or one of its words begins with the value."""
    folded = {name.casefold(): name for name in known}
    if value.casefold() in folded:
        return folded[value.casefold()]
    parts = [
        name
        for name in known
        # the value at the beginning of a word of the name, not followed by a digit: "020" is not meant as 0201
        if len(value) > 1 and re.search(rf"(?<![a-z0-9]){re.escape(value.casefold())}(?![0-9])", name.casefold())
    ]
    near = difflib.get_close_matches(value.casefold(), folded, n=1)
    return min(parts, default=folded[near[0]] if near else None)


def unknown_key(key: object, known: Sequence[str], where: str = "") -> Problem:
    """The problem of an unknown key, with the nearest known one."""
    near = difflib.get_close_matches(str(key), known, n=1)
    hint = f"did you mean '{near[0]}'?" if near else "known are: " + ", ".join(known)
    name = str(key)[:_SHOWN_CHARACTERS]
    return Problem(name, f"{where}{name} is not a known key; {hint}")


class Fields:
    """One table of untrusted values.

    Every reader returns a usable value even after a problem, so that all problems come together;
    the caller looks at `problems` when it has read everything.

    where: Prefix of the key in messages, such as ``"board."``.
    problems: Where problems are collected (shared with nested tables).
    """

    def __init__(self, values: Mapping[str, Any], where: str = "", problems: list[Problem] | None = None) -> None:
        self.values = values
        self.where = where
        self.problems: list[Problem] = [] if problems is None else problems

    def problem(self, key: str, message: str) -> None:
        """Collect a problem of a key, which is named as the user typed it."""
        self.problems.append(Problem(self.where + key, self.where + message))

    def refused(self, key: str) -> bool:
        """Whether a value was refused before, so that values which depend on it cannot be checked."""
        return any(problem.root == key for problem in self.problems)

    def refuse_unknown(self, known: Sequence[str]) -> None:
        """Collect a problem for each key that is not known, with the one that was probably meant."""
        unknown = [key for key in self.values if key not in known]
        self.problems += [unknown_key(key, known, self.where) for key in unknown[:_MOST_UNKNOWN]]
        if len(unknown) > _MOST_UNKNOWN:  # to look for what each was meant to be takes 0.4 ms
            more = f"{len(unknown) - _MOST_UNKNOWN} more keys are not known; known are: {', '.join(known)}"
            self.problems.append(Problem(str(unknown[_MOST_UNKNOWN])[:_SHOWN_CHARACTERS], self.where + more))

    def _missing(self, key: str, what: str) -> None:
        self.problem(key, f"{key} is missing; give {what}")

    def number(
        self,
        key: str,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        above: float = -math.inf,
        below: float = math.inf,
        unit: str = "mm",
        remedy: str = "",
        default: float = math.nan,
    ) -> float:
        """A finite number with low <= value <= high and above < value < below."""
        if key not in self.values:
            self._missing(key, f"a number in {unit}" if unit else "a number")
            return default
        value, of_unit = self.values[key], f" {unit}" if unit else ""
        then = f"; {remedy or 'give ' + _range_text(low, high, above, below, of_unit)}"
        # bool is a subclass of int: true would be 1
        if isinstance(value, bool) or not isinstance(value, Real):
            self.problem(key, f"{key} = {shown(value)} is not a number{f' in {unit}' if unit else ''}{then}")
            return default
        try:
            number = float(value)
        # an integer beyond 1.8e308
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.problem(key, f"{key} = {shown(value)}{of_unit} is not a finite number{then}")
        elif number < low or number <= above:
            bound = f"below {low:g}" if number < low else f"not above {above:g}"
            self.problem(key, f"{key} = {number:g}{of_unit} is {bound}{of_unit}{then}")
        elif number > high or number >= below:
            bound = f"exceeds {high:g}" if number > high else f"is not below {below:g}"
            self.problem(key, f"{key} = {number:g}{of_unit} {bound}{of_unit}{then}")
        else:
            return number
        return default

    def numbers(
        self,
        key: str,
        count: int,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        above: float = -math.inf,
        unit: str = "mm",
        remedy: str = "",
        default: Sequence[float] | None = None,
    ) -> tuple[float, ...]:
        """A sequence of exactly `count` finite numbers, each within the same bounds."""
        fallback = tuple(default) if default is not None else (math.nan,) * count
        each = self._each(key, count, "numbers", f" in {unit}" if unit else "", remedy)
        if each is None:
            return fallback
        both = zip(each.values, fallback, strict=True)
        return tuple(
            each.number(name, low=low, high=high, above=above, unit=unit, remedy=remedy, default=other) for name, other in both
        )

    def _each(self, key: str, count: int, what: str, of_unit: str, remedy: str) -> Fields | None:
        """The items of a sequence of length `count`, each under its own key such as ``size_mm[0]``; None if it is not one."""
        if key not in self.values:
            self._missing(key, f"{count} {what}{of_unit}")
            return None
        value = self.values[key]
        # a string is a sequence as well: "abc" would be three items
        if isinstance(value, str) or not isinstance(value, Sequence) or len(value) != count:
            self.problem(key, f"{key} = {shown(value)} is not {count} {what}; {remedy or f'give a list of {count}'}")
            return None
        return Fields({f"{key}[{i}]": item for i, item in enumerate(value)}, self.where, self.problems)

    def integer(self, key: str, *, low: int, high: int, remedy: str = "", default: int = 0) -> int:
        """A whole number with low <= value <= high."""
        if key not in self.values:
            self._missing(key, f"a whole number from {low} to {high}")
            return default
        value, then = self.values[key], f"; {remedy or f'give one from {low} to {high}'}"
        if isinstance(value, bool) or not isinstance(value, Integral):
            if isinstance(value, float) and value.is_integer() and low <= value <= high:  # as of 1e3
                then = f", as it is written with a point or an exponent; give {int(value)}"
            self.problem(key, f"{key} = {shown(value)} is not a whole number{then}")
            return default
        whole = int(value)
        if not low <= whole <= high:
            self.problem(key, f"{key} = {shown(whole)} is outside {low} to {high}{then}")
            return default
        return whole

    def integers(
        self, key: str, count: int, *, low: int, high: int, remedy: str = "", default: Sequence[int] | None = None
    ) -> tuple[int, ...]:
        """A sequence of exactly `count` whole numbers, each within the same bounds."""
        fallback = tuple(default) if default is not None else (low,) * count
        each = self._each(key, count, "whole numbers", "", remedy)
        if each is None:
            return fallback
        both = zip(each.values, fallback, strict=True)
        return tuple(each.integer(name, low=low, high=high, remedy=remedy, default=other) for name, other in both)

    def text(
        self,
        key: str,
        *,
        choices: Sequence[str] = (),
        pattern: str = "",
        remedy: str = "",
        default: str = "",
        longest: int = 10_000,
    ) -> str:
        """A string, one of `choices` if given, fully matching `pattern` if given."""
        if key not in self.values:
            self._missing(key, "one of " + ", ".join(choices) if choices else "a text")
            return default
        value = self.values[key]
        if not isinstance(value, str) or len(value) > longest:
            wanted = "one of: " + ", ".join(choices) if choices else f"at most {longest} characters in quotes"
            wrong = f"has {len(value)} characters" if isinstance(value, str) else "is not a text"
            self.problem(key, f"{key} = {shown(value)} {wrong}; {remedy or f'give {wanted}'}")
        elif choices and value not in choices:
            near = nearest(value, choices)
            hint = f"did you mean '{near}'?" if near else remedy or "give one of them"
            self.problem(key, f"{key} = {shown(value)} is none of: {', '.join(choices)}; {hint}")
        elif pattern and not re.fullmatch(pattern, value):
            self.problem(key, f"{key} = {shown(value)} has a form that cannot be used; {remedy or pattern}")
        else:
            return value
        return default

    def choice(self, key: str, choices: Sequence[str]) -> str:
        """One of `choices`; the first of them where none is given."""
        return self.text(key, choices=choices, default=choices[0]) if key in self.values else choices[0]

    def flag(self, key: str, *, default: bool = False) -> bool:
        """A bool; `default` where it is missing or no bool, which is collected as a problem."""
        if key not in self.values:
            self._missing(key, "true or false")
            return default
        value = self.values[key]
        if not isinstance(value, bool):
            self.problem(key, f"{key} = {shown(value)} is neither true nor false; give one of them")
            return default
        return value

    def table(self, key: str, known: Sequence[str] | None = None) -> Fields:
        """A nested table; its problems are collected here, under ``key.``; keys not in `known` are refused."""
        value = self.values.get(key)
        if not isinstance(value, Mapping):
            what = f"{key} = {shown(value)} is not a table" if key in self.values else f"{key} is missing"
            message = f"{what}; give a table of that name"
            if Problem(self.where + key, self.where + message) not in self.problems:  # several readers may ask for one table
                self.problem(key, message)
            value = {}
        table = Fields(value, f"{self.where}{key}.", self.problems)
        if known is not None:
            table.refuse_unknown(known)
        return table

    def rows(self, key: str, *, longest: int, remedy: str = "give a list") -> Sequence[Any]:
        """A list of at most `longest` entries of any type."""
        value = self.values.get(key)
        if isinstance(value, str) or not isinstance(value, Sequence):
            what = f"{key} = {shown(value)} is not a list" if key in self.values else f"{key} is missing"
            self.problem(key, f"{what}; {remedy}")
            return ()
        if len(value) > longest:
            self.problem(key, f"{key} has {len(value)} entries, more than {longest}; give fewer")
            return ()
        return value
