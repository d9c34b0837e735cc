"""Gerber files read by the writer's own grammar: what gerbonara reads of them, and nothing in another form."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab import Kit
from tactape_fab.kit.read.gerber_file import read_gerber
from tactape_fab.kit.read.written_gerber import FormError, read_shapes, read_written

LAYERS = ("copper-top", "coverlay-top", "paste-top", "legend-top", "profile", "components-top")


@pytest.mark.parametrize("role", LAYERS)
def test_shapes_are_those_that_gerbonara_reads(small_kit: Kit, role: str) -> None:
    data = (small_kit.path / small_kit.files[role]).read_bytes()
    read_written(data)
    own, other = read_shapes(data), read_gerber(data)
    assert own.flash_xy_mm.tolist() == other.flash_xy_mm.tolist()
    assert own.flash_aperture.tolist() == other.flash_aperture.tolist()
    assert own.stroke_width_mm.tolist() == other.stroke_width_mm.tolist()
    for shapes in ("areas_mm", "strokes_mm"):
        for one, same in zip(getattr(own, shapes), getattr(other, shapes), strict=True):
            np.testing.assert_allclose(one, same, rtol=0.0, atol=1e-9)
    if role != "components-top":  # the shapes of its pins are two, a circle and a square, of which pictures show neither
        for one, same in zip(own.aperture_outlines_mm, other.aperture_outlines_mm, strict=True):
            np.testing.assert_allclose(one, same, rtol=0.0, atol=1e-9)


def test_a_file_in_another_form_is_left_to_gerbonara(small_kit: Kit) -> None:
    data = (small_kit.path / small_kit.files["copper-top"]).read_bytes().replace(b"G01*\n", b"G01*\nG04 by hand*\n", 1)
    with pytest.raises(FormError, match=r"line \d+, 'G04 by hand\*', is none"):
        read_written(data)
    assert read_shapes(data) is read_gerber(data)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("X1Y2D03*", "cannot flash here"),
        ("D11*", "not defined"),
        ("X1Y2D01*", "cannot draw here"),
        ("D10*\nX0Y0D02*\nX5Y0D03*\nX5Y5D01*", "cannot draw here"),
        ("D10*\nX0Y0D02*\nX5Y0D03*\nG04 #@! TA.AperFunction,Other,x*\nX5Y5D01*", "cannot draw here"),
        ("X1Y2I1J1D02*", "no move or flash"),
        ("X1Y2D04*", "is none that the writer writes"),
        ("G03*\nG03*", "is none that the writer writes"),
        ("G36*\nX1Y2D01*", "one contour"),
        ("G36*\nX1Y2D02*\nX2Y2D01*\nX2Y3D02*", "one contour"),
        ("G36*\nX1Y2D02*\nX2Y2D01*\nX2Y3D01*\nG37*", "is none that the writer writes"),
        ("G36*\nX1Y2D02*\nX2Y2D01*\nX1Y2D01*", "does not end"),
    ],
)
def test_a_line_out_of_its_place_is_refused(line: str, why: str) -> None:
    head = "%FSLAX46Y46*%\n%MOMM*%\n%LPD*%\nG75*\nG01*\n%ADD10C,0.100000*%\n"
    with pytest.raises(FormError, match=why):
        read_written(f"{head}{line}\nM02*\n".encode())
