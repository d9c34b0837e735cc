"""Codes of textures: their common interface, and all existing codes.

Differences between codes are attributes and methods of these objects; no caller tests a code's name. To add a code, add an object
to `CODES`.
"""

from __future__ import annotations

from numbers import Integral

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import Fields, shown
from tactape_fab.texture.directions import DIRECTIONS, USUAL_DIRECTIONS
from tactape_fab.texture.plane import Plane, PlaneCode
from tactape_fab.texture.sequences import anoto_main, anoto_secondary, de_bruijn
from tactape_fab.texture.touch.design import HIGHER_RUNGS, MOST_TOUCH_POINTS, RUNGS
from tactape_fab.texture.touch.designed import DesignedCode
from tactape_fab.texture.trace import TraceCode

Code = PlaneCode | TraceCode | DesignedCode
"""A code; all have these attributes and methods.

window, range: Least and largest number of columns, and of rows, of a tape.
most_points: Largest number of grid points of a tape.
directions: Allowed numbers of displacement directions.
plane: The code plane, of which a tape shows the patch at a given or searched origin. None if each tape's matrix is designed:
    its origin is (0, 0), every size is another texture, and the symbols are stored only in the tape itself.
sequences: The plane, if it is made of number sequences along its axes.
half_turns: Whether it has separate distances for tapes whose parts show their quarter turn, as long parts do.
proven: Proven least distance in bits, by shape of `touch.patches.PATCHES`, between patches at any two places of all sectors
    at a known turn; empty if nothing is proven.
proven_by: Proof of a tape's symbols, for messages after "symbols ...".
another: Option that selects another texture.
default_origin: Default (column, row) of a sector's tape.
symbols: Symbols of a new tape of a shape (rows, columns); a designed matrix differs from those of `avoid`. `half_turns` says
    that the tape's parts show a quarter turn, so that a design may demand larger distances at 0 and 180 degrees.
extended: A texture's symbols on a grid of another shape (rows, columns); equal textures have equal ones.
texture_key: Key that is equal for two tapes which a touch cannot tell apart, grid, pitch and displacement aside.
digest_entry: Manifest entries with a digest of the symbols; empty where the code determines them.
check_symbols: Refuse symbols of a manifest that are not the code's at that place, or do not match their digest.
"""

DEFAULT_CODE = "microdots-4x4"
TOUCH_CODE = "touch-1"
_CODES: tuple[Code, ...] = (
    PlaneCode(
        name=DEFAULT_CODE,
        main=de_bruijn(2, 4),
        secondary=(de_bruijn(3, 3), de_bruijn(5, 3)),
        # with digits 0 to 2 and 0 to 4 the differences are 1 to 15: 0 would make two columns alike
        least_difference=1,
        # 255 strides of 12 and a tape of 315 points fit in the 3,375 of the plane
        origin_stride=12,
    ),
    PlaneCode(
        name="debruijn-4x4",
        main=de_bruijn(2, 4),
        # all 16 differences, one sequence: 4,096 columns, as the paper says of a main sequence of 16 (16^3)
        secondary=(de_bruijn(16, 3),),
        least_difference=0,
        origin_stride=12,
    ),
    PlaneCode(
        name="anoto-6x6",
        main=anoto_main(),
        # 54 differences, 5 to 58, of digits with the weights 1, 3, 9 and 18
        secondary=anoto_secondary(),
        least_difference=5,
        origin_stride=1000,
    ),
    TraceCode(
        name="trace-22",
        degree=22,
        polynomial=0x21C8AB,
        # the best constants of some thousand random ones (docs/codes.md); 129 is more than the 127 columns, so that rows do not
        # overlap, and 129 * 127 * 256 exponents are fewer than the 2^22 - 1 there are
        columns_apart=129,
        y_exponent=429093,
        range=127,
        sectors=256,
        # counted over the whole field: the minimum weight of the linear code of each shape
        proven={"3x3": 0, "disc-12": 2, "4x4": 4, "disc-21": 6, "5x5": 9},
    ),
    DesignedCode(name=TOUCH_CODE, window=4, sectors=4096, range=2000, most_points=MOST_TOUCH_POINTS, rungs=RUNGS),
    DesignedCode(
        name="touch-2",
        window=4,
        sectors=4096,
        range=2000,
        most_points=MOST_TOUCH_POINTS,
        rungs=HIGHER_RUNGS,
        half_turns=True,
    ),
)
CODES = {code.name: code for code in _CODES}
"""Every code by its name."""
ALL_CODE_NAMES = tuple(CODES)
CODE_NAMES = tuple(code.name for code in _CODES if code.plane is not None)
"""Codes with a plane."""


def get_code(name: str) -> Code:
    """The code of that name. Raises SpecError if no code has that name."""
    if not isinstance(name, str) or name not in CODES:
        raise SpecError(Problem("code", f"code = {shown(name)} is none of: {', '.join(ALL_CODE_NAMES)}"))
    return CODES[name]


def get_plane(name: str) -> Plane:
    """The code of that name, which has a plane. Raises SpecError if no code with a plane has that name."""
    known = isinstance(name, str) and name in CODES
    plane = CODES[name].plane if known else None
    if plane is None and known:
        message = "has no code plane: only a tape's manifest holds its symbols; name the tape's kit"
        raise SpecError(Problem("code", f"code = {shown(name)} {message}"))
    if plane is None:
        raise SpecError(Problem("code", f"code = {shown(name)} is none of: {', '.join(CODE_NAMES)}"))
    return plane


def has_plane(name: object) -> bool:
    """Whether the code of that name has a plane; an unknown name counts as one that has."""
    return not isinstance(name, str) or name not in CODES or CODES[name].plane is not None


def default_origin(code: str, sector: int) -> tuple[int, int]:
    """Default (column, row) in the code plane of a sector's tape.

    Tapes of up to 166 x 166 points at the default origins of two sectors never overlap in the plane, so that sectors are not
    shifts of one another (`PlaneCode.default_origin`). Tapes of a code without a plane begin at (0, 0).

    Parameters
    ----------
    code : str
        Name of the code.
    sector : int
        0 ... sectors - 1.

    Returns
    -------
    tuple of int
        (column, row).

    Raises
    ------
    SpecError
        If the code is unknown or the sector out of its range.
    """
    of = get_code(code)
    given: object = sector
    if isinstance(given, bool) or not isinstance(given, Integral):
        raise SpecError(Problem("sector", f"sector = {given!r} is not a whole number; give one from 0 to {of.sectors - 1}"))
    sector = int(given)
    if not 0 <= sector < of.sectors:
        raise SpecError(Problem("sector", f"sector = {sector} is outside 0 to {of.sectors - 1} of code '{code}'"))
    return of.default_origin(sector)


def read_directions(table: Fields, code: Code | None) -> int:
    """Number of displacement directions that the code allows, any known one if `code` is None; default `USUAL_DIRECTIONS`."""
    directions = table.values.get("directions", USUAL_DIRECTIONS)
    if isinstance(directions, bool) or not isinstance(directions, int) or directions not in DIRECTIONS:
        known = " nor ".join(map(str, DIRECTIONS))
        table.problem("directions", f"directions = {shown(directions)} is neither {known}; give one of them")
        return USUAL_DIRECTIONS
    if code is not None and directions not in code.directions:
        others = [other.name for other in _CODES if directions in other.directions]
        message = f"directions = {directions} of code '{code.name}': only {' and '.join(others)} have {directions}"
        table.problem("directions", f"{message}; use --code {others[0]}, or --directions {USUAL_DIRECTIONS}")
    return directions
