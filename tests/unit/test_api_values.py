"""What a new user hands to the API: paths and single tapes are taken, all else ends in one clear error of ours."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

import tactape_fab
from tactape_fab import (
    AsBuilt,
    FrameError,
    Kit,
    Localization,
    Localizer,
    Prior,
    SpecError,
    Tape,
    TapeSpec,
    Tracker,
    across,
    board_to_texture,
    certify,
    default_origin,
    examine_order,
    list_tapes,
    make_kit,
    make_kits,
    make_panel,
    pixels_to_texture,
    read_object,
    read_tapes,
    refine_tag_pose,
    tag_side_mm,
    tag_to_texture,
    texture_to_board,
    texture_to_pixels,
    verify_kit,
)
from tactape_fab.base.templates import templates_folder
from tactape_fab.sense import (
    ArmPose,
    ElasticContact,
    LiveSensor,
    Mount,
    Network,
    Parts,
    Scene,
    SensorProfile,
    calibrate_sensor,
    draw_poses,
    image_message,
    inspect_scans,
    load_network,
    load_sensor,
    make_reconstruction,
    measure_pose,
    observation_names,
    pose_message,
    sensor_on_object,
    simulate,
    simulate_forces,
    simulate_frames,
    transform_message,
)
from tactape_fab.sense.raw.reconstruct import make_network
from tactape_fab.solids import SolidForm, assembly, texture_part
from tests.contacts import TAPE, dots

GREY = np.full((8, 12, 3), 127, dtype=np.uint8)


@pytest.fixture(scope="module")
def network() -> Network:
    return make_network([(np.full((2, 5), 0.01, dtype=np.float32), np.zeros(2, dtype=np.float32))])


@pytest.fixture(scope="module")
def localizer() -> Localizer:
    return Localizer(TAPE)


# Tapes


def test_a_localizer_takes_a_tape_and_paths_of_kits(small_kit: Kit) -> None:
    path, manifest = small_kit.path, small_kit.path / "manifest.json"
    ways: list[Any] = [small_kit.tape, [small_kit.tape], path, str(path), [str(path)], (manifest,), iter([path, small_kit.tape])]
    for tapes in ways:
        taken = Localizer(tapes).tapes
        assert [(tape.name, tape.sector) for tape in taken] == [(small_kit.tape.name, small_kit.tape.sector)]


def test_a_localizer_takes_a_folder_of_kits(small_kit: Kit) -> None:
    assert [t.name for t in Localizer(small_kit.path.parent).tapes] == [t.name for t in read_tapes([small_kit.path.parent])]


@pytest.mark.parametrize(
    ("tapes", "said"),
    [
        (["nosuchkit"], "nosuchkit"),
        ("nosuchkit", "nosuchkit"),
        ([], "no tape is registered; give the kits that can be touched"),
        (None, "tape = None is no tape; give Tape.load(KIT), or the path of a kit"),
        (7, "tape = 7 is no tape"),
        ([TAPE, 3.5], "tape = 3.5 is no tape"),
        ([[TAPE]], "is no tape"),
    ],
)
def test_a_localizer_refuses_what_is_no_tape(tapes: Any, said: str) -> None:
    with pytest.raises(SpecError) as caught:
        Localizer(tapes)
    assert said in str(caught.value) and len(caught.value.problems) == 1


@pytest.mark.parametrize("package", ["decode", "objects", "track"])
def test_what_python_calls_names_no_option_of_the_command_line(package: str) -> None:
    """The command names its own in place of arguments: `cli.exits`."""
    for path in Path(tactape_fab.__file__).parent.glob(f"sense/{package}/**/*.py"):
        texts = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)]
        assert not [text.value for text in texts if isinstance(text.value, str) and re.search(r"(^|\s)--[a-z]", text.value)], path


def test_all_that_is_wrong_is_said_together() -> None:
    wrong: dict[str, Any] = {"max_p_false": "1e-4", "kappa": None, "world": 3, "unregistered_share": True}
    with pytest.raises(SpecError) as caught:
        Localizer(["nosuchkit"], **wrong)
    assert [p.key for p in caught.value.problems[-4:]] == ["world", "max_p_false", "unregistered_share", "kappa"]
    assert len(caught.value.problems) == 5


def test_a_code_s_grid_must_be_numbers() -> None:
    wrong: Any = "1.5"
    with pytest.raises(SpecError, match=r"w = '1\.5' is not a number in mm; --w is the grid pitch"):
        Localizer.from_code("microdots-4x4", wrong, 0.25)


FIX = Localization(status="solid", located=True, position_mm=(1.0, 2.0), theta_deg=3.0, board_mm=(4.0, 5.0), covariance=np.eye(3))
TRANSPOSED = np.array([(1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (1.0, 2.0, 3.0, 1.0)])
CAMERA = np.array([(900.0, 0.0, 320.0), (0.0, 900.0, 240.0), (0.0, 0.0, 1.0)])
NO_TAPE = r"^tape = .* is no tape; give Tape\.load\(KIT\)$"
NO_KIT = r"^path = .* is no path; give the folder of a kit or its manifest\.json, as a text or a Path$"
NO_LIST = r"is no list of tapes; give \[Tape\.load\(KIT\), \.\.\.\]$"
EYE, ONES, RAGGED = np.eye(3), np.ones(3), [[1, 2], [3]]
WRONG: dict[str, tuple[Callable[[], object], str]] = {
    "tracker": (lambda: Tracker(of("k7")), r"^localizer = 'k7' is no Localizer; give Tracker\(Localizer\(KIT\)\)$"),
    "motion": (lambda: Tracker(Localizer(TAPE), of(3)), "^motion = 3 is no Motion; give one, or leave it out$"),
    "simulate": (lambda: simulate(of("k7"), (1.0, 2.0), 3.0), NO_TAPE),
    "simulate None": (lambda: simulate(of(None), (1.0, 2.0), 3.0), NO_TAPE),
    "poses": (lambda: draw_poses(of("k7"), 3), NO_TAPE),
    "scene": (lambda: simulate(TAPE, (1.0, 2.0), 3.0, scene=of(3)), r"^scene = 3 is no Scene; give one, such as Scene"),
    "certify": (lambda: certify(of("k7")), NO_TAPE),
    "load None": (lambda: Tape.load(of(None)), NO_KIT),
    "load 3": (lambda: Tape.load(of(3)), NO_KIT),
    "load bytes": (lambda: Tape.load(of(b"k7")), NO_KIT),
    "verify": (lambda: verify_kit(of(5)), NO_KIT),
    "read_tapes": (lambda: read_tapes(of(None)), "^paths = None is no path; give kits"),
    "object": (lambda: read_object(of({})), r"^path = \{\} is no path; give the \.toml file of an object"),
    "as-built": (lambda: AsBuilt.load(of(None)), "^as_built = None is no path; give a file of measured places"),
    "kit": (lambda: make_kit(TapeSpec(sector=7, models=False), of(5)), "^path = 5 is no path; give the folder of the kit"),
    "spec": (lambda: make_kit(of("k7")), r"^spec = 'k7' is no TapeSpec; give one, such as TapeSpec\(sector=7\)$"),
    "network": (lambda: load_network(of(None)), "^path = None is no path; give a file of weights"),
    "scans": (lambda: inspect_scans(of(5), "k7"), "^scans = 5 is no path; give images of the tape"),
    "size": (lambda: TapeSpec(sector=7, size_mm=of(x for x in (100, 50))), "^size_mm = <generator .* is not 2 numbers; give W"),
    "mapping": (lambda: TapeSpec.from_mapping(of(3)), '^values = 3 is no mapping; give keys and values, such as {"sector": 7}$'),
    "manifest": (lambda: Tape.from_mapping(of(None)), "^manifest = None is no mapping; give the content of a kit's"),
    "measured": (lambda: AsBuilt.from_mapping(of([])), r"^content = \[\] is no mapping; give what a file of measured places"),
    "avoid": (lambda: make_kit(TapeSpec(sector=7), avoid=of("k7")), f"^avoid = 'k7' {NO_LIST}"),
    "verify option": (lambda: make_kit(TapeSpec(sector=7), verify=of("no")), "^verify = 'no' is no bool; give True or False$"),
    "force": (lambda: make_kit(TapeSpec(sector=7), force=of(1)), "^force = 1 is no bool; give True or False$"),
    "signer": (lambda: make_kit(TapeSpec(sector=7), signer=of("key")), "^signer = 'key' is no Signer; give what read_signer"),
    "overwrite": (lambda: make_kit(TapeSpec(sector=7), overwrite=of("no")), "^overwrite = 'no' is neither True, False nor"),
    "panel of a tape": (lambda: make_panel(examine_order({"sector": 7})[0]), r"^examined = Examined\(.* is no panel"),
    "panel": (lambda: make_panel(of(3)), "^examined = 3 is no panel; give what examine_order returns first"),
    "planned": (lambda: list(make_kits(of("k7"), Path(), workers=1)), r"^tapes = 'k7' is no list of planned tapes; give"),
    "workers": (lambda: list(make_kits((), Path(), workers=of(2.5))), "^workers = 2.5 is not a whole number; give a number of"),
    "order": (lambda: examine_order(of("k7")), "^values = 'k7' is no mapping"),
    "list": (lambda: list_tapes(of("k7"), {}, Path()), "^values = 'k7' is no mapping"),
    "options": (lambda: list_tapes({"sectors": "1,2"}, of(None), Path()), "^options = None is no mapping; give the options"),
    "no sectors": (lambda: list_tapes({}, {}, Path()), '^sectors is missing; give sectors = "0-9", or a list of tapes$'),
    "contact": (lambda: verify_kit("k7", contact=of(3)), "^contact = 3 is no Contact; give"),
    "as_built": (lambda: read_tapes((), as_built=of(3)), "^as_built = 3 is no list of files; give files of measured places, or"),
    "code": (lambda: default_origin(of([]), 7), r"^code = \[\] is none of: "),
    "across": (lambda: across(of("k7"), 4), f"^tapes = 'k7' {NO_LIST}"),
    "across none": (lambda: across([], 4), "^tapes holds no tape; give at least one$"),
    "side": (lambda: across([TAPE], of("4")), "^side = '4' is not a whole number; give one from 1 to 16$"),
    "tag side": (lambda: tag_side_mm(of("k7")), NO_TAPE),
    "tag": (lambda: tag_to_texture(of(3)), NO_TAPE),
    "pixels": (lambda: pixels_to_texture(TAPE, of("a"), EYE, ONES, EYE), r"^pixels = 'a' is no array of numbers; give \(u, v\)"),
    "points": (lambda: texture_to_pixels(TAPE, of([[1]]), EYE, ONES, EYE), r"^texture_mm has the shape \(1, 1\); give \(x, y\)"),
    "rotation": (lambda: pixels_to_texture(TAPE, [[1, 2]], of(3), ONES, EYE), r"^rotation has the shape \(\); give a finite"),
    "camera": (lambda: pixels_to_texture(TAPE, [[1, 2]], EYE, ONES, of("x")), "^camera_matrix = 'x' is no array of numbers;"),
    "lens": (lambda: pixels_to_texture(TAPE, [[1, 2]], EYE, ONES, EYE, [1.0]), "^distortion has 1 values; give 4, 5, 8, 12 or"),
    "to board": (lambda: texture_to_board(of("a"), (0.0, 0.0)), "^xy_mm or texture_origin_mm is no point: give points of shape"),
    "to texture": (lambda: board_to_texture([1.0, 2.0], of(3)), "^xy_mm or texture_origin_mm is no point: give points of shape"),
    "max_p_false": (lambda: Localizer(TAPE, max_p_false=of(None)), "^max_p_false = None is not a number; give a probab"),
    "code's bound": (lambda: Localizer.from_code("microdots-4x4", 1.5, 0.25, max_p_false=2.0), "^max_p_false = 2 is not below 1"),
    "code's kappa": (lambda: Localizer.from_code("microdots-4x4", 1.5, 0.25, kappa=0.0), "^kappa = 0 is below 1; give the least"),
    "fixed_scale": (lambda: Localizer(TAPE, fixed_scale=of("no")), "^fixed_scale = 'no' is neither true nor false; give one of"),
    "fix": (lambda: measure_pose(of("k7")), "^fix = 'k7' is no Localization; give what Localizer.locate returns$"),
    "message": (lambda: pose_message(of(None), 0), "^fix = None is no Localization; give what Localizer.locate returns$"),
    "pose": (lambda: transform_message(of(None), "x"), r"^pose = None is no message of a pose; give pose_message\(fix, stamp\)"),
    "depth": (lambda: image_message(of("a"), load_sensor("digit"), 0), r"^depth = 'a' is no array of numbers; give a depth map"),
    "stamp": (lambda: image_message(np.zeros((2, 2)), load_sensor("digit"), of(1.5)), "^stamp = 1.5 is no whole number of ns;"),
    "profile": (lambda: image_message(np.zeros((2, 2)), of("digit"), 0), r"^sensor = 'digit' is no SensorProfile; give"),
    "names": (lambda: observation_names(of("k7")), f"^tapes = 'k7' {NO_LIST}"),
    "forces": (lambda: simulate_forces(TAPE, (1.0, 2.0), 3.0, of("a")), "^forces_n = 'a' is no array of numbers; give a list"),
    "places": (lambda: Parts(xy_mm=of([1, 2]), rotation_deg=of([0])), r"^xy_mm has the shape \(2,\); give arrays of numbers"),
    "rows": (lambda: simulate(TAPE, (1.0, 2.0), 3.0, parts=Parts(xy_mm=of([[1, 2]]), rotation_deg=of([]))), "^parts has places"),
    "mount": (lambda: sensor_on_object("x", of(3), TAPE, (1.0, 2.0), 3.0), "^mount = 3 is no Mount; give Mount"),
    "mirror": (lambda: Mount(surface="plane", rotation=-np.eye(3), position_mm=np.zeros(3)), "^mount.rotation = .* is no ro"),
    "scaled": (lambda: Mount(surface="plane", rotation=2 * np.eye(3), position_mm=np.zeros(3)), "^mount.rotation = .* is no ro"),
    "cone": (lambda: Mount(surface=of("cone"), rotation=np.eye(3), position_mm=np.zeros(3)), "^mount.surface = 'cone' is none"),
    "radius": (lambda: Mount(surface="cylinder", rotation=np.eye(3), position_mm=np.zeros(3)), "^mount.top_mm = 0 mm is not"),
    "around": (lambda: Mount(surface="cylinder", rotation=np.eye(3), position_mm=np.zeros(3), around=of("z")), "^mount.around ="),
    "at": (lambda: measure_pose(FIX, at=TRANSPOSED), "^at is no pose: give a 4 x 4 matrix of a rotation and, in its last column"),
    "transposed": (lambda: pixels_to_texture(TAPE, (1, 2), np.eye(3), (0, 0, 9), CAMERA.T), "^camera_matrix = .* is invalid"),
    "arm pose": (lambda: ArmPose(frame=0, flange_to_base=TRANSPOSED), "^flange_to_base of frame 0 is no pose; give a 4"),
    "arm shape": (lambda: ArmPose(frame=0, flange_to_base=np.eye(3)), r"^flange_to_base has the shape \(3, 3\); give a 4 x 4"),
    "arm poses": (lambda: calibrate_sensor([], TAPE, arm_poses=of([3])), r"^arm_poses = \[3\] is no list of ArmPose; give"),
    "frames": (lambda: calibrate_sensor(of(3), TAPE), r"^frames = 3 is no list of frames; give depth maps \(h, w\), one for"),
    "source": (lambda: LiveSensor(of(3), ["k7"]), "^source = 3 is no path; give a folder, a file of frames, a camera or - for"),
    "kits": (lambda: LiveSensor("f.npz", of(3)), "^kits = 3 is no path; give the paths of kits"),
    "form": (lambda: texture_part(TAPE, of(3)), r"^form = 3 is no SolidForm; give SolidForm\(base_mm=0.8\), or leave it out$"),
    "base": (lambda: texture_part(TAPE, SolidForm(base_mm=of("x"))), "^base_mm = 'x' is not a number in mm; give a number"),
    "model": (lambda: assembly(of("k7")), NO_TAPE),
    "no noise": (lambda: Scene(noise=of(None)), "^scene.noise is missing; give a number$"),
    "no force": (lambda: ElasticContact(force_n=of(None)), "^elastic.force_n = None is not a number in N; give a number from"),
    "no blur": (lambda: ElasticContact(blur_mm=of(None)), "^elastic.blur_mm = None is not a number in mm; give a number from"),
    "ragged pixels": (lambda: pixels_to_texture(TAPE, of(RAGGED), EYE, ONES, EYE), "^pixels = .* is no array of numbers; give"),
    "ragged shift": (lambda: pixels_to_texture(TAPE, [1, 2], EYE, of(RAGGED), EYE), "^translation_mm = .* is no array of num"),
    "ragged lens": (lambda: pixels_to_texture(TAPE, [1, 2], EYE, ONES, EYE, of(RAGGED)), "^distortion = .* is no array of num"),
    "ragged scale": (lambda: Localizer(TAPE, replace(load_sensor("digit"), px_per_mm=of(RAGGED))), r"px_per_mm\[0\] = \[1, 2\]"),
    "space": (lambda: board_to_texture([1.0, 2.0, 3.0], (0.0, 0.0)), "^xy_mm or texture_origin_mm is no point: give points of"),
    "to space": (lambda: texture_to_board([[1.0, 2.0, 3.0]], (0.0, 0.0)), "^xy_mm or texture_origin_mm is no point: give points"),
    "share": (lambda: Localizer(TAPE, unregistered_share=1e-320), "^unregistered_share = .*e-321 is below 1e-300; give a probab"),
    "no manifest": (lambda: TAPE.with_as_built(of(3)), "^manifest = 3 is no path; give the manifest.json of a kit, as a text"),
    "frame": (lambda: FIX.to_mapping(of("x")), "^frame = 'x' is no index; give a whole number, or leave it out$"),
    "long code": (lambda: default_origin("x" * 5000, 7), r"^code = 'x{56}\.\.\. is none of: "),
    "date": (lambda: Localizer(TAPE).locate_dots([], timestamp=of(np.datetime64("now"))), "^timestamp = .* is no number; give"),
}  # fmt: skip


def of(value: Any) -> Any:
    """A value of whatever type a call declares."""
    return value


@pytest.mark.parametrize(("call", "said"), WRONG.values(), ids=WRONG)
def test_what_is_of_another_type_is_refused_with_what_to_give(call: Callable[[], object], said: str) -> None:
    with pytest.raises(SpecError, match=said):
        call()


class OfAnotherLibrary:
    """An array of a library that gives none, as a tensor of PyTorch that requires grad: a network's output as it comes."""

    def __array__(self, dtype: object = None, copy: object = None) -> NoReturn:
        raise RuntimeError("Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead.")


