"""Checks of solid models without a CAD kernel: STL measured and decoded, 3MF compared with it, STEP as text."""

from __future__ import annotations

import io
import re
import warnings
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from math import pi

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import named, shown_path
from tactape_fab.base.input_file import read_member
from tactape_fab.solids.elements import closed_element, element_volume_mm3
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.stl import MeshError, mesh_problems, stl_problems
from tactape_fab.solids.mesh.triangles import THREEMF_MODEL, THREEMF_PARTS, Mesh
from tactape_fab.solids.volume import solid_volume_mm3
from tactape_fab.solids.wrap import unwrapped
from tactape_fab.texture.cpl import CplContent
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.models.back_mark import check_mark
from tactape_fab.verify.models.base_shape import check_base
from tactape_fab.verify.models.raised import cells_of, find_raised
from tactape_fab.verify.models.step_text import shell_problems, step_problems
from tactape_fab.verify.symbols import check_symbols

PLACE_TOLERANCE_MM = 0.001
STL_PLACE_TOLERANCE_MM = 0.005
"""Place tolerance in an STL, whose coordinates have 24 bits of mantissa, and in which a dome's rings are polygons."""
_CHORD_TOLERANCE_MM = 0.002
_DOME_CHORDS = 1.05
"""Factor on the volume that chords may cut off a dome if its base is curved, as its foot is then not a circle."""
_MOST_MODEL_BYTES = 2 << 30
_TEXT_PER_TRIANGLE = 300
_POINT = re.compile(rb"=CARTESIAN_POINT\('',\(([^()]{5,200})\)\)")
_MOST_PART_BYTES = 10_000
_THREEMF_HEAD = re.compile(
    rb'<\?xml version="1\.0" encoding="UTF-8"\?>\n<model unit="millimeter" xml:lang="en-US" '
    rb'xmlns="http://schemas\.microsoft\.com/3dmanufacturing/core/2015/02">\n'
    rb'(?:<metadata name="[^<>"]{0,2000}">[^<>]{0,100000}</metadata>\n){0,100}'
    rb'<resources>\n<object id="1" type="model" name="[^<>"]{0,2000}">\n<mesh>\n'
)
_ZIP_START, _ZIP_END, _ZIP_END_BYTES = b"PK\3\4", b"PK\5\6", 22
_THREEMF_TAIL = b'</mesh>\n</object>\n</resources>\n<build>\n<item objectid="1"/>\n</build>\n</model>\n'
_DECIMAL = rb"-?\d{1,9}\.\d{6}"
_THREEMF_VERTEX = re.compile(rb'<vertex x="%b" y="%b" z="%b"/>\n' % ((_DECIMAL,) * 3))
_THREEMF_TRIANGLE = re.compile(rb'<triangle v1="\d{1,9}" v2="\d{1,9}" v3="\d{1,9}"/>\n')
_LETTERS = bytes(byte if byte in b"-0123456789" else ord(" ") for byte in range(256))
"""Table of `bytes.translate` that leaves only digits and signs."""
_LONGEST_NAME = 13
_FURTHEST = 1e9
_VERTEX = re.compile(rb"=VERTEX_POINT\('',#(\d{1,12})\)")
_AXES = re.compile(rb"#(\d{1,12})=AXIS2_PLACEMENT_3D\('',#(\d{1,12}),")
_ROUND = re.compile(rb"=(?:SPHERICAL|CONICAL)_SURFACE\('',#(\d{1,12}),")
_OCCURRENCE = re.compile(
    rb"CARTESIAN_POINT\('',\(\s*(-?\d+\.\d*),\s*(-?\d+\.\d*),\s*(-?\d+\.\d*)\)\);\s*#\d+=AXIS2_PLACEMENT_3D[^;]*;"
    rb"\s*#\d+=ITEM_DEFINED_TRANSFORMATION[^;]*;\s*#\d+=\(REPRESENTATION_RELATIONSHIP[^;]*;"
    rb"\s*#\d+=NEXT_ASSEMBLY_USAGE_OCCURRENCE\('([^']*)','([^']*)'"
)


def check_models(
    tape: Tape, form: SolidForm, files: Mapping[str, WrittenFile], mesh: Mesh, cpl: CplContent | None
) -> list[Check]:
    """Check every model of a kit that numpy can read; `mesh` is that of its STL."""
    checks = [
        _check_mesh(tape, form, mesh, stl_problems(files["stl"].data)),
        *_check_elements(tape, form, mesh),
        check_base(tape, form, mesh),
    ]
    if form.mark:
        checks.append(check_mark(tape, form, mesh))
    checks.append(check_threemf(files["3mf"].data, mesh))
    checks.append(_check_solid_text(tape, form, files["step-solid"].data))
    if "step-assembly" in files:
        checks.append(_check_assembly_text(tape, files["step-assembly"].data, cpl))
    return checks


