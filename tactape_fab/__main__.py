"""``python -m tactape_fab``: the command line."""

from tactape_fab.cli import main

main(prog_name="tactape-fab")
