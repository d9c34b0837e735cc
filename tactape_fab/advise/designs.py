"""Candidate designs: the smallest legal pitches of each part, for several ratios of Δ to W.

Closed forms give the least legal pitch; then the rules are measured on a small tape of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import ceil
from shlex import quote

from tactape_fab.base.errors import Finding, SpecError
from tactape_fab.kit.examine.tape import rules_of_parts
from tactape_fab.kit.film.anchors import Placing
from tactape_fab.kit.film.coverlay import worst_box_gap_mm
from tactape_fab.kit.profiles import (
    ElementProfile,
    FabProfile,
    Limit,
    PartProfile,
    ProcessProfile,
    load_fab,
    load_process,
    read_part,
)
from tactape_fab.kit.rules.remedies import cell_pitch_mm, element_pitch_mm, gap_pitch_mm
from tactape_fab.kit.rules.spacing import finding
from tactape_fab.kit.spec.options import DEFAULT_ROTATION_DEG
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.directions import DIRECTIONS, USUAL_DIRECTIONS, Directions
from tactape_fab.texture.tape import DEFAULT_PITCH_MM, PITCH_PER_DISPLACEMENT

FILM = "fpc"
SHARES = (0.14, 1.0 / PITCH_PER_DISPLACEMENT, 0.2)
"""Δ as fractions of W; the first is not used for eight directions, whose places are nearer to each other."""
FILM_PARTS = ("r0201", "r01005")
ELEMENTS = (
    ("block", (0.6, 0.3, 0.23)),
    ("block", (0.4, 0.3, 0.2)),
    ("dome", (0.6, 0.6, 0.23)),
    ("dome", (0.4, 0.4, 0.18)),
)
"""Solid elements that are tried, besides `FILM_PARTS`, with their sizes, mm."""
_STEP_MM = 0.01
_TRIES = 4
_SECANTS = 6
_BOARD_MM, _BOARD_PITCHES, _EDGE_MM = 15.0, 8.0, 1.0
"""Size of the small tape on which rules are measured, in which every pair of symbols is adjacent somewhere."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Design:
    """A design: W, Δ, part, and coverlay mode; ``warnings`` are the rules that give warnings.

    ``coverlay`` and ``fab`` are None for solid elements, ``process`` is None for parts with lands, ``body_mm`` if it is the
    profile's. Eight directions are proposed only for solid elements.
    """

    part: str
    shape: str
    body_mm: tuple[float, float, float]
    pitch_mm: float
    displacement_mm: float
    coverlay: str | None = None
    fab: str | None = None
    process: str | None = None
    warnings: tuple[str, ...] = ()
    directions: int = USUAL_DIRECTIONS
    anchor: str = "none"

    @property
    def points_in(self) -> Directions:
        return DIRECTIONS[self.directions]

    def spec(self, size_mm: tuple[float, float], **more: object) -> TapeSpec:
        """Spec of a tape of the design, by default with four directions, as designing a tape of eight takes seconds."""
        values: dict[str, object] = {"part": self.part, "pitch_mm": self.pitch_mm, "displacement_mm": self.displacement_mm}
        if self.fab is not None:
            values |= {"fab": self.fab, "coverlay": self.coverlay, "anchor": self.anchor}
        else:
            values |= {"process": self.process, "body_mm": self.body_mm}
        return TapeSpec(**{"sector": 7, "size_mm": size_mm, **values, **more})  # type: ignore[arg-type]

    def command(self, size_mm: tuple[float, float], code: str, default_fab: str, default_code: str) -> str:
        """Command line that makes the tape."""
        words = ["tactape-fab make --sector 7", f"--w {self.pitch_mm:g} --delta {self.displacement_mm:g}"]
        if self.fab is not None:
            words += [f"--part {self.part}"] if self.part != FILM_PARTS[0] else []
            words += [f"--fab {quote(self.fab)}"] if self.fab != default_fab else []
            words += [f"--coverlay {self.coverlay}"]
        else:
            size = self.body_mm if self.shape == "block" else self.body_mm[1:]
            words += [f"--part {self.part} --body {'x'.join(f'{side:g}' for side in size)} --process {self.process}"]
        words += [f"--code {code}"] if code != default_code else []
        words += [f"--directions {self.directions}"] if not self.points_in.usual else []
        return " ".join([*words, f"--size {size_mm[0]:g}x{size_mm[1]:g}"])


def film_designs(fab: FabProfile) -> Iterator[Design]:
    """Designs of parts with lands: the smallest that the fab does not refuse, and the smallest without a warning."""
    parts = [part for part in map(read_part, FILM_PARTS) if isinstance(part, PartProfile)]
    for part, mode, share, careful in product(parts, fab.coverlay_modes, SHARES, (True, False)):
        pitch_mm = settled(partial(film_pitch_mm, fab.in_mode(mode), part, careful), share)
        yield replace(_design(part, pitch_mm, share), coverlay=mode, fab=fab.name)


def usual_design(fab: FabProfile) -> Design:
    """The default design of `make`."""
    part = read_part(FILM_PARTS[0])
    return replace(_design(part, DEFAULT_PITCH_MM, 1.0 / PITCH_PER_DISPLACEMENT), coverlay=fab.coverlay_modes[0], fab=fab.name)


