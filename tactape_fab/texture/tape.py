"""Tape: a texture and its board. Fabrication and localization both use this object."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.base.errors import Problem, SpecError, refuse
from tactape_fab.base.fields import Fields, shown
from tactape_fab.base.given_path import as_path
from tactape_fab.base.given_value import refuse_other
from tactape_fab.texture.as_built import AsBuilt, BuiltParts, Given, as_built_of
from tactape_fab.texture.board import Board, Surface, Tag, read_board, read_surface, read_tag
from tactape_fab.texture.code import ALL_CODE_NAMES, DEFAULT_CODE, get_code, read_directions
from tactape_fab.texture.directions import DIRECTIONS, USUAL_DIRECTIONS, Directions
from tactape_fab.texture.frames import (
    DIRECTIONS_XY,
    BoolArray,
    FloatArray,
    IntArray,
    SymbolArray,
    rows_to_symbols,
    snap_mm,
    symbols_to_rows,
    texture_to_board,
)
from tactape_fab.texture.manifest import find_manifest, of_kit, read_manifest
from tactape_fab.texture.part import TapePart, read_part
from tactape_fab.texture.plane import MOST_POINTS

DEFAULT_PITCH_MM, PITCH_PER_DISPLACEMENT = 1.5, 6.0
"""Default pitch W, and default ratio W / Delta."""
LEAST_PITCH_MM, MOST_PITCH_MM = 0.2, 20.0
LEAST_DISPLACEMENT_MM = 0.02
DEFAULT_GRID = (62, 32)
"""Columns and rows of the default tape, 100 x 50 mm."""
NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}"
NAME_REMEDY = "use 1 to 64 letters, digits, '.', '_', '-', a letter or digit first"
NEW_NAME_PATTERN = rf"(?!(?i:con|prn|aux|nul|com\d|lpt\d)(?:\.|$)){NAME_PATTERN}(?<!\.)"
NEW_NAME_REMEDY = f"{NAME_REMEDY}, no '.' last, and none that Windows keeps for a device, as con.1 or com1"
"""Names of folders that can be unpacked everywhere; read are those of kits that are there already as well."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tape:
    """One tape: code, place in the code plane, grid, symbols, board, part, tag.

    Attributes
    ----------
    name : str
        Name of the tape and of its files.
    sector : int
        Sector of the code.
    code : str
        Name of the code, such as ``"microdots-4x4"``.
    origin : (int, int)
        Column and row of grid point (0, 0) in the code plane.
    columns, rows : int
        Grid points along x and y.
    pitch_mm, displacement_mm : float
        W and Delta in the paper, mm.
    symbols : ndarray of uint8, shape (rows, columns)
        Read-only. The code's symbol at every grid point, including omitted ones.
    omitted : ndarray of int64, shape (k, 2)
        Read-only (column, row) of grid points that carry no part, row-major.
    board : Board
        Outline, place of the texture on it, holes (board frame, mm).
    part : TapePart
        Shape, size and rotation of the element on every grid point.
    tag : Tag or None
        The printed AprilTag, if any.
    surface : Surface or None
        The user's part that carries the texture, if any: board positions then have no meaning.
    directions : int
        Number of displacement directions: 4, or 8 for a touch code.
    as_built : AsBuilt or None
        Measured places of the parts of one made tape. Everything else is the design, except `built_parts` and `present`.
    """

    name: str
    sector: int
    code: str
    origin: tuple[int, int]
    columns: int
    rows: int
    pitch_mm: float
    displacement_mm: float
    symbols: SymbolArray
    omitted: IntArray
    board: Board
    part: TapePart
    tag: Tag | None
    surface: Surface | None = None
    directions: int = USUAL_DIRECTIONS
    as_built: AsBuilt | None = None

    def __post_init__(self) -> None:
        self.symbols.setflags(write=False)
        self.omitted.setflags(write=False)

    @property
    def placed(self) -> BoolArray:
        """Mask of the grid points that carry a part; shape (rows, columns)."""
        placed = np.ones((self.rows, self.columns), dtype=bool)
        placed[self.omitted[:, 1], self.omitted[:, 0]] = False
        return placed

    @property
    def present(self) -> BoolArray:
        """`placed` less the parts that are missing as built; shape (rows, columns)."""
        present = self.placed
        if self.as_built is not None and self.as_built.missing:
            # boolean indexing is row-major, as are designators
            present[present] = self.built_parts().present
        return present

    @property
    def part_count(self) -> int:
        """Number of parts: grid points that are not omitted."""
        return self.rows * self.columns - len(self.omitted)

    @property
    def points_in(self) -> Directions:
        """The displacement directions."""
        return DIRECTIONS[self.directions]

    @property
    def in_directions(self) -> str:
        """Text about the directions that messages put after the displacement; empty for four directions."""
        return "" if self.points_in.usual else f" in {self.directions} directions"

    @property
    def texture_key(self) -> tuple[Hashable, ...]:
        """Key that is equal for two tapes which a touch cannot tell apart, grid, pitch and displacement aside."""
        return get_code(self.code).texture_key(self.sector, self.origin, self.symbols)

    def cells(self) -> IntArray:
        """(column, row) of every placed part in designator order R1 ... Rn: row-major; shape (n, 2)."""
        row, column = np.nonzero(self.placed)
        return np.stack([column, row], axis=1)

    def part_xy_mm(self) -> FloatArray:
        """Nominal part centres in the board frame, designator order, snapped to 1 nm; shape (n, 2), mm."""
        # column and row, as x and y; arrays of the grid are indexed by row and column
        cells = self.cells()
        symbols = self.symbols[cells[:, 1], cells[:, 0]]
        # paper, Eq. 9: a part is at W times its cell, and Delta in its symbol's direction
        texture_mm = cells * self.pitch_mm + self.displacement_mm * DIRECTIONS_XY[symbols]
        return snap_mm(texture_to_board(texture_mm, self.board.texture_origin_mm))

    def built_parts(self) -> BuiltParts:
        """Shift from `part_xy_mm`, turn, presence and sigma of every part in designator order; nominal without `as_built`."""
        n = self.part_count
        if self.as_built is None:
            return BuiltParts(
                shift_mm=np.zeros((n, 2)), rotation_deg=np.zeros(n), present=np.ones(n, dtype=bool), sigma_mm=np.zeros(n)
            )
        return self.as_built.parts(self.part_xy_mm())

    def designators(self) -> list[str]:
        """R1 ... Rn, row-major from grid point (0, 0), placed parts only."""
        return [f"R{i}" for i in range(1, self.part_count + 1)]

    def to_mapping(self) -> dict[str, Any]:
        """The tape's entries of manifest.json."""
        return {
            "name": self.name,
            "sector": self.sector,
            "code": self.code,
            "origin": list(self.origin),
            "columns": self.columns,
            "rows": self.rows,
            "pitch_mm": self.pitch_mm,
            "displacement_mm": self.displacement_mm,
            **({} if self.points_in.usual else {"directions": self.directions}),
            "board": {**_plain(self.board), "holes": [list(h) for h in self.board.holes]},
            "part": _plain(self.part),
            "symbols": symbols_to_rows(self.symbols),
            **get_code(self.code).digest_entry(self.symbols),
            "omitted": self.omitted.tolist(),
            "tag": None if self.tag is None else _plain(self.tag),
            **({} if self.surface is None else {"surface": _plain(self.surface)}),
        }

    @classmethod
    def from_mapping(cls, manifest: Mapping[str, Any]) -> Tape:
        """Read the tape from a manifest's content; every value is checked.

        Parameters
        ----------
        manifest : mapping
            Content of a kit's manifest.json.

        Returns
        -------
        Tape

        Raises
        ------
        SpecError
            Every problem found: missing or impossible values, symbols that the code does not have at that place.
        """
        refuse_other(manifest, Mapping, "manifest", "mapping", "the content of a kit's manifest.json")
        return _read_tape(Fields(manifest))

    @classmethod
    def load(cls, path: str | Path, *, as_built: Given = None) -> Tape:
        """Load a tape from a kit folder or its manifest.json.

        Parameters
        ----------
        path : str or Path
            Folder of a kit, or its manifest.json.
        as_built : AsBuilt, str, Path or None
            Measured places of its parts, or their file; None for as-built.json beside the manifest, if it is there; "none" for
            the places of the design.

        Returns
        -------
        Tape

        Raises
        ------
        SpecError
            If there is no kit at `path`, its manifest cannot be read or contradicts itself, or the measured places are those
            of another kit.
        """
        file = find_manifest(path)
        try:
            return cls.from_mapping(read_manifest(file)).with_as_built(file, as_built)
        except SpecError as error:
            raise type(error)([of_kit(Path(path), problem) for problem in error.problems]) from error

    def with_as_built(self, manifest: str | Path, as_built: Given = None) -> Tape:
        """The tape with the measured places of its parts.

        Parameters
        ----------
        manifest : str or Path
            Path of the manifest.
        as_built : AsBuilt, str, Path or None
            As for `load`.

        Returns
        -------
        Tape

        Raises
        ------
        SpecError
            As `load`.
        """
        manifest = as_path(manifest, "manifest", "the manifest.json of a kit")
        built = as_built_of(manifest, self.name, self.part_count, as_built, most_mm=self.displacement_mm)
        return self if built is None else replace(self, as_built=built)


