"""Command line: one file per command, named as the command. Only this package imports click.

A command's module is imported when it is used (`group.COMMANDS`), so that `decode` does not load the options of `make`.
"""

from tactape_fab.cli.group import COMMANDS, command, main

__all__ = ["COMMANDS", "command", "main"]
