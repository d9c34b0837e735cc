"""Whether a tape can be made is decided in one place, in one pass: whoever asks hears the same."""

from __future__ import annotations

import math
import pickle
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from tactape_fab import TapeSpec
from tactape_fab.advise.designs import rules_of, usual_design
from tactape_fab.base.errors import CapacityError, Problem, ReachProblem, SpecError, refusal
from tactape_fab.cli import main
from tactape_fab.kit.examine.order import examine_order
from tactape_fab.kit.examine.tape import Examined, examine, rules_of_parts
from tactape_fab.kit.profiles import load_fab
from tactape_fab.texture.touch import designed
from tests.thorough import slow, some

FITTING: dict[str, Any] = {"sector": 7, "size_mm": [100.0, 80.0], "models": False}
"""A tape that fits on a panel of its own."""


def refusal_of(values: dict[str, Any], **how: Any) -> SpecError:
    with pytest.raises(SpecError) as caught:
        examine(values, **how)
    return caught.value


# Whoever asks hears the same


def toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"'{value}'" if isinstance(value, str) else str(value)


COMMANDS = ("make one.toml", "check one.toml", "make list.toml", "make one.toml --panel 1x1", "check one.toml --panel 1x1")
REFUSED: list[dict[str, Any]] = [
    {"sector": 300},
    {"pitch_mm": math.nan, "tag": "round", "holes_mm": [[200.0, 10.0, 1.0]]},
    {"displacement_mm": 0.7},
    {"displacement_mm": 0.7, "name": "a/b", "coverlay": "lpi"},
    {"fab": "nowhere.toml", "displacement_mm": 0.5, "coverlay": "per-part"},
    {"corner_radius_mm": 3.0, "part_number": "C1", "assembly": "jlcpcb", "colour": "red"},
    {"origin": [3370, 0], "anchor": "mesh", "rotation_deg": 0.0},
    {"models": True, "cylinder_mm": 1.0, "stiffener": "FR4:0.33"},
    {"code": "qr", "directions": 8, "tag_id": 600},
    {"holes_mm": [[50.0, 0.7, 1.0]], "bend_axis": "x"},
]


@pytest.mark.parametrize("values", REFUSED, ids=str)
def test_make_check_lists_and_panels_refuse_the_same_in_the_same_words(values: dict[str, Any], here: Path) -> None:
    lines = "".join(f"{key} = {toml(value)}\n" for key, value in {**FITTING, **values}.items())
    (here / "one.toml").write_text(lines)
    (here / "list.toml").write_text("[[tapes]]\n" + lines)
    said = {}
    for command in COMMANDS:
        result = CliRunner().invoke(main, command.split())
        assert result.exit_code in (2, 3), result.output
        errors = (line for line in result.stderr.splitlines() if line.startswith("error: "))
        said[command] = result.exit_code, sorted(line.replace("tapes[0]: ", "") for line in errors)
    assert said["check one.toml"][1]
    assert {command: answer for command, answer in said.items() if answer != said["check one.toml"]} == {}


def test_a_panel_of_one_is_examined_as_its_tape_is() -> None:
    panel, _ = examine_order({**FITTING, "fab": "jlcpcb-fpc", "panel": "1x1"})
    alone = examine({**FITTING, "fab": "jlcpcb-fpc"})
    assert not isinstance(panel, Examined)
    (tape,) = panel.tapes
    assert (tape.spec, tape.findings) == (alone.spec, alone.findings)


@pytest.mark.parametrize(("size_mm", "pitch_mm"), [((30.0, 20.0), 1.5), ((30.0, 20.0), 1.0), ((5.0, 5.0), 1.5)])
def test_advise_hears_what_make_hears(size_mm: tuple[float, float], pitch_mm: float) -> None:
    design = usual_design(load_fab("generic-fpc"))
    object.__setattr__(design, "pitch_mm", pitch_mm)
    values = {"sector": 7, "size_mm": size_mm, "tag": "none", "pitch_mm": pitch_mm, "displacement_mm": design.displacement_mm}
    values |= {"fab": design.fab, "coverlay": design.coverlay}
    broken = rules_of(design, size_mm)
    if broken is None:
        assert refusal_of(values).problems
    else:
        found = {f.rule: f.value for f in examine(values).findings if f.blocks}
        assert {f.rule: f.value for f in broken if f.blocks} == found


# Everything in one pass, and nothing that rests on what is refused


