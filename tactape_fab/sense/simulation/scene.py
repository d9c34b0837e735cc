"""Scene: properties of a contact other than the tape, the pose and the sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from math import sqrt
from typing import Any, Literal

from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import Fields, unknown_key

Contact = Literal["ellipse", "strip", "pad"]
CONTACTS = ("ellipse", "strip", "pad")


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Contact on a tape, and errors of tape and sensor. The defaults are the default scene.

    Attributes
    ----------
    contact : {"ellipse", "strip", "pad"}
        An ellipse, the strip along which a cylinder touches, or the whole field.
    contact_mm : (float, float)
        Both axes of the ellipse, along image u and v before it is turned.
    cylinder_radius_mm : float
        Radius of the cylinder under a strip; the texture is seen foreshortened on its flanks.
    strip_width_mm : float or None
        None: as wide as the cylinder is where it is `dome_mm` below its top.
    contact_offset_mm : (float, float)
        Contact centre from the image centre, right and down.
    contact_turn_deg : float
        Turn of the ellipse, or of the cylinder's axis from image u, counter-clockwise as the image is looked at.
    roll_off_mm : float
        Width of the rim over which the texture's imprint decreases from full to none; it is half on the contact's
        outline itself.
    texture_mm : float
        Height of an imprinted part before the elastomer smooths it. Less than the part's height, because the gel bridges.
    elastomer_mm : float
        Standard deviation of the Gaussian that models the elastomer.
    dome_mm : float
        Height of the background from the contact's own shape.
    tilt_mm_per_mm : (float, float)
        Slope of the background along image u and v.
    white_um, correlated_um, correlated_px : float or None
        Noise; None: the sensor's own figures. `correlated_px` is the standard deviation of the kernel that smooths it.
    noise : float
        Factor on both kinds of noise.
    missing : float
        Fraction of parts that are missing, each at random.
    bumps : int
        Round bumps inside the contact that belong to no tape.
    placement_mm, rotation_deg : float
        Standard deviation of the parts' positions per axis, and of their rotations.
    scale_error : float
        The true scale is the profile's times 1 + scale_error.
    mirrored_tape : bool
        The tape as its mirror image (x of the board frame reversed).
    """

    contact: Contact = "ellipse"
    contact_mm: tuple[float, float] = (11.0, 9.0)
    cylinder_radius_mm: float = 15.7
    strip_width_mm: float | None = None
    contact_offset_mm: tuple[float, float] = (0.0, 0.0)
    contact_turn_deg: float = 0.0
    roll_off_mm: float = 0.8
    texture_mm: float = 0.12
    elastomer_mm: float = 0.15
    dome_mm: float = 0.3
    tilt_mm_per_mm: tuple[float, float] = (0.01, -0.005)
    white_um: float | None = None
    correlated_um: float | None = None
    correlated_px: float | None = None
    noise: float = 1.0
    missing: float = 0.0
    bumps: int = 0
    placement_mm: float = 0.0
    rotation_deg: float = 0.0
    scale_error: float = 0.0
    mirrored_tape: bool = False

    def __post_init__(self) -> None:
        """Refuse invalid values, all together."""
        table = Fields({f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None}, "scene.")
        table.text("contact", choices=CONTACTS)
        for name, most in _PAIRS.items():
            setting = table.numbers(name, 2, low=-most, high=most, unit="" if name == "tilt_mm_per_mm" else "mm")
            object.__setattr__(self, name, setting)
        if min(self.contact_mm) < _LEAST_CONTACT_MM:
            table.problem("contact_mm", f"contact_mm = {self.contact_mm} is below {_LEAST_CONTACT_MM} mm; give a larger contact")
        for name, (least, most, unit) in _NUMBERS.items():
            if getattr(self, name) is not None:
                table.number(name, low=least, high=most, unit=unit)
        table.integer("bumps", low=0, high=1000)
        table.flag("mirrored_tape")
        if table.problems:
            raise SpecError(table.problems)

    @property
    def strip_half_mm(self) -> float:
        """Half the width of a strip, mm."""
        if self.strip_width_mm is not None:
            return self.strip_width_mm / 2
        return max(sqrt(2 * self.cylinder_radius_mm * self.dome_mm), _LEAST_CONTACT_MM / 2)

    def changed(self, options: Mapping[str, Any]) -> Scene:
        """The scene with some of its attributes replaced.

        Parameters
        ----------
        options : mapping
            Attributes to their new values.

        Returns
        -------
        Scene

        Raises
        ------
        SpecError
            For an unknown name or an invalid value.
        """
        known = [f.name for f in fields(self)]
        unknown = [unknown_key(name, known) for name in options if name not in known]
        if unknown:
            raise SpecError(unknown)
        return replace(self, **options) if options else self

    def to_mapping(self) -> dict[str, Any]:
        """All attributes as plain values, for a record of what was simulated."""
        return asdict(self)


_LEAST_CONTACT_MM = 0.1
_PAIRS = {"contact_mm": 1000.0, "contact_offset_mm": 1000.0, "tilt_mm_per_mm": 1.0}
_NUMBERS = {
    "cylinder_radius_mm": (0.5, 1e6, "mm"),
    "strip_width_mm": (_LEAST_CONTACT_MM, 1000.0, "mm"),
    "contact_turn_deg": (-1e6, 1e6, "deg"),
    "roll_off_mm": (0.0, 100.0, "mm"),
    "texture_mm": (0.0, 100.0, "mm"),
    "elastomer_mm": (0.0, 5.0, "mm"),
    "dome_mm": (0.0, 100.0, "mm"),
    "white_um": (0.0, 1e4, "um"),
    "correlated_um": (0.0, 1e4, "um"),
    "correlated_px": (1.0, 100.0, "px"),
    "noise": (0.0, 1000.0, ""),
    "missing": (0.0, 1.0, ""),
    "placement_mm": (0.0, 10.0, "mm"),
    "rotation_deg": (0.0, 360.0, "deg"),
    "scale_error": (-0.5, 0.5, ""),
}

DEFAULT_SCENE = Scene()
