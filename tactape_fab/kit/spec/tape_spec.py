"""TapeSpec: everything a user may ask for, checked at the door."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from math import inf, isnan
from pathlib import Path
from typing import Any, Literal, cast

from tactape_fab.base.errors import CapacityError, Problem, SpecError
from tactape_fab.base.fields import Fields, shown, unknown_key
from tactape_fab.base.templates import profile_names, read_toml
from tactape_fab.kit.profiles import X2_MODES, ElementProfile, PartProfile, read_part
from tactape_fab.kit.spec.film_options import read_film_options
from tactape_fab.kit.spec.scatter import scatter_refusal
from tactape_fab.kit.spec.solid_options import DEFAULT_PROCESS, Part, read_solid_options
from tactape_fab.solids.forms import Axis, Cylinder, Shell, SolidForm, Top
from tactape_fab.texture.code import ALL_CODE_NAMES, CODE_NAMES, DEFAULT_CODE, Code, default_origin, get_code, read_directions
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS, PART_NUMBER_PATTERN, PART_NUMBER_REMEDY
from tactape_fab.texture.directions import DIRECTIONS, USUAL_DIRECTIONS
from tactape_fab.texture.frames import snap_mm
from tactape_fab.texture.tag import LEAST_CELL_MM
from tactape_fab.texture.tape import LONGEST_MM, MOST_HOLES, TAG_FAMILY, TAG_IDS

TAG_MODES = ("strip", "none")
BEST: Literal["best"] = "best"
"""In place of an origin: search for it."""
DEFAULT_FAB = "generic-fpc"
DEFAULT_CORNER_RADIUS_MM = 1.0
LEAST_PITCH_MM, MOST_PITCH_MM = 0.2, 20.0
LEAST_DISPLACEMENT_MM = 0.02
DEFAULT_PITCH_MM = 1.5
PITCH_PER_DISPLACEMENT = 6.0
_NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TapeSpec:
    """What a user asks for. Building one checks every value and reports all problems together.

    Attributes
    ----------
    sector : int
        Which of the code's sectors the tape shows; what the design of a touch code begins with.
    pitch_mm : float
        Grid pitch, the paper's W.
    displacement_mm : float
        Displacement of each part, the paper's Delta; a sixth of the pitch where None is given.
    size_mm : (float, float)
        Outline, width by height.
    code : str
    directions : int
        How many directions parts are displaced in: 4, or 8 of the touch code, where the parts stand where they should.
    origin : (int, int) or "best"
        Column and row of grid point (0, 0) in the code plane; the sector's default origin where None is given. ``"best"``
        is searched for when the tape is planned. (0, 0) for the touch code, which has no plane.
    tag : {"strip", "none"}
        A strip at the left end with AprilTag and label, or no strip. Where None is given a film has one, a texture of
        solid elements has none.
    tag_id : int or None
        Id of the AprilTag; the sector where None is given and there is a strip.
    tag_cell_mm : float
    part : str
        Profile name, or path of a TOML file: a part with lands, or a solid element (``block``, ``dome``, ``cone``).
    fab : str or None
        Profile name, or path of a TOML file; ``generic-fpc`` for a part with lands, None for a solid element.
    rotation_deg : float
        Rotation of every part, counter-clockwise, 0 along board x.
    assembly : str or None
        Format of CPL and BOM: the assembly house whose columns they have; the fab profile's where None is given.
    part_number : str or None
        Number of the part in the BOM, as that house takes it; the part profile's where None is given, none where it has none.
    x2 : str or None
        Gerber attributes: ``full``, as ``comments``, or ``off``; the fab profile's where None is given.
    corner_radius_mm : float
        1 where None is given, 0 for solid elements on a cylinder, whose corners are square.
    holes_mm : sequence of (float, float, float)
        Unplated holes (x, y, diameter) in the board frame.
    name : str
        Name of the tape and of its files; ``tactape-s007`` for sector 7 where None is given.
    body_mm : (float, float, float) or None
        Size of a solid element: length, width, height; of a dome the diameter (once or twice) and the height. The part
        profile's where None is given.
    dome_top_mm : float or None
        Diameter of a dome's flat top, which makes it a truncated cone; the part profile's where None is given.
    process : str or None
        Process profile (``sla``, ``fdm``, ``cnc``), or path of a TOML file; ``sla`` for a solid element.
    models : bool
        Whether the kit has 3D models. The keys below are None without them.
    base_mm : float or None
        Thickness of the solid models' base.
    negative : bool
        The mould instead of the texture.
    top : {"tiles", "single"} or None
    cylinder_mm : float or None
        Radius of the cylinder that the solid models are wrapped around.
    around : {"x", "y"} or None
    shell : {"segment", "whole"} or None
        See `tactape_fab.solids.forms`.
    coverlay : {"per-part", "lpi", "gang"} or None
        How the coverlay is opened; the first way of the fab profile that its limits allow where None is given.
    anchor : {"none", "spur", "mesh"}
        Copper that runs on from the pads under the coverlay and holds them.
    stiffener, adhesive : str or None
        What is laminated to the underside, material and thickness in mm, such as ``"FR4 0.2"``.
    bend_axis : {"x", "y"} or None
        Board axis that goes round where the tape is bent.
    bend_radius_mm : float or None

    Raises
    ------
    SpecError
        With every problem. CapacityError where the code's reach is the only one.
    """

    sector: int
    pitch_mm: float = DEFAULT_PITCH_MM
    displacement_mm: float = None  # type: ignore[assignment]
    size_mm: tuple[float, float] = (100.0, 50.0)
    code: str = DEFAULT_CODE
    directions: int = USUAL_DIRECTIONS
    origin: tuple[int, int] | Literal["best"] = None  # type: ignore[assignment]
    tag: str = None  # type: ignore[assignment]
    tag_id: int | None = None
    tag_cell_mm: float = 0.5
    part: str = "r0201"
    rotation_deg: float = 45.0
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

    def __post_init__(self) -> None:
        values, problems = _checked(asdict(self))
        if problems:
            reach_only = all(isinstance(p, _ReachProblem) for p in problems)
            raise (CapacityError if reach_only else SpecError)(problems)
        for key, value in values.items():
            object.__setattr__(self, key, value)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> TapeSpec:
        """Build a spec from untrusted values, such as TOML and command-line options.

        Parameters
        ----------
        values : mapping
            Option names, as among the attributes, to values.

        Returns
        -------
        TapeSpec

        Raises
        ------
        SpecError
            Every problem found, unknown keys included.
        """
        problems = [unknown_key(key, KEYS) for key in values if key not in KEYS]
        known = {key: value for key, value in values.items() if key in KEYS}
        if "sector" not in known:
            problems.append(Problem("sector", "sector is missing; give --sector N, or sector = N in the TOML file"))
        try:
            spec = cls(**{"sector": 0, **known})
        except SpecError as error:
            if not problems:
                raise
            raise SpecError([*problems, *error.problems]) from None
        if problems:
            raise SpecError(problems)
        return spec

    def to_mapping(self) -> dict[str, Any]:
        """Every option as understood, for the manifest; of a profile's path only the file's name, wherever it stood."""
        values = {key: _plain(value) for key, value in asdict(self).items() if (key, value) != ("directions", USUAL_DIRECTIONS)}
        return {**values, **{key: Path(values[key]).name for key in PROFILE_KEYS if values[key] is not None}}

    @property
    def place(self) -> tuple[int, int]:
        """The origin; where it is still to be searched for (0, 0), where every tape fits that fits anywhere."""
        return (0, 0) if self.origin == BEST else self.origin

    @property
    def form(self) -> SolidForm | None:
        """What the solid models are like; None without models."""
        if self.base_mm is None:
            return None
        cylinder = None
        if self.cylinder_mm is not None:
            cylinder = Cylinder(radius_mm=self.cylinder_mm, around=cast(Axis, self.around), shell=cast(Shell, self.shell))
        return SolidForm(base_mm=self.base_mm, negative=self.negative, top=cast(Top, self.top), cylinder=cylinder)


PROFILE_KEYS = ("fab", "part", "process")
KEYS = tuple(f.name for f in fields(TapeSpec))


class _ReachProblem(Problem):
    """A problem of capacity: legal numbers that ask for more than the code has."""


def _plain(value: Any) -> Any:
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


def read_spec_file(path: Path) -> dict[str, Any]:
    """The values of a spec TOML; profile paths in it are relative to the file.

    Raises
    ------
    SpecError
        When the file cannot be read as TOML.
    """
    values = read_toml(path, "spec file")
    for key in PROFILE_KEYS:
        name = values.get(key)
        if isinstance(name, str) and name.endswith(".toml"):
            values[key] = str(path.parent / name)
    return values


def _checked(raw: dict[str, Any]) -> tuple[dict[str, Any], list[Problem]]:
    """All values in their final form, and all problems."""
    table = Fields({key: value for key, value in raw.items() if value is not None})
    code = get_code(table.text("code", choices=ALL_CODE_NAMES, default=DEFAULT_CODE))
    if table.problems:  # an unknown code: judge the sector by the code that has most
        code = max(map(get_code, CODE_NAMES), key=lambda c: c.sectors)
    sector = table.integer(
        "sector",
        low=0,
        high=code.sectors - 1,
        remedy=f"code '{code.name}' has {code.sectors} sectors; "
        + ("'anoto-6x6' has 3969" if code.sectors < 3969 else "take one of them"),
    )
    pitch_mm = _pitch(table)
    values: dict[str, Any] = {
        "code": code.name,
        "sector": sector,
        "pitch_mm": pitch_mm,
        "displacement_mm": _displacement(table, pitch_mm),
        "size_mm": _size(table, pitch_mm, code.name, code.range),
        "origin": _origin(table, code, sector),
        "tag_cell_mm": _snapped(table.number("tag_cell_mm", low=LEAST_CELL_MM, high=5.0, default=0.5)),
        "rotation_deg": table.number("rotation_deg", low=-360.0, high=360.0, unit="deg", default=45.0) % 360.0,
        "part": _profile_name(table, "part", "parts"),
    }
    part = _part(table, values["part"])
    values["directions"] = _directions(table, code, part, values["displacement_mm"])
    values |= read_solid_options(table, part)
    values |= _of_the_film(table, isinstance(part, ElementProfile))
    values |= read_film_options(table, solid=isinstance(part, ElementProfile))
    values["process"] = _process(table, part)
    values["tag_id"] = _tag_id(table, values["tag"], sector)
    values["corner_radius_mm"] = _corner_radius(table, part, values)
    values["holes_mm"] = _holes(table, values["size_mm"])
    for key, choices in (("assembly", ASSEMBLY_FORMATS), ("x2", X2_MODES)):
        values[key] = table.text(key, choices=choices) if key in table.values else None
    values["part_number"] = (
        table.text("part_number", pattern=PART_NUMBER_PATTERN, remedy=PART_NUMBER_REMEDY)
        if "part_number" in table.values
        else None
    )
    values["name"] = (
        table.text("name", pattern=_NAME_PATTERN, remedy="use 1 to 64 letters, digits, '.', '_', '-'")
        if "name" in table.values
        else f"tactape-s{sector:03d}"
    )
    return values, table.problems


def _part(table: Fields, name: str) -> Part | None:
    """The part's profile, to know its kind; one that cannot be read counts as none, `examine` says why."""
    if _refused(table, "part"):
        return None
    try:
        return read_part(name)
    except SpecError:
        return None


