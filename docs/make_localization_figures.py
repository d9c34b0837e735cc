"""Makes the pictures of docs/localization.md and docs/verify.md. Run: python docs/make_localization_figures.py"""

from __future__ import annotations

import tempfile
from argparse import ArgumentParser
from pathlib import Path

from tactape_fab import TapeSpec, make_kit
from tactape_fab.sense.files.jobs import localize, prepare
from tactape_fab.sense.files.simulated import simulate_file
from tactape_fab.sense.overlay import draw_overlay
from tactape_fab.verify import read_contact, verify_kit
from tactape_fab.verify.trip.map import map_kit

FIGURES = Path(__file__).parent / "figures"


def overlay() -> None:
    """The overlay of a contact near the tape's edge, with some parts missing and a bump that is none."""
    import cv2

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kit = make_kit(TapeSpec(sector=7), folder / "tactape-s007")
        frames = simulate_file(kit.path, folder / "frames.npz", pose=[3.0, 20.0, 25.0], missing=0.05, bumps=2, seed=8).path
        job = prepare([str(frames)], [str(kit.path)], "gelsight-mini")
        located = next(localize(job))
        picture = draw_overlay(located.depth, located.sensor, job.tapes, located.fix, located.frame)
    cv2.imwrite(str(FIGURES / "localization-overlay.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def coverage() -> None:
    """The map of the main job for contacts that are hardly large enough."""
    picture = FIGURES / "verify-map.png"
    picture.unlink(missing_ok=True)  # `map_kit` replaces what says that this tool wrote it, which a smaller copy does not
    with tempfile.TemporaryDirectory() as name:
        kit = make_kit(TapeSpec(sector=7, models=False), Path(name) / "tactape-s007")
        contact = read_contact(size=(7.5, 6.0))
        map_kit(kit.path, picture, contact, verify_kit(kit.path, contact=contact).trips)


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    FIGURES.mkdir(exist_ok=True)
    overlay()
    coverage()
