"""Files of frames: what they may hold, what is refused and how, and that a written file has the same bytes every time."""

from __future__ import annotations

import json
import shlex
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tactape_fab import Kit
from tactape_fab.base.errors import SpecError
from tactape_fab.cli import command
from tactape_fab.sense import load_sensor
from tactape_fab.sense.files.depth_maps import _REMEDY, SUFFIXES, FrameFile, open_frame_file, open_frames
from tactape_fab.sense.files.jobs import is_kit
from tactape_fab.sense.files.simulated import simulate_file
from tactape_fab.texture.registry import read_tapes

SENSOR = load_sensor("gelsight-mini")
SHAPE = SENSOR.frame_shape


def ramp(count: int, dtype: npt.DTypeLike = np.float32) -> npt.NDArray[Any]:
    """Frames of which neighbouring pixels, rows and frames differ."""
    return (np.arange(count * SHAPE[0] * SHAPE[1]) % 1999).reshape(count, *SHAPE).astype(dtype)


def read(file: FrameFile) -> npt.NDArray[Any]:
    return np.stack(list(file.frames()))


def refused(path: Path) -> str:
    """The one message with which a file is refused, by its header or when it is read."""
    with pytest.raises(SpecError) as error:
        list(open_frame_file(path).frames())
    assert len(error.value.problems) == 1
    assert str(path) in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<u2", ">i4", "u1", "?", "<f2"])
def test_numbers_of_any_kind_come_as_they_are(tmp_path: Path, dtype: str) -> None:
    depth = ramp(2, dtype)
    np.save(tmp_path / "f.npy", depth)
    np.savez_compressed(tmp_path / "f.npz", depth=depth)
    for name in ("f.npy", "f.npz"):
        file = open_frame_file(tmp_path / name)
        assert (file.count, file.frame_shape) == (2, SHAPE)
        assert all(frame.dtype == depth.dtype for frame in file.frames())
        np.testing.assert_array_equal(read(file), depth)


def test_frames_stored_column_by_column_are_turned_round(tmp_path: Path) -> None:
    np.save(tmp_path / "f.npy", np.asfortranarray(ramp(3)))
    np.testing.assert_array_equal(read(open_frame_file(tmp_path / "f.npy")), ramp(3))
    np.save(tmp_path / "one.npy", np.asfortranarray(ramp(1)[0]))
    np.testing.assert_array_equal(read(open_frame_file(tmp_path / "one.npy")), ramp(1))


def test_a_file_of_another_shape_in_its_place_is_not_read_as_the_first(tmp_path: Path) -> None:
    """Its rows would be cut at other places."""
    np.save(tmp_path / "f.npy", ramp(3))
    file = open_frame_file(tmp_path / "f.npy")
    for other in (ramp(3).transpose(0, 2, 1).copy(), ramp(4)):
        np.save(tmp_path / "f.npy", other)
        with pytest.raises(SpecError, match="it was written anew while it was read"):
            read(file)


def test_one_frame_needs_no_third_axis(tmp_path: Path) -> None:
    np.savez(tmp_path / "f.npz", depth=ramp(1)[0], timestamp=3.5)
    file = open_frame_file(tmp_path / "f.npz")
    assert (file.count, file.frame_shape, file.time_of(0)) == (1, SHAPE, 3.5)


def test_times_and_scale_are_read(tmp_path: Path) -> None:
    np.savez(tmp_path / "f.npz", depth=ramp(3), timestamp=np.array([1, 2, 3]), px_per_mm=15.5)
    file = open_frame_file(tmp_path / "f.npz")
    assert [file.time_of(k) for k in range(3)] == [1.0, 2.0, 3.0]
    assert file.px_per_mm == (15.5, 15.5)
    np.savez(tmp_path / "g.npz", depth=ramp(3), timestamp=[1.0, np.nan, np.inf], px_per_mm=[15.5, 14.0])
    file = open_frame_file(tmp_path / "g.npz")
    assert [file.time_of(k) for k in range(3)] == [1.0, None, None]
    assert file.px_per_mm == (15.5, 14.0)
    np.savez(tmp_path / "h.npz", depth=ramp(3))
    assert open_frame_file(tmp_path / "h.npz").time_of(2) is None


