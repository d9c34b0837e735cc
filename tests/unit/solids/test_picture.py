"""Pictures of meshes: the nearest face is seen at every sample, whatever it is compared with by brute force."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from tactape_fab.base.errors import RenderError
from tactape_fab.solids.elements import closed_element
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.picture import _nearest_faces, png_bytes, shaded, view_frame
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.part import TapePart

BLOCK = TapePart(name="block", shape="block", body_mm=(0.6, 0.3, 0.2), rotation_deg=0.0)


def block() -> Mesh:
    vertices, faces = closed_element(BLOCK, 0.1)
    return Mesh(vertices_mm=vertices, faces=faces)


def from_above(mesh: Mesh, width_px: int, margin: float = 0.03) -> npt.NDArray[np.uint8]:
    return shaded(mesh, direction=(0.0, 0.0, 1.0), up=(0.0, 1.0, 0.0), width_px=width_px, margin=margin)


def nearest_by_brute_force(corners: FloatArray, shape: tuple[int, int]) -> tuple[IntArray, FloatArray]:
    """Every sample against every triangle, by barycentric coordinates; with how far inside its triangle it lies."""
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
    face, depth, inside = np.full(shape, -1), np.full(shape, -np.inf), np.full(shape, np.inf)
    for i, (a, b, c) in enumerate(corners):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        w1 = ((u - a[0]) * (c[1] - a[1]) - (v - a[1]) * (c[0] - a[0])) / area
        w2 = ((b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0])) / area
        least = np.minimum(np.minimum(w1, w2), 1 - w1 - w2)
        z = a[2] + w1 * (b[2] - a[2]) + w2 * (c[2] - a[2])
        hit = (least >= 0) & (z > depth)
        face[hit], depth[hit] = i, z[hit]
        inside = np.minimum(inside, np.abs(least))
    return face, inside


@pytest.mark.parametrize("seed", range(10))
def test_every_sample_sees_the_nearest_face(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (60, 80)
    corners = rng.uniform((-10, -10, 0), (90, 70, 50), (1, 3))[:, None] + rng.uniform(-40, 40, (30, 3, 3))
    seen = _nearest_faces(corners, np.arange(len(corners)), shape)
    expected, inside = nearest_by_brute_force(corners, shape)
    clear = inside > 1e-6  # not on an edge
    assert clear.mean() > 0.9
    assert (expected[clear] >= 0).any()
    assert np.array_equal(seen.face[clear], expected[clear])


def test_a_mesh_in_many_pieces_is_drawn_as_one(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = from_above(block(), 60)
    monkeypatch.setattr("tactape_fab.solids.picture._SAMPLES_AT_ONCE", 50)
    assert np.array_equal(from_above(block(), 60), whole)


def test_the_picture_shows_the_object_where_it_is() -> None:
    image = from_above(block(), 300, 0.1)
    assert image.shape == (175, 300, 3)
    assert image.dtype == np.uint8
    dark = np.argwhere(image.max(axis=2) < 250)
    (top, left), (bottom, right) = dark.min(axis=0), dark.max(axis=0)
    assert (left, right) == pytest.approx((25, 274), abs=1)
    assert (top, bottom) == pytest.approx((25, 149), abs=1)
    assert (image[0] == 255).all()


def test_up_is_up_and_light_comes_from_the_upper_left() -> None:
    """A small block on a large one, at its upper right: its shadow falls away from the light."""
    vertices, faces = closed_element(BLOCK, 0.0)
    large = vertices * (10.0, 10.0, 1.0) - (0.0, 0.0, 0.2)
    small = vertices * (2.0, 2.0, 3.0) + (1.5, 0.8, 0.0)
    mesh = Mesh(vertices_mm=np.concatenate([large, small]), faces=np.concatenate([faces, faces + len(vertices)]))
    image = from_above(mesh, 400, 0.0).astype(int)
    px_per_mm = 400 / 6.0

    def brightness(x_mm: float, y_mm: float) -> float:
        u, v = int((x_mm + 3.0) * px_per_mm), int((1.5 - y_mm) * px_per_mm)
        return float(image[v - 2 : v + 3, u - 2 : u + 3].mean())

    base = brightness(-2.0, -1.0)
    assert brightness(1.5, 0.45) < base - 20  # below the small block
    assert brightness(1.5, 1.15) == pytest.approx(base, abs=3)  # above it
    assert brightness(1.5, 0.8) == pytest.approx(base, abs=3)  # its own top


def test_equal_meshes_give_equal_bytes() -> None:
    one, other = (png_bytes(shaded(block(), direction=(-0.3, -0.6, 0.8), up=(0.0, 0.0, 1.0), width_px=200)) for _ in range(2))
    assert one == other
    image = cv2.imdecode(np.frombuffer(one, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape[1] == 200


def test_the_frame_of_a_view_is_a_rotation() -> None:
    frame = view_frame((1.0, 2.0, 3.0), (0.0, 0.0, 1.0))
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    assert frame[2] == pytest.approx(np.array([1.0, 2.0, 3.0]) / np.sqrt(14))
    assert frame[0][2] == pytest.approx(0.0, abs=1e-12)


def test_a_slender_object_keeps_within_the_largest_picture() -> None:
    vertices, faces = closed_element(BLOCK, 0.1)
    tall = Mesh(vertices_mm=vertices * (1.0, 100.0, 1.0), faces=faces)
    image = from_above(tall, 1000)
    assert max(image.shape) <= 6002


@pytest.mark.parametrize(
    ("mesh", "direction", "up"),
    [
        (Mesh(vertices_mm=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64)), (0, 0, 1), (0, 1, 0)),
        (Mesh(vertices_mm=np.zeros((3, 3)), faces=np.array([(0, 1, 2)])), (0, 0, 1), (0, 1, 0)),
        (Mesh(vertices_mm=np.full((3, 3), np.nan), faces=np.array([(0, 1, 2)])), (0, 0, 1), (0, 1, 0)),
        (block(), (0, 0, 1), (0, 0, 2)),
        (block(), (0, 0, 0), (0, 1, 0)),
    ],
    ids=["empty", "a point", "nan", "up is towards the viewer", "no direction"],
)
def test_what_cannot_be_drawn_is_refused(
    mesh: Mesh, direction: tuple[float, float, float], up: tuple[float, float, float]
) -> None:
    with pytest.raises(RenderError):
        shaded(mesh, direction=direction, up=up, width_px=100)
