"""As-built files: what is written is read back, and what nobody should trust is refused, all findings together."""

from __future__ import annotations

import json
import os
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import AsBuilt, Film, SpecError
from tactape_fab.texture.as_built import as_built_of, manifest_digest, refuse_other_kit


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


def test_single_precision_is_written_with_as_few_digits() -> None:
    measured = places().dx_mm.astype(np.float32)
    content = places(dx_mm=measured).to_mapping()
    assert all(value == round(value, 6) for value in content["parts"]["dx_mm"])
    assert AsBuilt.from_mapping(content).to_mapping() == content


def test_lengths_are_written_to_a_nanometre_and_angles_to_a_thousandth() -> None:
    exact: dict[str, Any] = dict.fromkeys(("dx_mm", "dy_mm", "sigma_mm"), np.full(5, 0.0123456789)) | {
        "rotation_deg": np.full(5, 1.23456)
    }
    parts = places(**exact).to_mapping()["parts"]
    assert {key: set(parts[key]) for key in exact} == {key: {0.012346} for key in exact} | {"rotation_deg": {1.235}}


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
        ("parts.designator", ["R1", "R3", "R5", "R5", "R9"], "R5 occurs twice"),
        ("parts.designator", "R1", "is not a list"),
        ("parts.sigma_mm", [0.0] * 6, "sigma_mm has 6 entries for 5 designators"),
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


@pytest.mark.parametrize(
    ("key", "least", "most"),
    [("dx_mm", -10.0, 10.0), ("dy_mm", -10.0, 10.0), ("rotation_deg", -360.0, 360.0), ("sigma_mm", 0.0, 10.0)],
)
def test_values_may_reach_their_limits(key: str, least: float, most: float) -> None:
    values = np.array([least, most, 0.0, 0.0, 0.0])
    content = places(5, **{key: values}).to_mapping()
    assert getattr(AsBuilt.from_mapping(content), key).tolist() == values.tolist()
    for beyond in (np.nextafter(least, -np.inf), np.nextafter(most, np.inf)):
        column = [0.0, 0.0, 0.0, 0.0, float(beyond)]
        assert f"parts.{key}[4] = " in refused({f"parts.{key}": column})
        with pytest.raises(SpecError, match=f"{key} has values that are not from"):
            places(5, **{key: np.array(column)})


def test_the_film_may_stretch_by_a_tenth() -> None:
    film = {"scale": [0.9, 1.1], "shear": -0.1, "sigma": 0.1}
    read = AsBuilt.from_mapping({**places().to_mapping(), "film": film}).film
    assert (read.scale, read.shear, read.sigma) == ((0.9, 1.1), -0.1, 0.1)
    assert AsBuilt.from_mapping({**places().to_mapping(), "film": {**film, "shear": 0.1}}).film.shear == 0.1
    for key, value in (("scale", [0.899, 1.0]), ("scale", [1.0, 1.101]), ("shear", 0.101), ("shear", -0.101), ("sigma", -1e-9)):
        assert f"film.{key}" in refused({f"film.{key}": value})
    assert "film.sigma" in refused({"film.sigma": 0.101})
    without = {key: value for key, value in places().to_mapping().items() if key not in ("film", "source")}
    assert (AsBuilt.from_mapping(without).film, AsBuilt.from_mapping(without).source) == (Film(), ())


def test_parts_in_any_order_are_read_in_that_of_their_numbers() -> None:
    content = places().to_mapping()
    for column in content["parts"].values():
        column.reverse()
    assert AsBuilt.from_mapping(content).to_mapping() == places().to_mapping()


def test_designators_have_eight_digits_at_most() -> None:
    names = ["R1", "R3", "R5", "R7", "R99999999"]
    content = places().to_mapping()
    content["parts"]["designator"] = names
    assert AsBuilt.from_mapping(content).number.tolist() == [1, 3, 5, 7, 99_999_999]
    for wrong in ("R100000000", "R0", "R", "C5", "R²", "R+5", "R 5", 5):
        text = refused({"parts.designator": [*names[:4], wrong]})
        assert f"designator[4] = {wrong!r} is no designator; give R and" in text and "are wrong" not in text


def test_sources_are_bounded() -> None:
    room = 10_000 - len(json.dumps({"kind": "scan", "note": ""}))
    rows = [{"kind": "scan", "note": "x" * room}] * 2
    assert AsBuilt.from_mapping({**places().to_mapping(), "source": rows}).source == tuple(rows)
    assert "source[1] has NaN or more" in refused({"source": [rows[0], {**rows[0], "note": "x" * (room + 1)}]})
    assert "source[0] has NaN or more" in refused({"source": [{"kind": "scan", "note": float("nan")}]})
    one = [{"kind": "aoi", "drift_mm": 10.0}]
    assert len(AsBuilt.from_mapping({**places().to_mapping(), "source": one * 1000}).source) == 1000
    assert "source" in refused({"source": one * 1001})
    for drift_mm in (-1e-9, 10.001, "0"):
        assert "source[0].drift_mm" in refused({"source": [{"kind": "aoi", "drift_mm": drift_mm}]})


