"""Solid models read back without a CAD kernel: STL measured and decoded, 3MF against it, STEP as text."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Mapping

import numpy as np

from tactape_fab.errors import Check
from tactape_fab.kit.readback import CplContent
from tactape_fab.solids.elements import element_volume_mm3
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh import Mesh
from tactape_fab.solids.readmesh import MeshError, mesh_problems, read_stl
from tactape_fab.solids.rise import solid_volume_mm3
from tactape_fab.solids.wrap import unwrapped
from tactape_fab.texture.frames import FloatArray, board_to_texture
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile, named
from tactape_fab.verify.symbols import check_symbols

PLACE_TOLERANCE_MM = 0.001
STL_PLACE_TOLERANCE_MM = 0.005
"""Coordinates of an STL have 24 bits, and a dome's rings are polygons."""
_CHORD_TOLERANCE_MM = 0.002
_DOME_VOLUME_TOLERANCE = 0.06
_MOST_MODEL_BYTES = 2 << 30
_OCCURRENCE = re.compile(
    rb"CARTESIAN_POINT\('',\(\s*(-?[\d.]+),\s*(-?[\d.]+),\s*(-?[\d.]+)\)\);\s*#\d+=AXIS2_PLACEMENT_3D[^;]*;"
    rb"\s*#\d+=ITEM_DEFINED_TRANSFORMATION[^;]*;\s*#\d+=\(REPRESENTATION_RELATIONSHIP[^;]*;"
    rb"\s*#\d+=NEXT_ASSEMBLY_USAGE_OCCURRENCE\('([^']*)','([^']*)'"
)


def check_models(tape: Tape, form: SolidForm, files: Mapping[str, WrittenFile], cpl: CplContent | None) -> list[Check]:
    """Every model of a kit, as far as numpy can read it."""
    try:
        mesh = read_stl(files["stl"].data)
    except MeshError as error:
        return [Check(name="stl", passed=False, message=f"{files['stl'].path}: {error}")]
    checks = [_check_mesh(tape, form, mesh), *_check_elements(tape, form, mesh)]
    checks.append(check_threemf(files["3mf"].data, mesh))
    checks.append(_check_solid_text(tape, files["step-solid"].data))
    if "step-assembly" in files:
        checks.append(_check_assembly_text(tape, files["step-assembly"].data, cpl))
    return checks


def _check_mesh(tape: Tape, form: SolidForm, mesh: Mesh) -> Check:
    problems = mesh_problems(mesh)
    volume, expected = mesh.volume_mm3, solid_volume_mm3(tape, form)
    if abs(volume - expected) > mesh_volume_tolerance_mm3(tape, form):
        problems.append(f"its volume is {volume:.3f} mm3, not {expected:.3f}")
    message = "; ".join(problems) or f"watertight, one body of {len(mesh.faces)} triangles, {volume:.3f} mm3"
    return Check(name="stl", passed=not problems, message=message, figure=volume, unit="mm3")


def mesh_volume_tolerance_mm3(tape: Tape, form: SolidForm) -> float:
    """How far a mesh's volume may be from the solid's: its chords cut off a little of every curve."""
    dome = tape.part_count * element_volume_mm3(tape.part) * _DOME_VOLUME_TOLERANCE if tape.part.shape == "dome" else 0.0
    width, height = tape.board.size_mm
    curved_mm2 = width * height if form.cylinder is not None else 2 * (width + height) * form.base_mm
    return dome + 1e-5 * solid_volume_mm3(tape, form) + _CHORD_TOLERANCE_MM * curved_mm2


