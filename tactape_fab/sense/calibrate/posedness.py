"""Parameters that frames do not determine: refusals with their remedy, and remarks on how to calibrate better."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from hashlib import sha256
from math import ceil, pi

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import FrameError, Problem, SpecError
from tactape_fab.base.given_value import NO_ARRAY, refuse_other, unmasked
from tactape_fab.sense.calibrate import camera
from tactape_fab.sense.calibrate.adjust import Bundle
from tactape_fab.sense.calibrate.hand_eye import HandEye
from tactape_fab.sense.calibrate.noise import Noise
from tactape_fab.sense.calibrate.presses import Frame, Press
from tactape_fab.sense.calibrate.result import HeldOut
from tactape_fab.sense.decode.localizer import Localizer
from tactape_fab.sense.decode.result import SOLID_DOTS, Localization
from tactape_fab.sense.decode.wrong_profile import IN_PROFILE
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape

LEAST_PRESSES = 6
"""Six presses have four times the unknowns of a camera; of fewer each one's own gel counts too much."""
MOST_FRAMES = 2000
MOST_HOLES = 0.5
CORNER = 0.5
"""A corner begins at this share of the way from the image's middle to its sides."""
LARGEST_CORNER_UM, LARGEST_UNSEEN_UM = 50.0, 25.0
"""Largest error of the camera at the worst place in view with which a profile is written although a corner has no dot, and where
none has: nothing then says that the lens is no more than k1. The stock profile's, uncalibrated, is over 100. With dots at all
corners a larger one is the gel's, and every press makes it smaller."""
GOOD_CORNER_UM = 15.0
GOOD_SHARE = 1.15
"""Ratio of the errors of answers to those with the true camera above which more presses are advised."""
ALIKE = 0.9
"""Length of the mean vector of doubled directions from which on presses count as all turned alike."""
WORSE_OUTSIDE = 1.5
_CORNERS = {"upper left": (-1, -1), "upper right": (1, -1), "lower left": (-1, 1), "lower right": (1, 1)}


def checked_frames(frames: Iterable[npt.ArrayLike]) -> tuple[list[Frame], list[str]]:
    """Frames as arrays of one shape, and what is wrong with some of them.

    Raises SpecError if there is none, or they are no depth maps of one shape, or all of them are empty.
    """
    images: list[Frame] = []
    bad: list[str] = []
    refuse_other(frames, Iterable, "frames", "list of frames", "depth maps (h, w), one for each press")
    for k, given in enumerate(frames):
        image = _numbers(given, k)
        if images and image.shape != images[0].shape:
            (h, w), (height, width) = image.shape, images[0].shape
            message = f"frame {k} is {h} x {w} px, the others are {height} x {width}; give frames of one sensor, all of one size"
            raise SpecError(Problem("frames", message))
        if k >= MOST_FRAMES:
            message = f"there are more than {MOST_FRAMES} frames; some ten presses are enough, give fewer"
            raise SpecError(Problem("frames", message))
        fault = frame_fault(image)
        if fault is not None:
            bad.append(f"frame {k} {fault}")
        images.append(image)
    if not images:
        raise SpecError(Problem("frames", "there are no frames; give depth maps of some ten presses on the tape"))
    if len(bad) == len(images):
        message = f"no frame shows anything: {bad[0]}; look at how they are saved: depth of the gel, one number a pixel"
        raise SpecError(Problem("frames", message))
    return images, bad


def without_repeats(images: Sequence[Frame]) -> tuple[list[Frame], list[str]]:
    """Frames, those emptied that are an earlier one value by value, as of a file that is given twice; and what is said of it.

    Their errors are the same, too: as presses of their own they would make the camera look surer than it is.
    """
    first: dict[bytes, int] = {}
    again = [(k, j) for k, image in enumerate(images) if (j := first.setdefault(sha256(image.tobytes()).digest(), k)) != k]
    if not again:
        return list(images), []
    repeats = {k for k, _ in again}
    kept = [np.full_like(image, np.nan) if k in repeats else image for k, image in enumerate(images)]
    (k, j), number = again[0], len(again)
    counted = "1 frame is an earlier one" if number == 1 else f"{number} frames are earlier ones"
    return kept, [f"{counted} again, value by value (frame {k} is frame {j}); what is there twice counts once"]


def _numbers(given: npt.ArrayLike, index: int) -> Frame:
    try:
        array = np.asarray(unmasked(given))
        if array.dtype.kind not in "fiub" or array.ndim != 2 or min(array.shape) < 16:
            raise ValueError(f"shape {array.shape}, dtype {array.dtype}")
        with np.errstate(over="ignore", invalid="ignore"):
            return np.ascontiguousarray(array, dtype=np.float32)
    except NO_ARRAY as error:
        raise FrameError(
            f"frame {index} is no depth map: {error}; give arrays (h, w) of numbers, 16 px or more a side"
        ) from error


