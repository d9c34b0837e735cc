"""Triangle meshes, and their reproducible files: binary STL, and 3MF."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.build_date import zip_entry
from tactape_fab.base.number_rows import number_rows
from tactape_fab.texture.frames import FloatArray, IntArray

_PIECE_ROWS = 20_000
"""Vertices or triangles that are written at once, which bounds the memory."""
_ROW_BYTES = 60
"""Upper bound of the bytes of a vertex or triangle in the XML of a 3MF."""
_DEFLATE_LEVEL = 4
"""zlib level: three times as fast as the default of 6, for 5 % more bytes of a 3MF (`python -m tests.bench.make_cost`)."""
_LEVEL_NAME = "compress_level" if hasattr(zipfile.ZipInfo, "compress_level") else "_compresslevel"
"""Attribute of a ZipInfo with the level, which is public from Python 3.13 on."""
_STL_HEADER_BYTES = 80
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A closed triangle mesh.

    vertices_mm (v, 3)
    faces (f, 3): Counter-clockwise seen from outside.
    """

    vertices_mm: FloatArray
    faces: IntArray

    @property
    def corners_mm(self) -> FloatArray:
        """Corners of every triangle; shape (f, 3, 3)."""
        return self.vertices_mm[self.faces]

    @cached_property
    def volume_mm3(self) -> float:
        """Enclosed volume, by the divergence theorem about the mesh's middle."""
        # signed tetrahedra a . (b x c) / 6 about the middle, as their sum would lose digits far from the origin
        a, b, c = np.moveaxis(self.corners_mm - self.vertices_mm.mean(axis=0), 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors normalised along the last axis; zero vectors stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1.0)


def face_normals(corners: FloatArray) -> FloatArray:
    """Unit normals of triangles (f, 3, 3), zero for one without area; shape (f, 3)."""
    return unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def stl_bytes(mesh: Mesh, title: str) -> bytes:
    """Binary STL in mm; see `stl_pieces`."""
    return b"".join(stl_pieces(mesh, title))


def stl_pieces(mesh: Mesh, title: str) -> Iterator[bytes]:
    """Binary STL in mm, in pieces; `title` is in the header, and must not begin with "solid".

    Corners are the vertices rounded to float32; equal vertices give equal corners, so that a closed mesh stays closed.
    """
    header: bytes = f"binary STL, mm: {title}".encode("ascii", "replace")[:_STL_HEADER_BYTES].ljust(_STL_HEADER_BYTES)
    yield header + len(mesh.faces).to_bytes(4, "little")
    vertices = mesh.vertices_mm.astype("<f4")
    for faces in _pieces(mesh.faces):
        corners = vertices[faces]
        triangles = np.zeros(len(corners), dtype=STL_TRIANGLE)
        triangles["normal"] = face_normals(corners)
        triangles["corners"] = corners
        yield triangles.tobytes()


def _pieces(rows: npt.NDArray[Any]) -> Iterator[npt.NDArray[Any]]:
    return (rows[i : i + _PIECE_ROWS] for i in range(0, len(rows), _PIECE_ROWS))


# 3MF Core Specification 1.3: one object, one build item, millimetres

_CONTENT_TYPES = (
    b'<?xml version="1.0" encoding="UTF-8"?>\n'
    b'<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    b'<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    b'<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
    b"</Types>\n"
)
_RELATIONSHIPS = (
    b'<?xml version="1.0" encoding="UTF-8"?>\n'
    b'<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    b'<Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    b"</Relationships>\n"
)
THREEMF_PARTS = {"[Content_Types].xml": _CONTENT_TYPES, "_rels/.rels": _RELATIONSHIPS}
"""Members of a 3MF package before its model."""
THREEMF_MODEL = "3D/3dmodel.model"


def threemf_bytes(mesh: Mesh, title: str, metadata: Mapping[str, str], date: datetime) -> bytes:
    """3MF with unit, title and metadata, compressed and dated `date`; equal meshes give equal bytes.

    metadata: Well-known names of the 3MF core specification (section 3.4.1), such as Description and Application.
    date: From 1980 to 2107.
    """
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:  # a level given here would not apply to our entries
        for path, pieces in (
            *((path, [part]) for path, part in THREEMF_PARTS.items()),
            (THREEMF_MODEL, _model_xml(mesh, title, metadata)),
        ):
            entry = zip_entry(path, date)
            setattr(entry, _LEVEL_NAME, _DEFLATE_LEVEL)
            entry.file_size = _ROW_BYTES * (len(mesh.vertices_mm) + len(mesh.faces))  # more than 2 GB needs a zip64 entry
            with archive.open(entry, "w") as member:
                for piece in pieces:
                    member.write(piece)
    return stream.getvalue()


def _model_xml(mesh: Mesh, title: str, metadata: Mapping[str, str]) -> Iterator[bytes]:
    yield (
        b'<?xml version="1.0" encoding="UTF-8"?>\n'
        b'<model unit="millimeter" xml:lang="en-US" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">\n'
    )
    for name, value in {"Title": title, **metadata}.items():
        yield f'<metadata name="{escape(name)}">{escape(value, quote=False)}</metadata>\n'.encode()
    yield f'<resources>\n<object id="1" type="model" name="{escape(title)}">\n<mesh>\n<vertices>\n'.encode()
    for rows in _pieces(mesh.vertices_mm):
        yield number_rows('<vertex x="%.6f" y="%.6f" z="%.6f"/>\n', rows)
    yield b"</vertices>\n<triangles>\n"
    for corners in _pieces(mesh.faces):
        yield number_rows('<triangle v1="%d" v2="%d" v3="%d"/>\n', corners)
    yield b'</triangles>\n</mesh>\n</object>\n</resources>\n<build>\n<item objectid="1"/>\n</build>\n</model>\n'
