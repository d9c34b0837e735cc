"""Commands as a user types them, in this process."""

from __future__ import annotations

import shlex

from click.testing import CliRunner, Result

from tactape_fab.cli import main


def run(words: str) -> Result:
    return CliRunner().invoke(main, shlex.split(words), prog_name="tactape-fab")
