"""Centres from the pixels: nearer to the parts than the dots' own, and only where the parts' relief is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tactape_fab.base.blas import one_thread
from tactape_fab.sense import ElasticContact, Scene, calibrate_sensor, simulate
from tactape_fab.sense.calibrate.adjust import LEAST_AGREEING
from tactape_fab.sense.calibrate.calibration import _adjusted
from tactape_fab.sense.calibrate.posedness import LEAST_PRESSES
from tactape_fab.sense.calibrate.presses import Press, located
from tactape_fab.sense.calibrate.refined import MOST_LOW, refined
from tactape_fab.sense.calibrate.relief import find_relief
from tactape_fab.sense.decode.pixels.patches import pixel_fit
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.part import TapePart
from tests.thorough import only_thorough, slow
from tests.unit.sense.calibrate.sensors import STOCK, TAPE, TRUE, off_mm, pressed, presses


def centred_mm(press: Press, pose: FloatArray) -> FloatArray:
    """Of the dots amid others, their mean taken out: the pose is nobody's here."""
    off = off_mm(press, pose)[press.interior]
    centred: FloatArray = off - off.mean(axis=0)
    return centred


def test_pixels_place_dots_better_than_the_detector() -> None:
    made = presses()
    found, _ = located(made.frames[:4], [TAPE], TRUE)
    fine = refined(made.frames, found, TRUE, [TAPE])
    assert [press.frame for press in fine] == [0, 1, 2, 3] and all(press.fine for press in fine)
    rough_um, fine_um = (
        1000 * np.sqrt(np.mean(np.concatenate([centred_mm(p, made.poses[p.frame]) for p in some]) ** 2)) for some in (found, fine)
    )
    assert fine_um < 0.8 * rough_um < 8.0 and fine_um < 5.0
    # weights are what dots have of their height
    weights = np.concatenate([press.weights for press in fine])
    assert 1.0 - MOST_LOW < weights.min() < weights.max() <= 1.0
    # nothing draws them but the rim, and they are no middles between edges, whatever the dots were
    assert not any(press.pushed.any() or press.rim_mm.any() for press in fine)
    for press in [*fine, *refined(made.frames, [replace(found[0], by_edges=0.7)], TRUE, [TAPE])]:
        assert press.by_edges == 0.0
        for of_dots in (press.seen_px, press.texture_mm, press.rim_mm, press.pushed, press.pulled):
            assert of_dots.shape == (len(press.weights), 2)


def test_a_press_has_as_many_dots_as_a_fit_needs_or_is_left_out() -> None:
    made = presses()
    (found,), _ = located(made.frames[:1], [TAPE], TRUE)
    inner = np.flatnonzero(found.interior)
    for count in (LEAST_AGREEING - 1, LEAST_AGREEING):
        fine = refined(made.frames, [found.taken(inner[:count])], TRUE, [TAPE])
        assert [len(press.weights) for press in fine] == [count] * (count >= LEAST_AGREEING)


def test_pixels_that_are_averaged_first_place_dots_as_well() -> None:
    """A camera of twice as many pixels, whose middles are half a pixel off those of its blocks."""
    doubled = replace(TRUE, width_px=640, height_px=480, px_per_mm=(30.0, 30.0))
    made = pressed(doubled, 2, 1, (5.0, 3.5), 20.0)
    found, _ = located(made.frames, [TAPE], doubled)
    fine = refined(made.frames, found, doubled, [TAPE])
    assert pixel_fit(doubled).factor == 2 and len(fine) == 2
    for press, rough in zip(fine, found, strict=True):
        # the same dots, by both ways to look at them
        to_px = press.seen_px[:, None] - rough.seen_px
        apart_px = to_px[np.arange(len(to_px)), np.hypot(*to_px.transpose(2, 0, 1)).argmin(axis=1)]
        assert np.abs(np.median(apart_px, axis=0)).max() < 0.15 and np.abs(apart_px).max() < 1.0
    # looked for from where they were found, they are found there again
    again = refined(made.frames, fine, doubled, [TAPE])
    moved_px = np.concatenate([new.seen_px - old.seen_px for new, old in zip(again, fine, strict=True)])
    assert np.sqrt(np.mean(moved_px**2)) < 0.015


@pytest.mark.parametrize("part", [replace(TAPE.part, shape="dome"), replace(TAPE.part, body_mm=(2.0, 1.2, 0.4))])
def test_parts_of_unknown_relief_keep_their_dots(part: TapePart) -> None:
    tape = replace(TAPE, part=part)
    found, _ = located(presses().frames[:1], [TAPE], TRUE)
    assert refined(presses().frames, found, TRUE, [tape]) == []


def test_frames_that_show_no_such_part_keep_their_dots() -> None:
    made = presses()
    found, _ = located(made.frames[:1], [TAPE], TRUE)
    noise = np.random.default_rng(0).standard_normal(made.frames[0].shape).astype(np.float32)
    assert refined([noise], found, TRUE, [TAPE]) == []


def test_an_elastic_gel_s_calibration_rests_on_middles() -> None:
    """Pixels that scatter as little as they do are drawn by the pressure all alike: scale and aspect were off by 3 sigma."""
    rng, scene = np.random.default_rng(5), Scene(elastic=ElasticContact(force_n=2.0), slope_noise=0.032)
    frames = []
    for k in range(LEAST_PRESSES):
        at, theta = rng.uniform((20.0, 15.0), (70.0, 33.0)).tolist(), float(rng.uniform(-180.0, 180.0))
        frames.append(simulate(TAPE, at, theta, sensor=TRUE, scene=scene, seed=k))
    with one_thread():
        kept, bundle, *_ = _adjusted(frames, [TAPE], TRUE, [], lambda *_: None)
    assert len(kept) == LEAST_PRESSES and not any(press.fine for press in kept)
    off = bundle.values[:4] - (np.log(15.0), 0.03, 0.01, 0.03)
    assert np.abs(off).max() < 10e-4 and (np.abs(off) < 2.0 * np.sqrt(np.diag(bundle.covariance)[:4])).all()


@slow
def test_pixels_that_are_far_surer_than_middles_count() -> None:
    """Sharp tops of the imprint model are as the pixels' relief has them."""
    made = pressed(TRUE, 8, 1, (5.0, 3.5), 20.0, elastomer_mm=0.06)
    assert located(made.frames[:1], [TAPE], TRUE)[0][0].by_edges == 1.0
    found = calibrate_sensor(made.frames, [TAPE], STOCK)
    assert all(press.fine and press.by_edges == 0.0 for press in found.presses)


@only_thorough
def test_a_calibration_rests_on_the_pixels() -> None:
    found = calibrate_sensor(presses().frames, [TAPE], STOCK)
    assert all(press.fine for press in found.presses)
    assert next(q.value for q in found.quantities if q.name == "dot") < 4.5


def test_of_one_press_nothing_is_known_of_how_relief_differs() -> None:
    made = presses()
    found, _ = located(made.frames[:3], [TAPE], TRUE)
    bundles = [SimpleNamespace(sensor=TRUE, poses=made.poses[:count]) for count in (1, 3)]
    one, more = (find_relief(made.frames, found[: len(b.poses)], b, [TAPE]) for b in bundles)  # type: ignore[arg-type]
    assert one is not None and more is not None
    assert one.sigma_blur_mm is None and one.sigma_amplitude is None
    assert more.sigma_blur_mm is not None and more.sigma_amplitude is not None and more.sigma_amplitude > 0.0
