"""Take the drift out of a relative tracker with GTSAM. Run: python docs/examples/slam.py (a minute; needs the extra slam)

A finger goes three times round an object and turns with it. Tracking from one image to the next says how it moved, as
NormalFlow does, but a little wrong each time: 2.5 degrees after a whole turn. On the tape every sixth frame says where it is;
for half a turn it is on a bare part of the object and says nothing.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import gtsam
import numpy as np
from common import BARE, DOCS, TAPE, axes, save, tape_of

from tactape_fab import Localizer
from tactape_fab.sense import measure_pose, simulate
from tests.bench.marks import replaced

SEED = 5
TURNS, STEP_DEG, EVERY = 3, 5.0, 6
HEADING_DEG = 20.0
DRIFT_DEG = 2.5
"""Of a whole turn, as drift and as what single steps scatter."""
ODOMETRY = np.array([2e-4, 2e-4, np.radians(DRIFT_DEG) / np.sqrt(360 / STEP_DEG), 2e-5, 2e-5, 1e-6])
"""Standard deviations of a step, turns (rad) and shifts (m): what the graph is told."""
BARE_DEG = (430.0, 610.0)
START = np.array([1e-3, 1e-3, 1.0, 1.0, 1.0, 1e-4])
"""The first pose: on the tape and upright, anywhere."""


def course(turns: int) -> list[gtsam.Pose3]:
    """True poses of the sensor in the board frame, m: x along its image's u, z into the tape."""
    poses = []
    for angle_deg in np.arange(0.0, 360.0 * turns + 1.0, STEP_DEG):
        way = np.radians(angle_deg)
        x_mm, y_mm, angle = 50 + 18 * np.cos(way), 25 + 9 * np.sin(2 * way), way + np.radians(HEADING_DEG)
        turn = gtsam.Rot3(np.array([(np.cos(angle), np.sin(angle), 0), (np.sin(angle), -np.cos(angle), 0), (0, 0, -1)]))
        poses.append(gtsam.Pose3(turn, np.array([x_mm, y_mm, 0.0]) / 1000))
    return poses


def tracked(poses: list[gtsam.Pose3], rng: np.random.Generator) -> list[gtsam.Pose3]:
    """What the relative tracker says of every step: the truth, a drift of `DRIFT_DEG` a turn, and scatter."""
    drift = np.radians(DRIFT_DEG) * STEP_DEG / 360 * np.array([0, 0, 1, 0, 0, 0])
    scatter = ODOMETRY * (1, 1, 0.2, 1, 1, 1)
    return [a.between(b).retract(drift + rng.normal(0, 1, 6) * scatter) for a, b in pairwise(poses)]


def error(found: gtsam.Pose3, true: gtsam.Pose3) -> tuple[float, float]:
    """How far along the tape, mm, and by how much the turn is off, degrees."""
    off = true.localCoordinates(found)
    return 1000 * float(np.hypot(off[3], off[4])), float(np.degrees(abs(off[2])))


def run(turns: int = TURNS) -> dict[str, Any]:
    """Errors at every step, of the tracker alone and with fixes, and how the fixes' errors fit what they say of themselves."""
    rng = np.random.default_rng(SEED)
    tape = tape_of(45, (100.0, 50.0))
    x0, y0 = tape.board.texture_origin_mm
    localizer = Localizer([tape])
    poses = course(turns)
    graph, values, dead = gtsam.ISAM2(), gtsam.Values(), poses[0]
    new = gtsam.NonlinearFactorGraph()
    new.addPriorPose3(0, poses[0], gtsam.noiseModel.Diagonal.Sigmas(START))
    values.insert(0, poses[0])
    alone, fused, own, met, nees = [], [], [], [], []
    for k, (true, step) in enumerate(zip(poses, [None, *tracked(poses, rng)], strict=True)):
        if step is not None:
            dead = dead.compose(step)
            new.add(gtsam.BetweenFactorPose3(k - 1, k, step, gtsam.noiseModel.Diagonal.Sigmas(ODOMETRY)))
            values.insert(k, graph.calculateEstimatePose3(k - 1).compose(step))
        angle_deg = STEP_DEG * k
        if k % EVERY == 0 and not BARE_DEG[0] < angle_deg < BARE_DEG[1]:
            x, y = 1000 * true.translation()[:2]
            depth = simulate(tape, (x - x0, y0 - y), angle_deg + HEADING_DEG, tilt_mm_per_mm=(0.0, 0.0), seed=SEED + k)
            fix = localizer.locate(depth)
            measured = measure_pose(fix)
            if measured is not None:
                new.add(measured.prior_factor(k))
                seen = gtsam.Pose3(measured.pose)
                own.append(error(seen, true))
                met.append(k)
                off = seen.localCoordinates(true)[[2, 3, 4]]
                nees.append(float(off @ measured.information[2:5, 2:5] @ off) / 3)
        graph.update(new, values)
        new, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        alone.append(error(dead, true))
        fused.append(error(graph.calculateEstimatePose3(k), true))
    whole = graph.calculateEstimate()
    after = [error(whole.atPose3(k), true) for k, true in enumerate(poses)]
    errors = {"alone": alone, "fused": fused, "after": after, "own": own, "at": [fused[k] for k in met]}
    return {**{name: np.array(each) for name, each in errors.items()}, "nees": nees}


ROWS = (
    ("tracker alone", "alone"),
    ("with fixes, as it goes", "fused"),
    ("with fixes, all at the end", "after"),
    ("with fixes, at those steps that have one", "at"),
    ("the fixes themselves", "own"),
)


def table(found: dict[str, Any]) -> str:
    """Errors of each way, root mean square and largest."""
    rows = ["| | rms | largest | rms | largest |", "|---|---|---|---|---|"]
    for name, key in ROWS:
        rms, most = np.sqrt((found[key] ** 2).mean(axis=0)), found[key].max(axis=0)
        rows.append(f"| {name} | {rms[0]:.3f} mm | {most[0]:.3f} mm | {rms[1]:.3f}° | {most[1]:.3f}° |")
    nees = float(np.mean(found["nees"]))
    return "\n".join(rows) + f"\n\n{len(found['nees'])} fixes; their squared error over their covariance is {nees:.2f}.\n"


def main() -> None:
    found = run()
    figure, (left, right) = axes(9.0, 3.2, 2)
    angle_deg = STEP_DEG * np.arange(len(found["alone"]))
    for ax, column, unit in ((left, 0, "mm"), (right, 1, "degrees")):
        ax.axvspan(*BARE_DEG, color="0.92", lw=0)
        ax.plot(angle_deg, found["alone"][:, column], color=BARE, label="tracker alone")
        ax.plot(angle_deg, found["fused"][:, column], color=TAPE, label="with fixes, as it goes")
        ax.plot(angle_deg, found["after"][:, column], color=TAPE, ls=":", label="with fixes, all at the end")
        ax.set(xlabel="way round the object, degrees", ylabel=f"error, {unit}", xlim=(0, angle_deg[-1]))
        ax.set_ylim(bottom=0)
        ax.set_xticks(np.arange(0, angle_deg[-1] + 1, 180))
    left.set_title("position on the object")
    right.set_title("turn")
    left.legend(frameon=False, loc="upper left")
    left.text(np.mean(BARE_DEG), 0.4 * left.get_ylim()[1], "bare part:\nno fixes", ha="center", color="0.4", fontsize=8)
    save(figure, "slam")
    page = DOCS / "slam.md"
    page.write_text(replaced(page.read_text(encoding="utf-8"), "drift", table(found)), encoding="utf-8")


if __name__ == "__main__":
    main()
