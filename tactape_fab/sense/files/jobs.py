"""Files of frames -> answers: the registry from kits, a locator for it, and one answer after the other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy.typing as npt

from tactape_fab.base.errors import Problem, refuse, tried
from tactape_fab.base.fields import Fields, shown_path
from tactape_fab.sense.decode.settings import setting_problems
from tactape_fab.sense.files.depth_maps import SUFFIXES, FrameFile, open_frame_file, open_frames
from tactape_fab.sense.files.recordings import Recording, is_recording, open_recording, upright
from tactape_fab.sense.raw.colour_images import RawImage, colour_paths, open_reconstruction
from tactape_fab.sense.sensors import MOST_SIGMA, SensorProfile, load_sensor
from tactape_fab.texture.code import CODE_NAMES, get_plane, has_plane
from tactape_fab.texture.packed import is_packed
from tactape_fab.texture.registry import read_tapes
from tactape_fab.texture.tape import DEFAULT_PITCH_MM, Tape, read_displacement, read_pitch

if TYPE_CHECKING:
    from tactape_fab.sense.decode.result import Localization

Frames = FrameFile | RawImage | Recording
_NO_RECORDING = "--topic is for recordings, .mcap, rosbag2 and LeRobot; leave it out"


class Locate(Protocol):
    """Function that locates a depth map as the sensor delivers it."""

    def __call__(self, depth: npt.ArrayLike, *, timestamp: float | None = None) -> Localization: ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Located:
    """A frame and its answer.

    frame: Counted over all files.
    depth (h, w): Depth map as in the file.
    sensor: Sensor profile, with the file's scale if it has one.
    px_per_mm: That scale; None if it has none.
    """

    frame: int
    depth: npt.NDArray[Any]
    sensor: SensorProfile
    fix: Localization
    px_per_mm: tuple[float, float] | None = None


def is_kit(path: str) -> bool:
    """Whether a user's path denotes a kit: a folder, or a manifest."""
    try:
        return path.lower().endswith(".json") or (Path(path).is_dir() and not is_recording(path))
    except (OSError, ValueError):
        return False


def told_apart(frames: Sequence[str], kits: Sequence[str]) -> tuple[list[str], list[str]]:
    """FRAMES and --tape as they are meant where either has what belongs to the other, and --tape is given.

    A shell expands a pattern to --tape A B, whose B is read as FRAMES; and both are easily swapped.
    """
    if not kits:
        return [*frames], []
    swapped = [kit for kit in kits if is_recording(kit) or (Path(kit).suffix.lower() in SUFFIXES and not is_packed(Path(kit)))]
    given = [*(f for f in frames if not is_kit(f)), *swapped]
    return given, [*(kit for kit in kits if kit not in swapped), *(f for f in frames if is_kit(f))]


def open_presses(paths: Sequence[str], like: SensorProfile | None, topic: str | None, problems: list[Problem]) -> list[Frames]:
    """Files of frames and recordings of a sensor that is to be calibrated, in the order given; problems are added to `problems`.

    like: As of `calibrate`; without it no recording is opened.
    """
    if topic is not None and not any(is_recording(path) for path in paths):
        problems.append(Problem("topic", _NO_RECORDING))
    opened: list[Frames] = []
    for path in paths:
        if not is_recording(path):
            opened += filter(None, [tried(partial(open_frame_file, path), problems)])
        elif like is not None and (found := tried(partial(open_recording, path, like, topic), problems)) is not None:
            if found.ours:
                message = f"{shown_path(path)} was written by watch, upright and in metres whatever the sensor delivers"
                problems.append(Problem("frames", f"{message}; give the frames as they come from the sensor"))
            opened.append(found)
    return opened


@dataclass(frozen=True, slots=True, kw_only=True)
class BareCode:
    """Code and grid, given instead of tapes."""

    name: str
    pitch_mm: float
    displacement_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Raw:
    """Colour images instead of depth maps, with background and weights; see `sense.raw.colour_images`."""

    images: Sequence[str]
    background: str | None
    weights: str | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Job:
    """A job of `decode`: files of frames, sensor, registry or code alone, and settings of `Localizer`."""

    files: Sequence[Frames]
    sensor: SensorProfile
    tapes: Sequence[Tape]
    code: BareCode | None
    settings: Mapping[str, Any]


