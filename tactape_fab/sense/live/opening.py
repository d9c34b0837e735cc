"""Options of `watch` to an open source; everything that can be refused is checked before the first frame."""

from __future__ import annotations

import stat
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Problem, SpecError, reason_of, refuse, tried
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.input_file import begins_with
from tactape_fab.base.output_file import refuse_taken_place
from tactape_fab.sense.files.depth_maps import SUFFIXES, has_manifest, open_frames
from tactape_fab.sense.files.jobs import Job, of_colour_images, prepare_without_frames
from tactape_fab.sense.files.recording_kinds import BAG
from tactape_fab.sense.files.recordings import is_recording
from tactape_fab.sense.live.camera import FILMS, USB, Crop, camera_named, camera_source, film_source
from tactape_fab.sense.live.folder import folder_source
from tactape_fab.sense.live.replay import has_stamps, refuse_no_seconds, replay
from tactape_fab.sense.live.sources import Source
from tactape_fab.sense.live.stream import stream_source
from tactape_fab.sense.live.watch import Watch
from tactape_fab.sense.raw.colour_images import open_reconstruction
from tactape_fab.sense.raw.image_files import COLOUR_PICTURES
from tactape_fab.sense.sensors import SensorProfile, load_sensor

STANDARD_INPUT = "-"
LEAST_HZ = 0.001
"""A replay waits an hour at most from frame to frame (`replay.LONGEST_GAP_S`)."""
MOST_HZ = 100_000.0
_SOURCES = "give a folder, a file of frames, - for standard input, or with raw=True a camera such as /dev/video0 or usb:NAME"


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceSettings:
    """A user's options for reading a source; None if not given.

    rate: Hz of a replay.
    idle: s without a new file after which a folder is done.
    raw: The source has colour images.
    background, weights: See `sense.raw.colour_images.open_reconstruction`.
    crop: See `camera.Crop`.
    """

    rate: Any = None
    idle: Any = None
    no_drop: bool = False
    raw: bool = False
    background: str | None = None
    weights: str | None = None
    crop: Any = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """A sensor that is to be watched: its name ("" where there is only one), its profile, its source, and how that is read."""

    name: str = ""
    sensor: str
    source: str
    settings: SourceSettings


Outputs = Sequence[tuple[str, str, str | None]]


def open_watches(wanted: Sequence[Wanted], kits: Sequence[str], outputs: Outputs, **options: Any) -> list[Watch]:
    """Open the sources of sensors, and read the tapes, once for all of them, and the sensors.

    wanted: Sources are a folder, a file of frames, a camera, a film, or "-".
    kits, **options: As `sense.files.jobs.prepare` takes them.
    outputs (str, str, path or None): Files to be written that must not be there: name of the option, ending, and the path or
        None.
    Raises SpecError with every invalid value and file.
    """
    problems: list[Problem] = []
    for k, one in enumerate(wanted):
        if one.name in [other.name for other in wanted[:k]]:
            problems.append(Problem("sensor", f"sensor {one.name} is named twice; give each a name of its own"))
    of_pipe = [one.name for one in wanted if one.source == STANDARD_INPUT]
    if len(of_pipe) > 1:
        message = f"sensors {', '.join(of_pipe)} all read standard input, and each would get some; give folders for the others"
        problems.append(Problem("sensor", message))
    first = wanted[0]
    job = prepare_without_frames(kits, first.sensor, problems, colour=first.settings.raw, **options)
    for key, ending, path in outputs:
        if path is not None:
            tried(partial(_refuse_output, key, Path(path), ending), problems)
    messages = any(key == "mcap" and path is not None for key, _, path in outputs)
    jobs: dict[tuple[str, bool], Job] = {} if job is None else {(first.sensor, first.settings.raw): job}
    watches = []
    for one in wanted:
        own: list[Problem] = []
        watches.append(_opened(one, job, jobs, messages, own))
        problems += [_of_sensor(one.name, problem) for problem in own] if one.name else own
    refuse(problems)
    return [watched for watched in watches if watched is not None]


def _of_sensor(name: str, problem: Problem) -> Problem:
    """A problem of one of several sensors; what is not for its source may be given for another's."""
    one = ", or give it as NAME=VALUE for one that takes it" if problem.key in ("rate", "idle") else ""
    return Problem(problem.key, f"sensor {name}: " + problem.message.replace("; leave it out", f"; leave it out{one}"))


def _opened(
    one: Wanted, job: Job | None, jobs: dict[tuple[str, bool], Job], messages: bool, problems: list[Problem]
) -> Watch | None:
    """One sensor with its source; None where there are problems. Sensors of one profile share it, and all share the tapes."""
    settings, key = one.settings, (one.sensor, one.settings.raw)
    of_colours = {"background": settings.background, "weights": settings.weights, "crop": settings.crop}
    problems += [
        Problem(key, f"{key} = {shown(value)} is for colour images; give raw=True with it, or leave it out")
        for key, value in of_colours.items()
        if value is not None and not settings.raw
    ]
    rate_hz, idle_s, crop = _read_settings(settings, problems)
    if job is not None and key not in jobs:
        profile = tried(lambda: load_sensor(one.sensor), problems)
        if profile is not None:
            jobs[key] = replace(job, sensor=of_colour_images(profile) if settings.raw else profile)
    own = jobs.get(key)
    if own is None:
        return None
    found = tried(partial(_source, one.source, settings, rate_hz, idle_s, crop, own.sensor), problems)
    if messages and not (found is None or found[1]):
        message = f"{shown_path(one.source)} holds no timestamps, and messages need some; give rate=HZ, at which it was taken"
        problems.append(Problem("mcap", message))
    colours = None
    if settings.raw:
        colours = open_reconstruction(settings.background, settings.weights, own.sensor, problems)
    return None if found is None else Watch(job=own, source=found[0], reconstruction=colours)


