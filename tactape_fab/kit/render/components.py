"""X3 component layer (Gerber Layer Format Specification 2024.05, section 6): every part with its data, for archives
and for reading the assembly back without the CPL.
"""

from __future__ import annotations

import numpy as np

from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.render.gerber_text import GerberText
from tactape_fab.texture.frames import to_nm
from tactape_fab.texture.shapes import outlines_at

# Gerber 2024.05 section 6.2: fixed apertures of component centre, pin 1 and other pins
_CENTRE_MM = 0.3
_PIN_1_MM = 0.36
_BODY_LINE_MM = 0.1


def render_components(drawing: Drawing, fab: FabProfile) -> tuple[Artifact]:
    """Centre, body outline and both pins of every part; always with full attributes, which are the layer's content."""
    part = drawing.part
    gerber = GerberText(drawing.project, "full", "Component,L1,Top")
    centre = gerber.circle(_CENTRE_MM, "ComponentMain")
    body = gerber.circle(_BODY_LINE_MM, "ComponentOutline,Body")
    pin_1 = gerber.polygon(_PIN_1_MM, 4, "ComponentPin")
    pin_2 = gerber.circle(0.0, "ComponentPin")
    # object attributes hold until they are set again, so those that are equal for all parts are written once, before the first
    first, rotation_deg = 1, None
    for parts in drawing.parts:
        if parts.rotation_deg != rotation_deg:
            gerber.object_attribute(f"CRot,{parts.rotation_deg:g}")
        if rotation_deg is None:
            gerber.object_attribute("CMnt,SMD")
            gerber.object_attribute(f"CVal,{_field(part.value)}")
            gerber.object_attribute(f"CFtp,{_field(part.footprint)}")
            gerber.object_attribute(f"CHgt,{part.body_mm[2]:g}")
        rotation_deg = parts.rotation_deg
        corners = len(parts.bodies.outline_mm)
        # the text of one part: centre, body as a closed stroke, pins 1 and 2; %% is a per cent sign of an attribute
        template = (
            f"%%TO.C,R%d*%%\n{centre}*\nX%dY%dD03*\n{body}*\nX%dY%dD02*\n"
            + "X%dY%dD01*\n" * corners
            + f"%%TO.P,R%d,1*%%\n{pin_1}*\nX%dY%dD03*\n%%TO.P,R%d,2*%%\n{pin_2}*\nX%dY%dD03*\n%%TD.P*%%\n"
        )
        number = np.arange(first, first + len(parts.xy_mm))
        closed = np.concatenate([parts.bodies.outline_mm, parts.bodies.outline_mm[:1]])
        outline = to_nm(outlines_at(parts.xy_mm, closed)).reshape(len(number), -1)
        # the flashes of a part's two lands are consecutive: x1, y1, x2, y2
        pins = to_nm(parts.pads.xy_mm).reshape(-1, 4)
        values = np.column_stack([number, to_nm(parts.xy_mm), outline, number, pins[:, :2], number, pins[:, 2:]])
        gerber.rows(template, values)
        first += len(number)
    gerber.delete_attributes()
    role = "components-top"
    return (Artifact(role=role, path=fab.file_path(role, drawing.name), data=gerber.data()),)


def _field(text: str) -> str:
    """A text as one attribute field: the comma separates fields (Gerber 2024.05 section 3.4.3)."""
    return text.replace(",", "\\u002C")
