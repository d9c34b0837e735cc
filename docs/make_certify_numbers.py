"""Makes the picture of docs/certify.md and prints its table; with --write, writes it there.

Run: python docs/make_certify_numbers.py [--write]; the search over all sectors takes some minutes.
"""

from __future__ import annotations

import sys
import tempfile
from argparse import ArgumentParser
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a dependency installs a package `tests`, too

from tactape_fab import TapeSpec, make_kit
from tactape_fab.base.picture_file import write_picture
from tactape_fab.kit.examine.code_tapes import default_tapes
from tactape_fab.report.certify_picture import draw_certified
from tactape_fab.texture.certify.certificate import closest
from tactape_fab.texture.certify.kits import certified
from tactape_fab.texture.certify.origin import choose_origin
from tactape_fab.texture.code import DEFAULT_CODE, get_plane
from tests.bench.marks import replaced

PAGE = Path(__file__).parent / "certify.md"
FIGURE = Path(__file__).parent / "figures" / "certify-map.png"
DISTANCES = range(4)


def row(name: str, distances: list[int | None]) -> str:
    count = Counter(distances)
    assert set(count) <= set(DISTANCES)
    return f"| {name} | {' | '.join(str(count[d]) for d in DISTANCES)} |"


def default_row() -> str:
    """Tapes by least distance of their 4x4 windows, every sector at its default origin."""
    return row("default origin", [closest(tape, 4).distance for tape in default_tapes(DEFAULT_CODE)])


def best_row() -> str:
    """The same after `--origin best`."""
    tapes = default_tapes(DEFAULT_CODE)
    return row("`--origin best`", [choose_origin(get_plane(t.code), t.sector, t.placed).distance for t in tapes])


def picture() -> None:
    with tempfile.TemporaryDirectory() as folder:
        kit = make_kit(TapeSpec(sector=7, models=False), Path(folder) / "tactape-s007")
    drawn = draw_certified(certified([kit.tape]))
    FIGURE.unlink(missing_ok=True)
    write_picture(FIGURE, drawn, "picture", compression=9)


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    picture()
    head = [f"| least distance | {' | '.join(map(str, DISTANCES))} |", "|---" * (len(DISTANCES) + 1) + "|"]
    table = "\n".join([*head, default_row(), best_row(), ""])
    sys.stdout.write(table)
    if asked.write:
        PAGE.write_text(replaced(PAGE.read_text(encoding="utf-8"), "numbers", table), encoding="utf-8")


if __name__ == "__main__":
    main()
