"""AsBuilt: where the parts of one made tape really stand, as measured; the file as-built.json beside a kit."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.input_file import open_regular, read_regular
from tactape_fab.base.json_text import parse_json
from tactape_fab.base.output_file import write_file
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray
from tactape_fab.texture.plane import MOST_POINTS

AS_BUILT_FORMAT = "tactape-as-built/1"
AS_BUILT_NAME = "as-built.json"
NOMINAL = "none"
"""Stands for the places of the design, in the place of a file."""
SOURCES = ("scan", "survey", "aoi", "cpl")
MOST_BYTES = 64 * 1024 * 1024
_MOST_VALUES = 7 * MOST_POINTS
"""Six columns of one value for each part."""
MOST_SOURCES = 1000
MOST_SOURCE_CHARACTERS = 10_000
FARTHEST_MM = 10.0
"""Largest shift, and largest standard deviation of a place. A part farther off is a foreign object."""
MOST_STRETCH = 0.1
"""Largest stretch and shear of the film: polyimide moves by 0.1 % or so."""
LEAST_MEASURED = 10
"""Measured parts from which on their scatter says how far off the others may be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """Stretch of the whole film: a point (x, y) of the design is at (sx x + k y, sy y), board frame, mm.

    Attributes
    ----------
    scale : (float, float)
        sx and sy, near 1.
    shear : float
        k, the lean of the y axis towards x.
    sigma : float
        Standard deviation of each of these.
    """

    scale: tuple[float, float] = (1.0, 1.0)
    shear: float = 0.0
    sigma: float = 0.0

    @property
    def matrix(self) -> FloatArray:
        """[[sx, k], [0, sy]]; shape (2, 2)."""
        return np.array([[self.scale[0], self.shear], [0.0, self.scale[1]]])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BuiltParts:
    """Every part of a tape in designator order, measured or not; what the decoder and the simulator use.

    shift_mm (n, 2): Real less nominal place, stretch of the film included, board frame; 0 where nobody measured a part of an even
        film.
    rotation_deg (n,): Turn from the nominal rotation, counter-clockwise seen from above.
    present (n,)
    sigma_mm (n,): Standard deviation of the place along each axis. That of a part which is not listed is the scatter of the
        listed ones.
    """

    shift_mm: FloatArray
    rotation_deg: FloatArray
    present: BoolArray
    sigma_mm: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AsBuilt:
    """Measured places of the parts of one made tape. A part that is not listed is where the design has it.

    Attributes
    ----------
    tape : str
        Name of the tape.
    manifest_sha256 : str
        Digest of the bytes of the kit's manifest.json: the places belong to this kit alone. See `manifest_digest`.
    number : ndarray of int, shape (n,)
        Number of each listed designator: 12 of R12; ascending, none twice. ``number - 1`` indexes `Tape.part_xy_mm`.
    dx_mm, dy_mm : ndarray, shape (n,)
        Measured less nominal place (board frame: x right, y up), the film's stretch taken out: the part is at
        ``film.matrix @ nominal + (dx, dy)``. 0 for a missing part.
    rotation_deg : ndarray, shape (n,)
        Measured less nominal rotation, counter-clockwise seen from above; 0 where it was not measured.
    present : ndarray of bool, shape (n,)
        False: no part is there.
    sigma_mm : ndarray, shape (n,)
        Standard deviation of the place along each axis.
    film : Film
        Stretch of the whole film; a film without any is the default.
    source : tuple of mapping
        How it was measured, oldest first: each has a ``kind`` of "scan", "survey", "aoi" or "cpl", and anything else that
        JSON can hold. ``drift_mm`` of the last is the standard deviation, along each axis, of what neighbouring parts are
        wrong by together; it is part of `sigma_mm`.

    Raises
    ------
    SpecError
        If arrays differ in length, or a value is out of range: all problems together.
    """

    tape: str
    manifest_sha256: str
    number: IntArray
    dx_mm: FloatArray
    dy_mm: FloatArray
    rotation_deg: FloatArray
    present: BoolArray
    sigma_mm: FloatArray
    film: Film = field(default_factory=Film)
    source: tuple[Mapping[str, Any], ...] = ()

    def __post_init__(self) -> None:
        problems = _array_problems(self)
        if problems:
            raise SpecError(problems)
        for array in (self.number, self.dx_mm, self.dy_mm, self.rotation_deg, self.present, self.sigma_mm):
            array.setflags(write=False)

    def parts(self, nominal_mm: FloatArray) -> BuiltParts:
        """Shift, rotation, presence and sigma of every part.

        Parameters
        ----------
        nominal_mm : ndarray, shape (n, 2)
            `Tape.part_xy_mm` of the tape.

        Returns
        -------
        BuiltParts
        """
        n, at = len(nominal_mm), self.number - 1
        unlisted = self.scatter_mm if self.present.sum() >= LEAST_MEASURED else 0.0
        shift = nominal_mm @ (self.film.matrix - np.eye(2)).T
        np.add.at(shift, at, np.stack([self.dx_mm, self.dy_mm], axis=1))
        rotation, present, sigma = np.zeros(n), np.ones(n, dtype=bool), np.full(n, unlisted)
        rotation[at], present[at], sigma[at] = self.rotation_deg, self.present, self.sigma_mm
        return BuiltParts(shift_mm=shift, rotation_deg=rotation, present=present, sigma_mm=sigma)

    @property
    def scatter_mm(self) -> float:
        """Root mean square of dx and dy of the parts that are there; 0 without any."""
        d = np.concatenate([self.dx_mm[self.present], self.dy_mm[self.present]])
        return float(np.sqrt((d**2).mean())) if len(d) else 0.0

    @property
    def mean_mm(self) -> float:
        """How far the parts that are there are off together; 0 without any."""
        there = self.present
        return float(np.hypot(self.dx_mm[there].mean(), self.dy_mm[there].mean())) if there.any() else 0.0

    @property
    def drift_mm(self) -> float:
        """Standard deviation along each axis of what neighbouring parts are wrong by together: an answer's position, too."""
        said = self.source[-1].get("drift_mm", 0.0) if self.source else 0.0
        return float(said) if isinstance(said, int | float) and 0.0 <= said <= FARTHEST_MM else 0.0

    @property
    def missing(self) -> int:
        """Number of parts that are not there."""
        return int((~self.present).sum())

    def to_mapping(self) -> dict[str, Any]:
        """The content of the file: places to 1 nm, angles to 0.001 degrees."""
        return {
            "format": AS_BUILT_FORMAT,
            "tape": self.tape,
            "manifest_sha256": self.manifest_sha256,
            "film": {
                "scale": [round(float(s), 9) for s in self.film.scale],
                "shear": round(float(self.film.shear), 9),
                "sigma": round(float(self.film.sigma), 9),
            },
            "parts": {
                "designator": [f"R{n}" for n in self.number.tolist()],
                "dx_mm": _rounded(self.dx_mm, 6),
                "dy_mm": _rounded(self.dy_mm, 6),
                "rotation_deg": _rounded(self.rotation_deg, 3),
                "present": self.present.tolist(),
                "sigma_mm": _rounded(self.sigma_mm, 6),
            },
            "source": [dict(entry) for entry in self.source],
        }

    @classmethod
    def from_mapping(cls, content: Mapping[str, Any]) -> AsBuilt:
        """Read the content of a file; every value is checked.

        Parameters
        ----------
        content : mapping
            What the file's JSON holds; untrusted.

        Returns
        -------
        AsBuilt

        Raises
        ------
        SpecError
            Every problem found.
        """
        return _read(Fields(content))

    @classmethod
    def load(cls, path: str | Path) -> AsBuilt:
        """Read a file.

        Parameters
        ----------
        path : str or Path
            The file, or the folder of a kit that holds as-built.json.

        Returns
        -------
        AsBuilt

        Raises
        ------
        SpecError
            If there is none, it is too large or not JSON, or a value is missing or impossible: all problems together.
        """
        return cls.from_mapping(_content(Path(path)))

    def write(self, path: str | Path) -> Path:
        """Write the file, the same bytes for the same places; a file of that name is replaced in one step, a link never.

        Parameters
        ----------
        path : str or Path
            The file, or the folder of a kit, which then gets as-built.json.

        Returns
        -------
        Path
            Of the file.

        Raises
        ------
        SpecError
            If there is no such folder, or a link or a folder of that name.
        TactapeError
            If it cannot be written; what stood there is as it was.
        """
        file = _file_of(Path(path))
        write_file(file, _as_text(self.to_mapping()).encode("utf-8"), "o", overwrite=True)
        return file

    def problems_for(self, name: str, digest: str, parts: int, most_mm: float = inf) -> list[Problem]:
        """Why these places are not those of a tape: none if they are.

        Parameters
        ----------
        name : str
            The tape's name.
        digest : str
            `manifest_digest` of its kit.
        parts : int
            Number of its parts.
        most_mm : float
            Furthest that all parts together may be off the design; every position would be wrong by as much.

        Returns
        -------
        list of Problem
        """
        if self.manifest_sha256 != digest:
            was = "" if self.tape == name else f", of the tape {shown(self.tape)}"
            message = (
                f"manifest_sha256 = {self.manifest_sha256[:12]}... is that of another kit{was}; the manifest of {name} has "
                f"{digest[:12]}...; measure this tape, or leave the file out: --as-built none, or no --from"
            )
            return [Problem("as-built", message)]
        problems = []
        if self.tape != name:
            problems.append(Problem("as-built", f"tape = {shown(self.tape)} is not {name}; give the name of the kit's tape"))
        if len(self.number) and self.number[-1] > parts:
            message = f"designator R{self.number[-1]} exceeds R{parts}, the last part of {name}; leave it out"
            problems.append(Problem("as-built", message))
        if self.mean_mm > most_mm:
            off = f"its parts are off the design by {self.mean_mm:.3f} mm on the mean"
            message = f"{off}, more than their displacement of {most_mm:g} mm"
            problems.append(
                Problem("as-built", f"{message}; measure this tape again, or leave the file out: --as-built none, or no --from")
            )
        return problems


