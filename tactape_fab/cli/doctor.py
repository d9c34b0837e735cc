"""doctor, completion."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from tactape_fab.cli.exits import echo_json, echo_lines
from tactape_fab.cli.group import main
from tactape_fab.cli.printing import diagnosis_lines

SHELLS = ("bash", "zsh", "fish")


@main.command()
@click.option("--json", "as_json", is_flag=True, help="Print what was found as JSON.")
def doctor(as_json: bool) -> None:
    """Say what this installation can do: versions, the compiled decoder, outside programs and extras, and what each adds.

    \b
    Example: tactape-fab doctor
    """
    from tactape_fab.cli.installation import diagnose

    found = diagnose()
    echo_json(found.to_mapping()) if as_json else echo_lines(diagnosis_lines(found))


@main.command()
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print what makes a shell complete commands, options, names of profiles and files.

    \b
    Example: eval "$(tactape-fab completion bash)"
    """
    completer = get_completion_class(shell)
    if completer is None:
        raise click.UsageError(f"click knows no completion for {shell}")
    click.echo(completer(main, {}, "tactape-fab", "_TACTAPE_FAB_COMPLETE").source())
