"""Assets for simulators, opened by the software they are for: MuJoCo, a URDF reader, USD, glTF readers."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from cv2 import aruco

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.sense.objects.tag_view import tag_side_mm
from tactape_fab.texture.frames import FloatArray
from tests.conftest import _missing
from tests.surfaces import ball, emboss, kit_folder, planned
from tests.thorough import slow

WIDTH, HEIGHT, FOVY_DEG = 960, 720, 40.0


def reader(module: str, package: str) -> Any:
    """A library that reads assets; a visible skip where it is missing."""
    try:
        return import_module(module)
    except ImportError:
        _missing(module, f"pip install {package}")


@pytest.fixture(scope="module")
def mujoco() -> Any:
    os.environ.setdefault("MUJOCO_GL", "egl")  # without a display
    return reader("mujoco", "mujoco")


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    spec = TapeSpec(sector=100, size_mm=(30.0, 20.0), models=False, sim=True)
    return make_kit(spec, tmp_path_factory.mktemp("film") / "tactape-s100", verify=False)


@pytest.fixture(scope="module")
def wrapped(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    spec = TapeSpec(sector=8, part="dome", size_mm=(30.0, 20.0), cylinder_mm=12.0, sim=True)
    return make_kit(spec, tmp_path_factory.mktemp("wrapped") / "tactape-s008", verify=False)


@pytest.fixture(scope="module")
def embossed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    pytest.importorskip("manifold3d")
    folder = tmp_path_factory.mktemp("part")
    return emboss(kit_folder(folder / "kit", planned((10.0, 10.0))), ball(subdivisions=4), sim=True)


def sim_file(made: Any, ending: str) -> Path:
    (path,) = (path for path in (made.path / "sim").glob(f"*{ending}") if not path.stem.endswith("-hull"))
    return Path(path)


# MuJoCo


def look_at(place: FloatArray, target: FloatArray, up: tuple[float, float, float]) -> FloatArray:
    """Axes of a camera of MuJoCo as columns: x right, y up, z away from what it looks at."""
    z = (place - target) / np.linalg.norm(place - target)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def seen(mujoco: Any, file: Path, place: FloatArray, axes: FloatArray) -> tuple[Any, np.ndarray]:
    """Data and picture of a description with a camera.

    The picture is drawn by a process of its own: what OpenGL loads stays out of the tests'.
    """
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        try:
            return data, pool.submit(drawn, file, place, axes).result()
        except (RuntimeError, ImportError, AttributeError) as error:  # each way to OpenGL has its own
            _missing("OpenGL", f"install Debian's libegl1 and libgl1-mesa-dri ({error})")
    raise AssertionError


def drawn(file: Path, place: FloatArray, axes: FloatArray) -> np.ndarray:
    """Picture of a description by MuJoCo."""
    mujoco = import_module("mujoco")
    spec = mujoco.MjSpec.from_file(str(file))
    camera = spec.worldbody.add_camera()
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    camera.name, camera.pos, camera.quat, camera.fovy = "eye", place, quaternion, FOVY_DEG
    spec.visual.global_.offwidth, spec.visual.global_.offheight = WIDTH, HEIGHT
    spec.visual.map.znear = 0.01
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.7] * 3, [0.0] * 3
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, "eye")
        picture: np.ndarray = renderer.render()
    return picture


@pytest.mark.parametrize("name", ["world", "texture", "tag"])
def test_a_tape_may_have_the_name_of_a_frame(mujoco: Any, name: str, tmp_path: Path) -> None:
    spec = TapeSpec(sector=7, name=name, size_mm=(30.0, 20.0), models=False, sim=True)
    made = make_kit(spec, tmp_path / name, verify=False)
    model = mujoco.MjModel.from_xml_path(str(sim_file(made, ".xml")))
    assert [model.body(k).name for k in range(model.nbody)] == ["world", f"{name}_body"]
    robot = reader("yourdfpy", "yourdfpy").URDF.load(str(sim_file(made, ".urdf")), load_meshes=False)
    assert (robot.base_link, sorted(robot.link_map)) == (f"{name}_body", sorted([f"{name}_body", "tag", "texture"]))
    mujoco.MjModel.from_xml_path(str(sim_file(made, ".urdf")))


def test_a_model_that_includes_a_tape_keeps_its_own_angles(mujoco: Any, film: Kit) -> None:
    file = sim_file(film, ".xml")
    arm = '<body name="arm" euler="0 0 90"><joint name="wrist" range="-90 90"/><geom type="sphere" size="0.1"/></body>'
    whole = f'<mujoco><worldbody>{arm}</worldbody><include file="{file.name}"/></mujoco>'
    assets = {path.name: path.read_bytes() for path in file.parent.iterdir()}
    model = mujoco.MjModel.from_xml_string(whole, assets)
    assert model.body("arm").quat == pytest.approx([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    assert model.joint("wrist").range == pytest.approx([-np.pi / 2, np.pi / 2])
    assert film.tape.name in [model.body(k).name for k in range(model.nbody)]


CAMERAS = [((0.004, 0.003, 0.022), (0, 1, 0)), ((0.012, -0.008, 0.02), (0.3, 1, 0)), ((-0.005, 0.012, 0.03), (1, 0.2, 0))]


def pose_of_tag(gray: np.ndarray, side_m: float) -> tuple[int, FloatArray, FloatArray]:
    """Id of the one tag in a picture; its axes (x right, y down, z into it) as columns and centre in the camera's frame."""
    parameters = aruco.DetectorParameters()
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    detector = aruco.ArucoDetector(aruco.getPredefinedDictionary(aruco.DICT_APRILTAG_36h11), parameters)
    (corners,), number, _ = detector.detectMarkers(gray)
    focal = HEIGHT / 2 / np.tan(np.radians(FOVY_DEG / 2))
    lens = np.array([[focal, 0, (WIDTH - 1) / 2], [0, focal, (HEIGHT - 1) / 2], [0, 0, 1]])  # pixel centres are whole numbers
    # OpenCV's dictionary holds each tag turned by 180 degrees: its first corner is the tag's lower right
    square = side_m / 2 * np.array([(1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0)], dtype=float)
    _, turn, place = cv2.solvePnP(square, corners[0], lens, np.zeros(4), flags=cv2.SOLVEPNP_IPPE)
    return int(np.ravel(number)[0]), cv2.Rodrigues(turn)[0], place.ravel()


