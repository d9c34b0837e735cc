"""Reproduction of a kit: it is made again from its manifest in a temporary folder, and every byte is compared.

A manifest is untrusted. Its spec is checked like one that a user typed, must not name files, and must match the tape that the
manifest describes, so that the size of the new kit is bounded by that of the kit.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path, PurePosixPath
from typing import Any

from tactape_fab.base.build_date import dated
from tactape_fab.base.errors import Check, Problem, SpecError, TactapeError, reason_of, refuse
from tactape_fab.base.fields import Fields, named, shown, shown_path
from tactape_fab.base.libraries import versions_in_kits
from tactape_fab.base.templates import is_profile_file
from tactape_fab.base.version import __version__
from tactape_fab.kit.examine.order import ExaminedPanel
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.panel.geometry import read_panel_record
from tactape_fab.kit.panel.tabs_and_marks import plan_packed, plan_panel
from tactape_fab.kit.profiles.confirm import read_trials
from tactape_fab.kit.spec.tape_spec import KEYS, PROFILE_KEYS, TapeSpec
from tactape_fab.make.kit import fill_kit
from tactape_fab.make.panel import fill_panel
from tactape_fab.texture.board import MOST_HOLES
from tactape_fab.texture.certify.origin import Choice
from tactape_fab.texture.code import has_plane
from tactape_fab.texture.manifest import MANIFEST_NAME, MOST_MANIFEST_BYTES, find_manifest, read_any_manifest
from tactape_fab.texture.panel_manifest import is_panel, read_placed
from tactape_fab.texture.tape import NAME_PATTERN, NAME_REMEDY, Tape
from tactape_fab.verify.certificate import difference
from tactape_fab.verify.files import read_inside
from tactape_fab.verify.spec_record import contradictions, of_tape, other_values
from tactape_fab.verify.verification import Verification

NAME = "reproduced"
_SPARE_POINTS = 10_000
_MORE_POINTS = 4
"""Tolerances of the check that a spec matches its tape: the grid points for which the board has room may exceed the manifest's by
this factor and this number, as margins and a strip take some."""
_LONGER_BYTES = 1 << 20
_DATE = "%Y-%m-%dT%H:%M:%S+00:00"


class NotReproducibleError(TactapeError):
    """A kit that this version cannot make again, which says nothing about the kit; the message says why, and what can."""


def reproduce_kit(path: str | Path, *, required: bool = True) -> Verification:
    """Make a kit, or a panel with its kits, again from its manifest, and compare every byte.

    path: Folder of a kit or panel, or its manifest.json.
    required: Whether a kit that this version cannot make again is a failure, or else a warning: kits of other versions, with the
        user's own profiles, on the user's own part, and designs that avoid other tapes.
    Returns: A verification with one line.
    Raises SpecError when there is no kit at `path`.
    """
    file = find_manifest(path)
    try:
        content = read_any_manifest(file)
        problems, count = _reproduced_panel(file, content) if is_panel(content) else _reproduced(file, content)
    except NotReproducibleError as why:
        return _answer(file, Check(name=NAME, passed=False, warning=not required, skipped=True, message=f"not made again: {why}"))
    except (TactapeError, MemoryError, RecursionError) as error:
        fault = "; ".join(str(error).splitlines()) or type(error).__name__
        return _answer(file, Check(name=NAME, passed=False, message=f"it cannot be made from its manifest: {fault}"))
    message = named(problems) or f"made again from its manifest: {count} files, the same bytes"
    return _answer(file, Check(name=NAME, passed=not problems, message=message, figure=float(count)))


def _answer(file: Path, check: Check) -> Verification:
    return Verification(name=file.resolve().parent.name, checks=(check,))


# One tape


def _reproduced(file: Path, content: Mapping[str, Any]) -> tuple[list[str], int]:
    """Differences between a kit and its reproduction, and the number of files that were compared."""
    if "surface" in content:
        raise NotReproducibleError("it was made on the user's own part, which is not in it; run emboss with that part again")
    if problems := contradictions(content, Tape.from_mapping(content)):
        raise SpecError(problems)
    made = _read_made(content)
    examined = _examined(content, made)
    with tempfile.TemporaryDirectory(prefix="tactape-", ignore_cleanup_errors=True) as scratch, dated(made["date"]):
        again = Path(scratch)
        blocking = [finding for finding in examined.findings if finding.blocks]
        fill_kit(again, examined, blocking, verify=made["verified"], progress=lambda _: None)
        return _differences(file.parent, again, made["libraries"])


def _read_made(content: Mapping[str, Any]) -> dict[str, Any]:
    """The record of how a kit was made. Raises NotReproducibleError if another version made it."""
    tool = content.get("tool")
    version = tool.get("version") if isinstance(tool, Mapping) else None
    if version != __version__:
        raise NotReproducibleError(
            f"its manifest says that tactape-fab {shown(version)} made it, this is {__version__}; install that version"
        )
    if not isinstance(content.get("made"), Mapping):
        raise NotReproducibleError("it does not record what it was made with, as this version does; make it anew")
    table = Fields(content).table("made", ("date", "libraries", "verified", "coverlay_asked"))
    date = table.text("date", longest=40)
    try:
        moment = datetime.strptime(date, _DATE).replace(tzinfo=timezone.utc)
    except ValueError:
        table.problem("date", f"date = {shown(date)} is no date of a kit; it is written as 1980-01-01T00:00:00+00:00")
        moment = datetime(1980, 1, 1, tzinfo=timezone.utc)
    libraries = table.table("libraries").values
    made = {
        "date": moment,
        "verified": table.flag("verified"),
        "coverlay_asked": table.flag("coverlay_asked"),
        "libraries": {name: libraries.get(name) for name in versions_in_kits()},
    }
    refuse(table.problems)
    return made


def _examined(content: Mapping[str, Any], made: Mapping[str, Any]) -> Examined:
    """The examined tape of a manifest's spec."""
    values = content.get("spec")
    if not isinstance(values, Mapping):
        raise SpecError("the manifest has no spec")
    values = {key: value for key, value in values.items() if value is not None}
    for key in PROFILE_KEYS:
        if is_profile_file(values.get(key)):
            raise NotReproducibleError(
                f"its {key} profile, {shown(values[key])}, is the user's own, and not in it; make it again from that profile"
            )
    tape = Tape.from_mapping(content)
    search = content.get("search")
    avoided = _avoided(content if search is None else search)
    # for a plane the manifest records the origin; a design would need the avoided tapes themselves
    if avoided and not has_plane(tape.code):
        raise NotReproducibleError(f"its design avoids other tapes, not in it: {shown(avoided)}; make it again beside them")
    if search is not None and not avoided:
        values["origin"] = "best"
    if not made["coverlay_asked"]:
        # the manifest has the mode that was used; if it was not requested, it is chosen again
        values.pop("coverlay", None)
    _refuse_other(values, tape)
    examined = examine(TapeSpec.from_mapping(values))
    return replace(examined, search=_recorded_choice(search, tape), avoided=avoided) if avoided else examined


