"""Pictures of an inspection: every deviation enlarged, and the shifts of all parts on a map of the tape."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tactape_fab.base.libraries import library
from tactape_fab.base.picture_file import write_picture
from tactape_fab.sense.inspect.patches import patch_grid, sample
from tactape_fab.sense.inspect.result import Deviation, Inspection, Kind
from tactape_fab.sense.inspect.scan_files import Picture
from tactape_fab.sense.inspect.view import View
from tactape_fab.texture.frames import FloatArray

MOST_TILES = 60
_TILE_PX, _CAPTION_PX, _GAP_PX = 260, 40, 8
_ACROSS = 6
_HALF_MM = 0.9
_INK, _RED, _BLUE, _GREY = (40, 40, 40), (40, 40, 220), (200, 120, 0), (205, 205, 205)  # blue, green, red
_ORDER: tuple[Kind, ...] = ("missing", "tombstoned", "turned", "foreign", "shifted")
_MAP_PX_PER_MM = 16.0
_MAP_MOST_PX = 2400
_ENLARGED = 8.0


def draw_deviations(inspection: Inspection, views: Sequence[View]) -> Picture:
    """Every deviation as a tile of 1.8 x 1.8 mm, board y up: nominal body in blue, measured one in red.

    views: The scans that show the tape.
    """
    found = sorted(inspection.deviations(), key=lambda d: (_ORDER.index(d.kind), -abs(d.value or 0.0)))
    shown = found[:MOST_TILES]
    rows = max(1, -(-len(shown) // _ACROSS))
    across = min(_ACROSS, max(len(shown), 2))
    head = 64
    height = head + rows * (_TILE_PX + _CAPTION_PX + _GAP_PX) + _GAP_PX
    out = np.full((height, across * (_TILE_PX + _GAP_PX) + _GAP_PX, 3), 255, dtype=np.uint8)
    more = f", the first {len(shown)} shown" if len(found) > len(shown) else ""
    _write(out, f"{inspection.tape.name}: {len(found)} deviations{more}", (_GAP_PX, 26), 0.6)
    _write(out, "blue: nominal body   red: as measured   1.8 mm a tile", (_GAP_PX, 52), 0.5)
    number = {name: i for i, name in enumerate(inspection.tape.designators())}
    for place, deviation in enumerate(shown):
        row, column = divmod(place, _ACROSS)
        x, y = _GAP_PX + column * (_TILE_PX + _GAP_PX), head + row * (_TILE_PX + _CAPTION_PX + _GAP_PX)
        tile = _tile(inspection, views, deviation, number.get(deviation.designator))
        out[y : y + _TILE_PX, x : x + _TILE_PX] = tile
        _write(out, _caption(deviation), (x + 2, y + _TILE_PX + 22), 0.5)
    return out


def _caption(d: Deviation) -> str:
    if d.kind == "foreign" and d.value is not None:
        return f"foreign {d.value:.2f} mm at {d.at_mm[0]:.1f}, {d.at_mm[1]:.1f}"
    if d.kind == "shifted":
        return f"{d.designator} shifted {d.value:.3f} mm"
    return (
        f"{d.designator} turned {d.value:.0f} deg"
        if d.kind == "turned"
        else f"{d.designator} {'covered' if d.kind == 'foreign' else d.kind}"
    )


def _tile(inspection: Inspection, views: Sequence[View], deviation: Deviation, part: int | None) -> Picture:
    cv2 = library("cv2", "--picture")
    at = np.array(deviation.at_mm)
    view = next((v for v in views if (v.inside[part] if part is not None else _shows(v, at))), views[0])
    grid = patch_grid(_HALF_MM, _HALF_MM, min(view.warp.px_per_mm, 60.0))
    seen = sample(view.picture, view.warp, at[None], 0.0, grid)[0].reshape(*grid.shape, 3)[::-1]
    tile = cv2.resize(np.ascontiguousarray(seen.astype(np.uint8)), (_TILE_PX, _TILE_PX), interpolation=cv2.INTER_CUBIC)
    if part is None:
        radius = (deviation.value or 0.0) / 2 + 0.12
        cv2.circle(tile, (_TILE_PX // 2, _TILE_PX // 2), round(radius * _TILE_PX / 2 / _HALF_MM), _RED, 2, cv2.LINE_AA)
        return np.asarray(tile)
    tape = inspection.tape
    _outline(tile, np.zeros(2), tape.part.rotation_deg, tape.part.body_mm, _BLUE)
    if inspection.present[part] and not inspection.covered[part]:
        turn = tape.part.rotation_deg + float(inspection.turn_deg[part])
        _outline(tile, inspection.shift_mm[part], turn, tape.part.body_mm, _RED)
    return np.asarray(tile)


def _shows(view: View, at_mm: FloatArray) -> bool:
    u, v = view.warp.to_px(at_mm[None])[0]
    return bool(0 <= u < view.picture.shape[1] and 0 <= v < view.picture.shape[0])


def _outline(
    tile: Picture, shift_mm: FloatArray, turn_deg: float, body_mm: Sequence[float], colour: tuple[int, int, int]
) -> None:
    cv2 = library("cv2", "--picture")
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    half = np.array(body_mm[:2]) / 2
    corners = (np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half) @ np.array([(c, s), (-s, c)]) + shift_mm
    px = (corners * (1.0, -1.0) / _HALF_MM + 1.0) * _TILE_PX / 2
    cv2.polylines(tile, [np.rint(px * 16).astype(np.int32)], True, colour, 1, cv2.LINE_AA, 4)


def draw_places(inspection: Inspection) -> Picture:
    """Map of the tape: the shift of each part as a line eight times as long, missing parts as crosses, limits passed in red."""
    cv2 = library("cv2", "--picture")
    tape = inspection.tape
    width, height = tape.board.size_mm
    per_mm = min(_MAP_PX_PER_MM, _MAP_MOST_PX / max(width, height))
    head = 56
    out = np.full((int(height * per_mm) + head, max(int(width * per_mm), 760), 3), 255, dtype=np.uint8)

    def px(board_mm: FloatArray) -> FloatArray:
        return np.asarray(np.rint((np.asarray(board_mm) * (1.0, -1.0) + (0.0, height)) * per_mm + (0, head)).astype(int))

    cv2.rectangle(out, (0, head), tuple(px(np.array([width, 0.0])).tolist()), _GREY, 1)
    sites = tape.part_xy_mm()
    ends = px(sites + inspection.shift_mm * _ENLARGED)
    beyond = (
        inspection.covered
        | (np.hypot(*inspection.shift_mm.T) > inspection.tolerance_mm)
        | (np.abs(inspection.turn_deg) > inspection.turn_tolerance_deg)
    )
    for i, (a, b) in enumerate(zip(px(sites).tolist(), ends.tolist(), strict=True)):
        if not inspection.present[i]:
            cv2.drawMarker(out, a, _RED, cv2.MARKER_TILTED_CROSS, max(6, round(0.8 * per_mm)), 2)
            continue
        colour = _RED if beyond[i] else _BLUE
        cv2.circle(out, a, 1, colour, -1)
        cv2.line(out, a, b, colour, 1, cv2.LINE_AA)
    for x, y, d in inspection.foreign_mm.tolist():
        cv2.circle(out, px(np.array([x, y])).tolist(), round((d / 2 + 0.5) * per_mm), _RED, 2, cv2.LINE_AA)
    mean, scatter = inspection.mean_shift_mm, inspection.scatter_mm
    _write(out, f"{tape.name}: lines are shifts x {_ENLARGED:.0f}; crosses: no part; rings: foreign objects", (6, 22), 0.5)
    text = (
        f"scatter {1000 * scatter[0]:.0f}, {1000 * scatter[1]:.0f} um; "
        f"mean against the lands {1000 * mean[0]:.0f}, {1000 * mean[1]:.0f} um"
    )
    _write(out, text, (6, 44), 0.5)
    return out


def _write(out: Picture, text: str, at: tuple[int, int], size: float) -> None:
    cv2 = library("cv2", "--picture")
    cv2.putText(out, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, _INK, 1, cv2.LINE_AA)


def write_pictures(folder: Path, inspection: Inspection, views: Sequence[View]) -> list[Path]:
    """Both pictures of a tape as PNG in a folder, which is made if need be; their paths.

    Raises SpecError if they cannot be written there.
    """
    paths = [folder / name for name in picture_names(inspection)]
    for path, picture in zip(paths, (draw_deviations(inspection, views), draw_places(inspection)), strict=True):
        write_picture(path, picture, "picture", compression=7)
    return paths


def picture_names(inspection: Inspection) -> list[str]:
    """Names of the files of `write_pictures`."""
    return [f"{inspection.tape.name}-{what}.png" for what in ("deviations", "places")]
