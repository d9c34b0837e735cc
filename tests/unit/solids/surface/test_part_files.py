"""Reading of the user's mesh: every format read, every fault named, nothing written, no other file opened."""

from __future__ import annotations

import io
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from tactape_fab import Tape
from tactape_fab.base.errors import SpecError
from tactape_fab.make.emboss import emboss_kit
from tactape_fab.solids.mesh.triangles import Mesh, threemf_bytes
from tactape_fab.solids.surface import part_files
from tactape_fab.solids.surface.charts import Placement
from tactape_fab.solids.surface.nested import wrong_shells
from tactape_fab.solids.surface.part_files import closed_mesh, read_surface_mesh, self_intersections
from tactape_fab.texture.frames import FloatArray
from tests.attacks import nested_tetrahedra, stl
from tests.surfaces import ball, box, cylinder, emboss, kit_folder, mesh_of, planned, saddle, stl_of
from tests.thorough import slow


@pytest.fixture(scope="module")
def tape() -> Tape:
    return planned()


@pytest.fixture
def kit(tmp_path: Path, tape: Tape) -> Path:
    return kit_folder(tmp_path / "kit", tape)


def test_element_larger_than_its_cell_is_refused(kit: Path, tape: Tape, tmp_path: Path) -> None:
    fat = replace(tape, part=replace(tape.part, body_mm=(1.2, 0.8, 0.3)))
    with pytest.raises(
        SpecError, match=r"reaches 0\.957 mm from its grid point, displaced, and its cell only 0\.750 mm; make the kit"
    ):
        emboss(kit_folder(tmp_path / "fat", fat), box())


def crossing_boxes() -> Any:
    other = box(10, 10, 10)
    other.apply_translation((3, 4, 5))
    return trimesh.util.concatenate([box(10, 10, 10), other])


def open_box() -> Any:
    model = box()
    return trimesh.Trimesh(model.vertices, model.faces[2:], process=False)


def turned_face() -> Any:
    model = box()
    return trimesh.Trimesh(model.vertices, np.vstack([model.faces[:1, ::-1], model.faces[1:]]), process=False)


def scaled(factor: float) -> Any:
    model = box()
    model.apply_scale(factor)
    return model


def not_finite() -> bytes:
    data = stl_of(box())
    return data[:96] + np.float32("nan").tobytes() + data[100:]


def entities() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("3D/3dmodel.model", '<!DOCTYPE m [<!ENTITY a "b">]><model>&a;</model>')
    return stream.getvalue()


def with_another(size_mm: float, z_mm: float, *, turned: bool = False) -> Any:
    other = box(size_mm, size_mm, 1.0).apply_translation((0.0, 0.0, z_mm))
    if turned:
        other.invert()
    return trimesh.util.concatenate([box(), other])