def prepare(
    frames: Sequence[str], kits: Sequence[str], sensor: str, raw: Raw | None = None, topic: str | None = None, **options: Any
) -> Job:
    """Read and check all settings and files before the first frame.

    frames, kits: See `open_frames` and `read_tapes`.
    sensor: Profile name or the path of its TOML file.
    raw: Colour images instead of `frames`; the profile's sign and unit are those of its depth maps, and not looked at then.
    topic: Topic or feature of recordings; see `open_recording`.
    **options: as_built: files of measured places, as `read_tapes` takes them; code, w, delta: the code and its grid (mm) instead
        of kits; method, world, max_p_false, max_p_tape, fixed_scale, refine: as `Localizer` takes them. None is what is not
        given.
    Raises SpecError with every invalid value and file.
    """
    problems: list[Problem] = []
    if raw is not None and not raw.images:
        message = "--background and --weights are for colour images, and none is given; name them with --raw, or leave those out"
        problems.append(Problem("raw", message))
    elif raw is None and not frames:
        problems.append(Problem("frames", "no file of frames is given; give FRAMES, such as frames.npz"))
    job = prepare_without_frames(kits, sensor, problems, colour=raw is not None, **options)
    files = None if job is None else tried(partial(_open, frames, raw, job.sensor, topic), problems)
    refuse(problems)
    assert job is not None and files is not None
    return replace(job, files=files)


def prepare_without_frames(
    kits: Sequence[str], sensor: str, problems: list[Problem], *, colour: bool = False, **options: Any
) -> Job | None:
    """A job without frames; problems are added to `problems`. None if there is no sensor.

    colour: Whether its frames are made of colour images: in mm, and larger where pushed further in.
    **options: As for `prepare`.
    """
    given = {name: value for name, value in options.items() if value is not None and value is not False}
    as_built = given.pop("as_built", ())
    bare: dict[str, Any] = {name: given.pop(name) for name in ("code", "w", "delta") if name in given}
    code = _read_code(bare, bool(kits), problems)
    problems += setting_problems(given, code=bare.get("code"))
    tapes = tried(lambda: read_tapes(kits, as_built), problems)
    profile = tried(lambda: load_sensor(sensor), problems)
    if profile is None:
        return None
    return Job(files=(), sensor=of_colour_images(profile) if colour else profile, tapes=tapes or (), code=code, settings=given)


def of_colour_images(profile: SensorProfile) -> SensorProfile:
    """The profile of depth maps made of a sensor's colour images."""
    return replace(profile, sign=1, depth_unit_mm=1.0)


def _open(frames: Sequence[str], raw: Raw | None, profile: SensorProfile, topic: str | None) -> Sequence[Frames]:
    """The files in the order in which they are given; of colour images recordings come last."""
    given = frames if raw is None else raw.images
    recorded = [path for path in given if is_recording(path)]
    files, problems = [path for path in given if path not in recorded], list[Problem]()
    if topic is not None and not recorded:
        problems.append(Problem("topic", _NO_RECORDING))
    images = [] if raw is None else colour_paths(files, profile, problems)
    opened = tried(partial(open_frames, files, profile), problems) if raw is None else None
    found = [tried(partial(open_recording, path, profile, topic, colour=raw is not None), problems) for path in recorded]
    recordings = [one for one in found if one is not None]
    # one for all: what is wrong with it is said once
    colours = open_reconstruction(raw.background, raw.weights, profile, problems) if raw is not None and given else None
    refuse(problems)
    if colours is not None:
        of_images = [RawImage(path=path, reconstruction=colours) for path in images]
        return [*of_images, *(replace(one, reconstruction=colours) for one in recordings)]
    files_of: dict[bool, Iterator[Frames]] = {False: iter(opened or ()), True: iter(recordings)}
    return [next(files_of[path in recorded]) for path in given]