def element_centres(tape: Tape, form: SolidForm, mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    """Where elements stand, from a solid's mesh alone.

    Vertices well above the base (below it, in a mould) are gathered by the grid cell they lie in; the middle of
    those of one cell is its element's centre.

    Returns
    -------
    centres_mm : ndarray, shape (k, 2)
        Board frame; on a cylinder along the arc at z = 0.
    strays_mm : ndarray, shape (m, 2)
        Raised vertices that lie in no cell.
    """
    points = unwrapped(mesh.vertices_mm, tape, form)
    height = tape.part.body_mm[2]
    raised = points[:, 2] > 0.6 * height
    if form.negative:
        raised &= points[:, 2] < height + form.base_mm / 2
    xy = points[raised, :2]
    cell = np.rint(board_to_texture(xy, tape.board.texture_origin_mm) / tape.pitch_mm).astype(np.int64)
    inside = ((cell >= 0) & (cell < (tape.columns, tape.rows))).all(axis=1)
    key = cell[inside, 1] * tape.columns + cell[inside, 0]
    low, high = np.full((tape.rows * tape.columns, 2), np.inf), np.full((tape.rows * tape.columns, 2), -np.inf)
    np.minimum.at(low, key, xy[inside])
    np.maximum.at(high, key, xy[inside])
    there = np.isfinite(low[:, 0])
    return (low[there] + high[there]) / 2, xy[~inside]


def _check_elements(tape: Tape, form: SolidForm, mesh: Mesh) -> list[Check]:
    centres, strays = element_centres(tape, form, mesh)
    checks = check_symbols(tape, centres, "STL")
    expected = tape.part_xy_mm()
    problems = []
    if len(strays):
        problems.append(f"{len(strays)} raised vertices off the grid, first at ({strays[0, 0]:.3f}, {strays[0, 1]:.3f}) mm")
    if len(centres) != len(expected):
        problems.append(f"{len(centres)} elements where the manifest has {len(expected)}")
        figure = None
    else:
        order = np.argsort(tape.cells() @ (1, tape.columns), kind="stable")
        off = np.hypot(*(centres - expected[order]).T)
        worst = int(np.argmax(off))
        figure = float(off[worst] * 1000)
        if off[worst] > STL_PLACE_TOLERANCE_MM:
            x, y = centres[worst]
            problems.append(
                f"{int((off > STL_PLACE_TOLERANCE_MM).sum())} elements are misplaced, worst by {figure:.1f} um "
                f"at ({x:.3f}, {y:.3f}) mm"
            )
    message = "; ".join(problems) or f"centre of every element within {figure:.2f} um"
    return [Check(name="stl places", passed=not problems, message=message, figure=figure, unit="um"), *checks]


def read_threemf(data: bytes) -> Mesh:
    """The one mesh of a 3MF file, in mm.

    Raises
    ------
    MeshError
        When it is no such file.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = [entry.filename for entry in archive.infolist()]
            models = [entry for entry in archive.infolist() if entry.filename.endswith(".model")]
            if len(models) != 1 or "[Content_Types].xml" not in names or "_rels/.rels" not in names:
                raise MeshError("it is no 3MF package of one model")
            if sum(entry.file_size for entry in archive.infolist()) > _MOST_MODEL_BYTES:
                raise MeshError(f"it unpacks to more than {_MOST_MODEL_BYTES} bytes")
            text = archive.read(models[0])
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError, ValueError, NotImplementedError) as error:
        raise MeshError(f"it cannot be unpacked: {error}") from error
    if not re.search(rb'<model\b[^>]*\bunit="millimeter"', text):
        raise MeshError("its unit is not the millimetre")
    try:
        vertices = np.array(re.findall(rb'<vertex x="([^"]+)" y="([^"]+)" z="([^"]+)"', text), dtype="S").astype(np.float64)
        faces = np.array(re.findall(rb'<triangle v1="(\d+)" v2="(\d+)" v3="(\d+)"', text), dtype="S").astype(np.int64)
    except (ValueError, OverflowError) as error:
        raise MeshError(f"it holds what is no number: {error}") from error
    if len(vertices) == 0 or len(faces) == 0 or faces.max() >= len(vertices) or not np.isfinite(vertices).all():
        raise MeshError("its triangles name vertices that it does not have")
    return Mesh(vertices_mm=vertices, faces=faces)


def check_threemf(data: bytes, stl: Mesh) -> Check:
    """A 3MF file holds the mesh of the STL."""
    try:
        mesh = read_threemf(data)
    except MeshError as error:
        return Check(name="3mf", passed=False, message=str(error))
    tolerance = 2e-6 + 2.0**-23 * float(np.abs(stl.vertices_mm).max())
    alike = mesh.faces.shape == stl.faces.shape
    error_mm = float(np.abs(mesh.corners_mm - stl.corners_mm).max()) if alike else 0.0
    passed = alike and error_mm <= tolerance
    message = (
        f"the mesh of the STL, within {error_mm * 1e6:.1f} nm"
        if passed
        else f"its {len(mesh.faces)} triangles are not the STL's {len(stl.faces)}"
    )
    return Check(name="3mf", passed=passed, message=message, figure=error_mm * 1e6, unit="nm")


def _step_problems(data: bytes) -> list[str]:
    whole = data.startswith(b"ISO-10303-21;") and data.rstrip().endswith(b"END-ISO-10303-21;")
    problems = [] if whole else ["it is no whole ISO 10303-21 file"]
    if b".MILLI.,.METRE." not in data:
        problems.append("its unit is not the millimetre")
    return problems


def faces_of_elements(tape: Tape) -> int:
    """Faces that the elements of a solid have."""
    return tape.part_count * (5 if tape.part.shape == "block" else 1 if tape.part.top_mm is None else 2)


def _check_solid_text(tape: Tape, data: bytes) -> Check:
    problems = _step_problems(data)
    solids, shells = data.count(b"=MANIFOLD_SOLID_BREP("), data.count(b"=CLOSED_SHELL(")
    faces, own = data.count(b"=ADVANCED_FACE("), faces_of_elements(tape)
    if (solids, shells) != (1, 1):
        problems.append(f"{solids} solids of {shells} shells instead of one")
    if faces < own + 3:
        problems.append(f"{faces} faces, fewer than the {own} of {tape.part_count} elements and a base")
    message = "; ".join(problems) or f"one solid of {faces} faces, {own} of them elements'"
    return Check(name="step-solid", passed=not problems, message=message, figure=float(faces))


def _check_assembly_text(tape: Tape, data: bytes, cpl: CplContent | None) -> Check:
    problems = _step_problems(data)
    found = _OCCURRENCE.findall(data)
    names = [name.decode("ascii", "replace") for *_, name, _ in found]
    designators = list(cpl.designators) if cpl is not None else tape.designators()
    xy = cpl.xy_mm if cpl is not None else tape.part_xy_mm()
    error_mm = 0.0
    if any(a != b for *_, a, b in found):
        problems.append("an occurrence has two names")
    if sorted(names) != sorted(designators):
        odd = sorted(set(names) ^ set(designators))
        problems.append(f"{len(names)} occurrences where the CPL has {len(designators)}: {named(odd) or 'a name occurs twice'}")
    else:
        places = dict(zip(designators, xy, strict=True))
        written = np.array([row[:3] for row in found], dtype="S").astype(np.float64)
        off = np.hypot(*(written[:, :2] - np.array([places[name] for name in names])).T) + np.abs(written[:, 2])
        error_mm = float(off.max())
        if error_mm > PLACE_TOLERANCE_MM:
            problems.append(f"{names[int(off.argmax())]} is {error_mm * 1000:.1f} um off its CPL row")
    message = "; ".join(problems) or f"{len(names)} occurrences named and placed as in the CPL, within {error_mm * 1e6:.0f} nm"
    return Check(name="step-assembly", passed=not problems, message=message, figure=error_mm * 1000, unit="um")
