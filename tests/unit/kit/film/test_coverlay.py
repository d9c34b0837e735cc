"""Coverlay modes and anchors: where they are legal is what brute-force geometry finds, drawn here without the code under test."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import cos, radians, sin

import numpy as np
import pytest
import shapely
from shapely import affinity

from tactape_fab import TapeSpec
from tactape_fab.base.errors import SpecError
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.film.anchors import anchor_modes
from tactape_fab.kit.film.coverlay import Mode, coverlay_modes, gang_window, least_pitch_mm, worst_box_gap_mm
from tactape_fab.kit.profiles import FabProfile, load_fab, load_part, profile_names
from tactape_fab.texture.board import Board
from tests.thorough import costly, some

PART = load_part("r0201")
PROFILES = [name for name in profile_names("fabs") if load_fab(name).coverlay_modes[0] != "gang"]
DISPLACEMENTS = ((0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0))
HALF_UM = 0.0005


def box(length: float, width: float, rotation_deg: float) -> shapely.Polygon:
    return affinity.rotate(shapely.box(-length / 2, -width / 2, length / 2, width / 2), rotation_deg, origin=(0, 0))


def brute_gap_mm(shape: shapely.Geometry, other: shapely.Geometry, pitch_mm: float, displacement_mm: float) -> float:
    """Least distance of a shape from another one's copies on the 24 grid points round it, all 16 pairs of symbols."""
    copies = [
        affinity.translate(
            other, column * pitch_mm + displacement_mm * (b[0] - a[0]), row * pitch_mm + displacement_mm * (b[1] - a[1])
        )
        for column, row in product(range(-2, 3), repeat=2)
        if (column, row) != (0, 0)
        for a, b in product(DISPLACEMENTS, repeat=2)
    ]
    return float(shapely.distance(shape, copies).min())


def opening_size(fab: FabProfile) -> tuple[float, float]:
    """From the numbers of the part's and the fab's files: 2 x 0.32 + 0.46 by 0.40, and the expansion on each side."""
    return 1.10 + 2 * fab.coverlay_expansion_mm, 0.40 + 2 * fab.coverlay_expansion_mm


def modes_at(fab: FabProfile, pitch_mm: float, displacement_mm: float, rotation_deg: float = 45.0) -> dict[str, Mode]:
    modes = coverlay_modes(fab, PART, pitch_mm=pitch_mm, displacement_mm=displacement_mm, rotation_deg=rotation_deg)
    return {mode.name: mode for mode in modes}


def test_legal_region_is_that_of_brute_force_on_random_designs() -> None:
    rng = np.random.default_rng(6)
    fabs, verdicts = [load_fab(name) for name in PROFILES], []
    for _ in range(some(500)):
        fab = fabs[rng.integers(len(fabs))]
        displacement_mm = round(float(rng.uniform(0.05, 0.5)), 3)
        rotation_deg = float(rng.choice([45.0, 45.0, 135.0, 0.0, 90.0, round(float(rng.uniform(0, 360)), 1)]))
        pitch_mm = round(float(rng.uniform(max(1.0, 2 * displacement_mm + 0.01), 2.6)), 3)
        name = fab.coverlay_modes[0]
        mode = modes_at(fab, pitch_mm, displacement_mm, rotation_deg)[name]
        shape = box(*opening_size(fab), rotation_deg)
        limit = fab.limits["opening-bridge"].value_mm
        wide = brute_gap_mm(shape, shape, pitch_mm, displacement_mm) >= limit - HALF_UM
        large = min(opening_size(fab)) >= fab.limits["opening-size"].value_mm - HALF_UM
        assert mode.legal == (wide and large), (fab.name, pitch_mm, displacement_mm, rotation_deg)
        verdicts.append(mode.legal)
    assert 0.2 < np.mean(verdicts) < 0.8


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("rotation_deg", [45.0, 0.0, 20.0])
@pytest.mark.parametrize("displacement_mm", [0.05, 0.15, 0.25, 0.4])
def test_the_named_pitch_is_the_least_legal_one(name: str, rotation_deg: float, displacement_mm: float) -> None:
    fab = load_fab(name)
    mode = modes_at(fab, 1.5, displacement_mm, rotation_deg)[fab.coverlay_modes[0]]
    shape, limit = box(*opening_size(fab), rotation_deg), fab.limits["opening-bridge"].value_mm
    assert mode.least_pitch_mm is not None
    assert brute_gap_mm(shape, shape, mode.least_pitch_mm, displacement_mm) >= limit - 1e-9
    assert brute_gap_mm(shape, shape, mode.least_pitch_mm - 0.002, displacement_mm) < limit
    for wider_mm in (0.01, 0.1, 0.5, 1.0):  # legal from there on, not only there
        assert brute_gap_mm(shape, shape, mode.least_pitch_mm + wider_mm, displacement_mm) >= limit


