"""Check that Gerber and drill files have exactly the writer's form, and that a second reader finds the same shapes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import named, shown
from tactape_fab.kit.read.gerber_file import GerberContent, GerberShapes
from tactape_fab.kit.read.written_gerber import FormError, written_shapes
from tactape_fab.verify.files import WrittenFile

_NAME = "written form"
_SAME_MM = 2e-6
"""Largest difference between two readings of a coordinate, as gerbonara's are sums of floats."""
_FUNCTION = re.compile(rb"^(?:%|G04 #@! )TA([^*%]*)", re.MULTILINE)  # names and values may have these letters, too
_FUNCTIONS = {
    "copper-top": {b".AperFunction,SMDPad,CuDef", b".AperFunction,Conductor", b".AperFunction,FiducialPad,Global"},
    "profile": {b".AperFunction,Profile"},
    "components-top": {
        *(b".AperFunction,ComponentMain", b".AperFunction,ComponentOutline,Body", b".AperFunction,ComponentPin"),
    },
}
_OTHER_FUNCTIONS = {b".AperFunction,Material"}
_DRILL = re.compile(  # XNC 2021.11
    r"M48\n"
    r"(?:; #@! TF\.(?:GenerationSoftware|CreationDate|SameCoordinates),[^\x00-\x1f]{0,300}\n){3}"
    r"; #@! TF\.Part,(?:Single|Array)\n"
    r"; #@! TF\.FileFunction,NonPlated,1,1,NPTH\n"
    r"METRIC\n"
    r"(?:; #@! TA\.AperFunction,MechanicalDrill\nT\d{1,4}C\d{1,4}\.\d{4}\n){1,1000}"
    r"%\nG05\n"
    r"(?:T\d{1,4}\n(?:X-?\d{1,6}\.\d{4}Y-?\d{1,6}\.\d{4}\n)+){1,1000}"
    r"M30\n"
)


def check_form(files: Mapping[str, WrittenFile], gerbers: Mapping[str, GerberContent]) -> Check:
    """Check that Gerber and drill files have the writer's form, and that both readers find the same shapes."""
    problems = []
    for role, content in gerbers.items():
        try:
            problems += [f"{role}: {problem}" for problem in _differences(written_shapes(files[role].data), content)]
            if others := set(_FUNCTION.findall(files[role].data)) - _FUNCTIONS.get(role, _OTHER_FUNCTIONS):
                problems.append(f"{role}: an aperture of it is for {shown(others.pop().decode('ascii'))}")
        except FormError as error:
            problems.append(f"{role}: {error}")
    if "drill-npth" in files:
        problems += [f"drill-npth: {problem}" for problem in drill_problems(files["drill-npth"].data)]
    count = len(gerbers) + ("drill-npth" in files)
    message = named(problems) or f"{count} files in the writer's grammar, read alike by gerbonara and by it"
    return Check(name=_NAME, passed=not problems, message=message, figure=float(count))


def drill_problems(data: bytes) -> list[str]:
    """Problems of a drill file's form: other syntax, or a tool that is defined or selected twice."""
    text = data.decode("ascii", "replace")
    if _DRILL.fullmatch(text) is None:
        return ["it is not as the writer writes it: header, tools, then the holes of each tool"]
    defined = re.findall(r"^T(\d+)C", text, re.MULTILINE)
    taken = re.findall(r"^T(\d+)$", text, re.MULTILINE)
    right = [str(number) for number in range(1, len(defined) + 1)]
    return [] if defined == right == taken else ["its tools are not each defined and taken once, in order"]


def _differences(drawn: GerberShapes, content: GerberContent) -> list[str]:
    """Differences between the two readings of a file."""
    problems = []
    # in both readings apertures are numbered in the order of their first flash
    same_apertures = np.array_equal(drawn.flash_aperture, content.flash_aperture)
    if not same_apertures or not alike(drawn.flash_xy_mm, content.flash_xy_mm):
        problems.append("gerbonara reads other flashes than the grammar")
    for what, these, those in (
        ("apertures", drawn.aperture_outlines_mm, content.aperture_outlines_mm),
        ("regions", drawn.areas_mm, content.areas_mm),
        ("lines", (segments(drawn.strokes_mm),), (segments(content.strokes_mm),)),
        ("widths of lines", (drawn.stroke_width_mm,), (content.stroke_width_mm,)),
    ):
        if len(these) != len(those) or not all(map(alike, these, those)):
            problems.append(f"gerbonara reads other {what} than the grammar")
    return problems


def segments(strokes_mm: Sequence[np.ndarray]) -> np.ndarray:
    """Start and end of each segment of polylines; shape (n, 4), mm."""
    points = np.concatenate([np.empty((0, 2)), *strokes_mm])
    # from the concatenated points of all strokes, without the lines between consecutive strokes
    ends = np.cumsum([len(stroke) for stroke in strokes_mm], dtype=np.int64)[:-1]
    return np.delete(np.concatenate([points[:-1], points[1:]], axis=1), ends - 1, axis=0)


def alike(a: np.ndarray, b: np.ndarray, tolerance_mm: float = _SAME_MM) -> bool:
    """Whether two arrays of points have the same shape, and equal values within the tolerance."""
    return a.shape == b.shape and bool((np.abs(a - b) <= tolerance_mm).all())


def same_contours(found: Sequence[np.ndarray], wanted: Sequence[np.ndarray], tolerance_mm: float) -> bool:
    """Whether closed contours pairwise have the same points in the same order."""
    # a region of a Gerber file repeats its first point at the end, other formats do not
    these, those = ([line[:-1] if np.array_equal(line[0], line[-1]) else line for line in lines] for lines in (found, wanted))
    return len(these) == len(those) and all(alike(a, b, tolerance_mm) for a, b in zip(these, those, strict=True))
