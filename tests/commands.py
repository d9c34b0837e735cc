"""Commands as a user types them, in this process."""

from __future__ import annotations

import shlex

from click.testing import CliRunner, Result

from tactape_fab.cli import main


def run(words: str) -> Result:
    return run_words(*shlex.split(words))


def run_words(*words: object) -> Result:
    """As `run`, where a word may be a path, or hold blanks."""
    return CliRunner().invoke(main, [str(word) for word in words], prog_name="tactape-fab")
