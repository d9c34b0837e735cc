"""Examination of a tape: whether it can be made, and every rule measured, before anything is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar, cast

from tactape_fab.base.errors import Finding, Problem, SpecError, independent, refusal, tried
from tactape_fab.base.fields import shown
from tactape_fab.base.given_path import as_path
from tactape_fab.kit.examine.together import of_sector, other_sectors, together_findings
from tactape_fab.kit.film.drawing import Drawing, tape_drawing
from tactape_fab.kit.film.layout import Layout, build_layout
from tactape_fab.kit.output_place import Overwrite, refuse_taken
from tactape_fab.kit.plan import ELEMENT_KEYS, film_size_mm, plan, plan_texture, texture_size_mm
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
from tactape_fab.kit.profiles.assembly import part_number_problem
from tactape_fab.kit.rules.film_rules import OF_ASSEMBLY, fab_for, film_findings, film_problems
from tactape_fab.kit.rules.process_rules import check_models, check_texture
from tactape_fab.kit.rules.remedies import film_remedy
from tactape_fab.kit.rules.spacing import check
from tactape_fab.kit.spec.grid_options import BEST, DEFAULT_SIZE_MM
from tactape_fab.kit.spec.options import DEFAULT_FAB
from tactape_fab.kit.spec.solid_options import DEFAULT_PROCESS
from tactape_fab.kit.spec.tape_spec import DEFAULTS, TapeSpec, read_spec
from tactape_fab.solids.checks import form_problems, hole_problems
from tactape_fab.solids.forms import SolidForm
from tactape_fab.texture.certify.certificate import Certificate, certify, pair_words
from tactape_fab.texture.certify.origin import Choice, choose_origin, choose_sector
from tactape_fab.texture.certify.pairs import Conflict
from tactape_fab.texture.code import DEFAULT_CODE, default_origin, get_code, get_plane, has_plane
from tactape_fab.texture.directions import USUAL_DIRECTIONS
from tactape_fab.texture.tape import DEFAULT_GRID, Tape, refuse_no_tapes

T = TypeVar("T")

_SECTORS_BESIDE = 4
"""Most other sectors that are tried if the sector conflicts with tapes to avoid; each takes a search for the origin."""

_FORM_KEYS = (*ELEMENT_KEYS, "size_mm", "process", "base_mm", "around", "shell")
"""Keys on which the solid models depend."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Profiles:
    """The profiles that a spec names; ``fab`` is None for solid elements, ``process`` is None without models."""

    fab: FabProfile | None
    part: PartProfile | ElementProfile
    process: ProcessProfile | None

    def size_mm(self, spec: TapeSpec) -> tuple[float, float]:
        """The spec's outline, or the least larger one that holds a window of the code."""
        if isinstance(self.part, PartProfile):
            assert self.fab is not None
            return film_size_mm(spec, self.fab, self.part)
        assert self.process is not None
        return texture_size_mm(spec, self.process, self.part)

    def plan(self, spec: TapeSpec, avoid: Sequence[Tape] | None = ()) -> Tape:
        """The tape of a spec that names these profiles; see `tactape_fab.kit.plan`."""
        if isinstance(self.part, PartProfile):
            assert self.fab is not None
            return plan(spec, self.fab, self.part, avoid)
        assert self.process is not None
        return plan_texture(spec, self.process, self.part, avoid)


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """Fab, layers and drawing of a tape made of parts with lands."""

    fab: FabProfile
    layout: Layout


@dataclass(frozen=True, slots=True, kw_only=True)
class Examined:
    """A spec with everything derived from it before anything is written; ``film`` is None for solid elements.

    ``search`` is None if the origin was not searched for, ``avoided`` names the tapes that the origin was chosen away from.
    """

    spec: TapeSpec
    tape: Tape
    film: Film | None
    profiles: Profiles
    findings: tuple[Finding, ...]
    certificate: Certificate
    search: Choice | None = None
    avoided: tuple[str, ...] = ()

    @property
    def layout(self) -> Layout:
        """The film's layers; an error for solid elements."""
        assert self.film is not None
        return self.film.layout

    @property
    def drawing(self) -> Drawing:
        """The film's drawing; an error for solid elements."""
        return tape_drawing(self.layout)

    @property
    def fab(self) -> FabProfile:
        """The film's fab; an error for solid elements."""
        assert self.film is not None
        return self.film.fab


