"""The mesh of a solid: closed, one body, in the right place; STL and 3MF; what is refused before and after."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from dataclasses import replace
from datetime import datetime, timezone
from math import pi
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from tactape_fab.solids.elements import CHORD_ERROR_MM, block_corners_mm, closed_element, dome_points, element_rings_mm, reach_mm
from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.stl import MeshError, body_count, mesh_problems, read_stl, stl_problems
from tactape_fab.solids.mesh.triangles import THREEMF_PARTS, Mesh, stl_bytes, threemf_bytes
from tactape_fab.solids.rise import foot_loop_mm, foot_radius_mm, wrapped_volume_mm3
from tactape_fab.solids.volume import solid_volume_mm3
from tactape_fab.solids.wrap import unwrapped, world, wrap_of
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.models.base_shape import check_base
from tactape_fab.verify.models.meshes import mesh_volume_tolerance_mm3, read_threemf
from tactape_fab.verify.models.raised import find_raised
from tests.solids import BLOCK, CONE, DATE, DOME, FORMS, PARTS, element_volume_mm3, tape_of, volume_mm3
from tests.unit.solids.step.test_step_text import STRANGE
from tests.unit.solids.step.test_tiles import HOLES

VARIANTS = [pytest.param(part, form, id=f"{p} {f}") for p, part in PARTS.items() for f, form in FORMS.items()]


def checked(tape: Tape, form: SolidForm) -> Mesh:
    """The mesh as it stands in an STL file: closed, as large as it should be, every element where it should be."""
    mesh = texture_mesh(tape, form)
    assert mesh_problems(mesh) == []
    written = stl_bytes(mesh, "t")
    read = read_stl(written)
    assert mesh_problems(read) == [] and stl_problems(written) == []
    assert len(read.faces) == len(mesh.faces)
    for m in (mesh, read):
        assert abs(m.volume_mm3 - volume_mm3(tape, form)) <= mesh_volume_tolerance_mm3(tape, form)
    base = check_base(tape, form, read)
    assert base.passed, base.message
    found = find_raised(tape, form, read.vertices_mm)
    centres, strays = found.centres_mm, found.strays_mm
    order = np.argsort(tape.cells() @ (1, tape.columns))
    assert len(strays) == 0
    assert np.abs(centres - tape.part_xy_mm()[order]).max() < 0.004
    height = unwrapped(mesh.vertices_mm, tape, form)[:, 2]
    top = tape.part.body_mm[2] + (form.base_mm if form.negative else 0.0)
    flat = 0.0 if form.cylinder is None else 0.06 / form.cylinder.radius_mm  # flat tops stand on a tangent plane
    assert top - 1e-9 < height.max() < top + flat + 1e-9
    assert height.min() == pytest.approx(0.0 if form.negative else -form.base_mm, abs=1e-9)
    return mesh


@pytest.mark.parametrize(("part", "form"), VARIANTS)
def test_every_variant_is_watertight_one_body_and_in_place(part: Any, form: SolidForm) -> None:
    checked(tape_of(part, 7, 5, omitted=[(0, 0), (6, 4), (3, 3)]), form)


@pytest.mark.parametrize(("tape", "form", "_genus"), STRANGE.values(), ids=STRANGE)
def test_strange_tapes_are_watertight_too(tape: Tape, form: SolidForm, _genus: int) -> None:
    checked(tape, form)


@pytest.mark.parametrize("holes", HOLES.values(), ids=HOLES)
@pytest.mark.parametrize("part", [BLOCK, DOME], ids=["block", "dome"])
def test_holes_may_lie_anywhere(holes: list[tuple[float, float, float]], part: Any) -> None:
    checked(tape_of(part, 13, 13, holes_mm=holes), SolidForm())


@pytest.mark.parametrize("off_mm", [-0.0011, -0.001, -0.0005, -1e-6, 0.0, 1e-6, 0.0005, 0.001, 0.0011])
def test_a_hole_may_touch_the_border_of_a_cell(off_mm: float) -> None:
    tape = tape_of(BLOCK, 8, 8)
    x0, y0 = tape.board.texture_origin_mm
    checked(tape_of(BLOCK, 8, 8, holes_mm=[(x0 + 3.5 * 1.5 + 0.5 + off_mm, y0 - 3.5 * 1.5 - 0.5 - off_mm, 1.0)]), SolidForm())


@pytest.mark.parametrize("short_mm", [0.0, 1e-6, 1e-5, 1e-4, 0.001])
def test_a_side_between_two_corners_may_be_short(short_mm: float) -> None:
    tape = tape_of(BLOCK, 13, 8)
    checked(tape_of(BLOCK, 13, 8, radius_mm=round(min(tape.board.size_mm) / 2 - short_mm, 6)), SolidForm())


@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
@pytest.mark.parametrize("negative", [False, True])
@pytest.mark.parametrize("around", ["x", "y"])
def test_a_thick_whole_shell_round_a_small_tape_is_no_error(part: Any, negative: bool, around: Any) -> None:
    """Its chords cut off more than the tape's own area has."""
    form = SolidForm(base_mm=10.0, negative=negative, cylinder=Cylinder(radius_mm=50.0, around=around, shell="whole"))
    checked(tape_of(part, 4, 4), form)


