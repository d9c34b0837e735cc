"""Kits as `emboss` takes them, and parts to emboss: balls, saddles, boxes, cylinders, cones, as meshes and as STEP files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from tactape_fab import Tape, TapeSpec
from tactape_fab.kit.plan import plan
from tactape_fab.kit.profiles import load_fab, load_part
from tactape_fab.make.emboss import Embossed, emboss_kit
from tactape_fab.solids.mesh.triangles import Mesh
from tactape_fab.solids.surface.part_files import closed_mesh, read_surface_mesh


def planned(size_mm: tuple[float, float] = (14.0, 14.0), **values: Any) -> Tape:
    """A tape without a strip: 8 x 8 points at 14 x 14 mm."""
    spec = TapeSpec(sector=7, size_mm=size_mm, tag="none", **values)
    return plan(spec, load_fab("generic-fpc"), load_part(spec.part))


def kit_folder(folder: Path, tape: Tape) -> Path:
    """A folder that holds nothing but the manifest of a tape."""
    folder.mkdir(parents=True)
    content = {"format": "tactape-manifest/1", **tape.to_mapping(), "files": []}
    (folder / "manifest.json").write_text(json.dumps(content), encoding="ascii")
    return folder


def ball(radius_mm: float = 25.0, subdivisions: int = 5) -> Any:
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)


def box(x_mm: float = 30.0, y_mm: float = 30.0, z_mm: float = 5.0) -> Any:
    """About the origin, its top at z / 2."""
    return trimesh.creation.box((x_mm, y_mm, z_mm))


def cylinder(radius_mm: float = 16.0, length_mm: float = 60.0, sections: int = 256) -> Any:
    """About the z axis."""
    return trimesh.creation.cylinder(radius_mm, length_mm, sections=sections)


def saddle(size_mm: float = 30.0, points: int = 81) -> Any:
    """A slab 4 mm thick whose top is z = (x^2 - y^2) / 60; written as a grid of quads, each two triangles."""
    line = np.linspace(-size_mm / 2, size_mm / 2, points)
    x, y = np.meshgrid(line, line, indexing="ij")
    top = np.stack([x, y, (x**2 - y**2) / 60], axis=2).reshape(-1, 3)
    i = np.arange(points * points).reshape(points, points)
    a, b, c, d = (corner.ravel() for corner in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    up = np.vstack([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    rim = np.concatenate([i[:-1, 0], i[-1, :-1], i[:0:-1, -1], i[0, :0:-1]])
    after, below = np.roll(rim, -1), points * points
    side = np.vstack([np.stack([rim + below, after + below, after], axis=1), np.stack([rim + below, after, rim], axis=1)])
    return trimesh.Trimesh(np.vstack([top, top - (0, 0, 4)]), np.vstack([up, up[:, ::-1] + below, side]), process=False)


def stl_of(model: Any) -> bytes:
    return bytes(model.export(file_type="stl"))


def mesh_of(model: Any) -> Mesh:
    """A trimesh model as the product reads it from an STL file."""
    return closed_mesh(read_surface_mesh(stl_of(model), "stl"))


def step_file(path: Path, shape: Any) -> Path:
    """Write a build123d shape as STEP with a fixed date."""
    import build123d as bd

    bd.export_step(shape, path, timestamp="1980-01-01T00:00:00")
    return path


def emboss(kit: Path, model: Any, name: str = "part.stl", **options: Any) -> Embossed:
    """Write a model beside the kit and emboss it."""
    path = kit.parent / name
    if model is not None:
        data = model if isinstance(model, bytes) else model.export(file_type=path.suffix[1:])
        path.write_bytes(data.encode() if isinstance(data, str) else data)
    return emboss_kit(kit, path, **options)
