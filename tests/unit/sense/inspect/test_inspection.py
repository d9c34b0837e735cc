"""Places, faults and as-built files from scans drawn by other code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from tactape_fab import Kit, Tape, TapeSpec, make_kit
from tactape_fab.base.errors import SpecError
from tactape_fab.base.fields import Fields
from tactape_fab.make.panel import PanelKit
from tactape_fab.sense import Inspection, inspect_scans
from tactape_fab.sense.inspect.inspection import _merged
from tactape_fab.sense.inspect.result import DRIFT_MM
from tactape_fab.sense.inspect.wanted import WantedTape
from tactape_fab.texture.as_built import AsBuilt, manifest_digest
from tactape_fab.texture.manifest import read_any_manifest
from tactape_fab.texture.panel_manifest import read_placed
from tests import scans
from tests.scans import Built, Picture, Scanner, assembled, scan
from tests.thorough import costly, only_thorough, slow
from tests.unit.sense.inspect.conftest import MISSING, SHIFTED, TOMBSTONED, TURNED, Scanned, write


def errors_um(found: Inspection, built: Built) -> np.ndarray:
    """Errors of the ordinary parts, (n, 2)."""
    ordinary = built.present & (np.abs(built.turn_deg) < 10.0) & found.present & ~found.covered
    error = found.shift_mm - np.stack([built.dx_mm, built.dy_mm], axis=1)
    return np.asarray(error[ordinary] * 1000)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


@pytest.fixture(scope="module")
def found(scanned: Scanned) -> Inspection:
    (one,) = inspect_scans(scanned.path, scanned.kit)
    return one


def test_places_are_within_5_um_at_1200_dpi_and_say_how_sure_they_are(found: Inspection, scanned: Scanned) -> None:
    error = errors_um(found, scanned.built)
    assert rms(error) < 5.0
    assert np.abs(error).max() < 25.0
    ordinary = scanned.built.present & (np.abs(scanned.built.turn_deg) < 10.0) & ~found.covered
    nees = (error**2).mean(axis=1) / (1000 * found.sigma_mm[ordinary]) ** 2
    assert 0.4 < nees.mean() < 1.6
    assert rms(found.turn_deg[ordinary] - scanned.built.turn_deg[ordinary]) < 1.0


def test_every_fault_is_found_and_none_is_invented(found: Inspection, scanned: Scanned) -> None:
    said = {(d.kind, d.designator) for d in found.deviations() if d.designator}
    assert said == {
        *(("missing", f"R{i + 1}") for i in MISSING),
        ("tombstoned", f"R{TOMBSTONED + 1}"),
        ("turned", f"R{TURNED + 1}"),
        ("shifted", f"R{SHIFTED + 1}"),
    }
    (speck,) = found.foreign_mm
    assert np.hypot(*(speck[:2] - scanned.built.specks[0][:2])) < 0.1
    assert abs(found.turn_deg[TURNED] - 35.0) < 1.5


def test_the_as_built_file_holds_what_was_measured(found: Inspection, scanned: Scanned, tmp_path: Path) -> None:
    read = AsBuilt.load(found.as_built().write(tmp_path / "as-built.json"))
    assert read.manifest_sha256 == manifest_digest(scanned.kit / "manifest.json")
    np.testing.assert_array_equal(read.present, scanned.built.present)
    np.testing.assert_allclose(read.dx_mm[read.present], found.shift_mm[found.present, 0], atol=1e-6)
    assert (read.dx_mm[~read.present] == 0).all()
    assert read.film.scale == (1.0, 1.0) and read.film.sigma == 0.001
    assert read.source[0]["kind"] == "scan" and read.source[0]["found_by"] == "tag"


def test_scale_and_skew_of_the_scanner_are_said_and_move_no_part(found: Inspection) -> None:
    (facts,) = found.scans
    assert abs(facts.px_per_mm[0] / (1200 / 25.4) - 1.003) < 1e-3
    assert abs(facts.px_per_mm[1] / (1200 / 25.4) - 0.998) < 1e-3
    assert 2.0 < facts.jitter_um < 15.0


@pytest.mark.parametrize(
    ("turns_deg", "mean_deg"), [((89.0, -89.0), 90.0), ((-88.5, 89.5), -89.5), ((30.0, 31.0), 30.5), ((-4.0,), -4.0)]
)
def test_turns_of_several_scans_are_averaged_as_axes(turns_deg: tuple[float, ...], mean_deg: float, scanned: Scanned) -> None:
    """A body looks the same after half a turn: 89 and -89 degrees are two apart."""
    wanted = WantedTape(tape=Tape.load(scanned.kit), sha256="")
    n = wanted.tape.part_count
    of_all = {"area": np.ones(n), "sigma_mm": np.full(n, 0.01), "shift_mm": np.zeros((n, 2)), "covered": np.zeros(n, dtype=bool)}
    views = [
        SimpleNamespace(
            view=SimpleNamespace(inside=np.ones(n, dtype=bool)),
            bodies=SimpleNamespace(turn_deg=np.full(n, turn), **of_all),
            upright=np.zeros(n, dtype=bool),
            foreign_mm=np.zeros((0, 3)),
            facts=None,
        )
        for turn in turns_deg
    ]
    found = _merged(wanted, views, 0.05, 10.0)  # type: ignore[arg-type]
    apart = (found.turn_deg - mean_deg + 90.0) % 180.0 - 90.0
    assert np.allclose(apart, 0.0, atol=1e-9) and np.abs(found.turn_deg).max() <= 90.0
    # what metal and solder draw to one side is the same in all
    assert np.allclose(found.sigma_mm, np.hypot(0.01, DRIFT_MM))


@costly
@pytest.mark.parametrize(("dpi", "scanned_deg"), [(600.0, 0.7), (800.0, 90.0)])
def test_parts_that_lie_across_are_turned_whatever_the_scan_s_resolution(
    dpi: float, scanned_deg: float, kit_40: Kit, tmp_path: Path
) -> None:
    """A part across its place looks so much like the others that it fits them, badly, in the turn that they have."""
    tape = Tape.load(kit_40.path)
    built, turned_deg = assembled(tape, seed=5), np.array([88.0, -70.0, 90.0, -89.0, 60.0, 80.0, -85.0, 75.0])
    across = 20 + 9 * np.arange(len(turned_deg))
    built.turn_deg[across] = turned_deg
    path = write(tmp_path / "scan.png", scan(tape, built, Scanner(dpi=dpi, turn_deg=scanned_deg), seed=3))
    (one,) = inspect_scans(path, kit_40.path)
    assert {(d.kind, d.designator) for d in one.deviations()} == {("turned", f"R{i + 1}") for i in across}
    # a body looks the same after half a turn
    assert np.abs((one.turn_deg[across] - turned_deg + 90.0) % 180.0 - 90.0).max() < 5.0


@only_thorough
@pytest.mark.parametrize(("dpi", "seed"), [(2400.0, 0), (1200.0, 9)])
def test_good_parts_that_glare_makes_look_as_if_across_lie_as_designed(
    dpi: float, seed: int, kit_40: Kit, tmp_path: Path
) -> None:
    """Of twenty scans those with the part that fits its others best across."""
    built = assembled(Tape.load(kit_40.path), sigma_mm=0.1, missing=5, seed=seed)
    picture = scan(Tape.load(kit_40.path), built, Scanner(dpi=dpi), seed=seed)
    (one,) = inspect_scans(write(tmp_path / "scan.tif", picture), kit_40.path)
    assert "turned" not in {found.kind for found in one.deviations()}


@only_thorough
def test_a_speck_as_dark_as_bodies_at_a_part_is_seen(kit_40: Kit, tmp_path: Path) -> None:
    """Its edge was taken for the part's: places were up to 0.28 mm off, with a sigma of 3 um."""
    tape = Tape.load(kit_40.path)
    beside = (60, 150, 240, 330)
    built = assembled(tape, seed=4)
    at = tape.part_xy_mm()[list(beside)] + np.stack([built.dx_mm, built.dy_mm], axis=1)[list(beside)]
    away = np.array([(0.35, 0.2), (-0.3, 0.35), (0.6, 0.0), (0.1, -0.55)])
    built = replace(built, specks=[(float(x), float(y), 0.45) for x, y in at + away])
    path = write(tmp_path / "scan.png", scan(tape, built, Scanner(blur_mm=0.03), seed=4))
    (one,) = inspect_scans(path, kit_40.path)
    assert set(np.flatnonzero(one.covered).tolist()) == set(beside)
    error = one.shift_mm - np.stack([built.dx_mm, built.dy_mm], axis=1)
    assert (np.abs(error).max(axis=1) < 6.0 * one.sigma_mm).all()
    assert one.sigma_mm[list(beside)] == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize(
    ("scanner", "seed"),
    [(Scanner(dpi=2400, glare=0.0), 1), (Scanner(blur_mm=0.012, band_mm=0.02, noise=1.0, glare=0.0), 2)],
    ids=["no glare", "ends that differ"],
)
def test_good_parts_that_look_a_little_different_are_not_covered(
    scanner: Scanner, seed: int, kit_40: Kit, tmp_path: Path
) -> None:
    tape = Tape.load(kit_40.path)
    built = assembled(tape, missing=5, seed=seed)
    (one,) = inspect_scans(write(tmp_path / "scan.png", scan(tape, built, scanner, seed=seed)), kit_40.path)
    assert [found.kind for found in one.deviations()] == ["missing"] * 5


