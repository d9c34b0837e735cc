"""Coupons of fab profiles that a user wrote: small panels, and names that no tape may have."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.kit.examine.coupon import examine_coupon
from tests.thorough import slow


def profile(folder: Path, name: str, largest_mm: float = 250.0) -> str:
    place = folder / "mine.toml"
    panel = f"[panel]\nsmallest_mm = [20, 20]\nlargest_mm = [{largest_mm:g}, {largest_mm:g}]\n"
    text = f'extends = "jlcpcb-fpc"\nname = {json.dumps(name, ensure_ascii=False)}\n{panel}'
    place.write_text(text, encoding="utf-8")
    return str(place)


@slow
def test_tapes_without_room_on_the_largest_panel_are_named(tmp_path: Path) -> None:
    made = examine_coupon(profile(tmp_path, "small", 80.0))
    assert len(made.tapes) == len(made.trials) == 4
    assert made.remarks == (
        "warning: 80 x 80 mm, the largest panel of small, holds 4 of 9 tapes; not on it: opening-bridge 0.5 mm, anchor-spur, "
        "anchor-mesh, gang, gang",
    )
    assert examine_coupon("jlcpcb-fpc").remarks == ()


def test_a_panel_that_holds_no_tape_is_the_fabs(tmp_path: Path) -> None:
    with pytest.raises(
        SpecError, match="fab = 'tiny' takes panels of up to 30 x 30 mm, whose rails leave no room for a tape of 24"
    ):
        examine_coupon(profile(tmp_path, "tiny", 30.0))


@pytest.mark.parametrize(
    ("fab", "name"),
    [
        ("\u00c4 fab", "fab-coupon"),
        ("\u6df1\u5733", "coupon"),
        ('O\'Neil "Flex"', "O-Neil-Flex-coupon"),
        ("x" * 60, "x" * 50 + "-coupon"),
    ],
)
def test_any_fab_has_a_coupon_by_default(fab: str, name: str, tmp_path: Path) -> None:
    assert examine_coupon(profile(tmp_path, fab)).name == name


def test_a_broken_rule_has_the_figure_of_its_worst_tape() -> None:
    made = examine_coupon("generic-fpc")
    of_tapes = [f for tape in made.tapes for f in tape.findings if f.rule == "opening-bridge"]
    (said,) = [f for f in made.findings if f.rule == "opening-bridge"]
    assert sum(not f.passed for f in of_tapes) > 1
    assert not said.passed and said.value == min(f.value for f in of_tapes if f.value is not None)


def test_no_finding_of_a_coupon_names_an_option_that_it_does_not_have() -> None:
    made = examine_coupon("generic-fpc")
    assert [f.message for tape in made.tapes for f in tape.findings if "use --" in f.message]
    assert not [f.message for f in made.findings if "--" in f.message]


def test_limits_that_no_tape_of_the_coupon_keeps_are_the_fabs(tmp_path: Path) -> None:
    path = Path(profile(tmp_path, "broad"))
    limit = 'value_mm = 9\nlevel = "block"\nsource = "s"\ndate = "2026-01-01"\nconfirmed = false\n'
    path.write_text(f"{path.read_text()}\n[limits.body-edge]\n{limit}")
    with pytest.raises(SpecError, match=r"of 24 x 24 mm keeps: .*; order a tape without a coupon$") as refusal:
        examine_coupon(str(path))
    assert "use --" not in str(refusal.value)