@pytest.mark.parametrize(
    "call",
    [
        lambda given: Localizer(TAPE).locate(given),
        lambda given: Localizer(TAPE).locate_dots(given),
        lambda given: image_message(given, load_sensor("digit"), 0),
        lambda given: simulate(TAPE, (1.0, 2.0), 0.0, parts=given),
        lambda given: pixels_to_texture(TAPE, given, EYE, ONES, EYE),
        lambda given: texture_to_board(given, (0.0, 0.0)),
        lambda given: refine_tag_pose(TAPE, given, EYE, ONES, EYE),
        lambda given: calibrate_sensor([given] * 10, TAPE),
    ],
    ids=["locate", "dots", "image_message", "simulate", "pixels_to_texture", "texture_to_board", "refine_tag_pose", "calibrate"],
)
def test_what_another_library_gives_no_array_of_is_refused(call: Callable[[Any], object]) -> None:
    with pytest.raises((FrameError, SpecError), match=r"no array|no point|no depth map"):
        call(OfAnotherLibrary())


def test_a_time_beyond_any_number_is_refused() -> None:
    with pytest.raises(FrameError, match=r"^timestamp = <int too long to show> is no time; give seconds$"):
        Tracker(Localizer(TAPE)).update_dots([], timestamp=10**5000)


