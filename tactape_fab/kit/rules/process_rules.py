"""Limits of a printing or milling process, measured on the nominal geometry of a tape's solid models."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tactape_fab.base.errors import Finding
from tactape_fab.kit.outlines import element_outline
from tactape_fab.kit.profiles import ProcessProfile
from tactape_fab.kit.rules.spacing import Measured, finding, gap_mm, hole_rules, hole_to_parts, neighbours, to_outline, worst_at
from tactape_fab.solids.elements import narrowest_mm
from tactape_fab.solids.forms import SolidForm
from tactape_fab.texture.shapes import reach_mm
from tactape_fab.texture.tape import Tape


def check_models(tape: Tape, form: SolidForm, process: ProcessProfile) -> list[Finding]:
    """Measure elements, gaps, height and base of a tape's solid models against a process.

    In a mould the cavities are the gaps, and the walls between them are the features.
    """
    return list(_model_rules(tape, form, process))


def check_texture(tape: Tape, form: SolidForm, process: ProcessProfile) -> list[Finding]:
    """Measure a texture of solid elements: its models, and its elements and holes on the base."""
    board, parts_xy_mm = tape.board, tape.part_xy_mm()
    foot = element_outline(tape.part.shape, tape.part.body_mm, tape.part.rotation_deg)
    limit_mm = process.limits["body-edge"].value_mm
    findings = check_models(tape, form, process)
    measured = to_outline(parts_xy_mm, foot, board, limit_mm)
    findings.append(finding(process, "body-edge", measured, "element to outline", "use a larger --size"))
    if board.holes:
        findings += hole_rules(board, process, "base")
        findings += hole_to_parts(board, process, "hole-part", parts_xy_mm, foot[None], "hole to element")
    return findings


def _model_rules(tape: Tape, form: SolidForm, process: ProcessProfile) -> Iterator[Finding]:
    width: Measured = (narrowest_mm(tape.part), None)
    between = _between_elements(tape)
    wider, apart = "use a larger element", "use a larger --w, a smaller --delta or a smaller element"
    other = " or another --process"
    if form.negative:
        if between is not None:
            yield finding(process, "feature", between, "narrowest wall between two cavities", apart + other)
        yield finding(process, "gap", width, "narrowest width of a cavity", wider + other)
    else:
        yield finding(process, "feature", width, "narrowest width of an element", wider + other)
        if between is not None:
            yield finding(process, "gap", between, "gap between two elements", apart + other)
    what = "depth of a cavity" if form.negative else "height of an element"
    yield finding(process, "height", (tape.part.body_mm[2], None), what, "use a higher element" + other)
    yield finding(process, "base", (form.base_mm, None), "thickness of the base", "use a larger --base" + other)


def _between_elements(tape: Tape) -> Measured | None:
    """Least gap between the feet of two elements, mm; None if no two are near each other."""
    foot = element_outline(tape.part.shape, tape.part.body_mm, tape.part.rotation_deg)
    shifts, places = neighbours(tape, 2 * float(np.hypot(*reach_mm(foot))) + 2 * tape.pitch_mm)
    return worst_at(gap_mm(foot, shifts), places) if len(shifts) else None
