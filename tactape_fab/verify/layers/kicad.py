"""Checks that the KiCad board has the manifest's footprints, lands, outline, holes and tracks, and nothing else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import named
from tactape_fab.base.fields import shown as quoted
from tactape_fab.kit.profiles import LandPattern
from tactape_fab.kit.read.gerber_file import ReadbackError, collection_paused
from tactape_fab.kit.read.s_expression import Tree, read_s_expression
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.layers.film_layers import without_counterpart
from tactape_fab.verify.layers.kicad_drawn import (
    Alike,
    At,
    Made,
    child,
    drawn_problems,
    layer_of,
    number,
    only,
    rules_problems,
    values,
)
from tactape_fab.verify.layers.kicad_form import misquoted, refuse_malformed
from tactape_fab.verify.layers.lands import PLACE_TOLERANCE_MM, ROTATION_TOLERANCE_DEG, Recorded

_IDENTIFIERS = ("tstamp", "uuid")
_SETTINGS = ("version", "generator", "general", "paper", "title_block", "layers", "setup", "net")
_DRAWN_ON = {
    "gr_line": ("Edge.Cuts", "F.SilkS"),
    "gr_arc": ("Edge.Cuts",),
    "gr_poly": ("F.SilkS", "F.Mask"),
    "gr_text": ("Cmts.User",),
    "fp_text": ("F.Fab",),
    "fp_rect": ("F.Fab", "F.CrtYd", "F.Mask"),
}
"""Layers on which each kind of item may be drawn."""
_OF_A_FOOTPRINT = ("layer", "at", "descr", "attr", "fp_text", "fp_rect", "pad")
_OF_A_LAND = ("at", "size", "layers", "roundrect_rratio")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shown:
    """Expected content of a board, in the board frame, mm.

    parts_xy_mm (n, 2): Parts R1 ... Rn.
    rotation_deg (n,); holes (x, y, diameter)
    edge_lines: Number of lines and arcs of outline and slots.
    fiducials_mm (x, y); fiducial_mm: Diameters of their copper and of its mask opening.
    tracks_mm (k, 2, 2): End points of the anchors' lines, of width ``track_width_mm``.
    """

    parts_xy_mm: FloatArray
    rotation_deg: FloatArray
    size_mm: tuple[float, float]
    holes: Sequence[tuple[float, float, float]]
    edge_lines: int
    tracks_mm: FloatArray
    track_width_mm: float
    fiducials_mm: Sequence[tuple[float, float]] = ()
    fiducial_mm: tuple[float, float] = (0.0, 0.0)

    def designators(self) -> list[str]:
        return [f"R{n}" for n in range(1, len(self.parts_xy_mm) + 1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Board:
    """The s-expression lists of a board by kind, its lower-left corner on the sheet, and its footprints with their places, mm."""

    lists: dict[str, list[Tree]]
    origin_mm: tuple[float, float]
    at: dict[str, At]
    alike: Sequence[Alike]
    pads: Mapping[str, Sequence[Tree]]


def sides_of(size_mm: tuple[float, float], corner_radius_mm: float) -> int:
    """Number of lines and arcs of an outline: four corners, and the sides that are left."""
    return 4 * (corner_radius_mm > 0) + 2 * sum(side_mm - 2 * corner_radius_mm > 1e-6 for side_mm in size_mm)


def shown_tape(tape: Tape, tracks_mm: FloatArray, track_width_mm: float) -> Shown:
    """Expected content of the board of a single tape."""
    return Shown(
        parts_xy_mm=tape.part_xy_mm(),
        rotation_deg=np.full(tape.part_count, tape.part.rotation_deg),
        size_mm=tape.board.size_mm,
        holes=tape.board.holes,
        edge_lines=sides_of(tape.board.size_mm, tape.board.corner_radius_mm),
        tracks_mm=tracks_mm,
        track_width_mm=track_width_mm,
    )


def check_kicad(files: Mapping[str, WrittenFile], shown: Shown, made: Made) -> list[Check]:
    """Check that the board shows exactly the content of manifest and layers, and that its project has the fab's rules."""
    try:
        with collection_paused():
            tree = read_s_expression(files["kicad-pcb"].data, _IDENTIFIERS)
            found = _read_board(tree)
        problems = [
            *misquoted(tree),
            *_places(found, shown),
            *_lands(found, shown, made.record.lands),
            *_sheet(found, shown),
            *_outline(found, shown),
            *_holes(found, shown),
            *_fiducials(found, shown),
            *_tracks(found, shown),
            *_unexpected(found),
            *drawn_problems(found.lists, found.alike, found.at, np.array(found.origin_mm), shown.fiducials_mm, made),
            *rules_problems(files["kicad-project"].data, made.record.limits_mm, shown.track_width_mm),
        ]
    except (ReadbackError, ValueError, TypeError, IndexError) as error:
        message = f"it is no board of KiCad with an origin, or it was cut off: {error}"
        return [Check(name="kicad board", passed=False, message=message)]
    right = f"{len(shown.parts_xy_mm)} footprints, outline, holes and rules as in the manifest, openings and ink as in the layers"
    message = named(problems) if problems else right
    return [Check(name="kicad board", passed=not problems, message=message)]