def _of_the_film(table: Fields, solid: bool) -> dict[str, Any]:
    """Tag and fab: a film has both unless told otherwise, solid elements have neither."""
    if solid:
        return {"tag": "none", "fab": None}
    return {
        "tag": table.text("tag", choices=TAG_MODES, default="none") if "tag" in table.values else "strip",
        "fab": _profile_name(table, "fab", "fabs") if "fab" in table.values else DEFAULT_FAB,
    }


def _process(table: Fields, part: Part | None) -> str | None:
    if "process" in table.values:
        return _profile_name(table, "process", "processes")
    return DEFAULT_PROCESS if isinstance(part, ElementProfile) else None


def _corner_radius(table: Fields, part: Part | None, values: dict[str, Any]) -> float:
    square = isinstance(part, ElementProfile) and values["cylinder_mm"] is not None
    given = table.values.get("corner_radius_mm", 0.0 if square else DEFAULT_CORNER_RADIUS_MM)
    radius_mm = Fields({"corner_radius_mm": given}, "", table.problems).number(
        "corner_radius_mm",
        low=0.0,
        high=LONGEST_MM if _refused(table, "size_mm") else min(values["size_mm"]) / 2,
        remedy="half the shorter side at most",
    )
    if square and radius_mm > 0.0:
        table.problem(
            "corner_radius_mm",
            f"corner_radius_mm = {radius_mm:g} mm contradicts cylinder_mm: a wrapped texture has square corners, 0 mm; "
            "leave out --corner-radius",
        )
    return _snapped(radius_mm)


