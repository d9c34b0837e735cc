"""Facts for the order notes and the fab drawing, gathered from layout, fab profile and findings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor, inf

import numpy as np

from tactape_fab.base.errors import Finding
from tactape_fab.kit.artifact import AnyArtifact
from tactape_fab.kit.estimate import Estimate, estimate
from tactape_fab.kit.film.anchors import foreign_pads_mm
from tactape_fab.kit.film.layout import Layout
from tactape_fab.kit.panel.geometry import CORNER_RADIUS_MM, Panel, Place
from tactape_fab.kit.plan import TOLERANCE_MM
from tactape_fab.kit.profiles import FabProfile, Origin, PartNumber, PartProfile
from tactape_fab.texture.frames import pair_of
from tactape_fab.texture.shapes import outlines_at, reach_mm
from tactape_fab.texture.tag import SIDE_CELLS
from tactape_fab.texture.tape import Tape

_CLOSE = 1.25
"""A limit is close if the measured value is less than this factor times the limit."""
_NEVER_CLOSE = ("size", "corner-radius", "part-count")
"""Rules whose value is not a gap that a fab could fail to make."""
_INK_CLEAR_MM = 0.5
_LEAST_AREA_MM = 1.5
_TENTHS = 10

Box = tuple[float, float, float, float]
"""Least x, least y, largest x, largest y: board frame, mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """A relevant threshold that no fab has confirmed."""

    rule: str
    message: str
    source: str
    date: str


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderedTape:
    """A tape of a panel: its place, how it is made, the numbers of its first and last designator, and its field on the panel."""

    name: str
    sector: int
    first: int
    last: int
    offset_mm: tuple[float, float]
    size_mm: tuple[float, float]
    turned: bool
    made: str
    field_mm: Box


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderedPanel:
    """Facts of a panel for the order notes.

    mixed: Whether its tapes differ in W, Δ, coverlay or anchors.
    loose: Whether any tape has pads without anchors.
    """

    words: str
    mixed: bool
    loose: bool
    rail_mm: float
    gap_mm: float
    tab_mm: float
    tapes: tuple[OrderedTape, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderFacts:
    """Values available to the templates of order notes.

    name, size_mm, part_count: Of the ordered item: the tape, or the panel in `panel`; `tape` is then its first tape.
    corner_radius_mm: Of its outline.
    legend: Whether anything is printed on it.
    designs: Number of different designs among its tapes.
    files: Maps roles to paths in the kit.
    part_number: In the assembly house's format; '' without one.
    field_mm: Box that contains every coverlay opening, rounded outward to 0.1 mm; nothing may be added in it.
    number_mm: Box where the fab may print its order number: in the strip, clear of tag and label; rounded inward, None if
        there is no space.
    slash: Direction of a part seen from above: one of ``- / | \\``.
    fits_panel: Whether the board alone is within the assembly line's limits.
    fits_rails: Whether it is with the rails and slots of a panel, which the fab could make of it.
    questions, broken, warnings, close: Relevant unconfirmed thresholds, broken blocking rules (the tape was forced), warnings
        without a threshold, and limits that are met with less than the margin `_CLOSE`, or not met.
    coverlays: Ways in which the tapes' coverlay is opened, without repetition.
    rotation_deg, turned_slash: Rotation of parts on tapes that are not turned; direction of parts on turned tapes, "" without
        any.
    pitch_words, displacement_words: W and Δ of all tapes.
    first_mm, last_mm: Places of the first and the last part.
    stiffener, adhesive: Layer laminated to the underside: material and thickness in mm.
    backed_holes: Whether a tape has holes, which go through these layers; those in the rails of a panel do not.
    anchors: ``spur``, ``mesh`` or ``none``.
    """

    name: str
    size_mm: tuple[float, float]
    corner_radius_mm: float
    legend: bool
    part_count: int
    tape: Tape
    fab: FabProfile
    part: PartProfile
    part_number: str
    files: Mapping[str, str]
    bom_rows: int
    field_mm: Box
    number_mm: Box | None
    slash: str
    fits_panel: bool
    fits_rails: bool
    least_gap_mm: float
    least_hole_mm: float | None
    opening_mm: tuple[float, float]
    questions: tuple[Question, ...]
    broken: tuple[str, ...]
    warnings: tuple[str, ...]
    close: tuple[str, ...]
    estimate: Estimate
    coverlays: list[str]
    rotation_deg: float
    pitch_words: str
    displacement_words: str
    first_mm: tuple[float, float]
    last_mm: tuple[float, float]
    turned_slash: str = ""
    stiffener: str | None = None
    adhesive: str | None = None
    backed_holes: bool = False
    anchors: str = "none"
    designs: int = 1
    panel: OrderedPanel | None = None

    @property
    def unit(self) -> str:
        """Description of the ordered item."""
        return "tape" if self.panel is None else "panel"

    @property
    def fields_mm(self) -> list[tuple[Box, Box | None]]:
        """For every tape, in the ordered item's frame: the field of parts, and the box for the fab's number (None without)."""
        if self.panel is None:
            return [(self.field_mm, self.number_mm)]
        return [(tape.field_mm, None) for tape in self.panel.tapes]

    @property
    def turned(self) -> bool:
        """Whether any tape is turned on the panel."""
        return bool(self.turned_slash)

    @property
    def number(self) -> PartNumber | None:
        """The house's entry for the part number; None if the number is the user's own, or none is given."""
        known = self.fab.order.number
        return known if known is not None and known.number == self.part_number else None


def order_facts(layout: Layout, fab: FabProfile, findings: Sequence[Finding], artifacts: Sequence[AnyArtifact]) -> OrderFacts:
    """Gather the facts of one tape's order; `artifacts` are the files of its film."""
    tape, part = layout.tape, layout.part
    (bom,) = (a for a in artifacts if a.role == "bom")
    longer, shorter = max(tape.board.size_mm), min(tape.board.size_mm)
    least, most = fab.panel.smallest_mm, fab.panel.largest_mm
    field_mm = _field(layout)
    return OrderFacts(
        name=tape.name,
        size_mm=tape.board.size_mm,
        corner_radius_mm=tape.board.corner_radius_mm,
        legend=_has_legend(layout),
        part_count=tape.part_count,
        tape=tape,
        fab=fab,
        part=part,
        part_number=part.part_numbers.get(fab.assembly, ""),
        files={a.role: a.path for a in artifacts},
        bom_rows=bom.data.count(b"\r\n") - 1,
        field_mm=field_mm,
        number_mm=_number_area(layout, fab, field_mm[0]),
        slash=_slash(tape.part.rotation_deg),
        fits_panel=all(
            low - TOLERANCE_MM <= side <= high + TOLERANCE_MM
            for low, side, high in zip(least, (longer, shorter), most, strict=True)
        ),
        fits_rails=all(side <= high + TOLERANCE_MM for side, high in zip((longer, shorter), fab.largest_railed_mm, strict=True)),
        least_gap_mm=_least_gap_mm([layout], fab, findings),
        least_hole_mm=min((hole[2] for hole in tape.board.holes), default=None),
        opening_mm=layout.outlines.opening_size_mm,
        questions=_questions(fab, findings),
        broken=tuple(f"{f.rule}: {f.message}" for f in findings if f.blocks),
        warnings=tuple(f"{f.rule}: {f.message}" for f in findings if f.level == "warn" and not f.passed and not f.source),
        close=tuple(f"{f.rule}: {f.message}" for f in findings if _is_close(f)),
        estimate=estimate(tape.part_count, fab),
        coverlays=[layout.coverlay],
        rotation_deg=tape.part.rotation_deg,
        pitch_words=f"{tape.pitch_mm:.4g}",
        displacement_words=f"{tape.displacement_mm:.4g}",
        first_mm=pair_of(layout.parts_xy_mm[0]),
        last_mm=pair_of(layout.parts_xy_mm[-1]),
        stiffener=layout.stiffener,
        adhesive=layout.adhesive,
        backed_holes=bool(tape.board.holes),
        anchors="none" if layout.anchors is None else layout.anchors.mode,
    )


def panel_order_facts(
    name: str,
    panel: Panel,
    layouts: Sequence[Layout],
    fab: FabProfile,
    findings: Sequence[Finding],
    artifacts: Sequence[AnyArtifact],
) -> OrderFacts:
    """Gather the facts of a panel's order; `artifacts` are its own files, `layouts` in the order of `Panel.offsets_mm`."""
    facts = order_facts(layouts[0], fab, findings, artifacts)
    counts = [layout.tape.part_count for layout in layouts]
    # designators are numbered through all tapes: the last number of each tape
    last = np.cumsum(counts).tolist()
    holes = [hole[2] for layout in layouts for hole in layout.tape.board.holes]
    made, turned = [_made(layout) for layout in layouts], [place.turned for place in panel.places]
    ways = dict.fromkeys(way for _, way, _ in made)
    rotation_deg = layouts[0].tape.part.rotation_deg
    # the first part of the first tape and the last of the last one
    ends = [panel.places[i].on_panel_mm(layouts[i].parts_xy_mm[i]) for i in (0, -1)]
    return replace(
        facts,
        name=name,
        size_mm=panel.size_mm,
        corner_radius_mm=CORNER_RADIUS_MM,
        legend=any(map(_has_legend, layouts)),
        part_count=sum(counts),
        fits_panel=True,
        fits_rails=True,
        least_gap_mm=_least_gap_mm(layouts, fab, findings),
        backed_holes=bool(holes),
        least_hole_mm=min([*holes, *(hole[2] for hole in panel.tooling_holes_mm)], default=None),
        estimate=estimate(sum(counts), fab),
        coverlays=[*ways],
        anchors=" or ".join(dict.fromkeys(anchors for _, _, anchors in made if anchors != "none")) or "none",
        pitch_words=_either(layout.tape.pitch_mm for layout in layouts),
        displacement_words=_either(layout.tape.displacement_mm for layout in layouts),
        # parts of a turned tape are turned by another 90 degrees; if all tapes are turned, that is their direction
        slash=_slash(rotation_deg + 90.0 * all(turned)),
        turned_slash=_slash(rotation_deg + 90.0) if any(turned) and not all(turned) else "",
        rotation_deg=(rotation_deg + 90.0 * all(turned)) % 360.0,
        first_mm=ends[0],
        last_mm=ends[1],
        designs=len({_design(layout) for layout in layouts}),
        panel=OrderedPanel(
            words=panel.words,
            mixed=len(set(made)) > 1,
            loose=any(anchors == "none" for _, _, anchors in made),
            rail_mm=panel.rail_mm,
            gap_mm=panel.gap_mm,
            tab_mm=panel.tab_mm,
            tapes=tuple(
                OrderedTape(
                    name=layout.tape.name,
                    sector=layout.tape.sector,
                    first=end - count + 1,
                    last=end,
                    offset_mm=place.offset_mm,
                    size_mm=place.size_mm,
                    turned=place.turned,
                    made=", ".join(words),
                    field_mm=_on_panel(_field(layout), place),
                )
                for layout, count, end, place, words in zip(layouts, counts, last, panel.places, made, strict=True)
            ),
        ),
    )


def _has_legend(layout: Layout) -> bool:
    return bool(layout.legend.areas_mm or layout.legend.strokes_mm)


def _least_gap_mm(layouts: Sequence[Layout], fab: FabProfile, findings: Sequence[Finding]) -> float:
    """Least copper spacing: between pads, between spurs, and of anchors from pads of other parts."""
    measured = {f.rule: f.value for f in findings if f.value is not None}
    least_mm = min((measured[rule] for rule in ("pad-pad", "pad-pair", "anchor-copper") if rule in measured), default=0.0)
    # a pad is at least one expansion inside its opening, which often shows that anchors are not the nearest copper
    if measured.get("anchor-opening", inf) + fab.coverlay_expansion_mm >= least_mm:
        return least_mm
    anchored = [(layout.anchors, outlines_at(layout.pads.xy_mm, layout.pads.outline_mm)) for layout in layouts]
    return min([least_mm, *(foreign_pads_mm(anchors, pads_mm) for anchors, pads_mm in anchored if anchors is not None)])


def _made(layout: Layout) -> tuple[str, str, str]:
    """W and Δ, coverlay, and anchors of a tape as text."""
    tape, anchors = layout.tape, layout.anchors
    way = layout.coverlay
    return f"W {tape.pitch_mm:.4g} Δ {tape.displacement_mm:.4g}", way, "none" if anchors is None else anchors.mode


def _design(layout: Layout) -> tuple[object, ...]:
    """Key that is equal for two tapes of a panel with the same design, whatever their names."""
    tape = layout.tape
    texture = tape.code, tape.sector, tape.origin, tape.directions, tape.pitch_mm, tape.displacement_mm
    return (*texture, tape.board, tape.tag, *_made(layout))


def _either(values: Iterable[float]) -> str:
    known = [f"{value:.4g}" for value in sorted(set(values))]
    return known[0] if len(known) == 1 else f"{', '.join(known[:-1])} or {known[-1]}"


def _on_panel(box: Box, place: Place) -> Box:
    # after a turn by 90 degrees the corners have to be sorted again
    a, b = place.on_panel_mm(np.array(box[:2])), place.on_panel_mm(np.array(box[2:]))
    return min(a[0], b[0]), min(a[1], b[1]), max(a[0], b[0]), max(a[1], b[1])


def _slash(rotation_deg: float) -> str:
    # one of four characters, for the nearest of 0, 45, 90 and 135 degrees; a chip has a twofold symmetry
    return "-/|\\"[round(rotation_deg % 180.0 / 45.0) % 4]


def _is_close(finding: Finding) -> bool:
    """Whether an unconfirmed limit is met by a small margin, or not met; of those that are no gap, whether it is not met."""
    if finding.rule in _NEVER_CLOSE:
        # the number of parts has a question of its own
        return finding.level == "warn" and not finding.passed and finding.rule != "part-count"
    asked = finding.source and not finding.confirmed and finding.level != "info"
    # with a limit of 0, such as that of courtyards, only an overlap is close
    return bool(asked) and finding.value is not None and finding.limit is not None and finding.value < _CLOSE * finding.limit


def _field(layout: Layout) -> Box:
    xy, reach = layout.openings.xy_mm, reach_mm(layout.openings.outline_mm)
    low, high = xy.min(axis=0) - reach, xy.max(axis=0) + reach
    if layout.window_mm is not None:
        low, high = np.minimum(low, layout.window_mm.min(axis=0)), np.maximum(high, layout.window_mm.max(axis=0))
    # outward to tenths, so that the printed field contains every opening
    low, high = np.floor(low * _TENTHS) / _TENTHS, np.ceil(high * _TENTHS) / _TENTHS
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _number_area(layout: Layout, fab: FabProfile, field_left_mm: float) -> Box | None:
    """The tallest area of the strip without ink and holes, clear of the field; None without a strip or without space."""
    tape, legend, edge_mm = layout.tape, layout.legend, fab.legend.edge_mm
    if tape.tag is None:
        return None
    half_mm = SIDE_CELLS * tape.tag.cell_mm / 2
    right_mm = min(tape.tag.center_mm[0] + half_mm, field_left_mm - _INK_CLEAR_MM)
    # intervals of y with ink anywhere in the strip: the tag, then each stroke of the label
    inked = [(tape.tag.center_mm[1] - half_mm, tape.tag.center_mm[1] + half_mm)]
    inked += [(float(stroke[:, 1].min()), float(stroke[:, 1].max())) for stroke in legend.strokes_mm]
    inked += [(y - d / 2, y + d / 2) for x, y, d in tape.board.holes if x - d / 2 < right_mm + _INK_CLEAR_MM]
    # sorted by their lower ends, between the board's edges as intervals of length 0
    ends = np.array(sorted([(edge_mm, edge_mm), *inked, *[(tape.board.size_mm[1] - edge_mm,) * 2]]))
    # running maximum of the upper ends, as intervals may be nested or overlap
    tops = np.maximum.accumulate(ends[:, 1])
    gaps = [(low + _INK_CLEAR_MM, high - _INK_CLEAR_MM) for low, (high, _) in zip(tops[:-1], ends[1:], strict=True)]
    low, high = max(gaps, key=lambda gap: gap[1] - gap[0])
    left_mm = max(edge_mm, _INK_CLEAR_MM)
    if high - low < _LEAST_AREA_MM or right_mm - left_mm < _LEAST_AREA_MM:
        return None
    # inward to tenths, as the notes print them
    x0, y0 = (ceil(value * _TENTHS) / _TENTHS for value in (left_mm, low))
    x1, y1 = (floor(value * _TENTHS) / _TENTHS for value in (right_mm, high))
    return x0, y0, x1, y1


def _questions(fab: FabProfile, findings: Sequence[Finding]) -> tuple[Question, ...]:
    """A question for each unconfirmed threshold that a rule was checked against."""
    tables = (fab.panel, fab.parts, fab.anchor, fab.stiffener, fab.adhesive, fab.stencil, fab.bend, fab.legend)
    origins: list[Origin] = [*fab.limits.values(), fab.size, fab.parts.smallest_origin]
    origins += [table.origin for table in tables if table is not None]
    # findings have the source of a limit, but not its date, which is looked up by source
    dates = {origin.source: origin.date for origin in origins}
    of_rules = {(rule, limit.source): limit.date for rule, limit in fab.limits.items()}
    return tuple(
        Question(
            rule=f.rule,
            message=f.message,
            source=f.source,
            date=of_rules.get((f.rule, f.source)) or dates.get(f.source, "no date"),
        )
        for f in findings
        if f.source and not f.confirmed
    )