def test_the_drift_is_that_of_the_last_source() -> None:
    def drift_mm(*said: object) -> float:
        return places(source=tuple({"kind": "scan", "drift_mm": value} for value in said)).drift_mm

    assert (drift_mm(0.02, 0.01), drift_mm(0), drift_mm(10.0), drift_mm(1)) == (0.01, 0.0, 10.0, 1.0)
    assert (drift_mm(), drift_mm(10.001), drift_mm(-0.1), drift_mm("0.1"), drift_mm(None)) == (0.0,) * 5
    assert places(source=({"kind": "scan"},)).drift_mm == 0.0


def test_scatter_and_mean_are_of_the_parts_that_are_there() -> None:
    dx_mm, dy_mm = np.array([0.3, 0.3, 9.0, 0.3, 0.3]), np.array([0.5, 0.3, 9.0, 0.3, 0.5])
    built = places(dx_mm=dx_mm, dy_mm=dy_mm)
    assert built.mean_mm == pytest.approx(0.5)
    assert built.scatter_mm == pytest.approx(np.sqrt((4 * 0.09 + 2 * 0.25 + 2 * 0.09) / 8))
    nobody = places(present=np.zeros(5, dtype=bool))
    assert (nobody.scatter_mm, nobody.mean_mm, nobody.missing) == (0.0, 0.0, 5)
    assert not built.number.flags.writeable and not built.sigma_mm.flags.writeable


@pytest.mark.parametrize("present", [9, 10])
def test_few_measured_parts_say_nothing_of_the_others(present: int) -> None:
    built = places(20, present=np.arange(20) < present)
    sigma_mm = built.parts(np.zeros((50, 2))).sigma_mm[1]
    assert sigma_mm == (built.scatter_mm if present == 10 else 0.0)
    found = built.parts(np.zeros((50, 2)))
    assert found.present.sum() == 50 - built.missing == 30 + present
    assert found.rotation_deg[::2][:20].tolist() == built.rotation_deg.tolist() and not found.rotation_deg[1::2].any()


def test_the_file_has_a_line_for_each_key_and_no_digit_too_many(tmp_path: Path) -> None:
    built = places(
        1, number=np.array([12]), dx_mm=np.array([0.12345678]), dy_mm=np.array([-1e-9]), rotation_deg=np.array([1.23456]),
        present=np.array([True]), sigma_mm=np.array([0.00300049]),
        film=Film(scale=(1.0123456789, 0.9), shear=1.23456789e-5, sigma=1.23456789e-5),
    )  # fmt: skip
    text = built.write(tmp_path / "a.json").read_text()
    assert (
        text
        == """{
  "format": "tactape-as-built/1",
  "tape": "t",
  "manifest_sha256": "%s",
  "film": {"scale": [1.012345679, 0.9], "shear": 1.2346e-05, "sigma": 1.2346e-05},
  "parts": {
    "designator": ["R12"],
    "dx_mm": [0.123457],
    "dy_mm": [0.0],
    "rotation_deg": [1.235],
    "present": [true],
    "sigma_mm": [0.003]
  },
  "source": [{"dpi": 1200, "kind": "scan"}]
}
"""
        % ("0" * 64)
    )


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
        stream.truncate((64 << 20) + 1)
    with pytest.raises(SpecError, match="more than"):
        AsBuilt.load(file)


def test_no_file_is_a_spec_error(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="cannot be read"):
        AsBuilt.load(tmp_path)
    with pytest.raises(SpecError, match="cannot be read: No such file or directory; give"):
        AsBuilt.load(tmp_path / "none.json")
    # what is no JSON has no reason of the system
    file = tmp_path / "as-built.json"
    file.write_text("[1, ")
    with pytest.raises(SpecError, match=r"cannot be read: Expecting value: line 1 column 5.*; give"):
        AsBuilt.load(file)


def test_arrays_of_a_program_are_checked() -> None:
    with pytest.raises(SpecError) as raised:
        places(number=np.array([1, 1, 2, 3, 4]), dx_mm=np.zeros(3), sigma_mm=np.full(5, np.nan))
    assert len(raised.value.problems) == 3


@pytest.mark.parametrize("value", [[1.0] * 5, np.array(1.0), np.full(5, "1")])
def test_what_is_no_array_of_its_kind_is_named(value: Any) -> None:
    with pytest.raises(SpecError, match=r"^sigma_mm = .* is no array of its kind"):
        places(sigma_mm=value)


def test_places_are_not_written_where_another_kit_s_belong(tmp_path: Path) -> None:
    """Under that name beside its manifest alone."""
    manifest, file = tmp_path / "manifest.json", tmp_path / "as-built.json"
    refuse_other_kit(file, "0" * 64, "out")
    manifest.write_text(json.dumps({"name": "t"}))
    refuse_other_kit(file, manifest_digest(manifest), "out")
    refuse_other_kit(tmp_path / "places.json", "0" * 64, "out")
    with pytest.raises(SpecError, match=r"^out = .* another kit belong.*nothing was touched"):
        refuse_other_kit(file, "0" * 64, "out")


