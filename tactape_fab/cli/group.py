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
        try:
            return super().main(*args, **kwargs)
        except OSError as error:
            if not _cannot_print(error):
                raise
            sys.stdout = None  # what is left in its buffer would fail once more
            click.echo(f"error: standard output cannot be written: {error.strerror}; give it room, or another place", err=True)
            sys.exit(1)


def _cannot_print(error: OSError) -> bool:
    """Whether it was raised where click prints; all that the package itself cannot write it reports in its own words."""
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    return frame is not None and frame.tb_frame.f_globals.get("__name__") == click.utils.__name__


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="tactape-fab")
def main() -> None:
    """Make tactile fiducial tapes that a PCB fab can build, and prove them from the written files."""
