"""Process profiles: limits of a printing or milling process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tactape_fab.base.templates import profile_table, read_once, refuse_problems
from tactape_fab.kit.profiles.limits import SOURCE_KEYS, Limit, read_limit

PROCESS_LIMIT_IDS = (
    "feature",
    "gap",
    "height",
    "base",
    "body-edge",
    "hole-edge",
    "hole-part",
    "hole-hole",
    "hole-size",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessProfile:
    """Limits of a printing or milling process; ``limits`` holds one `Limit` for each of PROCESS_LIMIT_IDS.

    ``feature`` is the narrowest raised width, ``gap`` the narrowest gap (for milling: the ball mill's diameter),
    ``height`` the least height that can be made, ``base`` the thinnest base.
    ``mark`` tells whether it can make the mark in the back.
    """

    name: str
    title: str
    limits: Mapping[str, Limit]
    mark: bool = True

    def thresholds(self) -> dict[str, Any]:
        """The thresholds as the manifest records them."""
        return {"limits_mm": {name: limit.value_mm for name, limit in self.limits.items()}}


@read_once("processes")
def load_process(name: str) -> ProcessProfile:
    """A process profile by name, or by the path of a TOML file. Raises SpecError: every problem found in it."""
    table = profile_table("processes", "process", name)
    table.refuse_unknown(("name", "title", "mark", "limits"))
    limits = table.table("limits", PROCESS_LIMIT_IDS)
    profile = ProcessProfile(
        name=table.text("name", longest=100),
        title=table.text("title"),
        limits={name: read_limit(limits.table(name, ("value_mm", *SOURCE_KEYS))) for name in PROCESS_LIMIT_IDS},
        mark=table.flag("mark") if "mark" in table.values else True,
    )
    refuse_problems(table)
    return profile
