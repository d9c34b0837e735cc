"""The texture on the user's own part: the map, the figures, the refusals, the finished folder."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from tactape_fab import Tape, TapeSpec, make_kit
from tactape_fab.base.errors import SpecError, TactapeError
from tactape_fab.cli.emboss import distortion_lines
from tactape_fab.make.emboss import emboss_kit, worst_pitch_error
from tactape_fab.solids.elements import element_volume_mm3
from tactape_fab.solids.mesh.stl import mesh_problems, read_stl
from tactape_fab.solids.mesh.triangles import Mesh, stl_bytes
from tactape_fab.solids.surface.charts import Placement
from tactape_fab.solids.surface.fuse import fuse_mesh
from tactape_fab.solids.surface.part_mesh import MeshChart
from tactape_fab.solids.surface.patch import MOST_PITCH_ERROR
from tactape_fab.solids.surface.place import lay_out
from tactape_fab.texture.part import TapePart
from tactape_fab.verify.models.embossed import check_embossed
from tests.surfaces import ball, box, cylinder, emboss, kit_folder, mesh_of, planned, saddle
from tests.thorough import only_thorough, slow

GRID_MM = np.stack(np.meshgrid(np.arange(-15.0, 16.0, 1.5), np.arange(-12.0, 13.0, 1.5)), axis=2).reshape(-1, 2)


@pytest.fixture(scope="module")
def tape() -> Tape:
    return planned()


@pytest.fixture
def kit(tmp_path: Path, tape: Tape) -> Path:
    return kit_folder(tmp_path / "kit", tape)


# The map


@pytest.mark.parametrize(("subdivisions", "error_mm"), [(2, 0.5), (3, 0.13), (5, 0.009)])
def test_ball_is_mapped_along_its_great_circles(subdivisions: int, error_mm: float) -> None:
    radius_mm = 25.0
    chart = MeshChart(mesh_of(ball(radius_mm, subdivisions)), Placement())
    frames = chart.frames(GRID_MM)
    x, n = chart.centre.x_axis[0], chart.centre.normal[0]
    arc_mm = np.hypot(*GRID_MM.T)
    course = (GRID_MM[:, :1] * x + GRID_MM[:, 1:] * np.cross(n, x)) / np.where(arc_mm > 0, arc_mm, 1)[:, None]
    exact = radius_mm * (np.cos(arc_mm / radius_mm)[:, None] * n + np.sin(arc_mm / radius_mm)[:, None] * course)
    assert frames.arrived.all()
    assert np.linalg.norm(frames.points_mm - exact, axis=1).max() < error_mm
    # the facets lie inside the ball, which shortens the way; sideways there is next to no error
    aside = np.einsum("ij,ij->i", frames.points_mm, np.cross(n, course))
    assert np.abs(aside).max() < max(error_mm / 5, 0.007)
    assert np.abs(np.einsum("ij,ij->i", frames.normal, frames.x_axis)).max() < 1e-12


def test_cylinder_is_mapped_by_arc_length() -> None:
    chart = MeshChart(mesh_of(cylinder(16.0)), Placement(at_mm=(16.0, 0.0, 2.0)))
    frames = chart.frames(GRID_MM)
    angle = np.arctan2(frames.points_mm[:, 1], frames.points_mm[:, 0])
    assert np.abs(angle * 16.0 - GRID_MM[:, 0]).max() < 0.002
    assert np.abs(frames.points_mm[:, 2] - 2.0 - GRID_MM[:, 1]).max() < 0.002
    around = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1)
    assert np.abs(frames.x_axis - around).max() < 0.002


def test_plane_is_mapped_exactly_and_up_turns_the_board() -> None:
    chart = MeshChart(mesh_of(box(60, 60)), Placement(at_mm=(1.0, 2.0, 2.5), up=(1.0, 0.0, 3.0)))
    points = chart.frames(GRID_MM).points_mm
    assert np.abs(points - np.c_[1.0 + GRID_MM[:, 1], 2.0 - GRID_MM[:, 0], np.full(len(GRID_MM), 2.5)]).max() < 1e-5


def test_default_place_is_the_point_above_the_middle() -> None:
    model = box(30, 20, 6)
    model.apply_translation((5, 6, 7))
    centre = MeshChart(mesh_of(model), Placement()).centre
    assert np.abs(centre.points_mm[0] - (5, 6, 10)).max() < 1e-5
    assert np.abs(centre.y_axis[0] - (0, 1, 0)).max() < 1e-9


def test_walk_ends_at_a_crease() -> None:
    frames = MeshChart(mesh_of(box(20, 20)), Placement()).frames(np.array([(9.9, 0.0), (30.0, 0.0), (0.0, -30.0)]))
    assert frames.arrived.tolist() == [True, False, False]
    assert np.abs(frames.walked_mm - (9.9, 10.0, 10.0)).max() < 1e-4


# What is measured


def test_ball_is_measured(tape: Tape) -> None:
    laid = lay_out(tape, MeshChart(mesh_of(ball(25.0)), Placement()))
    reach_mm = laid.distortion.reach_mm
    assert laid.radius_mm == pytest.approx(25.0, rel=1e-3)
    assert reach_mm == pytest.approx(3.5 * 1.5 * 2**0.5)
    # an arc at distance r about the middle is sin(r / R) R long for every r: 10 % lost at r = 0.787 R
    assert laid.distortion.usable_radius_mm == pytest.approx(0.787 * 25.0, rel=0.02)
    angle = reach_mm / 25.0
    assert np.sin(angle) / angle - 1 == pytest.approx(-0.0146, abs=1e-3)
    assert -0.0146 < laid.distortion.pitch_error_min < -0.005
    assert abs(laid.distortion.pitch_error_max) < 5e-4


def test_flat_texture_has_no_distortion(tape: Tape) -> None:
    laid = lay_out(tape, MeshChart(mesh_of(box()), Placement()))
    figures = laid.distortion
    assert max(abs(figures.pitch_error_min), abs(figures.pitch_error_max)) < 1e-6
    assert figures.usable_radius_mm == pytest.approx(15.0, abs=0.01)
    assert laid.radius_mm is None
    # two neighbours that lean towards each other by twice 0.25 mm are 1.0 mm apart; along their sides that is 0.707 - 0.3
    assert figures.closest_gap_mm == pytest.approx(2**-0.5 - 0.3, abs=1e-5)


def test_hollow_has_a_negative_radius(tape: Tape) -> None:
    shell = trimesh.util.concatenate([box(80, 80, 80), ball(30.0, 4)])
    shell.faces[len(box().faces) :] = shell.faces[len(box().faces) :, ::-1]
    laid = lay_out(tape, MeshChart(mesh_of(shell), Placement(at_mm=(0.0, 0.0, -30.0))))
    assert laid.radius_mm == pytest.approx(-30.0, rel=0.01)
    assert laid.centre.normal[0, 2] > 0.999


@pytest.mark.parametrize("part", ["block", "cap", "cone"])
def test_one_body_of_the_right_volume(part: str) -> None:
    body = {
        "block": TapePart(name="b", shape="block", body_mm=(0.6, 0.3, 0.23), rotation_deg=45.0),
        "cap": TapePart(name="d", shape="dome", body_mm=(0.8, 0.8, 0.3), rotation_deg=0.0),
        "cone": TapePart(name="c", shape="dome", body_mm=(0.8, 0.8, 0.3), rotation_deg=0.0, top_mm=0.4),
    }[part]
    tape = replace(planned(), part=body)
    host = mesh_of(box())
    fused = fuse_mesh(host, lay_out(tape, MeshChart(host, Placement())))
    gained_mm3 = fused.volume_mm3 - host.volume_mm3
    assert fused.bodies == 1
    assert gained_mm3 == pytest.approx(64 * element_volume_mm3(body), rel={"block": 1e-5, "cap": 0.11, "cone": 0.05}[part])


def test_hollow_host_keeps_its_hollow(tape: Tape) -> None:
    inner = box(20, 20, 2)
    inner.invert()
    host = mesh_of(trimesh.util.concatenate([box(), inner]))
    fused = fuse_mesh(host, lay_out(tape, MeshChart(host, Placement())))
    assert fused.bodies == 2
    assert fused.volume_mm3 == pytest.approx(4500 - 800 + 64 * 0.0414, abs=1e-4)


# What is refused


def test_texture_beyond_an_edge_names_the_largest_radius(tape: Tape) -> None:
    with pytest.raises(
        SpecError, match=r"runs off the surface: \d+ of 64 elements.* usable radius here is 4\.[0-9] mm, the texture"
    ):
        lay_out(tape, MeshChart(mesh_of(box(9.5, 30)), Placement()))


@slow
def test_texture_that_goes_round_twice_is_refused() -> None:
    with pytest.raises(SpecError, match=r"meets itself[^\n]*\n.*overlap by up to .* usable radius here is 1[45]\.\d mm"):
        lay_out(planned((50.0, 20.0)), MeshChart(mesh_of(cylinder(5.0)), Placement(at_mm=(5.0, 0.0, 0.0))))


@slow
def test_ball_too_small_for_the_texture_is_refused() -> None:
    with pytest.raises(
        SpecError, match=r"(folds|overlap).*usable radius here is 1\d\.\d mm, the texture reaches 5\d\.\d mm; use a kit of"
    ):
        lay_out(planned((100.0, 50.0)), MeshChart(mesh_of(ball(25.0)), Placement()))


def test_too_sharp_a_curve_is_refused() -> None:
    wide = TapePart(name="w", shape="block", body_mm=(1.0, 0.3, 0.05), rotation_deg=0.0)
    tape = replace(planned((11.0, 11.0), displacement_mm=0.1), part=wide)
    with pytest.raises(SpecError, match=r"too curved or rough for \d+ elements: .* by up to 0\.0\d+ mm, more than 0\.025 mm"):
        lay_out(tape, MeshChart(mesh_of(cylinder(3.0, 60.0, 400)), Placement(at_mm=(3.0, 0.0, 0.0))))


def test_wall_thinner_than_the_feet_is_refused(tape: Tape) -> None:
    host = mesh_of(box(30, 30, 0.04))
    with pytest.raises(SpecError, match=r"64 elements do not stand whole .* in 2 pieces.*thinner than the 0\.050 mm"):
        fuse_mesh(host, lay_out(tape, MeshChart(host, Placement())))


def test_what_the_engine_loses_as_it_simplifies_is_seen(tape: Tape) -> None:
    u = np.array([(0, 0), (120, 0), (120, 90), (90, 90), (90, 30), (30, 30), (30, 90), (0, 90)])
    fan, k = np.array([(8, 8 + i, 9 + i) for i in range(1, 7)]), np.arange(8)
    sides = np.vstack([np.c_[k, (k + 1) % 8, (k + 1) % 8 + 8], np.c_[k, (k + 1) % 8 + 8, k + 8]])
    points = np.vstack([np.c_[u, np.zeros(8)], np.c_[u, np.full(8, 10.0)]])
    host = Mesh(vertices_mm=points, faces=np.vstack([fan, fan[:, ::-1] - 8, sides]))  # covers the notch, there and back
    laid = lay_out(tape, MeshChart(host, Placement(at_mm=(60.0, 15.0, 10.0))))
    with pytest.raises(TactapeError, match=r"the simplified solid has 5\d{4}\.\d+ mm3 instead of 7200\d"):
        fuse_mesh(host, laid)


# The finished folder


def test_folder_is_complete_and_the_manifest_loads(kit: Path, tape: Tape) -> None:
    told: list[tuple[str, int, int]] = []
    made = emboss(kit, ball(), "my ball.stl", progress=lambda *line: told.append(line))
    manifest = json.loads((made.path / "manifest.json").read_bytes())
    assert made.path == kit.parent / f"my-ball-{tape.name}"
    assert np.array_equal(Tape.load(made.path).symbols, tape.symbols)
    assert {row["role"] for row in manifest["files"]} == {"stl", "3mf", "placements", "certificate", "report"} == set(made.files)
    for row in manifest["files"]:
        data = (made.path / row["path"]).read_bytes()
        assert (len(data), hashlib.sha256(data).hexdigest()) == (row["bytes"], row["sha256"])
    surface = manifest["surface"]
    assert surface["source"] == "my ball.stl"
    assert surface["sha256"] == hashlib.sha256((kit.parent / "my ball.stl").read_bytes()).hexdigest()
    assert (surface["format"], surface["unit"], surface["face"], surface["bodies"]) == ("stl", "mm", None, 1)
    assert surface["centre_mm"] == pytest.approx([0, 0, 25], abs=1e-5)
    assert surface["normal"] == pytest.approx([0, 0, 1], abs=1e-6)
    assert surface["up"] == pytest.approx([0, 1, 0], abs=1e-6)
    assert surface["radius_mm"] == pytest.approx(25, rel=1e-3)
    assert surface["volume_mm3"] - surface["source_volume_mm3"] == pytest.approx(64 * 0.0414, rel=0.01)
    assert all(check.passed for check in made.checks)
    assert {check.name for check in made.checks} >= {"body", "volume", "elements", "symbols from STL", "windows from STL"}
    assert [line[0] for line in told] == ["reading", "mapping", "fusing", "fusing", "verifying"]
    rows = (made.path / made.files["placements"]).read_text().splitlines()
    assert len(rows) == 65
    assert rows[1].startswith("R1,0,0,")


@slow
def test_same_input_gives_the_same_bytes(kit: Path) -> None:
    first = emboss(kit, saddle(), output=kit.parent / "a")
    second = emboss(kit, None, output=kit.parent / "b")
    for path in ("manifest.json", *first.files.values()):
        assert (first.path / path).read_bytes() == (second.path / path).read_bytes()


def test_result_can_be_embossed_again(kit: Path) -> None:
    first = emboss(kit, box(), output=kit.parent / "a")
    again = emboss_kit(first.path, first.path / first.files["3mf"], kit.parent / "b", placement=Placement(at_mm=(0, 0, -2.5)))
    assert again.surface["volume_mm3"] == pytest.approx(4500 + 2 * 64 * 0.0414, abs=1e-3)


def test_taken_places_are_refused(kit: Path) -> None:
    first = emboss(kit, box())
    with pytest.raises(SpecError, match="exists already; use --overwrite"):
        emboss(kit, None)
    assert emboss(kit, None, overwrite=True).path == first.path
    (first.path / "mine.txt").write_text("keep")
    with pytest.raises(SpecError, match=r"holds mine\.txt"):
        emboss(kit, None, overwrite=True)


@pytest.mark.parametrize("stage", ["mapping", "fusing", "verifying"])
def test_interruption_leaves_nothing(kit: Path, stage: str) -> None:
    def stop(what: str, _: int, __: int) -> None:
        if what == stage:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        emboss(kit, box(), progress=stop, output=kit.parent / "new" / "deep")
    assert sorted(path.name for path in kit.parent.iterdir()) == ["kit", "part.stl"]


# The checks


def changed_csv(change: Callable[[list[list[str]]], object]) -> Callable[[dict[str, Any]], None]:
    def edit(parts: dict[str, Any]) -> None:
        rows = [line.split(",") for line in parts["csv"].decode().splitlines()]
        change(rows)
        parts["csv"] = "\r\n".join(map(",".join, rows)).encode()

    return edit


def bare_host(parts: dict[str, Any]) -> None:
    host = mesh_of(box())
    parts["stl"] = stl_bytes(host, "x")


def turned_symbol(parts: dict[str, Any]) -> None:
    """An element that stands where another symbol would have it, placements and manifest unchanged."""
    tape = Tape.from_mapping(parts["manifest"])
    symbols = tape.symbols.copy()
    symbols[3, 4] = (symbols[3, 4] + 1) % 4
    host = mesh_of(box())
    parts["stl"] = stl_bytes(fuse_mesh(host, lay_out(replace(tape, symbols=symbols), MeshChart(host, Placement()))).mesh, "x")


MUTATIONS: list[tuple[Callable[[dict[str, Any]], object], set[str]]] = [
    (bare_host, {"volume", "elements", "symbols from STL", "windows from STL"}),
    (turned_symbol, {"elements", "symbols from STL", "windows from STL"}),
    (lambda p: p.update(stl=p["stl"][:-50]), {"stl"}),
    (
        lambda p: p.update(stl=p["stl"][:80] + (len(p["stl"]) // 50 - 3).to_bytes(4, "little") + p["stl"][84:-100]),
        {"body", "volume"},
    ),
    (lambda p: p["manifest"]["surface"].update(volume_mm3=4502.7), {"volume"}),
    (lambda p: p["manifest"]["surface"].update(bodies=2), {"body"}),
    (lambda p: p["manifest"].pop("surface"), {"manifest"}),
    (lambda p: p.update(csv=p["csv"][:-200]), {"placements"}),
    (lambda p: p.update(csv=p["csv"].replace(b"R7,", b"R8,")), {"placements"}),
    (changed_csv(lambda rows: rows[5].__setitem__(3, "1e9")), {"placements"}),
    (changed_csv(lambda rows: rows[5].__setitem__(3, f"{float(rows[5][3]) + 0.02:.6f}")), {"elements"}),
    (changed_csv(lambda rows: rows[5].__setitem__(7, f"{float(rows[5][7]) + 0.05:.6f}")), {"placements"}),
]


@pytest.mark.parametrize(("change", "expected"), MUTATIONS, ids=[str(i) for i in range(len(MUTATIONS))])
def test_every_mutation_is_named(kit: Path, change: Callable[[dict[str, Any]], object], expected: set[str]) -> None:
    made = emboss(kit, box())
    parts = {
        "manifest": json.loads((made.path / "manifest.json").read_bytes()),
        "stl": (made.path / made.files["stl"]).read_bytes(),
        "csv": (made.path / made.files["placements"]).read_bytes(),
    }
    assert all(check.passed for check in check_embossed(parts["manifest"], parts["stl"], parts["csv"]))
    change(parts)
    failed = {check.name for check in check_embossed(parts["manifest"], parts["stl"], parts["csv"]) if not check.passed}
    assert failed >= expected if len(expected) > 1 else failed == expected


def test_coarse_ball_whose_facets_disagree_is_refused(tape: Tape) -> None:
    with pytest.raises(SpecError, match=r"the pitch is off by up to -\d\d%, more than 25%; the largest usable radius"):
        lay_out(tape, MeshChart(mesh_of(ball(25.0, 1)), Placement()))


def test_flat_face_beside_fillets_stays_flat(tape: Tape) -> None:
    """A tessellated CAD part: the corners of its flat top are also those of narrow facets that turn away."""
    half, drop = 15.0, 1.0
    angle = np.linspace(0.0, np.pi / 2, 9)
    rings = [np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (half + drop * np.sin(a)) for a in angle]
    heights = [5.0 - drop * (1 - np.cos(a)) for a in angle]
    levels = [np.c_[ring, np.full(4, z)] for ring, z in zip([*rings, rings[-1]], [*heights, 0.0], strict=True)]
    hull = trimesh.Trimesh(np.vstack(levels)).convex_hull
    chart = MeshChart(mesh_of(hull), Placement(at_mm=(0.0, 0.0, 5.0)))
    normals = lay_out(tape, chart).elements.normal
    assert np.degrees(np.arccos(np.clip(normals[:, 2], -1, 1))).max() < 0.1


# The choice of a place


def capsule() -> Any:
    return trimesh.creation.capsule(height=60.0, radius=15.0, count=[48, 48])


@slow
def test_a_place_that_distorts_is_not_chosen_where_another_is_good(tmp_path: Path) -> None:
    kit = kit_folder(tmp_path / "kit", planned((34.0, 22.0)))
    made = emboss(kit, capsule())
    assert made.surface["centre_mm"] == pytest.approx([15.0, 0.0, 0.0], abs=0.05)
    assert worst_pitch_error(made.surface["distortion"]) < 0.01
    at = emboss(kit, None, placement=Placement(at_mm=(0.0, 0.0, 45.0)), overwrite=True)
    assert worst_pitch_error(at.surface["distortion"]) > MOST_PITCH_ERROR
    said = distortion_lines(at)
    assert len(said) == 1 and f"usable are {at.surface['distortion']['usable_radius_mm']:.1f} mm" in said[0]
    assert distortion_lines(made) == []


@slow
def test_a_part_that_distorts_everywhere_is_refused_with_a_place_that_can_be_taken(tmp_path: Path) -> None:
    kit = kit_folder(tmp_path / "kit", planned((34.0, 22.0)))
    with pytest.raises(SpecError, match=r"off by up to \d+% at the best of 7 places, more than 10%") as caught:
        emboss(kit, ball(15.0))
    way = re.search(r"use --at (\d\S*),(\d\S*),(\d\S*) to have it so", str(caught.value))
    assert way is not None
    x, y, z = map(float, way.groups())
    assert emboss(kit, None, placement=Placement(at_mm=(x, y, z))).checks
    size = re.search(r"or a kit of --size (\d+)x(\d+)$", str(caught.value))
    assert size is not None
    smaller = kit_folder(tmp_path / "smaller", planned((float(size[1]), float(size[2]))))
    assert distortion_lines(emboss(smaller, None, overwrite=True)) == []
    assert not list(tmp_path.glob("*.tmp"))


@only_thorough
def test_no_triangle_is_so_thin_that_readers_disagree_on_the_pole_of_a_capsule(tmp_path: Path) -> None:
    """Elements lean against each other there; trimesh, which joins vertices that are near, found the mesh open."""
    path = tmp_path / "capsule.stl"
    trimesh.creation.capsule(height=60.0, radius=15.0, count=[64, 64]).export(path)
    kit = make_kit(TapeSpec(sector=7, part="dome", process="sla", size_mm=(40.0, 30.0)), tmp_path / "kit")
    made = emboss_kit(kit.path, path, tmp_path / "made", placement=Placement(at_mm=(0.0, 0.0, 45.0)))
    data = (made.path / made.files["stl"]).read_bytes()
    corners = read_stl(data).corners_mm
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert edges.min() > 1.5e-6
    assert mesh_problems(read_stl(data)) == []
    other = trimesh.load_mesh(made.path / made.files["stl"], process=True)
    assert (other.is_watertight, other.is_winding_consistent, other.body_count) == (True, True, 1)
