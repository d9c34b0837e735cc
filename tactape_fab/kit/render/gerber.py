"""The fabrication layers as Gerber files.

Every pad is a flash of an outline macro (primitive 4) with literal, already rotated vertices: the only form that
gerbonara, tracespace, gerbv and PyGerber all draw correctly.
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
    """The aperture of each tape's flashes; equal outlines share one, so there are two at most, for turned tapes and others."""
    known: dict[bytes, str] = {}
    for of in flashes:
        # rounded, as a difference in the last bit must not make another aperture
        if (key := of.outline_mm.round(9).tobytes()) not in known:
            known[key] = gerber.outline(f"{name}TURNED" if known else name, of.outline_mm, function)
    return [known[of.outline_mm.round(9).tobytes()] for of in flashes]


def _flash_all(gerber: GerberText, name: str, flashes: Sequence[Flashes]) -> None:
    apertures = _apertures(gerber, name, flashes, "Material")
    for aperture in dict.fromkeys(apertures):
        of_it = [of.xy_mm for of, own in zip(flashes, apertures, strict=True) if own == aperture]
        gerber.flash(aperture, np.concatenate(of_it))


def render_copper(drawing: Drawing, fab: FabProfile) -> tuple[Artifact]:
    """Copper layer: two flashed pads per part, with component and pin (.P) if attributes are on; anchors; and fiducials."""
    gerber = GerberText(drawing.project, fab.x2, "Copper,L1,Top")
    apertures = _apertures(gerber, "PAD", [parts.pads for parts in drawing.parts], "SMDPad,CuDef")
    # N/C is the net of a single pad (Gerber 2024.05 section 5.6.13); a mesh connects pads, which then state no net
    if drawing.anchors is None or not len(drawing.anchors.webs_mm):
        gerber.object_attribute("N,N/C")
    named = gerber.attribute_line("TO.P,R%d,%d")
    first, before = 0, ""
    for parts, aperture in zip(drawing.parts, apertures, strict=True):
        # an aperture is selected only if it changes; the attributes in between do not deselect it
        gerber.add(*[f"{aperture}*"] * (aperture != before))
        pad = np.arange(first, first + len(parts.pads.xy_mm))
        if named:
            # two pads per part: component pad // 2 + 1, pin pad % 2 + 1
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
    """Coverlay or solder mask as a soldermask layer, which draws the openings: one per part, or one for all parts of a tape."""
    gerber = GerberText(drawing.project, fab.x2, "Soldermask,Top", "Negative")
    if drawing.windows_mm:
        gerber.regions(drawing.windows_mm, "Material")
    _flash_all(gerber, "OPENING", [parts.openings for parts in drawing.parts if parts.openings is not None])
    if drawing.fiducials is not None:
        gerber.flash(gerber.circle(drawing.fiducials.opening_mm, "Material"), drawing.fiducials.xy_mm)
    return _artifact(drawing, fab, "coverlay-top", gerber)


def render_paste(drawing: Drawing, fab: FabProfile) -> tuple[Artifact]:
    """Solder paste layer: the stencil's apertures."""
    gerber = GerberText(drawing.project, fab.x2, "Paste,Top")
    _flash_all(gerber, "PASTE", [parts.paste for parts in drawing.parts])
    return _artifact(drawing, fab, "paste-top", gerber)


def render_legend(drawing: Drawing, fab: FabProfile) -> tuple[Artifact, ...]:
    """Legend layer: tags and labels; no file for tapes without a strip."""
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
    """Profile layer: the outline, and the slots around the tapes of a panel, as closed contours."""
    gerber = GerberText(drawing.project, fab.x2, "Profile,NP")
    gerber.add(f"{gerber.circle(OUTLINE_LINE_MM, 'Profile')}*")
    (width, height), radius = to_nm(drawing.size_mm).tolist(), int(to_nm(drawing.corner_radius_mm))
    # start and end point are the same text, so that the outline is exactly closed for every reader
    start = f"X{radius}Y0"
    gerber.add(f"{start}D02*")
    # a straight side, then a counter-clockwise quarter circle; I and J are the vector from the arc's start to its centre
    sides = (
        (f"X{width - radius}Y0", f"X{width}Y{radius}I0J{radius}"),
        (f"X{width}Y{height - radius}", f"X{width - radius}Y{height}I-{radius}J0"),
        (f"X{radius}Y{height}", f"X0Y{height - radius}I0J-{radius}"),
        (f"X0Y{radius}", f"{start}I{radius}J0"),
    )
    for line, arc in sides:
        gerber.add(f"{line}D01*")
        # an arc of radius 0 would end where it starts, which is a full
        # circle with G75; afterwards the mode is linear again
        if radius:
            gerber.add("G03*", f"{arc}D01*", "G01*")
    for slot in drawing.slots_mm:
        gerber.stroke(np.concatenate([slot, slot[:1]]))
    return _artifact(drawing, fab, "profile", gerber)