Given = AsBuilt | str | Path | None
"""Measured places of a kit: themselves, their file, "none", or None for the file beside the manifest."""


def as_built_of(manifest: Path, name: str, parts: int, given: Given = None, *, most_mm: float = inf) -> AsBuilt | None:
    """Measured places of the kit of a manifest; None where there are none, or nobody asks for them.

    name: The tape's name.
    parts: Number of its parts.
    given: As `Tape.load` takes it.
    most_mm: As `AsBuilt.problems_for` takes it.
    Raises SpecError if the file cannot be read, is that of another kit, or has all parts together too far off.
    """
    if given is None and not (manifest.parent / AS_BUILT_NAME).is_file():
        return None
    if isinstance(given, str) and given == NOMINAL:
        return None
    built = given if isinstance(given, AsBuilt) else AsBuilt.load(manifest.parent / AS_BUILT_NAME if given is None else given)
    problems = built.problems_for(name, manifest_digest(manifest), parts, most_mm)
    if problems:
        raise SpecError(problems)
    return built


def manifest_digest(manifest: str | Path) -> str:
    """SHA-256 of the bytes of a kit's manifest.json, in 64 hexadecimal digits."""
    digest = sha256()
    with open_regular(Path(manifest)) as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _file_of(path: Path) -> Path:
    return path / AS_BUILT_NAME if path.is_dir() else path


