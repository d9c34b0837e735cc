"""A body's geometry as OBJ, USD text and glTF, in metres."""

from __future__ import annotations

import json
import re
import struct
from typing import Any

import numpy as np

from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.sim.body import Body, Box
from tactape_fab.solids.sim.description import Colour, frame_quaternion, numbers, quaternion
from tactape_fab.solids.wrap import wrap_of
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape

_M = 1e-3
_SHEET_COLUMNS = 180


def obj(mesh: Mesh, uv: FloatArray | None = None, material_file: str | None = None) -> bytes:
    """Wavefront OBJ, z up, in m with a resolution of a tenth of a micrometre; without normals, so that faces are flat."""
    head = "" if material_file is None else f"mtllib {material_file}\nusemtl look\n"
    points = "v %.7f %.7f %.7f\n" * len(mesh.vertices_mm) % tuple((_M * mesh.vertices_mm + 0.0).ravel().tolist())
    one = mesh.faces + 1
    if uv is None:
        return f"{head}{points}{_faces('f %d %d %d', one)}".encode("ascii")
    places = "vt %.6f %.6f\n" * len(uv) % tuple(uv.ravel().tolist())
    return f"{head}{points}{places}{_faces('f %d/%d %d/%d %d/%d', np.repeat(one, 2, axis=1))}".encode("ascii")


def _faces(form: str, indices: IntArray) -> str:
    return (form + "\n") * len(indices) % tuple(indices.ravel().tolist())


def mtl(colour_file: str | None, rgb: Colour) -> bytes:
    """The material of an OBJ file."""
    lines = ["newmtl look", f"Kd {numbers((1, 1, 1) if colour_file else rgb)}", "Ks 0.05 0.05 0.05", "Ns 20"]
    return ("\n".join([*lines, *([f"map_Kd {colour_file}"] if colour_file else [])]) + "\n").encode("ascii")


# USD as text: the binary format needs usd-core, and the bytes of a kit must not depend on installed libraries


def usda(body: Body, colour_file: str | None, rgb: Colour) -> bytes:
    """USD with UsdPhysics (rigid body, mass, collision) and a UsdPreviewSurface; z up, m."""
    name = re.sub(r"\W", "_", body.name)
    name = name if re.match(r"[A-Za-z_]", name) else f"_{name}"
    values, vectors = np.linalg.eigh(body.inertia)
    # eigenvectors may be left-handed, which a quaternion cannot represent
    vectors[:, 2] *= np.sign(np.linalg.det(vectors))
    faces, points = body.mesh.faces, _M * body.mesh.vertices_mm
    collides = "" if body.hull is None else ', "PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"'
    lines = [
        "#usda 1.0",
        "(",
        f'    defaultPrim = "{name}"',
        "    metersPerUnit = 1",
        '    upAxis = "Z"',
        ")",
        f'def Xform "{name}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])',
        "{",
        f"    float physics:mass = {body.mass:.9g}",
        f"    point3f physics:centerOfMass = {_tuple(body.centre)}",
        f"    float3 physics:diagonalInertia = {_tuple(values)}",
        # the matrix's columns are the principal axes in the body's frame; USD has the real part first
        f"    quatf physics:principalAxes = {_tuple(matrix_quaternion(vectors))}",
        f'    def Mesh "visual" (prepend apiSchemas = ["MaterialBindingAPI"{collides}])',
        "    {",
        '        uniform token subdivisionScheme = "none"',
        *([] if body.hull is None else ['        uniform token physics:approximation = "convexHull"']),
        f"        float3[] extent = [{_tuple(points.min(axis=0))}, {_tuple(points.max(axis=0))}]",
        f"        int[] faceVertexCounts = [{', '.join(['3'] * len(faces))}]",
        f"        int[] faceVertexIndices = [{', '.join(map(str, faces.ravel().tolist()))}]",
        f"        point3f[] points = [{_tuples('(%.7f, %.7f, %.7f)', points + 0.0)}]",
    ]
    if body.uv is not None:
        lines += [
            f"        texCoord2f[] primvars:st = [{_tuples('(%.6f, %.6f)', body.uv)}] (",
            '            interpolation = "vertex"',
            "        )",
        ]
    lines += [f"        rel material:binding = </{name}/look>", "    }", *_material(name, colour_file, rgb)]
    for k, box in enumerate(body.boxes):
        lines += _collision(f"collision{k}", box)
    for frame in body.frames:
        lines += [
            f'    def Xform "{frame.name}"',
            "    {",
            f"        double3 xformOp:translate = {_tuple(frame.origin)}",
            f"        quatf xformOp:orient = {_tuple(frame_quaternion(frame))}",
            '        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]',
            "    }",
        ]
    return ("\n".join([*lines, "}"]) + "\n").encode("ascii")


