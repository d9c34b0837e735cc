"""A spec examined: planned, drawn, measured and certified before anything is written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar, cast

from tactape_fab.base.errors import Finding, Problem, SpecError
from tactape_fab.base.fields import shown
from tactape_fab.kit.film.drawing import Drawing, tape_drawing
from tactape_fab.kit.film.layout import Layout, build_layout
from tactape_fab.kit.plan import plan, plan_texture
from tactape_fab.kit.profiles import (
    ElementProfile,
    FabProfile,
    PartProfile,
    ProcessProfile,
    X2Mode,
    load_fab,
    load_process,
    read_part,
)
from tactape_fab.kit.rules.film_rules import fab_for, film_findings, film_problems
from tactape_fab.kit.rules.process_rules import check_models, check_texture
from tactape_fab.kit.rules.spacing import check
from tactape_fab.kit.spec.tape_spec import BEST, TapeSpec
from tactape_fab.solids.checks import form_problems
from tactape_fab.solids.forms import SolidForm
from tactape_fab.texture.certify.certificate import Certificate, certify, pair_words
from tactape_fab.texture.certify.origin import Choice, choose_origin
from tactape_fab.texture.code import get_code, get_plane, has_plane
from tactape_fab.texture.cpl import part_number_problem
from tactape_fab.texture.tape import Tape

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """What there is of a tape of parts with lands beside the tape: its fab, and its layers."""

    fab: FabProfile
    layout: Layout


@dataclass(frozen=True, slots=True, kw_only=True)
class Examined:
    """A spec with all that follows from it before anything is written; ``film`` is None for solid elements.

    ``search`` is None where the origin was not searched for, ``avoided`` names the tapes that it kept away from.
    """

    spec: TapeSpec
    tape: Tape
    film: Film | None
    process: ProcessProfile | None
    findings: tuple[Finding, ...]
    certificate: Certificate
    search: Choice | None = None
    avoided: tuple[str, ...] = ()

    @property
    def layout(self) -> Layout:
        """The film's layers; only a film has them."""
        assert self.film is not None
        return self.film.layout

    @property
    def drawing(self) -> Drawing:
        """The film's drawing; only a film has one."""
        return tape_drawing(self.layout)

    @property
    def fab(self) -> FabProfile:
        """The film's fab; only a film has one."""
        assert self.film is not None
        return self.film.fab


def examine(spec: TapeSpec, *, avoid: Sequence[Tape] = ()) -> Examined:
    """Plan, draw, measure and certify a tape; nothing is written and no broken rule raises.

    Parameters
    ----------
    spec : TapeSpec
    avoid : sequence of Tape
        Tapes that exist: the origin is then chosen away from them, and the spec's must be ``"best"``; a touch code is
        designed away from them.

    Returns
    -------
    Examined
        With ``tape``, ``findings`` (every design rule, measured) and ``certificate``.

    Raises
    ------
    SpecError
        When a profile cannot be read, or no tape follows from the spec.
    """
    problems: list[Problem] = []
    fab = _loaded(load_fab, spec.fab, problems)
    part = _loaded(read_part, spec.part, problems)
    process = _loaded(load_process, spec.process, problems)
    if avoid and has_plane(spec.code) and spec.origin != BEST:
        problems.append(fixed_origin(spec.origin))
    problems += _other_directions(spec, avoid)
    if problems:
        raise SpecError(problems)
    if isinstance(part, PartProfile) and fab is not None:
        fab = replace(fab, x2=cast(X2Mode, spec.x2 or fab.x2), assembly=spec.assembly or fab.assembly)
        if refused := film_problems(spec, fab):
            raise SpecError(refused)
        part = _with_number(part, spec.part_number, fab.assembly)
        fab = fab_for(spec, fab, part)
        spec, search = _settled(spec, lambda: plan(spec, fab, part), avoid)
        return _examine_film(spec, plan(spec, fab, part, avoid), (fab, part, process), search)
    if isinstance(part, ElementProfile) and process is not None:
        spec, search = _settled(spec, lambda: _plan_texture(spec, process, part), avoid)
        return _examine_texture(spec, _plan_texture(spec, process, part, avoid), process, search)
    raise SpecError(Problem("part", f"part = {shown(spec.part)} has changed since the spec was read; run the command again"))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Search:
    """What was searched for; `choice` is None where nothing was."""

    choice: Choice | None = None
    avoided: tuple[str, ...] = ()


def fixed_origin(origin: object) -> Problem:
    """An origin that is given where one is to be chosen."""
    message = f"origin = {shown(origin)} contradicts avoid, which chooses the origin; give --origin best, or leave --origin out"
    return Problem("origin", message)


def _other_directions(spec: TapeSpec, avoid: Sequence[Tape]) -> list[Problem]:
    """Tapes to avoid that no decoder knows together with the one that is asked for."""
    other = [tape for tape in avoid if tape.directions != spec.directions]
    if not other:
        return []
    message = f"avoid: the parts of {other[0].name} point in {other[0].directions} directions, those of this tape in "
    message += f"{spec.directions}: no decoder knows both together, and there is nothing to avoid; leave it out"
    return [Problem("avoid", message)]


