"""TapeSpec: every option of a tape, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path, PurePath
from typing import Any, Literal, cast

from tactape_fab.base.errors import Problem, refusal
from tactape_fab.base.fields import unknown_key
from tactape_fab.base.given_value import refuse_other
from tactape_fab.base.templates import is_profile_file, read_toml
from tactape_fab.kit.spec.board_options import DEFAULT_TAG_CELL_MM
from tactape_fab.kit.spec.grid_options import BEST, DEFAULT_SIZE_MM
from tactape_fab.kit.spec.options import DEFAULT_PART, DEFAULT_ROTATION_DEG, read_options
from tactape_fab.solids.forms import Axis, Cylinder, Shell, SolidForm, Top
from tactape_fab.texture.code import DEFAULT_CODE
from tactape_fab.texture.directions import USUAL_DIRECTIONS
from tactape_fab.texture.tape import DEFAULT_PITCH_MM


@dataclass(frozen=True, slots=True, kw_only=True)
class TapeSpec:
    """Options of a tape. Building a spec checks every value and reports all problems together.

    Attributes have their final values: options that were left out get the default that follows from the others.
    `dataclasses.replace` keeps these: with another sector, the spec would keep name, tag and origin of the old one. Build a new
    spec instead.

    Attributes
    ----------
    sector : int
        Sector of the code that the tape shows; the seed of a touch code's design.
    pitch_mm : float
        Grid pitch (W in the paper).
    displacement_mm : float
        Displacement of each part (Delta in the paper); None for a sixth of the pitch.
    size_mm : (float, float)
        Outline (width, height).
    code : str
    directions : int
        Number of displacement directions: 4, or 8 for the touch code with accurately placed parts.
    origin : (int, int) or "best"
        Column and row of grid point (0, 0) in the code plane; None for the sector's default origin. ``"best"`` starts a
        search when the tape is planned. (0, 0) for the touch code, which has no plane.
    tag : {"strip", "none"}
        A strip at the left end with AprilTag and label, or no strip. None: a strip on a film, no strip on a texture of
        solid elements.
    tag_id : int or None
        Id of the AprilTag; None for the sector if there is a strip.
    tag_cell_mm : float
    part : str
        Profile name, or path of a TOML file: a part with lands, or a solid element, to print or mill.
    fab : str or None
        Profile name, or path of a TOML file; default ``generic-fpc`` for a part with lands, None for a solid element.
    rotation_deg : float
        Rotation of every part, counter-clockwise, 0 along board x.
    assembly : str or None
        Assembly house that determines the columns of CPL and BOM; None for the fab profile's.
    part_number : str or None
        Part number in the BOM, in that house's format; None for the part profile's, if it has one.
    x2 : str or None
        Gerber attributes: ``full``, as ``comments``, or ``off``; None for the fab profile's choice.
    corner_radius_mm : float
        Default 1; 0 for solid elements on a cylinder, whose corners are square.
    holes_mm : sequence of (float, float, float)
        Unplated holes (x, y, diameter) in the board frame.
    name : str
        Name of the tape and of its files; None for ``tactape-s007`` (sector 7).
    body_mm : (float, float, float) or None
        Size of a solid element: length, width, height; for a dome the diameter (once or twice) and the height. None for the
        part profile's.
    dome_top_mm : float or None
        Diameter of a dome's flat top, which makes it a truncated cone; None for the part profile's.
    process : str or None
        Process profile (``sla``, ``fdm``, ``cnc``), or path of a TOML file; default ``sla`` for a solid element.
    models : bool
        Whether the kit has 3D models. The keys below are None without them.
    base_mm : float or None
        Thickness of the solid models' base.
    negative : bool
        Make the mould instead of the texture.
    top : {"tiles", "single"} or None
    cylinder_mm : float or None
        Radius of the cylinder that the solid models are wrapped around.
    around : {"x", "y"} or None
    shell : {"segment", "whole"} or None
        See `tactape_fab.solids.forms`.
    coverlay : {"per-part", "lpi", "gang"} or None
        How the coverlay is opened; None for the first way of the fab profile that its limits allow.
    anchor : {"none", "spur", "mesh"}
        Copper that extends from the pads under the coverlay, which then holds the pads.
    stiffener, adhesive : str or None
        Layer laminated to the underside: material and thickness in mm, such as ``"FR4 0.2"``.
    bend_axis : {"x", "y"} or None
        Board axis that becomes curved when the tape is bent.
    bend_radius_mm : float or None
    sim : bool
        Whether the kit has assets for simulators.
    mark : bool or None
        Whether the sector's number and an arrow are engraved in the back of the base of solid elements, by default unless it is
        milled; None for a film, which has them in print.

    Raises
    ------
    SpecError
        With every problem. CapacityError if the code's reach is the only one.
    """

    sector: int
    pitch_mm: float = DEFAULT_PITCH_MM
    displacement_mm: float = None  # type: ignore[assignment]
    size_mm: tuple[float, float] = DEFAULT_SIZE_MM
    code: str = DEFAULT_CODE
    directions: int = USUAL_DIRECTIONS
    origin: tuple[int, int] | Literal["best"] = None  # type: ignore[assignment]
    tag: str = None  # type: ignore[assignment]
    tag_id: int | None = None
    tag_cell_mm: float = DEFAULT_TAG_CELL_MM
    part: str = DEFAULT_PART
    rotation_deg: float = DEFAULT_ROTATION_DEG
    fab: str | None = None
    assembly: str | None = None
    part_number: str | None = None
    x2: str | None = None
    corner_radius_mm: float = None  # type: ignore[assignment]
    holes_mm: Sequence[tuple[float, float, float]] = ()
    name: str = None  # type: ignore[assignment]
    body_mm: tuple[float, float, float] | None = None
    dome_top_mm: float | None = None
    process: str | None = None
    models: bool = True
    base_mm: float | None = None
    negative: bool = False
    top: str | None = None
    cylinder_mm: float | None = None
    around: str | None = None
    shell: str | None = None
    coverlay: str | None = None
    anchor: str = "none"
    stiffener: str | None = None
    adhesive: str | None = None
    bend_axis: str | None = None
    bend_radius_mm: float | None = None
    sim: bool = False
    mark: bool | None = None

    def __post_init__(self) -> None:
        values, problems = read_options(_plainly({key: getattr(self, key) for key in KEYS}))
        if problems:
            raise refusal(problems)
        self._take(values)

    def _take(self, values: Mapping[str, Any]) -> None:
        for key, value in values.items():
            object.__setattr__(self, key, value)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> TapeSpec:
        """Build a spec from untrusted values, such as TOML and command-line options.

        Parameters
        ----------
        values : mapping
            Option names, as in the attributes, to values.

        Returns
        -------
        TapeSpec

        Raises
        ------
        SpecError
            Every problem found, unknown keys included.
        """
        spec, problems = read_spec(values)
        if problems:
            raise refusal(problems)
        return spec

    def with_values(self, **values: Any) -> TapeSpec:
        """Copy of the spec with some values replaced, which are not checked.

        Parameters
        ----------
        **values
            Attributes to their new values, in their final form.

        Returns
        -------
        TapeSpec
        """
        other = object.__new__(TapeSpec)
        other._take({**{key: getattr(self, key) for key in KEYS}, **values})
        return other

    def to_mapping(self) -> dict[str, Any]:
        """Every option in its final form, for the manifest; a path of a profile is reduced to the file's name."""
        values = {key: _plain(value) for key, value in asdict(self).items() if key not in _LEFT_OUT or value != DEFAULTS[key]}
        return {**values, **{key: Path(values[key]).name for key in PROFILE_KEYS if values[key] is not None}}

    @property
    def place(self) -> tuple[int, int]:
        """The origin; (0, 0) if it is still to be searched for, where any tape fits that fits in the plane."""
        return (0, 0) if self.origin == BEST else self.origin

    @property
    def form(self) -> SolidForm | None:
        """Form of the solid models; None without models."""
        if self.base_mm is None:
            return None
        cylinder = None
        if self.cylinder_mm is not None:
            cylinder = Cylinder(radius_mm=self.cylinder_mm, around=cast(Axis, self.around), shell=cast(Shell, self.shell))
        return SolidForm(
            base_mm=self.base_mm, negative=self.negative, top=cast(Top, self.top), cylinder=cylinder, mark=bool(self.mark)
        )


