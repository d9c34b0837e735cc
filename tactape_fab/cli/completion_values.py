"""What a shell offers for the value of an option or argument: names of profiles, words of its metavar, files."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import click
from click.shell_completion import CompletionItem

_WORD = re.compile(r"[a-z0-9-]+")
_FILE = re.compile(r"KIT|FRAMES|FILE|SPEC|SURFACE|IMAGE")


def _profiles(kind: str) -> Callable[[], Sequence[str]]:
    def names() -> Sequence[str]:
        from tactape_fab.base.templates import profile_names

        return profile_names(kind)

    return names


def _codes() -> Sequence[str]:
    from tactape_fab.texture.code import ALL_CODE_NAMES

    return ALL_CODE_NAMES


def _plane_codes() -> Sequence[str]:
    from tactape_fab.texture.code import CODE_NAMES

    return CODE_NAMES


def _houses() -> Sequence[str]:
    from tactape_fab.texture.cpl import ASSEMBLY_FORMATS

    return ASSEMBLY_FORMATS


NAMES: dict[tuple[str, str], Callable[[], Sequence[str]]] = {
    ("fab", "PROFILE"): _profiles("fabs"),
    ("name", "[NAME]"): _profiles("fabs"),
    ("part", "NAME"): _profiles("parts"),
    ("process", "sla|fdm|cnc"): _profiles("processes"),
    ("sensor", "NAME"): _profiles("sensors"),
    ("sensor", "NAME|FILE.toml"): _profiles("sensors"),
    ("code", "NAME"): _codes,
    ("code", "CODE"): _plane_codes,
    ("assembly", "HOUSE"): _houses,
}
"""What stands for a name that the package knows, by key and metavar; a CODE is one with a plane.

Profiles may be files of the user's, too.
"""


class Offered(click.types.StringParamType):
    """A text as it is given; what is offered for it comes from the metavar of its parameter."""

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        metavar = param.metavar or (param.name or "").upper()
        names = NAMES.get((param.name or "", metavar))
        words = names() if names else [word for word in metavar.split("|") if _WORD.fullmatch(word)]
        items = [CompletionItem(word) for word in words if word.startswith(incomplete)]
        if items:
            return items
        if names is not None or _FILE.search(metavar):
            return [CompletionItem(incomplete, type="file")]
        return [CompletionItem(incomplete, type="dir")] if metavar == "DIR" else []


def complete_values(group: click.Group) -> None:
    """Let every text that a command takes be completed."""
    for command in group.commands.values():
        for parameter in command.params:
            if parameter.type is click.STRING:
                parameter.type = Offered()