def _refused(table: Fields, key: str) -> bool:
    """Whether a value was refused before: what rests on it cannot be judged."""
    return any(problem.key.startswith(key) for problem in table.problems)


def _snapped(value_mm: float) -> float:
    return value_mm if isnan(value_mm) else float(snap_mm(value_mm))


def _pitch(table: Fields) -> float:
    remedy = f"--w is the grid pitch in millimetres, {LEAST_PITCH_MM} to {MOST_PITCH_MM:g}, usually {DEFAULT_PITCH_MM}"
    return _snapped(table.number("pitch_mm", low=LEAST_PITCH_MM, high=MOST_PITCH_MM, remedy=remedy, default=DEFAULT_PITCH_MM))


def _displacement(table: Fields, pitch_mm: float) -> float:
    usual = pitch_mm / PITCH_PER_DISPLACEMENT
    if "displacement_mm" not in table.values:
        return _snapped(usual)
    remedy = f"--delta is the displacement in millimetres, {LEAST_DISPLACEMENT_MM} to less than half the pitch {pitch_mm:g}"
    return _snapped(
        table.number(
            "displacement_mm",
            low=LEAST_DISPLACEMENT_MM,
            below=inf if _refused(table, "pitch_mm") else pitch_mm / 2,
            remedy=f"{remedy}, usually {usual:g}",
            default=usual,
        )
    )


