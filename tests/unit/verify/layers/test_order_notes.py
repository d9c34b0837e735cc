"""Figures in the prose of order notes that somebody acts on: the field to keep clear, the board's size, the last part's place."""

from __future__ import annotations

import re

import pytest

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields
from tactape_fab.texture.manifest import read_manifest
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.film import read_film_manifest
from tactape_fab.verify.layers.order_notes import check_order_notes


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    spec = TapeSpec(sector=7, size_mm=(30, 25), models=False)
    return make_kit(spec, tmp_path_factory.mktemp("notes") / "kit", verify=False)


def checked(kit: Kit, pattern: str, new: str) -> Check:
    manifest = read_manifest(kit.path / "manifest.json")
    files = {row["role"]: WrittenFile(path=row["path"], data=(kit.path / row["path"]).read_bytes()) for row in manifest["files"]}
    text, count = re.subn(pattern, new, files["order-notes"].data.decode())
    assert count
    files["order-notes"] = WrittenFile(path=files["order-notes"].path, data=text.encode())
    film = read_film_manifest(Fields(manifest))
    return check_order_notes(files, kit.tape, order=film.order, assembly=film.assembly, backings=film.film.backings)


@pytest.mark.parametrize(
    ("pattern", "new", "said"),
    [
        (r"field of parts, x 6\.0 to", "field of parts, x 16.0 to", "they protect x 16 to 28.8 mm, y 1.1 to 23.9 mm"),
        (r"(field of parts, .* y) 1\.1 to", r"\1 2.1 to", "and parts lie beyond it"),
        (r"(field of parts, .* to) 23\.9", r"\1 13.9", "and parts lie beyond it"),
        (r"one board of 30 x 25", "one board of 30 x 52", "they say 30, 52 where 30, 25 should stand"),
        (r"board alone \(30 x", "board alone (300 x", "they say 300, 25 where 30, 25 should stand"),
        (r"and R225 at 28\.15", "and R225 at 2.15", "they say 2.15, 2 where 28.15, 2 should stand"),
    ],
)
def test_figures_that_somebody_acts_on_are_the_tape_s(kit: Kit, pattern: str, new: str, said: str) -> None:
    line = checked(kit, pattern, new)
    assert not line.passed and said in line.message


def test_notes_without_such_sentences_and_as_written_pass(kit: Kit) -> None:
    assert checked(kit, "ORDER NOTES", "ORDER NOTES").passed
    assert checked(kit, r", x 6\.0 to .* mm:", ":").passed  # as of an older version