def _check_mesh(tape: Tape, form: SolidForm, mesh: Mesh, file_problems: Sequence[str]) -> Check:
    problems = [*file_problems, *mesh_problems(mesh)]
    volume, expected = mesh.volume_mm3, solid_volume_mm3(tape, form)
    if abs(volume - expected) > mesh_volume_tolerance_mm3(tape, form):
        problems.append(f"its volume is {volume:.3f} mm3, not {expected:.3f}")
    message = "; ".join(problems) or f"watertight, one body of {len(mesh.faces)} triangles, {volume:.3f} mm3"
    return Check(name="stl", passed=not problems, message=message, figure=volume, unit="mm3")


def mesh_volume_tolerance_mm3(tape: Tape, form: SolidForm) -> float:
    """Allowed difference between the volumes of a mesh and its solid, mm^3, as chords cut off a little of every curve."""
    dome = 0.0
    if tape.part.shape == "dome":
        # volume of one dome as meshed on a plane, without the part below its foot
        vertices, faces = closed_element(tape.part, 0.0)
        chords = element_volume_mm3(tape.part) - Mesh(vertices_mm=vertices, faces=faces).volume_mm3
        dome = _DOME_CHORDS * tape.part_count * chords
    width, height = tape.board.size_mm
    # walls of outline and holes may be off by a chord's sagitta over their whole area
    deep_mm = form.base_mm + (tape.part.body_mm[2] if form.negative else 0.0)
    curved_mm2 = (2 * (width + height) + sum(pi * d for _, _, d in tape.board.holes)) * deep_mm
    if form.cylinder is not None:
        along, across = (width, height) if form.cylinder.around == "x" else (height, width)
        back_mm = form.cylinder.radius_mm + (form.base_mm + tape.part.body_mm[2] if form.negative else 0.0)
        length = form.cylinder.circumference_mm if form.cylinder.shell == "whole" else along
        # both sides have the same cuts, so that area and sagitta grow with the radius
        curved_mm2 = length * across * max(back_mm / form.cylinder.radius_mm, 1.0) ** 2
    return dome + 1e-5 * solid_volume_mm3(tape, form) + _CHORD_TOLERANCE_MM * curved_mm2


def _check_elements(tape: Tape, form: SolidForm, mesh: Mesh) -> list[Check]:
    raised = find_raised(tape, form, mesh.vertices_mm)
    problems, figure = _place_problems(tape, raised.cells, raised.centres_mm, STL_PLACE_TOLERANCE_MM)
    if len(raised.strays_mm):
        x, y = raised.strays_mm[0]
        problems.append(f"{len(raised.strays_mm)} raised vertices off the grid, first at ({x:.3f}, {y:.3f}) mm")
    if raised.shape_error_mm > STL_PLACE_TOLERANCE_MM:
        problems.append(f"elements differ from the manifest's shape by {raised.shape_error_mm * 1000:.1f} um")
    message = (
        "; ".join(problems) or f"shape and middle of every element within {max(figure, raised.shape_error_mm * 1000):.2f} um"
    )
    places = Check(name="stl places", passed=not problems, message=message, figure=figure, unit="um")
    return [places, *check_symbols(tape, raised.centres_mm, "STL")]


def _place_problems(tape: Tape, cells: IntArray, centres_mm: FloatArray, tolerance_mm: float) -> tuple[list[str], float]:
    """Problems of the element centres found in cells, and the largest distance from a nominal centre, um."""
    # row * columns + column, as `cells_of` numbers them
    grid = tape.cells() @ (1, tape.columns)
    order = np.argsort(grid, kind="stable")
    if not np.array_equal(np.sort(cells), grid[order]):
        lost, extra = len(np.setdiff1d(grid, cells)), len(np.setdiff1d(cells, grid))
        return [f"{len(cells)} elements where the manifest has {len(grid)}: {lost} are missing, {extra} too many"], 0.0
    off = np.hypot(*(centres_mm[np.argsort(cells, kind="stable")] - tape.part_xy_mm()[order]).T)
    worst = int(np.argmax(off))
    figure = float(off[worst] * 1000)
    if off[worst] <= tolerance_mm:
        return [], figure
    x, y = tape.part_xy_mm()[order][worst]
    many = int((off > tolerance_mm).sum())
    return [f"{many} elements are misplaced, worst by {figure:.1f} um at ({x:.3f}, {y:.3f}) mm"], figure


