"""Examination of an order: a tape, or the tapes of a panel."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tactape_fab.base.errors import Finding, Problem, SpecError, independent, refusal, tried
from tactape_fab.base.fields import shown
from tactape_fab.base.given_value import refuse_other
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.examine.together import of_sector, other_sectors, sector_words, together_findings
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.output_place import Overwrite
from tactape_fab.kit.panel.arrange import arrangement_problem, arrangements, choose_arrangement, nearest_arrangement
from tactape_fab.kit.panel.geometry import Panel, Place
from tactape_fab.kit.panel.panel_drawing import panel_drawing
from tactape_fab.kit.panel.tabs_and_marks import plan_panel
from tactape_fab.kit.profiles import FabProfile, load_fab
from tactape_fab.kit.profiles.confirm import Trial
from tactape_fab.kit.rules.film_rules import assembly_findings
from tactape_fab.kit.rules.spacing import size_finding
from tactape_fab.kit.spec.panel_options import PANEL_KEYS, PanelRequest, read_panel_request
from tactape_fab.kit.spec.tape_spec import TapeSpec, read_spec
from tactape_fab.texture.board import TAG_FAMILY, TAG_IDS
from tactape_fab.texture.certify.pairs import Conflict
from tactape_fab.texture.code import get_code
from tactape_fab.texture.tape import Tape, refuse_no_tapes

_REMEDY = re.compile("; use --.*")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExaminedPanel:
    """A panel with everything derived from its spec before anything is written.

    tapes: In the order of `panel.offsets_mm`.
    remarks: Remarks for the user: why there is a panel, and copies of tapes.
    together: Conflicts between tapes of the panel.
    trials: What each tape tests, if the panel is a coupon.
    """

    name: str
    tapes: tuple[Examined, ...]
    panel: Panel
    remarks: tuple[str, ...]
    together: tuple[Finding, ...] = ()
    trials: tuple[Trial, ...] = ()

    @property
    def fab(self) -> FabProfile:
        return self.tapes[0].fab

    @property
    def drawing(self) -> Drawing:
        return panel_drawing(self.name, [tape.drawing for tape in self.tapes], self.panel)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Every design rule once, with the value of its worst tape and the place there; size and assembly are those of the panel.

        Findings of a coupon have no remedy, as no option changes its tapes.
        """
        return self._findings(on_panel=False)

    @property
    def findings_on_panel(self) -> tuple[Finding, ...]:
        """As `findings`, with their places in the panel's frame."""
        return self._findings(on_panel=True)

    def _findings(self, *, on_panel: bool) -> tuple[Finding, ...]:
        parts = sum(tape.tape.part_count for tape in self.tapes)
        # fab and assembly line handle the panel, so number of parts and size are the panel's
        size_mm = self.panel.size_mm
        of_panel = {f.rule: f for f in (size_finding(size_mm, self.fab), *assembly_findings(size_mm, parts, self.fab, "panel"))}
        worst: dict[str, Finding] = {}
        of_tapes = zip(self.tapes, self.panel.places, strict=True)
        for finding in (_on_panel(f, place) if on_panel else f for tape, place in of_tapes for f in tape.findings):
            known = worst.setdefault(finding.rule, finding)
            if (known.passed and not finding.passed) or (known.passed == finding.passed and _worse(finding, known)):
                worst[finding.rule] = finding
        found = (*{**worst, **of_panel}.values(), *self.together)
        return tuple(replace(f, message=without_remedy(f.message)) for f in found) if self.trials else found


def without_remedy(message: str) -> str:
    """A message without the options of `make` at its end."""
    return _REMEDY.sub("", message)


def _on_panel(finding: Finding, place: Place) -> Finding:
    """A tape's finding with its place converted to the panel's frame."""
    if finding.at_mm is None:
        return finding
    return replace(finding, at_mm=place.on_panel_mm(np.array(finding.at_mm)))


def _worse(a: Finding, b: Finding) -> bool:
    """Whether a is worse than b: nearer to its limit if both hold, farther beyond it if both are broken."""
    if a.value is None or a.limit is None or b.value is None or b.limit is None:
        return False
    a_mm, b_mm = abs(a.value - a.limit), abs(b.value - b.limit)
    return a_mm < b_mm if a.passed else a_mm > b_mm


