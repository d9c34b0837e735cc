"""Checks of a KiCad board other than places and copper: openings, ink and outline against the Gerber files, settings, rules."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isclose
from typing import Any

import numpy as np
import shapely

from tactape_fab.base.fields import named
from tactape_fab.base.fields import shown as quoted
from tactape_fab.base.json_text import parse_json
from tactape_fab.kit.read.gerber_file import GerberContent, GerberShapes, ReadbackError
from tactape_fab.kit.read.s_expression import Quoted, Tree
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import rotate
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.layers.film_layers import FilmManifest, without_counterpart
from tactape_fab.verify.layers.lands import PLACE_TOLERANCE_MM, apart_mm, nearest, point_tree
from tactape_fab.verify.layers.written_form import same_contours, segments

At = tuple[float, float, float]
_ARC_TOLERANCE_MM = 0.01
"""Tolerance of a corner's middle from the chords of the outline layer."""
_RULES = {
    "min_clearance": "pad-pad",
    "min_copper_edge_clearance": "pad-edge",
    "min_hole_clearance": "hole-copper",
    "min_hole_to_hole": "hole-hole",
    "min_through_hole_diameter": "hole-size",
}
"""Design rules of the project, and the fab's limit of each."""
_OF_THIS_TOOL = {"min_silk_clearance": 0.0, "via diameter of its class": 0.6, "via drill of its class": 0.3}
"""Design rules that are no fab's limit, mm: openings cut the ink already, and no tape has a via."""
_OF_A_CLASS = ("clearance", "track_width", "via_diameter", "via_drill")
_SEVERITIES: tuple[dict[str, str], ...] = ({}, {"track_dangling": "ignore"})
_PLOTTED = {"F.Paste", "F.SilkS", "F.Mask", "Edge.Cuts"}
_VERSION = ("20211014",)
_NUMBER = re.compile(r"[-.0-9]*")
_LINE_MM = 0.05
"""Width of the lines of outlines, bodies and courtyards."""
_NOT_PLACED = ("exclude_from_pos_files", "exclude_from_bom")
_ATTRIBUTES = {"R": ("smd",), "H": _NOT_PLACED, "F": ("smd", *_NOT_PLACED)}
"""Attributes of a footprint by the first letter of its name: part, hole, fiducial."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Alike:
    """Footprints that are equal but for place and designator.

    kind: First letter of their designators.
    name: That of the footprint.
    items: Their lists but for the place, and the designator's without it.
    names: Their designators.
    """

    kind: str
    name: str
    items: Sequence[Tree]
    names: list[str]

    @property
    def pads(self) -> list[Tree]:
        return [item for item in self.items if item[0] == "pad"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Made:
    """Expected content of a board and of drawings other than places, from the manifest and the kit's other files.

    tape: The only tape, or the first one of a panel.
    gerbers: Layers by role.
    radius_mm: Radius of the outline's corners.
    slots_mm: Slots around the tapes of a panel.
    """

    name: str
    tape: Tape
    record: FilmManifest
    gerbers: Mapping[str, GerberContent]
    radius_mm: float
    slots_mm: Sequence[FloatArray] = ()
    on_panel: bool = False


def drawn_problems(
    lists: Mapping[str, Sequence[Tree]],
    footprints: Sequence[Alike],
    at: Mapping[str, At],
    origin_mm: FloatArray,
    fiducials_mm: Sequence[tuple[float, float]],
    made: Made,
) -> list[str]:
    """Problems of graphics and settings of a board; `at` has the footprints' places in the board frame."""
    silk = [item for kind in ("gr_line", "gr_poly") for item in lists.get(kind, []) if layer_of(item) == "F.SilkS"]
    return [
        *_settings(lists, made),
        *_footprints(footprints, made),
        *_openings(lists, footprints, at, origin_mm, np.array(fiducials_mm).reshape(-1, 2), made.gerbers.get("coverlay-top")),
        *_ink(silk, origin_mm, made.gerbers.get("legend-top")),
        *_outline(lists, origin_mm, made.gerbers.get("profile")),
    ]


