"""survey: files of frames to the measured places of a tape's parts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, refuse, tried
from tactape_fab.base.fields import shown_path
from tactape_fab.base.pool import Workers, checked_workers, mapped
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.sense.decode.localizer import Localizer
from tactape_fab.sense.files.arm_poses import read_arm_poses, read_hand_eye
from tactape_fab.sense.files.depth_maps import FrameFile, open_frames
from tactape_fab.sense.files.jobs import at_scale
from tactape_fab.sense.sensors import SensorProfile, load_sensor
from tactape_fab.sense.survey.adjust import Adjusted, Prior, adjust
from tactape_fab.sense.survey.contacts import Contact, Ground, contact_of, ground_of
from tactape_fab.sense.survey.poses import RobotPose, in_plane
from tactape_fab.sense.survey.residuals import COMMON
from tactape_fab.texture.as_built import NOMINAL, AsBuilt, Film, Given, manifest_digest, refuse_other_kit, refuse_other_places
from tactape_fab.texture.as_built_file import file_of
from tactape_fab.texture.frames import FloatArray, IntArray
from tactape_fab.texture.manifest import find_manifest
from tactape_fab.texture.tape import Tape

LEAST_CONTACTS = 10
MOST_CONTACTS = 3000
"""Limit of memory, which grows as (3 contacts)^2: survey more of them in parts, each --from the last."""
LEAST_EXPECTED = 2
"""A part is missing if at least so many contacts have dots all round it, and no contact ever shows it."""
DRIFT_ERROR = 2.2
"""Factor on the adjustment's standard deviation of drift, as errors of dots are not independent. In simulated surveys of 300
contacts, alone and with a robot or a scan, the means of neighbouring parts are off by 1.8 to 2.4 times as much."""

_BLOCK = 32
"""Frames that one worker locates at a time."""

_FRAMES = "frames_sha256"
"""Key of a survey's entry in `source`: the digest of its frames, in whatever order."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Survey:
    """The result of a survey.

    frames, contacts: Frames read, and those that were located and used.
    parts: Parts of the tape.
    posed: Contacts with a pose of the robot; None where no poses were given.
    """

    as_built: AsBuilt
    adjusted: Adjusted
    frames: int
    contacts: int
    parts: int
    posed: int | None = None

    def to_mapping(self) -> dict[str, Any]:
        """The figures as plain values. ``nuisance`` has camera parameters that absorb other distortions too: no calibration."""
        a = self.adjusted
        return {
            "tape": self.as_built.tape,
            "frames": self.frames,
            "contacts": self.contacts,
            "parts": self.parts,
            "touched": len(a.part),
            "missing": self.as_built.missing,
            "sigma_mm": float(np.median(self.as_built.sigma_mm)),
            "drift_mm": self.as_built.drift_mm,
            "scatter_mm": self.as_built.scatter_mm,
            "dot_mm": a.dot_mm,
            "far_off": a.left,
            "nuisance": {name: [float(a.common[k]), float(a.common_sigma[k])] for k, name in enumerate(COMMON)},
        }


def survey_files(
    frames: Sequence[str],
    kit: str | Path,
    *,
    sensor: str = DEFAULT_SENSOR,
    poses: str | Path | None = None,
    hand_eye: str | Path | None = None,
    inspected: str | Path | None = None,
    output: str | Path | None = None,
    progress: Progress = lambda *_: None,
    workers: object = 1,
) -> Survey:
    """Survey a kit's tape from files of frames.

    frames: As `open_frames` takes them.
    kit: Of the tape that was touched.
    sensor: Profile name, or the path of its TOML file.
    poses: CSV of the robot's poses; see `sense.files.arm_poses`.
    hand_eye: Where the sensor is on the flange and the tape in the base, as `calibrate --hand-eye` wrote it; without it the poses
        are those of the sensor's own frame.
    inspected: Measured places to start from, such as those of an inspection or of an earlier survey; combined by covariance.
    output: Where the measured places will be written: refused if something else is there. Nothing is written yet.
    progress: Called with a text, the number of frames done and their total.
    workers: Number of processes that locate frames, or the address of a Dask scheduler, untrusted; None for one.
    Raises SpecError with every invalid value; if too few frames are located.
    """
    problems: list[Problem] = []
    chosen = checked_workers(workers, problems, usual=1)
    if output is not None:
        tried(partial(refuse_other_places, file_of(Path(output)), "output"), problems)
    given: Given = NOMINAL
    if not frames:
        problems.append(Problem("frames", "no file of frames is given; give FRAMES, such as frames.npz"))
    if inspected is not None:
        of_file: list[Problem] = []
        given = tried(lambda: AsBuilt.load(inspected), of_file) or NOMINAL
        # named as the option that gave the file
        problems += [replace(p, message=p.message.replace("as_built = ", "inspected = ", 1)) for p in of_file]
    tape = tried(lambda: Tape.load(kit, as_built=given), problems)
    profile = tried(lambda: load_sensor(sensor), problems)
    if hand_eye is not None and poses is None:
        message = f"hand_eye = {shown_path(hand_eye)} is for poses of a robot, and none are given; give --poses POSES.csv, too"
        problems.append(Problem("hand_eye", message))
    files = None if profile is None or not frames else tried(partial(open_frames, frames, profile), problems)
    count = None if files is None else sum(file.count for file in files)
    robot = [] if poses is None else tried(lambda: _robot(poses, hand_eye, tape, count), problems)
    if tape is not None and tape.surface is not None:
        message = f"{tape.name} is a texture on a part without a board, and no file of places is made for those; use its design"
        problems.append(Problem("tape", message))
    if files is not None and profile is not None:
        # the camera is one unknown of all contacts
        scales = {file.px_per_mm or profile.px_per_mm for file in files}
        if len(scales) > 1:
            message = "the files are of sensors with different px/mm; survey them one by one with --from"
            problems.append(Problem("frames", message))
        profile = at_scale(profile, scales.pop())
    if output is not None and tape is not None:
        tried(lambda: refuse_other_kit(file_of(Path(output)), manifest_digest(find_manifest(kit)), "output"), problems)
    refuse(problems)
    assert tape is not None and profile is not None and files is not None and robot is not None
    return _surveyed(tape, find_manifest(kit), profile, files, robot, progress, chosen)


