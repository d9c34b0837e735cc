"""A user's first frames: what looks wrong in them and in the sensor profile, before anything is calibrated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.calibrate.held import at_one_place
from tactape_fab.sense.calibrate.orientation import find_orientation, fitted_size, with_depth, with_mask
from tactape_fab.sense.calibrate.posedness import LEAST_PRESSES, checked_frames, frame_fault, of_two_kinds, without_repeats
from tactape_fab.sense.calibrate.presses import Frame
from tactape_fab.sense.calibrate.valid import valid_pixels
from tactape_fab.sense.decode.accept import NOT_REGISTERED
from tactape_fab.sense.decode.dots.frame_dots import detected
from tactape_fab.sense.decode.localizer import Localizer
from tactape_fab.sense.decode.result import SOLID_DOTS, Localization
from tactape_fab.sense.decode.rule import GOOD_TRUST
from tactape_fab.sense.decode.wrong_profile import IN_PROFILE
from tactape_fab.sense.files.jobs import at_scale, by_scale_of_file, of_file_scale
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.tape import Tape

MOST_FRAMES = 200
"""Only so many first frames are examined."""
EIGHT_BITS = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameLook:
    """A frame: trusted dots, whether it is located by the profile, and else why not; None where no tape is named."""

    frame: int
    dots: int
    located: bool | None
    reason: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstFrames:
    """The findings of a user's first frames.

    wrong: What looks wrong, each with its remedy; nothing where all is well.
    """

    frames: tuple[FrameLook, ...]
    wrong: tuple[str, ...]
    next_step: str

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def look_at_frames(
    frames: Iterable[npt.ArrayLike],
    tapes: Sequence[Tape],
    like: SensorProfile,
    px_per_mm: tuple[float, float] | None = None,
) -> FirstFrames:
    """Say what looks wrong in frames.

    frames each (h, w): As the sensor delivers them.
    tapes: That were pressed; none: only the frames themselves are looked at.
    px_per_mm: The file's own scale, which counts for the profile's.
    Raises SpecError, FrameError if they are no depth maps of one shape, or all of them are empty.
    """
    images, bad = checked_frames(frames)
    images = images[:MOST_FRAMES]
    height, width = images[0].shape
    sensor = fitted_size((height, width), like)
    if px_per_mm is not None:
        sensor = at_scale(sensor, px_per_mm)
    once, _ = without_repeats(images)
    valid = valid_pixels(once, sensor)
    wrong = [f"{fault}; leave it out, or look at how it is saved" for fault in bad[:5]]
    wrong += _of_values(images, with_depth(valid, sensor))
    if (height, width) != like.frame_shape:
        h, w = like.frame_shape
        # as `fitted_size` has it: any other size or turn in the profile has another px/mm
        upright = " and rotate90 = 0" if like.rotate90 else ""
        wrong.append(
            f"frames are {height} x {width} px (height x width), those of '{like.name}' {h} x {w}; give another like, or set "
            f"width_px = {width}, height_px = {height}{upright} in the sensor profile, or calibrate"
        )
    if valid is not None:
        wrong.append(
            f"{100 * (1 - valid.mean()):.1f} % of the pixels never change: blind ones belong into a mask; calibrate writes it"
        )
        sensor = with_mask(sensor, with_depth(valid, sensor))
    dots = [int((detected(image, sensor).trust > GOOD_TRUST).sum()) for image in images]
    if not tapes:
        looks = tuple(FrameLook(frame=k, dots=n, located=None, reason=None) for k, n in enumerate(dots))
        return FirstFrames(frames=looks, wrong=tuple(wrong), next_step="name the kit that was pressed with --tape, to see more")
    localizer = Localizer(tapes, sensor, refine="dots")
    answers = [by_scale_of_file(localizer.locate(image), px_per_mm) for image in images]
    looks = tuple(
        FrameLook(frame=k, dots=n, located=fix.located, reason=fix.reason)
        for k, (n, fix) in enumerate(zip(dots, answers, strict=True))
    )
    found = sum(fix.located for fix in answers)
    mixed = of_two_kinds(answers)
    wrong += mixed
    # a frame without contact is no fault
    reasons = Counter(
        fix.reason
        for fix in answers
        if fix.reason is not None and fix.n_dots >= SOLID_DOTS and not (mixed and IN_PROFILE in fix.reason)
    )
    wrong += [f"{count} of {len(images)} frames: {reason}" for reason, count in _named(reasons)]
    if found and px_per_mm is None and sensor.px_per_mm != like.px_per_mm:
        u, v = sensor.px_per_mm
        wrong.append(f"frames of this size are located at px_per_mm = [{u:.4g}, {v:.4g}]; set it{IN_PROFILE}, or calibrate")
    if 2 * sum(NOT_REGISTERED in (fix.reason or "") for fix in answers) > len(answers):
        return FirstFrames(frames=looks, wrong=tuple(wrong), next_step="another tape was pressed; give its kit")
    if found == 0:
        problems = _of_profile(images, tapes, sensor, max(fix.n_dots for fix in answers))
        wrong.append(problems if px_per_mm is None else of_file_scale(problems))
    # what is there twice is one press
    own = [fix for fix, image in zip(answers, once, strict=True) if np.isfinite(image).any()]
    return FirstFrames(frames=looks, wrong=tuple(wrong), next_step=_next_step(own, wrong, bool(mixed)))


def _of_values(images: Sequence[Frame], seen: BoolArray | None) -> list[str]:
    """Faults of the values themselves; `seen` are the pixels that carry depth, None for all."""
    reasons = []
    whole = [image for image in images if frame_fault(image) is None]
    few = [len(np.unique(image[np.isfinite(image)])) for image in whole[:5]]
    if few and max(few) <= EIGHT_BITS:
        reasons.append(
            f"frames hold at most {max(few)} different values: 8 bits are too coarse for dots; save depth as float or 16 bits"
        )
    same = sum(np.array_equal(a, b) for a, b in pairwise(whole))
    if same:
        reasons.append(f"{same} frames are the same as the one before, pixel for pixel; save frames as they come")
    # a real number is the largest in one pixel, a cut-off one in many; a blind one may be the largest of all
    depths = [image if seen is None else image[seen] for image in whole]
    largest = max((float(np.mean(depth == np.nanmax(depth))) for depth in depths if np.isfinite(depth).any()), default=0.0)
    if largest > 0.01:
        reasons.append(f"up to {100 * largest:.0f} % of a frame's pixels have its largest value: depth is cut off; press less")
    return reasons


def _named(reasons: Counter[str]) -> list[tuple[str, int]]:
    """Reasons of refusal, most frequent first; those that differ only in numbers are one."""
    kinds: dict[str, tuple[str, int]] = {}
    for reason, count in reasons.most_common():
        # counts and places within a reason differ from frame to frame
        kind = "".join(c for c in reason if not c.isdigit())
        first_reason, before = kinds.get(kind, (reason, 0))
        kinds[kind] = (first_reason, before + count)
    return sorted(kinds.values(), key=lambda pair: -pair[1])[:3]


def _of_profile(images: Sequence[Frame], tapes: Sequence[Tape], sensor: SensorProfile, most_dots: int) -> str:
    """The fault of the profile that keeps all frames from being located, if it is one; `most_dots` of a contact."""
    found = find_orientation(images, tapes, sensor, with_depth(None, sensor))
    if found is None:
        few = f" Contacts show {most_dots} dots at most, which are few: press on more of it" if most_dots < SOLID_DOTS else ""
        return f"no sign, mirror or px/mm shows the tape: is it the one that was pressed, parts up, and are frames depth?{few}"
    (u, v), mirror = found.px_per_mm, "true" if found.mirror else "false"
    changes = [
        *([f"sign = {found.sign}"] if found.sign != sensor.sign else []),
        *([f"mirror = {mirror}"] if found.mirror != sensor.mirror else []),
        f"px_per_mm = [{u:.4g}, {v:.4g}]",
    ]
    return f"the tape is seen with another profile: set {', '.join(changes)} in the sensor profile, or calibrate"


def _next_step(answers: Sequence[Localization], wrong: Sequence[str], mixed: bool) -> str:
    found, places = sum(fix.located for fix in answers), _places(answers)
    said = f"{found} of {len(answers)} frames are located"
    if places >= LEAST_PRESSES:
        return f"{said}: run tactape-fab calibrate with them"
    if mixed:
        return f"{said}: give frames of one kind alone, some ten presses of it, then run tactape-fab calibrate with them"
    if wrong and found == 0:
        return "run tactape-fab calibrate with some ten presses: it finds sign, mirror and px/mm itself"
    # frames of one press that is held are one press
    said += f", at {places} places" if 1 < places < found else ", all at one place" if places < found else ""
    return f"{said}; press the tape some ten times, then run tactape-fab calibrate"


def _places(answers: Sequence[Localization]) -> int:
    """How many presses are sure to be presses of their own, by where they are."""
    kept: list[tuple[str | None, FloatArray]] = []
    for fix in answers:
        if fix.located and fix.position_mm is not None and fix.theta_deg is not None:
            pose = np.array([*fix.position_mm, np.radians(fix.theta_deg)])
            if not any(tape == fix.tape and at_one_place(other, pose) for tape, other in kept):
                kept.append((fix.tape, pose))
    return len(kept)
