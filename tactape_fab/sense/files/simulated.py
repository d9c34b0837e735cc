"""simulate_file: writes frames of a kit's tape with their truth as one file."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np

from tactape_fab.base.build_date import zip_date, zip_entry
from tactape_fab.base.errors import Problem, SpecError, refuse, tried
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.input_file import open_regular
from tactape_fab.base.output_file import not_written, refuse_taken_place, sync_file, sync_folder, unfinished
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.sense.files.depth_maps import ZIP_ERRORS
from tactape_fab.sense.sensors import MOST_FRAMES, SensorProfile, load_sensor
from tactape_fab.sense.simulation.arguments import bend_problems, edge_problems
from tactape_fab.sense.simulation.draw import Frame, iterate_frames
from tactape_fab.sense.simulation.elastic_contact import ElasticContact
from tactape_fab.sense.simulation.parts import Parts, built_parts_of, parts_from_cpl
from tactape_fab.sense.simulation.scene import Scene, blur_of
from tactape_fab.sense.simulation.view import FARTHEST_MM
from tactape_fab.texture.as_built import NOMINAL, TAKE_DESIGN
from tactape_fab.texture.manifest import find_manifest, read_manifest, safe_path
from tactape_fab.texture.tape import Tape

SCENE_MEMBER = "scene"
"""Member with the simulated scene as JSON; marks a file of frames that may be overwritten."""

Progress = Callable[[str, int, int], None]

PLACES = ("design", "cpl", "as-built")
"""Where the places of parts may come from."""

_SCENE_KEYS = {
    "contact": "contact_mm",
    "cylinder": "cylinder_radius_mm",
    "missing": "missing",
    "bumps": "bumps",
    "noise": "noise",
    "noise_model": "noise_model",
    "placement": "placement_mm",
    "elastomer": "elastomer_mm",
    "scale_error": "scale_error",
    "aspect_error": "aspect_error",
    "shear_error": "shear_error",
    "k1_error": "k1_error",
    "gel_displacement": "gel_displacement_um",
    "gel_correlation": "gel_correlation_mm",
}
"""Options of the command line and the attributes of Scene that they set."""
_ELASTIC_KEYS = {
    "force": "force_n",
    "tilt": "tilt_deg",
    "gel_thickness": "thickness_mm",
    "gel_modulus": "modulus_kpa",
    "markers": "markers",
}
"""Options of an elastic contact alone, and the attributes of ElasticContact that they set."""
_CONTACT_MODELS = ("imprint", "elastic")


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulated:
    """A written file of frames: number, shape, tape and sensor, parts that the pick-and-place file leaves out.

    unrolled_mm: Radius that the kit's texture is wrapped round, where it is drawn flat nevertheless.
    """

    path: Path
    count: int
    frame_shape: tuple[int, int]
    tape: str
    sensor: str
    left_out: int = 0
    unrolled_mm: float | None = None


def simulate_file(
    kit: str | Path,
    output: str | Path,
    *,
    count: int = 1,
    seed: int = 0,
    sensor: str = DEFAULT_SENSOR,
    pose: object = None,
    edge: bool = False,
    from_cpl: bool = False,
    places: str | None = None,
    as_built: str | None = None,
    progress: Progress = lambda *_: None,
    **scene: Any,
) -> Simulated:
    """Simulate frames of a kit's tape and write them as .npz.

    kit, output: A kit, and the file to write: depth (count, h, w), position_mm (count, 2), theta_deg (count,), px_per_mm (2,).
    count, seed: Equal seeds give equal bytes.
    sensor: Profile name or the path of its TOML file.
    pose: x mm, y mm, theta deg of every frame; poses spread over the tape when left out.
    edge: Spread them along the texture's edge.
    from_cpl: Take the places of parts from the kit's pick-and-place file; the same as ``places="cpl"``.
    places {"design", "cpl", "as-built"}: Where the places of parts come from: the design, which None is, the kit's pick-and-place
        file, or what was measured of the tape.
    as_built: File of measured places instead of the kit's as-built.json.
    progress: Called with a text, the number of frames done and their total.
    **scene: contact ((a, b) in mm, or "pad"), cylinder (radius mm), missing, bumps, noise, noise_model, placement, elastomer,
        scale_error, aspect_error, shear_error, k1_error, gel_displacement, gel_correlation: attributes of `Scene`. contact_model
        ("imprint" or "elastic"); with "elastic" force (N), tilt (two angles, degrees), gel_thickness (mm), gel_modulus (kPa),
        markers, cylinder and elastomer (its blur): attributes of `ElasticContact`.
    Raises SpecError with every invalid value.
    Raises TactapeError if the file cannot be written.
    """
    table = Fields({"count": count, "seed": seed, **({} if pose is None else {"pose": pose})})
    frames_count = table.integer("count", low=1, high=MOST_FRAMES, default=1)
    whole_seed = table.integer("seed", low=0, high=2**64 - 1)
    remedy = f"give X,Y,THETA in mm and degrees, such as 20,12,30, each from {-FARTHEST_MM:g} to {FARTHEST_MM:g}"
    at = table.numbers("pose", 3, low=-FARTHEST_MM, high=FARTHEST_MM, unit="", remedy=remedy) if pose is not None else None
    problems = table.problems + edge_problems(edge, pose, "--pose")
    how = tried(lambda: _scene(scene), problems)
    profile = tried(lambda: load_sensor(sensor), problems)
    if from_cpl and places not in (None, "cpl"):
        problems.append(Problem("from", f"--from {places} and --from-cpl both name the parts' places; give one of them"))
    elif as_built is not None and places != "as-built":
        message = f"as_built = {shown(as_built)} names measured places, and nothing asks for them; add --from as-built"
        problems.append(Problem("as-built", message))
    named = Fields({"from": "cpl" if from_cpl else "design" if places is None else places}, problems=problems)
    source = named.text("from", choices=PLACES, default="design")
    measured = NOMINAL if source != "as-built" else as_built
    tape = tried(partial(_tape, kit, measured), problems)
    parts = None if tape is None else tried(partial(_parts_from, source, tape, kit), problems)
    path = tried(lambda: refuse_taken_file(output), problems)
    if how is not None and how.contact == "strip" and tape is not None:
        ways = "leave out --cylinder", "use --cylinder {:g}"
        problems += bend_problems(tape, how.cylinder_radius_mm, "cylinder", *ways)
    refuse(problems)
    assert how is not None and profile is not None and tape is not None and path is not None
    poses = None if at is None else np.tile(at, (frames_count, 1))
    frames = iterate_frames(tape, frames_count, whole_seed, profile, how, poses=poses, edge=edge, parts=parts)
    record: dict[str, Any] = {"tape": tape.name, "sector": tape.sector, "sensor": profile.name}
    record |= {
        "seed": whole_seed,
        "edge": edge,
        "from_cpl": source == "cpl",
        "scene": how.to_mapping() | {"elastomer_mm": blur_of(how, profile.gel)},
    }
    if tape.as_built is not None:
        record["as_built"] = tape.as_built.manifest_sha256
    write_frames(path, _shown(frames, frames_count, progress), frames_count, profile, record)
    return Simulated(
        path=path,
        count=frames_count,
        frame_shape=profile.frame_shape,
        tape=tape.name,
        sensor=profile.name,
        left_out=tape.part_count - len(parts.xy_mm) if parts is not None and source == "cpl" else 0,
        unrolled_mm=_wrapped_mm(kit) if how.contact != "strip" else None,
    )


def _wrapped_mm(kit: str | Path) -> float | None:
    """Radius of the cylinder that a kit's models are wrapped round, mm; None if they are flat."""
    found = _recorded(kit, "solid", "cylinder", "radius_mm")
    return found if isinstance(found, float) else None


