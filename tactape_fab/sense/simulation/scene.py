"""Scene: properties of a contact other than the tape, the pose and the sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from math import sqrt
from typing import Any, Literal

from tactape_fab.base.errors import Problem, SpecError, refuse
from tactape_fab.base.fields import Fields, shown, unknown_key
from tactape_fab.sense.geometry import USUAL_BLUR_MM, Gel
from tactape_fab.sense.simulation.elastic_contact import ElasticContact

Contact = Literal["ellipse", "strip", "pad"]
CONTACTS = ("ellipse", "strip", "pad")
NoiseModel = Literal["sensor", "slope", "smooth"]
NOISE_MODELS = ("sensor", "slope", "smooth")
SMOOTH_NOISE = ("white_um", "correlated_um", "correlated_px")
"""Figures of the noise model "smooth"."""


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
    elastomer_mm : float or None
        Standard deviation of the Gaussian that models the elastomer; None: that of the sensor's gel, or 0.15 mm.
    dome_mm : float
        Height of the background from the contact's own shape.
    tilt_mm_per_mm : (float, float)
        Slope of the background along image u and v.
    noise_model : {"sensor", "slope", "smooth"}
        White noise of the slopes, integrated, or white and smooth noise of the depth. "sensor": the one of which the scene gives
        a figure, else slopes where the sensor's profile says how noisy they are.
    slope_noise : float or None
        Noise of the slopes, root mean square a pixel; None: the sensor's own.
    white_um, correlated_um, correlated_px : float or None
        Noise of the depth; None: the sensor's own figures. `correlated_px` is the standard deviation of the kernel that smooths
        it.
    noise : float
        Factor on the noise of either model.
    missing : float
        Fraction of parts that are missing, each at random.
    bumps : int
        Round bumps inside the contact that belong to no tape.
    placement_mm, rotation_deg : float
        Standard deviation of the parts' positions per axis, and of their rotations.
    scale_error : float
        The true scale is the profile's times 1 + scale_error.
    aspect_error, shear_error, k1_error : float
        The true aspect, shear and radial distortion (`Geometry`) are the profile's plus these.
    gel_displacement_um, gel_correlation_mm : float or None
        Smooth random displacement of what the gel shows, root mean square along each axis, and the standard deviation of the
        Gaussian that correlates it; None: those of the sensor's gel.
    mirrored_tape : bool
        The tape as its mirror image (x of the board frame reversed).
    elastic : ElasticContact or None
        Solve the contact of an elastic gel. Its force and shapes decide what touches: of the attributes above it takes
        `contact_offset_mm` and `contact_turn_deg` for a cylinder's axis, noise, and errors of the tape and of the scale;
        `contact` becomes "pad", or "strip" on a cylinder. None: the imprint described above.
    """

    contact: Contact = "ellipse"
    contact_mm: tuple[float, float] = (11.0, 9.0)
    cylinder_radius_mm: float = 15.7
    strip_width_mm: float | None = None
    contact_offset_mm: tuple[float, float] = (0.0, 0.0)
    contact_turn_deg: float = 0.0
    roll_off_mm: float = 0.8
    texture_mm: float = 0.12
    elastomer_mm: float | None = None
    dome_mm: float = 0.3
    tilt_mm_per_mm: tuple[float, float] = (0.01, -0.005)
    noise_model: NoiseModel = "sensor"
    slope_noise: float | None = None
    white_um: float | None = None
    correlated_um: float | None = None
    correlated_px: float | None = None
    noise: float = 1.0
    missing: float = 0.0
    bumps: int = 0
    placement_mm: float = 0.0
    rotation_deg: float = 0.0
    scale_error: float = 0.0
    aspect_error: float = 0.0
    shear_error: float = 0.0
    k1_error: float = 0.0
    gel_displacement_um: float | None = None
    gel_correlation_mm: float | None = None
    mirrored_tape: bool = False
    elastic: ElasticContact | None = None

    def __post_init__(self) -> None:
        """Refuse invalid values, all together."""
        table = Fields({f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None}, "scene.")
        table.text("contact", choices=CONTACTS)
        for name, most in _PAIRS.items():
            remedy = f"give both axes, each at most {most:g} mm: 11x9, in Python (11, 9)" if name == "contact_mm" else ""
            setting = table.numbers(name, 2, low=-most, high=most, unit=_PAIR_UNITS.get(name, "mm"), remedy=remedy)
            object.__setattr__(self, name, setting)
        if min(self.contact_mm) < _LEAST_CONTACT_MM:
            message = f"contact_mm = {list(self.contact_mm)} is below {_LEAST_CONTACT_MM} mm; give a larger contact"
            table.problem("contact_mm", message)
        open_ones = {f.name for f in fields(self) if f.default is None}  # None leaves those to the sensor or to another figure
        for name, (least, most, unit) in _NUMBERS.items():
            if name not in open_ones or getattr(self, name) is not None:
                table.number(name, low=least, high=most, unit=unit)
        table.text("noise_model", choices=NOISE_MODELS)
        self._refuse_other_noise(table)
        table.integer("bumps", low=0, high=1000)
        table.flag("mirrored_tape")
        elastic = table.values.get("elastic")
        if elastic is not None and not isinstance(elastic, ElasticContact):
            table.problem("elastic", f"elastic = {shown(elastic)} is no ElasticContact; give one, or None")
        refuse(table.problems)
        if self.elastic is not None:
            self._touch_everywhere(self.elastic)

    def _touch_everywhere(self, elastic: ElasticContact) -> None:
        """Where an elastic gel may touch: everywhere in the image."""
        curved = elastic.cylinder_radius_mm is not None
        object.__setattr__(self, "contact", "strip" if curved else "pad")
        object.__setattr__(self, "strip_width_mm", _NUMBERS["strip_width_mm"][1] if curved else None)
        if curved:
            object.__setattr__(self, "cylinder_radius_mm", elastic.cylinder_radius_mm)

    def _refuse_other_noise(self, table: Fields) -> None:
        """Refuse figures of a noise model that is not the scene's; they would do nothing."""
        smooth = [name for name in SMOOTH_NOISE if getattr(self, name) is not None]
        if smooth and (self.noise_model == "slope" or self.slope_noise is not None):
            table.problem(smooth[0], f"{smooth[0]} is a figure of the noise model smooth, the scene's is slope; leave it out")
        elif self.slope_noise is not None and self.noise_model == "smooth":
            table.problem("slope_noise", "slope_noise is a figure of the noise model slope, the scene's is smooth; leave it out")

    @property
    def strip_half_mm(self) -> float:
        """Half the width of a strip, mm."""
        if self.strip_width_mm is not None:
            return self.strip_width_mm / 2
        # a cylinder pressed in by d touches to x^2 / 2 R = d
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
        refuse(unknown)
        return replace(self, **options) if options else self

    def to_mapping(self) -> dict[str, Any]:
        """All attributes as plain values, for a record of what was simulated."""
        return asdict(self)


