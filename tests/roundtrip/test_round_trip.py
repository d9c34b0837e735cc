"""The round trip of `verify`: contacts of the parts that each written file places are decoded, and a wrong file is named."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from tactape_fab import Kit, Localizer, Tape, TapeSpec, make_kit
from tactape_fab.base.fields import Fields
from tactape_fab.cli import main
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.read.gerber_file import read_gerber
from tactape_fab.sense import Parts, iterate_frames
from tactape_fab.sense.decode.dots.detect import Dots
from tactape_fab.sense.decode.dots.frame_dots import frame_dots
from tactape_fab.sense.decode.dots.rim import chosen, settled
from tactape_fab.sense.simulation.dot_errors import dots_of
from tactape_fab.sense.simulation.parts import parts_of
from tactape_fab.solids.forms import read_form
from tactape_fab.solids.mesh.stl import read_stl
from tactape_fab.solids.mesh.triangles import Mesh, stl_bytes
from tactape_fab.texture.frames import FloatArray
from tactape_fab.verify import Verification, verify_kit
from tactape_fab.verify.trip import coverage
from tactape_fab.verify.trip.coverage import TURNS, coverage_of
from tactape_fab.verify.trip.limit import MARGIN, as_seen, error_free, rule_of
from tactape_fab.verify.trip.misplaced import explain
from tactape_fab.verify.trip.positions import Source, copper_source, stl_source
from tactape_fab.verify.trip.round_trip import (
    BARELY,
    EDGE,
    INSIDE,
    LOST,
    MISSED,
    NOISY,
    QUICK,
    RIGHT,
    WRONG,
    Trip,
    full_trips,
    quick_trip,
    read_contact,
    trip_checks,
)
from tactape_fab.verify.trip.visible_parts import ERROR_FREE, in_place, parts_shown
from tests.roundtrip.kits import Edit, OpenKit, Point, failed, flashes, mirror, mirrored, moved
from tests.thorough import slow, thorough

Copy = Callable[[Kit], Path]

SIDE_MM = 20.0
HALF = moved(0.75, 0.0)
MIRRORED, TURNED = mirrored(SIDE_MM), lambda p: (SIDE_MM - p[0], SIDE_MM - p[1])
CONTACTS = INSIDE + EDGE


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> OpenKit:
    """The flat kit as sector 101 has it."""
    spec = TapeSpec(sector=101, size_mm=(SIDE_MM, SIDE_MM), holes_mm=[(16.4, 10.0, 1.0)], models=False)
    return OpenKit(make_kit(spec, tmp_path_factory.mktemp("other") / "tactape-s101").path)


def cpl(change: Callable[[Point], Point]) -> Edit:
    def edit(kit: OpenKit) -> None:
        def moved_rows(table: list[list[str]]) -> None:
            for row in table[1:]:
                row[1:3] = [f"{v:.4f}" for v in change((float(row[1]), float(row[2])))]

        kit.rows("cpl", moved_rows)

    return edit


def lines(verification: Verification) -> dict[str, str]:
    """Messages of the round trip's failed lines by the source of the parts."""
    return {n.removeprefix("round trip from "): c.message for n, c in failed(verification).items() if n.startswith("round trip")}


# What is wrong is named


WRONG_FILES = pytest.mark.parametrize(
    ("edit", "wrong", "says"),
    [
        pytest.param(cpl(HALF), "CPL", "it is shifted by (+0.750, +0.000) mm on the board, half a pitch along x", id="cpl half"),
        pytest.param(cpl(MIRRORED), "CPL", "it is mirrored left to right", id="cpl mirrored"),
        pytest.param(cpl(TURNED), "CPL", "it is turned by 180 deg", id="cpl turned"),
        pytest.param(
            flashes("copper-top", HALF), "copper", "shifted by (+0.750, +0.000) mm on the board, half", id="copper half"
        ),
        pytest.param(mirror("copper-top", SIDE_MM), "copper", "it is mirrored left to right", id="copper mirrored"),
        pytest.param(flashes("copper-top", TURNED), "copper", "it is turned by 180 deg", id="copper turned"),
    ],
)


