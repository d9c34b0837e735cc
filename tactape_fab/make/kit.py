"""make_kit: makes a kit in a temporary folder, verifies it there, and renames the folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tactape_fab.base.errors import Check, DesignRuleError, Finding, SpecError
from tactape_fab.base.given_path import as_path
from tactape_fab.base.given_value import refuse_other
from tactape_fab.kit.artifact import AnyArtifact
from tactape_fab.kit.examine.tape import Examined, drawn_form, examine, undrawable
from tactape_fab.kit.order_facts import order_facts
from tactape_fab.kit.output_place import Overwrite, refuse_taken
from tactape_fab.kit.render.certificate_json import render_certificate
from tactape_fab.kit.render.fab_drawing import render_fab_drawing
from tactape_fab.kit.render.fab_dxf import render_fab_dxf
from tactape_fab.kit.render.order_notes import render_order_notes
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.kit.writer import (
    film_record,
    made_record,
    manifest,
    render_all,
    render_models,
    search_record,
    texture_record,
    write_kit,
)
from tactape_fab.make.publish import finished
from tactape_fab.report import add_report
from tactape_fab.solids.checks import form_problems, hole_problems
from tactape_fab.texture.certify.origin import Choice
from tactape_fab.texture.manifest import MANIFEST_NAME
from tactape_fab.texture.tape import Tape

if TYPE_CHECKING:
    from tactape_fab.verify.signature import Signer


@dataclass(frozen=True, slots=True, kw_only=True)
class Kit:
    """A finished kit.

    Attributes
    ----------
    path : Path
        Its folder.
    tape : Tape
    findings : tuple of Finding
        Every design rule, measured.
    checks : tuple of Check
        Every line of its verification; empty without verification.
    files : dict of str to str
        Paths by role, relative to the folder.
    search : Choice or None
        Result of the search for the origin; None without a search.
    """

    path: Path
    tape: Tape
    findings: tuple[Finding, ...]
    checks: tuple[Check, ...]
    files: Mapping[str, str]
    search: Choice | None = None

    def to_mapping(self) -> dict[str, Any]:
        """The kit as the JSON object that `tactape-fab make --json` prints."""
        tape = self.tape
        return {
            "path": str(self.path),
            "name": tape.name,
            "sector": tape.sector,
            "code": tape.code,
            "origin": list(tape.origin),
            "columns": tape.columns,
            "rows": tape.rows,
            "parts": tape.part_count,
            "files": dict(self.files),
            "findings": [asdict(f) for f in self.findings],
            "checks": [asdict(c) for c in self.checks],
        }


def make_kit(
    spec: TapeSpec,
    path: str | Path | None = None,
    *,
    avoid: Sequence[Tape] = (),
    overwrite: Overwrite = False,
    verify: bool = True,
    force: bool = False,
    signer: Signer | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Kit:
    """Make a kit: all files of a tape, verified from what was written.

    Parameters
    ----------
    spec : TapeSpec
    path : str or Path, optional
        Folder of the kit; by default the tape's name in the current folder.
    avoid : sequence of Tape
        Existing tapes: the origin is chosen away from them, and the spec's must be ``"best"``; a touch code is designed
        away from them.
    overwrite : bool or "edits"
        Replace an older kit of this tool at `path`; with ``"edits"`` also one whose files were edited since they were
        written. Anything else there is refused.
    verify : bool
        Verify the written files before the kit gets its name.
    force : bool
        Write it in spite of broken design rules; the manifest records them under ``forced``.
    signer : Signer, optional
        Sign it: `tactape_fab.verify.signature.read_signer` reads a key.
    progress : callable
        Called with the name of each step.

    Returns
    -------
    Kit

    Raises
    ------
    SpecError
        If no tape can be made from the spec, or `path` is taken.
    DesignRuleError
        If a rule of the fab profile is broken.
    VerifyError
        If the written files fail the verification; nothing is left at `path`.
    """
    if path is not None:
        path = as_path(path, "path", "the folder of the kit")  # before the work
    refuse_wrong_how(verify=verify, force=force, signer=signer)
    return make_examined(
        examine(spec, avoid=avoid), path, overwrite=overwrite, verify=verify, force=force, signer=signer, progress=progress
    )


def make_examined(
    examined: Examined,
    path: str | Path | None = None,
    *,
    overwrite: Overwrite = False,
    verify: bool = True,
    force: bool = False,
    signer: Signer | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Kit:
    """Make the kit of a tape that has been examined; see `make_kit`."""
    target = Path(examined.tape.name) if path is None else as_path(path, "path", "the folder of the kit")
    blocking = refuse_broken(examined.findings, [examined], target, overwrite=overwrite, force=force)
    with finished(target, "kit", overwrite=overwrite, signer=signer) as folder:
        files, checks = fill_kit(folder, examined, blocking, verify=verify, progress=progress)
    return Kit(
        path=target,
        tape=examined.tape,
        findings=examined.findings,
        checks=checks,
        files=files,
        search=examined.search,
    )


def fill_kit(
    folder: Path, examined: Examined, blocking: Sequence[Finding], *, verify: bool, progress: Callable[[str], None]
) -> tuple[dict[str, str], tuple[Check, ...]]:
    """Write every file of a kit into a folder, verify them there, and add the report; returns paths by role, and the checks.

    ``blocking`` are the broken rules that the kit is made in spite of.

    Raises VerifyError if the written files fail the verification.
    """
    progress("rendering")
    artifacts, content = rendered(examined)
    content |= made_record(examined.spec, verified=verify)
    if blocking:
        content["forced"] = [forced(finding) for finding in blocking]
    progress("writing")
    files = {artifact.role: artifact.path for artifact in artifacts}
    artifacts.reverse()
    # each artifact is released once it is written: with 200,000 parts they take as much memory as a model or the report
    write_kit(folder, content, (artifacts.pop() for _ in range(len(artifacts))))
    checks: tuple[Check, ...] = ()
    if verify:
        progress("verifying")
        from tactape_fab.verify import verify_folder  # imported here: it takes long to load

        verification = verify_folder(folder / MANIFEST_NAME, quick=True)
        verification.raise_if_failed()
        checks = verification.checks
    progress("reporting")
    report = add_report(folder, content, examined.tape, checks=checks, findings=examined.findings)
    return {**files, report.role: report.path}, checks


def rendered(examined: Examined) -> tuple[list[AnyArtifact], dict[str, Any]]:
    """Every file of a kit, and the content of its manifest."""
    spec, tape, film, process = examined.spec, examined.tape, examined.film, examined.profiles.process
    artifacts: list[AnyArtifact] = [] if film is None else [*render_all(examined.drawing, film.fab)]
    if film is not None:
        facts = order_facts(film.layout, film.fab, examined.findings, artifacts)
        drawing = examined.drawing
        artifacts += (*render_order_notes(facts), *render_fab_drawing(facts, drawing), *render_fab_dxf(facts, drawing))
    if spec.form is not None:
        artifacts += render_models(tape, spec.form, None if film is None else film.fab)
    if spec.sim:
        from tactape_fab.kit.render.sim import render_sim  # imported here: few kits have it

        artifacts += render_sim(tape, spec.form, None if film is None else film.fab)
    if film is not None:
        record = film_record(film.layout, spec, film.fab, process)
    else:
        assert process is not None
        record = texture_record(spec, process)
    artifacts += render_certificate(examined.certificate)
    return artifacts, manifest(tape, {**record, **search_record(examined.search, examined.avoided)}, artifacts)


def refuse_wrong_how(*, verify: object, force: object, signer: object) -> None:
    """Refuse arguments of the wrong type before the work. Raises SpecError."""
    from tactape_fab.verify.signature import Signer

    for key, value in (("verify", verify), ("force", force)):
        refuse_other(value, bool, key, "bool", "True or False")
    refuse_other(signer, (Signer, type(None)), "signer", "Signer", "what read_signer returns, or leave it out")


def refuse_broken(
    findings: Sequence[Finding], drawn: Sequence[Examined], target: Path, *, overwrite: Overwrite, force: bool
) -> list[Finding]:
    """Refuse a path that is taken, and broken rules unless they are forced; returns the broken ones.

    `drawn` is the tape, or the tapes of a panel; models that cannot be built are refused even with `force`.
    """
    blocking = [finding for finding in findings if finding.blocks]
    try:
        refuse_taken(target, overwrite=overwrite)
    except SpecError as error:
        raise SpecError(error.problems, () if force else blocking) from None
    holes = [p for tape in drawn if tape.spec.form is not None or tape.spec.sim for p in hole_problems(tape.tape.board)]
    if force and holes:
        raise SpecError(holes)
    first = drawn[0]
    form = drawn_form(first.spec, first.tape)
    never = (
        # a chip larger than its cell may be forced onto a film, but its models would overlap, which no file can represent
        undrawable(form_problems(first.tape, form), first.spec, first.film)
        if force and form is not None and first.film is not None
        else []
    )
    if blocking and (never or not force):
        raise DesignRuleError(never or findings)
    return blocking


def forced(finding: Finding) -> dict[str, Any]:
    """Record of a broken rule in the manifest of a kit that was made in spite of it."""
    return {"rule": finding.rule, "value": finding.value, "limit": finding.limit, "message": finding.message}
