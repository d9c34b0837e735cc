"""The touch code beside microdots-4x4, on the same contacts, and on what is no tape of ours: `python -m tests.bench.touch`.

Figures go to docs/touch.json row by row; rows that are there with as many frames are not measured again. `docs/make_touch.py`
makes the tables of docs/touch-code.md of it. Designs of 16 tapes, each beside those before, take some minutes of their own:
`--designs FILE` keeps them.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path
from time import process_time
from typing import Any
from zlib import crc32

import numpy as np

from tactape_fab import Localizer, Tape
from tactape_fab.sense import Scene, iterate_frames
from tactape_fab.sense.decode.settings import World
from tactape_fab.texture.code import TOUCH_CODE
from tactape_fab.texture.frames import SymbolArray
from tactape_fab.texture.touch.design import design
from tactape_fab.texture.touch.patches import PATCHES, patch_distances, patch_shapes
from tactape_fab.texture.touch.words import words_of
from tactape_fab.texture.windows import bit_count
from tests.bench.dot_records import recorded
from tests.bench.evidence.record import about
from tests.bench.false_tally import Tally, upper_bound
from tests.bench.impostors import Surface, other_surface
from tests.bench.localization_false import IMPOSTORS, MIRRORED, PART, SCENES, Job, _poses
from tests.bench.localization_measure import WORLDS, is_right
from tests.bench.localization_rows import SECTOR, SEED, registered_tape, tape_of
from tests.bench.marks import stamp
from tests.bench.recorded import draw_dots

FIGURES = Path(__file__).parents[2] / "docs" / "touch.json"
CONTACTS_MM = (5.0, 5.5, 6.0, 6.5, 7.0, 8.0, 9.0)
MISSING = (0.1, 0.2, 0.3)
REGISTRIES = (1, 16)
MAX_P_TAPE = 1e-2
Row = tuple[float, float, int, float | None]
ROWS: tuple[Row, ...] = (
    *((size, 0.0, tapes, None) for tapes in REGISTRIES for size in CONTACTS_MM),
    *((size, missing, tapes, None) for tapes in REGISTRIES for size in (7.0, 9.0) for missing in MISSING),
    *((size, 0.0, tapes, MAX_P_TAPE) for tapes in REGISTRIES for size in CONTACTS_MM[:5]),
)
"""Contact (mm), share of missing parts, registered tapes, largest p_tape where it has a limit of its own."""
PLANE_SECTORS = (7, 8, 24, 100, 246)
EIGHT = "eight"
"""Subjects of that name and a sector are other touch tapes of eight directions."""
EIGHT_SUBJECTS = ("microdots-4x4 8", "microdots-4x4 100", "touch-1 7", "eight 1", "eight 2")
SECTORS = (SECTOR, *(sector for sector in range(16) if sector != SECTOR))


@cache
def _matrix(k: int, path: Path | None) -> SymbolArray:
    """The matrix of a sector of `SECTORS`, designed beside those before it, or as the file has it."""
    if path is not None and path.exists():
        with np.load(path) as file:
            if k < len(file.files):
                return np.asarray(file[file.files[k]])
    like = registered_tape()
    return design(SECTORS[k], (like.rows, like.columns), [_matrix(i, path) for i in range(k)])


def _matrices(path: Path | None) -> list[SymbolArray]:
    """All of them, kept in the file."""
    found = [_matrix(k, path) for k in range(len(SECTORS))]
    if path is not None:
        np.savez(path, *found)
    return found


def touch_tapes(count: int, path: Path | None) -> list[Tape]:
    """Touch tapes on the grid of the benchmark's own tape."""
    like = registered_tape()
    return [
        replace(like, name=f"touch-{s}", code=TOUCH_CODE, sector=s, origin=(0, 0), symbols=_matrix(k, path), tag=None)
        for k, s in enumerate(SECTORS[:count])
    ]


@cache
def eight_tape(sector: int = SECTOR) -> Tape:
    """A touch tape of eight directions on the same grid."""
    like = registered_tape()
    symbols = design(sector, (like.rows, like.columns), directions=8)
    names = {"name": f"eight-{sector}", "code": TOUCH_CODE, "sector": sector, "origin": (0, 0)}
    return replace(like, **names, symbols=symbols, directions=8, tag=None)  # type: ignore[arg-type]


def plane_tapes(count: int) -> list[Tape]:
    return [registered_tape(), *(tape_of(sector) for sector in SECTORS[1:count])]


