"""make_kit: the only place where a kit gets its name. Built and verified in a temporary folder, then exchanged into place."""

from __future__ import annotations

import ctypes
import errno
import os
import re
import secrets
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from tactape_fab.errors import Check, DesignRuleError, Finding, Problem, SpecError, TactapeError
from tactape_fab.fields import shown_path
from tactape_fab.kit.layout import Layout, build_layout
from tactape_fab.kit.plan import plan
from tactape_fab.kit.rules import check
from tactape_fab.kit.spec import KEYS, TapeSpec
from tactape_fab.kit.writer import manifest, render_all, write_kit
from tactape_fab.profiles import FabProfile, X2Mode, load_fab, load_part
from tactape_fab.texture.tape import MANIFEST_NAME, UNFINISHED_SUFFIX, Tape, read_manifest
from tactape_fab.verify import verify_folder

_RENAME_EXCHANGE = 2
_AT_FDCWD = -100
_RESTS_ON = {
    "displacement_mm": {"pitch_mm"},
    "size_mm": {"pitch_mm", "displacement_mm", "code", "fab", "part", "rotation_deg", "tag_cell_mm", "corner_radius_mm"},
    "origin": {"code", "sector", "size_mm", "pitch_mm"},
    "corner_radius_mm": {"size_mm", "tag_cell_mm"},
    "holes_mm": {"size_mm", "corner_radius_mm"},
}
"""What else decides whether a value is refused: where that was set aside, the value cannot be judged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Examined:
    """A spec with all that follows from it before anything is written."""

    spec: TapeSpec
    fab: FabProfile
    layout: Layout
    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Kit:
    """A kit that stands under its name.

    Attributes
    ----------
    path : Path
        Its folder.
    tape : Tape
    findings : tuple of Finding
        Every design rule, measured.
    checks : tuple of Check
        Every line of its verification; empty where none was asked for.
    files : dict of str to str
        Role to path, relative to the folder.
    """

    path: Path
    tape: Tape
    findings: tuple[Finding, ...]
    checks: tuple[Check, ...]
    files: Mapping[str, str]


def examine(spec: TapeSpec) -> Examined:
    """Plan, draw and measure a tape; nothing is written and no broken rule raises.

    Raises
    ------
    SpecError
        When a profile cannot be read, or no tape follows from the spec.
    """
    problems: list[Problem] = []
    fab = part = None
    try:
        fab = load_fab(spec.fab)
    except SpecError as error:
        problems += error.problems
    try:
        part = load_part(spec.part)
    except SpecError as error:
        problems += error.problems
    if fab is None or part is None:
        raise SpecError(problems)
    fab = replace(fab, x2=cast(X2Mode, spec.x2 or fab.x2), assembly=spec.assembly or fab.assembly)
    layout = build_layout(plan(spec, fab, part), spec, fab, part)
    return Examined(spec=spec, fab=fab, layout=layout, findings=tuple(check(layout, fab)))


def _root(key: str) -> str:
    """The key of the spec that a problem's key belongs to."""
    return re.split(r"[ .\[:]", key)[0]


def examine_values(values: Mapping[str, Any], *, output: str | None = None, overwrite: bool = False) -> Examined:
    """Examine untrusted values, and the place that the kit is to take.

    A refusal lists everything: what is refused is set aside for its default and the rest is examined again, until
    nothing new is found; broken design rules are listed where the values that they measure were not refused.

    Raises
    ------
    SpecError
        With every problem, and in `findings` the rules that the remaining values break.
    """
    problems: list[Problem] = []
    raised: list[type[SpecError]] = []
    if output is not None:
        try:
            _refuse_taken(Path(output), overwrite=overwrite)
        except SpecError as error:
            problems += error.problems
            raised.append(SpecError)
    findings: Sequence[Finding] = ()
    kept = dict(values)
    set_aside: set[str] = set()
    while True:
        try:
            examined = examine(TapeSpec.from_mapping(kept))
        except SpecError as error:
            new = [p for p in error.problems if p not in problems and not _RESTS_ON.get(_root(p.key), set()) & set_aside]
            if not new:
                break
            problems += new
            raised.append(type(error))
            refused = {_root(problem.key) for problem in new}
            set_aside |= refused
            kept = {"sector": 0, **{k: v for k, v in kept.items() if k in KEYS and k not in refused}}
        else:
            if not problems:
                return examined
            if not set_aside & {"pitch_mm", "displacement_mm", "rotation_deg", "part"}:
                findings = [replace(finding, at_mm=None) for finding in examined.findings if finding.blocks]
            break
    raise (raised[0] if len(set(raised)) == 1 else SpecError)(problems, findings)


