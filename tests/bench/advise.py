"""Whether `advise` keeps what it promises: random designs, simulated at the very contact that it says for each.

python -m tests.bench.advise            measures docs/advise.json and makes the tables of choose.md from it (three minutes)
python -m tests.bench.advise --fit      measures other designs over many contacts and says which constants of the model fit
"""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np

from tactape_fab.advise.answer import LOCATED, Line, Simulated, seen_of, simulated
from tactape_fab.advise.designs import Design, judged
from tactape_fab.advise.model import CODES, LOSS, Loss, Seen, accuracy, least_contact_mm, signal_of
from tactape_fab.advise.question import Question, read_question
from tactape_fab.kit.examine.tape import profiles_of
from tactape_fab.sense import SensorProfile
from tests.bench.evidence.record import about
from tests.bench.marks import all_replaced, measured_line, stamp

DOCS = Path(__file__).parents[2] / "docs"
FIGURES, PAGE = DOCS / "advise.json", DOCS / "choose.md"
DESIGNS, FRAMES, SEED = 28, 100, 31
OF_EIGHT, SEED_OF_EIGHT = 10, 32
"""As many designs of eight directions, printed ones."""
FIT_DESIGNS, FIT_FRAMES, FIT_SEED, STEP_MM = 24, 40, 5, 0.5
SLACK = 0.05
"""A promise is kept where no more than this is missing from it."""
LEAST_PITCH_MM = {
    ("r0201", (0.6, 0.3, 0.23)): 1.28,
    ("r01005", (0.4, 0.2, 0.13)): 0.83,
    ("block", (0.6, 0.3, 0.23)): 0.97,
    ("block", (0.4, 0.2, 0.18)): 0.75,
    ("dome", (0.6, 0.6, 0.23)): 1.1,
    ("dome", (0.4, 0.4, 0.18)): 0.85,
}
LEAST_PITCH_OF_EIGHT_MM = {
    ("block", (0.6, 0.3, 0.23)): 1.06,
    ("block", (0.4, 0.3, 0.2)): 0.9,
    ("dome", (0.6, 0.6, 0.23)): 1.1,
    ("dome", (0.4, 0.4, 0.18)): 0.85,
}
VARIANTS = {
    "0201, W 1.5, Δ 0.25": ("r0201", (0.6, 0.3, 0.23), 1.5, 0.25, 7.0, 4),
    "0201, W 1.39, Δ 0.20": ("r0201", (0.6, 0.3, 0.23), 1.39, 0.20, 6.6, 4),
    "0201, W 1.28, Δ 0.20": ("r0201", (0.6, 0.3, 0.23), 1.28, 0.20, 6.0, 4),
    "0402, W 1.77, Δ 0.21": ("r0402", (1.0, 0.5, 0.35), 1.77, 0.21, None, 4),
    "0402, W 2.2, Δ 0.3": ("r0402", (1.0, 0.5, 0.35), 2.2, 0.3, None, 4),
    "block, W 0.96, Δ 0.16": ("block", (0.6, 0.3, 0.23), 0.96, 0.16, 4.6, 4),
    "dome of 0.4 mm, W 0.9, Δ 0.15": ("dome", (0.4, 0.4, 0.18), 0.9, 0.15, 4.4, 4),
    "01005, W 0.9, Δ 0.15": ("r01005", (0.4, 0.2, 0.13), 0.9, 0.15, None, 4),
    "01005, W 0.83, Δ 0.14": ("r01005", (0.4, 0.2, 0.13), 0.83, 0.14, 4.1, 4),
    "block, W 1.06, Δ 0.1767": ("block", (0.6, 0.3, 0.23), 1.06, 0.1767, None, 4),
    "block, W 1.06, Δ 0.1767, 8 directions": ("block", (0.6, 0.3, 0.23), 1.06, 0.1767, 4.5, 8),
    "block, W 1.5, Δ 0.25": ("block", (0.6, 0.3, 0.23), 1.5, 0.25, None, 4),
    "block, W 1.5, Δ 0.25, 8 directions": ("block", (0.6, 0.3, 0.23), 1.5, 0.25, 6.1, 8),
}
"""Denser tapes: part, body, W, Δ, the contact that a model of hard symbols had said, mm (None: not asked), directions."""
VARIANT_STEP_MM, VARIANT_FRAMES = 0.25, 200


def drawn(seed: int, count: int, directions: int = 4) -> Iterator[tuple[Design, Question]]:
    """Random designs that are legal, and what they are asked for."""
    rng = np.random.default_rng(seed)
    least_mm = LEAST_PITCH_MM if directions == 4 else LEAST_PITCH_OF_EIGHT_MM
    kinds, given = list(least_mm), 0
    while given < count:
        part, body_mm = kinds[int(rng.integers(len(kinds)))]
        pitch_mm = round(least_mm[part, body_mm] * float(rng.uniform(1.0, 1.35)), 2)
        displacement_mm = round(pitch_mm * float(rng.uniform(0.13, 0.19)), 2)
        blur_mm, placement_mm = round(float(rng.uniform(0.10, 0.25)), 2), round(float(rng.uniform(0.0, 0.05)), 3)
        tapes, sensor = int(rng.choice([1, 4, 16])), str(rng.choice(["gelsight-mini", "digit"]))
        tapes = tapes if directions == 4 else 1  # each would be designed for some seconds
        if (design := judged(design_of(part, body_mm, pitch_mm, displacement_mm, directions))) is not None:
            given += 1
            yield design, asked(sensor, blur_mm, placement_mm, tapes, part)