def test_a_picture_of_rows_of_several_lengths_is_refused() -> None:
    with pytest.raises(FrameError, match=r"^the picture's rows have several lengths; give \(h, w\) gray levels, uint8$"):
        refine_tag_pose(TAPE, of(RAGGED), EYE, (0, 0, 9), CAMERA)


def test_a_manifest_may_be_named_by_a_text(small_kit: Kit) -> None:
    assert small_kit.tape.with_as_built(str(small_kit.path / "manifest.json")).name == small_kit.tape.name


def test_wrong_types_are_said_together() -> None:
    with pytest.raises(SpecError) as caught:
        simulate(of("k7"), (1.0, 2.0), 3.0, scene=of(3), sensor=of(5))
    assert [p.key for p in caught.value.problems] == ["tape", "sensor", "scene"]


def test_a_spec_takes_arrays_and_paths() -> None:
    fab = templates_folder() / "fabs" / "generic-fpc.toml"
    taken = TapeSpec(
        sector=of(np.int64(7)), size_mm=of(np.array([100, 50])), fab=of(fab), holes_mm=of(np.array([[50.0, 3.0, 1.0]]))
    )
    usual = TapeSpec(sector=7, size_mm=(100, 50), fab=str(fab), holes_mm=[(50.0, 3.0, 1.0)])
    assert (
        taken
        == usual
        == TapeSpec.from_mapping({"sector": 7, "size_mm": np.array([100, 50]), "fab": fab, "holes_mm": [(50.0, 3.0, 1.0)]})
    )
    assert hash(taken) == hash(usual)