def test_a_mesh_costs_few_triangles() -> None:
    tape = tape_of(BLOCK, 40, 30)
    assert len(texture_mesh(tape, SolidForm()).faces) / tape.part_count < 20


# A mould and its texture


def test_a_mould_is_the_complement_turned_about_board_y() -> None:
    tape = tape_of(BLOCK, 4, 4, omitted=[(1, 2)])
    texture, mould = (texture_mesh(tape, SolidForm(negative=negative)) for negative in (False, True))
    up = {tuple(v) for v in np.round(texture.vertices_mm[texture.vertices_mm[:, 2] > 0.1], 9).tolist()}
    turned = mould.vertices_mm * (-1.0, 1.0, -1.0)
    cavity = {tuple(v) for v in np.round(turned[np.abs(turned[:, 2] - 0.23) < 1e-9], 9).tolist()}
    assert up == cavity
    assert len(up) == 4 * 15
    low, high = mould.vertices_mm.min(axis=0), mould.vertices_mm.max(axis=0)
    assert low.tolist() == pytest.approx([-tape.board.size_mm[0], 0.0, -1.03])
    assert high.tolist() == pytest.approx([0.0, tape.board.size_mm[1], 0.0])
    (w, h), r = tape.board.size_mm, tape.board.corner_radius_mm
    assert texture.volume_mm3 + mould.volume_mm3 == pytest.approx((w * h - (4 - pi) * r * r) * (0.8 + 0.23 + 0.8), rel=1e-4)


# Round a cylinder


@pytest.mark.parametrize("around", ["x", "y"])
@pytest.mark.parametrize("negative", [False, True])
def test_a_wrapped_point_comes_back(around: Any, negative: bool) -> None:
    tape = tape_of(BLOCK, 8, 7)
    form = SolidForm(negative=negative, cylinder=Cylinder(radius_mm=9.0, around=around))
    assert form.cylinder is not None
    wrap = wrap_of(tape, form, form.cylinder)
    points = np.random.default_rng(0).uniform((0.1, 0.1), np.array(tape.board.size_mm) - 0.1, (200, 2))
    height = np.random.default_rng(1).uniform(-1, 1, 200)
    ab = points @ wrap.from_board.T
    placed = wrap.point(wrap.angle_rad(ab[:, 0]), ab[:, 1], wrap.radius_mm + height)
    back = unwrapped(placed, tape, form)
    assert np.abs(back - np.column_stack([points, height])).max() < 1e-12
    frames = wrap.frames(wrap.angle_rad(ab[:, 0]))
    assert np.allclose(np.linalg.det(frames), 1.0)
    assert np.allclose(frames @ frames.transpose(0, 2, 1), np.eye(3))


