"""Two versions' answers are compared to the last digit."""

from __future__ import annotations

from math import inf, nan, nextafter
from pathlib import Path

import pytest

from tests.bench import answers
from tests.bench.answers import differences


def test_the_last_digit_a_sign_and_a_missing_field_are_seen_and_nan_is_nan() -> None:
    old = {"x": [1.0, nan], "y": 0.0, "reason": None}
    assert differences(old, {"x": [1.0, nan], "y": 0.0, "reason": None}) == []
    assert differences(old, {"x": [nextafter(1.0, inf), nan], "y": -0.0}) == ["x", "y"]
    assert differences(old, old | {"tilt": None, "theta": 1.0}) == ["theta"]


def test_a_changed_answer_is_named_and_ends_with_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = {"row": "7x7", "how": "open world", "frame": 3, "located": True, "theta_deg": 1.0}
    monkeypatch.setattr(answers, "answers", lambda frames: iter([said]))
    monkeypatch.setattr("sys.argv", ["answers", "write", f"{tmp_path}/old.jsonl"])
    answers.main()
    monkeypatch.setattr("sys.argv", ["answers", "compare", f"{tmp_path}/old.jsonl"])
    answers.main()
    assert capsys.readouterr().out == "1 answers, 1 located: 0 differ\n"
    said["theta_deg"] = nextafter(1.0, inf)
    with pytest.raises(SystemExit, match="1"):
        answers.main()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("7x7, open world, frame 3: theta_deg 1.0 -> 1.00000000") and lines[1:] == [
        "1 answers, 1 located: 1 differ",
        "       1  theta_deg",
    ]
