"""The public benchmark: the same bytes, the truth apart from the frames, and scores that errors of known size have."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.sense.benchmark.__main__ import main
from tactape_fab.sense.benchmark.adapters import ADAPTERS, answer_lines, changed_files, open_benchmark
from tactape_fab.sense.benchmark.answers import Answer, read_answers
from tactape_fab.sense.benchmark.conditions import CONDITIONS, FOREIGN, REGISTERED
from tactape_fab.sense.benchmark.score import Truth, calibration, read_truth, score
from tactape_fab.sense.benchmark.write import MOST_FRAMES, UNIT_MM, truth_path, write_benchmark
from tests.thorough import only_thorough

ONLY = ("imprint, 11x9 mm", "imprint, tape that is not named", "elastic, 2 N")
FRAMES = len(ONLY) * 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four frames of each of three conditions, one for each tape."""
    path = tmp_path_factory.mktemp("benchmark") / "small"
    write_benchmark(path, frames=4, only=ONLY)
    return path


@pytest.fixture(scope="module")
def truth(folder: Path) -> list[Truth]:
    return read_truth(truth_path(folder))


@pytest.fixture(scope="module")
def located(folder: Path) -> Path:
    """Answers of the package's own method."""
    path = folder.with_name("ml.jsonl")
    path.write_text("\n".join(answer_lines("ml", ADAPTERS["ml"], open_benchmark(folder))), encoding="utf-8")
    return path


# The files


def test_frames_do_not_tell_the_truth(folder: Path, truth: list[Truth]) -> None:
    names = {path.name for path in folder.rglob("*") if path.is_file()}
    assert names == {"frames.npy", "sensor.toml", "benchmark.json", *(f"tactape-s{s:03d}.json" for s in REGISTERED)}
    texts = [path.read_text(encoding="utf-8") for path in folder.rglob("*") if path.suffix != ".npy" and path.is_file()]
    assert not any(name in text for text in texts for name in (*ONLY, f"s{FOREIGN:03d}"))
    order = [one.condition for one in truth]
    assert {name: order.count(name) for name in ONLY} == dict.fromkeys(ONLY, 4)
    assert order != sorted(order, key=ONLY.index)
    assert {one.tape for one in truth if one.registered} == {f"tactape-s{s:03d}" for s in REGISTERED}


def test_frames_are_those_of_the_simulators(folder: Path, truth: list[Truth]) -> None:
    frames = np.load(folder / "frames.npy")
    assert frames.shape == (FRAMES, 240, 320) and frames.dtype == np.int16
    deep = frames.astype(np.float64) * UNIT_MM
    assert (np.ptp(deep, axis=(1, 2)) > 0.2).all() and (np.ptp(deep, axis=(1, 2)) < 3.0).all()
    assert 200e6 * 0.9 < MOST_FRAMES * len(CONDITIONS) * frames[0].nbytes < 200e6


def test_equal_seeds_give_equal_bytes_and_others_do_not(folder: Path, tmp_path: Path) -> None:
    again, other = (write_benchmark(tmp_path / str(seed), frames=4, seed=seed, only=ONLY[:1]) for seed in (2026, 2027))
    assert [*again.values()] == [*write_benchmark(tmp_path / "more", frames=4, only=ONLY[:1]).values()]
    assert again["frames.npy"] != other["frames.npy"] and again["sensor.toml"] == other["sensor.toml"]
    assert changed_files(folder) == [] == changed_files(tmp_path / "2026")


@only_thorough
def test_a_processor_without_vector_units_writes_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    units = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    plain = {
        "NPY_DISABLE_CPU_FEATURES": " ".join(units),
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
    }
    words = ["write", str(tmp_path / "plain"), "--frames", "4", *(word for name in ONLY for word in ("--only", name))]
    command = [sys.executable, "-m", "tactape_fab.sense.benchmark", *words]
    subprocess.run(command, env={**os.environ, **plain}, check=True, capture_output=True)
    assert (tmp_path / "plain" / "frames.npy").read_bytes() == (folder / "frames.npy").read_bytes()
    assert truth_path(tmp_path / "plain").read_bytes() == truth_path(folder).read_bytes()