def read_threemf(data: bytes, most_bytes: int = _MOST_MODEL_BYTES) -> Mesh:
    """The single mesh of a 3MF file, in mm. Raises MeshError for another file, or if it has more than `most_bytes` unpacked."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            *parts, model = archive.infolist() or [zipfile.ZipInfo()]
            if [part.filename for part in (*parts, model)] != [*THREEMF_PARTS, THREEMF_MODEL]:
                raise MeshError("it is no 3MF package of one model")
            # the relationships define which member is the model
            if any(read_member(archive, part, _MOST_PART_BYTES) != THREEMF_PARTS[part.filename] for part in parts):
                raise MeshError("its package is not written as usual")
            # readers may search for the archive from either end
            if not data.startswith(_ZIP_START) or data[-_ZIP_END_BYTES:].find(_ZIP_END) != 0:
                raise MeshError("other bytes stand before or behind its package")
            text = read_member(archive, model, most_bytes)
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError, ValueError, NotImplementedError) as error:
        raise MeshError(f"it cannot be unpacked: {error}") from error
    # in this tool's form: one object, placed once, without components or transforms, and without comments or
    # tags in another form that another reader might take for the model
    head, _, rest = text.partition(b"<vertices>\n")
    points, _, rest = rest.partition(b"</vertices>\n<triangles>\n")
    corners, _, tail = rest.partition(b"</triangles>\n")
    if _THREEMF_HEAD.fullmatch(head) is None or tail != _THREEMF_TAIL:
        in_mm = b' unit="millimeter"' in head
        raise MeshError("it does not build one object where it stands" if in_mm else "its unit is not the millimetre")
    if _THREEMF_VERTEX.sub(b"", points) or _THREEMF_TRIANGLE.sub(b"", corners):
        raise MeshError("a vertex or triangle of it is not written as usual")
    # millionths are read as whole numbers, in a third of the time; the quotient is the float nearest to the decimal all the same
    vertices = np.fromstring(points.translate(_LETTERS, b"."), dtype=np.int64, sep=" ").reshape(-1, 3) / 1e6
    # each corner's number stands behind the 1, 2 or 3 of its name
    faces = np.fromstring(corners.translate(_LETTERS), dtype=np.int64, sep=" ").reshape(-1, 6)[:, 1::2]
    if len(vertices) == 0 or len(faces) == 0 or faces.max() >= len(vertices):
        raise MeshError("its triangles name vertices that it does not have")
    return Mesh(vertices_mm=vertices, faces=faces)


def check_threemf(data: bytes, stl: Mesh) -> Check:
    """Check that a 3MF file holds the mesh of the STL."""
    try:
        mesh = read_threemf(data, 1_000_000 + _TEXT_PER_TRIANGLE * len(stl.faces))
    except MeshError as error:
        return Check(name="3mf", passed=False, message=str(error))
    # six decimals in the 3MF, 24 bits of mantissa in the STL: the rounding of both, with a margin
    tolerance = 2e-6 + 2.0**-23 * float(np.abs(stl.vertices_mm).max())
    alike = mesh.faces.shape == stl.faces.shape
    error_mm = float(np.abs(mesh.corners_mm - stl.corners_mm).max()) if alike else 0.0
    passed = alike and error_mm <= tolerance
    if not alike:
        message = f"its {len(mesh.faces)} triangles are not the STL's {len(stl.faces)}"
    else:
        message = f"{'the mesh of the STL, within' if passed else 'a corner is off the STL by'} {error_mm * 1e6:.1f} nm"
    return Check(name="3mf", passed=passed, message=message, figure=error_mm * 1e6, unit="nm")


def _anchors(tape: Tape, data: bytes) -> FloatArray:
    """Points in a STEP text that give the elements' places: corners of blocks, centres of spheres and cones, mm; (n, 3).

    Raises ValueError if a referenced entity is not a point.
    """
    # by entity name, as vertices and placements refer to points in any order
    points = {_name_before(data, found.start()): found[1] for found in _POINT.finditer(data)}
    if tape.part.shape == "block":
        # corners of the base are included; they are not raised, and are dropped later
        wanted = _VERTEX.findall(data)
    else:
        axes = dict(_AXES.findall(data))
        wanted = [axes[name] for name in _ROUND.findall(data) if name in axes]
    # joined and split as a whole, as a list of texts per point takes twice as long
    return _numbers(b",".join(points[name] for name in wanted if name in points).split(b","))


def _name_before(data: bytes, end: int) -> bytes:
    """Digits of the entity name that ends at `end`, searched backwards, as references look like names."""
    return data[data.rfind(b"#", max(end - _LONGEST_NAME, 0), end) + 1 : end]


def _numbers(flat: Sequence[bytes]) -> FloatArray:
    """Rows of three numbers; shape (n, 3). Raises ValueError if a value is not a number, or a row does not have three."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # numpy's warning for text after the last number
        try:
            numbers = np.fromstring(b" ".join(flat), sep=" ")
        except DeprecationWarning as warning:
            raise ValueError(str(warning)) from warning
    # a value such as "1 2" would give two numbers, and shift all following ones
    if len(numbers) != len(flat):
        raise ValueError(f"{len(numbers)} numbers where there are {len(flat)}")
    if numbers.size and not np.abs(numbers).max() <= _FURTHEST:  # true for NaN as well
        raise ValueError("a number that is none, or far beyond any part")
    return numbers.reshape(-1, 3)


