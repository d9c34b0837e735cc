"""What a command writes replaces nothing else: no input, no file of a kit, nothing in the folder of an empty name."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactape_fab import Kit
from tactape_fab.sense import simulate_frames
from tests.commands import run
from tests.roundtrip.kits import contents


@pytest.fixture
def here(default_kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder: a kit, two frames in a file and as pictures, and files of the user's own."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(default_kit.path, "kit")
    depth = simulate_frames(default_kit.tape, 2, seed=5).depth
    np.savez("frames.npz", depth=depth)
    Path("recorded").mkdir()
    low, high = float(depth.min()), float(depth.max())
    for k, frame in enumerate(depth):
        cv2.imwrite(f"recorded/frame-{k:06d}.png", ((frame - low) / (high - low) * 65535).astype(np.uint16))
    Path("pictures").mkdir()
    for name in ("mine.svg", "mine.png", "pictures/residuals.png", "new-mask.png"):
        Path(name).write_text("mine")
    return tmp_path


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("decode recorded/frame-000000.png --tape kit --overlay recorded", "frame-000000.png is there and is no picture of this"),
        ("decode frames.npz --tape kit --overlay frames.npz", "--overlay = frames.npz: frames.npz is there and is no folder"),
        (
            "decode frames.npz --tape kit --overlay kit/manifest.json/a",
            "--overlay = kit/manifest.json/a: kit/manifest.json is there and is no folder",
        ),
        ("registry kit --pack kit/manifest.json --overwrite", "manifest.json is there and is no packed registry"),
        ("registry kit --pack frames.npz --overwrite", "frames.npz is there and is no packed registry"),
        ("certify kit --picture kit/manifest.json --overwrite", "--picture = kit/manifest.json does not end with .png"),
        ("certify kit --picture mine.png --overwrite", "mine.png is there and is no picture of this tool"),
        ("certify kit --picture w.jpg", "--picture = w.jpg does not end with .png"),
        ("verify kit --map mine.png --overwrite", "mine.png is there and is no picture of this tool"),
        ("advise --contact 9 --map mine.svg --overwrite", "mine.svg is there and is no map of this tool"),
        ("calibrate frames.npz --tape kit -o new.toml", "-o = new-mask.png exists already; nothing was touched"),
        ("calibrate frames.npz --tape kit -o other.toml --picture pictures", "residuals.png is there and is no picture of this"),
        (
            "calibrate frames.npz --tape kit -o other.toml --picture mine.png",
            "--picture = mine.png: mine.png is there and is no folder",
        ),
        (
            "inspect mine.png --tape kit -o places.json --picture mine.png",
            "--picture = mine.png: mine.png is there and is no folder",
        ),
        ('decode frames.npz --tape ""', "Invalid value for '--tape': '' is empty"),
        ('decode frames.npz --tape kit --overlay ""', "Invalid value for '--overlay': '' is empty"),
        ('watch "" --tape kit', "'' is empty; give a path, or leave it out"),
        ('certify ""', "'' is empty; give a path, or leave it out"),
    ],
)
def test_files_of_others_are_refused_before_the_work(command: str, said: str, here: Path) -> None:
    before = contents(here)
    result = run(command)
    assert (result.exit_code, result.stdout) == (2, ""), (result.output, result.exception)
    assert said in result.stderr
    assert contents(here) == before


def test_pictures_of_an_earlier_run_are_replaced(here: Path) -> None:
    for _ in range(2):
        assert run("decode frames.npz --tape kit --overlay drawn").exit_code == 0
        assert run("certify kit --picture windows.png --overwrite").exit_code == 0
    assert sorted(path.name for path in Path("drawn").iterdir()) == ["frame-000000.png", "frame-000001.png"]
