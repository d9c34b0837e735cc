"""The command inspect: exit statuses, files, and what it prints."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

from tactape_fab import Kit, Tape
from tactape_fab.cli import main
from tactape_fab.texture.as_built import AsBuilt
from tests.scans import Scanner, assembled, scan
from tests.thorough import slow


@pytest.fixture(scope="module")
def scans(flat_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Scans of a good tape and of one that lacks a part."""
    tape = Tape.load(flat_kit.path)
    folder = tmp_path_factory.mktemp("scans")
    paths = {}
    for name, missing in (("good", 0), ("bad", 1)):
        paths[name] = folder / f"{name}.png"
        built = assembled(tape, sigma_mm=0.03, missing=missing, seed=4)
        paths[name].write_bytes(cv2.imencode(".png", scan(tape, built, Scanner(dpi=1000)))[1].tobytes())
    return paths


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["inspect", *map(str, arguments)])


def test_a_good_tape_is_done_with_status_0(flat_kit: Kit, scans: dict[str, Path], tmp_path: Path) -> None:
    result = run(scans["good"], "--tape", flat_kit.path, "-o", tmp_path / "as-built.json")
    assert result.exit_code == 0, result.output
    assert "94 of 94 parts are in place, 0 deviations" in result.stdout
    assert AsBuilt.load(tmp_path / "as-built.json").missing == 0
    assert len((tmp_path / "as-built-deviations.csv").read_text().splitlines()) == 1
    assert not list(tmp_path.glob("*.png"))


def test_a_fault_is_status_4_with_files_pictures_and_rows(flat_kit: Kit, scans: dict[str, Path], tmp_path: Path) -> None:
    result = run(scans["bad"], "--tape", flat_kit.path, "-o", tmp_path / "a.json", "--picture", tmp_path / "seen")
    assert result.exit_code == 4
    assert "1 deviation beyond the tolerances" in result.stderr
    (row,) = csv.DictReader((tmp_path / "a-deviations.csv").read_text().splitlines())
    assert row["Deviation"] == "missing" and row["Designator"] in result.stdout
    assert AsBuilt.load(tmp_path / "a.json").missing == 1
    for what in ("deviations", "places"):
        picture = cv2.imread(str(tmp_path / "seen" / f"tactape-s100-{what}.png"))
        assert picture is not None and np.asarray(picture).std() > 5.0


def test_a_narrow_tolerance_makes_the_same_tape_fail(flat_kit: Kit, scans: dict[str, Path], tmp_path: Path) -> None:
    result = run(scans["good"], "--tape", flat_kit.path, "-o", tmp_path / "a.json", "--tolerance", "0.05mm", "--json")
    assert result.exit_code == 4
    (said,) = json.loads(result.stdout)
    assert said["tolerance_mm"] == 0.05
    assert {d["kind"] for d in said["deviations"]} == {"shifted"}
    assert all(d["value"] >= 0.05 for d in said["deviations"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], ["SCAN is missing", "--tape is missing", "-o is missing"]),
        (["none.png", "--tape", "KIT", "-o", "a.json"], ["none.png cannot be read"]),
        (["GOOD", "--tape", "KIT", "-o", "a.txt"], ["a.txt is no file of places"]),
        (["GOOD", "--tape", "KIT", "-o", "none/a.json"], ["none/a.json: there is no folder of that name"]),
        (["GOOD", "--tape", "KIT", "-o", "a.json", "--tolerance", "wide"], ["tolerance = 'wide' is not from"]),
        (
            ["GOOD", "--tape", "none", "-o", "a.txt", "--dpi", "0", "--turn-tolerance", "0"],
            [
                "none is no kit",
                "a.txt is no file of places",
                "--dpi = 0 dpi is not from",
                "error: --turn-tolerance = 0 deg is not from",
            ],
        ),
    ],
)
def test_what_cannot_be_meant_is_status_2_and_writes_nothing(
    flat_kit: Kit, scans: dict[str, Path], here: Path, arguments: list[str], said: list[str]
) -> None:
    named = {"KIT": str(flat_kit.path), "GOOD": str(scans["good"])}
    result = run(*(named.get(a, a) for a in arguments))
    assert result.exit_code == 2
    assert all(text in result.stderr for text in said)
    assert not list(here.iterdir())


@pytest.mark.parametrize("taken", ["a.json", "a-deviations.csv"])
def test_a_file_that_no_inspection_wrote_is_kept(taken: str, flat_kit: Kit, scans: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / taken).write_bytes((flat_kit.path / "manifest.json").read_bytes())
    result = run(scans["good"], "--tape", flat_kit.path, "-o", tmp_path / "a.json")
    assert result.exit_code == 2 and f"{taken} is there and is no" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == [taken]
    assert (tmp_path / taken).read_bytes() == (flat_kit.path / "manifest.json").read_bytes()


def test_the_places_of_another_kit_are_kept(flat_kit: Kit, scans: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_bytes((flat_kit.path / "manifest.json").read_bytes() + b" ")
    result = run(scans["good"], "--tape", flat_kit.path, "-o", tmp_path / "as-built.json")
    assert result.exit_code == 2 and "is where the places of another kit belong" in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]


def test_a_picture_of_another_s_is_kept_and_nothing_written(flat_kit: Kit, scans: dict[str, Path], tmp_path: Path) -> None:
    mine = tmp_path / f"{flat_kit.tape.name}-places.png"
    mine.write_bytes(b"mine")
    result = run(scans["good"], "--tape", flat_kit.path, "-o", tmp_path / "a.json", "--picture", tmp_path)
    assert result.exit_code == 2 and f"{mine.name} is there and is no picture of this tool" in result.stderr
    assert list(tmp_path.iterdir()) == [mine] and mine.read_bytes() == b"mine"


def test_an_older_inspection_is_replaced(flat_kit: Kit, scans: dict[str, Path], tmp_path: Path) -> None:
    for name, status in (("bad", 4), ("good", 0)):
        assert run(scans[name], "--tape", flat_kit.path, "-o", tmp_path / "a.json").exit_code == status
    assert AsBuilt.load(tmp_path / "a.json").missing == 0


@slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_an_answer_that_cannot_be_printed_is_said_in_one_line(flat_kit: Kit, scans: dict[str, Path], tmp_path: Path) -> None:
    words = ["inspect", str(scans["good"]), "--tape", str(flat_kit.path), "-o", "a.json"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "tactape_fab", *words],
            cwd=tmp_path,
            stdout=full,
            stderr=subprocess.PIPE,
            encoding="utf-8",
            check=False,
        )
    lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert done.returncode == 1 and len(lines) == 1 and "standard output cannot be written" in lines[0]
    assert AsBuilt.load(tmp_path / "a.json").missing == 0  # written before
