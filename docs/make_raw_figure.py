"""Makes the picture of docs/raw-images.md. Run: TACTAPE_SENSOR_DATA=FOLDER python docs/make_raw_figure.py

The folder holds background.png and nnmodel.pth of a GelSight Mini (rpl-cmu/normalflow, examples/, MIT).
"""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a dependency installs a package `tests`, too

from tactape_fab import Localizer, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Scene, load_network, make_reconstruction, simulate
from tactape_fab.sense.overlay import draw_overlay
from tactape_fab.sense.raw.torch_file import read_tensors
from tests.raw_images import image_of, plain_layers

PX_PER_MM = 16.0
PANEL = (480, 360)
GAP = 8


def figure(folder: Path) -> np.ndarray:
    """Image, depth and answer side by side."""
    tape = examine(TapeSpec(sector=7)).layout.tape
    background = cv2.imread(str(folder / "background.png"))
    assert background is not None, "no picture"
    weights = folder / "nnmodel.pth"
    truth = simulate(tape, (40.0, 22.0), 25.0, scene=Scene(noise=0.0), seed=4)
    image = image_of(truth, background, plain_layers(read_tensors(weights)), PX_PER_MM, noise_grey=1.5)
    depth = make_reconstruction(background, load_network(weights), (PX_PER_MM, PX_PER_MM)).depth(image)
    localizer = Localizer([tape])
    overlay = draw_overlay(depth, localizer.sensor, [tape], localizer.locate(depth), 0)
    answer = overlay[56 : 56 + 720]
    grey = cv2.cvtColor(cv2.normalize(depth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    panels = [cv2.resize(panel, PANEL, interpolation=cv2.INTER_AREA) for panel in (image, grey, answer)]
    gap = np.full((PANEL[1], GAP, 3), 255, dtype=np.uint8)
    return np.hstack([panels[0], gap, panels[1], gap, panels[2]])


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    picture = figure(Path(os.environ["TACTAPE_SENSOR_DATA"]))
    cv2.imwrite(str(Path(__file__).parent / "figures" / "raw-chain.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
