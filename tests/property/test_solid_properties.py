"""For any legal tape and form: the mesh is closed, whole and in place, and the STEP text is an exact closed solid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import hypot, pi
from typing import Any

import numpy as np
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from tactape_fab.solids.checks import form_problems
from tactape_fab.solids.forms import Cylinder, SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.stl import mesh_problems, read_stl, stl_problems
from tactape_fab.solids.mesh.triangles import stl_bytes
from tactape_fab.solids.step.part21 import real, reals
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.models.base_shape import check_base
from tactape_fab.verify.models.meshes import mesh_volume_tolerance_mm3
from tactape_fab.verify.models.raised import find_raised
from tactape_fab.verify.models.step_text import shell_problems, step_problems
from tests.part21 import check_solids
from tests.solids import BLOCK, CONE, DOME, step_of, tape_of, volume_mm3
from tests.thorough import some

Draw = Callable[[st.SearchStrategy[Any]], Any]

LEAST_CYLINDER_MM = 5.0
"""Below it the spline of a dome's foot leaves its surfaces by more than 1e-7 mm."""
_SOME = settings(max_examples=some(40), deadline=None, suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow])


def mm(low: float, high: float) -> st.SearchStrategy[float]:
    return st.integers(round(low * 1e6), round(high * 1e6)).map(lambda nm: nm / 1e6)


@st.composite
def parts(draw: Draw) -> Any:
    kind = draw(st.sampled_from(["block", "dome", "cone"]))
    if kind == "block":
        size = (draw(mm(0.2, 0.8)), draw(mm(0.2, 0.5)), draw(mm(0.05, 0.5)))
        turn = draw(
            st.one_of(st.sampled_from([0.0, 30.0, 45.0, 90.0, 137.0, 300.0]), st.floats(-180.0, 180.0).map(lambda v: round(v, 3)))
        )
        return replace(BLOCK, body_mm=size, rotation_deg=turn)
    foot = draw(mm(0.3, 0.8))
    if kind == "dome":
        return replace(DOME, body_mm=(foot, foot, draw(mm(0.05, 0.42 * foot))))
    top = draw(mm(0.1, foot - 0.05))
    return replace(CONE, body_mm=(foot, foot, draw(mm(0.1, 0.5))), top_mm=top)


def apart(holes: list[tuple[float, float, float]], tape: Tape) -> list[tuple[float, float, float]]:
    """Those holes that keep away from each other and from the outline."""
    (w, h), r = tape.board.size_mm, tape.board.corner_radius_mm
    kept: list[tuple[float, float, float]] = []
    for x, y, d in holes:
        corner = hypot(max(r - x, x - w + r, 0.0), max(r - y, y - h + r, 0.0))
        clear = min(x, y, w - x, h - y) > d / 2 + 0.2 and (corner == 0.0 or corner < r - d / 2 - 0.2)
        if clear and all(hypot(x - a, y - b) > (d + e) / 2 + 0.2 for a, b, e in kept):
            kept.append((x, y, d))
    return kept