def examine_order(
    values: Mapping[str, Any], *, output: str | None = None, overwrite: Overwrite = False, avoid: Sequence[Tape] = ()
) -> tuple[Examined | ExaminedPanel, tuple[str, ...]]:
    """Examine untrusted values of a tape, or of a panel where one is asked for or the fab profile puts tapes on panels.

    Parameters
    ----------
    values : mapping
        Option names to values, as for `TapeSpec.from_mapping`, and those of a panel; untrusted.
    output : str, optional
        Folder for the result; an existing one is refused together with all other problems.
    overwrite : bool or "edits"
        Whether an older result of this tool there may be replaced.
    avoid : sequence of Tape
        Tapes to choose the origin away from.

    Returns
    -------
    Examined or ExaminedPanel
    tuple of str
        Remarks for the user.

    Raises
    ------
    SpecError
        With every problem, and in `findings` the rules that the remaining values break.
    """
    refuse_other(values, Mapping, "values", "mapping", 'keys and values, such as {"sector": 7}')
    refuse_no_tapes(avoid, "avoid")
    tape_values = {key: value for key, value in values.items() if key not in PANEL_KEYS}
    spec, _ = read_spec({"sector": 0, **tape_values})
    request, problems = read_panel_request(values, films=spec.fab is not None)
    # a fab profile that cannot be read is reported by `examine`
    fab = None if spec.fab is None else tried(lambda: load_fab(str(spec.fab)), [])
    if request.asked_for and spec.fab is None:
        message = f"panel = '{values['panel']}' is of films with parts, but part = '{spec.part}' is printed or milled; "
        problems.append(Problem("panel", message + f"leave out {_listed_options(('panel', *_of_panel_alone(values)))}"))
    by_profile = request.mode is None and fab is not None and fab.panel.make == "auto"
    if not (request.asked_for or by_profile):
        problems += _without_panel(values, films=spec.fab is not None) if request.mode is None else []
        if request.sectors:
            tape_values = {"sector": request.sectors[0], **tape_values}
        return examine(tape_values, output=output, overwrite=overwrite, avoid=avoid, known=problems), ()
    if avoid:
        message = f"avoid = {len(avoid)} tapes cannot be used with a panel; leave --avoid out, or use --panel none"
        problems.append(Problem("avoid", message))
    first = request.sectors[0] if request.sectors else tape_values.get("sector")
    if request.sectors is None and "sectors" in values and "sector" not in tape_values:
        first = 0  # invalid sectors are already among the problems
    base_values = {**tape_values, **({} if first is None else {"sector": first})}
    alone = by_profile and fab is not None and not arrangements(spec.size_mm, fab)
    of_panel = [] if fab is None or alone else _panel_problems(spec, first, request, fab, values)
    try:
        base = examine(base_values, output=output, overwrite=overwrite, known=problems)
    except SpecError as error:
        # the panel reports one tag id for all tapes; the tape's own problem with that id would be a repetition
        of_tape = [p for p in error.problems if p.root != "tag_id" or all(q.root != "tag_id" for q in of_panel)]
        raise refusal([*of_tape, *independent(of_panel, of_tape)], error.findings) from None
    if alone:
        return examine(base_values, output=output, overwrite=overwrite, avoid=avoid), (_no_panel(spec.size_mm, base.fab),)
    if of_panel:
        raise SpecError(of_panel, [f for f in base.findings if f.blocks])
    examined = _examine_panel(base, request, tape_values, by_profile=by_profile)
    return examined, examined.remarks


