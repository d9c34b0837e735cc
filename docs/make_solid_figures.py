"""Makes the pictures of docs/solids.md: every variant of the solid models, drawn from written files without a display.

Run: python docs/make_solid_figures.py [NAME...]
"""

from __future__ import annotations

import tempfile
from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab import TapeSpec, make_kit
from tactape_fab.make.emboss import emboss_kit
from tactape_fab.solids.mesh.stl import read_stl
from tactape_fab.solids.picture import png_bytes, shaded
from tactape_fab.solids.surface.charts import Placement

FIGURES = Path(__file__).parent / "figures"
WIDTH_PX = 640
OBLIQUE = (0.25, -0.8, 1.0)
TOP = (0.0, 0.0, 1.0)

Folder = Path
Direction = tuple[float, float, float]


def drawn(stl: Path, direction: Direction, up: Direction) -> bytes:
    return png_bytes(shaded(read_stl(stl.read_bytes()), direction=direction, up=up, width_px=WIDTH_PX))


def kit_picture(direction: Direction = OBLIQUE, **spec: Any) -> Callable[[Folder], bytes]:
    """A kit's STL."""

    def draw(folder: Folder) -> bytes:
        kit = make_kit(TapeSpec(sector=7, **spec), folder / "kit")
        return drawn(kit.path / kit.files["stl"], direction, TOP)

    return draw


def emboss_picture(
    surface: Callable[[Folder], Path], direction: Direction, placement: Placement, size_mm: tuple[float, float]
) -> Callable[[Folder], bytes]:
    """The STL of a texture on a part."""

    def draw(folder: Folder) -> bytes:
        kit = make_kit(TapeSpec(sector=7, part="block", size_mm=size_mm), folder / "kit")
        made = emboss_kit(kit.path, surface(folder), folder / "part", placement=placement)
        return drawn(made.path / made.files["stl"], direction, TOP)

    return draw


def sphere(folder: Folder) -> Path:
    """A sphere of radius 25 mm as STL."""
    import trimesh

    path = folder / "sphere.stl"
    trimesh.creation.icosphere(subdivisions=5, radius=25.0).export(path)
    return path


def saddle(folder: Folder) -> Path:
    """A slab of 40 x 40 mm under the saddle z = (x2 - y2) / 100, as STL."""
    import trimesh

    n = 81
    x, y = np.meshgrid(np.linspace(-20, 20, n), np.linspace(-20, 20, n), indexing="ij")
    top = np.stack([x, y, (x**2 - y**2) / 100], axis=-1).reshape(-1, 3)
    low = top * (1, 1, 0) - (0, 0, 10)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    a = (i * n + j).ravel()
    quads = np.concatenate([np.stack([a, a + n, a + n + 1], axis=1), np.stack([a, a + n + 1, a + 1], axis=1)])
    rim = np.concatenate(
        [np.arange(n) * n, (n - 1) * n + np.arange(1, n), np.arange(n - 2, -1, -1) * n + n - 1, np.arange(n - 2, 0, -1)]
    )
    p, q = rim, np.roll(rim, -1)
    walls = np.concatenate([np.stack([q, p, p + n * n], axis=1), np.stack([q, p + n * n, q + n * n], axis=1)])
    mesh = trimesh.Trimesh(np.vstack([top, low]), np.concatenate([quads, quads[:, ::-1] + n * n, walls]), process=False)
    assert mesh.is_watertight
    assert mesh.volume > 0
    path = folder / "saddle.stl"
    mesh.export(path)
    return path


def step_of(shape: str) -> Callable[[Folder], Path]:
    """A plain body as STEP."""

    def write(folder: Folder) -> Path:
        import build123d as b3d

        body = {
            "plane": lambda: b3d.Box(50, 40, 12),
            "cylinder": lambda: b3d.Rotation(0, 90, 0) * b3d.Cylinder(18, 50),
            "cone": lambda: b3d.Rotation(0, 90, 0) * b3d.Cone(22, 16, 50),
        }[shape]()
        path = folder / f"{shape}.step"
        b3d.export_step(body, path)
        return path

    return write


PICTURES: dict[str, Callable[[Folder], bytes]] = {
    "flat-block": kit_picture(part="block", size_mm=(24, 16)),
    "flat-dome": kit_picture(part="dome", size_mm=(24, 16)),
    "flat-cone": kit_picture(part="cone", size_mm=(24, 16)),
    "mould": kit_picture(part="block", size_mm=(24, 16), negative=True),
    "cylinder-16": kit_picture(part="block", size_mm=(40, 24), cylinder_mm=16.0),
    "cylinder-25": kit_picture(part="dome", size_mm=(40, 24), cylinder_mm=25.0),
    "cylinder-50": kit_picture(part="block", size_mm=(60, 30), cylinder_mm=50.0),
    "cylinder-whole": kit_picture(part="dome", size_mm=(62, 30), cylinder_mm=10.0, shell="whole"),
    "emboss-sphere": emboss_picture(sphere, OBLIQUE, Placement(), (24, 24)),
    "emboss-saddle": emboss_picture(saddle, OBLIQUE, Placement(at_mm=(0.0, 0.0, 0.0)), (24, 24)),
    "emboss-plane": emboss_picture(step_of("plane"), OBLIQUE, Placement(at_mm=(0.0, 0.0, 6.0)), (30, 20)),
    "emboss-cylinder": emboss_picture(step_of("cylinder"), OBLIQUE, Placement(at_mm=(0.0, 0.0, 18.0)), (30, 20)),
    "emboss-cone": emboss_picture(step_of("cone"), OBLIQUE, Placement(at_mm=(0.0, 0.0, 19.0)), (30, 20)),
}


def main(names: list[str]) -> None:
    FIGURES.mkdir(exist_ok=True)
    for name in names or PICTURES:
        with tempfile.TemporaryDirectory() as folder:
            (FIGURES / f"solid-{name}.png").write_bytes(PICTURES[name](Path(folder)))
        print(FIGURES.name + f"/solid-{name}.png")


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="all unless named")
    main(parser.parse_args().names)
