"""Images to depth: the network's arithmetic, the integral of slopes, the sign, and `decode --raw` from end to end."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from click.testing import Result

from tactape_fab import Kit
from tactape_fab.base.errors import FrameError, Problem, SpecError
from tactape_fab.sense import Scene, load_network, load_sensor, make_reconstruction, simulate_frames
from tactape_fab.sense.files.jobs import Raw, prepare
from tactape_fab.sense.raw.colour_images import open_reconstruction
from tactape_fab.sense.raw.perceptron import BLOCK, of_pixels
from tactape_fab.sense.raw.reconstruct import integrated, make_network, slopes_of
from tests.commands import run
from tests.contacts import TAPE
from tests.raw_images import angles, features, image_of, plain_network, random_layers, tensors_of, weights_file

SCALE = (16.0, 16.0)
Taken = tuple[Path, npt.NDArray[np.float64]]


def noise_image(h: int, w: int, seed: int = 1) -> npt.NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (h, w, 3), dtype=np.uint8)


def picture(path: Path) -> npt.NDArray[np.uint8]:
    found = cv2.imread(str(path))
    assert found is not None
    return np.asarray(found, dtype=np.uint8)


@pytest.mark.parametrize("widths", [(5, 2), (5, 7, 2), (5, 32, 32, 32, 2), (5, 1, 9, 3, 2)])
@pytest.mark.parametrize("size", [(13, 17), (1, 1), (16, 2 * BLOCK // 16), (5, 211)])
def test_the_network_is_what_its_weights_say(widths: tuple[int, ...], size: tuple[int, int]) -> None:
    layers, image = random_layers(widths), noise_image(*size)
    network = make_network(layers)
    found = of_pixels(image, network.weights, network.biases, network.widths)
    np.testing.assert_allclose(found.reshape(2, -1).T, angles(features(image), layers), rtol=1e-4, atol=1e-5)


def test_a_surface_comes_back_from_its_slopes() -> None:
    """Half the slopes of two neighbours are the step between them exactly, where the surface is of the second degree."""
    u_px, v_px = np.meshgrid(np.arange(41), np.arange(30))
    u, v = u_px / 16.0, v_px / 13.0
    surface = 0.03 * u**2 - 0.05 * v**2 + 0.02 * u * v + 0.1 * u
    slopes = np.stack([0.06 * u + 0.02 * v + 0.1, -0.1 * v + 0.02 * u]).astype(np.float32)
    np.testing.assert_allclose(integrated(slopes, (16.0, 13.0)), surface - surface.mean(), atol=2e-6)


def test_slopes_of_no_surface_give_the_nearest() -> None:
    slopes = np.random.default_rng(5).normal(0.0, 1.0, (2, 4, 6)).astype(np.float32)
    rows, steps = [], []
    index = np.arange(24).reshape(4, 6)
    for first, second, step in (
        (index[:, :-1], index[:, 1:], (slopes[0, :, :-1] + slopes[0, :, 1:]) / 2 / 16.0),
        (index[:-1], index[1:], (slopes[1, :-1] + slopes[1, 1:]) / 2 / 10.0),
    ):
        for a, b, s in zip(first.ravel(), second.ravel(), step.ravel(), strict=True):
            rows.append(np.eye(24)[b] - np.eye(24)[a])
            steps.append(s)
    nearest = np.linalg.lstsq(np.array(rows), np.array(steps), rcond=None)[0]
    found = integrated(slopes, (16.0, 10.0))
    np.testing.assert_allclose(found.ravel(), nearest - nearest.mean(), atol=1e-6)


def bump() -> npt.NDArray[np.float32]:
    """0.2 mm pushed in at (u, v) = (40, 22)."""
    v, u = np.mgrid[:60, :90]
    return np.asarray(0.2 * np.exp(-((u - 40.0) ** 2 + (v - 22.0) ** 2) / (2 * 5.0**2)), dtype=np.float32)


def test_what_is_pushed_in_is_larger_and_in_millimetres() -> None:
    layers, background = plain_network(), np.full((60, 90, 3), 128, dtype=np.uint8)
    image = image_of(bump(), background, layers, SCALE[0])
    depth = make_reconstruction(background, make_network(layers), SCALE).depth(image)
    assert divmod(int(depth.argmax()), 90) == (22, 40)
    np.testing.assert_allclose(depth - np.median(depth), bump() - np.median(bump()), atol=0.004)
    assert image[22, 32, 0] < 128 < image[22, 48, 0]  # the gel's surface falls towards what is pressed in: negative on its left


def test_a_background_of_another_light_is_refused() -> None:
    """With one that is a third darker angles were off by ten of their standard deviations."""
    layers, background = plain_network(), np.full((60, 90, 3), 128, dtype=np.uint8)
    image = image_of(bump(), background, layers, SCALE[0])
    with pytest.raises(FrameError, match=r"50 grey levels off .* more than 20, is of another light or camera; take"):
        make_reconstruction(background - 50, make_network(layers), SCALE).depth(image)


def test_what_the_untouched_gel_shows_is_taken_off() -> None:
    network = make_network(random_layers((5, 32, 32, 32, 2)))
    background = noise_image(24, 32)
    reconstruction = make_reconstruction(background, network, SCALE)
    assert np.abs(reconstruction.untouched).max() > 0.1
    np.testing.assert_array_equal(reconstruction.depth(background), np.zeros((24, 32)))


def test_nothing_is_compiled_for_an_image_that_lies_otherwise() -> None:
    network = make_network(random_layers((5, 6, 2)))
    large = noise_image(48, 64)
    reconstruction = make_reconstruction(large[::2, ::2], network, SCALE)
    compiled = list(of_pixels.signatures)
    locked = large[:24, :32].copy()
    locked.setflags(write=False)
    for image in (large[::2, ::2], locked, np.asfortranarray(large[:24, :32])):
        found = reconstruction.depth(image)
        np.testing.assert_array_equal(found, reconstruction.depth(image.copy(order="C")))
    assert of_pixels.signatures == compiled


def test_angles_beyond_any_gel_are_as_steep_as_one_can_be() -> None:
    """A tangent would grow without end at a right angle, and turn its sign beyond."""
    layers = [(np.array([[1e3] * 5, [-1e3] * 5], dtype=np.float32), np.zeros(2, dtype=np.float32))]
    slopes = slopes_of(noise_image(24, 32)[1:], make_network(layers))
    np.testing.assert_allclose(slopes[0], np.tan(1.4), rtol=1e-5)
    np.testing.assert_allclose(slopes[1], -np.tan(1.4), rtol=1e-5)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((24, 31, 3), dtype=np.uint8),
        np.zeros((24, 32), dtype=np.uint8),
        np.zeros((24, 32, 4), dtype=np.uint8),
        np.zeros((24, 32, 3)),
        np.zeros((0, 32, 3), dtype=np.uint8),
        [[1], [2, 3]],
        None,
        "image.png",
    ],
    ids=str,
)
def test_what_is_no_image_of_the_sensor_is_refused(image: npt.ArrayLike) -> None:
    network, background = make_network(plain_network()), noise_image(24, 32)
    with pytest.raises(FrameError, match=r"; (give uint8|crop and scale)"):
        make_reconstruction(background, network, SCALE).depth(image)


# decode --raw


def raw_folder(folder: Path, sensor: str, count: int) -> npt.NDArray[np.float64]:
    """Images, background and weights of a sensor on the default tape; the poses, (x mm, y mm, theta deg) rows."""
    profile = load_sensor(sensor)
    h, w = profile.frame_shape
    background = np.full((h, w, 3), 128, dtype=np.uint8)
    frames = simulate_frames(TAPE, count, seed=4, sensor=profile, scene=Scene(noise=0.0))
    (folder / "images").mkdir()
    unit_mm = profile.depth_unit_mm or 1.0
    for k, depth in enumerate(frames.depth):
        image = image_of(depth * profile.sign * unit_mm, background, plain_network(), profile.px_per_mm[0], 1.0, seed=k)
        assert cv2.imwrite(str(folder / "images" / f"contact-{8 + k}.png"), image)
    cv2.imwrite(str(folder / "background.png"), background)
    weights_file(folder / "nnmodel.pth", tensors_of(plain_network()))
    return np.column_stack([frames.position_mm, frames.theta_deg])


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, npt.NDArray[np.float64]]:
    """Images of a GelSight Mini; not to be changed."""
    folder = tmp_path_factory.mktemp("raw")
    return folder, raw_folder(folder, "gelsight-mini", 4)


def check(result: Result, poses: npt.NDArray[np.float64]) -> None:
    assert result.exit_code == 0, result.stderr
    fixes = [json.loads(line) for line in result.stdout.splitlines()]
    assert [(fix["frame"], fix["located"]) for fix in fixes] == [(k, True) for k in range(len(poses))]
    np.testing.assert_allclose([fix["position_mm"] for fix in fixes], poses[:, :2], atol=0.02)
    turns = np.array([fix["theta_deg"] for fix in fixes]) - poses[:, 2]
    np.testing.assert_allclose((turns + 180) % 360 - 180, 0.0, atol=0.2)


def test_images_are_located(raw: Taken, default_kit: Kit) -> None:
    """A folder in the order of the numbers in its names, 8, 9, 10, 11; or files, as a shell lists them."""
    folder, poses = raw
    given = f"--background {folder}/background.png --weights {folder}/nnmodel.pth --tape {default_kit.path} --json"
    check(run(f"decode --raw {folder}/images {given}"), poses)
    files = [folder / "images" / f"contact-{k}.png" for k in (9, 8)]
    check(run(f"decode {given} --raw {files[0]} {files[1]}"), poses[[1, 0]])


def test_images_lie_as_the_profile_says(tmp_path: Path, default_kit: Kit) -> None:
    """Mirrored and turned; the sign and the unit of the sensor's own depth maps mean nothing here."""
    sensor = tmp_path / "mine.toml"
    text = (Path(__file__).parents[4] / "templates" / "sensors" / "gelsight-mini.toml").read_text(encoding="utf-8")
    changes = {
        "sign = 1": "sign = -1",
        "mirror = false": "mirror = true",
        "rotate90 = 0": "rotate90 = 1",
        "unit_mm = 1.0": "unit_mm = 0.05",
    }
    for old, new in changes.items():
        assert f"\n{old}\n" in text
        text = text.replace(f"\n{old}\n", f"\n{new}\n")
    sensor.write_text(text, encoding="utf-8")
    poses = raw_folder(tmp_path, str(sensor), 2)
    given = f"--background {tmp_path}/background.png --weights {tmp_path}/nnmodel.pth --tape {default_kit.path} --json"
    check(run(f"decode --raw {tmp_path}/images {given} --sensor {sensor}"), poses)


