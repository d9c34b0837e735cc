"""Incoming inspection: from scans and a kit to the positions of all parts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, refuse, tried
from tactape_fab.base.fields import shown
from tactape_fab.base.given_path import as_path
from tactape_fab.sense.inspect.bodies import Bodies, fit_bodies
from tactape_fab.sense.inspect.colours import Palette, learn_palette
from tactape_fab.sense.inspect.film import fit_film
from tactape_fab.sense.inspect.foreign import find_foreign
from tactape_fab.sense.inspect.parallax import BEND_MM, bend_mm, without_parallax
from tactape_fab.sense.inspect.patches import patch_grid, sample
from tactape_fab.sense.inspect.registered import register_colours
from tactape_fab.sense.inspect.result import DRIFT_MM, TOLERANCE_MM, TURN_TOLERANCE_DEG, Inspection, ScanFacts
from tactape_fab.sense.inspect.scan_files import Picture
from tactape_fab.sense.inspect.view import View, views_of
from tactape_fab.sense.inspect.wanted import WantedTape, read_wanted
from tactape_fab.sense.inspect.warp import Warp
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.tape import Tape

LEAST_AREA = 0.55
"""Of body colour, in units of the usual part's: whole parts have 0.75 and more, bare lands and parts on end below 0.35."""
_UPRIGHT_AREA = 0.12
_UPRIGHT_DIFFERENCE = 0.12
"""Bare lands differ from end to end by 0.06 at most, a part on its end makes 0.19 (in units of the film's brightness)."""
_MOST_SCANS = 64
_APART_MM, _APART_SIGMAS, _LEAST_COMMON = 0.015, 4.0, 20
"""Median distance of places by two scans from which on they are of two copies: parts of a line that places to 0.05 mm are 0.08 mm
apart; in units of what both scans say of their errors, too; and of how many parts."""
CAMERA_ORDER, CAMERA_LANDS = 3, 100
"""Powers of a warp that take in a camera's perspective and lens, and how many lands they need."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Measured:
    """A view with what was measured in it; arrays over the parts that it shows whole."""

    view: View
    bodies: Bodies
    upright: BoolArray
    foreign_mm: FloatArray
    facts: ScanFacts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inspected:
    """The inspections of all tapes, and the scans with their warps, for pictures."""

    inspections: list[Inspection]
    views: list[list[View]]


def inspect_scans(
    scans: Sequence[str | Path] | str | Path,
    kit: str | Path,
    *,
    dpi: float | None = None,
    photo: bool = False,
    tolerance_mm: float = TOLERANCE_MM,
    turn_tolerance_deg: float = TURN_TOLERANCE_DEG,
) -> list[Inspection]:
    """Measure where the parts of a tape are, from scans of it or photographs from above.

    Parameters
    ----------
    scans : path or sequence of path
        TIFF, PNG or JPEG, 600 dpi or more; several images that together show all parts. They may overlap and lie at any turn.
    kit : path
        Kit of the tape, panel, or folder of kits, of which the scans show some.
    dpi : float, optional
        Nominal resolution; needed only where neither a tag nor the file says it.
    photo : bool
        Whether a camera took the images, from one point above; found by itself where perspective or the lens bends them. Mean and
        growth of all shifts are then taken for parallax.
    tolerance_mm, turn_tolerance_deg : float
        Shift and turn from which on a part is listed.

    Returns
    -------
    list of Inspection
        One for each tape.

    Raises
    ------
    SpecError
        If a scan cannot be read or shows none of the tapes, parts lie outside the scans, or a value is out of range.
    """
    return inspect_with_views(
        scans, kit, dpi=dpi, photo=photo, tolerance_mm=tolerance_mm, turn_tolerance_deg=turn_tolerance_deg
    ).inspections


def inspect_with_views(
    scans: Sequence[str | Path] | str | Path,
    kit: str | Path,
    *,
    dpi: float | None = None,
    photo: bool = False,
    tolerance_mm: float = TOLERANCE_MM,
    turn_tolerance_deg: float = TURN_TOLERANCE_DEG,
    progress: Callable[[str, int, int], None] = lambda *_: None,
    refused: Sequence[Problem] = (),
) -> Inspected:
    """`inspect_scans`, with the scans themselves.

    refused: Problems of the caller, raised together with those of the arguments.
    """
    several = scans if isinstance(scans, Iterable) and not isinstance(scans, str) else [scans]
    paths = [as_path(scan, "scans", "images of the tape") for scan in several]
    problems = [*refused, *_problems(paths, dpi, tolerance_mm, turn_tolerance_deg)]
    wanted = tried(lambda: read_wanted(kit), problems)
    if problems or wanted is None:
        raise SpecError(problems)
    views: list[View] = []
    for i, path in enumerate(paths):
        progress("scan", i, len(paths))
        views += tried(partial(views_of, path, wanted, dpi), problems) or []
    refuse(problems)
    shown_tapes = sorted({v.number for v in views})
    if wanted[0].offset_mm is not None:  # a panel is inspected whole
        shown_tapes = list(range(len(wanted)))
    groups = [[v for v in views if v.number == number] for number in shown_tapes]
    for number, group in zip(shown_tapes, groups, strict=True):
        problems += _outside(wanted[number].tape, group)
    refuse(problems)
    found = []
    for i, (number, group) in enumerate(zip(shown_tapes, groups, strict=True)):
        progress("tape", i, len(groups))
        measured = [_measured(view, wanted[number].tape, photo) for view in group]
        _refuse_copies(wanted[number].tape, measured)
        found.append(_merged(wanted[number], measured, tolerance_mm, turn_tolerance_deg))
    progress("tape", len(groups), len(groups))
    return Inspected(inspections=found, views=groups)


def _problems(paths: Sequence[str | Path], dpi: float | None, tolerance_mm: float, turn_tolerance_deg: float) -> list[Problem]:
    problems = []
    if not 1 <= len(paths) <= _MOST_SCANS:
        problems.append(Problem("scan", f"{len(paths)} scans are given; give 1 to {_MOST_SCANS}"))
    for key, value, low, high, unit in (
        ("dpi", dpi, 50.0, 20_000.0, "dpi"),
        ("tolerance_mm", tolerance_mm, 0.001, 10.0, "mm"),
        ("turn_tolerance_deg", turn_tolerance_deg, 0.1, 90.0, "deg"),
    ):
        if value is None and key == "dpi":
            continue
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            said = shown(value) if isinstance(value, str) else f"{shown(value)} {unit}"
            message = f"{key} = {said} is not from {low:g} to {high:g} {unit}; give a number of {unit}"
            problems.append(Problem(key, message))
    return problems


def _outside(tape: Tape, views: Sequence[View]) -> list[Problem]:
    """Parts that no scan shows whole."""
    seen = np.zeros(tape.part_count, dtype=bool)
    for view in views:
        seen |= view.inside
    if seen.all():
        return []
    if not views:
        return [Problem("scan", f"no scan shows {tape.name}; scan the whole panel, or give one of its kits")]
    gone = np.flatnonzero(~seen)
    low, high = tape.part_xy_mm()[gone].min(axis=0), tape.part_xy_mm()[gone].max(axis=0)
    names = tape.designators()
    message = (
        f"{len(gone)} of {len(seen)} parts of {tape.name} ({names[gone[0]]} to {names[gone[-1]]}, board x {low[0]:.1f} to "
        f"{high[0]:.1f}, y {low[1]:.1f} to {high[1]:.1f} mm) lie outside the scans: cropped; scan the whole tape, or give "
        "several overlapping images"
    )
    return [Problem("scan", message)]


def _measured(view: View, tape: Tape, photo: bool) -> _Measured:
    try:
        palette = learn_palette(view.picture, view.warp, tape, view.inside)
    except SpecError as error:
        raise SpecError(Problem("scan", f"{view.name}: {error}")) from None
    sites = tape.part_xy_mm()[view.inside]
    film = fit_film(view.picture, view.warp, tape, palette, view.inside)
    photo = photo or bend_mm(film.warp, sites) > BEND_MM  # lands, as the scatter of bodies bends a warp that is fitted to them
    if photo and len(sites) >= CAMERA_LANDS and film.warp.order < CAMERA_ORDER:
        film = fit_film(view.picture, film.warp.raised(CAMERA_ORDER), tape, palette, view.inside)
    if not photo:
        register_colours(view.picture, film.warp, tape, palette)
    bodies = fit_bodies(view.picture, film.warp, tape, palette, sites)
    upright, there = np.zeros(len(sites), dtype=bool), bodies.area >= LEAST_AREA
    gone = np.flatnonzero(~there)
    if len(gone):
        differs = _end_difference(view.picture, film.warp, tape, palette, sites[gone])
        upright[gone] = (bodies.area[gone] > _UPRIGHT_AREA) | (differs > _UPRIGHT_DIFFERENCE)
    foreign = find_foreign(view.picture, film.warp, tape, palette, (sites + bodies.shift_mm)[there], bodies.turn_deg[there])
    growth, common_mm = None, float(np.hypot(film.common_mm, bodies.common_mm))
    if photo:
        alone = bodies
        bodies, growth = without_parallax(alone, sites, there & ~alone.covered)
        # the correction also removes the placement's own mean and growth, an error common to all parts
        common_mm = float(np.hypot(common_mm, np.sqrt((bodies.sigma_mm**2 - alone.sigma_mm**2).mean())))
    return _Measured(
        view=view,
        bodies=bodies,
        upright=upright,
        foreign_mm=foreign,
        facts=replace(_facts(view, film.warp, film.sigma_mm, growth), common_mm=common_mm),
    )


def _end_difference(picture: Picture, warp: Warp, tape: Tape, palette: Palette, sites_mm: FloatArray) -> FloatArray:
    """Difference between both ends of a part's patch, apart from their mean brightness, in units of the film's; (n,)."""
    length, width, _ = tape.part.body_mm
    grid = patch_grid(1.1 * length, width, warp.px_per_mm)
    grey = palette.grey(sample(picture, warp, sites_mm, tape.part.rotation_deg, grid)).reshape(-1, *grid.shape)
    # the patch minus itself rotated by half a turn; one half of the difference suffices
    apart = (grey - grey[:, ::-1, ::-1])[:, :, grid.shape[1] // 2 + 1 :]
    return np.asarray(apart.std(axis=(1, 2)), dtype=np.float64)


def _facts(view: View, warp: Warp, film_sigma_mm: float, growth: float | None) -> ScanFacts:
    linear = warp.coefficients[1:3].T / warp.half_mm  # px/mm, columns: board x, board y
    along = float(np.hypot(*linear[:, 0]))
    # area over length: height of the pixel's parallelogram, with the shear taken out
    up = float(abs(np.linalg.det(linear))) / along
    shear = float(linear[:, 0] @ linear[:, 1]) / along**2
    jitter = np.concatenate([line.value_px.ravel() for line in warp.lines]) if warp.lines else np.zeros(1)
    return ScanFacts(
        name=view.name,
        dpi=view.dpi,
        px_per_mm=(view.factor * along, view.factor * up),
        shear=shear,
        jitter_um=float(np.sqrt((jitter**2).mean())) / warp.px_per_mm * 1000,
        film_sigma_um=film_sigma_mm * 1000,
        found_by=view.found_by,
        growth=growth,
    )


def _refuse_copies(tape: Tape, measured: Sequence[_Measured]) -> None:
    """Refuse scans of different copies: positions of parts differ beyond a common shift, and their means would be of no tape."""
    for one, other in combinations(measured, 2):
        both = np.flatnonzero(one.view.inside & other.view.inside)
        a, b = (np.searchsorted(np.flatnonzero(m.view.inside), both) for m in (one, other))
        there = (one.bodies.area[a] >= LEAST_AREA) & (other.bodies.area[b] >= LEAST_AREA)
        if there.sum() < _LEAST_COMMON:
            continue
        a, b = a[there], b[there]
        off = one.bodies.shift_mm[a] - other.bodies.shift_mm[b]
        apart = float(np.median(np.hypot(*(off - np.median(off, axis=0)).T)))
        if apart > max(_APART_MM, _APART_SIGMAS * float(np.median(np.hypot(one.bodies.sigma_mm[a], other.bodies.sigma_mm[b])))):
            message = (
                f"{one.view.name} and {other.view.name} show parts of {tape.name} {1000 * apart:.0f} um apart (median): two "
                "copies of the tape; inspect each by itself"
            )
            raise SpecError(Problem("scan", message))


def _merged(wanted: WantedTape, measured: Sequence[_Measured], tolerance_mm: float, turn_tolerance_deg: float) -> Inspection:
    """Weighted means over the scans; a part is missing if it is so in every scan that shows it."""
    n = wanted.tape.part_count
    weight, off, shift, turn, first_deg = np.zeros(n), np.zeros(n), np.zeros((n, 2)), np.zeros(n), np.full(n, np.nan)
    there, upright, clear = (np.zeros(n, dtype=bool) for _ in range(3))
    for m in measured:
        at = np.flatnonzero(m.view.inside)
        present = m.bodies.area >= LEAST_AREA
        # a scan's own drift is in all of its parts, so that a second scan counts even where the first is sharp
        sigma = np.hypot(m.bodies.sigma_mm, DRIFT_MM)
        w = np.where(present, 1.0 / sigma**2, 0.0)
        weight[at] += w
        off[at] += w * sigma
        shift[at] += w[:, None] * m.bodies.shift_mm
        # a body looks the same after half a turn: 89 and -89 degrees are 2 apart, so the one nearest to the first scan's counts
        first_deg[at] = np.where(present & np.isnan(first_deg[at]), m.bodies.turn_deg, first_deg[at])
        halves = np.rint((np.nan_to_num(first_deg[at]) - m.bodies.turn_deg) / 180.0)
        turn[at] += w * (m.bodies.turn_deg + 180.0 * halves)
        there[at] |= present
        upright[at] |= m.upright
        clear[at] |= ~m.bodies.covered
    safe = np.maximum(weight, 1e-12)
    foreign = np.concatenate([m.foreign_mm for m in measured])
    return Inspection(
        tape=wanted.tape,
        manifest_sha256=wanted.sha256,
        shift_mm=shift / safe[:, None],
        turn_deg=turn / safe - 180.0 * np.rint(turn / safe / 180.0),
        # that of one scan: metal and solder of a part draw all scans to one side (four were off by 7.4 um, as one was)
        sigma_mm=np.where(there, off / safe, 1.0),
        present=there,
        tombstoned=upright & ~there,
        covered=there & ~clear,
        foreign_mm=_distinct(foreign),
        tolerance_mm=float(tolerance_mm),
        turn_tolerance_deg=float(turn_tolerance_deg),
        scans=tuple(m.facts for m in measured),
    )


def _distinct(foreign_mm: FloatArray) -> FloatArray:
    """Objects, each once where several scans show it."""
    kept: list[FloatArray] = []
    # the largest view of an object stays
    for entry in foreign_mm[np.argsort(-foreign_mm[:, 2])] if len(foreign_mm) else []:
        if all(np.hypot(*(entry - other)[:2]) > max(entry[2], other[2]) for other in kept):
            kept.append(entry)
    return np.array(kept).reshape(-1, 3)