# Reading


def _read_board(tree: Tree) -> _Board:
    if tree[:1] != ("kicad_pcb",):
        raise ReadbackError("it does not begin with kicad_pcb")
    refuse_malformed(tree, {"kicad_pcb": (*_SETTINGS, *_DRAWN_ON, "footprint", "segment"), "footprint": _OF_A_FOOTPRINT})
    lists: dict[str, list[Tree]] = {}
    for item in tree[1:]:
        if isinstance(item, str):
            raise ReadbackError(f"{quoted(item)} stands in no list")
        lists.setdefault(str(item[0]), []).append(item)
    setup = only(lists, "setup")
    x0_mm, y0_mm = values(setup, "aux_axis_origin")
    at: dict[str, At] = {}
    alike: dict[tuple[object, ...], Alike] = {}
    for footprint in lists.get("footprint", []):
        own: list[Tree] = []
        others: list[Tree] = []
        for item in footprint[2:]:
            differs = item[0] == "at" or (item[0] == "fp_text" and item[1] == "reference")
            (own if differs else others).append(item)  # type: ignore[arg-type]
        references = [(str(item[2]), item[3:]) for item in own if item[0] == "fp_text"]
        if len(references) != 1:
            raise ReadbackError(f"footprint {len(at) + 1} has {len(references)} references, not one")
        ((name, words),) = references
        x_mm, y_mm, *turn_deg = values(own, "at")
        # y of a sheet points down; the auxiliary origin is the board's lower left corner. Angles are counter-clockwise in both
        at[name] = (x_mm - x0_mm, y0_mm - y_mm, turn_deg[0] if turn_deg else 0.0)
        # equal lists of the file are one object, so that identities can be compared
        key = (name[0], footprint[1], *words, *map(id, others))
        reference = ("fp_text", "reference", *words)
        some = Alike(kind=name[0], name=str(footprint[1]), items=[reference, *others], names=[])
        alike.setdefault(key, some).names.append(name)
    pads = {name: pads for some in alike.values() for pads in [some.pads] for name in some.names}
    return _Board(lists=lists, origin_mm=(x0_mm, y0_mm), at=at, alike=[*alike.values()], pads=pads)


# Comparing


def _is_part(name: str) -> bool:
    # H1 ... are holes, FID1 ... fiducials, R1 ... parts
    return name[:1] not in ("H", "F")


def _places(found: _Board, shown: Shown) -> list[str]:
    expected, count = shown.designators(), len(found.lists.get("footprint", []))
    parts = [name for name in found.at if _is_part(name)]
    if parts != expected or count != len(expected) + len(shown.holes) + len(shown.fiducials_mm):
        wrong = sorted(set(parts) ^ set(expected))
        return [f"its {count} footprints are not R1 to R{len(expected)} in order" + (f": {named(wrong)}" if wrong else "")]
    rows = np.array([found.at[name] for name in expected]).reshape(-1, 3)
    error_mm = np.hypot(*(rows[:, :2] - shown.parts_xy_mm).T)
    turn_deg = np.abs((rows[:, 2] - shown.rotation_deg + 180.0) % 360.0 - 180.0)
    far, turned = np.flatnonzero(error_mm > PLACE_TOLERANCE_MM), np.flatnonzero(turn_deg > ROTATION_TOLERANCE_DEG)
    problems = []
    if len(far):
        problems.append(f"off the grid: {named([f'{expected[i]} by {1000 * error_mm[i]:.1f} um' for i in far])}")
    if len(turned):
        problems.append(f"turned: {named([f'{expected[i]} at {rows[i, 2]:g} deg' for i in turned])}")
    return problems


