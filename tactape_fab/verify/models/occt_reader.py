"""Reads STEP files with OCCT, the CAD kernel of build123d, and prints its findings as JSON.

It runs in its own process, `python -m tactape_fab.verify.models.occt_reader FILE...`, so that a file that crashes the
kernel does not end the verification.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from tactape_fab.base.launch import limit_self

_PRECISION_MM = 1e-7
"""OCCT's smallest precision. With the file's 1e-6 mm it approximates the ellipses of blocks on a cylinder so coarsely that
volumes have relative errors of up to 1e-6, growing with the tape.
"""


def read_shape(path: str, *, precise: bool = True) -> dict[str, Any]:
    """Solids, shells, faces, validity, volume and gaps of a STEP file; `precise` if this tool wrote all of it."""
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.Interface import Interface_Static
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_ShapeEnum

    reader = STEPControl_Reader()
    if precise:
        Interface_Static.SetIVal_s("read.precision.mode", 1)
        Interface_Static.SetRVal_s("read.precision.val", _PRECISION_MM)
    if reader.ReadFile(path) != IFSelect_ReturnStatus.IFSelect_RetDone or reader.TransferRoots() < 1:
        return {"error": "OCCT finds no shape in it"}
    shape = reader.OneShape()
    solids = [_mass(solid) for solid in _explore(shape, TopAbs_ShapeEnum.TopAbs_SOLID)]
    return {
        "solids": len(solids),
        "faces": sum(1 for _ in _explore(shape, TopAbs_ShapeEnum.TopAbs_FACE)),
        "valid": bool(BRepCheck_Analyzer(shape).IsValid()),
        "volume_mm3": sum(solid[0] for solid in solids),
        "centre_mm": solids[0][1:4] if len(solids) == 1 else None,
        "gap_mm": _gap_mm(shape),
    }


def _mass(solid: Any) -> list[float]:
    """Volume (mm^3) and centre of mass (mm) of a solid.

    Integrated at fixed Gauss points, as in FreeCAD: exact except for domes on a cylinder, with relative errors of 2e-7
    (`COARSE_VOLUME_TOLERANCE`). Integration to 1e-9 took OCCT three times as long as everything else.
    """
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(solid, properties)
    return [float(properties.Mass()), *_xyz(properties.CentreOfMass())]


def _gap_mm(shape: Any) -> float:
    """Largest distance of an edge or a vertex from the faces and edges it belongs to, mm: OCCT widens tolerances to bridge it."""
    from OCP.ShapeAnalysis import ShapeAnalysis_ShapeTolerance

    return float(ShapeAnalysis_ShapeTolerance().Tolerance(shape, 1))


def _bounds(solid: Any) -> list[float]:
    """Least and largest coordinates of a solid, mm."""
    from OCP.Bnd import Bnd_Box
    from OCP.BRepBndLib import BRepBndLib

    box = Bnd_Box()
    # exact bounds of the shape, not of its mesh, without tolerances
    BRepBndLib.AddOptimal_s(solid, box, False, False)
    return [*_xyz(box.CornerMin()), *_xyz(box.CornerMax())]


def _xyz(point: Any) -> tuple[float, float, float]:
    return point.X(), point.Y(), point.Z()


def _explore(shape: Any, kind: Any) -> Any:
    from OCP.TopExp import TopExp_Explorer

    explorer = TopExp_Explorer(shape, kind)
    while explorer.More():
        yield explorer.Current()
        explorer.Next()


def read_assembly(path: str) -> dict[str, Any]:
    """Occurrences of a STEP assembly: name, place and axes of each, the solids of its products, and their largest gap."""
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDF import TDF_ChildIterator
    from OCP.TDocStd import TDocStd_Document
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.XCAFDoc import XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

    document = TDocStd_Document(TCollection_ExtendedString("XmlOcaf"))
    reader = STEPCAFControl_Reader()
    reader.SetNameMode(True)
    reader.ReadFile(path)
    if not reader.Transfer(document):
        return {"error": "OCCT finds no assembly in it"}
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    occurrences, products, gaps = [], {}, [0.0]
    for label in _children(TDF_ChildIterator(shapes.Label())):
        if not XCAFDoc_ShapeTool.IsAssembly_s(label):
            if XCAFDoc_ShapeTool.IsSimpleShape_s(label):
                shape = XCAFDoc_ShapeTool.GetShape_s(label)
                gaps.append(_gap_mm(shape))
                solids = _explore(shape, TopAbs_ShapeEnum.TopAbs_SOLID)
                products[_name(label)] = [[*_mass(solid), *_bounds(solid)] for solid in solids]
            continue
        for part in _children(TDF_ChildIterator(label)):
            placed = XCAFDoc_ShapeTool.GetLocation_s(part).Transformation()
            origin = placed.TranslationPart()
            axis = [placed.Value(row, 1) for row in (1, 2, 3)]
            up = [placed.Value(row, 3) for row in (1, 2, 3)]
            occurrences.append([_name(part), origin.X(), origin.Y(), origin.Z(), *axis, *up])
    return {"products": products, "occurrences": occurrences, "gap_mm": max(gaps)}


def _children(iterator: Any) -> Any:
    while iterator.More():
        yield iterator.Value()
        iterator.Next()


def _name(label: Any) -> str:
    from OCP.TDataStd import TDataStd_Name

    found = TDataStd_Name()
    return str(found.Get().ToExtString()) if label.FindAttribute(TDataStd_Name.GetID_s(), found) else ""


def main(*, precise: bool = True) -> None:
    """Read the files of the arguments: solid and assembly, '-' for none; then the limits of time (s) and memory (bytes)."""
    import OCP.STEPCAFControl  # noqa: F401  what loading the kernel takes is no cost of a file

    solid, assembly, *limits = sys.argv[1:]
    if limits:
        limit_self(cpu_s=float(limits[0]), memory_bytes=int(limits[1]))
    answer = {
        "solid": read_shape(solid, precise=precise) if solid != "-" else None,
        "assembly": read_assembly(assembly) if assembly != "-" else None,
    }
    print("\nANSWER " + json.dumps(answer))


if __name__ == "__main__":
    main()