def _settled(spec: TapeSpec, planned: Callable[[], Tape], avoid: Sequence[Tape]) -> tuple[TapeSpec, _Search]:
    """The spec with the best origin where it asks for that, and what was found."""
    if spec.origin != BEST:
        return spec, _Search(avoided=tuple(t.name for t in avoid))
    choice = choose_origin(get_plane(spec.code), spec.sector, planned().placed, avoid)
    return replace(spec, origin=choice.origin), _Search(choice=choice, avoided=tuple(t.name for t in avoid))


def _window_findings(certificate: Certificate) -> list[Finding]:
    """A warning where 4x4 windows are equal: no contact that shows nothing else can tell these places apart."""
    size = certificate.of_side(4)
    if size.distance != 0:
        return []
    count = f"{size.pairs} pair{'s' * (size.pairs != 1)} of 4x4 windows read{'s' * (size.pairs == 1)} the same"
    enough = certificate.distinct_side
    contact = "larger contacts" if enough is None else f"contacts of at least {enough} x {enough} parts"
    remedy = get_code(certificate.tape.code).another
    message = f"{count}, first {pair_words(certificate.tape, size, 0)}; rely on {contact}, or use {remedy}"
    return [Finding(rule="windows", level="warn", passed=False, unit="", message=message)]


def _loaded(load: Callable[[str], T], name: str | None, problems: list[Problem]) -> T | None:
    """A profile by its name; None where there is no name, or where its problems are added."""
    try:
        return None if name is None else load(name)
    except SpecError as error:
        problems += error.problems
        return None


def _with_number(part: PartProfile, number: str | None, house: str) -> PartProfile:
    """The part with the number that was asked for, as its assembly house takes it."""
    if number is None:
        return part
    if (problem := part_number_problem(number, house)) is not None:
        raise SpecError(Problem("part_number", problem))
    return replace(part, part_numbers={**part.part_numbers, house: number})


def _examine_film(
    spec: TapeSpec, planned: Tape, profiles: tuple[FabProfile, PartProfile, ProcessProfile | None], search: _Search
) -> Examined:
    fab, part, process = profiles
    layout = build_layout(planned, spec, fab, part)
    tape, form = layout.tape, spec.form
    findings = check(layout, fab) + film_findings(layout, spec, fab)
    if form is not None:
        problems = form_problems(tape, form)
        findings += [_cell_finding(p) for p in problems if p.key == "part" and not _broken(findings, "body-body")]
        findings += _corner_findings(tape, form)
        findings += [] if process is None else check_models(tape, form, process)
        if others := [p for p in problems if p.key != "part"]:
            raise SpecError(others, [f for f in findings if f.blocks])
    return _examined(spec, tape, Film(fab=fab, layout=layout), process, findings, search)


def _examined(
    spec: TapeSpec, tape: Tape, film: Film | None, process: ProcessProfile | None, findings: Sequence[Finding], search: _Search
) -> Examined:
    certificate = certify(tape)
    return Examined(
        spec=spec,
        tape=tape,
        film=film,
        process=process,
        findings=(*findings, *_window_findings(certificate)),
        certificate=certificate,
        search=search.choice,
        avoided=search.avoided,
    )


def _broken(findings: Sequence[Finding], rule: str) -> bool:
    return any(f.rule == rule and f.blocks for f in findings)


def _cell_finding(problem: Problem) -> Finding:
    """Parts that a fab can place may yet be too large for the models, which need each of them in its own cell."""
    return Finding(rule="models", level="block", passed=False, unit="", message=f"{problem.message}, or --no-3d")


def _corner_findings(tape: Tape, form: SolidForm) -> list[Finding]:
    radius_mm = tape.board.corner_radius_mm
    if form.cylinder is None or radius_mm == 0.0:
        return []
    message = f"the film's corners have a radius of {radius_mm:g} mm, those of the wrapped models are square"
    return [Finding(rule="model-corner", level="info", passed=False, value=0.0, limit=radius_mm, message=message)]


def _plan_texture(spec: TapeSpec, process: ProcessProfile, part: ElementProfile, avoid: Sequence[Tape] = ()) -> Tape:
    assert spec.body_mm is not None
    return plan_texture(spec, process, replace(part, body_mm=spec.body_mm, top_mm=spec.dome_top_mm), avoid)


def _examine_texture(spec: TapeSpec, tape: Tape, process: ProcessProfile, search: _Search) -> Examined:
    assert spec.form is not None
    findings = check_texture(tape, spec.form, process)
    if problems := form_problems(tape, spec.form):
        raise SpecError(problems, [f for f in findings if f.blocks])
    return _examined(spec, tape, None, process, findings, search)
