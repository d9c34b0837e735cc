"""Valid files of every kind that is read, made by the package itself, the smaller the better."""

from __future__ import annotations

import io
import json
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import trimesh

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.base.fields import Fields
from tactape_fab.base.templates import templates_folder
from tactape_fab.solids.surface.placements import COLUMNS
from tactape_fab.texture.as_built_file import AS_BUILT_FORMAT
from tactape_fab.texture.manifest import read_manifest
from tactape_fab.texture.packed import pack
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.film import read_film_manifest
from tactape_fab.verify.layers.film_layers import FilmManifest
from tests.panels import TWO, panel_of
from tests.raw_images import random_layers, tensors_of, weights_file

_SPEC = TapeSpec(sector=100, size_mm=(20.0, 20.0), holes_mm=[(16.4, 10.0, 1.0)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Seeds:
    """A small kit as `verify` knows it, and files of every other kind by their names."""

    tape: Tape
    manifest: dict[str, Any]
    film: FilmManifest
    files: dict[str, WrittenFile]
    others: dict[str, bytes]


def make_seeds() -> Seeds:
    """All of them; some seconds."""
    with TemporaryDirectory(prefix="tactape-seeds-") as folder:
        here = Path(folder)
        kit = make_kit(_SPEC, here / "tactape-s100", verify=False)
        panel = panel_of(TWO, here / "panel")
        manifest = read_manifest(kit.path / "manifest.json")
        weights_file(here / "w.pth", tensors_of(random_layers((5, 4, 2))))
        return Seeds(
            tape=kit.tape,
            manifest=manifest,
            film=read_film_manifest(Fields(manifest)),
            files={role: WrittenFile(path=path, data=(kit.path / path).read_bytes()) for role, path in kit.files.items()},
            others={
                "manifest.json": (kit.path / "manifest.json").read_bytes(),
                "a.registry": pack([kit.tape], [""]),
                "panel.json": (panel.path / "manifest.json").read_bytes(),
                "weights.pth": (here / "w.pth").read_bytes(),
                "as-built.json": _as_built(kit),
                **_texts(),
                **_arrays(),
                **_pictures(),
                **_models(),
            },
        )


def _as_built(kit: Kit) -> bytes:
    names = kit.tape.designators()[:3]
    columns = {"dx_mm": [0.01, 0.0, -0.02], "dy_mm": [0.0] * 3, "rotation_deg": [0.1] * 3, "sigma_mm": [0.005] * 3}
    content = {
        "format": AS_BUILT_FORMAT,
        "tape": kit.tape.name,
        "manifest_sha256": "0" * 64,
        "film": {"scale": [1.0, 1.0], "shear": 0.0, "sigma": 1e-4},
        "parts": {"designator": names, **columns, "present": [True] * 3},
        "source": [{"kind": "survey"}],
    }
    return json.dumps(content).encode()


def _texts() -> dict[str, bytes]:
    profiles = templates_folder()
    taken = {"fab": "fabs/generic-fpc", "part": "parts/r0201", "element": "parts/dome", "sensor": "sensors/digit"}
    taken["process"] = "processes/sla"
    found = {f"{name}.toml": (profiles / f"{path}.toml").read_bytes() for name, path in taken.items()}
    found["spec.toml"] = b"sector = 7\npitch_mm = 1.5\nsize_mm = [60.0, 30.0]\nholes_mm = [[40.0, 10.0, 1.0]]\n"
    found["list.toml"] = b'size_mm = [60.0, 30.0]\n[[tapes]]\nsector = 3\nname = "a"\n[[tapes]]\nsector = 4\ntag_id = 4\n'
    pose = b"position_mm = [0.0, 0.0, 10.0]\nrpy_deg = [0.0, 0.0, 90.0]\n"
    found["object.toml"] = b'name = "cup"\n[[tapes]]\nkit = "kit"\nsurface = "plane"\nsigma_mm = 0.2\nsigma_deg = 0.3\n' + pose
    found["placements.csv"] = _placements()
    return found


def _placements() -> bytes:
    return (",".join(COLUMNS) + "\r\n" + "R1,0,0," + "1.000000," * 6 + "1.0,0.0,0.0,0.0,0.0,1.0\r\n").encode()


def _arrays() -> dict[str, bytes]:
    depth = np.linspace(0, 1, 2 * 6 * 8, dtype=np.float32).reshape(2, 6, 8)
    stream = io.BytesIO()
    np.savez_compressed(stream, depth=depth, timestamp=np.arange(2.0), px_per_mm=np.array(16.0))
    found = {"frames.npz": stream.getvalue()}
    for name, array in (("frames.npy", depth), ("f-order.npy", np.asfortranarray(depth[0])), ("stamp.npy", np.float64(3.5))):
        stream = io.BytesIO()
        np.save(stream, array)
        found[name] = stream.getvalue()
    found["stream.bin"] = found["stamp.npy"] + found["f-order.npy"] + b"junk" + found["frames.npy"]
    return found


def _pictures() -> dict[str, bytes]:
    grey = (np.arange(24 * 32).reshape(24, 32) % 251).astype(np.uint8)
    colour = np.repeat(grey[..., None], 3, axis=2)
    mask = np.full((320, 240), 255, dtype=np.uint8)
    images = {"depth.png": grey.astype(np.uint16), "depth.tif": grey.astype(np.uint16), "mask.png": mask}
    found = {name: cv2.imencode(Path(name).suffix, image)[1].tobytes() for name, image in images.items()}
    for suffix in (".png", ".jpg", ".tif"):
        found[f"colour{suffix}"] = cv2.imencode(suffix, colour)[1].tobytes()
    wide = np.repeat(np.tile(grey, (3, 3))[..., None], 3, axis=2)
    found |= {f"scan{suffix}": cv2.imencode(suffix, wide)[1].tobytes() for suffix in (".jpg", ".tif")}
    found["scan.png"] = _with_dpi(cv2.imencode(".png", wide)[1].tobytes())
    return found


def _with_dpi(png: bytes) -> bytes:
    """A PNG that says its resolution, as a scanner's does (pHYs behind IHDR)."""
    body = b"pHYs" + struct.pack(">IIB", 23622, 23622, 1)
    return png[:33] + struct.pack(">I", 9) + body + struct.pack(">I", zlib.crc32(body)) + png[33:]


def _models() -> dict[str, bytes]:
    box = trimesh.creation.box((10.0, 8.0, 6.0))
    found = {}
    for kind in ("stl", "obj", "ply", "3mf"):
        data = box.export(file_type=kind)
        found[f"part.{kind}"] = data.encode() if isinstance(data, str) else data
    return found