def rules_problems(project: bytes, limits_mm: Mapping[str, Any], track_width_mm: float) -> list[str]:
    """Problems of a project's design rules; the track width is that of anchors, or without any (0) the fab's least spacing."""
    try:
        content = parse_json(project)
        settings, (net_class,) = content["board"]["design_settings"], content["net_settings"]["classes"]
        rules, severities = dict(settings["rules"]), settings["rule_severities"]
        # such as drc_exclusions, which hide what breaks a rule
        more = [*(settings.keys() - {"rules", "rule_severities"}), *(rules.keys() - {*_RULES, "min_track_width", *_OF_THIS_TOOL})]
        # KiCad uses the larger one of the board's clearance and the net class's
        rules |= {f"{key.replace('_', ' ')} of its class": net_class[key] for key in _OF_A_CLASS}
        # KiCad passes over a number in quotes, and takes its own
        found = {key: value for key, value in rules.items() if type(value) in (int, float)}
    except (ValueError, KeyError, TypeError, AttributeError):
        return ["its project holds no design rules"]
    wanted = {key: limits_mm[rule] for key, rule in {**_RULES, "clearance of its class": "pad-pad"}.items() if rule in limits_mm}
    if track_width_mm or "pad-pad" in limits_mm:
        wanted |= dict.fromkeys(("min_track_width", "track width of its class"), track_width_mm or limits_mm["pad-pad"])
    wrong = [key for key, value in {**wanted, **_OF_THIS_TOOL}.items() if found.get(key) != value]
    wrong += [*([] if severities in _SEVERITIES else ["rule_severities"]), *sorted(map(quoted, more))]
    return [f"its project's {named(wrong)} are not the limits of the manifest's fab"] if wrong else []


def child(tree: Sequence[str | Tree], name: str) -> Tree:
    """The one list of this name in a list."""
    found = [item for item in tree if item and item[0] == name and isinstance(item, tuple)]
    if len(found) != 1:
        # lists of a footprint come without its name
        of = tree[0] if tree and isinstance(tree[0], str) else "footprint"
        raise ReadbackError(f"a {quoted(of)} has {len(found)} times {name}")
    return found[0]


def only(lists: Mapping[str, Sequence[Tree]], kind: str) -> Tree:
    """The one list of a kind in a board."""
    found = lists.get(kind, ())
    if len(found) != 1:
        raise ReadbackError(f"it has {len(found)} times {kind}")
    return found[0]


def values(tree: Sequence[str | Tree], name: str) -> list[float]:
    """The numbers of the one list of this name in a list."""
    return [number(word) for word in child(tree, name)[1:] if isinstance(word, str)]


def number(word: str) -> float:
    """A number of KiCad or of a DXF. Python's float takes 3_1.15 for one as well, of which others read the 3."""
    if _NUMBER.fullmatch(word) is None:
        raise ValueError(f"{quoted(word)} stands where a number should")
    return float(word)


def layer_of(tree: Tree) -> str:
    """Name of the one layer of a graphic or a footprint."""
    return str(child(tree, "layer")[1])


def _settings(lists: Mapping[str, Sequence[Tree]], made: Made) -> list[str]:
    """Check thickness, title, layers, nets and notes."""
    general, title, layers, setup = (only(lists, kind) for kind in ("general", "title_block", "layers", "setup"))
    (thickness_mm,) = values(general, "thickness")
    problems = [] if only(lists, "version")[1:] == _VERSION else ["its format is not that of KiCad 6"]
    only(lists, "generator")
    if len(general) != 2 or not isclose(thickness_mm, made.tape.board.thickness_mm, abs_tol=1e-6):
        problems.append(f"it is {thickness_mm:g} mm thick, not {made.tape.board.thickness_mm:g}")
    if child(title, "title")[1:] != (made.name,):
        problems.append("its title is not the kit's name")
    child(title, "date"), child(title, "rev")
    for row in layers[1:]:
        if isinstance(row, str):
            raise ReadbackError(f"{quoted(row)} stands in no row of its layers")
    # a KiCad board has at least two copper layers; the second one of a film stays empty
    copper = sorted(str(row[1]) for row in layers[1:] if row[2:3] != ("user",))
    if copper != ["B.Cu", "F.Cu"] or any(row[2] != "signal" for row in layers[1:] if row[1] in copper):
        problems.append("its copper layers are not F.Cu and B.Cu")
    # KiCad moves graphics of a layer that is not in its table to the comments layer, which is not plotted
    if lacking := sorted(_PLOTTED - {str(row[1]) for row in layers[1:]}):
        problems.append(f"its table of layers lacks {named(lacking)}")
    plain = [item[0] for item in setup[1:]] == ["pad_to_mask_clearance", "aux_axis_origin", "grid_origin"]
    origins = (values(setup, "aux_axis_origin"), values(setup, "grid_origin"))
    if not plain or values(setup, "pad_to_mask_clearance") != [0.0] or origins[0] != origins[1]:
        problems.append("its setup is not that of this tool")
    if [net[1:] for net in lists.get("net", [])] != [("0", "")]:
        problems.append("it has nets")
    notes = sorted(str(text[1]) for text in lists.get("gr_text", []))
    wanted = [
        sorted(f"{role.split('-')[0]} under all of {of}: {what}" for role, what in made.record.film.backings.items())
        for of in ("it", "each tape")
    ]
    return problems if notes in wanted else [*problems, f"it says {named(list(map(quoted, notes)) or ['nothing'])} of backings"]


