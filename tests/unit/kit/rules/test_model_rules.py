"""Rules of printing and milling: measured values recounted by shapes, and remedies typed back, which just meet the limit."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from math import nextafter
from typing import Any

import pytest
import shapely

from tactape_fab import Tape
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.plan import TOLERANCE_MM
from tactape_fab.kit.profiles import ProcessProfile, load_process
from tactape_fab.kit.rules import process_rules
from tactape_fab.kit.rules.process_rules import check_models, check_texture
from tactape_fab.kit.rules.remedies import GAPS
from tactape_fab.solids.forms import SolidForm
from tests.property.test_remedies import alternatives, blocking, findings, try_back, typed
from tests.tapes import tape_at
from tests.unit.kit.rules.test_process_rules import board_of, by_rule, foot, spec_of

COMMANDS = (
    "--part block --process fdm",
    "--part block --process fdm --rotation 0 --body 0.7x0.2x0.5",
    "--part cone --process fdm --base 0.3",
    "--part cone --process cnc --negative",
    "--part dome --process fdm --w 1",
    "--part dome --process cnc --body 0.4x0.05",
    "--part dome --process fdm --body 0.5x0.3 --dome-top 0.2",
    "--part block --process sla --w 1 --delta 0.15",
    "--part dome --process fdm --hole 7,5,2",
    "--process fdm",
    "--process fdm --part r01005 --w 1",
)
MODELS = ("feature", "gap", "height", "base")


def test_the_remedy_of_a_film_is_for_its_coverlay() -> None:
    """The W that is named keeps every rule of the fab that blocks, too, and is smaller where there are no bridges to keep."""
    pitches_mm = {}
    for mode in ("per-part", "gang"):
        command = f"--sector 7 --size 20x14 --process sla --coverlay {mode} --rotation 0 --w 1"
        (way,) = (way for way in alternatives(str(findings(command)[1]["gap"]["message"])) if "--w" in way)
        rows = findings(typed(command, way))[1]
        assert blocking(rows).isdisjoint(GAPS)
        pitches_mm[mode] = float(way.split()[2])
        if mode == "per-part":
            assert rows["opening-bridge"]["value"] == pytest.approx(rows["opening-bridge"]["limit"], abs=0.0015)
    assert pitches_mm["gang"] < pitches_mm["per-part"]


@pytest.mark.parametrize("body_mm", [(0.7, 0.2, 0.5), (0.2, 0.7, 0.1), (0.3, 0.3, 0.3)])
def test_no_side_of_an_element_becomes_smaller(body_mm: tuple[float, float, float]) -> None:
    words = "x".join(map(str, body_mm))
    rows = broken(f"--sector 7 --size 20x14 --part block --process fdm --rotation 0 --w 3 --body {words}")
    assert rows
    for rule, row in rows.items():
        found = re.search(r"--body ([\d.]+)x([\d.]+)x([\d.]+)", str(row["message"]))
        assert found is not None
        least = (0.6, 0.6, 0.0) if rule == "feature" else (0.0, 0.0, 0.4)
        assert tuple(map(float, found.groups())) == tuple(map(max, zip(body_mm, least, strict=True)))


def broken(command: str) -> dict[str, dict[str, Any]]:
    return {rule: row for rule, row in findings(command)[1].items() if rule in MODELS and not row["passed"]}


@pytest.mark.parametrize("words", COMMANDS)
def test_remedies_typed_back_meet_the_limit_and_no_more(words: str) -> None:
    command = f"--sector 7 --size 20x14 {words}"
    assert findings(command)[1] and list(try_back(command, Counter())) == []
    for rule, row in broken(command).items():
        ways = list(alternatives(str(row["message"])))
        assert ways
        for way in ways:
            if "process" in way:
                continue
            value, limit = (findings(typed(command, way))[1][rule][key] for key in ("value", "limit"))
            assert value == pytest.approx(limit, abs=0.0015), way


@pytest.mark.parametrize("words", COMMANDS)
def test_every_process_that_makes_it_as_it_is_is_named(words: str) -> None:
    command = f"--sector 7 --size 20x14 {words}"
    own = words.partition("--process ")[2].split()[0]
    for rule, row in broken(command).items():
        named = set(re.findall(r"--process ([a-z]+)", str(row["message"])))
        others = set() if "--hole" in words else set(profile_names("processes")) - {own}
        makes = {name for name in others if findings(command.replace(f"--process {own}", f"--process {name}"))[1][rule]["passed"]}
        assert named == makes, rule


def limited(rule: str, value_mm: float, warn_mm: float | None = None) -> ProcessProfile:
    """SLA with another limit."""
    process = load_process("sla")
    limit = replace(process.limits[rule], value_mm=value_mm, warn_mm=warn_mm)
    return replace(process, limits={**process.limits, rule: limit})


def test_what_no_process_makes_is_made_without_one() -> None:
    tape, spec, part = (examined := examine(spec_of())).tape, examined.spec, examined.profiles.part
    found = by_rule(check_models(tape, SolidForm(base_mm=1e-3), limited("base", 9.0), spec, part))
    assert found["base"].message.endswith("; use --base 9")
    found = by_rule(check_models(tape, SolidForm(), limited("feature", 9.0), spec.with_values(holes_mm=((1.0, 1.0, 0.5),)), part))
    assert found["feature"].message.endswith("; leave out --process") and found["feature"].limit == 9.0
    block = (examined := examine(spec_of(part="block"))).spec.with_values(holes_mm=((1.0, 1.0, 0.5),))
    found = by_rule(check_models(examined.tape, SolidForm(), limited("feature", 99.0), block, examined.profiles.part))
    assert found["feature"].message.endswith("; leave out --process") and "--body" not in found["feature"].message


@pytest.mark.parametrize("name", ["block", "dome"])
def test_a_process_is_named_where_its_own_check_passes(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Down to the last bit at its limit, and where it only warns it is not."""
    examined = examine(spec_of(part=name))
    tape, spec, part = examined.tape, examined.spec, examined.profiles.part
    height_mm = tape.part.body_mm[2]
    just_mm = height_mm + TOLERANCE_MM
    while just_mm - TOLERANCE_MM > height_mm:
        just_mm = nextafter(just_mm, 0.0)
    assert just_mm - TOLERANCE_MM == height_mm
    for value_mm, warn_mm, makes in (
        (height_mm, None, True),
        (just_mm, None, True),
        (just_mm + 1e-9, None, False),
        (0.1, just_mm, True),
        (0.1, height_mm + 0.01, False),
    ):
        other = replace(limited("height", value_mm, warn_mm), name="other")
        assert by_rule(check_models(tape, SolidForm(), other, spec, part))["height"].passed is makes
        monkeypatch.setattr(process_rules, "load_process", lambda _, other=other: other)
        found = by_rule(check_models(tape, SolidForm(), limited("height", 2.0), spec, part))["height"]
        assert ("--process other" in found.message) is makes


