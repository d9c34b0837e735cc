"""Contacts over the edge of a plate: dots beside it weigh less, and poses err as far as they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import Localizer, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.sense.decode.contact.edge import PLATE_MM, off_edge
from tests.contacts import TAPE, nees

PLATE = examine(TapeSpec(sector=3, part="dome", size_mm=(60.0, 40.0), tag="none")).tape


def test_dots_of_a_plate_weigh_less_beside_its_edge() -> None:
    """By the distance from the edge alone, whichever of four it is; those of a film weigh the same everywhere."""
    x, y = PLATE.board.texture_origin_mm
    board_mm = np.array([(0.5, 20.0), (30.0, 1.1), (58.3, 20.0), (30.0, 20.0), (30.0, 39.9)])
    texture_mm = (board_mm - (x, y)) * (1.0, -1.0)
    weights = off_edge(np.array([1.0, 1.0, 1.0, 0.7, 0.1]), texture_mm, PLATE)
    assert weights == pytest.approx([0.15, 0.5, 1.0, 0.7, 0.1])
    thinnest = replace(PLATE, board=replace(PLATE.board, thickness_mm=PLATE_MM))
    assert off_edge(np.ones(5), texture_mm, thinnest) == pytest.approx([0.15, 0.5, 1.0, 1.0, 0.15])
    film = replace(PLATE, board=TAPE.board)
    assert (off_edge(np.ones(5), texture_mm, film) == 1.0).all()


def test_poses_over_the_edge_of_a_plate_are_as_exact_as_said() -> None:
    """Where dots beside the edge weigh fully, poses are 6 um nearer to the middle of the plate, and the mean is 2.6."""
    localizer, squares = Localizer([PLATE], refine="dots", world="closed"), []
    scene = Scene(elastomer_mm=0.25, contact_mm=(12.0, 7.0))
    for frame in iterate_frames(PLATE, 32, 5, scene=scene, edge=True):
        fix = localizer.locate(frame.depth)
        if fix.located:
            squares.append(nees(fix, frame))
    assert len(squares) > 24 and np.mean(squares) < 1.9
