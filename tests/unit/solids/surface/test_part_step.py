"""The texture on a face of a STEP solid: exact places, one valid solid, refusals."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from tactape_fab import Tape, TapeSpec, make_kit
from tactape_fab.base import launch
from tactape_fab.base.errors import SpecError, TactapeError
from tactape_fab.make import emboss as make_emboss
from tactape_fab.make.emboss import Embossed, emboss_kit
from tactape_fab.solids.surface.charts import Placement
from tactape_fab.solids.surface.developed import Developable
from tactape_fab.solids.surface.part_step import read_step_solid
from tactape_fab.solids.surface.placements import read_placements
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart
from tactape_fab.verify import verify_kit
from tests.roundtrip.kits import OpenKit, failed
from tests.roundtrip.test_verify_robust import DAMAGES
from tests.surfaces import kit_folder, planned, step_file
from tests.thorough import costly, slow, some


class _Kernel:
    """build123d, loaded by the first test that uses it: every worker collects these tests, and that takes seconds."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith(("_", "pytest")):  # pytest asks everything in a module whether it is a fixture
            raise AttributeError(name)
        return getattr(import_module("build123d"), name)


bd = _Kernel()
BLOCK_MM3 = 0.6 * 0.3 * 0.23
AXES = np.array([(0.6, 0.8, 0.0), (-0.8, 0.6, 0.0), (0.0, 0.0, 1.0)])


