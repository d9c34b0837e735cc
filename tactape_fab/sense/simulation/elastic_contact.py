"""ElasticContact: how a tape is pressed into an elastic gel, and how the sensor measures the gel's surface."""

from __future__ import annotations

from dataclasses import dataclass, fields

from tactape_fab.base.errors import refuse
from tactape_fab.base.fields import Fields


@dataclass(frozen=True, slots=True, kw_only=True)
class ElasticContact:
    """A tape pressed with a force into an elastic layer that is bonded to the sensor; `Scene.elastic` takes one.

    Without friction: the gel slides along the tape and does not stick to it, and its surface moves along the sensor's axis only.
    A gel that sticks drags the imprint sideways (`Gel.displacement_um`). It touches nothing beyond the image, has no free sides,
    and is linear: no large strains, no creep.

    Attributes
    ----------
    force_n : float
        Normal force over the whole image, N.
    tilt_deg : (float, float)
        Tilt of the tape: its plane rises towards the sensor by tan(tilt) per mm along image u and v.
    cylinder_radius_mm : float or None
        Radius of the cylinder that the tape is wrapped on; None: the tape is flat. `Scene.contact_turn_deg` turns its axis.
    thickness_mm : float or None
        Thickness of the layer; None: that of the sensor's profile, or 4 mm.
    modulus_kpa : float or None
        Young's modulus; None: that of the sensor's profile, or 275 kPa.
    poisson : float
        Poisson's ratio, below 0.5.
    crown_mm : (float, float)
        Radii of the gel's undeformed surface along image u and v; its highest point is in the image's centre.
    blur_mm : float
        Standard deviation of the Gaussian that skin and camera smooth the gel's surface with.
    slope_limit : float or None
        Slopes s are measured as limit * tanh(s / limit), as depth networks do; None: as they are.
    markers : bool
        Whether the gel has printed dots, 0.5 mm wide at 2 mm: there no slope is measured, and the depth is filled in.
    """

    force_n: float = 2.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    cylinder_radius_mm: float | None = None
    thickness_mm: float | None = None
    modulus_kpa: float | None = None
    poisson: float = 0.485
    crown_mm: tuple[float, float] = (189.0, 113.0)
    blur_mm: float = 0.04
    slope_limit: float | None = 1.2
    markers: bool = False

    def __post_init__(self) -> None:
        """Refuse invalid values, all together."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        given = {name: value for name, value in values.items() if value is not None or name not in _OPEN}
        table = Fields(given, "elastic.")
        most = _MOST_TILT_DEG
        remedy = f"give the tilts along image u and v, each from {-most:g} to {most:g} deg: 3,0, in Python (3, 0)"
        object.__setattr__(self, "tilt_deg", table.numbers("tilt_deg", 2, low=-most, high=most, unit="deg", remedy=remedy))
        object.__setattr__(self, "crown_mm", table.numbers("crown_mm", 2, low=10.0, high=1e9))
        for name, (least, most, unit) in _NUMBERS.items():
            if name in given:
                table.number(name, low=least, high=most, unit=unit)
        table.flag("markers")
        refuse(table.problems)


_MOST_TILT_DEG = 20.0
_OPEN = ("cylinder_radius_mm", "thickness_mm", "modulus_kpa", "slope_limit")
"""Attributes that may be None: flat, the sensor profile's values, no limit."""
_NUMBERS = {
    "force_n": (0.01, 1000.0, "N"),
    "cylinder_radius_mm": (2.0, 1e6, "mm"),
    "thickness_mm": (0.1, 100.0, "mm"),
    "modulus_kpa": (1.0, 1e5, "kPa"),
    "poisson": (0.0, 0.4999, ""),
    "blur_mm": (0.0, 5.0, "mm"),
    "slope_limit": (0.1, 100.0, ""),
}
