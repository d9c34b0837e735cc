"""Tops of long parts under a pressure that falls across the contact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tactape_fab import Localizer
from tactape_fab.sense import ElasticContact, Scene, iterate_frames
from tactape_fab.sense.decode.grid.long_parts import DRAWN, drawn_px
from tactape_fab.texture.frames import FloatArray
from tests.contacts import TAPE

R, PART = 16.0, TAPE.part
GEL_MM = 1.5 * np.stack(np.meshgrid(np.arange(-3.0, 4.0), np.arange(-2.0, 3.0)), axis=-1).reshape(-1, 2)


def at_theta(theta_deg: float) -> FloatArray:
    """Texture points of dots on the gel (docs/frames.md)."""
    c, s = np.cos(np.radians(theta_deg)), np.sin(np.radians(theta_deg))
    return np.asarray(GEL_MM @ np.array([[c, -s], [s, c]]))


@pytest.mark.parametrize("theta_deg", [0.0, 30.0, -100.0])
def test_dots_are_drawn_to_the_pressure_along_the_part(theta_deg: float) -> None:
    slope = np.array([0.04, -0.03])
    moved = drawn_px(PART, 7.0 * np.exp(GEL_MM @ slope), R * GEL_MM, at_theta(theta_deg), R)
    turn = np.radians(theta_deg - PART.rotation_deg)
    along = np.array([np.cos(turn), np.sin(turn)])
    length, width, _ = PART.body_mm
    wanted = R * DRAWN * (length**4 - width**4) * ((slope @ along) * along - slope / 2.0)
    assert moved is not None and np.abs(moved - wanted).max() < 0.1 * np.abs(wanted).max()


def test_even_heights_low_ones_and_few_move_nothing() -> None:
    texture = at_theta(20.0)
    for heights in (np.ones(35), np.zeros(35), np.where(np.arange(35) % 3 > 0, 1.0, 0.5)):
        moved = drawn_px(PART, heights, R * GEL_MM, texture, R)
        assert moved is not None and np.abs(moved).max() < 1e-9
    moved = drawn_px(PART, np.exp(GEL_MM[:7] @ [0.04, 0.0]), R * GEL_MM[:7], texture[:7], R)
    assert moved is not None and (moved == 0.0).all()
    assert drawn_px(replace(PART, body_mm=(0.4, 0.4, 0.2)), np.ones(35), R * GEL_MM, texture, R) is None


def test_the_turn_of_a_light_press_is_as_exact_as_said() -> None:
    localizer = Localizer([TAPE], refine="dots")
    frames = list(iterate_frames(TAPE, 8, 9, scene=Scene(elastic=ElasticContact(force_n=1.0), slope_noise=0.032)))
    off = []
    for frame in frames:
        fix = localizer.locate(frame.depth)
        assert fix.theta_deg is not None and fix.covariance is not None
        turn = np.radians((fix.theta_deg - frame.theta_deg + 180.0) % 360.0 - 180.0)
        off.append(turn / np.sqrt(fix.covariance[2, 2]))
    assert np.sqrt(np.mean(np.square(off))) < 1.3  # 1.8 where tops are taken for the parts' middles