def design_of(
    part: str, body_mm: tuple[float, float, float], pitch_mm: float, displacement_mm: float, directions: int = 4
) -> Design:
    film = part.startswith("r")
    return Design(
        part=part,
        shape="dome" if part == "dome" else "block",
        body_mm=body_mm,
        pitch_mm=pitch_mm,
        displacement_mm=displacement_mm,
        coverlay="gang" if film else None,
        fab="generic-fpc" if film else None,
        process=None if film else "sla",
        directions=directions,
    )


def asked(sensor: str, blur_mm: float, placement_mm: float, tapes: int, part: str) -> Question:
    process = "fpc" if part.startswith("r") else "sla"
    values = {"sensor": sensor, "blur_mm": blur_mm, "placement_mm": placement_mm, "tapes": tapes, "process": process}
    return read_question({"contact_mm": 6.0, **values})


def _field_mm(sensor: SensorProfile) -> float:
    """The shorter side of what a sensor sees."""
    return min(sensor.width_px / sensor.px_per_mm[0], sensor.height_px / sensor.px_per_mm[1])


def line_of(design: Design, question: Question) -> Line:
    """What is promised of a design."""
    spec = design.spec(question.size_mm)
    points = profiles_of(spec).plan(spec).part_count
    seen, field_mm = seen_of(design, question, points), _field_mm(question.sensor)
    code = CODES[0] if design.directions == 4 else CODES[-1]
    promised_mm = least_contact_mm(seen, code, LOSS, LOCATED, field_mm)
    error_mm, angle_deg = accuracy(seen, promised_mm or field_mm)
    signal = signal_of(seen)
    return Line(
        design=design,
        code=code,
        least_mm=promised_mm,
        error_um=1000.0 * error_mm,
        angle_deg=angle_deg,
        parts=points,
        once=None,
        each=None,
        height_um=signal.height_um,
        noise_um=signal.noise_um,
        command="",
    )


def promises(of: Collection[int] = range(DESIGNS + OF_EIGHT), frames: int = FRAMES) -> list[dict[str, Any]]:
    """Rows, of all designs or of those with these numbers: a design, what is promised of it, and what was simulated there."""
    rows = []
    for number, (design, question) in enumerate(chain(drawn(SEED, DESIGNS), drawn(SEED_OF_EIGHT, OF_EIGHT, 8))):
        if number not in of:
            continue
        line = line_of(design, question)
        sim = None if line.least_mm is None else simulated(line, question, frames)
        rows.append({**_described(design, question), "promise": _promise(line), "simulated": _said(sim)})
        print(rows[-1], file=sys.stderr)
    return rows


def _described(design: Design, question: Question) -> dict[str, Any]:
    return {
        "part": design.part,
        "body_mm": list(design.body_mm),
        "pitch_mm": design.pitch_mm,
        "displacement_mm": design.displacement_mm,
        "directions": design.directions,
        "blur_mm": question.blur_mm,
        "placement_mm": question.placement_mm,
        "tapes": question.tapes,
        "sensor": question.sensor.name,
    }


def _promise(line: Line) -> dict[str, Any]:
    mapping = line.to_mapping()
    return {"contact_mm": mapping["least_contact_mm"], "error_um": mapping["error_um"], "angle_deg": mapping["angle_deg"]}


def _said(sim: Simulated | None) -> dict[str, Any] | None:
    if sim is None:
        return None
    return {"located": sim.located, "frames": sim.frames, "error_um": sim.error_um, "angle_deg": sim.angle_deg}


def kept(row: Any) -> bool:
    """Whether a promise is kept; one that is not made is."""
    sim = row["simulated"]
    return sim is None or sim["located"] / sim["frames"] >= LOCATED - SLACK


def variants(frames: int = VARIANT_FRAMES) -> list[dict[str, Any]]:
    """Rows: a denser tape, the smallest contact of which 9 in 10 are located in simulation, and what is promised."""
    rows = []
    for name, (part, body_mm, pitch_mm, displacement_mm, before_mm, directions) in VARIANTS.items():
        design = design_of(part, body_mm, pitch_mm, displacement_mm, directions)
        question = asked("gelsight-mini", 0.15, 0.0, 1, part)
        line = line_of(design, question)
        assert line.least_mm is not None
        size_mm = np.floor(line.least_mm / VARIANT_STEP_MM) * VARIANT_STEP_MM
        rates: dict[float, float] = {}
        while _rate(rates, line, question, float(size_mm), frames) >= LOCATED:
            size_mm -= VARIANT_STEP_MM
        while _rate(rates, line, question, float(size_mm), frames) < LOCATED:
            size_mm += VARIANT_STEP_MM
        rows.append({"name": name, "before_mm": before_mm, "simulated_mm": float(size_mm), "promised_mm": line.least_mm})
        print(rows[-1], rates, file=sys.stderr)
    return rows


