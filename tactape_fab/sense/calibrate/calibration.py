"""Calibration of a sensor: presses on known tapes -> its profile, with the standard deviation of everything."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from numbers import Integral
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tactape_fab.base.blas import one_thread
from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown
from tactape_fab.base.given_value import as_numbers, refuse_other
from tactape_fab.sense.calibrate import camera
from tactape_fab.sense.calibrate.adjust import Bundle, agreeing, designs_of, problem_of, solve
from tactape_fab.sense.calibrate.errors import Errors, Estimate, estimate_errors
from tactape_fab.sense.calibrate.hand_eye import find_hand_eye
from tactape_fab.sense.calibrate.held import held_frames, held_remark
from tactape_fab.sense.calibrate.noise import Noise, between_dots, off_contact
from tactape_fab.sense.calibrate.orientation import KnownTurn, find_orientation, fitted_size, upright, with_depth, with_mask
from tactape_fab.sense.calibrate.posedness import (
    LEAST_PRESSES,
    checked_frames,
    corner_sigma_um,
    frame_fault,
    of_two_kinds,
    refuse_few,
    refuse_unspread,
    remarks_of,
    share_of_perfect,
    unseen,
    without_repeats,
)
from tactape_fab.sense.calibrate.presses import Frame, Press, located
from tactape_fab.sense.calibrate.refined import refined
from tactape_fab.sense.calibrate.relief import Relief, find_relief
from tactape_fab.sense.calibrate.result import Calibration, HeldOut, Quantity
from tactape_fab.sense.calibrate.valid import LEAST_SHARE, clear_of_blind, valid_pixels
from tactape_fab.sense.files.arm_poses import ArmPose
from tactape_fab.sense.sensors import SensorProfile, as_sensor
from tactape_fab.texture.frames import BoolArray, FloatArray
from tactape_fab.texture.registry import TapeLike, as_tapes, refuse_equal_names
from tactape_fab.texture.tape import Tape

ROUNDS = 3
"""Times that frames are located and the camera adjusted: a better profile finds more dots."""
SETTLED_UM = 1.0
"""Rounds end when the image's corner moves by less than this on the gel."""
LEAST_TOLERANCE = 0.03
"""Least `scale_tolerance` of the new profile: a gel stretches by as much where it is pressed."""
SURE_LENS = 3.0
"""The distortion's centre is a free parameter if |k1| is at least so many standard deviations."""
FOLDS = 5
SURER_THAN_MIDDLES = 0.7
"""Where dots are middles between edges, centres from the pixels are taken only if they err by less than this share of what those
do: the pressure draws them alike in all presses, which looks like a scale, not like an error. With 0201 and 0402 in the elastic
simulator the share is 0.9 to 2, and pixels are off in scale by 0.02 to 0.15 %, up to 8 standard deviations; in sharp contacts of
the imprint model, where no pressure draws them, it is 0.5."""


