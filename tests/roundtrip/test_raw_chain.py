"""From a depth map to the image that a real sensor would take of it, and back: a GelSight Mini's own network and gel.

The image is the network turned round (`raw_images.image_of`), so it shows what eight bits, the camera's noise, the network's
conditioning and the integral cost, not how well the network was calibrated.
"""

from __future__ import annotations

from itertools import permutations

import cv2
import numpy as np
import pytest

from tactape_fab import Localizer
from tactape_fab.sense import Scene, iterate_frames, load_network, make_reconstruction
from tactape_fab.sense.raw.torch_file import read_tensors
from tests.contacts import TAPE, is_near
from tests.raw_images import angles, features, image_of, plain_layers, sensor_data

COUNT = 50
NOISE_GREY = 1.5
"""Of one pixel and colour; 1.2 to 2.1 in images of a GelSight Mini off contact."""
PX_PER_MM = 16.0


def high_passed(depth: np.ndarray) -> np.ndarray:
    """What a decoder looks at: the depth without what varies over more than some 25 px."""
    return np.asarray(depth - cv2.blur(depth, (25, 25)))


def test_the_real_network_sees_no_slopes_where_nothing_is_touched() -> None:
    """It was trained to: only with its inputs in the right order does it."""
    folder = sensor_data()
    background = cv2.imread(str(folder / "background.png"))
    assert background is not None
    network = load_network(folder / "nnmodel.pth")
    assert network.sizes == (5, 32, 32, 32, 2)
    layers = plain_layers(read_tensors(folder / "nnmodel.pth"))
    rms = {}
    for order in permutations(range(3)):
        for place in permutations((3, 4)):
            seen = np.tan(angles(features(np.asarray(background, dtype=np.uint8))[:, list(order + place)], layers))
            rms[order + place] = np.sqrt(np.mean(seen**2))
    found = make_reconstruction(background, network, (PX_PER_MM, PX_PER_MM)).untouched
    least = min(rms.values())
    assert np.sqrt(np.mean(found**2)) == pytest.approx(least, rel=1e-4)
    assert sorted(rms.values())[1] > 3 * least


def test_contacts_are_located_from_images() -> None:
    folder = sensor_data()
    background = cv2.imread(str(folder / "background.png"))
    assert background is not None
    layers = plain_layers(read_tensors(folder / "nnmodel.pth"))
    reconstruction = make_reconstruction(background, load_network(folder / "nnmodel.pth"), (PX_PER_MM, PX_PER_MM))
    localizer = Localizer([TAPE])
    right, squares, places = 0, [], []
    for k, frame in enumerate(iterate_frames(TAPE, COUNT, seed=1, scene=Scene(noise=0.0))):
        image = image_of(frame.depth, background, layers, PX_PER_MM, NOISE_GREY, seed=k)
        depth = reconstruction.depth(image)
        squares.append(np.square(high_passed(depth) - high_passed(frame.depth)).mean())
        fix = localizer.locate(depth)
        x, y = frame.position_mm
        right += fix.located and is_near(fix, (x, y), frame.theta_deg)
        places.append(np.subtract(fix.position_mm or np.nan, (x, y)))
    error_um, place_um = 1e3 * np.sqrt(np.mean(squares)), 1e3 * np.sqrt(np.mean(np.square(places)))
    print(f"{right} of {COUNT} right; depth {error_um:.2f} um rms, place {place_um:.2f} um rms per axis")
    assert right == COUNT
    assert error_um < 2.0
    assert place_um < 3.0
