"""The camera's side: from a tag's pose to texture coordinates and back, on pictures of a written preview, too."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from tactape_fab import Kit, pixels_to_texture, refine_tag_pose, tag_side_mm, tag_to_texture, texture_to_pixels
from tactape_fab.base.errors import FrameError, SpecError
from tactape_fab.sense.objects.tag_view import camera_arrays, tag_corners_mm
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tag import tag_cells
from tactape_fab.texture.tape import Tape
from tests.bench import camera
from tests.thorough import only_thorough, slow

pytestmark = pytest.mark.usefixtures("kits_as_elsewhere")  # their pictures are looked at

CAMERA = np.array([[1000.0, 0.0, 640.0], [0.0, 1100.0, 480.0], [0.0, 0.0, 1.0]])
POSE = (np.asarray(cv2.Rodrigues(np.array([0.3, -0.2, 1.0]))[0]), np.array([10.0, -20.0, 280.0]))


@pytest.fixture(params=[0.0, 90.0], ids=["upright", "turned"])
def tape(small_kit: Kit, request: pytest.FixtureRequest) -> Tape:
    assert small_kit.tape.tag is not None
    return replace(small_kit.tape, tag=replace(small_kit.tape.tag, rotation_deg=request.param))


def test_the_tag_s_frame_is_apriltag_s(tape: Tape) -> None:
    assert tape.tag is not None
    half, (x0, y0) = tag_side_mm(tape) / 2, tape.board.texture_origin_mm
    assert tag_side_mm(tape) == 8 * tape.tag.cell_mm
    # AprilRobotics: x right, y down; corners from the lower left, counter-clockwise
    in_tag = np.array([(-half, half, 0, 1), (half, half, 0, 1), (half, -half, 0, 1), (-half, -half, 0, 1)])
    in_texture = in_tag @ tag_to_texture(tape).T
    board = tag_corners_mm(tape)
    assert in_texture[:, :2] == pytest.approx(np.stack([board[:, 0] - x0, y0 - board[:, 1]], axis=1))
    right = board[1] - board[0]
    angle = np.radians(tape.tag.rotation_deg)
    assert right / np.linalg.norm(right) == pytest.approx([np.cos(angle), np.sin(angle)], abs=1e-9)


@pytest.mark.parametrize("distortion", [None, [-0.2, 0.05, 0.001, -0.002, 0.0]])
def test_pixels_and_texture_are_inverse(tape: Tape, distortion: list[float] | None) -> None:
    points = np.array([(0.0, 0.0), (30.0, 5.0), (-4.0, 22.0)])
    pixels = texture_to_pixels(tape, points, *POSE, CAMERA, distortion)
    assert pixels_to_texture(tape, pixels, *POSE, CAMERA, distortion) == pytest.approx(points, abs=1e-3)
    # by hand, without a lens: through the tag's own frame
    if distortion is None:
        in_tag = np.linalg.inv(tag_to_texture(tape)) @ [30.0, 5.0, 0.0, 1.0]
        x, y, z = POSE[0] @ in_tag[:3] + POSE[1]
        assert pixels[1] == pytest.approx([1000 * x / z + 640, 1100 * y / z + 480])


@pytest.mark.parametrize("distortion", [[-0.35, 0.12, 5e-4, 2e-4, -0.02], [-0.4, 0.2, 0.0, 0.0], [0.3, -0.1, 0.0, 0.0, 0.05]])
def test_pixels_at_the_sides_of_a_wide_lens_are_where_they_see(tape: Tape, distortion: list[float]) -> None:
    u, v = np.meshgrid(np.linspace(0.0, 1279.0, 9), np.linspace(0.0, 959.0, 7))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    seen = pixels_to_texture(tape, pixels, *POSE, CAMERA, distortion)
    assert texture_to_pixels(tape, seen, *POSE, CAMERA, distortion) == pytest.approx(pixels, abs=1e-6)


def test_rays_that_miss_the_film_hit_nothing(tape: Tape) -> None:
    edge_on = np.asarray(cv2.Rodrigues(np.array([np.pi / 2 - 0.05, 0.0, 0.0]))[0])
    hit = pixels_to_texture(tape, [(640.0, -3000.0), (640.0, 480.0)], edge_on, (0.0, 20.0, 300.0), CAMERA)
    behind = texture_to_pixels(tape, [(0.0, 0.0)], POSE[0], (0.0, 0.0, -300.0), CAMERA)
    assert np.isnan(hit).any() and np.isnan(behind).all()


def test_what_is_no_pose_is_refused(tape: Tape) -> None:
    for rotation, shift in (
        (np.eye(2), (0, 0, 1)),
        (2 * np.eye(3), (0, 0, 1)),
        (-np.eye(3), (0, 0, 1)),
        (np.eye(3), (0, 0, np.nan)),
    ):
        with pytest.raises(SpecError, match=r"pose|rotation"):
            pixels_to_texture(tape, [(0, 0)], rotation, shift, CAMERA)
    with pytest.raises(SpecError, match="carries no tag"):
        tag_to_texture(replace(tape, tag=None))


# Pictures


@only_thorough
def test_points_of_the_texture_are_seen_within_a_tenth_of_a_millimetre() -> None:
    pytest.importorskip("pupil_apriltags")
    large = camera.measure(2.0, 3)
    assert large["found"] == 3
    assert large["refined, whole"]["max_mm"] <= 0.1
    middle = camera.measure(1.0, 3)
    assert middle["refined, near"]["max_mm"] <= 0.1
    assert middle["refined, whole"]["p95_mm"] < middle["detector, whole"]["p95_mm"]


def test_a_mirrored_tilt_is_put_right() -> None:
    of, rng = camera.printed(2.0), np.random.default_rng(5)
    turn, shift = camera.draw_pose(of.tape, rng)
    picture = camera.photograph(of, turn, shift, rng)
    half = tag_side_mm(of.tape) / 2
    square = np.array([(-half, half, 0.0), (half, half, 0.0), (half, -half, 0.0), (-half, -half, 0.0)])
    corners = np.reshape(cv2.projectPoints(square, cv2.Rodrigues(turn)[0], shift, camera.CAMERA, None)[0], (-1, 2))
    _, turns, shifts, _ = cv2.solvePnPGeneric(square, corners, camera.CAMERA, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    mirrored, there = np.asarray(cv2.Rodrigues(turns[1])[0]), np.ravel(shifts[1])
    assert np.abs(mirrored - turn).max() > 0.1
    found = refine_tag_pose(of.tape, picture, mirrored, there, camera.CAMERA)
    assert found.fit > 0.99 and 0.3 < found.blur_px < 1.0
    assert found.rotation == pytest.approx(turn, abs=2e-3) and found.translation_mm == pytest.approx(shift, abs=0.2)


def test_of_two_tilts_that_look_alike_the_chance_of_the_other_is_said() -> None:
    """The one that was taken is right as often as is said: of tags of 1.4 px per cell a third are mirrored."""
    said, wrong = [], []
    for cell_mm, seed in ((0.35, 0), (0.35, 1), (0.35, 3), (0.35, 4), (2.0, 5)):
        of, rng = camera.printed(cell_mm), np.random.default_rng(seed)
        turn, shift = camera.draw_pose(of.tape, rng)
        found = refine_tag_pose(of.tape, camera.photograph(of, turn, shift, rng), turn, shift, camera.CAMERA)
        said.append(found.p_mirrored)
        wrong.append(np.degrees(np.arccos((np.trace(found.rotation.T @ turn) - 1.0) / 2.0)) > 5.0)
    assert max(said[:-1]) > 0.2 and all(0.0 <= p <= 0.5 for p in said)
    assert said[-1] < 1e-9 and not wrong[-1]
    assert all(p > 0.05 for p, off in zip(said, wrong, strict=True) if off)


@only_thorough
def test_small_tags_are_mirrored_as_often_as_is_said() -> None:
    """Of 1.4 to 2 px per cell; the number that is mirrored is a sum of chances, each of variance p (1 - p)."""
    said, wrong = [], 0
    for k in range(80):
        of, rng = camera.printed((0.35, 0.5)[k % 2]), np.random.default_rng(1000 + k)
        turn, shift = camera.draw_pose(of.tape, rng)
        found = refine_tag_pose(of.tape, camera.photograph(of, turn, shift, rng), turn, shift, camera.CAMERA)
        said.append(found.p_mirrored)
        wrong += bool(np.degrees(np.arccos(min((np.trace(found.rotation.T @ turn) - 1.0) / 2.0, 1.0))) > 3.0)
    p = np.array(said)
    assert wrong >= 3 and abs(wrong - p.sum()) < 3.0 * np.sqrt((p * (1.0 - p)).sum())


@pytest.mark.parametrize("known", [True, False], ids=["lens known", "lens not known"])
def test_a_detector_s_pose_is_refined_whether_it_knows_the_lens_or_not(known: bool) -> None:
    """AprilTag takes every camera for a pinhole: through a lens its pose is far off, and the tag not where it says."""
    lens = np.array([-0.2, 0.06, 0.001, -0.0005, 0.0])
    of, rng = camera.printed(2.0), np.random.default_rng(5)
    turn, shift = np.asarray(cv2.Rodrigues(np.array([0.4, 0.2, 0.5]))[0]), np.array([-75.0, 50.0, 260.0])
    straight = camera.photograph(of, turn, shift, rng)
    (width, height), half = camera.SIZE_PX, tag_side_mm(of.tape) / 2
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(np.float64)
    # where the straight picture has what each pixel sees, within a hundredth of a pixel
    at = np.reshape(cv2.undistortPoints(pixels, camera.CAMERA, lens, P=camera.CAMERA), (-1, 2))
    map_u, map_v = at.T.reshape(2, height, width).astype(np.float32)
    picture = np.asarray(cv2.remap(straight, map_u, map_v, cv2.INTER_CUBIC), dtype=np.uint8)
    square = np.array([(-half, half, 0.0), (half, half, 0.0), (half, -half, 0.0), (-half, -half, 0.0)])
    corners = np.reshape(cv2.projectPoints(square, cv2.Rodrigues(turn)[0], shift, camera.CAMERA, lens)[0], (-1, 2))
    taken = lens if known else None
    _, told, there = cv2.solvePnP(square, corners, camera.CAMERA, taken, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    found = refine_tag_pose(of.tape, picture, np.asarray(cv2.Rodrigues(told)[0]), np.ravel(there), camera.CAMERA, lens)
    assert found.fit > 0.99
    assert found.rotation == pytest.approx(turn, abs=5e-3) and found.translation_mm == pytest.approx(shift, abs=0.3)


def from_above(cell_px: int, blur_px: float = 0.7) -> tuple[Tape, camera.Picture, FloatArray, FloatArray]:
    """A tag whose middle lies on the camera's axis, seen at a right angle: tape, picture, camera, the tag's place there."""
    of = camera.printed(2.0).tape
    assert of.tag is not None
    side = 14 * cell_px
    picture = np.zeros((side, side), dtype=np.uint8)
    cells = np.kron(255 * tag_cells(of.tag.id).astype(np.uint8), np.ones((cell_px, cell_px), dtype=np.uint8))
    picture[2 * cell_px : -2 * cell_px, 2 * cell_px : -2 * cell_px] = cells
    matrix = np.array([[1000.0, 0.0, (side - 1) / 2], [0.0, 1000.0, (side - 1) / 2], [0.0, 0.0, 1.0]])
    return of, cv2.GaussianBlur(picture, (0, 0), blur_px), matrix, np.array([0.0, 0.0, 1000.0 * of.tag.cell_mm / cell_px])


def test_a_tag_of_more_pixels_than_16_bits_count_is_refined() -> None:
    of, picture, matrix, there = from_above(21)
    found = refine_tag_pose(of, picture, np.eye(3), there + np.array([0.1, -0.1, 0.0]), matrix)
    assert (9 * 21) ** 2 > 2**15 and found.fit > 0.99
    # that of the picture, 0.7 px, without the smoothing for the fit, 2.2 px, nor the printed picture's own pixels, 1.3 px wide
    assert 0.4 < found.blur_px < 0.8
    assert found.translation_mm == pytest.approx(there, abs=0.1)


@pytest.mark.parametrize("times", [0.8, 0.87, 1.15, 1.25])
def test_a_pose_too_near_or_too_far_leads_to_the_tag(times: float) -> None:
    """A detector that is told the side of the light ring, 10 cells for 8, is a quarter off."""
    of, picture, matrix, there = from_above(6)
    found = refine_tag_pose(of, picture, np.asarray(cv2.Rodrigues(np.array([0.02, 0.03, 0.01]))[0]), times * there, matrix)
    assert found.fit > 0.99 and found.translation_mm == pytest.approx(there, abs=0.3)


def test_light_that_falls_across_the_tag_leaves_its_pose() -> None:
    of, picture, matrix, there = from_above(6)
    fall = np.linspace(1.0, 0.25, picture.shape[1]) * np.linspace(0.9, 1.0, picture.shape[0])[:, None]
    found = refine_tag_pose(of, (40.0 + picture * 0.8 * fall).astype(np.uint8), np.eye(3), there, matrix)
    assert found.fit > 0.99 and found.translation_mm == pytest.approx(there, abs=0.3)
    assert np.abs(found.rotation - np.eye(3)).max() < 0.01


@pytest.mark.parametrize(("seed", "most_deg"), [(3, 1.0), (6, 0.5)])
def test_a_small_tag_is_found_along_the_valley_of_its_tilts(seed: int, most_deg: float) -> None:
    """From a start 3 % too far, as detectors have it, a pose's own fit was 11.5 and 0.9 degrees off after 40 steps."""
    of, rng = camera.printed(0.5), np.random.default_rng(seed)
    turn, shift = camera.draw_pose(of.tape, rng)
    found = refine_tag_pose(of.tape, camera.photograph(of, turn, shift, rng), turn, 1.03 * shift, camera.CAMERA)
    assert np.degrees(np.arccos((np.trace(found.rotation.T @ turn) - 1.0) / 2.0)) < most_deg


