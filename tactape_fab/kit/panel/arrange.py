"""Arrangements of a panel, as columns and rows of tapes, that fab and assembly accept."""

from __future__ import annotations

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.kit.panel.geometry import Size, panel_size_mm
from tactape_fab.kit.plan import TOLERANCE_MM
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.spec.panel_options import MOST_ALONG


def within(size_mm: Size, fab: FabProfile) -> bool:
    """Whether assembly and fab accept a board of this size."""
    longer, shorter = max(size_mm), min(size_mm)
    least, largest = fab.panel.smallest_mm, fab.largest_panel_mm
    above = longer >= least[0] - TOLERANCE_MM and shorter >= least[1] - TOLERANCE_MM
    return above and longer <= largest[0] + TOLERANCE_MM and shorter <= largest[1] + TOLERANCE_MM


def arrangements(tape_mm: Size, fab: FabProfile) -> list[tuple[int, int]]:
    """Every arrangement that fab and assembly accept: the fewest tapes first, then the smallest area, then the squarest."""
    longest = fab.largest_panel_mm[0]
    # an upper bound without rails and gaps; `within` decides
    columns, rows = (min(MOST_ALONG, int(longest // side)) for side in tape_mm)
    sizes = {
        (c, r): panel_size_mm(tape_mm, (c, r), fab.panel.rail_mm, fab.panel.gap_mm)
        for c in range(1, columns + 1)
        for r in range(1, rows + 1)
    }
    fitting = [pair for pair, size in sizes.items() if within(size, fab)]
    return sorted(fitting, key=lambda p: (p[0] * p[1], sizes[p][0] * sizes[p][1], max(sizes[p]), p))


def choose_arrangement(tape_mm: Size, fab: FabProfile, count: int | None, alone: str = "--panel none") -> tuple[int, int]:
    """The arrangement of the fewest tapes that assembly accepts, or of exactly `count`.

    alone: Options by which tapes are made without a panel.
    Raises SpecError if there is no such arrangement.
    """
    fitting = arrangements(tape_mm, fab)
    size = f"{tape_mm[0]:g} x {tape_mm[1]:g} mm"
    if not fitting:
        width, height = panel_size_mm(tape_mm, (1, 1), fab.panel.rail_mm, fab.panel.gap_mm)
        message = (
            f"panel = 'auto': tapes of {size} fit on no panel: one with its rails is {width:g} x {height:g} mm, and "
            f"{_takes(fab)}; use another --size, or {alone}"
        )
        raise SpecError(Problem("panel", message))
    matching = [pair for pair in fitting if count is None or pair[0] * pair[1] == count]
    if not matching:
        known = sorted({c * r for c, r in fitting})
        near = ", ".join(str(n) for n in sorted(known, key=lambda n: abs(n - (count or 0)))[:3])
        message = (
            f"panel = 'auto': {count} tapes of {size} fill no panel that {fab.name} takes; name another number of --sectors, "
            f"such as {near}"
        )
        raise SpecError(Problem("panel", message))
    return matching[0]


def _takes(fab: FabProfile) -> str:
    least, most, board = fab.panel.smallest_mm, fab.panel.largest_mm, fab.size.largest_mm
    return (
        f"assembly at {fab.name} takes {least[0]:g} x {least[1]:g} to {most[0]:g} x {most[1]:g} mm, "
        f"the fab boards of up to {board[0]:g} x {board[1]:g} mm"
    )


def arrangement_problem(
    tape_mm: Size, arrangement: tuple[int, int], fab: FabProfile, named: int | None, alone: str = "--panel none"
) -> Problem | None:
    """The problem of an arrangement at this fab, or None; ``named`` is the number of sectors, if given, ``alone`` as above."""
    size = panel_size_mm(tape_mm, arrangement, fab.panel.rail_mm, fab.panel.gap_mm)
    if within(size, fab):
        return None
    nearest = nearest_arrangement(tape_mm, arrangement, fab)
    remedy = f"use another --size, or {alone}" if nearest is None else f"use --panel {nearest[0]}x{nearest[1]}"
    if nearest is not None and named not in (None, nearest[0] * nearest[1]):
        remedy += f", and name {nearest[0] * nearest[1]} sectors"
    given = f"panel = {arrangement[0]}x{arrangement[1]} of {tape_mm[0]:g} x {tape_mm[1]:g} mm tapes"
    return Problem("panel", f"{given} is {size[0]:g} x {size[1]:g} mm, but {_takes(fab)}; {remedy}")


def nearest_arrangement(tape_mm: Size, arrangement: tuple[int, int], fab: FabProfile) -> tuple[int, int] | None:
    """The accepted arrangement whose number of tapes is nearest to that of `arrangement`; None if there is none."""
    count = arrangement[0] * arrangement[1]
    return min(arrangements(tape_mm, fab), key=lambda p: abs(p[0] * p[1] - count), default=None)
