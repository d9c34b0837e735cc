"""Fab and part profiles: data files of templates/, or a user's own TOML by path, read into plain records."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any, Literal, cast

from tactape_fab.errors import Level, Problem, SpecError
from tactape_fab.fields import Fields, shown, shown_path
from tactape_fab.texture.tape import PART_SHAPES

X2_MODES = ("full", "comments", "off")
ASSEMBLY_FORMATS = ("generic", "jlcpcb")
LIMIT_IDS = (
    "pad-pad",
    "body-body",
    "pad-edge",
    "body-edge",
    "opening-size",
    "opening-bridge",
    "opening-edge",
    "opening-legend",
    "hole-edge",
    "hole-copper",
    "hole-part",
    "hole-hole",
    "hole-legend",
    "hole-size",
    "courtyard",
)
GERBER_ROLES = ("copper-top", "coverlay-top", "paste-top", "legend-top", "profile", "drill-npth", "components-top", "job")
_PROFILE_BYTES = 1024 * 1024
_LEGEND_KEYS = ("line_mm", "text_mm", "gap_mm", "bleed_mm", "edge_mm")
_COLOURS_ALIKE = {"white": ("white",), "black": ("black",)}
_SOURCE_KEYS = ("level", "source", "date", "confirmed")
_LAND_KEYS = ("size_mm", "corner_radius_mm", "offset_mm")
_FILE_NAME = r"(\{name\})?[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}|\{name\}\.[A-Za-z0-9._-]{1,99}"

X2Mode = Literal["full", "comments", "off"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """One threshold of a fab, where it comes from, and whether the fab confirmed it."""

    value_mm: float
    level: Level
    source: str
    date: str
    confirmed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeLimit:
    """The largest board, (longer side, shorter side)."""

    largest_mm: tuple[float, float]
    level: Level
    source: str
    date: str
    confirmed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    base: str
    thickness_mm: float
    copper_um: float
    layers: int
    finish: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LegendRules:
    """``line_mm`` thinnest ink line, ``text_mm`` least capital height, ``gap_mm`` least gap between inked areas,
    ``bleed_mm`` how far ink runs over an edge, ``edge_mm`` ink to outline.
    """

    line_mm: float
    text_mm: float
    gap_mm: float
    bleed_mm: float
    edge_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FabProfile:
    """What a fab can make and how it wants its files.

    ``limits`` holds one `Limit` for each of LIMIT_IDS; ``file_names`` one name pattern per Gerber role.
    """

    name: str
    title: str
    material: Material
    coverlay_colour: str
    legend_colour: str
    x2: X2Mode
    assembly: str
    file_names: Mapping[str, str]
    coverlay_expansion_mm: float
    legend: LegendRules
    limits: Mapping[str, Limit]
    size: SizeLimit

    def file_path(self, role: str, tape_name: str) -> str:
        """Path of a fabrication file relative to the kit's folder."""
        return f"gerber/{self.file_names[role].replace('{name}', tape_name)}"

    def thresholds(self) -> dict[str, Any]:
        """The thresholds and colours as the manifest records them."""
        return {
            "coverlay_colour": self.coverlay_colour,
            "legend_colour": self.legend_colour,
            "coverlay_expansion_mm": self.coverlay_expansion_mm,
            "legend_bleed_mm": self.legend.bleed_mm,
            "legend_gap_mm": self.legend.gap_mm,
            "largest_board_mm": list(self.size.largest_mm),
            "limits_mm": {name: limit.value_mm for name, limit in self.limits.items()},
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class LandPattern:
    """A pair of rounded rectangles at (-offset, 0) and (+offset, 0) of the unturned part."""

    size_mm: tuple[float, float]
    corner_radius_mm: float
    offset_mm: float

    @property
    def area_mm2(self) -> float:
        """Exact area of one of the two lands."""
        return self.size_mm[0] * self.size_mm[1] - (4 - pi) * self.corner_radius_mm**2


@dataclass(frozen=True, slots=True, kw_only=True)
class PartProfile:
    """An element that stands on the grid points, unturned (long axis along x)."""

    name: str
    shape: str
    value: str
    description: str
    footprint: str
    body_mm: tuple[float, float, float]
    body_tolerance_mm: float
    pads: LandPattern
    paste: LandPattern
    courtyard_mm: tuple[float, float]


def templates_folder() -> Path:
    """Folder of the data files: inside the package in a wheel, beside it in a checkout or an editable install."""
    package = Path(__file__).resolve().parent
    for folder in (package / "templates", package.parent / "templates"):
        if folder.is_dir():
            return folder
    raise FileNotFoundError("the templates folder is missing from this installation of tactape-fab; install it again")


def profile_names(kind: str) -> list[str]:
    """Names of the profiles that come with the package; kind is ``fabs`` or ``parts``."""
    return sorted(path.stem for path in (templates_folder() / kind).glob("*.toml"))


def read_toml(path: Path, key: str) -> dict[str, Any]:
    """A TOML file of bounded size as a mapping.

    Raises
    ------
    SpecError
        When it cannot be opened, is too large, or is no TOML.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(_PROFILE_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a path that no system takes
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        message = f"{key} = {shown_path(path)} cannot be opened: {reason}; give the path of a TOML file that can be read"
        raise SpecError(Problem(key, message)) from error
    if len(data) > _PROFILE_BYTES:
        raise SpecError(
            Problem(key, f"{key} = {path} is larger than {_PROFILE_BYTES} bytes; it is not a spec or profile, give one")
        )
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # UnicodeDecodeError and TOMLDecodeError among them
        raise SpecError(Problem(key, f"{key} = {path} is not TOML: {error}; correct it")) from error


def _profile_table(kind: str, key: str, name: str) -> Fields:
    if name.endswith(".toml"):
        path = Path(name)
    elif name in (known := profile_names(kind)):
        path = templates_folder() / kind / f"{name}.toml"
    else:
        raise SpecError(Problem(key, f"{key} = {shown(name)} is none of: {', '.join(known)}, nor the path of a .toml file"))
    return Fields(read_toml(path, key), f"{key} {path.stem}: ")


def load_fab(name: str) -> FabProfile:
    """A fab profile by name, or by the path of a TOML file.

    Raises
    ------
    SpecError
        Every problem found in it.
    """
    table = _profile_table("fabs", "fab", name)
    table.refuse_unknown(
        ("name", "title", "material", "colours", "gerber", "assembly", "files", "coverlay", "legend", "limits", "size")
    )
    material = table.table("material", ("base", "thickness_mm", "copper_um", "layers", "finish"))
    colours = table.table("colours", ("coverlay", "legend"))
    gerber = table.table("gerber", ("x2",))
    assembly = table.table("assembly", ("format",))
    coverlay = table.table("coverlay", ("expansion_mm",))
    legend = table.table("legend", _LEGEND_KEYS)
    files = table.table("files", GERBER_ROLES)
    limits = table.table("limits", LIMIT_IDS)
    size = table.table("size", ("largest_mm", *_SOURCE_KEYS))
    largest = size.numbers("largest_mm", 2, above=0.0)
    names = [files.values[role] for role in GERBER_ROLES if isinstance(files.values.get(role), str)]
    for shared in sorted({n for n in names if names.count(n) > 1}):
        files.problem("files", f"{shown(shared)} stands at two roles, which cannot share a file name; give each its own")
    if colours.values.get("legend") in _COLOURS_ALIKE.get(str(colours.values.get("coverlay")), ()):
        both = colours.values["legend"]
        colours.problem("legend", f"legend = {both!r} on coverlay {both!r} cannot be seen, nor its tag; give another of the two")
    profile = FabProfile(
        name=table.text("name", longest=100),
        title=table.text("title"),
        material=Material(
            base=material.text("base"),
            thickness_mm=material.number("thickness_mm", above=0.0, high=10.0),
            copper_um=material.number("copper_um", above=0.0, high=1000.0, unit="um"),
            layers=material.integer("layers", low=1, high=64),
            finish=material.text("finish"),
        ),
        coverlay_colour=colours.text("coverlay", choices=("amber", "black", "white", "yellow", "green")),
        legend_colour=colours.text("legend", choices=("white", "black")),
        x2=cast(X2Mode, gerber.text("x2", choices=X2_MODES)),
        assembly=assembly.text("format", choices=ASSEMBLY_FORMATS),
        file_names={
            role: files.text(role, pattern=_FILE_NAME, remedy="give a file name, with {name} for the tape's")
            for role in GERBER_ROLES
        },
        coverlay_expansion_mm=coverlay.number("expansion_mm", low=0.0, high=1.0),
        legend=LegendRules(**{key: legend.number(key, low=0.0, high=10.0) for key in _LEGEND_KEYS}),
        limits={name: _read_limit(limits.table(name, ("value_mm", *_SOURCE_KEYS))) for name in LIMIT_IDS},
        size=SizeLimit(
            largest_mm=(max(largest), min(largest)),
            level=_read_level(size),
            source=size.text("source"),
            date=size.text("date"),
            confirmed=size.flag("confirmed"),
        ),
    )
    _refuse_problems(table)
    return profile


def _read_limit(table: Fields) -> Limit:
    return Limit(
        value_mm=table.number("value_mm", low=0.0, high=100.0),
        level=_read_level(table),
        source=table.text("source"),
        date=table.text("date"),
        confirmed=table.flag("confirmed"),
    )


def _read_level(table: Fields) -> Level:
    return cast(Level, table.text("level", choices=("block", "warn", "info"), default="block"))


def load_part(name: str) -> PartProfile:
    """A part profile by name, or by the path of a TOML file.

    Raises
    ------
    SpecError
        Every problem found in it.
    """
    table = _profile_table("parts", "part", name)
    table.refuse_unknown(("name", "shape", "value", "description", "footprint", "body", "pads", "paste", "courtyard"))
    body = table.table("body", ("size_mm", "tolerance_mm"))
    length, width, height = body.numbers("size_mm", 3, above=0.0, high=20.0)
    courtyard = table.table("courtyard", ("size_mm",)).numbers("size_mm", 2, above=0.0, high=40.0)
    profile = PartProfile(
        name=table.text("name", pattern=r"[A-Za-z0-9._-]{1,64}", remedy="use letters, digits, '.', '_', '-'"),
        shape=table.text("shape", choices=PART_SHAPES),
        value=_attribute_text(table, "value"),
        description=_attribute_text(table, "description"),
        footprint=_attribute_text(table, "footprint"),
        body_mm=(length, width, height),
        body_tolerance_mm=body.number("tolerance_mm", low=0.0, high=1.0),
        pads=read_land(table.table("pads", _LAND_KEYS)),
        paste=read_land(table.table("paste", _LAND_KEYS)),
        courtyard_mm=(courtyard[0], courtyard[1]),
    )
    _refuse_problems(table)
    return profile


def _attribute_text(table: Fields, key: str) -> str:
    """A text that may stand in a Gerber attribute or a CSV cell: one line of plain characters, no field separators."""
    return table.text(key, pattern=r"[A-Za-z0-9 ._()+/,-]{1,200}", remedy="use plain letters, digits and ._()+/,-")


def read_land(table: Fields) -> LandPattern:
    """A land pattern out of a table of a part profile or a manifest; problems are collected in `table`."""
    size = table.numbers("size_mm", 2, above=0.0, high=20.0)
    return LandPattern(
        size_mm=(size[0], size[1]),
        corner_radius_mm=table.number("corner_radius_mm", low=0.0, high=min(size) / 2),
        offset_mm=table.number("offset_mm", above=size[0] / 2, high=20.0, remedy="the two pads must not touch"),
    )


def _refuse_problems(table: Fields) -> None:
    if table.problems:
        raise SpecError(table.problems)
