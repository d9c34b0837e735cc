"""The commands simulate and decode: what they print and write, what they refuse, and that decode finds what simulate hid."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
import numpy.typing as npt
import pytest
from click.testing import Result

from tactape_fab import Kit, Localizer, SpecError
from tactape_fab.cli import command
from tests.commands import run

KEYS = {
    "frame", "status", "located", "reason", "tape", "sector", "position_mm", "theta_deg", "board_mm", "contact_mm", "cell",
    "index", "px_per_mm", "covariance", "n_dots", "n_agree", "p_tape", "p_place", "p_false", "elapsed_ms", "timestamp",
    "strain", "strain_sigma", "tilt_deg", "tilt_covariance", "indentation_mm", "indentation_sigma_mm", "force_n", "force_sigma_n",
}  # fmt: skip
SPEC_OF_ANSWER = KEYS | {"plane_mm", "refined", "refine_reason", "places"}


def answers(result: Result) -> list[dict[str, Any]]:
    assert result.exit_code == 0, result.stderr

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    return [json.loads(line, parse_constant=refuse) for line in result.stdout.splitlines()]


@pytest.fixture(scope="module")
def frames(default_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four frames of the default tape; not to be changed."""
    path = tmp_path_factory.mktemp("frames") / "frames.npz"
    result = run(f"simulate {default_kit.path} -o {path} --count 4 --seed 3")
    assert result.exit_code == 0, result.stderr
    return path


# simulate


def test_simulate_says_what_it_wrote(default_kit: Kit, frames: Path) -> None:
    result = run(f"simulate {default_kit.path} -o {frames.with_name('again.npz')} --count 4 --seed 3")
    assert result.stderr == ""
    assert result.stdout == f"{frames.with_name('again.npz')}: 4 frames of 240 x 320 px, tactape-s007 as gelsight-mini sees it\n"
    assert frames.with_name("again.npz").read_bytes() == frames.read_bytes()


def test_simulate_takes_a_pose_and_a_scene(small_kit: Kit, tmp_path: Path) -> None:
    path = tmp_path / "f.npz"
    options = (
        "--pose 4,8.5,-30 --contact 7x6 --missing 0.1 --bumps 2 --noise 2 --placement 0.05mm --elastomer 0.2 --scale-error 0.03 "
        "--noise-model smooth --aspect-error 0.03 --shear-error -0.01 --k1-error 0.02 --gel-displacement 50 --gel-correlation 3mm"
    )
    result = run(f"simulate {small_kit.path} -o {path} --count 2 --sensor digit {options}")
    assert result.exit_code == 0, result.stderr
    with np.load(path) as arrays:
        assert arrays["depth"].shape == (2, 320, 240)
        np.testing.assert_array_equal(arrays["position_mm"], [(4.0, 8.5)] * 2)
        np.testing.assert_array_equal(arrays["theta_deg"], [-30.0] * 2)
        scene = json.loads(str(arrays["scene"]))["scene"]
    wanted = {
        "contact": "ellipse", "contact_mm": [7.0, 6.0], "missing": 0.1, "bumps": 2, "noise": 2.0, "placement_mm": 0.05,
        "elastomer_mm": 0.2, "scale_error": 0.03, "noise_model": "smooth", "aspect_error": 0.03, "shear_error": -0.01,
        "k1_error": 0.02, "gel_displacement_um": 50.0, "gel_correlation_mm": 3.0,
    }  # fmt: skip
    assert {key: scene[key] for key in wanted} == wanted


@pytest.mark.parametrize(("option", "contact"), [("--contact pad", "pad"), ("--cylinder 12", "strip")])
def test_simulate_takes_other_contacts(small_kit: Kit, tmp_path: Path, option: str, contact: str) -> None:
    assert run(f"simulate {small_kit.path} -o {tmp_path / 'f.npz'} {option}").exit_code == 0
    with np.load(tmp_path / "f.npz") as arrays:
        assert json.loads(str(arrays["scene"]))["scene"]["contact"] == contact


