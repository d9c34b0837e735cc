"""Touch tapes in a decoder: alone, among tapes of other codes, and against what is none of them."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tactape_fab import Localizer, Prior, Tape, TapeSpec
from tactape_fab.base.errors import SpecError
from tactape_fab.cli import main
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Scene, draw_poses, simulate
from tactape_fab.sense.decode.search.hypotheses import distinct
from tactape_fab.texture.code import TOUCH_CODE
from tactape_fab.texture.touch.design import design
from tactape_fab.verify.symbols import check_symbols
from tactape_fab.verify.trip.misplaced import explain

SIZE = {"size_mm": (60.0, 30.0), "models": False, "tag": "none"}
SCENE = Scene(contact_mm=(8.0, 8.0))


@cache
def touch(sector: int) -> Tape:
    return examine(TapeSpec(sector=sector, code=TOUCH_CODE, **SIZE)).tape  # type: ignore[arg-type]


@cache
def plane(sector: int) -> Tape:
    return examine(TapeSpec(sector=sector, **SIZE)).tape  # type: ignore[arg-type]


def contacts(tape: Tape, count: int, seed: int, scene: Scene = SCENE) -> list[tuple[np.ndarray, np.ndarray]]:
    poses = draw_poses(tape, count, seed, scene=scene)
    return [(pose, simulate(tape, tuple(pose[:2]), pose[2], scene=scene, seed=seed + k)) for k, pose in enumerate(poses)]


@pytest.mark.parametrize("world", ["open", "closed"])
def test_a_registry_may_mix_codes(world: str) -> None:
    tapes = [touch(1), plane(7), touch(2)]
    localizer = Localizer(tapes, world=world)  # type: ignore[arg-type]
    located = 0
    for tape in tapes:
        for pose, depth in contacts(tape, 8, 3):
            fix = localizer.locate(depth)
            if fix.located:
                located += 1
                assert (fix.tape, fix.sector) == (tape.name, tape.sector)
                assert fix.position_mm is not None and np.hypot(*(np.array(fix.position_mm) - pose[:2])) < 0.1
                assert fix.cell is not None and fix.index == tuple(np.add(fix.cell, tape.origin))
    assert located >= 23


def test_smaller_contacts_are_located_than_with_a_code_that_has_a_plane() -> None:
    scene = Scene(contact_mm=(7.0, 7.0))
    counts = [
        sum(Localizer([tape]).locate(depth).located for _, depth in contacts(tape, 40, 5, scene)) for tape in (touch(1), plane(7))
    ]
    assert counts[0] >= 38 and counts[0] >= counts[1]


def test_a_prior_helps() -> None:
    scene, tape = Scene(contact_mm=(5.5, 5.5)), touch(1)
    localizer, alone, near = Localizer([tape]), 0, 0
    for pose, depth in contacts(tape, 30, 9, scene):
        alone += localizer.locate(depth).located
        fix = localizer.locate(depth, prior=Prior(position_mm=(float(pose[0]), float(pose[1])), theta_deg=float(pose[2])))
        near += fix.located
        assert not fix.located or np.hypot(*(np.array(fix.position_mm) - pose[:2])) < 0.5
    assert near > alone


@pytest.mark.parametrize("world", ["open", "closed"])
def test_what_is_no_registered_tape_is_not_located(world: str) -> None:
    localizer = Localizer([touch(1)], world=world)  # type: ignore[arg-type]
    for other in (touch(2), touch(3), plane(7)):
        for _, depth in contacts(other, 10, 11):
            assert not localizer.locate(depth).located
    for _, depth in contacts(touch(1), 10, 13, replace(SCENE, mirrored_tape=True)):
        fix = localizer.locate(depth)
        assert not fix.located and "mirrored" in str(fix.reason)


def test_equal_designs_are_one_tape_and_others_of_the_sector_are_not() -> None:
    tape = touch(1)
    holed = replace(tape, name="holed", omitted=np.array([[0, 0]]))
    other = replace(tape, name="other", symbols=np.array(design(1, tape.symbols.shape, [tape.symbols])))
    kept = distinct([holed, tape, other])
    assert [t.name for t in kept] == ["holed", "other"] and kept[0].placed.all()


def test_evidence_against_a_random_matrix_has_mean_one() -> None:
    """The mean that the bound rests on: over all places of many matrices, of soft symbols whatever they are."""
    rng = np.random.default_rng(0)
    said = []
    q = rng.uniform(0.2, 0.8, (8, 2))  # of eight dots, for each bit that it is 1
    for seed in range(40):
        matrix = design(seed, (16, 16))
        for r, c in np.ndindex(13, 13):
            bits = matrix[r : r + 4, c : c + 2].ravel()
            of = np.stack([bits % 2, bits // 2], axis=1)
            said.append(np.prod(2 * np.where(of == 1, q, 1 - q)))
    assert np.mean(said) == pytest.approx(1.0, abs=4 * np.std(said) / np.sqrt(len(said)))


# What knows planes only


def test_what_needs_a_plane_is_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="plane, which 'touch-1' or 'touch-2' has not; use method='ml', or tapes of another code"):
        Localizer([touch(1)], method="paper")
    with pytest.raises(SpecError, match="'touch-1' has no code plane"):
        Localizer.from_code(TOUCH_CODE, 1.5, 0.25)
    np.save(tmp_path / "f.npy", np.zeros((240, 320), dtype=np.float32))
    for command, said in (
        (["decode", str(tmp_path / "f.npy"), "--code", "touch-1"], "name the tape's kit with --tape"),
        (["certify", "--code", "touch-1"], "each is designed; name their kits"),
        (["check", "--sector", "1", "--code", "touch-1", "--size", "30x20", "--origin", "best"], "leave --origin out"),
    ):
        result = CliRunner().invoke(main, command)
        assert result.exit_code == 2 and said in result.stderr, result.stderr


# Verification


def test_parts_that_show_another_symbol_are_found() -> None:
    tape, xy_mm = touch(1), touch(1).part_xy_mm()
    assert all(check.passed for check in check_symbols(tape, xy_mm, "CPL"))
    other = replace(
        tape,
        symbols=np.where(
            np.arange(tape.symbols.size).reshape(tape.symbols.shape) == 77, (tape.symbols + 1) % 4, tape.symbols
        ).astype(np.uint8),
    )
    symbols, windows = check_symbols(tape, other.part_xy_mm(), "CPL")
    assert not symbols.passed and "1 symbols differ" in symbols.message
    assert not windows.passed and "windows are not the matrix's" in windows.message


@pytest.mark.parametrize(
    ("moved", "said"),
    [
        (lambda xy: xy * (-1.0, 1.0) + (60.0, 0.0), "mirrored left to right"),
        (lambda xy: (xy - 15.0) @ np.array([(0.0, 1.0), (-1.0, 0.0)]) + 15.0, "turned by 90 deg"),
        (lambda xy: np.add(xy, (1.5, 0.0)), r"shifted by \(\+1.500, \+0.000\) mm"),
    ],
)
def test_misplaced_parts_are_explained(moved: object, said: str) -> None:
    tape = touch(1)
    found = explain(tape, moved(tape.part_xy_mm()))  # type: ignore[operator]
    assert found is not None
    assert re.search(said, found), found
