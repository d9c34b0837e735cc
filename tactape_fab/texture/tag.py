"""Cells of an AprilTag 36h11 by its id."""

from __future__ import annotations

import numpy as np

from tactape_fab.base.libraries import library
from tactape_fab.texture.frames import BoolArray

CODE_CELLS = 8
"""Cells along a side: 6 of data and the black border."""
RING_CELLS = 1
"""Width of the light ring outside the black border, without which detectors do not find the tag (AprilTag 2, section III)."""
SIDE_CELLS = CODE_CELLS + 2 * RING_CELLS
LEAST_CELL_MM = 0.30
"""Smallest cell that prints and that pupil-apriltags still reads after 0.05 mm of ink bleed; OpenCV needs 0.5 mm."""


def tag_cells(tag_id: int) -> BoolArray:
    """Cells of a tag and its light ring, upright in AprilRobotics' orientation.

    tag_id: 0 ... 586.
    Returns (10, 10): True where light; row 0 is the top.
    """
    aruco = library("cv2", "drawing an AprilTag").aruco
    dictionary = aruco.getPredefinedDictionary(aruco.DICT_APRILTAG_36h11)
    # OpenCV's tags are turned by 180 degrees against AprilRobotics'
    upright = aruco.generateImageMarker(dictionary, tag_id, CODE_CELLS)[::-1, ::-1]
    return np.pad(upright > 127, RING_CELLS, constant_values=True)
