"""Makes the picture of README: the default tape with what is on it. Run: python docs/make_figures.py (with the extra evidence)"""

from __future__ import annotations

import json
import tempfile
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab import Tape, TapeSpec, make_kit
from tactape_fab.kit.read.readback import read_cpl
from tactape_fab.report.layers import HIDDEN, Shapes, film_shapes
from tactape_fab.sense import Scene, load_sensor
from tactape_fab.texture.frames import LETTERS, FloatArray, texture_to_board

FIGURES = Path(__file__).parent / "figures"
SENSOR = "gelsight-mini"
COLOURS = dict(zip("NWES", ("#0072b2", "#007a5a", "#8a5a00", "#c43c00"), strict=True))
SIDE = 3
"""Grid points along a side of the enlarged piece."""


def drawn(axes: Any, shapes: list[Shapes], parts_mm: FloatArray) -> None:
    """The shapes of the written files, as the report draws them."""
    from matplotlib.collections import LineCollection, PolyCollection

    for shape in shapes:
        outlines = [outline + at for outline, xy in shape.stamps for at in (parts_mm if xy is None else xy)]
        fill, edge, width = shape.fill or "none", shape.stroke or "none", 0.6 if shape.stroke else 0.0
        axes.add_collection(PolyCollection([*outlines, *shape.polygons], facecolors=fill, edgecolors=edge, linewidths=width))
        if shape.lines:
            axes.add_collection(LineCollection(shape.lines, colors=shape.stroke, linewidths=0.9))


def piece_with_all(tape: Tape) -> tuple[int, int]:
    """Column and row of the first piece, from the middle on, whose parts show every symbol at least twice."""
    for row in range(tape.rows // 3, tape.rows - SIDE):
        for column in range(tape.columns // 2, tape.columns - SIDE):
            if (np.bincount(tape.symbols[row : row + SIDE, column : column + SIDE].ravel(), minlength=4) >= 2).all():
                return column, row
    raise LookupError("no piece shows all symbols")


def explained(axes: Any, tape: Tape, column: int, row: int) -> None:
    """The grid, an arrow from each grid point to its part, letters, W and delta."""
    origin, pitch = tape.board.texture_origin_mm, tape.pitch_mm
    cells = [(c, r) for r in range(row, row + SIDE) for c in range(column, column + SIDE)]
    points = texture_to_board(np.array(cells) * pitch, origin)
    centres = tape.part_xy_mm().reshape(tape.rows, tape.columns, 2)
    (x0, y1), (x1, y0) = points.min(axis=0)[[0, 1]], points.max(axis=0)[[0, 1]]
    for x in np.unique(points[:, 0]):
        axes.axvline(x, color="white", lw=0.8, ls=(0, (4, 3)), alpha=0.8)
    for y in np.unique(points[:, 1]):
        axes.axhline(y, color="white", lw=0.8, ls=(0, (4, 3)), alpha=0.8)
    for (c, r), point in zip(cells, points, strict=True):
        letter = LETTERS[tape.symbols[r, c]]
        axes.annotate(
            "", centres[r, c], point, arrowprops={"arrowstyle": "-|>", "color": "white", "lw": 1.8, "shrinkA": 0, "shrinkB": 0}
        )
        axes.plot(*point, "o", color="white", ms=3.5)
        axes.text(
            *(centres[r, c] + (0.36, -0.36)), letter, color="white", fontsize=9, weight="bold", ha="center", va="center",
            bbox={"boxstyle": "circle,pad=0.18", "fc": COLOURS[letter], "ec": "none"},
        )  # fmt: skip
    dimension = {"arrowstyle": "<->", "color": "black", "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
    below = y1 - 0.78 * pitch
    axes.annotate("", (x0, below), (x0 + pitch, below), arrowprops=dimension, annotation_clip=False)
    axes.text(x0 + pitch / 2, below - 0.08, f"W = {pitch:g} mm", ha="center", va="top", fontsize=10)
    axes.set(xlim=(x0 - 0.6 * pitch, x1 + 0.6 * pitch), ylim=(y1 - 0.6 * pitch, y0 + 0.6 * pitch))


def tape() -> None:
    """The default tape, what a sensor sees of it, and nine parts enlarged."""
    from matplotlib.figure import Figure
    from matplotlib.patches import ConnectionPatch, Ellipse, FancyBboxPatch, Rectangle

    with tempfile.TemporaryDirectory() as folder:
        kit = make_kit(TapeSpec(sector=7, models=False), Path(folder) / "tactape-s007")
        files = {
            role: (kit.path / path).read_bytes() for role, path in kit.files.items() if role.endswith(("-top", "profile", "cpl"))
        }
        shapes = [
            s
            for s in film_shapes(files, read_cpl(files["cpl"]), json.loads((kit.path / "manifest.json").read_bytes())["fab"])
            if s.layer not in HIDDEN
        ]
        made, parts_mm = kit.tape, kit.tape.part_xy_mm()
    figure = Figure(figsize=(9.6, 3.75))
    whole, near = figure.add_axes((0.0, 0.06, 0.64, 0.88)), figure.add_axes((0.672, 0.1, 0.325, 0.76))
    for axes in (whole, near):
        drawn(axes, shapes, parts_mm)
        axes.set_aspect("equal")
    whole.axis("off")
    width_mm, height_mm = made.board.size_mm
    whole.set(xlim=(-0.5, width_mm + 0.5), ylim=(-0.5, height_mm + 0.5))
    near.set(xticks=[], yticks=[])
    column, row = piece_with_all(made)
    explained(near, made, column, row)
    (left, right), (low, high) = near.get_xlim(), near.get_ylim()
    whole.add_patch(Rectangle((left, low), right - left, high - low, fill=False, ec="black", lw=1.8))
    for y, end in ((low, (0.0, 0.0)), (high, (0.0, 1.0))):
        figure.add_artist(ConnectionPatch((right, y), end, whole.transData, near.transAxes, color="black", lw=0.8))
    title = f"each part is Δ = {made.displacement_mm:g} mm north, south,\neast or west of its grid point"
    near.set_title(title, fontsize=10)
    sensor, contact_mm = load_sensor(SENSOR), Scene().contact_mm
    seen = np.array([sensor.width_px, sensor.height_px]) / sensor.px_per_mm
    x, y = 20.0, 21.0
    corners = "round,pad=0,rounding_size=1"
    whole.add_patch(FancyBboxPatch((x, y), seen[0], seen[1], boxstyle=corners, fc=(1, 1, 1, 0.35), ec="#0072b2", lw=2.2))
    whole.add_patch(Ellipse((x + seen[0] / 2, y + seen[1] / 2), *contact_mm, fc=(1, 1, 1, 0.25), ec="#0072b2", lw=1.8, ls="--"))
    label: dict[str, Any] = {"ha": "center", "fontsize": 10, "bbox": {"boxstyle": "round,pad=0.25", "fc": "white", "ec": "none"}}
    whole.text(x + seen[0] / 2, y - 3.2, "dashed: a contact, {:g} x {:g} mm".format(*contact_mm), **label)
    whole.text(x + seen[0] / 2, y + seen[1] + 1.6, "what a GelSight Mini sees, {:g} x {:g} mm".format(*seen), **label)
    figure.savefig(FIGURES / "tape.png", dpi=150, metadata={"Software": None})


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    FIGURES.mkdir(exist_ok=True)
    tape()