def examine(
    asked: TapeSpec | Mapping[str, Any],
    *,
    avoid: Sequence[Tape] = (),
    output: str | None = None,
    overwrite: Overwrite = False,
    known: Sequence[Problem] = (),
) -> Examined:
    """Decide whether a tape can be made, and measure every rule. Nothing is written, and a broken rule does not raise.

    Parameters
    ----------
    asked : TapeSpec or mapping
        A spec, or untrusted values of one.
    avoid : sequence of Tape
        Existing tapes. The origin is chosen away from them, and must be ``"best"`` if given; the sector is chosen if not
        given; a touch code is designed away from them.
    output : str, optional
        Path of the kit to be made.
    overwrite : bool or "edits"
        Whether an older kit there may be replaced.
    known : sequence of Problem
        Problems already found in the order that the tape is part of; raised together with all others.

    Returns
    -------
    Examined
        With ``tape``, ``findings`` (every design rule, measured) and ``certificate``.

    Raises
    ------
    SpecError
        With every problem, and in `findings` the broken rules whose values were not refused. CapacityError if the code's
        reach is the only problem.
    """
    refuse_no_tapes(avoid, "avoid")
    problems = list(known)
    if output is not None:
        tried(lambda: refuse_taken(as_path(output, "output", "the folder of the kit"), overwrite=overwrite), problems)
    spec = asked if isinstance(asked, TapeSpec) else _read(asked, avoid, problems)
    problems += independent(_avoid_problems(spec, avoid), problems)
    spec, profiles = _profiles(spec, problems)
    if profiles is None:
        raise refusal(problems)
    if not isinstance(asked, TapeSpec) and avoid and "sector" not in asked and not problems:
        sector = tried(lambda: _free_sector(spec, profiles, avoid), problems)
        if sector is not None:
            return examine({**asked, "sector": sector}, avoid=avoid, output=output, overwrite=overwrite)
    spec, tape, search, film, findings = _with_rules(spec, profiles, avoid, problems)
    certificate, searched = certify(tape), search is not None
    findings += _beside(spec, tape, profiles, avoid)
    return Examined(
        spec=spec,
        tape=tape,
        film=film,
        profiles=profiles,
        findings=(*findings, *_window_findings(certificate, searched=searched), *_origin_findings(tape, searched=searched)),
        certificate=certificate,
        search=search,
        avoided=tuple(t.name for t in avoid),
    )


def rules_of_parts(spec: TapeSpec) -> list[Finding]:
    """Every rule that `examine` measures on parts, layers and models: not those of the texture, whose search takes half of it.

    Raises SpecError where `examine` does.
    """
    return _with_rules(spec, profiles_of(spec), (), [])[-1]


def _with_rules(
    spec: TapeSpec, profiles: Profiles, avoid: Sequence[Tape], problems: list[Problem]
) -> tuple[TapeSpec, Tape, Choice | None, Film | None, list[Finding]]:
    """The spec with its origin, the tape, the search for the origin, the film, and the rules of its parts.

    Raises SpecError with `problems` and those found here, and with the broken rules whose values were not refused.
    """
    planned, tape, search = _planned(spec, profiles, avoid, problems)
    if tape is None:
        raise refusal(problems)
    # rules measured on other elements than those asked for do not apply to the tape
    measurable = {problem.root for problem in problems}.isdisjoint(ELEMENT_KEYS)
    resized, rounded = planned.size_mm != spec.size_mm, planned.corner_radius_mm != spec.corner_radius_mm
    elsewhere = {*(("size", *OF_ASSEMBLY) if resized else ()), *(("corner-radius",) if rounded else ())}
    film, findings = _measured(planned, tape, profiles, problems, resized=resized)
    if problems:
        # places on a substitute board mean nothing, so at_mm is left out, as are rules that are those of its outline
        broken = [replace(f, at_mm=None) for f in findings if f.blocks and measurable and f.rule not in elsewhere]
        raise refusal(problems, broken)
    return planned, tape, search, film, findings


# Values and profiles