def _rounded(values: FloatArray, digits: int) -> list[float]:
    return [v + 0.0 for v in np.round(values, digits).tolist()]  # + 0.0: no -0.0


def _as_text(content: Mapping[str, Any]) -> str:
    """JSON with one line for each key of the tables."""
    lines = []
    for key, value in content.items():
        if key == "parts":
            inner = ",\n".join(f"    {json.dumps(name)}: {json.dumps(column)}" for name, column in value.items())
            lines.append(f"  {json.dumps(key)}: {{\n{inner}\n  }}")
        else:
            lines.append(f"  {json.dumps(key)}: {json.dumps(value, sort_keys=True)}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _content(path: Path) -> Mapping[str, Any]:
    try:
        file = _file_of(path)
        data = read_regular(file, MOST_BYTES)
        if len(data) > MOST_BYTES:
            message = f"{shown_path(file)} has more than {MOST_BYTES} bytes; it is no as-built file of this tool"
            raise SpecError(Problem("as-built", message))
        content = parse_json(data, most_values=_MOST_VALUES)
    except (OSError, ValueError) as error:
        if isinstance(error, SpecError):
            raise
        reason = getattr(error, "strerror", None) or shown(str(error))
        remedy = "give a file that inspect or survey wrote"
        raise SpecError(Problem("as-built", f"{shown_path(path)} cannot be read: {reason}; {remedy}")) from error
    if not isinstance(content, dict):
        raise SpecError(Problem("as-built", f"{shown_path(path)} holds no table; give a file that inspect or survey wrote"))
    return content


_COLUMNS = ("dx_mm", "dy_mm", "rotation_deg", "sigma_mm")
_RANGES = {
    "dx_mm": (-FARTHEST_MM, FARTHEST_MM),
    "dy_mm": (-FARTHEST_MM, FARTHEST_MM),
    "rotation_deg": (-360.0, 360.0),
    "sigma_mm": (0.0, FARTHEST_MM),
}


def _read(table: Fields) -> AsBuilt:
    if isinstance(kind := table.values.get("format"), str) and kind != AS_BUILT_FORMAT:  # its other keys mean something else
        message = f"format = {shown(kind)} is no file of measured places; give one of format '{AS_BUILT_FORMAT}', as survey makes"
        raise SpecError(Problem("as-built", message))
    table.refuse_unknown(("format", "tape", "manifest_sha256", "film", "parts", "source"))
    table.text("format", choices=(AS_BUILT_FORMAT,), remedy="this version reads no other")
    name = table.text("tape", longest=64)
    digest = table.text("manifest_sha256", pattern="[0-9a-f]{64}", remedy="give 64 hexadecimal digits")
    film = _read_film(table.table("film", ("scale", "shear", "sigma"))) if "film" in table.values else Film()
    parts = table.table("parts", ("designator", *_COLUMNS, "present"))
    names = parts.rows("designator", longest=MOST_POINTS)
    number = _numbers(parts, names)
    columns = {key: _column(parts, key, len(names)) for key in _COLUMNS}
    present = parts.rows("present", longest=MOST_POINTS)
    if len(present) != len(names) or not set(map(type, present)) <= {bool}:
        parts.problem("present", f"present is not {len(names)} of true and false; give one for each designator")
    source = _read_source(table) if "source" in table.values else ()
    if table.problems:
        raise SpecError([Problem("as-built", problem.message) for problem in table.problems])
    order = np.argsort(number, kind="stable")
    return AsBuilt(
        tape=name,
        manifest_sha256=digest,
        number=number[order],
        present=np.array(present, dtype=bool)[order],
        film=film,
        source=source,
        **{key: values[order] for key, values in columns.items()},
    )


def _read_film(table: Fields) -> Film:
    sx, sy = table.numbers("scale", 2, low=1.0 - MOST_STRETCH, high=1.0 + MOST_STRETCH, unit="")
    return Film(
        scale=(sx, sy),
        shear=table.number("shear", low=-MOST_STRETCH, high=MOST_STRETCH, unit=""),
        sigma=table.number("sigma", low=0.0, high=MOST_STRETCH, unit=""),
    )


def _numbers(parts: Fields, names: Sequence[object]) -> IntArray:
    """Numbers of designators such as R12; 1, 2, ... where one is wrong."""
    found = [
        int(name[1:])
        if isinstance(name, str) and 1 < len(name) <= 9 and name[0] == "R" and name[1:].isascii() and name[1:].isdigit()
        else 0
        for name in names
    ]
    wrong = [k for k, n in enumerate(found) if n < 1 or names[k] != f"R{n}"]
    if wrong:
        message = f"designator[{wrong[0]}] = {shown(names[wrong[0]])} is no designator; give R and a number, such as R12"
        parts.problem("designator", message + (f" ({len(wrong)} are wrong)" if len(wrong) > 1 else ""))
        return np.arange(1, len(names) + 1)
    number = np.array(found, dtype=np.int64)
    kinds, counts = np.unique(number, return_counts=True)
    if (counts > 1).any():
        parts.problem("designator", f"designator R{kinds[counts > 1][0]} occurs twice; give each part once")
    return number


def _column(parts: Fields, key: str, count: int) -> FloatArray:
    """A column of finite numbers within its range; zeros where there is a problem."""
    low, high = _RANGES[key]
    unit = "deg" if key == "rotation_deg" else "mm"
    values = parts.rows(key, longest=max(count, 1_000_000))
    if key not in parts.values or parts.refused(parts.where + key):
        return np.zeros(count)
    if len(values) != count:
        parts.problem(key, f"{key} has {len(values)} entries for {count} designators; give one for each")
        return np.zeros(count)
    if set(map(type, values)) <= {int, float}:
        try:
            column = np.array(values, dtype=np.float64).reshape(count)
        except OverflowError:  # an integer beyond any float
            column = np.full(count, np.nan)
        wrong = np.flatnonzero(~((column >= low) & (column <= high)))
        if not len(wrong):
            return column
        first = int(wrong[0])
    else:
        first = next(k for k, v in enumerate(values) if type(v) not in (int, float))
    message = f"{key}[{first}] = {shown(values[first])} is no number of {unit} from {low:g} to {high:g}; correct it"
    parts.problem(key, message)
    return np.zeros(count)


def _read_source(table: Fields) -> tuple[Mapping[str, Any], ...]:
    found = []
    for i, row in enumerate(table.rows("source", longest=MOST_SOURCES)):
        entry = Fields(row if isinstance(row, Mapping) else {}, f"source[{i}].", table.problems)
        entry.text("kind", choices=SOURCES)
        if "drift_mm" in entry.values:
            entry.number("drift_mm", low=0.0, high=FARTHEST_MM)
        try:
            size = len(json.dumps(row, allow_nan=False))
        except (ValueError, RecursionError):
            size = MOST_SOURCE_CHARACTERS + 1
        if size > MOST_SOURCE_CHARACTERS:
            message = f"source[{i}] has NaN or more than {MOST_SOURCE_CHARACTERS} characters; give less of it"
            table.problem("source", message)
        found.append(dict(entry.values))
    return tuple(found)


def _array_problems(built: AsBuilt) -> list[Problem]:
    """Faults of arrays that a program gives."""
    n = len(built.number)
    arrays: list[tuple[str, npt.NDArray[Any]]] = [(key, getattr(built, key)) for key in (*_COLUMNS, "present")]
    problems = [
        Problem("as-built", f"{key} has shape {a.shape}, not ({n},); give one value for each designator")
        for key, a in arrays
        if a.shape != (n,)
    ]
    if built.number.ndim != 1 or (n and (built.number[0] < 1 or (np.diff(built.number) <= 0).any())):
        problems.append(Problem("as-built", "number is not ascending from 1 or more; sort the parts, each once"))
    for key, (low, high) in _RANGES.items():
        values = getattr(built, key)
        if not ((values >= low) & (values <= high)).all():
            problems.append(Problem("as-built", f"{key} has values that are not from {low:g} to {high:g}; correct them"))
    return problems