def takes_panel(values: Mapping[str, Any]) -> tuple[bool, str]:
    """Whether the fab's profile puts the sectors of a list on one panel without --panel; if not, a remark, or "".

    It does if that many tapes fill a panel that fab and assembly accept, as it does for one sector, whose panel is filled with
    the sectors that follow.
    """
    request, problems = read_panel_request(values)
    spec, refused = read_spec({"sector": 0, **{key: value for key, value in values.items() if key not in PANEL_KEYS}})
    fab = None if spec.fab is None else tried(lambda: load_fab(str(spec.fab)), [])
    if problems or refused or request.mode is not None or request.sectors is None or fab is None or fab.panel.make != "auto":
        return False, ""
    fitting = arrangements(spec.size_mm, fab)
    if not fitting:
        return False, _no_panel(spec.size_mm, fab)
    # numbers of tapes that fill a panel, the nearest to the requested one first
    counts = sorted({columns * rows for columns, rows in fitting}, key=lambda n: abs(n - len(request.sectors or ())))
    if len(request.sectors) in counts:
        return True, ""
    width, height = spec.size_mm
    return False, (
        f"no panel: {len(request.sectors)} tapes of {width:g} x {height:g} mm fill none that assembly at {fab.name} takes, but "
        f"{', '.join(map(str, counts[:3]))} do; each is made alone, --pack puts any number on panels"
    )


def _of_panel_alone(values: Mapping[str, Any]) -> tuple[str, ...]:
    """The given keys, other than ``panel`` and ``sectors``, that mean nothing without a panel."""
    return tuple(key for key in ("same_sector", "tabs") if values.get(key) not in (None, False))


def _listed_options(keys: Sequence[str]) -> str:
    *first, last = (f"--{key.replace('_', '-')}" for key in keys)
    return f"{', '.join(first)} and {last}" if first else last


def _no_panel(size_mm: tuple[float, float], fab: FabProfile) -> str:
    return f"no panel: tapes of {size_mm[0]:g} x {size_mm[1]:g} mm fit on none that assembly at {fab.name} takes"


def _without_panel(values: Mapping[str, Any], *, films: bool) -> list[Problem]:
    """Problems of panel options if no panel is made."""
    asked = "give --panel, or " if films else ""
    return [
        Problem(key, f"{key} is of a panel, and none is asked for; {asked}leave out --{key.replace('_', '-')}")
        for key in PANEL_KEYS[1:]
        if values.get(key) not in (None, False)
    ]


def _examine_panel(base: Examined, request: PanelRequest, values: Mapping[str, Any], *, by_profile: bool) -> ExaminedPanel:
    """The panel of tapes with these values, each with its own sector and name."""
    fab, size_mm, first = base.fab, base.tape.board.size_mm, base.tape.sector
    count = None if request.sectors is None else len(request.sectors)
    arrangement = request.arrangement or choose_arrangement(size_mm, fab, count)
    panel = plan_panel(size_mm, base.tape.board.corner_radius_mm, arrangement, request.tabs, fab)
    sectors = request.sectors or tuple(first if request.same_sector else first + i for i in range(panel.count))
    copies = request.same_sector and panel.count > 1
    name = values.get("name")
    stem = "tactape" if name is None else name
    named = [f"{stem}-s{sector:03d}" + f"-{i}" * copies for i, sector in enumerate(sectors, start=1)]
    tapes = tuple(examine({**values, "sector": s, "name": n}) for s, n in zip(sectors, named, strict=True))
    return ExaminedPanel(
        name=f"tactape-panel-s{first:03d}" if name is None else str(name),
        tapes=tapes,
        panel=panel,
        remarks=tuple(_remarks(panel, sectors, fab, by_profile=by_profile, filled=request.sectors is None and not copies)),
        together=() if copies else _together(tapes, named=request.sectors is not None),
    )


def _together(tapes: Sequence[Examined], *, named: bool) -> tuple[Finding, ...]:
    """Finding of conflicts between tapes of a panel; its remedy gives sectors without conflicts."""

    def remedy(found: Sequence[Conflict]) -> str:
        drawn = [tape.tape for tape in tapes]
        sectors = other_sectors(drawn, found, lambda i, sector: of_sector(tapes[i].spec, tapes[i].profiles.plan, sector))
        return f"use --sectors {sector_words(sectors)}" + ("" if named else " in place of --sector") if sectors else ""

    return together_findings([tape.tape for tape in tapes], remedy)