def _read(values: Mapping[str, Any], avoid: Sequence[Tape], problems: list[Problem]) -> TapeSpec:
    """Read the spec from untrusted values; with tapes to avoid, a missing sector or origin is not a problem."""
    given: object = values
    if not isinstance(given, Mapping):
        message = f"spec = {shown(given)} is no TapeSpec; give one, such as TapeSpec(sector=7)"
        raise SpecError([*problems, Problem("spec", message)])
    # sector and origin are chosen away from the tapes to avoid, so neither has to be given
    if avoid:
        values = {"sector": 0, **({"origin": BEST} if has_plane(values.get("code")) else {}), **values}
    spec, refused = read_spec(values)
    problems += refused
    return spec


def profiles_of(spec: TapeSpec) -> Profiles:
    """The profiles that a spec names, with the modes that it asks for.

    Raises SpecError if one cannot be read, or does not offer an option of the spec.
    """
    problems: list[Problem] = []
    _, profiles = _profiles(spec, problems)
    if profiles is None or problems:
        raise refusal(problems)
    return profiles


def _profiles(spec: TapeSpec, problems: list[Problem]) -> tuple[TapeSpec, Profiles | None]:
    """The profiles of a spec, and the spec without options that they do not offer, each of which is a problem.

    The default profile replaces one that cannot be read. If the part is refused there are no profiles: all depend on it.
    """

    def loaded(load: Callable[[str], T], name: str | None, usual: str) -> T | None:
        profile = None if name is None else tried(lambda: load(name), problems)
        return load(usual) if profile is None and name is not None else profile

    fab = loaded(load_fab, spec.fab, DEFAULT_FAB)
    process = loaded(load_process, spec.process, DEFAULT_PROCESS)
    part = None if any(p.root == "part" for p in problems) else tried(lambda: read_part(spec.part), problems)
    if isinstance(part, PartProfile) and fab is not None:
        found = film_problems(spec, fab, part)
        problems += independent([replace(problem, needs=("fab",)) for problem in found], problems)
        # refused options get their defaults, so that the others are still examined
        spec = spec.with_values(**{problem.root: DEFAULTS[problem.root] for problem in found})
        fab = replace(fab, x2=cast(X2Mode, spec.x2 or fab.x2), assembly=spec.assembly or fab.assembly)
        if spec.part_number is not None:
            message = part_number_problem(spec.part_number, fab.assembly)
            wrong = [] if message is None else [Problem("part_number", message, needs=("assembly", "fab"))]
            problems += independent(wrong, problems)
            part = replace(part, part_numbers={**part.part_numbers, fab.assembly: spec.part_number})
        return spec, Profiles(fab=fab_for(spec, fab, part), part=part, process=process)
    if isinstance(part, ElementProfile) and spec.body_mm is not None:
        part = replace(part, body_mm=spec.body_mm, top_mm=spec.dome_top_mm)
        return spec, Profiles(fab=None, part=part, process=process)
    if part is not None:
        problems.append(Problem("part", f"part = {shown(spec.part)} has changed since the spec was read; run the command again"))
    return spec, None


def _avoid_problems(spec: TapeSpec, avoid: Sequence[Tape]) -> list[Problem]:
    """Problems of `avoid`: an origin given where one is to be chosen, and tapes that no decoder can use with the new one."""
    found = []
    if avoid and has_plane(spec.code) and spec.origin != BEST:
        message = f"origin = {list(spec.origin)} contradicts avoid, which chooses the origin; "
        found.append(Problem("origin", f"{message}give --origin best, or leave --origin out", needs=("code",)))
    if other := [tape for tape in avoid if tape.directions != spec.directions]:
        message = f"avoid: the parts of {other[0].name} point in {other[0].directions} directions, those of this tape in "
        message += f"{spec.directions}: one decoder cannot take both, and there is nothing to avoid; leave it out"
        found.append(Problem("avoid", message, needs=("directions",)))
    return found


# Tape, layers and rules


def _free_sector(spec: TapeSpec, profiles: Profiles, avoid: Sequence[Tape]) -> int:
    """The sector farthest from tapes to avoid, for a tape of this spec; its grid is the same in every sector.

    For a code without a plane this is any sector that is neither theirs nor an id of their tags.
    """
    if not has_plane(spec.code):
        used = {t.sector for t in avoid if t.code == spec.code} | {t.tag.id for t in avoid if t.tag is not None}
        # the smallest unused number, which is at most the count of used ones
        return min(set(range(len(used) + 1)) - used)
    return choose_sector(get_plane(spec.code), profiles.plan(spec).placed, avoid)


