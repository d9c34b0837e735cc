"""Tiny kits, every text format byte for byte; a difference is a change of output that CHANGELOG.md must name.

`pytest tests/golden --update-golden` writes the files anew.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tactape_fab import TapeSpec, make_kit

FOLDER = Path(__file__).parent / "files"
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
        if path.suffix not in {".png", ".zip", ".json", ".step", ".stl", ".3mf", ""}
    }
    golden = FOLDER / name
    if request.config.getoption("--update-golden"):
        for relative, data in written.items():
            (golden / relative).parent.mkdir(parents=True, exist_ok=True)
            (golden / relative).write_bytes(data)
    expected = {p.relative_to(golden).as_posix(): p.read_bytes() for p in sorted(golden.rglob("*")) if p.is_file()}
    assert written.keys() == expected.keys()
    for relative, data in written.items():
        assert data == expected[relative], f"{name}/{relative} differs from the golden file"
