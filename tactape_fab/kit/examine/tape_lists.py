"""Examination of lists of tapes: every tape is examined before anything is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import DesignRuleError, Finding, Problem, SpecError, reason_of, tried
from tactape_fab.base.fields import named, shown_path
from tactape_fab.base.given_path import as_path
from tactape_fab.base.given_value import refuse_other
from tactape_fab.base.input_file import mode_of
from tactape_fab.base.pool import Workers, checked_workers
from tactape_fab.kit.examine.tape import Examined, Profiles, examine
from tactape_fab.kit.examine.together import apart, of_sector, other_sectors, sector_words, together_findings, too_many
from tactape_fab.kit.output_place import Overwrite, refuse_taken
from tactape_fab.kit.panel.packing import misfit
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.rules.film_rules import OF_ASSEMBLY
from tactape_fab.kit.spec.grid_options import BEST
from tactape_fab.kit.spec.tape_list import TapeEntry, read_list
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.certify.origin import choose_origin
from tactape_fab.texture.certify.pairs import Conflict
from tactape_fab.texture.code import get_plane, has_plane
from tactape_fab.texture.manifest import MANIFEST_NAME
from tactape_fab.texture.tape import Tape

_NAMED = 5
"""Most tapes refused for one reason that a message names; the others are counted."""
_MOST_SEARCHED = 24
"""Most tapes of a list whose best origins are searched before they are made; each takes a quarter of a second."""
_OF_THE_TAPE = ("sector", "origin", "name", "tag_id")
"""Keys whose problems are reported for each tape; those of any other key are reported once per table."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Planned:
    """One tape of a list that can be made; `fab` is its film's fab, None for solid elements."""

    spec: TapeSpec
    fab: FabProfile | None

    @property
    def texture(self) -> tuple[object, ...]:
        """Key that is equal for two tapes which cannot be told apart."""
        spec = self.spec
        size_mm = None if has_plane(spec.code) else spec.size_mm  # another size, another design
        return spec.code, spec.directions, spec.sector, spec.origin, spec.pitch_mm, spec.displacement_mm, size_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class Listed:
    """All tapes of a list, the workers, and the findings, once for all tapes that differ only in sector."""

    tapes: tuple[Planned, ...]
    findings: tuple[Finding, ...]
    workers: Workers


def list_tapes(
    values: Mapping[str, Any],
    options: Mapping[str, Any],
    folder: Path,
    *,
    workers: object = None,
    overwrite: Overwrite = False,
    force: bool = False,
    packed: bool = False,
) -> Listed:
    """Check a list of tapes as a whole; nothing is written.

    Every value and every path is checked, the fab's rules once for all tapes that differ only in sector.

    Parameters
    ----------
    values, options : mapping
        Values of the spec file, and options, which override them; untrusted.
    folder : Path
        Folder for the kits.
    workers : object
        Number of processes or address of a Dask scheduler, untrusted; None for the number of processors.
    overwrite : bool or "edits"
    force : bool
        As for `make_kit`.
    packed : bool
        Whether the tapes are packed on panels, whose size they must fit.

    Returns
    -------
    Listed
        ``tapes``, ``findings`` and ``workers``, as `make_kits` takes them.

    Raises
    ------
    SpecError
        With every problem and every broken rule.
    DesignRuleError
        If there are only broken rules, and not `force`.
    """
    refuse_other(values, Mapping, "values", "mapping", 'the values of a spec file, such as {"sectors": "0-9"}')
    refuse_other(options, Mapping, "options", "mapping", "the options that override them, or {}")
    folder = as_path(folder, "folder", "the folder for the kits")
    of_workers: list[Problem] = []
    chosen = checked_workers(workers, of_workers)
    for key, flag in (("force", force), ("packed", packed)):
        refuse_other(flag, bool, key, "bool", "True or False")
    entries, of_list = read_list(values, options)
    tally = _Tally(packed=packed)
    for entry in entries:
        tally.take(entry)
    of_folder = _folder_problems(folder)
    problems = [*of_workers, *of_folder, *of_list, *tally.problems()]
    if not of_list:  # otherwise some of the tapes are substitutes
        problems += _shared_names(tally.tapes)
        problems += [] if of_folder or packed else _taken(tally.tapes, folder, overwrite=overwrite)
    broken = [finding for finding in tally.findings if finding.blocks]
    if problems:
        raise SpecError(problems, [replace(finding, at_mm=None) for finding in broken])
    if broken and not force:
        raise DesignRuleError(broken)
    # a list with refused or undesigned tapes is not compared: substitutes would conflict with each other
    together = () if len(tally.drawn) < len(tally.tapes) else _together(tally, by_table="tapes" in values)
    # the assembly line handles the panels, on which these are measured
    of_tapes = [finding for finding in tally.findings if not (packed and finding.rule in OF_ASSEMBLY)]
    return Listed(tapes=tuple(tally.tapes), findings=(*of_tapes, *_copies(tally.tapes), *together), workers=chosen)