@pytest.mark.parametrize(("around", "axis"), [("x", 0), ("y", 1)])
def test_the_middle_line_stays_and_the_axis_lies_below(around: Any, axis: int) -> None:
    tape = tape_of(BLOCK, 8, 7)
    form = SolidForm(cylinder=Cylinder(radius_mm=9.0, around=around))
    mesh = texture_mesh(tape, form)
    middle = tape.board.size_mm[axis] / 2
    distance = np.hypot(mesh.vertices_mm[:, axis] - middle, mesh.vertices_mm[:, 2] + 9.0)
    assert distance.min() == pytest.approx(9.0 - 0.8)
    assert distance.max() == pytest.approx(9.23, abs=0.02)
    other = mesh.vertices_mm[:, 1 - axis]
    assert (other.min(), other.max()) == pytest.approx((0.0, tape.board.size_mm[1 - axis]))
    # board x and y keep their sense
    ends = unwrapped(mesh.vertices_mm, tape, form)[:, axis]
    assert np.sign(np.corrcoef(ends, mesh.vertices_mm[:, axis])[0, 1]) == 1.0


def test_world_of_a_mould_is_a_half_turn() -> None:
    assert world(SolidForm(negative=True)).tolist() == np.diag((-1.0, 1.0, -1.0)).tolist()
    assert np.linalg.det(world(SolidForm(negative=True))) == 1.0


@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
@pytest.mark.parametrize("radius_mm", [3.0, 6.0, 16.0, 50.0, 1000.0])
@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 45.0, 90.0, 137.0])
def test_the_volume_on_a_cylinder_agrees_with_sums(part: Any, radius_mm: float, turn_deg: float) -> None:
    assert wrapped_volume_mm3(part, radius_mm, turn_deg) == pytest.approx(element_volume_mm3(part, radius_mm, turn_deg), rel=2e-6)


@pytest.mark.parametrize("part", [DOME, CONE, replace(DOME, body_mm=(0.6, 0.6, 0.29))], ids=["dome", "cone", "high dome"])
@pytest.mark.parametrize("radius_mm", [5.0, 16.0, 50.0])
def test_a_foot_lies_on_dome_and_cylinder(part: Any, radius_mm: float) -> None:
    t, b, r = foot_loop_mm(part, radius_mm, 360).T
    assert np.abs(np.hypot(t, r) - radius_mm).max() < 1e-12
    z, across = r - radius_mm, np.hypot(t, b)
    if part.top_mm is None:
        sphere = (0.3**2 + part.body_mm[2] ** 2) / 2 / part.body_mm[2]
        assert np.abs(np.hypot(across, z - part.body_mm[2] + sphere) - sphere).max() < 1e-12
    else:
        assert np.abs(z - (0.3 - across) * 0.23 / 0.15).max() < 1e-12
    assert foot_radius_mm(part, radius_mm, np.array([pi / 2])) == pytest.approx(0.3)


@pytest.mark.parametrize(("part", "form"), VARIANTS)
def test_the_volume_formula_agrees_with_another(part: Any, form: SolidForm) -> None:
    tape = tape_of(part, 8, 7, omitted=[(0, 0)])
    assert solid_volume_mm3(tape, form) == pytest.approx(volume_mm3(tape, form), rel=2e-8)


# Elements


def test_rings_of_elements() -> None:
    assert element_rings_mm(BLOCK).shape == (2, 4, 3)
    dome, cone = element_rings_mm(DOME), element_rings_mm(CONE)
    sphere = (0.3**2 + 0.23**2) / 2 / 0.23
    assert np.linalg.norm(dome - (0, 0, 0.23 - sphere), axis=2) == pytest.approx(np.full(dome.shape[:2], sphere))
    assert np.hypot(cone[1, :, 0], cone[1, :, 1]) == pytest.approx(np.full(dome_points(CONE), 0.15))
    assert reach_mm(DOME) == (0.3, 0.3)
    assert reach_mm(replace(BLOCK, rotation_deg=90.0)) == pytest.approx((0.15, 0.3))
    corners = block_corners_mm(replace(BLOCK, rotation_deg=90.0))
    assert corners[0].tolist() == pytest.approx([0.15, -0.3])