# Sensors


def test_a_sensor_is_a_name_a_path_or_a_profile() -> None:
    path = templates_folder() / "sensors" / "digit.toml"
    for sensor in (path, str(path), "digit", load_sensor(path)):
        assert Localizer(TAPE, sensor=sensor).sensor.name == "digit"
    assert (simulate(TAPE, (20.0, 12.0), 30.0, sensor=path) == simulate(TAPE, (20.0, 12.0), 30.0, sensor="digit")).all()


@pytest.mark.parametrize("sensor", [5, None, ["digit"], {"name": "digit"}])
def test_what_is_no_sensor_is_refused(sensor: Any) -> None:
    for call in (lambda: Localizer(TAPE, sensor=sensor), lambda: simulate(TAPE, (20.0, 12.0), 30.0, sensor=sensor)):
        with pytest.raises(SpecError, match=r"is no sensor; give the name of a profile, a \.toml file, or a SensorProfile"):
            call()


@pytest.mark.parametrize("sensor", ["gelsight-maxi", Path("nowhere.toml")])
def test_a_sensor_that_is_not_there_is_named(sensor: str | Path) -> None:
    with pytest.raises(SpecError, match=Path(sensor).stem):
        Localizer(TAPE, sensor=sensor)


def test_a_profile_of_one_s_own_is_taken() -> None:
    own = SensorProfile(name="mine", title="Mine", width_px=320, height_px=240, px_per_mm=(16.0, 16.0))
    assert Localizer(TAPE, own).locate_dots(dots((20.0, 12.0), 30.0)).located