def side_by_side(row: Row, frames: int, path: Path | None) -> dict[str, Any]:
    """Frames of one row located right, and wrong, by code and world; poses, losses and noise are the same for both codes."""
    size_mm, missing, tapes, max_p_tape = row
    scene = Scene(contact_mm=(size_mm, size_mm), missing=missing)
    found: dict[str, Any] = {"contact_mm": size_mm, "missing": missing, "tapes": tapes}
    found |= {"max_p_tape": max_p_tape, "frames": frames}
    for code, registered in (("microdots-4x4", plane_tapes(tapes)), (TOUCH_CODE, touch_tapes(tapes, path))):
        localizers = {world: Localizer(registered, world=world, max_p_tape=max_p_tape) for world in WORLDS}
        counts = {world: {"right": 0, "wrong": 0} for world in WORLDS}
        spent = dict.fromkeys(WORLDS, 0.0)
        for frame in iterate_frames(registered[0], frames, SEED + 17, scene=scene):
            for world, localizer in localizers.items():
                start = process_time()
                fix = localizer.locate(frame.depth)
                spent[world] += process_time() - start
                if fix.located:
                    counts[world]["right" if is_right(fix, frame, registered[0]) else "wrong"] += 1
        found[code] = {world: {**counts[world], "ms": round(1000 * spent[world] / frames, 3)} for world in WORLDS}
    return found