@pytest.mark.parametrize(
    ("expansion_mm", "bridge_mm", "pitches_mm"),
    [
        (0.05, 0.2, (0.990, 1.190, 1.290, 1.390, 1.490, 1.590, 1.690, 1.990)),
        (0.10, 0.2, (1.131, 1.331, 1.431, 1.531, 1.631, 1.731, 1.831, 2.131)),
        (0.05, 0.5, (1.414, 1.614, 1.714, 1.814, 1.914, 2.014, 2.114, 2.414)),
        (0.10, 0.5, (1.556, 1.756, 1.856, 1.956, 2.056, 2.156, 2.256, 2.556)),
    ],
)
def test_known_pitches(expansion_mm: float, bridge_mm: float, pitches_mm: tuple[float, ...]) -> None:
    """Measured once by hand for displacements 0, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35 and 0.5 mm."""
    size = (1.10 + 2 * expansion_mm, 0.40 + 2 * expansion_mm)
    for displacement_mm, pitch_mm in zip((0, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.5), pitches_mm, strict=True):
        assert least_pitch_mm(size, bridge_mm, 45.0, displacement_mm) == pytest.approx(pitch_mm, abs=0.0006)


def test_a_bridge_equal_to_its_limit_passes_and_one_below_does_not() -> None:
    fab, size = load_fab("generic-fpc"), (1.2, 0.5)
    pitch_mm = 1.5
    gap_mm = worst_box_gap_mm(size, 45.0, pitch_mm, 0.25)
    for shift_mm, legal in ((0.0, True), (0.000499, True), (0.000501, False)):
        limits = {**fab.limits, "opening-bridge": replace(fab.limits["opening-bridge"], value_mm=gap_mm + shift_mm)}
        assert modes_at(replace(fab, limits=limits), pitch_mm, 0.25)["per-part"].legal is legal


def test_openings_that_touch_have_a_gap_without_a_sign() -> None:
    modes = coverlay_modes(load_fab("generic-fpc"), PART, pitch_mm=1.5, displacement_mm=0.25, rotation_deg=30.0)
    assert modes[0].reason == "bridges down to 0.000 mm, limit 0.200 mm"


def test_the_measured_bridge_is_the_closed_form_ones() -> None:
    examined = examine(TapeSpec(sector=7))
    bridge = next(f for f in examined.findings if f.rule == "opening-bridge")
    assert bridge.value == pytest.approx(worst_box_gap_mm((1.2, 0.5), 45.0, 1.5, 0.25), abs=1e-5)


@pytest.mark.parametrize(
    ("name", "pitch_mm", "mode"),
    [
        ("generic-fpc", 1.5, "per-part"),
        ("generic-fpc", 1.45, "gang"),
        ("jlcpcb-fpc", 1.5, "gang"),
        ("jlcpcb-fpc", 2.057, "per-part"),
        ("generic-lpi", 1.35, "lpi"),
        ("generic-lpi", 1.34, "gang"),
    ],
)
def test_the_default_is_the_first_legal_mode_said_aloud(name: str, pitch_mm: float, mode: str) -> None:
    examined = examine(TapeSpec(sector=7, pitch_mm=pitch_mm, displacement_mm=0.25, fab=name, models=False))
    assert examined.fab.coverlay_mode == mode
    (said,) = [f for f in examined.findings if f.rule == "coverlay"]
    assert mode in said.message
    assert said.level == ("warn" if mode == "gang" else "info")


