"""Registration of a scan's colour channels: many scanners see red, green and blue up to a pixel apart.

Lands are looked for in one colour and bodies in a mixture of all, so that colours half a pixel apart at 1200 dpi would move all
bodies by 18 um.
"""

from __future__ import annotations

import numpy as np

from tactape_fab.base.libraries import library
from tactape_fab.sense.inspect.colours import Palette
from tactape_fab.sense.inspect.scan_files import Picture
from tactape_fab.sense.inspect.warp import Warp
from tactape_fab.sense.objects.tag_view import tag_corners_mm
from tactape_fab.texture.tape import Tape

_LEAST_MM = 0.003
"""Least distance of two channels that is corrected: for aligned channels less than 1 um is found."""
_LEAST_CORRELATION = 0.9
_STEPS, _CONVERGED_PX = 50, 1e-4
_SMOOTH_PX = 5


def register_colours(picture: Picture, warp: Warp, tape: Tape, palette: Palette) -> None:
    """Shift two channels of a picture, in place, onto the third, in which lands are searched; does nothing if no tag is seen.

    The tag has only ink and film, so that its edges are the same in every channel. Around parts they are not: openings show in
    one, copper in another, and both may be apart. Not for photographs: their channels differ in scale, unlike at the tag.
    """
    cv2 = library("cv2", "inspecting a scan")
    if tape.tag is None:
        return
    corners = warp.to_px(tag_corners_mm(tape))
    rim = tape.tag.cell_mm * warp.px_per_mm
    low, high = np.floor(corners.min(axis=0) - rim).astype(int), np.ceil(corners.max(axis=0) + rim).astype(int)
    if (low < 0).any() or (high >= picture.shape[1::-1]).any():
        return
    tag = np.ascontiguousarray(picture[low[1] : high[1], low[0] : high[0]])
    best = int(np.argmax(np.abs(palette.metal - palette.film)))
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _STEPS, _CONVERGED_PX)
    for channel in {0, 1, 2} - {best}:
        matrix = np.eye(2, 3, dtype=np.float32)
        try:
            # the correlation that it maximizes does not depend on contrast and brightness (Evangelidis and Psarakis, 2008)
            alike, matrix = cv2.findTransformECC(
                tag[..., best], tag[..., channel], matrix, cv2.MOTION_TRANSLATION, until, None, _SMOOTH_PX
            )
        except cv2.error:  # it does not converge
            continue
        if alike < _LEAST_CORRELATION or np.hypot(*matrix[:, 2]) < _LEAST_MM * warp.px_per_mm:
            continue
        plane = np.ascontiguousarray(picture[..., channel])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        picture[..., channel] = cv2.warpAffine(plane, matrix, plane.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
