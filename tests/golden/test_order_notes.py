"""Order notes of the default tape at every profile, letter by letter, and CPL and BOM of a tiny tape in every format.

A difference is a change of output that CHANGELOG.md must name. `pytest tests/golden --update-golden` writes the files anew.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tactape_fab import TapeSpec
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.order_facts import order_facts
from tactape_fab.kit.render.cpl_bom import render_bom, render_cpl
from tactape_fab.kit.render.order_notes import render_order_notes
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS

FOLDER = Path(__file__).parent / "files"


def compare(path: Path, data: bytes, request: pytest.FixtureRequest) -> None:
    if request.config.getoption("--update-golden"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    assert data == path.read_bytes(), f"{path.name} differs from the golden file"


@pytest.mark.parametrize("fab", profile_names("fabs"))
def test_notes_are_the_golden_ones(fab: str, request: pytest.FixtureRequest) -> None:
    made = examine(TapeSpec(sector=7, pitch_mm=1.5, displacement_mm=0.25, fab=fab, models=False))
    lists = [*render_cpl(made.drawing, made.fab), *render_bom(made.drawing, made.fab)]
    others = {"fab-zip": "-fab.zip", "preview-png": ".png", "placement-preview": "-placements.svg"}
    files = [*lists, *(Artifact(role=role, path=made.tape.name + ending, data=b"") for role, ending in others.items())]
    (notes,) = render_order_notes(order_facts(made.layout, made.fab, made.findings, files))
    compare(FOLDER / "order-notes" / f"{fab}.txt", notes.data, request)


@pytest.mark.parametrize("house", ASSEMBLY_FORMATS)
def test_cpl_and_bom_are_the_golden_ones(house: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")  # 2026-01-01
    number = "C1000" if house == "jlcpcb" else "RC0201-5"
    spec = TapeSpec(sector=3, size_mm=(10.0, 10.0), tag="none", name="t", models=False, assembly=house, part_number=number)
    made = examine(spec)
    for artifact in (*render_cpl(made.drawing, made.fab), *render_bom(made.drawing, made.fab)):
        compare(FOLDER / "assembly" / house / artifact.path.rsplit("/", 1)[-1], artifact.data, request)
