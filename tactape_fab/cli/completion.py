"""completion: shell completion of commands, options, names of profiles, words of a metavar, and files."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from importlib import import_module

import click
from click.shell_completion import CompletionItem, get_completion_class

_WORD = re.compile(r"[a-z0-9-]+")
_FILE = re.compile(r"KIT|FRAMES|FILE|SPEC|SURFACE|IMAGE")


SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print what makes a shell complete commands, options, names of profiles and files.

    \b
    Example: eval "$(tactape-fab completion bash)"
    """
    main = click.get_current_context().find_root().command
    completer = get_completion_class(shell)
    if completer is None:
        raise click.UsageError(f"click knows no completion for {shell}")
    click.echo(completer(main, {}, "tactape-fab", "_TACTAPE_FAB_COMPLETE").source())


def _profiles(kind: str) -> Callable[[], Sequence[str]]:
    def names() -> Sequence[str]:
        from tactape_fab.base.templates import profile_names

        return profile_names(kind)

    return names


def _constant(module: str, name: str) -> Callable[[], Sequence[str]]:
    return lambda: getattr(import_module(f"tactape_fab.texture.{module}"), name)


NAMES: dict[tuple[str, str], Callable[[], Sequence[str]]] = {
    ("fab", "PROFILE"): _profiles("fabs"),
    ("fab", "[NAME]"): _profiles("fabs"),
    ("part", "NAME"): _profiles("parts"),
    ("process", "PROFILE"): _profiles("processes"),
    ("process", "fpc|PROFILE"): lambda: ["fpc", *_profiles("processes")()],
    ("sensor", "NAME"): _profiles("sensors"),
    ("sensor", "NAME|FILE.toml"): _profiles("sensors"),
    ("code", "NAME"): _constant("code", "ALL_CODE_NAMES"),
    ("code", "CODE"): _constant("code", "CODE_NAMES"),
    ("assembly", "HOUSE"): _constant("cpl", "ASSEMBLY_FORMATS"),
}
"""Functions that list the known names for a parameter's name and metavar; CODE lists codes with a plane."""


def offered(param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Completions of what was typed for a parameter: names, words of its metavar, or files or folders, which the shell lists."""
    metavar = param.metavar or (param.name or "").upper()
    names = NAMES.get((param.name or "", metavar))
    words = names() if names else [word for word in metavar.split("|") if _WORD.fullmatch(word)]
    items = [CompletionItem(word) for word in words if word.startswith(incomplete)]
    if items:
        return items
    if names is not None or _FILE.search(metavar):
        return [CompletionItem(incomplete, type="file")]
    return [CompletionItem(incomplete, type="dir")] if metavar == "DIR" else []
