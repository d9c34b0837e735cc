"""Reads STEP files with OCCT, the kernel that build123d brings, and prints what it found as JSON.

Run in its own process, `python -m tactape_fab.verify.models.occt_reader FILE...`: if a file crashes the kernel, the
verification gets an answer.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

VOLUME_EPSILON = 1e-9
_SURFACE = re.compile(rb"\b([A-Z_]*SURFACE[A-Z_]*)\s*\(")


def read_shape(path: str) -> dict[str, Any]:
    """Solids, shells, faces, validity and volume of a STEP file."""
    from OCP.BRepCheck import BRepCheck_Analyzer
    from OCP.IFSelect import IFSelect_ReturnStatus
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_ShapeEnum

    reader = STEPControl_Reader()
    if reader.ReadFile(path) != IFSelect_ReturnStatus.IFSelect_RetDone or reader.TransferRoots() < 1:
        return {"error": "OCCT finds no shape in it"}
    shape, simple = reader.OneShape(), _is_simple(path)
    solids = [_mass(solid, simple=simple) for solid in _explore(shape, TopAbs_ShapeEnum.TopAbs_SOLID)]
    return {
        "solids": len(solids),
        "faces": sum(1 for _ in _explore(shape, TopAbs_ShapeEnum.TopAbs_FACE)),
        "valid": bool(BRepCheck_Analyzer(shape).IsValid()),
        "volume_mm3": sum(solid[0] for solid in solids),
        "centre_mm": solids[0][1:4] if len(solids) == 1 else None,
    }


def _mass(solid: Any, *, simple: bool) -> list[float]:
    """Volume (mm^3), centre of mass and bounds (three least, three largest; mm) of a solid; `simple` as `_is_simple` says."""
    from OCP.Bnd import Bnd_Box
    from OCP.BRepBndLib import BRepBndLib
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties, box = GProp_GProps(), Bnd_Box()
    if simple:
        BRepGProp.VolumeProperties_s(solid, properties)  # its fixed Gauss points are exact on these, and five times faster
    else:
        BRepGProp.VolumeProperties_s(solid, properties, VOLUME_EPSILON)
    BRepBndLib.AddOptimal_s(solid, box, False, False)
    points = (properties.CentreOfMass(), box.CornerMin(), box.CornerMax())
    return [float(properties.Mass()), *(value for p in points for value in (p.X(), p.Y(), p.Z()))]


def _is_simple(path: str) -> bool:
    """Whether every surface in a STEP file is a plane or a cylinder."""
    return set(_SURFACE.findall(Path(path).read_bytes())) <= {b"CYLINDRICAL_SURFACE"}


def _explore(shape: Any, kind: Any) -> Any:
    from OCP.TopExp import TopExp_Explorer

    explorer = TopExp_Explorer(shape, kind)
    while explorer.More():
        yield explorer.Current()
        explorer.Next()


def read_assembly(path: str) -> dict[str, Any]:
    """Occurrences of a STEP assembly: name, place and direction of the local x axis of each, and of their solids."""
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
    occurrences, products, simple = [], {}, _is_simple(path)
    for label in _children(TDF_ChildIterator(shapes.Label())):
        if not XCAFDoc_ShapeTool.IsAssembly_s(label):
            if XCAFDoc_ShapeTool.IsSimpleShape_s(label):
                shape = XCAFDoc_ShapeTool.GetShape_s(label)
                products[_name(label)] = [_mass(solid, simple=simple) for solid in _explore(shape, TopAbs_ShapeEnum.TopAbs_SOLID)]
            continue
        for part in _children(TDF_ChildIterator(label)):
            placed = XCAFDoc_ShapeTool.GetLocation_s(part).Transformation()
            origin = placed.TranslationPart()
            axis = [placed.Value(row, 1) for row in (1, 2, 3)]
            up = [placed.Value(row, 3) for row in (1, 2, 3)]
            occurrences.append([_name(part), origin.X(), origin.Y(), origin.Z(), *axis, *up])
    return {"products": products, "occurrences": occurrences}


def _children(iterator: Any) -> Any:
    while iterator.More():
        yield iterator.Value()
        iterator.Next()


def _name(label: Any) -> str:
    from OCP.TDataStd import TDataStd_Name

    found = TDataStd_Name()
    return str(found.Get().ToExtString()) if label.FindAttribute(TDataStd_Name.GetID_s(), found) else ""


def main() -> None:
    """Read the solid named first and the assembly named second; '-' means no file."""
    solid, assembly = sys.argv[1:3]
    answer = {
        "solid": read_shape(solid) if solid != "-" else None,
        "assembly": read_assembly(assembly) if assembly != "-" else None,
    }
    print("\nANSWER " + json.dumps(answer))


if __name__ == "__main__":
    main()