def test_a_condition_has_the_same_frames_whatever_else_is_written(folder: Path, truth: list[Truth], tmp_path: Path) -> None:
    write_benchmark(tmp_path / "one", frames=4, only=ONLY[:1])
    alone, whole = np.load(tmp_path / "one" / "frames.npy"), np.load(folder / "frames.npy")
    for k, one in enumerate(read_truth(truth_path(tmp_path / "one"))):
        assert (alone[k] == whole[truth.index(one)]).all()


def test_changed_files_are_named(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_benchmark(tmp_path / "b", frames=1, only=ONLY[:1])
    assert main(["check", str(tmp_path / "b")]) == 0
    text = (tmp_path / "b" / "sensor.toml").read_text(encoding="utf-8")
    (tmp_path / "b" / "sensor.toml").write_text(text.replace("16.0", "16.1"), encoding="utf-8")
    (tmp_path / "b" / "frames.npy").unlink()
    assert changed_files(tmp_path / "b") == ["frames.npy", "sensor.toml"]
    assert main(["check", str(tmp_path / "b")]) == 1
    assert capsys.readouterr().out.count("changed") == 2


def test_everything_that_cannot_be_written_is_said_at_once(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["write", str(folder), "--frames", "66", "--seed", "-1", "--only", "imprint, 7x7"]) == 2
    said = capsys.readouterr().err
    for words in ("frames = 66", "seed = -1", "'imprint, 7x7 mm'", "exists already; nothing was touched"):
        assert words in said, words


# Methods


def test_our_method_locates_what_is_registered_and_nothing_else(located: Path, truth: list[Truth]) -> None:
    method, answers = read_answers(located, FRAMES)
    rows = score(answers, truth)
    assert method == "ml" and len(answers) == FRAMES
    assert [(rows[name].right, rows[name].wrong) for name in ONLY] == [(4, 0), (0, 0), (4, 0)]
    whole = rows["all"]
    assert (whole.frames, whole.right, whole.wrong) == (FRAMES, 8, 0)
    assert whole.p50_um is not None and 0.0 < whole.p50_um < 10.0 and whole.nees is not None and 0.1 < whole.nees < 5.0
    assert whole.stated is not None and 0.0 < whole.stated < 8e-4 and whole.p50_ms is not None and whole.p50_ms > 0.0


def test_the_paper_s_method_states_neither_covariance_nor_chance(folder: Path, truth: list[Truth], tmp_path: Path) -> None:
    output = tmp_path / "paper.jsonl"
    assert main(["answer", str(folder), "-o", str(output), "--method", "paper"]) == 0
    assert main(["answer", str(folder), "-o", str(output), "--method", "paper"]) == 2  # it is there
    whole = score(read_answers(output, FRAMES)[1], truth)["all"]
    assert whole.right >= 4 and whole.nees is None and whole.stated is None


def test_scores_are_printed_for_each_file(folder: Path, located: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", str(folder), str(located), str(located)]) == 0
    said = capsys.readouterr().out
    assert said.count("| all | 8 of 12 | 0 |") == 2 and said.count("| 0 to 0.0001 | ") == 2
    assert main(["score", str(folder), str(located), "nowhere.jsonl"]) == 2
    refused = capsys.readouterr()
    assert refused.out == "" and "nowhere.jsonl cannot be read: No such file or directory; give lines of JSON" in refused.err


def test_options_are_named_as_they_are_typed(folder: Path, located: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["write", str(folder), "--frames", "0", "--seed", "-1", "--only", "x"]) == 2
    assert main(["answer", str(folder), "-o", str(located)]) == 2
    said = capsys.readouterr().err
    for text in ("--frames = 0 is", "--seed = -1 is", "--only = 'x' is", f"FOLDER = {folder} is", f"-o = {located} exists"):
        assert f"error: {text}" in said


def test_texts_of_a_data_set_stay_on_their_lines(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evil = "x\nall right \x1b[31m\u202e\ud800"
    (tmp_path / "b").mkdir()
    index = {**json.loads((folder / "benchmark.json").read_text(encoding="utf-8")), "files": {"frames.npy": evil}}
    (tmp_path / "b" / "benchmark.json").write_text(json.dumps(index), encoding="utf-8")
    first, row, *_ = truth_path(folder).read_text(encoding="utf-8").splitlines()
    row = json.dumps({**json.loads(row), "condition": evil})
    truth_path(tmp_path / "b").write_text(f"{first}\n{row}\n", encoding="utf-8")
    head = json.dumps({"format": "tactape-answers/1", "method": evil})
    (tmp_path / "a.jsonl").write_text(f"{head}\n", encoding="utf-8")
    (tmp_path / "wrong.jsonl").write_text(json.dumps({"frame": 0, "located": True, evil: 1}), encoding="utf-8")
    assert main(["check", str(tmp_path / "b")]) == 1
    assert main(["score", str(tmp_path / "b"), str(tmp_path / "a.jsonl")]) == 0
    assert main(["score", str(tmp_path / "b"), str(tmp_path / "wrong.jsonl")]) == 2
    said = capsys.readouterr()
    assert said.out.count("x\\nall right \\x1b[31m\\u202e\\ud800") == 3
    assert not {"\x1b", "\u202e"} & {*said.out, *said.err}


# Scores


def _exact(truth: list[Truth], **changed: Any) -> dict[int, Answer]:
    """The truth as answers, with something changed in all of them."""
    names = {k: one for k, one in enumerate(truth) if one.registered}
    return {
        k: replace(Answer(located=True, tape=one.tape, position_mm=one.position_mm, theta_deg=one.theta_deg), **changed)
        for k, one in names.items()
    }


@pytest.mark.parametrize("given", [".", "../{name}", "tapes/.."])
def test_a_data_set_may_be_named_from_within(
    given: str, folder: Path, located: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    assert main(["score", given.format(name=folder.name), str(located)]) == 0
    assert "| all |" in capsys.readouterr().out
    assert main(["write", "."]) == 2 and main(["write", "/"]) == 2
    assert capsys.readouterr().err.count("is a folder; nothing was touched; use another name") == 2


def test_a_reader_that_has_enough_ends_it_without_a_traceback(folder: Path, located: Path) -> None:
    command = [sys.executable, "-m", "tactape_fab.sense.benchmark", "score", str(folder), str(located)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as ended:
        assert ended.stdout is not None and ended.stderr is not None
        ended.stdout.close()
        assert ended.stderr.read() == ""
    assert ended.returncode == 1


def test_a_signal_leaves_no_unfinished_folder(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tactape_fab.sense.benchmark", "write", "set", "--frames", "64", "--only", ONLY[0]]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as stopped:
        assert stopped.stderr is not None and "50 of 64" in stopped.stderr.readline()
        stopped.terminate()
    assert stopped.returncode == 128 + signal.SIGTERM and list(tmp_path.iterdir()) == []


def test_the_truth_scores_without_error(truth: list[Truth]) -> None:
    whole = score(_exact(truth), truth)["all"]
    assert (whole.right, whole.wrong, whole.p95_um, whole.p95_deg) == (8, 0, 0.0, 0.0)


def test_a_sector_names_a_tape_as_well(truth: list[Truth]) -> None:
    by_sector = {k: replace(a, tape=None, sector=truth[k].sector) for k, a in _exact(truth).items()}
    assert score(by_sector, truth)["all"].right == 8
    assert score({k: replace(a, sector=FOREIGN) for k, a in by_sector.items()}, truth)["all"].wrong == 8


def test_another_place_tape_or_angle_is_wrong(truth: list[Truth]) -> None:
    exact = _exact(truth)
    moved = {k: replace(a, position_mm=(a.position_mm[0] + 0.8, a.position_mm[1])) for k, a in exact.items() if a.position_mm}
    turned = {k: replace(a, theta_deg=a.theta_deg + 180.0) for k, a in exact.items() if a.theta_deg is not None}
    others = {k: replace(a, tape="tactape-s007" if a.tape != "tactape-s007" else "tactape-s024") for k, a in exact.items()}
    for answers in (moved, turned, others):
        whole = score(answers, truth)["all"]
        assert (whole.right, whole.wrong, whole.p50_um) == (0, 8, None)


def test_nothing_is_right_where_the_tape_is_not_registered(truth: list[Truth]) -> None:
    answers = {
        k: Answer(located=True, tape=one.tape, position_mm=one.position_mm, theta_deg=one.theta_deg)
        for k, one in enumerate(truth)
    }
    assert score(answers, truth)[ONLY[1]].wrong == 4


def test_errors_and_nees_are_those_of_a_known_error(truth: list[Truth]) -> None:
    off = {
        k: replace(
            a,
            position_mm=(a.position_mm[0] + 0.003, a.position_mm[1] - 0.004),
            theta_deg=a.theta_deg + 0.2,
            covariance=np.diag([0.003**2, 0.004**2, np.radians(0.2) ** 2]),
        )
        for k, a in _exact(truth).items()
        if a.position_mm is not None and a.theta_deg is not None
    }
    whole = score(off, truth)["all"]
    assert whole.p50_um == pytest.approx(5.0) and whole.p95_deg == pytest.approx(0.2) and whole.nees == pytest.approx(1.0)


def test_p_false_is_compared_with_what_is_wrong(truth: list[Truth]) -> None:
    exact = _exact(truth, p_false=0.05)
    first = min(exact)
    answers = {**exact, first: replace(exact[first], located=False, tape="tactape-s999", p_false=0.7)}
    classes = {low: (count, wrong) for low, _, count, _, wrong in calibration(answers, truth)}
    assert classes == {0.0: (0, 0), 1e-4: (0, 0), 0.01: (7, 0), 0.1: (0, 0), 0.5: (1, 1)}
    assert [stated for *_, stated, _ in calibration(answers, truth)] == pytest.approx([0.0, 0.0, 0.35, 0.0, 0.7])
    assert score(answers, truth)["all"].stated == pytest.approx(0.35)
    assert score(_exact(truth, p_false=3.0), truth)["all"].stated == len(exact)


# Files of answers


def test_problems_of_a_file_of_answers_are_said_with_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "mine.jsonl"
    lines: list[object] = [
        {"format": "tactape-answers/1", "method": "mine"},
        {"frame": 0, "located": False, "reason": "nothing"},
        {"frame": 1, "located": True, "tape": "a"},
        {"frame": 12, "located": False},
        {"frame": 0, "located": False},
        [],
        {"frame": 2, "located": True, "sector": 7, "position_mm": [1, 2], "theta_deg": 3, "covariance": [[1, 2, 3]] * 3},
        {"frame": 3, "located": True, "sector": 7, "position_mm": [1, float("nan")], "theta_deg": 3},
        {"frame": 4, "located": False, "p_false": -0.5},
        {"frame": 5, "located": False, "covariance": [[10**400, 0, 0], [0, 1, 0], [0, 0, 1]]},
    ]
    path.write_text("".join(json.dumps(text) + "\n" for text in lines), encoding="utf-8")
    with pytest.raises(SpecError) as caught:
        read_answers(path, FRAMES)
    said = [problem.message for problem in caught.value.problems]
    assert [int(text.partition("line ")[2].partition(":")[0]) for text in said] == [3, 4, 5, 6, 7, 8, 9, 10]
    path.write_text("".join(json.dumps(text) + "\n" for text in lines[:2]), encoding="utf-8")
    method, answers = read_answers(path, FRAMES)
    assert method == "mine" and answers.keys() == {0} and not answers[0].located


def test_a_truth_or_index_that_is_none_is_refused(folder: Path, located: Path, tmp_path: Path) -> None:
    for text in (
        "",
        "{}",
        "[1]",
        '{"format": "tactape-benchmark/1"}',
        '{"format": "tactape-truth/1"}\n{"frame": 1}',
        '{"format": "tactape-truth/1"}\n{"frame": 0, "x": 1}',
        '{"format": "tactape-truth/1"}\n{"frame": 0, "condition": "a", "registered": true, "tape": "b", "sector": 7}',
    ):
        (tmp_path / "truth.jsonl").write_text(text, encoding="utf-8")
        with pytest.raises(SpecError, match="no truth"):
            read_truth(tmp_path / "truth.jsonl")
        (tmp_path / "benchmark.json").write_text(text, encoding="utf-8")
        with pytest.raises(SpecError, match="no benchmark"):
            open_benchmark(tmp_path)
    for read, what in ((read_truth, "truth of a benchmark"), (open_benchmark, "benchmark")):
        with pytest.raises(SpecError, match=f"none.* is no {what}: No such file or directory; "):
            read(tmp_path / "none")
    assert main(["score", str(tmp_path / "none"), str(located)]) == 2


@pytest.mark.parametrize("words", ["", "write", "check", "answer", "score"])
def test_help_is_printed(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*words.split(), "--help"])
    assert ended.value.code == 0
    assert "usage: python -m tactape_fab.sense.benchmark" in capsys.readouterr().out
