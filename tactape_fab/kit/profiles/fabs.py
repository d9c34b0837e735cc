"""Fab profiles: limits of a fab, and format of its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, cast

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import Fields, nearest, shown
from tactape_fab.base.templates import is_profile_file, profile_names, read_once, refuse_problems
from tactape_fab.kit.profiles.fab_tables import (
    AnchorRules,
    Backing,
    BendRules,
    CoverlayMode,
    PanelRules,
    PartsLimit,
    StencilRules,
    read_anchor,
    read_backing,
    read_bend,
    read_modes,
    read_panel,
    read_parts_limit,
    read_stencil,
)
from tactape_fab.kit.profiles.inherited import fab_table
from tactape_fab.kit.profiles.limits import (
    ORIGIN_KEYS,
    SOURCE_KEYS,
    Limit,
    Origin,
    SizeLimit,
    read_level,
    read_limit,
    read_origin,
)
from tactape_fab.kit.profiles.ordering import Ordering, read_ordering
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS

X2_MODES = ("full", "comments", "off")
LIMIT_IDS = (
    "pad-pad",
    "body-body",
    "pad-edge",
    "body-edge",
    "opening-size",
    "opening-bridge",
    "opening-expansion",
    "opening-edge",
    "opening-legend",
    "hole-edge",
    "hole-copper",
    "hole-part",
    "hole-hole",
    "hole-legend",
    "hole-size",
    "courtyard",
    "corner-radius",
)
GERBER_ROLES = (
    "copper-top",
    "coverlay-top",
    "paste-top",
    "legend-top",
    "profile",
    "drill-npth",
    "stiffener-bottom",
    "adhesive-bottom",
    "components-top",
    "job",
)
BACKING_ROLES = ("stiffener-bottom", "adhesive-bottom")
"""Roles of layers laminated to the underside; their file names contain the material."""
_TABLES = (
    *("name", "title", "material", "colours", "gerber", "assembly", "files", "coverlay", "legend", "limits", "size"),
    *("anchor", "stiffener", "adhesive", "stencil", "bend", "parts", "panel", "order"),
)
LEAST_LEGEND_MM = {"line_mm": 0.01, "text_mm": 0.1, "gap_mm": 0.0, "bleed_mm": 0.0, "edge_mm": 0.0}
"""Least values of the legend's sizes: with a text height of 0 a strip would hold infinitely many lines, and lines of no width
are no ink.
"""
# faces of a board next to nothing thick have no direction in the STEP file
_LEAST_THICKNESS_MM = 0.001
_LEGEND_KEYS = tuple(LEAST_LEGEND_MM)
_COLOURS_ALIKE = {"white": ("white",), "black": ("black",)}
_BEFORE = r"([A-Za-z0-9_-][A-Za-z0-9._-]{0,29})?"
"""Optional prefix of {name} in the name of a file."""
_FILE_NAME = r"(?:" + _BEFORE + r"\{name\})?[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}|" + _BEFORE + r"\{name\}\.[A-Za-z0-9._-]{1,99}"
_BACKING_NAME = r"(?:" + _BEFORE + r"\{name\})?[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}\{material\}[A-Za-z0-9._-]{0,99}"

X2Mode = Literal["full", "comments", "off"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """The material of a board: `thickness_mm` of all layers together, `copper_um` of the copper alone."""

    base: str
    thickness_mm: float
    copper_um: float
    layers: int
    finish: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LegendSizes:
    """``line_mm`` thinnest ink line, ``text_mm`` least cap height, ``gap_mm`` least gap between inked areas,
    ``bleed_mm`` bleed of ink over an edge, ``edge_mm`` least distance of ink from the outline.
    """

    line_mm: float
    text_mm: float
    gap_mm: float
    bleed_mm: float
    edge_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LegendRules(LegendSizes):
    origin: Origin


@dataclass(frozen=True, slots=True, kw_only=True)
class FabProfile:
    """Limits of a fab, and format of its files.

    ``limits`` holds one `Limit` for each of LIMIT_IDS; ``file_names`` one name pattern per Gerber role.
    ``coverlay_modes`` are the ways in which the fab opens the coverlay or solder mask, ``coverlay_mode`` the one in use.
    """

    name: str
    title: str
    material: Material
    coverlay_colour: str
    legend_colour: str
    x2: X2Mode
    job_in_zip: bool
    assembly: str
    file_names: Mapping[str, str]
    coverlay_expansion_mm: float
    coverlay_modes: tuple[CoverlayMode, ...]
    coverlay_mode: CoverlayMode
    anchor: AnchorRules
    stiffener: Backing
    adhesive: Backing
    stencil: StencilRules
    bend: BendRules | None
    parts: PartsLimit
    panel: PanelRules
    order: Ordering
    legend: LegendRules
    limits: Mapping[str, Limit]
    size: SizeLimit

    def file_path(self, role: str, tape_name: str, material: str = "") -> str:
        """Path of a fabrication file relative to the kit's folder; `material` is that of a backing, see `material_words`."""
        return f"gerber/{self.file_names[role].replace('{name}', tape_name).replace('{material}', material)}"

    @property
    def largest_panel_mm(self) -> tuple[float, float]:
        """Longer and shorter side of the largest panel, within the fab's limit for boards and that of the assembly line."""
        (longer, shorter), board = self.panel.largest_mm, self.size.largest_mm
        return min(longer, board[0]), min(shorter, board[1])

    @property
    def largest_railed_mm(self) -> tuple[float, float]:
        """Longer and shorter side of the largest board that fits on a panel: a panel of one has two rails and two slots."""
        around_mm, (longer, shorter) = 2 * (self.panel.rail_mm + self.panel.gap_mm), self.largest_panel_mm
        return longer - around_mm, shorter - around_mm

    @property
    def mask_name(self) -> str:
        """Name of the layer that covers the copper: a coverlay with cut openings, or a photoimageable solder mask."""
        return "solder mask" if "lpi" in self.coverlay_modes else "coverlay"

    def in_mode(self, mode: CoverlayMode) -> FabProfile:
        """The profile with another coverlay mode.

        With one opening for all parts the remaining coverlay is a frame, whose width must meet the limit of a bridge.
        """
        limits = dict(self.limits)
        bridge = limits["opening-bridge"]
        if mode == "gang" and bridge.value_mm > limits["opening-edge"].value_mm:
            limits["opening-edge"] = bridge
        return replace(self, coverlay_mode=mode, limits=limits)

    def thresholds(self) -> dict[str, Any]:
        """The thresholds and colours as the manifest records them."""
        return {
            "coverlay_colour": self.coverlay_colour,
            "legend_colour": self.legend_colour,
            "coverlay_expansion_mm": self.coverlay_expansion_mm,
            "coverlay_mode": self.coverlay_mode,
            "job_in_zip": self.job_in_zip,
            "legend_bleed_mm": self.legend.bleed_mm,
            "legend_gap_mm": self.legend.gap_mm,
            "legend_line_mm": self.legend.line_mm,
            "legend_text_mm": self.legend.text_mm,
            "legend_edge_mm": self.legend.edge_mm,
            "material": {**asdict(self.material), "mask": self.mask_name, "flexible": self.bend is not None},
            "largest_board_mm": list(self.size.largest_mm),
            "limits_mm": {name: limit.value_mm for name, limit in self.limits.items()},
        }


