"""What a survey brings: `python -m tests.bench.survey [--count N] [--page docs/measure.md]`.

Parts of a tape are drawn off the design, N contacts of them surveyed, and others located by the design, by what the survey says,
and by the true places. The survey has touch alone, or poses of a robot as well, or starts from a scan.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

from tactape_fab import Localizer, Tape
from tactape_fab.sense import Frame, Scene, iterate_frames, load_sensor
from tactape_fab.sense.survey.poses import RobotPose
from tactape_fab.sense.survey.survey import Survey, _surveyed
from tests.bench.as_built import design
from tests.bench.localization_measure import error_of
from tests.bench.marks import write_between
from tests.measured import measured

PLACEMENT_MM, ROBOT_MM, SCAN_MM, SEED = 0.05, 0.02, 0.005, 3
SCENE = Scene(contact_mm=(11.0, 9.0))


@dataclass
class Frames:
    """As `sense.files.depth_maps.FrameFile`, in memory."""

    depths: list[Any]
    px_per_mm: None = None

    @property
    def count(self) -> int:
        return len(self.depths)

    def frames(self) -> Iterator[Any]:
        return iter(self.depths)


def poses_of(frames: Sequence[Frame], turn_deg: float = 40.0) -> list[RobotPose]:
    """What a robot says of the poses of some frames, in a frame of its own."""
    rng, c, s = np.random.default_rng(9), np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    found = []
    for k, frame in enumerate(frames):
        at = np.array([[c, -s], [s, c]]) @ (frame.position_mm * (1.0, -1.0)) + rng.normal(0.0, ROBOT_MM, 2)
        theta = frame.theta_deg + turn_deg + rng.normal(0.0, 0.05)
        found.append(RobotPose(frame=k, x_mm=at[0], y_mm=at[1], theta_deg=theta, sigma_mm=ROBOT_MM, sigma_deg=0.05))
    return found


def surveyed(tape: Tape, frames: Sequence[Frame], robot: Sequence[RobotPose]) -> Survey:
    """The survey of frames in memory."""
    files: Any = [Frames([frame.depth for frame in frames])]
    with TemporaryDirectory() as folder:
        manifest = Path(folder) / "manifest.json"
        manifest.write_text("{}")
        return _surveyed(tape, manifest, load_sensor("gelsight-mini"), files, robot, lambda *_: None)


def said_of(tape: Tape, frames: Sequence[Frame]) -> str:
    """Position (µm rms per axis), angle (degrees rms) and NEES/3 of a localizer, as cells of a table."""
    localizer = Localizer(tape)
    fixes = [(localizer.locate(frame.depth), frame) for frame in frames]
    errors = np.array([error_of(fix, frame) for fix, frame in fixes if fix.located])
    covariances = np.array([fix.covariance for fix, _ in fixes if fix.located])
    nees = np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]).mean() / 3
    rms = np.sqrt((errors**2).mean(axis=0))
    return f"{np.hypot(*rms[:2]) / np.sqrt(2) * 1000:.1f} | {np.degrees(rms[2]):.3f} | {nees:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.survey", description=__doc__)
    parser.add_argument("--count", type=int, default=300, metavar="N", help="contacts of the survey; 300 unless said")
    parser.add_argument(
        "--page", type=Path, metavar="FILE.md", help="write the table between the marks of a page, docs/measure.md"
    )
    chosen = parser.parse_args()
    truth, parts = measured(design(), PLACEMENT_MM, error_mm=1e-9, seed=SEED)
    learn = list(iterate_frames(design(), chosen.count, SEED, scene=SCENE, parts=parts))
    look = list(iterate_frames(design(), 200, SEED + 1, scene=SCENE, parts=parts))
    scanned = measured(design(), PLACEMENT_MM, error_mm=SCAN_MM, seed=SEED)[0]
    lines = [
        f"| {chosen.count} contacts of 11x9 mm, parts placed to {PLACEMENT_MM} mm | position, µm rms | angle, ° rms | NEES/3 "
        "| touched parts are off by, µm | `sigma_mm` says, µm |",
        "|---|---|---|---|---|---|",
        f"| by the design | {said_of(design(), look)} | | |",
    ]
    for name, tape, robot in (
        ("surveyed by touch alone", design(), []),
        (f"with a robot good to {ROBOT_MM} mm", design(), poses_of(learn)),
        (f"from a scan good to {SCAN_MM} mm", scanned, []),
    ):
        start = process_time()
        found = surveyed(tape, learn, robot)
        print(f"{name}: {process_time() - start:.1f} s of a processor, {found.contacts} contacts")
        built = replace(design(), as_built=found.as_built)
        off = (built.built_parts().shift_mm - truth.built_parts().shift_mm)[found.adjusted.part]
        sigma = built.built_parts().sigma_mm[found.adjusted.part]
        rms = [f"{1000 * np.sqrt((values**2).mean()):.1f}" for values in (off, sigma)]
        lines.append(f"| {name} | {said_of(built, look)} | {rms[0]} | {rms[1]} |")
    lines.append(f"| by the true places | {said_of(truth, look)} | | |")
    table = "\n".join(lines) + "\n"
    print(table)
    if chosen.page is not None:
        write_between(chosen.page, "surveyed", table)


if __name__ == "__main__":
    main()
