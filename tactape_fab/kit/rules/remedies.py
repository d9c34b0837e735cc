"""Remedies that work as typed: the least W, together with a Δ, at which rules of a film or a texture hold.

Δ is kept: symbols are distinguished by Δ relative to the error of a dot, independent of W. If a command leaves Δ out it is W/6
and grows with W, so that a larger W alone might be refused again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import floor

from tactape_fab.base.templates import profile_names
from tactape_fab.kit.film.anchors import Placing, anchor_pitch_mm
from tactape_fab.kit.film.coverlay import least_pitch_mm, whole_um_up
from tactape_fab.kit.outlines import opening_size_mm, part_outlines
from tactape_fab.kit.plan import TOLERANCE_MM, film_size_mm, texture_size_mm
from tactape_fab.kit.profiles import ElementProfile, FabProfile, PartProfile, ProcessProfile, read_part
from tactape_fab.kit.spec.scatter import least_displacement_mm
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.solids.checks import LEAST_CLEARANCE_MM
from tactape_fab.solids.elements import reach_mm
from tactape_fab.texture.directions import DIRECTIONS
from tactape_fab.texture.part import TapePart
from tactape_fab.texture.tape import LEAST_DISPLACEMENT_MM, MOST_PITCH_MM

LEAST_SHARE = 0.14
"""Least Δ, as a fraction of W, of a remedy that reduces the displacement; also the least that `advise` proposes."""
GAPS = ("pad-pad", "body-body", "courtyard", "opening-bridge")
"""Rules for gaps between parts of a film, which a larger W satisfies."""
_STEP_MM = 0.001
_HALVINGS = 20

Pitch = Callable[[Placing], float | None]
"""Function that gives the least pitch, mm, at which a rule is met; None if at none."""


# Least pitches


def film_pitch_mm(rule: str, limit_mm: float, fab: FabProfile, part: PartProfile, placing: Placing) -> float | None:
    """Least pitch, mm, at which a rule of GAPS, ``anchor-spur`` or ``anchor-mesh`` is met for any symbols; None if at none.

    ``limit_mm`` is the required gap; for anchors that between the copper of two parts.
    """
    if not rule.startswith("anchor-"):
        return gap_pitch_mm(rule, limit_mm, fab, part, placing)
    outlines = part_outlines(part, fab, placing.rotation_deg)
    return anchor_pitch_mm(rule.removeprefix("anchor-"), fab, outlines, part.pads, placing, copper_mm=limit_mm)


def gap_pitch_mm(rule: str, limit_mm: float, fab: FabProfile, part: PartProfile, placing: Placing) -> float:
    """Least pitch, mm, at which a rule of GAPS is met with the gap `limit_mm`, for any symbols."""

    def apart(size_mm: tuple[float, float], wider_mm: float = 0.0, shift_mm: float = 0.0) -> float:
        return least_pitch_mm(
            size_mm,
            limit_mm + wider_mm,
            placing.rotation_deg,
            placing.displacement_mm,
            (shift_mm, 0.0),
            directions=placing.directions,
        )

    if rule == "opening-bridge":
        return apart(opening_size_mm(part, fab))
    if rule == "courtyard":
        return apart(part.courtyard_mm)
    if rule == "body-body":
        return apart((part.body_mm[0] + part.body_tolerance_mm, part.body_mm[1] + part.body_tolerance_mm))
    # a land is a smaller box offset by the corner radius r; the Minkowski difference of two is such a box with radius 2 r. Land 1
    # of a part against land 2 of another is shifted by the distance of the two lands, in either direction
    round_mm, between_mm = 2.0 * part.pads.corner_radius_mm, 2.0 * part.pads.offset_mm
    pad = (part.pads.size_mm[0] - round_mm, part.pads.size_mm[1] - round_mm)
    return max(apart(pad, round_mm, shift_mm) for shift_mm in (0.0, between_mm, -between_mm))


def element_pitch_mm(gap_mm: float, part: ElementProfile, placing: Placing) -> float:
    """Least pitch, mm, at which the feet of any two elements are at least `gap_mm` apart, for any symbols."""
    if part.shape == "block":
        return least_pitch_mm(
            part.body_mm[:2], gap_mm, placing.rotation_deg, placing.displacement_mm, directions=placing.directions
        )
    # two circles are nearest if both elements are displaced towards each other along the row: W - 2 Δ - diameter
    return part.body_mm[0] + gap_mm + 2.0 * placing.displacement_mm


def cell_pitch_mm(part: PartProfile | ElementProfile, placing: Placing) -> float:
    """Least pitch, mm, at which a displaced body stays within its cell, as the models require."""
    tape_part = TapePart(name=part.name, shape=part.shape, body_mm=part.body_mm, rotation_deg=placing.rotation_deg)
    # half a cell has to hold reach, displacement and clearance
    return 2.0 * (float(max(reach_mm(tape_part))) + placing.displacement_mm + LEAST_CLEARANCE_MM)


# Remedies


@dataclass(frozen=True, slots=True, kw_only=True)
class Remedy:
    """Search for the W and Δ of a spec at which rules hold.

    ``pitches`` are the rules that must hold; ``size_mm`` gives the outline that a spec with another grid needs; ``placed`` says
    that parts are placed by an assembly line, not printed.
    """

    spec: TapeSpec
    pitches: tuple[Pitch, ...]
    size_mm: Callable[[TapeSpec], tuple[float, float]]
    placed: bool = False

    def options(self) -> str | None:
        """Options to type: W and Δ, and the outline if a window no longer fits; "" if the present W and Δ work, None if no
        values do.
        """
        spec, displacement_mm = self.spec, _rounded(self.spec.displacement_mm)
        if self._met(spec.pitch_mm, spec.displacement_mm):
            return self._size(spec).strip()
        pitch_mm = self._least(displacement_mm)
        if pitch_mm is None or pitch_mm > MOST_PITCH_MM:
            return None
        # a remedy does not make W smaller
        pitch_mm = max(whole_um_up(pitch_mm), spec.pitch_mm)
        size = self._size(spec.with_values(pitch_mm=pitch_mm, displacement_mm=displacement_mm))
        return f"--w {pitch_mm:g} --delta {displacement_mm:g}{size}"

    def smaller(self) -> float | None:
        """The largest Δ, mm, that works at the present W; None if it is not below the present Δ, or too small to be read."""
        least_mm, high = max(LEAST_SHARE * self.spec.pitch_mm, LEAST_DISPLACEMENT_MM), self.spec.displacement_mm
        if self.placed and not DIRECTIONS[self.spec.directions].usual:  # placement scatter would cause wrong symbols
            least_mm = max(least_mm, least_displacement_mm())
        low = least_mm
        if low >= high or not self._met(self.spec.pitch_mm, low) or self._met(self.spec.pitch_mm, high):
            return None
        # rules are monotonic in Δ: bisection between low, which holds, and
        # high, which does not, to a millionth of their first distance
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if self._met(self.spec.pitch_mm, middle) else (low, middle)
        # rounded down to micrometres, so that the rules hold
        found = floor(low / _STEP_MM) * _STEP_MM
        return round(found, 3) if found >= least_mm else None

    def words(self) -> str:
        """The remedy as a sentence: ``use --w 2.056 --delta 0.25, or --delta 0.2``; "" if there is none."""
        options = self.options()
        smaller = self.smaller()
        parts = [f"use {options.strip()}"] if options else []
        parts += [f"--delta {smaller:g}" if parts else f"use --delta {smaller:g}"] if smaller is not None else []
        return ", or ".join(parts)

    def _least(self, displacement_mm: float) -> float | None:
        placing = Placing(rotation_deg=self.spec.rotation_deg, displacement_mm=displacement_mm, directions=self.spec.directions)
        found = [pitch(placing) for pitch in self.pitches]
        return None if any(pitch is None for pitch in found) else max((p for p in found if p is not None), default=0.0)

    def _met(self, pitch_mm: float, displacement_mm: float) -> bool:
        least = self._least(displacement_mm)
        return least is not None and pitch_mm >= least - TOLERANCE_MM

    def _size(self, spec: TapeSpec) -> str:
        size_mm = self.size_mm(spec)
        return "" if size_mm == spec.size_mm else f" --size {size_mm[0]:g}x{size_mm[1]:g}"


def _rounded(displacement_mm: float) -> float:
    return max(round(displacement_mm, 3), LEAST_DISPLACEMENT_MM)


def film_remedy(
    spec: TapeSpec,
    fab: FabProfile,
    part: PartProfile,
    rules: Sequence[str] = (),
    more: Sequence[Pitch] = (),
) -> Remedy:
    """Remedy by which these rules hold without a warning, and all blocking rules hold as well, including those of the models.

    fab: The fab profile in the spec's coverlay mode.
    rules: Rules of GAPS, ``anchor-spur``, ``anchor-mesh``.
    more: Other rules that must hold.
    """
    anchored = spec.anchor != "none" or any(rule.startswith("anchor-") for rule in rules)
    if anchored and _gang(fab):  # an anchor needs coverlay around the part
        fab = fab.in_mode(next(mode for mode in fab.coverlay_modes if mode != "gang"))
    pitches = [*more, *(_of_film(rule, _clear_mm(fab, rule), fab, part) for rule in rules)]
    if spec.anchor != "none":
        pitches.append(_of_film(f"anchor-{spec.anchor}", fab.limits["pad-pad"].value_mm, fab, part))
    for rule in GAPS:
        blocks = fab.limits[rule].level == "block" and not (rule == "opening-bridge" and _gang(fab))
        if rule not in rules and blocks:
            pitches.append(_of_film(rule, fab.limits[rule].value_mm, fab, part))
    if spec.form is not None:
        pitches.append(lambda placing: cell_pitch_mm(part, placing))
    return Remedy(spec=spec, pitches=tuple(pitches), size_mm=lambda other: film_size_mm(other, fab, part), placed=True)


def _gang(fab: FabProfile) -> bool:
    return fab.coverlay_mode == "gang" and len(fab.coverlay_modes) > 1


def _clear_mm(fab: FabProfile, rule: str) -> float:
    """The gap, mm, at which a rule neither blocks nor warns; for anchors that between the copper of two parts."""
    limit = fab.limits["pad-pad" if rule.startswith("anchor-") else rule]
    return max(limit.value_mm, limit.warn_mm or 0.0)


def _of_film(rule: str, limit_mm: float, fab: FabProfile, part: PartProfile) -> Pitch:
    return lambda placing: film_pitch_mm(rule, limit_mm, fab, part, placing)


def texture_remedy(spec: TapeSpec, process: ProcessProfile, part: ElementProfile, gap_mm: float) -> Remedy:
    """Remedy by which the feet of any two elements are `gap_mm` apart, and every element stays in its cell."""
    return Remedy(
        spec=spec,
        pitches=(lambda placing: element_pitch_mm(gap_mm, part, placing), lambda placing: cell_pitch_mm(part, placing)),
        size_mm=lambda other: texture_size_mm(other, process, part),
    )


def film_parts(fits: Callable[[PartProfile], bool]) -> Iterator[PartProfile]:
    """Shipped parts with lands that fit, the smallest first."""
    parts = [part for part in map(read_part, profile_names("parts")) if isinstance(part, PartProfile)]
    yield from sorted(filter(fits, parts), key=lambda part: part.body_mm)


# Words


def wider_words(spec: TapeSpec, fab: FabProfile, part: PartProfile, rule: str, *, may_turn: bool = True) -> str:
    """Remedy for a gap rule of a film: W and Δ, or Δ, or, if they may be, parts rotated by 45 degrees."""
    parts = [words] if (words := film_remedy(spec, fab, part, [rule]).words()) else []
    if may_turn and spec.rotation_deg % 90.0 != 45.0:
        turned = film_remedy(spec.with_values(rotation_deg=45.0), fab, part, [rule]).options()
        if turned == "":
            parts.append("--rotation 45" if parts else "use --rotation 45")
    return ", or ".join(parts) or f"no W up to {MOST_PITCH_MM:g} mm does; use another --part"


def opening_words(spec: TapeSpec, fab: FabProfile, limit_mm: float) -> str:
    """Remedy for openings that are too small: one for all parts, or larger parts."""
    other = part_words(spec, fab, lambda part: min(opening_size_mm(part, fab)) >= limit_mm, "with wider pads")
    may_gang = "gang" in fab.coverlay_modes and spec.anchor == "none"
    return f"use --coverlay gang, or {other.removeprefix('use ')}" if may_gang else other


def part_words(spec: TapeSpec, fab: FabProfile, fits: Callable[[PartProfile], bool], which: str) -> str:
    """Remedy by the smallest shipped part that fits, with W and Δ at which its rules hold."""
    rules = [] if fab.coverlay_mode == "gang" else ["opening-bridge"]
    for part in film_parts(lambda part: part.name != spec.part and fits(part)):
        options = film_remedy(spec, fab, part, rules).options()
        if options is not None:
            return f"use --part {part.name} {options}".rstrip()
    return f"ask the fab, or write a profile of a part {which}"
