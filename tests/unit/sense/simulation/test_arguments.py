"""Arguments of the simulator: a strip is round a cylinder that the tape's board can be bent to."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import pytest

from tactape_fab import Kit, Tape, TapeSpec
from tactape_fab.base.errors import SpecError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Scene, simulate, simulate_frames
from tests.tapes import tape_at


@pytest.mark.parametrize(("flexible", "thickness_mm"), [(True, 0.11), (False, 1.6), (None, 3.0)])
def test_a_strip_is_round_a_cylinder_that_the_board_can_be_bent_to(flexible: bool | None, thickness_mm: float) -> None:
    tape = tape_at(7, (12, 8))
    tape = replace(tape, board=replace(tape.board, flexible=flexible, thickness_mm=thickness_mm))
    ways: list[Callable[[Scene], object]] = [
        lambda scene: simulate(tape, (5.0, 5.0), 0.0, scene=scene),
        lambda scene: simulate_frames(tape, 1, seed=0, scene=scene),
        lambda scene: simulate(tape, (5.0, 5.0), 0.0, contact=scene.contact, cylinder_radius_mm=scene.cylinder_radius_mm),
    ]
    says = {
        True: r"^scene.cylinder_radius_mm = 1.099 mm is below 1.1 mm, 10 times the 0.11 mm of its film.*; give 1.1 mm or more$",
        False: r"^scene.cylinder_radius_mm = 1.099 mm contradicts the rigid board of tape-7; leave the tape flat$",
    }
    for way in ways:
        if flexible is None:
            way(Scene(contact="strip", cylinder_radius_mm=1.099))
            continue
        with pytest.raises(SpecError, match=says[flexible]):
            way(Scene(contact="strip", cylinder_radius_mm=1.099))
        way(Scene(cylinder_radius_mm=1.099))
    if flexible:
        simulate(tape, (5.0, 5.0), 0.0, scene=Scene(contact="strip", cylinder_radius_mm=1.1))


def test_a_kit_says_whether_its_board_can_be_bent(small_kit: Kit) -> None:
    manifest = json.loads((small_kit.path / "manifest.json").read_text())
    assert small_kit.tape.board.flexible is True and Tape.load(small_kit.path).board.flexible is True
    assert "flexible" not in manifest["board"]
    assert "flexible" not in repr(small_kit.tape.board)  # of which the identity of its files is made
    manifest["fab"]["material"]["flexible"] = False
    assert Tape.from_mapping(manifest).board.flexible is False
    for said in (1, None, "yes"):
        manifest["fab"]["material"]["flexible"] = said
        assert Tape.from_mapping(manifest).board.flexible is None
    del manifest["fab"]
    assert Tape.from_mapping(manifest).board.flexible is None
    rigid = TapeSpec(sector=7, size_mm=(20.0, 20.0), fab="generic-fr4", pitch_mm=2.2, displacement_mm=0.25)
    assert examine(rigid).tape.board.flexible is False
    assert examine(TapeSpec(sector=7, size_mm=(20.0, 20.0), part="dome")).tape.board.flexible is None
