"""Parser of sector lists such as ``0-9,20``."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

from tactape_fab.base.errors import Problem, refuse
from tactape_fab.base.fields import named, shown
from tactape_fab.texture.code import ALL_CODE_NAMES, CODE_NAMES, get_code

MOST_TAPES = 4096
_SECTORS_REMEDY = "give sectors and ranges of them, such as 0-9,20"
_RANGE = re.compile(r"([0-9]{1,18})(?:-([0-9]{1,18}))?")


def read_sectors_of(value: object, code: object) -> tuple[int, ...]:
    """As `read_sectors`, for a code by name; for an unknown one, with the largest number of sectors of the codes with a plane."""
    known = [code] if code in ALL_CODE_NAMES else CODE_NAMES
    return read_sectors(value, max(get_code(str(name)).sectors for name in known))


def read_sectors(value: object, sectors: int, key: str = "sectors") -> tuple[int, ...]:
    """The sectors of ``"0-9,20"``, or of a list of whole numbers, in the order given.

    value: Untrusted.
    sectors: Number of sectors of the code.
    key: Name of the list in messages.
    Raises SpecError with every problem: invalid sectors or ranges, reversed ranges, sectors outside the code, repetitions.
    """
    problems: list[Problem] = []

    def problem(message: str) -> None:
        problems.append(Problem(key, f"{key} = {shown(value)} {message}"))

    found: dict[int, int] = {}
    for first, last, text in _ranges(value, problem):
        if first > last:
            problem(f"holds {text}, which runs backwards; give {last}-{first}")
        elif last >= sectors:
            problem(f"holds {text}, outside 0 to {sectors - 1}; the code has {sectors} sectors")
        else:
            for sector in range(first, last + 1):
                found[sector] = found.get(sector, 0) + 1
    if repeated := [str(sector) for sector, times in found.items() if times > 1]:
        problem(f"names sector {named(repeated)} more than once; name each once")
    refuse(problems)
    return tuple(found)


def _ranges(value: object, problem: Any) -> Iterator[tuple[int, int, str]]:
    """First, last and text of every range; an invalid range is a problem."""
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        items = list(value)
        if wrong := [item for item in items if isinstance(item, bool) or not isinstance(item, int)]:
            problem(f"holds {shown(wrong[0])}, which is no whole number; {_SECTORS_REMEDY}")
            return
    elif isinstance(value, str):
        items = [item.strip() for item in value.split(",")]
    else:
        problem(f"is no list of sectors; {_SECTORS_REMEDY}")
        return
    if items in ([], [""]):
        problem(f"names no sector; {_SECTORS_REMEDY}")
        return
    if len(items) > MOST_TAPES:
        problem(f"has {len(items)} entries, more than {MOST_TAPES}; give fewer")
        return
    for item in items:
        match = _RANGE.fullmatch(str(item))
        if match is None:
            problem(f"holds {shown(item)}, which is neither a sector nor a range of sectors; {_SECTORS_REMEDY}")
        else:
            yield int(match[1]), int(match[2] or match[1]), match[0]