def _footprints(footprints: Sequence[Alike], made: Made) -> list[str]:
    """Check names, values, attributes and body graphics of footprints."""
    wrong = Counter[str]()
    for some in footprints:
        if (problem := _footprint_problem(some, made)) is not None:
            wrong[problem] += len(some.names)
    return [f"{count} footprints with {problem}" for problem, count in wrong.items()]


def _footprint_problem(some: Alike, made: Made) -> str | None:
    kind, inner = some.kind, some.items
    if tuple(child(inner, "attr")[1:]) != _ATTRIBUTES.get(kind):
        return "other attributes"
    turn = next((values(pad, "at")[2:] for pad in some.pads), []) or [0.0]
    for text in (item for item in inner if item[0] == "fp_text" and isinstance(item, tuple)):
        # of a text as of a pad, a turn is relative to the board
        hidden = any(word == "hide" and not isinstance(word, Quoted) for word in text)
        if [*values(text, "at"), 0.0][:3] != [0.0, 0.0, *turn] or not hidden:
            return "a text elsewhere, or one that shows"
    given = [item[2] for item in inner if item[:2] == ("fp_text", "value")]
    if len(given) != 1 or (kind == "R" and given != [made.record.assembly.value]):
        return "another value"
    if kind != "R" and any(item[0] == "fp_rect" for item in inner):
        return "a rectangle"
    if kind == "H":
        if len(pads := some.pads) != 1:
            return "more or fewer than one pad"
        pad = pads[0]
        # an unplated hole is a pad as large as its drill, so that no copper remains
        right = child(pad, "layers")[1:] == ("*.Cu", "*.Mask") and values(pad, "size") == values(pad, "drill") * 2
        return None if right else "another pad"
    if kind != "R":
        return None
    if some.name != f"tactape:{made.record.assembly.footprint}":
        return "another name"
    drawn = [i for i in inner if i[0] == "fp_rect" and isinstance(i, tuple) and layer_of(i) != "F.Mask"]
    if any(child(i, "fill")[1:] != ("none",) or values(i, "width") != [_LINE_MM] for i in drawn):
        return "other lines"
    bodies, courtyards = (
        [(values(i, "start"), values(i, "end")) for i in drawn if layer_of(i) == layer] for layer in ("F.Fab", "F.CrtYd")
    )
    # how large a courtyard is says no manifest
    if [[-x for x in start] for start, _ in courtyards] != [end for _, end in courtyards] or len(courtyards) != 1:
        return "another courtyard"
    half = np.array(made.tape.part.body_mm[:2]) / 2
    right = len(bodies) == 1 and np.allclose(bodies[0], (-half, half), rtol=0.0, atol=PLACE_TOLERANCE_MM)
    return None if right else "another body"


def _openings(
    lists: Mapping[str, Sequence[Tree]],
    footprints: Sequence[Alike],
    at: Mapping[str, At],
    origin_mm: FloatArray,
    fiducials_mm: FloatArray,
    coverlay: GerberShapes | None,
) -> list[str]:
    """Check that the mask graphics are the openings of the coverlay layer."""
    if coverlay is None:
        return []
    polygons = [_polygon(item, origin_mm) for item in lists.get("gr_poly", []) if layer_of(item) == "F.Mask"]
    rectangles = [
        (item, [at[name] for name in some.names])
        for some in footprints
        for item in some.items
        if item[0] == "fp_rect" and isinstance(item, tuple) and layer_of(item) == "F.Mask"
    ]
    count, corners = len(polygons), list[FloatArray]()
    for item, places in rectangles:
        _refuse_hollow(item)
        (x0, y0), (x1, y1) = values(item, "start"), values(item, "end")
        # y is flipped before the rotation, which is counter-clockwise on the board
        local, rows = np.array([(x0, -y0), (x1, -y0), (x1, -y1), (x0, -y1)]), np.array(places)
        for turn_deg in sorted(set(rows[:, 2].tolist())):
            xy = rows[rows[:, 2] == turn_deg, :2]
            corners.append((xy[:, None] + rotate(local, turn_deg)).reshape(-1, 2))
            count += len(xy)
    kept = np.ones(len(coverlay.flash_xy_mm), dtype=bool)
    if len(fiducials_mm):
        # a fiducial's opening is the mask margin of its pad, not a rectangle
        kept = nearest(coverlay.flash_xy_mm, point_tree(fiducials_mm))[1] > PLACE_TOLERANCE_MM
    flashes, aperture, wanted = coverlay.flash_xy_mm[kept], coverlay.flash_aperture[kept], list[FloatArray]()
    for k, outline in enumerate(coverlay.aperture_outlines_mm):
        wanted.append((flashes[aperture == k][:, None] + outline).reshape(-1, 2))
    openings = len(flashes) + len(coverlay.areas_mm)
    same = same_contours(polygons, coverlay.areas_mm, PLACE_TOLERANCE_MM)
    if count == openings and same and _points_apart_mm(corners, wanted) <= PLACE_TOLERANCE_MM:
        return []
    return [f"its {count} openings are not the {openings} of the coverlay layer"]