def _lands(found: _Board, shown: Shown, lands: Recorded) -> list[str]:
    """Check that every part has the four lands of the manifest's land pattern, and no other pad."""
    turned = dict(zip(shown.designators(), shown.rotation_deg.tolist(), strict=True))
    wrong: dict[str, list[str]] = {}
    for some in found.alike:
        if _is_part(some.kind):
            for rotation_deg in dict.fromkeys(turned.get(name, 0.0) for name in some.names):
                names = [name for name in some.names if turned.get(name, 0.0) == rotation_deg]
                for problem in _pads_problems(some.pads, lands, rotation_deg):
                    wrong.setdefault(problem, []).extend(names)
    every = len(shown.parts_xy_mm)
    return [f"{what} ({'every part' if len(names) == every else named(names)})" for what, names in wrong.items()]


def _pads_problems(pads: Sequence[Tree], lands: Recorded, rotation_deg: float) -> list[str]:
    expected = [
        *((f"pad {k + 1}", "12"[k], "F.Cu", lands.pads, k) for k in range(2)),
        *((f"stencil aperture {k + 1}", "", "F.Paste", lands.paste, k) for k in range(2)),
    ]
    problems = []
    for what, name, layer, land, k in expected:
        same = [pad for pad in pads if pad[1] == name and child(pad, "layers")[1:] == (layer,)]
        # pad 1 is at -x of the unrotated part, pad 2 at +x; stencil apertures have no number, and are identified by the side
        here = [pad for pad in same if (values(pad, "at")[0] > 0) == (k == 1)]
        if len(here) != 1:
            problems.append(f"{what} is there {len(here)} times")
        elif not _is_land(here[0], land, k, rotation_deg):
            problems.append(f"{what} is not the land pattern's")
    return problems if len(pads) == len(expected) else [*problems, f"it has {len(pads)} lands, not {len(expected)}"]


def _is_land(pad: Tree, land: LandPattern, k: int, rotation_deg: float) -> bool:
    kinds = [child[0] for child in pad[4:] if isinstance(child, tuple)]
    (x_mm, y_mm, *turn_deg), (length_mm, width_mm) = values(pad, "at"), values(pad, "size")
    ratio = values(pad, "roundrect_rratio")[0] if "roundrect_rratio" in kinds else 0.0
    # KiCad gives a rounded pad's radius as a fraction of its shorter side
    radius_mm = ratio * min(length_mm, width_mm)
    wanted = (land.offset_mm if k else -land.offset_mm, 0.0, *land.size_mm, land.corner_radius_mm)
    # a pad's angle is relative to the board, its place relative to the footprint
    turned = abs(((turn_deg[0] if turn_deg else 0.0) - rotation_deg + 180.0) % 360.0 - 180.0)
    return bool(
        pad[2:4] in (("smd", "roundrect"), ("smd", "rect"))
        and len(kinds) == len(pad) - 4
        and set(kinds) <= set(_OF_A_LAND)
        and np.allclose((x_mm, y_mm, length_mm, width_mm, radius_mm), wanted, rtol=0.0, atol=PLACE_TOLERANCE_MM)
        and turned <= ROTATION_TOLERANCE_DEG
    )


def _sheet(found: _Board, shown: Shown) -> list[str]:
    """Check that the sheet has the board in its middle."""
    name, *sides = only(found.lists, "paper")[1:]
    width_mm, height_mm = (number(str(side)) for side in sides)
    x_mm, y_mm = found.origin_mm
    middle = (2 * x_mm + shown.size_mm[0], 2 * y_mm - shown.size_mm[1])
    right = name == "User" and np.allclose((width_mm, height_mm), middle, rtol=0.0, atol=PLACE_TOLERANCE_MM)
    return [] if right else [f"its sheet of {width_mm:g} x {height_mm:g} mm is not one with the board in its middle"]


def _outline(found: _Board, shown: Shown) -> list[str]:
    lines = [item for kind in ("gr_line", "gr_arc") for item in found.lists.get(kind, []) if layer_of(item) == "Edge.Cuts"]
    if len(lines) != shown.edge_lines:
        return [f"its outline has {len(lines)} sides and corners, not {shown.edge_lines}"]
    ends = ("start", "mid", "end")
    points = np.array([values(item, end) for item in lines for end in ends if end != "mid" or item[0] == "gr_arc"])
    box_mm = np.concatenate([points.min(axis=0), points.max(axis=0)]) - np.tile(found.origin_mm, 2)
    width_mm, height_mm = shown.size_mm
    # relative to the origin on the sheet, the board is above, at negative y
    wrong = np.abs(box_mm - (0.0, -height_mm, width_mm, 0.0)).max() > PLACE_TOLERANCE_MM
    return [f"its outline is {box_mm[2] - box_mm[0]:g} x {box_mm[3] - box_mm[1]:g} mm about another place"] if wrong else []


