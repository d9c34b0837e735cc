"""The inspection of one tape: where its parts are, which deviate, and its as-built file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot
from typing import Any, Literal

import numpy as np

from tactape_fab.texture.as_built import AsBuilt, Film
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.tape import Tape

Kind = Literal["missing", "tombstoned", "shifted", "turned", "foreign"]

TOLERANCE_MM = 0.2
"""Four times the scatter of a usual line, 0.05 mm: 0.03 % of good parts are farther off."""
TURN_TOLERANCE_DEG = 10.0
FILM_SIGMA = 0.001
"""Standard deviation of a film's own stretch, which a scan cannot tell from the scanner's: polyimide changes by about 0.1 %."""
DRIFT_MM = 0.001
"""Standard deviation, along each axis, of the common error of neighbouring parts: a shadow on one side shifts all of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviation:
    """One thing that is not as designed.

    Attributes
    ----------
    kind : {"missing", "tombstoned", "shifted", "turned", "foreign"}
    designator : str
        Empty for a foreign object between parts.
    at_mm : (float, float)
        Nominal place of the part, or place of the object (board frame, mm).
    value, limit : float or None
        Shift (mm), turn (degrees), or diameter of an object (mm); None where a part is missing.
    unit : str
    """

    kind: Kind
    designator: str
    at_mm: tuple[float, float]
    value: float | None = None
    limit: float | None = None
    unit: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanFacts:
    """Figures of one scan: nominal dpi (None where nobody says), scale, skew, line shifts, and residuals of the lands.

    ``px_per_mm`` and ``shear`` hold scanner and film together. ``growth`` is that of a photograph's parallax; None for a scan.
    ``common_mm`` is the standard deviation, along each axis, of the common error of all parts, by shadows and the correction of
    parallax.
    """

    name: str
    dpi: float | None
    px_per_mm: tuple[float, float]
    shear: float
    jitter_um: float
    film_sigma_um: float
    found_by: Literal["tag", "code", "neighbour"]
    growth: float | None = None
    common_mm: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inspection:
    """Places of a tape's parts as scans show them; arrays in designator order.

    Attributes
    ----------
    tape : Tape
    manifest_sha256 : str
    shift_mm : ndarray, shape (n, 2)
        Measured less nominal place, board frame, the film's stretch and the scanner's taken out.
    turn_deg : ndarray, shape (n,)
        Measured less nominal rotation, counter-clockwise; the mean of all parts is 0.
    sigma_mm : ndarray, shape (n,)
        Standard deviation of the place along each axis.
    present : ndarray of bool, shape (n,)
        False where a part is missing or stands on its end.
    tombstoned : ndarray of bool, shape (n,)
    covered : ndarray of bool, shape (n,)
        Something lies on the part, or it does not look like the others: its place is not to be relied on.
    foreign_mm : ndarray, shape (k, 3)
        Objects that are no part: x, y (board frame) and diameter.
    tolerance_mm, turn_tolerance_deg : float
    scans : tuple of ScanFacts
    """

    tape: Tape
    manifest_sha256: str
    shift_mm: FloatArray
    turn_deg: FloatArray
    sigma_mm: FloatArray
    present: BoolArray
    tombstoned: BoolArray
    covered: BoolArray
    foreign_mm: FloatArray
    tolerance_mm: float
    turn_tolerance_deg: float
    scans: tuple[ScanFacts, ...]

    @property
    def mean_shift_mm(self) -> tuple[float, float]:
        """Mean shift of all parts relative to their lands, board frame, mm."""
        x, y = self.shift_mm[self.present].mean(axis=0) if self.present.any() else (0.0, 0.0)
        return float(x), float(y)

    @property
    def scatter_mm(self) -> tuple[float, float]:
        """Standard deviation of the places along board x and y."""
        x, y = self.shift_mm[self.present].std(axis=0) if self.present.any() else (0.0, 0.0)
        return float(x), float(y)

    def deviations(self) -> list[Deviation]:
        """Everything beyond the tolerances, in designator order, then the foreign objects."""
        sites, names = self.tape.part_xy_mm(), self.tape.designators()
        far = np.hypot(*self.shift_mm.T)
        out: list[Deviation] = []
        seen = self.present & ~self.covered
        shifted = seen & (far > self.tolerance_mm)
        turned = seen & (np.abs(self.turn_deg) > self.turn_tolerance_deg)
        for i in np.flatnonzero(~self.present | shifted | turned | self.covered).tolist():
            at = (float(sites[i, 0]), float(sites[i, 1]))
            if not self.present[i]:
                kind: Kind = "tombstoned" if self.tombstoned[i] else "missing"
                out.append(Deviation(kind=kind, designator=names[i], at_mm=at))
            if self.covered[i]:
                out.append(Deviation(kind="foreign", designator=names[i], at_mm=at))
            if shifted[i]:
                value = float(far[i])
                out.append(
                    Deviation(kind="shifted", designator=names[i], at_mm=at, value=value, limit=self.tolerance_mm, unit="mm")
                )
            if turned[i]:
                angle, most = float(self.turn_deg[i]), self.turn_tolerance_deg
                out.append(Deviation(kind="turned", designator=names[i], at_mm=at, value=angle, limit=most, unit="deg"))
        out += [
            Deviation(kind="foreign", designator="", at_mm=(x, y), value=d, unit="mm") for x, y, d in self.foreign_mm.tolist()
        ]
        return out

    def as_built(self) -> AsBuilt:
        """The measured places as the file of them has them; see `texture.as_built`."""
        there = self.present[:, None]
        shift = np.where(there, self.shift_mm, 0.0)
        return AsBuilt(
            tape=self.tape.name,
            manifest_sha256=self.manifest_sha256,
            number=np.arange(1, self.tape.part_count + 1),
            dx_mm=shift[:, 0].copy(),
            dy_mm=shift[:, 1].copy(),
            rotation_deg=np.where(self.present, self.turn_deg, 0.0),
            present=self.present.copy(),
            sigma_mm=self.sigma_mm.copy(),
            film=Film(scale=(1.0, 1.0), shear=0.0, sigma=FILM_SIGMA),
            source=tuple(_source(scan) for scan in self.scans),
        )

    def to_mapping(self) -> dict[str, Any]:
        """The summary and every deviation, as JSON can hold them."""
        return {
            "tape": self.tape.name,
            "parts": self.tape.part_count,
            "present": int(self.present.sum()),
            "mean_shift_mm": [round(v, 6) for v in self.mean_shift_mm],
            "scatter_mm": [round(v, 6) for v in self.scatter_mm],
            "sigma_mm": round(float(np.median(self.sigma_mm)), 6),
            "tolerance_mm": self.tolerance_mm,
            "turn_tolerance_deg": self.turn_tolerance_deg,
            "scans": [_source(scan) for scan in self.scans],
            "deviations": [
                {
                    "kind": d.kind,
                    "designator": d.designator or None,
                    "at_mm": [round(v, 4) for v in d.at_mm],
                    "value": None if d.value is None else round(d.value, 4),
                    "limit": d.limit,
                    "unit": d.unit,
                }
                for d in self.deviations()
            ],
        }


def _source(scan: ScanFacts) -> Mapping[str, Any]:
    return {
        "kind": "scan",
        "file": scan.name,
        "dpi": scan.dpi,
        "px_per_mm": [round(v, 5) for v in scan.px_per_mm],
        "shear": round(scan.shear, 6),
        "jitter_um": round(scan.jitter_um, 2),
        "lands_um": round(scan.film_sigma_um, 2),
        "found_by": scan.found_by,
        "drift_mm": round(hypot(DRIFT_MM, scan.common_mm), 6),
        **({} if scan.growth is None else {"photo": True, "parallax_per_mm": round(scan.growth, 6)}),
    }