@pytest.mark.parametrize("body_mm", [(0.3, 0.3, 0.1), (0.6, 0.6, 0.23), (0.6, 0.6, 0.3), (3.0, 3.0, 1.0), (20.0, 20.0, 4.0)])
def test_chords_stay_near_the_sphere(body_mm: tuple[float, float, float]) -> None:
    """The middle of a chord is what is farthest from its circle; twice as many points would be more than the error asks for."""
    part = replace(DOME, body_mm=body_mm)
    rings = element_rings_mm(part)
    sphere_mm = (body_mm[0] ** 2 / 4 + body_mm[2] ** 2) / 2 / body_mm[2]
    along = (rings + np.roll(rings, 1, axis=1)) / 2
    out = np.hypot(rings[..., 0], rings[..., 1]) - np.hypot(along[..., 0], along[..., 1])
    top = np.array([0.0, 0.0, body_mm[2]])
    upward = (rings + np.concatenate([rings[1:], np.broadcast_to(top, rings[:1].shape)])) / 2
    down = sphere_mm - np.linalg.norm(upward - (0.0, 0.0, body_mm[2] - sphere_mm), axis=2)
    for error_mm in (out, down):
        assert error_mm.max() <= CHORD_ERROR_MM
    if body_mm[0] > 1.0:
        assert min(out.max(), down.max()) > CHORD_ERROR_MM / 2


@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
def test_an_element_alone_is_a_closed_body(part: Any) -> None:
    vertices, faces = closed_element(part, 0.1)
    mesh = Mesh(vertices_mm=vertices, faces=faces)
    assert mesh_problems(mesh) == []
    assert (vertices[:, 2].min(), vertices[:, 2].max()) == pytest.approx((-0.1, 0.23))
    foot = 0.18 * 0.1 if part.shape == "block" else pi * 0.09 * 0.1
    assert mesh.volume_mm3 == pytest.approx(element_volume_mm3(part, None, 0.0) + foot, rel=0.08)


# STL


def cube() -> Mesh:
    v = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Mesh(vertices_mm=v, faces=np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))


def test_stl_is_what_its_description_says() -> None:
    data = stl_bytes(cube(), "title")
    assert len(data) == 84 + 50 * 12
    assert data[:80].rstrip() == b"binary STL, mm: title"
    assert not data.startswith(b"solid")
    assert struct.unpack_from("<I", data, 80) == (12,)
    for k in range(12):
        normal, a, b, c = np.reshape(struct.unpack_from("<12f", data, 84 + 50 * k), (4, 3))
        assert np.cross(b - a, c - a) == pytest.approx(normal)
        assert struct.unpack_from("<H", data, 84 + 50 * k + 48) == (0,)
    assert len(stl_bytes(cube(), "é" * 200)) == len(data)


def test_stl_comes_back() -> None:
    read = read_stl(stl_bytes(cube(), "t"))
    assert mesh_problems(read) == []
    assert read.volume_mm3 == pytest.approx(1.0)
    assert np.array_equal(read.corners_mm, cube().corners_mm)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "0 bytes are too few"),
        (b"x" * 83, "83 bytes"),
        (b"\0" * 84, "announces 0 triangles"),
        (b"solid t\nfacet normal 0 0 1\n" * 20 + b"endsolid t\n", "do not fit"),
        (b"\0" * 80 + b"\xff\xff\xff\xff", "announces 4294967295 triangles"),
        (stl_bytes(cube(), "t")[:-1], "do not fit"),
        (stl_bytes(cube(), "t") + b"\0", "do not fit"),
        (stl_bytes(cube(), "t")[:96] + b"\0\0\xc0\x7f" + stl_bytes(cube(), "t")[100:], "not finite numbers"),
        (stl_bytes(cube(), "t")[:96] + b"\0\0\x80\x7f" + stl_bytes(cube(), "t")[100:], "not finite numbers"),
    ],
)
def test_what_is_no_stl_is_refused(data: bytes, says: str) -> None:
    with pytest.raises(MeshError, match=says):
        read_stl(data)


def joined(a: Mesh, b: Mesh) -> Mesh:
    return Mesh(vertices_mm=np.vstack([a.vertices_mm, b.vertices_mm]), faces=np.vstack([a.faces, b.faces + len(a.vertices_mm)]))


