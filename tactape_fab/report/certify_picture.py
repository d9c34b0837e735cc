"""Pictures of certificates: a map of one tape's nearest windows, or a matrix of distances between several tapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tactape_fab.texture.certify.certificate import Certificate, Closest, nearest_distances
from tactape_fab.texture.certify.kits import Certified
from tactape_fab.texture.certify.pairs import BEYOND, NO_WINDOWS, Across
from tactape_fab.texture.tape import Tape

Picture = npt.NDArray[np.uint8]
Colour = tuple[int, int, int]

_SHADES = np.array(
    [(20, 10, 10), (110, 20, 90), (120, 55, 200), (90, 150, 250), (150, 215, 250), (240, 240, 240)], dtype=np.uint8
)
"""Colours of distances 0, 1, ... and `BEYOND`, BGR: lighter is farther, also distinct in grey."""
_PAPER, _INK, _FAINT, _MARK = (255, 255, 255), (40, 40, 40), (215, 215, 215), (178, 114, 0)
_MARGIN, _LINE, _FONT = 30, 22, 0.5
_FIELD_PX, _LEAST_WIDTH_PX, _MOST_CELL_PX, _MATRIX_PX = 1240, 900, 24, 420
_MARKED = 6
_NAMED = 24


def draw_certified(result: Certified) -> Picture:
    """Picture of certificates: for each window size a map of one tape, or a matrix of several.

    Returns (height, width, 3): BGR.
    """
    if len(result.certificates) == 1:
        certificate = result.certificates[0]
        cell = min(max(_FIELD_PX // certificate.tape.columns, 1), _MOST_CELL_PX)
        first, *others = (
            _map(certificate, size, cell if i == 0 else max(cell // 2, 1)) for i, size in enumerate(certificate.sizes)
        )
        panels = [first, *([_beside(others)] if others else [])]
        title = f"{certificate.tape.name}: which windows are hard to tell apart (dark), and the nearest pairs (same number)"
        return _sheet(title, _stacked(panels), "symbols by which the nearest other window differs")
    panels = [_matrix(windows, result.names) for windows in result.across]
    title = "how far every two tapes are apart (dark: hard to tell apart)"
    return _sheet(title, _beside(panels), "symbols by which their nearest windows differ")


def _text(picture: Picture, text: str, x: int, y: int, colour: Colour = _INK) -> None:
    import cv2

    shown = text.encode("ascii", "replace").decode()
    cv2.putText(picture, shown, (x, y), cv2.FONT_HERSHEY_SIMPLEX, _FONT, colour, 1, cv2.LINE_AA)


def _text_width(text: str) -> int:
    import cv2

    return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _FONT, 1)[0][0])


def _blank(height: int, width: int) -> Picture:
    return np.full((height, width, 3), _PAPER, dtype=np.uint8)


def _padded(picture: Picture, height: int, width: int) -> Picture:
    page = _blank(height, width)
    page[: picture.shape[0], : picture.shape[1]] = picture
    return page


def _stacked(panels: list[Picture]) -> Picture:
    width = max(p.shape[1] for p in panels)
    return np.vstack([_padded(p, p.shape[0] + _MARGIN // 2, width) for p in panels])


def _beside(panels: list[Picture]) -> Picture:
    height = max(p.shape[0] for p in panels)
    return np.hstack([_padded(p, height, p.shape[1] + _MARGIN * (i + 1 < len(panels))) for i, p in enumerate(panels)])


def _sheet(title: str, body: Picture, key: str) -> Picture:
    """Title, body, and the legend of the shades."""
    height = body.shape[0] + 2 * _MARGIN + 2 * _LINE + _LINE
    page = _blank(height, max(body.shape[1] + 2 * _MARGIN, _LEAST_WIDTH_PX))
    _text(page, title, _MARGIN, _MARGIN)
    top = _MARGIN + _LINE
    page[top : top + body.shape[0], _MARGIN : _MARGIN + body.shape[1]] = body
    x, y = _MARGIN, top + body.shape[0] + _LINE + 8
    _text(page, key + ":", x, y)
    x += _text_width(key + ":") + 15
    for distance, shade in enumerate(_SHADES.tolist()):
        page[y - 14 : y + 4, x : x + 26] = _INK
        page[y - 13 : y + 3, x + 1 : x + 25] = shade
        _text(page, f"{distance}+" if distance == BEYOND else str(distance), x + 32, y)
        x += 70
    return page


def _map(certificate: Certificate, size: Closest, cell: int) -> Picture:
    """Map of a tape with each window as a square at its middle; the first nearest pairs are outlined, with a number per pair."""
    tape = certificate.tape
    field = _field(tape, size.side, cell)
    if size.distance is None:
        texts = ["no whole window"]
    else:
        pairs = f"{size.pairs} pair{'s' * (size.pairs != 1)}"
        texts = [f"at least {size.distance} symbols differ ({pairs})", f"detects {size.detects} wrong, corrects {size.corrects}"]
    lines = [f"{size.side}x{size.side}: {texts[0]}", *texts[1:]]
    if _text_width("; ".join(lines)) <= field.shape[1]:
        lines = ["; ".join(lines)]
    head = _blank(_LINE * len(lines), max(field.shape[1], *map(_text_width, lines)))
    for i, line in enumerate(lines):
        _text(head, line, 0, _LINE * (i + 1) - 8)
    windows = [(i, *rc) for i in range(min(len(size.turn), _MARKED)) for rc in (size.first_rc[i], size.second_rc[i])]
    corners = [(int(column) * cell, int(row) * cell) for _, row, column in windows]
    for corner in corners:
        _outline(field, corner, size.side * cell)
    for (i, _, _), corner in zip(windows, corners, strict=True):
        _number(field, corner, size.side * cell, str(i + 1))
    return np.vstack([head, _padded(field, field.shape[0], head.shape[1])])


def _field(tape: Tape, side: int, cell: int) -> Picture:
    field = _blank(tape.rows * cell, tape.columns * cell)
    half = cell // 2
    if cell >= 4:
        rows, columns = np.nonzero(tape.placed)
        for dy in (0, 1):
            for dx in (0, 1):
                field[rows * cell + half - 1 + dy, columns * cell + half - 1 + dx] = _FAINT
    corner_rc, distance = nearest_distances(tape, side, BEYOND - 1)
    shade = _SHADES[np.minimum(distance, BEYOND)]
    # from the window's upper left cell to its middle
    shift = (side - 1) * cell // 2
    for (row, column), colour in zip((corner_rc * cell + shift).tolist(), shade.tolist(), strict=True):
        field[row : row + cell, column : column + cell] = colour
    return field


def _outline(field: Picture, corner: tuple[int, int], side_px: int) -> None:
    import cv2

    cv2.rectangle(field, corner, (corner[0] + side_px - 1, corner[1] + side_px - 1), _MARK, 2)


def _number(field: Picture, corner: tuple[int, int], side_px: int, label: str) -> None:
    """Write a pair's number in or at a corner of its window where it overlaps no outline and no other number."""
    import cv2

    width, height = _text_width(label), _LINE // 2 + 1
    across = (5, side_px - width - 5)
    places = [(corner[0] + x, corner[1] + y) for y in (height + 5, side_px - 5, -4, side_px + height + 4) for x in across]

    def is_free(place: tuple[int, int]) -> bool:
        left, bottom = place
        # the mark's colour at that place would be an outline or another number
        under = field[max(bottom - height, 0) : bottom + 1, left : left + width]
        return bottom >= height and bottom < len(field) and not (under == _MARK).all(axis=2).any()

    at = next((place for place in places if is_free(place)), places[0])
    cv2.putText(field, label, at, cv2.FONT_HERSHEY_SIMPLEX, _FONT, _PAPER, 4, cv2.LINE_AA)
    cv2.putText(field, label, at, cv2.FONT_HERSHEY_SIMPLEX, _FONT, _MARK, 1, cv2.LINE_AA)


def _matrix(windows: Across, names: Sequence[str]) -> Picture:
    count = len(names)
    cell = min(max(_MATRIX_PX // count, 1), 60)
    shades = _SHADES[np.minimum(windows.matrix, BEYOND)]
    shades[windows.matrix == NO_WINDOWS] = _PAPER
    squares = np.repeat(np.repeat(shades, cell, axis=0), cell, axis=1)
    named = count <= _NAMED
    left = max((_text_width(n) for n in names), default=0) + 8 if named else 0
    head = f"{windows.side}x{windows.side} windows"
    picture = _blank(squares.shape[0] + _LINE, max(left + squares.shape[1], _text_width(head)))
    picture[_LINE:, left : left + squares.shape[1]] = squares
    _text(picture, head, left, _LINE - 8)
    for i, name in enumerate(names if named else ()):
        middle = _LINE + i * cell + cell // 2 + 5
        _text(picture, name, 0, middle)
        for k in range(count):
            value = int(windows.matrix[i, k])
            if value != NO_WINDOWS and cell >= 16:
                colour = _PAPER if value <= 2 else _INK
                _text(picture, f"{value}+" if value == BEYOND else str(value), left + k * cell + cell // 2 - 6, middle, colour)
    return picture