@pytest.mark.parametrize("name", ["f.png", "f.tif", "F.TIFF"])
def test_pictures_of_16_bits(tmp_path: Path, name: str) -> None:
    depth = ramp(1, np.uint16)[0]
    (tmp_path / name).write_bytes(cv2.imencode(Path(name).suffix.lower(), depth)[1].tobytes())
    np.testing.assert_array_equal(read(open_frame_file(tmp_path / name)), depth[None])


def test_tiff_of_floats_and_of_the_other_byte_order(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "f.tif"), ramp(1)[0])
    np.testing.assert_array_equal(read(open_frame_file(tmp_path / "f.tif")), ramp(1))
    depth = np.arange(12, dtype=">u2").reshape(3, 4)
    tags = [(256, 3, 4), (257, 3, 3), (258, 3, 16), (259, 3, 1), (262, 3, 1), (273, 4, 8), (277, 3, 1), (278, 3, 3), (279, 4, 24)]
    rows = b"".join(struct.pack(">HHIHH" if t == 3 else ">HHII", n, t, 1, *((v, 0) if t == 3 else (v,))) for n, t, v in tags)
    header = struct.pack(">2sHI", b"MM", 42, 8 + depth.nbytes)
    data = header + depth.tobytes() + struct.pack(">H", len(tags)) + rows + struct.pack(">I", 0)
    (tmp_path / "big.tif").write_bytes(data)
    np.testing.assert_array_equal(read(open_frame_file(tmp_path / "big.tif"))[0], depth)


def _array(descr: str, shape: str, fortran: bool = False) -> bytes:
    return _header(f"{{'descr': {descr!r}, 'fortran_order': {fortran}, 'shape': {shape}, }}")