@slow
@pytest.mark.parametrize(("place", "up"), CAMERAS)
def test_a_camera_in_mujoco_finds_the_tag_where_it_is(mujoco: Any, film: Kit, place: Any, up: Any) -> None:
    tag = film.tape.tag
    assert tag is not None
    at = np.array(place)
    axes = look_at(at, np.array([tag.center_mm[0] / 1000 + 0.002, tag.center_mm[1] / 1000 + 0.001, 0.0]), up)
    data, picture = seen(mujoco, sim_file(film, ".xml"), at, axes)
    gray = np.ascontiguousarray(picture.mean(axis=2).astype(np.uint8))
    number, turn, place_m = pose_of_tag(gray, tag_side_mm(film.tape) / 1000)
    assert number == tag.id
    opencv = axes * (1, -1, -1)
    true_turn = opencv.T @ data.site("tag").xmat.reshape(3, 3)
    true_place = opencv.T @ (data.site("tag").xpos - at)
    assert place_m == pytest.approx(true_place, abs=0.004 * true_place[2])
    angle = np.degrees(np.arccos(np.clip((np.trace(turn.T @ true_turn) - 1) / 2, -1, 1)))
    assert angle < 2.0


def test_the_tag_s_site_is_where_the_manifest_has_it(mujoco: Any, film: Kit) -> None:
    tag, origin = film.tape.tag, film.tape.board.texture_origin_mm
    assert tag is not None
    model = mujoco.MjModel.from_xml_path(str(sim_file(film, ".xml")))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for name, place_mm in (("tag", tag.center_mm), ("texture", origin)):
        assert 1000 * data.site(name).xpos == pytest.approx([*place_mm, 0.0], abs=1e-6)
        assert data.site(name).xmat == pytest.approx(np.diag([1.0, -1.0, -1.0]).ravel(), abs=1e-9)


