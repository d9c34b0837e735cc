"""Makes the picture of dots.md from a simulated contact. Run: python docs/make_dots_figure.py"""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from tactape_fab import Localizer, Tape, TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import Scene, simulate
from tactape_fab.sense.decode.dots.detect import detect
from tactape_fab.sense.decode.dots.inputs import canonical_frame
from tactape_fab.sense.decode.dots.rim import settled
from tactape_fab.sense.decode.rank import read
from tactape_fab.sense.decode.search.search import Place
from tactape_fab.sense.decode.search.single_place import places_near, shown_by

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.patches import Circle

FIGURE = Path(__file__).parent / "figures" / "dots.png"
SCENE = Scene(missing=0.06, bumps=3, contact_mm=(13.0, 9.0))
POSITION_MM, THETA_DEG = (62.0, 20.0), 24.0
SEED = 5
ORANGE, GREEN, LINES = "#d95f0e", "#1b7837", "#7fb3e6"


def picture(axes: Any, image: Any, title: str) -> None:
    axes.imshow(image, cmap="gray", interpolation="nearest")
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xticks([])
    axes.set_yticks([])


def evidence(tape: Tape, place: Place, turn: int) -> Any:
    """Ln E of the dots at every place of the tape, by the column and the row of their corner, in one turn."""
    found = np.full((tape.rows, tape.columns), np.nan)
    middle = np.array([tape.columns, tape.rows]) / 2
    cells, values = places_near(place.tables[0], shown_by(tape), turn, middle, float(tape.columns), 1)
    for (column, row), value in zip(cells.tolist(), values.tolist(), strict=True):
        if 0 <= column < tape.columns and 0 <= row < tape.rows:
            found[row, column] = value
    return found


def main() -> None:
    tape = examine(TapeSpec(sector=7)).layout.tape
    localizer = Localizer([tape])
    depth = simulate(tape, POSITION_MM, THETA_DEG, scene=SCENE, seed=SEED)
    fix = localizer.locate(depth)
    assert fix.located and fix.dots is not None and fix.position_mm is not None
    assert fix.theta_deg is not None and fix.px_per_mm is not None
    view, scale, centre_mm = localizer._view, localizer._square.detection_px_per_mm, np.array(fix.position_mm)
    image = canonical_frame(depth, localizer.sensor)
    found = detect(image, scale)
    dots = settled(found, view.pitch_px, view.shift)
    reading = read(dots, view, localizer._world, None, 1e-4, 1e-5)
    assert reading is not None and isinstance(reading.place, Place) and found.high is not None

    figure, axes = plt.subplots(2, 2, figsize=(10.4, 7.4), layout="constrained")
    first, second, third, fourth = axes.ravel()
    picture(first, image, "1  A depth map")

    coarse = image.shape[0] / found.high.shape[0]
    picture(
        second, np.kron(found.high, np.ones((int(coarse), int(coarse)))), "2  Band-pass, its tops, and how far each is trusted"
    )
    second.scatter(*found.xy_px.T, s=20 + 130 * found.trust, facecolors="none", edgecolors=ORANGE, linewidths=1.1)

    picture(third, image, "3  The grid that fits all dots, and the letter of each")
    # texture = S + (1/R) R(theta) (p - p0), turned round
    c, s, r = np.cos(np.radians(fix.theta_deg)), np.sin(np.radians(fix.theta_deg)), fix.px_per_mm
    back = np.array([[c, s], [-s, c]]) * r
    for axis, lines in enumerate((range(tape.columns), range(tape.rows))):
        for line in lines:
            ends = np.array([[-200.0, -200.0], [200.0, 200.0]])
            ends[:, axis] = line * tape.pitch_mm
            u, v = (view.centre_px + (ends - centre_mm) @ back).T
            third.plot(u, v, color=LINES, lw=0.6, zorder=1)
    third.set_xlim(-0.5, image.shape[1] - 0.5)
    third.set_ylim(image.shape[0] - 0.5, -0.5)
    on_tape = fix.dots.cell[:, 0] >= 0
    letters, sure = fix.dots.symbol.argmax(axis=1), fix.dots.symbol.max(axis=1)
    for uv, letter, share, there in zip(fix.dots.uv_px, letters, sure, on_tape, strict=True):
        du, dv = np.array(tape.points_in.xy[letter]) @ back / r
        third.annotate(
            "",
            xy=uv + 9 * np.array([du, dv]),
            xytext=uv - 4 * np.array([du, dv]),
            arrowprops={"arrowstyle": "-|>", "color": GREEN if there and share > 0.9 else ORANGE, "lw": 1.4},
        )

    values = evidence(tape, reading.place, reading.place.turn)
    column, row = reading.place.cells.min(axis=0)
    others = np.delete(values.ravel(), row * tape.columns + column)
    fourth.set_title(
        "4  ln E at every place of the tape, in the answer's turn:\n"
        f"     the answer {values[row, column]:.0f}, the next {np.nanmax(others):.0f}, and what all dots could say "
        f"{reading.place.most_evidence:.0f}",
        fontsize=10,
        loc="left",
    )
    shown = fourth.imshow(values, cmap="cividis", interpolation="nearest", vmin=np.nanpercentile(values, 1))
    fourth.add_patch(Circle((column, row), 1.6, fc="none", ec=ORANGE, lw=1.6))
    fourth.set_xlabel("column of the dots' corner", fontsize=9)
    fourth.set_ylabel("row", fontsize=9)
    figure.colorbar(shown, ax=fourth, shrink=0.7)
    figure.savefig(FIGURE, dpi=100, metadata={"Software": None})


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    main()
