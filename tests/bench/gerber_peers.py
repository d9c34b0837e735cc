"""One copper layer by two Gerber libraries: the same pads from the same arrays, through their own objects, to bytes."""

from __future__ import annotations

import re
from collections.abc import Callable
from math import radians
from typing import Any

import gerber_writer
import numpy as np
from gerbonara.aperture_macros.parse import GenericMacros
from gerbonara.apertures import ApertureMacroInstance, RectangleAperture
from gerbonara.graphic_objects import Flash
from gerbonara.rs274x import GerberFile
from gerbonara.utils import MM

from tactape_fab.kit.film.layout import Layout
from tactape_fab.texture.frames import FloatArray


def with_gerber_writer(layout: Layout) -> bytes:
    land, rotation_deg = layout.part.pads, layout.tape.part.rotation_deg
    pad = gerber_writer.RoundedRectangle(*land.size_mm, land.corner_radius_mm, "SMDPad,CuDef")
    layer = gerber_writer.DataLayer("Copper,L1,Top")
    for x, y in layout.pads.xy_mm.tolist():
        layer.add_pad(pad, (x, y), rotation_deg)
    text: str = layer.dumps_gerber()
    return text.encode()


def gerbonara_layer(layout: Layout, aperture: Any) -> bytes:
    layer = GerberFile(objects=[Flash(x, y, aperture, unit=MM) for x, y in layout.pads.xy_mm.tolist()])
    return bytes(layer.write_to_bytes())


def with_gerbonara(layout: Layout) -> bytes:
    land, clockwise_rad = layout.part.pads, -radians(layout.tape.part.rotation_deg)
    shape = (*land.size_mm, land.corner_radius_mm, 0, 0, clockwise_rad)
    return gerbonara_layer(layout, ApertureMacroInstance(macro=GenericMacros.rounded_rect, parameters=shape, unit=MM))


def with_gerbonara_and_sharp_corners(layout: Layout) -> bytes:
    """Its cheapest turned pad: not the same shape, but the least that it can take."""
    pad = RectangleAperture(*layout.part.pads.size_mm, unit=MM).rotated(-radians(layout.tape.part.rotation_deg))
    return gerbonara_layer(layout, pad)


PEERS: dict[str, Callable[[Layout], bytes]] = {
    "gerber_writer": with_gerber_writer,
    "gerbonara": with_gerbonara,
    "gerbonara, pads with sharp corners": with_gerbonara_and_sharp_corners,
}


def flashes_mm(gerber: bytes) -> FloatArray:
    """Places of all flashes as a file has them."""
    decimals = re.search(rb"%FSLAX\d(\d)Y", gerber)
    assert decimals is not None
    places: FloatArray = np.array(re.findall(rb"X(-?\d+)Y(-?\d+)D03\*", gerber), dtype=np.float64)
    return places / 10.0 ** int(decimals[1])
