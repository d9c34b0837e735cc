"""The robot's page and the applications say what their figures say, and the scripts succeed as they are said to."""

from __future__ import annotations

import importlib
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactape_fab import Localizer, Motion, Tracker
from tactape_fab.sense.track.tracker import TOUCHES
from tests.bench import camera, tracking
from tests.docs.test_docs import script_of

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLES = ("bottles", "key", "posture", "stick")


@pytest.fixture
def examples(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The scripts of the applications, by name; they find each other as they do when they are run."""
    monkeypatch.setattr(sys, "path", [str(DOCS / "examples"), *sys.path])
    before = set(sys.modules)
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if name in ("common", *EXAMPLES):
            del sys.modules[name]


def prose(page: str) -> str:
    return re.sub(r"\s+", " ", (DOCS / page).read_text(encoding="utf-8"))


def test_the_robot_s_page_is_made_of_its_figures() -> None:
    script = script_of("make_robot")
    content = json.loads(script.FIGURES.read_text(encoding="utf-8"))
    assert set(content) == {"measured", *script.MEASURES} and set(content["measured"]) == set(script.MEASURES)
    page = script.PAGE.read_text(encoding="utf-8")
    assert script.made_anew(page, content) == page, "run python docs/make_robot.py"
    for table in script.TABLES:
        assert page.count(f"<!-- {table} -->\n|") == 1, table


def test_what_the_robot_s_page_claims_of_its_figures() -> None:
    content = json.loads((DOCS / "robot.json").read_text(encoding="utf-8"))
    rows = [*content["motions"], *content["traps"]]
    worlds = [row[world] for row in rows for world in ("open", "closed") if world in row]
    assert {one[way]["false"] for one in worlds for way in ("single", "tracked")} == {0}  # no located frame in a wrong place
    for row in content["motions"]:
        for world in ("open", "closed"):
            assert row[world]["tracked"]["right"] >= row[world]["single"]["right"], row["course"]
    assert sum(slip["false"] for slip in content["slips"]) == 0
    for row in content["camera"]:
        if row["cell_mm"] >= 1.0:
            assert row["found"] == row["views"]
            assert row["refined, near"]["max_mm"] <= 0.1
            assert row["ten refined, whole"]["max_mm"] <= 0.1
    assert content["camera"][0]["found"] < content["camera"][0]["views"]
    assert content["camera"][-1]["refined, whole"]["max_mm"] <= 0.1


def test_the_robot_s_page_says_what_was_measured() -> None:
    page, motion = prose("robot.md"), Motion()
    for words in (
        f"sequences of {tracking.FRAMES} frames at {tracking.RATE_HZ:g} Hz",
        f"contacts of {min(tracking.SIZES_MM):g} to {max(tracking.SIZES_MM):g} mm",
        f"{camera.SIZE_PX[0]} x {camera.SIZE_PX[1]} px with a focal length of {camera.FOCAL_PX:g} px, from {camera.AWAY_MM:g} mm",
        f"tilted by up to {camera.MOST_TILT_DEG:g} degrees",
        f"texture within {camera.NEAR_MM:g} mm of the tag",
        f"up to {motion.speed_mm_s:g} mm/s and {motion.turn_deg_s:g} degrees/s",
        f"`p_tape` below {TOUCHES:g}",
    ):
        assert words in page, words


def test_the_page_of_applications_is_made_of_its_figures(examples: Any) -> None:
    common = examples("common")
    content = json.loads(common.FIGURES.read_text(encoding="utf-8"))
    assert set(content) == set(EXAMPLES)
    page = common.PAGE.read_text(encoding="utf-8")
    assert common.made_anew(page, content) == page, "run the scripts of docs/examples"
    for name, entry in content.items():
        assert page.count(f"<!-- {name} -->\n|") == 1
        assert all(row["trials"] >= 100 for row in entry["ways"])
        with_tape, *without = (row["success"] / row["trials"] for row in entry["ways"])
        assert with_tape >= 0.95 and max(without) < with_tape / 1.5


def test_the_page_of_applications_says_what_success_is(examples: Any) -> None:
    page = prose("applications.md")
    key, stick, bottles, posture = (examples(name) for name in ("key", "stick", "bottles", "posture"))
    assert 1.0 < posture.SETTLED_S < 1.5  # a little more than a second
    for words in (
        f"within {posture.LEVEL_DEG:g} degree of level from a little more than a second after the part was dropped",
        f"follows the tracker's angle, {posture.WRIST_DEG_S:g} degrees a second at most",
        f"the tip within {key.SIDE_MM:g} mm to either side, the blade within {key.ANGLE_DEG:g} degrees",
        f"the blade's tip is {key.TIP_MM:g} mm away",
        f"A stick of {2 * stick.RADIUS_MM:g} mm",
        f"its tip is {stick.TIP_MM:g} mm beyond the tape. Success: the tip within {stick.WITHIN_MM:g} mm",
        f"bottles of {2 * bottles.RADIUS_MM:g} mm",
        f"tries again {bottles.ASIDE_DEG:g} degrees further",
        f"its label within {bottles.WITHIN_DEG:g} degrees of the front",
    ):
        assert words in page, words


def test_every_application_runs(examples: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    common = examples("common")
    for name, value in (("FIGURES", tmp_path / "a.json"), ("PAGE", tmp_path / "a.md"), ("PICTURES", tmp_path)):
        monkeypatch.setattr(common, name, value)
    for name in EXAMPLES:
        examples(name).main(2)
        assert (tmp_path / f"application-{name}.png").read_bytes().startswith(b"\x89PNG")
    content = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert [content[name]["ways"][0]["success"] for name in EXAMPLES] == [2, 2, 2, 2]


def test_a_box_that_is_not_followed_hangs_as_it_was_gripped(examples: Any) -> None:
    posture = examples("posture")
    held = posture.run(None, np.random.default_rng(1), 0)
    assert held.error_deg == pytest.approx(abs(held.lean_deg[-1])) and not held.success
    tape = examples("common").tape_of(21, (60.0, 40.0))
    followed = posture.run(Tracker(Localizer([tape])), np.random.default_rng(1), 0)
    assert followed.lean_deg[0] == held.lean_deg[0] and followed.success
    assert posture.DROP_S <= followed.told_s[0] <= posture.DROP_S + 0.2
