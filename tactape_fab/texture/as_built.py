"""AsBuilt: where the parts of one made tape really are, as measured, and whether that is of a given kit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, reason_of, refuse
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.given_path import as_path
from tactape_fab.base.given_value import as_numbers, refuse_other
from tactape_fab.base.input_file import mode_of, sha256_of
from tactape_fab.base.output_file import refuse_taken_place, write_file
from tactape_fab.texture.as_built_file import (
    AS_BUILT_FORMAT,
    AS_BUILT_NAME,
    FARTHEST_MM,
    RANGES,
    as_text,
    content_of,
    file_of,
    read_values,
    rounded,
)
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray
from tactape_fab.texture.manifest import MANIFEST_NAME

NOMINAL = "none"
"""Given in the place of a file: the places of the design."""
_FILE = "a file of measured places, or the folder of a kit"
TAKE_DESIGN = f"give as_built='{NOMINAL}'"
_OF_DESIGN = f"{TAKE_DESIGN} for the places of the design"
_OTHERWISE = f"measure this tape again, or {_OF_DESIGN}"
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
        refuse(_array_problems(self))
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

        Raises
        ------
        SpecError
            If these are no places, or there are fewer than were measured.
        """
        nominal_mm = as_numbers(nominal_mm, (None, 2), "nominal_mm", "Tape.part_xy_mm() of the tape")
        n, at = len(nominal_mm), self.number - 1
        if len(at) and at[-1] >= n:
            message = f"nominal_mm has {n} parts, {self.tape} has more; give Tape.part_xy_mm() of it"
            raise SpecError(Problem("nominal_mm", message))
        # nobody looked at the others: they scatter as the measured ones do, and a few measured ones do not say how much
        unlisted = self.scatter_mm if self.present.sum() >= LEAST_MEASURED else 0.0
        # F p + d less p, with p as rows
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
        # the film's stretch is taken out of dx and dy, so that this is a shift of all parts alone
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
                "dx_mm": rounded(self.dx_mm, 6),
                "dy_mm": rounded(self.dy_mm, 6),
                "rotation_deg": rounded(self.rotation_deg, 3),
                "present": self.present.tolist(),
                "sigma_mm": rounded(self.sigma_mm, 6),
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
        refuse_other(content, Mapping, "content", "mapping", "what a file of measured places holds")
        values = read_values(Fields(content))
        return cls(**{**values, "film": Film(**values["film"])})

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
        file = as_path(path, "as_built", _FILE)
        content = content_of(file)
        try:
            return cls.from_mapping(content)
        except SpecError as error:  # named: keys of the kit's manifest are called alike
            said = f"{shown_path(file_of(file))}: "
            raise SpecError([replace(problem, message=said + problem.message) for problem in error.problems]) from None

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
            If it cannot be written; an older file is left unchanged.
        """
        file = file_of(as_path(path, "path", _FILE))
        write_file(file, as_text(self.to_mapping()).encode("utf-8"), "o", overwrite=True)
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
                f"{digest[:12]}...; measure this tape, or {_OF_DESIGN}"
            )
            return [Problem("as-built", message)]
        problems = []
        if self.tape != name:
            problems.append(Problem("as-built", f"tape = {shown(self.tape)} is not {name}; give the name of the kit's tape"))
        if len(self.number) and self.number[-1] > parts:
            message = f"designator R{self.number[-1]} exceeds R{parts}, the last part of {name}; leave it out"
            problems.append(Problem("as-built", message))
        if parts and self.missing >= parts:
            message = f"present is false for all {parts} parts of {name}, which then has nothing to locate by"
            problems.append(Problem("as-built", f"{message}; {_OTHERWISE}"))
        if self.mean_mm > most_mm:
            off = f"its parts are off the design by {self.mean_mm:.3f} mm on the mean"
            message = f"{off}, more than their displacement of {most_mm:g} mm"
            problems.append(Problem("as-built", f"{message}; {_OTHERWISE}"))
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
    if given is None and not _is_beside(manifest.parent / AS_BUILT_NAME):
        return None
    if isinstance(given, str) and given == NOMINAL:
        return None
    built = given if isinstance(given, AsBuilt) else AsBuilt.load(manifest.parent / AS_BUILT_NAME if given is None else given)
    refuse(built.problems_for(name, manifest_digest(manifest), parts, most_mm))
    return built


def _is_beside(path: Path) -> bool:
    """Whether a kit has measured places. Raises SpecError where something else has their name, and would be taken for them."""
    try:
        if mode_of(path) is None:
            return False
        if path.is_file():
            return True
        what = "a folder" if path.is_dir() else "a link to nothing" if path.is_symlink() else "no regular file"
    except (OSError, ValueError) as error:
        what = f"not to be looked at ({reason_of(error)})"
    message = f"{shown_path(path)} is {what}, and measured places are looked for there; remove it, or {_OF_DESIGN}"
    raise SpecError(Problem("as-built", message))


def refuse_other_places(path: Path, key: str) -> None:
    """Refuse a path for measured places, named by an option, in no folder or where something else lies. Raises SpecError."""
    refuse_taken_place(path, key, ours=lambda file: AsBuilt.load(file) is not None, kind="no file of places")


def refuse_other_kit(path: Path, digest: str, key: str) -> None:
    """Refuse a path for measured places, named by an option, where they would be taken for those of another kit.

    digest: `manifest_digest` of the kit that they are of.
    Raises SpecError.
    """
    manifest = path.parent / MANIFEST_NAME
    if path.name == AS_BUILT_NAME and manifest.is_file() and manifest_digest(manifest) != digest:
        message = f"{key} = {shown_path(path)} is where the places of another kit belong, that of {shown_path(manifest)}"
        raise SpecError(Problem(key, f"{message}; nothing was touched; give the folder of this kit, or another name"))


def manifest_digest(manifest: str | Path) -> str:
    """SHA-256 of the bytes of a kit's manifest.json, in 64 hexadecimal digits."""
    return sha256_of(Path(manifest))


def _array_problems(built: AsBuilt) -> list[Problem]:
    """Faults of arrays that a program gives."""
    for key, kinds in {"number": "iu", "present": "b", **dict.fromkeys(RANGES, "fiu")}.items():
        array = getattr(built, key)
        if not isinstance(array, np.ndarray) or array.ndim == 0 or array.dtype.kind not in kinds:
            return [Problem("as-built", f"{key} = {shown(array)} is no array of its kind; give one value for each designator")]
    n = len(built.number)
    arrays: list[tuple[str, npt.NDArray[Any]]] = [(key, getattr(built, key)) for key in (*RANGES, "present")]
    problems = [
        Problem("as-built", f"{key} has shape {a.shape}, not ({n},); give one value for each designator")
        for key, a in arrays
        if a.shape != (n,)
    ]
    if built.number.ndim != 1 or (n and (built.number[0] < 1 or (built.number[1:] <= built.number[:-1]).any())):
        problems.append(Problem("as-built", "number is not ascending from 1 or more; sort the parts, each once"))
    for key, (low, high) in RANGES.items():
        values = getattr(built, key)
        if not ((values >= low) & (values <= high)).all():
            problems.append(Problem("as-built", f"{key} has values that are not from {low:g} to {high:g}; correct them"))
    return problems