def no_tape(value: object, remedy: str = "Tape.load(KIT)") -> Problem:
    """The problem of an argument that is not a tape."""
    return Problem("tape", f"tape = {shown(value)} is no tape; give {remedy}")


def refuse_no_tape(value: object) -> None:
    """Refuse an argument that is not a tape, such as the path of one. Raises SpecError."""
    if not isinstance(value, Tape):
        raise SpecError(no_tape(value))


def refuse_no_tapes(values: object, key: str) -> None:
    """Refuse an argument that is not a list of tapes, such as the path of a kit. Raises SpecError."""
    if not isinstance(values, Sequence) or not all(isinstance(value, Tape) for value in values):
        raise SpecError(Problem(key, f"{key} = {shown(values)} is no list of tapes; give [Tape.load(KIT), ...]"))


def _plain(record: Board | TapePart | Tag | Surface) -> dict[str, Any]:
    values = (
        (f.name, getattr(record, f.name))
        for f in fields(record)
        if f.name != "flexible" and (f.name != "top_mm" or getattr(record, f.name) is not None)
    )
    return {name: list(v) if isinstance(v, tuple) else v for name, v in values}


def read_pitch(table: Fields, key: str) -> float:
    """W of a tape that is to be made or found without its manifest, mm; the default if it is refused."""
    remedy = f"--w is the grid pitch in millimetres, {LEAST_PITCH_MM} to {MOST_PITCH_MM:g}, usually {DEFAULT_PITCH_MM}"
    return table.number(key, low=LEAST_PITCH_MM, high=MOST_PITCH_MM, remedy=remedy, default=DEFAULT_PITCH_MM)


