"""Panels: several tapes examined together and made with their kits, in one folder that takes its name when it is verified."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactape_fab.errors import Check, Finding, Problem, SpecError, VerifyError
from tactape_fab.examine_values import examine_values
from tactape_fab.folders import finished
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.drawing import Drawing
from tactape_fab.kit.film_rules import assembly_findings
from tactape_fab.kit.order import panel_order_facts
from tactape_fab.kit.panel import Panel, arrangement_problem, arrangements, choose_arrangement, plan_panel
from tactape_fab.kit.panel_drawing import panel_drawing
from tactape_fab.kit.panel_options import PANEL_KEYS, PanelRequest, read_panel_request
from tactape_fab.kit.render.order_notes import render_order_notes
from tactape_fab.kit.spec import DEFAULT_FAB, TapeSpec
from tactape_fab.kit.writer import PlacedKit, panel_manifest, panel_record, render_all, write_kit
from tactape_fab.make import Examined, examine, forced, refuse_broken, rendered
from tactape_fab.profiles import FabProfile, PartProfile, load_fab, read_part
from tactape_fab.report import add_panel_report, add_report
from tactape_fab.texture.code import limits_of
from tactape_fab.texture.panel import KITS_FOLDER
from tactape_fab.texture.tape import MANIFEST_NAME, Tape


@dataclass(frozen=True, slots=True, kw_only=True)
class ExaminedPanel:
    """A panel with all that follows from its spec before anything is written.

    Attributes
    ----------
    name : str
    tapes : tuple of Examined
        In the order of `panel.offsets_mm`.
    panel : Panel
    request : PanelRequest
    remarks : tuple of str
        What is worth saying aloud: why there is a panel, and copies.
    """

    name: str
    tapes: tuple[Examined, ...]
    panel: Panel
    request: PanelRequest
    remarks: tuple[str, ...]

    @property
    def fab(self) -> FabProfile:
        return self.tapes[0].fab

    @property
    def drawing(self) -> Drawing:
        return panel_drawing(self.name, [tape.drawing for tape in self.tapes], self.panel)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Every design rule once, as its worst tape measures it; what assembly asks is asked of the panel."""
        parts = sum(tape.tape.part_count for tape in self.tapes)
        of_panel = {f.rule: f for f in assembly_findings(self.panel.size_mm, parts, self.fab, "panel")}
        worst: dict[str, Finding] = {}
        for finding in (f for tape in self.tapes for f in tape.findings):
            known = worst.setdefault(finding.rule, finding)
            if (known.passed and not finding.passed) or (known.passed == finding.passed and _tighter(finding, known)):
                worst[finding.rule] = finding
        return tuple({**worst, **of_panel}.values())


def _tighter(a: Finding, b: Finding) -> bool:
    return a.value is not None and b.value is not None and a.limit is not None and abs(a.value - a.limit) < abs(b.value - a.limit)


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelKit:
    """A panel that stands under its name.

    Attributes
    ----------
    path : Path
    name : str
    panel : Panel
    tapes : tuple of Tape
    findings : tuple of Finding
    checks : tuple of Check
        Of the panel and of every kit in it; empty where none was asked for.
    files : dict of str to str
        Role to path of the panel's own files.
    kits : tuple of str
        Folders of the kits, relative to `path`.
    """

    path: Path
    name: str
    panel: Panel
    tapes: tuple[Tape, ...]
    findings: tuple[Finding, ...]
    checks: tuple[Check, ...]
    files: Mapping[str, str]
    kits: tuple[str, ...]


# The door


def examine_order(
    values: Mapping[str, Any], *, output: str | None = None, overwrite: bool = False, avoid: Sequence[Tape] = ()
) -> tuple[Examined | ExaminedPanel, tuple[str, ...]]:
    """Examine untrusted values of a tape, or of a panel where one is asked for or the fab profile puts tapes on panels.

    Returns
    -------
    Examined or ExaminedPanel
    tuple of str
        What is worth saying aloud.

    Raises
    ------
    SpecError
        With every problem, and in `findings` the rules that the remaining values break.
    """
    request, problems = read_panel_request(values)
    tape_values = {key: value for key, value in values.items() if key not in PANEL_KEYS}
    fab, is_film = _film_of(tape_values)
    if request.wished and not is_film:
        message = f"panel = '{values['panel']}' is of films with parts, but part = '{tape_values['part']}' is printed or milled; "
        problems.append(Problem("panel", message + "leave out --panel"))
    by_profile = request.mode is None and is_film and request.sectors is None and fab is not None and fab.panel.make == "auto"
    if not (request.wished or by_profile):
        problems += _without_panel(request, values) if request.mode is None else []
        if request.sectors:
            tape_values = {"sector": request.sectors[0], **tape_values}
        return _with(problems, lambda: examine_values(tape_values, output=output, overwrite=overwrite, avoid=avoid)), ()
    if avoid:
        message = f"avoid = {len(avoid)} tapes cannot be used with a panel; leave --avoid out, or use --panel none"
        problems.append(Problem("avoid", message))
    first = request.sectors[0] if request.sectors else tape_values.get("sector")
    values_of = _Naming(values=tape_values, name=tape_values.get("name"))
    if request.sectors is None and "sectors" in values and "sector" not in tape_values:
        first = 0  # what is wrong with the sectors is among the problems
    place = output if output is not None or not isinstance(first, int) else values_of.panel_name(first)
    base = _with(problems, lambda: examine_values(values_of.of(first), output=place, overwrite=overwrite))
    if base.film is None:
        return base, ()
    size_mm = base.tape.board.size_mm
    if by_profile and not arrangements(size_mm, base.fab):
        remark = f"no panel: tapes of {size_mm[0]:g} x {size_mm[1]:g} mm fit on none that assembly at {base.fab.name} takes"
        return examine_values(tape_values, output=output, overwrite=overwrite, avoid=avoid), (remark,)
    examined = _examine_panel(base, request, values_of, by_profile=by_profile)
    return examined, examined.remarks


