"""Streaming reader of a user's 3MF as triangles, which builds no XML tree and has limits on every count."""

from __future__ import annotations

import io
import zipfile
import zlib
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any
from xml.parsers import expat

import numpy as np

from tactape_fab.base.errors import SpecError
from tactape_fab.base.input_file import read_member
from tactape_fab.texture.frames import FloatArray, IntArray

MOST_FACES = 2_000_000
FURTHEST_MM = 1e9
_MOST_VERTICES = 3 * MOST_FACES
_MOST_UNPACKED, _MOST_RATIO, _SPARE = 1 << 30, 40, 1 << 20
"""Most bytes of an unpacked model, and largest ratio to the file's: our own have 6 to 9, those of slicers 4 to 12."""
_UNITS_MM = {"micron": 1e-3, "millimeter": 1.0, "centimeter": 10.0, "inch": 25.4, "foot": 304.8, "meter": 1000.0}
_SOLID = ("model", "solidsupport")
"""Types of objects that are solid and part of the print (3MF Core Specification 1.3, section 4.1)."""
_DEEPEST = 16
_MOST_OBJECTS = 10_000


def read_3mf(data: bytes) -> tuple[FloatArray, IntArray]:
    """Vertices in mm and triangles of all build items (3MF Core Specification 1.3, sections 3 and 4). Raises SpecError."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            models = [entry for entry in archive.infolist() if PurePosixPath(entry.filename).suffix.lower() == ".model"]
            if len(models) != 1:
                raise SpecError(f"SURFACE holds {len(models)} model parts, not 1; export it as STL")
            xml = read_member(archive, models[0], min(_MOST_UNPACKED, _MOST_RATIO * len(data) + _SPARE))
        return _Model(xml).mesh()
    except SpecError:
        raise
    except (zipfile.BadZipFile, zlib.error, expat.ExpatError, NotImplementedError, RuntimeError, OSError, EOFError) as error:
        raise SpecError(f"SURFACE cannot be read as 3MF: {error}; export it again, or as STL") from error
    except (LookupError, ValueError, OverflowError) as error:
        reason = f"a value is missing or not a number ({str(error)[:80]})"
        raise SpecError(f"SURFACE cannot be read as 3MF: {reason}; export it again, or as STL") from error


@dataclass(slots=True)
class _Object:
    """An object of the model: its mesh, or its components."""

    kind: str = "model"
    points: array[float] = field(default_factory=lambda: array("d"))
    corners: array[int] = field(default_factory=lambda: array("q"))
    has_mesh: bool = False
    components: list[Mapping[str, str]] = field(default_factory=list)
    arrays: tuple[FloatArray, IntArray] | None = None


class _Model:
    """One 3MF model: its objects, and the items of its build."""

    def __init__(self, xml: bytes) -> None:
        self.unit_mm = 1.0
        self.objects: dict[str, _Object] = {}
        self.items: list[Mapping[str, str]] = []
        self.placed = self.faces = self.vertices = self.read = 0
        self._now = _Object()
        # handlers by an element's full name, known once the root has given its namespace
        self._of: dict[str, Callable[[dict[str, str]], None]] | None = None
        # names are "namespace name"; elements of extensions have other namespaces, and are ignored
        parser = expat.ParserCreate(namespace_separator=" ")
        parser.buffer_text = True
        parser.StartElementHandler = self._start
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.Parse(xml, True)

    def _refuse_doctype(self, *_: Any) -> None:
        raise SpecError("SURFACE declares XML entities, which no 3MF needs; export it again")

    def _start(self, tag: str, values: dict[str, str]) -> None:
        if self._of is None:  # the root, whose namespace is that of all relevant elements
            space = tag.partition(" ")[0] + " " if " " in tag else ""
            unit = values.get("unit", "millimeter")
            if unit not in _UNITS_MM:
                raise SpecError(f"SURFACE has the unit {unit[:40]!r}, which 3MF does not know; export it again")
            self.unit_mm = _UNITS_MM[unit]
            handlers = (self._object, self._mesh, self._vertex, self._triangle, self._component, self._item)
            self._of = {space + handler.__name__[1:]: handler for handler in handlers}
        elif (handler := self._of.get(tag)) is not None:
            handler(values)

    def _object(self, values: dict[str, str]) -> None:
        self._now = self.objects[values.get("id", "")] = _Object(kind=values.get("type", "model"))

    def _mesh(self, _: dict[str, str]) -> None:
        if self._now.has_mesh:
            raise ValueError("an object has two meshes")
        self._now.has_mesh = True

    def _vertex(self, values: dict[str, str]) -> None:
        # an array of doubles takes 24 bytes per vertex, a quarter of a list of floats
        self._now.points.extend((float(values["x"]), float(values["y"]), float(values["z"])))
        self._count()

    def _triangle(self, values: dict[str, str]) -> None:
        self._now.corners.extend((int(values["v1"]), int(values["v2"]), int(values["v3"])))
        self._count()

    def _count(self) -> None:
        self.read += 1
        # checked while reading, before the arrays grow; checked again later, as an object may be placed many times
        if self.read > _MOST_VERTICES + MOST_FACES:
            raise SpecError(f"SURFACE has more than {MOST_FACES} triangles; give a coarser mesh")

    def _component(self, values: dict[str, str]) -> None:
        self._now.components.append(values)

    def _item(self, values: dict[str, str]) -> None:
        self.items.append(values)

    def mesh(self) -> tuple[FloatArray, IntArray]:
        vertices: list[FloatArray] = []
        faces: list[IntArray] = []
        for item in self.items:
            self._add(item, np.eye(3), np.zeros(3), vertices, faces, 0)
        if not vertices:
            return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
        # indices of triangles are relative to their object
        first = np.cumsum([0, *(len(v) for v in vertices[:-1])])
        return np.vstack(vertices) * self.unit_mm, np.vstack([f + i for f, i in zip(faces, first, strict=True)])

    def _add(
        self,
        reference: Mapping[str, str],
        turn: FloatArray,
        move: FloatArray,
        vertices: list[FloatArray],
        faces: list[IntArray],
        depth: int,
    ) -> None:
        self.placed += 1
        if depth > _DEEPEST or self.placed > _MOST_OBJECTS:
            raise SpecError(f"SURFACE places more than {_MOST_OBJECTS} objects or nests them too deep; export it as STL")
        target = self.objects.get(reference.get("objectid", ""))
        if target is None:
            raise SpecError("SURFACE places an object that its model part does not hold; export it as STL")
        if (transform := reference.get("transform")) is not None:
            numbers = np.array(transform.split(), dtype=np.float64)
            if len(numbers) != 12 or not (np.abs(numbers) < FURTHEST_MM).all():
                raise ValueError("transform")
            matrix = numbers.reshape(4, 3)  # row vectors, section 3.3
            turn, move = matrix[:3] @ turn, matrix[3] @ turn + move
        if target.has_mesh:
            if target.kind not in _SOLID:
                raise SpecError(f"SURFACE places an object of type {target.kind[:40]!r}, which is no solid; export the part")
            points, triangles = self._arrays(target)
            vertices.append(points @ turn + move)
            # a reflection reverses every triangle
            faces.append(triangles if np.linalg.det(turn) > 0 else triangles[:, ::-1])
        for component in target.components:
            self._add(component, turn, move, vertices, faces, depth + 1)

    def _arrays(self, target: _Object) -> tuple[FloatArray, IntArray]:
        if target.arrays is None:
            points = np.array(target.points, dtype=np.float64).reshape(-1, 3)
            triangles = np.array(target.corners, dtype=np.int64).reshape(-1, 3)
            if not (np.abs(points) < FURTHEST_MM).all():
                raise ValueError("a coordinate")
            if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(points)):
                raise ValueError("a triangle names a vertex that is not there")
            target.arrays = points, triangles
        points, triangles = target.arrays
        self.faces += len(triangles)
        self.vertices += len(points)
        if self.faces > MOST_FACES or self.vertices > _MOST_VERTICES:
            raise SpecError(f"SURFACE has more than {MOST_FACES} triangles; give a coarser mesh")
        return points, triangles