def read_displacement(table: Fields, key: str, pitch_mm: float, *, pitch_refused: bool) -> float:
    """Delta of such a tape of pitch `pitch_mm`, mm; the default if it is not given, or it or the pitch is refused."""
    usual = pitch_mm / PITCH_PER_DISPLACEMENT
    if key not in table.values:
        return usual
    remedy = f"--delta is the displacement in millimetres, {LEAST_DISPLACEMENT_MM} to less than half the pitch {pitch_mm:g}"
    below = inf if pitch_refused else pitch_mm / 2
    remedy += f", usually {usual:.3g}"
    found = table.number(key, low=LEAST_DISPLACEMENT_MM, below=below, remedy=remedy, default=usual)
    return usual if pitch_refused else found


def _flexible(table: Fields) -> bool | None:
    """Whether the fab's material can be bent, where a manifest says it."""
    found: object = table.values
    for key in ("fab", "material", "flexible"):
        found = found.get(key) if isinstance(found, Mapping) else None
    return found if isinstance(found, bool) else None


def _read_tape(table: Fields) -> Tape:
    code = get_code(table.text("code", choices=ALL_CODE_NAMES, default=DEFAULT_CODE))
    sector = table.integer("sector", low=0, high=code.sectors - 1)
    origin = table.integers("origin", 2, low=0, high=code.range - 1)
    columns = table.integer("columns", low=code.window, high=code.range, default=code.window)
    rows = table.integer("rows", low=code.window, high=code.range, default=code.window)
    name = table.text("name", pattern=NAME_PATTERN, remedy=NAME_REMEDY)
    pitch_mm = table.number("pitch_mm", above=0.0, high=100.0, default=1.0)
    # from W / 2 on, a part would be as near to a neighbouring grid point as to its own
    displacement_mm = table.number("displacement_mm", above=0.0, below=pitch_mm / 2, default=pitch_mm / 6)
    directions = read_directions(table, code)
    board = replace(read_board(table.table("board")), flexible=_flexible(table))
    part = read_part(table.table("part"))
    if "tag" not in table.values:
        table.problem("tag", "tag is missing; give a table, or null for a tape without one")
    tag = None if table.values.get("tag") is None else read_tag(table.table("tag"))
    surface = read_surface(table.table("surface")) if "surface" in table.values else None
    if columns * rows > MOST_POINTS:
        table.problem("columns", f"columns x rows = {columns} x {rows} exceeds {MOST_POINTS} grid points")
    refuse(table.problems)
    symbols = _read_symbols(table, rows, columns, directions)
    code.check_symbols(symbols, sector, (origin[0], origin[1]), table)
    return Tape(
        name=name,
        sector=sector,
        code=code.name,
        origin=(origin[0], origin[1]),
        columns=columns,
        rows=rows,
        pitch_mm=pitch_mm,
        displacement_mm=displacement_mm,
        symbols=symbols,
        omitted=_read_omitted(table, rows, columns),
        board=board,
        part=part,
        tag=tag,
        surface=surface,
        directions=directions,
    )


