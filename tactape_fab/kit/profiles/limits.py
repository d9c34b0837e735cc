"""Thresholds of fab and process profiles: value, level, source, and whether the fab confirmed it."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan
from typing import cast

from tactape_fab.base.errors import Level
from tactape_fab.base.fields import Fields

SOURCE_KEYS = ("level", "source", "date", "confirmed")


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """One threshold of a fab, its source, and whether the fab confirmed it.

    A value below ``warn_mm``, if given, gives a warning.
    """

    value_mm: float
    level: Level
    source: str
    date: str
    confirmed: bool
    warn_mm: float | None = None


def read_limit(table: Fields) -> Limit:
    value_mm = table.number("value_mm", low=0.0, high=100.0)
    return Limit(
        value_mm=value_mm,
        level=read_level(table),
        source=table.text("source"),
        date=table.text("date"),
        confirmed=table.flag("confirmed"),
        warn_mm=_warn_mm(table, value_mm) if "warn_mm" in table.values else None,
    )


def _warn_mm(table: Fields, value_mm: float) -> float:
    remedy = f"give more than value_mm = {value_mm:g} mm, or leave it out"
    return table.number("warn_mm", above=0.0 if isnan(value_mm) else value_mm, high=100.0, remedy=remedy)


def read_level(table: Fields) -> Level:
    return cast(Level, table.text("level", choices=("block", "warn", "info"), default="block"))