def _planned(
    spec: TapeSpec, profiles: Profiles, avoid: Sequence[Tape], problems: list[Problem]
) -> tuple[TapeSpec, Tape | None, Choice | None]:
    """The tape, at the best origin if asked for, and the result of that search.

    If no tape can be made, the rules are measured on a substitute with the same elements and directions, or of the default code,
    and a board that is large enough.
    """
    try:
        tape = profiles.plan(spec, None if problems else avoid)  # a refused tape is not designed
        if spec.origin != BEST or problems:
            return spec, tape, None
        choice = choose_origin(get_plane(spec.code), spec.sector, tape.placed, avoid)
        spec = spec.with_values(origin=choice.origin)
        return spec, profiles.plan(spec), choice
    except SpecError as error:
        problems += independent(error.problems, problems)
        refused = {problem.root for problem in error.problems}
    # refused keys of the board are replaced by values that are always valid; the others stay
    board = {"holes_mm": (), "corner_radius_mm": 0.0, "size_mm": DEFAULT_SIZE_MM}
    board = board if "size_mm" in refused else {key: value for key, value in board.items() if key in refused}
    spec = spec.with_values(**board, sector=0, origin=(0, 0))
    spec = spec.with_values(size_mm=profiles.size_mm(spec)) if "size_mm" in refused else spec
    # the tag may be too near to straight sides, the board too large for a designed code
    for without in ({}, {"tag": "none", "tag_id": None}, {"code": DEFAULT_CODE, "directions": USUAL_DIRECTIONS}):
        other = spec.with_values(**without)
        substitute = tried(partial(profiles.plan, other, None), [])
        if substitute is not None:
            return other, substitute, None
    return spec, None, None


def _beside(spec: TapeSpec, tape: Tape, profiles: Profiles, avoid: Sequence[Tape]) -> tuple[Finding, ...]:
    """Finding of conflicts with the tapes to avoid that remain at the chosen origin; its remedy gives a sector without."""

    def elsewhere(_: int, sector: int) -> Tape | None:
        if not has_plane(spec.code):
            return None
        other = tried(lambda: choose_origin(get_plane(spec.code), sector, tape.placed, avoid), [])
        return None if other is None else of_sector(spec.with_values(origin=other.origin), profiles.plan, sector)

    def remedy(found: Sequence[Conflict]) -> str:
        own = [replace(conflict, tapes=(conflict.tapes[1], 0)) for conflict in found[:1]]
        sectors = other_sectors([tape, *avoid], own, elsewhere, tries=_SECTORS_BESIDE)
        return f"use --sector {sectors[0]}" if sectors else "leave out --sector, or use a smaller --size"

    return together_findings([tape, *avoid], remedy, new=1)


def _measured(
    spec: TapeSpec, tape: Tape, profiles: Profiles, problems: list[Problem], *, resized: bool
) -> tuple[Film | None, list[Finding]]:
    """The film's layers, and every rule. Reasons why the solid models cannot be built are added to `problems`, except those of
    the size if the board is a substitute (`resized`).
    """
    fab, part, process, form = profiles.fab, profiles.part, profiles.process, spec.form
    drawn = drawn_form(spec, tape)
    of_form = [] if drawn is None else form_problems(tape, drawn)
    film = None
    if isinstance(part, PartProfile):
        assert fab is not None
        film = Film(fab=fab, layout=build_layout(tape, spec, fab, part))
        # the remedy of a refused mesh turns the parts itself, with the W that it needs then
        may_turn = all(problem.root != "anchor" for problem in problems)
        findings = check(film.layout, fab, spec, may_turn=may_turn) + film_findings(film.layout, spec, fab)
        # overlapping bodies have a rule of their own, and necessarily exceed their cells
        findings += [] if _broken(findings, "body-body") else undrawable(of_form, spec, film)
        findings += _corner_findings(tape, form)
        findings += check_models(tape, form, process, spec, part) if form is not None and process is not None else []
        of_form = [problem for problem in of_form if problem.key != "part"]
    else:
        assert form is not None
        assert process is not None
        findings = check_texture(tape, form, process, spec, part)
    if _broken(findings, "hole-hole") or _broken(findings, "hole-edge"):  # told already
        of_form = [problem for problem in of_form if problem not in hole_problems(tape.board)]
    # the keys on which a problem of the models depends: it is dropped if one of these was refused
    needs: dict[str, tuple[str, ...]] = {"part": ELEMENT_KEYS, "holes_mm": (), "rotation_deg": ()}
    refused = [*problems, *([Problem("size_mm", "")] if resized else [])]
    problems += independent([replace(p, needs=needs.get(p.key, _FORM_KEYS)) for p in of_form], refused)
    return film, findings