@pytest.mark.parametrize(
    ("mesh", "says"),
    [
        (Mesh(vertices_mm=cube().vertices_mm, faces=cube().faces[1:]), "3 edges without a second triangle"),
        (Mesh(vertices_mm=cube().vertices_mm, faces=cube().faces[:, ::-1]), "face inward"),
        (Mesh(vertices_mm=cube().vertices_mm, faces=np.vstack([cube().faces[:1, ::-1], cube().faces[1:]])), "face opposite"),
        (Mesh(vertices_mm=cube().vertices_mm, faces=np.vstack([cube().faces, [[0, 2, 5]]])), "more than two"),
        (Mesh(vertices_mm=cube().vertices_mm, faces=np.vstack([cube().faces, [[0, 0, 1]]])), "1 triangles without area"),
        (joined(cube(), Mesh(vertices_mm=cube().vertices_mm + 5, faces=cube().faces)), "2 bodies"),
    ],
)
def test_what_is_no_closed_body_is_said(mesh: Mesh, says: str) -> None:
    assert says in "; ".join(mesh_problems(mesh))


def test_bodies_are_counted_through_long_chains() -> None:
    count = 5000
    strip = np.column_stack([np.arange(count), np.arange(count) + 1, np.arange(count) + 2])
    faces = np.vstack([np.random.default_rng(0).permutation(strip), strip[::-1] + count + 2])
    mesh = Mesh(vertices_mm=np.zeros((2 * count + 4, 3)), faces=faces)
    assert body_count(mesh) == 2


# 3MF


def package(text: bytes, name: str = "3D/3dmodel.model", parts: dict[str, bytes] = THREEMF_PARTS) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for part, content in {**parts, name: text}.items():
            archive.writestr(part, content)
    return stream.getvalue()


def model(vertices: bytes = b"", triangles: bytes = b"") -> bytes:
    """The model of a package with these in its one mesh."""
    text = model_text(threemf_bytes(cube(), "t", {}, DATE))
    rows = rb"(?s)(<vertices>\n).*(</vertices>\n<triangles>\n).*(</triangles>)"
    return re.sub(rows, lambda m: m[1] + vertices + m[2] + triangles + m[3], text)


