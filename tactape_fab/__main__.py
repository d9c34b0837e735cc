"""``python -m tactape_fab`` and the command ``tactape-fab``: the command line."""

from __future__ import annotations

import os
import sys


def run() -> None:
    """Run the command line. Ctrl-C ends it without a traceback from its first import on, with status 130."""
    try:
        _open_closed_streams()
        from tactape_fab.cli import main  # imported here: it takes a tenth of a second, in which people press Ctrl-C

        main(prog_name="tactape-fab")
    except KeyboardInterrupt:
        print("stopped by Ctrl-C", file=sys.stderr)
        sys.exit(130)


def _open_closed_streams() -> None:
    """Keep files off the numbers of standard streams that the caller closed, as by ``>&-``.

    The next file that is opened would have the number, and what a library or a child prints would be in it. Python prints nothing
    to a closed standard output, and exits with 0; printing to one that can only be read fails, as of other programs.
    """
    while (descriptor := os.open(os.devnull, os.O_RDONLY)) <= 2:
        pass
    os.close(descriptor)
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115 (a descriptor, open to the end)


if __name__ == "__main__":
    run()
