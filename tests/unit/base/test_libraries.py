"""The robot's half runs where nothing but numpy, numba and click is installed, and what is missing is named."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from tactape_fab import Kit
from tactape_fab.base.errors import MissingLibraryError, TactapeError
from tactape_fab.base.launch import python_command, run
from tactape_fab.base.libraries import library
from tests.thorough import only_thorough, thorough

NOT_BY_DEFAULT = ("build123d", "OCP", "manifold3d", "scipy", "matplotlib", "mcap", "rerun", "pupil_apriltags")
NOT_ON_A_ROBOT = (*NOT_BY_DEFAULT, "shapely", "cv2", "trimesh", "gerbonara", "jinja2", "HersheyFonts", "rtree", "kornia_rs")
_HIDE = "sys.modules.update(dict.fromkeys({names!r})); "


def without(names: tuple[str, ...], line: str, folder: Path) -> tuple[int, str, str]:
    """Exit status, output and errors of a command where these libraries cannot be imported."""
    program = _HIDE.format(names=names) + "from tactape_fab.cli import main; main(sys.argv[1:], prog_name='tactape-fab')"
    done = run(python_command(program, *line.split()), timeout_s=300.0, scratch=folder)
    return done.returncode, done.stdout, done.stderr


def robot(line: str, folder: Path) -> tuple[int, str, str]:
    """A command on a robot."""
    return without(NOT_ON_A_ROBOT, line, folder)


@only_thorough
@pytest.mark.parametrize("options", ["", thorough("--part block")])
def test_the_default_installation_makes_and_verifies_with_no_cad_kernel(
    options: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor with FreeCAD or PrusaSlicer, which take longer than all else."""
    monkeypatch.setenv("PATH", str(tmp_path))
    status, _, errors = without(NOT_BY_DEFAULT, f"make --sector 7 --size 20x20 -o kit {options}", tmp_path)
    assert status == 0, errors
    for line in ("verify kit", "verify kit --quick"):
        status, output, errors = without(NOT_BY_DEFAULT, line, tmp_path)
        assert (status, "fail" in output) == (0, False), output + errors
        warned = [row for row in output.splitlines() if row.startswith("warn") and "OCCT" in row]
        assert len(warned) == ("--quick" not in line)
        assert all(row.endswith('the models were not read with it; pip install "tactape-fab[cad]"') for row in warned)


def test_the_default_installation_says_what_embossing_takes(small_kit: Kit, tmp_path: Path) -> None:
    model = next(small_kit.path.glob("models/*.stl"))
    status, output, errors = without(NOT_BY_DEFAULT, f"emboss {small_kit.path} {model}", tmp_path)
    said = 'error: emboss needs manifold3d, which is not installed; pip install "tactape-fab[cad]"\n'
    assert (status, output, errors) == (1, "", said)


def test_doctor_answers_without_a_reader_of_toml(tmp_path: Path) -> None:
    """Python 3.10 has none of its own, and nothing else works there."""
    status, output, errors = without(("tomllib", "tomli"), "doctor", tmp_path)
    assert (status, errors) == (0, "") and "templates" in output
    status, output, errors = without(("tomllib", "tomli"), "profiles", tmp_path)
    assert (status, output) == (1, "") and errors.startswith("error: reading TOML needs toml")


def test_a_robot_simulates_decodes_watches_certifies_and_lists(small_kit: Kit, tmp_path: Path) -> None:
    kit = small_kit.path
    status, _, errors = robot(f"simulate {kit} -o frames.npz --count 2 --pose 8,8,30", tmp_path)
    assert status == 0, errors
    frames = np.load(tmp_path / "frames.npz")["depth"]
    np.save(tmp_path / "one.npy", frames[0])
    for line in (f"decode one.npy frames.npz --tape {kit} --json", f"watch frames.npz --rate max --no-drop --tape {kit} --json"):
        status, output, errors = robot(line, tmp_path)
        fixes = [json.loads(row) for row in output.splitlines()]
        assert status == 0 and fixes, errors
        assert all(fix["located"] and fix["tape"] == small_kit.tape.name for fix in fixes)
    for line in (f"certify {kit} --json", f"registry {kit} --json"):
        status, output, errors = robot(line, tmp_path)
        assert status == 0 and json.loads(output), errors


def test_the_public_names_of_the_robots_half_need_nothing_else(small_kit: Kit, tmp_path: Path) -> None:
    program = _HIDE.format(names=NOT_ON_A_ROBOT)
    program += "from tactape_fab import Localizer, Tape, Tracker, read_object; Tape.load(sys.argv[1])"
    done = run(python_command(program, str(small_kit.path)), timeout_s=300.0, scratch=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("make --sector 3 --size 20x20", "this command needs shapely, which is not installed; pip install tactape-fab"),
        ("verify KIT", "this command needs shapely, which is not installed; pip install tactape-fab"),
        (
            "decode F.npz --tape KIT --overlay o",
            "--overlay needs cv2, which is not installed; pip install opencv-python-headless",
        ),
        (
            "decode F.npz --tape KIT --method paper",
            'method "paper" needs cv2, which is not installed; pip install opencv-python-headless',
        ),
        (
            "watch F.npz --rate 9 --tape KIT --mcap a.mcap",
            '--mcap needs mcap, which is not installed; pip install "tactape-fab[live]"',
        ),
        ("watch F.npz --tape KIT --save a.rrd", '--save needs rerun, which is not installed; pip install "tactape-fab[rerun]"'),
    ],
)
def test_what_is_missing_is_named_with_the_line_to_type(line: str, said: str, small_kit: Kit, tmp_path: Path) -> None:
    np.savez(tmp_path / "F.npz", depth=np.zeros((240, 320), dtype=np.float32))
    status, output, errors = robot(line.replace("KIT", str(small_kit.path)), tmp_path)
    assert (status, output) == (1 if "watch" not in line else 2, "")
    assert errors.splitlines()[-1] == f"error: {said}"


def test_a_library_that_is_there_is_given_and_one_that_is_not_is_an_error_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    assert library("numpy", "this test") is np
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    with pytest.raises(MissingLibraryError) as caught:
        library("manifold3d", "emboss")
    assert str(caught.value) == 'emboss needs manifold3d, which is not installed; pip install "tactape-fab[cad]"'
    assert isinstance(caught.value, TactapeError) and isinstance(caught.value, ImportError)
