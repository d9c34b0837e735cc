"""Rules of a film other than gaps and edges: coverlay, anchors, stencil, backing, bending, parts and panel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import hypot, isinf

from tactape_fab.base.errors import Finding, Problem
from tactape_fab.kit.film.anchors import anchor_modes, between_spurs_mm, clearance_mm, foreign_openings_mm
from tactape_fab.kit.film.coverlay import Mode, coverlay_modes, first_legal
from tactape_fab.kit.film.layout import Layout
from tactape_fab.kit.plan import TOLERANCE_MM
from tactape_fab.kit.profiles import FabProfile, PartProfile
from tactape_fab.kit.rules.spacing import finding
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.shapes import area_mm2, reach_mm


def film_problems(spec: TapeSpec, fab: FabProfile) -> list[Problem]:
    """Problems of options that the fab does not offer."""
    problems = []
    if spec.coverlay is not None and spec.coverlay not in fab.coverlay_modes:
        other = f"--coverlay {' or '.join(fab.coverlay_modes)}"
        profile = {"lpi": ", or --fab generic-lpi", "per-part": ", or --fab generic-fpc"}.get(spec.coverlay, "")
        said = f"coverlay = '{spec.coverlay}' is not what {fab.name} does; use {other}{profile}"
        problems.append(Problem("coverlay", said))
    for key, given, backing in (("stiffener", spec.stiffener, fab.stiffener), ("adhesive", spec.adhesive, fab.adhesive)):
        if given is not None and given not in backing.choices:
            known = ", ".join(choice.replace(" ", ":") for choice in backing.choices)
            remedy = f"{fab.name} has: {known}; give one of them" if known else f"{fab.name} has none; leave out --{key}"
            problems.append(Problem(key, f"{key} = '{given}' is none that can be had; {remedy}"))
    if spec.bend_radius_mm is not None and fab.bend is None:
        said = f"bend_radius_mm = {spec.bend_radius_mm:g} mm contradicts fab = '{fab.name}', a rigid board; use a flex profile"
        problems.append(Problem("bend_radius_mm", said))
    if spec.anchor == "mesh" and spec.rotation_deg % 90.0 != 45.0:
        said = f"anchor = 'mesh' contradicts rotation_deg = {spec.rotation_deg:g} deg: its webs lie along the parts"
        problems.append(Problem("anchor", f"{said}; use --rotation 45 or --anchor spur"))
    return problems


def fab_for(spec: TapeSpec, fab: FabProfile, part: PartProfile) -> FabProfile:
    """The fab with its coverlay opened as requested, or in its first legal way."""
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
    """Every rule of this module, measured; legal ways and their limits as findings of level info."""
    modes = _modes(spec, fab, layout.part)
    anchors = anchor_modes(fab, layout.outlines, layout.part.pads, layout.tape)
    return [
        *_coverlay(modes, spec, fab),
        *_anchors(anchors, modes, layout, spec, fab),
        *_drawn(layout, fab),
        *assembly_findings(layout.tape.board.size_mm, layout.tape.part_count, fab),
        *_bending(layout, spec, fab),
    ]


def _of_mode(mode: Mode, what: str, pitch_mm: float) -> Finding:
    """A way as a finding: the tape's W, and the least legal W."""
    verdict = "legal" if mode.legal else "not legal"
    return Finding(
        rule=f"{what}-{mode.name}",
        level="info",
        passed=mode.legal,
        value=pitch_mm if mode.least_pitch_mm else None,
        limit=mode.least_pitch_mm or None,
        message=f"{verdict} at W {pitch_mm:g} mm: {mode.reason}",
    )


def _coverlay(modes: Sequence[Mode], spec: TapeSpec, fab: FabProfile) -> Iterator[Finding]:
    for mode in modes:
        yield _of_mode(mode, "coverlay", spec.pitch_mm)
    chosen, preferred = fab.coverlay_mode, fab.coverlay_modes[0]
    if spec.coverlay is None and chosen != preferred:
        refused = next(mode for mode in modes if mode.name == preferred)
        message = f"the first legal way to open the coverlay is {chosen}, which holds no pad down; {preferred}: {refused.reason}"
        yield Finding(rule="coverlay", level="warn", passed=False, unit="", message=message)
    else:
        how = "as asked for" if spec.coverlay is not None else f"the first legal way of {fab.name}"
        yield Finding(rule="coverlay", level="info", passed=True, unit="", message=f"coverlay {chosen}, {how}")


