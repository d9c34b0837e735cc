"""As-built files: what is written is read back, and what nobody should trust is refused, all findings together."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import AsBuilt, Film, SpecError
from tactape_fab.texture.as_built import MOST_BYTES, manifest_digest


def places(count: int = 5, **other: Any) -> AsBuilt:
    rng = np.random.default_rng(1)
    dx, dy = rng.normal(0.0, 0.05, (2, count))
    values: dict[str, Any] = {
        "tape": "t",
        "manifest_sha256": "0" * 64,
        "number": np.arange(1, 2 * count, 2),
        "dx_mm": dx,
        "dy_mm": dy,
        "rotation_deg": rng.normal(0.0, 2.0, count),
        "present": np.arange(count) != 2,
        "sigma_mm": np.full(count, 0.003),
        "source": ({"kind": "scan", "dpi": 1200},),
    }
    return AsBuilt(**(values | other))


def refused(change: dict[str, Any]) -> str:
    content = places().to_mapping()
    for key, value in change.items():
        table, _, name = key.rpartition(".")
        (content[table] if table else content)[name] = value
    with pytest.raises(SpecError) as raised:
        AsBuilt.from_mapping(content)
    return str(raised.value)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    written = places(film=Film(scale=(1.001, 0.999), shear=2e-4, sigma=1e-5))
    file = written.write(tmp_path)
    assert file == tmp_path / "as-built.json"
    read = AsBuilt.load(tmp_path)
    assert read.to_mapping() == written.to_mapping()
    np.testing.assert_allclose(read.dx_mm, written.dx_mm, atol=5e-7)
    assert read.missing == 1


def test_same_places_give_same_bytes_and_nothing_else_is_left(tmp_path: Path) -> None:
    first = places().write(tmp_path / "a.json").read_bytes()
    assert places().write(tmp_path / "a.json").read_bytes() == first
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_a_place_that_cannot_be_written_is_a_spec_error(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="there is no folder of that name"):
        places().write(tmp_path / "nowhere" / "a.json")


def test_parts_have_the_film_and_their_own_shift() -> None:
    nominal = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    built = places(
        1, number=np.array([2]), dx_mm=np.array([0.1]), dy_mm=np.array([-0.2]), rotation_deg=np.array([3.0]),
        film=Film(scale=(1.01, 0.99), shear=0.002),
    ).parts(nominal)  # fmt: skip
    np.testing.assert_allclose(built.shift_mm, [[0.0, 0.0], [0.2, -0.2], [0.02, -0.1]])
    np.testing.assert_allclose(built.rotation_deg, [0.0, 3.0, 0.0])
    assert built.present.all()


def test_parts_that_were_not_measured_may_be_as_far_off_as_those_that_were() -> None:
    built = places(20).parts(np.zeros((50, 2)))
    assert built.sigma_mm[0] == 0.003
    assert 0.04 < built.sigma_mm[1] < 0.06
    assert places(1, present=np.array([False])).parts(np.zeros((50, 2))).sigma_mm[1] == 0.0


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("format", "tactape-as-built/2", "format"),
        ("manifest_sha256", "00", "manifest_sha256"),
        ("tape", 4, "tape = 4 is not a text"),
        ("extra", 1, "extra is not a known key"),
        ("parts.designator", ["R1", "R3", "R1", "R7", "R9"], "R1 occurs twice"),
        ("parts.designator", ["R1", "R3", "R05", "R7", "R9"], "designator[2] = 'R05' is no designator"),
        ("parts.designator", ["R1", 3, None, "R7", "R9"], "(2 are wrong)"),
        ("parts.designator", "R1", "is not a list"),
        ("parts.dx_mm", [0.0] * 4, "dx_mm has 4 entries for 5 designators"),
        ("parts.dx_mm", [0.0, float("nan"), 0.0, 0.0, 0.0], "dx_mm[1] = nan"),
        ("parts.dx_mm", [0.0, 0.0, 11.0, 0.0, 0.0], "dx_mm[2] = 11.0 is no number of mm from -10 to 10"),
        ("parts.dy_mm", [0.0, 0.0, True, 0.0, 0.0], "dy_mm[2] = True"),
        ("parts.dy_mm", [0, 10**400, 0, 0, 0], "dy_mm"),
        ("parts.sigma_mm", [0.0, 0.0, 0.0, 0.0, -1.0], "sigma_mm[4]"),
        ("parts.rotation_deg", [0.0, "1", 0.0, 0.0, 0.0], "rotation_deg[1]"),
        ("parts.present", [1, True, True, True, True], "present is not 5 of true and false"),
        ("film.scale", [1.0, 2.0], "film.scale[1]"),
        ("film.shear", None, "film.shear"),
        ("source", [{"kind": "guess"}], "source[0].kind"),
        ("source", [{"kind": "scan", "note": "x" * 20_000}], "source[0] has NaN or more than"),
        ("source", ["scan"], "source[0].kind is missing"),
    ],
)
def test_values_nobody_should_trust_are_refused(key: str, value: object, said: str) -> None:
    assert said in refused({key: value})


def test_all_findings_come_together() -> None:
    text = refused({"tape": 4, "film.shear": "x", "parts.dx_mm": [], "parts.present": []})
    assert all(said in text for said in ("tape = 4", "film.shear", "dx_mm has 0 entries", "present is not 5"))


@pytest.mark.parametrize("text", ["", "[]", "{", "nul", "[" * 100_000, "\ufeff{}", '{"format": 1e999}'])
def test_files_that_are_no_table_are_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "as-built.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(SpecError):
        AsBuilt.load(file)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "as-built.json"
    with file.open("wb") as stream:
        stream.truncate(MOST_BYTES + 1)
    with pytest.raises(SpecError, match="more than"):
        AsBuilt.load(file)


def test_no_file_is_a_spec_error(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="cannot be read"):
        AsBuilt.load(tmp_path)


def test_arrays_of_a_program_are_checked() -> None:
    with pytest.raises(SpecError) as raised:
        places(number=np.array([1, 1, 2, 3, 4]), dx_mm=np.zeros(3), sigma_mm=np.full(5, np.nan))
    assert len(raised.value.problems) == 3


def test_places_belong_to_one_kit(tmp_path: Path) -> None:
    manifest = tmp_path / "manifest.json"
    manifest.write_text(json.dumps({"name": "t"}))
    digest = manifest_digest(manifest)
    built = places(manifest_sha256=digest)
    assert built.problems_for("t", digest, 9) == []
    assert "is not u" in built.problems_for("u", digest, 9)[0].message
    assert "R9 exceeds R8" in built.problems_for("t", digest, 8)[0].message
    assert "another kit" in built.problems_for("t", "1" * 64, 9)[0].message


def test_places_that_are_all_off_by_more_than_the_displacement_are_refused(tmp_path: Path) -> None:
    """A file beside a stranger's kit would move every position without a word."""
    (tmp_path / "manifest.json").write_text(json.dumps({"name": "t"}))
    digest = manifest_digest(tmp_path / "manifest.json")
    present = np.array([True, True, False, True])
    for mean_mm, refused in ((0.24, False), (0.26, True), (1.5, True), (-1.5, True)):
        dx_mm, dy_mm = 0.6 * mean_mm + np.array([0.1, -0.1, 9.0, 0.0]), np.full(4, 0.8 * mean_mm)
        sigma_mm, number = np.full(4, 0.005), np.arange(1, 5)
        turned = {"rotation_deg": np.zeros(4), "present": present, "sigma_mm": sigma_mm, "manifest_sha256": digest}
        built = places(4, number=number, dx_mm=dx_mm, dy_mm=dy_mm, **turned)
        problems = built.problems_for("t", digest, 9, 0.25)
        assert bool(problems) is refused
        assert (
            not refused or f"by {abs(mean_mm):.3f} mm on the mean, more than their displacement of 0.25 mm" in problems[0].message
        )
        assert built.problems_for("t", digest, 9) == []


def test_a_file_of_another_kind_is_refused_in_one_line() -> None:
    with pytest.raises(SpecError) as caught:
        AsBuilt.from_mapping({"format": "tactape-manifest/1", "sector": 7, "code": "microdots-4x4"})
    (problem,) = caught.value.problems
    assert "'tactape-manifest/1'" in problem.message and "tactape-as-built/1" in problem.message