def _recorded(kit: str | Path, *keys: str) -> object:
    """A value of a manifest's tables; None if it is not there."""
    found: Any = read_manifest(find_manifest(kit))
    for key in keys:
        found = found.get(key) if isinstance(found, Mapping) else None
    return found


def _scene(options: Mapping[str, Any]) -> Scene:
    """The default scene with some attributes replaced by options."""
    model = Fields({"contact_model": "imprint", **options})
    chosen = model.text("contact_model", choices=_CONTACT_MODELS)
    if chosen == "elastic":
        return _elastic_scene(options)
    model.problems += [
        Problem(name, f"{name} is of an elastic contact; add --contact-model elastic")
        for name in options
        if name in _ELASTIC_KEYS and chosen
    ]
    values = {_SCENE_KEYS[name]: value for name, value in options.items() if name in _SCENE_KEYS}
    # a wrapped tape touches along a strip
    if "cylinder" in options:
        values["contact"] = "strip"
        if "contact" in options:
            del values["contact_mm"]
            size = shown(options["contact"])
            model.problem("cylinder", f"cylinder contradicts contact = {size}: both name the contact; give one of them")
    elif options.get("contact") == "pad":
        values["contact"] = values.pop("contact_mm")
    scene = tried(lambda: _scene_of(values), model.problems)
    if scene is None or model.problems:
        raise SpecError(model.problems)
    return scene


