"""The error tree, and the two kinds of line that the tool reports: Finding (design rules) and Check (verification)."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal, TypeVar

from tactape_fab.base.plain_text import one_line

T = TypeVar("T")
Level = Literal["block", "warn", "info"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One design rule, measured.

    Attributes
    ----------
    rule : str
        Stable id of the rule, such as ``pad-pad``.
    level : {"block", "warn", "info"}
        Consequence of a broken rule: the fab refuses, the fab asks, or a remark.
    passed : bool
        Whether the rule holds.
    value, limit : float or None
        The worst measured value and its threshold, in `unit`.
    unit : str
        ``"mm"``, ``"mm2"`` or ``""``.
    at_mm : tuple of float or None
        Place of the worst value (board frame, mm).
    message : str
        Text with value, limit and remedy.
    source : str
        Source of the threshold.
    confirmed : bool
        Whether the fab confirmed it.
    """

    rule: str
    level: Level
    passed: bool
    message: str
    value: float | None = None
    limit: float | None = None
    unit: str = "mm"
    at_mm: tuple[float, float] | None = None
    source: str = ""
    confirmed: bool = False

    def __post_init__(self) -> None:
        _plain_numbers(self, "value", "limit")

    @property
    def blocks(self) -> bool:
        """Whether the rule is broken and of level ``"block"``."""
        return self.level == "block" and not self.passed


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One line of a verification: what was compared, the figure, and whether it holds.

    Attributes
    ----------
    name : str
        Stable name of the comparison.
    passed : bool
        Whether it holds.
    message : str
        Text of what was compared and found.
    figure : float or None
        The worst measured value, in `unit`.
    unit : str
        ``"mm"``, another unit, or ``""``.
    warning : bool
        Whether a line that does not hold is a warning, and does not fail the kit.
    skipped : bool
        Whether nothing was compared, as what that needs is missing.
    """

    name: str
    passed: bool
    message: str
    figure: float | None = None
    unit: str = ""
    warning: bool = False
    skipped: bool = False

    def __post_init__(self) -> None:
        _plain_numbers(self, "figure")


def _plain_numbers(line: Finding | Check, *names: str) -> None:
    """Make every line fit for JSON: Python's bool and float in place of numpy's, None for NaN and infinity, and no control
    characters in texts, which may quote untrusted files.
    """
    object.__setattr__(line, "message", one_line(line.message))
    if isinstance(line, Check):
        object.__setattr__(line, "name", one_line(line.name))
    object.__setattr__(line, "passed", bool(line.passed))
    for name in names:
        value = getattr(line, name)
        if value is not None:
            # JSON has no NaN or infinity, which mean here that nothing was measured
            object.__setattr__(line, name, float(value) if isfinite(value) else None)


@dataclass(frozen=True, slots=True)
class Problem:
    """One refused value: the key it belongs to and the sentence for the user.

    ``needs`` are the other keys on which the check depends: if one of them is refused itself, the problem is dropped.
    """

    key: str
    message: str
    needs: tuple[str, ...] = ()

    @property
    def root(self) -> str:
        """The option that the key belongs to: ``size_mm`` for ``size_mm[0]``, ``fab`` for a key of the fab's profile."""
        return re.split(r"[ .\[:]", self.key)[0]

    @property
    def of_file(self) -> bool:
        """Whether the key is one in a file, such as ``fab mine: name``, so that names in the message are the file's."""
        return ": " in self.key


class ReachProblem(Problem):
    """A problem of capacity: valid numbers that exceed the code's range."""


def independent(found: Iterable[Problem], known: Sequence[Problem]) -> list[Problem]:
    """The problems that do not depend on a value that is already refused."""
    # a problem without a key concerns no option, so nothing depends on it
    refused = {problem.root for problem in known} - {""}
    return [problem for problem in found if refused.isdisjoint((problem.root, *problem.needs))]


class TactapeError(Exception):
    """Base class of all errors of this package."""


class SpecError(TactapeError, ValueError):
    """A value that a user gave is unreadable or out of range. Carries every problem found, not only the first.

    Attributes
    ----------
    problems : tuple of Problem
    findings : tuple of Finding
        Broken design rules that could be measured in spite of the problems.
    """

    def __init__(self, problems: str | Problem | Sequence[Problem], findings: Sequence[Finding] = ()) -> None:
        if isinstance(problems, str):
            problems = Problem("", problems)
        self.problems: tuple[Problem, ...] = (problems,) if isinstance(problems, Problem) else tuple(problems)
        self.findings: tuple[Finding, ...] = tuple(findings)
        super().__init__("\n".join(p.message for p in self.problems))

    # Exception's own would call the class with the text alone, and lose the problems on the way from another process
    def __reduce__(self) -> tuple[type[SpecError], tuple[Any, ...]]:
        return type(self), (self.problems, self.findings)


class CapacityError(SpecError):
    """The tape exceeds the range of the code plane."""


def refuse(problems: Sequence[Problem]) -> None:
    """Raise SpecError with these problems, if there are any."""
    if problems:
        raise SpecError(problems)


def refusal(problems: Sequence[Problem], findings: Sequence[Finding] = ()) -> SpecError:
    """The error with these problems: a CapacityError if the code's reach is the only problem."""
    reach_only = all(isinstance(problem, ReachProblem) for problem in problems)
    return (CapacityError if reach_only else SpecError)(problems, findings)


class DesignRuleError(TactapeError):
    """A legal spec that breaks design rules of its fab profile."""

    def __init__(self, findings: Sequence[Finding]) -> None:
        self.findings: tuple[Finding, ...] = tuple(findings)
        super().__init__("\n".join(f"{f.rule}: {f.message}" for f in self.findings if f.blocks))

    def __reduce__(self) -> tuple[type[DesignRuleError], tuple[Any, ...]]:
        return type(self), (self.findings,)


class MissingLibraryError(TactapeError, ImportError):
    """A library that is not installed; the message gives the install command."""


class RenderError(TactapeError):
    """A file of the kit could not be written."""


class FrameError(TactapeError, ValueError):
    """A frame that is not a depth map of the sensor: wrong shape, not numeric, too large."""


class VerifyError(TactapeError):
    """A written kit differs from its manifest.

    Attributes
    ----------
    checks : tuple of Check
        Every line of the verification, the failed ones included.
    """

    def __init__(self, checks: Sequence[Check]) -> None:
        self.checks: tuple[Check, ...] = tuple(checks)
        super().__init__("\n".join(f"{c.name}: {c.message}" for c in self.checks if not c.passed and not c.warning))

    def __reduce__(self) -> tuple[type[VerifyError], tuple[Any, ...]]:
        return type(self), (self.checks,)


class LostProcessError(Exception):
    """A process ended before it answered; its exit status is negative if a signal ended it, and the message says which."""

    def __init__(self, exit_status: int) -> None:
        super().__init__(f"was ended by signal {-exit_status}" if exit_status < 0 else f"ended with status {exit_status}")
        self.exit_status = exit_status


def reason_of(error: Exception) -> str:
    """The system's text for a failure, without errno and path; the error's own text if no system call failed."""
    if isinstance(error, RecursionError):
        return "it is nested too deep"
    text: str = getattr(error, "strerror", None) or str(error)
    # Python's remedy, a function to call, is none for who types a command
    return text.partition("; use sys.set_int_max_str_digits")[0]


def tried(read: Callable[[], T], problems: list[Problem]) -> T | None:
    """Result of `read`; None if it raises SpecError, whose problems are appended to the list."""
    try:
        return read()
    except SpecError as error:
        problems.extend(error.problems)
        return None