def _header(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", 246) + text.ljust(245).encode() + b"\n"


def _png(dtype: npt.DTypeLike, *shape: int) -> bytes:
    return bytes(cv2.imencode(".png", np.zeros(shape, dtype))[1].tobytes())


BAD: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "nothing": (".npy", lambda: b"", "cannot be read"),
    "text": (".npz", lambda: b"depth", "not a zip file"),
    "objects": (".npy", lambda: _array("|O", "(240, 320)"), "not real numbers"),
    "complex": (".npy", lambda: _array("<c8", "(240, 320)"), "not real numbers"),
    "record": (".npy", lambda: _header("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (240, 320), }"), "not real"),
    "huge": (".npy", lambda: _array("<f4", "(9, 99999, 320)"), "at most 4096"),
    "many": (".npy", lambda: _array("<f4", "(10000000, 240, 320)"), "1 to 1000000"),
    "columns": (".npy", lambda: _array("<f8", "(9999, 999, 999)", fortran=True), "ascontiguous"),
    "negative": (".npy", lambda: _array("<f4", "(-1, 240, 320)"), "cannot be read"),
    "code": (".npy", lambda: _header("{'descr': ((((("), "cannot be read"),
    "short": (".npy", lambda: _array("<f4", "(240, 320)") + bytes(99), "ends in"),
    "appended": (".npy", lambda: 2 * (_array("<f4", "(2, 3)") + bytes(24)), "280 bytes follow its array of shape (2, 3)"),
    "time first": (".npy", lambda: _array("<f8", "()") + bytes(8) + _array("<f4", "(2, 3)") + bytes(24), "shape (), as where"),
    "jpeg": (".png", lambda: b"\xff\xd8\xff\xe0" + bytes(99), "no PNG"),
    "8 bits": (".png", lambda: _png(np.uint8, 240, 320), "8 bits"),
    "colour": (".png", lambda: _png(np.uint16, 240, 320, 3), "3 channels"),
    "cut": (".png", lambda: _png(np.uint16, 240, 320)[:60], "damaged"),
    "bomb": (".png", lambda: _png(np.uint16, 4, 4)[:16] + struct.pack(">II", 1 << 30, 1 << 30) + bytes([16, 0]) + bytes(9), "px"),
    "tiff": (".tif", lambda: b"II*\x00" + bytes(2), "ends in its header"),
    "far tiff": (".tif", lambda: b"II*\x00\xff\xff\xff\xff" + bytes(99), "ends in its header"),
    "no tiff": (".tif", lambda: bytes(99), "no TIFF"),
    "csv": (".csv", lambda: b"1,2", "no file of frames"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_is_no_depth_map_is_named(tmp_path: Path, case: str) -> None:
    suffix, data, words = BAD[case]
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(data())
    assert words in refused(path)


@pytest.mark.parametrize(("kind", "words"), [(np.int16, "signed numbers of 16 bits"), (np.int32, "signed numbers of 32 bits")])
def test_tiff_of_signed_numbers_is_named(tmp_path: Path, kind: type[np.generic], words: str) -> None:
    cv2.imwrite(str(tmp_path / "f.tif"), np.zeros((32, 40), kind))
    assert f"it has {words}; write unsigned ones of 16 bits, or floats of 32" in refused(tmp_path / "f.tif")


@pytest.mark.parametrize("turn", range(1, 9))
def test_tiff_that_opencv_would_turn_is_refused(tmp_path: Path, turn: int) -> None:
    cv2.imwrite(str(tmp_path / "f.tif"), ramp(1)[0])
    data = bytearray((tmp_path / "f.tif").read_bytes())
    start = int.from_bytes(data[4:8], "little")
    tags = {int.from_bytes(data[at : at + 2], "little"): at for at in range(start + 2, start + 2 + 12 * data[start], 12)}
    # tag SamplesPerPixel (277), 1 where it is missing, becomes Orientation (274)
    data[tags[277] : tags[277] + 2], data[tags[277] + 8] = (274).to_bytes(2, "little"), turn
    (tmp_path / "f.tif").write_bytes(data)
    if turn == 1:
        np.testing.assert_array_equal(read(open_frame_file(tmp_path / "f.tif")), ramp(1))
    else:
        assert f"(tag Orientation = {turn}); write it without that" in refused(tmp_path / "f.tif")


def test_every_kind_of_file_is_named_where_it_is_offered() -> None:
    offered = [_REMEDY, str(command("decode").help), str(command("calibrate").help)]
    offered.append((Path(__file__).parents[4] / "docs" / "localization.md").read_text(encoding="utf-8"))
    assert all(suffix in text for suffix in SUFFIXES if suffix != ".tiff" for text in offered)


def test_tiff_of_two_pictures_is_refused(tmp_path: Path) -> None:
    cv2.imwritemulti(str(tmp_path / "f.tif"), [np.zeros((4, 4), np.uint16)] * 2)
    assert "several pictures" in refused(tmp_path / "f.tif")


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"height": np.zeros((2, 3))}, "no array 'depth', only height"),
        ({}, "no array 'depth', and no other; give"),
        ({"depth": np.zeros((0, 240, 320))}, "depth has shape (0, 240, 320)"),
        ({"depth": np.zeros((2, 2, 2, 2))}, "depth has shape (2, 2, 2, 2)"),
        ({"depth": np.zeros(9)}, "depth has shape (9,)"),
        ({"depth": np.zeros((3, 4, 4)), "timestamp": np.zeros(2)}, "timestamp has shape (2,); give (3,)"),
        ({"depth": np.zeros((4, 4)), "timestamp": np.array("noon")}, "timestamp holds values of type '<U4', not real numbers"),
        ({"depth": np.zeros((1, 4, 4)), "timestamp": np.array(["2026-01-01"], "M8[ns]")}, "give seconds, of dates such as"),
        ({"depth": np.zeros((4, 4)), "px_per_mm": np.array("16")}, "px_per_mm holds values of type '<U2', not real numbers"),
        ({"depth": np.zeros((4, 4)), "px_per_mm": np.array(0.0)}, "px_per_mm = 0.0 is not from 1 to 1000"),
        ({"depth": np.zeros((4, 4)), "px_per_mm": np.array([16.0, np.nan])}, "px_per_mm"),
        ({"depth": np.zeros((4, 4)), "px_per_mm": np.ones(3)}, "px_per_mm has shape (3,)"),
    ],
    ids=str,
)
def test_arrays_of_another_form_are_named(tmp_path: Path, arrays: dict[str, npt.NDArray[Any]], words: str) -> None:
    np.savez(tmp_path / "f.npz", allow_pickle=False, **arrays)
    assert words in refused(tmp_path / "f.npz")


def test_a_member_without_npy_is_no_array(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "f.npz", "w") as archive:
        archive.writestr("depth", b"")
    assert "no array 'depth', only depth (without .npy); give" in refused(tmp_path / "f.npz")


