"""Every small change to a kit's 3D models is caught by `verify` and named; what needs no kernel is caught by --quick.

Sizes and SHA-256 are made to fit, so that nothing but the lines about the models can tell.
"""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.cli import main
from tactape_fab.solids.mesh.stl import read_stl
from tactape_fab.solids.mesh.triangles import STL_TRIANGLE, Mesh, stl_bytes, threemf_bytes
from tactape_fab.texture.frames import FloatArray
from tactape_fab.verify import Verification, verify_kit
from tests.roundtrip.kits import Edit, OpenKit, bytes_of, failed, replaced, text_of
from tests.solids import DATE
from tests.thorough import first, slow, thorough

Copy = Callable[[Kit], Path]

PART = 10
"""Number of the part that is changed."""
MODEL_LINES = {
    "round trip from STL",
    *("stl", "stl base", "stl mark", "stl places", "symbols from STL", "windows from STL", "3mf", "step-solid", "step-assembly"),
    *("step-solid by OCCT", "step-assembly by OCCT", "stl by trimesh", "solid"),
}


def case(name: str, edit: Edit, *fails: str, says: str = "") -> Any:
    return pytest.param(edit, fails, says, id=name)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    spec = TapeSpec(sector=100, size_mm=(20.0, 12.0), holes_mm=[(16.4, 6.0, 1.0)])
    return make_kit(spec, tmp_path_factory.mktemp("film") / "tactape-s100")


TEXTURES: dict[str, dict[str, Any]] = {
    "block": {"part": "block", "size_mm": (14.0, 12.0)},
    "mould": {"part": "block", "size_mm": (14.0, 12.0), "negative": True},
    "dome": {"part": "dome", "size_mm": (14.0, 12.0)},
    "cone round y": {"part": "cone", "size_mm": (14.0, 12.0), "cylinder_mm": 16.0, "around": "y"},
}


@pytest.fixture(scope="module")
def textures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kit]:
    folder = tmp_path_factory.mktemp("textures")
    return {name: make_kit(TapeSpec(sector=7, **values), folder / name.replace(" ", "-")) for name, values in TEXTURES.items()}


@pytest.fixture
def only_occt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Verify without FreeCAD and PrusaSlicer, for the time it takes."""
    monkeypatch.setattr("tactape_fab.base.launch.shutil.which", lambda name, path=None: None)


def judge(verification: Verification, fails: tuple[str, ...], says: str) -> None:
    lines = failed(verification)
    assert set(fails) <= set(lines)
    assert says in lines[fails[0]].message
    assert not verification.passed


# Changes


def mesh_of(change: Callable[[Mesh], Mesh]) -> Edit:
    return bytes_of("stl", lambda data: stl_bytes(change(read_stl(data)), "t"))


def near_part(kit: OpenKit, mesh: Mesh) -> tuple[Any, FloatArray]:
    """Vertices of the changed part, and its place."""
    from tactape_fab import Tape

    place = Tape.from_mapping(kit.manifest).part_xy_mm()[PART - 1]
    near = np.hypot(*(mesh.vertices_mm[:, :2] - place).T) < 0.4
    return near & (mesh.vertices_mm[:, 2] > -0.01), place


def move_block(dx_mm: float, dy_mm: float) -> Edit:
    def edit(kit: OpenKit) -> None:
        def change(mesh: Mesh) -> Mesh:
            near, _ = near_part(kit, mesh)
            assert near.any()
            return Mesh(vertices_mm=mesh.vertices_mm + np.outer(near, (dx_mm, dy_mm, 0.0)), faces=mesh.faces)

        mesh_of(change)(kit)

    return edit


def block_to_another_symbol(kit: OpenKit) -> None:
    letter = kit.manifest["symbols"][(PART - 1) // kit.manifest["columns"]][(PART - 1) % kit.manifest["columns"]]
    delta = kit.manifest["displacement_mm"]
    move_block(*{"N": (0, -2 * delta), "S": (0, 2 * delta), "W": (2 * delta, 0), "E": (-2 * delta, 0)}[letter])(kit)


def flattened(kit: OpenKit) -> None:
    """One block without height: a closed mesh still."""

    def change(mesh: Mesh) -> Mesh:
        near, _ = near_part(kit, mesh)
        vertices = mesh.vertices_mm.copy()
        vertices[near & (vertices[:, 2] > 0.1), 2] = 0.01
        return Mesh(vertices_mm=vertices, faces=mesh.faces)

    mesh_of(change)(kit)


def without_triangle(mesh: Mesh) -> Mesh:
    return Mesh(vertices_mm=mesh.vertices_mm, faces=np.delete(mesh.faces, 100, axis=0))


def flipped_triangle(mesh: Mesh) -> Mesh:
    faces = mesh.faces.copy()
    faces[100] = faces[100, ::-1]
    return Mesh(vertices_mm=mesh.vertices_mm, faces=faces)


def second_body(mesh: Mesh) -> Mesh:
    corners = np.array([(1, 1, -0.2), (2, 1, -0.2), (1, 2, -0.2), (1, 1, -0.1)], dtype=float)
    faces = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]) + len(mesh.vertices_mm)
    return Mesh(vertices_mm=np.vstack([mesh.vertices_mm, corners]), faces=np.vstack([mesh.faces, faces]))


def scaled(factor: float) -> Callable[[Mesh], Mesh]:
    return lambda mesh: Mesh(vertices_mm=mesh.vertices_mm * factor, faces=mesh.faces)


def inside_out(mesh: Mesh) -> Mesh:
    return Mesh(vertices_mm=mesh.vertices_mm, faces=mesh.faces[:, ::-1])


def ascii_stl(data: bytes) -> bytes:
    facet = "facet normal 0 0 0\nouter loop\n" + "vertex %g %g %g\n" * 3 + "endloop\nendfacet\n"
    rows = [facet % tuple(corners) for corners in read_stl(data).corners_mm.reshape(-1, 9).tolist()]
    return ("solid t\n" + "".join(rows) + "endsolid t\n").encode("ascii")


def of_both(choose: Callable[[OpenKit, FloatArray], int], by_mm: tuple[float, float, float]) -> Edit:
    """Move a vertex in the STL and in the 3MF."""

    def edit(kit: OpenKit) -> None:
        mesh = read_stl(kit.data["stl"])
        vertices = mesh.vertices_mm.copy()
        vertices[choose(kit, vertices)] += by_mm
        moved = Mesh(vertices_mm=vertices, faces=mesh.faces)
        kit.data.update({"stl": stl_bytes(moved, "t"), "3mf": threemf_bytes(moved, "t", {}, DATE)})

    return edit


def on_top(across: float, up: float) -> Callable[[OpenKit, FloatArray], int]:
    """The vertex of the base's top nearest to a place on the board, from (0, 0) to (1, 1)."""
    return lambda kit, xyz: _nearest(xyz, (across * 14.0, up * 12.0, 0.0))