@one_thread()
def calibrate_sensor(
    frames: Iterable[npt.ArrayLike],
    tapes: TapeLike | Iterable[TapeLike],
    like: str | Path | SensorProfile = "generic",
    *,
    name: str = "calibrated",
    known_theta: tuple[int, float] | None = None,
    arm_poses: Sequence[ArmPose] | None = None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Calibration:
    """Calibrate a sensor from some ten presses anywhere on a tape, each at an unknown pose.

    Parameters
    ----------
    frames : iterable of array_like, each of shape (h, w)
        Depth maps as the sensor delivers them, one for each press. Frames that touch nothing are welcome: noise is measured in
        them. Six presses or more, with dots near all four corners of the image.
    tapes : Tape, path, or sequence of either
        As for `Localizer`: the tapes that were pressed.
    like : str, Path or SensorProfile
        The profile to start from: its px/mm may be wrong by a factor of two, its sign and mirror anyhow. Of frames of another
        size its field of view is taken.
    name : str
        Of the new profile.
    known_theta : (int, float), optional
        Index of a frame, and the sensor's turn on the tape in it: degrees, counter-clockwise seen from above. Quarter turns of
        the image are not observable otherwise, and those of `like` are kept.
    arm_poses : sequence of ArmPose, optional
        Poses of the robot's flange, for frames that they name.
    progress : callable
        Called with a text, the number of frames done and their total, or of adjustments, anew in each round.

    Returns
    -------
    Calibration

    Raises
    ------
    SpecError
        If frames are no depth maps, show no tape or another one, are too few, or say too little of the camera; with the remedy.
    """
    registered, given = as_tapes(tapes), as_sensor(like)
    if arm_poses is not None and not (isinstance(arm_poses, Sequence) and all(isinstance(one, ArmPose) for one in arm_poses)):
        message = f"arm_poses = {shown(arm_poses)} is no list of ArmPose; give [ArmPose(frame=0, flange_to_base=...), ...]"
        raise SpecError(Problem("arm_poses", message))
    refuse_equal_names(registered, "a press")
    images, bad = checked_frames(frames)
    height, width = images[0].shape
    start = fitted_size((height, width), given)
    all_images = images  # a known direction may be that of a repeated frame, which is emptied now
    images, repeats = without_repeats(images)
    bad += repeats
    valid = valid_pixels(images, start)
    seen = with_depth(valid, start)
    if valid is not None and seen is not None and seen.mean() < LEAST_SHARE:
        message = f"only {100 * seen.mean():.1f} % of the pixels change from frame to frame; give frames of different presses"
        raise SpecError(Problem("frames", message))
    known = None if known_theta is None else _known(known_theta, len(images))
    rough = find_orientation(images, registered, start, seen)
    if rough is None:
        raise SpecError(unseen(images, bad, registered, with_mask(start, seen)))
    if valid is not None:
        valid = clear_of_blind(valid, float(np.mean(rough.px_per_mm)))
    valid = with_depth(valid, start)
    rough = with_mask(rough, valid)
    if known is not None:
        rough = _turned(all_images, registered, rough, known, valid)
    # the order: orientation and rough scale by which frames are located at all, the camera, and only then what rests on the
    # camera
    posed = {pose.frame for pose in arm_poses or ()}
    presses, bundle, estimate, empty, held = _adjusted(images, registered, rough, bad, progress, posed)
    bad += held
    corner_um = corner_sigma_um(bundle)
    refuse_unspread(presses, bundle, corner_um)
    held_out = _held_out(presses, bundle, _free(bundle))
    relief = find_relief(images, presses, bundle, registered)
    noise = off_contact(images, presses, empty, bundle.sensor)
    if noise is None and relief is not None:
        noise = between_dots(relief.left, relief.freedom, bundle.sensor)
    hand_eye = None if arm_poses is None else find_hand_eye(bundle, presses, registered, arm_poses)
    sensor = _profile(name, given, bundle, estimate, relief, noise if noise is not None and noise.of_mm else None, presses)
    return Calibration(
        sensor=sensor,
        quantities=tuple(_quantities(sensor, bundle, estimate, relief, noise, corner_um)),
        held_out=held_out,
        frames=len(images),
        presses=tuple(presses),
        bundle=bundle,
        valid=valid,
        hand_eye=hand_eye,
        remarks=tuple(
            remarks_of(presses, bundle, given, (height, width), known is not None, corner_um, held_out, noise, bad, hand_eye)
        ),
    )


def _known(given: tuple[int, float], count: int) -> KnownTurn:
    remedy = "the index of a frame and its angle: 0,90"
    theta_deg = float(as_numbers(given, (2,), "known_theta", remedy, finite=False)[1])
    refuse_other(given[0], Integral, "known_theta", "index", remedy)
    frame = given[0]
    typed = f"known_theta = {shown(frame)},{theta_deg:g}"
    if not 0 <= frame < count:
        message = f"{typed}: frame {shown(frame)} is not from 0 to {count - 1}; give {remedy}"
        raise SpecError(Problem("known_theta", message))
    # a NaN is within no limits
    if not -360.0 <= theta_deg <= 360.0:
        raise SpecError(Problem("known_theta", f"{typed}: {theta_deg:g} deg is not from -360 to 360 deg; give one of those"))
    return KnownTurn(frame=frame, theta_deg=theta_deg)


def _turned(
    images: Sequence[Frame], tapes: Sequence[Tape], rough: SensorProfile, known: KnownTurn, valid: BoolArray | None
) -> SensorProfile:
    found, answers = located([images[known.frame]], tapes, rough)
    if not found:
        message = f"known_theta = {known.frame},{known.theta_deg:g}: the frame is not located: {answers[0].reason}; name another"
        raise SpecError(Problem("known_theta", message))
    return upright(rough, known, float(np.degrees(found[0].theta_rad)), valid)


def _adjusted(
    images: Sequence[Frame],
    tapes: Sequence[Tape],
    rough: SensorProfile,
    bad: Sequence[str],
    progress: Callable[[str, int, int], None],
    posed: Collection[int] = (),
) -> tuple[list[Press], Bundle, Estimate, list[int], list[str]]:
    """Presses, camera, errors of dots, frames that touch nothing, and remarks on those of a press again or of another profile.

    Frames are located and adjusted by turns, then by their pixels.

    bad: What is wrong with frames, for a refusal.
    posed: Frames with a pose of the arm.
    """
    sensor, before, held = rough, None, list[str]()
    whole = [frame_fault(image) is None for image in images]
    for k in range(ROUNDS):
        presses, answers = located(images, tapes, sensor, partial(progress, f"round {k + 1}: frames"))
        refuse_few(presses, answers, whole, [*bad, *held])
        # only surrounded dots: a shift by the rim that is the same in all presses would be taken for distortion
        inner, step = [press.taken(press.interior) for press in presses], partial(progress, f"round {k + 1}: adjustments")
        kept, bundle, estimate = adjust(inner, sensor, step)
        again = held_frames(kept, bundle, posed)
        if again:
            images = [np.full_like(image, np.nan) if i in again else image for i, image in enumerate(images)]
            whole, held = [good and i not in again for i, good in enumerate(whole)], [*held, *held_remark(again)]
            presses, inner = ([press for press in each if press.frame not in again] for each in (presses, inner))
            refuse_few(presses, answers, whole, [*held, *bad])
            kept, bundle, estimate = adjust(inner, sensor, step)
        after = _corner_mm(bundle)
        if before is not None and np.abs(after - before).max() < SETTLED_UM / 1000:
            break
        # the tolerance stays wide while the scale is still moving
        before, sensor = after, replace(_with_sigmas(bundle), scale_tolerance=sensor.scale_tolerance)
    empty = [
        k
        for k, (of_whole, fix) in enumerate(zip(whole, answers, strict=True))
        if not fix.located and fix.status != "solid" and of_whole  # a constant frame has no noise to measure
    ]
    placed = {press.frame: pose for press, pose in zip(kept, bundle.poses, strict=True)}
    fine = refined(images, [p.at(placed[p.frame]) for p in presses if p.frame in placed], bundle.sensor, tapes)
    # only where every press has them: none is given up for better centres
    if len(fine) == len(kept):
        better = adjust(fine, bundle.sensor, partial(progress, "pixels: adjustments"))
        by_edges = float(np.mean([press.by_edges for press in kept]))
        if better[2].errors.dot_mm < (1.0 - (1.0 - SURER_THAN_MIDDLES) * by_edges) * estimate.errors.dot_mm:
            kept, bundle, estimate = better
    return kept, bundle, estimate, empty, [*held, *of_two_kinds(answers)]


def adjust(
    presses: Sequence[Press], sensor: SensorProfile, progress: Callable[[int, int], None] = lambda *_: None
) -> tuple[list[Press], Bundle, Estimate]:
    """Adjust presses from a rough profile: the dots that agree, the camera, and the errors of dots."""
    problem = problem_of(presses, sensor, Errors())
    bundle = solve(problem)
    # the first solution rests on wrong dots, too: what agrees with it is chosen once more after it was solved without them
    for k in range(2):
        progress(k, 2)
        kept = agreeing(presses, bundle, problem)
        # dots that do not agree may take whole presses with them
        if len(kept) < LEAST_PRESSES:
            refuse_few(kept)
        problem = problem_of(kept, bundle.sensor, bundle.errors, _free(bundle))
        bundle = solve(problem)
        estimate = estimate_errors(*designs_of(problem, bundle))
        problem = replace(problem, errors=estimate.errors)
        bundle = solve(problem)
    progress(2, 2)
    free = _free(bundle)
    if not free.all():  # a lens whose distortion is not seen has no centre
        centred = replace(bundle.sensor, geometry=replace(bundle.sensor.geometry, center_px=None))
        bundle = solve(problem_of(kept, centred, bundle.errors, free))
    return kept, bundle, estimate


def _free(bundle: Bundle) -> BoolArray:
    """The camera's observable parameters: the distortion's centre only if there is distortion."""
    free = np.ones(camera.COUNT, dtype=bool)
    # the centre of no distortion can be anywhere: its covariance would be that of its prior
    free[4:] = abs(bundle.values[3]) > SURE_LENS * np.sqrt(bundle.covariance[3, 3])
    return free


def _corner_mm(bundle: Bundle) -> FloatArray:
    sensor = bundle.sensor
    # mm on the gel at the image's corners: changes of parameters that compensate each other do not show here
    ends = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]) * (sensor.width_px - 1, sensor.height_px - 1)
    return sensor.camera.from_px(ends) - sensor.camera.from_px(sensor.centre_px)