@pytest.mark.parametrize(
    "wrong",
    [
        {"width_px": 0}, {"width_px": 320.0}, {"height_px": "240"}, {"height_px": 10**9},
        {"px_per_mm": 16.0}, {"px_per_mm": None}, {"px_per_mm": (0.0, 16.0)},
        {"px_per_mm": (16.0, float("nan"))}, {"px_per_mm": (1e9, 16.0)},
        {"sign": 0}, {"sign": "1"},
        {"mirror": 1}, {"rotate90": 90}, {"mask": "ellipse"},
        {"mask": np.ones((320, 240), dtype=bool)}, {"mask": np.ones((240, 320))},
        {"depth_unit_mm": 0.0}, {"white_um": None}, {"slope_noise": -1.0}, {"scale_tolerance": float("inf")}, {"geometry": None},
        {"gel": 3}, {"name": 3}, {"title": None},
    ],
)  # fmt: skip
def test_a_profile_of_one_s_own_that_no_sensor_has_is_refused(wrong: dict[str, Any]) -> None:
    made: dict[str, Any] = {"name": "mine", "title": "Mine", "width_px": 320, "height_px": 240, "px_per_mm": (16.0, 16.0)} | wrong
    for call in (lambda own: Localizer(TAPE, own), lambda own: simulate(TAPE, (20.0, 12.0), 30.0, sensor=own)):
        with pytest.raises(SpecError, match=rf"^sensor .*: {next(iter(wrong))}(\[[01]\])? .*; (give|leave) ") as caught:
            call(SensorProfile(**made))
        assert len(caught.value.problems) == 1


