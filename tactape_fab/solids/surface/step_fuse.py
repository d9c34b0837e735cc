"""Fusion of a STEP solid and the elements of a texture by OCCT through build123d, checked against exact volumes."""

from __future__ import annotations

import tempfile
from itertools import pairwise
from math import pi, sqrt
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import TactapeError
from tactape_fab.solids.elements import sphere_radius_mm
from tactape_fab.solids.surface.developed import Developable
from tactape_fab.solids.surface.fuse import Progress
from tactape_fab.solids.surface.place import LaidOut
from tactape_fab.solids.surface.standing import standing_mm3
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart

_AT_ONCE = 2500
"""Elements per call of the kernel: every call processes the whole face again, so few calls are much faster."""

_VOLUME_ERROR, _LOST = 1e-5, 0.05
"""Largest relative error of the total volume, and largest error as a fraction of an element's volume: wrong results of OCCT are
off by at least a third of an element, right ones by at most 4e-4 of one."""
_INTEGRAL_ERROR = 1e-9


def embossed_step(solid: Any, surface: Developable, laid: LaidOut, timestamp: str, progress: Progress = lambda *_: None) -> bytes:
    """The solid fused with the elements, as a STEP file dated `timestamp` (ISO 8601).

    Raises TactapeError if the result is not one valid solid of the expected volume.
    """
    part, count, sink_mm = laid.tape.part, laid.tape.part_count, float(laid.sink_mm.max())
    expected_mm3 = standing_mm3(part, surface, laid.elements, sink_mm)
    problems, attempts = list[str](), [(_fused, solid)]
    if part.shape == "dome":
        # a failed fuse leaves tolerances of up to 0.8 mm in both of its arguments, so each attempt has its own copy
        attempts.append((_fused_revolved, _copy(solid)))
    # the first attempt that passes is used
    for fuse, host in attempts:
        fused = fuse(host, _element(part, sink_mm), laid, progress)
        progress("checking STEP", count, count)
        problems = _problems(host, fused, laid, expected_mm3)
        if not problems:
            progress("writing STEP", count, count)
            return _written(fused.solids()[0], timestamp)
    remedy = "move the texture a little, or export the part as STL and emboss that"
    raise TactapeError(f"the fused STEP solid is wrong: {', '.join(problems)}; {remedy}")


def _copy(solid: Any) -> Any:
    import build123d as bd
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy

    return bd.Solid(BRepBuilderAPI_Copy(solid.wrapped).Shape())


def _fused(solid: Any, element: Any, laid: LaidOut, progress: Progress) -> Any:
    import build123d as bd

    frames = laid.elements
    tools = [
        element.moved(bd.Location(bd.Plane(origin=tuple(p), x_dir=tuple(x), z_dir=tuple(n))))
        for p, x, n in zip(frames.points_mm.tolist(), frames.x_axis.tolist(), frames.normal.tolist(), strict=True)
    ]
    fused = solid
    with bd.SkipClean():  # cleaning would also merge the user's own faces
        for start in range(0, len(tools), _AT_ONCE):
            progress("fusing STEP", start, len(tools))
            fused = fused.fuse(*tools[start : start + _AT_ONCE])
    return fused


def _fused_revolved(solid: Any, element: Any, laid: LaidOut, progress: Progress) -> Any:
    """As `_fused`, but with flanks of domes as surfaces of revolution during the fusion; the result is equally exact.

    OCCT intersects a sphere or a cone with a cone by formulas relative to the apex. If that is far away, at half angles of 0.02
    rad to some 5 degrees, they lose digits, and OCCT cuts off or adds parts of domes. Surfaces of revolution are intersected
    numerically.
    """
    import build123d as bd
    from OCP.BRep import BRep_Tool
    from OCP.Geom import Geom_Plane, Geom_SurfaceOfRevolution
    from OCP.ShapeCustom import ShapeCustom

    fused = _fused(solid, bd.Solid(ShapeCustom.ConvertToRevolution_s(element.wrapped)), laid, progress)
    surfaces = [BRep_Tool.Surface_s(face.wrapped) for face in element.faces()]
    (flank,) = [surface for surface in surfaces if not isinstance(surface, Geom_Plane)]
    users = set(solid.faces())
    for face in fused.faces():
        if face not in users and isinstance(BRep_Tool.Surface_s(face.wrapped), Geom_SurfaceOfRevolution):
            _set_flank(face, flank)
    return fused