def test_simulate_says_that_it_draws_a_wrapped_kit_flat(tmp_path: Path) -> None:
    assert run(f"make --sector 7 --part dome --cylinder 20 --size 20x20 --no-verify -o {tmp_path / 'round'}").exit_code == 0
    flat, bent = (run(f"simulate {tmp_path / 'round'} -o {tmp_path / 'f.npz'} {option}") for option in ("", "--cylinder 20"))
    assert "warning: the kit is wrapped round a radius of 20 mm, and drawn flat; --cylinder 20 " in flat.stderr
    assert bent.stderr == ""
    listed = run(f"simulate {tmp_path / 'round'} -o {tmp_path / 'f.npz'} --from cpl")
    assert listed.exit_code == 2 and "has no pick-and-place file; leave out --from cpl, or --from-cpl" in listed.stderr
    scanned = run(f"inspect s.png --tape {tmp_path / 'round'} -o {tmp_path / 'a.json'}")
    assert "reads scans of films with parts on them, and tactape-s007 has none; name other kits" in scanned.stderr


def test_simulate_presses_an_elastic_gel(small_kit: Kit, tmp_path: Path) -> None:
    path = tmp_path / "f.npz"
    options = (
        "--force 3.5 --tilt 1,-2 --cylinder 20mm --gel-thickness 3mm --gel-modulus 300 --markers --elastomer 0.05 --missing 0.1"
    )
    result = run(f"simulate {small_kit.path} -o {path} --contact-model elastic {options}")
    assert result.exit_code == 0, result.stderr
    with np.load(path) as arrays:
        assert arrays["depth"].max() > 0.1
        scene = json.loads(str(arrays["scene"]))["scene"]
    wanted = {
        "force_n": 3.5, "tilt_deg": [1.0, -2.0], "cylinder_radius_mm": 20.0, "thickness_mm": 3.0, "modulus_kpa": 300.0,
        "markers": True, "blur_mm": 0.05,
    }  # fmt: skip
    assert {key: scene["elastic"][key] for key in wanted} == wanted
    assert (scene["contact"], scene["missing"]) == ("strip", 0.1)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--force 2", "add --contact-model elastic"),
        ("--markers", "add --contact-model elastic"),
        ("--contact-model rigid", "--contact-model = 'rigid'"),
        ("--contact-model elastic --contact 5x5", "--contact contradicts --contact-model = 'elastic': its force"),
        ("--contact-model elastic --force -1 --tilt 3", "--tilt = '3'"),
        ("--contact-model elastic --force none --missing 2", "--force = 'none'"),
        ("--count 0", "count = 0"),
        ("--count many", "count = 'many'"),
        ("--seed -1", "seed = -1"),
        ("--pose 1,2", "--pose = '1,2'"),
        ("--pose 1,2,nan", "--pose = '1,2,nan': nan is not a finite number"),
        ("--pose 1,2,3 --edge", "--edge spreads poses, and poses are given; leave it out, or --pose"),
        ("--contact 0x0", "--contact"),
        ("--contact round", "--contact = 'round'"),
        ("--contact 5x5 --cylinder 10", "--cylinder contradicts --contact = '5x5': both name"),
        ("--missing 1.5", "missing = 1.5"),
        ("--noise loud", "noise = 'loud'"),
        ("--sensor eye", "sensor = 'eye'"),
    ],
)
def test_simulate_refuses_with_a_word(small_kit: Kit, tmp_path: Path, options: str, words: str) -> None:
    result = run(f"simulate {small_kit.path} -o {tmp_path / 'f.npz'} {options}")
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_simulate_names_all_problems(tmp_path: Path) -> None:
    result = run(f"simulate {tmp_path / 'gone'} -o {tmp_path / 'f.txt'} --count 0 --missing 2 --sensor eye")
    assert result.exit_code == 2
    assert [word in result.stderr for word in ("gone", "f.txt", "count", "missing", "'eye'")] == [True] * 5
    assert len(result.stderr.splitlines()) == 5


def test_simulate_that_cannot_write_fails(small_kit: Kit, tmp_path: Path) -> None:
    assert "no folder" in run(f"simulate {small_kit.path} -o {tmp_path / 'none' / 'f.npz'}").stderr
    assert run(f"simulate {small_kit.path}").exit_code == 2


# decode


