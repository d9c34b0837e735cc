"""A measurement that is asked for, and how large all of them are."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

Result = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Size:
    """How much is measured.

    Attributes
    ----------
    name : str
        "quick" or "full".
    trials : int
        Contacts at each pose of the paper's table I.
    frames : int
        Contacts for each point of a curve.
    sectors : int
        Sectors whose tapes are certified.
    parts : int
        Parts of the largest tape that is written.
    """

    name: str
    trials: int
    frames: int
    sectors: int
    parts: int = 500


QUICK = Size(name="quick", trials=2, frames=40, sectors=16, parts=10_000)
FULL = Size(name="full", trials=10, frames=400, sectors=256, parts=200_000)


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One measurement.

    Attributes
    ----------
    section, name : str
    measure : callable
        A function of a module, so that another process finds it; it takes `options`.
    options : mapping
        Plain values.
    alone : bool
        Whether times are measured: nothing else runs beside it.
    """

    section: str
    name: str
    measure: Callable[..., Result]
    options: Mapping[str, Any] = field(default_factory=dict)
    alone: bool = False

    @property
    def key(self) -> str:
        """What a result is kept under."""
        return json.dumps([self.section, self.name, dict(self.options)], sort_keys=True)

    def run(self) -> Result:
        """Measure."""
        return self.measure(**self.options)

    def timed(self) -> tuple[Result, float]:
        """Measure; and the seconds that it took."""
        start = perf_counter()
        return self.run(), perf_counter() - start