def _scene_of(values: Mapping[str, Any], elastic: ElasticContact | None = None) -> Scene:
    """The scene with these attributes; a refused one is named as the option that set it."""
    try:
        return Scene(**values, elastic=elastic)
    except SpecError as error:
        raise SpecError([_of_option(problem, _SCENE_KEYS) for problem in error.problems]) from None


def _elastic_scene(options: Mapping[str, Any]) -> Scene:
    """The scene of an elastic contact."""
    keys = {**_ELASTIC_KEYS, "cylinder": "cylinder_radius_mm", "elastomer": "blur_mm"}
    problems: list[Problem] = []
    if "contact" in options:
        message = "contact contradicts contact_model = 'elastic': its force decides how large it is; leave it out"
        problems.append(Problem("contact", message))
    elastic = tried(lambda: ElasticContact(**{keys[name]: value for name, value in options.items() if name in keys}), problems)
    problems = [_of_option(problem, keys) for problem in problems]
    others = {
        _SCENE_KEYS[name]: value for name, value in options.items() if name in _SCENE_KEYS and name not in (*keys, "contact")
    }
    scene = tried(lambda: _scene_of(others, elastic), problems)
    if scene is None or problems:
        raise SpecError(problems)
    return scene


def _of_option(problem: Problem, keys: Mapping[str, str]) -> Problem:
    """A problem of an attribute as one of the option that set it, by which its sentence begins."""
    attribute = problem.key.partition(".")[2]
    name, _, index = attribute.partition("[")
    option = next((option for option, key in keys.items() if key == name), None)
    if option is None:
        return problem
    at = f"{option}[{index}" if index else option
    return Problem(at, at + problem.message.removeprefix(problem.key))


def _tape(kit: str | Path, measured: str | None) -> Tape:
    """The kit's tape, without measured places where ``--from`` does not ask for them; so its remedy is another."""
    try:
        return Tape.load(kit, as_built=measured)
    except SpecError as error:
        way = "leave out --from" if measured is None else "leave out --from and --as-built"
        raise SpecError([replace(p, message=p.message.replace(TAKE_DESIGN, way)) for p in error.problems]) from None


def _parts_from(source: str, tape: Tape, kit: str | Path) -> Parts | None:
    """The parts of a source; None for those of the design."""
    if source == "cpl":
        return _written_parts(tape, kit)
    return built_parts_of(tape) if source == "as-built" else None