@pytest.mark.parametrize(("value_mm", "warn_mm"), [(0.9, None), (0.2, 0.9)])
def test_a_wider_element_stands_so_far_apart_that_no_gap_is_warned_of(value_mm: float, warn_mm: float | None) -> None:
    process = limited("gap", value_mm, warn_mm)
    examined = examine(spec_of(part="block", size_mm=(30.0, 20.0), rotation_deg=0.0))
    width_mm = examined.tape.part.body_mm[1] + 0.2
    process = replace(
        process, limits={**process.limits, "feature": replace(process.limits["feature"], value_mm=width_mm, warn_mm=None)}
    )
    found = by_rule(check_models(examined.tape, SolidForm(), process, examined.spec, examined.profiles.part))["feature"]
    (way,) = (way for way in alternatives(found.message) if "--body" in way)
    rows = findings(typed("--sector 7 --size 30x20 --part block --rotation 0 --process sla", way))[1]
    assert rows["feature"]["value"] == pytest.approx(width_mm)
    assert rows["gap"]["value"] == pytest.approx(0.9, abs=0.0015)


@pytest.mark.parametrize("body", ["0.4x0.05", "1.2x0.05"])
def test_a_cap_that_must_be_higher_is_as_wide_as_its_height_asks_for(body: str) -> None:
    """No cap is higher than its radius, and none is made wider than it need be."""
    message = str(broken(f"--sector 7 --size 30x20 --w 3 --part dome --process fdm --body {body}")["height"]["message"])
    found = re.search(r"--body ([\d.]+)x([\d.]+)", message)
    assert found is not None
    width_mm, height_mm = map(float, found.groups())
    assert height_mm == 0.4
    assert width_mm == 1.2 if body.startswith("1.2") else 2.0 * height_mm < width_mm < 2.5 * height_mm


