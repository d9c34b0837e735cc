"""Mesh and its two formats: binary STL, and 3MF as our own text and zip, the same bytes every time."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from html import escape

import numpy as np

from tactape_fab.texture.frames import FloatArray, IntArray

_STL_HEADER_BYTES = 80
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh:
    """A closed triangle mesh.

    Attributes
    ----------
    vertices_mm : ndarray, shape (v, 3)
    faces : ndarray of int, shape (f, 3)
        Counter-clockwise seen from outside.
    """

    vertices_mm: FloatArray
    faces: IntArray

    @property
    def corners_mm(self) -> FloatArray:
        """Corners of every triangle; shape (f, 3, 3)."""
        corners: FloatArray = self.vertices_mm[self.faces]
        return corners

    @property
    def volume_mm3(self) -> float:
        """Enclosed volume, by the divergence theorem about the mesh's middle."""
        a, b, c = np.moveaxis(self.corners_mm - self.vertices_mm.mean(axis=0), 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def stl_bytes(mesh: Mesh, title: str) -> bytes:
    """Binary STL in mm; `title` stands in the header, which must not begin with "solid".

    Corners are the vertices rounded to float32, equal vertices to equal corners: a closed mesh stays closed.
    """
    corners = mesh.corners_mm.astype("<f4")
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = np.zeros(len(corners), dtype=_STL_TRIANGLE)
    triangles["normal"] = normals / np.where(lengths > 0, lengths, 1)
    triangles["corners"] = corners
    header: bytes = f"binary STL, mm: {title}".encode("ascii", "replace")[:_STL_HEADER_BYTES].ljust(_STL_HEADER_BYTES)
    return b"".join([header, len(triangles).to_bytes(4, "little"), triangles.tobytes()])


# 3MF Core Specification 1.3: one object, one build item, millimetres

_CONTENT_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
    "</Types>\n"
)
_RELATIONSHIPS = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    "</Relationships>\n"
)


def threemf_bytes(mesh: Mesh, title: str, metadata: Mapping[str, str], date: datetime) -> bytes:
    """3MF with unit, title and metadata; compressed, dated `date`, the same bytes every time.

    Parameters
    ----------
    metadata : mapping
        Well-known names of the 3MF core specification (section 3.4.1), such as Description and Application.
    date : datetime
        From 1980 to 2107.
    """
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for path, text in (
            ("[Content_Types].xml", _CONTENT_TYPES.encode("ascii")),
            ("_rels/.rels", _RELATIONSHIPS.encode("ascii")),
            ("3D/3dmodel.model", _model_xml(mesh, title, metadata)),
        ):
            entry = zipfile.ZipInfo(path, date.timetuple()[:6])
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, text)
    return stream.getvalue()


def _model_xml(mesh: Mesh, title: str, metadata: Mapping[str, str]) -> bytes:
    head = [
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<model unit="millimeter" xml:lang="en-US" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">\n'
    ]
    for name, value in {"Title": title, **metadata}.items():
        head.append(f'<metadata name="{escape(name)}">{escape(value, quote=False)}</metadata>\n')
    head.append(f'<resources>\n<object id="1" type="model" name="{escape(title)}">\n<mesh>\n<vertices>\n')
    vertices = '<vertex x="%.6f" y="%.6f" z="%.6f"/>\n' * len(mesh.vertices_mm) % tuple(mesh.vertices_mm.ravel().tolist())
    faces = '<triangle v1="%d" v2="%d" v3="%d"/>\n' * len(mesh.faces) % tuple(mesh.faces.ravel().tolist())
    tail = '</triangles>\n</mesh>\n</object>\n</resources>\n<build>\n<item objectid="1"/>\n</build>\n</model>\n'
    return "".join([*head, vertices, "</vertices>\n<triangles>\n", faces, tail]).encode("utf-8")
