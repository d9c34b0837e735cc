"""Thresholds of fab and process profiles: value, level, source, and whether the fab confirmed it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import isnan
from typing import Any, cast

from tactape_fab.base.errors import Level
from tactape_fab.base.fields import Fields

ORIGIN_KEYS = ("source", "date", "confirmed")
SOURCE_KEYS = ("level", *ORIGIN_KEYS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Source of a threshold, and whether the fab confirmed it."""

    source: str
    date: str
    confirmed: bool


def read_origin(table: Fields) -> Origin:
    """Source, date and confirmation of a table of thresholds."""
    return Origin(source=table.text("source"), date=table.text("date"), confirmed=table.flag("confirmed"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit(Origin):
    """One threshold of a fab.

    A measured value below ``warn_mm``, if given, is a warning.
    """

    value_mm: float
    level: Level
    warn_mm: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeLimit(Origin):
    """The largest board, (longer side, shorter side)."""

    largest_mm: tuple[float, float]
    level: Level


def cited(origin: Origin) -> dict[str, Any]:
    """Source and confirmation of a threshold, as keyword arguments of `Finding`."""
    return {"source": origin.source, "confirmed": origin.confirmed}


def read_limit(table: Fields) -> Limit:
    value_mm = table.number("value_mm", low=0.0, high=100.0)
    level, origin, warn_mm = read_level(table), asdict(read_origin(table)), None
    if "warn_mm" in table.values:
        remedy = f"give more than value_mm = {value_mm:g} mm, or leave it out"
        warn_mm = table.number("warn_mm", above=0.0 if isnan(value_mm) else value_mm, high=100.0, remedy=remedy)
    return Limit(value_mm=value_mm, level=level, **origin, warn_mm=warn_mm)


def read_level(table: Fields) -> Level:
    return cast(Level, table.text("level", choices=("block", "warn", "info"), default="block"))