def _avoided(record: object) -> tuple[str, ...]:
    """Names of the tapes that were avoided."""
    found = record.get("avoided") if isinstance(record, Mapping) else None
    return tuple(str(name)[:64] for name in found) if isinstance(found, list) else ()


def _recorded_choice(search: object, tape: Tape) -> Choice:
    """The recorded result of a search that avoided other tapes, which the kit does not contain."""
    table = Fields(search if isinstance(search, Mapping) else {}, "search.")
    choice = Choice(
        origin=tape.origin,
        candidates=table.integer("candidates", low=1, high=1_000_000_000),
        distance=table.integer("distance", low=0, high=16),
        default_distance=_distance(table, "default_distance"),
        from_others=_distance(table, "from_others"),
    )
    refuse(table.problems)
    return choice


def _distance(table: Fields, key: str) -> int | None:
    return None if table.values.get(key) is None else table.integer(key, low=0, high=16)


def _refuse_other(values: Mapping[str, Any], tape: Tape) -> None:
    """Refuse a spec that does not match the tape, before anything is computed from it."""
    board, problems = tape.board, other_values(values, of_tape(tape))
    problems += [Problem(str(key), f"spec.{shown(key)} is no option") for key in values if key not in KEYS]
    # the grid of a board without margins is an upper bound, so that a small manifest cannot demand a large tape
    points = (board.size_mm[0] / tape.pitch_mm + 1) * (board.size_mm[1] / tape.pitch_mm + 1)
    if points > _MORE_POINTS * tape.columns * tape.rows + _SPARE_POINTS:
        problems.append(Problem("size_mm", f"its {tape.columns} x {tape.rows} grid points are not those of a board of that size"))
    if len(board.holes) > MOST_HOLES:
        problems.append(Problem("holes_mm", f"it has {len(board.holes)} holes, more than {MOST_HOLES}"))
    refuse(problems)


# A panel