def _with_sigmas(bundle: Bundle) -> SensorProfile:
    """The profile with the standard deviations of its camera."""
    sensor = bundle.sensor
    scale, aspect, shear, k1 = np.sqrt(np.diag(bundle.covariance))[:4].tolist()
    geometry = replace(
        sensor.geometry, sigma_px_per_mm=scale * sensor.px_per_mm[0], sigma_aspect=aspect, sigma_shear=shear, sigma_k1=k1
    )
    return replace(sensor, geometry=geometry)


def _held_out(presses: Sequence[Press], bundle: Bundle, free: BoolArray) -> HeldOut | None:
    """Cross-validation: the camera from some presses, the pose alone of the others."""
    if len(presses) < 4:
        return None
    outside = []
    folds = min(FOLDS, len(presses))
    # no free parameter of the camera: of presses left out the poses alone are fitted
    nothing = np.zeros(camera.COUNT, dtype=bool)
    for fold in range(folds):
        # every k-th press, so that each fold has presses from the whole session
        rest = [p for k, p in enumerate(presses) if k % folds != fold]
        out = [p for k, p in enumerate(presses) if k % folds == fold]
        learned = solve(problem_of(rest, bundle.sensor, bundle.errors, free))
        outside += list(solve(problem_of(out, learned.sensor, bundle.errors, nothing)).residual_mm)
    squares = np.concatenate([r.ravel() ** 2 for r in outside])
    return HeldOut(inside_um=1000 * bundle.rms_mm, outside_um=1000 * float(np.sqrt(squares.mean())), folds=folds)