def test_places_belong_to_one_kit(tmp_path: Path) -> None:
    manifest = tmp_path / "manifest.json"
    manifest.write_text(json.dumps({"name": "t"}))
    digest = manifest_digest(manifest)
    built = places(manifest_sha256=digest)
    assert built.problems_for("t", digest, 9) == []
    assert "is not u" in built.problems_for("u", digest, 9)[0].message
    assert "R9 exceeds R8" in built.problems_for("t", digest, 8)[0].message
    assert "another kit" in built.problems_for("t", "1" * 64, 9)[0].message
    for name, of in (("t", ""), ("u", ", of the tape 't'")):
        (problem,) = built.problems_for(name, "1" * 64, 9)
        assert problem.message == (
            f"manifest_sha256 = {digest[:12]}... is that of another kit{of}; the manifest of {name} has {'1' * 12}...; "
            "measure this tape, or give as_built='none' for the places of the design"
        )


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


def test_a_kit_has_the_places_that_are_given_those_beside_it_or_none(tmp_path: Path) -> None:
    manifest = tmp_path / "manifest.json"
    manifest.write_text(json.dumps({"name": "t"}))
    assert as_built_of(manifest, "t", 9) is None
    built = places(manifest_sha256=manifest_digest(manifest))
    elsewhere = built.write(tmp_path / "other.json")
    for given in (built, elsewhere, str(elsewhere)):
        found = as_built_of(manifest, "t", 9, given)
        assert found is not None and found.to_mapping() == built.to_mapping()
    assert as_built_of(manifest, "t", 9) is None
    places(manifest_sha256=built.manifest_sha256, sigma_mm=np.full(5, 0.2)).write(tmp_path)
    beside = as_built_of(manifest, "t", 9)
    assert beside is not None and beside.sigma_mm[0] == 0.2
    assert as_built_of(manifest, "t", 9, "none") is None
    with pytest.raises(SpecError, match="R9 exceeds R8"):
        as_built_of(manifest, "t", 8)
    with pytest.raises(SpecError, match="more than their displacement"):
        as_built_of(manifest, "t", 9, most_mm=1e-4)


@pytest.mark.parametrize("kind", ["link", "folder", "fifo"])
def test_what_has_the_name_of_the_places_and_is_none_is_refused(tmp_path: Path, kind: str) -> None:
    manifest, file = tmp_path / "manifest.json", tmp_path / "as-built.json"
    manifest.write_text(json.dumps({"name": "t"}))
    if kind == "link":
        file.symlink_to("nowhere")
    elif kind == "folder":
        file.mkdir()
    else:
        os.mkfifo(file)
    said = {"link": "a link to nothing", "folder": "a folder", "fifo": "no regular file"}[kind]
    with pytest.raises(SpecError, match=rf"as-built\.json is {said}, .*; remove it, or give as_built='none' for"):
        as_built_of(manifest, "t", 9)
    assert as_built_of(manifest, "t", 9, "none") is None


def test_a_tape_without_any_part_is_refused(tmp_path: Path) -> None:
    manifest = tmp_path / "manifest.json"
    manifest.write_text(json.dumps({"name": "t"}))
    bare = places(number=np.arange(1, 6), present=np.zeros(5, dtype=bool), manifest_sha256=manifest_digest(manifest))
    with pytest.raises(
        SpecError, match=r"present is false for all 5 parts of t, .*; measure this tape again, or give as_built='none'"
    ):
        as_built_of(manifest, "t", 5, bare)
    assert as_built_of(manifest, "t", 6, bare) is bare


def test_shapes_and_numbers_of_a_program_are_checked() -> None:
    assert len(places(0, present=np.empty(0, dtype=bool)).number) == 0
    for number in (np.array([0, 1, 2, 3, 4]), np.array([1, 3, 2, 4, 5]), np.ones((5, 1), dtype=np.int64)):
        with pytest.raises(SpecError, match="not ascending from 1"):
            places(number=number)
    for kind in (np.uint8, np.uint16, np.uint64):
        with pytest.raises(SpecError, match="not ascending from 1"):
            places(number=np.array([1, 3, 2, 4, 5], dtype=kind))
        assert len(places(number=np.array([1, 2, 3, 4, 5], dtype=kind)).parts(np.zeros((5, 2))).sigma_mm) == 5
    with pytest.raises(SpecError, match=r"dy_mm has shape \(4,\), not \(5,\)"):
        places(dy_mm=np.zeros(4))


def test_the_digest_is_of_all_bytes_of_a_manifest(tmp_path: Path) -> None:
    content = b"x" * (1 << 20) + b"y"
    (tmp_path / "manifest.json").write_bytes(content)
    assert manifest_digest(tmp_path / "manifest.json") == sha256(content).hexdigest()