def test_decode_finds_what_simulate_hid(default_kit: Kit, frames: Path) -> None:
    found = answers(run(f"decode {frames} --tape {default_kit.path} --json"))
    with np.load(frames) as truth:
        for k, fix in enumerate(found):
            assert set(fix) == SPEC_OF_ANSWER
            assert (fix["frame"], fix["located"], fix["reason"], fix["tape"], fix["sector"]) == (k, True, None, "tactape-s007", 7)
            assert np.hypot(*(np.array(fix["position_mm"]) - truth["position_mm"][k])) < 0.05
            assert abs((fix["theta_deg"] - truth["theta_deg"][k] + 180) % 360 - 180) < 0.5
            x, y = fix["position_mm"]
            x0, y0 = default_kit.tape.board.texture_origin_mm
            assert fix["board_mm"] == pytest.approx([x0 + x, y0 - y])
            assert 0 <= fix["p_false"] <= 1e-4
            assert np.shape(fix["covariance"]) == (3, 3)


def test_decode_says_what_each_dot_says_if_asked(default_kit: Kit, frames: Path) -> None:
    plain, found = (answers(run(f"decode {frames} --tape {default_kit.path} --json{more}")) for more in ("", " --dots"))
    for without, fix in zip(plain, found, strict=True):
        told = fix.pop("dots")
        assert set(told) == {"uv_px", "cell", "symbol", "residual_mm", "inlier"}
        assert {len(rows) for rows in told.values()} == {fix["n_dots"]} and sum(told["inlier"]) == fix["n_agree"]
        assert fix["cell"] in told["cell"]
        assert {**fix, "elapsed_ms": 0} == {**without, "elapsed_ms": 0}
        assert fix["strain"][2] is None and max(fix["strain_sigma"][:2]) < 0.01


def test_decode_says_what_each_dot_says_in_json_alone(default_kit: Kit, frames: Path) -> None:
    result = run(f"decode {frames} --tape {default_kit.path} --dots")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "--json" in result.stderr


def test_decode_prints_a_table_and_a_summary(default_kit: Kit, frames: Path) -> None:
    result = run(f"decode {frames} --tape {default_kit.path}")
    assert result.exit_code == 0
    header, *rows = result.stdout.splitlines()
    assert header.split() == ["frame", "status", "dots", "tape", "x", "mm", "y", "mm", "theta", "deg", "p_false"]
    assert [row.split()[0] for row in rows] == ["0", "1", "2", "3"]
    assert all("tactape-s007" in row for row in rows)
    assert result.stderr.startswith("located 4 of 4 frames; median ")


def test_frames_count_on_over_all_files_and_times_pass_through(default_kit: Kit, frames: Path, tmp_path: Path) -> None:
    with np.load(frames) as arrays:
        depth = arrays["depth"]
    np.savez(tmp_path / "timed.npz", depth=depth[:2], timestamp=[10.5, np.nan], px_per_mm=16.3)
    np.save(tmp_path / "one.npy", depth[2])
    counts = np.round((depth[3] - depth[3].min()) * 60000).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "one.png"), counts)
    inputs = " ".join(str(p) for p in (tmp_path / "timed.npz", tmp_path / "one.npy", tmp_path / "one.png"))
    found = answers(run(f"decode {inputs} --tape {default_kit.path} --json"))
    assert [fix["frame"] for fix in found] == [0, 1, 2, 3]
    assert [fix["timestamp"] for fix in found] == [10.5, None, None, None]
    assert all(fix["located"] for fix in found)
    assert all(abs(fix["px_per_mm"] / 16 - 1) < 0.02 for fix in found)


def test_a_frame_that_is_not_located_is_an_answer(default_kit: Kit, tmp_path: Path) -> None:
    np.save(tmp_path / "flat.npy", np.zeros((2, 240, 320)))
    result = run(f"decode {tmp_path / 'flat.npy'} --tape {default_kit.path} --json")
    for fix in answers(result):
        assert (fix["status"], fix["located"]) == ("none", False)
        assert fix["reason"]
        unknown = ("tape", "sector", "position_mm", "theta_deg", "board_mm", "contact_mm", "cell", "index", "covariance")
        assert all(fix[key] is None for key in unknown)
    assert result.stderr.startswith("located 0 of 2 frames")
    assert "not located: " in run(f"decode {tmp_path / 'flat.npy'} --tape {default_kit.path}").stdout


