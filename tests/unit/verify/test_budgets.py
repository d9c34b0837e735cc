"""Budgets of a kit's files: three times what this tool writes, whatever the kit, and none that a few parts can make large."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tactape_fab import Kit, PanelKit, Tape, TapeSpec, make_kit
from tactape_fab.verify import verify_kit
from tactape_fab.verify.budgets import BUDGETS, OTHERS, WHOLE_KIT, count_of, most_bytes
from tests.roundtrip.kits import failed
from tests.tapes import tape_at

SPECS = {
    "film with models": {"size_mm": (34.0, 24.0), "holes_mm": ((20.0, 12.0, 2.0),)},
    "domes round a cylinder": {"size_mm": (34.0, 24.0), "part": "dome", "process": "sla", "cylinder_mm": 6.0, "shell": "whole"},
    "a mould": {"size_mm": (20.0, 20.0), "part": "block", "tag": "none", "negative": True},
}


@pytest.mark.parametrize("values", SPECS.values(), ids=SPECS.keys())
def test_a_budget_is_three_times_what_is_written(values: dict[str, object], tmp_path: Path) -> None:
    kit = make_kit(TapeSpec.from_mapping({"sector": 9, **values}), tmp_path / "kit", verify=False)
    count = count_of(kit.tape)
    sizes = {role: (kit.path / path).stat().st_size for role, path in kit.files.items()}
    assert {role: size for role, size in sizes.items() if 3 * size > most_bytes(role, count)} == {}
    assert 3 * sum(sizes.values()) < most_bytes(WHOLE_KIT, count)
    each = {role: (size - BUDGETS[role][0] / 3) / count for role, size in sizes.items() if role in BUDGETS}
    assert {role: size for role, size in each.items() if 3 * size > BUDGETS[role][1]} == {}  # of a large kit, too


@pytest.mark.parametrize("role", [*BUDGETS, "a role of another version"])
def test_no_file_of_a_kit_of_few_parts_may_be_large(role: str) -> None:
    assert most_bytes(role, 100) < 1 << 28
    assert most_bytes(role, 10**9, embossed=True) <= 1 << 30


def test_a_budget_grows_with_the_parts_and_with_the_user_s_own_part_up_to_the_largest_file() -> None:
    for role in (*BUDGETS, "a role of another version"):
        base, each = BUDGETS.get(role, OTHERS)
        own = 512 << 20 if role in ("stl", "3mf", "step-solid", WHOLE_KIT) else 0
        for count in (0, 1, 1000, 10**9):
            assert most_bytes(role, count) == min(base + each * count, 1 << 30)
            assert most_bytes(role, count, embossed=True) == min(base + each * count + own, 1 << 30)


def test_parts_and_holes_of_all_tapes_count() -> None:
    one = tape_at(7, (6, 5))
    holed = replace(one, omitted=np.array([[2, 3]]), board=replace(one.board, holes=((1.0, 1.0, 0.5), (2.0, 2.0, 0.5))))
    assert (count_of(), count_of(one), count_of(one, holed)) == (0, 30, 61)


def test_a_file_beyond_its_budget_is_not_read(flat_kit: Kit, copied: Callable[[Kit | PanelKit], Path]) -> None:
    folder = copied(flat_kit)
    place = folder / flat_kit.files["cpl"]
    most = most_bytes("cpl", count_of(Tape.load(folder / "manifest.json")))
    with place.open("r+b") as stream:
        stream.truncate(most + 1)
    assert f"has more than {most} bytes" in failed(verify_kit(folder, quick=True))["files"].message