def _reproduced_panel(file: Path, content: Mapping[str, Any]) -> tuple[list[str], int]:
    """As `_reproduced`, for a panel with all its kits."""
    made = _read_made(content)
    placed = read_placed(table := Fields(content))
    refuse(table.problems)
    root = file.parent.resolve()
    tapes = []
    for place in placed:
        kit = file.parent / PurePosixPath(place.manifest)
        try:
            read_inside(root, kit, MOST_MANIFEST_BYTES)
        except (OSError, RuntimeError) as error:
            raise SpecError(f"{place.manifest} {reason_of(error)}") from error
        own = read_any_manifest(kit)
        record = _read_made(own)
        # panel and kits were made in one run; versions of libraries are considered when files are compared
        if {**record, "libraries": None} != {**made, "libraries": None}:
            raise SpecError(f"{place.manifest} was not made with the panel")
        tapes.append(_examined(own, record))
    examined = _examined_panel(content, tapes)
    with tempfile.TemporaryDirectory(prefix="tactape-", ignore_cleanup_errors=True) as scratch, dated(made["date"]):
        again = Path(scratch)
        blocking = [finding for finding in examined.findings if finding.blocks]
        fill_panel(again, examined, blocking, verify=made["verified"], progress=lambda _: None)
        problems, count = [], 0
        for place in placed:
            folder = PurePosixPath(place.manifest).parent
            found, files = _differences(file.parent / folder, again / folder, made["libraries"])
            problems += [f"{folder}/{problem}" for problem in found]
            count += files
        found, files = _differences(file.parent, again, made["libraries"])
        return problems + found, count + files


def _examined_panel(content: Mapping[str, Any], tapes: Sequence[Examined]) -> ExaminedPanel:
    table = Fields(content)
    name = table.text("name", pattern=NAME_PATTERN, remedy=NAME_REMEDY)
    record = table.table("panel")
    recorded = read_panel_record(record)
    if table.problems or record.problems:
        raise SpecError([*table.problems, *record.problems])
    boards = [(tape.tape.board.size_mm, tape.tape.board.corner_radius_mm) for tape in tapes]
    if any(tape.film is None for tape in tapes) or boards != [(place.size_mm, place.radius_mm) for place in recorded.places]:
        raise SpecError(f"its {len(tapes)} tapes are not {recorded.words} of the sizes that it records")
    if recorded.grid is None:
        panel = plan_packed(
            recorded.size_mm, boards, [(place.offset_mm, place.turned) for place in recorded.places], tapes[0].fab
        )
    else:
        # the sides with tabs follow from the recorded numbers of tabs
        sides = "x" * (recorded.places[0].tabs_x > 0) + "y" * (recorded.places[0].tabs_y > 0)
        panel = plan_panel(*boards[0], recorded.grid, sides, tapes[0].fab)
    trials = read_trials(content)[1] if "coupon" in content else ()
    return ExaminedPanel(name=name, tapes=tuple(tapes), panel=panel, remarks=(), trials=trials)


# Comparison


def _differences(folder: Path, again: Path, libraries: Mapping[str, Any]) -> tuple[list[str], int]:
    """Differing files, the manifest last with the first value that differs; and the number of compared files."""
    if not folder.is_dir():
        return [f"{shown_path(folder)} was removed while it was read"], 0
    root, problems = folder.resolve(), []
    expected: dict[str, Any] = json.loads((again / MANIFEST_NAME).read_bytes())
    paths = [str(row["path"]) for row in expected["files"]]
    for path in paths:
        try:
            right = (again / path).read_bytes()
            same = read_inside(root, folder / path, len(right) + _LONGER_BYTES) == right
        except (OSError, RuntimeError) as error:
            problems.append(f"{path} {reason_of(error)}")
        else:
            problems += [] if same else [f"{path} is not what this manifest makes"]
    try:
        written = read_inside(root, folder / MANIFEST_NAME, MOST_MANIFEST_BYTES)
        if written != (again / MANIFEST_NAME).read_bytes():
            problems += _manifest_difference(json.loads(written), expected, problems)
    except (OSError, RuntimeError, ValueError) as error:
        problems.append(f"{MANIFEST_NAME} {reason_of(error)}")
    others = {name: (libraries[name], own) for name, own in versions_in_kits().items() if libraries[name] != own}
    # other versions of numpy or zlib may write other bytes for the same content, so a difference proves nothing
    if problems and others:
        values = ", ".join(f"{name} {shown(theirs)}, here {own}" for name, (theirs, own) in others.items())
        raise NotReproducibleError(f"{named(problems)}; it was made with {values}: install these to tell whether that is why")
    return problems, len(paths) + 1


def _manifest_difference(found: Mapping[str, Any], expected: Mapping[str, Any], problems: Sequence[str]) -> list[str]:
    """Differences of a manifest, without sizes and digests of files that are reported themselves."""
    skipped = {"files"} if problems else set()
    written, right = ({key: value for key, value in side.items() if key not in skipped} for side in (found, expected))
    wrong = difference(written, right)
    if wrong is not None:
        return [f"{MANIFEST_NAME}: {wrong}"]
    return [] if problems else [f"{MANIFEST_NAME} has the right content, but is not written as this version writes it"]
