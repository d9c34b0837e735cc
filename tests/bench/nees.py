"""Errors of located answers against their covariance, row by row.

    python -m tests.bench.nees [--frames N] [--only ROW] [--noise sensor|slope] [--refine dots|pixels]

e is the error of (x, y, theta), C the covariance that was said. NEES/3, the mean of e^T C^-1 e / 3, is 1 where C is true and
errors are normal; of N frames it scatters by sqrt(2 / 3 N). The last columns are errors of aspect and shear,
`Localization.strain`, over their standard deviation: root mean squares, 1 where that is true; on strips the aspect is that of
foreshortening, several times its deviation, and counts here as an error. The decoder has the stock profile
in every row, whatever the truth is, but for the size of the gel's displacement, unless it is said to be unknown, and, where
gels are not elastic, the crown.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace
from math import radians, tan

import numpy as np

from tactape_fab import Localizer
from tactape_fab.sense import Scene, draw_poses, iterate_frames, load_sensor
from tactape_fab.sense.decode.result import Refined
from tests.bench.localization_measure import error_of, is_right
from tests.bench.localization_rows import SEED, STRIPS, frames_of, plane_gel, registered_tape
from tests.bench.localization_rows import Row as Frames

BEYOND = 7.815
"""Of chi square with 3 degrees of freedom 5 % is beyond."""
MEASURED_SLOPE = 0.032
"""White slope noise, rms a pixel, in 172 patches off contact of a real GelSight Mini."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A scene with the truth that the stock profile does not know; theta is drawn where it is None.

    displacement_um: What the profile says of the gel's displacement; None: the truth.
    cut_at: Quantile of a frame's depths beyond which they are cut off, as where a format's range ends.
    """

    name: str
    scene: Scene = field(default_factory=Scene)
    theta_deg: float | None = None
    displacement_um: float | None = None
    cut_at: float = 1.0


def _at(u_mm: float, v_mm: float, **options: float) -> Scene:
    return Scene(contact_offset_mm=(u_mm, v_mm)).changed(options)


def tilted(deg: float) -> Scene:
    return Scene(tilt_mm_per_mm=(tan(radians(deg)), 0.0))


ROWS = (
    Row(name="default"),
    *(Row(name=f"default, theta {deg:g}", theta_deg=deg) for deg in (0.0, 90.0, 0.2)),
    Row(name="contact 7x7, theta 0", scene=Scene(contact_mm=(7.0, 7.0)), theta_deg=0.0),
    Row(name="blur 0.08 mm, theta 0", scene=Scene(elastomer_mm=0.08), theta_deg=0.0),
    Row(name="off-centre (3, 2)", scene=_at(3.0, 2.0)),
    Row(name="off-centre (4, 3)", scene=_at(4.0, 3.0)),
    *(Row(name=f"scale {100 * e:g} %, (4, 3)", scene=_at(4.0, 3.0, scale_error=e)) for e in (0.002, 0.004, 0.01)),
    Row(name="scale 1 %", scene=Scene(scale_error=0.01)),
    Row(name="aspect 3 %", scene=Scene(aspect_error=0.03)),
    *(Row(name=f"aspect {100 * a:g} %, (3, 2)", scene=_at(3.0, 2.0, aspect_error=a)) for a in (0.03, 0.05)),
    Row(name="shear 2 %", scene=Scene(shear_error=0.02)),
    Row(name="shear 2 %, (3, 2)", scene=_at(3.0, 2.0, shear_error=0.02)),
    *(Row(name=f"lens {100 * k:g} %, (3, 2)", scene=_at(3.0, 2.0, k1_error=k)) for k in (0.02, -0.03, 0.05)),
    *(Row(name=f"tilt {deg:g} deg", scene=tilted(deg)) for deg in (2.0, 5.0)),
    *(Row(name=f"gel displaced {um / 1000:g} mm", scene=Scene(gel_displacement_um=um)) for um in (50.0, 100.0, 200.0)),
    *(
        Row(name=f"gel displaced {um / 1000:g} mm, unknown", scene=Scene(gel_displacement_um=um), displacement_um=0.0)
        for um in (10.0, 20.0, 50.0, 100.0)
    ),
    Row(
        name="contact 7x7, gel displaced 0.03 mm, unknown",
        scene=Scene(gel_displacement_um=30.0, contact_mm=(7.0, 7.0)),
        displacement_um=0.0,
    ),
    Row(name="gel displaced 0.1 mm, 0.02 in the profile", scene=Scene(gel_displacement_um=100.0), displacement_um=20.0),
    *(Row(name=f"placement {mm:g} mm", scene=Scene(placement_mm=mm)) for mm in (0.05, 0.1)),
    *(Row(name=f"strip {width:g} mm", scene=STRIPS[width]) for width in (6.0, 5.0, 4.5)),
    *(
        Row(name=f"cylinder {mm:g} mm, oblique", scene=Scene(contact="strip", cylinder_radius_mm=mm, contact_turn_deg=30.0))
        for mm in (16.0, 100.0)
    ),
    Row(name="contact 7x7", scene=Scene(contact_mm=(7.0, 7.0))),
    *(Row(name=f"depths cut off at the {100 * cut_at:g} % quantile", cut_at=cut_at) for cut_at in (0.99, 0.95, 0.9)),
    Row(name="noise x2", scene=Scene(noise=2.0)),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """What a row shows; errors and NEES of frames located and right."""

    frames: int
    right: int
    wrong: int
    position_um: float
    theta_deg: float
    nees: float
    beyond: float
    aspect: float
    shear: float


def figures_of(row: Row, count: int, refine: Refined) -> Figures:
    """Locate frames of a row; all dots lie alike in their pixels at a theta of 0 or 90, as 1.5 mm are 24 px."""
    scene, theta_deg = row.scene, row.theta_deg
    sensor = plane_gel() if scene.elastic is None else load_sensor("gelsight-mini")
    known_um = (scene.gel_displacement_um or 0.0) if row.displacement_um is None else row.displacement_um
    sensor = replace(sensor, gel=replace(sensor.gel, displacement_um=known_um))
    localizer = Localizer([registered_tape()], sensor, refine=refine)
    wrong = 0
    errors, squares, strains = [np.zeros((0, 3))], [np.zeros(0)], [np.full((1, 2), np.nan)]
    sheared = np.array([scene.aspect_error, scene.shear_error])
    frames = frames_of(Frames(name="", scenes=(scene,)), count)
    if theta_deg is not None:
        poses = draw_poses(registered_tape(), count, SEED, scene=scene)
        poses[:, 2] = theta_deg
        frames = iterate_frames(registered_tape(), count, SEED, scene=scene, poses=poses)
    for frame in frames:
        fix = localizer.locate(np.minimum(frame.depth, np.quantile(frame.depth, row.cut_at)))
        if not is_right(fix, frame):
            wrong += fix.located
            continue
        assert fix.covariance is not None
        error = error_of(fix, frame)
        errors.append(error[None])
        squares.append(np.array([error @ np.linalg.solve(fix.covariance, error)]))
        seen, sigmas = (np.array(of[:2], dtype=np.float64) for of in (fix.strain, fix.strain_sigma) if of is not None)
        strains.append(((seen - sheared) / sigmas)[None])
    error, square = np.concatenate(errors), np.concatenate(squares)
    rms = np.sqrt((error**2).mean(axis=0))
    aspect, shear = np.sqrt(np.nanmean(np.concatenate(strains) ** 2, axis=0)).tolist()
    return Figures(
        frames=count,
        right=len(square),
        wrong=wrong,
        position_um=1000.0 * float(np.hypot(rms[0], rms[1])) / np.sqrt(2.0),
        theta_deg=float(np.degrees(rms[2])),
        nees=float(square.mean()) / 3.0,
        beyond=float((square > BEYOND).mean()),
        aspect=aspect,
        shear=shear,
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.nees", description=__doc__)
    parser.add_argument("--frames", type=int, default=400, metavar="N", help="frames a row")
    parser.add_argument("--only", metavar="ROW", help="rows whose name holds this")
    parser.add_argument("--noise", choices=("sensor", "slope"), default="sensor", help="the profile's, or that of a real sensor")
    parser.add_argument("--refine", choices=("dots", "pixels"), default="dots", help="what poses are fitted to")
    chosen = parser.parse_args()
    noise = {"slope_noise": MEASURED_SLOPE} if chosen.noise == "slope" else {}
    rows = [row for row in ROWS if chosen.only is None or chosen.only in row.name]
    if not rows:
        parser.error(f"--only: no row holds {chosen.only!r}; rows are {', '.join(row.name for row in ROWS)}")
    print("| row | frames | located | wrong | rms µm | rms deg | NEES/3 | beyond 95 % | aspect | shear |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for row in rows:
        f = figures_of(replace(row, scene=row.scene.changed(noise)), chosen.frames, chosen.refine)
        shown = f"{f.position_um:.2f} | {f.theta_deg:.4f} | {f.nees:.2f} | {100 * f.beyond:.1f} %"
        strain = f"{f.aspect:.2f} | {f.shear:.2f}"
        print(f"| {row.name} | {f.frames} | {f.right} | {f.wrong} | {shown} | {strain} |", flush=True)


if __name__ == "__main__":
    main()