@pytest.fixture(autouse=True)
def one_kernel(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """OCCT in this process, which has loaded it: another process for each part would take seconds. Not where it may crash."""
    if "own_process" not in request.node.name:
        monkeypatch.setattr(make_emboss, "limit_self", lambda **_: None)
        monkeypatch.setattr(make_emboss, "_on_step", lambda a, b, c, *_: make_emboss._on_step_alone(a, b, c))


@pytest.fixture(scope="module")
def tape() -> Tape:
    return planned((10.0, 10.0))


@pytest.fixture
def kit(tmp_path: Path, tape: Tape) -> Path:
    return kit_folder(tmp_path / "kit", tape)


def emboss(kit: Path, shape: Any, **options: Any) -> Embossed:
    return emboss_kit(kit, step_file(kit.parent / "part.step", shape), **options)


def read_back(made: Embossed) -> Any:
    return bd.import_step(made.path / made.files["step-solid"])


def plate() -> Any:
    return bd.Solid.make_box(30, 30, 5)


def bulge_mm3(radius_mm: float) -> float:
    """Volume between a cylinder and the tangent plane under one block at 45 degrees to its axis, by quadrature."""
    node, weight = np.polynomial.legendre.leggauss(40)
    length, width = np.meshgrid(0.3 * node, 0.15 * node, indexing="ij")
    across = (length - width) / 2**0.5
    return float((np.outer(weight, weight) * (radius_mm - np.sqrt(radius_mm**2 - across**2))).sum() * 0.3 * 0.15)


# Rolling out


@pytest.mark.parametrize(
    "surface",
    [
        Developable(kind="plane", origin_mm=np.array([1.0, 2.0, 3.0]), axes=AXES),
        Developable(kind="cylinder", origin_mm=np.array([1.0, 2.0, 3.0]), axes=AXES, radius_mm=16.0),
        Developable(kind="cone", origin_mm=np.array([1.0, 2.0, 3.0]), axes=AXES, radius_mm=20.0, half_angle_rad=0.3),
        Developable(kind="cone", origin_mm=np.array([1.0, 2.0, 3.0]), axes=AXES, radius_mm=20.0, half_angle_rad=-0.3),
    ],
    ids=["plane", "cylinder", "widening", "narrowing"],
)
def test_rolling_keeps_lengths_and_directions(surface: Developable) -> None:
    flat = np.random.default_rng(3).uniform(-8, 8, (200, 2))
    start = np.tile([[0.4, 2.0]], (200, 1))
    places = surface.roll(start, flat)
    step = 1e-5
    for axis, (image, plane) in enumerate(((places.first, (step, 0.0)), (places.second, (0.0, step)))):
        moved = (surface.roll(start, flat + plane).points_mm - surface.roll(start, flat - plane).points_mm) / (2 * step)
        assert np.abs(moved - image).max() < 1e-8, axis
    assert np.abs(np.einsum("ij,ij->i", places.first, places.second)).max() < 1e-12
    assert np.abs(np.linalg.norm(places.normal, axis=1) - 1).max() < 1e-12
    assert np.abs(np.einsum("ij,ij->i", places.normal, places.first)).max() < 1e-12
    assert (
        np.abs(surface.roll(surface.parameters(places.points_mm), np.zeros_like(flat)).points_mm - places.points_mm).max() < 1e-10
    )


# Faces


def placed(made: Embossed) -> tuple[FloatArray, FloatArray]:
    """Board places about the grid's middle, and where the elements stand."""
    board_mm = made.tape.part_xy_mm()
    middle = (np.array([made.tape.columns, made.tape.rows]) - 1) / 2 * made.tape.pitch_mm * (1, -1)
    rows = read_placements((made.path / made.files["placements"]).read_bytes(), made.tape.part_count)
    return board_mm - (np.array(made.tape.board.texture_origin_mm) + middle), rows.points_mm


def test_plane(kit: Path, tape: Tape) -> None:
    made = emboss(kit, plate(), placement=Placement(at_mm=(14.0, 15.0, 5.0)))
    board_mm, points_mm = placed(made)
    assert np.abs(points_mm - np.c_[board_mm + np.array([14, 15]), np.full(len(board_mm), 5.0)]).max() < 1e-6
    solid = read_back(made)
    assert (len(solid.solids()), len(solid.faces()), solid.is_valid) == (1, 6 + 5 * tape.part_count, True)
    assert solid.volume == pytest.approx(4500 + tape.part_count * BLOCK_MM3, rel=1e-9)
    assert made.surface["volume_mm3"] == pytest.approx(solid.volume, rel=1e-6)
    assert (made.surface["format"], made.surface["unit"], made.surface["radius_mm"]) == ("step", None, None)
    assert all(check.passed for check in made.checks)


@pytest.mark.parametrize("at_mm", [(-16.0, 0.0, 20.0), (16.0, 0.0, 20.0)], ids=["opposite the seam", "on the seam"])
def test_cylinder(kit: Path, tape: Tape, at_mm: tuple[float, float, float]) -> None:
    made = emboss(kit, bd.Solid.make_cylinder(16, 40), placement=Placement(at_mm=at_mm))
    board_mm, points_mm = placed(made)
    angle = np.arctan2(points_mm[:, 1], points_mm[:, 0]) - np.arctan2(at_mm[1], at_mm[0])
    arc_mm = 16 * ((angle + np.pi) % (2 * np.pi) - np.pi)
    assert np.abs(np.c_[arc_mm, points_mm[:, 2] - 20] - board_mm).max() < 2e-6
    solid = read_back(made)
    assert (len(solid.solids()), len(solid.faces()), solid.is_valid) == (1, 3 + 5 * tape.part_count, True)
    expected_mm3 = np.pi * 16**2 * 40 + tape.part_count * (BLOCK_MM3 + bulge_mm3(16.0))
    assert solid.volume == pytest.approx(expected_mm3, rel=1e-8)
    assert made.surface["radius_mm"] == pytest.approx(16.0)
    assert abs(made.surface["distortion"]["pitch_error_max"]) < 1e-6


def test_bore_is_hollow(kit: Path) -> None:
    bored = bd.Solid.make_box(60, 60, 30).cut(bd.Solid.make_cylinder(20, 40).moved(bd.Location((30, 30, -1))))
    made = emboss(kit, bored, placement=Placement(at_mm=(50.0, 30.0, 15.0)))
    assert made.surface["radius_mm"] == pytest.approx(-20.0)
    assert made.surface["normal"] == pytest.approx([-1, 0, 0])
    assert read_back(made).is_valid


@costly
@pytest.mark.parametrize("radii_mm", [(20.0, 10.0), (10.0, 20.0)])
def test_cone(kit: Path, tape: Tape, radii_mm: tuple[float, float]) -> None:
    made = emboss(kit, bd.Solid.make_cone(*radii_mm, 40), placement=Placement(at_mm=(15.0, 0.0, 20.0)))
    board_mm, points_mm = placed(made)
    # rolled out by hand: distance from the apex, and the angle about the axis times the sine of the half angle
    slope = (radii_mm[1] - radii_mm[0]) / 40
    sine = abs(slope) / np.hypot(1, slope)
    slant = np.hypot(points_mm[:, 0], points_mm[:, 1]) / sine
    turn = np.arctan2(points_mm[:, 1], points_mm[:, 0]) * sine
    flat = slant[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)

    def distances(points: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(points[:, None] - points, axis=2))

    assert np.abs(distances(flat) - distances(board_mm)).max() < 5e-6
    solid = read_back(made)
    assert (len(solid.solids()), len(solid.faces()), solid.is_valid) == (1, 3 + 5 * tape.part_count, True)
    gained = solid.volume - bd.Solid.make_cone(*radii_mm, 40).volume
    assert gained == pytest.approx(tape.part_count * BLOCK_MM3, rel=0.01)


@costly
@pytest.mark.parametrize("top_mm", [None, 0.4], ids=["cap", "cone"])
@pytest.mark.parametrize("shape", ["plane", "cylinder"])
def test_domes(tmp_path: Path, tape: Tape, top_mm: float | None, shape: str) -> None:
    dome = TapePart(name="d", shape="dome", body_mm=(0.8, 0.8, 0.3), rotation_deg=0.0, top_mm=top_mm)
    kit = kit_folder(tmp_path / "domes", replace(tape, part=dome))
    host = plate() if shape == "plane" else bd.Solid.make_cylinder(16, 40)
    made = emboss(kit, host, placement=Placement(face=5 if shape == "plane" else 0))
    solid = read_back(made)
    faces = len(host.faces()) + tape.part_count * (1 if top_mm is None else 2)
    assert (len(solid.solids()), len(solid.faces()), solid.is_valid) == (1, faces, True)
    cap_mm3 = np.pi * 0.3 / 6 * (3 * 0.4**2 + 0.3**2) if top_mm is None else np.pi * 0.3 / 3 * (0.16 + 0.08 + 0.04)
    rel = 1e-6 if shape == "plane" else 0.05
    assert solid.volume - host.volume == pytest.approx(tape.part_count * cap_mm3, rel=rel)


def test_default_is_the_largest_face_and_its_widest_place(kit: Path) -> None:
    ring = bd.Solid.make_cylinder(40, 5).cut(bd.Solid.make_cylinder(15, 5))
    made = emboss(kit, ring)
    assert made.surface["centre_mm"][2] in {0.0, 5.0}
    assert 20 < np.hypot(*made.surface["centre_mm"][:2]) < 35


def test_same_input_gives_the_same_bytes(kit: Path) -> None:
    first = emboss(kit, plate(), output=kit.parent / "a")
    second = emboss(kit, plate(), output=kit.parent / "b")
    for path in ("manifest.json", *first.files.values()):
        assert (first.path / path).read_bytes() == (second.path / path).read_bytes()
    assert b"'1980-01-01T00:00:00'" in (first.path / first.files["step-solid"]).read_bytes()[:1000]
    assert [row["role"] for row in json.loads((first.path / "manifest.json").read_bytes())["files"]].count("step-solid") == 1


# Refusals


def two_boxes() -> Any:
    return bd.Compound([bd.Solid.make_box(3, 3, 3), bd.Solid.make_box(3, 3, 3).moved(bd.Location((9, 0, 0)))])


@pytest.mark.parametrize(
    ("shape", "placement", "message"),
    [
        (
            plate,
            Placement(face=6),
            r"face = 6 does not exist: the solid has 6 faces, 0 to 5; the largest: 4 plane 900\.0 mm2 at 15",
        ),
        (plate, Placement(face=-1), r"face = -1 does not exist"),
        (plate, Placement(at_mm=(1, 1, 9)), r"at = 1,1,9 lies 4\.000 mm from the surface, more than 0\.053 mm; .* is 1,1,5"),
        (plate, Placement(face=4, at_mm=(15, 15, 5)), r"lies 5\.000 mm from the surface"),
        (plate, Placement(face=5, up=(0, 0, 2)), r"up = 0,0,2 is parallel"),
        (lambda: bd.Solid.make_sphere(25), Placement(), r"face = 0 is a sphere; give a plane, .* or export the part as STL"),
        (lambda: bd.Face.make_rect(30, 30), Placement(), r"holds no solid, only 1 loose faces"),
        (two_boxes, Placement(), r"holds 2 solids; export the part as one solid"),
        (
            lambda: bd.Solid.make_box(7, 30, 5),
            Placement(at_mm=(3.5, 15, 5)),
            r"off the surface.*largest usable radius here is 3\.\d mm",
        ),
        (lambda: bd.Solid.make_box(30, 30, 0.04), Placement(face=5), r"elements do not stand whole"),
        (lambda: bd.Solid.make_box(0.1, 0.1, 0.1), Placement(), r"is 0\.1 x 0\.1 x 0\.1 mm, smaller than 1 mm; correct its unit"),
        (lambda: bd.Solid.make_cylinder(1, 30), Placement(face=0), r"meets itself"),
    ],
)
def test_bad_input_is_named_and_nothing_written(kit: Path, shape: Any, placement: Placement, message: str) -> None:
    with pytest.raises(SpecError, match=message):
        emboss(kit, shape(), placement=placement)
    assert sorted(path.name for path in kit.parent.iterdir()) == ["kit", "part.step"]


@pytest.mark.parametrize("data", [b"", b"rubbish", b"ISO-10303-21;\nHEADER;\nrubbish", "half"])
def test_unreadable_step_is_refused(kit: Path, data: bytes | str, capfd: pytest.CaptureFixture[str]) -> None:
    path = step_file(kit.parent / "part.step", plate())
    path.write_bytes(path.read_bytes()[:6000] if isinstance(data, str) else data)
    with pytest.raises(SpecError, match="SURFACE cannot be read as STEP"):
        emboss_kit(kit, path)
    assert capfd.readouterr() == ("", "")


def test_a_changed_step_of_a_part_is_caught_without_a_kernel(tmp_path: Path) -> None:
    made = emboss(make_kit(TapeSpec(sector=7, part="block", size_mm=(10.0, 10.0)), tmp_path / "kit").path, plate())
    assert verify_kit(made.path, quick=True).passed
    step = (made.path / made.files["step-solid"]).read_bytes()
    for data, says in (
        (step[:-200], "it is no whole"),
        (step.replace(b".MILLI.,.METRE.", b"$,.METRE."), "a unit of it is no millimetre"),
        (step.replace(b"LENGTH_MEASURE(1.E-07)", b"LENGTH_MEASURE(1.)"), "uncertain by 1 mm"),
        (b"ISO-10303-21;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n", "its solids are not each shown once"),
    ):
        part = OpenKit(made.path)
        part.data["step-solid"] = data
        lines = failed(verify_kit(part.save(consistent=True), quick=True))
        assert lines.keys() == {"step-solid"}
        assert says in lines["step-solid"].message


def test_unit_of_a_step_is_its_own(kit: Path) -> None:
    with pytest.raises(SpecError, match="a STEP file says its unit itself"):
        emboss(kit, plate(), unit="m")


def test_step_in_metres_is_read_in_mm(kit: Path) -> None:
    path = kit.parent / "part.step"
    bd.export_step(bd.Solid.make_box(0.03, 0.03, 0.005), path, unit=bd.Unit.M, timestamp="1980-01-01T00:00:00")
    made = emboss_kit(kit, path, placement=Placement(at_mm=(15.0, 15.0, 5.0)))
    assert made.surface["source_volume_mm3"] == pytest.approx(4500.0)
    assert read_back(made).volume == pytest.approx(4500 + made.tape.part_count * BLOCK_MM3, rel=1e-9)


@slow
@pytest.mark.parametrize("seed", range(some(4)))
def test_a_mutated_step_file_is_answered_from_its_own_process(seed: int, kit: Path) -> None:
    """OCCT crashes on some of these: in a process of its own."""
    random = Random(f"step {seed}")
    part = step_file(kit.parent / "part.step", bd.Solid.make_cylinder(20.0, 60.0))
    for _ in range(random.randint(1, 3)):
        part.write_bytes(random.choice(DAMAGES)(random, part.read_bytes()))
    try:
        made = emboss_kit(kit, part)
    except TactapeError as error:
        assert len(str(error).splitlines()) == 1
        assert sorted(path.name for path in kit.parent.iterdir()) == ["kit", "part.step"]
    else:
        assert all(check.passed for check in made.checks)


def in_two_files(folder: Path, shape: Any) -> Path:
    """A STEP file of an assembly whose one part is in another file, as OCCT writes it."""
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.STEPControl import STEPControl_StepModelType
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDocStd import TDocStd_Document
    from OCP.TopLoc import TopLoc_Location
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    document = TDocStd_Document(TCollection_ExtendedString("XCAF"))
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    part, whole = shapes.AddShape(shape.wrapped, False), shapes.NewShape()
    TDataStd_Name.Set_s(part, TCollection_ExtendedString("theirs"))
    shapes.AddComponent(whole, part, TopLoc_Location())
    shapes.UpdateAssemblies()
    writer = STEPCAFControl_Writer()
    assert writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs, "of-")
    writer.Write(str(folder / "whole.step"))
    assert (folder / "of-theirs.stp").is_file()
    return folder / "whole.step"