def _set_flank(face: Any, flank: Any) -> None:
    """Replace a dome's revolved flank in place by the equal sphere or cone, as revolved lines are read wrongly from files."""
    from build123d.topology import downcast
    from OCP.BRep import BRep_Builder, BRep_Tool
    from OCP.Geom import Geom_SphericalSurface
    from OCP.gp import gp_Vec2d
    from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopLoc import TopLoc_Location

    # all domes share one surface in the element's frame, each with its own location
    place, builder = TopLoc_Location(), BRep_Builder()
    revolved = BRep_Tool.Surface_s(face.wrapped, place)
    # the parametrisations are equal, except that OCCT's revolved circle is from 3/2 to 5/2 pi, a sphere's latitude -1/2 to 1/2 pi
    shift = gp_Vec2d(0.0, -2 * pi if isinstance(flank, Geom_SphericalSurface) else 0.0)
    # not `face.edges()`, which omits the degenerate edge at a sphere's pole
    edges = TopExp_Explorer(face.wrapped, TopAbs_ShapeEnum.TopAbs_EDGE)
    while edges.More():
        forward = downcast(edges.Current().Oriented(TopAbs_Orientation.TopAbs_FORWARD))
        edges.Next()
        # each side of a seam has its own curve in parameter space
        sides = (forward, downcast(forward.Reversed())) if BRep_Tool.IsClosed_s(forward, revolved, place) else (forward,)
        curves = [BRep_Tool.CurveOnSurface_s(side, revolved, place, 0.0, 0.0).Translated(shift) for side in sides]
        first, last = BRep_Tool.Range_s(forward, revolved, place)
        builder.UpdateEdge(forward, *curves, flank, place, BRep_Tool.Tolerance_s(forward))
        builder.Range(forward, flank, place, first, last)
    builder.UpdateFace(face.wrapped, flank, place, BRep_Tool.Tolerance_s(face.wrapped))


def _problems(solid: Any, fused: Any, laid: LaidOut, expected_mm3: FloatArray) -> list[str]:
    """Problems of a fused solid: OCCT's result may be valid and wrong, so volume, solids and faces are checked."""
    from OCP.BRepCheck import BRepCheck_Analyzer

    problems = []
    solids = fused.solids()
    if len(solids) != 1:
        problems.append(f"it falls into {len(solids)} solids")
    added, expected = _added_mm3(solid, fused), float(expected_mm3.sum())
    if abs(added - expected) > _VOLUME_ERROR * expected + _LOST * float(expected_mm3.min()):
        problems.append(f"its elements add {added:.4f} mm3 instead of {expected:.4f} mm3")
    # an element adds its faces and a hole in the user's face, which remains one face
    part = laid.tape.part
    shown = 5 if part.shape == "block" else 1 if part.top_mm is None else 2  # faces of an element above the surface
    faces = len(solid.faces()) + laid.tape.part_count * shown
    if len(fused.faces()) != faces:
        problems.append(f"it has {len(fused.faces())} faces instead of {faces}")
    if not BRepCheck_Analyzer(fused.wrapped).IsValid():
        problems.append("OCCT finds it invalid")
    return problems


def _added_mm3(before: Any, after: Any) -> float:
    """Volume of a fused solid less that of the user's."""
    from OCP.BRep import BRep_Builder
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps
    from OCP.TopoDS import TopoDS_Compound

    old, new = before.faces(), after.faces()
    between, builder, kept = TopoDS_Compound(), BRep_Builder(), set(old) & set(new)
    builder.MakeCompound(between)
    # faces that both solids have cancel in the difference, and need not be integrated
    for face in (*(f.wrapped for f in new if f not in kept), *(f.wrapped.Reversed() for f in old if f not in kept)):
        builder.Add(between, face)
    volume = GProp_GProps()
    # with a given error, as OCCT's default takes too few points for a face with many holes, an error of 1 % of all elements
    BRepGProp.VolumeProperties_s(between, volume, _INTEGRAL_ERROR)
    return float(volume.Mass())


def _written(solid: Any, timestamp: str) -> bytes:
    import build123d as bd

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "solid.step"
        if not bd.export_step(solid, path, write_pcurves=False, timestamp=timestamp):
            raise TactapeError("OCCT cannot write the fused solid as STEP; export the part as STL and emboss that")
        return path.read_bytes()


def _element(part: TapePart, sink_mm: float) -> Any:
    """One element as an exact solid in its own frame, extended `sink_mm` below its foot."""
    import build123d as bd

    length, width, height = part.body_mm
    if part.shape == "block":
        box = bd.Solid.make_box(length, width, height + sink_mm)
        return box.moved(bd.Location((0, 0, 0), (0, 0, part.rotation_deg)) * bd.Location((-length / 2, -width / 2, -sink_mm)))
    # the flank continues below the foot, as a rim at its height would touch a cylinder in two points, which OCCT gets wrong
    top = 0.0 if part.top_mm is None else part.top_mm / 2
    if part.top_mm is not None:
        below, rim = sink_mm, length / 2 + (length / 2 - top) / height * sink_mm
        flank = bd.Edge.make_line((rim, 0, -below), (top, 0, height))
    else:
        sphere, middle = sphere_radius_mm(part), height - sphere_radius_mm(part)
        # down to the sphere's equator, below which the side is vertical
        below = min(sink_mm, -middle)
        rim, waist = sqrt(sphere**2 - (below + middle) ** 2), (height - below) / 2
        on_flank = (sqrt(sphere**2 - (waist - middle) ** 2), 0, waist)
        flank = bd.Edge.make_three_point_arc((rim, 0, -below), on_flank, (0, 0, height))
    corners = [(top, height), (0.0, height), (0.0, -sink_mm), (rim, -sink_mm), (rim, -below)]
    lines = [bd.Edge.make_line((a[0], 0, a[1]), (b[0], 0, b[1])) for a, b in pairwise(corners) if a != b]
    return bd.Solid.revolve(bd.Face(bd.Wire([flank, *lines])), 360, bd.Axis.Z)