# Anchors


def spur(fab: FabProfile, rotation_deg: float) -> tuple[shapely.Geometry, shapely.Geometry]:
    """Both spurs of a part as they are drawn: round-ended lines from the pads' middles to beyond the opening."""
    tip = 0.55 + fab.coverlay_expansion_mm + fab.anchor.overlap_mm - fab.anchor.web_mm / 2
    along = np.array([cos(radians(rotation_deg)), sin(radians(rotation_deg))])
    right, left = (
        shapely.LineString([side * 0.32 * along, side * tip * along]).buffer(fab.anchor.web_mm / 2, quad_segs=64)
        for side in (1, -1)
    )
    return right, left


@pytest.mark.parametrize("name", ["generic-fpc", "jlcpcb-fpc", "generic-lpi", "jlcpcb-fr4"])
@pytest.mark.parametrize("rotation_deg", [45.0, 0.0, 30.0])
def test_spurs_are_legal_from_the_named_pitch_on(name: str, rotation_deg: float) -> None:
    fab = load_fab(name).in_mode(load_fab(name).coverlay_modes[0])
    examined = examine(TapeSpec(sector=7, pitch_mm=2.5, displacement_mm=0.25, rotation_deg=rotation_deg, fab=name, models=False))
    layout = examined.layout
    mode = anchor_modes(fab, layout.outlines, PART.pads, layout.tape)[0]
    assert mode.least_pitch_mm is not None
    window, (right, left) = box(*opening_size(fab), rotation_deg), spur(fab, rotation_deg)

    def legal(pitch_mm: float) -> bool:
        clear = min(brute_gap_mm(s, window, pitch_mm, 0.25) for s in (right, left))
        apart = min(brute_gap_mm(s, t, pitch_mm, 0.25) for s, t in ((right, right), (right, left)))
        least = max(fab.anchor.opening_mm, fab.limits["pad-pad"].value_mm - fab.coverlay_expansion_mm)
        return clear >= least - 1e-4 and apart >= fab.limits["pad-pad"].value_mm - 1e-4

    assert legal(mode.least_pitch_mm)
    assert not legal(mode.least_pitch_mm - 0.003)


def test_spurs_that_come_too_near_to_each_other_are_refused_though_openings_are_far() -> None:
    """Tips that face each other along the diagonal: W sqrt 2 - 2 delta / sqrt 2 less twice 0.75 mm and the limit 0.1 mm."""
    for pitch_mm, passed in ((1.383, True), (1.379, False)):
        spec = TapeSpec(
            sector=7, pitch_mm=pitch_mm, displacement_mm=0.25, anchor="spur", coverlay="per-part", size_mm=(60.0, 40.0)
        )
        findings = {f.rule: f for f in examine(spec).findings}
        assert findings["anchor-opening"].passed
        assert findings["anchor-copper"].blocks is not passed
        assert findings["anchor-copper"].value == pytest.approx(2**0.5 * (pitch_mm - 0.25) - 1.5, abs=0.001)


@costly
@pytest.mark.parametrize("rotation_deg", [45.0, 135.0, 225.0])
@pytest.mark.parametrize("displacement_mm", [0.1, 0.25])
def test_a_mesh_is_legal_from_the_named_pitch_on_and_measured_so(rotation_deg: float, displacement_mm: float) -> None:
    values = {"sector": 7, "displacement_mm": displacement_mm, "rotation_deg": rotation_deg, "anchor": "mesh"}
    wide = examine(TapeSpec(pitch_mm=2.2, size_mm=(60.0, 40.0), models=False, **values))  # type: ignore[arg-type]
    least = next(f.limit for f in wide.findings if f.rule == "anchor-mesh")
    assert least is not None
    assert least == pytest.approx(2**0.5 * 0.9 + 2 * displacement_mm, abs=0.001)
    for pitch_mm, legal in ((least, True), (least - 0.003, False)):
        examined = examine(TapeSpec(pitch_mm=pitch_mm, size_mm=(60.0, 40.0), models=False, **values))  # type: ignore[arg-type]
        found = next(f for f in examined.findings if f.rule == "anchor-opening")
        assert found.passed is legal, found.message
        lines = shapely.buffer(shapely.linestrings(examined.layout.anchors.webs_mm), 0.05)  # type: ignore[union-attr]
        openings = [affinity.translate(box(1.2, 0.5, rotation_deg), x, y) for x, y in examined.layout.parts_xy_mm]
        assert shapely.distance(shapely.union_all(lines), openings).min() == pytest.approx(found.value, abs=0.002)