def matrix_quaternion(rotation: FloatArray) -> FloatArray:
    """A rotation matrix as a quaternion, w first and non-negative: an eigenvector of Bar-Itzhack's matrix (2000)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    k = np.array(
        [
            (xx - yy - zz, yx + xy, zx + xz, zy - yz),
            (yx + xy, yy - xx - zz, zy + yz, xz - zx),
            (zx + xz, zy + yz, zz - xx - yy, yx - xy),
            (zy - yz, xz - zx, yx - xy, xx + yy + zz),
        ]
    )
    # three times Bar-Itzhack's matrix; the eigenvector of its largest eigenvalue is the nearest rotation
    x, y, z, w = np.linalg.eigh(k)[1][:, -1].tolist()
    return np.array([w, x, y, z]) * (1.0 if w >= 0 else -1.0)


def _material(name: str, colour_file: str | None, rgb: Colour) -> list[str]:
    path = f"/{name}/look"
    diffuse = f"color3f inputs:diffuseColor = {_tuple(rgb)}"
    extra = []
    if colour_file is not None:
        diffuse = f"color3f inputs:diffuseColor.connect = <{path}/colour.outputs:rgb>"
        extra = [
            '        def Shader "place"',
            "        {",
            '            uniform token info:id = "UsdPrimvarReader_float2"',
            '            string inputs:varname = "st"',
            "            float2 outputs:result",
            "        }",
            '        def Shader "colour"',
            "        {",
            '            uniform token info:id = "UsdUVTexture"',
            f"            asset inputs:file = @./{colour_file}@",
            f"            float2 inputs:st.connect = <{path}/place.outputs:result>",
            "            float3 outputs:rgb",
            "        }",
        ]
    return [
        '    def Material "look"',
        "    {",
        f"        token outputs:surface.connect = <{path}/surface.outputs:surface>",
        '        def Shader "surface"',
        "        {",
        '            uniform token info:id = "UsdPreviewSurface"',
        f"            {diffuse}",
        "            float inputs:roughness = 0.6",
        "            token outputs:surface",
        "        }",
        *extra,
        "    }",
    ]


def _collision(name: str, box: Box) -> list[str]:
    return [
        f'    def Cube "{name}" (prepend apiSchemas = ["PhysicsCollisionAPI"])',
        "    {",
        # a cube with sides of 2, so that the scale is half the sides, as in the other formats
        "        double size = 2",
        '        uniform token purpose = "guide"',
        f"        double3 xformOp:translate = {_tuple(box.centre)}",
        f"        quatf xformOp:orient = {_tuple(quaternion(box.turn))}",
        f"        double3 xformOp:scale = {_tuple(box.half)}",
        '        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient", "xformOp:scale"]',
        "    }",
    ]


def _tuple(values: Any) -> str:
    return f"({numbers(values).replace(' ', ', ')})"


def _tuples(form: str, values: FloatArray) -> str:
    return ", ".join([form] * len(values)) % tuple(values.ravel().tolist())


# glTF: a smooth sheet with the texture as a normal map


def glb(tape: Tape, form: SolidForm | None, colour_png: bytes | None, normal_png: bytes, rgb: Colour) -> bytes:
    """A binary glTF 2.0: the surface below the elements, with colours and the relief as a normal map; y up."""
    points, normals, uv, faces = _sheet(tape, form)
    arrays = [
        # OpenGL's constants: 34962 array buffer, 34963 element array buffer, 5126 float, 5125 unsigned int
        (points.astype("<f4"), 34962, 5126, "VEC3"),
        (normals.astype("<f4"), 34962, 5126, "VEC3"),
        ((uv * (1, -1) + (0, 1)).astype("<f4"), 34962, 5126, "VEC2"),  # glTF counts v from the top
        (faces.astype("<u4").ravel(), 34963, 5125, "SCALAR"),
    ]
    chunks = [array.tobytes() for array, *_ in arrays] + [normal_png] + ([] if colour_png is None else [colour_png])
    views, at = [], 0
    for k, chunk in enumerate(chunks):
        target = {"target": arrays[k][1]} if k < len(arrays) else {}
        views.append({"buffer": 0, "byteOffset": at, "byteLength": len(chunk), **target})
        # views begin at multiples of 4 bytes, as accessors of floats require
        at += len(chunk) + -len(chunk) % 4
    accessors = [
        {"bufferView": k, "componentType": kind, "count": len(array), "type": shape}
        for k, (array, _, kind, shape) in enumerate(arrays)
    ]
    # glTF requires bounds of positions
    accessors[0] |= {"min": arrays[0][0].min(axis=0).tolist(), "max": arrays[0][0].max(axis=0).tolist()}
    look: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.6, "baseColorFactor": [*rgb, 1.0]}
    if colour_png is not None:
        look |= {"baseColorFactor": [1.0, 1.0, 1.0, 1.0], "baseColorTexture": {"index": 1}}
    content = {
        "asset": {"version": "2.0", "generator": "tactape-fab"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        # -90 deg about x, as (x, y, z, w): board z up becomes glTF's y up
        "nodes": [{"name": tape.name, "mesh": 0, "rotation": [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}]}],
        "materials": [
            {"name": "look", "pbrMetallicRoughness": look, "normalTexture": {"index": 0}, "doubleSided": True},
        ],
        "textures": [{"source": k, "sampler": 0} for k in range(len(chunks) - len(arrays))],
        # linear, also between mipmaps, clamped to the edge, so that the texture's border does not repeat
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "images": [{"bufferView": len(arrays) + k, "mimeType": "image/png"} for k in range(len(chunks) - len(arrays))],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": at}],
    }
    data = b"".join(chunk + bytes(-len(chunk) % 4) for chunk in chunks)
    text = json.dumps(content, separators=(",", ":")).encode("ascii")
    # chunks are multiples of 4 bytes: JSON is padded with spaces, binary data with zeros
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(data)
    head = struct.pack("<4sII", b"glTF", 2, total)
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\x00") + data


def _sheet(tape: Tape, form: SolidForm | None) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Points (m), normals, texture coordinates and triangles of the board's top, flat or on a cylinder."""
    wrap = None if form is None or form.cylinder is None else wrap_of(tape, form, form.cylinder)
    across = np.linspace(0.0, 1.0, 2 if wrap is None else _SHEET_COLUMNS + 1)
    a, b = (axis.ravel() for axis in np.meshgrid(across, (0.0, 1.0), indexing="ij"))
    if wrap is None:
        uv = np.column_stack([a, b])
        points = np.column_stack([uv * tape.board.size_mm, np.zeros(len(a))])
        normals = np.tile((0.0, 0.0, 1.0), (len(a), 1))
    else:
        along = wrap.b_mm[0] + b * (wrap.b_mm[1] - wrap.b_mm[0])
        angle = wrap.angle_rad(a * wrap.length_mm)
        points, normals = wrap.point(angle, along, wrap.radius_mm), wrap.frames(angle)[:, 2]
        uv = np.column_stack([a * wrap.length_mm, along]) @ wrap.from_board / tape.board.size_mm
    # points alternate between the two ends along b, with two triangles per step along a
    k = 2 * np.arange(len(across) - 1)
    faces = np.concatenate([np.stack([k, k + 2, k + 3], axis=1), np.stack([k, k + 3, k + 1], axis=1)])
    return _M * points, normals, uv, faces
