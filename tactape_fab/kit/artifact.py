"""Artifact: one file of the kit as bytes, before anything is written."""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime

from tactape_fab.errors import RenderError

EPOCH = datetime(1980, 1, 1, tzinfo=UTC)
"""Date of every file where SOURCE_DATE_EPOCH is not set: the earliest that a zip can hold."""
_LATEST = datetime(2107, 12, 31, tzinfo=UTC)


@dataclass(frozen=True, slots=True, kw_only=True)
class Artifact:
    """A file: its role in the manifest, its path relative to the kit's folder (with '/'), its bytes."""

    role: str
    path: str
    data: bytes


def build_date() -> datetime:
    """The one date that files carry: SOURCE_DATE_EPOCH (reproducible-builds.org), else 1980-01-01, in UTC.

    Raises
    ------
    RenderError
        When SOURCE_DATE_EPOCH is no whole number of seconds between 1980 and 2107, the reach of a zip's dates.
    """
    text = os.environ.get("SOURCE_DATE_EPOCH")
    if text is None:
        return EPOCH
    try:
        date = datetime.fromtimestamp(int(text), tz=UTC)
    except (ValueError, OverflowError, OSError):
        date = None
    if date is None or not EPOCH <= date <= _LATEST:
        raise RenderError(
            f"SOURCE_DATE_EPOCH = {text[:40]!r} is no number of seconds between {EPOCH:%Y-%m-%d} and {_LATEST:%Y-%m-%d}; "
            "correct it or unset it"
        )
    return date