def make_kit(
    spec: TapeSpec,
    path: str | Path | None = None,
    *,
    overwrite: bool = False,
    verify: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> Kit:
    """Make a kit: all files of a tape, verified from what was written.

    Parameters
    ----------
    spec : TapeSpec
    path : str or Path, optional
        Folder of the kit; the tape's name in the current folder where none is given.
    overwrite : bool
        Replace an older kit of this tool at `path`. Anything else that stands there is refused.
    verify : bool
        Verify the written files before the kit gets its name.
    progress : callable
        Told in words what is being done.

    Returns
    -------
    Kit

    Raises
    ------
    SpecError
        When no tape follows from the spec, or `path` is taken.
    DesignRuleError
        When a rule of the fab profile is broken.
    VerifyError
        When the written files are not what they should be; nothing stands at `path` then.
    """
    return make_examined(examine(spec), path, overwrite=overwrite, verify=verify, progress=progress)


def make_examined(
    examined: Examined,
    path: str | Path | None = None,
    *,
    overwrite: bool = False,
    verify: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> Kit:
    """Make the kit of a tape that has been examined; see `make_kit`."""
    target = Path(examined.layout.tape.name if path is None else path)
    blocking = [finding for finding in examined.findings if finding.blocks]
    try:
        _refuse_taken(target, overwrite=overwrite)
    except SpecError as error:
        raise SpecError(error.problems, blocking) from None
    if blocking:
        raise DesignRuleError(examined.findings)
    progress("rendering")
    artifacts = render_all(examined.layout, examined.fab)
    content = manifest(examined.layout, examined.spec, examined.fab, artifacts)
    checks: tuple[Check, ...] = ()
    folder = target.parent / f".{target.name}.{secrets.token_hex(4)}{UNFINISHED_SUFFIX}"
    new_parents = [parent for parent in target.parents if not parent.exists()]
    try:
        folder.mkdir(parents=True)
        progress("writing")
        write_kit(folder, content, artifacts)
        if verify:
            progress("verifying")
            verification = verify_folder(folder / MANIFEST_NAME, quick=True)
            verification.raise_if_failed()
            checks = verification.checks
        _put_in_place(folder, target, overwrite=overwrite)
    except OSError as error:
        reason = error.strerror or error
        raise TactapeError(f"the kit cannot be written to {target}: {reason}; use -o to name another folder") from error
    finally:
        _clear_away(folder, new_parents)
    return Kit(
        path=target,
        tape=examined.layout.tape,
        findings=examined.findings,
        checks=checks,
        files={a.role: a.path for a in artifacts},
    )


def _clear_away(folder: Path, new_parents: Sequence[Path]) -> None:
    """Leave nothing behind, also when a second signal comes while this is under way."""
    try:
        shutil.rmtree(folder, ignore_errors=True)
        for parent in new_parents:  # innermost first; one that holds a kit stays
            with suppress(OSError):
                parent.rmdir()
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _refuse_taken(target: Path, *, overwrite: bool) -> None:
    if target.name.endswith(UNFINISHED_SUFFIX) or target.name in ("", "..") or target.name.startswith("."):
        raise SpecError(f"output = {target} is no name for a kit; give a folder that does not begin with '.' and ends otherwise")
    try:
        taken = target.exists() or target.is_symlink()
    except (OSError, ValueError) as error:  # a name that no system takes
        reason = getattr(error, "strerror", None) or error
        raise SpecError(f"output = {shown_path(target)} cannot be a folder: {reason}; use -o to name another one") from error
    if taken and (target.is_symlink() or not target.is_dir()):
        raise SpecError(f"output = {target} exists and is not a folder; nothing was touched; use -o to name another folder")
    if taken and not overwrite:
        raise SpecError(f"output = {target} exists already; use --overwrite to replace a kit, or -o to name another folder")
    if taken:
        _refuse_foreign(target)


def _refuse_foreign(target: Path) -> None:
    """Only a folder that is wholly ours may be replaced: our manifest, and no file that it does not list."""
    remedy = "nothing was touched; use -o to name another folder"
    try:
        content = read_manifest(target / MANIFEST_NAME)
    except SpecError as error:
        raise SpecError(f"output = {target} is no kit of this tool ({error}); {remedy}") from None
    rows = content.get("files")
    listed = {row.get("path") for row in rows if isinstance(row, dict)} if isinstance(rows, list) else set()
    listed.add(MANIFEST_NAME)
    for place in target.rglob("*"):
        if (place.is_symlink() or not place.is_dir()) and place.relative_to(target).as_posix() not in listed:
            raise SpecError(f"output = {target} holds {place.relative_to(target)}, which its manifest does not list; {remedy}")


def _put_in_place(folder: Path, target: Path, *, overwrite: bool) -> None:
    """Give a finished folder its name; whoever looks sees the old kit or the new one, never a mixture."""
    if not (target.exists() or target.is_symlink()):
        folder.rename(target)
        return
    _refuse_taken(target, overwrite=overwrite)  # again: it may have come since
    if _exchange(folder, target):
        return
    # without an exchange in one step: the old kit steps aside under an unfinished name, and back if the new one fails
    aside = folder.with_name(folder.name.removesuffix(UNFINISHED_SUFFIX) + ".old" + UNFINISHED_SUFFIX)
    target.rename(aside)
    try:
        folder.rename(target)
    except OSError:
        aside.rename(target)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _exchange(a: Path, b: Path) -> bool:
    """Exchange two folders in one step (Linux renameat2 with RENAME_EXCHANGE); False where the system cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    if rename(_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP):
        return False
    raise OSError(code, os.strerror(code))