@WRONG_FILES
def test_the_one_source_that_is_wrong_is_named(edit: Edit, wrong: str, says: str, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    edit(kit)
    said = lines(verify_kit(kit.save(consistent=True), quick=True))
    right = {"CPL": "copper", "copper": "CPL"}[wrong]
    assert list(said) == [wrong]
    assert f"the {wrong} is what is wrong: " in said[wrong] and says in said[wrong]
    assert said[wrong].endswith(f"{right} decodes right")


def test_the_decoder_finds_the_copper_half_a_pitch_off(flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    flashes("copper-top", HALF)(kit)
    said = lines(verify_kit(kit.save(consistent=True)))
    assert list(said) == ["copper"] and "the copper is what is wrong: it is shifted by (+0.750, +0.000) mm" in said["copper"]
    assert f" of {CONTACTS // 2} contacts decode to another place" in said["copper"] and "0.75" in said["copper"]


@pytest.mark.parametrize("quick", [True, False], ids=["quick", "full"])
@pytest.mark.parametrize("turned", [False, thorough(True)], ids=["upright", "turned by 180 deg"])
def test_parts_of_another_sector_are_named(turned: bool, quick: bool, flat_kit: Kit, other: OpenKit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.data.update({role: other.data[role] for role in ("cpl", "copper-top")})
    if turned:
        cpl(TURNED)(kit)
        flashes("copper-top", TURNED)(kit)
    said = lines(verify_kit(kit.save(consistent=True), quick=quick))
    assert set(said) == {"CPL", "copper"}
    for source, message in said.items():
        assert f"{source}: its parts are those of sector 101, not 100" in message
        assert ("it is turned by 180 deg" in message) == turned
        assert "decodes right" not in message


def test_a_solid_of_another_sector_is_named(tmp_path: Path) -> None:
    def made(sector: int) -> Kit:
        return make_kit(TapeSpec(sector=sector, part="block", size_mm=(SIDE_MM, SIDE_MM)), tmp_path / f"made-{sector}")

    kit, foreign = OpenKit(made(3).path), OpenKit(made(4).path)
    kit.data.update({role: foreign.data[role] for role in ("stl", "3mf", "step-solid")})
    said = lines(verify_kit(kit.save(consistent=True), quick=True))
    assert list(said) == ["STL"] and "its parts are those of sector 4, not 3" in said["STL"]


@slow
def test_every_way_to_be_misplaced_is_put_into_words(default_kit: Kit) -> None:
    tape, at = default_kit.tape, default_kit.tape.part_xy_mm()
    height = tape.board.size_mm[1]
    quarter = at @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    elsewhere = parts_of(_again(tape, origin=(0, 0))).xy_mm
    said = {
        None: at,
        "it has no parts": at[:0],
        "its parts stand on no grid of pitch 1.5 mm": np.random.default_rng(1).uniform(0.0, 40.0, (900, 2)),
        "it is shifted by (+0.000, -0.030) mm on the board": at - (0.0, 0.030),
        "it is shifted by (-3.000, +0.750) mm on the board, 2 pitches along x and half a pitch along y": at - (3.0, -0.75),
        "it is mirrored top to bottom": at * (1.0, -1.0) - (0.0, -height),
        "it is turned by 90 deg": quarter,
        "its parts are those of sector 7 at origin 0,0, not 84,1428": elsewhere,
        "its parts are those of sector 7 of 'debruijn-4x4', not 7": parts_of(_again(tape, code="debruijn-4x4")).xy_mm,
        "its parts name no one place of 'microdots-4x4' or another code": tape.cells() * 1.5 + tape.board.texture_origin_mm,
    }
    assert {words: explain(tape, np.asarray(xy_mm, dtype=np.float64)) for words, xy_mm in said.items()} == {
        words: words for words in said
    }
    at[3] = 1e36  # farther than an integer counts, as an STL may say
    assert explain(tape, at) == "its parts name no one place of 'microdots-4x4' or another code"


@pytest.mark.parametrize("share", [0.1, 1 / 6, 0.26, 0.3, 0.4, 0.45])
def test_parts_are_found_on_their_grid_whatever_their_displacement(share: float) -> None:
    tape = examine(TapeSpec(sector=7, part="dome", body_mm=(0.2, 0.2, 0.05), pitch_mm=2.4, displacement_mm=2.4 * share)).tape
    at = tape.part_xy_mm()
    assert explain(tape, at) is None
    if share > 0.4:
        return
    assert explain(tape, at + np.array([0.0, 0.05])) == "it is shifted by (+0.000, +0.050) mm on the board"
    assert explain(tape, at * (1.0, -1.0) + np.array([0.0, tape.board.size_mm[1]])) == "it is mirrored top to bottom"
    scattered = np.random.default_rng(1).uniform(0.0, 40.0, (900, 2))
    assert explain(tape, scattered) in (
        "its parts stand on no grid of pitch 2.4 mm",
        "its parts name no one place of 'microdots-4x4' or another code",
    )


def test_a_tape_whose_dots_the_quick_method_cannot_tell_apart_is_made(tmp_path: Path) -> None:
    values = {"sector": 101, "pitch_mm": 1.378, "displacement_mm": 0.377, "part": "dome", "body_mm": [0.571, 0.228]}
    kit = make_kit(TapeSpec.from_mapping({**values, "size_mm": [24.1, 27.1]}), tmp_path / "kit")
    (check,) = (c for c in kit.checks if c.name == "round trip from STL")
    assert check.passed or check.warning, check.message


def _again(tape: Tape, **options: object) -> Tape:
    from tactape_fab.kit.examine.tape import examine

    return examine(TapeSpec.from_mapping({"sector": tape.sector, **options})).tape


# Where the parts are read from


def test_the_three_sources_agree_within_their_resolution(default_kit: Kit) -> None:
    tape, kit = default_kit.tape, OpenKit(default_kit.path)
    pads = kit.manifest["land_pattern"]["pads"]
    copper = copper_source(read_gerber(kit.data["copper-top"]).flash_xy_mm, pads["offset_mm"], tape.part.rotation_deg)
    stl = stl_source(tape, read_form(Fields(kit.manifest["solid"])), read_stl(kit.data["stl"]))
    for source, tolerance_mm in ((copper, 1e-5), (stl, 1e-4)):
        assert len(source.parts.xy_mm) == tape.part_count
        apart = source.parts.xy_mm[:, None] - tape.part_xy_mm()[None]
        assert np.hypot(apart[..., 0], apart[..., 1]).min(axis=1).max() <= tolerance_mm
        assert np.abs((source.parts.rotation_deg - 45.0 + 90.0) % 180.0 - 90.0).max() < 0.01


@pytest.mark.parametrize(
    ("part", "options"),
    [("block", {"negative": True}), ("block", {"cylinder_mm": 15.0}), ("dome", {}), ("cone", {"negative": True})],
    ids=["block mould", "block cylinder", "dome", "cone mould"],
)
def test_solids_decode_from_their_mesh(part: str, options: dict[str, object], tmp_path: Path) -> None:
    spec = TapeSpec.from_mapping({"sector": 5, "part": part, "size_mm": [SIDE_MM, SIDE_MM], **options})
    kit = make_kit(spec, tmp_path / "kit")
    check = next(c for c in kit.checks if c.name == "round trip from STL")
    assert check.passed and check.figure == QUICK


@pytest.mark.parametrize(("part", "size_mm"), [("block", [20.0, 8.0]), ("r0201", [20.0, 10.0])])
def test_the_quick_round_trip_sees_tapes_hardly_wider_than_a_window(part: str, size_mm: list[float], tmp_path: Path) -> None:
    spec = TapeSpec.from_mapping({"sector": 5, "part": part, "size_mm": size_mm, "tag": "none", "models": part == "block"})
    found = [c for c in make_kit(spec, tmp_path / "kit").checks if c.name.startswith("round trip")]
    assert found and all(c.passed and c.figure == QUICK for c in found)


def test_a_shifted_mesh_is_followed_off_the_grid(default_kit: Kit) -> None:
    kit = OpenKit(default_kit.path)
    mesh = read_stl(kit.data["stl"])
    shifted = read_stl(stl_bytes(Mesh(vertices_mm=mesh.vertices_mm - (-0.75, 0.0, 0.0), faces=mesh.faces), "shifted"))
    source = stl_source(default_kit.tape, read_form(Fields(kit.manifest["solid"])), shifted)
    assert "half a pitch along x" in str(explain(default_kit.tape, source.parts.xy_mm))


# How it passes


def test_the_full_round_trip_of_the_main_job(default_kit: Kit) -> None:
    tape, told = default_kit.tape, list[tuple[str, int, int]]()
    source = Source(name="CPL", parts=parts_of(tape))
    (trip,) = full_trips(tape, [source], progress=lambda *step: told.append(step))
    (check,) = trip_checks(tape, [source], [trip])
    assert check.passed and trip.count(RIGHT) >= 0.95 * CONTACTS
    assert [done for _, done, _ in told] == list(range(CONTACTS + 1)) and {count for *_, count in told} == {CONTACTS}
    assert np.nanpercentile(trip.error_um, 50) < 10.0
    corner = np.abs(trip.poses[:, :2] - [(tape.columns - 1) * 0.75, (tape.rows - 1) * 0.75]).max(axis=0)
    assert (corner > [(tape.columns - 1) * 0.75 - 1.0, (tape.rows - 1) * 0.75 - 1.0]).all(), "no contact near the edges"


def test_too_small_a_contact_is_a_warning_and_no_failure(flat_kit: Kit) -> None:
    verification = verify_kit(flat_kit.path, contact=read_contact(size=(3.0, 3.0)))
    found = [c for c in verification.checks if c.name.startswith("round trip")]
    assert len(found) == 2 and all(c.warning and not c.passed and "larger one" in c.message for c in found)
    assert verification.passed


# What is not located


def test_tops_of_loud_noise_beside_the_parts_excuse(default_kit: Kit) -> None:
    source, contact = Source(name="CPL", parts=parts_of(default_kit.tape)), read_contact(size=(8.0, 7.0))
    loud = replace(contact, scene=replace(contact.scene, noise=4.0, noise_model="smooth"))
    (trip,) = full_trips(default_kit.tape, [source], loud, counts=(12, 4))
    (check,) = trip_checks(default_kit.tape, [source], [trip])
    assert trip.count(RIGHT) > 0 < trip.count(NOISY)
    assert check.passed and f"{trip.count(NOISY)} not located in the sensor's noise" in check.message


def test_noise_is_no_excuse_for_parts_that_are_not_there(default_kit: Kit) -> None:
    parts = parts_of(default_kit.tape)
    source = Source(name="CPL", parts=parts.taken(np.arange(0, len(parts.xy_mm), 4)))
    (trip,) = full_trips(default_kit.tape, [source], counts=(4, 1))
    (check,) = trip_checks(default_kit.tape, [source], [trip])
    assert trip.count(NOISY) + trip.count(BARELY) + trip.count(MISSED) == 0 < trip.count(LOST) and trip.failed
    assert not check.passed and "are not located though the tape says enough there" in check.message


def worse_dots(*given: Any) -> Dots:
    """Every other dot."""
    dots = frame_dots(*given)
    return chosen(dots, np.arange(len(dots.weights)) % 2 == 0)


def moved_dots(*given: Any) -> Dots:
    """Dots that lie somewhere near the right places."""
    dots = settled(*given)
    return replace(dots, xy_px=dots.xy_px + 4.0 * np.sin(np.arange(2.0 * len(dots.weights)) ** 2).reshape(-1, 2))


@pytest.mark.parametrize("worse", ["asks for more", "loses dots", "moves dots"])
def test_a_worse_decoder_finds_no_excuse(worse: str, default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit asks neither what the decoder finds of the parts, nor where it takes them to lie."""
    if worse == "asks for more":
        stricter = {**(Localizer.__init__.__kwdefaults__ or {}), "max_p_false": 1e-12}
        monkeypatch.setattr(Localizer.__init__, "__kwdefaults__", stricter)
    elif worse == "loses dots":
        monkeypatch.setattr("tactape_fab.sense.decode.square_image.frame_dots", worse_dots)
    else:
        monkeypatch.setattr("tactape_fab.sense.decode.localizer.settled", moved_dots)
    source = Source(name="CPL", parts=parts_of(default_kit.tape))
    (trip,) = full_trips(default_kit.tape, [source], read_contact(size=(8.0, 7.0)), counts=(6, 2))
    (check,) = trip_checks(default_kit.tape, [source], [trip])
    assert trip.count(MISSED) >= 4 and trip.count(LOST) == 0
    assert f"{trip.count(MISSED)} missed by the decoder" in check.message or trip.count(RIGHT) == 0


def test_who_knows_the_parts_locates_whatever_the_decoder_does(default_kit: Kit) -> None:
    tape, contact = default_kit.tape, read_contact(size=(7.0, 6.5))
    localizer, rule, located, known = Localizer([tape], contact.sensor), rule_of(tape, contact.sensor), 0, 0
    for frame in iterate_frames(tape, 60, 3, contact.sensor, contact.scene):
        pose = np.array([*frame.position_mm, frame.theta_deg])
        if localizer.locate(frame.depth).located:
            located += 1
            known += all(as_seen(rule, pose, contact.scene, frame.depth, known_parts=told).located for told in (True, False))
    assert 10 < located < 60 and known == located


def test_bounds_hardly_depend_on_whether_symbols_are_known_when_the_grid_is_fitted(default_kit: Kit) -> None:
    tape, contact = default_kit.tape, read_contact(size=(7.0, 6.5))
    localizer, rule, ratios = Localizer([tape], contact.sensor), rule_of(tape, contact.sensor), list[float]()
    for frame in iterate_frames(tape, 60, 3, contact.sensor, contact.scene):
        fix, pose = localizer.locate(frame.depth), np.array([*frame.position_mm, frame.theta_deg])
        known = as_seen(rule, pose, contact.scene, frame.depth, known_parts=False)
        if known.p_tape is not None and known.p_tape < 1e-3:
            assert fix.p_tape is not None
            ratios.append(fix.p_tape / known.p_tape)
    assert len(ratios) > 30 and np.percentile(ratios, 95) < MARGIN and max(ratios) != 1.0


def test_parts_in_place_are_told_from_others(default_kit: Kit) -> None:
    tape, contact, parts = default_kit.tape, read_contact(), parts_of(default_kit.tape)
    shown = parts_shown(tape, np.array([30.0, 20.0, 10.0]), contact.scene, contact.sensor)
    xy_mm, rotation_deg = parts.xy_mm, parts.rotation_deg

    def stand(xy_mm: FloatArray) -> bool:
        return in_place(tape, shown, Parts(xy_mm=xy_mm, rotation_deg=np.full(len(xy_mm), rotation_deg[0])))

    assert stand(xy_mm.copy()) and stand(xy_mm + 0.005) and not stand(xy_mm + 0.02)
    assert not stand(np.delete(xy_mm, shown[0], axis=0)) and not stand(np.concatenate([xy_mm, xy_mm[shown[:1]] + 0.3]))


@pytest.mark.parametrize("share", [0.2, 0.25, 0.29, 0.4])
def test_neighbours_that_lean_together_are_in_place(share: float) -> None:
    spec = TapeSpec(sector=7, part="dome", body_mm=(0.2, 0.2, 0.05), displacement_mm=round(1.5 * share, 3), size_mm=(40.0, 30.0))
    tape, contact = examine(spec).tape, read_contact()
    parts, shown = parts_of(tape), parts_shown(tape, np.array([20.0, 14.0, 10.0]), contact.scene, contact.sensor)
    assert in_place(tape, shown, parts)
    beside = np.concatenate([parts.xy_mm, parts.xy_mm[shown[:1]] + 0.1])
    assert not in_place(tape, shown, Parts(xy_mm=beside, rotation_deg=np.zeros(len(beside))))


def test_what_the_edge_swallows_does_not_count_where_the_edge_shows() -> None:
    def counts(tape: Tape, x_mm: float) -> tuple[int, int]:
        pose, contact = np.array([x_mm, 15.0, 20.0]), read_contact()
        there = len(dots_of(tape, pose.tolist(), contact.scene, 0, ERROR_FREE).weights)
        return error_free(rule_of(tape, contact.sensor), pose, contact.scene).n_dots, there

    solid, film = (examine(TapeSpec(sector=7, size_mm=(60.0, 40.0), part=part)).tape for part in ("block", "r0201"))
    seen, there = counts(solid, 0.5)
    assert 15 < seen < there
    for tape, x_mm in ((solid, 15.0), (film, (film.columns - 1) * 1.5 - 0.5)):
        seen, there = counts(tape, x_mm)
        assert seen == there > 15


def test_a_wrong_answer_fails_however_many_are_right(default_kit: Kit) -> None:
    outcome = np.full(CONTACTS, RIGHT)
    outcome[5] = WRONG
    poses, error_um = np.zeros((CONTACTS, 3)), np.where(outcome == RIGHT, 4.0, 2000.0)
    source = Source(name="CPL", parts=parts_of(default_kit.tape))
    trip = Trip(source="CPL", poses=poses, outcome=outcome, error_um=error_um, reasons=Counter())
    (check,) = trip_checks(default_kit.tape, [source], [trip])
    assert not check.passed and f"1 of {CONTACTS} contacts decode to another place" in check.message
    assert "2.000 mm off" in check.message


def test_quick_needs_no_compiler(tmp_path: Path) -> None:
    script = (
        "import sys; from tactape_fab import TapeSpec, make_kit\n"
        "kit = make_kit(TapeSpec(sector=7, size_mm=(20, 20), models=False), sys.argv[1])\n"
        "print([c.name for c in kit.checks if c.name.startswith('round trip')], 'numba' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", script, str(tmp_path / "kit")], capture_output=True, encoding="utf-8", check=True)
    assert run.stdout.strip() == "['round trip from CPL', 'round trip from copper'] False"


def test_the_quick_round_trip_is_the_same_every_time(flat_kit: Kit) -> None:
    source = Source(name="CPL", parts=parts_of(flat_kit.tape))
    first, again = (quick_trip(flat_kit.tape, source) for _ in range(2))
    assert (first.error_um == again.error_um).all() and first.count(RIGHT) == QUICK


# The map


@pytest.fixture
def few_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Maps with few places, which are done sooner."""
    monkeypatch.setattr(coverage, "_PLACES", 100)


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["verify", *arguments], prog_name="tactape-fab")


def test_the_map_tells_where_contacts_are_located(flat_kit: Kit, few_places: None) -> None:
    tape = flat_kit.tape
    large, small = (coverage_of(tape, read_contact(size=size)) for size in ((9.0, 9.0), (6.5, 6.5)))
    assert large.share.shape == (len(large.y_mm), len(large.x_mm)) and set(np.unique(large.share * TURNS)) <= {0, 1, 2, 3}
    x, y = np.meshgrid(large.x_mm, large.y_mm)
    field = (x > 2.0) & (x < (tape.columns - 1) * 1.5 - 2.0) & (y > 2.0) & (y < (tape.rows - 1) * 1.5 - 2.0)
    assert large.share[field].mean() > 0.9 and large.share[x < -3.0].max() < 0.1
    assert 0.0 < small.share.mean() < large.share.mean()


@slow
def test_the_map_is_a_picture_beside_the_kit(flat_kit: Kit, tmp_path: Path, few_places: None) -> None:
    import cv2

    done = run(str(flat_kit.path), "--map", str(tmp_path / "map.png"), "--contact", "8x8")
    assert done.exit_code == 0
    picture = np.asarray(cv2.imread(str(tmp_path / "map.png")))
    assert picture.shape[0] > 600 and picture.shape[1] > 900
    for colour in ((247, 220, 180), (90, 150, 235), (178, 90, 0)):  # located anywhere, nowhere, and in the round trip
        assert np.all(picture == np.array(colour), axis=2).sum() > 100


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--map", "{kit}/map.png"), "lies in the kit"),
        (("--map", "{kit}/assembly/../map.png"), "lies in the kit"),
        (("--map", "{tmp}/map.jpg"), "does not end with .png"),
        (("--map", "{tmp}/nowhere/map.png"), "there is no folder of that name"),
        (("--contact", "huge"), "--contact"),
        (("--contact", "0x5"), "0.1 mm"),
        (("--contact", "nanx5"), "--contact"),
        (("--sensor", "nosuch"), "nosuch"),
        (("--quick", "--map", "{tmp}/map.png"), "leave out --quick, or --map"),
        (("--quick", "--contact", "5x5", "--sensor", "digit"), "leave out --quick, or --contact, --sensor"),
    ],
)
def test_what_cannot_be_done_is_refused_with_2(arguments: tuple[str, ...], says: str, flat_kit: Kit, tmp_path: Path) -> None:
    before = sorted(path.name for path in flat_kit.path.rglob("*"))
    done = run(str(flat_kit.path), *(a.format(kit=flat_kit.path, tmp=tmp_path) for a in arguments))
    assert done.exit_code == 2 and says in done.stderr, done.output
    assert sorted(path.name for path in flat_kit.path.rglob("*")) == before and not list(tmp_path.glob("*"))


def test_all_that_is_wrong_is_said_at_once(flat_kit: Kit, tmp_path: Path) -> None:
    done = run(str(flat_kit.path), "--map", str(flat_kit.path / "m.png"), "--contact", "0x0", "--sensor", "nosuch")
    assert done.exit_code == 2
    assert all(word in done.stderr for word in ("lies in the kit", "0.1 mm", "nosuch"))
