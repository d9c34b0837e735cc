"""make --order: of the tapes that a house can make, the one that holds its pads best and still locates a contact."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from math import ceil, inf, sqrt
from shlex import quote
from typing import Any

from tactape_fab.advise.answer import LOCATED, seen_of
from tactape_fab.advise.designs import SHARES, Design, film_pitch_mm, judged, settled
from tactape_fab.advise.model import CODES, LOSS, least_contact_mm
from tactape_fab.advise.question import Question, read_question
from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown
from tactape_fab.kit.film.anchors import Placing, anchor_pitch_mm
from tactape_fab.kit.outlines import part_outlines
from tactape_fab.kit.profiles import FabProfile, PartProfile, house_fab, load_fab, read_part
from tactape_fab.kit.spec.options import DEFAULT_ROTATION_DEG
from tactape_fab.kit.spec.panel_options import PANEL_KEYS
from tactape_fab.kit.spec.scatter import PLACEMENT_MM
from tactape_fab.kit.spec.tape_spec import TapeSpec, read_spec
from tactape_fab.texture.directions import DIRECTIONS, USUAL_DIRECTIONS

DEFAULT_CONTACT_MM = (11.0, 9.0)
"""Default size of the contact for which a tape is chosen, mm; that of the benchmarks."""
_SHARES = (0.12, *SHARES)
_TYPED = {"pitch_mm": "--w", "displacement_mm": "--delta", "coverlay": "--coverlay", "anchor": "--anchor"}
"""Options on the command line of the values that may be given."""
_HOLDS = {
    "mesh": "an opening for each part, and a mesh of copper under the film that holds every pad",
    "spur": "an opening for each part, and spurs of copper under the film that hold every pad",
    "none": "an opening for each part, and nothing that holds its pads",
    "gang": "one opening for all parts, and no film that holds a pad",
}
"""Ways to hold the pads, best first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A legal design, and the diameter of the smallest round contact that it locates, mm; inf if none does."""

    design: Design
    least_mm: float

    @property
    def holds(self) -> str:
        """One of the keys of _HOLDS."""
        return "gang" if self.design.coverlay == "gang" else self.design.anchor

    def words(self) -> str:
        return f"W {self.design.pitch_mm:g}, Δ {self.design.displacement_mm:g} mm, {_HOLDS[self.holds]}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Chosen:
    """The values of an order with all open ones chosen, and remarks on the choice."""

    values: dict[str, Any]
    candidate: Candidate
    remarks: tuple[str, ...]


def choose_order(values: Mapping[str, Any], house: str, contact: Any = None) -> Chosen:
    """Choose fab, W, Δ, coverlay, anchor and part number of a tape, as far as `values` leave them open.

    values: Option names to values, as for `make_kit`; untrusted.
    house: A house (``jlcpcb``), a fab profile, or a profile's file.
    contact: Diameter, or both axes, of the smallest contact to be located, mm; default 11 x 9.
    Raises SpecError if the house is unknown, the values are invalid, or no tape with them is legal.
    """
    fab_name = house_fab(house)
    if values.get("fab", fab_name) != fab_name:
        message = f"order = '{house}' takes the profile {fab_name}, which contradicts fab = '{values['fab']}'; leave out --fab"
        raise SpecError(Problem("order", message))
    given = {"sector": 0, **{key: value for key, value in values.items() if key not in (*PANEL_KEYS, "fab")}}
    fab, (spec, problems) = load_fab(fab_name), read_spec(given)
    others = list(_other_designs(spec, given))
    if others or problems:
        raise SpecError([*others, *(p for p in problems if p.root not in {other.root for other in others})])
    part = read_part(spec.part)
    if not isinstance(part, PartProfile):
        raise SpecError(Problem("order", f"part = '{spec.part}' is printed or milled, not ordered; leave out --order"))
    asked_mm, asked_words = _contact(DEFAULT_CONTACT_MM if contact is None else contact)
    question = read_question({"contact_mm": asked_mm, "fab": fab_name, "placement_mm": PLACEMENT_MM, "size_mm": spec.size_mm})
    tried = dict.fromkeys(_designs(fab, fab_name, part, spec, given))
    left_open = "pitch_mm" not in given
    judgements = (judged(found, widen=left_open) for found in tried)
    legal = [_candidate(design, question, spec.code) for design in judgements if design is not None]
    typed = [option for key, option in _TYPED.items() if key in given]
    less = f"leave out {'some of ' * (len(typed) > 1)}{', '.join(typed)}" if typed else ""
    if not legal:
        way = less or "ask the house, or give another part or house"
        raise SpecError(Problem("order", f"order = '{house}': no tape is legal{' with what is given' if typed else ''}; {way}"))
    best = _best(legal, asked_mm)
    decided = {"fab": fab_name, **{key: getattr(best.design, key) for key in _TYPED}}
    number = fab.order.number
    if number is not None and number.part == part.name and values.get("assembly", fab.assembly) == fab.assembly:
        decided |= {"part_number": values.get("part_number", number.number)}
    remarks = tuple(_remarks(best, legal, fab, (asked_mm, asked_words), decided, less))
    return Chosen(values={**values, **decided}, candidate=best, remarks=remarks)


def _other_designs(spec: TapeSpec, given: Mapping[str, Any]) -> Iterator[Problem]:
    """Problems of values of tapes to which the choice does not apply."""
    remedy = "or use --fab with --w and --delta in place of --order"
    if spec.rotation_deg % 90.0 != DEFAULT_ROTATION_DEG:
        message = f"rotation_deg = {spec.rotation_deg:g} deg contradicts --order, whose tapes have parts at"
        yield Problem("rotation_deg", f"{message} {DEFAULT_ROTATION_DEG:g} deg; leave out --rotation, {remedy}")
    directions = given.get("directions")
    if directions in tuple(DIRECTIONS) and directions != USUAL_DIRECTIONS:
        message = f"directions = {directions} contradicts --order, whose tapes have {USUAL_DIRECTIONS}"
        yield Problem("directions", f"{message}; leave out --directions, {remedy}")


def _contact(value: Any) -> tuple[float, str]:
    """Diameter of the round contact of the same area, mm, and the contact as text."""
    sides = list(value) if isinstance(value, (list, tuple)) else [value]
    if not (1 <= len(sides) <= 2 and all(isinstance(side, (int, float)) and 1.0 <= side <= 100.0 for side in sides)):
        message = (
            f"contact = {shown('x'.join(map(str, sides)))} is no size of a contact; give MM or WxH, 1 to 100 mm, such as 11x9"
        )
        raise SpecError(Problem("contact", message))
    words = " x ".join(f"{side:g}" for side in sides) + " mm"
    # an ellipse of axes a and b has the area of a circle of diameter sqrt(a b)
    return round(sqrt(sides[0] * sides[-1]), 2), words


def _designs(fab: FabProfile, name: str, part: PartProfile, spec: TapeSpec, given: Mapping[str, Any]) -> Iterator[Design]:
    """Designs with the least legal W, without and with warnings; given values are kept."""
    modes = [mode for mode in fab.coverlay_modes if given.get("coverlay", mode) == mode]
    anchors = [anchor for anchor in ("mesh", "spur", "none") if given.get("anchor", anchor) == anchor]
    for mode, anchor, share, careful in product(modes, anchors, _SHARES, (True, False)):
        if mode == "gang" and anchor != "none":
            continue
        least = partial(_pitch_mm, fab.in_mode(mode), part, anchor, careful)
        if "pitch_mm" in given:
            pitch_mm = spec.pitch_mm
        elif "displacement_mm" in given:
            pitch_mm = ceil(round(least(spec.displacement_mm) * 100.0, 4)) / 100.0
        else:
            pitch_mm = settled(least, share)
        displacement_mm = spec.displacement_mm if "displacement_mm" in given else round(share * pitch_mm, 2)
        yield Design(
            part=spec.part,
            shape=part.shape,
            body_mm=part.body_mm,
            pitch_mm=pitch_mm,
            displacement_mm=displacement_mm,
            coverlay=mode,
            fab=name,
            anchor=anchor,
        )


def _pitch_mm(fab: FabProfile, part: PartProfile, anchor: str, careful: bool, displacement_mm: float) -> float:
    pitch_mm = film_pitch_mm(fab, part, careful, displacement_mm)
    if anchor == "none":
        return pitch_mm
    placing = Placing(rotation_deg=DEFAULT_ROTATION_DEG, displacement_mm=displacement_mm, directions=USUAL_DIRECTIONS)
    held_mm = anchor_pitch_mm(anchor, fab, part_outlines(part, fab, DEFAULT_ROTATION_DEG), part.pads, placing)
    return max(pitch_mm, held_mm or inf)


def _candidate(design: Design, question: Question, code_name: str) -> Candidate:
    code = next((code for code in CODES if code.name == code_name), CODES[0])
    found = least_contact_mm(seen_of(design, question), code, LOSS, LOCATED, question.field_mm)
    return Candidate(design=design, least_mm=inf if found is None else found)


def _best(legal: Sequence[Candidate], asked_mm: float) -> Candidate:
    """Of the candidates that locate the contact, the one that holds its pads best, with fewest warnings; else the nearest one."""
    ranks = list(_HOLDS)
    reaching = [candidate for candidate in legal if candidate.least_mm <= asked_mm]
    if not reaching:
        return min(legal, key=lambda c: (c.least_mm, ranks.index(c.holds)))
    return min(reaching, key=lambda c: (ranks.index(c.holds), len(c.design.warnings), c.least_mm))


def _remarks(
    best: Candidate, legal: Sequence[Candidate], fab: FabProfile, asked: tuple[float, str], decided: Mapping[str, Any], less: str
) -> Iterator[str]:
    asked_mm, words = asked
    located = "no contact in view is located" if best.least_mm == inf else f"contacts from {best.least_mm:g} mm are located"
    size = words if words == f"{asked_mm:g} mm" else f"{words}, as large as a disc of {asked_mm:g} mm"
    yield f"order: {fab.name} makes {best.words()}; {located} (asked: {size}; parts placed within {PLACEMENT_MM:g} mm rms)"
    sound = [candidate for candidate in legal if len(candidate.design.warnings) <= len(best.design.warnings)]
    least = min(sound, key=lambda c: c.least_mm)
    if best.least_mm > asked_mm:
        yield (
            f"warning: order: no tape that {fab.name} makes{' with what is given' * bool(less)} locates a contact of "
            f"{asked_mm:g} mm by this prediction; {less or '--contact takes a larger one, another house may do'}"
        )
    elif least.least_mm < best.least_mm and least.holds != best.holds:
        yield (
            f"order: holding the pads costs {best.least_mm - least.least_mm:.1f} mm of contact: from {least.least_mm:g} mm with "
            f"{least.words()}"
        )
    options = [f"--fab {quote(str(decided['fab']))}", *(f"{option} {decided[key]}" for key, option in _TYPED.items())]
    yield f"order: the same without a search: {' '.join(options)}" + (
        f" --part-number {decided['part_number']}" if "part_number" in decided else ""
    )