def test_tapes_may_be_listed_after_one_option_or_lie_in_a_folder(
    default_kit: Kit, small_kit: Kit, frames: Path, tmp_path: Path
) -> None:
    (tmp_path / "a").symlink_to(small_kit.path)
    (tmp_path / "b").symlink_to(default_kit.path)
    manifest = default_kit.path / "manifest.json"
    for tapes in (f"--tape {small_kit.path} --tape {manifest}", f"--tape {small_kit.path} {manifest}", f"--tape {tmp_path}"):
        assert {fix["tape"] for fix in answers(run(f"decode {frames} {tapes} --json"))} == {"tactape-s007"}


def test_worlds_bounds_and_scale_are_passed_on(default_kit: Kit, frames: Path) -> None:
    decode = f"decode {frames} --tape {default_kit.path} --json"
    closed = answers(run(f"{decode} --world closed"))
    for opened, narrow in zip(answers(run(decode)), closed, strict=True):
        assert narrow["located"] and narrow["p_place"] < opened["p_place"]
    assert not any(fix["located"] for fix in answers(run(f"{decode} --max-p-false 1e-300")))
    for fix in answers(run(f"{decode} --fixed-scale")):
        assert fix["px_per_mm"] == pytest.approx(16.0, rel=1e-9)


def test_poses_are_refined_on_the_pixels_when_asked(default_kit: Kit, frames: Path) -> None:
    plain, refined = (answers(run(f"decode {frames} --tape {default_kit.path} --json {o}")) for o in ("", "--refine pixels"))
    assert {fix["refined"] for fix in plain} == {"dots"} and {fix["refined"] for fix in refined} == {"pixels"}
    for before, after in zip(plain, refined, strict=True):
        assert after["refine_reason"] is None and before["cell"] == after["cell"]
        assert 0.0 < np.hypot(*np.subtract(before["position_mm"], after["position_mm"])) < 0.02


@pytest.mark.parametrize("options", ["--tape {kit} --refine pixel", "--code microdots-4x4 --refine pixels"])
def test_another_way_to_refine_is_refused(default_kit: Kit, frames: Path, options: str) -> None:
    result = run(f"decode {frames} {options.format(kit=default_kit.path)}")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "refine" in result.stderr


def test_the_paper_s_method_bounds_nothing(default_kit: Kit, frames: Path) -> None:
    found = answers(run(f"decode {frames} --tape {default_kit.path} --method paper --json"))
    assert any(fix["located"] for fix in found)
    for fix in found:
        assert set(fix) == SPEC_OF_ANSWER
        assert [fix[key] for key in ("p_tape", "p_place", "p_false", "covariance")] == [None] * 4


@pytest.mark.parametrize(
    ("options", "setting"),
    [
        ("--max-p-false 1e-3", {"max_p_false": 1e-3}),
        ("--max-p-tape 1e-2", {"max_p_tape": 1e-2}),
        ("--world closed", {"world": "closed"}),
        ("--fixed-scale", {"fixed_scale": True}),
        ("--refine pixels", {"refine": "pixels"}),
        ("--refine dots", {"refine": "dots"}),
        ("--world open", None),
    ],
)
def test_the_paper_s_method_refuses_what_it_does_not_know(
    default_kit: Kit, frames: Path, options: str, setting: dict[str, Any] | None
) -> None:
    """In the words of Python, with options in place of arguments."""
    result = run(f"decode {frames} --tape {default_kit.path} --method paper {options}")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(f"error: {options.split(maxsplit=1)[0]}")
    _, words = result.stderr.strip().split(": method ")
    assert words.endswith("; leave it out, or give --method ml")
    if setting is not None:
        with pytest.raises(SpecError) as caught:
            Localizer(default_kit.tape, method="paper", **setting)
        assert str(caught.value).split(": method ")[1] == words.replace("--method ml", "method='ml'")


