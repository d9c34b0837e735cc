"""Rules of a film other than gaps and edges: coverlay, anchors, stencil, backing, bending, parts and panel."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import ceil, hypot, isinf

from tactape_fab.base.errors import Finding, Problem
from tactape_fab.kit.film.anchors import anchor_modes, between_spurs_mm, clearance_mm, foreign_openings_mm
from tactape_fab.kit.film.coverlay import Mode, coverlay_modes, first_legal
from tactape_fab.kit.film.layout import Layout
from tactape_fab.kit.film.tag_ink import most_gap_mm
from tactape_fab.kit.outlines import opening_size_mm, part_outlines
from tactape_fab.kit.plan import TOLERANCE_MM, film_size_mm
from tactape_fab.kit.profiles import FabProfile, PartProfile, cited, load_fab
from tactape_fab.kit.rules.remedies import film_remedy, part_words
from tactape_fab.kit.rules.spacing import finding
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.board import Tag
from tactape_fab.texture.frames import FloatArray, pair_of
from tactape_fab.texture.shapes import area_mm2, reach_mm

_LAYER_WORDS = re.compile(
    r"outline|profile|inner|fab|npth|pnp_bom|edge[._]cuts|[bf][._](cu|mask|paste|silks)|in\d+[._]cu"
    r"|(top|bottom)_(copper|mask|paste|silk)|(copper|soldermask|solderpaste|silkscreen)_(top|bottom)",
    re.IGNORECASE,
)
"""Names of layers in files of KiCad, gEDA and Eagle, by which tracespace's whats-that-gerber knows them before the ending."""


def film_problems(spec: TapeSpec, fab: FabProfile, part: PartProfile) -> list[Problem]:
    """Problems of options that the fab does not offer."""
    problems = []
    if spec.coverlay is not None and spec.coverlay not in fab.coverlay_modes:
        profile = ", or " + words if (words := _other_fab(spec, part, spec.coverlay)) else ""
        larger = _with_outline(spec.with_values(coverlay=None), fab, part)
        left_out = f"use {larger} without --coverlay" if larger else "leave out --coverlay"
        message = f"coverlay = '{spec.coverlay}' is not what {fab.name} does; {left_out}{profile}"
        problems.append(Problem("coverlay", message))
    for key, given, backing in (("stiffener", spec.stiffener, fab.stiffener), ("adhesive", spec.adhesive, fab.adhesive)):
        if given is not None and given not in backing.choices:
            known = ", ".join(choice.replace(" ", ":") for choice in backing.choices)
            remedy = f"{fab.name} has: {known}; give one of them" if known else f"{fab.name} has none; leave out --{key}"
            problems.append(Problem(key, f"{key} = '{given.replace(' ', ':')}' is not available; {remedy}"))
    if spec.bend_radius_mm is not None and fab.bend is None:
        message = f"bend_radius_mm = {spec.bend_radius_mm:g} mm contradicts fab = '{fab.name}', a rigid board; "
        message += "leave out --bend-axis and --bend-radius" + "".join(f", or use {words}" for words in _flexible(spec, part))
        problems.append(Problem("bend_radius_mm", message))
    if spec.anchor == "mesh" and spec.rotation_deg % 90.0 != 45.0:
        message = f"anchor = 'mesh' contradicts rotation_deg = {spec.rotation_deg:g} deg: its webs lie along the parts"
        ways = filter(None, (_anchor_remedy(anchor, part, spec, fab) for anchor in ("mesh", "spur")))
        bare = f"--anchor none {_with_outline(spec.with_values(anchor='none'), fab, part)}".strip()
        problems.append(Problem("anchor", f"{message}; use {', or '.join([*ways, bare])}"))
    return problems