def _together(tally: _Tally, *, by_table: bool) -> tuple[Finding, ...]:
    """Finding of conflicts between tapes of a list; its remedy gives sectors or ``--origin best`` if that resolves them."""
    if len(tally.drawn) > _MOST_SEARCHED and any(drawn.spec.origin == BEST for drawn in tally.drawn):
        return (too_many(len(tally.drawn)),)
    tapes = [drawn.tape() for drawn in tally.drawn]

    def remedy(found: Sequence[Conflict]) -> str:
        sectors = other_sectors(tapes, found, lambda i, sector: tally.drawn[i].of_sector(sector))
        ways = []
        if sectors and by_table:
            moved = [(tape.name, s) for tape, s in zip(tapes, sectors, strict=True) if tape.sector != s]
            ways.append(", ".join(f"sector = {sector} for {name}" for name, sector in moved))
        elif sectors:
            ways.append(f"--sectors {sector_words(sectors)}")
        if len(tapes) <= _MOST_SEARCHED and all(drawn.spec.origin != BEST for drawn in tally.drawn):
            searched = [drawn.of_origin() for drawn in tally.drawn]
            if apart([tape for tape in searched if tape is not None]) and None not in searched:
                ways.append("--origin best")
        return "use " + ", or ".join(ways) if ways else "make one of them alone, with --avoid and the folder of the others"

    return together_findings(tapes, remedy, copies=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Drawn:
    """A tape of a list; it is planned at the default origin if the best one is still to be searched for."""

    spec: TapeSpec
    profiles: Profiles
    planned: Tape

    def tape(self) -> Tape:
        """The tape, at the best origin if it is asked for."""
        return self.planned if self.spec.origin != BEST else self.of_origin() or self.planned

    def of_sector(self, sector: int) -> Tape | None:
        """The same tape with another sector."""
        return of_sector(self.spec, self.profiles.plan, sector)

    def of_origin(self) -> Tape | None:
        """The same tape at the best origin."""
        spec, placed = self.spec, self.planned.placed
        choice = tried(lambda: choose_origin(get_plane(spec.code), spec.sector, placed), [])
        return None if choice is None else tried(lambda: self.profiles.plan(spec.with_values(origin=choice.origin)), [])


@dataclass(slots=True, kw_only=True)
class _Kind:
    """Tapes that differ only in sector and name: the rules are measured on the first one that passed.

    ``refusal`` is the problem shared by all of them; ``tables`` are the tables for which it has been reported.
    """

    examined: Examined | None = None
    refusal: list[Problem] = field(default_factory=list)
    findings: tuple[Finding, ...] = ()
    tables: set[str] = field(default_factory=set)


class _Tally:
    """Examines tape by tape and collects every problem."""

    def __init__(self, *, packed: bool) -> None:
        self.packed = packed
        self.tapes: list[Planned] = []
        self.drawn: list[_Drawn] = []
        self.findings: list[Finding] = []
        self._kinds: dict[str, _Kind] = {}
        self._problems: dict[tuple[str, str], dict[str, Problem]] = {}

    def take(self, entry: TapeEntry) -> None:
        alike = {key: value for key, value in entry.values.items() if key not in ("sector", "name")}
        kind = self._kinds.setdefault(repr(sorted(alike.items(), key=lambda item: str(item[0]))), _Kind())
        if kind.examined is None and not kind.refusal:
            self._first(entry, kind)
        else:
            self._another(entry, kind)
        if entry.where not in kind.tables:
            kind.tables.add(entry.where)
            # for a kind that occurs in several tables, remarks are reported once, broken rules once per table
            reported = [finding for finding in kind.findings if finding.blocks or len(kind.tables) == 1]
            self.findings += [replace(finding, message=entry.where + finding.message) for finding in reported]
            self._refuse(entry, kind.refusal)

    def _first(self, entry: TapeEntry, kind: _Kind) -> None:
        try:
            kind.examined = examine(entry.values)
        except SpecError as error:
            kind.findings = error.findings
            kind.refusal = [problem for problem in error.problems if problem.root not in _OF_THE_TAPE]
            self._refuse(entry, error.problems)
            return
        kind.findings = kind.examined.findings
        kind.refusal = _unpackable(kind.examined) if self.packed else []
        self._pass(kind.examined.spec, kind.examined, kind.examined.tape)

    def _another(self, entry: TapeEntry, kind: _Kind) -> None:
        try:
            spec = TapeSpec.from_mapping(entry.values)
            if kind.examined is not None:
                if has_plane(spec.code):  # a design takes seconds, and nothing else could fail with another sector
                    self._pass(spec, kind.examined, kind.examined.profiles.plan(spec))
                else:
                    self._pass(spec, kind.examined, None)
        except SpecError as error:
            self._refuse(entry, [problem for problem in error.problems if problem not in kind.refusal])

    def _pass(self, spec: TapeSpec, examined: Examined, tape: Tape | None) -> None:
        if tape is not None:
            self.drawn.append(_Drawn(spec=spec, profiles=examined.profiles, planned=replace(tape, name=spec.name)))
        # as it was asked for: a kit whose origin was given records no search for it
        asked = spec if examined.search is None else spec.with_values(origin=BEST)
        self.tapes.append(Planned(spec=asked, fab=None if examined.film is None else examined.fab))

    def _refuse(self, entry: TapeEntry, problems: Sequence[Problem]) -> None:
        for problem in problems:
            own = entry.of_sector if problem.root in _OF_THE_TAPE else ""
            message = entry.where + own + problem.message
            # problems of one key that differ only in the sector are grouped, so that `problems` can count them
            kept = self._problems.setdefault((entry.where, problem.root if own else message), {})
            kept[message] = Problem(problem.key, message)

    def problems(self) -> list[Problem]:
        """Every problem; of many tapes with the same refused key only the first few are named."""
        named: list[Problem] = []
        for (where, key), kept in self._problems.items():
            several = list(kept.values())
            named += several[:_NAMED]
            if len(several) > _NAMED:
                message = f"{where}{len(several) - _NAMED} more sectors are refused for their {key}; give fewer of them"
                named.append(Problem(key, message))
        return named


def _unpackable(examined: Examined) -> list[Problem]:
    if examined.film is None:
        message = f"part = {examined.spec.part!r} makes no film that could be packed into panels; leave --pack out"
        return [Problem("part", message)]
    problem = misfit(examined.spec.size_mm, examined.fab)
    return [] if problem is None else [problem]


def _folder_problems(folder: Path) -> list[Problem]:
    """Reasons why a folder cannot hold kits."""
    shown, remedy = shown_path(folder), "use -o to name another folder"
    try:
        there = mode_of(folder) is not None
        if (folder / MANIFEST_NAME).exists():
            return [Problem("output", f"output = {shown} is a kit, which holds no other kits; {remedy}")]
        if there and not folder.is_dir():
            return [Problem("output", f"output = {shown} exists and is not a folder; nothing was touched; {remedy}")]
    except (OSError, ValueError) as error:  # a name that is invalid on every system
        return [Problem("output", f"output = {shown} cannot be a folder: {reason_of(error)}; {remedy}")]
    return []


def _shared_names(tapes: Sequence[Planned]) -> list[Problem]:
    names = [tape.spec.name for tape in tapes]
    return [
        Problem("name", f"name = '{name}' is that of {count} tapes of the list; give each a name of its own, or another sector")
        for name in dict.fromkeys(names)
        if (count := names.count(name)) > 1
    ]


def _taken(tapes: Sequence[Planned], folder: Path, *, overwrite: Overwrite) -> list[Problem]:
    """Problems of the kits' paths; all older kits are reported in one problem."""
    problems: list[Problem] = []
    older: list[str] = []
    for name in dict.fromkeys(tape.spec.name for tape in tapes):
        try:
            refuse_taken(folder / name, overwrite=overwrite)
        except SpecError:
            try:
                # refused even with --overwrite: not a kit of this tool, or an edited one
                refuse_taken(folder / name, overwrite=True)
                older.append(name)
            except SpecError as error:  # not ours, or edited
                problems += error.problems
    if older:
        message = (
            f"output = {shown_path(folder)} holds {named(older)} already; use --overwrite to replace kits, "
            "or -o to name another folder"
        )
        problems.append(Problem("output", message))
    return problems


def _copies(tapes: Sequence[Planned]) -> list[Finding]:
    """Warning for tapes that no decoder can tell apart."""
    ordered = sorted(tapes, key=lambda tape: repr(tape.texture))
    found = []
    for _, group in groupby(ordered, key=lambda tape: tape.texture):
        names = [tape.spec.name for tape in group]
        if len(names) > 1:
            message = f"{', '.join(names)} show the same texture and cannot be told apart; give each another sector or origin"
            found.append(Finding(rule="copies", level="warn", passed=False, unit="", message=message))
    return found