_LEFT_OUT = ("directions", "sim", "mark")
"""Options that a manifest contains only if they differ from their defaults, as older versions did not have them."""
PROFILE_KEYS = ("fab", "part", "process")
KEYS = tuple(f.name for f in fields(TapeSpec))
DEFAULTS = {f.name: f.default for f in fields(TapeSpec) if f.default is not MISSING}


def read_spec(values: Mapping[str, Any]) -> tuple[TapeSpec, list[Problem]]:
    """Read untrusted values into a spec, and list every problem: unknown keys, a missing sector, invalid values.

    A refused value is replaced by a valid one in the spec, so that values that do not depend on it can be checked.
    """
    refuse_other(values, Mapping, "values", "mapping", 'keys and values, such as {"sector": 7}')
    problems = [unknown_key(key, KEYS) for key in values if key not in KEYS]
    if "sector" not in values:
        problems.append(Problem("sector", "sector is missing; give --sector N, or sector = N in the TOML file"))
    known = _plainly({key: value for key, value in values.items() if key in KEYS})
    read, refused = read_options({**DEFAULTS, "sector": 0, **known})
    spec = object.__new__(TapeSpec)
    spec._take(read)
    return spec, problems + refused


def _plainly(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values with lists in place of numpy arrays, and strings in place of paths of profiles."""
    lists = {key: value.tolist() if hasattr(value, "tolist") else value for key, value in values.items()}
    paths = {key: str(lists[key]) for key in PROFILE_KEYS if isinstance(lists.get(key), PurePath)}
    return {**lists, **paths}


def _plain(value: Any) -> Any:
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


def read_spec_file(path: Path) -> dict[str, Any]:
    """The values of a spec TOML; profile paths in it are relative to the file.

    Raises SpecError if the file cannot be read as TOML.
    """
    values = read_toml(path, "SPEC.toml")
    for key in PROFILE_KEYS:
        name = values.get(key)
        if isinstance(name, str) and is_profile_file(name):
            values[key] = str(path.parent / name)
    return values
