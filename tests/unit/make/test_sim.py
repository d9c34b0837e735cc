"""Kits with assets for simulators: verified, made again, and others left as they were."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tactape_fab import DesignRuleError, Kit, SpecError, TapeSpec, make_kit, verify_kit
from tactape_fab.make.reproduce import reproduce_kit
from tactape_fab.texture.manifest import read_manifest
from tactape_fab.verify.files import SIM


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    spec = TapeSpec(sector=100, size_mm=(20.0, 20.0), models=False, sim=True)
    return make_kit(spec, tmp_path_factory.mktemp("sim") / "tactape-s100")


def test_the_assets_are_listed_each_with_its_hash(kit: Kit) -> None:
    rows = [row for row in read_manifest(kit.path / "manifest.json")["files"] if row["role"] == SIM]
    assert {Path(row["path"]).name for row in rows} == {p.name for p in (kit.path / "sim").iterdir()}
    assert len(rows) == 10 and kit.files[SIM] == "sim/tactape-s100.xml"


def test_verify_says_that_their_content_is_not_compared(kit: Kit) -> None:
    said = {check.name: check.message for check in verify_kit(kit.path, quick=True).checks}
    assert said["sim"] == "10 files; not compared: what simulators load of them"


def test_a_kit_with_assets_is_made_again_byte_for_byte(kit: Kit) -> None:
    assert reproduce_kit(kit.path).passed


@pytest.mark.parametrize("ending", [".xml", ".obj", "-height.png"])
def test_a_changed_asset_is_noticed(kit: Kit, copied: Callable[[Kit], Path], ending: str) -> None:
    folder = copied(kit)
    file = folder / "sim" / f"tactape-s100{ending}"
    data = bytearray(file.read_bytes())
    data[-20] ^= 1
    file.write_bytes(data)
    failed = {check.name for check in verify_kit(folder).checks if not check.passed}
    assert "files" in failed
    assert not reproduce_kit(folder).passed


def test_without_it_a_manifest_does_not_know_the_option(flat_kit: Kit) -> None:
    content = read_manifest(flat_kit.path / "manifest.json")
    assert "sim" not in content["spec"] and SIM not in {row["role"] for row in content["files"]}


def test_a_mould_has_none() -> None:
    with pytest.raises(SpecError, match="nobody touches a mould"):
        TapeSpec(sector=1, part="dome", negative=True, sim=True)


def test_parts_larger_than_their_cells_are_refused_even_if_forced(tmp_path: Path) -> None:
    spec = TapeSpec(sector=7, size_mm=(30.0, 20.0), pitch_mm=0.75, models=False, sim=True)
    with pytest.raises(DesignRuleError, match=r"larger than its cell.*or leave out --sim"):
        make_kit(spec, tmp_path / "kit", force=True)
    assert list(tmp_path.iterdir()) == []
