"""Insert a key that was gripped anyhow. Run: python docs/examples/key.py (under a minute)

A gripper holds a key by its bow, off by some millimetres and degrees; the sensor has to tell how, so that the blade meets the
keyhole. A trial succeeds if the tip is then within 0.25 mm to either side, and the blade within 1.5 degrees. With a tape on the
bow, the fix says it. Without, the bow's own relief is matched with a map of it (tactile mapping): a knurl that repeats itself,
and a mark at one end. Or nothing is sensed, and the grip is taken to be the nominal one.
"""

from __future__ import annotations

import cv2
import numpy as np
from common import BARE, TAPE, TRIALS, FloatArray, Image, axes, keep, save, tape_of, way

from tactape_fab import Localizer, Tape, texture_to_board
from tactape_fab.sense import Scene, simulate

SEED = 4
BOW_MM = (32.0, 24.0)
TIP_MM = 38.0
SIDE_MM, ANGLE_DEG = 0.25, 1.5
SCENE = Scene(contact_mm=(10.0, 9.0))
R, CENTRE = 16.0, np.array([159.5, 119.5])
MAP_PX_PER_MM = 8.0
ANGLES_DEG = np.arange(-10.0, 10.01, 0.5)


def knurl(tape: Tape) -> FloatArray:
    """The bow's own relief: bumps on a plain grid, and a mark of irregular ones over its last 12 mm; board frame."""
    column, row = np.meshgrid(np.arange(tape.columns), np.arange(tape.rows))
    plain = np.stack([column.ravel(), row.ravel()], axis=1) * tape.pitch_mm
    marked = plain[:, 0] > (tape.columns - 1) * tape.pitch_mm - 12.0
    mark = plain[marked] + np.random.default_rng(99).uniform(-0.4, 0.4, (int(marked.sum()), 2))
    return texture_to_board(np.concatenate([plain[~marked], mark]), tape.board.texture_origin_mm)


def band(image: Image, px_per_mm: float) -> Image:
    """What is as wide as a bump."""
    fine, coarse = (cv2.GaussianBlur(image, (0, 0), sigma_mm * px_per_mm) for sigma_mm in (0.12, 0.6))
    return np.asarray(fine - coarse, dtype=np.float32)


def relief_map(tape: Tape, relief: FloatArray) -> tuple[Image, FloatArray]:
    """A map of the relief, stitched from frames of flat pads, and its origin (texture point of pixel (0, 0))."""
    scene = Scene(contact="pad", noise=0.0, dome_mm=0.0, tilt_mm_per_mm=(0.0, 0.0))
    low, high = np.array([-12.0, -10.0]), np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm + (12.0, 10.0)
    width, height = np.ceil((high - low) * MAP_PX_PER_MM).astype(int)
    whole = np.zeros((height, width), dtype=np.float32)
    for x in np.arange(low[0] + 6, high[0], 12.0):
        for y in np.arange(low[1] + 5, high[1], 10.0):
            depth = simulate(tape, (x, y), 0.0, scene=scene, parts=relief)
            step = int(R / MAP_PX_PER_MM)
            small = cv2.resize(depth, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)[11:109, 16:144]
            u, v = np.rint((np.array([x, y]) - low) * MAP_PX_PER_MM - (64, 49)).astype(int)
            part = whole[max(v, 0) : v + 98, max(u, 0) : u + 128]
            part[:] = small[max(-v, 0) :, max(-u, 0) :][: part.shape[0], : part.shape[1]]
    return band(whole, MAP_PX_PER_MM), low + 0.5 / MAP_PX_PER_MM  # the frame's middle is between four pixels


