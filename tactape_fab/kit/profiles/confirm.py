"""A new fab profile from a returned coupon, with the limits that its tapes confirmed or moved, their source and date."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Problem, SpecError, refuse
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.plain_text import toml_string
from tactape_fab.base.templates import is_profile_file
from tactape_fab.kit.profiles.fabs import FabProfile, load_fab

CONFIRMABLE = ("opening-bridge", "opening-size", "opening-expansion", "pad-pad", "body-body", "courtyard")
"""Limits that a tape which came back whole confirms if its gap was no wider than the limit."""
TESTS = ("opening-bridge", "anchor-spur", "anchor-mesh", "gang")
_MET_MM = 0.0005


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A tape of a coupon: the rule that it tests, the value (None for anchors and one window), and its measured gaps, mm."""

    sector: int
    tests: str
    value_mm: float | None
    coverlay: str
    measured_mm: Mapping[str, float]

    def to_mapping(self) -> dict[str, Any]:
        return asdict(self)


def read_trials(content: Mapping[str, Any]) -> tuple[str, tuple[Trial, ...]]:
    """Fab profile and trials of a coupon, from its panel's manifest. Raises SpecError if it is not a valid one of a coupon."""
    if not isinstance(content.get("coupon"), Mapping):
        raise SpecError(
            Problem("coupon", f"COUPON is {shown(content.get('name'))}, no coupon; give the folder that tactape-fab coupon wrote")
        )
    table = Fields(content).table("coupon", ("fab", "trials"))
    fab, trials = table.text("fab", longest=1000), []
    for i, row in enumerate(table.rows("trials", longest=100)):
        entry = Fields(row if isinstance(row, Mapping) else {}, f"coupon.trials[{i}].", table.problems)
        measured = entry.table("measured_mm", CONFIRMABLE)
        given = entry.values.get("value_mm") is not None
        trials.append(
            Trial(
                sector=entry.integer("sector", low=0, high=1_000_000),
                tests=entry.text("tests", choices=TESTS),
                value_mm=entry.number("value_mm", low=0.0, high=100.0) if given else None,
                coverlay=entry.text("coverlay", longest=20),
                measured_mm={key: measured.number(key, low=-100.0, high=100.0) for key in measured.values},
            )
        )
    refuse(table.problems)
    return fab, tuple(trials)


@dataclass(frozen=True, slots=True, kw_only=True)
class Confirmed:
    """The text of a profile, and a summary of its changes."""

    text: str
    lines: tuple[str, ...]