def test_scales_are_those_of_the_images_as_they_lie(raw: Taken) -> None:
    folder, _ = raw
    for quarters, along in ((0, (15.0, 17.0)), (2, (15.0, 17.0)), (1, (17.0, 15.0)), (3, (17.0, 15.0))):
        sensor = replace(load_sensor("gelsight-mini"), px_per_mm=(15.0, 17.0), rotate90=quarters)
        if quarters % 2:
            sensor = replace(sensor, width_px=240, height_px=320)  # the images of the folder, then, turned upright
        problems = list[Problem]()
        found = open_reconstruction(str(folder / "background.png"), str(folder / "nnmodel.pth"), sensor, problems)
        assert found is not None and found.px_per_mm == along and problems == []


def test_background_and_weights_of_images_and_recordings_are_refused_once(raw: Taken, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(b"no log")
    images = [str(raw[0] / "images"), str(log)]
    with pytest.raises(SpecError) as caught:
        prepare([], [], "gelsight-mini", Raw(images=images, background=None, weights=str(log)), code="microdots-4x4")
    assert [(problem.key, "log.mcap" in problem.message) for problem in caught.value.problems] == [
        ("frames", True),
        ("background", False),
        ("weights", True),
    ]


def test_everything_that_is_wrong_is_said_at_once(raw: Taken, tmp_path: Path, default_kit: Kit) -> None:
    folder, _ = raw
    image = picture(folder / "images" / "contact-8.png")
    for name, wrong in {"small.png": image[:100], "grey.png": image[..., 0], "deep.png": image.astype(np.uint16)}.items():
        cv2.imwrite(str(tmp_path / name), wrong)
    (tmp_path / "text.jpg").write_text("no picture")
    (tmp_path / "bare.jpg").write_bytes(b"\xff\xd8" + b"\xff" * 10_000_000)
    (tmp_path / "empty").mkdir()
    names = ["small.png", "grey.png", "deep.png", "text.jpg", "bare.jpg", "none.png"]
    images = " ".join(str(tmp_path / name) for name in names)
    result = run(f"decode --raw {tmp_path}/empty --raw {images} --background {tmp_path}/small.png --weights {tmp_path}/text.jpg")
    assert result.exit_code == 2
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    said = [
        "no tape is given",
        "empty is a folder without a PNG or JPEG",
        "small.png: it is 100 x 320 px, frames of sensor 'gelsight-mini' are 240 x 320",
        "grey.png: it has 1 channel of 8 bits",
        "deep.png: it has 3 channels of 16 bits",
        "text.jpg: it is neither PNG nor JPEG",
        "bare.jpg: it is a JPEG without a picture",
        "none.png cannot be read: No such file or directory",
        "background " + str(tmp_path / "small.png"),
        "text.jpg is no zip",
    ]
    assert len(lines) == len(said)
    for line in said:
        assert any(line in found for found in lines), (line, lines)


def test_many_wrong_images_are_counted(tmp_path: Path, raw: Taken, default_kit: Kit) -> None:
    folder, _ = raw
    for k in range(30):
        (tmp_path / f"{k}.png").write_bytes(b"no picture")
    given = f"--background {folder}/background.png --weights {folder}/nnmodel.pth --tape {default_kit.path}"
    lines = run(f"decode --raw {tmp_path} {given}").stderr.splitlines()
    assert len(lines) == 11
    assert "20 more of 30 images" in lines[-1]


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("--raw x.png --weights w.pth", "give --background FILE"),
        ("--raw x.png --background b.png", "give --weights FILE"),
        ("--background b.png frames.npz", "name them with --raw"),
        ("--weights w.pth", "name them with --raw"),
    ],
)
def test_raw_background_and_weights_go_together(given: str, says: str) -> None:
    result = run(f"decode {given}")
    assert result.exit_code == 2
    assert says in result.stderr


