"""The picture of `verify --map`: where contacts can be located on a tape, and the outcomes of the round trip."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, reason_of
from tactape_fab.base.fields import shown_path
from tactape_fab.base.picture_file import refuse_picture, write_picture
from tactape_fab.texture.as_built import NOMINAL
from tactape_fab.texture.frames import FloatArray, board_to_picture, texture_to_board
from tactape_fab.texture.manifest import find_manifest
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.trip.coverage import Coverage, coverage_of
from tactape_fab.verify.trip.round_trip import BARELY, LIMITED, LOST, MISSED, NOISY, RIGHT, WRONG, Contact, Progress, Trip

Picture = npt.NDArray[np.uint8]

_LONGEST_PX, _LEAST_WIDTH_PX, _MARGIN_PX, _LINE_PX = 1200, 900, 60, 30
_SUBPIXEL = 4
_WHITE, _INK, _PART = (255, 255, 255), (40, 40, 40), (120, 120, 120)
_ALL, _SOME, _NONE = (247, 220, 180), (120, 225, 250), (90, 150, 235)
_GOOD, _OPEN, _BAD = (178, 90, 0), (40, 40, 40), (110, 20, 160)
"""Colours, BGR as in OpenCV: blue, yellow and orange, which colour-blind readers can tell apart, with hatching as well."""
_SIZE = -1
"""Entry of the legend for the outline of a contact; the others are outcomes of a `Trip`."""


def refuse_map(kit: str | Path, file: str | Path, *, overwrite: bool = False) -> Path:
    """Check the path of a map.

    Raises SpecError if it does not end with .png, its folder does not exist, it is taken and `overwrite` does not allow it, or it
        is in the kit, which must not have files that its manifest does not list.
    """
    path, folder = Path(file), find_manifest(kit).parent
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:
        reason = reason_of(error)
        raise SpecError(Problem("map", f"map = {shown_path(path)} cannot be looked at: {reason}; use another name")) from error
    if inside:
        message = f"map = {shown_path(path)} lies in the kit, which holds only what its manifest lists; give a place outside"
        raise SpecError(Problem("map", message))
    refuse_picture(path, "map", overwrite=overwrite)
    return path


def map_kit(
    kit: str | Path,
    path: Path,
    contact: Contact,
    trips: Sequence[Trip],
    progress: Progress = lambda *_: None,
    *,
    overwrite: bool = False,
) -> None:
    """Write the map of a kit; no map for a texture on a user's part, which is not flat.

    path: Result of `refuse_map`.
    contact: Sensor and size of the contacts.
    trips: Round trips of the kit's verification, whose contacts are drawn as well.
    progress: Called with a text, the amount done and the total.
    Raises SpecError when the manifest cannot be read.
    Raises TactapeError when the map cannot be written.
    """
    tape = Tape.load(kit, as_built=NOMINAL)
    if tape.surface is None:
        picture = draw_map(tape, coverage_of(tape, contact, progress), contact, trips)
        write_picture(path, picture, "map", overwrite=overwrite)


def draw_map(tape: Tape, coverage: Coverage, contact: Contact, trips: Sequence[Trip]) -> Picture:
    """Picture of a tape: where contacts can be located, its parts, and the contacts of a round trip.

    Returns (height, width, 3): BGR; board x to the right, y up.
    """
    width_mm, height_mm = tape.board.size_mm
    px_per_mm = _LONGEST_PX / max(width_mm, height_mm)
    board_px = np.rint(np.array([width_mm, height_mm]) * px_per_mm).astype(int)
    words = _words(tape, coverage, contact)
    legend = _legend(contact, trips)
    width = max(int(board_px[0]) + 2 * _MARGIN_PX, _LEAST_WIDTH_PX)
    top = 20 + _LINE_PX * len(words)
    height = top + int(board_px[1]) + _MARGIN_PX + _LINE_PX * len(legend)
    picture = np.full((height, width, 3), _WHITE, dtype=np.uint8)
    for line, text in enumerate(words):
        _text(picture, text, (_MARGIN_PX, 28 + _LINE_PX * line))
    board = picture[top : top + board_px[1], _MARGIN_PX : _MARGIN_PX + board_px[0]]
    board[:] = _areas(coverage, board.shape[:2])

    def to_px(xy_mm: FloatArray) -> FloatArray:
        return board_to_picture(xy_mm, (0.0, height_mm), px_per_mm)

    for x, y in to_px(tape.part_xy_mm()):
        _disc(board, (x, y), max(0.14 * tape.pitch_mm * px_per_mm, 1.0), _PART)
    for outcome in (LIMITED, NOISY, BARELY, MISSED, RIGHT, LOST, WRONG):
        for trip in trips:
            at = texture_to_board(trip.poses[trip.outcome == outcome, :2], tape.board.texture_origin_mm)
            for x, y in to_px(at):
                _mark(board, outcome, (x, y))
    _draw_size(board, contact, px_per_mm)
    _draw_scale(picture, (width_mm, height_mm), px_per_mm, (_MARGIN_PX, top))
    for line, (swatch, text) in enumerate(legend):
        at_y = top + int(board_px[1]) + _MARGIN_PX - 6 + _LINE_PX * line
        if isinstance(swatch, float):
            picture[at_y - 10 : at_y + 10, _MARGIN_PX : _MARGIN_PX + 40] = _hatched(np.full((20, 40), swatch))
        else:
            _mark(picture, swatch, (_MARGIN_PX + 20.0, float(at_y)))
        _text(picture, text, (_MARGIN_PX + 55, at_y + 6))
    return picture


def _words(tape: Tape, coverage: Coverage, contact: Contact) -> list[str]:
    size = contact.scene.contact_mm
    what = "the whole pad" if contact.scene.contact == "pad" else f"contacts of {size[0]:g} x {size[1]:g} mm"
    share = coverage.share
    return [
        f"{tape.name}: where {what} of {contact.sensor.name} can be located".encode("ascii", "replace").decode(),
        f"at any angle on {100 * (share == 1.0).mean():.0f} %, at some on {100 * ((share > 0.0) & (share < 1.0)).mean():.0f} %, "
        f"nowhere on {100 * (share == 0.0).mean():.0f} % of the board",
    ]


def _legend(contact: Contact, trips: Sequence[Trip]) -> list[tuple[float | int, str]]:
    rows: list[tuple[float | int, str]] = [
        (1.0, "centre of a contact that can be located at any angle"),
        (0.5, "... at some angles only"),
        (0.0, "... at none: too few parts lie under it, or they are too like others"),
    ]
    if contact.scene.contact != "pad":
        rows.append((_SIZE, "one such contact, to scale (lower right corner)"))
    words = {
        RIGHT: "located and right in the round trip",
        LIMITED: "not located, as it shows too little",
        NOISY: "not located in the sensor's noise",
        BARELY: "not located, as it shows barely enough",
        MISSED: "missed by the decoder, though its dots say enough",
        LOST: "not located, though the tape says enough there",
        WRONG: "located elsewhere: wrong",
    }
    for outcome, text in words.items():
        sources = {trip.source: trip.count(outcome) for trip in trips if trip.count(outcome)}
        if count := sum(sources.values()):
            rows.append((int(outcome), f"{text} ({count} contact{'s' * (count > 1)}; parts from {', '.join(sources)})"))
    return rows


def _areas(coverage: Coverage, shape: tuple[int, int]) -> Picture:
    """Picture of a coverage's cells, scaled to the board's size in pixels."""
    # nearest-neighbour scaling, as each cell is a single answer at its middle
    rows = np.arange(shape[0]) * len(coverage.y_mm) // shape[0]
    columns = np.arange(shape[1]) * len(coverage.x_mm) // shape[1]
    return _hatched(coverage.share[rows[:, None], columns[None]])


def _hatched(share: FloatArray) -> Picture:
    """Colour of each pixel, hatched in one direction if the fraction is below 1, and in both if it is 0."""
    v, u = np.indices(share.shape)
    picture = np.empty((*share.shape, 3), dtype=np.uint8)
    picture[:] = _SOME
    picture[share == 1.0], picture[share == 0.0] = _ALL, _NONE
    lines = ((u + v) % 16 < 2) & (share < 1.0) | ((u - v) % 16 < 2) & (share == 0.0)
    picture[lines] = picture[lines] * 0.7
    return picture


def _mark(picture: Picture, outcome: float, at: tuple[float, float]) -> None:
    if outcome == _SIZE:
        _ring(picture, (round(at[0]), round(at[1])), (18, 11))
    elif outcome == RIGHT:
        _disc(picture, at, 5.0, _GOOD)
    elif outcome in (LIMITED, NOISY, BARELY, MISSED):
        _disc(picture, at, 5.5, _WHITE)
        _disc(picture, at, 5.5, _OPEN, 2)
        if outcome in (NOISY, BARELY, MISSED):
            _line(picture, (at[0] - 9, at[1]), (at[0] + 9, at[1]), _OPEN, 2)
        if outcome == MISSED:
            _line(picture, (at[0], at[1] - 9), (at[0], at[1] + 9), _OPEN, 2)
    else:
        for reach, colour in ((10, _WHITE), (8, _BAD)):
            for slant in (1, -1):
                ends = [(at[0] - reach, at[1] - slant * reach), (at[0] + reach, at[1] + slant * reach)]
                _line(picture, ends[0], ends[1], colour, 8 if colour == _WHITE else 4)
        if outcome == LOST:
            _disc(picture, at, 12.0, _BAD, 3)


def _draw_size(board: Picture, contact: Contact, px_per_mm: float) -> None:
    """Outline of a contact, to scale, in the lower right corner."""
    if contact.scene.contact == "pad":
        return
    a, b = (max(round(side / 2 * px_per_mm), 1) for side in contact.scene.contact_mm)
    _ring(board, (board.shape[1] - a - 12, board.shape[0] - b - 12), (a, b))


def _ring(picture: Picture, centre: tuple[int, int], half_px: tuple[int, int]) -> None:
    import cv2

    cv2.ellipse(picture, centre, half_px, 0.0, 0.0, 360.0, _WHITE, 6, cv2.LINE_AA)
    cv2.ellipse(picture, centre, half_px, 0.0, 0.0, 360.0, _INK, 2, cv2.LINE_AA)


def _draw_scale(picture: Picture, size_mm: tuple[float, float], px_per_mm: float, corner: tuple[int, int]) -> None:
    """Draw ticks of board x below and board y on the left, mm."""
    step = next(s for s in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 10**6) if s * px_per_mm >= 60)
    left, top = corner
    bottom = top + round(size_mm[1] * px_per_mm)
    for mm in range(0, int(size_mm[0]) + 1, step):
        x = left + mm * px_per_mm
        _line(picture, (x, bottom), (x, bottom + 6), _INK, 1)
        _text(picture, f"{mm}" if mm else "0 mm", (round(x) - 6, bottom + 22), 0.42)
    for mm in range(0, int(size_mm[1]) + 1, step):
        y = bottom - mm * px_per_mm
        _line(picture, (left - 6, y), (left, y), _INK, 1)
        _text(picture, f"{mm:4d}", (left - 46, round(y) + 5), 0.42)


def _text(picture: Picture, text: str, at: tuple[int, int], size: float = 0.58) -> None:
    import cv2

    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, _INK, 1, cv2.LINE_AA)


def _fixed(at: tuple[float, float]) -> tuple[int, int]:
    # fixed-point coordinates for OpenCV's `shift`
    return round(at[0] * 2**_SUBPIXEL), round(at[1] * 2**_SUBPIXEL)


def _disc(picture: Picture, at: tuple[float, float], radius: float, colour: tuple[int, int, int], width: int = -1) -> None:
    import cv2

    cv2.circle(picture, _fixed(at), round(radius * 2**_SUBPIXEL), colour, width, cv2.LINE_AA, _SUBPIXEL)


def _line(picture: Picture, a: tuple[float, float], b: tuple[float, float], colour: tuple[int, int, int], width: int) -> None:
    import cv2

    cv2.line(picture, _fixed(a), _fixed(b), colour, width, cv2.LINE_AA, _SUBPIXEL)
