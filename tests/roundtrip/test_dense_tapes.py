"""Denser tapes and other parts than the default: each goes through the whole chain, from the spec to located contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tactape_fab import Kit, Localizer, TapeSpec, make_kit
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Scene, simulate_frames
from tactape_fab.verify import verify_kit
from tests.roundtrip.kits import failed

FRAMES = 4
TAPES: dict[str, dict[str, Any]] = {
    "r0201 1.39": {"pitch_mm": 1.39, "displacement_mm": 0.20},
    "r0201 1.28 gang": {"pitch_mm": 1.28, "displacement_mm": 0.20, "coverlay": "gang"},
    "r01005 0.9": {"pitch_mm": 0.9, "displacement_mm": 0.15, "part": "r01005"},
    "r0402 1.83": {"pitch_mm": 1.83, "displacement_mm": 0.25, "part": "r0402"},
    "block 0.96": {"pitch_mm": 0.96, "displacement_mm": 0.16, "part": "block"},
    "block 1.06 of eight": {"pitch_mm": 1.06, "part": "block", "code": "touch-1", "directions": 8},
    "dome 0.95 of eight": {"pitch_mm": 0.95, "part": "dome", "body_mm": (0.4, 0.4, 0.18), "code": "touch-1", "directions": 8},
    "r0201 2.0 of eight": {"pitch_mm": 2.0, "displacement_mm": 0.35, "code": "touch-1", "directions": 8},
    "dome 0.9": {"pitch_mm": 0.9, "displacement_mm": 0.15, "part": "dome", "body_mm": (0.4, 0.4, 0.18)},
}
LESS_IMPRINTED = {"r01005 0.9": 0.07}
"""What is imprinted of a body of 0.13 mm, mm; of the others the default of a scene."""

LARGER_CONTACTS_MM = {"r0402 1.83": 11.0}
"""Contacts of tapes of so large a W, mm; 8 mm of the others."""

WITH_EVERY_READER = ("r01005 0.9", "block 0.96")


@pytest.fixture(scope="module", params=TAPES)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Kit]:
    name: str = request.param
    spec = TapeSpec(sector=7, name="t", tag="none", size_mm=(18.0, 16.0), **TAPES[name])
    return name, make_kit(spec, tmp_path_factory.mktemp("dense") / "kit")


def test_it_verifies(made: tuple[str, Kit]) -> None:
    """The closest of the films and of the textures with every reader, the others with those that `make` uses."""
    name, kit = made
    verification = verify_kit(kit.path, quick=name not in WITH_EVERY_READER)
    assert verification.passed, failed(verification)
    assert any("STL" in line.name for line in verification.checks)


@pytest.mark.parametrize("sensor", ["gelsight-mini", "digit"])
def test_its_contacts_are_located(made: tuple[str, Kit], sensor: str) -> None:
    name, kit = made
    contact_mm = LARGER_CONTACTS_MM.get(name, 8.0)
    scene = Scene(contact_mm=(contact_mm, contact_mm), texture_mm=LESS_IMPRINTED.get(name, Scene().texture_mm))
    frames = simulate_frames(kit.tape, FRAMES, 5, sensor, scene)
    localizer = Localizer([kit.tape], sensor=sensor)
    for depth, true_mm in zip(frames.depth, frames.position_mm, strict=True):
        fix = localizer.locate(depth)
        assert fix.located and fix.position_mm is not None, fix.reason
        assert np.hypot(*np.subtract(fix.position_mm, true_mm)) < kit.tape.pitch_mm / 10


def test_a_chip_that_no_line_is_known_to_place_is_said() -> None:
    for part, passed in (("r01005", False), ("r0201", True)):
        found = {f.rule: f for f in examine(TapeSpec(sector=7, size_mm=(24.0, 20.0), part=part, models=False)).findings}
        size = found["chip-size"]
        assert (size.passed, size.level, size.limit) == (passed, "warn", 0.6)
        assert ("ask generic-fpc whether they place it" in size.message) is not passed
        assert "0201 to 25 x 25 mm" in size.source
        assert not size.confirmed