BAD = [
    ("no.stl", b"", {}, "holds no triangles that can be read as STL"),
    ("cut.stl", stl_of(box())[:-20], {}, "holds no triangles that can be read as STL"),
    ("rubbish.ply", b"ply\nformat ascii 1.0\n", {}, "cannot be read as PLY"),
    ("wrong.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 9\n", {}, "cannot be read as OBJ"),
    ("rubbish.3mf", b"PK\x03\x04", {}, "cannot be read as 3MF"),
    ("entities.3mf", entities(), {}, "declares XML entities"),
    ("part.dxf", b"0", {}, r"is none of: stl, 3mf, obj, ply, step, stp"),
    ("open.stl", open_box(), {}, r"not watertight: 4 of its 17 edges are open; repair it"),
    ("turned.stl", turned_face(), {}, r"triangles that face opposite ways: 3 edges"),
    ("crossing.stl", crossing_boxes(), {}, r"cuts itself: \d+ pairs of triangles cross or cover each other, first near \("),
    ("nan.stl", not_finite(), {}, r"vertices whose coordinates are not finite numbers"),
    ("metres.stl", scaled(0.001), {}, r"is 0.03 x 0.03 x 0.005 mm, smaller than 1 mm; the file was read in mm; .* use --unit m"),
    (
        "small.stl",
        scaled(0.07),
        {},
        r"smaller than the texture of 10.5 x 10.5 mm; the file was read in mm; .* --unit cm or m or inch",
    ),
    ("huge.stl", scaled(1000.0), {}, r"is 3e\+04 x 3e\+04 x 5000 mm, larger than 5000 mm"),
    ("box.stl", box(), {"unit": "furlong"}, "unit = 'furlong' is none of: mm, cm, m, inch"),
    ("box.3mf", b"", {"unit": "cm"}, "a 3MF file says its unit itself"),
    (
        "box.stl",
        box(),
        {"placement": Placement(at_mm=(0, 0, 9))},
        r"at = 0,0,9 lies 6.500 mm from the surface.* nearest .* is 0,0,2.5",
    ),
    ("box.stl", box(), {"placement": Placement(at_mm=(0, 0, float("nan")))}, r"is no point; give X,Y,Z in mm"),
    ("box.stl", box(), {"placement": Placement(up=(0, 0, 1))}, r"up = 0,0,1 is parallel to the surface's normal"),
    ("box.stl", box(), {"placement": Placement(up=(0, 0, 0))}, r"up = 0,0,0 is no direction"),
    ("box.stl", box(), {"placement": Placement(face=2)}, r"face = 2 is one of a STEP solid, and .* is a mesh"),
    ("box.stl", box(9, 9), {}, "runs off the surface"),
    ("inside.stl", with_another(10.0, 0.0), {}, r"face the wrong way: 1, the first round \(0.00, 0.00, 0.00\) mm"),
    ("flush.stl", with_another(10.0, -2.0), {}, r"face the wrong way: 1, the first round \(0.00, 0.00, -2.00\) mm"),
    ("turned-body.stl", with_another(10.0, -9.0, turned=True), {}, "face the wrong way: 1"),
    ("far.stl", box().apply_translation((0, 20_000.0, 0)), {}, r"reaches 20015 mm from its origin, more than 16384 mm.* move it"),
]


@pytest.mark.parametrize(("name", "model", "options", "message"), BAD, ids=[f"{row[0]}-{i}" for i, row in enumerate(BAD)])
def test_bad_input_is_named_and_nothing_written(kit: Path, name: str, model: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecError, match=message):
        emboss(kit, model, name, **options)
    assert sorted(path.name for path in kit.parent.iterdir()) == sorted(["kit", name])


def test_missing_files_are_refused(kit: Path, tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=r"SURFACE = .*none\.stl cannot be read: No such file"):
        emboss_kit(kit, tmp_path / "none.stl")
    with pytest.raises(SpecError, match="is no kit"):
        emboss_kit(tmp_path / "none", tmp_path / "none.stl")


# Files


def test_obj_opens_no_other_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.mtl").write_text("newmtl a\nmap_Kd /etc/passwd\n")
    data = b"mtllib evil.mtl\nusemtl a\n" + box().export(file_type="obj").encode()
    monkeypatch.setattr(Path, "open", lambda *_, **__: pytest.fail("a file is opened"))
    monkeypatch.setattr("builtins.open", lambda *_, **__: pytest.fail("a file is opened"))
    assert len(read_surface_mesh(data, "obj").faces) == 12


@pytest.mark.parametrize("kind", ["stl", "obj", "ply"])
def test_every_mesh_format_gives_the_same_solid(kind: str) -> None:
    data = saddle().export(file_type=kind)
    mesh = closed_mesh(read_surface_mesh(data.encode() if isinstance(data, str) else data, kind))
    assert mesh.volume_mm3 == pytest.approx(3600.0, rel=1e-5)
    assert len(mesh.faces) == len(saddle().faces)