@slow
@pytest.mark.parametrize(
    ("film", "opening"), [((28, 92, 48), (150, 140, 90)), ((30, 60, 130), (150, 140, 90)), ((70, 70, 72), (160, 145, 95))]
)
def test_films_of_other_colours_serve(
    film: tuple[int, int, int], opening: tuple[int, int, int], kit_40: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Green, blue and black: metal is three times as bright as film, and gold in an opening is as far from blue as a body."""
    monkeypatch.setattr(scans, "FILM", np.array(film, dtype=np.float64))
    monkeypatch.setattr(scans, "BASE", np.array(opening, dtype=np.float64))
    tape = Tape.load(kit_40.path)
    built = assembled(tape, missing=5, seed=1)
    path = write(tmp_path / "scan.png", scan(tape, built, Scanner(dpi=800), seed=1))
    (one,) = inspect_scans(path, kit_40.path, tolerance_mm=0.25)
    assert {d.kind for d in one.deviations()} <= {"missing", "tombstoned"}
    np.testing.assert_array_equal(one.present, built.present)
    assert rms(errors_um(one, built)) < 6.0


def test_colours_that_are_a_pixel_apart_move_no_part(scanned: Scanned, tmp_path: Path) -> None:
    """Blue half a pixel up and red half a pixel down, as of three lines of sensors: all parts were 18 um off together."""
    apart = scanned.picture.copy()
    for channel, down_px in ((0, -0.5), (2, 0.5)):
        move = np.array([(1.0, 0.0, 0.0), (0.0, 1.0, down_px)])
        apart[..., channel] = cv2.warpAffine(apart[..., channel], move, apart.shape[1::-1], flags=cv2.INTER_CUBIC)
    (one,) = inspect_scans(write(tmp_path / "apart.png", apart), scanned.kit)
    assert np.abs(errors_um(one, scanned.built).mean(axis=0)).max() < 3.0


def test_a_grey_scan_serves(scanned: Scanned, tmp_path: Path) -> None:
    grey = write(tmp_path / "grey.tif", cv2.cvtColor(scanned.picture, cv2.COLOR_BGR2GRAY))
    (one,) = inspect_scans(grey, scanned.kit)
    assert rms(errors_um(one, scanned.built)) < 7.0
    np.testing.assert_array_equal(one.present, scanned.built.present)


@slow
def test_a_blurred_scan_says_how_far_parts_are_off_along_them(kit_40: Kit, tmp_path: Path) -> None:
    """Where the outer ends are blurred, a part is where its metal begins, and that differs from end to end."""
    tape = Tape.load(kit_40.path)
    built = assembled(tape, seed=1)
    picture = scan(tape, built, Scanner(dpi=600, blur_mm=0.06, band_mm=0.02), seed=1)
    (one,) = inspect_scans(write(tmp_path / "blurred.png", picture), kit_40.path, dpi=600)
    error = errors_um(one, built)
    nees = ((error - error.mean(axis=0)) ** 2).mean() / (1000 * float(np.median(one.sigma_mm))) ** 2
    assert 0.5 < nees < 1.5


@slow
def test_a_tag_whose_ink_has_spread_leaves_the_parts_to_be_read_at_the_given_dpi(kit_40: Kit, tmp_path: Path) -> None:
    """Blurred ink makes the tag 3.6 mm wide, of 4: at its scale the parts are those of no tape."""
    tape = Tape.load(kit_40.path)
    built = assembled(tape, seed=1)
    path = write(tmp_path / "spread.png", scan(tape, built, Scanner(blur_mm=0.05), seed=1))
    with pytest.raises(SpecError, match="and give dpi=N"):
        inspect_scans(path, kit_40.path)
    (one,) = inspect_scans(path, kit_40.path, dpi=1200)
    assert one.scans[0].found_by == "code" and rms(errors_um(one, built)) < 6.0


@slow
@pytest.mark.parametrize(("off_mm", "file"), [((0.06, -0.06), "scan.png"), ((0.0, 0.0), "scan.jpg")])
def test_metal_beside_bodies_is_not_taken_for_them(off_mm: tuple[float, float], file: str, kit_40: Kit, tmp_path: Path) -> None:
    """Bodies that are all off across leave their lands bare on one side; colours of a JPEG are of half the size."""
    tape = Tape.load(kit_40.path)
    built = assembled(tape, seed=5)
    built = replace(built, dx_mm=built.dx_mm + off_mm[0], dy_mm=built.dy_mm + off_mm[1])
    picture = scan(tape, built, Scanner(), seed=1)
    (one,) = inspect_scans(write(tmp_path / file, picture, cv2.IMWRITE_JPEG_QUALITY, 50), kit_40.path)
    assert np.abs(errors_um(one, built).mean(axis=0)).max() < 4.0


@slow
def test_overlapping_images_are_one_inspection_the_second_found_by_its_code(scanned: Scanned, tmp_path: Path) -> None:
    width = scanned.picture.shape[1]
    first = write(tmp_path / "a.png", scanned.picture[:, : width * 6 // 10])
    second = write(tmp_path / "b.png", np.ascontiguousarray(scanned.picture[:, width * 4 // 10 :][::-1, ::-1]))
    (one,) = inspect_scans([first, second], scanned.kit, dpi=1200)
    assert [s.found_by for s in one.scans] == ["tag", "code"]
    assert rms(errors_um(one, scanned.built)) < 5.5
    np.testing.assert_array_equal(one.present, scanned.built.present)


@slow
def test_two_copies_of_a_tape_are_not_averaged(scanned: Scanned, tmp_path: Path) -> None:
    """In one scan or in two: places would be those of the first copy, or the mean of both, and exact."""
    other = scan(scanned.tape, assembled(scanned.tape, seed=8), Scanner(), seed=3)
    beside = np.hstack([scanned.picture, other[: len(scanned.picture)]])
    with pytest.raises(SpecError, match=r"tag of tactape-s007 2 times: several copies of the tape; scan each by itself"):
        inspect_scans(write(tmp_path / "both.png", beside), scanned.kit)
    with pytest.raises(SpecError, match=r"scan.png and other.png show parts of tactape-s007 \d+ um apart .* two copies"):
        inspect_scans([scanned.path, write(tmp_path / "other.png", other)], scanned.kit)


@slow
def test_a_second_copy_without_a_tag_is_refused(scanned: Scanned, tmp_path: Path) -> None:
    """Its places would be those of one copy, whichever was read, and exact."""
    untagged = scanned.picture[:, scanned.picture.shape[1] // 4 :]
    for copies in ([scanned.picture, untagged], [untagged, untagged]):
        path = write(tmp_path / "two.png", np.concatenate(copies, axis=1))
        with pytest.raises(SpecError, match="are those of tactape-s007 again: two copies of the tape"):
            inspect_scans(path, scanned.kit, dpi=1200)


def test_the_code_says_which_of_several_tapes_it_is(scanned: Scanned, tmp_path: Path) -> None:
    picture = scanned.picture.copy()
    picture[:, : picture.shape[1] * 19 // 100] = picture[5, picture.shape[1] // 2]  # the strip with the tag is covered
    make_kit(TapeSpec(sector=9, size_mm=(40.0, 30.0), models=False), tmp_path / "kits" / "other")
    (tmp_path / "kits" / "this").symlink_to(scanned.kit)
    (one,) = inspect_scans(write(tmp_path / "a.png", picture), tmp_path / "kits", dpi=1190)
    assert one.tape.name == "tactape-s007" and one.scans[0].found_by == "code"


@only_thorough
def test_a_photograph_at_a_slant_serves(kit_40: Kit, tmp_path: Path) -> None:
    tape = Tape.load(kit_40.path)
    built = assembled(tape, missing=3, seed=11)
    slanted = Scanner(dpi=900, turn_deg=128.0, perspective=0.04, jitter_um=0.1, scale=(1.0, 1.0), skew_deg=0.0)
    (one,) = inspect_scans(write(tmp_path / "photo.png", scan(tape, built, slanted)), kit_40.path)
    assert rms(errors_um(one, built)) < 7.0
    np.testing.assert_array_equal(one.present, built.present)


@slow
def test_scatter_of_the_parts_makes_no_photograph_of_a_scan(kit_40: Kit, tmp_path: Path) -> None:
    tape = Tape.load(kit_40.path)
    built = assembled(tape, sigma_mm=0.1, missing=4, seed=1)
    (one,) = inspect_scans(write(tmp_path / "scan.png", scan(tape, built, Scanner(dpi=700), seed=1)), kit_40.path)
    assert one.scans[0].growth is None and np.abs(errors_um(one, built).mean(axis=0)).max() < 4.0


@costly
@pytest.mark.parametrize("photo", [False, True])
def test_what_a_photograph_loses_of_all_parts_together_is_their_drift(photo: bool, scanned: Scanned) -> None:
    """Of n parts that scatter by s the mean is off by s / sqrt(n), and the growth moves the mean part by half of that square."""
    (one,) = inspect_scans(scanned.path, scanned.kit, photo=photo)
    scatter_mm, n = np.hypot(*one.scatter_mm) / np.sqrt(2.0), one.present.sum()
    lost_mm = scatter_mm * np.sqrt(1.5 / n) if photo else 0.0
    assert one.as_built().drift_mm == pytest.approx(np.hypot(DRIFT_MM, lost_mm), rel=0.15)


@only_thorough
def test_a_camera_s_parallax_is_no_shift_of_parts(kit_40: Kit, tmp_path: Path) -> None:
    """A camera 250 mm above, at a slant, with a lens: bodies are seen up to 20 um farther out than their lands."""
    tape = Tape.load(kit_40.path)
    built = assembled(tape, missing=4, seed=21)
    camera = Scanner(dpi=800, turn_deg=31.0, perspective=0.06, lens_k1=0.01, camera_mm=250.0, jitter_um=0.01, shadow=0.2)
    (one,) = inspect_scans(write(tmp_path / "photo.png", scan(tape, built, camera, seed=3)), kit_40.path)
    error = errors_um(one, built)
    assert rms(error) < 7.0 and one.scans[0].growth is not None and one.scans[0].growth > 2e-4
    assert np.abs(one.mean_shift_mm).max() < 1e-3
    np.testing.assert_array_equal(one.present, built.present)
    assert (error**2).mean() / (1000 * np.median(one.sigma_mm)) ** 2 < 2.2
    assert one.as_built().source[0]["photo"] is True


@pytest.fixture(scope="module")
def panel_scan(panel_2: PanelKit) -> tuple[Picture, list[Built]]:
    """All tapes of a panel, each drawn alone and put in its place."""
    dpi = 1000.0
    placed = read_placed(Fields(read_any_manifest(panel_2.path / "manifest.json")))
    tapes = [Tape.load((panel_2.path / p.manifest).parent) for p in placed]
    builts = [assembled(t, missing=2, seed=i) for i, t in enumerate(tapes)]
    still = Scanner(dpi=dpi, turn_deg=0.0, scale=(1.0, 1.0), skew_deg=0.0, jitter_um=0.1, margin_mm=0.4, shading=0.0)
    pieces = [scan(t, b, still, seed=i) for i, (t, b) in enumerate(zip(tapes, builts, strict=True))]
    r = dpi / 25.4
    corner = [(p.offset_mm[0] * r, (p.offset_mm[1] + t.board.size_mm[1]) * r) for p, t in zip(placed, tapes, strict=True)]
    height = int(max(v for _, v in corner) + 200)
    width = int(max(u + s.shape[1] for (u, _), s in zip(corner, pieces, strict=True)) + 100)
    out = np.full((height, width, 3), 236, np.uint8)
    for (u, v), piece in zip(corner, pieces, strict=True):
        row, column = height - 60 - int(v), int(u)
        out[row : row + piece.shape[0], column : column + piece.shape[1]] = piece
    return out, builts


@only_thorough
def test_all_tapes_of_a_panel_are_inspected(panel_2: PanelKit, panel_scan: tuple[Picture, list[Built]], tmp_path: Path) -> None:
    picture, builts = panel_scan
    found = inspect_scans(write(tmp_path / "panel.png", picture), panel_2.path)
    assert len(found) == len(builts) == 2
    for one, built in zip(found, builts, strict=True):
        np.testing.assert_array_equal(one.present, built.present)
        assert rms(errors_um(one, built)) < 6.0


@only_thorough
def test_a_photograph_of_a_panel_is_inspected(panel_2: PanelKit, panel_scan: tuple[Picture, list[Built]], tmp_path: Path) -> None:
    """Slanted and turned; each tape loses the mean and growth of its own shifts, as that of a photograph by itself does."""
    picture, builts = panel_scan
    height, width = picture.shape[:2]
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=np.float32)
    slanted = corners + np.array([(0.02, 0.01), (-0.01, 0.03), (0.01, -0.01), (-0.02, -0.02)], dtype=np.float32) * width
    bent = cv2.warpPerspective(picture, cv2.getPerspectiveTransform(corners, slanted), (width, height), borderValue=(236,) * 3)
    path = write(tmp_path / "photo.png", np.ascontiguousarray(np.rot90(bent, 2)))
    for one, built in zip(inspect_scans(path, panel_2.path, photo=True), builts, strict=True):
        np.testing.assert_array_equal(one.present, built.present)
        sites, there = one.tape.part_xy_mm(), built.present
        arm = (sites - sites[there].mean(axis=0))[there]
        true = np.stack([built.dx_mm, built.dy_mm], axis=1)[there]
        true = true - true.mean(axis=0)
        true = true - arm * (arm * true).sum() / (arm**2).sum()
        assert rms(1000 * (one.shift_mm[there] - true)) < 8.0
        assert one.scans[0].growth is not None


@slow
def test_tapes_that_are_turned_on_a_panel_are_found_beside_others(panel_packed: PanelKit, tmp_path: Path) -> None:
    """Of five sizes, four of them turned by a quarter, and two of these without a tag: their places say where they are."""
    dpi, margin_mm = 600.0, 0.4
    placed = read_placed(Fields(read_any_manifest(panel_packed.path / "manifest.json")))
    tapes = [Tape.load((panel_packed.path / p.manifest).parent) for p in placed]
    assert {t.tag is None for p, t in zip(placed, tapes, strict=True) if p.rotation_deg == 90.0} == {True, False}
    builts = [assembled(t, missing=2, seed=i) for i, t in enumerate(tapes)]
    still = Scanner(dpi=dpi, turn_deg=0.0, scale=(1.0, 1.0), skew_deg=0.0, jitter_um=0.1, margin_mm=margin_mm, shading=0.0)
    r, (width_mm, height_mm) = dpi / 25.4, (120.0, 130.0)
    out = np.full((round(height_mm * r), round(width_mm * r), 3), 236, np.uint8)
    for i, (p, tape, built) in enumerate(zip(placed, tapes, builts, strict=True)):
        piece, (w, h) = scan(tape, built, still, seed=i), tape.board.size_mm
        left, top = p.offset_mm[0], p.offset_mm[1] + h
        if p.rotation_deg == 90.0:  # counter-clockwise about its lower left corner
            piece, left, top = np.rot90(piece), left - h, p.offset_mm[1] + w
        row, column = round((height_mm - top - margin_mm) * r), round((left - margin_mm) * r)
        out[row : row + piece.shape[0], column : column + piece.shape[1]] = piece
    found = inspect_scans(write(tmp_path / "panel.png", out), panel_packed.path, dpi=dpi)
    assert [one.scans[0].found_by for one in found].count("neighbour") == 2
    for one, built in zip(found, builts, strict=True):
        np.testing.assert_array_equal(one.present, built.present)
        assert rms(errors_um(one, built)) < 6.0


@slow
def test_a_panel_of_which_a_tape_is_not_scanned_is_refused(
    panel_2: PanelKit, panel_scan: tuple[Picture, list[Built]], tmp_path: Path
) -> None:
    picture, _ = panel_scan
    half = write(
        tmp_path / "half.png",
        picture[: picture.shape[0] // 2] if picture.shape[0] > picture.shape[1] else picture[:, : picture.shape[1] // 2],
    )
    with pytest.raises(SpecError, match=r"no scan shows tactape-s0|outside the scans: cropped"):
        inspect_scans(half, panel_2.path)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"dpi": 0.0}, "dpi = 0.0 dpi is not from 50 to 20000 dpi"),
        ({"tolerance_mm": -1.0}, "tolerance_mm = -1.0 mm is not from 0.001 to 10 mm"),
        ({"turn_tolerance_deg": float("nan")}, "turn_tolerance_deg = nan deg is not"),
    ],
)
def test_impossible_options_are_refused(scanned: Scanned, options: dict[str, Any], said: str) -> None:
    with pytest.raises(SpecError, match=said):
        inspect_scans(scanned.path, scanned.kit, **options)


def test_no_scan_at_all_is_refused_together_with_a_missing_kit(tmp_path: Path) -> None:
    with pytest.raises(SpecError) as error:
        inspect_scans([], tmp_path / "none")
    assert len(error.value.problems) == 2


TAN = (150, 120, 90)


@pytest.mark.parametrize(("body", "seed"), [(TAN, 6), ((125, 105, 88), 7)])
def test_bodies_of_the_colour_of_lands_edges_are_told_from_bare_lands(
    body: tuple[int, int, int], seed: int, kit_40: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Chip capacitors: those that were missing, or 0.3 mm off, were said to be where they should, to some micrometres."""
    monkeypatch.setattr(scans, "BODY", np.array(body, dtype=np.float64))
    tape = Tape.load(kit_40.path)
    built = assembled(tape, sigma_mm=0.03, missing=4, seed=seed)
    far = np.flatnonzero(built.present)[[50, 200]]
    built.dx_mm[far], built.dy_mm[far] = (0.3, -0.2), (0.05, 0.22)
    path = write(tmp_path / "scan.png", scan(tape, built, Scanner(glare=0.0), seed=seed))
    (one,) = inspect_scans(path, kit_40.path)
    np.testing.assert_array_equal(one.present, built.present)
    said = {(d.kind, d.designator) for d in one.deviations()}
    gone = {("missing", f"R{k + 1}") for k in np.flatnonzero(~built.present)}
    assert gone < said and {name for _, name in said - gone} == {f"R{k + 1}" for k in far}
    ordinary = built.present & ~np.isin(np.arange(tape.part_count), far)
    assert np.abs(one.shift_mm - np.stack([built.dx_mm, built.dy_mm], axis=1))[ordinary].max() < 0.02


@slow
def test_doubt_of_a_shadow_is_in_what_is_said_of_places(kit_40: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On green film all places were 6 um off across the parts, and their sigmas of 3 um had none of it."""
    monkeypatch.setattr(scans, "FILM", np.array((28.0, 92.0, 48.0)))
    monkeypatch.setattr(scans, "BASE", np.array((150.0, 140.0, 90.0)))
    tape = Tape.load(kit_40.path)
    built = assembled(tape, seed=1)
    (one,) = inspect_scans(write(tmp_path / "scan.png", scan(tape, built, Scanner(), seed=1)), kit_40.path)
    mean_mm = errors_um(one, built).mean(axis=0) / 1000
    drift_mm = float(one.as_built().source[0]["drift_mm"])
    assert np.abs(mean_mm).max() < 2.5 * drift_mm and 0.002 < drift_mm < 0.006
    assert (one.sigma_mm[one.present] >= drift_mm).all()
