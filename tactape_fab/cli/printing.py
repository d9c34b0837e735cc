"""Results as lines of text and as JSON, for the command line to print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactape_fab.base.errors import Check, Finding

if TYPE_CHECKING:
    from tactape_fab.cli.installation import Decoder, Diagnosis
    from tactape_fab.kit.profiles import FabProfile
    from tactape_fab.make.emboss import Embossed
    from tactape_fab.make.kit import Kit
    from tactape_fab.make.panel import PanelKit
    from tactape_fab.sense.decode.result import Localization
    from tactape_fab.sense.objects.mount import ObjectPose
    from tactape_fab.sense.objects.taped_object import TapedObject
    from tactape_fab.texture.certify.origin import Choice
    from tactape_fab.texture.tape import Tape

PURPOSES = (
    ("for the fab", ("fab-zip",)),
    ("for assembly", ("cpl", "bom")),
    ("for the order", ("order-notes",)),
    ("for CAD and milling", ("step-assembly", "step-solid")),
    ("for printing", ("stl", "3mf")),
    ("to look at", ("report",)),
)
"""What a user does with which files, in the order in which make names them."""


def rule_lines(findings: Sequence[Finding]) -> list[str]:
    """The broken rules that block."""
    return [f"{f.rule}: {f.message}{_at(f)}" for f in findings if f.blocks]


def _at(finding: Finding) -> str:
    return "" if finding.at_mm is None else f" (at {finding.at_mm[0]:.2f}, {finding.at_mm[1]:.2f} mm)"


def finding_lines(findings: Sequence[Finding]) -> list[str]:
    """Every rule as a row of a table."""
    header = ("rule", "verdict", "measured", "limit", "unit", "at x, y mm", "limit from")
    return table_lines(header, [_finding_row(f) for f in findings])


def remark_lines(findings: Sequence[Finding]) -> list[str]:
    """What is worth knowing of rules of level info: what is in use, and what would be possible from where on."""
    said = [f for f in findings if f.level == "info" and (not f.passed or f.rule.startswith(("coverlay", "anchor", "bend")))]
    return [f"{f.rule}: {f.message}" for f in said]


def _finding_row(finding: Finding) -> tuple[str, ...]:
    verdict = "ok" if finding.passed else finding.level
    value = "" if finding.value is None else f"{finding.value:.3f}"
    limit = "" if finding.limit is None else f"{finding.limit:.3f}"
    at = "" if finding.at_mm is None else f"{finding.at_mm[0]:.2f}, {finding.at_mm[1]:.2f}"
    source = f"{finding.source}{' (confirmed)' * finding.confirmed}"
    return finding.rule, verdict, value, limit, finding.unit if value else "", at, source


def table_lines(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as aligned columns."""
    widths = [max(len(row[i]) for row in [header, *rows]) for i in range(len(header))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in [header, *rows]]


def profiles_lines(fabs: Sequence[FabProfile]) -> list[str]:
    """Fab profiles as rows of a table."""
    rows = [
        (
            fab.name,
            f"{fab.material.base} {fab.material.thickness_mm:g} mm",
            ", ".join(fab.coverlay_modes),
            f"{fab.limits['opening-bridge'].value_mm:g} mm",
            f"{fab.size.largest_mm[0]:g} x {fab.size.largest_mm[1]:g} mm",
            fab.title,
        )
        for fab in fabs
    ]
    return table_lines(("name", "material", "coverlay", "bridge", "largest", "title"), rows)


def profile_lines(profile: Mapping[str, Any]) -> list[str]:
    """One fab profile explained, from what `explain_fab` gives."""
    material, files = profile["material"], profile["files"]
    head = [
        f"{profile['name']}: {profile['title']}",
        f"{material['base']} {material['thickness_mm']:g} mm, {material['layers']} copper layer of {material['copper_um']:g} um, "
        f"{material['finish']}; {profile['colours']['coverlay']} with {profile['colours']['legend']} legend",
        f"coverlay: {', '.join(profile['coverlay'])}",
        *(f"{key}: {', '.join(profile[key]) or 'none'}" for key in ("stiffener", "adhesive")),
        f"Gerber attributes {profile['gerber']['x2']}, job file {'in' if profile['gerber']['job_in_zip'] else 'not in'} the zip, "
        f"part list as {profile['assembly']}",
        f"panel: {'tapes are put on panels unless told otherwise' if profile['panel'] == 'auto' else 'where it is asked for'}",
        f"files: {', '.join(files.values())}",
        "",
    ]
    rows = [
        (
            row["id"],
            row["level"],
            " x ".join(f"{v:g}" for v in row["value"]) if isinstance(row["value"], list) else f"{row['value']:g}",
            row["unit"],
            "yes" if row["confirmed"] else "no",
            row["date"],
            row["source"],
        )
        for row in profile["thresholds"]
    ]
    return [*head, *table_lines(("threshold", "level", "value", "unit", "confirmed", "date", "source"), rows)]


