"""STL and 3MF read by PrusaSlicer, and a tape of 20 x 20 mm sliced for a resin printer."""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely

from tactape_fab.solids.forms import SolidForm
from tests.readers.solids import NAMES, Variant, slicer_info, written
from tests.solids import BLOCK, DOME, tape_of
from tests.thorough import slow

DISPLAY_MM, DISPLAY_PX = (120.0, 68.0), (2560, 1440)
LAYER_MM = 0.05


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("ending", ["stl", "3mf"])
def test_prusa_slicer_finds_one_manifold_part(
    name: str, ending: str, prusa_slicer: str, solid_variants: dict[str, Variant]
) -> None:
    variant = solid_variants[name]
    found = slicer_info(prusa_slicer, variant.path(ending))
    assert (found["manifold"], found["number_of_parts"]) == ("yes", "1")
    assert float(found["number_of_facets"]) == len(variant.mesh.faces)
    assert float(found["volume"]) == pytest.approx(variant.mesh.volume_mm3, rel=5e-5)
    vertices = variant.mesh.vertices_mm
    size = [float(found[f"size_{axis}"]) for axis in "xyz"]
    assert size == pytest.approx(np.ptp(vertices, axis=0).tolist(), abs=2e-5)


@slow
def test_a_texture_of_20_x_20_mm_slices_for_a_resin_printer(prusa_slicer: str, tmp_path: Path) -> None:
    """The pixels that cure above the base are as many islands as there are elements, each in its element's place."""
    tape = tape_of(BLOCK, 12, 12, omitted=[(3, 4)])
    assert max(tape.board.size_mm) == pytest.approx(20.0, abs=0.2)
    variant = written(tape, SolidForm(), tmp_path / "tape")
    settings = f"--export-sla --printer-technology SLA --layer-height {LAYER_MM} --initial-layer-height {LAYER_MM}"
    flat = "--supports-enable=0 --pad-enable=0"
    command = [prusa_slicer, *settings.split(), *flat.split(), "--output", "t.sl1", variant.path("stl")]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    with zipfile.ZipFile(tmp_path / "t.sl1") as archive:
        names = sorted(name for name in archive.namelist() if name.endswith(".png"))
        layers = [cv2.imdecode(np.frombuffer(archive.read(name), np.uint8), cv2.IMREAD_GRAYSCALE) for name in names]
    assert len(layers) in (20, 21)  # 0.8 mm of base and 0.23 mm of texture
    islands = []
    for layer in layers:
        assert layer is not None
        assert layer.shape == DISPLAY_PX  # portrait
        count, _, _, centres = cv2.connectedComponentsWithStats((layer > 127).astype(np.uint8))
        islands.append((count - 1, centres[1:]))
    assert [count for count, _ in islands[:16]] == [1] * 16
    assert [count for count, _ in islands[17:]] == [tape.part_count] * (len(layers) - 17)
    pixel_mm = np.array(DISPLAY_MM) / DISPLAY_PX  # its pixels are not quite square, and the picture is turned
    seen = islands[-1][1] * pixel_mm
    expected = tape.part_xy_mm()
    worst = []
    for turn in (np.array(((a, 0), (0, b))) for a in (1, -1) for b in (1, -1)):  # the display's mirror and axes
        for matrix in (turn, turn[::-1]):
            moved = seen @ matrix.T
            moved += expected.mean(axis=0) - moved.mean(axis=0)
            tree = shapely.STRtree(shapely.points(moved))
            _, distance = tree.query_nearest(shapely.points(expected), return_distance=True, all_matches=False)
            worst.append(distance.max())
    assert min(worst) < pixel_mm.max()


@slow
def test_a_dome_slices_with_supports_as_they_are_by_default(prusa_slicer: str, tmp_path: Path) -> None:
    variant = written(tape_of(DOME, 4, 4), SolidForm(), tmp_path / "tape")
    command = f"--export-sla --printer-technology SLA --layer-height {LAYER_MM} --output t.sl1 {variant.path('stl')}"
    subprocess.run([prusa_slicer, *command.split()], check=True, capture_output=True, cwd=tmp_path)
    with zipfile.ZipFile(tmp_path / "t.sl1") as archive:
        assert archive.testzip() is None
        assert len([name for name in archive.namelist() if name.endswith(".png")]) > 20
