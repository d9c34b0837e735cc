"""Reader of tapes from a user's paths: kits, panels, manifests, folders of these, packed registries. All commands use it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path

from tactape_fab.base.errors import Problem, SpecError, refuse, tried
from tactape_fab.base.fields import shown_path
from tactape_fab.base.given_path import as_path
from tactape_fab.base.given_value import refuse_other
from tactape_fab.base.output_file import UNFINISHED_SUFFIX
from tactape_fab.texture.as_built import NOMINAL, AsBuilt, Given, manifest_digest
from tactape_fab.texture.manifest import MANIFEST_NAME, find_manifest, of_kit, read_manifest
from tactape_fab.texture.packed import MOST_TAPES, is_packed, read_packed
from tactape_fab.texture.panel_manifest import kits_of
from tactape_fab.texture.tape import Tape, no_tape


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registered:
    """A tape, the path of its kit or packed registry, and the name of its fab or process profile."""

    path: Path
    tape: Tape
    fab: str


TapeLike = Tape | str | PathLike[str]
"""A tape, or the path of a kit, a panel, a manifest, a folder of these, or a packed registry."""


def read_tapes(paths: str | Path | Sequence[str | Path], as_built: str | Path | Sequence[str | Path] = ()) -> list[Tape]:
    """The tapes of kits.

    Parameters
    ----------
    paths : path or sequence of path
        Folders of kits, panels or embossed parts, their manifests, folders of such folders (in the order of their names), or
        packed registries.
    as_built : path or sequence of path
        Files of measured places, each of one of the kits, in place of the as-built.json beside it; ``["none"]`` for the places
        of the design.

    Returns
    -------
    list of Tape
        In the order given.

    Raises
    ------
    SpecError
        With the problems of all paths together.
    """
    return [entry.tape for entry in read_registered(paths, as_built)]


def as_tapes(tapes: object) -> list[Tape]:
    """List of tapes from tapes or paths (see `read_tapes`), or from a single tape or path.

    Raises SpecError: what is wrong with any of them, all together.
    """
    given = [tapes] if isinstance(tapes, Tape | str | bytes | PathLike) or not isinstance(tapes, Iterable) else tapes
    found: list[Tape] = []
    problems: list[Problem] = []
    for entry in given:
        if isinstance(entry, Tape):
            found.append(entry)
        elif isinstance(entry, str | PathLike):
            found += tried(partial(read_tapes, [entry if isinstance(entry, str) else Path(entry)]), problems) or []
        else:
            problems.append(no_tape(entry, "Tape.load(KIT), or the path of a kit"))
    refuse(problems)
    return found


def read_registered(
    paths: str | Path | Sequence[str | Path], as_built: str | Path | Sequence[str | Path] = ()
) -> list[Registered]:
    """The registry: kits, in the order given.

    paths: As for `read_tapes`.
    as_built: As for `read_tapes`.
    Raises SpecError: what is wrong with any of them, all together.
    """
    entries: list[Registered] = []
    problems: list[Problem] = []
    given = tried(lambda: _Measured([as_built] if isinstance(as_built, str | PathLike) else as_built), problems) or _Measured(())
    for given_path in [paths] if isinstance(paths, str | PathLike) or not isinstance(paths, Iterable) else paths:
        try:
            path = as_path(given_path, "paths", "kits")
            if given_path == "":  # Path("") would be the current folder
                raise SpecError(Problem("tape", "tape = '' is empty; give the path of a kit"))
            packed = is_packed(path)
            if packed:
                entries += [Registered(path=path, tape=tape, fab=fab) for tape, fab in read_packed(path)]
            places = [] if packed else _kits_at(path)
        except SpecError as error:
            problems.extend(error.problems)
            continue
        if len(entries) + len(places) > MOST_TAPES:
            raise SpecError(Problem("tape", f"more than {MOST_TAPES} tapes are given; register those that can be touched"))
        for place in places:
            try:
                file = find_manifest(place)
            except SpecError as error:  # its message names the place
                problems.extend(Problem("tape", problem.message) for problem in error.problems)
                continue
            try:
                manifest = read_manifest(file)
                fab = manifest.get("fab")
                name = fab.get("name", "") if isinstance(fab, dict) else ""
                tape = Tape.from_mapping(manifest).with_as_built(file, given.of(file))
                entries.append(Registered(path=place, tape=tape, fab=str(name)[:200]))
            except SpecError as error:
                problems.extend(of_kit(place, problem) for problem in error.problems)
    problems += given.unused(entries)
    refuse(problems)
    return entries


def taken_once(entries: Sequence[Registered]) -> tuple[list[Registered], list[str]]:
    """The entries less those of a file that was read before, by another path or a link; and a note about each such path.

    A copy of a kit in a folder of its own is another kit.
    """
    files = {path: (path / MANIFEST_NAME if path.is_dir() else path).resolve() for path in {entry.path for entry in entries}}
    first: dict[object, Registered] = {}
    notes: dict[str, None] = {}
    for entry in entries:
        known = first.setdefault((files[entry.path], entry.tape.name, entry.tape.sector, entry.tape.origin), entry)
        if known is not entry:
            here, there = shown_path(entry.path), shown_path(known.path)
            notes[f"{here} is given again, and taken once" if here == there else f"{here} is {there}, and taken once"] = None
    return [*first.values()], [*notes]


class _Measured:
    """Files of measured places, by the digest of the manifest that each belongs to."""

    def __init__(self, files: Sequence[str | Path]) -> None:
        given: object = files
        refuse_other(given, Sequence, "as_built", "list of files", "files of measured places, or none")
        files = [as_path(file, "as_built", "files of measured places, or none") if file != NOMINAL else NOMINAL for file in files]
        self._nominal = NOMINAL in files
        if self._nominal and any(file != NOMINAL for file in files):
            message = "as_built = none is given together with files; give either none or the files"
            raise SpecError(Problem("as-built", message))
        self._files: dict[str, str | Path] = {}
        for file in () if self._nominal else files:
            first = self._files.setdefault(AsBuilt.load(file).manifest_sha256, file)
            if first != file:
                message = f"as_built = {shown_path(first)} and {shown_path(file)} are of one kit, whose parts stand in one place"
                raise SpecError(Problem("as-built", f"{message}; give one of them"))
        self._used: set[str] = set()

    def of(self, manifest: Path) -> Given:
        """The argument of `Tape.with_as_built`."""
        if self._nominal or not self._files:
            return NOMINAL if self._nominal else None
        digest = manifest_digest(manifest)
        self._used.add(digest)
        return self._files.get(digest)

    def unused(self, entries: Sequence[Registered]) -> list[Problem]:
        """The files that belong to none of the kits."""
        kits = ", ".join(entry.tape.name for entry in entries[:5])
        of = f"of {kits} has" if kits else "is there"
        return [
            Problem("as-built", f"{shown_path(file)} is for the manifest {digest[:12]}..., and none {of}; give its kit, too")
            for digest, file in self._files.items()
            if digest not in self._used
        ]


def labels(entries: Sequence[Registered]) -> tuple[str, ...]:
    """Names of the tapes; a name that occurs twice is followed by the path of the kit."""
    names = Counter(e.tape.name for e in entries)
    return tuple(e.tape.name if names[e.tape.name] == 1 else f"{e.tape.name} ({shown_path(e.path)})" for e in entries)


def refuse_equal_names(tapes: Iterable[Tape], what: str) -> None:
    """Refuse two different tapes of the same name where a tape is identified by its name only.

    what: The thing that identifies tapes by name, for the message.
    Raises SpecError.
    """
    first: dict[str, Tape] = {}
    for tape in tapes:
        other = first.setdefault(tape.name, tape)
        if other is not tape and other.texture_key != tape.texture_key:
            named = f"tapes of sectors {other.sector} and {tape.sector}" if other.sector != tape.sector else "two tapes"
            message = f"{named} are both named {tape.name}, and {what} names its tape by that alone"
            raise SpecError(Problem("tape", f"{message}; make one of them with another name, or leave it out"))


def _kits_at(path: Path) -> list[Path]:
    """Paths of kits: the path itself if it is a kit, those of a panel, or those of all kits and panels in a folder."""
    try:
        if not path.is_dir() or (path / MANIFEST_NAME).exists():
            return kits_of(path)
        inside = sorted(p for p in path.iterdir() if (p / MANIFEST_NAME).is_file() and not p.name.endswith(UNFINISHED_SUFFIX))
    except (OSError, ValueError):  # reported when the path is read as a kit
        return [path]
    return [kit for place in inside for kit in kits_of(place)] or [path]