@pytest.mark.parametrize(
    ("values", "roots"),
    [
        ({"pitch_mm": math.nan, "displacement_mm": 0.9, "size_mm": [9000, 50]}, {"pitch_mm"}),
        ({"code": "qr", "sector": 300}, {"code"}),
        ({"code": "qr", "sector": 9999, "origin": [3400, 0]}, {"code", "sector"}),
        ({"sector": 300, "size_mm": [5000, 40]}, {"sector"}),
        ({"sector": 300, "size_mm": [5, 5]}, {"sector", "size_mm"}),
        ({"size_mm": [0, 50], "holes_mm": [[200, 10, 1]], "corner_radius_mm": 30}, {"size_mm"}),
        ({"size_mm": [20, 20], "tag_cell_mm": 9}, {"tag_cell_mm"}),
        ({"size_mm": [20, 20], "corner_radius_mm": 3, "pitch_mm": 0}, {"pitch_mm", "corner_radius_mm"}),
        ({"tag": "round", "tag_id": 3}, {"tag"}),
        ({"fab": "nowhere.toml", "coverlay": "lpi", "stiffener": "FR4:0.33"}, {"fab"}),
        ({"fab": "nowhere.toml", "part": "nowhere.toml", "process": "nowhere.toml"}, {"fab", "part", "process"}),
        ({"assembly": "acme", "part_number": "R1"}, {"assembly"}),
        ({"models": 3, "base_mm": 1.0, "process": "sla"}, {"models"}),
        ({"anchor": "mesh", "rotation_deg": 400}, {"rotation_deg"}),
        ({"part": "dome", "size_mm": [0, 50], "cylinder_mm": 15}, {"size_mm"}),
        ({"part": "dome", "base_mm": 0, "cylinder_mm": 15}, {"base_mm"}),
        ({"part": "dome", "base_mm": 0, "cylinder_mm": 15, "holes_mm": [[20, 20, 1]]}, {"base_mm", "holes_mm"}),
        ({"part": "block", "base_mm": 0, "body_mm": [2, 2, 0.2]}, {"base_mm", "part"}),
        ({"part": "r9", "body_mm": [math.nan, 1, 1], "coverlay": "lpi"}, {"part"}),
        (  # the substitute of a board that is too small is longer than the circumference
            {"size_mm": [24, 8], "tag_cell_mm": 0.8, "fab": "generic-lpi", "coverlay": "per-part", "cylinder_mm": 10},
            {"coverlay"},
        ),
    ],
    ids=lambda value: str(sorted(value)),
)
def test_what_rests_on_a_refused_value_is_not_judged(values: dict[str, Any], roots: set[str]) -> None:
    problems = refusal_of({"sector": 7, **values}).problems
    assert {problem.root for problem in problems} == roots
    assert len({problem.message for problem in problems}) == len(problems)
    assert all("  " not in problem.message for problem in problems)


@pytest.mark.parametrize(
    "values",
    [{"sector": 300}, {"size_mm": [5, 5]}, {"origin": [3370, 0]}, {"tag": "round"}, {"fab": "nowhere.toml"}, {"name": "a/b"}],
    ids=str,
)
def test_rules_are_measured_beside_what_is_refused(values: dict[str, Any]) -> None:
    error = refusal_of({"sector": 7, "displacement_mm": 0.7, "models": False, **values})
    assert {"pad-pad", "body-body"} <= {finding.rule for finding in error.findings}
    assert all(finding.blocks and finding.at_mm is None for finding in error.findings)


def test_no_rule_is_measured_of_elements_that_are_refused() -> None:
    assert refusal_of({"sector": 7, "displacement_mm": 0.7, "pitch_mm": 0}).findings == ()
    assert refusal_of({"sector": 7, "displacement_mm": 0.7, "rotation_deg": 400}).findings == ()


def test_the_place_is_refused_with_all_the_rest(tmp_path: Path) -> None:
    place = str(tmp_path)
    assert "exists already" in str(refusal_of({"sector": 7}, output=place))
    both = refusal_of({"sector": 7, "pitch_mm": 0, "displacement_mm": 0.9}, output=place)
    assert [problem.root for problem in both.problems] == ["", "pitch_mm"]


def test_what_is_known_of_an_order_is_refused_with_its_tape() -> None:
    known = [Problem("tabs", "tabs = 'q'")]
    assert [p.root for p in refusal_of({"sector": 300}, known=known).problems] == ["tabs", "sector"]
    assert [p.root for p in refusal_of({"sector": 3}, known=known).problems] == ["tabs"]


def test_a_lack_of_reach_alone_is_a_capacity_error() -> None:
    assert isinstance(refusal_of({"sector": 7, "size_mm": [5000, 30]}), CapacityError)
    assert not isinstance(refusal_of({"sector": 7, "size_mm": [5000, 30], "name": "a/b"}), CapacityError)
    error = refusal([ReachProblem("size_mm", "too large")])
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is CapacityError
    assert again.problems == error.problems