def test_3mf_units_components_and_transforms() -> None:
    mesh = mesh_of(box(2, 3, 4))
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in mesh.vertices_mm)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces)
    xml = (
        '<model unit="centimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        f'<object id="1"><mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh></object>'
        '<object id="2"><components><component objectid="1" transform="0 1 0 -1 0 0 0 0 1 10 0 0"/></components></object>'
        '</resources><build><item objectid="2" transform="1 0 0 0 1 0 0 0 -1 0 0 5"/></build></model>'
    )
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("3D/3dmodel.model", xml)
    read = closed_mesh(read_surface_mesh(stream.getvalue(), "3mf"))
    # turned by 90 degrees about z, moved by 10 along x, then mirrored in z and moved by 5 along z; in cm
    assert read.vertices_mm.min(axis=0) == pytest.approx((85.0, -10.0, 30.0))
    assert read.vertices_mm.max(axis=0) == pytest.approx((115.0, 10.0, 70.0))
    assert read.volume_mm3 == pytest.approx(24_000.0)
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("3D/3dmodel.model", xml.replace('<object id="1"', '<object id="1" type="support"'))
    with pytest.raises(SpecError, match="object of type 'support', which is no solid"):
        read_surface_mesh(stream.getvalue(), "3mf")


def test_3mf_that_places_itself_is_refused() -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(
            "3D/3dmodel.model",
            '<model><resources><object id="1"><components><component objectid="1"/><component objectid="1"/></components>'
            "</object>"
            '</resources><build><item objectid="1"/></build></model>',
        )
    with pytest.raises(SpecError, match="nests them too deep"):
        read_surface_mesh(stream.getvalue(), "3mf")


@slow
def test_touching_triangles_do_not_cross() -> None:
    for model in (ball(25.0, 3), saddle(), cylinder(), box()):
        assert self_intersections(mesh_of(model))[0] == 0
    assert self_intersections(read_surface_mesh(stl_of(crossing_boxes()), "stl"))[0] > 0


def test_a_hollow_and_a_body_beside_or_in_the_hollow_are_no_fault(kit: Path) -> None:
    # volumes by hand: 30 x 30 x 5 less the hollow, and with a body apart
    hollow = with_another(10.0, 0.0, turned=True)
    assert closed_mesh(mesh_of(hollow)).volume_mm3 == pytest.approx(4400.0)
    assert closed_mesh(mesh_of(with_another(10.0, -9.0))).volume_mm3 == pytest.approx(4600.0)
    rattle = trimesh.util.concatenate([hollow, box(2.0, 2.0, 0.5)])
    assert closed_mesh(mesh_of(rattle)).volume_mm3 == pytest.approx(4402.0)
    assert emboss(kit, hollow).surface["source_volume_mm3"] == pytest.approx(4400.0)


@slow
def test_thousands_of_shells_are_looked_at_in_seconds() -> None:
    small = [box(1.0, 1.0, 1.0).apply_translation((2.0 * i, 2.0 * k, 0.0)) for i in range(60) for k in range(50)]
    model = trimesh.util.concatenate([*small, box(500.0, 500.0, 20.0)])
    mesh = Mesh(vertices_mm=np.asarray(model.vertices), faces=np.asarray(model.faces))
    started = time.process_time()
    assert wrong_shells(mesh)[0] == 3000
    assert time.process_time() - started < 5.0


def test_rounding_is_welded_and_an_inside_out_mesh_turned() -> None:
    model = ball(25.0, 3)
    corners = np.asarray(model.triangles).reshape(-1, 3)
    shaken = corners + np.random.default_rng(1).uniform(-1e-6, 1e-6, corners.shape)
    loose = trimesh.Trimesh(shaken, np.arange(len(corners)).reshape(-1, 3)[:, ::-1], process=False)
    mesh = closed_mesh(read_surface_mesh(loose.export(file_type="ply"), "ply"))
    assert len(mesh.faces) == len(model.faces)
    assert mesh.volume_mm3 == pytest.approx(model.volume, rel=1e-4)


def test_own_3mf_is_read_back() -> None:
    from tactape_fab.base.build_date import zip_date

    mesh = mesh_of(ball(25.0, 3))
    read = closed_mesh(read_surface_mesh(threemf_bytes(mesh, "t", {}, zip_date()), "3mf"))
    assert read.volume_mm3 == pytest.approx(mesh.volume_mm3, rel=1e-6)


