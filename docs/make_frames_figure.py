"""Makes the picture of frames.md from a tape and a simulated contact. Run: python docs/make_frames_figure.py"""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from tactape_fab import Tape, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import simulate
from tactape_fab.texture.frames import texture_to_board

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.patches import Polygon, Rectangle

FIGURE = Path(__file__).parent / "figures" / "frames.png"
POSITION_MM, THETA_DEG, PX_PER_MM = (20.0, 12.0), 30.0, 16.0
WIDTH_PX, HEIGHT_PX = 320, 240
BLUE, ORANGE, GREEN, INK, FAINT = "#0059b2", "#b35900", "#1b7837", "#222222", "#9a9a9a"
PAPER = {"fc": "white", "ec": "none", "pad": 0.8, "alpha": 0.85}


def arrow(axes: Any, start: Any, end: Any, colour: str, text: str, offset: tuple[float, float]) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "lw": 2.0, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=end, xytext=start, arrowprops=style, zorder=5)
    words = {"color": colour, "fontsize": 11, "ha": "center", "va": "center", "bbox": PAPER, "zorder": 6}
    axes.annotate(text, end, xytext=offset, textcoords="offset points", **words)


def on_board(tape: Tape, uv_px: Any) -> Any:
    """Where image points lie on the board: T = S + (1/R) [[cos, sin], [-sin, cos]] (p - p0)."""
    cos, sin = np.cos(np.radians(THETA_DEG)), np.sin(np.radians(THETA_DEG))
    offset = (np.asarray(uv_px, dtype=float) - ((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)) / PX_PER_MM
    return texture_to_board(POSITION_MM + offset @ np.array([[cos, sin], [-sin, cos]]).T, tape.board.texture_origin_mm)


def draw_board(axes: Any, tape: Tape) -> None:
    width, height = tape.board.size_mm
    axes.add_patch(Rectangle((0, 0), width, height, fc="#fbf6ea", ec=INK, lw=1.2))
    axes.scatter(*tape.part_xy_mm().T, s=5, c=FAINT, marker="s", linewidths=0)
    axes.add_patch(Rectangle((0, 0), 6, height, fc="none", ec=FAINT, ls=":", lw=1))
    axes.text(3, height / 2, "tag strip", rotation=90, color=FAINT, ha="center", va="center", fontsize=9)
    arrow(axes, (0, 0), (9, 0), ORANGE, "x", (10, 0))
    arrow(axes, (0, 0), (0, 9), ORANGE, "y", (0, 11))
    axes.text(0.2, -2.2, "board frame: lower-left corner, y up", color=ORANGE, fontsize=9)
    x0, y0 = tape.board.texture_origin_mm
    arrow(axes, (x0, y0), (x0 + 9, y0), BLUE, "x, columns", (36, 0))
    arrow(axes, (x0, y0), (x0, y0 - 9), BLUE, "y, rows", (0, -11))
    axes.text(x0 - 1, height + 0.9, "texture frame: grid point (0, 0), y down", color=BLUE, fontsize=9)
    corners = on_board(tape, [(0, 0), (WIDTH_PX, 0), (WIDTH_PX, HEIGHT_PX), (0, HEIGHT_PX)])
    axes.add_patch(Polygon(corners, fc="none", ec=GREEN, lw=1.6))
    origin, along, down = on_board(tape, [(0, 0), (110, 0), (0, 110)])
    arrow(axes, origin, along, GREEN, "u", (6, 8))
    arrow(axes, origin, down, GREEN, "v", (8, -8))
    place = texture_to_board(POSITION_MM, tape.board.texture_origin_mm)
    axes.plot(*place, "o", color=INK, ms=5)
    axes.text(place[0] + 0.5, place[1] - 1.6, "S", color=INK, fontsize=12, weight="bold")
    axes.plot([place[0], place[0] + 8], [place[1], place[1]], color=INK, lw=0.9, ls="--")
    turn = np.radians(np.linspace(0, THETA_DEG, 30))
    axes.plot(place[0] + 6 * np.cos(turn), place[1] + 6 * np.sin(turn), color=INK, lw=1.2)
    end = on_board(tape, [((WIDTH_PX - 1) / 2 + 8 * PX_PER_MM, (HEIGHT_PX - 1) / 2)])[0]
    axes.plot([place[0], end[0]], [place[1], end[1]], color=INK, lw=0.9, ls="--")
    axes.text(place[0] + 6.5, place[1] + 1.3, "θ", color=INK, fontsize=12)
    axes.set(xlim=(-2, width + 2), ylim=(-3.5, height + 3), aspect="equal", title="On the tape, seen from above")
    axes.axis("off")


def draw_image(axes: Any, tape: Tape) -> None:
    depth = simulate(tape, POSITION_MM, THETA_DEG, contact_mm=(18.0, 13.0), noise=0.0)
    axes.imshow(depth, cmap="gray")
    arrow(axes, (0, 0), (110, 0), GREEN, "u", (12, -10))
    arrow(axes, (0, 0), (0, 110), GREEN, "v", (12, -6))
    middle = ((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
    axes.plot(*middle, "o", color="white", mec=INK, ms=6)
    axes.annotate("p0", middle, xytext=(0, 15), textcoords="offset points", color=INK, fontsize=11, ha="center", bbox=PAPER)
    for direction, text in (((1, 0), "x"), ((0, 1), "y")):
        cos, sin = np.cos(np.radians(THETA_DEG)), np.sin(np.radians(THETA_DEG))
        u, v = np.array([[cos, -sin], [sin, cos]]) @ np.array(direction) * 75
        arrow(axes, middle, (middle[0] + u, middle[1] + v), "#4aa3ff", text, (11 * np.sign(u), -11 * np.sign(v)))
    axes.set(title="In the image: the pattern is turned clockwise by θ", xticks=[], yticks=[])


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    tape = examine(TapeSpec(sector=7, size_mm=(48.0, 32.0), models=False)).layout.tape
    figure, (left, right) = plt.subplots(1, 2, figsize=(12.4, 4.6), width_ratios=(1.25, 1.0))
    draw_board(left, tape)
    draw_image(right, tape)
    figure.tight_layout()
    figure.savefig(FIGURE, dpi=100, metadata={"Software": None})