def test_a_profile_s_geometry_and_gel_are_looked_at_too() -> None:
    mini = load_sensor("gelsight-mini")
    own = replace(mini, geometry=replace(mini.geometry, k1=5.0), gel=replace(mini.gel, thickness_mm=0.0, crown_mm=(1.0, 1.0)))
    with pytest.raises(SpecError) as caught:
        Localizer(TAPE, own)
    assert [p.key for p in caught.value.problems] == ["geometry.k1", "gel.thickness_mm", "gel.crown_mm[0]", "gel.crown_mm[1]"]


@pytest.mark.parametrize("scale", [[16, 16], np.array([16.0, 16.0], dtype=np.float32)])
def test_a_profile_takes_any_two_numbers_as_its_scale(scale: Any) -> None:
    own = SensorProfile(name="mine", title="Mine", width_px=320, height_px=240, px_per_mm=scale)
    assert Localizer(TAPE, own).locate(simulate(TAPE, (20.0, 12.0), 30.0, sensor=own)).located


# Priors


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"position_mm": 5.0}, "position_mm"),
        ({"position_mm": "ab"}, "position_mm"),
        ({"position_mm": ("1", "2")}, "position_mm"),
        ({"position_mm": (1.0, 2.0, 3.0)}, "position_mm"),
        ({"position_mm": (1.0, float("nan"))}, "position_mm"),
        ({"position_mm": None}, "position_mm"),
        ({"theta_deg": "30"}, "theta_deg"),
        ({"theta_deg": float("inf")}, "theta_deg"),
        ({"radius_mm": -1.0}, "radius_mm"),
        ({"radius_mm": "2"}, "radius_mm"),
        ({"angle_deg": 400.0}, "angle_deg"),
        ({"angle_deg": None}, "angle_deg"),
        ({"tape": TAPE}, "tape"),
    ],
)
def test_a_wrong_prior_is_refused(values: dict[str, Any], key: str) -> None:
    with pytest.raises(SpecError, match=rf"^{key} = ") as caught:
        Prior(**{"position_mm": (20.0, 12.0), "theta_deg": 30.0, **values})
    assert [p.key for p in caught.value.problems] == [key]


