"""Hold a toolbox level though it slips in the gripper. Run: python docs/examples/posture.py (half a minute)

A gripper holds a toolbox by its handle, with a tape on it. The box hangs askew after the handover; later a part is dropped into
it, and it turns and slides in the grip. A trial succeeds if the box is within 1 degree of level 1.2 s after that, and stays so.
With the tape the wrist follows what the tracker says; without it, the wrist is told nothing by a smooth handle, and holds still.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from common import BARE, TAPE, TRIALS, axes, keep, save, tape_of, way

from tactape_fab import Localizer, Tracker
from tactape_fab.sense import Scene, simulate

SEED = 3
RATE_HZ = 15.0
FRAMES = 42
DROP_S, SLIP_S, SETTLED_S = 1.2, 0.4, 1.2
WRIST_DEG_S = 60.0
LEVEL_DEG = 1.0
SCENE = Scene(contact_mm=(9.0, 8.0), missing=0.02, placement_mm=0.03)


@dataclass(frozen=True)
class Trial:
    """Lean of the box over time, the wrist's angle beside it, when slip was told, and how far off level it ended."""

    time_s: np.ndarray
    lean_deg: np.ndarray
    told_s: list[float]
    error_deg: float

    @property
    def success(self) -> bool:
        return self.error_deg <= LEVEL_DEG


def run(tracker: Tracker | None, rng: np.random.Generator, seed: int) -> Trial:
    """One trial; without a tracker the wrist holds still."""
    grip_deg, slip_deg = rng.uniform(-20, 20), rng.choice([-1.0, 1.0]) * rng.uniform(8, 25)
    start, slide = rng.uniform((14, 12), (46, 28)), np.array([rng.uniform(-1, 1), rng.uniform(1, 4)])
    tape = tape_of(21, (60.0, 40.0)) if tracker is None else tracker.localizer.tapes[0]
    if tracker is not None:
        tracker.reset()
    wrist_deg, leans, told = 0.0, [], []
    time_s = np.arange(FRAMES) / RATE_HZ
    for k, now_s in enumerate(time_s):
        share = float(np.clip((now_s - DROP_S) / SLIP_S, 0.0, 1.0))
        in_grip_deg = grip_deg + share * slip_deg  # the box in the gripper, counter-clockwise
        leans.append(wrist_deg + in_grip_deg)
        if tracker is not None:
            depth = simulate(tape, start + share * slide, -in_grip_deg, scene=SCENE, seed=seed + k)
            track = tracker.update(depth, float(now_s))
            told += [event.timestamp for event in track.events if event.kind == "slip"]
            if track.fix.theta_deg is not None:
                most = WRIST_DEG_S / RATE_HZ
                wrist_deg += float(np.clip(track.fix.theta_deg - wrist_deg, -most, most))
    lean = np.array(leans)
    return Trial(time_s, lean, told, float(np.abs(lean[time_s >= DROP_S + SETTLED_S]).max()))


def main(trials: int = TRIALS) -> None:
    tracker = Tracker(Localizer([tape_of(21, (60.0, 40.0))]))
    ways: dict[str, list[Trial]] = {}
    for name, follows in (("with the tape", tracker), ("without: the wrist holds still", None)):
        rng = np.random.default_rng(SEED)
        ways[name] = [run(follows, rng, 1000 * k) for k in range(trials)]
    rows = [way(name, [t.success for t in found], [t.error_deg for t in found]) for name, found in ways.items()]
    figure, (left, right) = axes(9.0, 3.2, 2)
    for ax, (name, found), colour in zip((left, right), ways.items(), (TAPE, BARE), strict=True):
        for trial in found[:30]:
            ax.plot(trial.time_s, trial.lean_deg, color=colour, alpha=0.45, lw=0.9)
        ax.axhspan(-LEVEL_DEG, LEVEL_DEG, color="0.6", alpha=0.4, lw=0)
        ax.axvline(DROP_S, color="0.4", ls=":", lw=1)
        ax.set(title=name, xlabel="time, s", ylabel="lean of the box, degrees", ylim=(-48, 48))
    left.annotate("a part is dropped in", (DROP_S, 40), (DROP_S + 0.15, 40), fontsize=9, va="center")
    save(figure, "posture")
    keep("posture", "°", rows, SEED)


if __name__ == "__main__":
    main()
