"""Command line: one module per command, with the command's name. Only this package imports click.

A command's module is imported when the command is used (`group.COMMANDS`), so that `decode` does not load that of `make`.
"""

from tactape_fab.cli.group import COMMANDS, command, main

__all__ = ["COMMANDS", "command", "main"]
