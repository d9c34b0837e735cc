"""One scan: which tapes it shows, and where; or why it shows none of the wanted ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown_path
from tactape_fab.base.libraries import library
from tactape_fab.sense.inspect.blobs import Blobs, find_blobs
from tactape_fab.sense.inspect.locate import LEAST_AGREEING, SeenTag, find_tags, grow, read_code, warp_of_tag, within
from tactape_fab.sense.inspect.scan_files import MM_PER_INCH, Picture, read_scan
from tactape_fab.sense.inspect.wanted import WantedTape
from tactape_fab.sense.inspect.warp import Warp, affine_warp
from tactape_fab.texture.frames import BoolArray, FloatArray

LEAST_PX_PER_MM = 22.0
"""560 dpi: the body of an 0201 is then 7 px wide."""
_MOST_PX_PER_MM = 110.0
_SHRUNK_PX_PER_MM = 80.0
_LEAST_SPREAD = 3.0
MOST_BLOCKS = 2.25
"""Steepness at the borders of 8 x 8 blocks over that elsewhere: 1.0 without JPEG, 1.7 at quality 75, 2.1 at 30, 2.4 at 20."""
_SAME_PANEL_MM = 5.0
_MOST_SPREAD = 0.25
"""Most that a tag's size may be off what the nominal resolution says, for this to be believed: an image that was made smaller or
larger since is off by more."""

FoundBy = Literal["tag", "code", "neighbour"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A tape in a scan.

    number: Of the tape among those that are wanted.
    name: Of the scan's file.
    picture (h, w, 3): Each pixel the mean of `factor` by `factor` of the scan.
    inside (n,): Parts that the scan shows whole.
    dpi: Nominal, of the scan.
    found_by {"tag", "code", "neighbour"}
    """

    number: int
    name: str
    picture: Picture
    warp: Warp
    inside: BoolArray
    dpi: float | None
    found_by: FoundBy
    factor: int = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seed:
    """A tape and a warp that holds near a point of it."""

    number: int
    warp: Warp
    near_mm: FloatArray
    found_by: FoundBy


def views_of(path: str | Path, wanted: Sequence[WantedTape], dpi: float | None) -> list[View]:
    """Every wanted tape that a scan shows. Raises SpecError if the file is no scan, or shows none of them, with the reason."""
    picture, header = read_scan(path)
    name = shown_path(Path(path).name)
    try:
        return _views(picture, name, wanted, dpi or header.dpi)
    except SpecError as error:
        raise SpecError([Problem(p.key or "scan", f"{shown_path(path)}: {p.message}") for p in error.problems]) from None


def _views(picture: Picture, name: str, wanted: Sequence[WantedTape], dpi: float | None) -> list[View]:
    # a forty-ninth of the pixels is enough to see that there is nothing
    if float(picture[::7, ::7].std(axis=(0, 1)).max()) < _LEAST_SPREAD:
        raise SpecError("it is empty: all of one colour; scan the tape with its parts toward the glass")
    blocks = blockiness(picture)
    if blocks > MOST_BLOCKS:
        raise SpecError(f"it is full of JPEG blocks, {blocks:.1f} times as steep as what is between; scan to TIFF or PNG")
    tags = find_tags(picture)
    seeds = _tag_seeds(tags, wanted)
    px_per_mm = seeds[0].warp.px_per_mm if seeds else None if dpi is None else dpi / MM_PER_INCH
    if px_per_mm is not None and px_per_mm < LEAST_PX_PER_MM:
        least = LEAST_PX_PER_MM * MM_PER_INCH
        raise SpecError(f"it has {px_per_mm * MM_PER_INCH:.0f} dpi, fewer than {least:.0f}; scan at 600 dpi or more")
    factor = 1
    if px_per_mm is not None and px_per_mm > _MOST_PX_PER_MM:
        factor = int(px_per_mm / _SHRUNK_PX_PER_MM)
        picture = _shrunk(picture, factor)
        tags = find_tags(picture)
        px_per_mm /= factor
        seeds = _tag_seeds(tags, wanted)
    if px_per_mm is None:
        raise _nothing_found(picture, tags, wanted, None, None)
    blobs = find_blobs(picture, px_per_mm, wanted[0].tape.part.body_mm[0])
    if not seeds:
        seeds = _code_seeds(blobs, px_per_mm, wanted)
    views, agreeing = _grown(picture, name, wanted, seeds, blobs, dpi)
    if not views and seeds and seeds[0].found_by == "tag":
        # ink that spreads makes a tag a tenth smaller than drawn: with the nominal scale the parts are read
        nominal = px_per_mm if dpi is None else dpi / MM_PER_INCH / factor
        scale = nominal if abs(nominal / px_per_mm - 1.0) <= _MOST_SPREAD else px_per_mm
        views, _ = _grown(picture, name, wanted, _code_seeds(blobs, scale, wanted), blobs, dpi)
    if not views:
        raise _nothing_found(picture, tags, wanted, px_per_mm, agreeing)
    _refuse_second_copy(views, blobs, wanted)
    return [replace(view, factor=factor) for view in views]


