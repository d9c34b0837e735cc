"""A face of a STEP solid as a chart of a texture, developed exactly; by OCCT through build123d."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import copysign
from pathlib import Path
from typing import Any, cast

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.surface.charts import Frames, Placement, board_x, nearest
from tactape_fab.solids.surface.developed import Developable, Kind, Places
from tactape_fab.solids.surface.part_files import closed_mesh, welded
from tactape_fab.solids.surface.part_mesh import refuse_no_point, refuse_off_surface
from tactape_fab.solids.surface.threemf_file import MOST_FACES
from tactape_fab.texture.frames import BoolArray, FloatArray

_CHORD_ERROR_MM = (0.002, 0.01)

_TURN_RAD = 0.2
_LISTED = 5
_SAMPLES = 25
_HALVINGS = 20
_BESIDE_RAD = 1e-5
_ADVICE = "give a plane, a cylinder or a cone, or export the part as STL, where every surface will do"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepModel:
    """The single solid of a STEP file, and its faces in the file's order (build123d objects)."""

    solid: Any
    faces: tuple[Any, ...]

    @property
    def size_mm(self) -> FloatArray:
        """Extent along x, y, z."""
        return np.asarray(np.ptp(self.corners_mm, axis=0))

    @property
    def corners_mm(self) -> FloatArray:
        """Minimum and maximum x, y, z; shape (2, 3)."""
        box = self.solid.bounding_box()
        return np.array([tuple(box.min), tuple(box.max)])

    @property
    def chord_error_mm(self) -> float:
        """Largest distance of the mesh from the faces, mm: 2 um, for a large solid 1e-5 of its size, but at most 10 um."""
        return float(np.clip(1e-5 * self.size_mm.max(), *_CHORD_ERROR_MM))

    def tessellated(self) -> Mesh:
        """The solid as a closed mesh within `chord_error_mm` of its faces."""
        from OCP.BRepMesh import BRepMesh_IncrementalMesh

        chord_mm = self.chord_error_mm
        BRepMesh_IncrementalMesh(self.solid.wrapped, chord_mm, False, _TURN_RAD, True)  # build123d's is relative to edges
        points, triangles = self.solid.tessellate(chord_mm, _TURN_RAD)
        if len(triangles) > MOST_FACES:
            raise SpecError(f"SURFACE takes {len(triangles)} triangles, more than {MOST_FACES}; give a smaller or simpler solid")
        vertices = np.array([(p.X, p.Y, p.Z) for p in points], dtype=np.float64).reshape(-1, 3)
        return closed_mesh(welded(vertices, np.array(triangles, dtype=np.int64).reshape(-1, 3)), crossings=False)

    def listing(self) -> str:
        """Description of the largest faces: index, kind, area, centre."""
        largest = sorted(range(len(self.faces)), key=lambda i: -self.faces[i].area)[:_LISTED]
        rows = []
        for i in largest:
            centre = self.faces[i].center()
            kind = _kind(self.faces[i])
            rows.append(f"{i} {kind} {self.faces[i].area:.1f} mm2 at {centre.X:.2f},{centre.Y:.2f},{centre.Z:.2f}")
        return f"the solid has {len(self.faces)} faces, 0 to {len(self.faces) - 1}; the largest: " + "; ".join(rows)


def read_step_solid(data: bytes) -> StepModel:
    """Read a STEP file of one solid. Raises SpecError if it cannot be read, or has no solid or several."""
    import build123d as bd
    from OCP.BRepCheck import BRepCheck_Analyzer

    remedy = "export the part as one solid"
    if b"ISO-10303-21" not in data[:1000]:
        raise SpecError("SURFACE cannot be read as STEP: it does not begin with ISO-10303-21; export it again")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "surface.step"
        path.write_bytes(data)
        try:
            with warnings.catch_warnings(), _quiet_kernel():
                warnings.simplefilter("ignore")
                others = _other_files(path)
                if not others:
                    content = bd.import_step(path)
                    solids, faces = content.solids(), content.faces()
        except Exception as error:  # the kernel raises any exception on untrusted bytes
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise SpecError(f"SURFACE cannot be read as STEP: {reason}; export it again, or as STL") from error
    if others:
        raise SpecError(
            f"SURFACE names {others} other file{'s' * (others > 1)}, which would be read with it; {remedy} in one file"
        )
    if len(faces) == 0:
        raise SpecError("SURFACE cannot be read as STEP: the kernel finds no shape in it; export it again, or as STL")
    if len(solids) == 0:
        raise SpecError(f"SURFACE holds no solid, only {len(faces)} loose faces; {remedy}, or as a closed STL mesh")
    if len(solids) > 1:
        raise SpecError(f"SURFACE holds {len(solids)} solids; {remedy}")
    if not BRepCheck_Analyzer(solids[0].wrapped).IsValid():  # booleans of an invalid solid may crash OCCT or never end
        raise SpecError("SURFACE is no valid solid, as OCCT finds; repair it in your CAD program, or export it as STL")
    return StepModel(solid=solids[0], faces=tuple(solids[0].faces()))