def frame_fault(image: Frame) -> str | None:
    """The fault of a frame alone."""
    finite = np.isfinite(image)
    share = float(1.0 - finite.mean())
    if share == 1.0:
        return "is NaN or infinite in every pixel"
    if share > MOST_HOLES:
        return f"is NaN or infinite in {100 * share:.0f} % of its pixels"
    values = image[finite]
    if values.min() == values.max():
        return f"is constant: {values[0]:g} in every pixel"
    return None


def unseen(images: Sequence[Frame], bad: Sequence[str], tapes: Sequence[Tape], like: SensorProfile) -> Problem:
    """Why no frame shows a tape, by any sign, mirror and scale."""
    localizer = Localizer(tapes, like, refine="dots")
    answers = [localizer.locate(image) for image in images]
    reasons = Counter(fix.reason for fix in answers if fix.reason is not None)
    named = [reason for reason in reasons if "not registered" in reason]
    names = ", ".join(tape.name for tape in tapes)
    if named:
        return Problem("tape", f"the frames show another tape: it {named[0]}; give its kit")
    most = max(fix.n_dots for fix in answers)
    commonest = reasons.most_common(1)[0][0]
    tried = f"{names} is not seen in any of {len(images)} frames, by either sign, mirrored or not, at half to twice the px/mm of "
    if most < SOLID_DOTS:
        remedy = "press harder, or flatter, until the parts show as dots"
        message = f"{tried}'{like.name}': a frame shows at most {most} dots; {remedy}"
    else:
        remedy = "check that it is the tape that was pressed, with the parts up, and that frames are depth rather than colour"
        message = f"{tried}'{like.name}', though there are up to {most} dots ({commonest}); {remedy}"
    return Problem("frames", message + (f"; {'; '.join(bad[:3])}" if bad else ""))


def of_two_kinds(answers: Sequence[Localization]) -> list[str]:
    """The remark on frames that would be located by another profile than those that are, as of a recording half mirrored."""
    located = sum(fix.located for fix in answers)
    others = [fix.reason for fix in answers if fix.reason is not None and IN_PROFILE in fix.reason]
    if not (located and others):
        return []
    # the remedy in the reason would lose the frames that are located
    what = Counter(reason.split(";")[0] for reason in others).most_common(1)[0][0]
    return [
        f"{located} of {len(answers)} frames are located, and {len(others)} would be by another profile ({what}, mostly): no "
        f"profile fits both; give the frames of one kind alone, {LEAST_PRESSES} presses or more"
    ]


def refuse_few(
    presses: Sequence[Press], answers: Sequence[Localization] = (), whole: Sequence[bool] = (), bad: Sequence[str] = ()
) -> None:
    """Refuse too few presses. Raises SpecError.

    answers: Of all frames.
    whole: Which of them have no fault.
    bad: What is wrong with the others.
    """
    if len(presses) >= LEAST_PRESSES:
        return
    reasons = Counter(fix.reason for fix, good in zip(answers, whole, strict=True) if good and not fix.located)
    lost = f" of {len(answers)} frames" if len(answers) > len(presses) else ""
    lost += f" ({reasons.most_common(1)[0][0]}, mostly)" if reasons else ""
    few = "press" if len(presses) == 1 else "presses"
    message = f"only {len(presses)} {few}{lost} can be used, and a calibration needs {LEAST_PRESSES}"
    remedy = of_two_kinds(answers) or [
        "press the tape some ten times, anywhere on it, with the contact near each corner of the image at least once"
    ]
    raise SpecError(Problem("frames", "; ".join([message, *remedy, *bad[:3]])))


def empty_corners(presses: Sequence[Press], sensor: SensorProfile) -> list[str]:
    """Corners of the image without a dot."""
    at = np.concatenate([press.seen_px for press in presses])
    # -1 and 1 at the image's sides
    at = (at - sensor.centre_px) / sensor.centre_px
    return [name for name, signs in _CORNERS.items() if not (at * signs > CORNER).all(axis=1).any()]


def corner_sigma_um(bundle: Bundle) -> float:
    """Largest standard deviation, in view, of a point on the gel relative to the one in the image's middle, by the camera."""
    sensor = bundle.sensor
    side = np.linspace(0.0, 1.0, 9)
    at_px = np.stack(np.meshgrid(side * (sensor.width_px - 1), side * (sensor.height_px - 1)), axis=-1).reshape(-1, 2)
    if sensor.mask is not None:
        u, v = np.rint(at_px).astype(np.int64).T
        inside = sensor.mask[v, u]
        at_px = at_px[inside] if inside.any() else at_px
    # from the image's middle: a shift of all points together is the pose's
    at_mm: FloatArray = sensor.camera.from_px(at_px) - sensor.camera.from_px(sensor.centre_px)
    seen = camera.seen_by(sensor, bundle.values)
    # of pixels, to mm on the gel along each axis
    by = seen.to_px(at_mm)[2] / np.array(seen.scale)[:, None]
    # a rotation of the image belongs to the pose, not to the camera
    variance = np.einsum("nij,jk,nik->n", by, bundle.covariance, by)
    # both axes' variances are added above; along one of them
    return float(1000.0 * np.sqrt(variance.max() / 2.0))