def blur_of(scene: Scene, gel: Gel) -> float:
    """Standard deviation of the elastomer's Gaussian under a sensor with this gel, mm."""
    given = gel.blur_mm if scene.elastomer_mm is None else scene.elastomer_mm
    return USUAL_BLUR_MM if given is None else given


def as_scene(scene: object) -> Scene:
    """A scene itself, the default one for None. Raises SpecError for anything else."""
    if scene is None:
        return DEFAULT_SCENE
    if isinstance(scene, Scene):
        return scene
    message = f"scene = {shown(scene)} is no Scene; give one, such as Scene(noise=2), or leave it out"
    raise SpecError(Problem("scene", message))


_LEAST_CONTACT_MM = 0.1
_PAIRS = {"contact_mm": 1000.0, "contact_offset_mm": 1000.0, "tilt_mm_per_mm": 1.0}
_PAIR_UNITS = {"tilt_mm_per_mm": ""}
_NUMBERS = {
    "cylinder_radius_mm": (0.5, 1e6, "mm"),
    "strip_width_mm": (_LEAST_CONTACT_MM, 1000.0, "mm"),
    "contact_turn_deg": (-1e6, 1e6, "deg"),
    "roll_off_mm": (0.0, 100.0, "mm"),
    "texture_mm": (0.0, 100.0, "mm"),
    "elastomer_mm": (0.0, 5.0, "mm"),
    "dome_mm": (0.0, 100.0, "mm"),
    "slope_noise": (0.0, 10.0, ""),
    "white_um": (0.0, 1e4, "um"),
    "correlated_um": (0.0, 1e4, "um"),
    "correlated_px": (1.0, 100.0, "px"),
    "noise": (0.0, 1000.0, ""),
    "missing": (0.0, 1.0, ""),
    "placement_mm": (0.0, 10.0, "mm"),
    "rotation_deg": (0.0, 360.0, "deg"),
    "scale_error": (-0.5, 0.5, ""),
    "aspect_error": (-0.2, 0.2, ""),
    "shear_error": (-0.2, 0.2, ""),
    "k1_error": (-0.2, 0.2, ""),
    "gel_displacement_um": (0.0, 1000.0, "um"),
    "gel_correlation_mm": (0.1, 100.0, "mm"),
}

DEFAULT_SCENE = Scene()
