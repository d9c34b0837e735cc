"""Drawing: content of one set of fabrication files, of a single tape or of a panel. It is the only input of the renderers."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tactape_fab.base.version import __version__
from tactape_fab.kit.film.anchors import Anchors
from tactape_fab.kit.film.layout import Flashes, Layout, Legend
from tactape_fab.kit.outlines import PartOutlines
from tactape_fab.kit.profiles import PartProfile
from tactape_fab.texture.frames import FloatArray, snap_mm
from tactape_fab.texture.tape import Tape

Hole = tuple[float, float, float]
Offset = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fiducials:
    """Fiducial marks for the assembly line's cameras: discs of bare copper in wider openings.

    Attributes
    ----------
    xy_mm : ndarray, shape (k, 2)
    copper_mm, opening_mm : float
        Diameters.
    """

    xy_mm: FloatArray
    copper_mm: float
    opening_mm: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawing:
    """One set of fabrication files, in the frame of its own outline: x right, y up from the lower left corner, mm.

    Attributes
    ----------
    project : Project
        Name and identity of its files.
    size_mm, corner_radius_mm, outline_mm
        The outline, and the same with rounded corners as polylines, shape (k, 2).
    holes : tuple of (x, y, diameter)
    parts_xy_mm, pads, paste, openings, bodies
        As in `Layout`, those of several tapes one after the other with consecutive designators R1 ... Rn.
    windows_mm : tuple of ndarray
        One coverlay opening per tape in place of `openings`, in mode gang.
    backed_mm : tuple of ndarray
        Areas that stiffener and adhesive are laminated to.
    slots_mm : tuple of ndarray, each (k, 2)
        Slots cut round the tapes of a panel; empty for a single tape.
    fiducials : Fiducials or None
    """

    project: Project
    size_mm: tuple[float, float]
    corner_radius_mm: float
    thickness_mm: float
    outline_mm: FloatArray
    holes: tuple[Hole, ...]
    rotation_deg: float
    part: PartProfile
    outlines: PartOutlines
    parts_xy_mm: FloatArray
    pads: Flashes
    paste: Flashes
    openings: Flashes
    bodies: Flashes
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

    def designators(self) -> list[str]:
        """R1 ... Rn."""
        return [f"R{i}" for i in range(1, len(self.parts_xy_mm) + 1)]


def _key(tape: Tape) -> str:
    return f"{tape.name}/{tape.code}/{tape.sector}/{tape.origin}/{tape.pitch_mm}/{tape.displacement_mm}/{tape.board}"


def tape_drawing(layout: Layout) -> Drawing:
    """The drawing of a single tape."""
    tape = layout.tape
    return Drawing(
        project=Project(name=tape.name, key=_key(tape)),
        size_mm=tape.board.size_mm,
        corner_radius_mm=tape.board.corner_radius_mm,
        thickness_mm=tape.board.thickness_mm,
        outline_mm=layout.outline_mm,
        holes=tape.board.holes,
        rotation_deg=tape.part.rotation_deg,
        part=layout.part,
        outlines=layout.outlines,
        parts_xy_mm=layout.parts_xy_mm,
        pads=layout.pads,
        paste=layout.paste,
        openings=layout.openings,
        bodies=layout.bodies,
        legend=layout.legend,
        windows_mm=() if layout.window_mm is None else (layout.window_mm,),
        anchors=layout.anchors,
        backed_mm=(layout.outline_mm,),
        stiffener=layout.stiffener,
        adhesive=layout.adhesive,
    )


def joined(drawings: Sequence[Drawing], offsets_mm: Sequence[Offset]) -> Drawing:
    """Drawings with the same part and rotation moved to their places and joined; outline and name are the first's."""
    pairs = list(zip(drawings, [np.array(offset) for offset in offsets_mm], strict=True))
    first = drawings[0]

    def flashes(of: str) -> Flashes:
        xy = np.concatenate([snap_mm(getattr(drawing, of).xy_mm + offset) for drawing, offset in pairs])
        return Flashes(outline_mm=getattr(first, of).outline_mm, xy_mm=xy)

    def shapes(of: str) -> tuple[FloatArray, ...]:
        return tuple(shape for drawing, offset in pairs for shape in _moved(getattr(drawing, of), offset))

    anchors = [(drawing.anchors, offset) for drawing, offset in pairs if drawing.anchors is not None]
    return replace(
        first,
        holes=tuple((float(x + dx), float(y + dy), d) for drawing, (dx, dy) in pairs for x, y, d in drawing.holes),
        parts_xy_mm=np.concatenate([snap_mm(drawing.parts_xy_mm + offset) for drawing, offset in pairs]),
        pads=flashes("pads"),
        paste=flashes("paste"),
        openings=flashes("openings"),
        bodies=flashes("bodies"),
        legend=Legend(
            areas_mm=tuple(a for drawing, offset in pairs for a in _moved(drawing.legend.areas_mm, offset)),
            strokes_mm=tuple(s for drawing, offset in pairs for s in _moved(drawing.legend.strokes_mm, offset)),
            line_mm=first.legend.line_mm,
        ),
        windows_mm=shapes("windows_mm"),
        backed_mm=shapes("backed_mm"),
        anchors=None
        if not anchors
        else replace(
            anchors[0][0],
            spurs_mm=np.concatenate([snap_mm(a.spurs_mm + offset) for a, offset in anchors]),
            webs_mm=np.concatenate([snap_mm(a.webs_mm + offset) for a, offset in anchors]),
        ),
    )


def _moved(shapes: Iterable[FloatArray], offset: FloatArray) -> list[FloatArray]:
    return [snap_mm(shape + offset) for shape in shapes]


@dataclass(frozen=True, slots=True, kw_only=True)
class Project:
    """Identity of one set of files: its name, the text from which its GUID is derived, and the kind of board (.Part)."""

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
        return uuid.UUID(bytes=hashlib.sha256(self.key.encode()).digest()[:16], version=4)