def on_back(across: float, up: float) -> Callable[[OpenKit, FloatArray], int]:
    return lambda kit, xyz: _nearest(xyz, (across * 14.0, up * 12.0, -kit.manifest["solid"]["base_mm"]))


def foot(kit: OpenKit, xyz: FloatArray) -> int:
    """A corner of the changed part's foot."""
    from tactape_fab import Tape

    x, y = Tape.from_mapping(kit.manifest).part_xy_mm()[PART - 1]
    return _nearest(xyz, (x + 0.1, y + 0.3, 0.0))


def _nearest(xyz: FloatArray, to: tuple[float, float, float]) -> int:
    level = np.where(np.abs(xyz[:, 2] - to[2]) < 1e-6, 0.0, np.inf)
    return int((np.hypot(*(xyz[:, :2] - to[:2]).T) + level).argmin())


def normals(change: Callable[[FloatArray], FloatArray]) -> Callable[[bytes], bytes]:
    """Change the normals of an STL; corners stay."""

    def edit(data: bytes) -> bytes:
        triangles = np.frombuffer(data, dtype=STL_TRIANGLE, offset=84).copy()
        triangles["normal"] = change(triangles["normal"])
        return data[:84] + triangles.tobytes()

    return edit


def number_in_stl(value: float, triangle: int = 50) -> Edit:
    at = 84 + 50 * triangle + 12
    return bytes_of("stl", lambda data: data[:at] + struct.pack("<f", value) + data[at + 4 :])


def model_of(change: Callable[[str], str]) -> Edit:
    """Change the model's text inside the 3MF."""

    def repacked(data: bytes) -> bytes:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        text = members["3D/3dmodel.model"].decode("utf-8")
        members["3D/3dmodel.model"] = change(text).encode("utf-8")
        assert members["3D/3dmodel.model"].decode("utf-8") != text
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, member in members.items():
                archive.writestr(name, member)
        return stream.getvalue()

    return bytes_of("3mf", repacked)


def moved_vertex(text: str) -> str:
    first = re.search(r'<vertex x="(-?[\d.]+)"', text)
    assert first is not None
    return text.replace(first[0], f'<vertex x="{float(first[1]) + 0.01:.6f}"', 1)


def bomb(data: bytes) -> bytes:
    changed = bytearray(data)
    struct.pack_into("<I", changed, changed.rindex(b"PK\x01\x02") + 24, 0xF0000000)
    return bytes(changed)


MM = "(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))"
INCH = "(CONVERSION_BASED_UNIT('INCH',#7)LENGTH_UNIT()NAMED_UNIT(#6))"
SHOWN, USE = r"(=ADVANCED_BREP_SHAPE_REPRESENTATION\('',\(#\d+,)(#\d+)\),", r"(=ORIENTED_EDGE\('',\*,\*,)(#\d+),"


def changed(pattern: str, by: str) -> Callable[[str], str]:
    """Change the last place of a STEP file that looks so: that of an element, where there are several."""

    def edit(text: str) -> str:
        found = list(re.finditer(pattern, text))[-1]
        return text[: found.start()] + found.expand(by) + text[found.end() :]

    return edit