def _profile(
    name: str,
    like: SensorProfile,
    bundle: Bundle,
    estimate: Estimate,
    relief: Relief | None,
    noise: Noise | None,
    presses: Sequence[Press],
) -> SensorProfile:
    """The new profile."""
    sensor = _with_sigmas(bundle)
    gel = replace(
        like.gel,
        displacement_um=1000 * estimate.errors.gel_mm,
        correlation_mm=estimate.errors.correlation_mm,
        blur_mm=like.gel.blur_mm if relief is None else relief.blur_mm,
    )
    if gel.crown_mm is not None and (sensor.rotate90 - like.rotate90) % 2:  # its radii are along u and v
        gel = replace(gel, crown_mm=(gel.crown_mm[1], gel.crown_mm[0]))
    sigma = sensor.geometry.sigma_px_per_mm or 0.0
    touched = sorted({press.tape for press in presses})
    return replace(
        sensor,
        name=name,
        title=f"{name}, calibrated from {len(presses)} presses on {', '.join(touched)}",
        scale_tolerance=min(max(LEAST_TOLERANCE, 5.0 * sigma / sensor.px_per_mm[0]), 0.5),
        slope_noise=sensor.slope_noise if noise is None else noise.slope if noise.slope > 0.0 else None,
        white_um=sensor.white_um if noise is None else noise.white_um,
        correlated_um=sensor.correlated_um if noise is None else 0.0,
        gel=gel,
    )