def mapped(depth: Image, chart: Image, low: FloatArray) -> tuple[FloatArray, float]:
    """The pose (texture point, degrees) of best correlation with the map, over all angles and places."""
    step = int(R / MAP_PX_PER_MM)
    small = band(cv2.resize(depth, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA), MAP_PX_PER_MM)
    v, u = np.mgrid[: small.shape[0], : small.shape[1]]
    middle = (np.array(small.shape[::-1]) - 1) / 2
    inside = (((u - middle[0]) / 36) ** 2 + ((v - middle[1]) / 32) ** 2 < 1).astype(np.float32)
    best, found = -np.inf, (np.zeros(2), 0.0)
    for angle in ANGLES_DEG:
        # what is seen at theta is the texture turned clockwise by theta: turned back, it lies as the map does
        turn = cv2.getRotationMatrix2D(tuple(middle), angle, 1.0)
        patch, mask = (cv2.warpAffine(image, turn, small.shape[::-1]) for image in (small, inside))
        box = np.s_[20:100, 40:120]
        scores = cv2.matchTemplate(chart, patch[box] * mask[box], cv2.TM_CCORR)
        energy = cv2.matchTemplate(chart * chart, mask[box], cv2.TM_CCORR)
        score = scores / np.sqrt(np.maximum(energy, 0.05 * energy.max()))
        _, top, _, (x, y) = cv2.minMaxLoc(score)
        if top > best:
            best, found = top, (low + (np.array([x, y]) + middle - (40, 20)) / MAP_PX_PER_MM, float(angle))
    return found


def tip_error(position: FloatArray, theta_deg: float, true: FloatArray, true_deg: float, home: FloatArray) -> tuple[float, float]:
    """Sideways error of the tip (mm) and error of the blade's angle (degrees) where a grip is taken for another."""

    def tip(at: FloatArray, angle_deg: float) -> FloatArray:
        c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
        seen: FloatArray = np.array([[c, -s], [s, c]]) @ (home + np.array([TIP_MM, 0.0]) - at)  # the gripper's u, v
        return seen

    c, s = np.cos(np.radians(true_deg)), np.sin(np.radians(true_deg))
    across = np.array([-s, c])  # the blade's side, in the gripper
    off = tip(position, theta_deg) - tip(true, true_deg)
    return float(abs(off @ across)), abs(theta_deg - true_deg)


def main(trials: int = TRIALS) -> None:
    tape = tape_of(33, BOW_MM)
    relief = knurl(tape)
    home = np.array([tape.columns - 1, tape.rows - 1]) * tape.pitch_mm / 2
    chart, low = relief_map(tape, relief)
    localizer = Localizer([tape])
    names = ("with the tape", "without: its own relief, mapped", "without: nothing sensed")
    errors: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    grips, rng = [], np.random.default_rng(SEED)
    for k in range(trials):
        true, true_deg = home + rng.uniform((-6.0, -3.0), (6.0, 3.0)), float(rng.uniform(-8, 8))
        grips.append(true - home)
        fix = localizer.locate(simulate(tape, true, true_deg, scene=SCENE, seed=k))
        at = (home, 0.0)
        if fix.position_mm is not None and fix.theta_deg is not None:
            at = (np.array(fix.position_mm), fix.theta_deg)
        own = mapped(simulate(tape, true, true_deg, scene=SCENE, seed=k, parts=relief), chart, low)
        for name, (position, theta_deg) in zip(names, (at, own, (home, 0.0)), strict=True):
            errors[name].append(tip_error(position, theta_deg, true, true_deg, home))
    fits = {name: [side <= SIDE_MM and angle <= ANGLE_DEG for side, angle in found] for name, found in errors.items()}
    figure, (left, right) = axes(9.0, 3.4, 2)
    grip = np.array(grips)
    for ax, name, colour in ((left, names[0], TAPE), (right, names[1], BARE)):
        good = np.array(fits[name])
        ax.plot(*grip[good].T, "o", color=colour, ms=4, label=f"inserted, {good.sum()}")
        ax.plot(*grip[~good].T, "x", color="0.25", ms=5, label=f"missed, {(~good).sum()}")
        ax.set(title=name, xlabel="grip off along the key, mm", ylabel="across, mm", ylim=(-3.4, 4.6))
        ax.legend(loc="upper left", ncols=2, fontsize=9, frameon=False)
    save(figure, "key")
    keep("key", "mm", [way(name, fits[name], [side for side, _ in errors[name]]) for name in names], SEED)


if __name__ == "__main__":
    main()
