"""The command `tactape-fab`: a group that imports a command's module when the command is used."""

from __future__ import annotations

import atexit
import errno
import gc
import os
import re
import sys
from importlib import import_module
from io import TextIOWrapper
from typing import Any

import click
from click.shell_completion import CompletionItem

from tactape_fab.base.dropped_signal import INTERRUPTED, repeat_dropped_signal
from tactape_fab.base.plain_text import one_line
from tactape_fab.base.version import __version__
from tactape_fab.cli.exits import ended_by_signals

# The decoder and `calibrate` have small matrices: OpenBLAS threads would wait for each other, and took seven times the processor
# time of one on two busy cores. With one thread, sums are also the same on any number of cores. Set before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# As it ends, the interpreter looks twice for garbage among all objects, which go anyway: a twentieth of a `make`
atexit.register(gc.freeze)

_SECTIONS = {
    "Design and make": {
        "advise": "Say which W, Δ and part locate a contact of some size.",
        "check": "Measure a tape against the rules of its fab or process.",
        "make": "Write a tape's kit: all that fab and assembly line need.",
        "emboss": "Put a kit's texture on a part of yours.",
        "coupon": "Write a small panel that shows where a fab's limits are.",
        "profiles": "List fab profiles, explain one, or confirm its limits.",
    },
    "Prove": {
        "verify": "Read a kit back by other software, decode it, make it again.",
        "certify": "Say what every window of some tapes can tell apart.",
        "registry": "List tapes and their distances, or pack them into a file.",
    },
    "Locate contacts": {
        "simulate": "Write depth maps of a sensor on a kit's tape.",
        "decode": "Locate the contacts in files of frames.",
        "watch": "Locate frames as they come, and never be late.",
        "ros2": "Run the ROS 2 node.",
    },
    "Measure": {
        "calibrate": "Find a sensor's profile by some ten presses on a tape.",
        "inspect": "Find where a tape's parts are, from scans or photographs.",
        "survey": "Find where a tape's parts are, from many contacts.",
    },
    "This installation": {
        "doctor": "Say what it can do, and what looks wrong in a sensor's frames.",
        "completion": "Print what makes a shell complete commands and names.",
    },
}
COMMANDS = tuple(sorted(name for commands in _SECTIONS.values() for name in commands))
"""Names of the commands; each is a function in the module of the same name in this package."""


_PATH = re.compile(r"^\[?(KIT|DIR|FILE|FRAMES|SCAN|IMAGE|SPEC|POSES|AS-BUILT|SOURCE|COUPON|MODEL|KEY|PUB)")
"""Metavars of paths."""


class _Text(click.types.StringParamType):
    """Text parameter, with shell completion that depends on the metavar.

    An empty path, from a script's variable that is not set, is refused: it would be the current folder.
    """

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "" and param is not None and _PATH.match(param.metavar or (param.name or "").upper()):
            self.fail("'' is empty; give a path, or leave it out", param, ctx)
        return super().convert(value, param, ctx)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        from tactape_fab.cli.completion import offered

        return offered(param, incomplete)


def command(name: str) -> click.Command:
    """Import a command by its name in `COMMANDS`; its text parameters get shell completion."""
    found: click.Command = getattr(import_module(f"tactape_fab.cli.{name}"), name)
    for parameter in found.params:
        if parameter.type is click.STRING:
            parameter.type = _Text()
    return found


_NO_ROOM, _NO_FOLDER = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)), "No usable temporary directory"
"""Windows does not define EDQUOT. The text is Python's, where no temporary folder can be written, also as all are full."""
_NO_MEMORY = re.compile(r"can't start new thread|failed to map segment|Cannot allocate memory|Insufficient memory")
"""What Python's threads, the loader of libraries, the system and OpenCV say where memory is short."""


class _Group(click.Group):
    """Commands, imported on use. Characters of file names that the terminal cannot show are escaped."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return command(cmd_name) if cmd_name in COMMANDS else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """By what they are for, in whole sentences: click would cut the first one of each command's help."""
        for title, commands in _SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(f"{name:10}", text) for name, text in commands.items()])

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with ended_by_signals():
                return super().invoke(ctx)
        except click.UsageError as error:  # click quotes arguments unchanged, such as the file names of `coupon *`
            if error.message.isprintable():
                raise
            # unprintable characters are escaped before click prints the message
            raise click.UsageError(one_line(error.message), error.ctx) from error
        except KeyboardInterrupt:  # click would exit with the status of a failure, 1
            click.echo("stopped by Ctrl-C", err=True)
            raise click.exceptions.Exit(INTERRUPTED) from None

    def main(self, *args: Any, **kwargs: Any) -> Any:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
        before, sys.unraisablehook = sys.unraisablehook, repeat_dropped_signal
        try:
            return super().main(*args, **kwargs)
        except Exception as error:
            if isinstance(error, OSError) and _cannot_print(error):
                sys.stdout = None  # flushing its buffer would fail again
                message = f"standard output cannot be written: {error.strerror}; give it room, or another place"
            elif isinstance(error, OSError) and (error.errno in _NO_ROOM or _NO_FOLDER in str(error)):
                import tempfile  # imported here: few commands need it

                # none is set where all are full or read-only, and asking for it would fail again
                place = f"the temporary folder {tempfile.tempdir} cannot be written: " if tempfile.tempdir else ""
                message = f"{place}{error.strerror}; make room there, or set TMPDIR to another folder"
            elif _no_memory(error):
                message = "there is not enough memory for this; free some, or give a smaller input"
            else:
                raise
            click.echo(f"error: {message}", err=True)
            sys.exit(1)
        finally:
            sys.unraisablehook = before


def _no_memory(error: BaseException | None) -> bool:
    """Whether an error, or one during whose handling it was raised, says that memory was short."""
    return error is not None and (
        isinstance(error, MemoryError) or _NO_MEMORY.search(str(error)) is not None or _no_memory(error.__context__)
    )


def _cannot_print(error: OSError) -> bool:
    """Whether click's printing raised the error. Failures to write the package's own files have their own error class."""
    # by the innermost frame, as an OSError of another module also passes through click
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    return frame is not None and frame.tb_frame.f_globals.get("__name__") == click.utils.__name__


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="tactape-fab")
def main() -> None:
    """Make tactile fiducial tapes that a PCB fab can build, and prove them from the written files."""
