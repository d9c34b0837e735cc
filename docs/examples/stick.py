"""Know where the tip of a smooth stick is. Run: python docs/examples/stick.py (under a minute)

A gripper holds a stick of 16 mm, with a tape round it, somewhere and at some angle; it is to reach for a thing with the tip,
150 mm beyond the tape. A trial succeeds if the tip is within 3 mm of where it is thought to be. With the tape, the fix in the
stick's own frame says it. Without, the gel sees a smooth bar: principal components give its direction and its middle line (the
paper's baseline), but not where along it the grip is.
"""

from __future__ import annotations

import numpy as np
from common import BARE, TAPE, TRIALS, FloatArray, Image, axes, keep, save, tape_of, way

from tactape_fab import Localizer, Tape
from tactape_fab.sense import Mount, Scene, sensor_on_object, simulate

SEED = 5
RADIUS_MM = 8.0
TIP_MM = 150.0
WITHIN_MM = 3.0
R, CENTRE = 16.0, np.array([159.5, 119.5])
TOUCHES = 3


def mount_of(tape: Tape) -> Mount:
    """The tape round the stick: board y goes round, board x lies along the stick, against the axis's direction."""
    film = tape.board.thickness_mm
    turn, zero = np.eye(3), np.zeros(3)
    around = {"surface": "cylinder", "around": "y", "top_mm": RADIUS_MM + film, "true_mm": RADIUS_MM + film / 2}
    return Mount(rotation=turn, position_mm=zero, **around)  # type: ignore[arg-type]


def tip_by_pose(mount: Mount, tape: Tape, position_mm: FloatArray, theta_deg: float) -> FloatArray:
    """The tip in the sensor's frame (mm along u and v), from a pose on the tape: the stick's frame has it on its axis."""
    pose = sensor_on_object("stick", mount, tape, position_mm, theta_deg).transform()
    tip = np.array([0.0, 0.0, -(tape.board.size_mm[0] + TIP_MM)])
    in_sensor: FloatArray = pose[:3, :3].T @ (tip - pose[:3, 3])
    return in_sensor[:2]


def tip_by_bar(depth: Image, grip_mm: float) -> FloatArray:
    """The tip from principal components of a smooth bar's imprint, with the nominal place of the grip along the stick."""
    level = depth - depth.min()
    v, u = np.nonzero(level > 0.6 * level.max())
    points = (np.stack([u, v], axis=1) - CENTRE) / R
    points = points[np.hypot(*points.T) < 7.0]  # a disk, whose rim leans the bar to no side
    middle = points.mean(axis=0)
    _, _, rows = np.linalg.svd(points - middle, full_matrices=False)
    along = rows[0] if rows[0] @ (1.0, 0.0) > 0 else -rows[0]
    foot = middle - (middle @ along) * along  # the point of the middle line nearest the sensor's middle
    tip: FloatArray = foot + (TIP_MM + grip_mm) * along
    return tip


def scene_of(theta_deg: float) -> Scene:
    """A cylinder under the gel; its axis is board x, which a sensor turned by theta sees turned the other way."""
    return Scene(contact="strip", cylinder_radius_mm=RADIUS_MM, contact_turn_deg=-theta_deg, tilt_mm_per_mm=(0.0, 0.0))


def main(trials: int = TRIALS) -> None:
    tape = tape_of(45, (100.0, 50.0))
    mount, localizer = mount_of(tape), Localizer([tape], world="closed")
    x0, y0 = tape.board.texture_origin_mm
    nominal_mm = tape.board.size_mm[0] / 2
    rng = np.random.default_rng(SEED)
    names = ("with the tape", "without: the bar's principal components")
    off: dict[str, list[FloatArray]] = {name: [] for name in names}  # along the stick, and across
    for k in range(trials):
        board = rng.uniform((nominal_mm - 15.0, 9.0), (nominal_mm + 15.0, 41.0))
        position, theta_deg = np.array([board[0] - x0, y0 - board[1]]), float(rng.uniform(-15, 15))
        true = tip_by_pose(mount, tape, position, theta_deg)
        found = np.full(2, np.nan)
        for touch in range(TOUCHES):  # not located: a little further along, of which the gripper knows
            moved = position + np.array([2.0 * touch, 0.0])
            fix = localizer.locate(simulate(tape, moved, theta_deg, scene=scene_of(theta_deg), seed=10 * k + touch))
            if fix.position_mm is not None and fix.theta_deg is not None:
                found = tip_by_pose(mount, tape, np.array(fix.position_mm) - (2.0 * touch, 0.0), fix.theta_deg)
                break
        c, s = np.cos(np.radians(theta_deg)), np.sin(np.radians(theta_deg))
        along = np.array([[c, s], [-s, c]])
        off[names[0]].append(along @ (found - true))
        smooth = simulate(tape, position, theta_deg, scene=scene_of(theta_deg), seed=10 * k, missing=1.0)
        off[names[1]].append(along @ (tip_by_bar(smooth, nominal_mm) - true))
    errors = {name: [float(np.hypot(*one)) for one in found] for name, found in off.items()}
    fits = {name: [error <= WITHIN_MM for error in found] for name, found in errors.items()}
    figure, both = axes(9.0, 4.7, 2)
    turn = np.linspace(0, 2 * np.pi, 100)
    near = both[0].inset_axes((0.6, 0.6, 0.38, 0.34))
    for ax, name, colour, reach in (
        (both[0], names[0], TAPE, 18.0),
        (near, names[0], TAPE, 0.6),
        (both[1], names[1], BARE, 18.0),
    ):
        ax.plot(*np.array(off[name]).T, "o", color=colour, ms=4, alpha=0.7)
        ax.plot(WITHIN_MM * np.cos(turn), WITHIN_MM * np.sin(turn), color="0.4", lw=1, ls=":")
        ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        if ax is not near:
            ax.set(title=name, xlabel="tip off along the stick, mm", ylabel="across, mm")
    near.set_title("enlarged", fontsize=8)
    near.tick_params(labelsize=7)
    both[0].indicate_inset_zoom(near)
    save(figure, "stick")
    keep("stick", "mm", [way(name, fits[name], errors[name]) for name in names], SEED)


if __name__ == "__main__":
    main()