@st.composite
def solids(draw: Draw) -> tuple[Tape, SolidForm]:
    """A tape and a form that nothing is said against."""
    part = draw(parts())
    values: dict[str, Any] = {
        "pitch_mm": draw(st.one_of(st.just(1.5), mm(0.96, 3.0))),
        "margin_mm": draw(st.sampled_from([1.1, 0.3, 2.5])),
        "omitted": draw(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=3)),
    }
    values["displacement_mm"] = draw(mm(0.02, values["pitch_mm"] / 4))
    columns, rows = draw(st.integers(4, 13)), draw(st.integers(4, 8))
    bare = tape_of(part, columns, rows, radius_mm=0.0, **values)
    cylinder = None
    if draw(st.booleans()):
        around = draw(st.sampled_from(["x", "y"]))
        least = max(bare.board.size_mm[0 if around == "x" else 1] / 2 / pi, LEAST_CYLINDER_MM)
        radius = draw(st.one_of(st.just(least + 1e-6), st.just(least * 1.02), mm(5.0, 60.0)))
        cylinder = Cylinder(radius_mm=round(radius, 6), around=around, shell=draw(st.sampled_from(["segment", "whole"])))
    else:
        most_mm = min(bare.board.size_mm) / 2
        values["radius_mm"] = draw(st.sampled_from([0.0, 0.5, 1.0, min(3.0, most_mm), most_mm]))
        holes = []
        x0, y0 = bare.board.texture_origin_mm
        for _ in range(draw(st.integers(0, 3))):
            at = [draw(st.one_of(st.integers(0, 26).map(lambda k: k / 2), st.floats(0, 13))) * values["pitch_mm"] for _ in "xy"]
            d = draw(st.one_of(st.sampled_from([0.5, 1.0, 1.5, 3.0]), mm(0.4, 4.0)))
            holes.append((round(x0 + at[0], 6), round(y0 - at[1], 6), d))
        values["holes_mm"] = apart(holes, replace(bare, board=replace(bare.board, corner_radius_mm=values["radius_mm"])))
    tape = tape_of(part, columns, rows, **values)
    form = SolidForm(
        base_mm=draw(mm(0.1, 3.0)),
        negative=draw(st.booleans()),
        top=draw(st.sampled_from(["tiles", "single"])),
        cylinder=cylinder,
    )
    assume(not form_problems(tape, form))
    return tape, form


@given(solids())
@_SOME
def test_any_solid_is_a_closed_mesh_in_place(solid: tuple[Tape, SolidForm]) -> None:
    tape, form = solid
    mesh = texture_mesh(tape, form)
    assert mesh_problems(mesh) == []
    written = stl_bytes(mesh, "t")
    read = read_stl(written)
    assert mesh_problems(read) == [] and stl_problems(written) == []
    assert abs(mesh.volume_mm3 - volume_mm3(tape, form)) <= mesh_volume_tolerance_mm3(tape, form)
    assert (base := check_base(tape, form, read)).passed, base.message
    found = find_raised(tape, form, read.vertices_mm)
    centres, strays = found.centres_mm, found.strays_mm
    assert len(strays) == 0
    order = np.argsort(tape.cells() @ (1, tape.columns))
    assert np.abs(centres - tape.part_xy_mm()[order]).max(initial=0.0) < 0.004


@given(solids())
@_SOME
def test_any_solid_is_exact_and_closed_as_text(solid: tuple[Tape, SolidForm]) -> None:
    """Every edge between two faces, once each way; every name defined once; every edge on its faces' surfaces."""
    tape, form = solid
    step = step_of(tape, form)
    assert [*step_problems(step), *shell_problems(step)] == []
    (checker,) = check_solids(step)
    whole = form.cylinder is not None and form.cylinder.shell == "whole"
    assert checker.genus == len(tape.board.holes) + whole
    assert len(checker.faces) >= 3 + tape.part_count * (5 if tape.part.shape == "block" else 1 if tape.part.top_mm is None else 2)


@given(st.lists(st.floats(-2000, 2000, allow_nan=False), min_size=1, max_size=50), st.integers(1, 9))
@example([0.0, -0.0, 1e-12, -1e-12], 9)
def test_columns_of_numbers_are_what_python_writes(values: list[float], decimals: int) -> None:
    texts = reals(np.array(values), decimals).tolist()
    assert len({len(text) for text in texts}) == 1
    for text, value in zip(texts, values, strict=True):
        assert abs(float(text) - value) <= 0.5000001 * 10.0**-decimals + 1e-12


@given(st.floats(-1e9, 1e9, allow_nan=False))
def test_a_number_is_itself_to_twelve_decimals(value: float) -> None:
    text = real(value)
    assert "." in text
    assert "E" not in text.upper()
    assert abs(float(text) - value) <= 0.51e-12 + abs(value) * 1e-15
