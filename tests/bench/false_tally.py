"""Counts of frames that should not be located: how many were, where, and how near the others came."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import floor, log10
from typing import Any, Literal

from tactape_fab import Localization
from tactape_fab.sense.decode.rule import MAX_P_FALSE

Bound = Literal["p_false", "p_tape", "p_place"]
BOUNDS: tuple[Bound, ...] = ("p_false", "p_tape", "p_place")
DECADES = 8
CONFIDENCE = 0.95


@dataclass(slots=True, kw_only=True)
class Tally:
    """How many frames were located, and how often each bound was how small, located or not.

    Attributes
    ----------
    by : dict
        Located frames by contact.
    least, where : dict
        Smallest value of each bound, and the frame.
    decades : dict
        For each bound, how many frames had one of at most 0.1, 0.01, ...; p_place where p_tape does not refuse the frame, for
        unregistered tapes are in it only there.
    accepted : list of str
        The located frames.
    made_s, located_s : float
        Time that the frames took to make, and to be located.
    """

    frames: int = 0
    located: int = 0
    by: Counter[str] = field(default_factory=Counter)
    least: dict[str, float] = field(default_factory=lambda: dict.fromkeys(BOUNDS, 1.0))
    where: dict[str, str] = field(default_factory=lambda: dict.fromkeys(BOUNDS, "-"))
    decades: dict[str, list[int]] = field(default_factory=lambda: {bound: [0] * DECADES for bound in BOUNDS})
    accepted: list[str] = field(default_factory=list)
    made_s: float = 0.0
    located_s: float = 0.0

    def add(self, name: str, contact: str, fix: Localization) -> None:
        """Count one frame."""
        self.frames += 1
        if fix.located:
            self.located += 1
            self.by[contact] += 1
            self.accepted.append(name)
        for bound in BOUNDS:
            value = getattr(fix, bound)
            if value is None or (bound == "p_place" and fix.p_tape is not None and fix.p_tape > MAX_P_FALSE):
                continue
            if value < self.least[bound]:
                self.least[bound], self.where[bound] = value, name
            reached = DECADES if value <= 0.0 else min(max(floor(-log10(value) + 1e-12), 0), DECADES)
            for k in range(reached):
                self.decades[bound][k] += 1

    def merge(self, other: Tally) -> None:
        """Add another tally to this one."""
        self.frames += other.frames
        self.located += other.located
        self.by.update(other.by)
        self.accepted += other.accepted
        self.made_s += other.made_s
        self.located_s += other.located_s
        for bound in BOUNDS:
            if other.least[bound] < self.least[bound]:
                self.least[bound], self.where[bound] = other.least[bound], other.where[bound]
            self.decades[bound] = [a + b for a, b in zip(self.decades[bound], other.decades[bound], strict=True)]

    @property
    def most_likely(self) -> float:
        """The rate that frames are located at is below this, at 95 % confidence (Clopper and Pearson, one-sided)."""
        return upper_bound(self.located, self.frames)

    def to_mapping(self) -> dict[str, Any]:
        """Plain values."""
        return {name: dict(value) if isinstance(value, Counter) else value for name, value in self._items()}

    def _items(self) -> Iterable[tuple[str, Any]]:
        return ((name, getattr(self, name)) for name in self.__slots__)

    @classmethod
    def from_mapping(cls, values: dict[str, Any]) -> Tally:
        """What `to_mapping` made."""
        return cls(**{**values, "by": Counter(values["by"])})

    def __str__(self) -> str:
        by = f" {dict(self.by)}" if self.by else ""
        return (
            f"{self.located} of {self.frames} located{by}, rate below {self.most_likely:.1e}, "
            f"least p_false {self.least['p_false']:.1e} ({self.where['p_false']})"
        )


def total(tallies: Iterable[Tally]) -> Tally:
    """All of them together."""
    whole = Tally()
    for tally in tallies:
        whole.merge(tally)
    return whole


def upper_bound(successes: int, trials: int) -> float:
    """The largest rate that so few successes do not speak against, at 95 % confidence (Clopper and Pearson, one-sided)."""
    from scipy.stats import beta

    return 1.0 if successes >= trials else float(beta.ppf(CONFIDENCE, successes + 1, trials - successes))