def _read_symbols(table: Fields, rows: int, columns: int, directions: int) -> SymbolArray:
    texts = table.rows("symbols", longest=rows)
    if len(texts) != rows or not all(isinstance(t, str) and len(t) == columns for t in texts):
        raise SpecError(Problem("symbols", f"symbols is not {rows} strings of {columns} letters; make the kit again"))
    try:
        return rows_to_symbols(texts, directions)
    except ValueError as error:
        raise SpecError(Problem("symbols", str(error))) from error


def _read_omitted(table: Fields, rows: int, columns: int) -> IntArray:
    entries = table.rows("omitted", longest=rows * columns)
    inside = all(
        isinstance(e, list)
        and len(e) == 2
        and all(isinstance(i, int) and not isinstance(i, bool) for i in e)
        and 0 <= e[0] < columns
        and 0 <= e[1] < rows
        for e in entries
    )
    if table.problems or not inside:
        message = "omitted is not a list of [column, row] inside the grid; make the kit again"
        raise SpecError(table.problems or Problem("omitted", message))
    omitted = np.array(entries, dtype=np.int64).reshape(-1, 2)
    # a point listed twice is one point in the mask, but two in `part_count`
    if len(set(map(tuple, omitted.tolist()))) != len(omitted):
        raise SpecError(Problem("omitted", "omitted names a grid point twice; make the kit again"))
    return omitted
