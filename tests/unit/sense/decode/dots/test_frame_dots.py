"""Dots of one frame for adjustments of many: those that the decoder has, from the image centre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab.sense import ElasticContact, Scene, SensorProfile, load_sensor, simulate
from tactape_fab.sense.decode.dots import frame_dots as module
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.dots.frame_dots import contact_dots, detected, frame_dots, squared
from tactape_fab.sense.decode.dots.inputs import canonical_frame
from tactape_fab.sense.decode.dots.rim import settled
from tactape_fab.sense.decode.square_image import square_image
from tests.contacts import TAPE
from tests.unit.sense.calibrate.sensors import STOCK, TRUE

OBLONG = replace(STOCK, name="oblong", px_per_mm=(STOCK.px_per_mm[0], 0.85 * STOCK.px_per_mm[1]))
POSE = ((40.0, 24.0), 33.0)
SHARP = Scene(elastic=ElasticContact(force_n=2.0), slope_noise=0.032)


@pytest.mark.parametrize("sensor", [TRUE, OBLONG, load_sensor("digit")])
@pytest.mark.parametrize("scene", [SHARP, Scene(contact_mm=(9.0, 8.0), elastomer_mm=0.09), Scene(contact_mm=(9.0, 8.0))])
def test_dots_of_a_contact_are_those_of_the_decoder(sensor: SensorProfile, scene: Scene) -> None:
    depth, square = simulate(TAPE, *POSE, sensor=sensor, scene=scene, seed=3), square_image(sensor)
    image = canonical_frame(depth, sensor)
    shift = TAPE.displacement_mm / TAPE.pitch_mm
    want = square.at_middles(settled(square.dots(image), TAPE.pitch_mm * square.px_per_mm, shift), image, TAPE.part)
    found = contact_dots(depth, sensor, TAPE)
    assert found.by_edges == pytest.approx(want.by_edges, abs=1e-9) and len(found.weights) == len(want.weights) > 15
    assert np.allclose(found.weights, want.weights) and np.allclose(found.trust, want.trust)
    # an offset in pixels is undistorted here with its dot, by the decoder alone: some per cent of it, at the corners
    assert np.abs(found.xy_px - (want.xy_px - square.centre_px)).max() < 0.1


def test_where_tops_are_sharp_middles_are_what_is_seen() -> None:
    depth = simulate(TAPE, *POSE, sensor=TRUE, scene=SHARP, seed=3)
    found, raw = contact_dots(depth, TRUE, TAPE), detected(depth, TRUE)
    assert 0.9 < found.by_edges < 1.0 and found.seen_px is not None and raw.seen_px is not None
    # what the rim's correction of maxima is left with, which moves those by pixels
    assert 0.0 < np.abs(squared(found.seen_px, TRUE) - found.xy_px).max() < 0.2
    # and maxima are elsewhere
    apart_px = np.abs(found.seen_px[:, None] - raw.seen_px).max(axis=2).min(axis=1)
    assert np.median(apart_px) > 0.1 and apart_px.max() < 4.0


def test_soft_tops_keep_their_maxima_to_the_last_digit() -> None:
    depth = simulate(TAPE, *POSE, sensor=TRUE, scene=Scene(contact_mm=(9.0, 8.0)), seed=3)
    found, raw = contact_dots(depth, TRUE, TAPE), detected(depth, TRUE)
    want = settled(raw, TAPE.pitch_mm * TRUE.px_per_mm[0], TAPE.displacement_mm / TAPE.pitch_mm)
    assert want.seen_px is not None and found.seen_px is not None
    assert found.by_edges == 0.0 and np.array_equal(found.xy_px, want.xy_px) and np.array_equal(found.seen_px, want.seen_px)


def test_dots_beyond_a_mask_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the nearest pixel; that of a top which is found beyond the border is the border's."""
    h, w = STOCK.frame_shape
    mask = np.ones((h, w), dtype=bool)
    mask[:, :100] = mask[:50] = False
    image = canonical_frame(simulate(TAPE, *POSE, sensor=STOCK), STOCK)
    every = frame_dots(image, STOCK)
    u, v = every.xy_px.T
    inside = (u > 99.5) & (v > 49.5)
    found = frame_dots(image, replace(STOCK, mask=mask))
    assert 5 < len(found.weights) < len(every.weights) and np.array_equal(found.xy_px, every.xy_px[inside])
    ring = np.pad(np.zeros((h - 2, w - 2), dtype=bool), 1, constant_values=True)
    for beyond in ((-0.6, 60.0), (w - 0.4, 60.0), (150.0, -0.6), (150.0, h - 0.4)):
        moved = replace(every, xy_px=np.tile(beyond, (len(u), 1)))
        monkeypatch.setattr(module, "detect", lambda *_, moved=moved: moved)
        assert len(frame_dots(image, replace(STOCK, mask=ring)).weights) == len(u)
    for xy_px, is_in in (((w - 0.4, 60.0), True), ((150.0, h - 0.4), True), ((-0.6, 60.0), False), ((150.0, -0.6), False)):
        moved = replace(every, xy_px=np.tile(xy_px, (len(u), 1)))
        monkeypatch.setattr(module, "detect", lambda *_, moved=moved: moved)
        assert len(frame_dots(image, replace(STOCK, mask=mask)).weights) == is_in * len(u)


def test_pixels_that_are_oblong_have_the_scale_of_their_area(monkeypatch: pytest.MonkeyPatch) -> None:
    every, asked = detected(np.zeros(OBLONG.frame_shape, dtype=np.float32), OBLONG), []

    def detect(image: Image, px_per_mm: float) -> Dots:
        asked.append(px_per_mm)
        return every

    monkeypatch.setattr(module, "detect", detect)
    assert frame_dots(np.zeros(OBLONG.frame_shape, dtype=np.float32), OBLONG) is every
    assert asked == [pytest.approx(0.85**0.5 * STOCK.px_per_mm[0])]


def test_dots_settle_by_the_tape_s_own_pitch_and_displacement(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[float, float]] = []

    def settle(dots: Dots, pitch_px: float, shift: float) -> Dots:
        asked.append((pitch_px, shift))
        return settled(dots, pitch_px, shift)

    monkeypatch.setattr(module, "settled", settle)
    contact_dots(simulate(TAPE, *POSE, sensor=STOCK), STOCK, TAPE)
    assert asked == [pytest.approx((1.5 * STOCK.px_per_mm[0], 0.25 / 1.5))]


def test_places_are_from_the_image_s_centre_wherever_that_of_the_distortion_is() -> None:
    u, v = STOCK.centre_px
    sensor = replace(STOCK, geometry=replace(STOCK.geometry, k1=0.02, center_px=(u + 20.0, v - 12.0)))
    found = squared(np.array([[u, v], [u + 1.0, v], [u, v + 1.0]]), sensor)
    assert found[0] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert found[1:] == pytest.approx(np.eye(2), abs=0.02)


def test_a_frame_without_dots_has_none() -> None:
    masked = replace(TRUE, mask=np.ones(TRUE.frame_shape, dtype=bool))
    assert len(frame_dots(np.zeros(TRUE.frame_shape, dtype=np.float32), masked).weights) == 0
    assert len(contact_dots(np.zeros(TRUE.frame_shape, dtype=np.float32), TRUE, TAPE).weights) == 0