@pytest.mark.parametrize("kind", ["noise", "checks", "covered"])
def test_a_refusal_is_a_few_hundred_looks_at_the_tag(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 2400 and 4100 each took a millisecond."""
    of, picture, matrix, there = from_above(6)
    shown = {
        "noise": np.random.default_rng(1).integers(0, 255, picture.shape).astype(np.uint8),
        "checks": (255 * (np.indices(picture.shape) // 9).sum(axis=0) % 510).astype(np.uint8),
        "covered": np.where(np.arange(len(picture)) > 62, 255, picture).astype(np.uint8),
    }[kind]
    remap = Mock(wraps=cv2.remap)
    monkeypatch.setattr(cv2, "remap", remap)
    with pytest.raises(FrameError, match="does not show all of tag 7"):
        refine_tag_pose(of, shown, np.eye(3), there, matrix)
    assert 5 < remap.call_count < 400


@pytest.mark.parametrize(("level", "share"), [(0, 0.1), (128, 0.2), (220, 0.08), (255, 0.07), (255, 0.1), (255, 0.15)])
def test_a_tag_that_is_partly_covered_is_refused(level: int, share: float) -> None:
    of, picture, matrix, there = from_above(6)
    covered = picture.copy()
    covered[:, round((0.5 + 9 / 14 * (0.5 - share)) * len(picture)) :] = level
    with pytest.raises(
        FrameError,
        match=r"does not show all of tag 7 .*spot off by \d+% .*border off by 0\.\d\d cells.*in which nothing covers it",
    ):
        refine_tag_pose(of, covered, np.eye(3), there, matrix)
    assert refine_tag_pose(of, picture, np.eye(3), there, matrix).fit > 0.99


def test_a_noisy_picture_of_little_contrast_is_no_cover() -> None:
    of, picture, matrix, there = from_above(6)
    noise = np.random.default_rng(1).normal(0.0, 3.0, picture.shape)
    found = refine_tag_pose(of, np.rint(60.0 + picture * 0.1 + noise).astype(np.uint8), np.eye(3), there, matrix)
    assert 0.9 < found.fit < 0.98 and found.translation_mm == pytest.approx(there, abs=1.0)


@slow
def test_pictures_without_the_tag_are_refused() -> None:
    of, rng = camera.printed(2.0), np.random.default_rng(5)
    pose = camera.draw_pose(of.tape, rng)
    height_px, width_px = camera.SIZE_PX[::-1]
    noise = rng.integers(0, 255, (height_px, width_px), dtype=np.uint8)
    with pytest.raises(FrameError, match="does not show all of tag 7 there"):
        refine_tag_pose(of.tape, noise, *pose, camera.CAMERA)
    with pytest.raises(FrameError, match="does not show all of tag 7 there"):
        refine_tag_pose(of.tape, np.zeros_like(noise), *pose, camera.CAMERA)
    # border and ring are those of every tag: another one, a quarter turn, OpenCV's axes (y up, z out, turned by 180)
    picture, turn, shift = camera.photograph(of, *pose, rng), *pose
    assert of.tape.tag is not None
    another = replace(of.tape, tag=replace(of.tape.tag, id=8))
    quarter = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
    assert refine_tag_pose(of.tape, picture, turn, shift, camera.CAMERA).fit > 0.99
    for tape, told in ((another, turn), (of.tape, turn @ quarter), (of.tape, turn @ np.diag([-1.0, 1.0, -1.0]))):
        with pytest.raises(FrameError, match=r"does not show all of tag [78] there .* with x right and y down on it"):
            refine_tag_pose(tape, picture, told, shift, camera.CAMERA)
    with pytest.raises(FrameError, match="not wholly inside"):
        refine_tag_pose(of.tape, noise, pose[0], pose[1] + [300.0, 0.0, 0.0], camera.CAMERA)
    with pytest.raises(FrameError, match="not wholly in front"):
        refine_tag_pose(of.tape, noise, pose[0], -pose[1], camera.CAMERA)
    with pytest.raises(FrameError, match="covers"):
        refine_tag_pose(of.tape, noise, pose[0], pose[1] * 40, camera.CAMERA)
    with pytest.raises(FrameError, match="gray levels"):
        refine_tag_pose(of.tape, np.zeros((4, 4)), *pose, camera.CAMERA)
    with pytest.raises(SpecError, match="camera_matrix"):
        refine_tag_pose(of.tape, noise, *pose, np.eye(2))


@pytest.mark.parametrize(
    ("matrix", "lens", "says"),
    [
        ([[0.5, 0, 640], [0, 0.7, 480], [0, 0, 1]], [0.0] * 12, None),
        ([[0, 0, 640], [0, 900, 480], [0, 0, 1]], None, "camera_matrix"),
        ([[900, 1, 640], [0, 900, 480], [0, 0, 1]], None, "camera_matrix"),
        ([[900, 0, 640], [0, 900, 480], [0, 0, 1]], [0.0] * 13, "distortion has 13 values"),
    ],
)
def test_a_camera_is_one_without_skew_and_with_a_lens_of_opencv_s(
    matrix: list[list[float]], lens: list[float] | None, says: str | None
) -> None:
    if says is None:
        assert camera_arrays(matrix, lens)[0].tolist() == matrix
    else:
        with pytest.raises(SpecError, match=says):
            camera_arrays(matrix, lens)