def nearest_mm(tape: Tape, rotation_deg: float) -> float:
    """Least distance of an element's foot to the outline of its base."""
    examined = examine(spec_of(part=tape.part.name, rotation_deg=rotation_deg))
    shape = foot(examined.profiles.part, rotation_deg)  # type: ignore[arg-type]
    outline = board_of(tape).exterior
    return float(min(shapely.affinity.translate(shape, x, y).distance(outline) for x, y in tape.part_xy_mm()))


@pytest.mark.parametrize("name", ["block", "dome", "cone"])
def test_the_place_nearest_to_the_outline_is_measured(name: str) -> None:
    examined = examine(spec_of(part=name))
    found = by_rule(examined.findings)["body-edge"]
    assert found.value == pytest.approx(nearest_mm(examined.tape, examined.spec.rotation_deg), abs=2e-5)
    assert found.passed and found.message.startswith("element to outline ")
    strict = limited("body-edge", 3.0)
    assert examined.spec.form is not None
    far = by_rule(check_texture(examined.tape, examined.spec.form, strict, examined.spec, examined.profiles.part))["body-edge"]
    assert far.blocks and far.value == found.value and far.message.endswith("; use a larger --size")


def test_rules_of_holes_are_those_of_holes() -> None:
    rules = by_rule(examine(spec_of(part="dome")).findings).keys()
    assert rules == {*MODELS, "body-edge", "mark"}
    assert by_rule(examine(spec_of(part="dome", mark=False)).findings).keys() == rules - {"mark"}
    assert by_rule(examine(spec_of(part="dome", holes_mm=[(7.0, 5.0, 1.0)])).findings).keys() >= {*rules, "hole-part"}


def test_the_back_says_its_sector_or_that_it_has_no_place() -> None:
    found = by_rule(examine(spec_of(part="dome")).findings)["mark"]
    assert found.level == "info" and found.passed and found.message.startswith("sector 7 and an arrow to board +y, strokes ")
    none = by_rule(examine(spec_of(part="dome", sector=200, size_mm=(8.0, 8.0))).findings)["mark"]
    assert none.level == "info" and not none.passed and none.message.endswith("write the sector on it by hand")


def test_one_element_has_no_gap() -> None:
    examined = examine(spec_of(part="block"))
    part = examined.profiles.part

    def rules(grid: tuple[int, int]) -> set[str]:
        return set(by_rule(check_models(tape_at(7, grid), SolidForm(), load_process("sla"), examined.spec, part)))

    assert rules((1, 1)) == {*MODELS} - {"gap"}
    assert rules((2, 1)) == {*MODELS}


def test_the_order_of_rules_is_that_of_the_table() -> None:
    for negative in (False, True):
        examined = examine(spec_of(part="block", negative=negative))
        names = [f.rule for f in examined.findings if f.rule in MODELS]
        assert names == list(MODELS)
        said = by_rule(examined.findings)["height"].message
        assert said.startswith("depth of a cavity" if negative else "height of an element")