def model_text(data: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return archive.read("3D/3dmodel.model")


def test_3mf_is_packed_at_its_own_level() -> None:
    """Python has no public name for the level of an entry before 3.13: the bytes tell whether it was heard."""
    data = threemf_bytes(cube(), "t", {}, DATE)
    text = model_text(data)
    packed = {level: zlib.compressobj(level, zlib.DEFLATED, -15) for level in (4, zlib.Z_DEFAULT_COMPRESSION)}
    own, usual = (one.compress(text) + one.flush() for one in packed.values())
    assert own in data
    assert usual not in data


def test_3mf_is_a_package_of_one_object_in_millimetres() -> None:
    metadata = {"Description": "a < b & 'c'", "Application": "us"}
    data = threemf_bytes(cube(), 'a "title"', metadata, DATE)
    assert data == threemf_bytes(cube(), 'a "title"', metadata, DATE)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == ["[Content_Types].xml", "_rels/.rels", "3D/3dmodel.model"]
        assert {entry.date_time for entry in archive.infolist()} == {(2026, 1, 1, 0, 0, 0)}
        relations = ElementTree.fromstring(archive.read("_rels/.rels"))
        types = ElementTree.fromstring(archive.read("[Content_Types].xml"))
    assert relations[0].get("Target") == "/3D/3dmodel.model"
    assert {row.get("Extension") for row in types} == {"rels", "model"}
    core = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    model = ElementTree.fromstring(model_text(data))
    assert (model.tag, model.get("unit")) == (f"{core}model", "millimeter")
    assert {row.get("name"): row.text for row in model.iter(f"{core}metadata")} == {"Title": 'a "title"', **metadata}
    assert len(list(model.iter(f"{core}object"))) == len(list(model.iter(f"{core}item"))) == 1
    vertices = [[float(v.attrib[k]) for k in "xyz"] for v in model.iter(f"{core}vertex")]
    triangles = [[int(t.attrib[k]) for k in ("v1", "v2", "v3")] for t in model.iter(f"{core}triangle")]
    assert (vertices, triangles) == (cube().vertices_mm.tolist(), cube().faces.tolist())


def test_3mf_comes_back() -> None:
    read = read_threemf(threemf_bytes(cube(), "t", {}, DATE))
    assert np.array_equal(read.corners_mm, cube().corners_mm)


def test_only_the_date_differs_between_days() -> None:
    one, other = (threemf_bytes(cube(), "t", {}, datetime(1980, 1, day, tzinfo=timezone.utc)) for day in (1, 2))
    assert one != other
    assert model_text(one) == model_text(other)


POINT, FACE = b'<vertex x="1.000000" y="%b.000000" z="%b.000000"/>\n', b'<triangle v1="0" v2="%b" v3="%b"/>\n'


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "cannot be unpacked"),
        (b"PK\x03\x04" + b"\xff" * 500, "cannot be unpacked"),
        (threemf_bytes(cube(), "t", {}, DATE)[:-30], "cannot be unpacked"),
        (package(b"", "3D/3dmodel.txt"), "no 3MF package"),
        (package(b""), "not the millimetre"),
        (package(b'<model unit="inch">'), "not the millimetre"),
        (package(model()), "does not have"),
        (package(model(POINT % (b"2", b"q"), FACE % (b"0", b"0"))), "is not written as usual"),
        (package(model(POINT % (b"2", b"nan"), FACE % (b"0", b"0"))), "is not written as usual"),
        (package(model(POINT % (b"2", b"3"), FACE % (b"0", b"1"))), "does not have"),
        (package(model(POINT % (b"2", b"3"), FACE % (b"0", b"9" * 31))), "it"),
        (package(model(POINT % (b"2", b"3") + b"<vertex\tx='1'/>\n", FACE % (b"0", b"0"))), "is not written as usual"),
        (package(model(), parts=dict(reversed(THREEMF_PARTS.items()))), "no 3MF package"),
        (
            package(model(), parts={**THREEMF_PARTS, "_rels/.rels": THREEMF_PARTS["_rels/.rels"].replace(b"3d", b"4d")}),
            "as usual",
        ),
        (package(b"<?xml version='1.0'?><!--" + model()[38:] + b"--><model\tunit='inch'/>"), "does not build one object"),
        (package(model().replace(b'type="model"', b'type="support"')), "does not build one object"),
        (package(b'<model unit="millimeter"><vertex x="1" y="2" z="3"/>'), "does not build one object"),
    ],
)
def test_what_is_no_3mf_is_refused(data: bytes, says: str) -> None:
    with pytest.raises(MeshError, match=says):
        read_threemf(data)


def test_a_package_that_announces_too_much_is_refused_unread() -> None:
    data = bytearray(threemf_bytes(cube(), "t", {}, DATE))
    entry = data.rindex(b"PK\x01\x02")
    struct.pack_into("<I", data, entry + 24, 0xF0000000)
    with pytest.raises(MeshError, match="the zip announces"):
        read_threemf(bytes(data))


def test_vertices_that_readers_join_are_a_fault() -> None:
    cut = cube()
    near = cut.vertices_mm[cut.faces[0, 0]] + (2e-7, 0.0, 0.0)
    a, b, c = cut.faces[0]
    new = len(cut.vertices_mm)
    mate = next(face for face in cut.faces[1:] if {a, b} <= set(face.tolist()))
    d = next(v for v in mate.tolist() if v not in (a, b))
    faces = [face for face in cut.faces.tolist() if face not in (cut.faces[0].tolist(), mate.tolist())]
    faces += [[a, new, c], [new, b, c], [b, new, d], [new, a, d]]
    mesh = Mesh(vertices_mm=np.vstack([cut.vertices_mm, near]), faces=np.array(faces))
    assert [problem.split(" edges")[1] for problem in mesh_problems(mesh)] == [
        " shorter than 1e-06 mm, whose ends other readers join"
    ]
