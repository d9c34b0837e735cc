"""Date of written files: SOURCE_DATE_EPOCH, else 1980-01-01."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import datetime, timezone

from tactape_fab.base.errors import SpecError

EPOCH = datetime(1980, 1, 1, tzinfo=timezone.utc)
"""Date of every file if SOURCE_DATE_EPOCH is not set: the earliest that a zip can hold."""


ZIP_LATEST = datetime(2107, 12, 31, tzinfo=timezone.utc)

_GIVEN: ContextVar[datetime | None] = ContextVar("_GIVEN", default=None)


@contextmanager
def dated(date: datetime) -> Iterator[None]:
    """Context manager: files are written with this date, whatever the environment says, as when a kit is made again."""
    token = _GIVEN.set(date)
    try:
        yield
    finally:
        _GIVEN.reset(token)


def build_date() -> datetime:
    """Date of all written files: SOURCE_DATE_EPOCH (reproducible-builds.org), else 1980-01-01, in UTC.

    Raises SpecError if SOURCE_DATE_EPOCH is not a whole number of seconds since 1970.
    """
    given = _GIVEN.get()
    if given is not None:
        return given
    text = os.environ.get("SOURCE_DATE_EPOCH")
    if text is None:
        return EPOCH
    try:
        # int takes 1_0, too, white space, and digits of other scripts
        if not (text.isascii() and text.isdigit()):
            raise ValueError
        return datetime.fromtimestamp(int(text), tz=timezone.utc)
    except (ValueError, OverflowError, OSError):
        message = f"SOURCE_DATE_EPOCH = {text[:40]!r} is no whole number of seconds since 1970; correct it or unset it"
        raise SpecError(message) from None


def zip_date() -> datetime:
    """The build date, clipped to the range of a zip: 1980 to 2107."""
    return min(max(build_date(), EPOCH), ZIP_LATEST)


def zip_entry(name: str, date: datetime) -> zipfile.ZipInfo:
    """Header of a deflated zip member; its bytes are the same on every system."""
    entry = zipfile.ZipInfo(name, date.timetuple()[:6])
    entry.compress_type = zipfile.ZIP_DEFLATED
    # 3 is Unix, whose permissions are in the upper 16 bits; by default Python writes the system that it runs on
    entry.create_system = 3
    entry.external_attr = 0o644 << 16
    return entry