def _flexible(spec: TapeSpec, part: PartProfile) -> Iterator[str]:
    """Options for a flexible fab that does what is asked for, with W and Δ at which its rules hold; none if there is none."""
    for name in ("generic-fpc", "generic-lpi"):
        other, fab = spec.with_values(fab=name), load_fab(name)
        of_backings = ((spec.stiffener, fab.stiffener), (spec.adhesive, fab.adhesive))
        if spec.coverlay in (None, *fab.coverlay_modes) and all(given in (None, *has.choices) for given, has in of_backings):
            options = film_remedy(other, fab_for(other, fab, part), part, _bridges(other)).options()
            if options is not None:
                yield f"--fab {name} {options}".rstrip()
                return


def _bridges(spec: TapeSpec) -> list[str]:
    """The rule of bridges, where the coverlay is opened by part as asked for."""
    return [] if spec.coverlay in (None, "gang") else ["opening-bridge"]


def _with_outline(spec: TapeSpec, fab: FabProfile, part: PartProfile) -> str:
    """Options for a tape whose outline has to be larger, "" if it holds a window: that problem is not told beside a refusal of
    what the outline depends on.
    """
    options = film_remedy(spec, fab_for(spec, fab, part), part).options() or ""
    return options if "--size" in options else ""


def _other_fab(spec: TapeSpec, part: PartProfile, mode: str) -> str:
    """Options for a fab that has this coverlay mode, with W and Δ if they must change; "" if there is none."""
    name = {"lpi": "generic-lpi", "per-part": "generic-fpc"}.get(mode)
    if name is None:
        return ""
    fab = load_fab(name)
    if not _large_openings(part, fab):
        return ""
    options = film_remedy(spec.with_values(fab=name), fab, part, ["opening-bridge"]).options()
    mode_words = "" if spec.coverlay in (None, mode) else f"--coverlay {mode} "
    return "" if options is None else f"{mode_words}--fab {name} {options}".strip()


def fab_for(spec: TapeSpec, fab: FabProfile, part: PartProfile) -> FabProfile:
    """The fab profile in the requested coverlay mode, or in the first one that is legal."""
    return fab.in_mode(spec.coverlay or first_legal(_modes(spec, fab, part), fab))  # type: ignore[arg-type]


def _modes(spec: TapeSpec, fab: FabProfile, part: PartProfile) -> tuple[Mode, ...]:
    return coverlay_modes(
        fab,
        part,
        pitch_mm=spec.pitch_mm,
        displacement_mm=spec.displacement_mm,
        rotation_deg=spec.rotation_deg,
        directions=spec.directions,
    )


def film_findings(layout: Layout, spec: TapeSpec, fab: FabProfile) -> list[Finding]:
    """Every rule of this module, measured; coverlay modes and anchors that are not in use are findings of level info."""
    modes = _modes(spec, fab, layout.part)
    anchors = anchor_modes(fab, layout.outlines, layout.part.pads, layout.tape)
    return [
        *_coverlay(modes, layout.part, spec, fab),
        *_anchors(anchors, layout, spec, fab),
        *_drawn(layout, spec, fab),
        *assembly_findings(layout.tape.board.size_mm, layout.tape.part_count, fab),
        *_bending(layout, spec, fab),
        *name_findings(layout.tape.name),
    ]


def _of_mode(mode: Mode, what: str, pitch_mm: float, remedy: str) -> Finding:
    """Finding of a coverlay or anchor mode: its value is the tape's W, its limit the least legal W."""
    verdict = "legal" if mode.legal else "not legal"
    return Finding(
        rule=f"{what}-{mode.name}",
        level="info",
        passed=mode.legal,
        value=pitch_mm if mode.least_pitch_mm else None,
        limit=mode.least_pitch_mm or None,
        message=f"{verdict} at W {pitch_mm:g} mm: {mode.reason}" + (f"; use {remedy}" if remedy else ""),
    )


