"""Drawing: the shapes of one set of fabrication files, for a tape or a panel; the input of the layer renderers."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tactape_fab.base.version import __version__
from tactape_fab.kit.film.anchors import Anchors
from tactape_fab.kit.film.layout import Flashes, Layout, Legend
from tactape_fab.kit.outlines import PartOutlines
from tactape_fab.kit.profiles import PartProfile
from tactape_fab.texture.frames import FloatArray, pair_of, snap_mm

Hole = tuple[float, float, float]
Offset = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fiducials:
    """Fiducials for the assembly line's cameras: discs of bare copper in wider mask openings.

    xy_mm (k, 2)
    copper_mm, opening_mm: Diameters.
    """

    xy_mm: FloatArray
    copper_mm: float
    opening_mm: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parts:
    """The parts of one tape, all with the same rotation, with their lands and openings.

    Attributes
    ----------
    rotation_deg : float
    xy_mm : ndarray, shape (n, 2)
    pads, paste, openings, bodies : Flashes
        As in `Layout`; ``openings`` is None if one window is opened for all parts.
    """

    rotation_deg: float
    xy_mm: FloatArray
    pads: Flashes
    paste: Flashes
    openings: Flashes | None
    bodies: Flashes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawing:
    """Shapes of one set of fabrication files; frame: x right, y up from the lower left corner of its outline, mm.

    project: Name and identity of its files.
    size_mm, corner_radius_mm, outline_mm: The outline, and the same with rounded corners as polylines, shape (k, 2).
    holes (x, y, diameter)
    parts: Parts of each tape; designators R1 ... Rn are numbered through all tapes.
    outlines: Outlines of a part of the first tape, in the drawing's rotation.
    windows_mm: One coverlay opening in place of those of each part, for tapes in mode gang.
    backed_mm: Areas to which stiffener and adhesive are laminated.
    slots_mm each (k, 2): Slots routed around the tapes of a panel; empty for a single tape.
    """

    project: Project
    size_mm: tuple[float, float]
    corner_radius_mm: float
    thickness_mm: float
    outline_mm: FloatArray
    holes: tuple[Hole, ...]
    part: PartProfile
    outlines: PartOutlines
    parts: tuple[Parts, ...]
    legend: Legend
    windows_mm: tuple[FloatArray, ...]
    anchors: Anchors | None
    backed_mm: tuple[FloatArray, ...]
    stiffener: str | None
    adhesive: str | None
    slots_mm: tuple[FloatArray, ...] = ()
    fiducials: Fiducials | None = None

    @property
    def name(self) -> str:
        return self.project.name

    @property
    def parts_xy_mm(self) -> FloatArray:
        """Places of all parts, shape (n, 2)."""
        return np.concatenate([parts.xy_mm for parts in self.parts])

    def designators(self) -> list[str]:
        """R1 ... Rn."""
        return [f"R{i}" for i in range(1, sum(len(parts.xy_mm) for parts in self.parts) + 1)]


def tape_drawing(layout: Layout) -> Drawing:
    """The drawing of a single tape."""
    tape = layout.tape
    key = f"{tape.name}/{tape.code}/{tape.sector}/{tape.origin}/{tape.pitch_mm}/{tape.displacement_mm}/{tape.board}"
    return Drawing(
        project=Project(name=tape.name, key=key),
        size_mm=tape.board.size_mm,
        corner_radius_mm=tape.board.corner_radius_mm,
        thickness_mm=tape.board.thickness_mm,
        outline_mm=layout.outline_mm,
        holes=tape.board.holes,
        part=layout.part,
        outlines=layout.outlines,
        parts=(
            Parts(
                rotation_deg=tape.part.rotation_deg,
                xy_mm=layout.parts_xy_mm,
                pads=layout.pads,
                paste=layout.paste,
                openings=layout.openings if layout.window_mm is None else None,
                bodies=layout.bodies,
            ),
        ),
        legend=layout.legend,
        windows_mm=() if layout.window_mm is None else (layout.window_mm,),
        anchors=layout.anchors,
        backed_mm=(layout.outline_mm,),
        stiffener=layout.stiffener,
        adhesive=layout.adhesive,
    )


def joined(drawings: Sequence[Drawing], places: Sequence[tuple[Offset, bool]]) -> Drawing:
    """Merge drawings at their places, turned by 90 degrees where asked for; outline and name are those of the first."""
    moves = [_Move(offset_mm=np.array(offset), turned=turned) for offset, turned in places]
    pairs, first = list(zip(drawings, moves, strict=True)), drawings[0]

    def shapes(of: str) -> tuple[FloatArray, ...]:
        return tuple(move(shape) for drawing, move in pairs for shape in getattr(drawing, of))

    anchors = [(drawing.anchors, move) for drawing, move in pairs if drawing.anchors is not None]
    return replace(
        first,
        # not snapped to 1 nm: a drill file has four decimals of a millimetre anyway
        holes=tuple(
            (*pair_of(move(np.array(hole[:2]), snap=False)), hole[2]) for drawing, move in pairs for hole in drawing.holes
        ),
        outlines=moves[0].outlines(first.outlines),
        parts=tuple(move.parts(parts) for drawing, move in pairs for parts in drawing.parts),
        legend=Legend(
            areas_mm=tuple(move(area) for drawing, move in pairs for area in drawing.legend.areas_mm),
            strokes_mm=tuple(move(stroke) for drawing, move in pairs for stroke in drawing.legend.strokes_mm),
            # all drawings of one fab have one line width, but those without a strip have 0
            line_mm=max(drawing.legend.line_mm for drawing in drawings),
        ),
        windows_mm=shapes("windows_mm"),
        backed_mm=shapes("backed_mm"),
        anchors=None
        if not anchors
        else replace(
            anchors[0][0],
            spurs_mm=np.concatenate([move(a.spurs_mm) for a, move in anchors]),
            webs_mm=np.concatenate([move(a.webs_mm) for a, move in anchors]),
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Move:
    """A tape's place on a panel: turned by 90 degrees counter-clockwise or not, then moved."""

    offset_mm: FloatArray
    turned: bool

    def turn(self, xy_mm: FloatArray) -> FloatArray:
        # R_ccw(90 deg) (x, y) = (-y, x)
        return np.stack([-xy_mm[..., 1], xy_mm[..., 0]], axis=-1) if self.turned else xy_mm

    def __call__(self, xy_mm: FloatArray, *, snap: bool = True) -> FloatArray:
        moved: FloatArray = self.turn(xy_mm) + self.offset_mm
        return snap_mm(moved) if snap else moved

    def outlines(self, of: PartOutlines) -> PartOutlines:
        # outlines are about the part's centre, so they are only turned; the opening's size is that of the unturned part
        turned: dict[str, Any] = {k: self.turn(getattr(of, k)) for k in PartOutlines.__slots__ if k != "opening_size_mm"}
        return replace(of, **turned)

    def parts(self, parts: Parts) -> Parts:
        def flashes(of: Flashes) -> Flashes:
            # an outline is turned about its own origin; only the flash's place is moved
            return Flashes(outline_mm=self.turn(of.outline_mm), xy_mm=self(of.xy_mm))

        return Parts(
            rotation_deg=(parts.rotation_deg + 90.0 * self.turned) % 360.0,
            xy_mm=self(parts.xy_mm),
            pads=flashes(parts.pads),
            paste=flashes(parts.paste),
            openings=None if parts.openings is None else flashes(parts.openings),
            bodies=flashes(parts.bodies),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Project:
    """Identity of one set of files: name, text from which the GUID is derived, and kind of board (.Part)."""

    name: str
    key: str
    part: str = "Single"

    @property
    def id(self) -> str:
        """Value of .ProjectId (Gerber 2024.05 section 5.6.8): name, GUID, revision."""
        return f"{self.name},{self.guid},{__version__}"

    @property
    def guid(self) -> uuid.UUID:
        """A GUID in the form of RFC 4122 version 4, derived from `key` alone; also the value of .SameCoordinates."""
        # 16 bytes of a digest with the six bits of version and variant overwritten, so that equal keys give equal files
        return uuid.UUID(bytes=hashlib.sha256(self.key.encode()).digest()[:16], version=4)
