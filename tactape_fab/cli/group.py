"""The command itself."""

from __future__ import annotations

import sys
from io import TextIOWrapper
from typing import Any

import click

from tactape_fab import __version__


class _Group(click.Group):
    """The group of commands; names of files may hold what an ASCII terminal cannot show."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
        return super().main(*args, **kwargs)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="tactape-fab")
def main() -> None:
    """Make tactile fiducial tapes that a PCB fab can build, and prove them from the written files."""