def _mode_remedy(mode: Mode, part: PartProfile, spec: TapeSpec, fab: FabProfile) -> str:
    """Options that make a coverlay mode legal; "" if there are none."""
    if mode.name not in fab.coverlay_modes:
        return _other_fab(spec, part, mode.name)
    if mode.least_pitch_mm is None:
        return part_words(
            spec, fab.in_mode(mode.name), lambda other: _large_openings(other, fab), "with wider pads"
        ).removeprefix("use ")
    asked = spec.coverlay == mode.name or (spec.coverlay is None and mode.name == fab.coverlay_modes[0])
    options = film_remedy(spec, fab, part, ["opening-bridge"]).options() or ""
    return options if asked or not options else f"--coverlay {mode.name} {options}"


def _large_openings(part: PartProfile, fab: FabProfile) -> bool:
    return min(opening_size_mm(part, fab)) >= fab.limits["opening-size"].value_mm - TOLERANCE_MM


def _coverlay(modes: Sequence[Mode], part: PartProfile, spec: TapeSpec, fab: FabProfile) -> Iterator[Finding]:
    remedies = {mode.name: "" if mode.legal else _mode_remedy(mode, part, spec, fab) for mode in modes}
    for mode in modes:
        yield _of_mode(mode, "coverlay", spec.pitch_mm, remedies[mode.name])
    chosen, preferred = fab.coverlay_mode, fab.coverlay_modes[0]
    if spec.coverlay is None and chosen != preferred:
        refused = next(mode for mode in modes if mode.name == preferred)
        message = f"the first legal way to open the coverlay is {chosen}, which holds no pad down; {preferred}: {refused.reason}"
        message += f"; use {remedies[preferred]}" if remedies[preferred] else ""
        yield Finding(rule="coverlay", level="warn", passed=False, unit="", message=message)
    else:
        how = "as asked for" if spec.coverlay is not None else f"the first legal way of {fab.name}"
        yield Finding(rule="coverlay", level="info", passed=True, unit="", message=f"coverlay {chosen}, {how}")


def _anchors(anchors: Sequence[Mode], layout: Layout, spec: TapeSpec, fab: FabProfile) -> Iterator[Finding]:
    for mode in anchors:
        yield _of_mode(mode, "anchor", spec.pitch_mm, "" if mode.legal else _anchor_remedy(mode.name, layout.part, spec, fab))
    pads = len(layout.pads.xy_mm)
    held = 0 if layout.anchors is None else len(layout.anchors.spurs_mm)
    message = f"{held / pads:.0%} of {pads} pads are anchored under the {fab.mask_name}"
    yield Finding(rule="anchor", level="info", passed=True, value=held / pads, unit="", message=message)
    if spec.anchor != "none" and layout.anchors is None:
        remedy = _anchor_remedy(spec.anchor, layout.part, spec, fab)
        start = f"anchor {spec.anchor}: coverlay gang leaves nothing to hold it"
        start += f", {fab.coverlay_modes[0]} with it is legal further apart; use {remedy}, or --anchor none" if remedy else ""
        start += "" if remedy else "; use --anchor none"
        yield Finding(rule="anchor-opening", level="block", passed=False, unit="", message=start)
    if layout.anchors is not None:
        yield _anchor_gap(layout, spec, fab)
        if layout.anchors.mode == "spur":
            gap_mm, at_mm = between_spurs_mm(layout.anchors)
            measured = (gap_mm, pair_of(at_mm))

            def remedy_for(_: float) -> str:
                words = film_remedy(spec, fab, layout.part, ["anchor-spur"]).words()
                return f"{words}, or --anchor none" if words else "use --anchor none"

            yield replace(finding(fab, "pad-pad", measured, "gap between spurs of two parts", remedy_for), rule="anchor-copper")


def _anchor_remedy(name: str, part: PartProfile, spec: TapeSpec, fab: FabProfile) -> str:
    """Options that make an anchor mode legal; "" if there are none."""
    if spec.coverlay == "gang" or fab.coverlay_modes[0] == "gang" or not _large_openings(part, fab):
        return ""
    with_it = (
        spec.with_values(anchor=name, rotation_deg=45.0)
        if name == "mesh" and spec.rotation_deg % 90.0 != 45.0
        else spec.with_values(anchor=name)
    )
    options = film_remedy(with_it, fab, part).options()
    if options is None:
        return ""
    turn = "" if with_it.rotation_deg == spec.rotation_deg else " --rotation 45"
    return f"{'' if spec.anchor == name else f'--anchor {name}'}{turn} {options}".strip()


