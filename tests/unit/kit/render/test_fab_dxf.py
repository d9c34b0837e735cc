"""The DXF of the drawing: what is on its layers, its unit, no faults, and the same bytes every time."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from functools import cache
from typing import Any

import ezdxf
import numpy as np
import pytest
from ezdxf.bbox import extents

from tactape_fab import TapeSpec
from tactape_fab.kit.examine.order import ExaminedPanel, examine_order
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.order_facts import OrderFacts, order_facts, panel_order_facts
from tactape_fab.kit.render.fab_dxf import LAYERS, render_fab_dxf
from tactape_fab.kit.writer import render_all


@cache
def drawn(**values: Any) -> tuple[OrderFacts, Any, bytes]:
    made = examine(TapeSpec(**{"sector": 7, "size_mm": (60.0, 40.0), "models": False, **values}))
    assert made.film is not None
    facts = order_facts(made.film.layout, made.film.fab, made.findings, render_all(made.drawing, made.film.fab))
    (artifact,) = render_fab_dxf(facts, made.drawing)
    assert (artifact.role, artifact.path) == ("fab-dxf", "tactape-s007-drawing.dxf")
    return facts, made.drawing, artifact.data


def read(data: bytes) -> Any:
    document = ezdxf.read(io.StringIO(data.decode("utf-8")))
    audit = document.audit()
    assert (audit.errors, audit.fixes) == ([], [])
    return document


def points(entity: Any) -> np.ndarray:
    return np.array([tuple(vertex.dxf.location)[:2] for vertex in entity.vertices])


def test_layers_hold_outline_field_tag_and_holes() -> None:
    facts, drawing, data = drawn(holes_mm=((30.0, 20.0, 3.0),))
    document = read(data)
    assert document.units == 4  # millimetres
    assert {layer.dxf.name for layer in document.layers} >= set(LAYERS)
    on = {layer: list(document.modelspace().query(f'*[layer=="{layer}"]')) for layer in LAYERS}
    box = extents(on["OUTLINE"])
    assert (box.extmin.x, box.extmin.y, box.extmax.x, box.extmax.y) == pytest.approx((0.0, 0.0, 60.0, 40.0))
    (field,) = on["FIELD"]
    assert (*points(field).min(axis=0), *points(field).max(axis=0)) == pytest.approx(facts.field_mm)
    (hole,) = on["HOLES"]
    assert (hole.dxf.center.x, hole.dxf.center.y, hole.dxf.radius) == pytest.approx((30.0, 20.0, 1.5))
    assert len(on["TAG"]) == len(drawing.legend.areas_mm) > 1
    assert len(on["LABEL"]) == len(drawing.legend.strokes_mm) > 10
    assert all(entity.is_closed for layer in ("OUTLINE", "FIELD", "TAG") for entity in on[layer])
    assert sum(map(len, on.values())) == len(document.modelspace())


def test_a_panel_has_a_field_for_every_tape() -> None:
    panel, _ = examine_order({"sectors": "0-3", "panel": "2x2", "size_mm": (40.0, 30.0), "models": False})
    assert isinstance(panel, ExaminedPanel)
    film = panel.tapes[0].film
    assert film is not None
    layouts = [tape.layout for tape in panel.tapes]
    artifacts = render_all(panel.drawing, film.fab)
    facts = panel_order_facts(panel.name, panel.panel, layouts, film.fab, panel.findings, artifacts)
    (artifact,) = render_fab_dxf(facts, panel.drawing)
    document = read(artifact.data)
    fields = [points(entity) for entity in document.modelspace().query('*[layer=="FIELD"]')]
    offsets = np.array([field.min(axis=0) for field in fields]) - facts.field_mm[:2]
    assert offsets == pytest.approx(np.array([tape.offset_mm for tape in facts.panel.tapes]) if facts.panel else None)
    assert len(document.modelspace().query('*[layer=="SLOTS"]')) == len(panel.drawing.slots_mm) > 0


def test_the_bytes_are_the_same_in_another_process() -> None:
    code = (  # another order of sets, another hour
        "import sys; from tests.unit.kit.render.test_fab_dxf import drawn; "
        "sys.stdout.buffer.write(drawn(holes_mm=((30.0, 20.0, 3.0),))[2])"
    )
    again = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "3", "TZ": "Asia/Tokyo"},
    )
    assert again.stdout == drawn(holes_mm=((30.0, 20.0, 3.0),))[2]