def _film_of(values: Mapping[str, Any]) -> tuple[FabProfile | None, bool]:
    """The fab profile that would be taken, None where it cannot be read, and whether the part has lands."""
    try:
        is_film = isinstance(read_part(values.get("part", "r0201")), PartProfile)
    except (SpecError, TypeError, AttributeError):
        is_film = True
    try:
        return load_fab(values.get("fab", DEFAULT_FAB)), is_film
    except (SpecError, TypeError, AttributeError):
        return None, is_film


def _without_panel(request: PanelRequest, values: Mapping[str, Any]) -> list[Problem]:
    """Keys that say something of a panel where none is made."""
    return [
        Problem(key, f"{key} is of a panel, and none is asked for; give --panel, or leave out --{key.replace('_', '-')}")
        for key in PANEL_KEYS[1:]
        if values.get(key) not in (None, False)
    ]


def _with(problems: Sequence[Problem], examination: Callable[[], Examined]) -> Examined:
    """What an examination gives; its problems are listed after those that are known."""
    try:
        examined = examination()
    except SpecError as error:
        if not problems:
            raise
        raise SpecError([*problems, *error.problems], error.findings) from None
    if problems:
        raise SpecError(problems, [f for f in examined.findings if f.blocks])
    return examined


@dataclass(frozen=True, slots=True, kw_only=True)
class _Naming:
    """Values of each tape of a panel, and the panel's name."""

    values: Mapping[str, Any]
    name: Any

    def panel_name(self, first: int) -> str:
        return str(self.name) if self.name is not None else f"tactape-panel-s{first:03d}"

    def of(self, sector: Any, copy: int | None = None) -> dict[str, Any]:
        named = {}
        if isinstance(sector, int) and (self.name is not None or copy is not None):
            stem = self.name if self.name is not None else "tactape"
            named["name"] = f"{stem}-s{sector:03d}" + (f"-{copy}" if copy is not None else "")
        return {**self.values, **({} if sector is None else {"sector": sector}), **named}


def _examine_panel(base: Examined, request: PanelRequest, values_of: _Naming, *, by_profile: bool) -> ExaminedPanel:
    fab, size_mm, first = base.fab, base.tape.board.size_mm, base.tape.sector
    if request.arrangement is not None:
        arrangement = request.arrangement
        if (problem := arrangement_problem(size_mm, arrangement, fab)) is not None:
            raise SpecError(problem, [f for f in base.findings if f.blocks])
    else:
        arrangement = choose_arrangement(size_mm, fab, None if request.sectors is None else len(request.sectors))
    panel = plan_panel(size_mm, base.tape.board.corner_radius_mm, arrangement, request.tabs, fab)
    problems = list(_sector_problems(base, panel, request))
    if panel.count > 1 and values_of.values.get("tag_id") is not None and not request.same_sector:
        message = f"tag_id = {values_of.values['tag_id']} would be that of all {panel.count} tapes; "
        message += "leave out --tag-id, or use --tag none"
        problems.append(Problem("tag_id", message))
    if problems:
        raise SpecError(problems)
    sectors = request.sectors or tuple(first if request.same_sector else first + i for i in range(panel.count))
    copies = request.same_sector and panel.count > 1
    tapes = tuple(
        examine(TapeSpec.from_mapping(values_of.of(sector, i if copies else None))) for i, sector in enumerate(sectors, start=1)
    )
    return ExaminedPanel(
        name=values_of.panel_name(first),
        tapes=tapes,
        panel=panel,
        request=request,
        remarks=tuple(_remarks(panel, sectors, fab, by_profile=by_profile)),
    )


def _sector_problems(base: Examined, panel: Panel, request: PanelRequest) -> list[Problem]:
    if request.sectors is not None or request.same_sector:
        return []
    most, last = limits_of(base.tape.code).sectors, base.tape.sector + panel.count - 1
    if last < most:
        return []
    message = (
        f"sector = {base.tape.sector} on a panel of {panel.count} tapes asks for sectors up to {last}, but code "
        f"'{base.tape.code}' has {most}, up to {most - 1}; use --sector {most - panel.count} or less, or name them with --sectors"
    )
    return [Problem("sector", message)]


