"""The assembled tape as STEP AP214 text: a board, and one part with an occurrence per designator."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime
from itertools import pairwise

import numpy as np

from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.step.part21 import (
    MOST_OF_FRAME,
    TRAILER,
    Context,
    Rgb,
    Template,
    TextArray,
    Writer,
    coloured,
    context,
    fill,
    first_name,
    header,
    names,
    product,
    reals,
    wrapped_names,
)
from tactape_fab.solids.step.solid import FlatBase
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape

_MOST_DECIMALS = 6
_OF_OCCURRENCE = 7


def assembly_step(tape: Tape, *, name: str, date: datetime, board_rgb: Rgb, part_rgb: Rgb) -> bytes:
    """STEP file of a tape's board with its parts; see `assembly_step_chunks`."""
    return b"".join(assembly_step_chunks(tape, name=name, date=date, board_rgb=board_rgb, part_rgb=part_rgb))


def assembly_step_chunks(tape: Tape, *, name: str, date: datetime, board_rgb: Rgb, part_rgb: Rgb) -> Iterator[bytes]:
    """STEP file of a tape's board with its parts, in pieces.

    One product for the board (outline and holes, ``thickness_mm`` below z = 0), one for the part (unrotated, the middle of
    its foot at the origin), and an occurrence of it (ISO 10303-44 NEXT_ASSEMBLY_USAGE_OCCURRENCE) named by each designator.
    Board frame, mm.

    board_rgb, part_rgb: Colours of the two products, each from 0 to 1.
    """
    w = Writer()
    shared = context(w)
    definition, definition_shape = product(w, shared, name)
    origin = w.placement((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    # without elements the top face has few loops, so tiles would not help
    film = SolidForm(base_mm=tape.board.thickness_mm, top="single")
    base = FlatBase(w, tape, film)
    board = _product(w, shared, f"{name}-board", origin, base.faces([]), board_rgb)
    part = _product(w, shared, tape.part.name.upper(), origin, _box_faces(w, tape.part.body_mm), part_rgb)
    angle = np.radians(tape.part.rotation_deg)
    turned, up = w.direction((np.cos(angle), np.sin(angle), 0.0)), w.direction((0.0, 0.0, 1.0))

    first = first_name(w.next + MOST_OF_FRAME, tape.part_count, _OF_OCCURRENCE)
    # the second entity of each copy is its AXIS2_PLACEMENT_3D, which the assembly's representation lists
    placements = names(0, first + np.arange(tape.part_count) * _OF_OCCURRENCE + 1)
    shape = w.add(f"SHAPE_REPRESENTATION('',({wrapped_names([origin, placements])}),{shared.geometry})")
    w.add(f"SHAPE_DEFINITION_REPRESENTATION({definition_shape},{shape})")
    _relation(w, "board", (definition, shape), board, origin, origin)
    assert w.next <= first
    yield header(name, date)
    yield w.text()
    for template, start, columns in _occurrences(tape, first, (definition, shape), part, origin, f"{up},{turned}"):
        yield from fill(template, start, len(columns["x"]), columns)
    yield TRAILER


def _product(w: Writer, shared: Context, name: str, origin: str, faces: Sequence[str], rgb: Rgb) -> tuple[str, str]:
    """A coloured product of one solid; names of its definition and its shape representation."""
    shell = w.add(f"CLOSED_SHELL('',({','.join(faces)}))")
    solid = w.add(f"MANIFOLD_SOLID_BREP('',{shell})")
    definition, definition_shape = product(w, shared, name)
    shape = w.add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({origin},{solid}),{shared.geometry})")
    w.add(f"SHAPE_DEFINITION_REPRESENTATION({definition_shape},{shape})")
    coloured(w, shared, solid, rgb)
    return definition, shape


def _box_faces(w: Writer, size_mm: tuple[float, float, float]) -> list[str]:
    """The six faces of a box on z = 0 above the origin."""
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    foot = np.column_stack([signs * np.array(size_mm[:2]) / 2, np.zeros(4)])
    points = np.concatenate([foot, foot + np.array([0.0, 0.0, size_mm[2]])])
    vertices = [w.vertex(p) for p in points]

    def edge(a: int, b: int) -> str:
        return w.line_edge(vertices[a], vertices[b], points[a], points[b])

    low, high = ([edge(level + k, level + (k + 1) % 4) for k in range(4)] for level in (0, 4))
    rise = [edge(k, k + 4) for k in range(4)]
    loops = [[(low[k], True), (rise[(k + 1) % 4], True), (high[k], False), (rise[k], False)] for k in range(4)]
    loops += [[(e, True) for e in high], [(e, False) for e in reversed(low)]]
    # the outward normal of a side of a counter-clockwise rectangle is the direction of the previous side
    planes = [(points[k], points[k] - points[(k + 3) % 4], (0.0, 0.0, 1.0)) for k in range(4)]
    planes += [(points[4], (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)), (points[0], (0.0, 0.0, -1.0), (1.0, 0.0, 0.0))]
    faces = []
    for loop, (at, normal, ref) in zip(loops, planes, strict=True):
        plane = w.add(f"PLANE('',{w.placement(at, np.array(normal) / np.linalg.norm(normal), ref)})")
        faces.append(w.face([w.loop(loop)], plane))
    return faces


def _relation(
    t: Template | Writer, designator: str, of: tuple[str, str], used: tuple[str, str], origin: str, placement: str
) -> None:
    """Add the entities of an occurrence of a product in an assembly (ISO 10303-44, and 10303-43 for its place).

    of, used: Names of definition and shape representation of the assembly and of the product.
    """
    # from the component's origin to its place in the assembly; a MAPPED_ITEM takes a third of the bytes, but with 200 parts on a
    # board OCCT 8 read 203 solids and a wrong volume from it
    moved = t.add(f"ITEM_DEFINED_TRANSFORMATION('',$,{origin},{placement})")
    relation = t.add(
        f"(REPRESENTATION_RELATIONSHIP('',$,{used[1]},{of[1]})REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION({moved})"
        "SHAPE_REPRESENTATION_RELATIONSHIP())"
    )
    usage = t.add(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{designator}','{designator}',$,{of[0]},{used[0]},$)")
    usage_shape = t.add(f"PRODUCT_DEFINITION_SHAPE('',$,{usage})")
    t.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION({relation},{usage_shape})")


def _exact_decimals(xy_mm: FloatArray) -> int:
    """The fewest decimals, but at least three, that represent coordinates in whole nanometres exactly."""
    for decimals in range(3, _MOST_DECIMALS):
        # places are whole nanometres, 1e-6 mm, so differences below 1e-9 mm are rounding errors
        if (np.abs(xy_mm - np.round(xy_mm, decimals)) < 1e-9).all():
            return decimals
    return _MOST_DECIMALS


def _occurrences(
    tape: Tape, first: int, of: tuple[str, str], used: tuple[str, str], origin: str, directions: str
) -> Iterator[tuple[Template, int, dict[str, TextArray]]]:
    """A template for the designators of each length, with the number of its first entity, and its columns."""
    xy_mm = tape.part_xy_mm()
    decimals = _exact_decimals(xy_mm)
    x, y = reals(xy_mm[:, 0], decimals), reals(xy_mm[:, 1], decimals)
    texts = np.array(tape.designators(), dtype=np.bytes_)
    length = np.char.str_len(texts)
    # columns of a template have fixed widths, so R1 to R9, R10 to R99 and so on have templates of their own
    ends = [*(np.flatnonzero(np.diff(length)) + 1).tolist(), len(texts)]
    for begin, end in pairwise([0, *ends]):
        t = Template()
        point = t.add("CARTESIAN_POINT('',(<x>,<y>,0.))")
        placement = t.add(f"AXIS2_PLACEMENT_3D('',{point},{directions})")
        _relation(t, "<designator>", of, used, origin, placement)
        assert len(t) == _OF_OCCURRENCE
        designators = texts[begin:end].astype(f"S{length[begin]}")
        yield t, first + begin * _OF_OCCURRENCE, {"x": x[begin:end], "y": y[begin:end], "designator": designators}
