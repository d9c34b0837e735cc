"""Panels: several tapes with their kits in one folder, which gets its final name after verification."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactape_fab.base.errors import Check, Finding
from tactape_fab.base.given_path import as_path
from tactape_fab.base.given_value import refuse_other
from tactape_fab.kit.artifact import AnyArtifact
from tactape_fab.kit.examine.order import ExaminedPanel
from tactape_fab.kit.examine.tape import Examined
from tactape_fab.kit.order_facts import panel_order_facts
from tactape_fab.kit.output_place import Overwrite
from tactape_fab.kit.panel.geometry import Panel
from tactape_fab.kit.render.fab_drawing import render_fab_drawing
from tactape_fab.kit.render.fab_dxf import render_fab_dxf
from tactape_fab.kit.render.order_notes import render_order_notes
from tactape_fab.kit.writer import PlacedKit, made_record, panel_manifest, panel_record, render_all, write_kit
from tactape_fab.make.kit import fill_kit, forced, refuse_broken, refuse_wrong_how
from tactape_fab.make.publish import finished
from tactape_fab.report import add_panel_report
from tactape_fab.texture.manifest import MANIFEST_NAME
from tactape_fab.texture.panel_manifest import KITS_FOLDER
from tactape_fab.texture.tape import Tape

if TYPE_CHECKING:
    from tactape_fab.verify.signature import Signer


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelKit:
    """A finished panel.

    Attributes
    ----------
    path : Path
    name : str
    panel : Panel
    tapes : tuple of Tape
    findings : tuple of Finding
    checks : tuple of Check
        Checks of the panel and of every kit in it; empty without verification.
    files : dict of str to str
        Paths of the panel's own files by role.
    kits : tuple of str
        Folders of the kits, relative to `path`.
    """

    path: Path
    name: str
    panel: Panel
    tapes: tuple[Tape, ...]
    findings: tuple[Finding, ...]
    checks: tuple[Check, ...]
    files: Mapping[str, str]
    kits: tuple[str, ...]

    def to_mapping(self) -> dict[str, Any]:
        """The panel as the JSON object that `tactape-fab make --json` prints."""
        return {
            "path": str(self.path),
            "name": self.name,
            "panel": self.panel.to_mapping(),
            "tapes": [
                {
                    "kit": kit,
                    "name": tape.name,
                    "sector": tape.sector,
                    "code": tape.code,
                    "origin": list(tape.origin),
                    "parts": tape.part_count,
                    "offset_mm": list(place.offset_mm),
                    "rotation_deg": place.rotation_deg,
                }
                for kit, tape, place in zip(self.kits, self.tapes, self.panel.places, strict=True)
            ],
            "files": dict(self.files),
            "findings": [asdict(f) for f in self.findings],
            "checks": [asdict(c) for c in self.checks],
        }


def make_panel(
    examined: Examined | ExaminedPanel,
    path: str | Path | None = None,
    *,
    overwrite: Overwrite = False,
    verify: bool = True,
    force: bool = False,
    signer: Signer | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> PanelKit:
    """Make a panel: its files, and the complete kit of every tape on it, verified from the written files.

    Parameters
    ----------
    examined : ExaminedPanel
        Result of `examine_order` for a panel; that of a single tape is refused.
    path : str or Path, optional
        Folder of the panel; by default its name in the current folder.
    overwrite : bool or "edits"
    verify, force : bool
    signer : Signer, optional
        As for `make_kit`.
    progress : callable
        Called with the name of each step.

    Returns
    -------
    PanelKit

    Raises
    ------
    SpecError
        If it is not a panel, or `path` is taken.
    DesignRuleError
        If a rule of the fab profile is broken.
    VerifyError
        If the written files fail the verification; nothing is left at `path`.
    """
    refuse_other(examined, ExaminedPanel, "examined", "panel", "what examine_order returns first of an order of a panel")
    assert isinstance(examined, ExaminedPanel)
    refuse_wrong_how(verify=verify, force=force, signer=signer)
    findings = examined.findings
    target = Path(examined.name) if path is None else as_path(path, "path", "the folder of the panel")
    blocking = refuse_broken(findings, examined.tapes, target, overwrite=overwrite, force=force)
    with finished(target, "panel", overwrite=overwrite, signer=signer) as folder:
        artifacts, checks = fill_panel(folder, examined, blocking, verify=verify, progress=progress)
    return PanelKit(
        path=target,
        name=examined.name,
        panel=examined.panel,
        tapes=tuple(tape.tape for tape in examined.tapes),
        findings=findings,
        checks=checks,
        files={a.role: a.path for a in artifacts},
        kits=tuple(_kit_folder(tape) for tape in examined.tapes),
    )


def _kit_folder(tape: Examined) -> str:
    return f"{KITS_FOLDER}/{tape.tape.name}"


def fill_panel(
    folder: Path, examined: ExaminedPanel, blocking: Sequence[Finding], *, verify: bool, progress: Callable[[str], None]
) -> tuple[list[AnyArtifact], tuple[Check, ...]]:
    """Write a panel with all its kits into a folder, as `tactape_fab.make.kit.fill_kit` writes a kit.

    Raises VerifyError if the written files of a kit or of the panel fail the verification.
    """
    checks: list[Check] = []
    for number, tape in enumerate(examined.tapes, start=1):
        progress(f"tape {number} of {len(examined.tapes)}")
        place = folder / _kit_folder(tape)
        place.mkdir(parents=True)
        broken = [finding for finding in tape.findings if finding.blocks]
        _, verified = fill_kit(place, tape, broken, verify=verify, progress=lambda _: None)
        checks += verified
    artifacts, content = _write_panel(examined, folder, blocking, verify=verify, progress=progress)
    own: tuple[Check, ...] = ()
    if verify:
        from tactape_fab.verify.panel import verify_panel_folder

        progress("verifying the panel")
        # kits=False: fill_kit has verified them
        verification = verify_panel_folder(folder / MANIFEST_NAME, quick=True, kits=False)
        verification.raise_if_failed()
        own = verification.checks
    tapes, findings = [tape.tape for tape in examined.tapes], examined.findings_on_panel  # the report maps findings on the panel
    artifacts.append(add_panel_report(folder, content, tapes, checks=own, findings=findings))
    return artifacts, (*checks, *own)


def _write_panel(
    examined: ExaminedPanel, folder: Path, blocking: Sequence[Finding], *, verify: bool, progress: Callable[[str], None]
) -> tuple[list[AnyArtifact], dict[str, Any]]:
    """The panel's own files, and the content of its manifest."""
    progress("rendering the panel")
    first, film = examined.tapes[0], examined.tapes[0].film
    assert film is not None
    artifacts = render_all(examined.drawing, film.fab)
    layouts = [tape.layout for tape in examined.tapes]
    facts = panel_order_facts(examined.name, examined.panel, layouts, film.fab, examined.findings, artifacts)
    drawing = examined.drawing
    artifacts += (*render_order_notes(facts), *render_fab_drawing(facts, drawing), *render_fab_dxf(facts, drawing))
    kits = []
    number = 1
    for tape, place in zip(examined.tapes, examined.panel.places, strict=True):
        path = f"{_kit_folder(tape)}/{MANIFEST_NAME}"
        kits.append(PlacedKit(tape=tape.tape, manifest=path, data=(folder / path).read_bytes(), place=place, first=number))
        number += tape.tape.part_count
    record = panel_record(film.layout, first.spec, film.fab)
    content = panel_manifest(examined.name, examined.panel, kits, record, artifacts) | made_record(first.spec, verified=verify)
    if examined.trials:
        content["coupon"] = {"fab": first.spec.fab, "trials": [trial.to_mapping() for trial in examined.trials]}
    if blocking:
        content["forced"] = [forced(finding) for finding in blocking]
    write_kit(folder, content, artifacts)
    return artifacts, content
