"""XNC drill file (Ucamco XNC specification 2021.11): unplated holes, metric, explicit decimal points."""

from __future__ import annotations

from tactape_fab.base.build_date import build_date
from tactape_fab.base.version import __version__
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.profiles import FabProfile


def render_drill(drawing: Drawing, fab: FabProfile) -> tuple[Artifact, ...]:
    """One tool per diameter, smallest first, holes in the given order; no file without holes."""
    holes = drawing.holes
    if not holes:
        return ()
    diameters = sorted({d for _, _, d in holes})
    lines = [
        "M48",
        f"; #@! TF.GenerationSoftware,tactape-fab,tactape-fab,{__version__}",
        f"; #@! TF.CreationDate,{build_date():%Y-%m-%dT%H:%M:%S+00:00}",
        f"; #@! TF.SameCoordinates,{drawing.project.guid}",
        f"; #@! TF.Part,{drawing.project.part}",
        "; #@! TF.FileFunction,NonPlated,1,1,NPTH",
        "METRIC",
    ]
    for tool, diameter in enumerate(diameters, start=1):
        lines += ["; #@! TA.AperFunction,MechanicalDrill", f"T{tool}C{diameter:.4f}"]
    lines += ["%", "G05"]
    for tool, diameter in enumerate(diameters, start=1):
        lines.append(f"T{tool}")
        lines += [f"X{x:.4f}Y{y:.4f}" for x, y, d in holes if d == diameter]
    lines.append("M30")
    role = "drill-npth"
    data = ("\n".join(lines) + "\n").encode("ascii")
    return (Artifact(role=role, path=fab.file_path(role, drawing.name), data=data),)