def _directions(table: Fields, code: Code, part: Part | None, displacement_mm: float) -> int:
    """Eight directions are of the touch code, and of parts that do not scatter too much for it."""
    directions = read_directions(table, None if _refused(table, "code") else code)
    if not DIRECTIONS[directions].usual and isinstance(part, PartProfile) and not _refused(table, "displacement_mm"):
        refusal = None if _refused(table, "directions") else scatter_refusal(displacement_mm)
        if refusal is not None:
            table.problem("directions", refusal)
    return directions


def _size(table: Fields, pitch_mm: float, code_name: str, code_range: int) -> tuple[float, float]:
    width, height = table.numbers(
        "size_mm", 2, above=0.0, high=LONGEST_MM, remedy="give WIDTHxHEIGHT in millimetres, such as 100x50", default=(100.0, 50.0)
    )
    reach_mm = inf if _refused(table, "pitch_mm") else code_range * pitch_mm
    code = _code_of_reach(max(width, height) / pitch_mm)
    larger = f"use --code {code} or a smaller tape" if code else "use a smaller tape"
    for i, side_mm in enumerate((width, height)):
        if side_mm > reach_mm:
            message = (
                f"size_mm[{i}] = {side_mm} mm exceeds {reach_mm} mm, the reach of code '{code_name}' at pitch "
                f"{pitch_mm} mm; {larger}"
            )
            table.problems.append(_ReachProblem("size_mm", message))
    return _snapped(width), _snapped(height)


def _code_of_reach(points: float) -> str:
    """The code of least range that has so many points along an axis, '' where none has."""
    reaching = [name for name in CODE_NAMES if get_code(name).range >= points]
    return min(reaching, key=lambda name: get_code(name).range, default="")


def _origin(table: Fields, code: Code, sector: int) -> tuple[int, int] | Literal["best"]:
    if "origin" not in table.values:
        return default_origin(code.name, sector)
    if code.plane is None:
        if table.values["origin"] not in ((0, 0), [0, 0]):
            given = shown(table.values["origin"])
            message = f"origin = {given} means nothing with code '{code.name}', which has no plane: its tapes are designed"
            table.problem("origin", f"{message}; leave --origin out, and use another --sector for another tape")
        return code.default_origin(sector)
    if table.values["origin"] == BEST:
        return BEST
    remedy = f"give --origin COL,ROW with both from 0 to {code.range - 1}, or best, or leave it to the sector's default"
    column, row = table.integers("origin", 2, low=0, high=code.range - 1, remedy=remedy)
    return column, row


def _profile_name(table: Fields, key: str, kind: str) -> str:
    """A profile's name or path; whether a path can be read is found when it is loaded."""
    name = table.text(key, longest=4096)
    if name and not name.endswith(".toml") and name not in (known := profile_names(kind)):
        table.problem(key, f"{key} = {shown(name)} is none of: {', '.join(known)}, nor the path of a .toml file")
    return name


def _tag_id(table: Fields, tag: str, sector: int) -> int | None:
    if tag == "none":
        if "tag_id" in table.values:
            table.problem("tag_id", f"tag_id = {shown(table.values['tag_id'])} contradicts tag = 'none'; give one of them")
        return None
    if "tag_id" in table.values:
        return table.integer("tag_id", low=0, high=TAG_IDS - 1, remedy=f"family {TAG_FAMILY} has {TAG_IDS} ids")
    if sector >= TAG_IDS:
        table.problem(
            "tag_id",
            f"sector = {sector} exceeds {TAG_IDS - 1}, the last id of {TAG_FAMILY}; choose an id with --tag-id or use --tag none",
        )
        return 0
    return sector


def _holes(table: Fields, size_mm: tuple[float, float]) -> tuple[tuple[float, float, float], ...]:
    holes = []
    for i, hole in enumerate(table.rows("holes_mm", longest=MOST_HOLES)):
        key = f"holes_mm[{i}]"
        x, y, d = Fields({key: hole}, "", table.problems).numbers(
            key, 3, above=0.0, high=LONGEST_MM, remedy="give X,Y,DIAMETER in mm"
        )
        if _refused(table, "size_mm"):
            pass
        elif x + d / 2 >= size_mm[0] or y + d / 2 >= size_mm[1] or x <= d / 2 or y <= d / 2:
            table.problem(
                key, f"{key} = {x:g},{y:g},{d:g} mm does not lie inside the outline {size_mm[0]:g} x {size_mm[1]:g} mm; move it"
            )
        holes.append((round(x, 4), round(y, 4), round(d, 4)))  # as many decimals as the drill file has
    return tuple(holes)
