"""The fabrication layers as Gerber files.

Every pad is the flash of an outline macro (primitive 4) whose vertices are literal and already turned: the one form
that gerbonara, tracespace, gerbv and PyGerber all draw right.
"""

from __future__ import annotations

import numpy as np

from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.gerber_text import GerberText
from tactape_fab.kit.layout import Flashes, Layout
from tactape_fab.profiles import FabProfile
from tactape_fab.texture.frames import to_nm

OUTLINE_LINE_MM = 0.1


def _artifact(layout: Layout, fab: FabProfile, role: str, gerber: GerberText) -> tuple[Artifact]:
    return (Artifact(role=role, path=fab.file_path(role, layout.tape.name), data=gerber.data()),)


def render_copper(layout: Layout, fab: FabProfile) -> tuple[Artifact]:
    """Copper layer: two flashed pads per part, each naming its component and pin (.P) where attributes are on; and what
    anchors them.
    """
    gerber = GerberText(layout.tape, fab.x2, "Copper,L1,Top")
    aperture = gerber.outline("PAD", layout.pads.outline_mm, "SMDPad,CuDef")
    gerber.object_attribute("N,N/C")
    gerber.add(f"{aperture}*")
    pad = np.arange(len(layout.pads.xy_mm))
    named = gerber.attribute_line("TO.P,R%d,%d")
    if named:
        values = np.column_stack([pad // 2 + 1, pad % 2 + 1, to_nm(layout.pads.xy_mm)])
        gerber.rows(f"{named}X%dY%dD03*\n", values)
    else:
        gerber.rows("X%dY%dD03*\n", to_nm(layout.pads.xy_mm))
    gerber.delete_attributes()
    if layout.anchors is not None:
        gerber.add(f"{gerber.circle(layout.anchors.web_mm, 'Conductor')}*")
        gerber.rows("X%dY%dD02*\nX%dY%dD01*\n", to_nm(layout.anchors.lines_mm).reshape(-1, 4))
    return _artifact(layout, fab, "copper-top", gerber)


def _render_flashes(
    layout: Layout, fab: FabProfile, role: str, function: str, polarity: str, macro: str, flashes: Flashes
) -> tuple[Artifact]:
    gerber = GerberText(layout.tape, fab.x2, function, polarity)
    gerber.flash(gerber.outline(macro, flashes.outline_mm, "Material"), flashes.xy_mm)
    return _artifact(layout, fab, role, gerber)


def render_coverlay(layout: Layout, fab: FabProfile) -> tuple[Artifact]:
    """Coverlay or mask as a soldermask layer: what is drawn is open, a window for each part or one for all."""
    if layout.window_mm is not None:
        gerber = GerberText(layout.tape, fab.x2, "Soldermask,Top", "Negative")
        gerber.regions([layout.window_mm], "Material")
        return _artifact(layout, fab, "coverlay-top", gerber)
    return _render_flashes(layout, fab, "coverlay-top", "Soldermask,Top", "Negative", "OPENING", layout.openings)


def render_paste(layout: Layout, fab: FabProfile) -> tuple[Artifact]:
    """Stencil apertures."""
    return _render_flashes(layout, fab, "paste-top", "Paste,Top", "Positive", "PASTE", layout.paste)


def render_legend(layout: Layout, fab: FabProfile) -> tuple[Artifact, ...]:
    """Tag and label; nothing for a tape without a strip."""
    legend = layout.legend
    if not legend.areas_mm:
        return ()
    gerber = GerberText(layout.tape, fab.x2, "Legend,Top")
    gerber.regions(legend.areas_mm, "Material")
    if legend.strokes_mm:
        gerber.add(f"{gerber.circle(legend.line_mm, 'Material')}*")
        for stroke in legend.strokes_mm:
            gerber.stroke(stroke)
    return _artifact(layout, fab, "legend-top", gerber)


def render_profile(layout: Layout, fab: FabProfile) -> tuple[Artifact]:
    """The outline, closed with the text it began with."""
    gerber = GerberText(layout.tape, fab.x2, "Profile,NP")
    gerber.add(f"{gerber.circle(OUTLINE_LINE_MM, 'Profile')}*")
    board = layout.tape.board
    (width, height), radius = to_nm(board.size_mm).tolist(), int(to_nm(board.corner_radius_mm))
    start = f"X{radius}Y0"
    gerber.add(f"{start}D02*")
    sides = (
        (f"X{width - radius}Y0", f"X{width}Y{radius}I0J{radius}"),
        (f"X{width}Y{height - radius}", f"X{width - radius}Y{height}I-{radius}J0"),
        (f"X{radius}Y{height}", f"X0Y{height - radius}I0J-{radius}"),
        (f"X0Y{radius}", f"{start}I{radius}J0"),
    )
    for line, arc in sides:
        gerber.add(f"{line}D01*")
        if radius:
            gerber.add("G03*", f"{arc}D01*", "G01*")
    return _artifact(layout, fab, "profile", gerber)