def _anchor_gap(layout: Layout, spec: TapeSpec, fab: FabProfile) -> Finding:
    assert layout.anchors is not None
    gap_mm, at_mm = foreign_openings_mm(layout.anchors, layout.parts_xy_mm, layout.outlines.opening)
    limit_mm = clearance_mm(fab)
    passed = gap_mm >= limit_mm - TOLERANCE_MM
    remedy = "" if passed else _anchor_remedy(layout.anchors.mode, layout.part, spec, fab)
    message = f"anchors to openings of other pads {gap_mm:.3f} mm {'meet' if passed else 'are below'} {limit_mm:.3f} mm"
    return Finding(
        rule="anchor-opening",
        level="block",
        passed=passed,
        value=gap_mm,
        limit=limit_mm,
        at_mm=None if isinf(gap_mm) else pair_of(at_mm),
        **cited(fab.anchor.origin),
        message=message if passed else f"{message} of {fab.name}; use {f'{remedy}, or ' if remedy else ''}--anchor none",
    )


def _drawn(layout: Layout, spec: TapeSpec, fab: FabProfile) -> Iterator[Finding]:
    """Findings of legend and stencil."""
    if layout.tape.tag is not None:
        # ink bleeds over each edge by bleed_mm: a free cell between two inked ones keeps cell - 2 bleed
        ink_mm, origin = layout.tape.tag.cell_mm - 2 * fab.legend.bleed_mm, fab.legend.origin
        passed = ink_mm >= fab.legend.line_mm - TOLERANCE_MM
        message = f"narrowest ink of the tag {ink_mm:.3f} mm {'meets' if passed else 'is below'} {fab.legend.line_mm:.3f} mm"
        yield Finding(
            rule="legend-line",
            level="block",
            passed=passed,
            value=ink_mm,
            limit=fab.legend.line_mm,
            **cited(origin),
            message=message if passed else f"{message} of {fab.name}; use {_cell_options(layout, spec, fab)}",
        )
        yield from _tag_gap(layout.tape.tag, fab)
    yield _paste_ratio(layout, spec, fab)
    yield _chip_size(layout, spec, fab)


def _tag_gap(tag: Tag, fab: FabProfile) -> Iterator[Finding]:
    """Finding of a gap for which the chamfers of a cell's four corners take all of its ink; none where ink is left."""
    gap_mm, most_mm = fab.legend.gap_mm, most_gap_mm(tag.cell_mm, fab.legend.bleed_mm)
    if gap_mm < most_mm - TOLERANCE_MM:
        return
    yield Finding(
        rule="legend-gap",
        level="block",
        passed=False,
        value=gap_mm,
        limit=most_mm,
        **cited(fab.legend.origin),
        message=f"legend.gap_mm = {gap_mm:g} mm of {fab.name} leaves no ink in cells of {tag.cell_mm:g} mm of the tag; "
        f"use --tag none, or a profile with gap_mm + 2 bleed_mm below {most_mm + 2 * fab.legend.bleed_mm:.3f} mm",
    )


def _cell_options(layout: Layout, spec: TapeSpec, fab: FabProfile) -> str:
    """Options for a tag cell that is wide enough, and for the outline that its strip needs."""
    # rounded before ceil, as a sum of decimals may lie just above the next micrometre
    cell_mm = ceil(round((fab.legend.line_mm + 2 * fab.legend.bleed_mm) * 1000, 3)) / 1000
    size_mm = film_size_mm(spec.with_values(tag_cell_mm=cell_mm), fab, layout.part)
    return f"--tag-cell {cell_mm:g}" + ("" if size_mm == spec.size_mm else f" --size {size_mm[0]:g}x{size_mm[1]:g}")