def _ink(silk: Sequence[Tree], origin_mm: FloatArray, legend: GerberShapes | None) -> list[str]:
    """Check that the ink is that of the legend layer: areas by their corners, lines by their ends and width."""
    areas, strokes = ((), ()) if legend is None else (legend.areas_mm, legend.strokes_mm)
    polygons = [_polygon(item, origin_mm) for item in silk if item[0] == "gr_poly"]
    lines = [item for item in silk if item[0] == "gr_line"]
    problems = []
    if not same_contours(polygons, areas, PLACE_TOLERANCE_MM):
        problems.append(f"its {len(polygons)} areas of ink are not the {len(areas)} of the legend layer")
    on_sheet_mm = np.array([(values(line, "start"), values(line, "end")) for line in lines]).reshape(-1, 2, 2)
    ends = (on_sheet_mm - origin_mm) * (1.0, -1.0)
    wanted = segments(strokes).reshape(-1, 2, 2) if strokes else np.empty((0, 2, 2))
    alone = len(without_counterpart(ends, wanted)) + len(without_counterpart(wanted, ends))
    widths = {round(values(line, "width")[0], 6) for line in lines}
    right = set() if legend is None else set(np.round(legend.stroke_width_mm, 6).tolist())
    if alone or widths != right:
        problems.append(f"its {len(lines)} lines of ink are not those of the legend layer")
    return problems


def _outline(lists: Mapping[str, Sequence[Tree]], origin_mm: FloatArray, profile: GerberShapes | None) -> list[str]:
    """Check that sides and corners, with their middles, are on the outline layer and form a closed outline."""
    if profile is None or not profile.strokes_mm:
        return []
    sides = [item for kind in ("gr_line", "gr_arc") for item in lists.get(kind, []) if layer_of(item) == "Edge.Cuts"]
    ends = np.array([values(item, end) for item in sides for end in ("start", "end")]).reshape(-1, 2)
    middles = np.array([values(item, "mid") for item in sides if item[0] == "gr_arc"]).reshape(-1, 2)
    straight = np.array([item[0] == "gr_line" for item in sides], dtype=bool)
    middles = np.concatenate([middles, ends.reshape(-1, 2, 2)[straight].mean(axis=1)])
    cut = shapely.MultiLineString([stroke for stroke in profile.strokes_mm if len(stroke) > 1])
    points = (np.concatenate([ends, middles]) - origin_mm) * (1.0, -1.0)
    far_mm = shapely.distance(shapely.points(points), cut)
    # in a closed outline every end point occurs twice
    _, often = np.unique(np.round(ends, 4), axis=0, return_counts=True)
    thin = all(values(item, "width") == [_LINE_MM] for item in sides)
    near = (far_mm[: len(ends)] <= PLACE_TOLERANCE_MM).all() and (far_mm <= _ARC_TOLERANCE_MM).all()
    return [] if near and thin and (often == 2).all() else ["its outline is not that of the outline layer"]


def _polygon(item: Tree, origin_mm: FloatArray) -> FloatArray:
    """Corners of a filled polygon, board frame."""
    _refuse_hollow(item)
    rows = [[number(str(word)) for word in point[1:]] for point in child(item, "pts")[1:] if isinstance(point, tuple)]
    corners = np.array(rows, dtype=np.float64).reshape(-1, 2)
    return (corners - origin_mm) * (1.0, -1.0)


def _refuse_hollow(item: Tree) -> None:
    if child(item, "fill")[1:] != ("solid",) or values(item, "width") != [0.0]:
        raise ReadbackError(f"a {quoted(item[0])} of it is not filled to its edge alone")


def _points_apart_mm(shapes: Sequence[FloatArray], others: Sequence[FloatArray]) -> float:
    """Largest distance of a vertex from the nearest vertex of the other shapes, in both directions."""
    return apart_mm(*(np.concatenate([np.empty((0, 2)), *some]) for some in (shapes, others)))
