"""Dots beside the edge of a plate, over which the gel falls: their tops are drawn outwards, and they weigh less in the pose."""

from __future__ import annotations

import numpy as np

from tactape_fab.texture.frames import FloatArray, texture_to_board
from tactape_fab.texture.shapes import inset_mm
from tactape_fab.texture.tape import Tape

PLATE_MM = 0.3
"""Boards from this thickness on have an edge: printed and milled plates, FR4. A film of 0.1 mm moves no dots."""
NEAR_MM, FAR_MM, LEAST = 0.5, 1.7, 0.15
"""Distances from the edge at which a dot weighs `LEAST` and fully. On simulated plates of 0.8 mm dots are drawn by 3 and 22 um at
1.25 mm, for a gel that blurs by 0.15 and 0.25 mm, by 17 to 25 um at 1 mm, and not from 1.75 mm on."""


def off_edge(weights: FloatArray, texture_mm: FloatArray, tape: Tape) -> FloatArray:
    """Weights (n,) of dots whose parts stand at `texture_mm` (n, 2), less beside the edge of a plate."""
    board = tape.board
    if board.thickness_mm < PLATE_MM:
        return weights
    inside_mm = inset_mm(texture_to_board(texture_mm, board.texture_origin_mm), board.size_mm, board.corner_radius_mm)
    return np.minimum(weights, np.clip((inside_mm - NEAR_MM) / (FAR_MM - NEAR_MM), LEAST, 1.0))
