"""Every entry point for a moment of each run; `python -m tests.fuzz --seconds 60` for longer, guided by coverage."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.sense.files.depth_maps import SUFFIXES
from tests.fuzz.cases import Fault, install_watch, run_case
from tests.fuzz.entries import Entry, Read, all_entries
from tests.fuzz.mutate import mutated
from tests.fuzz.seeds import make_seeds
from tests.thorough import THOROUGH, slow

SPENT_S = 0.3 if THOROUGH else 0.15
"""Processor time for each entry point."""
NAMES = (
    *("manifest", "panel manifest", "kit: manifest", "spec", "fab profile", "part profile", "process profile", "sensor profile"),
    *(
        "sensor mask",
        "object",
        "as-built",
        "packed registry",
        "placements",
        "frames.npz",
        "frames.npy",
        "frame.png",
    ),
    *("frame.tif", "stream", "colour.png", "colour.jpg", "scan", "weights"),
    *("recording.mcap", "rosbag2", "dataset: info", "dataset: images", "dataset: arrays", "dataset: film"),
    *("benchmark: answers", "benchmark: truth", "benchmark: index"),
    *("surface.stl", "surface.obj", "surface.ply", "surface.3mf"),
    *("kit: copper-top", "kit: coverlay-top", "kit: paste-top", "kit: legend-top", "kit: profile", "kit: drill-npth"),
    *("kit: components-top", "kit: cpl", "kit: bom", "kit: order-notes", "kit: job", "kit: fab-zip", "kit: kicad-pcb"),
    *("kit: fab-dxf", "kit: fab-drawing"),
    *("kit: kicad-project", "kit: certificate", "kit: preview-png", "kit: preview-svg", "kit: placement-preview"),
    "kit: report",
    *("kit: stl", "kit: 3mf", "kit: step-solid", "kit: step-assembly"),
)


def test_every_kind_of_file_of_frames_has_an_entry() -> None:
    assert {Path(name).suffix for name in NAMES if name.startswith("frame")} == {*SUFFIXES} - {".tiff"}


@pytest.fixture(scope="module")
def entries() -> dict[str, Entry]:
    return all_entries(make_seeds())


@pytest.fixture(autouse=True)
def quiet(capfd: pytest.CaptureFixture[str]) -> Iterator[None]:
    """Libraries of pictures say much of what they cannot read."""
    install_watch()
    yield
    capfd.readouterr()


def test_all_entry_points_are_tried(entries: dict[str, Entry]) -> None:
    assert set(entries) == set(NAMES), "enter the name in NAMES"


@pytest.mark.parametrize("name", NAMES)
def test_changed_bytes_are_answered_or_refused(name: str, entries: dict[str, Entry], tmp_path: Path) -> None:
    entry = entries[name]
    for seed in entry.seeds:  # as they are, they are read
        entry.read(seed, tmp_path)
    chance, others = Random(name), tuple(entry.seeds)
    begin, tried = time.process_time(), 0
    while time.process_time() - begin < SPENT_S:
        data = mutated(chance.choice(others), chance, others)
        fault = run_case(entry.read, data, tmp_path)
        (tmp_path / "case").write_bytes(data)
        assert fault is None, f"{fault}: case {tried} of {name}, kept as {tmp_path / 'case'}"
        tried += 1
    assert tried > 0


# The harness itself


def _asks_for_memory(_: bytes, __: Path) -> None:
    np.ones(1_100_000_000, dtype=np.uint8)


def _loops(_: bytes, __: Path) -> None:
    while True:
        try:
            sum(range(10_000))
        except Exception:
            continue


def _writes(_: bytes, __: Path) -> None:
    Path("/proc/self/comm").write_text("elsewhere")


def _removes(_: bytes, __: Path) -> None:
    os.remove("/no-such-file")  # noqa: PTH107


def _runs(_: bytes, __: Path) -> None:
    os.system("true")


def _fails(_: bytes, __: Path) -> None:
    raise KeyError("sector")


@slow
@pytest.mark.parametrize(
    ("read", "kind"),
    [
        (_fails, "KeyError"),
        (_loops, "slow"),
        (_writes, "elsewhere"),
        (_removes, "elsewhere"),
        (_runs, "elsewhere"),
        (_asks_for_memory, "memory"),
    ],
)
def test_an_entry_point_with_a_fault_is_found(read: Read, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if kind == "slow":
        monkeypatch.setattr("tests.fuzz.cases.MOST_S", 0.2)
    found = run_case(read, b"", tmp_path)
    assert isinstance(found, Fault) and found.kind == kind


def test_what_is_refused_or_written_in_its_folder_is_no_fault(tmp_path: Path) -> None:
    def read(data: bytes, folder: Path) -> None:
        (folder / "mine").write_bytes(data)
        raise SpecError("no")

    refusals: list[int] = []
    assert run_case(read, b"", tmp_path, lambda: refusals.append(1)) is None
    assert refusals == [1]