@pytest.mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_arrays_that_numpy_does_not_pack_are_refused(packing: int, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", depth=np.zeros((2, 6, 8)))
    with zipfile.ZipFile(tmp_path / "a.npz") as plain, zipfile.ZipFile(tmp_path / "b.npz", "w", packing) as other:
        other.writestr("depth.npy", plain.read("depth.npy"))
    with pytest.raises(SpecError, match="its array 'depth' is packed in a way in which numpy writes none"):
        open_frame_file(tmp_path / "b.npz")


def test_a_damaged_byte_is_noticed(tmp_path: Path) -> None:
    np.savez(tmp_path / "f.npz", depth=ramp(2))
    data = bytearray((tmp_path / "f.npz").read_bytes())
    data[5000] ^= 255
    (tmp_path / "f.npz").write_bytes(data)
    assert "CRC" in refused(tmp_path / "f.npz")


def test_a_cut_zip_and_a_missing_file_are_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "f.npz", depth=ramp(2))
    (tmp_path / "cut.npz").write_bytes((tmp_path / "f.npz").read_bytes()[:-200])
    assert "cannot be read" in refused(tmp_path / "cut.npz")
    assert "No such file" in refused(tmp_path / "none.npz")


def test_all_problems_come_together_and_both_shapes_are_named(tmp_path: Path) -> None:
    np.save(tmp_path / "large.npy", np.zeros((480, 640)))
    np.save(tmp_path / "good.npy", ramp(1))
    with pytest.raises(SpecError) as error:
        open_frames([tmp_path / "large.npy", tmp_path / "none.npz", tmp_path / "good.npy"], SENSOR)
    first, second = (p.message for p in error.value.problems)
    assert all(part in first for part in ("large.npy", "480 x 640", "240 x 320", "gelsight-mini"))
    assert "none.npz" in second


# Registries


def test_kits_manifests_and_folders_of_kits(small_kit: Kit, default_kit: Kit, tmp_path: Path) -> None:
    folder = tmp_path / "tapes"
    folder.mkdir()
    for name, kit in (("b", small_kit), ("a", default_kit)):
        (folder / name).symlink_to(kit.path)
    (folder / ".x.partial").mkdir()
    (folder / "notes.txt").write_text("mine")
    assert [t.name for t in read_tapes([folder])] == [default_kit.tape.name, small_kit.tape.name]
    assert [t.name for t in read_tapes([small_kit.path, default_kit.path / "manifest.json"])] == ["tactape-s100", "tactape-s007"]


def test_every_path_that_is_no_kit_is_named(small_kit: Kit, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "m.json").write_text("{}")
    with pytest.raises(SpecError) as error:
        read_tapes([tmp_path / "empty", small_kit.path, tmp_path / "m.json", tmp_path / "gone"])
    messages = [p.message for p in error.value.problems]
    assert len(messages) == 3
    assert all(name in message for name, message in zip(("empty", "m.json", "gone"), messages, strict=True))


def test_what_is_meant_as_a_kit(small_kit: Kit) -> None:
    assert is_kit(str(small_kit.path)) and is_kit("some/manifest.json")
    assert not is_kit("frames.npz") and not is_kit("a\0b")


# Written files