TWICE = ('unit="inch" unit="millimeter"', 'unit="millimeter" unit="inch"')
MOVED, SCALED = "1 0 0 0 1 0 0 0 1 5 0 0", "2 0 0 0 2 0 0 0 2 0 0 0"
QUICK: list[Any] = [
    # STL
    case("STL: a block to another symbol", block_to_another_symbol, "symbols from STL", "windows from STL", "stl places", "3mf"),
    case("STL: a block by 20 um", move_block(0.02, 0.0), "stl places", says="worst by 20.0 um"),
    case("STL: a block without height", flattened, "stl places", says="elements where the manifest has"),
    case("STL: a triangle missing", mesh_of(without_triangle), "stl", "3mf", says="3 edges without a second triangle"),
    case("STL: a triangle flipped", mesh_of(flipped_triangle), "stl", says="face opposite ways"),
    case("STL: two bodies", mesh_of(second_body), "stl", says="2 bodies"),
    case("STL: in metres", mesh_of(scaled(0.001)), "stl", says="volume"),
    case("STL: in inches", mesh_of(scaled(1 / 25.4)), "stl", says="volume"),
    case("STL: inside out", mesh_of(inside_out), "stl", says="inward"),
    case("STL: cut", bytes_of("stl", lambda b: b[: len(b) // 2]), "stl", says="do not fit"),
    case("STL: empty", bytes_of("stl", lambda b: b""), "stl", says="0 bytes"),
    case("STL: NaN", number_in_stl(float("nan")), "stl", says="not finite numbers"),
    case("STL: infinity", number_in_stl(float("-inf")), "stl", says="not finite numbers"),
    case("STL: a corner moved", number_in_stl(3.0), "stl", "3mf"),
    case("STL: a corner far away", number_in_stl(3e38), "stl"),
    case("STL: normals turned inward", bytes_of("stl", normals(lambda n: -n)), "stl", says="normals that are not those of"),
    case("STL: normals are NaN", bytes_of("stl", normals(lambda n: n * np.nan)), "stl", says="normals that are not those of"),
    case("STL: begins as ASCII does", bytes_of("stl", lambda b: b"solid t".ljust(80) + b[80:]), "stl", says="take it for ASCII"),
    case("STL: in ASCII", bytes_of("stl", ascii_stl), "stl", says="do not fit"),
    case("STL: no triangles", bytes_of("stl", lambda b: b[:80] + b"\0\0\0\0"), "stl", says="announces 0"),
    case("STL: 4294967295 triangles", bytes_of("stl", lambda b: b[:80] + b"\xff\xff\xff\xff" + b[84:]), "stl"),
    # both, so that neither tells of the other
    case("meshes: a pit in the base's top", of_both(on_top(0.5, 0.5), (0.0, 0.0, -0.1)), "stl base", says="on no face"),
    case("meshes: a hump on the base's back", of_both(on_back(0.5, 0.5), (0.0, 0.0, -0.02)), "stl base", says="on no face"),
    case("meshes: a corner beyond the outline", of_both(on_top(1.0, 1 / 12), (0.02, 0.0, 0.0)), "stl base", says="by 20.0 um"),
    case("meshes: a foot", of_both(foot, (0.02, 0.0, 0.0)), "stl base", says="1 elements do not stand"),
    # 3MF
    case("3MF: in inches", model_of(lambda t: t.replace('unit="millimeter"', 'unit="inch"')), "3mf", says="millimetre"),
    case("3MF: a vertex moved", model_of(moved_vertex), "3mf"),
    case("3MF: a triangle dropped", model_of(lambda t: re.sub(r"<triangle [^>]*>\n", "", t, count=1)), "3mf", says="triangles"),
    case("3MF: a triangle flipped", model_of(lambda t: re.sub(r'v1="(\d+)" v2="(\d+)"', r'v1="\2" v2="\1"', t, count=1)), "3mf"),
    case("3MF: a vertex beyond the last", model_of(lambda t: re.sub(r'v1="\d+"', 'v1="99999999"', t, count=1)), "3mf"),
    case("3MF: no number", model_of(lambda t: re.sub(r'<vertex x="[^"]*"', '<vertex x="1e"', t, count=1)), "3mf", says="usual"),
    case("3MF: NaN", model_of(lambda t: re.sub(r'<vertex x="[^"]*"', '<vertex x="nan"', t, count=1)), "3mf"),
    case("3MF: the item moved", model_of(lambda t: t.replace("<item ", f'<item transform="{MOVED}" ')), "3mf"),
    case("3MF: the item scaled", model_of(lambda t: t.replace("<item ", f'<item transform="{SCALED}" ')), "3mf"),
    case("3MF: nothing to build", model_of(lambda t: t.replace('<item objectid="1"/>', "")), "3mf"),
    case("3MF: the item twice", model_of(lambda t: t.replace('<item objectid="1"/>', '<item objectid="1"/>' * 2)), "3mf"),
    case("3MF: asks for an extension", model_of(lambda t: t.replace("<model ", '<model requiredextensions="p" ')), "3mf"),
    case("3MF: of no namespace", model_of(lambda t: t.replace("/core/2015/02", "/core/2015/03")), "3mf"),
    case("3MF: the unit twice", model_of(lambda t: t.replace("<model ", '<model unit="inch" ').replace(*TWICE)), "3mf"),
    case("3MF: a second type", model_of(lambda t: t.replace('type="model"', 'type="model" type="support"')), "3mf"),
    case("3MF: bytes before it", bytes_of("3mf", lambda b: b"#!/bin/sh\n" + b), "3mf", says="before or behind"),
    case("3MF: bytes behind it", bytes_of("3mf", lambda b: b + b"PK"), "3mf", says="before or behind"),
    case("3MF: zip cut", bytes_of("3mf", lambda b: b[: len(b) // 2]), "3mf", says="cannot be unpacked"),
    case("3MF: zip damaged", bytes_of("3mf", lambda b: b[:600] + bytes(64) + b[664:]), "3mf", says="cannot be unpacked"),
    case("3MF: announces 4 GB", bytes_of("3mf", bomb), "3mf", says="announces"),
    case("3MF: no zip", bytes_of("3mf", lambda b: b"solid"), "3mf", says="cannot be unpacked"),
    # STEP
    case("STEP: cut", bytes_of("step-solid", lambda b: b[: len(b) // 2]), "step-solid", says="no whole"),
    case("STEP: empty", bytes_of("step-solid", lambda b: b""), "step-solid", says="no whole"),
    case("STEP: garbage", bytes_of("step-solid", lambda b: bytes(range(256)) * 100), "step-solid", says="no whole"),
    case("STEP: two solids", text_of("step-solid", lambda t: t.replace("=PRODUCT(", "=MANIFOLD_SOLID_BREP(")), "step-solid"),
    case("STEP: a comment", replaced("step-solid", "\nDATA;\n", "\nDATA;\n/* = */\n"), "step-solid", says="it has a comment"),
    case("STEP: in metres", replaced("step-solid", ".MILLI.,.METRE.", "$,.METRE."), "step-solid", says="millimetre"),
    *(
        case(f"STEP: {name}", text_of("step-solid", changed(pattern, by)), "step-solid", says=says)
        for name, pattern, by, says in [
            ("in inches", re.escape(MM), INCH, f"no millimetre, radian or steradian: {INCH}"),
            ("a second unit", "\nDATA;\n", rf"\g<0>#8={INCH};\n", f"no millimetre, radian or steradian: {INCH}"),
            ("in degrees", r",\.RADIAN", ",.DEGREE", "(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.DEGREE.))"),
            ("uncertain", "1.E-06", "1.", "its points are uncertain by 1 mm, more than 1e-05 mm"),
            ("a context without a length", r"\(\(#5,#6,#7\)\)", "((#6,#7))", "shapes whose units are not"),
            ("no context", f"{SHOWN}#9", r"\1\2),#8", "shapes whose units are not"),
            ("a solid twice", SHOWN, r"\1\2,\2),", "not each shown once"),
            ("a solid not shown", SHOWN, r"\1#1),", "not each shown once"),
            ("an edge turned", USE + r"\.T", r"\1\2,.F", "an edge is not used once in each direction"),
            ("another edge", USE, r"\1#99,", "an edge is not used once in each direction"),
            ("a bound turned", r"(=FACE_BOUND\(''[^;]*,)\.T", r"\1.F", "a bound is turned"),
            ("an open shell", r"(=CLOSED_SHELL\('',\()#\d+,", r"\1", "not named once in its shell"),
            ("a use twice", r"(=EDGE_LOOP\('',\()#\d+,(#\d+)", r"\1\2,\2", "not named once in its shell"),
        ]
    ),
]


@pytest.mark.parametrize(("edit", "fails", "says"), QUICK)
def test_a_changed_model_is_caught_without_a_kernel(
    edit: Edit, fails: tuple[str, ...], says: str, textures: dict[str, Kit], copied: Copy
) -> None:
    kit = OpenKit(copied(textures["block"]))
    edit(kit)
    verification = verify_kit(kit.save(consistent=True), quick=True)
    judge(verification, fails, says)
    assert failed(verification).keys() <= MODEL_LINES


@pytest.mark.parametrize("name", TEXTURES)
@pytest.mark.parametrize(
    ("edit", "fails"),
    [
        (mesh_of(without_triangle), "stl"),
        (mesh_of(second_body), "stl"),
        (model_of(moved_vertex), "3mf"),
        (bytes_of("step-solid", lambda b: b[:-100]), "step-solid"),
    ],
    ids=["triangle missing", "two bodies", "vertex moved", "cut"],
)
def test_every_kind_of_solid_is_looked_at(name: str, edit: Edit, fails: str, textures: dict[str, Kit], copied: Copy) -> None:
    kit = OpenKit(copied(textures[name]))
    edit(kit)
    assert fails in failed(verify_kit(kit.save(consistent=True), quick=True))


# The assembly


def occurrence(designator: str, change: Callable[[str], str]) -> Edit:
    """Change the lines of one occurrence: from its point to its name."""

    def edit(text: str) -> str:
        end = text.index(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{designator}'")
        start = text.rindex("CARTESIAN_POINT(", 0, end)
        end = text.index(";", end)
        changed = text[:start] + change(text[start:end]) + text[end:]
        assert changed != text
        return changed

    return text_of("step-assembly", edit)


def shifted(axis: int, by_mm: float) -> Callable[[str], str]:
    def change(text: str) -> str:
        found = re.match(r"CARTESIAN_POINT\('',\(([^)]*)\)", text)
        assert found is not None
        values = [float(v) for v in found[1].split(",")]
        values[axis] += by_mm
        return text.replace(found[1], ",".join(f"{v:.6f}" for v in values), 1)

    return change


def swapped(text: str) -> str:
    one, other = (f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('R{n}','R{n}'" for n in (11, 12))
    return text.replace(one, "#").replace(other, one).replace("#,", other + ",")


def without_occurrence(text: str) -> str:
    end = text.index("NEXT_ASSEMBLY_USAGE_OCCURRENCE('R10'")
    link = text.index("CONTEXT_DEPENDENT_SHAPE_REPRESENTATION", end)
    start = text.rindex("#", 0, text.rindex("CARTESIAN_POINT(", 0, end))
    names = re.search(r"(#\d+)=AXIS2", text[start:end])
    assert names is not None
    cut = text[:start] + text[text.index(";", link) + 1 :]
    return re.sub(rf"{names[1]},|,{names[1]}(?=\))", "", cut)


QUICK_ASSEMBLY = [
    case("by 2 um", occurrence("R10", shifted(0, 0.002)), "step-assembly", says="R10 is 2.0 um off its CPL row"),
    case("by 2 um upward", occurrence("R10", shifted(2, 0.002)), "step-assembly", says="R10 is 2.0 um"),
    case(
        "renamed", text_of("step-assembly", lambda t: t.replace("'R10','R10'", "'C10','C10'")), "step-assembly", says="C10, R10"
    ),
    case(
        "two names",
        text_of("step-assembly", lambda t: t.replace("'R10','R10'", "'R10','C10'")),
        "step-assembly",
        says="two names",
    ),
    case(
        "a name twice", text_of("step-assembly", lambda t: t.replace("'R10','R10'", "'R11','R11'")), "step-assembly", says="R10"
    ),
    case("two swapped", text_of("step-assembly", swapped), "step-assembly", says="um off its CPL row"),
    case("missing", text_of("step-assembly", without_occurrence), "step-assembly", says="occurrences where the CPL has"),
    case("cut", bytes_of("step-assembly", lambda b: b[: len(b) // 2]), "step-assembly", says="no whole"),
    case("empty", bytes_of("step-assembly", lambda b: b""), "step-assembly", says="no whole"),
    case("no number", occurrence("R10", lambda t: re.sub(r"\(\s*-?[\d.]+,", "(1.2.3,", t, count=1)), "step-assembly"),
    case("garbage", bytes_of("step-assembly", lambda b: b"ISO-10303-21;" + bytes(range(256)) * 99), "step-assembly"),
    case("metre", replaced("step-assembly", ".MILLI.,.METRE.", "$,.METRE."), "step-assembly", says="millimetre"),
    case("a solid twice", text_of("step-assembly", changed(SHOWN, r"\1\2,\2),")), "step-assembly", says="not each shown once"),
    case("an edge turned", text_of("step-assembly", changed(USE + r"\.T", r"\1\2,.F")), "step-assembly", says="not used once in"),
]


@pytest.mark.parametrize(("edit", "fails", "says"), QUICK_ASSEMBLY)
def test_a_changed_assembly_is_caught_without_a_kernel(
    edit: Edit, fails: tuple[str, ...], says: str, film: Kit, copied: Copy
) -> None:
    kit = OpenKit(copied(film))
    edit(kit)
    verification = verify_kit(kit.save(consistent=True), quick=True)
    judge(verification, fails, says)
    assert failed(verification).keys() <= MODEL_LINES


# With a kernel


def turned_occurrence(text: str) -> str:
    """R10 with the directions of its placement in another order: another turn."""
    end = text.index("NEXT_ASSEMBLY_USAGE_OCCURRENCE('R10'")
    start = text.rindex("CARTESIAN_POINT(", 0, end)
    found = re.search(r"(AXIS2_PLACEMENT_3D\('',#\d+),#\d+,#\d+\)", text[start:end])
    origin = re.search(r"AXIS2_PLACEMENT_3D\('',#\d+,(#\d+),(#\d+)\)", text)
    assert found is not None
    assert origin is not None
    return text[:start] + text[start:end].replace(found[0], f"{found[1]},{origin[1]},{origin[2]})") + text[end:]


def moved_board(text: str) -> str:
    """The board's occurrence, not the parts', by 1 mm."""
    last = max(int(n) for n in re.findall(r"#(\d+)=", text)) + 1
    board = re.search(r"ITEM_DEFINED_TRANSFORMATION\('',\$,(#\d+),(#\d+)\)", text)
    assert board is not None
    assert board[1] == board[2]
    axes = re.search(rf"{board[1]}=AXIS2_PLACEMENT_3D\('',#\d+,(#\d+,#\d+)\)", text)
    assert axes is not None
    text = text.replace(board[0], f"ITEM_DEFINED_TRANSFORMATION('',$,{board[1]},#{last + 1})", 1)
    listed = re.search(rf"=SHAPE_REPRESENTATION\('',\({board[1]},", text)
    assert listed is not None
    text = text.replace(listed[0], f"{listed[0]}#{last + 1},")
    own = f"#{last}=CARTESIAN_POINT('',(1.,0.,0.));\n#{last + 1}=AXIS2_PLACEMENT_3D('',#{last},{axes[1]});\n"
    return text.replace("ENDSEC;\nEND-ISO", own + "ENDSEC;\nEND-ISO")


def moved_part(scale: float, by: tuple[float, float, float]) -> Callable[[str], str]:
    """Every point of the part's prototype changed: x and y scaled against each other, then moved."""

    def edit(text: str) -> str:
        start = text.index("=MANIFOLD_SOLID_BREP", text.index("=MANIFOLD_SOLID_BREP") - 1)
        start = text.index("=PRODUCT(", start)  # the board is written; the part's box follows it
        end = text.index("=MANIFOLD_SOLID_BREP", start)

        def change(found: re.Match[str]) -> str:
            x, y, z = (float(v) for v in found[1].split(","))
            return f"CARTESIAN_POINT('',({x * scale + by[0]:.9f},{y / scale + by[1]:.9f},{z + by[2]:.9f}))"

        return text[:start] + re.sub(r"CARTESIAN_POINT\('',\(([^)]*)\)\)", change, text[start:end]) + text[end:]

    return edit


def vertex_moved(text: str) -> str:
    """One corner on top of the last block, by 10 um: its faces are no longer where their edges are."""
    found = list(re.finditer(r"CARTESIAN_POINT\('',\(( *-?\d+\.\d+),( *-?\d+\.\d+),0\.23\)\)", text))[-1]
    return text[: found.start(1)] + f"{float(found[1]) + 0.01:.9f}" + text[found.end(1) :]


def vertex_below_moved(text: str) -> str:
    """The first vertex of the base's or the film's underside, up by 50 um: the solid stays valid, and of the same volume."""
    point = re.search(r"CARTESIAN_POINT\('',\(0\.,1\.,(-0\.\d+)\)\);\n#\d+=VERTEX_POINT", text)
    assert point is not None
    return text[: point.start(1)] + f"{float(point[1]) + 0.05:.2f}" + text[point.end(1) :]


def without_block(text: str) -> str:
    """The last element's faces out of the shell and its bound out of the tile."""
    shell = re.search(r"CLOSED_SHELL\('',\(([^)]*)\)\)", text)
    assert shell is not None
    names = re.split(r",\s*", shell[1])
    gone = set(names[-5:])
    first = min(int(name[1:]) for name in gone)
    bounds = [int(n) for n in re.findall(r"#(\d+)=FACE_BOUND\(", text)]
    foot = max(b for b in bounds if b < first - 1)
    foot = max(b for b in bounds if b < foot) if f"(#{foot})" in text.replace("\n", "") else foot
    text = text.replace(shell[0], f"CLOSED_SHELL('',({','.join(names[:-5])}))")
    return re.sub(rf",\s*#{foot}(?=[,)])", "", text)


def wall_wider(text: str) -> str:
    """The first rounded wall with a radius 10 um larger than that of its edges."""
    return re.sub(
        r"(CYLINDRICAL_SURFACE\('',#\d+,)(\d+\.\d*)", lambda found: f"{found[1]}{float(found[2]) + 0.01:.9f}", text, count=1
    )


SPHERE = ("CYLINDRICAL_SURFACE('',", "SPHERICAL_SURFACE('',")
KERNEL_SOLID = [
    case("a vertex moved", text_of("step-solid", vertex_moved), "step-solid by OCCT"),
    case("a vertex of the base", text_of("step-solid", vertex_below_moved), "step-solid by OCCT", says="50.000 um off its faces"),
    case("a block deleted", text_of("step-solid", without_block), "step-solid by OCCT"),
    case("a wall with another radius", text_of("step-solid", wall_wider), "step-solid by OCCT"),
    case("the surface of a wall", replaced("step-solid", *SPHERE), "step-solid by CAD kernels", says="1 of SPHERICAL_SURFACE"),
    case("a name that is not there", replaced("step-solid", "=CLOSED_SHELL('',(#", "=CLOSED_SHELL('',(#9"), "step-solid by OCCT"),
]


@pytest.mark.parametrize(("edit", "fails", "says"), first(1, KERNEL_SOLID))
def test_a_changed_solid_is_caught_by_occt(
    edit: Edit, fails: tuple[str, ...], says: str, textures: dict[str, Kit], copied: Copy, only_occt: None
) -> None:
    kit = OpenKit(copied(textures["block"]))
    edit(kit)
    judge(verify_kit(kit.save(consistent=True)), fails, says)


MOVE = "ITEM_DEFINED_TRANSFORMATION('',$,#"
KERNEL_ASSEMBLY = [
    case("turned", text_of("step-assembly", turned_occurrence), "step-assembly by OCCT", says="R10 is turned"),
    case("the board moved", text_of("step-assembly", moved_board), "step-assembly by OCCT"),
    case("part sunk", text_of("step-assembly", moved_part(1.0, (0, 0, -0.1))), "step-assembly by OCCT", says="centre of mass"),
    case("part aside", text_of("step-assembly", moved_part(1.0, (0.05, 0, 0))), "step-assembly by OCCT", says="centre of mass"),
    case("a vertex of the film", text_of("step-assembly", vertex_below_moved), "step-assembly by OCCT", says="50.000 um off"),
    case("the part turned by 90 deg", text_of("step-assembly", moved_part(0.5, (0, 0, 0))), "step-assembly by OCCT"),
    case("a missing placement", replaced("step-assembly", MOVE, MOVE + "9"), "step-assembly by OCCT"),
]


@slow
@pytest.mark.parametrize(("edit", "fails", "says"), first(1, KERNEL_ASSEMBLY))
def test_a_changed_assembly_is_caught_by_occt(
    edit: Edit, fails: tuple[str, ...], says: str, film: Kit, copied: Copy, only_occt: None
) -> None:
    kit = OpenKit(copied(film))
    edit(kit)
    judge(verify_kit(kit.save(consistent=True)), fails, says)


def last_moved(points: int, by_mm: float) -> Callable[[str], str]:
    """The last element, of so many points, moved along x: a whole solid, in the wrong place."""

    def edit(text: str) -> str:
        found = list(re.finditer(r"CARTESIAN_POINT\('',\(( *-?\d+\.\d+),( *-?\d+\.\d+),([^)]*)\)\)", text))
        for point in reversed(found[-points:]):
            text = text[: point.start(1)] + f"{float(point[1]) + by_mm:.9f}" + text[point.end(1) :]
        return text

    return edit


@slow
@pytest.mark.parametrize(("name", "points"), [("block", 8), thorough("dome", 4)])
def test_an_element_in_another_place_is_caught(
    name: str, points: int, textures: dict[str, Kit], copied: Copy, only_occt: None
) -> None:
    """A valid solid of the right volume, whose last element stands 50 um aside."""
    kit = OpenKit(copied(textures[name]))
    text_of("step-solid", last_moved(points, 0.05))(kit)
    verification = verify_kit(kit.save(consistent=True))
    assert not verification.passed
    assert {line for line in failed(verification) if line.startswith("step-solid")}


# The manifest


def stated(path: str, value: Any) -> Edit:
    def edit(kit: OpenKit) -> None:
        *parents, last = path.split(".")
        place: Any = kit.manifest
        for key in parents:
            place = place[key]
        if value is None:
            del place[last]
        else:
            place[last] = value

    return edit


CYLINDER = {"radius_mm": 16.0, "around": "x", "shell": "segment"}
MANIFEST = [
    case("base", stated("solid.base_mm", 0.85), "stl", says="volume"),
    case("no base", stated("solid.base_mm", None), "manifest", says="base_mm"),
    case("base of nothing", stated("solid.base_mm", 0.0), "manifest", says="base_mm"),
    case("base of NaN", stated("solid.base_mm", float("nan")), "manifest", says="NaN is no JSON"),
    case("negative", stated("solid.negative", True), "stl"),
    case("negative no flag", stated("solid.negative", "yes"), "manifest", says="negative"),
    case("a cylinder", stated("solid.cylinder", CYLINDER), "stl"),
    case("a cylinder too small", stated("solid.cylinder", {**CYLINDER, "radius_mm": 1.0}), "solid", says="overlap itself"),
    case(
        "a cylinder of NaN", stated("solid.cylinder", {**CYLINDER, "radius_mm": float("nan")}), "manifest", says="NaN is no JSON"
    ),
    case("a cylinder round z", stated("solid.cylinder", {**CYLINDER, "around": "z"}), "manifest", says="around"),
    case("a cylinder without radius", stated("solid.cylinder", {"around": "x", "shell": "whole"}), "manifest", says="radius_mm"),
    case("a cylinder of text", stated("solid.cylinder", "16"), "manifest", says="cylinder"),
    case("another top", stated("solid.top", "round"), "manifest", says="top"),
    case("no solid", stated("solid", None), "manifest", says="solid"),
    case("solid of text", stated("solid", "flat"), "manifest", says="solid"),
    case("length", stated("part.body_mm", [0.62, 0.3, 0.23]), "stl places"),
    case("width", stated("part.body_mm", [0.6, 0.32, 0.23]), "stl"),
    case("height", stated("part.body_mm", [0.6, 0.3, 0.25]), "stl"),
    case("a part larger than its cell", stated("part.body_mm", [1.6, 0.3, 0.23]), "solid", says="larger than its cell"),
    case("shape", stated("part.shape", "dome"), "manifest", says="no dome"),
    case("turned", stated("part.rotation_deg", 135.0), "stl places"),
]


@pytest.mark.parametrize(("edit", "fails", "says"), MANIFEST)
def test_a_changed_manifest_is_caught_without_a_kernel(
    edit: Edit, fails: tuple[str, ...], says: str, textures: dict[str, Kit], copied: Copy
) -> None:
    kit = OpenKit(copied(textures["block"]))
    edit(kit)
    judge(verify_kit(kit.save(consistent=False), quick=True), fails, says)


@pytest.mark.parametrize("top_mm", [0.05, 0.3, 0.59])
def test_a_dome_that_is_called_a_cone_is_caught(top_mm: float, textures: dict[str, Kit], copied: Copy) -> None:
    kit = OpenKit(copied(textures["dome"]))
    kit.manifest["part"]["top_mm"] = top_mm
    lines = failed(verify_kit(kit.save(consistent=False), quick=True))
    assert lines.keys() & {"stl", "step-solid"}


def test_a_film_whose_manifest_forgets_its_models_is_caught(film: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(film))
    del kit.manifest["solid"]
    lines = failed(verify_kit(kit.save(consistent=False), quick=True))
    assert lines.keys() & {"manifest", "roles"}


@pytest.mark.parametrize("role", ["step-solid", "step-assembly", "stl", "3mf"])
def test_a_model_that_is_missing_is_named(role: str, film: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(film))
    (kit.folder / kit.paths[role]).unlink()
    lines = failed(verify_kit(kit.folder, quick=True))
    assert kit.paths[role] in lines["files"].message
    kit.manifest["files"] = [row for row in kit.manifest["files"] if row["role"] != role]
    (kit.folder / "manifest.json").write_text(json.dumps(kit.manifest), encoding="ascii")
    assert role in failed(verify_kit(kit.folder, quick=True))["roles"].message


# What passes


def test_unchanged_kits_pass_with_every_reader(textures: dict[str, Kit], film: Kit) -> None:
    for kit in (film, textures["cone round y"]):
        verification = verify_kit(kit.path)
        assert failed(verification) == {}
        assert verification.passed
        said = {check.name: check.message for check in verification.checks}
        assert {"stl", "stl places", "symbols from STL", "3mf", "step-solid", "step-solid by OCCT"} <= said.keys()
        assert said["stl by trimesh"].startswith("watertight, 1 body, ")
        assert ("step-assembly by OCCT" in said) == (kit is film)


@pytest.mark.parametrize("name", TEXTURES)
def test_unchanged_textures_pass_the_quick_verification(name: str, textures: dict[str, Kit]) -> None:
    verification = verify_kit(textures[name].path, quick=True)
    assert failed(verification) == {}
    assert not any("OCCT" in check.name or "FreeCAD" in check.name for check in verification.checks)


def test_a_program_that_is_missing_is_a_warning(textures: dict[str, Kit], only_occt: None) -> None:
    verification = verify_kit(textures["block"].path)
    assert verification.passed
    warnings = {check.name: check.message for check in verification.checks if check.warning}
    assert warnings.keys() >= {"FreeCAD", "PrusaSlicer"}
    assert "not installed" in warnings["FreeCAD"]


# Hostile files: an answer, never a traceback

HOSTILE = {
    "nothing but brackets": b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1=" + b"(" * 200_000 + b"\nENDSEC;\nEND-ISO-10303-21;\n",
    "a name that names itself": b"ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\n"
    b"FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));\nENDSEC;\nDATA;\n#1=CLOSED_SHELL('',(#1));\n#2=MANIFOLD_SOLID_BREP('',#1);\n"
    b"#3=SHAPE_REPRESENTATION('',(#2,#3),#3);\n/* .MILLI.,.METRE. =ADVANCED_FACE( */\nENDSEC;\nEND-ISO-10303-21;\n",
    "a number without end": b"ISO-10303-21;\nDATA;\n#1=CARTESIAN_POINT('',("
    + b"9" * 1_000_000
    + b".,0.,0.));\nEND-ISO-10303-21;\n",
    "zeros": bytes(1_000_000),
    "text in another encoding": "ISO-10303-21;\n".encode("utf-16"),
}


@slow
@pytest.mark.parametrize("data", first(1, [pytest.param(data, id=name) for name, data in HOSTILE.items()]))
def test_hostile_step_files_are_failed_lines(data: bytes, film: Kit, copied: Copy, only_occt: None) -> None:
    kit = OpenKit(copied(film))
    kit.data.update({"step-solid": data, "step-assembly": data})
    folder = kit.save(consistent=True)
    result = CliRunner().invoke(main, ["verify", str(folder)], prog_name="tactape-fab")
    assert result.exit_code == 4
    assert "Traceback" not in result.output
    lines = failed(verify_kit(folder, quick=True))
    assert {"step-solid", "step-assembly"} <= lines.keys()
    assert all(len(check.message) < 2000 for check in lines.values())


def test_a_name_cannot_write_to_the_terminal(film: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(film))
    replaced("step-assembly", "'R10','R10'", "'R\x1b[2J','R\x1b[2J'")(kit)
    result = CliRunner().invoke(main, ["verify", str(kit.save(consistent=True)), "--quick"], prog_name="tactape-fab", color=True)
    assert result.exit_code == 4
    assert "\x1b[2J" not in result.output


@pytest.mark.parametrize("role", ["stl", "3mf"])
@pytest.mark.parametrize("data", [b"", b"\0" * 84, b"\xff" * 5000, b"PK\x05\x06" + bytes(18), b"solid" * 1000], ids=range(5))
def test_a_hostile_mesh_file_is_a_failed_line(role: str, data: bytes, film: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(film))
    kit.data[role] = data
    folder = kit.save(consistent=True)
    assert role in failed(verify_kit(folder, quick=True))
    result = CliRunner().invoke(main, ["verify", str(folder), "--quick"], prog_name="tactape-fab")
    assert result.exit_code == 4
    assert "Traceback" not in result.output


@slow
def test_hostile_meshes_are_failed_lines_of_other_readers_too(film: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(film))
    data = kit.data["stl"]
    kit.data.update({"stl": data[:80] + (1000).to_bytes(4, "little") + data[84 : 84 + 50_000], "3mf": b"PK\x05\x06" + bytes(18)})
    result = CliRunner().invoke(main, ["verify", str(kit.save(consistent=True))], prog_name="tactape-fab")
    assert result.exit_code == 4
    assert "Traceback" not in result.output