def _robot(poses: str | Path, hand_eye: str | Path | None, tape: Tape | None, frames: int | None) -> list[RobotPose]:
    problems: list[Problem] = []
    arm = tried(lambda: read_arm_poses(poses, "poses", frames), problems)
    known = None if hand_eye is None else tried(lambda: read_hand_eye(hand_eye), problems)
    if known is not None and tape is not None and known.tape != tape.name:
        message = f"hand_eye = {shown_path(hand_eye)} says where {known.tape} lies; give that of {tape.name}"
        problems.append(Problem("hand_eye", message))
    if problems or arm is None:
        raise SpecError(problems)
    return in_plane(arm, known)


def _surveyed(
    tape: Tape,
    manifest: Path,
    sensor: SensorProfile,
    files: Sequence[FrameFile],
    robot: Sequence[RobotPose],
    progress: Progress,
    workers: Workers = 1,
) -> Survey:
    ground, before = ground_of(tape), tape.as_built
    built = tape.built_parts()
    # from the design's places, film stretch included, in the texture frame
    shift = built.shift_mm * (1.0, -1.0)
    prior = Prior(shift_mm=shift.copy(), sigma_mm=_sigma_before(built.sigma_mm, before))
    count = sum(file.count for file in files)
    digests: set[bytes] = set()
    contacts = _located({}, tape, ground, sensor, files, shift, progress, workers, digests)
    same = sha256(b"".join(sorted(digests))).hexdigest()
    if before is not None and any(entry.get(_FRAMES) == same for entry in before.source):
        message = "the places that it starts from were surveyed of these very frames, which would count twice"
        raise SpecError(Problem("frames", f"{message}; give new frames alone"))
    _refuse_number(len(contacts), count)
    adjusted = adjust(list(contacts.values()), ground.nominal_mm, sensor, prior, robot)
    if len(contacts) < count:  # the places found locate more of them
        known = _as_built(tape, manifest, adjusted, contacts.values(), before, count, same)
        shift[adjusted.part] = adjusted.shift_mm
        more = _located(contacts, replace(tape, as_built=known), ground, sensor, files, shift, progress, workers, set())
        if len(more) > len(contacts):
            contacts = more
            _refuse_number(len(contacts), count)
            adjusted = adjust(list(contacts.values()), ground.nominal_mm, sensor, prior, robot)
    return Survey(
        as_built=_as_built(tape, manifest, adjusted, contacts.values(), before, count, same),
        adjusted=adjusted,
        frames=count,
        contacts=len(contacts),
        parts=tape.part_count,
        posed=sum(pose.frame in contacts for pose in robot) if robot else None,
    )


def _sigma_before(sigma_mm: FloatArray, before: AsBuilt | None) -> FloatArray:
    """Prior standard deviation of each part without the drift common to neighbours; NaN if it was not measured.

    As an independent error of each part, drift would seem better known the more parts there are, and no contact shows it. The
    result includes it as it was before (`_as_built`).
    """
    unknown, alone = sigma_mm == 0.0, sigma_mm.copy()
    if before is not None:
        at = before.number - 1
        unknown[at] = False
        # a part that the last survey did not show has a standard deviation from before it, and no part is its drift alone
        alone[at] = np.sqrt(np.maximum(sigma_mm[at] ** 2 - before.drift_mm**2, sigma_mm[at] ** 2 / 4.0))
    # 0.1 um at least: a part that is called exact would have an infinite weight
    return np.where(unknown, np.nan, np.maximum(alone, 1e-4))


def _refuse_number(contacts: int, frames: int) -> None:
    if contacts < LEAST_CONTACTS:
        message = (
            f"only {contacts} of {frames} frames are located on this tape, fewer than {LEAST_CONTACTS}; "
            "press more often, or look why with decode"
        )
        raise SpecError(Problem("frames", message))
    if contacts > MOST_CONTACTS:
        message = f"{contacts} contacts are more than {MOST_CONTACTS}; give the frames in parts, each with --from the last file"
        raise SpecError(Problem("frames", message))