def test_every_pad_of_a_mesh_hangs_on_one_piece_of_copper() -> None:
    layout = examine(
        TapeSpec(sector=7, pitch_mm=1.8, displacement_mm=0.25, size_mm=(40.0, 30.0), anchor="mesh", models=False)
    ).layout
    assert layout.anchors is not None
    copper = shapely.union_all(shapely.buffer(shapely.linestrings(layout.anchors.lines_mm), 0.05))
    assert copper.geom_type == "Polygon"
    assert shapely.distance(copper, shapely.points(layout.pads.xy_mm)).max() == 0.0


def test_spurs_hold_each_pad_alone() -> None:
    layout = examine(TapeSpec(sector=7, size_mm=(40.0, 30.0), anchor="spur", models=False)).layout
    assert layout.anchors is not None
    drawn = shapely.buffer(shapely.linestrings(layout.anchors.spurs_mm), 0.05)
    pads = shapely.polygons(layout.pads.xy_mm[:, None] + layout.pads.outline_mm)
    assert shapely.intersects(drawn, pads).all()
    other = shapely.STRtree(pads).query(drawn, predicate="intersects")
    assert other.shape[1] == len(pads)  # each spur its own pad and no other
    openings = shapely.polygons(layout.openings.xy_mm[:, None] + layout.openings.outline_mm)
    beyond = shapely.difference(drawn, np.repeat(openings, 2))
    assert (np.array([np.ptp(g.exterior.coords, axis=0).max() for g in beyond]) > 0.1).all()


def test_an_anchor_without_coverlay_is_refused_with_what_would_help() -> None:
    examined = examine(TapeSpec(sector=7, fab="jlcpcb-fpc", anchor="spur", models=False))
    (broken,) = [f for f in examined.findings if f.blocks]
    assert broken.rule == "anchor-opening"
    assert "2.056" in broken.message
    with pytest.raises(SpecError, match="leaves no coverlay to hold an anchor"):
        TapeSpec(sector=7, coverlay="gang", anchor="spur")


# Window


@pytest.mark.parametrize("corner_radius_mm", [0.0, 1.0, 12.0])
def test_the_window_holds_every_opening_and_leaves_a_frame(corner_radius_mm: float) -> None:
    spec = TapeSpec(sector=7, size_mm=(50.0, 30.0), coverlay="gang", corner_radius_mm=corner_radius_mm, tag="none", models=False)
    layout = examine(spec).layout
    assert layout.window_mm is not None
    window = shapely.Polygon(layout.window_mm)
    openings = shapely.polygons(layout.openings.xy_mm[:, None] + layout.openings.outline_mm)
    assert shapely.covers(window.buffer(0.001), openings).all()
    board = shapely.Polygon(layout.outline_mm)
    assert board.exterior.distance(window) >= 0.2
    frame = shapely.distance(board.exterior, openings).min()
    assert board.exterior.distance(window) == pytest.approx(frame, abs=0.001)


def test_a_window_of_one_part_is_its_opening() -> None:
    board = Board(size_mm=(20.0, 20.0), texture_origin_mm=(10.0, 10.0), corner_radius_mm=0.0, thickness_mm=0.1)
    square = np.array([(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)])
    window = gang_window(board, np.array([[10.0, 8.0]]), square)
    assert shapely.Polygon(window).equals(shapely.box(9.0, 7.5, 11.0, 8.5))
