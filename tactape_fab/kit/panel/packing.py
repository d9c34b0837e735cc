"""Packing of rectangular tapes into sheets that fab and assembly line accept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.kit.panel.geometry import Panel
from tactape_fab.kit.panel.max_rects import bottom_left, fill_sheets, short_side_fit
from tactape_fab.kit.panel.tabs_and_marks import plan_packed
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray, snap_mm

FRAME_GAPS = 3
"""Least distance of two packed tapes, in gaps: the slots of both, and between them a web as wide as a slot."""
_WIDTHS = 24
"""Number of sheet widths that are tried for a panel's tapes."""
_UNITS_PER_MM = 1_000_000
"""Packing is done in whole nanometres: with floats, touching neighbours might count as overlapping."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Packing:
    """Places of n tapes on sheets.

    sizes_mm (n, 2): Outlines of the tapes as given.
    sheet (n,): Sheet of each tape, from 0.
    xy_mm (n, 2): Lower left corner of its occupied area, relative to the lower left corner of the sheet's area.
    turned (n,): Whether it is rotated by 90 degrees, counter-clockwise.
    """

    sizes_mm: FloatArray
    sheet: IntArray
    xy_mm: FloatArray
    turned: BoolArray

    @property
    def sheets(self) -> int:
        """Number of sheets."""
        return int(self.sheet.max()) + 1

    @property
    def offset_mm(self) -> FloatArray:
        """Place of each tape's board origin, mm, so that p_sheet = offset + R_ccw(0 or 90 degrees) p_board; shape (n, 2)."""
        turn_mm = np.stack([np.where(self.turned, self.sizes_mm[:, 1], 0.0), np.zeros(len(self.sheet))], axis=1)
        return np.asarray(self.xy_mm + turn_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedPanel:
    """A panel, and the indices of the tapes on it in the order of its places."""

    panel: Panel
    tapes: tuple[int, ...]


def sheet_room_mm(fab: FabProfile) -> tuple[float, float]:
    """Area for tapes on the largest panel of a fab, mm: the panel less the rails on all four sides and a gap along each."""
    border_mm = 2 * (fab.panel.rail_mm + fab.panel.gap_mm)
    width_mm, height_mm = (side_mm - border_mm for side_mm in fab.largest_panel_mm)
    return width_mm, height_mm


def misfit(size_mm: tuple[float, float], fab: FabProfile) -> Problem | None:
    """The problem of a tape that fits no sheet of a fab in either orientation."""
    room_mm = sheet_room_mm(fab)
    if max(size_mm) <= max(room_mm) and min(size_mm) <= min(room_mm):
        return None
    panel, largest_mm = fab.panel, fab.largest_panel_mm
    message = (
        f"size_mm = {size_mm[0]:g} x {size_mm[1]:g} mm does not fit into {room_mm[0]:g} x {room_mm[1]:g} mm, the room on a panel "
        f"of {largest_mm[0]:g} x {largest_mm[1]:g} mm of {fab.name} within rails of {panel.rail_mm:g} mm and gaps of "
        f"{panel.gap_mm:g} mm; use a smaller tape, or leave --pack out"
    )
    return Problem("size_mm", message)


def pack(sizes_mm: Sequence[tuple[float, float]], sheet_mm: tuple[float, float], gap_mm: float) -> Packing:
    """Pack tapes into the fewest sheets that several heuristics find; ties go to the packing with the emptiest last sheet.

    Tapes may be rotated by 90 degrees. Tapes of one size keep the given order: by sheet, from the top row down, left to right.

    sizes_mm: Width and height of each tape's outline.
    sheet_mm: Area for tapes on a sheet.
    gap_mm: Least gap between two tapes.
    Raises SpecError if there is no tape, or one fits no sheet.
    """
    sizes = np.asarray(sizes_mm, dtype=np.float64).reshape(-1, 2)
    if not len(sizes):
        raise SpecError("sizes_mm names no tape to pack; give one or more")
    if sizes.max() > max(sheet_mm) or sizes.min(axis=1).max() > min(sheet_mm):
        raise SpecError(
            f"a tape does not fit a sheet of {sheet_mm[0]:g} x {sheet_mm[1]:g} mm; use smaller tapes or larger sheets"
        )
    # tapes a gap apart in a sheet of side s are equivalent to touching tapes wider by the gap in a sheet of side s + gap
    sides = _whole(sizes + gap_mm)
    width, height = (int(side) for side in _whole(np.asarray(sheet_mm) + gap_mm))
    found = [
        fill_sheets(sides, (width, height), order, rule) for rule in (short_side_fit, bottom_left) for order in _orders(sides)
    ]
    places = _in_order(min(found, key=lambda rows: _cost(rows, sides)), sizes)
    return Packing(
        sizes_mm=sizes,
        sheet=places[:, 0],
        xy_mm=places[:, 1:3] / _UNITS_PER_MM,
        turned=places[:, 3].astype(bool),
    )


def pack_panels(outlines: Sequence[tuple[tuple[float, float], float]], fab: FabProfile) -> tuple[Packing, list[PackedPanel]]:
    """Pack tapes into panels of a fab, each as small as its tapes and the assembly line allow.

    outlines (size, radius): Outlines of the tapes as boards, mm.
    Raises SpecError if there is no tape, one fits no sheet, or a panel has no room for its tabs or marks.
    """
    packing = pack([size_mm for size_mm, _ in outlines], sheet_room_mm(fab), FRAME_GAPS * fab.panel.gap_mm)
    panels = []
    for sheet in range(packing.sheets):
        tapes = np.flatnonzero(packing.sheet == sheet)
        own = _tightest([(float(w), float(h)) for w, h in packing.sizes_mm[tapes]], fab)
        x, y = own.xy_mm.T
        order = np.lexsort((x, -y, own.turned))  # an unturned tape first, as the fab drawing enlarges its parts
        places = [
            ((float(snap_mm(px)), float(snap_mm(py))), bool(own.turned[i]))
            for i, (px, py) in zip(
                order.tolist(), (own.offset_mm[order] + fab.panel.rail_mm + fab.panel.gap_mm).tolist(), strict=True
            )
        ]
        found = tuple(tapes[order].tolist())
        panel = plan_packed(_panel_mm(own, fab), [outlines[i] for i in found], places, fab)
        panels.append(PackedPanel(panel=panel, tapes=found))
    return packing, panels


def _panel_mm(packing: Packing, fab: FabProfile) -> tuple[float, float]:
    """Outline of the smallest panel that holds a sheet's tapes and that assembly accepts."""
    extents = np.where(packing.turned[:, None], packing.sizes_mm[:, ::-1], packing.sizes_mm)
    far = (packing.xy_mm + extents).max(axis=0) + 2 * (fab.panel.rail_mm + fab.panel.gap_mm)
    longer, shorter = fab.panel.smallest_mm
    least = (longer, shorter) if far[0] >= far[1] else (shorter, longer)
    width, height = (float(snap_mm(max(a, b))) for a, b in zip(far.tolist(), least, strict=True))
    return width, height


def _tightest(sizes_mm: Sequence[tuple[float, float]], fab: FabProfile) -> Packing:
    """Repack one sheet's tapes into sheets of several widths; the packing with the smallest, then the squarest panel."""
    room_mm, gap_mm = sheet_room_mm(fab), FRAME_GAPS * fab.panel.gap_mm
    # a sheet must be at least as wide as the largest of the shorter sides, and at most as wide as the room
    low, high = min(max(min(size) for size in sizes_mm), room_mm[0]), max(max(size) for size in sizes_mm)
    tried = [pack(sizes_mm, room_mm, gap_mm)]
    # a tape longer than the room's height has to fit across
    for width_mm in np.linspace(low, room_mm[0], _WIDTHS).tolist():
        if high <= max(width_mm, room_mm[1]):
            tried.append(pack(sizes_mm, (width_mm, room_mm[1]), gap_mm))
    # the order and rule by which `pack_panels` filled this sheet fill it again, so at least one try needs one sheet only
    sizes = {k: _panel_mm(packing, fab) for k, packing in enumerate(tried) if packing.sheets == 1}
    return tried[min(sizes, key=lambda k: (round(sizes[k][0] * sizes[k][1], 3), max(sizes[k])))]


def _whole(lengths_mm: FloatArray) -> IntArray:
    return np.rint(lengths_mm * _UNITS_PER_MM).astype(np.int64)


def _orders(sides: IntArray) -> list[list[int]]:
    """Orders of packing: largest first, by area, by longer side, and by shorter side; ties in the given order."""
    low, high = sides.min(axis=1), sides.max(axis=1)
    keys = ((low * high,), (high, low), (low, high))  # nanometres: the product of two sides of 1 m is below 2**63
    return [np.lexsort([-k for k in reversed(key)]).tolist() for key in keys]


def _cost(places: IntArray, sides: IntArray) -> tuple[int, int, int]:
    """Cost of a packing: number of sheets, tape area on the emptiest of them, number of rotated tapes."""
    # float64 has sixteen digits, enough for nm^2, as the sums are only compared
    area = np.bincount(places[:, 0], weights=sides.prod(axis=1).astype(np.float64))
    return len(area), int(area.min()), int(places[:, 3].sum())


def _in_order(places: IntArray, sizes_mm: FloatArray) -> IntArray:
    """The same places, fullest sheet first, with tapes of one size assigned in the given order."""
    area = np.bincount(places[:, 0], weights=sizes_mm.prod(axis=1)).round(6)
    rank = np.empty(len(area), dtype=np.int64)
    # stable: sheets of equal area keep their order, so that the same list gives the same panels
    rank[np.argsort(-area, kind="stable")] = np.arange(len(area))
    places = np.column_stack([rank[places[:, 0]], places[:, 1:]])
    _, kinds = np.unique(sizes_mm, axis=0, return_inverse=True)
    ordered = places.copy()
    for kind in range(kinds.max() + 1):
        alike = np.flatnonzero(kinds.reshape(-1) == kind)
        slots = places[alike]
        # lexsort's last key is the first: by sheet, then from the top row down, then from left to right
        ordered[alike] = slots[np.lexsort((slots[:, 1], -slots[:, 2], slots[:, 0]))]
    return ordered
