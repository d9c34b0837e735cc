"""Both simulators side by side: the imprint that most of this page uses, and an elastic gel that knows nothing of it.

    python -m tests.bench.evidence.simulators [--frames N] [--only SCENE] [--refine dots|pixels]

prints the table by itself: 4,400 contacts of an elastic gel are 15 minutes of a processor.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from tactape_fab.sense import ElasticContact, Scene
from tactape_fab.sense.decode.result import Refined
from tests.bench.evidence.job import Job, Result, Size
from tests.bench.nees import Row, figures_of, tilted

SECTION = "simulators"
TITLE = "Two simulators, side by side"


def _strip(radius_mm: float) -> Scene:
    return Scene(contact="strip", cylinder_radius_mm=radius_mm)


def _pressed(**options: Any) -> Scene:
    return Scene(elastic=ElasticContact(**options))


SCENES: Mapping[str, tuple[Scene | None, Scene]] = {
    "default, 2 N": (Scene(), _pressed()),
    "tilt 2°, 2 N": (tilted(2.0), _pressed(tilt_deg=(2.0, 0.0))),
    "tilt 5°, 2 N": (tilted(5.0), _pressed(tilt_deg=(5.0, 0.0))),
    "tilt 2° along v, 2 N": (None, _pressed(tilt_deg=(0.0, -2.0))),
    "tilt 5° along v, 2 N": (None, _pressed(tilt_deg=(0.0, 5.0))),
    "cylinder of 30 mm, 2 N": (_strip(30.0), _pressed(cylinder_radius_mm=30.0)),
    "cylinder of 15.7 mm, 2 N": (_strip(15.7), _pressed(cylinder_radius_mm=15.7)),
    "flat, 0.5 N": (None, _pressed(force_n=0.5)),
    "flat, 10 N": (None, _pressed(force_n=10.0)),
    "flat, printed markers, 2 N": (None, _pressed(markers=True)),
    "flat, parts 0.03 mm off, 2 N": (Scene(placement_mm=0.03), Scene(elastic=ElasticContact(), placement_mm=0.03)),
}
"""The imprint model knows no force, no markers, and no tilt of the bodies: one along v would be the same again."""
MODELS = ("imprint", "elastic")


def jobs(size: Size) -> list[Job]:
    """Every scene in both."""
    return [
        Job(
            section=SECTION,
            name=f"{name}, {model}",
            measure=measure,
            options={"name": name, "model": model, "frames": size.frames},
        )
        for name, scenes in SCENES.items()
        for model, scene in zip(MODELS, scenes, strict=True)
        if scene is not None
    ]


def measure(name: str, model: str, frames: int, refine: Refined = "dots") -> Result:
    """Figures of one scene in one simulator."""
    scene = SCENES[name][MODELS.index(model)]
    assert scene is not None
    return asdict(figures_of(Row(name=model, scene=scene), frames, refine)) | {"crown": model == "elastic"}


def lines(results: Mapping[str, Result]) -> list[str]:
    """The section of the page."""
    crown = any(one.get("crown") for one in results.values())
    out = [
        f"## {TITLE}",
        "",
        "Our own scene, an imprint that is smoothed, and an elastic layer bonded to the sensor and pressed on the tape by a",
        "contact solver without friction (`simulate --contact-model elastic`), both with the slope noise of a real GelSight",
        f"Mini; the same decoder with the same profile, {CROWN if crown else NO_CROWN}. The second knows nothing",
        "of the first, nor of the decoder. In the first a tilt is a slope of the background alone. Flat contacts of the second",
        "may be below 0.8: neighbours push each other equally and oppositely. With parts as far off as real ones they are not.",
        "",
        *HEADER,
    ]
    return [*out, *(_row(name, results) for name in SCENES), ""]


CROWN, NO_CROWN = "but for the gel's crown, which the first has not", "without the gel's crown: tilts are not known"
HEADER = (
    "| | imprint: located | wrong | µm | ° | nees | elastic: located | wrong | µm | ° | nees |",
    "|---|---|---|---|---|---|---|---|---|---|---|",
)


def _row(name: str, results: Mapping[str, Result]) -> str:
    return f"| {name} | {' | '.join(_cells(results.get(f'{name}, {model}')) for model in MODELS)} |"


def _cells(one: Result | None) -> str:
    if one is None:
        return " | | | | "
    errors = f"{one['position_um']:.1f} | {one['theta_deg']:.3f} | {one['nees']:.2f}" if one["right"] else " | | "
    return f"{one['right']} of {one['frames']} | {one['wrong']} | {errors}"


def main() -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.evidence.simulators", description=__doc__)
    parser.add_argument("--frames", type=int, default=400, metavar="N", help="contacts a row, in each simulator")
    parser.add_argument("--only", metavar="SCENE", default="", help="scenes whose name holds this")
    parser.add_argument("--refine", choices=("dots", "pixels"), default="dots", help="what poses are fitted to")
    given = parser.parse_args()
    print(*HEADER, sep="\n")
    for name, scenes in SCENES.items():
        if given.only not in name:
            continue
        there = [model for model, scene in zip(MODELS, scenes, strict=True) if scene is not None]
        results = {f"{name}, {model}": measure(name, model, given.frames, given.refine) for model in there}
        print(_row(name, results), flush=True)


if __name__ == "__main__":
    main()