def _anchors(
    anchors: Sequence[Mode], modes: Sequence[Mode], layout: Layout, spec: TapeSpec, fab: FabProfile
) -> Iterator[Finding]:
    for mode in anchors:
        yield _of_mode(mode, "anchor", spec.pitch_mm)
    pads = len(layout.pads.xy_mm)
    held = 0 if layout.anchors is None else len(layout.anchors.spurs_mm)
    message = f"{held / pads:.0%} of {pads} pads are anchored under the {fab.mask_name}"
    yield Finding(rule="anchor", level="info", passed=True, value=held / pads, unit="", message=message)
    if spec.anchor != "none" and layout.anchors is None:
        said = f"anchor {spec.anchor}: coverlay gang leaves nothing to hold it, and {_what_would(spec, modes, layout, fab)}"
        yield Finding(rule="anchor-opening", level="block", passed=False, unit="", message=said)
    if layout.anchors is not None:
        yield _anchor_gap(anchors, layout, fab)
        if layout.anchors.mode == "spur":
            gap_mm, at_mm = between_spurs_mm(layout.anchors)
            measured = (gap_mm, (float(at_mm[0]), float(at_mm[1])))
            remedy = "use a larger --w or --anchor none"
            yield replace(finding(fab, "pad-pad", measured, "gap between spurs of two parts", remedy), rule="anchor-copper")


def _what_would(spec: TapeSpec, modes: Sequence[Mode], layout: Layout, fab: FabProfile) -> str:
    """Least pitch, mm, at which both the other way to open the coverlay and the anchors under it are legal."""
    film = next(mode for mode in modes if mode.name == fab.coverlay_modes[0])
    held = anchor_modes(fab.in_mode(fab.coverlay_modes[0]), layout.outlines, layout.part.pads, layout.tape)
    anchor = next(mode for mode in held if mode.name == spec.anchor)
    if not film.least_pitch_mm or not anchor.least_pitch_mm:
        return f"{film.name} is not legal: {film.reason}"
    return f"{film.name} with it is legal from W {max(film.least_pitch_mm, anchor.least_pitch_mm):.3f} mm on; use that --w"


def _anchor_gap(anchors: Sequence[Mode], layout: Layout, fab: FabProfile) -> Finding:
    assert layout.anchors is not None
    gap_mm, at_mm = foreign_openings_mm(layout.anchors, layout.parts_xy_mm, layout.outlines.opening)
    limit_mm = clearance_mm(fab)
    passed = gap_mm >= limit_mm - TOLERANCE_MM
    mode = next(m for m in anchors if m.name == layout.anchors.mode)
    message = f"anchors to openings of other pads {gap_mm:.3f} mm {'meet' if passed else 'are below'} {limit_mm:.3f} mm"
    return Finding(
        rule="anchor-opening",
        level="block",
        passed=passed,
        value=gap_mm,
        limit=limit_mm,
        at_mm=None if isinf(gap_mm) else (float(at_mm[0]), float(at_mm[1])),
        source=fab.anchor.origin.source,
        confirmed=fab.anchor.origin.confirmed,
        message=message if passed else f"{message} of {fab.name}; {mode.reason}, or --anchor none",
    )


def _drawn(layout: Layout, fab: FabProfile) -> Iterator[Finding]:
    """Legend and stencil."""
    if layout.tape.tag is not None:
        ink_mm, origin = layout.tape.tag.cell_mm - 2 * fab.legend.bleed_mm, fab.legend.origin
        passed = ink_mm >= fab.legend.line_mm - TOLERANCE_MM
        message = f"narrowest ink of the tag {ink_mm:.3f} mm {'meets' if passed else 'is below'} {fab.legend.line_mm:.3f} mm"
        yield Finding(
            rule="legend-line",
            level="block",
            passed=passed,
            value=ink_mm,
            limit=fab.legend.line_mm,
            source=origin.source,
            confirmed=origin.confirmed,
            message=message if passed else f"{message} of {fab.name}; use a larger --tag-cell",
        )
    yield _paste_ratio(layout, fab)
    yield _chip_size(layout, fab)


