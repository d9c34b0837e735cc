"""The fabrication layers as Gerber files.

Every pad is the flash of an outline macro (primitive 4) whose vertices are literal and already turned: the one form
that gerbonara, tracespace, gerbv and PyGerber all draw right.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.film.layout import Flashes
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.render.gerber_text import GerberText
from tactape_fab.texture.frames import to_nm

OUTLINE_LINE_MM = 0.1


def _artifact(drawing: Drawing, fab: FabProfile, role: str, gerber: GerberText) -> tuple[Artifact]:
    return (Artifact(role=role, path=fab.file_path(role, drawing.name), data=gerber.data()),)


def _apertures(gerber: GerberText, name: str, flashes: Sequence[Flashes], function: str) -> list[str]:
    """The aperture of each tape's flashes; those of one outline share it: two at most, as tapes lie turned or not."""
    known: dict[bytes, str] = {}
    for of in flashes:
        # outlines of equal parts are equal numbers; rounded, as a last bit must not make an aperture of its own
        if (key := of.outline_mm.round(9).tobytes()) not in known:
            known[key] = gerber.outline(f"{name}TURNED" if known else name, of.outline_mm, function)
    return [known[of.outline_mm.round(9).tobytes()] for of in flashes]


def _flash_all(gerber: GerberText, name: str, flashes: Sequence[Flashes]) -> None:
    apertures = _apertures(gerber, name, flashes, "Material")
    for aperture in dict.fromkeys(apertures):
        of_it = [of.xy_mm for of, own in zip(flashes, apertures, strict=True) if own == aperture]
        gerber.flash(aperture, np.concatenate(of_it))


def render_copper(drawing: Drawing, fab: FabProfile) -> tuple[Artifact]:
    """Copper layer: two flashed pads per part, each naming its component and pin (.P) where attributes are on; what anchors
    them; and fiducials.
    """
    gerber = GerberText(drawing.project, fab.x2, "Copper,L1,Top")
    apertures = _apertures(gerber, "PAD", [parts.pads for parts in drawing.parts], "SMDPad,CuDef")
    gerber.object_attribute("N,N/C")
    named = gerber.attribute_line("TO.P,R%d,%d")
    first, before = 0, ""
    for parts, aperture in zip(drawing.parts, apertures, strict=True):
        # an aperture is selected where it changes: the attributes between do not undo it
        gerber.add(*[f"{aperture}*"] * (aperture != before))
        pad = np.arange(first, first + len(parts.pads.xy_mm))
        if named:
            # pads come in pairs: component pad // 2 + 1, pin pad % 2 + 1
            values = np.column_stack([pad // 2 + 1, pad % 2 + 1, to_nm(parts.pads.xy_mm)])
            gerber.rows(f"{named}X%dY%dD03*\n", values)
        else:
            gerber.rows("X%dY%dD03*\n", to_nm(parts.pads.xy_mm))
        first, before = first + len(pad), aperture
    # fiducials and anchors belong to no net and no part
    gerber.delete_attributes()
    if drawing.anchors is not None:
        gerber.add(f"{gerber.circle(drawing.anchors.web_mm, 'Conductor')}*")
        gerber.rows("X%dY%dD02*\nX%dY%dD01*\n", to_nm(drawing.anchors.lines_mm).reshape(-1, 4))
    if drawing.fiducials is not None:
        gerber.flash(gerber.circle(drawing.fiducials.copper_mm, "FiducialPad,Global"), drawing.fiducials.xy_mm)
    return _artifact(drawing, fab, "copper-top", gerber)


def render_coverlay(drawing: Drawing, fab: FabProfile) -> tuple[Artifact]:
    """Coverlay or mask as a soldermask layer: what is drawn is open, a window for each part or one for all of a tape."""
    gerber = GerberText(drawing.project, fab.x2, "Soldermask,Top", "Negative")
    if drawing.windows_mm:
        gerber.regions(drawing.windows_mm, "Material")
    _flash_all(gerber, "OPENING", [parts.openings for parts in drawing.parts if parts.openings is not None])
    if drawing.fiducials is not None:
        gerber.flash(gerber.circle(drawing.fiducials.opening_mm, "Material"), drawing.fiducials.xy_mm)
    return _artifact(drawing, fab, "coverlay-top", gerber)


def render_paste(drawing: Drawing, fab: FabProfile) -> tuple[Artifact]:
    """Stencil apertures."""
    gerber = GerberText(drawing.project, fab.x2, "Paste,Top")
    _flash_all(gerber, "PASTE", [parts.paste for parts in drawing.parts])
    return _artifact(drawing, fab, "paste-top", gerber)


def render_legend(drawing: Drawing, fab: FabProfile) -> tuple[Artifact, ...]:
    """Tags and labels; nothing for tapes without a strip."""
    legend = drawing.legend
    if not legend.areas_mm:
        return ()
    gerber = GerberText(drawing.project, fab.x2, "Legend,Top")
    gerber.regions(legend.areas_mm, "Material")
    if legend.strokes_mm:
        gerber.add(f"{gerber.circle(legend.line_mm, 'Material')}*")
        for stroke in legend.strokes_mm:
            gerber.stroke(stroke)
    return _artifact(drawing, fab, "legend-top", gerber)


def render_profile(drawing: Drawing, fab: FabProfile) -> tuple[Artifact]:
    """The outline, closed with the text it began with, and what is cut out round the tapes of a panel, closed, too."""
    gerber = GerberText(drawing.project, fab.x2, "Profile,NP")
    gerber.add(f"{gerber.circle(OUTLINE_LINE_MM, 'Profile')}*")
    (width, height), radius = to_nm(drawing.size_mm).tolist(), int(to_nm(drawing.corner_radius_mm))
    # begin and end are the same text, so that the outline is closed to the last digit, whatever a reader does with it
    start = f"X{radius}Y0"
    gerber.add(f"{start}D02*")
    # a straight side, then a quarter turn counter-clockwise; I and J lead from the arc's begin to its centre
    sides = (
        (f"X{width - radius}Y0", f"X{width}Y{radius}I0J{radius}"),
        (f"X{width}Y{height - radius}", f"X{width - radius}Y{height}I-{radius}J0"),
        (f"X{radius}Y{height}", f"X0Y{height - radius}I0J-{radius}"),
        (f"X0Y{radius}", f"{start}I{radius}J0"),
    )
    for line, arc in sides:
        gerber.add(f"{line}D01*")
        # an arc of radius 0 would end where it begins, which is a full
        # turn with G75; the mode goes back to linear for what follows
        if radius:
            gerber.add("G03*", f"{arc}D01*", "G01*")
    for slot in drawing.slots_mm:
        gerber.stroke(np.concatenate([slot, slot[:1]]))
    return _artifact(drawing, fab, "profile", gerber)