def name_findings(name: str) -> list[Finding]:
    """Warning if the name of the tape, which its files have, is one of a layer for programs that tell layers by file names."""
    if (word := _LAYER_WORDS.search(name)) is None:
        return []
    message = f"name = '{name}' has '{word[0]}', by which viewers of fabs tell a layer: they would take other files for it, too; "
    return [Finding(rule="file-name", level="warn", passed=False, unit="", message=message + "use another --name")]


def _chip_size(layout: Layout, spec: TapeSpec, fab: FabProfile) -> Finding:
    """Check the part's length against the smallest chip that the line is known to place."""
    length_mm, least_mm, origin = layout.part.body_mm[0], fab.parts.smallest_mm, fab.parts.smallest_origin
    passed = length_mm >= least_mm - TOLERANCE_MM
    message = f"{layout.part.name} is {length_mm:.2f} mm long, "
    message += "no smaller than" if passed else "smaller than any chip that the line is known to place:"
    return Finding(
        rule="chip-size",
        level="warn",
        passed=passed,
        value=length_mm,
        limit=least_mm,
        **cited(origin),
        message=f"{message} {least_mm:.2f} mm"
        + (
            ""
            if passed
            else f"; ask {fab.name} whether they place it, or {_other_part(spec, fab, lambda p: p.body_mm[0] >= least_mm)}"
        ),
    )


def _other_part(spec: TapeSpec, fab: FabProfile, fits: Callable[[PartProfile], bool]) -> str:
    return part_words(spec, fab, fits, "that fits")


def _area_ratio(outline: FloatArray, fab: FabProfile) -> float:
    # IPC-7525 area ratio: aperture area over wall area (perimeter times thickness); if it is small, paste is not released
    around = sum(hypot(*(b - a)) for a, b in zip(outline, [*outline[1:], outline[0]], strict=True))
    return float(area_mm2(outline) / (around * fab.stencil.thickness_mm))


def _paste_ratio(layout: Layout, spec: TapeSpec, fab: FabProfile) -> Finding:
    """Check the area ratio of a stencil aperture."""
    rules = fab.stencil
    ratio = _area_ratio(layout.outlines.paste, fab)

    def enough(part: PartProfile) -> bool:
        return _area_ratio(part_outlines(part, fab, spec.rotation_deg).paste, fab) >= rules.least_ratio

    passed = ratio >= rules.least_ratio
    message = f"area ratio of the stencil's apertures {ratio:.2f} {'meets' if passed else 'is below'} {rules.least_ratio:.2f}"
    return Finding(
        rule="paste-ratio",
        level="warn",
        passed=passed,
        value=ratio,
        limit=rules.least_ratio,
        unit="",
        **cited(rules.origin),
        message=message if passed else f"{message} with {rules.thickness_mm:g} mm foil; {_other_part(spec, fab, enough)}",
    )


OF_ASSEMBLY = ("part-count", "assembly-size")
"""Rules of `assembly_findings`."""