@read_once("fabs")
def load_fab(name: str) -> FabProfile:
    """A fab profile by name, or by the path of a TOML file, merged with those that it ``extends``.

    Raises SpecError: every problem found in it.
    """
    table = fab_table(name)
    table.refuse_unknown(_TABLES)
    material = table.table("material", ("base", "thickness_mm", "copper_um", "layers", "finish"))
    colours = table.table("colours", ("coverlay", "legend"))
    gerber = table.table("gerber", ("x2", "job_in_zip"))
    assembly = table.table("assembly", ("format",))
    coverlay = table.table("coverlay", ("expansion_mm", "modes"))
    legend = table.table("legend", (*_LEGEND_KEYS, *ORIGIN_KEYS))
    files = table.table("files", GERBER_ROLES)
    limits = table.table("limits", LIMIT_IDS)
    modes = read_modes(coverlay)
    size = table.table("size", ("largest_mm", *SOURCE_KEYS))
    largest = size.numbers("largest_mm", 2, above=0.0)
    # with equal names one file would overwrite the other
    given = [(role, files.values[role]) for role in GERBER_ROLES if isinstance(files.values.get(role), str)]
    for shared in dict.fromkeys(name for _, name in given):
        roles = [role for role, name in given if name.casefold() == shared.casefold()]  # one name on Windows and macOS
        if len(roles) > 1 and shared == files.values[roles[0]]:
            files.problem(roles[0], f"{' and '.join(roles)} = {shown(shared)} would be one file; give each a name of its own")
    if colours.values.get("legend") in _COLOURS_ALIKE.get(str(colours.values.get("coverlay")), ()):
        both = colours.values["legend"]
        colours.problem("legend", f"legend = {both!r} on coverlay {both!r} cannot be seen, nor its tag; give another of the two")
    profile = FabProfile(
        name=table.text("name", longest=100),
        title=table.text("title"),
        material=Material(
            base=_one_blank(material.text("base")),
            thickness_mm=material.number("thickness_mm", low=_LEAST_THICKNESS_MM, high=10.0),
            copper_um=material.number("copper_um", above=0.0, high=1000.0, unit="um"),
            layers=material.integer("layers", low=1, high=64),
            finish=_one_blank(material.text("finish")),
        ),
        coverlay_colour=colours.text("coverlay", choices=("amber", "black", "white", "yellow", "green")),
        legend_colour=colours.text("legend", choices=("white", "black")),
        x2=cast(X2Mode, gerber.text("x2", choices=X2_MODES)),
        job_in_zip=gerber.flag("job_in_zip"),
        assembly=assembly.text("format", choices=ASSEMBLY_FORMATS),
        file_names={role: _file_name(files, role) for role in GERBER_ROLES},
        coverlay_expansion_mm=coverlay.number("expansion_mm", low=0.0, high=1.0),
        coverlay_modes=modes,
        coverlay_mode=modes[0],
        anchor=read_anchor(table),
        stiffener=read_backing(table, "stiffener"),
        adhesive=read_backing(table, "adhesive"),
        stencil=read_stencil(table),
        bend=read_bend(table),
        parts=read_parts_limit(table),
        panel=read_panel(table),
        order=read_ordering(table),
        legend=LegendRules(
            origin=read_origin(legend), **{key: legend.number(key, low=low, high=10.0) for key, low in LEAST_LEGEND_MM.items()}
        ),
        limits={name: read_limit(limits.table(name, ("value_mm", "warn_mm", *SOURCE_KEYS))) for name in LIMIT_IDS},
        size=SizeLimit(
            largest_mm=(max(largest), min(largest)),
            level=read_level(size),
            **asdict(read_origin(size)),
        ),
    )
    refuse_problems(table)
    return profile


def _one_blank(text: str) -> str:
    """A text with single blanks between its words, as notes, drawing and forms print it."""
    return " ".join(text.split())


def _file_name(files: Fields, role: str) -> str:
    if role in BACKING_ROLES:
        remedy = "give a file name of letters and digits, with {name} for the tape's and {material} for material and thickness"
        return files.text(role, pattern=_BACKING_NAME, remedy=remedy)
    return files.text(role, pattern=_FILE_NAME, remedy="give a file name of letters and digits, with {name} for the tape's")


def house_fab(house: str) -> str:
    """Name of the fab profile of a house, preferably one for films; the name or file of a profile is returned as it is.

    Raises SpecError if no profile is of that house.
    """
    known = profile_names("fabs")
    own = [name for name in known if name.partition("-")[0] == house]
    if house in known or is_profile_file(house):
        return house
    if own:
        return f"{house}-fpc" if f"{house}-fpc" in own else own[0]
    houses = sorted({name.partition("-")[0] for name in known})
    near = nearest(house, [*houses, *known])
    hint = f"did you mean '{near}'?" if near else "give one of them, a profile's name, or a .toml file"
    raise SpecError(Problem("order", f"order = {shown(house)} is none of: {', '.join(houses)}; {hint}"))
