"""make --order: what it chooses is legal as typed, holds its pads as well as can be, and locates what was asked for."""

from __future__ import annotations

from typing import Any

import pytest

from tactape_fab.advise.order import DEFAULT_CONTACT_MM, choose_order
from tactape_fab.base.errors import SpecError
from tactape_fab.kit.examine.order import examine_order
from tactape_fab.kit.examine.tape import Examined
from tests.thorough import costly, slow

HOLDS = ("mesh", "spur", "none", "gang")


def broken(values: dict[str, Any]) -> list[str]:
    """Rules that the order as chosen breaks."""
    examined, _ = examine_order({"sector": 7, "models": False, **values})
    return [finding.rule for finding in examined.findings if finding.blocks]


@costly
@pytest.mark.parametrize("house", ["jlcpcb", "pcbway", "generic", "jlcpcb-fr4", "generic-lpi"])
def test_the_choice_is_legal_and_reaches_the_contact(house: str) -> None:
    chosen = choose_order({"sector": 7}, house)
    assert chosen.values["fab"].startswith(house)
    assert not broken(chosen.values)
    assert chosen.candidate.least_mm <= (DEFAULT_CONTACT_MM[0] * DEFAULT_CONTACT_MM[1]) ** 0.5
    assert not any("warning" in remark for remark in chosen.remarks)


def test_the_commonest_house_gets_a_tape_that_holds_its_pads() -> None:
    chosen = choose_order({"sector": 7}, "jlcpcb")
    assert chosen.candidate.holds == "mesh" and chosen.values["coverlay"] == "per-part"
    assert chosen.values["part_number"] == "C473473"
    assert any("holding the pads costs" in remark and "one opening for all parts" in remark for remark in chosen.remarks)


@slow
def test_a_smaller_contact_costs_the_hold_of_the_pads() -> None:
    """The smaller the contact, the worse the pads are held, down to where no tape of the house does."""
    found = [choose_order({"sector": 7}, "jlcpcb", side_mm) for side_mm in (12, 9.5, 7, 3)]
    ranks = [HOLDS.index(chosen.candidate.holds) for chosen in found]
    assert ranks == sorted(ranks) and ranks[0] == 0 and ranks[2] == 3
    assert all(chosen.candidate.least_mm <= side for chosen, side in zip(found, (12, 9.5, 7), strict=False))
    assert any("no tape that jlcpcb-fpc makes locates a contact of 3 mm" in remark for remark in found[3].remarks)


def test_what_is_given_is_named_where_it_is_why_a_contact_is_not_located() -> None:
    said = " ".join(choose_order({"sector": 7, "pitch_mm": 3.0}, "jlcpcb").remarks)
    assert "makes with what is given locates a contact of 9.95 mm by this prediction; leave out --w" in said


@costly
@pytest.mark.parametrize(
    "given",
    [
        {"pitch_mm": 2.3},
        {"pitch_mm": 2.345},
        {"displacement_mm": 0.3},
        {"pitch_mm": 2.4, "displacement_mm": 0.3},
        {"anchor": "spur"},
        {"coverlay": "gang"},
        {"part_number": "C1"},
        {"assembly": "eurocircuits"},
        {"rotation_deg": -135.0},
    ],
)
def test_what_is_given_stays(given: dict[str, Any]) -> None:
    chosen = choose_order({"sector": 7, **given}, "jlcpcb")
    assert {key: chosen.values[key] for key in given} == given
    assert not broken(chosen.values)


def test_w_that_is_given_is_not_widened_to_what_is_legal() -> None:
    assert choose_order({"sector": 7, "pitch_mm": 1.0}, "jlcpcb-fr4").values["pitch_mm"] == 1.0


@pytest.mark.parametrize(
    ("values", "house", "contact", "says"),
    [
        ({}, "jlpcb", None, "did you mean 'jlcpcb'"),
        ({}, "acme", None, "order = 'acme' is none of: generic, jlcpcb, pcbway"),
        ({"fab": "pcbway-fpc"}, "jlcpcb", None, "leave out --fab"),
        ({"part": "dome"}, "jlcpcb", None, "leave out --order"),
        ({"pitch_mm": 0.7}, "jlcpcb", None, "no tape is legal with what is given; leave out --w$"),
        ({"rotation_deg": 30.0}, "jlcpcb", None, "rotation_deg = 30 deg contradicts --order"),
        ({"code": "touch-1", "directions": 8}, "jlcpcb-fr4", None, "directions = 8 contradicts --order"),
        ({"directions": [8]}, "jlcpcb-fr4", None, r"directions = \[8\] is neither 4 nor 8"),
        ({"pitch_mm": -1}, "jlcpcb", None, "pitch_mm = -1"),
        ({}, "jlcpcb", [0, 5], "contact = '0x5' is no size"),
        ({}, "jlcpcb", [4, 5, 6], "contact = '4x5x6' is no size"),
        ({}, "jlcpcb", ["a"], "contact = 'a' is no size"),
        ({}, "jlcpcb", float("nan"), "contact = 'nan' is no size"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_a_way_out(values: dict[str, Any], house: str, contact: Any, says: str) -> None:
    with pytest.raises(SpecError, match=says):
        choose_order(values, house, contact)


def test_the_same_without_a_search() -> None:
    """The last remark types the choice out; typed, it is the same order."""
    chosen = choose_order({"sector": 7}, "pcbway")
    words = chosen.remarks[-1].partition("search: ")[2].split()
    keys = {"--fab": "fab", "--w": "pitch_mm", "--delta": "displacement_mm", "--coverlay": "coverlay", "--anchor": "anchor"}
    keys |= {"--part-number": "part_number"}
    typed = {keys[option]: value for option, value in zip(words[::2], words[1::2], strict=True)}
    assert typed == {key: str(chosen.values[key]) for key in typed}
    examined, _ = examine_order({"sector": 7, "models": False, **chosen.values})
    assert isinstance(examined, Examined)
