"""Prints the table of docs/verify.md on the default kit; with --write, writes it there.

Run: python docs/make_numbers.py [--write]. The rows are the same everywhere, and a test holds the page to them.
"""

from __future__ import annotations

import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a dependency installs a package `tests`, too

from tactape_fab import Kit, TapeSpec, make_kit
from tests.bench.marks import replaced

PAGE = Path(__file__).parent / "verify.md"


def lasting_rows(kit: Kit) -> list[str]:
    """Rows that the default kit alone decides."""
    check = {c.name: c for c in kit.checks}
    rule = {f.rule: f for f in kit.findings}
    windows = check["windows from copper"].figure
    places = check["copper-top places"].figure
    bridge = rule["opening-bridge"]
    assert windows is not None and places is not None and bridge.value is not None and bridge.limit is not None
    return [
        f"| parts on a {kit.tape.board.size_mm[0]:g} x {kit.tape.board.size_mm[1]:g} mm tape | {kit.tape.part_count} |",
        f"| 4x4 windows of the written copper that decode, the right way up, to their place | {windows:.0f} of {windows:.0f} |",
        f"| largest distance of a written pad pair from its pick-and-place row | {places:.3f} µm |",
        f"| narrowest coverlay bridge, and the limit of `{kit.tape.part.name}` on `generic-fpc` | "
        f"{bridge.value:.3f} mm, {bridge.limit:.3f} mm |",
    ]


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        kit = make_kit(TapeSpec(sector=7), Path(folder) / "tactape-s007")
        rows = lasting_rows(kit)
    table = "\n".join(["| | |", "|---|---|", *rows, ""])
    sys.stdout.write(table)
    if asked.write:
        PAGE.write_text(replaced(PAGE.read_text(encoding="utf-8"), "numbers", table), encoding="utf-8")


if __name__ == "__main__":
    main()