def _written_parts(tape: Tape, kit: str | Path) -> Parts:
    """Parts of the kit's pick-and-place file."""
    file = find_manifest(kit)
    rows = read_manifest(file).get("files")
    named = [row for row in rows if isinstance(row, dict) and row.get("role") == "cpl"] if isinstance(rows, list) else []
    path = safe_path(named[0].get("path")) if named else None
    if path is None:
        raise SpecError(Problem("cpl", f"the kit of {file} has no pick-and-place file; leave out --from cpl, or --from-cpl"))
    return parts_from_cpl(file.parent / path, tape.designators())


def _shown(frames: Iterator[Frame], count: int, progress: Progress) -> Iterator[Frame]:
    for k, frame in enumerate(frames, start=1):
        yield frame
        progress("frames", k, count)


def refuse_taken_file(output: str | Path) -> Path:
    """Check the path of a new file of frames; only a simulated one may be replaced.

    Raises SpecError if it does not end with .npz, its folder does not exist, or another file is there.
    """
    path = Path(output)
    if path.name.lower() == ".npz":
        message = f"output = {shown_path(path)} is an ending without a name; give a name before it, such as frames.npz"
        raise SpecError(Problem("output", message))
    if path.suffix.lower() != ".npz":
        raise SpecError(Problem("output", f"output = {shown_path(path)} does not end with .npz; give a name that does"))
    refuse_taken_place(path, "output", ours=_is_simulated, kind="no simulated file")
    return path


def _is_simulated(path: Path) -> bool:
    try:
        with open_regular(path) as stream, zipfile.ZipFile(stream) as archive:
            return SCENE_MEMBER + ".npy" in archive.namelist()
    except ZIP_ERRORS:
        return False


def write_frames(path: Path, frames: Iterator[Frame], count: int, sensor: SensorProfile, record: Mapping[str, Any]) -> None:
    """Write frames as they are simulated; the file gets its name when complete, and equal input gives equal bytes.

    Its arrays are depth (N, h, w) float32, position_mm (N, 2), theta_deg (N,), px_per_mm (2,) of the profile, and `record` as
    JSON in scene.

    path: As `refuse_taken_file` gives it.
    frames: `count` of them.
    """
    partial_path = unfinished(path)
    try:
        with zipfile.ZipFile(partial_path, "w", zipfile.ZIP_DEFLATED) as archive:
            poses = np.empty((count, 3))
            # the size is not known before the last frame: zip64 is chosen ahead, or a file of 2 GB could not be finished
            with archive.open(_entry("depth"), "w", force_zip64=True) as stream:
                _write_header(stream, (count, *sensor.frame_shape), np.dtype("<f4"))
                for k, frame in enumerate(frames):
                    stream.write(np.ascontiguousarray(frame.depth, dtype="<f4").tobytes())
                    poses[k] = (*frame.position_mm, frame.theta_deg)
            # sorted keys and a fixed date of the zip's entries: equal input gives equal bytes
            text = np.array(json.dumps(record, sort_keys=True, ensure_ascii=True))
            others = {
                "position_mm": poses[:, :2],
                "theta_deg": poses[:, 2],
                "px_per_mm": np.array(sensor.px_per_mm),
                SCENE_MEMBER: text,
            }
            for name, array in others.items():
                buffer = io.BytesIO()
                np.lib.format.write_array(buffer, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False)
                archive.writestr(_entry(name), buffer.getvalue())
        sync_file(partial_path)
        refuse_taken_file(path)  # again: frames may have taken minutes
        partial_path.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise not_written(path, "output", error) from error
    finally:
        with suppress(OSError):
            partial_path.unlink()


def _entry(name: str) -> zipfile.ZipInfo:
    return zip_entry(name + ".npy", zip_date())


def _write_header(stream: IO[bytes], shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    descr = np.lib.format.dtype_to_descr(dtype)
    np.lib.format.write_array_header_1_0(stream, {"descr": descr, "fortran_order": False, "shape": shape})