def test_an_image_that_ends_early_is_named(tmp_path: Path, raw: Taken, default_kit: Kit) -> None:
    folder, _ = raw
    (tmp_path / "half.png").write_bytes((folder / "images" / "contact-8.png").read_bytes()[:60])
    given = f"--background {folder}/background.png --weights {folder}/nnmodel.pth --tape {default_kit.path}"
    result = run(f"decode --raw {tmp_path}/half.png {given}")
    assert result.exit_code == 2
    assert f"raw {tmp_path}/half.png: it is damaged" in result.stderr


def test_jpegs_are_read_as_they_lie(tmp_path: Path, raw: Taken, default_kit: Kit) -> None:
    folder, poses = raw
    image = picture(folder / "images" / "contact-8.png")
    cv2.imwrite(str(tmp_path / "a.JPG"), image, [cv2.IMWRITE_JPEG_QUALITY, 95, cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    data = (tmp_path / "a.JPG").read_bytes()
    upside_down = bytes.fromhex("ffe1 0022 457869660000 4d4d002a 00000008 0001 0112 0003 00000001 0003 0000 00000000")
    (tmp_path / "a.JPG").write_bytes(data[:2] + upside_down + data[2:])
    upright = picture(tmp_path / "a.JPG")
    assert np.abs(upright.astype(int) - image).mean() > np.abs(upright[::-1, ::-1].astype(int) - image).mean()
    given = f"--background {folder}/background.png --weights {folder}/nnmodel.pth --tape {default_kit.path} --json"
    check(run(f"decode --raw {tmp_path}/a.JPG {given}"), poses[:1])


def test_images_and_films_are_watched(tmp_path: Path, raw: Taken, default_kit: Kit) -> None:
    """A folder, and a film of the same images in the corner of larger ones, as a camera would deliver them."""
    folder, poses = raw
    given = f"--raw --background {folder}/background.png --weights {folder}/nnmodel.pth --tape {default_kit.path} --json"
    check(run(f"watch {folder}/images {given} --idle 0.2"), poses)
    film = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (704, 512))
    film.set(cv2.VIDEOWRITER_PROP_QUALITY, 100)
    for k in range(8, 8 + len(poses)):
        large = np.zeros((512, 704, 3), dtype=np.uint8)
        large[20:500, 40:680] = np.repeat(np.repeat(picture(folder / "images" / f"contact-{k}.png"), 2, axis=0), 2, axis=1)
        film.write(large)
    film.release()
    result = run(f"watch {tmp_path}/film.avi {given} --rate max --crop 40,20,640,480 --mcap {tmp_path}/touch.mcap")
    check(result, poses)
    stamps = [json.loads(line)["timestamp"] for line in result.stdout.splitlines()]
    np.testing.assert_allclose(np.diff(stamps), 0.04, atol=1e-6)
    assert (tmp_path / "touch.mcap").stat().st_size > len(poses) * 4 * 240 * 320
    uncut = run(f"watch {tmp_path}/film.avi {given} --rate max")
    assert uncut.exit_code == 1
    assert "an image of 512 x 704 px is none of sensor 'gelsight-mini', whose images are 240 x 320" in uncut.stderr


def test_the_weights_of_a_file_are_the_network(tmp_path: Path) -> None:
    layers = random_layers((5, 6, 9, 2))
    read, made = load_network(weights_file(tmp_path / "nnmodel.pth", tensors_of(layers))), make_network(layers)
    assert read.sizes == (5, 6, 9, 2)
    for name in ("weights", "biases", "widths"):
        np.testing.assert_array_equal(getattr(read, name), getattr(made, name))


def test_the_page_runs_as_it_stands(here: Path, raw: Taken, default_kit: Kit) -> None:
    folder, poses = raw
    page = (Path(__file__).parents[4] / "docs" / "raw-images.md").read_text(encoding="utf-8")
    for name in ("images", "background.png", "nnmodel.pth"):
        (here / name).symlink_to(folder / name)
    (here / "tactape-s007").symlink_to(default_kit.path)
    blocks = re.findall(r"^```(sh|python)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert [language for language, _ in blocks] == ["sh", "python", "python"]
    check(run(blocks[0][1].removeprefix("tactape-fab ") + " --json"), poses)
    script = subprocess.run(
        [sys.executable, "-c", blocks[1][1] + blocks[2][1]], capture_output=True, encoding="utf-8", check=True
    )
    np.testing.assert_allclose(ast.literal_eval(script.stdout), poses[0, :2], atol=0.02)
    assert len(np.load("presses.npz")["depth"]) == len(poses)
    for picture_of_it in re.findall(r"!\[[^]]+\]\(([^)]+)\)", page):
        assert picture(Path(__file__).parents[4] / "docs" / picture_of_it).shape == (360, 1456, 3)
