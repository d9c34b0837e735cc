"""``python -m tactape_fab`` and the command ``tactape-fab``: the command line."""

from __future__ import annotations

import sys


def run() -> None:
    """Run the command line. Ctrl-C ends it without a traceback from its first import on, with status 130."""
    try:
        from tactape_fab.cli import main  # imported here: it takes a tenth of a second, in which people press Ctrl-C

        main(prog_name="tactape-fab")
    except KeyboardInterrupt:
        print("stopped by Ctrl-C", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    run()