def test_without_a_tape_the_code_tells_sector_and_place(default_kit: Kit, tmp_path: Path) -> None:
    path = tmp_path / "large.npz"
    assert run(f"simulate {default_kit.path} -o {path} --count 2 --contact 14x12").exit_code == 0
    for options in ("--code microdots-4x4", "--code microdots-4x4 --w 1.5mm --delta 0.25 --max-p-false 1e-6"):
        found = answers(run(f"decode {path} {options} --json"))
        with np.load(path) as truth:
            for fix, position_mm in zip(found, truth["position_mm"], strict=True):
                assert (fix["located"], fix["sector"]) == (True, 7)
                assert np.hypot(*(np.array(fix["plane_mm"]) - position_mm - np.array(default_kit.tape.origin) * 1.5)) < 0.05
                assert [fix[key] for key in ("tape", "cell", "position_mm", "board_mm", "contact_mm")] == [None] * 5
    assert "sector 7" in run(f"decode {path} --code microdots-4x4").stdout


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--code braille", "code = 'braille'"),
        ("--code anoto-6x6", "anoto-6x6"),
        ("--code microdots-4x4 --w 0", "w = 0"),
        ("--code microdots-4x4 --w 1.5 --delta 0.8", "delta = 0.8"),
        (
            "--code microdots-4x4 --w 0.0015 --delta 0.00025",
            "--w = 0.0015 mm is below 0.2 mm; --w is the grid pitch in millimetres",
        ),
        ("--code microdots-4x4 --w 30 --delta 5", "--w = 30 mm exceeds 20 mm"),
        ("--code microdots-4x4 --delta 0.001", "--delta = 0.001 mm is below 0.02 mm"),
        ("--code microdots-4x4 --world closed", "--world"),
        ("--code microdots-4x4 --max-p-tape 0.01", "--max-p-tape"),
        ("--code microdots-4x4 --method paper", "--code = 'microdots-4x4': method 'paper' needs tapes"),
        ("--w 1.5", "no tape is given"),
    ],
)
def test_a_bare_code_is_refused_with_a_word(frames: Path, options: str, words: str) -> None:
    result = run(f"decode {frames} {options}")
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--max-p-false 0", "--max-p-false = 0"),
        ("--max-p-false 1e-4x", "--max-p-false = '1e-4x'"),
        ("--max-p-tape nan", "--max-p-tape = nan"),
        ("--code microdots-4x4", "--code and --tape"),
        ("--w 1.5 --delta 0.25", "--w, --delta and --tape"),
        ("--world flat", "world = 'flat'"),
        ("--method best", "method = 'best'"),
        ("--sensor digit", "are 320 x 240; give another --sensor"),
        ("--sensor my.toml", "my.toml"),
    ],
)
def test_decode_refuses_with_a_word(default_kit: Kit, frames: Path, options: str, words: str) -> None:
    result = run(f"decode {frames} --tape {default_kit.path} {options}")
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_decode_names_what_is_not_given() -> None:
    result = run("decode")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "FRAMES" in result.stderr and "--tape" in result.stderr


def test_a_kit_among_the_frames_is_no_frame(default_kit: Kit, frames: Path) -> None:
    result = run(f"decode {frames} {default_kit.path}")
    assert result.exit_code == 2
    assert "--tape" in result.stderr