def _holes(found: _Board, shown: Shown) -> list[str]:
    holes = {name: xy[:2] for name, xy in found.at.items() if name.startswith("H")}
    drills = [(*holes[name], *values(pad, "drill")) for name in holes for pad in found.pads[name] if pad[2] == "np_thru_hole"]
    pads = [pad for name in holes for pad in found.pads[name]]
    centred = all(pad[3] == "circle" and values(pad, "at") == [0.0, 0.0] for pad in pads)
    wanted = np.array(shown.holes).reshape(-1, 3)
    if (
        centred
        and len(holes) == len(pads) == len(drills) == len(wanted)
        and np.allclose(np.array(drills).reshape(-1, 3), wanted, rtol=0.0, atol=PLACE_TOLERANCE_MM)
    ):
        return []
    return [f"its {len(drills)} holes are not the manifest's {len(wanted)}"]


def _fiducials(found: _Board, shown: Shown) -> list[str]:
    marks = [name for name in found.at if name.startswith("FID")]
    at_mm = np.array([found.at[name][:2] for name in marks]).reshape(-1, 2)
    wanted = np.array(shown.fiducials_mm).reshape(-1, 2)
    single = all(len(found.pads[name]) == 1 and _is_mark(found.pads[name][0], *shown.fiducial_mm) for name in marks)
    if single and len(marks) == len(wanted) and np.allclose(at_mm, wanted, rtol=0.0, atol=PLACE_TOLERANCE_MM):
        return []
    return [f"its {len(marks)} fiducials are not the manifest's {len(wanted)}"]


def _is_mark(pad: Tree, copper_mm: float, opening_mm: float) -> bool:
    sizes = (*values(pad, "at"), *values(pad, "size"), *values(pad, "solder_mask_margin"), *values(pad, "clearance"))
    wanted = (0.0, 0.0, copper_mm, copper_mm, (opening_mm - copper_mm) / 2, (opening_mm - copper_mm) / 2)
    disc = pad[2:4] == ("smd", "circle") and child(pad, "layers")[1:] == ("F.Cu", "F.Mask")
    return disc and len(sizes) == len(wanted) and np.allclose(sizes, wanted, rtol=0.0, atol=PLACE_TOLERANCE_MM)


def _tracks(found: _Board, shown: Shown) -> list[str]:
    """Check the copper other than pads: each anchor line once."""
    tracks = found.lists.get("segment", [])
    ends = np.array([(values(track, "start"), values(track, "end")) for track in tracks]).reshape(-1, 2, 2)
    lines_mm = (ends - found.origin_mm) * (1.0, -1.0)
    width_mm = np.array([values(track, "width")[0] for track in tracks])
    alone = len(without_counterpart(lines_mm, shown.tracks_mm)) + len(without_counterpart(shown.tracks_mm, lines_mm))
    wrong = np.abs(width_mm - shown.track_width_mm) > PLACE_TOLERANCE_MM
    elsewhere = any(layer_of(track) != "F.Cu" or child(track, "net")[1:] != ("0",) for track in tracks)
    if alone or wrong.any() or len(tracks) != len(shown.tracks_mm) or elsewhere:
        return [f"its {len(tracks)} tracks are not the {len(shown.tracks_mm)} lines of the anchors"]
    return []


def _unexpected(found: _Board) -> list[str]:
    """Check that the board has no zones, vias, graphics on copper or footprints on the underside, which this tool never makes."""
    strange: Counter[str] = Counter()
    for kind, items in found.lists.items():
        if kind in _DRAWN_ON:
            strange.update(f"{kind} on {layer}" for layer in map(layer_of, items) if layer not in _DRAWN_ON[kind])
        elif kind not in (*_SETTINGS, "footprint", "segment"):
            strange[kind] += len(items)
    for some in found.alike:
        for what in map(_foreign_item, some.items):
            if what is not None:
                strange[f"footprint with {what}"] += len(some.names)
    return [f"it has {count} {what}" for what, count in strange.items()]


def _foreign_item(item: str | Tree) -> str | None:
    """Description of an item that a footprint must not contain; None for others."""
    if isinstance(item, str) or item[0] not in _OF_A_FOOTPRINT:
        return str(item if isinstance(item, str) else item[0])
    layer = layer_of(item) if item[0] in _DRAWN_ON else str(item[1]) if item[0] == "layer" else None
    allowed = _DRAWN_ON.get(str(item[0]), ("F.Cu",))
    return f"{item[0]} on {layer}" if layer is not None and layer not in allowed else None
