"""The page of evidence says what its figures say, and figures are measured as they are said to be."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tactape_fab.sense import Scene, load_sensor
from tests.bench import place_chance
from tests.bench.__main__ import main, measure
from tests.bench.evidence import accuracy, codes, conditions, counts, curves, place, resolution, simulators, table_one, table_two
from tests.bench.evidence import record as records
from tests.bench.evidence.job import FULL, QUICK, Job, Result, Size
from tests.bench.evidence.page import FIGURES_JSON, MEASURED, PAGE, jobs, page_of
from tests.bench.evidence.record import Record, results_of
from tests.bench.false_accepts import Record as Counts
from tests.bench.false_accepts import about
from tests.bench.false_tally import Tally
from tests.bench.localization_false import Job as Count
from tests.bench.localization_rows import Row, frames_of
from tests.thorough import only_thorough

TINY = Size(name="tiny", trials=1, frames=3, sectors=2)


def doubled(value: int) -> Result:
    return {"twice": 2 * value}


def job(value: int) -> Job:
    return Job(section="trial", name=f"of {value}", measure=doubled, options={"value": value})


def test_the_page_is_made_of_the_figures_beside_it() -> None:
    content = json.loads(FIGURES_JSON.read_text(encoding="utf-8"))
    assert page_of(content) == PAGE.read_text(encoding="utf-8"), "run python -m tests.bench"
    assert {entry["section"] for entry in content["results"]} >= {
        table_one.SECTION,
        table_two.SECTION,
        curves.SECTION,
        codes.SECTION,
    }


def test_a_regression_is_that_of_the_textbook() -> None:
    true, answered = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.1, 1.0, 2.2, 3.1])
    found = table_one.regression(true, answered)
    # by hand: Sxx 5, Sxy 5.1, means 1.5 and 1.6
    assert found.slope == pytest.approx(1.02)
    assert found.intercept == pytest.approx(0.07)
    residual = answered - (0.07 + 1.02 * true)
    assert found.rse == pytest.approx(np.sqrt((residual**2).sum() / 2))
    assert found.rmse == pytest.approx(np.sqrt((0.01 + 0.0 + 0.04 + 0.01) / 4))
    assert found.r2 == pytest.approx(1.02**2 * 5 / ((answered - 1.6) ** 2).sum())


def test_table_one_regresses_what_both_methods_answer() -> None:
    found = table_one.measure("ideal", "theta", 1)
    assert found["frames"] == 21
    for method in table_one.METHODS:
        assert found[method]["located"] >= 19
        assert found[method]["slope"] == pytest.approx(1.0, abs=0.01)
    assert found["ml"]["rmse"] < table_one.PAPER["theta"]["rmse"] / 5


def test_a_curve_ends_where_too_few_are_right() -> None:
    curve = replace(curves.CURVES[0], values=(5.0, 6.0, 7.0, 8.0))
    right = {5.0: 100, 6.0: 98, 7.0: 99, 8.0: 100}
    results = {f"{curve.title} {value:g}": {"open": {"frames": 100, "right": count}} for value, count in right.items()}
    assert curves.bound(curve, results, "open") == 7.0
    assert curves.bound(replace(curve, falling=False), results, "open") == 5.0
    results[f"{curve.title} 8"]["open"]["right"] = 0
    assert curves.bound(curve, results, "open") is None


def test_a_point_holds_both_worlds_and_the_paper_s_method() -> None:
    found = curves.measure_point("contact", 11.0, 3)
    assert set(found) == set(curves.METHODS)
    assert found["open"]["right"] == found["closed"]["right"] == found["open"]["limit"] == 3
    assert found["open"]["position_um"] < 20.0


def test_the_baseline_finds_contacts_now_and_then() -> None:
    try:
        table_two.create_brisk()
    except RuntimeError as error:  # `.ci/run` runs this test again, with OpenCV's contributed modules
        pytest.skip(str(error))
    found = table_two.measure_setting("tuned", 8)
    assert found["ours"]["right"] == found["frames"] == 8
    assert found["baseline"]["right"] >= 3
    assert found["baseline"]["position_um"] < 200.0 and found["baseline"]["theta_deg"] < 3.0


@only_thorough
def test_errors_are_held_against_the_bound() -> None:
    found = accuracy.measure_scene("default scene", 20)
    assert found["frames"] == 20
    assert 0.7 < found["position_ratio"] < 1.5 and 0.5 < found["theta_ratio"] < 1.6
    assert found["position_um"] < found["paper_position_um"] / 3  # some thirty dots instead of one
    # no decoder is better than the pixels, 20 frames' chance aside
    assert found["pixels"]["position_um"] > 0.7 * found["pixel_bound"]["position_um"] > 0.1
    said = accuracy.lines(dict.fromkeys(accuracy.SCENES, found))
    assert f"| default scene | 20 | {found['dot_px']:.2f} | {found['position_um']:.2f}, " in "\n".join(said)


def test_windows_and_tapes_are_counted() -> None:
    found = codes.measure_windows("microdots-4x4")
    assert found["range"] == 3375
    assert found["valid in all rotations"] == found["windows"]
    assert 0.8 < found["unnoticed"] / found["windows with a wrong symbol"] < 0.93
    tapes = codes.measure_tapes(4, 2)
    assert tapes["tapes"] == 2 == sum(tapes["distances"].values())


def test_every_section_has_jobs_of_its_own_names() -> None:
    for size in (QUICK, FULL, TINY):
        wanted = jobs(size)
        assert len({one.key for one in wanted}) == len({(one.section, one.name) for one in wanted}) == len(wanted)
    assert sum(one.options.get("frames", 0) for one in jobs(QUICK)) < sum(one.options.get("frames", 0) for one in jobs(FULL)) / 5


@pytest.mark.parametrize("processes", [1, 2])
def test_what_was_measured_is_not_measured_again(tmp_path: Path, processes: int, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "figures.jsonl"
    measure([job(1), job(2)], Record.opened(path), processes)
    assert "2 of 2" in capsys.readouterr().err
    with path.open("a") as stream:
        stream.write('{"key": "cut o')
    record = Record.opened(path)
    measure([job(1), job(2), job(3)], record, 1)
    assert "1 of 1" in (said := capsys.readouterr().err) and "of 3" in said
    content: dict[str, Any] = {"results": list(Record.opened(path).results.values())}
    assert results_of(content, "trial") == {"of 1": {"twice": 2}, "of 2": {"twice": 4}, "of 3": {"twice": 6}}


def test_the_page_says_of_which_sources_it_is(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    content = json.loads(FIGURES_JSON.read_text(encoding="utf-8"))
    assert f"The sources were `{content['about']['sources']}`" in page_of(content)
    monkeypatch.setattr("sys.argv", ["tests.bench", "--sources"])
    main()
    assert capsys.readouterr().out.strip() == records.about()["sources"]


def test_sections_that_are_kept_say_of_which_sources_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = [section.SECTION for section in MEASURED]
    places = ["--json", str(tmp_path / "new.jsonl"), "--page", str(tmp_path)]
    monkeypatch.setattr("sys.argv", ["tests.bench", "--keep", *kept, *places])
    main()
    before = json.loads(FIGURES_JSON.read_text(encoding="utf-8"))
    content = json.loads((tmp_path / FIGURES_JSON.name).read_text(encoding="utf-8"))
    assert [entry["result"] for entry in content["results"]] == [entry["result"] for entry in before["results"]]
    assert content["about"]["sources"] == records.about()["sources"]
    said = (tmp_path / PAGE.name).read_text(encoding="utf-8")
    lines = [line for line in said.splitlines() if line.startswith("Not measured anew, and of the sources `")]
    for entry in before["results"]:
        if entry["section"] in kept:
            sources = entry.get("sources", before["about"]["sources"])
            (line,) = (line for line in lines if f"`{sources}`" in line)
            assert entry["section"] in line


def test_figures_of_other_sources_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "figures.jsonl"
    path.write_text('{"sources": "others"}\n')
    with pytest.raises(SystemExit, match="other sources"):
        Record.opened(path)


def test_counts_of_false_accepts_come_from_their_file(tmp_path: Path) -> None:
    path = tmp_path / "counts.jsonl"
    record = Counts.opened(path)
    for sector, located in ((1, 0), (2, 2)):
        record.add(
            Count(kind="other sectors, dots", subject=f"sector {sector}", level="dots"), Tally(frames=1000, located=located)
        )
    (entry,) = counts.entries([path])
    said = counts.lines({entry["name"]: entry["result"]})
    assert said[0] == f"## {counts.TITLE}" and "Above the line, beyond chance: none." in said
    row = "| other sectors, dots | 2,000 (2 sectors, 1,000 or more each) | 2 | sector 2: 2 of 1000 | 3.1e-03 |"
    assert f"{row} `{about()['sources'][:8]}` |" in said


def test_counts_of_several_files_are_put_together(tmp_path: Path) -> None:
    paths = [tmp_path / "first.jsonl", tmp_path / "second.jsonl"]
    for path, located in zip(paths, (5, 1), strict=True):
        record = Counts.opened(path)
        for kind in ("ball, dots, open world", f"of {path.stem}, dots"):
            record.add(Count(kind=kind, subject="ball", level="dots"), Tally(frames=100, located=located))
    found = {entry["name"]: entry["result"]["located"] for entry in counts.entries(paths)}
    assert found == {"ball, dots, open world": 1, "of first, dots": 5, "of second, dots": 1}
    assert counts.entries([]) == []
    other = tmp_path / "other.jsonl"
    other.write_text("no\ncounts\n")
    with pytest.raises(ValueError, match=r"other\.jsonl has no counts"):
        counts.entries([*paths, other])


def test_bounds_that_are_too_small_too_often_are_named() -> None:
    promised = {"frames": 10000, "located": 0, "bound": "p_tape", "decades": [900, 110, 8, 0, 0, 0, 0, 0]}
    broken = {"frames": 10000, "located": 0, "bound": "p_place", "decades": [900, 300, 200, 100, 0, 0, 0, 0]}
    found = {"ball, dots, open world": promised, "ball, dots, closed world": promised, "other, dots": broken}
    assert counts._above(found) == ["other, dots, 1 % of them at 1e-04"]
    assert list(counts._worlds_as_one(found)) == ["ball, dots, both worlds", "other, dots"]
    found["ball, dots, closed world"] = promised | {"decades": [1, 0, 0, 0, 0, 0, 0, 0]}
    assert list(counts._worlds_as_one(found)) == list(found)
    axes = counts.pictures(found)["evidence-false-accepts.png"].axes
    assert [len(panel.get_legend_handles_labels()[0]) for panel in axes[:2]] == [3, 2]
    assert not any("other" in text.get_text() for text in axes[0].texts)
    assert any("other, dots" in text.get_text() for text in axes[1].texts)


def test_the_page_names_the_noise_of_its_figures() -> None:
    said = json.loads(FIGURES_JSON.read_text(encoding="utf-8"))["about"].get("noise")
    if said is not None:
        assert said == load_sensor("gelsight-mini").slope_noise
        assert f"slopes of {said:g} rms" in " ".join(PAGE.read_text(encoding="utf-8").split())
        return
    # the page's figures are of the older noise model, as it says
    smooth = Scene(texture_mm=0.0, dome_mm=0.0, tilt_mm_per_mm=(0.0, 0.0), noise_model="smooth")
    depth_um = [1000.0 * frame.depth for frame in frames_of(Row(name="noise", scenes=(smooth,)), 10)]
    high = [float((frame - cv2.blur(frame, (25, 25))).std()) for frame in depth_um]
    assert f"with {np.mean(high):.0f} µm\nof noise" in PAGE.read_text(encoding="utf-8")


def test_covariances_and_simulators_are_shown_as_measured() -> None:
    default = conditions.measure_row("default", 12)
    assert default["right"] == 12 and default["wrong"] == 0 and default["nees"] < 3.0
    wide = default | {"nees": 1.31}
    said = conditions.lines({"default": default | {"nees": 1.0}, "tilt": wide})
    assert said[-2] == "All rows but tilt are from 0.8 to 1.3."
    pressed = simulators.measure("default, 2 N", "elastic", 2)
    assert pressed["right"] == 2
    rows = simulators.lines({"default, 2 N, imprint": default, "default, 2 N, elastic": pressed})
    assert any(row.startswith("| default, 2 N | 12 of 12 | 0 |") and "| 2 of 2 | 0 |" in row for row in rows)


def test_a_finer_sensor_is_more_exact() -> None:
    coarse, fine = (resolution.measure(px_per_mm, 8) for px_per_mm in (8, 16))
    assert fine["right"] == 8 and fine["position_um"] < coarse["position_um"]
    assert fine["size_px"] == [320, 240]


@only_thorough
def test_p_place_is_held_against_what_happens() -> None:
    found = [
        place_chance.Said(
            name="a", part=0, tapes=1, max_p_tape=0.3, frame=(0, 1, 2), p_tape=(0.1,) * 3, p_place=p_place, wrong=wrong
        )
        for p_place, wrong in (((0.5, 0.02, 3e-9), (True, False, False)), ((0.2, 1.0, 0.03), (False, True, True)))
    ]
    decades = [one for one in place_chance.by_decade(found) if one.answers]
    assert [(one.exponent, one.answers, one.wrong) for one in decades] == [
        (-1, 3, 2),
        (-2, 2, 1),
        (place_chance.LEAST_DECADE, 1, 0),
    ]
    assert decades[0].said == pytest.approx(1.7)
    # twice the same batches: counts add up; 2 of 3.4 with the limits of a Poisson count of 4, 1.09 and 10.24
    assert "| 1 | 0.3 | 1e-1 to 1e0 | 6 | 3.4 | 4 | 1.18 (0.32 to 3.01) |" in place_chance.rows([*decades, *decades])
    answered = place.measure_batches("6 mm, 30 % missing", 0, 1)
    assert answered["contacts"] == 250 and sum(one[3] for one in answered["decades"]) > 100


def test_the_equations_of_the_paper_are_derived() -> None:
    """Two dots with independent errors of sigma, d apart: the angle of their line errs by sqrt(2) sigma / d."""
    rng, distance_px, sigma_px = np.random.default_rng(1), 128.0, 0.3
    ends = rng.normal(0.0, sigma_px, (2, 20_000))
    assert np.arctan2(ends[1] - ends[0], distance_px).std() == pytest.approx(np.sqrt(2.0) * sigma_px / distance_px, rel=0.02)
