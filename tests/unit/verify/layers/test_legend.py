"""The printed tag is found whatever its size, beside any label; a tag or label that is not the tape's is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from tactape_fab import TapeSpec
from tactape_fab.base.fields import Fields
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.film.layout import tape_legend
from tactape_fab.kit.profiles.fabs import LegendSizes
from tactape_fab.kit.read.gerber_file import GerberContent, read_gerber
from tactape_fab.kit.render.gerber import render_legend
from tactape_fab.verify.layers import legend
from tactape_fab.verify.layers.legend import check_label, check_tag, inked_or_cut, read_legend_record


@cache
def printed(**more: Any) -> tuple[Examined, GerberContent]:
    made = examine(TapeSpec(**{"sector": 7, "size_mm": (120.0, 80.0), "models": False, **more}))
    (layer,) = render_legend(made.drawing, made.fab)
    return made, read_gerber(layer.data)


@pytest.mark.parametrize("cell_mm", [0.3, 0.5, 0.63, 0.7, 0.783, 0.876, 0.95, 1.0, 2.0, 5.0])
@pytest.mark.parametrize("more", [{}, {"sector": 44, "name": "nD.-r-oZ"}])
def test_a_tag_of_any_size_is_found_beside_its_label(more: dict[str, Any], cell_mm: float) -> None:
    made, content = printed(tag_cell_mm=cell_mm, **more)
    (check,) = check_tag(content, made.tape, legend_is_light=True, with_pupil=False)
    assert check.passed, check.message


def moved(by_mm: float) -> Callable[[GerberContent], GerberContent]:
    return lambda content: replace(content, areas_mm=tuple(area + np.array([by_mm, 0.0]) for area in content.areas_mm))


def as_it_is(content: GerberContent) -> GerberContent:
    return content


@pytest.mark.parametrize(
    ("number", "change", "says"),
    [
        (7, as_it_is, "tag 7 reads the right way up, corners within 0.0"),
        (7, moved(-0.04), "tag 7 reads the right way up, corners within 0.0"),
        (7, moved(0.04), "tag 7 reads the right way up, corners within 0.0"),
        (7, moved(-0.06), "is turned or displaced: a corner is 0.0"),
        (7, lambda content: replace(content, areas_mm=()), "0 tags found"),
        (7, lambda content: replace(content, clear=True), "clear polarity"),
        (8, as_it_is, "the legend shows tag 8, the manifest says 7"),
    ],
)
@pytest.mark.parametrize("light", [True, False])
def test_both_detectors_name_a_tag_that_is_not_the_tape_s(
    number: int, change: Callable[[GerberContent], GerberContent], says: str, light: bool
) -> None:
    """A corner may be a tenth of a cell of 0.5 mm off."""
    made, content = printed()
    assert made.tape.tag is not None and made.tape.tag.cell_mm == 0.5
    tag = replace(made.tape.tag, id=number)
    areas_mm = tape_legend(replace(made.tape, tag=tag), made.fab.legend, light=light).areas_mm
    checks = check_tag(change(replace(content, areas_mm=areas_mm)), made.tape, legend_is_light=light, with_pupil=True)
    assert [check.passed for check in checks] == ["right way up" in says] * len(checks)
    assert all(says in check.message for check in checks), checks
    assert "clear" in says or [check.name for check in checks] == ["tag by OpenCV", "tag by pupil-apriltags"]


def test_a_tag_that_is_turned_by_half_is_named() -> None:
    """Its corners are a diagonal of eight cells of 0.5 mm off."""
    made, content = printed()
    assert made.tape.tag is not None
    tape = replace(made.tape, tag=replace(made.tape.tag, rotation_deg=180.0))
    for check in check_tag(content, tape, legend_is_light=True, with_pupil=True):
        assert not check.passed and check.figure == pytest.approx(8 * 0.5 * 2**0.5, abs=0.02)


def test_a_detector_that_is_missing_is_said_and_fails_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(legend, "find_spec", lambda name: None)
    made, content = printed()
    _, missing = check_tag(content, made.tape, legend_is_light=True, with_pupil=True)
    assert missing.skipped and missing.warning and "install the extra 'verify'" in missing.message


def with_line(index: int, by_mm: float) -> Callable[[GerberContent], GerberContent]:
    def change(content: GerberContent) -> GerberContent:
        lines = [stroke + by_mm * (k == index) for k, stroke in enumerate(content.strokes_mm)]
        return replace(content, strokes_mm=tuple(lines))

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (as_it_is, " lines, those of this tape's tag and label"),
        (with_line(5, 5e-6), " lines, those of this tape's tag and label"),
        (with_line(5, -2e-5), " lines are not the "),
        (lambda content: replace(content, strokes_mm=content.strokes_mm[1:]), " lines are not the "),
        (lambda content: replace(content, strokes_mm=()), "its 0 lines are not the "),
        (lambda content: replace(content, stroke_width_mm=content.stroke_width_mm - 2e-5), "a line is not 0.15 mm wide"),
        (moved(-2e-5), " areas are not the "),
        (lambda content: replace(content, flash_xy_mm=np.zeros((3, 2))), "3 flashes, which no legend has"),
    ],
)
def test_a_label_is_the_tape_s_line_by_line(change: Callable[[GerberContent], GerberContent], says: str) -> None:
    made, content = printed()
    check = check_label(change(content), made.tape, made.fab.legend, light=True)
    assert check.passed == ("those of" in says) and says in check.message


def test_a_label_of_a_profile_that_is_not_known_is_not_compared() -> None:
    made, content = printed()
    check = check_label(content, made.tape, None, light=True)
    assert check.warning and not check.passed and "not compared" in check.message


def test_sizes_of_the_print_are_those_of_the_manifest() -> None:
    sizes = {"line_mm": 0.2, "text_mm": 1.1, "gap_mm": 0.21, "bleed_mm": 0.02, "edge_mm": 0.3}
    table = Fields({"fab": {f"legend_{name}": size for name, size in sizes.items()}})
    assert read_legend_record(table) == LegendSizes(**sizes) and not table.problems
    small = Fields({"fab": {f"legend_{name}": 11.0 * (name == "edge_mm") for name in sizes}})
    read_legend_record(small)
    assert any("legend_edge_mm = 11" in str(problem) for problem in small.problems)


def test_boxes_of_ink_and_holes() -> None:
    _, content = printed()
    ink = replace(content, areas_mm=(np.array([(1.0, 5.0), (3.0, 4.0), (2.0, 7.0)]),), strokes_mm=(np.array([(9.0, 0), (8, 1)]),))
    boxes = [[*low.tolist(), *high.tolist()] for low, high in inked_or_cut(ink, [(20.0, 12.0, 3.0)])]
    assert boxes == [[1, 4, 3, 7], [8, 0, 9, 1], [18.5, 10.5, 21.5, 13.5]]
    assert len(inked_or_cut(None, [])) == 0
