"""Any legal spec becomes a kit: all files are rendered, and verification of what was written passes."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tactape_fab import Tape, TapeSpec, make_kit, verify_kit
from tactape_fab.base.errors import SpecError
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.profiles import BACKING_ROLES
from tactape_fab.kit.writer import RENDERERS, render_all
from tactape_fab.texture.code import CODE_NAMES, get_code
from tests.thorough import some


@st.composite
def specs(draw: st.DrawFn) -> dict[str, Any]:
    """Values of a small tape: any code, sector, origin, size, pitch, displacement, strip, holes, profile options."""
    code = get_code(draw(st.sampled_from(CODE_NAMES)))
    pitch_mm = draw(st.integers(1500, 2200)) / 1000
    tag = draw(st.sampled_from(["strip", "none"]))
    values: dict[str, Any] = {
        "code": code.name,
        "sector": draw(st.integers(0, code.sectors - 1)),
        "pitch_mm": pitch_mm,
        "displacement_mm": round(pitch_mm * draw(st.floats(0.05, 1 / 6)), 4),
        "size_mm": (draw(st.integers(240, 320)) / 10, draw(st.integers(160, 220)) / 10),
        "tag": tag,
        "corner_radius_mm": draw(st.sampled_from([0.0, 0.5, 1.0])),
        "assembly": draw(st.sampled_from([None, "generic", "jlcpcb"])),
        "x2": draw(st.sampled_from([None, "full", "comments", "off"])),
    }
    if tag == "strip":
        values["tag_id"] = draw(st.integers(0, 586))
    if draw(st.booleans()):
        values["origin"] = (draw(st.integers(0, code.range - 40)), draw(st.integers(0, code.range - 40)))
    if draw(st.booleans()):
        values["holes_mm"] = [(draw(st.integers(180, 220)) / 10, draw(st.integers(60, 100)) / 10, draw(st.integers(1, 15)) / 10)]
    return values


def legal(values: dict[str, Any]) -> Examined:
    """The examined spec, or no example where the holes leave no window or a rule is broken."""
    try:
        examined = examine(TapeSpec(**values))
    except SpecError as error:
        assert {p.key for p in error.problems} <= {"holes_mm", "origin"}, str(error)
        assume(False)
        raise
    assume(not any(finding.blocks for finding in examined.findings))
    return examined


@settings(deadline=None, derandomize=True, max_examples=some(8))
@given(values=specs())
def test_any_legal_spec_becomes_a_verified_kit(values: dict[str, Any]) -> None:
    """Without FreeCAD and PrusaSlicer, for their time; they read random kits in tests/roundtrip/test_random_kits.py."""
    examined = legal(values)
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", folder)
        kit = make_kit(examined.spec, Path(folder) / "kit")
        assert kit.checks
        assert all(check.passed or check.warning for check in kit.checks)
        assert verify_kit(kit.path).passed
        again = Tape.load(kit.path)
        assert np.array_equal(again.symbols, examined.layout.tape.symbols)
        assert again.to_mapping() == examined.layout.tape.to_mapping()
        manifest = json.loads((kit.path / "manifest.json").read_text())
        resolved = replace(examined.spec, assembly=examined.fab.assembly, x2=examined.fab.x2, coverlay=examined.fab.coverlay_mode)
        assert TapeSpec.from_mapping(manifest["spec"]) == resolved
        listed = {row["path"] for row in manifest["files"]} | {"manifest.json"}
        assert {p.relative_to(kit.path).as_posix() for p in kit.path.rglob("*") if p.is_file()} == listed


@settings(deadline=None, derandomize=True, max_examples=some(8))
@given(values=specs())
def test_rendering_depends_on_the_spec_alone(values: dict[str, Any]) -> None:
    examined = legal(values)
    one, other = render_all(examined.drawing, examined.fab), render_all(legal(values).drawing, examined.fab)
    assert [(a.role, a.path, a.data) for a in one] == [(a.role, a.path, a.data) for a in other]
    roles = {artifact.role for artifact in one}
    assert roles >= set(RENDERERS) - {"drill-npth", "legend-top", *BACKING_ROLES}
    assert ("drill-npth" in roles) == bool(values.get("holes_mm"))
    assert len({artifact.path for artifact in one}) == len(one)
    assert all(artifact.data for artifact in one)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(values=specs())
def test_a_spec_survives_its_own_manifest(values: dict[str, Any]) -> None:
    spec = TapeSpec(**values)
    assert TapeSpec.from_mapping(json.loads(json.dumps(spec.to_mapping()))) == spec
