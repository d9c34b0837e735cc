"""Assets for simulators: the tape as a body in MJCF, URDF and USD, its mesh, heightfield and normal map."""

from __future__ import annotations

import json
from math import ceil

import numpy as np
import numpy.typing as npt

from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.render.colours import BODY, COVERLAY_COLOURS, LEGEND_COLOURS, TERMINAL, TEXTURE, rgb, rgb8
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.sim.body import Body, part_body, tape_body
from tactape_fab.solids.sim.description import mjcf, urdf
from tactape_fab.solids.sim.relief import element_height_mm, png_bytes, relief_of, stamps
from tactape_fab.solids.sim.scene_files import glb, mtl, obj, usda
from tactape_fab.texture.board import Tag
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.shapes import rotate
from tactape_fab.texture.tag import SIDE_CELLS, tag_cells
from tactape_fab.texture.tape import Tape

ROLE = "sim"
_COLOUR_PX_PER_MM, _MOST_COLOUR_PX = 20.0, 4096
_MOST_NORMAL_PX = 4_000_000
_TERMINAL_SHARE = 0.25
"""Length of a terminal as a fraction of the chip's length (0201: 0.15 of 0.6 mm)."""

Picture = npt.NDArray[np.uint8]


def render_sim(tape: Tape, form: SolidForm | None, fab: FabProfile | None) -> list[Artifact]:
    """Every asset of a tape: a film with its parts (`fab`), or a texture of solid elements (`form`)."""
    shape, look = (form if fab is None else None), rgb(TEXTURE)  # a film's models are of its printed copy
    body = tape_body(tape, shape)
    relief, smooth = relief_of(tape), relief_of(tape, _MOST_NORMAL_PX)
    colour = None if fab is None else png_bytes(film_picture(tape, fab))
    normal = png_bytes(smooth.normals())
    # PNG's pHYs is in pixels per metre
    px_per_m = round(1000 * relief.px_per_mm)
    facts = {
        "units": {"length": "m", "mass": "kg"},
        "heightfield": {
            "file": f"{tape.name}-height.png",
            "metres_per_pixel": 1e-3 / relief.px_per_mm,
            # 16 bits over the relief's height
            "metres_at_65535": 1e-3 * relief.top_mm,
            "size_px": [relief.height.shape[1], relief.height.shape[0]],
            # the middle of pixel (0, 0), which is the upper left one: x right, y up from the board's lower left corner
            "first_pixel_m": [0.5e-3 / relief.px_per_mm, 1e-3 * tape.board.size_mm[1] - 0.5e-3 / relief.px_per_mm],
            "surface": "plane" if shape is None or shape.cylinder is None else "the board before it is wrapped",
        },
        "normal_map": {"file": f"{tape.name}-normal.png", "green": "along board y (OpenGL)"},
    }
    files = [
        ("-colour.png", colour),
        ("-height.png", png_bytes(relief.levels(), px_per_m)),
        ("-normal.png", normal),
        ("-sim.json", (json.dumps(facts, indent=1) + "\n").encode("ascii")),
        (".glb", glb(tape, shape, colour, normal, look)),
    ]
    return [*_artifacts(tape.name, files), *_body_files(body, None if colour is None else f"{tape.name}-colour.png")]


def render_part_sim(name: str, mesh: Mesh) -> list[Artifact]:
    """Assets of a texture on the user's own part, in the frame of the part's file."""
    return _body_files(part_body(name, mesh), None)


def _body_files(body: Body, colour_file: str | None) -> list[Artifact]:
    name, look = body.name, rgb(TEXTURE)
    hull = None if body.hull is None else f"{name}-hull.obj"
    files = [
        (".mtl", mtl(colour_file, look)),
        (".obj", obj(body.mesh, body.uv, f"{name}.mtl")),
        ("-hull.obj", None if body.hull is None else obj(body.hull)),
        (".usda", usda(body, colour_file, look)),
        (".urdf", urdf(body, f"{name}.obj", hull, look)),
        (".xml", mjcf(body, f"{name}.obj", colour_file, look)),
    ]
    return _artifacts(name, files)


def _artifacts(name: str, files: list[tuple[str, bytes | None]]) -> list[Artifact]:
    return [Artifact(role=ROLE, path=f"sim/{name}{ending}", data=data) for ending, data in files if data is not None]


def film_picture(tape: Tape, fab: FabProfile) -> Picture:
    """Colour picture of a film with its parts and tag, seen from above; (h, w, 3), row 0 at the upper edge."""
    width_mm, height_mm = tape.board.size_mm
    px_per_mm = min(_COLOUR_PX_PER_MM, _MOST_COLOUR_PX / max(width_mm, height_mm))
    shape = ceil(height_mm * px_per_mm), ceil(width_mm * px_per_mm)
    picture = np.empty((*shape, 3), dtype=np.uint8)
    picture[:] = rgb8(COVERLAY_COLOURS[fab.coverlay_colour][0])
    half_mm = tape.part.body_mm[0] * (0.5 - _TERMINAL_SHARE)
    for v, u, offset_mm in stamps(tape, px_per_mm, shape):
        # pixels covered by a body's foot
        on = element_height_mm(tape.part, offset_mm) > 0
        # coordinate along the part in its own frame: beyond this is a terminal
        end = np.abs(rotate(offset_mm[on], -tape.part.rotation_deg)[:, 0]) > half_mm
        picture[v[on], u[on]] = np.where(end[:, None], rgb8(TERMINAL), rgb8(BODY))
    if tape.tag is not None:
        _print_tag(picture, tape.tag, px_per_mm, height_mm, fab)
    return picture


def _print_tag(picture: Picture, tag: Tag, px_per_mm: float, height_mm: float, fab: FabProfile) -> None:
    """Draw the tag's ink: its light cells with a white legend, its dark ones with a black legend."""
    v, u = np.mgrid[: picture.shape[0], : picture.shape[1]]
    board: FloatArray = np.stack([(u + 0.5) / px_per_mm, height_mm - (v + 0.5) / px_per_mm], axis=2)
    # from board to tag: rotated back, in cells, y down, with the origin moved from the centre to the corner
    cell = rotate(board - tag.center_mm, -tag.rotation_deg) / tag.cell_mm * (1, -1) + SIDE_CELLS / 2
    on = ((cell >= 0) & (cell < SIDE_CELLS)).all(axis=2)
    column, row = cell[on].astype(np.int64).T
    light = tag_cells(tag.id)[row, column]
    inked = light == (fab.legend_colour == "white")
    rows = picture[on]
    rows[inked] = rgb8(LEGEND_COLOURS[fab.legend_colour])
    picture[on] = rows