def _other_files(path: Path) -> int:
    """Number of external files that OCCT would read with a STEP file, from any path, even a FIFO."""
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPConstruct import STEPConstruct_ExternRefs
    from OCP.STEPControl import STEPControl_Reader

    reader = STEPControl_Reader()
    if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        return 0  # the import reports it
    named = STEPConstruct_ExternRefs(reader.WS())
    named.LoadExternRefs()
    return int(named.NbExternRefs())


@contextmanager
def _quiet_kernel() -> Iterator[None]:
    """Context manager: silences OCCT's messages about a file on stdout, as our own message names the problem."""
    from OCP.Message import Message

    messenger = Message.DefaultMessenger_s()
    printers = list(messenger.Printers())
    for printer in printers:
        messenger.RemovePrinter(printer)
    try:
        yield
    finally:
        for printer in printers:
            messenger.AddPrinter(printer)


def _kind(face: Any) -> str:
    return str(face.geom_type.name).lower()


def developable(face: Any) -> Developable | None:
    """The surface of a face if it is developable, None for other kinds."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface

    adaptor, kind = BRepAdaptor_Surface(face.wrapped), _kind(face)
    if kind not in ("plane", "cylinder", "cone"):
        return None
    surface = {"plane": adaptor.Plane, "cylinder": adaptor.Cylinder, "cone": adaptor.Cone}[kind]()
    place = surface.Position()
    axes = [place.XDirection(), place.YDirection(), place.Direction()]
    origin = place.Location()
    radius_mm = {"cylinder": "Radius", "cone": "RefRadius"}.get(kind)
    return Developable(
        kind=cast(Kind, kind),
        origin_mm=np.array([origin.X(), origin.Y(), origin.Z()]),
        axes=np.array([(d.X(), d.Y(), d.Z()) for d in axes]),
        radius_mm=0.0 if radius_mm is None else getattr(surface, radius_mm)(),
        half_angle_rad=surface.SemiAngle() if kind == "cone" else 0.0,
    )


class FaceChart:
    """Chart of a face of a STEP solid, with the texture's middle and up direction.

    Raises SpecError if the face does not exist or is not developable, the point is off it, or `up` is parallel to its normal.
    """

    def __init__(self, model: StepModel, placement: Placement) -> None:
        wanted = None if placement.at_mm is None else np.array(placement.at_mm, dtype=np.float64)
        if wanted is not None:
            refuse_no_point(wanted)
        self.face = _chosen(model, placement.face, wanted)
        face = model.faces[self.face]
        surface = developable(face)
        if surface is None:
            raise SpecError(f"face = {self.face} is a {_kind(face)}; {_ADVICE}; {model.listing()}")
        self.surface = surface
        self._inside = _classifier(face)
        if wanted is None:
            start = self._middle(face)
        else:
            near, distance = _nearest(face, wanted)
            refuse_off_surface(wanted, near, distance, float(model.size_mm.max()))
            start = surface.parameters(near[None])
        # the developed surface's normal points away from the axis, but the face's may be opposite, as in a bore
        place = surface.roll(start, np.zeros((1, 2)))
        outward = face.normal_at(tuple(place.points_mm[0].tolist()))
        self.sense = copysign(1.0, float(place.normal[0] @ np.array([outward.X, outward.Y, outward.Z])))
        normal = place.normal * self.sense
        self.centre = Frames(
            points_mm=place.points_mm,
            x_axis=board_x(normal[0], placement.up)[None],
            normal=normal,
            facet=np.zeros(1, dtype=np.int64),
            walked_mm=np.zeros(1),
            arrived=np.ones(1, dtype=bool),
        )

    def frames(self, offset_mm: FloatArray) -> Frames:
        """Places of flat board points; see `Chart.frames`."""
        count = len(offset_mm)
        start = self.centre[np.zeros(count, dtype=np.int64)]
        places, turn = self._roll(start, offset_mm)
        arrived = self._inside(places.uv)
        x_axis = turn[:, 0, :1] * places.first + turn[:, 0, 1:] * places.second
        walked = np.hypot(offset_mm[:, 0], offset_mm[:, 1])
        lost = np.flatnonzero(~arrived)
        # length of a path that ends outside, by bisection to a millionth of it; it is assumed to cross one border
        low, high = np.zeros(len(lost)), np.ones(len(lost))
        for _ in range(_HALVINGS if len(lost) else 0):
            middle = (low + high) / 2
            there = self._inside(self._roll(start[lost], offset_mm[lost] * middle[:, None])[0].uv)
            low, high = np.where(there, middle, low), np.where(there, high, middle)
        walked[lost] *= low
        return Frames(
            points_mm=places.points_mm,
            x_axis=x_axis,
            normal=places.normal * self.sense,
            facet=np.zeros(count, dtype=np.int64),
            walked_mm=walked,
            arrived=arrived,
        )

    def feet(self, frames: Frames, outline_mm: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Heights of the surface over tangent planes; see `Chart.feet`."""
        count, points = len(frames.points_mm), len(outline_mm)
        start = frames[np.repeat(np.arange(count), points)]
        places, _ = self._roll(start, np.tile(outline_mm, (count, 1)))
        height = np.einsum("ij,ij->i", places.points_mm - start.points_mm, start.normal)
        return height.reshape(count, points), self._inside(places.uv).reshape(count, points)

    def _roll(self, start: Frames, offset_mm: FloatArray) -> tuple[Places, FloatArray]:
        """Places at board offsets from given ones; and components of board x and y along the flat axes, shape (n, 2, 2)."""
        uv = self.surface.parameters(start.points_mm)
        here = self.surface.roll(uv, np.zeros_like(uv))
        flat = np.stack([here.first, here.second], axis=1)
        # the components are constant along the path, as a development preserves angles
        turn = np.einsum("nbi,nfi->nbf", np.stack([start.x_axis, start.y_axis], axis=1), flat)
        return self.surface.roll(uv, np.einsum("nb,nbf->nf", offset_mm, turn)), turn

    def _middle(self, face: Any) -> FloatArray:
        """Parameters of a face's centre: the middle of their ranges or, if that is outside the face, of its widest place."""
        from OCP.BRepTools import BRepTools

        u0, u1, v0, v1 = BRepTools.UVBounds_s(face.wrapped)
        middle: FloatArray = np.array([[(u0 + u1) / 2, (v0 + v1) / 2]])
        if self._inside(middle)[0]:
            return middle
        part = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        u, v = (a.ravel() for a in np.meshgrid(u0 + part * (u1 - u0), v0 + part * (v1 - v0), indexing="ij"))
        samples = np.stack([u, v], axis=1)
        inside = self._inside(samples)
        if not inside.any():
            raise SpecError(f"face = {self.face} has no centre that can be found; give a point of it with --at X,Y,Z")
        points = self.surface.roll(samples, np.zeros_like(samples)).points_mm
        apart, _ = nearest(points[~inside], points[inside]) if not inside.all() else (np.zeros(len(points)), None)
        return np.asarray(samples[inside][[int(apart.argmax())]])


