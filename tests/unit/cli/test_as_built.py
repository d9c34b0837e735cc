"""Measured places through the command line: which file is taken, what answers rest on, and what is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import AsBuilt, Kit, SpecError, Tape, read_tapes
from tactape_fab.texture.as_built import manifest_digest
from tests.commands import run
from tests.measured import measured


@pytest.fixture
def kit(tmp_path: Path, default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the default kit, its parts measured."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "kit"
    shutil.copytree(default_kit.path, folder)
    tape, _ = measured(Tape.load(folder), 0.05, missing=0.02, digest=manifest_digest(folder / "manifest.json"))
    assert tape.as_built is not None
    tape.as_built.write(folder)
    return folder


def fixes(args: str) -> list[dict[str, Any]]:
    result = run(f"decode {args} --json")
    assert result.exit_code == 0, result.stderr
    return [json.loads(line) for line in result.stdout.splitlines()]


def test_frames_of_measured_parts_are_located_by_them(kit: Path) -> None:
    assert run("simulate kit -o frames.npz --count 3 --from as-built").exit_code == 0
    with np.load("frames.npz") as truth:
        at = truth["position_mm"]
    errors = {}
    for places, more in {"as-built": "", "nominal": "--as-built none"}.items():
        found = fixes(f"frames.npz --tape kit {more}")
        assert [fix["places"] for fix in found] == [places] * 3
        errors[places] = np.abs(np.array([fix["position_mm"] for fix in found]) - at).max()
    assert errors["as-built"] < 0.006 < errors["nominal"]


def test_a_file_elsewhere_is_taken_in_place_of_the_kits_own(kit: Path) -> None:
    file = AsBuilt.load(kit).write("elsewhere.json")
    (kit / "as-built.json").unlink()
    assert run("simulate kit -o frames.npz --from as-built --as-built elsewhere.json").exit_code == 0
    assert fixes("frames.npz --tape kit")[0]["places"] == "nominal"
    assert fixes(f"frames.npz --tape kit --as-built {file}")[0]["places"] == "as-built"
    tape = Tape.load(kit, as_built=file)
    assert tape.as_built is not None and tape.present.sum() == tape.part_count - tape.as_built.missing
    assert read_tapes([kit], [file])[0].as_built is not None


@pytest.mark.parametrize(
    ("args", "said"),
    [
        ("decode frames.npz --tape kit --as-built nothing.json", "error: --as-built = nothing.json cannot be read"),
        ("decode frames.npz --tape kit --as-built empty.json", "error: empty.json: parts.present is missing"),
        ("decode frames.npz --tape kit --as-built .", "as-built.json cannot be read: No such file"),
        ("decode frames.npz --tape kit --as-built none --as-built kit", "give either none or the files"),
        ("decode frames.npz --tape kit --as-built other.json", "and none of tactape-s007 has"),
        ("decode frames.npz --code microdots-4x4 --as-built kit", "none is there; give its kit with --tape, too"),
        ("simulate kit -o frames.npz --from nowhere", "from = 'nowhere' is none of"),
        ("simulate kit -o frames.npz --from as-built --from-cpl", "give one of them"),
        ("simulate kit -o frames.npz --from design --from-cpl", "give one of them"),
        ("simulate kit -o frames.npz --as-built other.json", "add --from as-built"),
        ("simulate kit -o frames.npz --from as-built --as-built other.json", "or leave out --from and --as-built for"),
        ("simulate kit -o frames.npz --from as-built --as-built none", "nobody measured tactape-s007"),
        ("certify --code microdots-4x4 --as-built kit", "name the kit"),
    ],
)
def test_what_is_refused(kit: Path, args: str, said: str) -> None:
    built = AsBuilt.load(kit).to_mapping() | {"manifest_sha256": "1" * 64}
    Path("other.json").write_text(json.dumps(built))
    Path("empty.json").write_text("{}")
    np.savez("frames.npz", depth=np.zeros((240, 320), dtype=np.float32))
    if "simulate" in args:
        Path("frames.npz").unlink()
    result = run(args)
    assert result.exit_code == 2
    assert said in result.stderr


def test_a_file_of_another_kit_is_refused_by_all_who_load_it(kit: Path) -> None:
    built = AsBuilt.load(kit).to_mapping() | {"manifest_sha256": "1" * 64}
    (kit / "as-built.json").write_text(json.dumps(built))
    for load in (lambda: Tape.load(kit), lambda: read_tapes([kit])):
        with pytest.raises(SpecError, match=r"another kit; .*; measure this tape, or give as_built='none' for the places of"):
            load()
    np.savez("frames.npz", depth=np.zeros((240, 320), dtype=np.float32))
    assert "or give --as-built none for the places of the design" in run("decode frames.npz --tape kit").stderr
    assert "or leave out --from for the places of the design" in run("simulate kit -o new.npz --from as-built").stderr
    survey = run("survey frames.npz --tape kit -o new.json --from kit/as-built.json").stderr
    assert "or leave out --from for the places of the design" in survey
    for command in ("calibrate frames.npz --tape kit -o s.toml", "registry kit", "make --sector 3 --avoid kit"):
        assert "or move its as-built.json away for the places of the design" in run(command).stderr, command
    assert Tape.load(kit, as_built="none").as_built is None


def test_verify_reports_measured_places(kit: Path) -> None:
    checks = {c["name"]: c for c in json.loads(run("verify kit --quick --json").stdout)["checks"]}
    assert checks["as-built"]["passed"] and "unlisted" not in checks
    assert checks["as-built"]["figure"] == pytest.approx(0.05, rel=0.05)
    assert f"{AsBuilt.load(kit).missing} missing" in checks["as-built"]["message"]
    built = AsBuilt.load(kit).to_mapping() | {"manifest_sha256": "1" * 64}
    (kit / "as-built.json").write_text(json.dumps(built))
    result = run("verify kit --quick --json")
    assert result.exit_code == 4
    wrong = [c for c in json.loads(result.stdout)["checks"] if not c["passed"]]
    assert [c["name"] for c in wrong] == ["as-built"] and "another kit" in wrong[0]["message"]


def test_certify_counts_windows_of_the_parts_that_are_there(kit: Path) -> None:
    with_all, without = (json.loads(run(f"certify kit {more} --json").stdout) for more in ("--as-built none", ""))
    assert with_all != without
    assert "missing as built" in run("certify kit").stdout


def test_survey_writes_places_that_decode_takes(kit: Path) -> None:
    AsBuilt.load(kit).write("truth.json")
    (kit / "as-built.json").unlink()
    made = run("simulate kit -o frames.npz --count 40 --contact 12x12 --from as-built --as-built truth.json")
    assert made.exit_code == 0, made.stderr
    result = run("survey frames.npz --tape kit -o kit --json")
    assert result.exit_code == 0, result.stderr
    said = json.loads(result.stdout)
    assert said["contacts"] == said["frames"] == 40
    assert said["scatter_mm"] == pytest.approx(0.05, rel=0.2)
    assert [fix["places"] for fix in fixes("frames.npz --tape kit")].count("as-built") >= 36
    with np.load("frames.npz") as frames:
        (x, y), half = frames["position_mm"][:2].T * ((1,), (-1,)), np.radians(frames["theta_deg"][:2]) / 2
    rows = [f"{k},{x[k]},{y[k]},0,0,{np.cos(half[k])},{np.sin(half[k])},0" for k in range(2)]
    Path("poses.csv").write_text("\n".join(["frame,x_mm,y_mm,z_mm,qw,qx,qy,qz", *rows]))
    few = run("survey frames.npz --tape kit --poses poses.csv -o few.json")
    assert few.exit_code == 0, few.stderr
    assert "note: --poses: 2 of 40 contacts have a pose; the others are placed by their dots alone, and stretch" in few.stderr
    assert "note" not in result.stderr
    same = run("survey frames.npz --tape kit --from kit/as-built.json -o second.json")
    assert same.exit_code == 2 and "surveyed of these very frames" in same.stderr
    run("simulate kit -o more.npz --count 40 --seed 5 --contact 12x12 --from as-built --as-built truth.json")
    again = run("survey more.npz --tape kit --from kit/as-built.json -o second.json")
    assert again.exit_code == 0, again.stderr
    assert "40 of 40 frames located and used" in again.stdout
    assert [entry["kind"] for entry in AsBuilt.load("second.json").source] == ["survey", "survey"]
    assert run("verify kit --quick").exit_code == 0


@pytest.mark.parametrize(
    ("args", "said"),
    [
        ("survey --tape kit -o out.json", "no file of frames is given"),
        ("survey frames.npz --tape nothing -o out.json", "nothing is no kit"),
        ("survey frames.npz --tape kit -o kit/manifest.json", "is no file of places; nothing was touched; use another name"),
        (f"survey frames.npz --tape kit -o {'n' * 300}.json", "cannot be looked at: File name too long; use another name"),
        ("survey frames.npz --tape kit -o other", "where the places of another kit belong, that of other/manifest.json"),
        ("survey frames.npz --tape kit -o nowhere/out.json", "there is no folder of that name"),
        ("survey frames.npz --tape kit -o out.json --poses nothing.csv", "nothing.csv cannot be opened"),
        ("survey frames.npz --tape kit -o out.json --from other.json", "another kit"),
        ("survey frames.npz --tape kit -o out.json --sensor nothing", "sensor"),
        ("survey frames.npz --tape kit -o out.json", "only 0 of 3 frames are located on this tape"),
    ],
)
def test_surveys_that_are_refused(kit: Path, args: str, said: str) -> None:
    built = AsBuilt.load(kit).to_mapping() | {"manifest_sha256": "1" * 64}
    Path("other.json").write_text(json.dumps(built))
    Path("other").mkdir()
    Path("other/manifest.json").write_text("{}")
    np.savez("frames.npz", depth=np.random.default_rng(1).normal(0.0, 0.01, (3, 240, 320)).astype(np.float32))
    result = run(args)
    assert result.exit_code == 2
    assert said in result.stderr
    assert not Path("out.json").exists() and not Path("other/as-built.json").exists()