def _text_place_problems(tape: Tape, form: SolidForm, data: bytes) -> list[str]:
    """Problems of elements of a STEP solid, and of corners of blocks, that are not at the manifest's places."""
    try:
        anchors = _anchors(tape, data)
    except ValueError:
        return ["it holds points that are none"]
    if tape.part.shape == "block":
        raised = find_raised(tape, form, anchors)
        problems, _ = _place_problems(tape, raised.cells, raised.centres_mm, PLACE_TOLERANCE_MM)
        if raised.shape_error_mm > PLACE_TOLERANCE_MM:
            problems.append(f"elements differ from the manifest's shape by {raised.shape_error_mm * 1000:.1f} um")
        return problems
    xy = unwrapped(anchors, tape, form)[:, :2]
    cells, inside = cells_of(tape, xy)
    if not inside.all():
        return [f"{int((~inside).sum())} elements are off the grid"]
    return _place_problems(tape, cells, xy, PLACE_TOLERANCE_MM)[0]


def _check_solid_text(tape: Tape, form: SolidForm, data: bytes) -> Check:
    problems = step_problems(data)
    solids, shells = data.count(b"=MANIFOLD_SOLID_BREP("), data.count(b"=CLOSED_SHELL(")
    of_element = 5 if tape.part.shape == "block" else 1 if tape.part.top_mm is None else 2
    faces, own = data.count(b"=ADVANCED_FACE("), tape.part_count * of_element
    if (solids, shells) != (1, 1):
        problems.append(f"{solids} solids of {shells} shells instead of one")
    # a base has at least a top, a back and a wall
    if faces < own + 3:
        problems.append(f"{faces} faces, fewer than the {own} of {tape.part_count} elements and a base")
    if not problems:
        problems = [*_text_place_problems(tape, form, data), *shell_problems(data)]
    what = "upper corners" if tape.part.shape == "block" else "centres"
    right = f"one solid of {faces} faces, {own} of them elements', whose {what} are in place; not compared in its text: all else"
    message = "; ".join(problems) or right
    return Check(name="step-solid", passed=not problems, message=message, figure=float(faces))


def _check_assembly_text(tape: Tape, data: bytes, cpl: CplContent | None) -> Check:
    problems = step_problems(data) or [*shell_problems(data)]
    found = _OCCURRENCE.findall(data)
    names = [shown_path(name.decode("ascii", "replace")) for *_, name, _ in found]
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
        # the pattern admits only digits, sign and point, so that the conversion cannot fail
        written = np.array([row[:3] for row in found], dtype="S").astype(np.float64)
        off = np.hypot(*(written[:, :2] - np.array([places[name] for name in names])).T) + np.abs(written[:, 2])
        error_mm = float(off.max())
        if error_mm > PLACE_TOLERANCE_MM:
            problems.append(f"{names[int(off.argmax())]} is {error_mm * 1000:.1f} um off its CPL row")
    right = f"{len(names)} occurrences named and placed as in the CPL, within {error_mm * 1e6:.0f} nm"
    message = "; ".join(problems) or f"{right}; not compared in its text: shapes of board and part"
    return Check(name="step-assembly", passed=not problems, message=message, figure=error_mm * 1000, unit="um")