BAD: dict[str, list[Any]] = {
    "sector": [300, "x", None],
    "code": ["qr", "anoto-6x6", 3],
    "pitch_mm": [math.nan, 25, 0.2, 20],
    "displacement_mm": [1e300, 0.7, "x"],
    "size_mm": [[5, 5], [1e7, 50], [9000, 9000], [5000, 40], "x"],
    "origin": [[3370, 0], [-1, 0], "best", {}],
    "tag": ["round", "none"],
    "tag_cell_mm": [math.inf, 5],
    "part": ["dome", "r9999", "block", 4],
    "body_mm": [[0.6, 0.6, 0.4], [20, 20, 0.1], [math.nan, 1, 1], 3],
    "rotation_deg": [math.nan, 0.1],
    "fab": ["acme", "jlcpcb-fr4", "jlcpcb-fpc"],
    "corner_radius_mm": [30, 3, math.nan],
    "holes_mm": [3, [[200, 10, 1]], [[12, 10, 19]], [[math.nan, 1, 1]]],
    "models": [False, 3],
    "cylinder_mm": [1e9, 0.5, 15],
    "around": ["z", "y"],
    "process": ["laser", "fdm"],
    "coverlay": ["lpi", "gang", 3],
    "anchor": ["mesh", "spur", "rope"],
}


@st.composite
def bad_values(draw: st.DrawFn) -> dict[str, Any]:
    keys = draw(st.lists(st.sampled_from(sorted(BAD)), min_size=2, max_size=7, unique=True))
    return {"sector": 7, "size_mm": [60, 40], **{key: draw(st.sampled_from(BAD[key])) for key in keys}}


@settings(deadline=None, derandomize=True, max_examples=some(60))
@given(values=bad_values())
def test_any_values_are_examined_or_refused_once_each(values: dict[str, Any]) -> None:
    try:
        assert examine(values).spec.pitch_mm > 0.0
    except SpecError as error:
        messages = [problem.message for problem in error.problems]
        assert messages
        assert len(set(messages)) == len(messages)


@pytest.mark.parametrize("directions", [4, 8])
def test_a_tape_that_is_refused_is_not_designed(monkeypatch: pytest.MonkeyPatch, directions: int) -> None:
    """A design takes seconds; the rules are measured without."""

    def designs(*_: object, **__: object) -> None:
        raise AssertionError("designed")

    monkeypatch.setattr(designed, "design", designs)
    values = {"sector": 1, "code": "touch-1", "directions": directions, "part": "block" if directions == 8 else "r0201"}
    with pytest.raises(SpecError) as caught:
        examine({**values, "origin": [3, 3], "pitch_mm": 1.0, "displacement_mm": 0.15})
    assert [p.key for p in caught.value.problems] == ["origin"]
    if directions == 4:
        same = examine({"sector": 1, "pitch_mm": 1.0, "displacement_mm": 0.15}).findings  # all pairs of symbols stand on it, too
        assert [(f.rule, f.value) for f in caught.value.findings] == [(f.rule, f.value) for f in same if f.blocks] != []
    with pytest.raises(AssertionError, match="designed"):
        examine(values)


@pytest.mark.parametrize(
    ("origin", "said"), [((84, 1428), 0), ((145, 1459), 1), ((57, 1411), 1), ((146, 1428), 0), ((84, 1410), 0)]
)
def test_a_tape_that_shows_a_part_of_its_sector_s_default_tape_is_told(origin: tuple[int, int], said: int) -> None:
    """Of 28 x 18 grid points; decode refuses contacts on such a part."""
    spec = TapeSpec(sector=7, origin=origin, size_mm=(50.0, 30.0), models=False)
    found = [f for f in examine(spec).findings if f.rule == "origin"]
    assert len(found) == said and all("--origin best" in f.message for f in found)


@slow
def test_an_origin_that_was_searched_for_is_not_told_to_be_searched_for() -> None:
    found = examine(TapeSpec(sector=3, origin="best", size_mm=(700.0, 700.0), models=False)).findings
    assert [f.message.rpartition("; ")[2] for f in found if f.rule == "origin"] == ["use a smaller --size"]


@pytest.mark.parametrize(("origin", "remedy"), [({}, "--origin best"), ({"origin": "best"}, "a smaller --size")])
def test_equal_windows_have_a_remedy_that_was_not_taken_yet(origin: dict[str, str], remedy: str) -> None:
    found = examine({"sector": 0, "code": "debruijn-4x4", "size_mm": [300.0, 200.0], "models": False, **origin}).findings
    (said,) = [f.message for f in found if f.rule == "windows"]
    assert said.endswith(f"rely on contacts of at least 5 x 5 parts, or use {remedy}")