def test_no_other_file_is_read_with_a_step_file(tmp_path: Path) -> None:
    """OCCT reads what a file names, from any folder: another's part came out embossed, and a FIFO was waited for."""
    file = in_two_files(tmp_path, plate())
    data = file.read_bytes().replace(b"'of-theirs.stp'", f"'{tmp_path}/of-theirs.stp'".encode())
    with pytest.raises(SpecError, match="SURFACE names 1 other file, which would be read with it; export the part as one solid"):
        read_step_solid(data)


NEVER_ENDS = f"""
    import resource
    used, (within_s, most_s) = resource.getrusage(resource.RUSAGE_SELF), resource.getrlimit(resource.RLIMIT_CPU)
    used_s = used.ru_utime + used.ru_stime
    if not 0 < within_s <= used_s + {make_emboss.STEP_CPU_S}:
        raise RuntimeError("no limit, or another")
    resource.setrlimit(resource.RLIMIT_CPU, (int(used_s) + 1, most_s))
    while 1:
        pass
"""
"""Sees that it has a limit, and shortens it, for the time that takes."""


@costly
@pytest.mark.parametrize(
    ("deed", "says"),
    [("os.kill(os.getpid(), 11)", "ends its process"), (NEVER_ENDS, "takes too long")],
    ids=["crashes", "never ends"],
)
def test_a_kernel_that_crashes_or_never_ends_costs_its_own_process(deed: str, says: str, kit: Path) -> None:
    part = step_file(kit.parent / "part.step", bd.Solid.make_box(30.0, 30.0, 5.0))
    kernel = kit.parent / "modules" / "build123d"
    kernel.mkdir(parents=True)
    (kernel / "__init__.py").write_text(f"import os\ndef import_step(path):\n    {deed}\n", encoding="ascii")
    code = (
        "import sys; from tactape_fab.make import emboss; "
        f"sys.path.insert(0, {str(kernel.parent)!r}); emboss.emboss_kit({str(kit)!r}, {str(part)!r})"
    )
    run = subprocess.run(launch.python_command(code), capture_output=True, encoding="utf-8", check=False)
    assert f"SURFACE cannot be read as STEP: the CAD kernel {says} over it" in run.stderr
