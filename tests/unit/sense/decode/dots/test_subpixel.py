"""Tops between pixels: right wherever in a pixel they lie, and alike for all dots of a tape that lies along the pixels."""

from __future__ import annotations

import numpy as np
import pytest

from tactape_fab import Localizer
from tactape_fab.sense import Scene, simulate
from tactape_fab.sense.decode.dots.filters import Image
from tactape_fab.sense.decode.dots.subpixel import sharp_tops
from tactape_fab.sense.decode.square_image import SquareImage
from tactape_fab.texture.frames import FloatArray
from tests.contacts import TAPE

R = 16.0
PHASES = np.stack(np.meshgrid(np.linspace(-0.7, 0.7, 8), np.linspace(-0.7, 0.7, 8)), axis=-1).reshape(-1, 2)


def long_bump(at_px: FloatArray, height: float = 1.0) -> FloatArray:
    """A bump twice as long as wide, askew, in an image of half the resolution."""
    v, u = np.mgrid[:16, :16]
    along, across = (u + v - at_px.sum()) / np.sqrt(2.0), (u - v - at_px[0] + at_px[1]) / np.sqrt(2.0)
    return np.asarray(height * np.exp(-0.5 * ((along / 2.8) ** 2 + (across / 1.6) ** 2)))


def test_from_anywhere_near_the_top_is_found() -> None:
    top = np.array([7.3, 7.9])
    seen_px = 2.0 * (top + PHASES) + 0.5
    shift_px = sharp_tops(long_bump(top).astype(np.float32), R, seen_px)[0]
    near = np.abs(PHASES).max(axis=1) < 0.45
    assert near.sum() >= 16
    # to 1/60 px, 1 um: a step of Newton from as far as half a coarse pixel
    assert np.abs(seen_px + shift_px - (2.0 * top + 0.5))[near].max() < 0.06
    again = sharp_tops(long_bump(top).astype(np.float32), R, (seen_px + shift_px)[near])[0]
    assert np.abs((seen_px + shift_px)[near] + again - (2.0 * top + 0.5)).max() < 0.004


def test_what_is_no_top_or_at_the_border_stays() -> None:
    top = np.array([8.0, 8.0])
    hollow, image = long_bump(top, -1.0).astype(np.float32), long_bump(top).astype(np.float32)
    at = np.array([[16.5, 16.5]])
    assert (sharp_tops(hollow, R, at)[0] == 0.0).all()
    assert (sharp_tops(np.zeros((16, 16), dtype=np.float32), R, at)[0] == 0.0).all()
    border = np.array([[0.0, 16.0], [16.0, 1.0], [31.0, 16.0], [16.0, 30.0], [-5.0, 500.0]])
    assert (sharp_tops(image, R, border)[0] == 0.0).all()


def unmoved(_: SquareImage, __: object, high: Image, seen_px: FloatArray, *___: object) -> tuple[FloatArray, FloatArray, None]:
    """Shifts and heights of dots that are left where they were detected."""
    return np.zeros_like(seen_px), np.ones(len(seen_px)), None


@pytest.mark.parametrize("theta_deg", [0.0, 90.0])
def test_a_tape_along_the_pixels_is_where_it_is_at_every_phase(theta_deg: float, monkeypatch: pytest.MonkeyPatch) -> None:
    # 1.5 mm are 24 px: all dots lie alike in their pixels, and what one is off by all are
    localizer, scene = Localizer([TAPE], refine="dots"), Scene(noise=0.0)
    places = np.array([30.0, 20.0]) + 0.125 * np.array(
        [[0.125, 0.0], [0.875, 0.0], [0.0, 0.125], [0.0, 0.875], [0.25, 0.25], [0.5, 0.0]]
    )
    frames = [simulate(TAPE, place.tolist(), theta_deg, scene=scene) for place in places]

    def off_um() -> float:
        found = [localizer.locate(frame) for frame in frames]
        assert all(fix.located for fix in found)
        return float(np.abs(np.array([fix.position_mm for fix in found]) - places).max() * 1000.0)

    assert off_um() < 1.0
    monkeypatch.setattr(SquareImage, "shifts", unmoved)
    assert off_um() > 4.0


def test_only_the_pose_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    localizer = Localizer([TAPE], refine="dots")
    frames = [
        simulate(TAPE, (30.0, 20.0), theta_deg, scene=Scene(contact_mm=(6.0, 6.0)), seed=k)
        for k, theta_deg in enumerate((0, 33, 90))
    ]
    sharp = [localizer.locate(frame) for frame in frames]
    monkeypatch.setattr(SquareImage, "shifts", unmoved)
    for fix, frame in zip(sharp, frames, strict=True):
        before = localizer.locate(frame)
        for name in ("located", "reason", "tape", "cell", "contact_mm", "n_dots", "p_tape", "p_place", "p_false"):
            assert getattr(fix, name) == getattr(before, name)
        if fix.located:
            assert fix.position_mm != before.position_mm
