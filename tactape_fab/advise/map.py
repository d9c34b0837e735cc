"""advise --map: the smallest contact that each code locates, and the cost, for each legal part and pitch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from tactape_fab.advise.answer import LOCATED, codes_for, seen_of
from tactape_fab.advise.designs import ELEMENTS, FILM_PARTS, SHARES, Design, film_pitch_mm, rules_of
from tactape_fab.advise.model import LOSS, least_contact_mm
from tactape_fab.advise.question import Question
from tactape_fab.base.errors import SpecError
from tactape_fab.base.pool import Workers, mapped
from tactape_fab.kit.estimate import estimate
from tactape_fab.kit.examine.tape import profiles_of
from tactape_fab.kit.profiles import FabProfile, PartProfile, read_part

PITCHES_MM = tuple(round(0.7 + 0.1 * k, 1) for k in range(18))
"""Pitches W of the map, mm."""
_SIDE_MM, _SIDE_PITCHES = 15.0, 8.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPoint:
    """A part at a pitch.

    least_mm: By code, the smallest contact of which 9 in 10 are located, mm, with the best Δ; None if none in the sensor's
        field is. Empty if the rules refuse every Δ, or no tape of that size can be planned.
    parts: Number of parts of one tape; 0 without a tape.
    once, each: Estimated assembly cost per order and per tape; None if not known.
    """

    part: str
    body_mm: tuple[float, float, float]
    pitch_mm: float
    least_mm: Mapping[str, float | None]
    parts: int = 0
    once: float | None = None
    each: float | None = None

    def to_mapping(self) -> dict[str, Any]:
        """An entry of ``map`` in the JSON of advise."""
        return {
            "part": self.part,
            "body_mm": list(self.body_mm),
            "pitch_mm": self.pitch_mm,
            "least_contact_mm": dict(self.least_mm),
            "parts": self.parts,
            "cost_once": self.once,
            "cost_each": self.each,
        }


def map_of(
    question: Question, workers: Workers = 1, progress: Callable[[str, int, int], None] = lambda *_: None
) -> tuple[MapPoint, ...]:
    """The map's points: for each part every pitch, ascending.

    workers: Number of processes, or the address of a Dask scheduler.
    progress: Called with a text, the number of points done and their total.
    """
    if isinstance(question.making, FabProfile):
        parts = [(name, read_part(name).body_mm) for name in FILM_PARTS]
    else:
        parts = list(ELEMENTS)
    asked = list(product(parts, PITCHES_MM))
    found: list[MapPoint] = []
    for point in mapped(partial(_point, question), asked, workers):
        found.append(point)
        progress("map: pitch", len(found), len(asked))
    return tuple(found)


def _point(question: Question, at: tuple[tuple[str, tuple[float, float, float]], float]) -> MapPoint:
    (part, body_mm), pitch_mm = at
    empty = MapPoint(part=part, body_mm=body_mm, pitch_mm=pitch_mm, least_mm={})
    legal = [design for share in SHARES if (design := _legal(question, part, body_mm, pitch_mm, share)) is not None]
    if not legal:
        return empty
    spec = legal[0].spec(question.size_mm)
    try:
        count = profiles_of(spec).plan(spec).part_count
    except SpecError:  # as for lines: tapes of other pitches may fit in that size
        return empty
    least: dict[str, float | None] = {}
    seen = [seen_of(design, question, count) for design in legal]
    for code in codes_for(legal[0], question, seen[0]):
        sizes = [least_contact_mm(one, code, LOSS, LOCATED, question.field_mm) for one in seen]
        least[code.name] = min((size for size in sizes if size is not None), default=None)
    point = replace(empty, least_mm=least, parts=count)
    if not isinstance(question.making, FabProfile):
        return point
    costs = estimate(count, question.making)
    return replace(point, once=costs.once, each=costs.each)


def _legal(question: Question, part: str, body_mm: tuple[float, float, float], pitch_mm: float, share: float) -> Design | None:
    """The design with that Δ, in the first legal coverlay mode; None if there is none."""
    making, profile = question.making, read_part(part)
    design = Design(
        part=part,
        shape=profile.shape,
        body_mm=body_mm,
        pitch_mm=pitch_mm,
        # rounds half up; `round` would round half to even
        displacement_mm=round(float(np.floor(100.0 * share * pitch_mm + 0.5)) / 100.0, 2),
    )
    if isinstance(making, FabProfile):
        assert isinstance(profile, PartProfile)
        ways = [
            replace(design, coverlay=mode, fab=question.profile)
            for mode in making.coverlay_modes
            if film_pitch_mm(making.in_mode(mode), profile, False, design.displacement_mm) <= pitch_mm + 1e-9
        ]
    else:
        ways = [replace(design, process=making.name)]
    side_mm = max(_SIDE_MM, _SIDE_PITCHES * pitch_mm)
    for way in ways:
        broken = rules_of(way, (side_mm, side_mm))
        if broken is not None and not any(finding.blocks for finding in broken):
            return way
    return None
