"""profiles confirm: what came back of a coupon moves or confirms limits, contradictions are refused, and the profile is one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.examine.coupon import TAPE_MM, examine_coupon
from tactape_fab.kit.profiles import load_fab
from tactape_fab.kit.profiles.confirm import Confirmed, Trial, confirm, read_trials

FABS = [name for name in profile_names("fabs") if load_fab(name).coverlay_modes != ("gang",)]
DATE, SOURCE = "2026-11-23", "coupon c: sectors as judged"


@pytest.fixture(scope="module")
def trials() -> tuple[Trial, ...]:
    return examine_coupon("jlcpcb-fpc").trials


def told(trials: tuple[Trial, ...], held: set[int], failed: set[int], place: Path) -> Confirmed:
    return confirm("jlcpcb-fpc", trials, held, failed, date=DATE, source=SOURCE, place=place)


@pytest.mark.parametrize("fab", ["jlcpcb-fpc", "pcbway-fpc", "generic-fr4", "generic-lpi"])
def test_a_coupon_is_a_small_panel_of_tapes_with_sectors_of_their_own(fab: str) -> None:
    made = examine_coupon(fab, 10)
    assert max(made.panel.size_mm) < 100.0 and {place.size_mm for place in made.panel.places} == {TAPE_MM}
    sectors = [tape.tape.sector for tape in made.tapes]
    assert sectors == [trial.sector for trial in made.trials] and len(set(sectors)) == len(sectors) and min(sectors) == 10
    limit_mm = load_fab(fab).limits["opening-bridge"].value_mm
    bridges = [trial for trial in made.trials if trial.tests == "opening-bridge"]
    assert {trial.value_mm for trial in bridges} >= {limit_mm, round(0.4 * limit_mm, 3)}
    for trial in bridges:  # the tape has the bridge that it tests
        assert trial.value_mm is not None
        assert trial.measured_mm["opening-bridge"] == pytest.approx(trial.value_mm, abs=0.003)
    assert {trial.tests for trial in made.trials} >= {"opening-bridge", "anchor-spur", "anchor-mesh"}


def test_the_narrowest_bridge_that_held_is_the_limit(trials: tuple[Trial, ...], tmp_path: Path) -> None:
    place = tmp_path / "mine.toml"
    found = told(trials, {0, 1, 4, 5, 6, 7, 8}, {2, 3}, place)
    place.write_text(found.text)
    fab, before = load_fab(str(place)), load_fab("jlcpcb-fpc")
    bridge = fab.limits["opening-bridge"]
    assert (bridge.value_mm, bridge.date, bridge.source, bridge.confirmed) == (0.35, DATE, SOURCE, True)
    assert fab.anchor.origin.confirmed and fab.coverlay_modes == before.coverlay_modes
    assert not fab.limits["pad-pad"].confirmed  # no tape was that narrow
    assert fab.limits["opening-size"] == before.limits["opening-size"]
    assert any("0.35 mm confirmed, 0.5 mm before" in line for line in found.lines)


@pytest.mark.parametrize("fab", FABS)
def test_a_coupon_that_came_back_whole_confirms_any_profile(fab: str, tmp_path: Path) -> None:
    place, trials = tmp_path / "mine.toml", examine_coupon(fab).trials  # on the narrowest tapes courtyards overlap
    found = confirm(fab, trials, {trial.sector for trial in trials}, (), date=DATE, source=SOURCE, place=place)
    place.write_text(found.text)
    limits = load_fab(str(place)).limits
    assert limits["opening-bridge"].value_mm == min(trial.value_mm or 1.0 for trial in trials)
    assert limits["courtyard"].confirmed and limits["courtyard"].value_mm == 0.0


def test_ways_that_failed_are_left_out(trials: tuple[Trial, ...], tmp_path: Path) -> None:
    place = tmp_path / "mine.toml"
    found = told(trials, {7, 8}, {0, 1, 2, 3, 4, 5, 6}, place)
    place.write_text(found.text)
    fab = load_fab(str(place))
    assert fab.coverlay_modes == ("gang",) and not fab.limits["opening-bridge"].confirmed and not fab.anchor.origin.confirmed
    assert sum("failed: do not order it" in line for line in found.lines) == 2
    assert load_fab("jlcpcb-fpc").coverlay_modes != fab.coverlay_modes


@pytest.mark.parametrize(
    ("held", "failed", "says"),
    [
        ({3}, {2}, "sector 3 with bridges of 0.1 mm held, but sector 2 with 0.2 mm failed"),
        ({0}, {0}, "both name sector 0"),
        ({99}, {0}, "held = 99 is no sector of the coupon"),
        (set(), {0, 1}, "no way to open the coverlay"),
        (set(), set(range(9)), "no way to open the coverlay"),
    ],
)
def test_what_cannot_be_is_refused(
    held: set[int], failed: set[int], says: str, trials: tuple[Trial, ...], tmp_path: Path
) -> None:
    with pytest.raises(SpecError, match=says):
        told(trials, held, failed, tmp_path / "mine.toml")


def test_any_title_and_file_name_make_a_profile_that_can_be_read(trials: tuple[Trial, ...], tmp_path: Path) -> None:
    mine, place = tmp_path / "\U0001f600.toml", tmp_path / "m\u00fc\U0001f600 2.toml"
    mine.write_text('extends = "jlcpcb-fpc"\ntitle = "\U0001f600 \u00e4"\n', encoding="utf-8")
    found = confirm(str(mine), trials, {0, 1, 7, 8}, {2, 3}, date=DATE, source=SOURCE, place=place)
    place.write_text(found.text, encoding="utf-8")
    fab = load_fab(str(place))
    assert (fab.name, fab.title) == ("m\u00fc\U0001f600 2", "\U0001f600 \u00e4, confirmed")


def test_a_profile_that_is_not_there_is_said_to_be_the_coupons(trials: tuple[Trial, ...], tmp_path: Path) -> None:
    with pytest.raises(
        SpecError, match=r"COUPON is of the fab profile gone\.toml, which is not there; run profiles confirm in the"
    ):
        confirm("gone.toml", trials, {0}, set(), date=DATE, source=SOURCE, place=tmp_path / "mine.toml")


@pytest.mark.parametrize(
    "content", [{}, {"coupon": 3}, {"coupon": {"fab": "x", "trials": [{"sector": -1}]}}, {"coupon": {"trials": 5}}]
)
def test_what_is_no_coupon_is_refused(content: dict[str, Any]) -> None:
    with pytest.raises(SpecError):
        read_trials(content)
    with pytest.raises(SpecError, match=r"^COUPON is 'tactape-s007', no coupon; give the folder that tactape-fab coupon wrote$"):
        read_trials({"name": "tactape-s007"})


def test_trials_are_read_as_they_were_written(trials: tuple[Trial, ...]) -> None:
    assert read_trials({"coupon": {"fab": "jlcpcb-fpc", "trials": [t.to_mapping() for t in trials]}}) == ("jlcpcb-fpc", trials)