def _read_settings(settings: SourceSettings, problems: list[Problem]) -> tuple[float | None, float | None, Crop | None]:
    table = Fields({"rate": settings.rate, "idle": settings.idle, "crop": settings.crop}, problems=problems)
    rate_hz = None
    if isinstance(settings.rate, str) and settings.rate == "max":
        rate_hz = float("inf")
    elif settings.rate is not None:
        rate_hz = table.number("rate", low=LEAST_HZ, high=MOST_HZ, unit="Hz", remedy="give a number of Hz, or max", default=1.0)
    idle_s = None if settings.idle is None else table.number("idle", above=0.0, unit="s", default=1.0)
    crop = None
    if settings.crop is not None:
        remedy = "give U,V,WIDTH,HEIGHT in pixels of the camera's image"
        u, v, width, height = table.integers("crop", 4, low=0, high=100_000, remedy=remedy, default=(0, 0, 1, 1))
        crop = (u, v, width, height)
        if width * height == 0:
            table.problem("crop", f"crop = {shown(settings.crop)} cuts out nothing; {remedy}")
    return rate_hz, idle_s, crop


def _refuse_output(key: str, path: Path, ending: str) -> None:
    """Refuse an output file with another ending, or one that exists: nothing is overwritten."""
    if path.suffix.lower() != ending:
        raise SpecError(Problem(key, f"{key} = {shown_path(path)} does not end with {ending}; give a name that does"))
    refuse_taken_place(path, key)


def _other_list(path: Path) -> bool:
    """Whether a file is named as the list of a rosbag2 folder and is none: a folder of frames may have a metadata.yaml."""
    return path.is_file() and not begins_with(path, "rosbag2_bagfile_information")


def _source(
    given: str, settings: SourceSettings, rate_hz: float | None, idle_s: float | None, crop: Crop | None, sensor: SensorProfile
) -> tuple[Source, bool]:
    """A source, and whether its frames have timestamps. Raises SpecError."""
    path, keep = camera_named(given.removeprefix(USB)) if given.startswith(USB) else Path(given), settings.no_drop
    problems: list[Problem] = []
    try:
        mode = 0 if given == STANDARD_INPUT else path.stat().st_mode
    except (OSError, ValueError) as error:
        reason = reason_of(error)
        raise SpecError(Problem("source", f"source {shown_path(given)} cannot be opened: {reason}; {_SOURCES}")) from error
    folder, camera = stat.S_ISDIR(mode), stat.S_ISCHR(mode)
    film = not folder and path.suffix.lower() in FILMS
    plain = not (folder or camera or film or given == STANDARD_INPUT)
    # a bag's folder would be waited in for ever: no frame comes into it
    if (folder or plain) and is_recording(path) and not (folder and _other_list(path / BAG)):
        message = f"source {shown_path(given)} is a recording, whose frames do not come any more; decode reads it"
        raise SpecError(Problem("source", message))
    if folder and has_manifest(path):
        message = f"source {shown_path(given)} is a kit, into which no frames come; give it with --tape, and a folder of frames"
        problems.append(Problem("source", message))
    if film and not (camera or stat.S_ISREG(mode)):
        message = f"source {shown_path(given)} cannot be opened: it is no regular file, as a film is; {_SOURCES}"
        problems.append(Problem("source", message))
    if rate_hz is not None and not (film or plain):
        message = f"rate = {shown(settings.rate)} is for files of frames; other sources set their own pace; leave it out"
        problems.append(Problem("rate", message))
    if idle_s is not None and not folder:
        message = f"idle = {shown(settings.idle)} is for folders, which nothing else tells when to stop; leave it out"
        problems.append(Problem("idle", message))
    if crop is not None and settings.raw and not (camera or film):
        message = f"crop = {shown(settings.crop)} is for cameras; cut the images of a folder when they are written"
        problems.append(Problem("crop", message))
    if (camera or film) and not settings.raw:
        message = f"a {'camera' if camera else 'film'} has colour images; give raw=True with background=FILE and weights=FILE"
        problems.append(Problem("raw", message))
    if settings.raw and (plain or given == STANDARD_INPUT):
        message = f"raw = True is for a camera, a film ({', '.join(FILMS)}) or a folder of images, not for {shown_path(given)}"
        problems.append(Problem("raw", f"{message}; leave it out"))
    refuse(problems)
    if given == STANDARD_INPUT:
        try:
            if sys.stdin is None:  # closed from the start: descriptor 0 may be another file of this process by now
                raise OSError
            stdin = open(0, "rb", buffering=0, closefd=False)  # noqa: SIM115  # no lock that a reader still holds at the end
        except OSError:
            message = "source = -, but standard input is closed; pipe .npy arrays to it, or name a file or a folder"
            raise SpecError(Problem("source", message)) from None
        return stream_source(stdin, keep=keep, frame_shape=sensor.frame_shape), True
    if folder:
        return folder_source(
            path,
            COLOUR_PICTURES if settings.raw else SUFFIXES,
            colour=settings.raw,
            keep=keep,
            idle_s=idle_s,
            frame_shape=sensor.frame_shape,
        ), True
    if camera:
        return camera_source(path, sensor.frame_shape, crop, keep=keep), True
    if film:
        return film_source(path, sensor.frame_shape, crop, rate_hz=rate_hz, keep=keep), True
    (file,) = open_frames([path], sensor)
    if rate_hz is None:
        refuse_no_seconds(file)
    return replay(file, rate_hz, keep=keep), has_stamps(file, rate_hz)