def _located(
    done: Mapping[int, Contact],
    tape: Tape,
    ground: Ground,
    sensor: SensorProfile,
    files: Sequence[FrameFile],
    shift: FloatArray,
    progress: Progress,
    workers: Workers,
    digests: set[bytes],
) -> dict[int, Contact]:
    """Contacts by frame: those in `done`, and those of the other frames that are located.

    digests: Empty; gets that of each frame.
    """
    count, seen = sum(file.count for file in files), 0
    frames = enumerate(_once((depth for file in files for depth in file.frames()), digests))
    blocks = iter(lambda: [(k, None if k in done else depth) for k, depth in islice(frames, _BLOCK)], [])
    found = dict(done)
    with closing(mapped(partial(_contacts, tape, ground, sensor, ground.nominal_mm + shift), blocks, workers)) as results:
        for size, contacts in results:
            found.update((contact.frame, contact) for contact in contacts)
            seen += size
            progress("frames", seen, count)
    return dict(sorted(found.items()))


def _once(frames: Iterable[npt.NDArray[Any]], before: set[bytes]) -> Iterator[npt.NDArray[Any] | None]:
    """Frames, with None for each exact repeat of an earlier one: its errors are the same, so it adds no information.

    before: Digests of earlier frames; gets those of these.
    """
    for depth in frames:
        # as the decoder reads them: a copy that was saved in another type is the same frame
        with np.errstate(over="ignore", invalid="ignore"):
            digest = sha256(depth.astype(np.float32).tobytes()).digest()
        yield None if digest in before else depth
        before.add(digest)


def _contacts(
    tape: Tape, ground: Ground, sensor: SensorProfile, built_mm: FloatArray, frames: Sequence[tuple[int, Any]]
) -> tuple[int, list[Contact]]:
    """Number of some frames, and the contacts of those that are given and located."""
    localizer = Localizer(tape, sensor, refine="dots")
    fixes = [(k, depth, localizer.locate(depth)) for k, depth in frames if depth is not None]
    contacts = [contact_of(k, depth, fix, ground, sensor, built_mm) for k, depth, fix in fixes if fix.located]
    return len(frames), [contact for contact in contacts if contact is not None]


def _as_built(
    tape: Tape,
    manifest: Path,
    adjusted: Adjusted,
    contacts: Collection[Contact],
    before: AsBuilt | None,
    frames: int,
    digest: str,
) -> AsBuilt:
    """The file's content: parts that were touched, those that are missing, and the rest of an earlier file."""
    n = tape.part_count
    listed, present = np.zeros(n, dtype=bool), np.ones(n, dtype=bool)
    d, rotation, sigma = np.zeros((n, 2)), np.zeros(n), np.zeros(n)
    film = Film()
    if before is not None:
        at = before.number - 1
        listed[at], present[at] = True, before.present
        d[at] = np.stack([before.dx_mm, before.dy_mm], axis=1)
        rotation[at], sigma[at], film = before.rotation_deg, before.sigma_mm, before.film
    # the file has dx, dy with the film's stretch taken out: see `AsBuilt`
    stretch = tape.part_xy_mm() @ (film.matrix - np.eye(2)).T
    at = adjusted.part
    listed[at], present[at] = True, True
    d[at] = adjusted.shift_mm * (1.0, -1.0) - stretch[at]
    # the adjusted sigma holds drift once, and DRIFT_ERROR times of it are meant: s^2 + (f^2 - 1) d^2; and that from before
    drift_before_mm = 0.0 if before is None else before.drift_mm
    added = np.hypot(np.sqrt(DRIFT_ERROR**2 - 1.0) * adjusted.drift_mm, drift_before_mm)
    sigma[at] = np.hypot(adjusted.sigma_mm, added)
    drift_mm = float(np.hypot(DRIFT_ERROR * adjusted.drift_mm, drift_before_mm))
    gone = _missing(contacts, at, n)
    listed[gone], present[gone], d[gone], sigma[gone], rotation[gone] = True, False, 0.0, 0.0, 0.0
    number = np.flatnonzero(listed) + 1
    entry = {"kind": "survey", "frames": frames, "contacts": len(contacts), "drift_mm": round(drift_mm, 6), _FRAMES: digest}
    return AsBuilt(
        tape=tape.name,
        manifest_sha256=manifest_digest(manifest),
        number=number,
        dx_mm=d[listed, 0],
        dy_mm=d[listed, 1],
        rotation_deg=rotation[listed],
        present=present[listed],
        sigma_mm=sigma[listed],
        film=film,
        source=(*(before.source if before is not None else ()), entry),
    )


def _missing(contacts: Collection[Contact], touched: IntArray, parts: int) -> IntArray:
    """Parts that no contact shows though several have dots all round them."""
    expected = np.zeros(parts, dtype=np.int64)
    for contact in contacts:
        expected[contact.expected] += 1
    # a part that any contact shows is there
    expected[touched] = 0
    return np.flatnonzero(expected >= LEAST_EXPECTED)
