"""Layout of a tape: every shape that is written, as arrays in the board frame (mm)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

from tactape_fab.kit.film.anchors import Anchors, anchor_plan, build_anchors
from tactape_fab.kit.film.coverlay import gang_window
from tactape_fab.kit.film.label import Label, compose_label
from tactape_fab.kit.film.tag_ink import tag_ink
from tactape_fab.kit.outlines import PartOutlines, part_outlines
from tactape_fab.kit.plan import TAG_KEEP_OUT_MM
from tactape_fab.kit.profiles import FabProfile, LegendSizes, PartProfile
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.board import Tag
from tactape_fab.texture.code import DEFAULT_CODE
from tactape_fab.texture.frames import FloatArray, snap_mm
from tactape_fab.texture.shapes import board_outline
from tactape_fab.texture.tag import SIDE_CELLS
from tactape_fab.texture.tape import Tape

_TAG_TO_TEXT_MM = 1.0
_END_GAP_MM = 1.0
_MOST_HIGHER_MM = 120


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flashes:
    """One outline repeated by translation.

    outline_mm (k, 2): Relative to the flash's own origin, counter-clockwise, not closed.
    xy_mm (m, 2): Places of the flashes, snapped to 1 nm.
    """

    outline_mm: FloatArray
    xy_mm: FloatArray

    def __post_init__(self) -> None:
        self.outline_mm.setflags(write=False)
        self.xy_mm.setflags(write=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Legend:
    """Legend: inked areas without holes, and strokes of width `line_mm` along `strokes_mm`."""

    areas_mm: tuple[FloatArray, ...] = ()
    strokes_mm: tuple[FloatArray, ...] = ()
    line_mm: float = 0.0
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """The drawn layers of a tape.

    parts_xy_mm (n, 2): Part centres in designator order.
    pads, paste: 2 n flashes: R1 land 1, R1 land 2, R2 land 1 ...
    openings, bodies: n flashes in designator order.
    outline_mm (k, 2): The board's outline with its rounded corners as polylines.
    coverlay: How the coverlay is opened: ``per-part``, ``lpi`` or ``gang``.
    window_mm (m, 2): In mode gang the one coverlay opening that replaces `openings`.
    anchors: Copper that extends from the pads under the coverlay.
    stiffener, adhesive: Layer laminated to the whole underside: material and thickness in mm.
    """

    tape: Tape
    part: PartProfile
    outlines: PartOutlines
    parts_xy_mm: FloatArray
    pads: Flashes
    paste: Flashes
    openings: Flashes
    bodies: Flashes
    outline_mm: FloatArray
    legend: Legend
    coverlay: str
    window_mm: FloatArray | None = None
    anchors: Anchors | None = None
    stiffener: str | None = None
    adhesive: str | None = None


def build_layout(tape: Tape, spec: TapeSpec, fab: FabProfile, part: PartProfile) -> Layout:
    """Draw a tape: placements, lands, openings, outline, tag and label."""
    outlines = part_outlines(part, fab, tape.part.rotation_deg)
    xy_mm = tape.part_xy_mm()
    gang = fab.coverlay_mode == "gang"
    anchors = None
    if spec.anchor != "none" and not gang:
        anchors = build_anchors(anchor_plan(spec.anchor, fab, outlines), tape, part.pads)

    def lands(centres_mm: FloatArray) -> FloatArray:
        return snap_mm(xy_mm[:, None] + centres_mm).reshape(-1, 2)

    return Layout(
        tape=tape,
        part=part,
        outlines=outlines,
        parts_xy_mm=xy_mm,
        pads=Flashes(outline_mm=outlines.pad, xy_mm=lands(outlines.pad_xy)),
        paste=Flashes(outline_mm=outlines.paste, xy_mm=lands(outlines.paste_xy)),
        openings=Flashes(outline_mm=outlines.opening, xy_mm=xy_mm),
        bodies=Flashes(outline_mm=outlines.body, xy_mm=xy_mm),
        outline_mm=board_outline(tape.board.size_mm, tape.board.corner_radius_mm),
        legend=tape_legend(tape, fab.legend, light=fab.legend_colour == "white"),
        coverlay=fab.coverlay_mode,
        window_mm=gang_window(tape.board, xy_mm, outlines.opening) if gang else None,
        anchors=anchors,
        stiffener=spec.stiffener,
        adhesive=spec.adhesive,
    )


def tape_legend(tape: Tape, rules: LegendSizes, *, light: bool) -> Legend:
    """Tag and label of a tape's strip; empty without a strip.

    rules: Limits of the fab's legend printer.
    light: Whether the ink is lighter than the film.
    """
    if tape.tag is None:
        return Legend()
    ink = tag_ink(tape.tag.id, cell_mm=tape.tag.cell_mm, gap_mm=rules.gap_mm, bleed_mm=rules.bleed_mm, legend_is_light=light)
    label = _label(tape, tape.tag, rules, tape.board.size_mm)
    return Legend(
        areas_mm=tuple(snap_mm(area + tape.tag.center_mm) for area in ink.areas_mm),
        strokes_mm=tuple(snap_mm(stroke) for stroke in label.strokes_mm),
        line_mm=rules.line_mm,
        left_out=label.left_out,
    )


def labelled_size_mm(tape: Tape, fab: FabProfile) -> tuple[float, float] | None:
    """The outline, higher by the fewest whole millimetres, whose strip holds the whole label, mm; None if there is none."""
    assert tape.tag is not None
    width_mm, height_mm = tape.board.size_mm
    for higher_mm in range(_MOST_HIGHER_MM):
        size_mm = (width_mm, height_mm + higher_mm)
        if not _label(tape, tape.tag, fab.legend, size_mm).left_out:
            return size_mm
    return None


def shorter_name_fits(tape: Tape, fab: FabProfile) -> bool:
    """Whether the strip holds the whole label once the name is a single character."""
    assert tape.tag is not None
    return not _label(replace(tape, name=tape.name[:1]), tape.tag, fab.legend, tape.board.size_mm).left_out


def _label(tape: Tape, tag: Tag, rules: LegendSizes, size_mm: tuple[float, float]) -> Label:
    """The label of a strip on an outline: between the tag and the upper end, inside the outline's rounded corner."""
    left_mm = TAG_KEEP_OUT_MM + rules.line_mm
    radius_mm, edge_mm = tape.board.corner_radius_mm, rules.edge_mm
    # the rounded corner, offset inward by edge_mm, is an arc of radius R - edge about (R, height - R): at left_mm it is R - rise
    # below the upper side; right of the corner only the end gap counts
    rise_mm = sqrt(max((radius_mm - edge_mm) ** 2 - (radius_mm - left_mm) ** 2, 0.0)) if left_mm < radius_mm else radius_mm
    return compose_label(
        [
            tape.name,
            f"sector {tape.sector}" + ("" if tape.code == DEFAULT_CODE else f" of {tape.code}"),
            f"{size_mm[0]:g} x {size_mm[1]:g} mm",
            f"W {tape.pitch_mm:g}  Δ {tape.displacement_mm:g} mm",
        ],
        x_mm=(left_mm, SIDE_CELLS * tag.cell_mm + 2 * TAG_KEEP_OUT_MM - left_mm),
        y_mm=(
            tag.center_mm[1] + SIDE_CELLS * tag.cell_mm / 2 + _TAG_TO_TEXT_MM,
            size_mm[1] - max(_END_GAP_MM, radius_mm - rise_mm),
        ),
        cap_mm=rules.text_mm,
    )