def _broken(findings: Sequence[Finding], rule: str) -> bool:
    return any(f.rule == rule and f.blocks for f in findings)


def drawn_form(spec: TapeSpec, tape: Tape) -> SolidForm | None:
    """Form of the solid models, or that of the flat film for simulators; None if the kit has neither."""
    return spec.form or (SolidForm(base_mm=tape.board.thickness_mm) if spec.sim else None)


def undrawable(problems: Sequence[Problem], spec: TapeSpec, film: Film) -> list[Finding]:
    """Findings for parts that a fab can place but that are too large for the cells of the models."""
    found = []
    for problem in (p for p in problems if p.key == "part"):
        words = film_remedy(spec, film.fab, film.layout.part).words() or "use a smaller part"
        without = ", or leave out --sim" if spec.form is None else ""
        # beside options of the models or assets of them, --no-3d alone would be refused, or be of no use
        if spec.form == SolidForm() and not spec.sim and spec.process is None:
            without = ", or --no-3d"
        message = f"{problem.message.rpartition('; ')[0]}; {words}{without}"
        found.append(Finding(rule="models", level="block", passed=False, unit="", message=message))
    return found


def _corner_findings(tape: Tape, form: SolidForm | None) -> list[Finding]:
    radius_mm = tape.board.corner_radius_mm
    if form is None or form.cylinder is None or radius_mm == 0.0:
        return []
    message = f"the film's corners have a radius of {radius_mm:g} mm, those of the wrapped models are square"
    return [Finding(rule="model-corner", level="info", passed=False, value=0.0, limit=radius_mm, message=message)]


def _origin_findings(tape: Tape, *, searched: bool) -> list[Finding]:
    """Warning if this tape overlaps the sector's tape at the default origin, which others may have."""
    u, v = default_origin(tape.code, tape.sector)
    column, row = tape.origin[0] - u, tape.origin[1] - v
    if column == row == 0 or get_code(tape.code).sequences is None:
        return []
    columns, rows = max(DEFAULT_GRID[0], tape.columns), max(DEFAULT_GRID[1], tape.rows)  # the size that decode assumes
    if not (-tape.columns < column < columns and -tape.rows < row < rows):
        return []
    # a search takes such an origin only where the plane has no other that it looks at
    remedy = "use a smaller --size" if searched else "leave out --origin, or use --origin best"
    message = (
        f"origin = {list(tape.origin)} shows a part of what the default tape of sector {tape.sector} shows, at {[u, v]}: no "
        f"touch there tells which it is, and decode refuses it but with --world closed; {remedy}"
    )
    return [Finding(rule="origin", level="warn", passed=False, unit="", message=message)]


def _window_findings(certificate: Certificate, *, searched: bool) -> list[Finding]:
    """Warning if 4x4 windows are equal, so that a contact which shows no more cannot tell these places apart."""
    # 4 x 4 is the window that the paper decodes (section III-A.4)
    size = certificate.of_side(4)
    if size.distance != 0:
        return []
    count = f"{size.pairs} pair{'s' * (size.pairs != 1)} of 4x4 windows read{'s' * (size.pairs == 1)} the same"
    enough = certificate.distinct_side
    contact = "larger contacts" if enough is None else f"contacts of at least {enough} x {enough} parts"
    # the best origin was searched for already: the search would find it again
    remedy = "a smaller --size" if searched else get_code(certificate.tape.code).another
    message = f"{count}, first {pair_words(certificate.tape, size, 0)}; rely on {contact}, or use {remedy}"
    return [Finding(rule="windows", level="warn", passed=False, unit="", message=message)]