def check_lines(checks: Sequence[Check]) -> list[str]:
    """Every line of a verification."""
    width = max(len(c.name) for c in checks)
    verdicts = ["ok  " if c.passed else "warn" if c.warning else "FAIL" for c in checks]
    return [f"{verdict}  {c.name.ljust(width)}  {c.message}" for verdict, c in zip(verdicts, checks, strict=True)]


def kit_json(kit: Kit) -> dict[str, Any]:
    tape = kit.tape
    return {
        "path": str(kit.path),
        "name": tape.name,
        "sector": tape.sector,
        "code": tape.code,
        "origin": list(tape.origin),
        "columns": tape.columns,
        "rows": tape.rows,
        "parts": tape.part_count,
        "files": dict(kit.files),
        "findings": [asdict(f) for f in kit.findings],
        "checks": [asdict(c) for c in kit.checks],
    }


def kit_lines(kit: Kit) -> list[str]:
    tape = kit.tape
    width, height = tape.board.size_mm
    return [
        f"{kit.path}: {tape.part_count} parts on {tape.columns} x {tape.rows} grid points, board {width:g} x {height:g} mm",
        f"sector {tape.sector} of {tape.code} at origin {tape.origin[0]},{tape.origin[1]}; "
        f"pitch {tape.pitch_mm:g} mm, displacement {tape.displacement_mm:g} mm{tape.in_directions}",
        *_search_lines(kit.search),
        f"verified: {len(kit.checks)} checks of the written files" if kit.checks else "not verified",
        *(f"{f.rule}: {f.message}" for f in kit.findings if f.rule == "coverlay" and f.level == "info"),
        *_purpose_lines(kit),
    ]


def _search_lines(search: Choice | None) -> list[str]:
    if search is None:
        return []
    before = "" if search.default_distance is None else f" (at the default origin {search.default_distance})"
    lines = [f"best of {search.candidates} origins: 4x4 windows differ by at least {search.distance} symbols{before}"]
    if search.from_others is not None:
        lines.append(f"and by at least {search.from_others} from those of the tapes to avoid")
    return lines


def panel_json(made: PanelKit) -> dict[str, Any]:
    return {
        "path": str(made.path),
        "name": made.name,
        "panel": made.panel.to_mapping(),
        "tapes": [
            {
                "kit": kit,
                "name": tape.name,
                "sector": tape.sector,
                "code": tape.code,
                "origin": list(tape.origin),
                "parts": tape.part_count,
                "offset_mm": list(offset_mm),
            }
            for kit, tape, offset_mm in zip(made.kits, made.tapes, made.panel.offsets_mm, strict=True)
        ],
        "files": dict(made.files),
        "findings": [asdict(f) for f in made.findings],
        "checks": [asdict(c) for c in made.checks],
    }


def panel_lines(made: PanelKit) -> list[str]:
    panel, first = made.panel, made.tapes[0]
    width, height = panel.size_mm
    parts = sum(tape.part_count for tape in made.tapes)
    rows = [
        (tape.name, str(tape.sector), f"{tape.origin[0]},{tape.origin[1]}", f"{x:g}, {y:g}", kit)
        for tape, (x, y), kit in zip(made.tapes, panel.offsets_mm, made.kits, strict=True)
    ]
    return [
        f"{made.path}: {panel.columns} x {panel.rows} tapes of {panel.tape_mm[0]:g} x {panel.tape_mm[1]:g} mm, "
        f"panel {width:g} x {height:g} mm, {parts} parts",
        f"{first.code}; pitch {first.pitch_mm:g} mm, displacement {first.displacement_mm:g} mm{first.in_directions}",
        *table_lines(("tape", "sector", "origin", "at x, y mm", "kit"), rows),
        f"verified: {len(made.checks)} checks of the written files" if made.checks else "not verified",
        *(f"{f.rule}: {f.message}" for f in made.findings if f.rule == "coverlay" and f.level == "info"),
        *_purpose_lines(made),
    ]


def embossed_json(made: Embossed) -> dict[str, Any]:
    return {
        "path": str(made.path),
        "name": made.tape.name,
        "surface": dict(made.surface),
        "files": dict(made.files),
        "checks": [asdict(c) for c in made.checks],
    }


def embossed_lines(made: Embossed) -> list[str]:
    surface, distortion = made.surface, made.surface["distortion"]
    centre = ", ".join(f"{v:.3f}" for v in surface["centre_mm"])
    return [
        f"{made.path}: {made.tape.part_count} elements of {made.tape.name} on {surface['source']} round ({centre}) mm",
        f"pitch error {distortion['pitch_error_min']:+.2%} to {distortion['pitch_error_max']:+.2%}, median "
        f"{distortion['pitch_error_median']:+.2%}; the texture reaches {distortion['reach_mm']:.1f} mm, usable are "
        f"{distortion['usable_radius_mm']:.1f} mm",
        f"verified: {len(made.checks)} checks of the written files",
        *_purpose_lines(made),
    ]