def test_a_prior_takes_arrays() -> None:
    position: Any = np.array([20.0, 12.0], dtype=np.float32)
    assert Prior(position_mm=position, theta_deg=np.float64(30.0)).radius_mm == 2.0


def test_what_is_no_prior_is_refused_with_the_line_to_write(localizer: Localizer) -> None:
    fix: Any = localizer.locate_dots(dots((20.0, 12.0), 30.0))
    others: list[Any] = [fix, (20.0, 12.0), {"theta_deg": 30.0}]
    for wrong in others:
        with pytest.raises(SpecError, match=r"not a Prior; give Prior\(position_mm=fix\.position_mm, theta_deg=fix\.theta_deg\)"):
            localizer.locate_dots(dots((20.0, 12.0), 30.0), prior=wrong)
    right = Prior(position_mm=fix.position_mm, theta_deg=fix.theta_deg)
    assert localizer.locate_dots(dots((20.0, 12.0), 30.0), prior=right).located
    assert localizer.locate_dots(dots((20.0, 12.0), 30.0), prior=replace(right, tape=fix.tape)).located
    with pytest.raises(
        SpecError, match=rf"^prior\.tape = 'tactape-s7' is the name of no registered tape; give one of {fix.tape}, or"
    ):
        localizer.locate_dots(dots((20.0, 12.0), 30.0), prior=replace(right, tape="tactape-s7"))


# Colour images


