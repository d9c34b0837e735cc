"""A STEP solid and the elements of a texture as one solid: fused by OCCT through build123d, and held against exact volumes."""

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
"""Elements in one call of the kernel: every call looks at the whole face again, so few calls are much faster."""

_VOLUME_ERROR, _LOST = 1e-5, 0.05
"""Of all elements together, and of one: where OCCT was wrong it was off by a third of an element or more, else by 4e-4 of one."""
_INTEGRAL_ERROR = 1e-9


def embossed_step(solid: Any, surface: Developable, laid: LaidOut, timestamp: str, progress: Progress = lambda *_: None) -> bytes:
    """The solid fused with the elements, as a STEP file dated `timestamp` (ISO 8601).

    Raises TactapeError when the result is not one valid solid of the expected volume.
    """
    part, count, sink_mm = laid.tape.part, laid.tape.part_count, float(laid.sink_mm.max())
    expected_mm3 = standing_mm3(part, surface, laid.elements, sink_mm)
    problems, attempts = list[str](), [(_fused, solid)]
    if part.shape == "dome":
        # a fuse that goes wrong leaves tolerances of up to 0.8 mm in both shapes that it was given: each has its own
        attempts.append((_fused_revolved, _copy(solid)))
    # what comes out right at once stays as it is, byte for byte
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
    with bd.SkipClean():  # cleaning would join the user's own faces too
        for start in range(0, len(tools), _AT_ONCE):
            progress("fusing STEP", start, len(tools))
            fused = fused.fuse(*tools[start : start + _AT_ONCE])
    return fused


def _fused_revolved(solid: Any, element: Any, laid: LaidOut, progress: Progress) -> Any:
    """As `_fused`, with domes whose flank is a surface of revolution until they are fused: the same places, as exact.

    A sphere or a cone meets a cone by OCCT's formulas, which count from the apex. Where that is far, at half angles of 0.02 rad
    to some 5 degrees, they lose digits, and OCCT cuts off or adds parts of domes. A surface of revolution it follows by steps.
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
    """Make a dome's revolved flank the sphere or the cone that it is, in place: a revolved line is read wrongly from a file."""
    from build123d.topology import downcast
    from OCP.BRep import BRep_Builder, BRep_Tool
    from OCP.Geom import Geom_SphericalSurface
    from OCP.gp import gp_Vec2d
    from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopLoc import TopLoc_Location

    # all domes have one surface, in the element's own frame, each at a place of its own
    place, builder = TopLoc_Location(), BRep_Builder()
    revolved = BRep_Tool.Surface_s(face.wrapped, place)
    # parameters are the same, but that OCCT revolves a circle from 3/2 to 5/2 pi where a sphere's latitude is -1/2 to 1/2 pi
    shift = gp_Vec2d(0.0, -2 * pi if isinstance(flank, Geom_SphericalSurface) else 0.0)
    # not `face.edges()`, which leaves out the one of no length at a sphere's pole
    edges = TopExp_Explorer(face.wrapped, TopAbs_ShapeEnum.TopAbs_EDGE)
    while edges.More():
        forward = downcast(edges.Current().Oriented(TopAbs_Orientation.TopAbs_FORWARD))
        edges.Next()
        # each side of a seam has a curve of its own in the surface's parameters
        sides = (forward, downcast(forward.Reversed())) if BRep_Tool.IsClosed_s(forward, revolved, place) else (forward,)
        curves = [BRep_Tool.CurveOnSurface_s(side, revolved, place, 0.0, 0.0).Translated(shift) for side in sides]
        first, last = BRep_Tool.Range_s(forward, revolved, place)
        builder.UpdateEdge(forward, *curves, flank, place, BRep_Tool.Tolerance_s(forward))
        builder.Range(forward, flank, place, first, last)
    builder.UpdateFace(face.wrapped, flank, place, BRep_Tool.Tolerance_s(face.wrapped))


def _problems(solid: Any, fused: Any, laid: LaidOut, expected_mm3: FloatArray) -> list[str]:
    """Faults of a fused solid. OCCT's fuse may be valid and wrong: volume, solids and faces are all counted."""
    from OCP.BRepCheck import BRepCheck_Analyzer

    problems = []
    solids = fused.solids()
    if len(solids) != 1:
        problems.append(f"it falls into {len(solids)} solids")
    added, expected = _added_mm3(solid, fused), float(expected_mm3.sum())
    if abs(added - expected) > _VOLUME_ERROR * expected + _LOST * float(expected_mm3.min()):
        problems.append(f"its elements add {added:.4f} mm3 instead of {expected:.4f} mm3")
    # an element adds its own faces and a hole in the user's face, which stays one
    part = laid.tape.part
    shown = 5 if part.shape == "block" else 1 if part.top_mm is None else 2  # faces of an element above the surface
    faces = len(solid.faces()) + laid.tape.part_count * shown
    if len(fused.faces()) != faces:
        problems.append(f"it has {len(fused.faces())} faces instead of {faces}")
    if not BRepCheck_Analyzer(fused.wrapped).IsValid():
        problems.append("OCCT finds it invalid")
    return problems


def _added_mm3(before: Any, after: Any) -> float:
    """Volume that a fused solid has beyond the user's."""
    from OCP.BRep import BRep_Builder
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps
    from OCP.TopoDS import TopoDS_Compound

    old, new = before.faces(), after.faces()
    between, builder, kept = TopoDS_Compound(), BRep_Builder(), set(old) & set(new)
    builder.MakeCompound(between)
    # faces that both solids have bound no part of the difference, and need not be integrated
    for face in (*(f.wrapped for f in new if f not in kept), *(f.wrapped.Reversed() for f in old if f not in kept)):
        builder.Add(between, face)
    volume = GProp_GProps()
    # to a given error: by default OCCT takes too few points for a face of many holes, 1 % of all elements off
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
    """One element as an exact solid in its own frame, its sides down to `sink_mm` below its foot."""
    import build123d as bd

    length, width, height = part.body_mm
    if part.shape == "block":
        box = bd.Solid.make_box(length, width, height + sink_mm)
        return box.moved(bd.Location((0, 0, 0), (0, 0, part.rotation_deg)) * bd.Location((-length / 2, -width / 2, -sink_mm)))
    # the flank goes on below the foot: a rim at the foot's height would touch a cylinder in two points, which OCCT gets wrong
    top = 0.0 if part.top_mm is None else part.top_mm / 2
    if part.top_mm is not None:
        below, rim = sink_mm, length / 2 + (length / 2 - top) / height * sink_mm
        flank = bd.Edge.make_line((rim, 0, -below), (top, 0, height))
    else:
        sphere, middle = sphere_radius_mm(part), height - sphere_radius_mm(part)
        # not below the sphere's equator, where the flank would lean inward: straight down from there
        below = min(sink_mm, -middle)
        rim, waist = sqrt(sphere**2 - (below + middle) ** 2), (height - below) / 2
        on_flank = (sqrt(sphere**2 - (waist - middle) ** 2), 0, waist)
        flank = bd.Edge.make_three_point_arc((rim, 0, -below), on_flank, (0, 0, height))
    corners = [(top, height), (0.0, height), (0.0, -sink_mm), (rim, -sink_mm), (rim, -below)]
    lines = [bd.Edge.make_line((a[0], 0, a[1]), (b[0], 0, b[1])) for a, b in pairwise(corners) if a != b]
    return bd.Solid.revolve(bd.Face(bd.Wire([flank, *lines])), 360, bd.Axis.Z)
