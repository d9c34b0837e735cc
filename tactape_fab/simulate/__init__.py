"""Depth maps of a tape in contact with a tactile sensor: what the decoder is tested on, and shares no code with.

Nothing here looks at a code or a symbol: parts stand where the tape, or a written CPL, says.
"""

from __future__ import annotations

from tactape_fab.simulate.dots import DotErrors, Dots, dots_of
from tactape_fab.simulate.frames import Frame, Frames, draw_poses, iterate_frames, simulate, simulate_frames
from tactape_fab.simulate.impostors import SURFACES, other_surface, plain_grid, random_bumps, random_symbols
from tactape_fab.simulate.parts import Parts, parts_from_cpl
from tactape_fab.simulate.recorded import DotFrames, DotRecords, draw_dots, record_dots
from tactape_fab.simulate.scene import Scene

__all__ = [
    "SURFACES",
    "DotErrors",
    "DotFrames",
    "DotRecords",
    "Dots",
    "Frame",
    "Frames",
    "Parts",
    "Scene",
    "dots_of",
    "draw_dots",
    "draw_poses",
    "iterate_frames",
    "other_surface",
    "parts_from_cpl",
    "plain_grid",
    "random_bumps",
    "random_symbols",
    "record_dots",
    "simulate",
    "simulate_frames",
]
