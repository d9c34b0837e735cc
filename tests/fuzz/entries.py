"""Every place where the package reads bytes that somebody else may have written.

An entry point is given a file's bytes and a folder of its own, and reads them as the package's commands do. Whatever the bytes
are, it answers, or raises an error of the package's tree.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from threading import Event

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields
from tactape_fab.kit.profiles.fabs import load_fab
from tactape_fab.kit.profiles.parts import read_part
from tactape_fab.kit.profiles.processes import load_process
from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.kit.spec.tape_list import is_list, read_list, read_list_file
from tactape_fab.kit.spec.tape_spec import read_spec
from tactape_fab.sense import load_network, load_sensor
from tactape_fab.sense.files.depth_maps import open_frame_file
from tactape_fab.sense.inspect.scan_files import read_scan
from tactape_fab.sense.live.stream import stream_source
from tactape_fab.sense.objects.taped_object import read_object
from tactape_fab.sense.raw.image_files import read_colour
from tactape_fab.solids.forms import read_form
from tactape_fab.solids.mesh.stl import MeshError, read_stl
from tactape_fab.solids.surface.part_files import closed_mesh, read_surface_mesh
from tactape_fab.solids.surface.placements import read_placements
from tactape_fab.texture.as_built import AsBuilt
from tactape_fab.texture.manifest import read_manifest
from tactape_fab.texture.registry import read_tapes
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.certificate import check_certificate
from tactape_fab.verify.files import WrittenFile, check_listed, check_picture
from tactape_fab.verify.film import (
    anchor_lines,
    check_attributes,
    check_tape,
    pair_all_lands,
    read_film_manifest,
    read_layers,
)
from tactape_fab.verify.film import read_role as read_of
from tactape_fab.verify.layers.cpl_rows import check_bom, check_cpl
from tactape_fab.verify.layers.drawings import check_drawings
from tactape_fab.verify.layers.fab_zip import check_zip
from tactape_fab.verify.layers.job_file import check_job
from tactape_fab.verify.layers.kicad import check_kicad, shown_tape
from tactape_fab.verify.layers.kicad_drawn import Made
from tactape_fab.verify.layers.order_notes import check_order_notes
from tactape_fab.verify.layers.written_form import check_form
from tactape_fab.verify.models.meshes import check_models
from tactape_fab.verify.pictured import Pictured
from tests.fuzz.recordings import recording_entries
from tests.fuzz.seeds import Seeds

Read = Callable[[bytes, Path], object]
Files = dict[str, WrittenFile]
LAYERS = ("copper-top", "coverlay-top", "paste-top", "legend-top", "profile", "drill-npth", "components-top")


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """How bytes of one kind are read, and valid ones to begin with.

    Attributes
    ----------
    read : callable
        Takes the bytes, and a folder to put them in.
    seeds : sequence of bytes
    """

    read: Read
    seeds: Sequence[bytes]


def all_entries(seeds: Seeds) -> dict[str, Entry]:
    """Every entry point by its name."""
    kit = {f"kit: {role}": Entry(read=read, seeds=[seeds.files[role].data]) for role, read in _of_a_kit(seeds).items()}
    other = seeds.others
    return {
        "manifest": Entry(read=_file("manifest.json", Tape.load), seeds=[other["manifest.json"]]),
        "packed registry": Entry(read=_file("a.registry", lambda path: read_tapes([path])), seeds=[other["a.registry"]]),
        "panel manifest": Entry(read=_panel(other), seeds=[other["panel.json"]]),
        "kit: manifest": Entry(read=_file("manifest.json", _records), seeds=[other["manifest.json"]]),
        "spec": Entry(read=_file("spec.toml", _spec), seeds=[other["spec.toml"], other["list.toml"]]),
        "fab profile": Entry(read=_file("a.toml", lambda path: load_fab(str(path))), seeds=[other["fab.toml"]]),
        "part profile": Entry(
            read=_file("a.toml", lambda path: read_part(str(path))), seeds=[other["part.toml"], other["element.toml"]]
        ),
        "process profile": Entry(read=_file("a.toml", lambda path: load_process(str(path))), seeds=[other["process.toml"]]),
        "sensor profile": Entry(read=_file("a.toml", load_sensor), seeds=[other["sensor.toml"]]),
        "sensor mask": Entry(read=_mask(other["sensor.toml"]), seeds=[other["mask.png"]]),
        "object": Entry(read=_object(other), seeds=[other["object.toml"]]),
        "as-built": Entry(read=_file("as-built.json", AsBuilt.load), seeds=[other["as-built.json"]]),
        "placements": Entry(read=lambda data, _: read_placements(data, 1), seeds=[other["placements.csv"]]),
        "frames.npz": Entry(read=_file("a.npz", _frames), seeds=[other["frames.npz"]]),
        "frames.npy": Entry(read=_file("a.npy", _frames), seeds=[other["frames.npy"], other["f-order.npy"]]),
        "frame.png": Entry(read=_file("a.png", _frames), seeds=[other["depth.png"]]),
        "frame.tif": Entry(read=_file("a.tif", _frames), seeds=[other["depth.tif"]]),
        "stream": Entry(read=_stream, seeds=[other["stream.bin"]]),
        "colour.png": Entry(read=_file("a.png", read_colour), seeds=[other["colour.png"]]),
        "colour.jpg": Entry(read=_file("a.jpg", read_colour), seeds=[other["colour.jpg"]]),
        "scan": Entry(read=_file("a.png", read_scan), seeds=[other[f"scan.{kind}"] for kind in ("png", "jpg", "tif")]),
        "weights": Entry(read=_file("a.pth", load_network), seeds=[other["weights.pth"]]),
        **{f"surface.{kind}": Entry(read=_surface(kind), seeds=[other[f"part.{kind}"]]) for kind in ("stl", "obj", "ply", "3mf")},
        **{name: Entry(read=read, seeds=valid) for name, (read, valid) in recording_entries().items()},
        **kit,
    }


def _file(name: str, call: Callable[[Path], object]) -> Read:
    """Read the bytes as a file of this name."""

    def read(data: bytes, folder: Path) -> object:
        (folder / name).write_bytes(data)
        return call(folder / name)

    return read


def _panel(other: dict[str, bytes]) -> Read:
    paths = [row["manifest"] for row in json.loads(other["panel.json"])["tapes"]]

    def read(data: bytes, folder: Path) -> object:
        for path in paths:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(other["manifest.json"])
        (folder / "manifest.json").write_bytes(data)
        return read_tapes([folder])

    return read


def _object(other: dict[str, bytes]) -> Read:
    def read(data: bytes, folder: Path) -> object:
        (folder / "kit").mkdir(exist_ok=True)
        (folder / "kit" / "manifest.json").write_bytes(other["manifest.json"])
        (folder / "object.toml").write_bytes(data)
        return read_object(folder / "object.toml")

    return read


def _mask(profile: bytes) -> Read:
    masked = profile.replace(b"[image]", b'[image]\nmask = "mask.png"')
    assert masked != profile

    def read(data: bytes, folder: Path) -> object:
        (folder / "mask.png").write_bytes(data)
        (folder / "sensor.toml").write_bytes(masked)
        return load_sensor(folder / "sensor.toml")

    return read


def _spec(path: Path) -> object:
    values = read_list_file(path)
    return read_list(values, {}) if is_list(values, {}) else read_spec(values)


def _frames(path: Path) -> object:
    return list(islice(open_frame_file(path).frames(), 3))


def _stream(data: bytes, _: Path) -> object:
    return list(islice(stream_source(io.BytesIO(data))(Event()), 100))


def _surface(kind: str) -> Read:
    return lambda data, _: closed_mesh(read_surface_mesh(data, kind))


# Files of a kit, in the company of the others


def _records(path: Path) -> object:
    """What `verify` reads of a manifest besides the tape."""
    table = Fields(read_manifest(path))
    return read_film_manifest(table), read_form(table.table("solid"))


def _of_a_kit(seeds: Seeds) -> dict[str, Read]:
    tape, film = seeds.tape, seeds.film
    form = read_form(Fields(seeds.manifest).table("solid"))
    cpl = read_cpl(seeds.files["cpl"].data)
    shown = shown_tape(tape, *anchor_lines(film, tape))

    def layers(files: Files) -> object:
        checks: list[Check] = []
        found = read_layers(files, cpl, film.film, checks)
        pairs = pair_all_lands(found, film.lands, tape)
        checks += check_tape(found, pairs, tape, film, files, with_pupil=False)
        return checks, check_form(files, found.gerbers), check_attributes(found.gerbers, files, film)

    def places(files: Files) -> object:
        checks: list[Check] = []
        found = read_of("cpl", read_cpl, files, checks)
        return found and check_cpl(found, tape, film.assembly, film.lands.pads)

    def models(files: Files) -> object:
        try:
            mesh = read_stl(files["stl"].data)
        except MeshError as error:
            return str(error)
        return check_models(tape, form, files, mesh, cpl)

    gerbers = read_layers(seeds.files, cpl, film.film, []).gerbers
    made = Made(name=tape.name, tape=tape, record=film, gerbers=gerbers, radius_mm=tape.board.corner_radius_mm)

    def pictures(files: Files) -> object:
        xy_mm, turned_deg, body_mm = shown.parts_xy_mm, shown.rotation_deg, tape.part.body_mm[:2]
        film = Pictured(size_mm=shown.size_mm, xy_mm=xy_mm, rotation_deg=turned_deg, body_mm=body_mm)
        return check_picture(files, tape.name, film)

    checks: dict[str, Callable[[Files], object]] = {
        **dict.fromkeys(LAYERS, layers),
        "cpl": places,
        "bom": lambda files: check_bom(files["bom"].data, tape.designators(), film.assembly),
        "order-notes": lambda files: check_order_notes(files, tape, film=film),
        **dict.fromkeys(("fab-dxf", "fab-drawing"), lambda files: check_drawings(files, shown, made)),
        "job": lambda files: check_job(tape.name, tape.board.size_mm, film.order, files),
        "fab-zip": check_zip,
        **dict.fromkeys(("kicad-pcb", "kicad-project"), lambda files: check_kicad(files, shown, made)),
        "certificate": lambda files: check_certificate(files["certificate"], tape),
        **dict.fromkeys(("preview-png", "preview-svg", "placement-preview"), pictures),
        "report": lambda files: check_listed(seeds.manifest, {"report": [files["report"]]}, []),
        **dict.fromkeys(("stl", "3mf", "step-solid", "step-assembly"), models),
    }

    def reading(role: str, check: Callable[[Files], object]) -> Read:
        # one layer alone is enough of them: what it is compared with is read by the other entry points
        kept = {role, "copper-top"} if role in LAYERS else set(seeds.files)
        company = {name: file for name, file in seeds.files.items() if name in kept}
        path = seeds.files[role].path
        return lambda data, _: check({**company, role: WrittenFile(path=path, data=data)})

    return {role: reading(role, check) for role, check in checks.items() if role in seeds.files}