def _refuse_second_copy(views: Sequence[View], blobs: Blobs, wanted: Sequence[WantedTape]) -> None:
    """Refuse a scan of which parts beside a tape are read as that tape again: a copy whose tag is not seen, or that has none."""
    if any(w.offset_mm is not None for w in wanted):
        return
    for view in views:
        tape = wanted[view.number].tape
        parts = view.warp.smooth(tape.part_xy_mm())
        beside = cKDTree(parts).query(blobs.px)[0] > tape.pitch_mm * view.warp.px_per_mm
        if _code_seeds(Blobs(px=blobs.px[beside]), view.warp.px_per_mm, [wanted[view.number]]):
            message = f"parts beside {tape.name} are those of {tape.name} again: two copies of the tape"
            raise SpecError(f"{message}; scan each by itself, or cut it out")


def blockiness(picture: Picture) -> float:
    """Bend of brightness at every eighth pixel over that at the others, the larger of both axes; 1 in a picture without JPEG."""
    worst = 1.0
    h, w = picture.shape[:2]
    green = picture[max(0, h // 2 - 1000) : h // 2 + 1000, max(0, w // 2 - 1000) : w // 2 + 1000, 1].astype(np.float32)
    for grey in (green, green.T):
        # second differences: a slope has none, a step at the border of two blocks has
        bend = np.abs(np.diff(grey, 2, axis=1)).mean(axis=0)
        if len(bend) < 16:
            continue
        # which of the eight phases has the borders depends on how the picture was cut
        phases = bend[: len(bend) // 8 * 8].reshape(-1, 8).mean(axis=0)
        worst = max(worst, float((phases / np.maximum((phases.sum() - phases) / 7, 1e-6)).max()))
    return worst


def _shrunk(picture: Picture, factor: int) -> Picture:
    cv2 = library("cv2", "inspecting a scan")
    height, width = (n // factor * factor for n in picture.shape[:2])
    return np.asarray(
        cv2.resize(picture[:height, :width], (width // factor, height // factor), interpolation=cv2.INTER_AREA), dtype=np.uint8
    )


def _tag_seeds(tags: Sequence[SeenTag], wanted: Sequence[WantedTape]) -> list[_Seed]:
    """A seed for every tape whose tag is seen. Where tags repeat, as on a panel, those that agree on where the panel lies."""
    seeds = [
        _Seed(number=i, warp=warp_of_tag(entry.tape, tag), near_mm=np.array(entry.tape.tag.center_mm), found_by="tag")
        for i, entry in enumerate(wanted)
        if entry.tape.tag is not None
        for tag in tags
        if tag.number == entry.tape.tag.id
    ]
    if len({s.number for s in seeds}) == len(seeds):
        return seeds
    if any(w.offset_mm is None for w in wanted):
        twice = next(s.number for k, s in enumerate(seeds) if s.number in {other.number for other in seeds[:k]})
        raise SpecError(
            f"it shows the tag of {wanted[twice].tape.name} {sum(s.number == twice for s in seeds)} times: several copies of the "
            "tape; scan each by itself, or cut it out"
        )
    # the panel's corner on each tape's board, and where each seed has it, mm of the picture: tags of one panel agree on it
    corners = [-np.asarray(wanted[s.number].offset_mm) @ wanted[s.number].turn for s in seeds]
    origins = np.array([s.warp.smooth(corner[None])[0] / s.warp.px_per_mm for s, corner in zip(seeds, corners, strict=True)])
    near = np.hypot(*(origins[:, None] - origins[None]).transpose(2, 0, 1)) < _SAME_PANEL_MM
    best = int(near.sum(axis=1).argmax())
    return list({s.number: s for s, same in zip(seeds, near[best], strict=True) if same}.values())


def _code_seeds(blobs: Blobs, px_per_mm: float, wanted: Sequence[WantedTape]) -> list[_Seed]:
    """A seed from the parts themselves: tapes of one pitch, displacement and number of directions are searched together."""
    groups: dict[tuple[float, float, int], list[int]] = {}
    for i, entry in enumerate(wanted):
        groups.setdefault((entry.tape.pitch_mm, entry.tape.displacement_mm, entry.tape.directions), []).append(i)
    for members in groups.values():
        found = read_code(blobs, px_per_mm, [wanted[i].tape for i in members])
        if found is not None and found.tape is not None and found.warp is not None:
            number = next(i for i in members if wanted[i].tape is found.tape)
            return [_Seed(number=number, warp=found.warp, near_mm=found.near_mm, found_by="code")]
    return []


def _grown(
    picture: Picture, name: str, wanted: Sequence[WantedTape], seeds: Sequence[_Seed], blobs: Blobs, dpi: float | None
) -> tuple[list[View], float | None]:
    """Views of tapes with a seed and of their neighbours on the panel; also the best share of agreeing parts if refused."""
    views: dict[int, View] = {}
    best: float | None = None
    waiting = list(seeds)
    while waiting:
        seed = waiting.pop(0)
        if seed.number in views:
            continue
        tape = wanted[seed.number].tape
        grown = grow(seed.warp, seed.near_mm, tape, blobs, picture.shape[:2])
        if grown is None or grown.agreeing < LEAST_AGREEING:
            best = max(best or 0.0, grown.agreeing) if grown is not None else best
            continue
        rim = 0.8 * tape.part.body_mm[0] * grown.warp.px_per_mm
        inside = within(grown.warp.smooth(tape.part_xy_mm()), picture.shape[:2], rim)
        if inside.sum() < 40:
            continue
        views[seed.number] = View(
            number=seed.number, name=name, picture=picture, warp=grown.warp, inside=inside, dpi=dpi, found_by=seed.found_by
        )
        waiting += _neighbours(views[seed.number], wanted, views)
    return list(views.values()), best


def _neighbours(view: View, wanted: Sequence[WantedTape], known: dict[int, View]) -> list[_Seed]:
    """Seeds of the other tapes of a panel, where the warp of one says that they lie in the picture."""
    here = wanted[view.number]
    if here.offset_mm is None:
        return []
    seeds = []
    sites = here.tape.part_xy_mm()[view.inside]
    # powers of a polynomial run away outside their own tape: only the affine part is carried on
    straight = np.linalg.lstsq(np.column_stack([sites, np.ones(len(sites))]), view.warp.smooth(sites), rcond=None)[0]
    for i, entry in enumerate(wanted):
        if i in known or entry.offset_mm is None:
            continue
        # a board point q of the other tape is at apart + turn @ q on this one's board
        apart, turn = here.turn.T @ (entry.offset_mm - here.offset_mm), here.turn.T @ entry.turn
        size = np.asarray(entry.tape.board.size_mm)
        warp = affine_warp(straight[:2].T @ turn, straight[2] + apart @ straight[:2], size / 2, float(size.max() / 2))
        there = entry.tape.part_xy_mm()
        near = there[np.hypot(*(there @ turn.T + apart - sites.mean(axis=0)).T).argmin()]
        if within(warp.smooth(near[None]), view.picture.shape[:2]).all():
            seeds.append(_Seed(number=i, warp=warp, near_mm=near, found_by="neighbour"))
    return seeds


def _listed(values: Sequence[str]) -> str:
    """The first four values, each once."""
    different = [*dict.fromkeys(values)]
    return ", ".join(different[:4]) + (", ..." if len(different) > 4 else "")


def _nothing_found(
    picture: Picture, tags: Sequence[SeenTag], wanted: Sequence[WantedTape], px_per_mm: float | None, agreeing: float | None
) -> SpecError:
    """Why a scan shows none of the tapes: mirrored, another tape, too few parts, or no scale to read its code at."""
    names, sectors, ids = (
        _listed(values)
        for values in (
            [w.tape.name for w in wanted],
            [str(w.tape.sector) for w in wanted],
            [str(w.tape.tag.id) for w in wanted if w.tape.tag is not None],
        )
    )
    has, of = ("has tag", "is of sector") if len(wanted) == 1 else ("have tag", "are of sector")
    has, of = has + "s" * ("," in ids), of + "s" * ("," in sectors)
    flipped = np.ascontiguousarray(picture[:, ::-1])
    if not tags and find_tags(flipped):
        return SpecError("it is mirrored: its tag can be read in a mirror alone; scan the side with the parts, without mirroring")
    if tags and not any(w.tape.tag is not None and t.number == w.tape.tag.id for w in wanted for t in tags):
        seen = ", ".join(str(n) for n in sorted({t.number for t in tags}))
        return SpecError(f"it shows a tape with tag {seen}, and {names} {has} {ids or 'none'}: another tape; give its kit")
    if px_per_mm is None:
        return SpecError(
            "no tag of the family tag36h11 is in it, and it does not say its dpi; give dpi=N, to read its parts as a code"
        )
    blobs = find_blobs(picture, px_per_mm, wanted[0].tape.part.body_mm[0])
    other = read_code(blobs, px_per_mm, [wanted[0].tape], plane=True)
    if other is not None and other.sector is not None and other.sector not in {w.tape.sector for w in wanted}:
        return SpecError(f"its parts are those of sector {other.sector}, and {names} {of} {sectors}: another tape; give its kit")
    mirrored = replace(blobs, px=blobs.px * (-1.0, 1.0) + (picture.shape[1] - 1.0, 0.0))
    if _code_seeds(mirrored, px_per_mm, wanted):
        return SpecError("it is mirrored: its parts fit in a mirror alone; scan the side with the parts, without mirroring")
    if agreeing is not None and tags:
        return SpecError(
            f"its tag is that of {names}, but only {agreeing:.0%} of its parts stand where that tape has them: another tape, or "
            "another version of it; give its kit"
        )
    fault = "no tag of the family tag36h11 is in it" if not tags else "its tag cannot be followed to the parts"
    return SpecError(
        f"{fault}, and its {len(blobs.px)} spots are no parts of {names}; scan the whole tape sharp, its parts toward the glass, "
        "at as many dpi across as along, and give dpi=N, as it was scanned"
    )
