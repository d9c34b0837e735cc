"""The part of a panel's files that is one tape's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pytest

from tactape_fab.base.errors import Problem
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.film.drawing import joined
from tactape_fab.kit.profiles import load_fab
from tactape_fab.kit.read.gerber_file import GerberContent, read_gerber
from tactape_fab.kit.render.components import render_components
from tactape_fab.kit.render.cpl_bom import render_cpl
from tactape_fab.kit.render.gerber import render_copper, render_coverlay, render_legend, render_paste
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.cpl import CplContent, read_cpl
from tactape_fab.texture.panel_manifest import PlacedTape
from tactape_fab.verify.layers.board import PART_DATA
from tactape_fab.verify.layers.on_panel import OnPanel, inside, of_tape, part_data_of_tape, rows_of_tape

PLACED = PlacedTape(manifest="m", sha256="0", offset_mm=(40.0, 7.0), rotation_deg=90.0, first_designator="R1")


@pytest.mark.parametrize("rotation_deg", [45.0, 17.123456, 342.876543, 359.99999, 269.99999, 0.00001])
def test_a_turned_part_says_its_own_rotation_to_the_last_digit(rotation_deg: float) -> None:
    ordered = examine(TapeSpec(sector=7, size_mm=(25, 20), tag="none", name="t", pitch_mm=2.2, rotation_deg=rotation_deg))
    (artifact,) = render_components(joined([ordered.drawing], [(PLACED.offset_mm, True)]), load_fab("generic-fpc"))
    on = OnPanel(tape=ordered.tape, place=PLACED)
    said = dict(PART_DATA.findall(part_data_of_tape(artifact.data, on)))
    assert said[b"Rot"] == b"%g" % rotation_deg
    wrong = artifact.data.replace(b"TO.CRot,", b"TO.CRot,1", 1)
    assert dict(PART_DATA.findall(part_data_of_tape(wrong, on)))[b"Rot"] != b"%g" % rotation_deg


# Two tapes, of which the second is turned


FAB = load_fab("generic-fpc")
TAPES = [
    examine(TapeSpec(sector=sector, size_mm=(30, 20), name=f"t{sector}", pitch_mm=pitch_mm))
    for sector, pitch_mm in ((7, 1.9), (8, 2.2))
]
OFFSETS_MM = ((3.0, 7.0), (60.0, 8.0))
DRAWING = joined([made.drawing for made in TAPES], [(OFFSETS_MM[0], False), (OFFSETS_MM[1], True)])
ON = [
    OnPanel(
        tape=made.tape,
        place=PlacedTape(manifest="m", sha256="0", offset_mm=offset_mm, rotation_deg=rotation_deg, first_designator=f"R{first}"),
    )
    for made, offset_mm, rotation_deg, first in zip(
        TAPES, OFFSETS_MM, (0.0, 90.0), (1, 1 + TAPES[0].tape.part_count), strict=True
    )
]


def assert_same(found: GerberContent, own: GerberContent) -> None:
    """All that a layer has, with shapes and places within 2 nm: points of the panel are snapped to 1 nm."""
    for name in (field.name for field in fields(GerberContent)):
        one, other = getattr(found, name), getattr(own, name)
        if isinstance(one, np.ndarray):
            np.testing.assert_allclose(one, other, atol=2e-6, err_msg=name)
        elif name.endswith("_mm"):
            assert len(one) == len(other), name
            for a, b in zip(one, other, strict=True):
                np.testing.assert_allclose(a, b, atol=2e-6, err_msg=name)
        elif name != "file_attributes":
            assert one == other, name


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("render", [render_copper, render_coverlay, render_paste, render_legend])
def test_what_lies_on_a_tape_is_its_own_layer(which: int, render: Callable[..., tuple[Artifact, ...]]) -> None:
    of_panel, own = (read_gerber(render(drawing, FAB)[0].data) for drawing in (DRAWING, TAPES[which].drawing))
    assert_same(of_tape(of_panel, ON[which]), own)


@pytest.mark.parametrize("which", [0, 1])
def test_rows_of_a_tape_are_its_own(which: int) -> None:
    problems: list[Problem] = []
    of_panel, own = (read_cpl(render_cpl(drawing, FAB)[0].data, problems) for drawing in (DRAWING, TAPES[which].drawing))
    assert isinstance(of_panel, CplContent) and isinstance(own, CplContent) and not problems
    found = rows_of_tape(of_panel, ON[which])
    assert (found.designators, found.sides) == (own.designators, own.sides)
    assert np.array_equal(found.rotation_deg, own.rotation_deg)
    np.testing.assert_allclose(found.xy_mm, own.xy_mm, atol=2e-6)


@pytest.mark.parametrize("which", [0, 1])
def test_attributes_of_parts_are_of_the_tape_alone(which: int) -> None:
    of_panel, own = (render_components(drawing, FAB)[0].data for drawing in (DRAWING, TAPES[which].drawing))
    found = part_data_of_tape(of_panel, ON[which])
    assert dict(PART_DATA.findall(found)) == dict(PART_DATA.findall(own))
    assert found.count(b"%TO.C,R") == ON[which].tape.part_count


@pytest.mark.parametrize(("on_panel", "own"), [(b"100", b"10"), (b"30", b"300"), (b"x", b"x")])
def test_a_wrong_rotation_stays_wrong(on_panel: bytes, own: bytes) -> None:
    data = render_components(DRAWING, FAB)[0].data
    assert data.count(b"TO.CRot,135*") == 1
    found = part_data_of_tape(data.replace(b"TO.CRot,135*", b"TO.CRot,%s*" % on_panel), ON[1])
    assert dict(PART_DATA.findall(found))[b"Rot"] == own


def test_points_go_to_the_panel_and_back() -> None:
    corners = np.array([(0.0, 0.0), (30.0, 0.0), (30.0, 20.0), (0.0, 20.0)])
    expected = [(60.0, 8.0), (60.0, 38.0), (40.0, 38.0), (40.0, 8.0)]
    assert np.array_equal(ON[1].on_panel(corners), expected)
    assert np.array_equal(ON[1].on_board(np.array(expected)), corners)
    beside = np.array([(60.1, 20.0), (39.9, 20.0), (50.0, 7.9), (50.0, 38.1)])
    assert inside(np.array(expected), ON[1]).all() and not inside(beside, ON[1]).any()
