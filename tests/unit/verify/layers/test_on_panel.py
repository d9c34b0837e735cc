"""The part of a panel's component layer that is one tape's."""

from __future__ import annotations

import pytest

from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.film.drawing import joined
from tactape_fab.kit.profiles import load_fab
from tactape_fab.kit.render.components import render_components
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.panel_manifest import PlacedTape
from tactape_fab.verify.layers.board import PART_DATA
from tactape_fab.verify.layers.on_panel import OnPanel, part_data_of_tape

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