def _chip_size(layout: Layout, fab: FabProfile) -> Finding:
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
        source=origin.source,
        confirmed=origin.confirmed,
        message=f"{message} {least_mm:.2f} mm"
        + ("" if passed else f"; ask {fab.name} whether they place it, or use a larger part"),
    )


def _paste_ratio(layout: Layout, fab: FabProfile) -> Finding:
    """Check the area ratio of a stencil aperture: its area over that of its walls."""
    outline = layout.outlines.paste
    around = sum(hypot(*(b - a)) for a, b in zip(outline, [*outline[1:], outline[0]], strict=True))
    rules = fab.stencil
    ratio = area_mm2(outline) / (around * rules.thickness_mm)
    passed = ratio >= rules.least_ratio
    message = f"area ratio of the stencil's apertures {ratio:.2f} {'meets' if passed else 'is below'} {rules.least_ratio:.2f}"
    return Finding(
        rule="paste-ratio",
        level="warn",
        passed=passed,
        value=ratio,
        limit=rules.least_ratio,
        unit="",
        source=rules.origin.source,
        confirmed=rules.origin.confirmed,
        message=message if passed else f"{message} with {rules.thickness_mm:g} mm foil; use a part with larger paste areas",
    )


def assembly_findings(board_mm: tuple[float, float], count: int, fab: FabProfile, what: str = "tape") -> Iterator[Finding]:
    """Check the number of parts, and whether the ordered item, a tape or a panel, is large enough for the line."""
    most = fab.parts.most
    few = count <= most
    yield Finding(
        rule="part-count",
        level=fab.parts.level,
        passed=few,
        value=count,
        limit=most,
        unit="",
        source=fab.parts.origin.source,
        confirmed=fab.parts.origin.confirmed,
        message=f"{count} parts" + ("" if few else f", more than {most}: ask {fab.name} whether they take so many"),
    )
    size_mm, panel = sorted(board_mm, reverse=True), fab.panel
    small = any(side < least - TOLERANCE_MM for side, least in zip(size_mm, panel.smallest_mm, strict=True))
    large = any(side > most_mm + TOLERANCE_MM for side, most_mm in zip(size_mm, panel.largest_mm, strict=True))
    said = f"assembly takes {panel.smallest_mm[0]:g} x {panel.smallest_mm[1]:g} to {panel.largest_mm[0]:g} x "
    said += f"{panel.largest_mm[1]:g} mm; the {what} is {size_mm[0]:g} x {size_mm[1]:g} mm"
    remedy = "; order it in a panel" * small + "; ask the line, or use a smaller --size" * large
    yield Finding(
        rule="assembly-size",
        level="info",
        passed=not (small or large),
        value=size_mm[0] if large else size_mm[1],
        limit=panel.largest_mm[0] if large else panel.smallest_mm[1],
        source=panel.origin.source,
        confirmed=panel.origin.confirmed,
        message=said + remedy,
    )


def _bending(layout: Layout, spec: TapeSpec, fab: FabProfile) -> Iterator[Finding]:
    if spec.bend_radius_mm is None or fab.bend is None:
        return
    backings = [float(backing.split()[1]) for backing in (spec.stiffener, spec.adhesive) if backing is not None]
    thick_mm = fab.material.thickness_mm + sum(backings)
    least_mm = fab.bend.least_thicknesses * thick_mm
    passed = spec.bend_radius_mm >= least_mm - TOLERANCE_MM
    said = f"bend radius {spec.bend_radius_mm:g} mm round {spec.bend_axis} {'meets' if passed else 'is below'} {least_mm:.2f} mm"
    said += f", {fab.bend.least_thicknesses:g} times {thick_mm:g} mm of film and what is laminated to it"
    yield Finding(
        rule="bend-radius",
        level="warn",
        passed=passed,
        value=spec.bend_radius_mm,
        limit=least_mm,
        source=fab.bend.origin.source,
        confirmed=fab.bend.origin.confirmed,
        message=said if passed else f"{said}; bend it less, or leave out the stiffener",
    )
    stiff_mm = 2 * reach_mm(layout.outlines.body)["xy".index(str(spec.bend_axis))]
    sag_mm = stiff_mm**2 / (8 * spec.bend_radius_mm)
    message = f"under a body, {stiff_mm:.2f} mm along {spec.bend_axis}, the film would bow by {sag_mm * 1000:.1f} um"
    yield Finding(rule="bend-part", level="info", passed=True, value=sag_mm, message=message)
