"""Tiny kits, every text format byte for byte, meshes by what they measure.

Files that hold pictures or their SHA-256, as the report does, differ between releases of OpenCV and are tested elsewhere.
A difference is a change of output that CHANGELOG.md must name. `pytest tests/golden --update-golden` writes the files anew.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import pytest

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.solids.mesh.stl import read_stl
from tactape_fab.verify.models.meshes import read_threemf

FOLDER = Path(__file__).parent / "files"
MESHES = "meshes.json"
SPECS = {
    "plain": TapeSpec(sector=3, size_mm=(10.0, 10.0), tag="none", name="plain"),
    "strip": TapeSpec(
        sector=200,
        code="debruijn-4x4",
        size_mm=(18.0, 12.0),
        holes_mm=[(15.0, 6.0, 0.8)],
        assembly="jlcpcb",
        x2="comments",
        name="strip",
    ),
}


@pytest.mark.parametrize("name", SPECS)
def test_text_files_are_the_golden_ones(
    name: str, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")  # 2026-01-01
    kit = make_kit(SPECS[name], tmp_path / name)
    written = {
        path.relative_to(kit.path).as_posix(): path.read_bytes()
        for path in sorted(kit.path.rglob("*"))
        if path.suffix not in {".pdf", ".png", ".zip", ".json", ".stl", ".3mf", ".html", ""}
    }
    golden = FOLDER / name
    if request.config.getoption("--update-golden"):
        for relative, data in written.items():
            (golden / relative).parent.mkdir(parents=True, exist_ok=True)
            (golden / relative).write_bytes(data)
    expected = {
        p.relative_to(golden).as_posix(): p.read_bytes() for p in sorted(golden.rglob("*")) if p.is_file() and p.name != MESHES
    }
    assert written.keys() == expected.keys()
    for relative, data in written.items():
        assert data == expected[relative], f"{name}/{relative} differs from the golden file; if it is to: --update-golden"


def measured(kit: Kit) -> dict[str, Any]:
    """What the meshes of a kit measure: triangles, volume and bounds in mm, and the 3MF's text."""
    threemf = (kit.path / kit.files["3mf"]).read_bytes()
    meshes = {"stl": read_stl((kit.path / kit.files["stl"]).read_bytes()), "3mf": read_threemf(threemf)}
    with zipfile.ZipFile(io.BytesIO(threemf)) as archive:
        texts = {name: hashlib.sha256(archive.read(name)).hexdigest() for name in archive.namelist()[:2]}
        model = archive.read("3D/3dmodel.model").decode("utf-8")
    return {
        **{
            role: {
                "triangles": len(mesh.faces),
                "vertices": len(mesh.vertices_mm),
                "volume_mm3": round(mesh.volume_mm3, 6),
                "bounds_mm": [[round(v, 5) for v in row] for row in (mesh.vertices_mm.min(axis=0), mesh.vertices_mm.max(axis=0))],
            }
            for role, mesh in meshes.items()
        },
        "package": texts,
        "head": model[: model.index("<vertices>")],
    }


@pytest.mark.parametrize("name", SPECS)
def test_meshes_measure_what_the_golden_ones_do(
    name: str, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")  # 2026-01-01
    found = measured(make_kit(SPECS[name], tmp_path / name))
    golden = FOLDER / name / MESHES
    if request.config.getoption("--update-golden"):
        golden.write_text(json.dumps(found, indent=1) + "\n", encoding="ascii")
    expected = json.loads(golden.read_bytes())
    for role in ("stl", "3mf"):
        volume, bounds = found[role].pop("volume_mm3"), found[role].pop("bounds_mm")
        assert volume == pytest.approx(expected[role].pop("volume_mm3"), abs=2e-5)
        for row, golden_row in zip(bounds, expected[role].pop("bounds_mm"), strict=True):
            assert row == pytest.approx(golden_row, abs=2e-5)
    assert found == expected