def share_of_perfect(bundle: Bundle) -> float:
    """Expected root mean square of errors of answers over that by a perfect camera, of contacts such as the presses.

    Each press is located by the camera of the n - 1 others, whose variance is n / (n - 1) times that of all. All count the same:
    one of few dots, whose own error is large, would hide the camera's in all others.
    """
    # x and y only; angles are another unit
    alone, anew = (each[:, :2, :2].trace(axis1=1, axis2=2) for each in (bundle.poses_alone, bundle.poses_anew))
    return float(np.sqrt(1.0 + ((anew / alone).mean() - 1.0) * (1.0 - 1.0 / len(bundle.poses))))


def refuse_unspread(presses: Sequence[Press], bundle: Bundle, corner_um: float) -> None:
    """Refuse presses that leave the camera open. Raises SpecError."""
    empty = empty_corners(presses, bundle.sensor)
    most = LARGEST_UNSEEN_UM if len(empty) == len(_CORNERS) else LARGEST_CORNER_UM
    if not empty or corner_um <= most:
        return
    known = f"the camera is known to {corner_um:.0f} um at the edge of the image, and {most:g} um are asked for"
    if len(empty) == len(_CORNERS):
        message = f"all contacts are in the middle of the image: {known}; press near the four corners"
    else:
        message = f"no contact reaches the {_listed(empty)} of the image: {known}; press there"
    raise SpecError(Problem("frames", message))


def remarks_of(
    presses: Sequence[Press],
    bundle: Bundle,
    start: SensorProfile,
    frame_shape: tuple[int, int],
    turn_known: bool,
    corner_um: float,
    held_out: HeldOut | None,
    noise: Noise | None,
    bad: Sequence[str],
    hand_eye: HandEye | None,
) -> list[str]:
    """Remarks on what cannot be observed, each with a remedy."""
    remarks = list(bad[:5])
    sensor = bundle.sensor
    if frame_shape != start.frame_shape:
        (h, w), (height, width) = frame_shape, start.frame_shape
        remarks.append(
            f"frames are {h} x {w} px (height x width), those of '{start.name}' {height} x {width}: the profile is for frames "
            "that are cut out and scaled as these are"
        )
    if not turn_known:
        remarks.append(
            f"quarter turns of the image cannot be told from presses: rotate90 = {sensor.rotate90} is that of '{start.name}'; "
            "for the true one press once in a known direction and give known_theta=FRAME,DEG"
        )
    share = share_of_perfect(bundle)
    if share > GOOD_SHARE + 0.005:
        # share^2 - 1 is the camera's variance over the pose's own, and falls as 1 / presses
        wanted = ceil(len(presses) * (share**2 - 1.0) / (GOOD_SHARE**2 - 1.0))
        remarks.append(
            f"by the covariance of the presses, positions are expected to err {share:.2f} times as far (rms, no median) as by a "
            f"perfect camera; with {wanted} presses in all, spread as these are, {GOOD_SHARE:g} times is expected"
        )
    if corner_um > GOOD_CORNER_UM:
        empty = empty_corners(presses, sensor)
        where = f"the {_listed(empty)} of the image" if empty else "other places and turns"
        remarks.append(f"the camera is known to {corner_um:.0f} um at the edge of the image: presses at {where} make it better")
    turns = np.array([press.theta_rad for press in presses])
    # doubled, as a half turn stretches the tape along the same line
    if abs(np.exp(2j * turns).mean()) > ALIKE:
        remarks.append(
            f"all presses are turned alike, within {np.degrees(_spread(turns)):.0f} deg: a stretch of the tape or of the gel "
            "counts as the sensor's; turn it by a quarter for some of them"
        )
    if held_out is not None and held_out.outside_um > WORSE_OUTSIDE * held_out.inside_um:
        remarks.append(
            f"presses that were left out fit worse, {held_out.outside_um:.1f} um against {held_out.inside_um:.1f}: the camera "
            "follows single presses; add some"
        )
    if noise is None or noise.patches == 0:
        remarks.append("no part of any frame is off contact: give frames that touch nothing, too, for the noise of the depth")
    if sensor.depth_unit_mm is None:
        remarks.append(f"'{start.name}' says no unit of the depth: amplitude and noise are in the frame's unit")
    if noise is not None and not noise.of_mm:
        remarks.append(
            f"slopes have a noise of {noise.slope:.3g} rms a pixel, and depths one of {noise.white_um:.3g} um, too much or too "
            f"little for depths in mm: the profile keeps the noise of '{start.name}'; give a like with the frames' depth.unit_mm "
            "(1000 for metres) for its own"
        )
    if hand_eye is not None:
        remarks += hand_eye.remarks
    return remarks


def _spread(turns: FloatArray) -> float:
    """Largest difference of directions, rad, where a half turn is none."""
    # mean axis; then differences within a quarter turn to either side, which need not be alike
    middle = np.angle(np.exp(2j * turns).mean()) / 2.0
    return float(np.ptp((turns - middle + pi / 2) % pi - pi / 2))


def _listed(names: Sequence[str]) -> str:
    corner = "corner" if len(names) == 1 else "corners"
    return f"{names[0]} {corner}" if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} {corner}"
