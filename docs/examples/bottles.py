"""Turn bottles until their labels face the front. Run: python docs/examples/bottles.py (under a minute)

Four bottles stand on a table, each with a tape round it; a camera from above cannot see the labels. A gripper takes one,
turned anyhow, and its sensor touches the tape: the fix in the bottle's frame, with the diameter that the gripper measures to
0.2 mm, says which bottle it is and where its label is; the wrist turns it to the front. A trial succeeds if the label is then
within 2 degrees of the front, and the bottle is known. Where the ends of the tape meet nothing is located: the gripper turns by
20 degrees and tries again, twice at most. Without the tape, smooth glass says nothing, and the bottle stays as it stands.
"""

from __future__ import annotations

import numpy as np
from common import BARE, TAPE, TRIALS, axes, keep, save, tape_of, way

from tactape_fab import Localizer, Tape
from tactape_fab.sense import Mount, Scene, sensor_on_object, simulate

SEED = 6
RADIUS_MM = 30.0
SECTORS = (51, 52, 53, 54)
LABELS_DEG = (0.0, 90.0, 200.0, 300.0)
"""Where the middle of each bottle's label is, counter-clockwise from the tape's left end."""
WITHIN_DEG = 2.0
CALIPER_MM = 0.2
ASIDE_DEG = 20.0
TOUCHES = 3
SCENE = Scene(contact="strip", cylinder_radius_mm=RADIUS_MM, contact_turn_deg=90.0, tilt_mm_per_mm=(0.0, 0.0))


def mount_of(tape: Tape, radius_mm: float) -> Mount:
    """The tape round a bottle that stands upright, z up: board x goes round."""
    top_mm = radius_mm + tape.board.thickness_mm
    around = {"surface": "cylinder", "around": "x", "top_mm": top_mm, "true_mm": radius_mm + tape.board.thickness_mm / 2}
    return Mount(rotation=np.eye(3), position_mm=np.zeros(3), **around)  # type: ignore[arg-type]


def turn_of(angle_deg: float) -> float:
    """An angle within half a turn."""
    return (angle_deg + 180.0) % 360.0 - 180.0


def main(trials: int = TRIALS) -> None:
    tapes = [tape_of(sector, (186.0, 24.0)) for sector in SECTORS]
    localizer = Localizer(tapes)
    rng = np.random.default_rng(SEED)
    names = ("with the tape", "without: it stays as it stands")
    off: dict[str, list[float]] = {name: [] for name in names}
    known = []
    for k in range(trials):
        bottle, stands_deg = int(rng.integers(4)), float(rng.uniform(-180, 180))
        tape, label_deg = tapes[bottle], LABELS_DEG[bottle]
        x0, y0 = tape.board.texture_origin_mm
        around_mm, true_mm = 2 * np.pi * RADIUS_MM, RADIUS_MM + tape.board.thickness_mm / 2
        # the sensor is at the front; the tape's left end is at stands_deg, counter-clockwise seen from above
        off[names[1]].append(abs(turn_of(stands_deg + label_deg)))
        height_mm, measured_mm = float(rng.uniform(9, 15)), RADIUS_MM + float(rng.normal(0, CALIPER_MM / 2))
        found = None
        for touch in range(TOUCHES):
            at_mm = (-(stands_deg + ASIDE_DEG * touch) % 360.0) / 360.0 * around_mm * true_mm / RADIUS_MM
            pose = np.array([at_mm - x0, y0 - height_mm]), float(rng.normal(0, 2.0))
            scene = SCENE.changed({"contact_turn_deg": 90.0 - pose[1]})
            fix = localizer.locate(simulate(tape, *pose, scene=scene, seed=10 * k + touch))
            if fix.position_mm is not None and fix.theta_deg is not None:
                seen = next(one for one in tapes if one.sector == fix.sector)
                there = sensor_on_object("bottle", mount_of(seen, measured_mm), seen, np.array(fix.position_mm), fix.theta_deg)
                front_deg = np.degrees(
                    np.arctan2(there.position_mm[1], there.position_mm[0])
                )  # what faces the sensor, on the bottle
                found = tapes.index(seen), -front_deg - ASIDE_DEG * touch
                break
        known.append(found is not None and found[0] == bottle)
        thought_deg = stands_deg if found is None else float(found[1])
        turned_deg = 0.0 if found is None else -(thought_deg + LABELS_DEG[found[0]])
        off[names[0]].append(abs(turn_of(stands_deg + label_deg + turned_deg)))
    fits = {
        names[0]: [error <= WITHIN_DEG and right for error, right in zip(off[names[0]], known, strict=True)],
        names[1]: [error <= WITHIN_DEG for error in off[names[1]]],
    }
    figure, ax = axes(7.0, 3.2)
    for name, colour in zip(names, (BARE, TAPE)[::-1], strict=True):
        ax.plot(np.sort(off[name]), (np.arange(trials) + 1) / trials, color=colour, label=name, drawstyle="steps-post")
    ax.axvline(WITHIN_DEG, color="0.4", ls=":", lw=1)
    ax.annotate("2°: success", (WITHIN_DEG, 0.05), (WITHIN_DEG * 1.15, 0.05), fontsize=9)
    ax.set(xscale="log", xlabel="label off the front, degrees", ylabel="share of trials", xlim=(0.01, 250), ylim=(0, 1.03))
    ax.legend(frameon=False, fontsize=9, loc="upper left")
    save(figure, "bottles")
    keep("bottles", "°", [way(name, fits[name], off[name]) for name in names], SEED)


if __name__ == "__main__":
    main()
