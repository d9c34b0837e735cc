"""AsBuilt: measured places of the parts of one made tape, and the check that they belong to a given kit."""

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
"""Value of `as_built` that asks for the nominal places instead of measured ones."""
_FILE = "a file of measured places, or the folder of a kit"
TAKE_DESIGN = f"give as_built='{NOMINAL}'"
_OF_DESIGN = f"{TAKE_DESIGN} for the places of the design"
_OTHERWISE = f"measure this tape again, or {_OF_DESIGN}"
LEAST_MEASURED = 10
"""Least number of measured parts whose scatter is taken as the sigma of unmeasured parts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Film:
    """Stretch of the whole film: a point (x, y) of the design is at (sx x + k y, sy y), board frame, mm.

    Attributes
    ----------
    scale : (float, float)
        sx and sy, near 1.
    shear : float
        k, the tangent of the y axis's lean towards x.
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
    """Places of all parts of a tape in designator order, measured or not, for the decoder and the simulator.

    shift_mm (n, 2): Real less nominal place, stretch of the film included, board frame; for a part that was not measured, the
        stretch alone.
    rotation_deg (n,): Real less nominal rotation, counter-clockwise seen from above.
    present (n,)
    sigma_mm (n,): Standard deviation of the place along each axis. For a part that is not listed it is the scatter of the listed
        ones, or 0 where fewer than `LEAST_MEASURED` are listed.
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
        JSON can hold. ``drift_mm`` of the last is the standard deviation, along each axis, of the error that neighbouring parts
        have in common; it is part of `sigma_mm`.

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
            If this is not an array of places, or it has fewer parts than were measured.
        """
        nominal_mm = as_numbers(nominal_mm, (None, 2), "nominal_mm", "Tape.part_xy_mm() of the tape")
        n, at = len(nominal_mm), self.number - 1
        if len(at) and at[-1] >= n:
            message = f"nominal_mm has {n} parts, {self.tape} has more; give Tape.part_xy_mm() of it"
            raise SpecError(Problem("nominal_mm", message))
        # parts that nobody measured scatter as the measured ones do, if enough of these are there to estimate it
        unlisted = self.scatter_mm if self.present.sum() >= LEAST_MEASURED else 0.0
        # F p + d less p, with p as rows
        shift = nominal_mm @ (self.film.matrix - np.eye(2)).T
        np.add.at(shift, at, np.stack([self.dx_mm, self.dy_mm], axis=1))
        rotation, present, sigma = np.zeros(n), np.ones(n, dtype=bool), np.full(n, unlisted)
        rotation[at], present[at], sigma[at] = self.rotation_deg, self.present, self.sigma_mm
        return BuiltParts(shift_mm=shift, rotation_deg=rotation, present=present, sigma_mm=sigma)

    @property
    def scatter_mm(self) -> float:
        """Root mean square of dx and dy over the parts that are present; 0 without any."""
        d = np.concatenate([self.dx_mm[self.present], self.dy_mm[self.present]])
        return float(np.sqrt((d**2).mean())) if len(d) else 0.0

    @property
    def mean_mm(self) -> float:
        """Length of the mean of (dx, dy) over the parts that are present; 0 without any."""
        there = self.present
        # dx and dy do not include the film's stretch, so that this is a common shift of all parts
        return float(np.hypot(self.dx_mm[there].mean(), self.dy_mm[there].mean())) if there.any() else 0.0

    @property
    def drift_mm(self) -> float:
        """Standard deviation along each axis of the error common to neighbouring parts, which a located position has as well."""
        value = self.source[-1].get("drift_mm", 0.0) if self.source else 0.0
        return float(value) if isinstance(value, int | float) and 0.0 <= value <= FARTHEST_MM else 0.0

    @property
    def missing(self) -> int:
        """Number of listed parts that are missing."""
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
            The file's parsed JSON; untrusted.

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
        except SpecError as error:  # the file is named, as the kit's manifest has keys of the same names
            at = f"{shown_path(file_of(file))}: "
            raise SpecError([replace(problem, message=at + problem.message) for problem in error.problems]) from None

    def write(self, path: str | Path) -> Path:
        """Write the file; equal places give equal bytes. An existing file is replaced atomically, a link never.

        Parameters
        ----------
        path : str or Path
            The file, or the folder of a kit, which then gets as-built.json.

        Returns
        -------
        Path
            The written file.

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
        """Reasons why these places cannot be those of a given kit; empty if they can.

        Parameters
        ----------
        name : str
            The tape's name.
        digest : str
            `manifest_digest` of its kit.
        parts : int
            Number of its parts.
        most_mm : float
            Largest accepted `mean_mm`: every located position would be wrong by as much.

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
    """Measured places of the kit of a manifest; None if there are none, or `given` asks for the nominal places.

    name: The tape's name.
    parts: Number of its parts.
    given: As `Tape.load` takes it.
    most_mm: As `AsBuilt.problems_for` takes it.
    Raises SpecError if the file cannot be read, belongs to another kit, or has a mean shift above `most_mm`.
    """
    if given is None and not _is_beside(manifest.parent / AS_BUILT_NAME):
        return None
    if isinstance(given, str) and given == NOMINAL:
        return None
    built = given if isinstance(given, AsBuilt) else AsBuilt.load(manifest.parent / AS_BUILT_NAME if given is None else given)
    refuse(built.problems_for(name, manifest_digest(manifest), parts, most_mm))
    return built


def _is_beside(path: Path) -> bool:
    """Whether as-built.json is beside a manifest. Raises SpecError if something else has that name."""
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
    """Refuse an output path for measured places if its folder does not exist or another file is there. Raises SpecError."""
    refuse_taken_place(path, key, ours=lambda file: AsBuilt.load(file) is not None, kind="no file of places")


def refuse_other_kit(path: Path, digest: str, key: str) -> None:
    """Refuse an output path for measured places where they would be read as those of another kit.

    digest: `manifest_digest` of the kit that was measured.
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
    """Problems of the constructor's arrays: lengths, order and ranges."""
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
