"""Limits of a printing or milling process, measured on the nominal geometry of a tape's solid models."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from tactape_fab.base.errors import Finding
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.outlines import element_outline
from tactape_fab.kit.plan import TOLERANCE_MM
from tactape_fab.kit.profiles import CoverlayMode, ElementProfile, PartProfile, ProcessProfile, load_fab, load_process
from tactape_fab.kit.rules.remedies import Remedy, element_pitch_mm, film_remedy, texture_remedy
from tactape_fab.kit.rules.spacing import (
    Measured,
    Remedies,
    finding,
    gap_mm,
    hole_rules,
    hole_to_parts,
    neighbours,
    to_outline,
    worst_at,
)
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.solids.elements import narrowest_mm
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mark import LEAST_CELL_MM, mark_of
from tactape_fab.texture.shapes import reach_mm
from tactape_fab.texture.tape import Tape

Part = PartProfile | ElementProfile
_DIAMETERS_A_HEIGHT = 2.2
"""Least diameter of a cap in a remedy, as a multiple of its height: a cap must be lower than its radius."""


def check_models(tape: Tape, form: SolidForm, process: ProcessProfile, spec: TapeSpec, part: Part) -> list[Finding]:
    """Measure elements, gaps, height and base of a tape's solid models against a process.

    In a mould the cavities are gaps, and the walls between them are features.
    """
    return list(_model_rules(tape, form, process, _Remedies(spec=spec, process=process, part=part)))


def check_texture(tape: Tape, form: SolidForm, process: ProcessProfile, spec: TapeSpec, part: Part) -> list[Finding]:
    """Measure a texture of solid elements: its models, and its elements and holes on the base."""
    board, parts_xy_mm = tape.board, tape.part_xy_mm()
    foot = element_outline(tape.part.shape, tape.part.body_mm, tape.part.rotation_deg)
    limit_mm = process.limits["body-edge"].value_mm
    findings = check_models(tape, form, process, spec, part)
    measured = to_outline(parts_xy_mm, foot, board, limit_mm)
    findings.append(finding(process, "body-edge", measured, "element to outline", "use a larger --size"))
    if form.mark:
        findings.append(_mark_rule(tape, form))
    if board.holes:
        findings += hole_rules(board, process, "base")
        findings += hole_to_parts(board, process, "hole-part", parts_xy_mm, foot[None], "hole to element")
    return findings


def _mark_rule(tape: Tape, form: SolidForm) -> Finding:
    """Finding of the mark in the back: its text, or the reason why there is none."""
    mark = mark_of(tape, form)
    if mark is None:
        message = f"the back has no place for figures of {LEAST_CELL_MM:g} mm strokes: write the sector on it by hand"
    else:
        message = (
            f"sector {tape.sector} and an arrow to board +y, strokes {mark.cell_mm:g} mm, {mark.depth_mm:g} mm into the back"
        )
    return Finding(rule="mark", level="info", passed=mark is not None, message=message)


def _model_rules(tape: Tape, form: SolidForm, process: ProcessProfile, remedies: _Remedies) -> Iterator[Finding]:
    width_mm, between = narrowest_mm(tape.part), _between_elements(tape)
    width: Measured = (width_mm, None)
    # in a mould solid and void are exchanged: an element's width is that of a cavity, and the gap between elements that of a wall
    of_width, of_gap = ("gap", "feature") if form.negative else ("feature", "gap")
    narrow, wall = ("width of a cavity", "wall between two cavities") if form.negative else ("width of an element", "")
    findings = {
        of_width: finding(process, of_width, width, f"narrowest {narrow}", remedies.of(of_width, width_mm, remedies.width))
    }
    if between is not None:
        what = f"narrowest {wall}" if wall else "gap between two elements"
        findings[of_gap] = finding(process, of_gap, between, what, remedies.of(of_gap, between[0], remedies.apart))
    # the order of the rules is the same for texture and mould
    yield from (findings[rule] for rule in ("feature", "gap") if rule in findings)
    what = "depth of a cavity" if form.negative else "height of an element"
    height_mm = tape.part.body_mm[2]
    yield finding(process, "height", (height_mm, None), what, remedies.of("height", height_mm, remedies.height))
    base = remedies.of("base", form.base_mm, lambda limit_mm: f"--base {limit_mm:g}")
    yield finding(process, "base", (form.base_mm, None), "thickness of the base", base)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Remedies:
    """Options to type if an element is too narrow, too low, or too near to another."""

    spec: TapeSpec
    process: ProcessProfile
    part: Part

    def of(self, rule: str, value_mm: float, found: Callable[[float], str]) -> Remedies:
        """Remedy of a rule: the options that `found` gives for its limit, or another process that can make the tape."""

        def words(limit_mm: float) -> str:
            # with holes no process is proposed, as its limits for holes differ and might be broken
            others = [] if self.spec.holes_mm else map(load_process, profile_names("processes"))
            ways = [found(limit_mm)] + [
                f"--process {other.name}"
                for other in others
                if value_mm >= max(other.limits[rule].value_mm, other.limits[rule].warn_mm or 0.0) - TOLERANCE_MM
            ]
            return "use " + ", or ".join(filter(None, ways)) if any(ways) else "leave out --process"

        return words

    def apart(self, limit_mm: float) -> str:
        """W and Δ at which the feet of any two elements are at least `limit_mm` apart."""
        return self._apart(self.part, limit_mm).words().removeprefix("use ")

    def _apart(self, part: Part, limit_mm: float) -> Remedy:
        if isinstance(part, ElementProfile):
            return texture_remedy(self.spec, self.process, part, limit_mm)
        fab = load_fab(str(self.spec.fab))
        fab = fab if self.spec.coverlay is None else fab.in_mode(cast(CoverlayMode, self.spec.coverlay))
        # in the models a chip is a block of its nominal size, so its gap is computed as for an element
        body = ElementProfile(
            name=part.name, shape=part.shape, description="", body_mm=part.body_mm, body_tolerance_mm=0.0, top_mm=None
        )
        return film_remedy(self.spec, fab, part, more=[lambda placing: element_pitch_mm(limit_mm, body, placing)])

    def width(self, limit_mm: float) -> str:
        """Options for a wider element, and for the W and Δ that it needs."""
        if not isinstance(self.part, ElementProfile):
            return ""
        length_mm, width_mm, height_mm = self.part.body_mm
        top_mm = self.part.top_mm
        if self.part.shape == "block":
            return self._with(replace(self.part, body_mm=(max(length_mm, limit_mm), max(width_mm, limit_mm), height_mm)))
        if top_mm is None:
            return self._with(replace(self.part, body_mm=(limit_mm, limit_mm, height_mm)))
        # a truncated cone keeps its slope, so its foot grows as much as its top
        foot_mm = round(max(length_mm, limit_mm + length_mm - top_mm), 6)
        return self._with(replace(self.part, body_mm=(foot_mm, foot_mm, height_mm), top_mm=limit_mm))

    def height(self, limit_mm: float) -> str:
        """Options for a higher element; a cap is made as wide as its height needs."""
        if not isinstance(self.part, ElementProfile):
            return ""
        length_mm, width_mm, _ = self.part.body_mm
        if self.part.shape == "dome" and self.part.top_mm is None:
            length_mm = width_mm = max(length_mm, round(_DIAMETERS_A_HEIGHT * limit_mm, 3))
        return self._with(replace(self.part, body_mm=(length_mm, width_mm, limit_mm)))

    def _with(self, part: ElementProfile) -> str:
        limit = self.process.limits["feature" if self.spec.negative else "gap"]
        # a wider element must meet the gap rule as well
        options = self._apart(part, max(limit.value_mm, limit.warn_mm or 0.0)).options()
        if options is None:
            return ""
        sides = part.body_mm if part.shape == "block" else part.body_mm[1:]
        top = "" if part.top_mm is None else f" --dome-top {part.top_mm:g}"
        return f"--body {'x'.join(f'{side:g}' for side in sides)}{top} {options}".strip()


def _between_elements(tape: Tape) -> Measured | None:
    """Least gap between the feet of two elements, mm, and its place; None if no two are near each other."""
    foot = element_outline(tape.part.shape, tape.part.body_mm, tape.part.rotation_deg)
    # two pitches beyond the feet, so that a neighbour is found even if every gap is wide
    shifts, places = neighbours(tape, 2 * float(np.hypot(*reach_mm(foot))) + 2 * tape.pitch_mm)
    return worst_at(gap_mm(foot, shifts), places) if len(shifts) else None