def test_written_frames_have_the_same_bytes_and_come_back(small_kit: Kit, tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        made = simulate_file(small_kit.path, tmp_path / name, count=2, seed=5, contact=[6, 5])
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert (made.count, made.frame_shape, made.tape, made.sensor) == (2, SHAPE, "tactape-s100", "gelsight-mini")
    with zipfile.ZipFile(made.path) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    with np.load(made.path) as arrays:
        assert arrays["depth"].dtype == np.float32
        assert arrays["position_mm"].shape == (2, 2) and arrays["theta_deg"].shape == (2,)
        np.testing.assert_array_equal(arrays["px_per_mm"], SENSOR.px_per_mm)
        record = json.loads(str(arrays["scene"]))
        np.testing.assert_array_equal(read(open_frame_file(made.path)), arrays["depth"])
    assert (record["tape"], record["seed"], record["scene"]["contact_mm"]) == ("tactape-s100", 5, [6.0, 5.0])
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.npz", "b.npz"]


def test_frame_k_is_the_same_whatever_the_count_and_differs_by_seed(small_kit: Kit, tmp_path: Path) -> None:
    depths = []
    for count, seed in ((1, 0), (2, 0), (1, 1)):
        made = simulate_file(small_kit.path, tmp_path / f"{count}{seed}.npz", count=count, seed=seed)
        depths.append(read(open_frame_file(made.path)))
    np.testing.assert_array_equal(depths[0][0], depths[1][0])
    assert (depths[0][0] != depths[2][0]).any()


def test_only_a_simulated_file_is_replaced(small_kit: Kit, tmp_path: Path) -> None:
    own, other = tmp_path / "own.npz", tmp_path / "other.npz"
    simulate_file(small_kit.path, own)
    before = own.read_bytes()
    simulate_file(small_kit.path, own, seed=1)
    assert own.read_bytes() != before
    np.savez(other, depth=ramp(1))
    measured = other.read_bytes()
    with pytest.raises(SpecError, match="no simulated file"):
        simulate_file(small_kit.path, other)
    assert other.read_bytes() == measured


@pytest.mark.parametrize("name", ["\N{GRINNING FACE}" * 60 + ".npz", "a" * 251 + ".npz"])
def test_a_long_name_is_written_as_a_short_one(name: str, small_kit: Kit, tmp_path: Path) -> None:
    simulate_file(small_kit.path, tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_what_comes_to_the_place_meanwhile_is_kept(small_kit: Kit, tmp_path: Path) -> None:
    path = tmp_path / "f.npz"

    def come(*_: object) -> None:
        path.write_bytes(b"mine")

    with pytest.raises(SpecError, match="no simulated file"):
        simulate_file(small_kit.path, path, progress=come)
    assert path.read_bytes() == b"mine" and list(tmp_path.iterdir()) == [path]


def test_an_interrupted_run_leaves_the_old_file(small_kit: Kit, tmp_path: Path) -> None:
    path = tmp_path / "f.npz"
    simulate_file(small_kit.path, path)
    before = path.read_bytes()

    def stop(_: str, done: int, __: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_file(small_kit.path, path, count=3, progress=stop)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_parts_stand_where_the_written_cpl_says(copied: Callable[[Kit], Path], small_kit: Kit, tmp_path: Path) -> None:
    kit = copied(small_kit)
    cpl = kit / "assembly" / "tactape-s100-cpl.csv"

    def frame(name: str, from_cpl: bool) -> npt.NDArray[Any]:
        made = simulate_file(kit, tmp_path / name, pose=[5.0, 6.0, 0.0], from_cpl=from_cpl, noise=0)
        return read(open_frame_file(made.path))

    plain = frame("a.npz", from_cpl=False)
    np.testing.assert_allclose(frame("b.npz", from_cpl=True), plain, atol=1e-4)
    lines = cpl.read_text().splitlines()
    cpl.write_text("\n".join([lines[0], *lines[1::2]]) + "\n")
    assert np.abs(frame("c.npz", from_cpl=True) - plain).max() > 0.02
    cpl.unlink()
    with pytest.raises(SpecError, match="cannot be opened"):
        simulate_file(kit, tmp_path / "d.npz", from_cpl=True)


# Damage


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files_are_read_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    """Bytes overwritten, cut or added anywhere: frames of the size that was announced, or a SpecError."""
    name = data.draw(st.sampled_from([".npz", ".npy", ".png", ".tif"]))
    depth = np.arange(2 * 6 * 7, dtype=np.uint16).reshape(2, 6, 7)
    path = tmp_path / f"f{name}"
    if name == ".npz":
        np.savez_compressed(path, depth=depth, timestamp=np.arange(2.0), px_per_mm=16.0)
    elif name == ".npy":
        np.save(path, depth)
    else:
        path.write_bytes(cv2.imencode(name, depth[0])[1].tobytes())
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, max(len(content) - 1, 0)))
        patch = data.draw(st.binary(max_size=4))
        content[at : at + data.draw(st.sampled_from([0, len(patch), len(content)]))] = patch
    path.write_bytes(content)
    try:
        file = open_frame_file(path)
        shapes = [frame.shape for frame in file.frames()]
    except SpecError as error:
        assert str(path) in str(error)
    else:
        assert shapes == [file.frame_shape] * file.count


def test_a_kit_in_the_place_of_frames_is_named_as_it_is_typed(tmp_path: Path) -> None:
    kit = tmp_path / "my kit"
    kit.mkdir()
    (kit / "manifest.json").touch()
    with pytest.raises(SpecError) as refused:
        open_frame_file(kit)
    assert shlex.split(str(refused.value).rpartition("; use ")[2]) == ["--tape", str(kit)]
