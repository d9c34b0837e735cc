"""Coupon: a small panel of tapes that differ in W, Δ, coverlay and anchor, whose order shows what a fab can make.

Some of its tapes break limits of the profile on purpose: those that come back whole move the limit, with a date.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil

from tactape_fab.base.errors import Finding, Problem, SpecError, refuse
from tactape_fab.base.fields import Fields
from tactape_fab.kit.examine.order import ExaminedPanel, without_remedy
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.film.anchors import Placing
from tactape_fab.kit.panel.packing import misfit, pack_panels
from tactape_fab.kit.profiles import FabProfile, PartProfile, load_fab, read_part
from tactape_fab.kit.profiles.confirm import CONFIRMABLE, Trial
from tactape_fab.kit.rules.remedies import film_pitch_mm
from tactape_fab.kit.spec.options import DEFAULT_ROTATION_DEG
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.code import DEFAULT_CODE, get_code
from tactape_fab.texture.tape import NEW_NAME_PATTERN, NEW_NAME_REMEDY

TAPE_MM = (24.0, 24.0)
"""Outline of a tape: nine fit on a panel of 98 x 98 mm, and each has room for a contact of 11 x 9 mm and its printed sector."""
SHARES_OF_LIMIT = (1.0, 0.7, 0.4, 0.2)
"""Widths of coverlay bridges that are tried, as fractions of the profile's limit."""
_PART, _DISPLACEMENT_MM, _SMALL_MM = "r0201", 0.25, 0.16
_MOST_OF_NAME = 50
"""Most characters of the fab's name in the name of its coupon."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Wanted:
    """A tape of the coupon: what it tests, at which value, and how it is made."""

    tests: str
    value_mm: float | None
    pitch_mm: float
    displacement_mm: float
    coverlay: str
    anchor: str = "none"


def examine_coupon(fab_name: str, first_sector: int = 0, name: str | None = None) -> ExaminedPanel:
    """The coupon of a fab profile, with a `Trial` for each of its tapes.

    fab_name: A profile, or its file.
    first_sector: Sector of the first tape; the others follow.
    Raises SpecError if there is no such profile, or the sectors do not exist.
    """
    fab, part = load_fab(fab_name), read_part(_PART)
    assert isinstance(part, PartProfile)
    wanted = list(_wanted(fab, part))
    last = get_code(DEFAULT_CODE).sectors - len(wanted)
    if not 0 <= first_sector <= last:
        ends = f"{first_sector} to {first_sector + len(wanted) - 1}"
        message = f"first_sector = {first_sector}: its {len(wanted)} tapes need sectors {ends}; "
        raise SpecError(Problem("first_sector", message + f"use --first-sector 0 to {last}"))
    if misfit(TAPE_MM, fab) is not None:
        message = (
            f"fab = '{fab.name}' takes panels of up to {_size(fab.largest_panel_mm)}, whose rails leave no room for a tape of "
        )
        raise SpecError(Problem("fab", f"{message}{_size(TAPE_MM)}; order a tape without a coupon"))
    table = Fields({"name": _usual_name(fab) if name is None else name})
    name = table.text("name", pattern=NEW_NAME_PATTERN, remedy=NEW_NAME_REMEDY)
    refuse(table.problems)
    tapes = tuple(_examined(fab_name, sector, trial) for sector, trial in enumerate(wanted, start=first_sector))
    # the first sheet is the fullest; tapes that do not fit on it are left out, which a remark says
    _, (packed, *others) = pack_panels([(TAPE_MM, tape.tape.board.corner_radius_mm) for tape in tapes], fab)
    trials = tuple(
        Trial(
            sector=tapes[i].tape.sector,
            tests=wanted[i].tests,
            value_mm=wanted[i].value_mm,
            coverlay=wanted[i].coverlay,
            measured_mm=_measured(tapes[i].findings),
        )
        for i in packed.tapes
    )
    return ExaminedPanel(
        name=name,
        tapes=tuple(tapes[i] for i in packed.tapes),
        panel=packed.panel,
        remarks=tuple(_left_out([wanted[i] for other in others for i in other.tapes], len(wanted), fab)),
        trials=trials,
    )


def _examined(fab_name: str, sector: int, trial: _Wanted) -> Examined:
    spec = TapeSpec(
        sector=sector,
        name=f"coupon-s{sector:03d}",
        fab=fab_name,
        size_mm=TAPE_MM,
        pitch_mm=trial.pitch_mm,
        displacement_mm=trial.displacement_mm,
        coverlay=trial.coverlay,
        anchor=trial.anchor,
        models=False,
    )
    try:
        return examine(spec)
    except SpecError as error:
        # the remedies are options of make, which a coupon does not have
        why = "; ".join(without_remedy(problem.message) for problem in error.problems)
        message = f"fab = '{fab_name}' has limits that no tape of {_size(TAPE_MM)} keeps: {why}; order a tape without a coupon"
        raise SpecError(Problem("fab", message)) from None


def _usual_name(fab: FabProfile) -> str:
    """The default name of a coupon: that of its fab, with hyphens for characters that names of tapes must not have."""
    stem = re.sub(r"[^A-Za-z0-9._]+", "-", fab.name)[:_MOST_OF_NAME].strip("._-")
    return f"{stem}-coupon" if stem else "coupon"


def _left_out(wanted: Sequence[_Wanted], count: int, fab: FabProfile) -> Iterator[str]:
    """Remarks on tapes that do not fit on the largest panel."""
    if wanted:
        tests = ", ".join(one.tests if one.value_mm is None else f"{one.tests} {one.value_mm:g} mm" for one in wanted)
        holds = f"holds {count - len(wanted)} of {count} tapes"
        yield f"warning: {_size(fab.largest_panel_mm)}, the largest panel of {fab.name}, {holds}; not on it: {tests}"


def _size(size_mm: tuple[float, float]) -> str:
    return f"{size_mm[0]:g} x {size_mm[1]:g} mm"


def _wanted(fab: FabProfile, part: PartProfile) -> Iterator[_Wanted]:
    """The tapes: bridges down to a fifth of the limit, another Δ, anchors, and one window for all at two Δ."""
    mode = fab.coverlay_modes[0]
    opened = fab.in_mode(mode)
    bridge_mm = fab.limits["opening-bridge"].value_mm

    def pitch_mm(rule: str, limit_mm: float, displacement_mm: float) -> float:
        placing = Placing(rotation_deg=DEFAULT_ROTATION_DEG, displacement_mm=displacement_mm, directions=4)
        found = film_pitch_mm(rule, limit_mm, opened, part, placing)
        assert found is not None, rule  # at 45 degrees spurs and mesh have a pitch
        # rounded up to a micrometre, so that the drawn gap meets the limit; first rounded as in `whole_um_up`
        return ceil(round(found * 1000.0, 3)) / 1000.0

    if mode != "gang":
        for share in SHARES_OF_LIMIT:
            value_mm = round(share * bridge_mm, 3)
            wide_mm = pitch_mm("opening-bridge", value_mm, _DISPLACEMENT_MM)
            yield _Wanted(
                tests="opening-bridge",
                value_mm=value_mm,
                pitch_mm=wide_mm,
                displacement_mm=_DISPLACEMENT_MM,
                coverlay=mode,
            )
        # the same bridge at a smaller Δ: W and Δ differ, the limit does not
        yield _Wanted(
            tests="opening-bridge",
            value_mm=bridge_mm,
            pitch_mm=pitch_mm("opening-bridge", bridge_mm, _SMALL_MM),
            displacement_mm=_SMALL_MM,
            coverlay=mode,
        )
        for anchor in ("spur", "mesh"):
            copper_mm = fab.limits["pad-pad"].value_mm
            # anchors are tested at the full bridge width, so that the anchor is what fails
            wide_mm = max(
                pitch_mm("opening-bridge", bridge_mm, _DISPLACEMENT_MM), pitch_mm(f"anchor-{anchor}", copper_mm, _DISPLACEMENT_MM)
            )
            yield _Wanted(
                tests=f"anchor-{anchor}",
                value_mm=None,
                pitch_mm=wide_mm,
                displacement_mm=_DISPLACEMENT_MM,
                coverlay=mode,
                anchor=anchor,
            )
    if "gang" in fab.coverlay_modes:
        # one window has no bridge to test: the usual grid, and one at a smaller Δ
        for wide_mm, displacement_mm in ((1.5, _DISPLACEMENT_MM), (1.32, _SMALL_MM)):
            yield _Wanted(tests="gang", value_mm=None, pitch_mm=wide_mm, displacement_mm=displacement_mm, coverlay="gang")


def _measured(findings: tuple[Finding, ...]) -> dict[str, float]:
    return {f.rule: round(f.value, 4) for f in findings if f.rule in CONFIRMABLE and f.value is not None}