def test_units_scale_the_part(kit: Path) -> None:
    made = emboss(kit, scaled(0.1), unit="cm")
    assert made.surface["unit"] == "cm"
    assert made.surface["source_volume_mm3"] == pytest.approx(4500, rel=1e-5)


FLAT = np.array([(-30, -30, 0), (30, -30, 0), (30, 30, 0), (-30, 30, 0)], dtype=np.float64)


@pytest.mark.parametrize(
    ("corners", "why"),
    [
        (np.zeros((12, 3, 3)), "no triangle with three corners apart"),
        (np.full((12, 3, 3), 1e6), "no triangle with three corners apart"),
        (np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0]]] * 12), "watertight|simple solid"),
        (FLAT[[[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 3, 2]]], "no volume|simple solid"),
        (box(60.0, 60.0, 5.0).triangles * (1, 1, 0), "no volume|simple solid|opposite ways"),
    ],
    ids=["points", "points far away", "lines", "a sheet of two sides", "a flattened box"],
)
def test_a_mesh_without_area_or_volume_is_refused(corners: FloatArray, why: str) -> None:
    with pytest.raises(SpecError, match=why):
        closed_mesh(read_surface_mesh(stl(corners), "stl"))


def test_triangles_without_area_beside_others_do_no_harm() -> None:
    sound = box(60.0, 60.0, 5.0).triangles
    sliver = np.concatenate([sound, np.repeat(sound[:1, :1], 3, axis=1), sound[:1, [0, 1, 0]]])
    mesh = closed_mesh(read_surface_mesh(stl(sliver), "stl"))
    assert len(mesh.faces) == 12
    assert mesh.volume_mm3 == pytest.approx(18_000.0)


def test_thousands_of_open_corners_in_one_place_are_refused() -> None:
    random = np.random.default_rng(3)
    corners = np.concatenate([random.normal(0.0, 1e-7, (2000, 3, 3)), [[(0, 0, 0), (1, 0, 0), (0, 1, 0)]]])
    with pytest.raises(SpecError, match="open edges within"):
        read_surface_mesh(stl(corners), "stl")


def test_nested_shells_are_refused_before_all_their_pairs_are_looked_at() -> None:
    mesh = read_surface_mesh(nested_tetrahedra(3000), "stl")
    started = time.process_time()
    with pytest.raises(SpecError, match="pairs of triangles in one place"):
        self_intersections(mesh)
    assert time.process_time() - started < 5.0


@pytest.mark.parametrize("first", range(8))
def test_a_polygon_that_is_not_convex_is_no_fan(first: int) -> None:
    u = np.roll([(0, 0), (120, 0), (120, 90), (90, 90), (90, 30), (30, 30), (30, 90), (0, 90)], -first, axis=0)
    corners = "".join(f"v {x} {y} {z}\n" for z in (0, 10) for x, y in u)
    sides = "".join(f"f {k + 1} {(k + 1) % 8 + 1} {(k + 1) % 8 + 9} {k + 9}\n" for k in range(8))
    text = f"{corners}{sides}f 8 7 6 5 4 3 2 1\nf 9 10 11 12 13 14 15 16\n"
    with pytest.raises(SpecError, match="cover each other"):
        closed_mesh(read_surface_mesh(text.encode(), "obj"))


@slow
def test_fine_level_faces_are_searched_from_above(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part_files, "_MOST_BOXES", 0)  # as for a mesh so fine that those for each triangle decide
    plate = saddle(points=151)
    plate.vertices[:, 2] = np.repeat((0.0, -20.0), 151**2)
    assert self_intersections(read_surface_mesh(stl_of(plate), "stl"))[0] == 0


def test_triangles_that_vanish_beside_the_size_of_the_part_are_refused() -> None:
    corners = [(0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1e9)]  # found by fuzzing: welding leaves no triangle
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\nf 2 1 4\n"
    with pytest.raises(SpecError, match="no triangle with three corners apart"):
        read_surface_mesh(text.encode(), "obj")