def _rate(rates: dict[float, float], line: Line, question: Question, size_mm: float, frames: int) -> float:
    if size_mm not in rates:
        rates[size_mm] = simulated(replace(line, least_mm=size_mm), question, frames).located / frames
    return rates[size_mm]


def fit() -> None:
    """The constants of the model that are nearest to simulated contacts, those that promise too much weighing most."""
    found = []
    for design, question in drawn(FIT_SEED, FIT_DESIGNS):
        line = line_of(design, question)
        rates: dict[float, float] = {}
        size_mm = max(3.0, round(3.6 * design.pitch_mm / STEP_MM) * STEP_MM)
        while size_mm < 12.0 and max(rates.values(), default=0.0) < LOCATED:
            rates[size_mm] = simulated(replace(line, least_mm=size_mm), question, FIT_FRAMES).located / FIT_FRAMES
            size_mm += STEP_MM
        print(_described(design, question), rates, file=sys.stderr)
        if len(rates) > 1 and max(rates.values()) >= LOCATED:
            sizes, shares = list(rates), list(rates.values())
            true_mm = float(np.interp(LOCATED, np.maximum.accumulate(shares[-2:]), sizes[-2:]))
            found.append((seen_of(design, question, line.parts), true_mm))
    tried = product((0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08), (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0))
    fits = sorted((_misfit(found, replace(LOSS, tops=tops, scatter=scatter)), tops, scatter) for tops, scatter in tried)
    for misfit, tops, scatter in fits[:5]:
        print(f"tops = {tops}, scatter = {scatter}: off by {misfit:.3f} (rms of ln, too small ones three times)")


def _misfit(found: list[tuple[Seen, float]], loss: Loss) -> float:
    off = []
    for seen, true_mm in found:
        least_mm = least_contact_mm(seen, CODES[0], loss, LOCATED, _field_mm(seen.sensor))
        if least_mm is not None:  # nothing promised
            ln = np.log(least_mm / true_mm)
            off.append(ln * (3.0 if ln < 0.0 else 1.0))
    return float(np.sqrt(np.mean(np.square(off))))


# The page


def promise_table(rows: list[dict[str, Any]]) -> str:
    out = [
        "| part | W, Δ | blur, placement | tapes | sensor | promised | located there | error, promised | angle, promised |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        sim, promise = row["simulated"], row["promise"]
        body = "" if row["part"].startswith("r") else " " + "x".join(f"{side:g}" for side in row["body_mm"])
        body += ", 8 directions" if row.get("directions") == 8 else ""
        where = "nothing" if promise["contact_mm"] is None else f"{promise['contact_mm']:g} mm"
        said = "-" if sim is None else f"{100 * sim['located'] / sim['frames']:.0f} %"
        error = "-" if sim is None else f"{sim['error_um']:.0f} µm, {promise['error_um']:.0f} µm"
        angle = "-" if sim is None else f"{sim['angle_deg']:.2f}°, {promise['angle_deg']:.2f}°"
        out.append(
            f"| `{row['part']}`{body} | {row['pitch_mm']:g}, {row['displacement_mm']:g} | {row['blur_mm']:g}, "
            f"{row['placement_mm']:g} | {row['tapes']} | `{row['sensor']}` | {where} | {said} | {error} | {angle} |"
        )
    return "\n".join(out) + "\n"


def variant_table(rows: list[dict[str, Any]]) -> str:
    out = ["| tape | simulated | `advise` | hard symbols |", "|---|---|---|---|"]
    for row in rows:
        before = "-" if row["before_mm"] is None else f"{row['before_mm']:g} mm"
        out.append(f"| {row['name']} | {row['simulated_mm']:g} mm | {row['promised_mm']:g} mm | {before} |")
    return "\n".join(out) + "\n"


TABLES = {"promises": promise_table, "variants": variant_table}


def made_anew(text: str, content: Mapping[str, Any]) -> str:
    """The page's text with its tables as the figures have them."""
    line = measured_line([content["about"]])
    return all_replaced(text, {name: table(content[name]) + line for name, table in TABLES.items()})


def main() -> None:
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--fit", action="store_true")
    if parser.parse_args().fit:
        fit()
        return
    content = {"about": {**about(), **stamp(), "seed": SEED}, "promises": promises(), "variants": variants()}
    FIGURES.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(made_anew(PAGE.read_text(encoding="utf-8"), content), encoding="utf-8")
    good = sum(kept(row) for row in content["promises"])
    print(f"{good} of {len(content['promises'])} promises kept")


if __name__ == "__main__":
    main()
