"""Expected region of a contact, and the places of registered tapes in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import degrees, isfinite
from numbers import Real

import numpy as np

from tactape_fab.base.errors import Problem, refuse
from tactape_fab.base.fields import shown
from tactape_fab.sense.decode.rule import LEAST_DOTS, PRIOR_SHARE
from tactape_fab.sense.decode.search.evidence import Tables
from tactape_fab.sense.decode.search.families import Family
from tactape_fab.sense.decode.search.single_place import places_near, shown_by
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.tape import Tape

MOST_RADIUS_MM = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Prior:
    """Expected region of a contact, such as round the last fix: a place within a radius and a range of angles.

    Attributes
    ----------
    position_mm : (float, float)
        S, the texture point under the image centre (texture frame, mm).
    theta_deg : float
        Turn of the sensor on the tape, degrees, counter-clockwise seen from above, as in `Localization`.
    radius_mm : float
        Largest distance of the true S from `position_mm`, mm.
    angle_deg : float
        Largest difference of the true theta from `theta_deg`, degrees.
    tape : str or None
        Name of the tape; None for any.

    Raises
    ------
    SpecError
        When a value is out of range.
    """

    position_mm: tuple[float, float]
    theta_deg: float
    radius_mm: float = 2.0
    angle_deg: float = 10.0
    tape: str | None = None

    def __post_init__(self) -> None:
        problems = []
        if not _are_numbers(self.position_mm, 2):
            problems.append(Problem("position_mm", f"position_mm = {shown(self.position_mm)} is no place; give (x, y) in mm"))
        if not _are_numbers([self.theta_deg], 1):
            problems.append(Problem("theta_deg", f"theta_deg = {shown(self.theta_deg)} is no angle; give degrees"))
        if not (_are_numbers([self.radius_mm], 1) and 0.0 <= self.radius_mm <= MOST_RADIUS_MM):
            message = f"radius_mm = {shown(self.radius_mm)} is not from 0 to {MOST_RADIUS_MM:g} mm; give how far off it may be"
            problems.append(Problem("radius_mm", message))
        if not (_are_numbers([self.angle_deg], 1) and 0.0 <= self.angle_deg <= 360.0):
            message = f"angle_deg = {shown(self.angle_deg)} is not from 0 to 360 degrees; give how far off it may be"
            problems.append(Problem("angle_deg", message))
        name: object = self.tape
        if not (name is None or isinstance(name, str)):
            problems.append(Problem("tape", f"tape = {shown(name)} is no name; give the tape's name, or None for any"))
        refuse(problems)


def _are_numbers(values: object, count: int) -> bool:
    """Whether `values` holds exactly `count` finite real numbers."""
    if not isinstance(values, Iterable):
        return False
    numbers = [v for v in values if isinstance(v, Real) and _is_finite(v)]
    return len(numbers) == len(list(values)) == count


def _is_finite(value: Real) -> bool:
    try:
        return isfinite(value)
    except OverflowError:  # a whole number beyond all floats
        return False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Near:
    """Places near a prior.

    ``places`` (n, 5) holds family, turn, site, column and row; ``evidence`` (n,) ln E there; ``over`` (n,) 1 where some dots lie
    beyond the tape's edge.
    """

    places: IntArray
    evidence: FloatArray
    over: IntArray


def near_prior(
    tapes: Sequence[Tape],
    families: Sequence[Family],
    tables: Sequence[Tables],
    grid: FloatArray,
    centre_px: FloatArray,
    prior: Prior,
) -> Near | None:
    """The places near a prior with enough dots on a tape, if there are any."""
    found = []
    for of, (family, t) in enumerate(zip(families, tables, strict=True)):
        for turn in range(4):
            theta_deg = degrees(float(np.arctan2(grid[1], grid[0]))) + 90.0 * turn
            # the difference brought to -180 ... 180 degrees
            if abs((theta_deg - prior.theta_deg + 180.0) % 360.0 - 180.0) > prior.angle_deg:
                continue
            centre = _turned_point(grid, centre_px, turn) - t.corner[turn]  # in cells from the dots' corner
            for site, index in enumerate(family.tapes):
                tape = tapes[index]
                if prior.tape not in (None, tape.name):
                    continue
                # where the dots' corner would have to lie for the image centre to be at the prior's place, in cells
                at, reach = np.asarray(prior.position_mm) / tape.pitch_mm - centre, prior.radius_mm / tape.pitch_mm
                cells, evidence = places_near(t, shown_by(tape), turn, at, reach, LEAST_DOTS)
                inside = ((cells >= 0) & (cells <= np.array([tape.columns, tape.rows]) - t.size[turn])).all(axis=1)
                places = np.column_stack([np.broadcast_to([of, turn, site], (len(cells), 3)), cells])
                found.append(Near(places=places, evidence=evidence, over=(~inside).astype(np.int64)))
    if sum(len(near.evidence) for near in found) == 0:
        return None
    return Near(
        places=np.concatenate([near.places for near in found]),
        evidence=np.concatenate([near.evidence for near in found]),
        over=np.concatenate([near.over for near in found]),
    )


def raised_by(near: Near, turn_weights: FloatArray, base: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ln of the weighted evidence of places near a prior, without the prior and with it."""
    turn = near.places[:, 1]
    # the prior weight of a place is a sum: its part of all places, and its part of `PRIOR_SHARE` by its turn
    without, share = base[turn, near.over], PRIOR_SHARE * turn_weights[turn] / turn_weights[turn].sum()
    return near.evidence + without, near.evidence + np.log(np.exp(without) + share)


def _turned_point(grid: FloatArray, point_px: FloatArray, turn: int) -> FloatArray:
    """A point in columns and rows of the grid after a quarter turn, as `evidence.turned` has it."""
    a, b, x, y = grid
    dx, dy = point_px[0] - x, point_px[1] - y
    norm = a * a + b * b
    k, j = (a * dx + b * dy) / norm, (a * dy - b * dx) / norm
    return np.array([(k, j), (j, -k), (-k, -j), (-j, k)][turn])
