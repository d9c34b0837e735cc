"""Text of a Gerber file: RS-274X with X2 attributes (Gerber Layer Format Specification 2024.05), from arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

import numpy as np

from tactape_fab.base.build_date import build_date
from tactape_fab.base.number_rows import number_rows
from tactape_fab.base.version import __version__
from tactape_fab.kit.film.drawing import Project
from tactape_fab.kit.profiles import X2Mode
from tactape_fab.texture.frames import FloatArray, IntArray, to_nm

_CHUNK = 20_000
"""Flashes formatted at a time, which bounds the memory."""
_FIRST_APERTURE = 10


class GerberText:
    """Lines of one Gerber file, with attributes in the mode that the fab accepts."""

    def __init__(self, project: Project, x2: X2Mode, file_function: str, polarity: str = "Positive") -> None:
        self._x2 = x2
        self._pieces: list[bytes] = []
        self._next_aperture = _FIRST_APERTURE
        self._attribute(f"TF.GenerationSoftware,tactape-fab,tactape-fab,{__version__}")
        self._attribute(f"TF.CreationDate,{build_date():%Y-%m-%dT%H:%M:%S+00:00}")
        self._attribute(f"TF.ProjectId,{project.id}")
        self._attribute(f"TF.SameCoordinates,{project.guid}")
        self._attribute(f"TF.Part,{project.part}")
        self._attribute(f"TF.FileFunction,{file_function}")
        self._attribute(f"TF.FilePolarity,{polarity}")
        # 4 and 6 digits of a millimetre: coordinates are whole nanometres
        self.add("%FSLAX46Y46*%", "%MOMM*%", "%LPD*%", "G75*", "G01*")

    def add(self, *lines: str) -> None:
        """Add lines as they are."""
        self._pieces += [f"{line}\n".encode("ascii") for line in lines]

    def _attribute(self, content: str) -> None:
        # Gerber 2024.05 section 5.1.1: attributes as standardised comments
        if self._x2 == "full":
            self.add(f"%{content}*%")
        elif self._x2 == "comments":
            self.add(f"G04 #@! {content}*")

    def attribute_line(self, content: str) -> str:
        """An attribute as a line of a %-format template, with ``%`` doubled; '' if attributes are off."""
        if self._x2 == "full":
            return f"%%{content}*%%\n"
        return f"G04 #@! {content}*\n" if self._x2 == "comments" else ""

    def object_attribute(self, content: str) -> None:
        """Set an attribute of the objects that follow, such as ``C,R1`` (5.4)."""
        self._attribute(f"TO.{content}")

    def delete_attributes(self) -> None:
        self._attribute("TD")

    def circle(self, diameter_mm: float, function: str) -> str:
        """Define a round aperture of a function, such as ``SMDPad,CuDef``; its D code."""
        return self._define(f"C,{diameter_mm:.6f}", function)

    def polygon(self, diameter_mm: float, corners: int, function: str) -> str:
        """Define a regular polygon by its outer diameter and number of corners as an aperture; its D code."""
        return self._define(f"P,{diameter_mm:.6f}X{corners}X0.000000", function)

    def outline(self, name: str, vertices_mm: FloatArray, function: str) -> str:
        """An outline macro and its aperture (Gerber 2024.05 section 4.5.1.6, primitive 4)."""
        closed = np.concatenate([vertices_mm, vertices_mm[:1]])
        points = ",\n".join(f"{x:.6f},{y:.6f}" for x, y in closed)
        # negative zeros are removed, as equal outlines must be equal bytes
        self.add(f"%AM{name}*", f"4,1,{len(vertices_mm)},\n{points},\n0*%".replace("-0.000000", "0.000000"))
        return self._define(name, function)

    def _define(self, shape: str, function: str) -> str:
        code = f"D{self._next_aperture}"
        self._next_aperture += 1
        # aperture attributes are set before the definition and deleted after it
        self._attribute(f"TA.AperFunction,{function}")
        self.add(f"%AD{code}{shape}*%")
        self.delete_attributes()
        return code

    def rows(self, template: str, values: IntArray) -> None:
        """Add the %-format `template`, which includes its line feeds, for each row of `values`; without a Python loop."""
        for start in range(0, len(values), _CHUNK):
            self._pieces.append(number_rows(template, values[start : start + _CHUNK]))

    def flash(self, aperture: str, xy_mm: FloatArray) -> None:
        """Flash an aperture, by its D code, at points of the board frame, mm; shape (n, 2)."""
        self.add(f"{aperture}*")
        self.rows("X%dY%dD03*\n", to_nm(xy_mm))

    def regions(self, areas_mm: Iterable[FloatArray], function: str) -> None:
        """Filled polygons (Gerber 2024.05 section 4.10); their function is in the aperture attributes (5.3)."""
        self._attribute(f"TA.AperFunction,{function}")
        for vertices_mm in areas_mm:
            self.add("G36*")
            self._contour(vertices_mm, closed=True)
            self.add("G37*")
        self.delete_attributes()

    def stroke(self, points_mm: FloatArray) -> None:
        """Draw an open line through points of the board frame, mm, with the current aperture."""
        self._contour(points_mm, closed=False)

    def _contour(self, points_mm: FloatArray, *, closed: bool) -> None:
        texts = [f"X{x}Y{y}" for x, y in to_nm(points_mm).tolist()]
        self.add(f"{texts[0]}D02*", *(f"{t}D01*" for t in texts[1:] + texts[:1] * closed))

    def data(self) -> bytes:
        """The whole file with its .MD5 (Gerber 2024.05 section 5.6.9: of everything before it, without line ends)."""
        # regions need no aperture (4.10), but gerbv takes a file that defines none for RS-274D, whose apertures come apart
        if self._next_aperture == _FIRST_APERTURE:
            self.circle(0.1, "Material")
        digest = hashlib.md5(usedforsecurity=False)
        for piece in self._pieces:
            digest.update(piece.replace(b"\n", b""))
        end = self.attribute_line(f"TF.MD5,{digest.hexdigest()}").replace("%%", "%")
        return b"".join([*self._pieces, f"{end}M02*\n".encode("ascii")])
