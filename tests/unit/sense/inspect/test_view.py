"""Which tapes a scan shows: by tags, by parts, by neighbours on a panel; and scans that are refused before."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactape_fab import Tape
from tactape_fab.base.errors import SpecError
from tactape_fab.sense.inspect import view as view_module
from tactape_fab.sense.inspect.blobs import Blobs
from tactape_fab.sense.inspect.inspection import _facts
from tactape_fab.sense.inspect.locate import SeenTag
from tactape_fab.sense.inspect.view import View, _neighbours, _shrunk, _tag_seeds, _views, blockiness, views_of
from tactape_fab.sense.inspect.wanted import WantedTape, _ccw, read_wanted
from tactape_fab.sense.inspect.warp import affine_warp
from tactape_fab.sense.objects.tag_view import tag_corners_mm
from tactape_fab.texture.board import Tag
from tests.tapes import tape_at
from tests.unit.sense.inspect.conftest import Scanned, write

TAPE = replace(tape_at(7, (20, 12)), tag=Tag(family="tag36h11", id=7, cell_mm=0.5, center_mm=(2.5, 3.5), rotation_deg=0.0))
OTHER = replace(tape_at(9, (20, 12)), tag=Tag(family="tag36h11", id=9, cell_mm=0.5, center_mm=(2.5, 3.5), rotation_deg=0.0))
NOISE = np.random.default_rng(1).integers(0, 256, (400, 640, 3)).astype(np.uint8)
SMOOTH = cv2.GaussianBlur(NOISE, (0, 0), 4.0)


def jpeg(quality: int, cut: int = 0) -> np.ndarray:
    data = cv2.imencode(".jpg", SMOOTH, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))[cut:, cut:]


def test_blocks_of_a_jpeg_are_seen_wherever_the_picture_was_cut() -> None:
    assert blockiness(SMOOTH) < 1.3 and blockiness(NOISE) < 1.3
    steep = [blockiness(jpeg(10, cut)) for cut in (0, 3, 7)]
    assert min(steep) > 3.0 and steep == pytest.approx([steep[0]] * 3, rel=0.1)
    # along either axis alone
    rows = np.repeat(np.repeat(NOISE[::8, :, :], 8, axis=0)[:, :1], 640, axis=1)
    assert blockiness(rows) > 5.0 and blockiness(rows.transpose(1, 0, 2)) > 5.0
    # too small to say
    assert blockiness(NOISE[:15, :15]) == 1.0


def test_a_picture_is_made_smaller_by_means_of_whole_blocks() -> None:
    small = _shrunk(NOISE[:301, :402], 3)
    assert small.shape == (100, 134, 3)
    assert small.astype(float) == pytest.approx(NOISE[:300, :402].reshape(100, 3, 134, 3, 3).mean(axis=(1, 3)), abs=1.0)


@pytest.mark.parametrize(
    ("picture", "dpi", "says"),
    [
        (np.full((300, 300, 3), 90, dtype=np.uint8), 1200.0, "it is empty: all of one colour"),
        (jpeg(10), 1200.0, "it is full of JPEG blocks"),
        (SMOOTH, None, "it does not say its dpi; give dpi=N"),
        (SMOOTH, 558.0, "it has 558 dpi, fewer than 559; scan at 600 dpi or more"),
        (SMOOTH, 560.0, "spots are no parts of tape-7"),
    ],
)
def test_a_scan_of_nothing_is_refused(picture: np.ndarray, dpi: float | None, says: str, tmp_path: Path) -> None:
    wanted = [WantedTape(tape=TAPE, sha256="")]
    with pytest.raises(SpecError, match=says):
        _views(picture, "s", wanted, dpi)
    with pytest.raises(SpecError, match=f"s.png: .*{says}") as refused:
        views_of(write(tmp_path / "s.png", picture), wanted, dpi)
    assert refused.value.problems[0].key == "scan"


def seen(tape: WantedTape, place_px: tuple[float, float], px_per_mm: float = 20.0) -> SeenTag:
    """The tag of a tape whose panel (or own) corner is seen at a pixel; v is down."""
    offset = np.zeros(2) if tape.offset_mm is None else tape.offset_mm
    on_panel = offset + tag_corners_mm(tape.tape) @ tape.turn.T
    assert tape.tape.tag is not None
    return SeenTag(number=tape.tape.tag.id, corners_px=on_panel * (px_per_mm, -px_per_mm) + place_px)


def test_tags_of_one_panel_are_those_that_agree_on_its_place() -> None:
    """Two tapes of one sector on a panel, one of them turned; one more panel is seen in part."""
    places = [((5.0, 5.0), 0.0), ((80.0, 5.0), 90.0)]
    wanted = [WantedTape(tape=TAPE, sha256="", offset_mm=np.array(at), turn=_ccw(deg)) for at, deg in places]
    # both are seen a pixel apart
    at_px = [(100.0, 1500.0), (101.0, 1500.0)]
    tags = [seen(wanted[0], (900.0, 4000.0)), *map(seen, wanted, at_px)]
    seeds = _tag_seeds(tags, wanted)
    assert sorted(seed.number for seed in seeds) == [0, 1] and {seed.found_by for seed in seeds} == {"tag"}
    for seed in seeds:
        at, turn = np.array(places[seed.number][0]), wanted[seed.number].turn
        sites = TAPE.part_xy_mm()
        assert seed.warp.smooth(sites) == pytest.approx((at + sites @ turn.T) * (20.0, -20.0) + at_px[seed.number], abs=1e-6)
        assert seed.near_mm.tolist() == [2.5, 3.5]


def test_tags_of_single_tapes_are_theirs_and_copies_are_refused() -> None:
    wanted = [WantedTape(tape=tape, sha256="") for tape in (TAPE, OTHER, replace(OTHER, tag=None))]
    tags = [seen(wanted[1], (0.0, 900.0)), seen(wanted[0], (0.0, 1900.0))]
    assert [seed.number for seed in _tag_seeds(tags, wanted)] == [0, 1] and _tag_seeds([], wanted) == []
    with pytest.raises(SpecError, match="it shows the tag of tape-9 2 times: several copies of the tape; scan each by itself"):
        _tag_seeds([*tags, seen(wanted[1], (900.0, 900.0))], wanted)


def test_neighbours_on_a_panel_are_looked_for_where_they_lie_in_the_picture() -> None:
    """From one tape whose warp is bent: of the others one is turned, one outside the picture, one known already."""
    places = [((5.0, 5.0), 0.0), ((80.0, 5.0), 90.0), ((5.0, 400.0), 0.0), ((5.0, 40.0), 0.0)]
    wanted = [WantedTape(tape=TAPE, sha256="", offset_mm=np.array(at), turn=_ccw(deg)) for at, deg in places]
    picture = np.zeros((2000, 2400, 3), dtype=np.uint8)
    c, s = np.cos(0.05), np.sin(0.05)
    linear = 20.0 * np.array([(c, -s), (-s, -c)])
    panel_px = np.array([30.0, 1900.0])
    warp = affine_warp(linear, panel_px + linear @ places[0][0], (18.0, 12.0), 18.0)
    view = View(
        number=0, name="s", picture=picture, warp=warp, inside=np.ones(TAPE.part_count, dtype=bool), dpi=None, found_by="tag"
    )
    (seed,) = _neighbours(view, wanted, {0: view, 3: view})
    sites = TAPE.part_xy_mm()
    there = places[1][0] + sites @ wanted[1].turn.T
    assert (seed.number, seed.found_by) == (1, "neighbour")
    assert seed.warp.smooth(sites) == pytest.approx(there @ linear.T + panel_px, abs=1e-6)
    # it begins at the part that is nearest to the tape that is known
    middle = places[0][0] + sites.mean(axis=0)
    assert seed.near_mm.tolist() == sites[np.hypot(*(there - middle).T).argmin()].tolist()
    assert sorted(seed.number for seed in _neighbours(view, wanted, {0: view})) == [1, 3]
    assert _neighbours(view, [replace(wanted[0], offset_mm=None), *wanted[1:]], {}) == []


@pytest.mark.parametrize(("times", "factor"), [(1, 1), (2, 1), (4, 2)])
def test_a_scan_of_many_dpi_is_looked_at_in_small_and_says_its_own(times: int, factor: int, scanned: Scanned) -> None:
    """Of 4800 dpi the figures were those of 2400, beside the 4800 that it has."""
    large = cv2.resize(scanned.picture[:, :1000], None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC)
    (view,) = _views(large, "s", read_wanted(scanned.kit), 1200.0 * times)
    assert (view.factor, view.found_by, view.picture.shape[1]) == (factor, "tag", 1000 * times // factor)
    facts = _facts(view, view.warp, 0.0, None)
    assert facts.dpi == 1200.0 * times and np.multiply(facts.px_per_mm, 25.4) == pytest.approx(facts.dpi, rel=0.01)


SITES, PX = TAPE.part_xy_mm(), 25.0
TO_PX, AT_PX = PX * np.array([(1.0, 0.0), (0.0, -1.0)]), np.array([40.0, 680.0])
WIDE = cv2.resize(NOISE, (2000, 720), interpolation=cv2.INTER_CUBIC)


def spots(*sets: np.ndarray) -> Blobs:
    """Spots at board points, with half a pixel of noise."""
    px = np.concatenate(sets) @ TO_PX.T + AT_PX
    return Blobs(px=px + np.random.default_rng(2).normal(0.0, 0.5, px.shape))


def looked_at(
    blobs: Blobs,
    wanted: list[WantedTape],
    monkeypatch: pytest.MonkeyPatch,
    tags: tuple[SeenTag, ...] = (),
    dpi: float = 25.4 * PX,
) -> list[View]:
    monkeypatch.setattr(view_module, "find_tags", lambda _: list(tags))
    monkeypatch.setattr(view_module, "find_blobs", lambda *_: blobs)
    return _views(WIDE, "s", wanted, dpi)


def wanted_of(*tapes: Tape) -> list[WantedTape]:
    return [WantedTape(tape=tape, sha256="") for tape in tapes]


def test_parts_say_which_tape_it_is_where_no_tag_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    # tapes of another pitch are looked for by themselves
    coarse = replace(OTHER, pitch_mm=2.0, name="coarse")
    (view,) = looked_at(spots(SITES), wanted_of(coarse, OTHER, TAPE), monkeypatch)
    assert (view.number, view.found_by, view.name, view.dpi, view.factor) == (2, "code", "s", 25.4 * PX, 1)
    assert view.inside.all() and np.abs(view.warp.to_px(SITES) - (SITES @ TO_PX.T + AT_PX)).max() < 1.0


def test_a_second_copy_beside_a_tape_is_refused_but_on_a_panel(monkeypatch: pytest.MonkeyPatch) -> None:
    both = spots(SITES, np.add(SITES, (38.0, 0.0)))
    with pytest.raises(
        SpecError, match="parts beside tape-7 are those of tape-7 again: two copies of the tape; scan each by itself"
    ):
        looked_at(both, wanted_of(TAPE), monkeypatch)
    on_panel = [replace(tape, offset_mm=np.array((0.0, 0.0))) for tape in wanted_of(TAPE)]
    assert len(looked_at(both, on_panel, monkeypatch)) == 1


SHUFFLED = TAPE.cells() * 1.5 * (1.0, -1.0) + TAPE.board.texture_origin_mm
SHUFFLED = SHUFFLED + 0.25 * np.array([(0, 1), (0, -1), (-1, 0), (1, 0)])[np.random.default_rng(4).integers(0, 4, len(SHUFFLED))]


@pytest.mark.parametrize(
    ("blobs", "tags", "says"),
    [
        (spots(OTHER.part_xy_mm()), (), "its parts are those of sector 9, and tape-7, coarse are of sector 7: another tape"),
        (spots(SITES * (-1.0, 1.0) + (36.0, 0.0)), (), "it is mirrored: its parts fit in a mirror alone"),
        (spots(SHUFFLED), (seen(wanted_of(TAPE)[0], (40.0, 680.0), PX),), "its tag is that of tape-7, coarse, but only "),
        (spots(SITES[:9]), (), "no tag of the family tag36h11 is in it, and its 9 spots are no parts of tape-7, coarse"),
        (
            spots(SITES[:9]),
            (seen(wanted_of(TAPE)[0], (40.0, 680.0), PX),),
            "its tag cannot be followed to the parts, and its 9 spots",
        ),
        (
            spots(SITES[:9]),
            (seen(wanted_of(OTHER)[0], (40.0, 680.0), PX),),
            "it shows a tape with tag 9, and tape-7, coarse have tag 7: another",
        ),
    ],
)
def test_why_a_scan_shows_no_wanted_tape_is_said(
    blobs: Blobs, tags: tuple[SeenTag, ...], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    coarse = replace(OTHER, pitch_mm=2.0, name="coarse", tag=None, sector=7)
    with pytest.raises(SpecError) as refused:
        looked_at(blobs, wanted_of(TAPE, coarse), monkeypatch, tags)
    assert says in str(refused.value)


def test_a_mirrored_tag_is_said(scanned: Scanned) -> None:
    with pytest.raises(SpecError, match="it is mirrored: its tag can be read in a mirror alone"):
        _views(np.ascontiguousarray(scanned.picture[:, 999::-1]), "s", read_wanted(scanned.kit), 1200.0)