def _remarks(panel: Panel, sectors: Sequence[int], fab: FabProfile, *, by_profile: bool) -> list[str]:
    width, height = panel.size_mm
    words = f"panel: {panel.columns} x {panel.rows} tapes, sectors {', '.join(map(str, sectors))}, on {width:g} x {height:g} mm"
    said = []
    if by_profile:
        least, most = fab.panel.smallest_mm, fab.panel.largest_mm
        said.append(
            f"{words}: assembly at {fab.name} takes {least[0]:g} x {least[1]:g} to {most[0]:g} x {most[1]:g} mm with rails; "
            "--panel none makes the tape alone"
        )
    if len(set(sectors)) < len(sectors):
        said.append(
            f"warning: all {len(sectors)} tapes show sector {sectors[0]}: a contact cannot tell one of these copies from another"
        )
    return said


# Making


def make_panel(
    examined: ExaminedPanel,
    path: str | Path | None = None,
    *,
    overwrite: bool = False,
    verify: bool = True,
    force: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> PanelKit:
    """Make a panel: its files, and the whole kit of every tape on it, verified from what was written.

    Parameters are those of `tactape_fab.make.make_examined`.

    Raises
    ------
    SpecError
        When `path` is taken.
    DesignRuleError
        When a rule of the fab profile is broken.
    VerifyError
        When the written files are not what they should be; nothing stands at `path` then.
    """
    target = Path(examined.name if path is None else path)
    findings = examined.findings
    blocking = refuse_broken(findings, examined.tapes[0], target, overwrite=overwrite, force=force)
    with finished(target, "panel", overwrite=overwrite) as folder:
        checks = _write_kits(examined, folder, verify=verify, progress=progress)
        artifacts, content = _write_panel(examined, folder, blocking, progress)
        own: tuple[Check, ...] = ()
        if verify:
            from tactape_fab.verify.panel import verify_panel_folder

            progress("verifying the panel")
            verification = verify_panel_folder(folder / MANIFEST_NAME, quick=True, kits=False)
            verification.raise_if_failed()
            own = verification.checks
        artifacts.append(add_panel_report(folder, content, checks=own, findings=findings))
    return PanelKit(
        path=target,
        name=examined.name,
        panel=examined.panel,
        tapes=tuple(tape.tape for tape in examined.tapes),
        findings=findings,
        checks=(*checks, *own),
        files={a.role: a.path for a in artifacts},
        kits=tuple(_kit_folder(tape) for tape in examined.tapes),
    )


def _kit_folder(tape: Examined) -> str:
    return f"{KITS_FOLDER}/{tape.tape.name}"


def _write_kits(examined: ExaminedPanel, folder: Path, *, verify: bool, progress: Callable[[str], None]) -> list[Check]:
    """The kit of every tape, whole; each is verified before the next is begun."""
    checks: list[Check] = []
    for number, tape in enumerate(examined.tapes, start=1):
        progress(f"tape {number} of {len(examined.tapes)}")
        artifacts, content = rendered(tape)
        if blocking := [finding for finding in tape.findings if finding.blocks]:
            content["forced"] = [forced(finding) for finding in blocking]
        place = folder / _kit_folder(tape)
        place.mkdir(parents=True)
        write_kit(place, content, artifacts)
        verified: tuple[Check, ...] = ()
        if verify:
            from tactape_fab.verify import verify_folder

            verification = verify_folder(place / MANIFEST_NAME, quick=True)
            if not verification.passed:
                raise VerifyError([c for c in verification.checks if not c.passed])
            verified = verification.checks
        add_report(place, content, tape.tape, checks=verified, findings=tape.findings)
        checks += verified
    return checks


def _write_panel(
    examined: ExaminedPanel, folder: Path, blocking: Sequence[Finding], progress: Callable[[str], None]
) -> tuple[list[Artifact], dict[str, Any]]:
    """The panel's own files, and what its manifest holds."""
    progress("rendering the panel")
    first, film = examined.tapes[0], examined.tapes[0].film
    assert film is not None
    artifacts = render_all(examined.drawing, film.fab)
    layouts = [tape.layout for tape in examined.tapes]
    facts = panel_order_facts(examined.name, examined.panel, layouts, film.fab, examined.findings, artifacts)
    artifacts += render_order_notes(facts)
    kits = []
    number = 1
    for tape, offset_mm in zip(examined.tapes, examined.panel.offsets_mm, strict=True):
        path = f"{_kit_folder(tape)}/{MANIFEST_NAME}"
        kits.append(
            PlacedKit(tape=tape.tape, manifest=path, data=(folder / path).read_bytes(), offset_mm=offset_mm, first=number)
        )
        number += tape.tape.part_count
    record = panel_record(film.layout, first.spec, film.fab)
    content = panel_manifest(examined.name, examined.panel, kits, record, artifacts)
    if blocking:
        content["forced"] = [forced(finding) for finding in blocking]
    write_kit(folder, content, artifacts)
    return artifacts, content