def test_one_scale_is_that_of_both_axes(network: Network) -> None:
    image = GREY.copy()
    image[2:5, 3:8] = 160
    one, two = (make_reconstruction(GREY, network, px) for px in (16.0, (16.0, 16.0)))
    assert one.px_per_mm == two.px_per_mm == (16.0, 16.0)
    assert (one.depth(image) == two.depth(image)).all()
    assert make_reconstruction(GREY, network, np.array([16.0, 15.0])).px_per_mm == (16.0, 15.0)


@pytest.mark.parametrize("scale", [0.0, -16.0, float("nan"), "16", None, (16.0,), (16.0, 0.0), (16.0, 16.0, 16.0), True])
def test_a_scale_that_is_none_is_refused(network: Network, scale: Any) -> None:
    with pytest.raises(SpecError, match=r"^px_per_mm.*; give px/mm, such as 16\.0, or \(u, v\)"):
        make_reconstruction(GREY, network, scale)


def test_a_network_s_path_is_no_network(tmp_path: Path) -> None:
    wrong: Any = tmp_path / "nnmodel.pth"
    with pytest.raises(SpecError, match=r"is no network; give load_network\(FILE\.pth\)"):
        make_reconstruction(GREY, wrong, 16.0)


def test_a_tape_loads_from_a_folder_or_a_manifest(small_kit: Kit) -> None:
    assert Tape.load(small_kit.path).name == Tape.load(str(small_kit.path / "manifest.json")).name == small_kit.tape.name


@pytest.mark.parametrize("array", [np.array([1e-6, 1e-5]), np.array([True, False]), np.zeros((2, 2))])
@pytest.mark.parametrize(
    ("key", "call"),
    [
        ("max_p_false", lambda array: Localizer(TAPE, max_p_false=array)),
        ("world", lambda array: Localizer(TAPE, world=array)),
        ("fixed_scale", lambda array: Localizer(TAPE, fixed_scale=array)),
        ("kappa", lambda array: Localizer.from_code("microdots-4x4", 1.5, 0.25, kappa=array)),
        ("scene.mirrored_tape", lambda array: simulate(TAPE, (1.0, 2.0), 3.0, mirrored_tape=array)),
        ("edge", lambda array: draw_poses(TAPE, 1, edge=array)),
        ("rate", lambda array: LiveSensor("f.npz", ["k7"], rate=array)),
        ("background", lambda array: LiveSensor("f.npz", ["k7"], background=array)),
        ("weights", lambda array: LiveSensor("f.npz", ["k7"], weights=array)),
        ("force", lambda array: list_tapes({"sectors": "1", "pitch_mm": 0.9}, {}, Path(), force=array)),
    ],
)
def test_an_array_is_no_option(key: str, call: Callable[[Any], object], array: Any) -> None:
    """One line that names the key, also of an array of several rows."""
    with pytest.raises(SpecError, match=rf"(?m)^{key} = array\(.*; give "):
        call(array)


def test_what_is_masked_is_no_value() -> None:
    pose = np.ma.array([(1.0, 2.0, 3.0)], mask=[(False, True, False)])
    with pytest.raises(SpecError, match=r"^position_mm\[1\] = nan mm is not a finite number"):
        simulate_frames(TAPE, 1, poses=pose)
    with pytest.raises(SpecError, match=r"^parts holds a value that is not finite"):
        simulate(TAPE, (1.0, 2.0), 3.0, parts=pose)
    camera = np.diag((1.0, -1.0, -1.0)), (0.0, 0.0, 100.0), [(500.0, 0.0, 320.0), (0.0, 500.0, 240.0), (0.0, 0.0, 1.0)]
    hidden = np.ma.array([(100.0, 200.0), (300.0, 210.0)], mask=[(True, True), (False, False)])
    for way in (pixels_to_texture, texture_to_pixels):
        assert np.isnan(way(TAPE, hidden, *camera)).tolist() == [[True, True], [False, False]]
        assert np.isnan(way(TAPE, hidden[0], *camera)).all()


def test_a_place_to_simulate_may_be_a_row_of_poses() -> None:
    drawn = draw_poses(TAPE, 1, seed=3)
    x, y, theta_deg = drawn[0].tolist()
    np.testing.assert_array_equal(simulate(TAPE, drawn[0, :2], theta_deg), simulate(TAPE, (x, y), theta_deg))