@slow
def test_what_is_drawn_is_a_film_with_dark_parts(mujoco: Any, film: Kit) -> None:
    at = np.array([0.016, 0.010, 0.045])
    _, picture = seen(mujoco, sim_file(film, ".xml"), at, look_at(at, at * (1, 1, 0), (0, 1, 0)))
    focal = HEIGHT / 2 / np.tan(np.radians(FOVY_DEG / 2))
    xy = film.tape.part_xy_mm() / 1000
    px = focal / (at[2] - 0.00023) * (xy - at[:2]) * (1, -1) + (WIDTH / 2, HEIGHT / 2)
    u, v = np.rint(px - 0.5).astype(int).T
    on = (u > 3) & (v > 3) & (u < WIDTH - 3) & (v < HEIGHT - 3)
    assert on.mean() > 0.9
    dark = picture.max(axis=2) < 60
    assert dark[v[on], u[on]].mean() > 0.95  # in the middle of each part's body
    assert dark[v[on], np.minimum(u[on] + 12, WIDTH - 1)].mean() < 0.1  # half a millimetre beside it


@pytest.mark.parametrize("kind", ["film", "wrapped", "embossed"])
def test_a_ball_falls_on_it_and_stays_outside(mujoco: Any, kind: str, request: pytest.FixtureRequest) -> None:
    made = request.getfixturevalue(kind)
    spec = mujoco.MjSpec.from_file(str(sim_file(made, ".xml")))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    visual = model.geom("visual")
    assert model.geom_contype[visual.id] == 0 and model.ngeom >= 2
    points = np.array(trimesh.load(sim_file(made, ".obj"), process=False).vertices)
    top = points[np.argmax(points[:, 2])]
    radius = 0.004
    ball_spec = spec.worldbody.add_body()
    ball_spec.name, ball_spec.pos = "ball", [top[0], top[1], top[2] + radius + 0.002]
    joint, geom = ball_spec.add_joint(), ball_spec.add_geom()
    joint.type, joint.axis = mujoco.mjtJoint.mjJNT_SLIDE, [0, 0, 1]
    geom.type, geom.size[0] = mujoco.mjtGeom.mjGEOM_SPHERE, radius
    spec.option.timestep = 2e-4
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(2500):
        mujoco.mj_step(model, data)
    low = data.body("ball").xpos[2] - radius
    assert top[2] - 0.0006 < low < top[2] + 0.0002  # on the base: parts are no obstacle, and the solver is a little soft


def test_mass_and_inertia_are_those_of_a_filled_mesh(mujoco: Any, wrapped: Kit) -> None:
    mesh = trimesh.load(sim_file(wrapped, ".obj"))
    mesh.density = 1200.0
    model = mujoco.MjModel.from_xml_path(str(sim_file(wrapped, ".xml")))
    assert model.body_mass[1] == pytest.approx(mesh.mass, rel=1e-3)
    assert model.body_ipos[1] == pytest.approx(mesh.center_mass, abs=1e-6)
    assert np.sort(model.body_inertia[1]) == pytest.approx(np.sort(np.linalg.eigvalsh(mesh.moment_inertia)), rel=1e-3)


# URDF, USD, glTF


@pytest.mark.filterwarnings("ignore:`Scene.dump:DeprecationWarning")  # yourdfpy's own
@pytest.mark.parametrize("kind", ["film", "wrapped", "embossed"])
def test_a_urdf_reader_loads_link_collision_and_inertia(kind: str, request: pytest.FixtureRequest) -> None:
    yourdfpy = reader("yourdfpy", "yourdfpy")
    made = request.getfixturevalue(kind)
    robot = yourdfpy.URDF.load(str(sim_file(made, ".urdf")), load_collision_meshes=True, build_collision_scene_graph=True)
    assert robot.validate()
    link = robot.robot.links[0]
    assert link.inertial.mass > 0 and np.linalg.eigvalsh(link.inertial.inertia).min() > 0
    looks, collides = np.array(robot.scene.bounds), np.array(robot.collision_scene.bounds)
    assert np.abs(looks - collides).max() < 0.0006  # but for the elements, and a cylinder's polygon
    if kind == "film":
        tag = made.tape.tag
        assert 1000 * robot.get_transform("tag", made.tape.name)[:3, 3] == pytest.approx([*tag.center_mm, 0], abs=1e-6)
        assert looks == pytest.approx(np.array([(0, 0, -0.11e-3), (0.03, 0.02, 0.23e-3)]), abs=1e-7)


