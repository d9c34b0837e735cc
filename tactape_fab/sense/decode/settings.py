"""Checks of `Localizer`'s settings and tapes together: out of range, without effect beside others, or not for one decoder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args

from tactape_fab.base.errors import Problem
from tactape_fab.base.fields import Fields, shown
from tactape_fab.sense.decode.result import Refined
from tactape_fab.sense.decode.rule import KAPPA, MAX_P_FALSE, UNREGISTERED_SHARE
from tactape_fab.texture.code import has_plane
from tactape_fab.texture.tape import Tape

World = Literal["open", "closed"]
Method = Literal["ml", "paper"]

USUAL: Mapping[str, Any] = {
    "method": "ml",
    "max_p_false": MAX_P_FALSE,
    "max_p_tape": None,
    "world": "open",
    "unregistered_share": UNREGISTERED_SHARE,
    "kappa": KAPPA,
    "fixed_scale": False,
    "refine": None,
}
"""All settings with their defaults."""
_LEAST_SHARE = 1e-300
_SHARES = ("max_p_false", "max_p_tape", "unregistered_share")
_OF_TAPES = ("world", "max_p_tape", "unregistered_share", "refine")


def given_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Those of some settings that differ from their defaults."""
    return {name: value for name, value in settings.items() if not (type(value) is type(USUAL[name]) and value == USUAL[name])}


def setting_problems(given: Mapping[str, Any], *, code: str | None = None) -> list[Problem]:
    """Problems of settings that are given, by their names.

    code: The code that is searched without tapes.
    """
    table = Fields({"fixed_scale": False, "kappa": KAPPA, **given})
    method, world = table.choice("method", get_args(Method)), table.choice("world", get_args(World))
    table.choice("refine", get_args(Refined))
    for name in (name for name in _SHARES if name in given):
        # the logarithm of a share of a place would be that of zero
        table.number(name, low=_LEAST_SHARE, above=0.0, below=1.0, unit="", remedy="give a probability such as 1e-4")
    table.number("kappa", low=1.0, high=1e300, unit="", remedy="give the least lead over any rival, such as 30")
    table.flag("fixed_scale")
    if method == "paper":
        idle = [name for name in given if name != "method"]
        lacks = "method 'paper' needs tapes, bounds nothing and takes its scale as it is; leave it out, or give method='ml'"
        # who leaves the code out is asked for tapes, or for a code
        kits = lacks.replace("leave it out", "give the kits instead")
        table.problems += [] if code is None else [Problem("code", f"code = {shown(code)}: {kits}")]
    elif code is not None:
        idle = [name for name in given if name in _OF_TAPES]
        lacks = "without tapes every place of the code may be touched, with one bound; leave it out, or give the kits"
    else:
        idle = ["unregistered_share"] if world == "closed" and "unregistered_share" in given else []
        lacks = "in a closed world no unregistered tape is touched; leave it out, or give world='open'"
    table.problems += [Problem(name, f"{name} = {shown(given[name])}: {lacks}") for name in idle if not table.refused(name)]
    return table.problems


def tape_problems(tapes: Sequence[Tape], method: object) -> list[Problem]:
    """Problems of tapes that one `Localizer` cannot tell apart, or that the paper's method cannot read."""
    problems = []
    if isinstance(method, str) and method == "paper" and not all(has_plane(tape.code) for tape in tapes):
        from tactape_fab.sense.decode.paper.method import PLANELESS

        problems.append(Problem("method", PLANELESS))
    each = "give those of one kind, and the others in a run, or a Localizer, of their own"
    sizes = sorted({(tape.pitch_mm, tape.displacement_mm) for tape in tapes})
    if len(sizes) > 1:
        designs = ", ".join(f"W {w:g} and Δ {d:g} mm" for w, d in sizes)
        problems.append(Problem("tape", f"the tapes differ in pitch or displacement ({designs}); {each}"))
    if len({tape.directions for tape in tapes}) > 1:
        problems.append(Problem("tape", f"the tapes differ in directions (4 and 8); {each}"))
    return problems