def foreign(subject: str, world: World, frames: int, path: Path | None, *, eight: bool = False) -> dict[str, Any]:
    """How often what is not the registered touch tape is located, as dots that the detector makes of such contacts."""
    own = [eight_tape()] if eight else touch_tapes(1, path)
    localizer, tally, k = Localizer(own, world=world), Tally(), 0
    while k < frames:
        for contact, dots in _part_of(subject, k // PART, own[0], path):
            if k == frames:
                break
            tally.add(f"{subject}, frame {k}", contact, localizer.locate_dots(dots.xy_px, dots.weights))
            k += 1
    by = {"accepted": tally.accepted, "below": upper_bound(tally.located, tally.frames), "least_p_false": tally.least["p_false"]}
    return {"subject": subject, "world": world, "frames": frames, "located": tally.located, **by}


def _part_of(subject: str, part: int, own: Tape, path: Path | None) -> Iterator[tuple[str, Any]]:
    tape = _touched(subject, own, path)
    drawn = []
    for contact, (scene, edge) in SCENES.items():
        rng = np.random.default_rng([SEED, crc32(f"{subject}, {contact}".encode()), part])
        poses = _poses(tape, Job(kind="", subject=subject, level="dots"), contact, rng)
        make = IMPOSTORS.get(subject)
        parts = None if make is None else make(tape, int(rng.integers(2**62)))
        mirrored = subject == MIRRORED
        drawn.append((contact, draw_dots(tape, poses, recorded(scene, edge), rng, parts=parts, mirrored=mirrored)))
    for k in range(PART):
        contact, dots = drawn[k % len(drawn)]
        yield contact, dots[k // len(drawn)]


def _touched(subject: str, own: Tape, path: Path | None) -> Tape:
    kind, _, number = subject.partition(" ")
    if kind == EIGHT:
        return eight_tape(int(number))
    if kind == TOUCH_CODE:
        place = SECTORS.index(int(number))
        return touch_tapes(place + 1, path)[place]
    return tape_of(int(number)) if kind == "microdots-4x4" else own


def foreign_surface(kind: Surface, frames: int) -> dict[str, Any]:
    """How often a surface without parts is located as the tape of eight directions, as depth maps."""
    localizer, located = Localizer([eight_tape()]), 0
    for seed in range(frames):
        located += localizer.locate(other_surface(kind, seed=seed)).located
    return {"subject": f"surface: {kind}", "world": "open", "frames": frames, "located": located}


def registry_distances(path: Path | None) -> dict[str, Any]:
    """Fewest bits between patches of two of the 16 tapes, and of the touch tapes each alone, by shape."""
    matrices, shapes = _matrices(path), patch_shapes()
    words = [words_of(symbols, shapes) for symbols in matrices]
    across: dict[str, int] = {}
    for k, name in enumerate(PATCHES):
        least = 99
        for (one, count), (other, other_count) in combinations(words, 2):
            every = other[k, :, : other_count[k]].ravel()
            for word in one[k, 0, : count[k]]:
                least = min(least, int(bit_count(every ^ word).min()))
        across[name] = least
    whole = np.ones(matrices[0].shape, dtype=bool)
    alone = [{d.shape: d.bits for d in patch_distances(symbols, whole)} for symbols in matrices]
    return {"tapes": len(matrices), "across": across, "alone": {n: min(a[n] or 0 for a in alone) for n in PATCHES}}


def speeds(path: Path | None) -> dict[str, Any]:
    """Milliseconds of processor time that one frame of an 11x9 contact takes, by code and number of tapes: least of many."""
    found: dict[str, Any] = {}
    random = np.random.default_rng(0)
    many = [replace(t, name=f"touch-{k}", sector=k, symbols=random.integers(0, 4, t.symbols.shape).astype(np.uint8), tag=None)
            for k, t in enumerate(touch_tapes(1, path) * 63, start=100)]  # fmt: skip
    for name, tapes in (
        ("microdots-4x4, 1", plane_tapes(1)),
        ("touch-1, 1", touch_tapes(1, path)),
        ("touch-1, 64", [*touch_tapes(1, path), *many]),
        ("touch-1 of 8 directions, 1", [eight_tape()]),
    ):
        localizer = Localizer(tapes)
        depths = [frame.depth for frame in iterate_frames(tapes[0], 20, SEED, scene=Scene())]
        least = [1e9] * len(depths)
        for _ in range(12):
            for k, depth in enumerate(depths):
                start = process_time()
                localizer.locate(depth)
                least[k] = min(least[k], 1000 * (process_time() - start))
        found[name] = round(float(np.median(least)), 3)
    return found


def _keep(content: dict[str, Any], section: str, key: str, value: Mapping[str, Any]) -> None:
    content.setdefault(section, {})[key] = dict(value)
    content.setdefault("measured", {}).setdefault(section, {})[key] = stamp()
    FIGURES.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print(section, key, json.dumps(value), file=sys.stderr, flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.touch", description=__doc__)
    parser.add_argument("--frames", type=int, default=1000, metavar="N", help="contacts a row")
    parser.add_argument("--foreign", type=int, default=4000, metavar="N", help="contacts of each that must not be located")
    parser.add_argument("--only", choices=("rows", "foreign", "foreign_eight", "registry", "speed"), help="this part alone")
    parser.add_argument("--designs", type=Path, metavar="FILE.npz")
    chosen = parser.parse_args(arguments)
    content = json.loads(FIGURES.read_text(encoding="utf-8")) if FIGURES.exists() else {}
    content["about"] = {k: v for k, v in about().items() if k != "sources"}

    def wanted(section: str, key: str, frames: int) -> bool:
        done = content.get(section, {}).get(key, {"frames": 0})["frames"] >= frames
        return chosen.only in (None, section) and not done

    for row in ROWS:
        key = f"{row[0]:g} mm, {100 * row[1]:g} % missing, {row[2]} tapes" + ("" if row[3] is None else ", max-p-tape")
        if wanted("rows", key, chosen.frames):
            _keep(content, "rows", key, side_by_side(row, chosen.frames, chosen.designs))
    subjects = [*IMPOSTORS, MIRRORED, *(f"microdots-4x4 {s}" for s in PLANE_SECTORS), *(f"touch-1 {s}" for s in SECTORS[1:])]
    for world in WORLDS:
        for subject in subjects:
            if wanted("foreign", f"{subject}, {world}", chosen.foreign):
                _keep(content, "foreign", f"{subject}, {world}", foreign(subject, world, chosen.foreign, chosen.designs))
    for world in WORLDS:
        for subject in (*IMPOSTORS, MIRRORED, *EIGHT_SUBJECTS):
            if wanted("foreign_eight", f"{subject}, {world}", chosen.foreign):
                _keep(
                    content,
                    "foreign_eight",
                    f"{subject}, {world}",
                    foreign(subject, world, chosen.foreign, chosen.designs, eight=True),
                )
    kinds: tuple[Surface, ...] = ("blank", "ball", "ridges")
    for kind in kinds:
        if wanted("foreign_eight", f"surface: {kind}, open", chosen.foreign):
            _keep(content, "foreign_eight", f"surface: {kind}, open", foreign_surface(kind, chosen.foreign))
    if chosen.only in (None, "registry"):
        _keep(content, "registry", "16 tapes", registry_distances(chosen.designs))
    if chosen.only in (None, "speed"):
        _keep(content, "speed", "11x9 mm", speeds(chosen.designs))


if __name__ == "__main__":
    main()