@pytest.mark.parametrize("kind", ["film", "wrapped", "embossed"])
def test_usd_has_the_same_body(kind: str, request: pytest.FixtureRequest) -> None:
    reader("pxr", "usd-core")
    from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

    made = request.getfixturevalue(kind)
    stage = Usd.Stage.Open(str(sim_file(made, ".usda")))
    root = stage.GetDefaultPrim()
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0 and UsdGeom.GetStageUpAxis(stage) == "Z"
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(root.GetPath().AppendChild("visual")))
    other = trimesh.load(sim_file(made, ".obj"), process=False)
    assert np.array(mesh.GetPointsAttr().Get()) == pytest.approx(other.vertices, abs=2e-7)
    assert len(mesh.GetFaceVertexIndicesAttr().Get()) == 3 * len(other.faces)
    material = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()[0]
    assert material.ComputeSurfaceSource()[0].GetIdAttr().Get() == "UsdPreviewSurface"
    mass = UsdPhysics.MassAPI(root)
    robot = reader("yourdfpy", "yourdfpy").URDF.load(str(sim_file(made, ".urdf")), load_meshes=False)
    inertial = robot.robot.links[0].inertial
    assert mass.GetMassAttr().Get() == pytest.approx(inertial.mass, rel=1e-6)
    turn = rotation_of(mass.GetPrincipalAxesAttr().Get())
    again = turn @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn.T
    assert again == pytest.approx(inertial.inertia, rel=1e-3, abs=1e-5 * np.abs(inertial.inertia).max())
    collides = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert len(collides) == len(robot.robot.links[0].collisions)


def rotation_of(quaternion: Any) -> FloatArray:
    """The matrix of USD's quaternion."""
    w, (x, y, z) = quaternion.GetReal(), quaternion.GetImaginary()
    skew = np.array([(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)])
    turned: FloatArray = np.eye(3) + 2 * w * skew + 2 * skew @ skew
    return turned


@pytest.mark.parametrize("kind", ["film", "wrapped"])
def test_gltf_has_a_sheet_with_colours_and_a_normal_map(kind: str, request: pytest.FixtureRequest) -> None:
    gltf = reader("pygltflib", "pygltflib")
    made = request.getfixturevalue(kind)
    found = gltf.GLTF2().load(str(sim_file(made, ".glb")))
    assert found.materials[0].normalTexture is not None
    coloured = found.materials[0].pbrMetallicRoughness.baseColorTexture is not None
    assert coloured == (kind == "film")
    loaded = trimesh.load(sim_file(made, ".glb"))
    size = made.tape.board.size_mm
    extent = np.ptp(loaded.bounds, axis=0)  # y is up: x, height, and -y of the board
    assert extent[2] == pytest.approx(size[1] / 1000, abs=1e-6)
    if kind == "film":
        assert extent == pytest.approx([size[0] / 1000, 0.0, size[1] / 1000], abs=1e-6)
        (mesh,) = loaded.geometry.values()
        picture = np.asarray(mesh.visual.material.baseColorTexture)
        tag = made.tape.tag
        corner = np.array(tag.center_mm) + (4.5 * tag.cell_mm) * np.array([1, 1])  # in the ring's upper right corner
        u, v = np.array([corner[0] / size[0], 1 - corner[1] / size[1]]) * picture.shape[1::-1]
        assert picture[int(v), int(u), :3].min() > 200  # white ink, there and nowhere above the tag
        assert picture[int(v - 40), int(u), :3].min() < 100