def _read_code(bare: Mapping[str, Any], kits: bool, problems: list[Problem]) -> BareCode | None:
    """The code given instead of kits; W and Delta default to those of `make`."""
    if kits and bare:
        named = ", ".join(f"--{name}" for name in bare)
        problems.append(Problem("code", f"{named} and --tape are given, but a kit says all of it; give either"))
    elif not kits and "code" not in bare:
        message = "no tape is given; name the kits that can be touched with --tape, or only their --code, --w and --delta"
        problems.append(Problem("tape", message))
    if kits or "code" not in bare:
        return None
    table = Fields({"w": DEFAULT_PITCH_MM, **bare}, problems=problems)
    if not has_plane(bare["code"]):
        tried(lambda: get_plane(bare["code"]), problems)
        return None
    name = table.text("code", choices=CODE_NAMES, default=CODE_NAMES[0])
    pitch_mm = read_pitch(table, "w")
    displacement_mm = read_displacement(table, "delta", pitch_mm, pitch_refused=table.refused("w"))
    return BareCode(name=name, pitch_mm=pitch_mm, displacement_mm=displacement_mm)


def make_locator(job: Job, sensor: SensorProfile) -> Locate:
    """Build the function that locates a sensor's frames for a job. Raises SpecError."""
    from tactape_fab.sense.decode.localizer import Localizer

    if job.code is None:
        return Localizer(job.tapes, sensor, **job.settings).locate
    settings = {name: value for name, value in job.settings.items() if name != "method"}
    return Localizer.from_code(job.code.name, job.code.pitch_mm, job.code.displacement_mm, sensor, **settings).locate


def by_scale_of_file(fix: Localization, px_per_mm: tuple[float, float] | None) -> Localization:
    """An answer whose reason says where the scale is to be corrected."""
    return fix if px_per_mm is None or fix.reason is None else replace(fix, reason=of_file_scale(fix.reason))


def of_file_scale(reason: str) -> str:
    """A reason that names the file's px_per_mm in place of the profile's, which the file overrides."""
    reason = reason.replace("the sensor profile's", "the file's").replace("the profile's", "the file's")
    if "px_per_mm" in reason:
        where = "in the sensor profile"
        counts = f"{where} (the file has a px_per_mm of its own, which counts: correct it, or leave it out)"
        reason = reason.replace(where, counts)
    return reason


def at_scale(sensor: SensorProfile, px_per_mm: tuple[float, float]) -> SensorProfile:
    """A sensor profile with the scale of a file; its sigma combines the profile's and the difference of both scales.

    A calibration's standard deviation is that of its own scale, not of another.
    """
    if px_per_mm == sensor.px_per_mm:
        return sensor
    geometry, (own_u, own_v), (u, v) = sensor.geometry, sensor.px_per_mm, px_per_mm
    known = geometry.sigma_px_per_mm
    return replace(
        sensor,
        px_per_mm=px_per_mm,
        geometry=replace(
            geometry,
            sigma_px_per_mm=None if known is None else hypot(known, max(abs(u - own_u), abs(v - own_v))),
            sigma_aspect=min(hypot(geometry.sigma_aspect, u * own_v / (v * own_u) - 1.0), MOST_SIGMA),
        ),
    )


def localize(job: Job) -> Iterator[Located]:
    """Answers for all frames of a job's files, in order.

    Raises SpecError, FrameError if a file ends early, or a frame is invalid.
    """
    # a locator is compiled and prepared for one profile; files of one scale share it
    locators: dict[tuple[tuple[float, float], bool], Locate] = {}
    frame = 0
    for file in job.files:
        scale = file.px_per_mm or job.sensor.px_per_mm
        own = at_scale(job.sensor, scale)
        ours = isinstance(file, Recording) and file.ours
        own = upright(own) if ours else own
        if (scale, ours) not in locators:
            locators[scale, ours] = make_locator(job, own)
        for k, depth in enumerate(file.frames()):
            fix = by_scale_of_file(locators[scale, ours](depth, timestamp=file.time_of(k)), file.px_per_mm)
            yield Located(frame=frame, depth=depth, sensor=own, fix=fix, px_per_mm=file.px_per_mm)
            frame += 1