def assembly_findings(board_mm: tuple[float, float], count: int, fab: FabProfile, what: str = "tape") -> Iterator[Finding]:
    """Check the number of parts, and whether the assembly line accepts the size of the ordered item, a tape or a panel."""
    most = fab.parts.most
    few = count <= most
    yield Finding(
        rule="part-count",
        level=fab.parts.level,
        passed=few,
        value=count,
        limit=most,
        unit="",
        **cited(fab.parts.origin),
        message=f"{count} parts" + ("" if few else f", more than {most}: ask {fab.name} whether they take so many"),
    )
    # a board may be turned on the line, so the longer side is compared with the longer limit
    size_mm, panel = sorted(board_mm, reverse=True), fab.panel
    too_short = [side < least - TOLERANCE_MM for side, least in zip(size_mm, panel.smallest_mm, strict=True)]
    too_long = [side > most_mm + TOLERANCE_MM for side, most_mm in zip(size_mm, panel.largest_mm, strict=True)]
    small, large = any(too_short), any(too_long)
    # the side that is too long, else the one that is too short; if both are, the longer or the shorter one
    side = too_long.index(True) if large else (0 if too_short == [True, False] else 1)
    message = f"assembly takes {panel.smallest_mm[0]:g} x {panel.smallest_mm[1]:g} to {panel.largest_mm[0]:g} x "
    message += f"{panel.largest_mm[1]:g} mm; the {what} is {board_mm[0]:g} x {board_mm[1]:g} mm"
    remedy = _size_remedy(size_mm, board_mm[0] >= board_mm[1], fab, small=small, large=large)
    yield Finding(
        rule="assembly-size",
        level="info",
        passed=not (small or large),
        value=size_mm[side],
        limit=(panel.largest_mm if large else panel.smallest_mm)[side],
        **cited(panel.origin),
        message=message + remedy,
    )


def _size_remedy(size_mm: Sequence[float], level: bool, fab: FabProfile, *, small: bool, large: bool) -> str:
    """Remedy for an item that assembly does not accept: a panel if the item fits on one with its rails, else another size."""
    if any(most < least for most, least in zip(fab.largest_panel_mm, fab.panel.smallest_mm, strict=True)):
        return "; ask the line" if small or large else ""  # no board that this fab makes is large enough for assembly
    room_mm = fab.largest_railed_mm
    fits = all(side <= most + TOLERANCE_MM for side, most in zip(size_mm, room_mm, strict=True))
    if small and not large and fits:
        return "; order it in a panel"
    if not (small or large):
        return ""
    held_mm = [min(side, most) for side, most in zip(size_mm, room_mm if small else fab.largest_panel_mm, strict=True)]
    held_mm = held_mm if level else held_mm[::-1]
    return f"; ask the line, or use --size {held_mm[0]:g}x{held_mm[1]:g}" + (" --panel auto" if small else "")


def _bending(layout: Layout, spec: TapeSpec, fab: FabProfile) -> Iterator[Finding]:
    if spec.bend_radius_mm is None or fab.bend is None:
        return
    backings = [float(backing.split()[1]) for backing in (spec.stiffener, spec.adhesive) if backing is not None]
    # the profile's ratio applies to the total thickness that is bent, with stiffener and adhesive
    thick_mm = fab.material.thickness_mm + sum(backings)
    least_mm = fab.bend.least_thicknesses * thick_mm
    passed = spec.bend_radius_mm >= least_mm - TOLERANCE_MM
    start = f"bend radius {spec.bend_radius_mm:g} mm round {spec.bend_axis} {'meets' if passed else 'is below'} {least_mm:.2f} mm"
    start += f", {fab.bend.least_thicknesses:g} times {thick_mm:g} mm of film and what is laminated to it"
    yield Finding(
        rule="bend-radius",
        level="warn",
        passed=passed,
        value=spec.bend_radius_mm,
        limit=least_mm,
        **cited(fab.bend.origin),
        # rounded up to a micrometre, so that the typed value meets the limit
        message=start if passed else f"{start}; bend it less, --bend-radius {ceil(least_mm * 1000 - 1e-6) / 1000:g}",
    )
    # the rigid body is a chord of its whole extent along the bent axis
    stiff_mm = 2 * reach_mm(layout.outlines.body)["xy".index(str(spec.bend_axis))]
    # sagitta of a chord s at radius R: R - sqrt(R^2 - s^2/4), about s^2 / (8 R) with a relative error of s^2 / (16 R^2)
    sag_mm = stiff_mm**2 / (8 * spec.bend_radius_mm)
    message = f"under a body, {stiff_mm:.2f} mm along {spec.bend_axis}, the film would bow by {sag_mm * 1000:.1f} um"
    yield Finding(rule="bend-part", level="info", passed=True, value=sag_mm, message=message)