def confirm(
    fab_name: str, trials: Sequence[Trial], held: Collection[int], failed: Collection[int], *, date: str, source: str, place: Path
) -> Confirmed:
    """A profile that extends that of the coupon's fab with the results of the coupon's tapes.

    held, failed: Sectors of the tapes that came back whole, and of those that did not; all others are ignored.
    date, source: Date, and description of the coupon.
    place: Path of the new profile.
    Raises SpecError if a sector is not the coupon's or is given twice, a narrower bridge held where a wider one failed, or
        nothing held.
    """
    known = {trial.sector for trial in trials}
    problems = []
    for key, sectors in (("held", held), ("failed", failed)):
        if strange := sorted(set(sectors) - known):
            line = (
                f"{key} = {', '.join(map(str, strange))} is no sector of the coupon; give those of {min(known)} to {max(known)}"
            )
            problems.append(Problem(key, line))
    if both := sorted(set(held) & set(failed)):
        problems.append(Problem("held", f"--held and --failed both name sector {', '.join(map(str, both))}; leave it out of one"))
    whole, broken = ([trial for trial in trials if trial.sector in of] for of in (held, failed))
    problems += _contradictions(whole, broken)
    fab = _fab_of(fab_name)
    modes = _modes(fab, whole, broken)
    if not modes or not whole:
        problems.append(Problem("held", "--held: no way to open the coverlay came back whole; ask another fab"))
    refuse(problems)
    origin = f"source = {toml_string(source)}\ndate = {toml_string(date)}\nconfirmed = true\n"
    # a path in a profile is relative to the profile's folder
    extends = os.path.relpath(fab_name, place.parent) if is_profile_file(fab_name) else fab_name
    tables = [
        f"name = {toml_string(place.stem)}\nextends = {toml_string(extends)}\ntitle = {toml_string(fab.title + ', confirmed')}\n"
    ]
    lines = []
    if modes != list(fab.coverlay_modes):
        tables.append(f"[coverlay]\nmodes = [{', '.join(map(toml_string, modes))}]\n")
        lines.append(f"coverlay: {' or '.join(modes)} alone")
    for rule, value_mm in _limits(fab, whole):
        before = fab.limits[rule].value_mm
        tables.append(f"[limits.{rule}]\nvalue_mm = {value_mm:g}\nlevel = {toml_string(fab.limits[rule].level)}\n{origin}")
        moved = f", {before:g} mm before" if abs(before - value_mm) > _MET_MM else ""
        lines.append(f"{rule}: {value_mm:g} mm confirmed{moved}")
    anchors = {trial.tests: trial in whole for trial in (*whole, *broken) if trial.tests.startswith("anchor-")}
    if any(anchors.values()):
        tables.append(f"[anchor]\n{origin}")
    lines += [f"{name.replace('-', ' ')}: {'held' if fine else 'failed: do not order it'}" for name, fine in anchors.items()]
    return Confirmed(text="\n".join(tables), lines=tuple(lines))


def _fab_of(name: str) -> FabProfile:
    """The fab profile of a coupon; a path is relative to the folder in which the coupon was made."""
    if is_profile_file(name) and not os.path.lexists(name):
        message = (
            f"COUPON is of the fab profile {shown_path(Path(name))}, which is not there; run profiles confirm in the folder "
        )
        raise SpecError(Problem("coupon", message + "in which the coupon was made"))
    return load_fab(name)


def _contradictions(whole: Sequence[Trial], broken: Sequence[Trial]) -> Iterator[Problem]:
    """Problems of bridges that held although a wider one failed: one was misjudged, or the fab is not consistent."""
    bridges = [[t for t in of if t.tests == "opening-bridge" and t.value_mm is not None] for of in (whole, broken)]
    for good in bridges[0]:
        for bad in bridges[1]:
            if (bad.value_mm or 0.0) > (good.value_mm or 0.0) + _MET_MM:
                message = (
                    f"--held: sector {good.sector} with bridges of {good.value_mm:g} mm held, but sector {bad.sector} with "
                    f"{bad.value_mm:g} mm failed; look again, or leave both out"
                )
                yield Problem("held", message)


def _modes(fab: FabProfile, whole: Sequence[Trial], broken: Sequence[Trial]) -> list[str]:
    """Coverlay modes of which at least one tape held, or none was tested."""
    kept = []
    for mode in fab.coverlay_modes:
        # anchors may fail for reasons of their own, so they say nothing about the mode
        bridges = [t for t in (*whole, *broken) if t.coverlay == mode and t.tests in ("opening-bridge", "gang")]
        if not bridges or any(t in whole for t in bridges):
            kept.append(str(mode))
    return kept


def _limits(fab: FabProfile, whole: Sequence[Trial]) -> Iterator[tuple[str, float]]:
    """New values of limits: the narrowest gap that came back whole, if no wider than the limit; 0 if courtyards overlap."""
    for rule in CONFIRMABLE:
        values = [
            t.measured_mm[rule]
            for t in whole
            if rule in t.measured_mm and not (rule == "opening-bridge" and t.coverlay == "gang")
        ]
        # a gap wider than the limit does not test it
        if values and min(values) <= fab.limits[rule].value_mm + _MET_MM:
            yield rule, max(round(min(values), 3), 0.0)