def test_a_file_that_ends_early_gives_its_whole_frames_and_a_message(default_kit: Kit, frames: Path, tmp_path: Path) -> None:
    with np.load(frames) as arrays:
        np.save(tmp_path / "f.npy", arrays["depth"])
    data = (tmp_path / "f.npy").read_bytes()
    (tmp_path / "f.npy").write_bytes(data[: len(data) // 2])
    result = run(f"decode {tmp_path / 'f.npy'} --tape {default_kit.path} --json")
    assert result.exit_code == 2
    assert len(result.stdout.splitlines()) == 1
    assert "ends in the middle of a frame" in result.stderr


def test_overlay_writes_a_picture_of_every_frame(default_kit: Kit, frames: Path, tmp_path: Path) -> None:
    from tactape_fab.sense.overlay import _AGREEING, _OTHER, _X_AXIS, _Y_AXIS, PANEL_PX, WORDS_PX

    np.save(tmp_path / "flat.npy", np.full((240, 320), np.nan))
    folder = tmp_path / "deep" / "overlay"
    result = run(f"decode {frames} {tmp_path / 'flat.npy'} --tape {default_kit.path} --overlay {folder}")
    assert result.exit_code == 0, result.stderr
    assert sorted(p.name for p in folder.iterdir()) == [f"frame-{k:06d}.png" for k in range(5)]
    picture = cv2.imread(str(folder / "frame-000000.png"))
    assert picture is not None and picture.shape == (WORDS_PX + 720 + PANEL_PX, 960, 3)
    frame, panel = picture[WORDS_PX:-PANEL_PX], picture[-PANEL_PX:]

    def painted(image: npt.NDArray[np.uint8], colour: tuple[int, int, int]) -> int:
        return int((image == colour).all(axis=-1).sum())

    assert painted(frame, _AGREEING) > 500 and min(painted(frame, _X_AXIS), painted(frame, _Y_AXIS)) > 50
    assert painted(panel[:, :-PANEL_PX], _OTHER) > 50, "the sensor's field on the tape"
    assert painted(panel[:, -PANEL_PX:], _AGREEING) > 50, "the ellipse of the error"
    lost = cv2.imread(str(folder / "frame-000004.png"))
    assert lost is not None and lost.shape == picture.shape
    assert painted(np.asarray(lost[WORDS_PX:]), _AGREEING) == 0
    taken = tmp_path / "taken"
    taken.write_text("mine")
    result = run(f"decode {frames} --tape {default_kit.path} --overlay {taken}")
    assert result.exit_code == 2
    assert "is there and is no folder; nothing was touched" in result.stderr


def test_overlay_draws_the_parts_where_the_dots_are(default_kit: Kit, frames: Path) -> None:
    """The inverse of the pose equation of docs/frames.md, against the simulator's true dots."""
    from tactape_fab.sense import iterate_frames
    from tactape_fab.sense.files.jobs import localize, prepare
    from tactape_fab.sense.overlay import View, placed_mm

    job = prepare([str(frames)], [str(default_kit.path)], "gelsight-mini")
    for located, true in zip(localize(job), iterate_frames(default_kit.tape, 4, 3), strict=True):
        drawn = View(located.sensor, located.fix, 3).to_px(placed_mm(default_kit.tape))
        wanted = (true.dots_px + 0.5) * 3 - 0.5
        nearest = np.hypot(*(drawn[None] - wanted[:, None]).transpose(2, 0, 1)).min(axis=1)
        assert nearest.max() < 3.0  # one pixel of the frame


# Help


@pytest.mark.parametrize("name", ["simulate", "decode"])
def test_every_option_is_documented(name: str) -> None:
    text = run(f"{name} --help").stdout
    reference = (Path(__file__).parents[3] / "docs" / "reference.md").read_text(encoding="utf-8")
    for option in command(name).params:
        if isinstance(option, click.Option):
            assert option.help and all(declared in text for declared in option.opts)
            assert all(f"`{declared}" in reference for declared in option.opts if declared.startswith("--")), option.opts


@pytest.mark.parametrize("name", ["simulate", "decode"])
def test_help_loads_nothing_of_weight(name: str) -> None:
    code = (
        "import sys\nfrom tactape_fab.cli import main\n"
        f"main(['{name}', '--help'], standalone_mode=False)\n"
        "print(sorted({'numba', 'numpy', 'cv2', 'scipy', 'build123d', 'trimesh'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    assert out.stdout.splitlines()[-1] == "[]"


def test_decoding_loads_no_cad_and_no_mesh_library(default_kit: Kit, frames: Path) -> None:
    code = (
        "import sys\nfrom tactape_fab.cli import main\n"
        f"main(['decode', {str(frames)!r}, '--tape', {str(default_kit.path)!r}], standalone_mode=False)\n"
        "print(sorted({'build123d', 'trimesh', 'manifold3d', 'gerbonara', 'shapely'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    assert out.stdout.splitlines()[-1] == "[]"


def test_a_scale_is_corrected_where_it_counts(default_kit: Kit, tmp_path: Path) -> None:
    """A file's own px/mm goes before the profile's, so a reason that names the profile alone would lead nowhere."""
    kit, own, bare = default_kit.path, tmp_path / "own.npz", tmp_path / "bare.npz"
    assert run(f"simulate {kit} -o {own} --count 2 --scale-error 0.3").exit_code == 0
    with np.load(own) as frames:
        np.savez(bare, depth=frames["depth"])
    remedy = "(the file has a px_per_mm of its own, which counts: correct it, or leave it out), or name a tape of W"
    for words in ("decode", "watch --rate max"):
        by_file, by_profile = (run(f"{words} {path} --tape {kit} --json").stdout for path in (own, bare))
        assert all("px_per_mm = [20.8" in said for said in (by_file, by_profile))
        assert remedy in by_file and remedy not in by_profile
        assert "at the file's 16 px/mm" in by_file and "at the profile's 16 px/mm" in by_profile
