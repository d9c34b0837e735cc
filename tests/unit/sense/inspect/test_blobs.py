"""Spots of a scan against the places where they were drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tactape_fab.sense.inspect.blobs import film_difference, find_blobs


@pytest.mark.parametrize("width_px", [2213, 2218])
def test_spots_lie_where_they_were_drawn_across_the_whole_scan(width_px: int) -> None:
    """At these widths the smaller picture's size is rounded by nearly half a pixel, up and down."""
    px_per_mm, picture = 12.7, np.full((200, width_px, 3), (30, 120, 200), np.uint8)
    u, v = np.meshgrid(np.arange(50, width_px - 40, 30), np.arange(45, 160, 30))
    for x, y in zip(u.ravel(), v.ravel(), strict=True):
        picture[y - 2 : y + 3, x - 4 : x + 5] = 20
    found = find_blobs(picture, px_per_mm, 0.6).px
    right = found[found[:, 0] > 0.8 * width_px]
    assert len(found) >= u.size
    # columns are 30 px apart, the first at 50
    off_px = (right[:, 0] - 50.0 + 15.0) % 30.0 - 15.0
    assert abs(off_px.mean()) < 0.25


def drawn(places_px: np.ndarray, half_px: tuple[float, float], shape: tuple[int, int]) -> np.ndarray:
    """Share of each pixel that rectangles about these places cover."""
    u, v = (
        np.clip(np.minimum(np.arange(n) + 0.5, at[:, None] + half) - np.maximum(np.arange(n) - 0.5, at[:, None] - half), 0, 1)
        for n, at, half in zip(shape[::-1], places_px.T, half_px, strict=True)
    )
    return np.asarray(np.einsum("nv,nu->vu", v, u))


@pytest.mark.parametrize("px_per_mm", [8.0, 12.7])
def test_each_spot_is_found_once_in_whatever_channel_it_shows(px_per_mm: float) -> None:
    shape, apart_px = (200, 300), 0.9 * px_per_mm
    places = np.stack(np.meshgrid(np.arange(30.3, 270, apart_px), np.arange(30.6, 170, apart_px)), axis=-1).reshape(-1, 2)
    at_edge = np.array([(0.0, 100.0), (299.0, 60.0), (150.0, 0.0), (90.0, 199.0)])
    # the film grows darker along the scan, more than a part differs from it
    film = np.array((30.0, 120.0, 200.0)) - np.linspace(0.0, 25.0, shape[1])[None, :, None]
    spots = drawn(np.concatenate([places, at_edge]), (0.3 * px_per_mm, 0.2 * px_per_mm), shape)
    picture = (film + spots[..., None] * (0.0, 60.0, 0.0)).round().astype(np.uint8)
    found = find_blobs(picture, px_per_mm, 0.6).px
    off_px, nearest = cKDTree(places).query(found)
    assert sorted(nearest) == list(range(len(places)))
    assert np.median(off_px) < 0.3 and off_px.max() < 0.8  # of those at the rim, which have no neighbour on one side


@pytest.mark.parametrize(("coarse_px_per_mm", "shrink"), [(10.0, 0.4), (20.0, 0.8), (50.0, 1.0)])
def test_the_difference_is_that_from_the_film_around(coarse_px_per_mm: float, shrink: float) -> None:
    picture = np.full((250, 300, 3), (30, 120, 200), np.uint8)
    picture[:, 150:] = (60, 90, 220)  # another film
    picture[90:130, 45:85] = (20, 160, 170)  # 1.6 mm wide: less than half of the window of 2.5 mm
    picture[140:240, 10:110] = (130, 20, 100)  # of 4 mm it is the film
    differs, factor = film_difference(picture, 25.0, coarse_px_per_mm)
    assert factor == shrink and differs.shape == (round(250 * shrink), round(300 * shrink))
    v, u = (np.rint(np.array(at) * shrink).astype(int) for at in ((110, 20, 30, 190), (65, 20, 250, 60)))
    assert differs[v, u] == pytest.approx([40.0, 0.0, 0.0, 0.0], abs=1.0)