# What is measured beside what is refused


def test_rules_are_told_beside_a_size_that_is_too_small_for_a_large_tag() -> None:
    """A strip with a tag of 45 mm and one window fit on no 100 x 50 either."""
    refusal = refusal_of({"sector": 7, "size_mm": [30.0, 24.0], "tag_cell_mm": 5.0, "part": "r0402"})
    assert [problem.root for problem in refusal.problems] == ["size_mm"]
    assert {"pad-pad", "models"} <= {finding.rule for finding in refusal.findings}


def test_rules_are_told_beside_a_tag_that_no_corners_let_in(here: Path) -> None:
    (here / "mine.toml").write_text('name = "mine"\nextends = "generic-fpc"\n[legend]\nedge_mm = 3.0\n')
    refusal = refusal_of({"sector": 7, "fab": "mine.toml", "pitch_mm": 1.0})
    assert [problem.root for problem in refusal.problems] == ["corner_radius_mm"]
    assert "body-body" in {finding.rule for finding in refusal.findings}


def test_no_rule_is_told_of_a_substitute_s_outline(here: Path) -> None:
    (here / "mine.toml").write_text(
        'name = "mine"\nextends = "generic-fpc"\n[size]\nlevel = "block"\nlargest_mm = [60.0, 40.0]\n'
        '[parts]\nlevel = "block"\n[limits]\ncorner-radius.level = "block"\ncorner-radius.value_mm = 2.0\n'
    )
    values = {"sector": 7, "fab": "mine.toml", "models": False, "pitch_mm": 1.0}
    of_outline = {"size", "part-count", "corner-radius"}
    for more, kept in (({"size_mm": [5.0, 5.0]}, set()), ({"corner_radius_mm": 5.0}, {"size", "part-count"})):
        refusal = refusal_of({**values, **more})
        assert {finding.rule for finding in refusal.findings} & of_outline == kept
        assert "body-body" in {finding.rule for finding in refusal.findings}


@pytest.mark.parametrize(
    "values",
    [
        {"coverlay": "gang"},
        {"pitch_mm": 1.0, "displacement_mm": 0.15},
        {"part": "dome", "process": "sla", "pitch_mm": 0.95, "displacement_mm": 0.15},
        {"origin": (3, 3)},
        {"code": "anoto-6x6", "size_mm": (200.0, 100.0)},
    ],
    ids=str,
)
def test_rules_of_parts_are_all_but_those_of_the_texture(values: dict[str, Any]) -> None:
    spec = TapeSpec(sector=7, **values)
    found = examine(spec).findings
    assert rules_of_parts(spec) == [f for f in found if f.rule not in ("windows", "origin")]
    assert len({f.rule for f in found}) > 4


def test_rules_of_parts_refuse_what_cannot_be_made() -> None:
    spec = TapeSpec(sector=7, size_mm=(5.0, 5.0))
    assert {p.key for p in refusal_of(spec.to_mapping()).problems} == {"size_mm"}
    with pytest.raises(SpecError, match="size_mm"):
        rules_of_parts(spec)


def test_models_may_be_left_out_unless_they_have_a_process() -> None:
    values: dict[str, Any] = {"sector": 7, "part": "r0402", "size_mm": [60.0, 40.0]}
    said = {
        process: next(f.message for f in examine({**values, "process": process}).findings if f.rule == "models")
        for process in (None, "cnc")
    }
    assert said == {None: f"{said['cnc']}, or --no-3d", "cnc": said["cnc"]}


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"size_mm": [6000.0, 20.0], "sector": 16}, "use --code anoto-6x6 or a smaller tape"),
        ({"size_mm": [5600.0, 20.0], "sector": 7}, "use --code debruijn-4x4 or a smaller tape"),
        ({"size_mm": [9900.0, 300.0], "sector": 7}, "use a smaller tape"),  # more points than a tape may have
        ({"size_mm": [500.0, 200.0], "code": "touch-1"}, "use a smaller --size, or --code microdots-4x4"),
        ({"size_mm": [500.0, 200.0], "code": "touch-1", "directions": 8, "part": "dome"}, "use a smaller --size"),
        ({"size_mm": [500.0, 200.0], "code": "touch-1", "sector": 4000, "tag": "none"}, "use a smaller --size"),
    ],
    ids=str,
)
def test_a_code_is_named_that_holds_the_tape(values: dict[str, Any], says: str) -> None:
    refusal = refusal_of({"sector": 7, **values})
    assert [line for line in str(refusal).splitlines() if line.endswith(f"; {says}")]
    if "--code" in says:
        assert examine({"sector": 7, **values, "code": says.partition("--code ")[2].split()[0]}).tape.part_count > 0