def _quantities(
    sensor: SensorProfile,
    bundle: Bundle,
    estimate: Estimate,
    relief: Relief | None,
    noise: Noise | None,
    corner_um: float,
) -> Iterator[Quantity]:
    geometry, (u, v) = sensor.geometry, sensor.px_per_mm
    sigma = geometry.sigma_px_per_mm or 0.0
    spread = np.sqrt(np.diag(bundle.covariance))
    seen = bool(spread[4] > 0.0)
    unit, um = ("mm", "um") if sensor.depth_unit_mm is not None else ("frame unit", "frame unit / 1000")
    unit_mm = sensor.depth_unit_mm or 1.0
    yield Quantity("px_per_mm_u", u, sigma, "px/mm")
    yield Quantity("px_per_mm_v", v, sigma * v / u, "px/mm")
    yield Quantity("aspect", geometry.aspect, geometry.sigma_aspect)
    yield Quantity("shear", geometry.shear, geometry.sigma_shear)
    yield Quantity("k1", geometry.k1, geometry.sigma_k1)
    note = "" if seen else "image centre: no distortion is seen, so it has none"
    for axis, at, of_axis in zip("uv", geometry.center_px or sensor.centre_px.tolist(), spread[4:].tolist(), strict=True):
        yield Quantity(f"center_{axis}", at, of_axis if seen else None, "px", note)
    yield Quantity("corner", 0.0, corner_um / 1000, "mm", "error of the camera at the worst place in view")
    yield Quantity("over_perfect", share_of_perfect(bundle), None, "", "rms of positions over a perfect camera's, as expected")
    gel, moved = estimate.errors, estimate.errors.gel_mm > 0.0
    yield Quantity("dot", 1000 * gel.dot_mm, None, "um", "error of a whole dot along an axis")
    about = 1000 * gel.gel_mm * estimate.sigma_ln_gel if moved else None
    yield Quantity("gel_displacement", 1000 * gel.gel_mm, about, "um", "" if moved else "none is seen")
    if moved:
        yield Quantity("gel_correlation", gel.correlation_mm, gel.correlation_mm * estimate.sigma_ln_correlation, "mm")
    if relief is not None:
        yield Quantity("blur", relief.blur_mm, relief.sigma_blur_mm, "mm")
        about = None if relief.sigma_amplitude is None else relief.sigma_amplitude * unit_mm
        yield Quantity("amplitude", relief.amplitude * unit_mm, about, unit, "height of a part")
    if noise is not None:
        where = f"{noise.patches} patches off contact" if noise.patches else "between the dots; white noise is within it"
        yield Quantity("noise_slope", noise.slope, noise.sigma_slope, "", where)
        if noise.patches:
            yield Quantity("noise_white", noise.white_um, noise.sigma_white_um, um)