def _panel_problems(
    spec: TapeSpec, first: object, request: PanelRequest, fab: FabProfile, values: Mapping[str, Any]
) -> list[Problem]:
    """Problems of columns and rows, and of sectors and tags of the tapes; with refused columns and rows, those of the remedy."""
    problems: list[Problem] = []
    count = None if request.sectors is None else len(request.sectors)
    arrangement = request.arrangement
    others = _of_panel_alone(values)
    alone = f"--panel none without {_listed_options(others)}" if others else "--panel none"
    if arrangement is None:
        arrangement = tried(lambda: choose_arrangement(spec.size_mm, fab, count, alone), problems)
    elif (problem := arrangement_problem(spec.size_mm, arrangement, fab, count, alone)) is not None:
        problems.append(problem)
        arrangement = nearest_arrangement(spec.size_mm, arrangement, fab)
    elif count not in (None, wanted := arrangement[0] * arrangement[1]):
        filled = any(columns * rows == count for columns, rows in arrangements(spec.size_mm, fab))
        message = (
            f"sectors = {shown(values['sectors'])} names {count} tapes, but panel = {arrangement[0]}x{arrangement[1]} has "
            f"{wanted}; name {wanted}{', or use --panel auto' if filled else ''}"
        )
        problems.append(Problem("sectors", message))
    problems = [replace(problem, needs=("size_mm", "fab")) for problem in problems]
    count = arrangement[0] * arrangement[1] if arrangement is not None and count is None else count
    if count is None or count == 1 or request.same_sector or not isinstance(first, int):
        return problems
    tags = _tag_problems(spec, first, count, request.sectors, values.get("tag_id"))
    return [*problems, *(_sector_problems(spec, first, count) if request.sectors is None else []), *tags]


def _sector_problems(spec: TapeSpec, first: int, count: int) -> list[Problem]:
    most, last = get_code(spec.code).sectors, first + count - 1
    if last < most:
        return []
    message = (
        f"sector = {first} on a panel of {count} tapes asks for sectors up to {last}, but code "
        f"'{spec.code}' has {most}, up to {most - 1}; use --sector {most - count} or less, or name them with --sectors"
    )
    return [Problem("sector", message, needs=("code",))]


def _tag_problems(spec: TapeSpec, first: int, count: int, sectors: Sequence[int] | None, tag_id: object) -> list[Problem]:
    """Problems of one tag id for several tapes, and of sectors that are not tag ids."""
    last = max(sectors) if sectors is not None else first + count - 1
    within = f"name --sectors up to {TAG_IDS - 1}" if sectors is not None else f"use --sector {TAG_IDS - count} or less"
    if tag_id is not None:
        also = f", and {within}, or --tag none" if last >= TAG_IDS else ""  # not alone: an id contradicts it
        message = f"tag_id = {tag_id} would be that of all {count} tapes; leave out --tag-id{also}"
        return [Problem("tag_id", message)]
    if spec.tag == "none" or last < TAG_IDS:
        return []
    asked = "sectors ask" if sectors is not None else f"sector = {first} on a panel of {count} tapes asks"
    message = f"{asked} for tags up to {last}, but the last id of {TAG_FAMILY} is {TAG_IDS - 1}; {within}, or use --tag none"
    return [Problem("tag_id", message, needs=("sector", "code", "tag"))]


def _remarks(panel: Panel, sectors: Sequence[int], fab: FabProfile, *, by_profile: bool, filled: bool) -> list[str]:
    width, height = panel.size_mm
    remarks = []
    if by_profile:
        least, most = fab.panel.smallest_mm, fab.panel.largest_mm
        added = (
            f"{sectors[0]}, and {', '.join(map(str, sectors[1:]))} to fill it"
            if filled and len(sectors) > 1
            else _listed(sectors)
        )
        remarks.append(
            f"panel: assembly at {fab.name} takes {least[0]:g} x {least[1]:g} to {most[0]:g} x {most[1]:g} mm with rails, so "
            f"{panel.words} go on {width:g} x {height:g} mm: sector {added}; "
            f"{'--sectors names others, ' if filled else ''}--panel none makes tapes alone"
        )
    if len(set(sectors)) < len(sectors):
        remarks.append(
            f"warning: all {len(sectors)} tapes show sector {sectors[0]}: a contact cannot tell one of these copies from another"
        )
    return remarks


def _listed(sectors: Sequence[int]) -> str:
    return ", ".join(map(str, dict.fromkeys(sectors)))