def _purpose_lines(made: Kit | PanelKit | Embossed) -> list[str]:
    lines = []
    for purpose, roles in PURPOSES:
        paths = [str(made.path / made.files[role]) for role in roles if role in made.files]
        if paths:
            lines.append(f"{purpose}: {', '.join(paths)}")
    return lines


# Localization


class FixTable:
    """Answers as rows of a table, one by one: widths come from the names of the tapes."""

    def __init__(self, tapes: Sequence[Tape], *, on_object: bool = False) -> None:
        self.on_object = on_object
        self.name_width = max([4, *(len(tape.name) for tape in tapes)])

    def header(self) -> str:
        row = self._row("frame", "status", "dots", "tape", "x mm", "y mm", "theta deg", "p_false")
        return row + "  on object: x, y, z mm" * self.on_object

    def row(self, frame: int, fix: Localization, there: ObjectPose | None = None) -> str:
        agreeing = f"{fix.n_agree}/{fix.n_dots}"
        if not fix.located:
            return f"{frame:>6}  {fix.status:<6}  {agreeing:>7}  not located: {fix.reason}"
        name = fix.tape or (f"sector {fix.sector}" if fix.sector is not None else "")
        x, y = (f"{v:.3f}" for v in fix.position_mm or fix.plane_mm or ()) if fix.position_mm or fix.plane_mm else ("", "")
        theta = "" if fix.theta_deg is None else f"{fix.theta_deg:.2f}"
        p_false = "" if fix.p_false is None else f"{fix.p_false:.1e}"
        on_object = "" if there is None else "  " + ", ".join(f"{v:.3f}" for v in there.position_mm)
        return self._row(str(frame), fix.status, agreeing, name, x, y, theta, p_false) + on_object

    def _row(self, frame: str, status: str, dots: str, name: str, x: str, y: str, theta: str, p_false: str) -> str:
        width = self.name_width
        return f"{frame:>6}  {status:<6}  {dots:>7}  {name:<{width}}  {x:>9}  {y:>9}  {theta:>9}  {p_false:>8}".rstrip()


def object_lines(thing: TapedObject) -> list[str]:
    """How well measured corners of tags fit, where an object's tapes are placed by these."""
    return [
        f"{entry.tape.name} on {thing.name}: the tag's corners fit within {entry.misfit_mm:.3f} mm (rms)"
        for entry in thing.tapes
        if entry.misfit_mm is not None
    ]


def summary_line(located: int, count: int, elapsed_ms: Sequence[float]) -> str:
    median = sorted(elapsed_ms)[len(elapsed_ms) // 2] if elapsed_ms else 0.0
    return f"located {located} of {count} frame{'s' * (count != 1)}; median {median:.2f} ms"


def simulated_line(path: Path, count: int, shape: tuple[int, int], name: str, sensor: str) -> str:
    frames = f"{count} frame{'s' * (count != 1)} of {shape[0]} x {shape[1]} px"
    return f"{path}: {frames}, {name} as {sensor} sees it"


# Installation


def diagnosis_lines(found: Diagnosis) -> list[str]:
    """What an installation can do, and what would add to it."""
    libraries = ", ".join(f"{name} {version or 'MISSING'}" for name, version in found.libraries.items())
    programs = [(p.name, p.path or "no", p.adds if p.path else f"{p.adds}; install {p.remedy}") for p in found.programs]
    extras = []
    for extra in found.extras:
        remedy = "" if extra.installed else f'; pip install "tactape-fab[{extra.name}]"'
        extras.append((extra.name, "yes" if extra.installed else "no", f"{extra.adds}{remedy}"))
    return [
        f"tactape-fab {found.version}, {found.python}, {found.machine}, {found.cores} cores",
        f"package    {found.package}",
        f"templates  {found.templates or 'MISSING: install tactape-fab again'}",
        f"decoder    {_decoder_line(found.decoder)}",
        f"libraries  {libraries or 'unknown: the package is not installed, only on the path'}",
        "",
        *table_lines(("program", "found", "what it adds"), programs),
        "",
        *table_lines(("extra", "installed", "what it adds"), extras),
    ]


def _decoder_line(decoder: Decoder) -> str:
    if decoder.problem is not None:
        return f"cannot be loaded: {decoder.problem}"
    if decoder.cache is None:
        return "compiled anew by every process: no folder can be written; set NUMBA_CACHE_DIR to one that can"
    if decoder.compiled:
        return f"compiled, in {decoder.cache}"
    return f"not compiled yet: the first decode takes some ten seconds more; then kept in {decoder.cache}"