def _chosen(model: StepModel, index: int | None, at_mm: FloatArray | None) -> int:
    """Index of the chosen face: the given one, else that at the point, else the largest."""
    if index is not None:
        if not 0 <= index < len(model.faces):
            raise SpecError(Problem("face", f"face = {index} does not exist: {model.listing()}"))
        return index
    if at_mm is None:
        return max(range(len(model.faces)), key=lambda i: float(model.faces[i].area))
    return min(range(len(model.faces)), key=lambda i: _nearest(model.faces[i], at_mm)[1])


def _nearest(face: Any, point_mm: FloatArray) -> tuple[FloatArray, float]:
    """The point of a face nearest to a point, and their distance."""
    import build123d as bd

    distance, near, _ = face.distance_to_with_closest_points(bd.Vertex(*point_mm.tolist()))
    return np.array([near.X, near.Y, near.Z]), float(distance)


def _classifier(face: Any) -> Any:
    """A function that tells which parameters, shape (n, 2), are inside a face's borders, shape (n,)."""
    from OCP.gp import gp_Pnt2d
    from OCP.IntTools import IntTools_FClass2d
    from OCP.TopAbs import TopAbs_State

    # in parameter space, without projecting points; built once per face
    classes = IntTools_FClass2d(face.wrapped, 1e-7)

    def is_inside(u: float, v: float) -> bool:
        state = classes.Perform(gp_Pnt2d(u, v), True)
        if state == TopAbs_State.TopAbs_ON:  # on a border, or on the seam, which has the face on both sides
            beside = [classes.Perform(gp_Pnt2d(u + step, v), True) for step in (-_BESIDE_RAD, _BESIDE_RAD)]
            return beside == [TopAbs_State.TopAbs_IN] * 2
        return bool(state == TopAbs_State.TopAbs_IN)

    def inside(uv: FloatArray) -> BoolArray:
        return np.array([is_inside(u, v) for u, v in uv.tolist()], dtype=bool)

    return inside