def solid_designs(process: ProcessProfile) -> Iterator[Design]:
    """Designs of solid elements: the smallest that the process does not refuse, and the smallest without a warning."""
    parts = {name: part for name, _ in ELEMENTS if isinstance(part := read_part(name), ElementProfile)}
    shares = [(4, share) for share in SHARES] + [(8, share) for share in SHARES[1:]]
    for (name, body_mm), (directions, share), careful in product(ELEMENTS, shares, (True, False)):
        part = replace(parts[name], body_mm=body_mm, top_mm=None)
        pitch_mm = settled(partial(_solid_pitch_mm, part, _gap_mm(process.limits["gap"], careful), directions), share)
        yield replace(_design(part, pitch_mm, share), process=process.name, directions=directions)


def _design(part: PartProfile | ElementProfile, pitch_mm: float, share: float) -> Design:
    displacement_mm = round(share * pitch_mm, 2)
    return Design(part=part.name, shape=part.shape, body_mm=part.body_mm, pitch_mm=pitch_mm, displacement_mm=displacement_mm)


def settled(least: Callable[[float], float], share: float) -> float:
    """Least pitch, in whole hundredths of a millimetre, that is legal with a displacement of the fraction `share` of it."""
    # the least pitch is piecewise linear in Δ, so the secant method converges in a few steps
    low, high = 1.0, 1.5
    at_low, at_high = (least(share * pitch_mm + _STEP_MM / 2.0) - pitch_mm for pitch_mm in (low, high))  # Δ is rounded
    # secant rule for the root of least(share W) - W
    for _ in range(_SECANTS):
        if abs(at_high) < 1e-6 or at_high == at_low:
            break
        low, high, at_low = high, high - at_high * (high - low) / (at_high - at_low), at_high
        at_high = least(share * high + _STEP_MM / 2.0) - high
    # rounded before ceil, so that 117.0000001 steps give 1.17, not 1.18
    return round(ceil(round(high / _STEP_MM, 4)) * _STEP_MM, 2)


def _gap_mm(limit: Limit, careful: bool) -> float:
    """The gap, mm, at which a limit does not block or, if `careful`, does not warn either."""
    if careful:
        return max(limit.value_mm, limit.warn_mm or 0.0)
    return limit.value_mm if limit.level == "block" else 0.0


def film_pitch_mm(fab: FabProfile, part: PartProfile, careful: bool, displacement_mm: float) -> float:
    """Least pitch, mm, that meets the gaps of pads, bodies, openings and models; of courtyards if they block, or if `careful`."""
    gaps_mm = {rule: _gap_mm(fab.limits[rule], careful) for rule in ("body-body", "pad-pad")}
    if careful or fab.limits["courtyard"].level == "block":
        gaps_mm["courtyard"] = _gap_mm(fab.limits["courtyard"], careful)
    if fab.coverlay_mode != "gang":
        gaps_mm["opening-bridge"] = _gap_mm(fab.limits["opening-bridge"], careful)
    placing = Placing(rotation_deg=DEFAULT_ROTATION_DEG, displacement_mm=displacement_mm, directions=USUAL_DIRECTIONS)
    apart_mm = [gap_pitch_mm(rule, gap_mm, fab, part, placing) for rule, gap_mm in gaps_mm.items()]
    return max(*apart_mm, cell_pitch_mm(part, placing))


def _solid_pitch_mm(part: ElementProfile, gap_mm: float, directions: int, displacement_mm: float) -> float:
    placing = Placing(rotation_deg=DEFAULT_ROTATION_DEG, displacement_mm=displacement_mm, directions=directions)
    return max(element_pitch_mm(gap_mm, part, placing), cell_pitch_mm(part, placing))


def judged(design: Design, *, widen: bool = True) -> Design | None:
    """The design with the warnings of the rules, with a slightly larger W if they require it; None if they refuse it."""
    limits = {} if design.fab is None else load_fab(design.fab).limits
    beyond_mm = max([0.0, *(limits[rule].value_mm - _EDGE_MM for rule in ("pad-edge", "body-edge", "opening-edge") if limits)])
    # rounding of W and Δ may make the closed form's pitch too small by a hundredth
    for step in range(_TRIES if widen else 1):
        wider = replace(design, pitch_mm=round(design.pitch_mm + step * _STEP_MM, 2)) if step else design
        side_mm = max(_BOARD_MM, _BOARD_PITCHES * wider.pitch_mm) + 2.0 * beyond_mm
        broken = rules_of(wider, (side_mm, side_mm))
        if broken is not None and not any(finding.blocks for finding in broken):
            return replace(wider, warnings=tuple(sorted(f.rule for f in broken if f.level == "warn")))
        if broken is not None and any(finding.blocks and finding.rule == "opening-size" for finding in broken):
            return None  # a larger W does not help
    return None


def rules_of(design: Design, size_mm: tuple[float, float]) -> list[Finding] | None:
    """Broken rules of a tape of the design; None if there is no such tape."""
    try:
        found = rules_of_parts(design.spec(size_mm, tag="none", name="t"))
    except SpecError:
        return None
    if not design.points_in.usual and design.shape == "block" and design.process is not None:
        found = [_gap_of_eight(design, load_process(design.process)) if f.rule == "gap" else f for f in found]
    return [f for f in found if not f.passed and f.level != "info" and f.rule not in _OF_ANY_TAPE]


def _gap_of_eight(design: Design, process: ProcessProfile) -> Finding:
    """Finding of the least gap between two blocks, the only rule that differs from four directions."""
    gap_mm = worst_box_gap_mm(
        design.body_mm[:2], DEFAULT_ROTATION_DEG, design.pitch_mm, design.displacement_mm, design.directions
    )
    return finding(process, "gap", (gap_mm, None), "gap between two elements", "use a larger --w")


_OF_ANY_TAPE = ("size", "part-count", "label", "assembly-size")
"""Rules about a board or an order, which do not depend on W, Δ and part."""
