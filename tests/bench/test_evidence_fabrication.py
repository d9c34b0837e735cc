"""The section on fabrication speed says what was measured, and what is measured is what it says."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.bench.evidence import fabrication, fabrication_measure
from tests.bench.evidence.fabrication_measure import ASSEMBLY, COPPER, KIT, LIBRARIES, ONLY_STL, SOLID, STL, THREEMF, US
from tests.bench.evidence.job import FULL, QUICK, Result
from tests.bench.evidence.page import FIGURES_JSON, page_of, write_page
from tests.bench.evidence.record import results_of
from tests.bench.gerber_peers import PEERS
from tests.thorough import only_thorough


def synthetic() -> dict[str, Result]:
    """Ours in proportion to parts, gerber_writer's ten times that, build123d's as their square; our copper twice as large."""
    results: dict[str, Result] = {
        fabrication.PROCESSES: {
            "processes": {"`make`": {"elapsed_s": 1.25, "cpu_s": 1.0}},
            "versions": dict.fromkeys(LIBRARIES, "9.9"),
        }
    }
    for parts in (1_000, 10_000, 100_000):
        copper, solid = {US: parts * 1e-6, "gerber_writer": parts * 1e-5}, {US: parts * 1e-5}
        sizes: dict[str, dict[str, int]] = {COPPER: {US: 80 * parts, "gerber_writer": 40 * parts}, SOLID: {US: parts}}
        memory: dict[str, dict[str, float]] = {KIT: {US: parts / 10}}
        if parts <= 10_000:
            solid["build123d"], sizes[SOLID]["build123d"] = (parts / 100) ** 2 / 1000, 4 * parts
            memory[SOLID] = {US: 40.0, "build123d": parts / 2}
        sizes[KIT] = {US: 8000 * parts}
        seconds = {COPPER: copper, SOLID: solid, KIT: {US: parts * 1e-4}}
        results[f"all, {parts} parts"] = {"parts": parts, "seconds": seconds, "bytes": sizes, "memory_mb": memory}
    return results


def content_of(results: dict[str, Result]) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(FIGURES_JSON.read_text(encoding="utf-8"))
    entries = [{"section": fabrication.SECTION, "name": name, "options": {}, "result": one} for name, one in results.items()]
    return content | {"results": entries}


def test_both_sides_stand_in_the_table_also_where_ours_loses() -> None:
    said = fabrication.lines(synthetic())
    assert "| copper layer | 100,000 | 0.100 | gerber_writer | 1.00 | 10 | 0.50 |" in said
    assert "| solid, STEP | 10,000 | 0.100 | build123d | 10.0 | 100 | 4.00 |" in said  # the largest that both wrote
    assert "Below 1, where ours is slower or larger: copper layer in bytes against gerber_writer (0.50)." in said
    results = synthetic()
    for one in results.values():
        one.get("bytes", {}).get(COPPER, {}).update(gerber_writer=10**9)
    assert "Below 1, where ours is slower or larger: nowhere." in fabrication.lines(results)


def test_growth_memory_and_processes_are_said() -> None:
    said = fabrication.lines(synthetic())
    assert "| solid, STEP | ours | 0.0100 | 0.100 | 1.00 | 1.00 | 1.00 |" in said
    assert "| solid, STEP | build123d | 0.100 | 10.0 |  | 2.00 | 2.00 |" in said
    assert "A process that writes the solid of 10,000 parts as STEP peaks at 40 MB, build123d's at 5000 MB." in said
    assert "One that makes the whole kit of 100,000 parts, 800 MB of files, peaks at 10000 MB." in said
    assert "| `make` | 1.25 | 1.00 |" in said
    assert "build123d 9.9" in "\n".join(said)
    assert max(map(len, said)) <= 130


def test_a_slope_is_the_exponent_of_growth() -> None:
    assert fabrication.slope_of([(n, 3e-6 * n**1.5) for n in (500, 2_000, 200_000)]) == pytest.approx(1.5)
    assert fabrication.slope_of([(500, 1.0)]) is None


def test_the_plot_shows_every_curve_with_its_slope() -> None:
    (figure,) = fabrication.pictures(synthetic()).values()
    axes = {one.get_title(): one for one in figure.axes}
    assert list(axes) == list(fabrication.PLOTTED)
    shown = {line.get_label(): line.get_xydata().tolist() for line in axes[SOLID].lines}
    assert shown["build123d: 2.00"] == [[1_000, 0.1], [10_000, 10.0]]
    assert len(shown[f"{US}: 1.00"]) == 3
    assert not axes[ASSEMBLY].lines


def test_page_and_picture_are_made_where_there_are_figures(tmp_path: Path) -> None:
    written = write_page(content_of(synthetic()), tmp_path)
    assert [path.name for path in written] == ["evidence.md", "evidence-growth.png"]
    assert "## Fabrication speed" in written[0].read_text(encoding="utf-8")
    assert written[1].read_bytes().startswith(b"\x89PNG")
    (bare := tmp_path / "bare").mkdir()
    assert [path.name for path in write_page(content_of({}), bare)] == ["evidence.md"]
    assert "Fabrication" not in page_of(content_of({}))


def test_the_committed_page_has_the_section_where_it_has_its_figures() -> None:
    content = json.loads(FIGURES_JSON.read_text(encoding="utf-8"))
    found = results_of(content, fabrication.SECTION)
    assert ("## Fabrication speed" in page_of(content)) == bool(found)
    for who in (who for of_who in fabrication.points_of(found).values() for who in of_who):
        assert who in {*fabrication.STYLES, "trimesh", "lib3mf"}


def test_times_are_measured_alone_and_up_to_the_largest_tape() -> None:
    full, quick = fabrication.jobs(FULL), fabrication.jobs(QUICK)
    assert all(one.alone for one in (*full, *quick))
    for kind in ("copper", "models", "kit"):
        sizes = [one.options["parts"] for one in full if one.name.startswith(kind)]
        assert (min(sizes), max(sizes)) == (500, 200_000)
    assert max(one.options.get("parts", 0) for one in quick) == 10_000
    asked = {one.options["parts"]: one.options for one in full if one.name.startswith("models")}
    assert [parts for parts, said in asked.items() if said["kernel"]] == [500, 1_000, 2_000]
    assert [parts for parts, said in asked.items() if not said["writers"]] == [200_000]
    assert [parts for parts, said in asked.items() if said["union"]] == [500, 1_000, 2_000, 10_000]
    assert sum(one.options.get("kernel", False) for one in quick) == 1
    assert min(one.options["turns"] for one in full) >= 2


def test_contenders_take_turns_and_the_least_time_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    clock: Iterator[float] = iter([0.0, 3.0, 10.0, 15.0, 20.0, 22.0, 30.0, 36.0])
    monkeypatch.setattr(fabrication_measure, "process_time", lambda: next(clock))
    called: list[str] = []
    found = fabrication_measure.in_turns({"a": lambda: called.append("a"), "b": lambda: called.append("b")}, 2)
    assert called == ["a", "b", "a", "b"]
    assert found == {"a": 2.0, "b": 5.0}


def test_copper_and_kit_are_measured() -> None:
    copper = fabrication_measure.measure_copper(100, 1, True)
    assert copper["parts"] >= 100
    assert set(copper["seconds"][COPPER]) == set(copper["bytes"][COPPER]) == {US, *PEERS}
    assert set(fabrication_measure.measure_copper(100, 1, False)["seconds"][COPPER]) == {US}
    kit = fabrication_measure.measure_kit(100, 1)
    assert kit["parts"] == copper["parts"]
    assert kit["bytes"][KIT][US] > copper["bytes"][COPPER][US]
    assert kit["seconds"][KIT][US] > copper["seconds"][COPPER][US]
    assert 30 < kit["memory_mb"][KIT][US] < 1000


@only_thorough
def test_models_are_measured_with_everyone_s_files() -> None:
    found = fabrication_measure.measure_models(100, 1, True, True, True)
    assert {file: set(who) for file, who in found["seconds"].items()} == {
        SOLID: {US, "build123d"},
        ASSEMBLY: {US, "build123d"},
        STL: {US, "manifold3d, trimesh", "build123d"},
        THREEMF: {US, "manifold3d, lib3mf"},
        ONLY_STL: {US, "trimesh"},
        fabrication_measure.ONLY_THREEMF: {US, "lib3mf"},
    }
    for file, sizes in found["bytes"].items():
        assert set(sizes) == set(found["seconds"][file]) <= set(fabrication.STYLES) | {"trimesh", "lib3mf"}
        assert max(sizes.values()) < 8 * min(sizes.values())  # the same content
    assert found["bytes"][ONLY_STL][US] == found["bytes"][ONLY_STL]["trimesh"]
    assert found["memory_mb"][SOLID]["build123d"] > found["memory_mb"][SOLID][US]
    alone = fabrication_measure.measure_models(100, 1, False, False, False)
    assert set(alone["seconds"]) == set(found["seconds"])
    assert all(set(who) == {US} for who in alone["seconds"].values())


@only_thorough
def test_whole_processes_are_measured_with_the_versions_of_libraries() -> None:
    found = fabrication_measure.measure_processes(1)
    assert set(found["versions"]) == set(LIBRARIES)
    cpu_s = {name: one["cpu_s"] for name, one in found["processes"].items()}
    assert cpu_s["`make`"] > cpu_s["`make --no-verify`"] > cpu_s["`--help`"] > cpu_s["`python -c ''`"] > 0
