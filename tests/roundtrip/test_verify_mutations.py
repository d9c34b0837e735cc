"""Every small change to a written kit is caught by `verify` and named by the line that is about it.

Each change of a file is tried twice: with the file changed alone, when the line of the hashes must fail beside it, and
with signature, fab zip, sizes and SHA-256 made to fit, when nothing but the line that is about it can tell.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.base.errors import SpecError
from tactape_fab.cli import main
from tactape_fab.verify import verify_kit
from tests.roundtrip.kits import (
    LAYERS,
    MODELS,
    ROLES,
    Edit,
    OpenKit,
    Point,
    Rows,
    aperture,
    bytes_of,
    designators,
    exchanged,
    failed,
    flashes,
    map_component,
    map_points,
    members,
    mirror,
    mirrored,
    moved,
    points,
    replaced,
    rows,
    stated,
    text_of,
    turned_90,
)

Copy = Callable[[Kit], Path]
Once = Callable[[str, Callable[[Path], Any]], Any]

PART = 10
"""Number of the part that is changed: column 1, row 1 of the small kit, symbol S."""
PADS = (2 * PART - 2, 2 * PART - 1)
SIDE_MM = 20.0
TAG_CENTRE_MM = (3.0, 3.5)
GUARDS = {"manifest", "files", "roles", "content", "attributes", "fab-zip"}
"""Lines that a change with fitted hashes must leave alone, unless it is about them."""

BOTH = pytest.mark.parametrize("consistent", [False, True], ids=["file alone", "hashes fitted"])


def case(name: str, edit: Edit, *fails: str, says: str = "") -> Any:
    """A change, the lines that must fail, and what the first of them must say."""
    return pytest.param(edit, fails, says, id=name)


# Changes, as functions of an opened kit


def cell(row: int, column: int, value: str) -> Edit:
    return rows("cpl", lambda table: table[row].__setitem__(column, value))


def swap_rows(table: Rows) -> None:
    table[4], table[9] = table[9], table[4]


def swap_places(table: Rows) -> None:
    table[3][1:3], table[17][1:3] = table[17][1:3], table[3][1:3]


def place_mm(kit: OpenKit) -> Point:
    x, y = kit.data["cpl"].decode("ascii").splitlines()[PART].split(",")[1:3]
    return float(x), float(y)


def turn_pads(kit: OpenKit) -> None:
    flashes("copper-top", turned_90(place_mm(kit)), *PADS)(kit)


def pad_line(kit: OpenKit, pad: int) -> str:
    return [line for line in kit.data["copper-top"].decode("ascii").splitlines() if line.endswith("D03*")][pad] + "\n"


def delete_pad(kit: OpenKit) -> None:
    replaced("copper-top", pad_line(kit, PADS[0]), "")(kit)


def add_pad(x_mm: float, y_mm: float) -> Edit:
    def edit(kit: OpenKit) -> None:
        last = pad_line(kit, PADS[1])
        replaced("copper-top", last, f"{last}X{round(x_mm * 1e6)}Y{round(y_mm * 1e6)}D03*\n")(kit)

    return edit


def stretched(p: Point) -> Point:
    """Longer along 45 degrees by 15 %, narrower across by as much: the same area."""
    along, across = 1.15 * (p[0] + p[1]) / 2, (p[0] - p[1]) / 2 / 1.15
    return along + across, along - across


def change_symbol_everywhere(kit: OpenKit) -> None:
    """The part goes from S to N in every file but the manifest."""
    assert kit.manifest["symbols"][1][1] == "S"
    north = moved(0.0, 2 * kit.manifest["displacement_mm"])
    x_mm, y_mm = north(place_mm(kit))
    kit.rows("cpl", lambda table: table[PART].__setitem__(slice(1, 3), [f"{x_mm:.4f}", f"{y_mm:.4f}"]))
    for role in ("copper-top", "paste-top"):
        flashes(role, north, *PADS)(kit)
    flashes("coverlay-top", north, PART - 1)(kit)
    component(north)(kit)


def component(change: Callable[[Point], Point]) -> Edit:
    return text_of("components-top", lambda text: map_component(text, f"R{PART}", change))


def turn_tag(quarters: int) -> Edit:
    """Turn the printed areas about the tag's centre; the label's lines stay."""

    def turn(text: str) -> str:
        end = text.rindex("G37*")
        areas = text[:end]
        for _ in range(quarters):
            areas = map_points(areas, turned_90(TAG_CENTRE_MM))
        return areas + text[end:]

    return text_of("legend-top", turn)


def outline_twice(text: str) -> str:
    drawn = text[text.index("X1000000Y0D02*") : text.index("%TF.MD5")]
    return text.replace(drawn, 2 * drawn)


def break_signature(kit: OpenKit) -> None:
    kit.sign = False
    digit = kit.data["copper-top"].decode("ascii").partition("TF.MD5,")[2][0]
    replaced("copper-top", f"TF.MD5,{digit}", f"TF.MD5,{'1' if digit == '0' else '0'}")(kit)


def _land_changes(role: str) -> list[Any]:
    """Changes of copper and paste."""
    return [
        case(f"{role}: one pad by 20 um", flashes(role, moved(0.02, 0), PADS[0]), f"{role} places", says=f"at R{PART}"),
        case(f"{role}: both pads by 20 um", flashes(role, moved(0, 0.02), *PADS), f"{role} places", says=f"20.0 um at R{PART}"),
        case(f"{role}: pad far away", flashes(role, moved(5, 0), PADS[0]), f"{role} pairs", f"{role} places", says="no partner"),
        case(f"{role}: aperture turned", aperture(role, turned_90()), f"{role} rotation", says="pad itself"),
        case(f"{role}: aperture larger", aperture(role, lambda p: (1.03 * p[0], 1.03 * p[1])), f"{role} area", says="+5.97 %"),
        case(f"{role}: aperture off its centre", aperture(role, moved(0.02, 0)), f"{role} shape"),
        case(f"{role}: aperture stretched", aperture(role, stretched), f"{role} shape"),
        case(f"{role}: aperture not exposed", replaced(role, "4,1,36,", "4,0,36,"), role),
        case(f"{role}: drawn clear", replaced(role, "%LPD*%", "%LPC*%"), f"{role} pairs"),
    ]


def _reading_changes(role: str) -> list[Any]:
    """Changes after which a file cannot be read, or reads differently from reader to reader."""
    gerber = role != "drill-npth"
    changes = [
        case(f"{role}: cut in half", bytes_of(role, lambda b: b[: len(b) // 2]), role),
        case(f"{role}: empty", bytes_of(role, lambda b: b""), role),
        case(f"{role}: end missing", replaced(role, "M02*\n" if gerber else "M30\n", ""), role),
    ]
    if gerber:
        changes += [
            case(f"{role}: end before its content", replaced(role, "G75*\n", "G75*\nM02*\n"), role),
            case(f"{role}: step and repeat", replaced(role, "G75*\n", "G75*\n%SRX2Y1I9J0*%\n"), role),
        ]
    return changes


def certificate(name: str, edit: Edit, says: str) -> Any:
    return case(f"certificate: {name}", edit, "certificate", says=says)


FILE_CHANGES = [
    *_land_changes("copper-top"),
    *_land_changes("paste-top"),
    case(
        "copper: part's pads turned", turn_pads, "copper-top places", "copper-top pairs", "symbols from copper", says=f"R{PART}"
    ),
    case("copper: pad deleted", delete_pad, "copper-top pairs", "copper-top places", says="187 flashes where 94 parts need 188"),
    case("copper: pad off the board", add_pad(-1.0, 5.0), "copper-top to edge", "copper-top pairs", says="-1.263 mm"),
    case("copper: pad near the edge", add_pad(SIDE_MM - 0.5, 5.0), "copper-top to edge", says="less than 0.3 mm"),
    # coverlay
    case(
        "coverlay: one opening by 20 um", flashes("coverlay-top", moved(0.02, 0), PART - 1), "coverlay-top places", says="at R10"
    ),
    case("coverlay: opening turned", aperture("coverlay-top", turned_90()), "coverlay-top shape"),
    case("coverlay: opening off its centre", aperture("coverlay-top", moved(0.02, 0)), "coverlay-top shape", says="20.0 um"),
    case("coverlay: not exposed", replaced("coverlay-top", "4,1,4,", "4,0,4,"), "coverlay-top"),
    case("coverlay: drawn clear", replaced("coverlay-top", "%LPD*%", "%LPC*%"), "coverlay-top openings"),
    # whole layers
    case("copper mirrored", mirror("copper-top", SIDE_MM), "copper-top pairs", "symbols from copper", "windows from copper"),
    case("paste mirrored", mirror("paste-top", SIDE_MM), "paste-top pairs", "paste-top places"),
    case("coverlay mirrored", mirror("coverlay-top", SIDE_MM), "coverlay-top places", "coverlay-top shape"),
    case("legend mirrored", points("legend-top", mirrored(SIDE_MM)), "tag by OpenCV", says="0 tags"),
    case("tag mirrored", points("legend-top", mirrored(2 * TAG_CENTRE_MM[0])), "tag by OpenCV", says="0 tags"),
    case("copper shifted", points("copper-top", moved(0.1, 0)), "copper-top places", says="94 pairs are off the CPL"),
    case("paste shifted", points("paste-top", moved(0, 0.1)), "paste-top places", says="worst by 100.0 um"),
    case("coverlay shifted", points("coverlay-top", moved(0, -0.1)), "coverlay-top places", says="worst by 100.0 um"),
    case("legend shifted", points("legend-top", moved(0.1, 0)), "tag by OpenCV", says="displaced"),
    case("outline shifted", points("profile", moved(0.1, 0)), "profile", says="from the manifest's outline"),
    case("copper and paste exchanged", exchanged("copper-top", "paste-top"), "attributes", "copper-top area", says="Paste,Top"),
    # pick-and-place
    case("CPL: row dropped", rows("cpl", lambda t: t.pop(PART)), "cpl rows", "symbols from CPL", says=f"misses R{PART}"),
    case("CPL: two rows exchanged", rows("cpl", swap_rows), "cpl rows", says="row 4 is R9, not R4"),
    case("CPL: two places exchanged", rows("cpl", swap_places), "cpl places", "components-top", says="R3 by 4242.6 um, R17"),
    case("CPL: part turned by 90 deg", cell(PART, 4, "135"), "cpl rotation", "copper-top rotation", says=f"R{PART} at 135 deg"),
    case("CPL: part turned by 180 deg", cell(PART, 4, "225"), "cpl rotation", says=f"R{PART} at 225 deg"),
    case("CPL: part by 20 um", cell(PART, 1, "8.4200"), "cpl places", "copper-top places", says=f"R{PART} by 20.0 um"),
    case("CPL: part on the bottom", cell(PART, 3, "Bottom"), "cpl rows", says="not on layer Top"),
    case("CPL: row repeated", rows("cpl", lambda t: t.insert(PART, t[PART])), "cpl rows", says=f"repeats R{PART}"),
    case("CPL: missing cell", rows("cpl", lambda t: t[PART].pop()), "cpl", says=f"line {PART + 1}: it has 4 cells"),
    case("CPL: no number", cell(PART, 1, "8,4"), "cpl", says="not a number"),
    case("CPL: NaN", cell(PART, 2, "nan"), "cpl", says="Mid Y = 'nan' is not a number"),
    case("CPL: column renamed", cell(0, 1, "Ref X"), "cpl", says="Mid X"),
    case("CPL: empty", bytes_of("cpl", lambda b: b""), "cpl", says="empty"),
    # bill of materials
    case("BOM: designator renamed", designators(lambda n: n.__setitem__(PART - 1, "C1")), "bom", says="R10; it has unknown C1"),
    case("BOM: designator dropped", designators(lambda n: n.pop(PART - 1)), "bom", says=f"misses R{PART}"),
    case("BOM: designator twice", designators(lambda n: n.append(f"R{PART}")), "bom", says="repeats"),
    case("BOM: wrong quantity", rows("bom", lambda t: t[1].__setitem__(1, "93")), "bom", says="quantity"),
    case("BOM: missing cell", rows("bom", lambda t: t[1].pop()), "bom", says="row 2 has 5 cells"),
    case("BOM: empty", bytes_of("bom", lambda b: b""), "bom", says="empty"),
    # a symbol
    case(
        "symbol changed in all files",
        change_symbol_everywhere,
        *("symbols from CPL", "windows from CPL", "symbols from copper", "windows from copper", "cpl places"),
        says="column 1, row 1: 'N' instead of 'S'",
    ),
    # outline and holes
    case("outline larger", points("profile", lambda p: (p[0] + 0.2 * (p[0] > 10), p[1])), "profile", says="20.2 x 20 mm"),
    case("outline open", replaced("profile", "X1000000Y0I1000000J0D01*\n", ""), "profile", says="not closed"),
    case("outline's arc ends elsewhere", replaced("profile", "X20000000Y1000000I0J", "X20900000Y1000000I0J"), "profile"),
    case("outline twice", text_of("profile", outline_twice), "profile", says="2 contours"),
    case("hole dropped", replaced("drill-npth", "X16.4000Y10.0000\n", ""), "drill-npth", says="(16.4, 10) d 1 mm is missing"),
    case("hole moved", replaced("drill-npth", "X16.4000", "X16.4200"), "drill-npth"),
    case("hole larger", replaced("drill-npth", "C1.0000", "C1.1000"), "drill-npth"),
    # legend
    case("tag turned by 90 deg", turn_tag(1), "tag by OpenCV", says="turned"),
    case("tag turned by 180 deg", turn_tag(2), "tag by OpenCV", says="turned"),
    case("legend drawn clear", replaced("legend-top", "%LPD*%", "%LPC*%"), "tag by OpenCV"),
    # attributes, component layer, job, previews
    case("wrong FileFunction", replaced("copper-top", "Copper,L1,Top", "Copper,L2,Bot"), "attributes", says="Copper,L2,Bot"),
    case("broken signature", break_signature, "attributes", says="MD5"),
    case("component renamed", replaced("components-top", f"O.C,R{PART}*", "O.C,C1*"), "components-top", says=f"C1, R{PART}"),
    case("component moved", component(moved(0.02, 0)), "components-top", says="R10 by 20.0 um"),
    case("job: another board", replaced("job", '"X": 20.0', '"X": 21.0'), "job", says="21 x 20 mm"),
    case("job: another layer", replaced("job", ".gts", ".gbs"), "job", says=".gbs"),
    case("job: empty", bytes_of("job", lambda b: b""), "job", says="cannot be read"),
    # certificate
    certificate("better than it is", replaced("certificate", '"detects": ', '"detects": 1'), "detects = 1"),
    certificate("another designator", replaced("certificate", '"designator": "R', '"designator": "C'), "computed 'R"),
    certificate("of another sector", replaced("certificate", '"sector": 100', '"sector": 101'), "sector = 101, computed 100"),
    certificate("a key more", replaced("certificate", '"parts"', '"x": 1, "parts"'), "'x' does not belong"),
    certificate("a key less", replaced("certificate", '"corrects"', '"correct"'), "corrects' is missing"),
    certificate("no whole number", replaced("certificate", '"rows": 12', '"rows": 12.0'), "12.0, computed 12"),
    certificate("no table", bytes_of("certificate", lambda b: b"[]"), "the content = []"),
    certificate("cut in half", bytes_of("certificate", lambda b: b[: len(b) // 2]), "cannot be read"),
    case("PNG garbage", bytes_of("preview-png", lambda b: b[:8] + b"garbage" * 99), "previews", says="PNG"),
    case("SVG cut", bytes_of("preview-svg", lambda b: b[: len(b) // 2]), "previews", says="SVG"),
    # zip
    case(
        "zip: file replaced",
        members(lambda kit, z: z.update({kit.name("job"): b"{}"})),
        "fab-zip",
        says="job.gbrjob in the zip differs",
    ),
    case("zip: file added", members(lambda kit, z: z.update({"x.txt": b"x"})), "fab-zip", says="x.txt does not belong"),
    case("zip: file dropped", members(lambda kit, z: z.pop(kit.name("drill-npth"))), "fab-zip", says="NPTH.drl is missing"),
    case(
        "zip: with the component layer",
        members(lambda kit, z: z.update({kit.name("components-top"): kit.data["components-top"]})),
        "fab-zip",
        says="pnp_top.gbr does not belong",
    ),
    case("zip: cut", bytes_of("fab-zip", lambda b: b[: len(b) // 2]), "fab-zip", says="cannot be opened"),
    *[change for role in (*LAYERS, "components-top", "drill-npth") for change in _reading_changes(role)],
]


def judge(kit: OpenKit, fails: tuple[str, ...], says: str, *, consistent: bool, quick: bool = True) -> None:
    """Save an edited kit, verify it, and expect failed lines."""
    verification = verify_kit(kit.save(consistent=consistent), quick=quick)
    lines = failed(verification)
    assert set(fails) <= set(lines)
    assert says in lines[fails[0]].message
    assert not verification.passed
    if consistent:
        assert GUARDS & set(lines) <= set(fails)
    else:
        assert "SHA-256 differs" in lines["files"].message


@pytest.mark.parametrize(("edit", "fails", "says"), FILE_CHANGES)
def test_a_changed_file_is_caught_and_named(edit: Edit, fails: tuple[str, ...], says: str, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    edit(kit)
    judge(kit, fails, says, consistent=True)


@pytest.mark.parametrize(("edit", "fails", "says"), FILE_CHANGES[::6])
def test_a_file_changed_alone_is_caught_by_its_hash_too(
    edit: Edit, fails: tuple[str, ...], says: str, flat_kit: Kit, copied: Copy
) -> None:
    kit = OpenKit(copied(flat_kit))
    edit(kit)
    judge(kit, fails, says, consistent=False)


@pytest.mark.parametrize("role", ROLES)
def test_the_file_of_another_kit_is_caught(role: str, small_kit: Kit, flat_kit: Kit, once: Once, copied: Copy) -> None:
    """By a line that reads it: what no reader checks is not part of a kit."""
    spec = TapeSpec(sector=101, size_mm=(24.0, 20.0), holes_mm=[(20.4, 10.0, 1.2)], fab="generic-fr4", models=role in MODELS)
    other = once(f"other {spec.models}", lambda folder: make_kit(spec, folder / "tactape-s101"))
    kit = OpenKit(copied(small_kit if spec.models else flat_kit))
    kit.data[role] = OpenKit(other.path).data[role]
    lines = failed(verify_kit(kit.save(consistent=True), quick=True))
    assert lines.keys() - (GUARDS - {role}), lines


def test_an_unchanged_kit_passes(small_kit: Kit, copied: Copy) -> None:
    verification = verify_kit(OpenKit(copied(small_kit)).save(consistent=True))
    assert verification.passed
    assert failed(verification) == {}
    assert "tag by pupil-apriltags" in {c.name for c in verification.checks}


@pytest.mark.parametrize(
    ("edit", "fails", "says"),
    [
        case("pad moved", flashes("copper-top", moved(0.02, 0), 3000), "copper-top places", says="at R1501"),
        case("two places exchanged", rows("cpl", swap_places), "cpl places", says="R3 by"),
        case("designator in the BOM's last row", rows("bom", lambda t: t[-1].__setitem__(0, "R1")), "bom", says="misses R"),
        case("copper mirrored", points("copper-top", mirrored(100.0)), "copper-top pairs", "symbols from copper"),
    ],
)
def test_a_change_in_the_main_job_is_caught(
    edit: Edit, fails: tuple[str, ...], says: str, default_kit: Kit, copied: Copy
) -> None:
    kit = OpenKit(copied(default_kit))
    edit(kit)
    judge(kit, fails, says, consistent=True)


# Kits of another make


@pytest.fixture(scope="module")
def round_kit(tmp_path_factory: pytest.TempPathFactory) -> Kit:
    """JLCPCB's columns, wide corners, no strip."""
    spec = TapeSpec(sector=3, size_mm=(20.0, 20.0), corner_radius_mm=5.0, tag="none", assembly="jlcpcb", models=False)
    return make_kit(spec, tmp_path_factory.mktemp("round") / "tactape-s003")


@BOTH
@pytest.mark.parametrize(
    ("edit", "fails", "says"),
    [
        case("renamed", designators(lambda n: n.__setitem__(PART - 1, "C1")), "bom", says="R10; it has unknown C1"),
        case("dropped", designators(lambda n: n.pop(PART - 1)), "bom", says="misses R10"),
        case("twice", designators(lambda n: n.append("R10")), "bom", says="repeats"),
        case("column renamed", replaced("bom", "Designator", "Refs"), "bom", says="Designator"),
    ],
)
def test_a_change_of_jlcpcbs_bom_is_caught(
    edit: Edit, fails: tuple[str, ...], says: str, consistent: bool, round_kit: Kit, copied: Copy
) -> None:
    kit = OpenKit(copied(round_kit))
    assert b"JLCPCB Part #" in kit.data["bom"]
    edit(kit)
    judge(kit, fails, says, consistent=consistent)


@BOTH
def test_a_smaller_outline_is_caught_with_wide_corners_too(consistent: bool, round_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(round_kit))
    points("profile", lambda p: (p[0] + (0.02 if p[0] < SIDE_MM / 2 else -0.02), p[1]))(kit)
    judge(kit, ("profile",), "", consistent=consistent)


@pytest.fixture(scope="module")
def other_legend(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The legend of the small kit with another tag."""
    spec = TapeSpec(sector=100, size_mm=(20.0, 20.0), holes_mm=[(16.4, 10.0, 1.0)], tag_id=5, models=False)
    kit = make_kit(spec, tmp_path_factory.mktemp("other") / "tactape-s100", verify=False)
    return (kit.path / kit.files["legend-top"]).read_bytes()


DETECTORS = ("tag by OpenCV", *(["tag by pupil-apriltags"] if find_spec("pupil_apriltags") else []))
"""The second one has no wheel for every Python."""


@BOTH
def test_the_legend_of_another_tag_is_caught_by_both_detectors(
    consistent: bool, other_legend: bytes, flat_kit: Kit, copied: Copy
) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.data["legend-top"] = other_legend
    judge(kit, DETECTORS, "legend shows tag 5", consistent=consistent, quick=False)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_tag_is_caught_by_both_detectors(quarters: int, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    turn_tag(quarters)(kit)
    judge(kit, DETECTORS, "turned", consistent=True, quick=False)


# The manifest


def another_sector(kit: OpenKit) -> None:
    """Sector, origin and symbols of another tape, which fit each other."""
    from tactape_fab.kit.examine.tape import examine

    other = examine(TapeSpec(sector=101, size_mm=(20.0, 20.0), holes_mm=[(16.4, 10.0, 1.0)])).layout.tape.to_mapping()
    kit.manifest.update({key: other[key] for key in ("sector", "origin", "symbols")})


MANIFEST_CHANGES = [
    case("one symbol", stated("symbols.1", "SNEWNWNS"), "manifest", says="column 1, row 1: 'N' where the code has 'S'"),
    case("sector", stated("sector", 101), "manifest", says="symbols differ"),
    case("origin", stated("origin", [1200, 1969]), "manifest", says="symbols differ"),
    case("code", stated("code", "debruijn-4x4"), "manifest", says="symbols differ"),
    case("a whole other sector", another_sector, "cpl places", "symbols from CPL", "windows from CPL", "symbols from copper"),
    case("rows", stated("rows", 11), "manifest", says="symbols"),
    case("omitted", stated("omitted", []), "cpl rows", "symbols from CPL", "bom", says="misses R95, R96"),
    case("omitted elsewhere", stated("omitted.0", [5, 5]), "cpl places", "symbols from CPL", "symbols from copper"),
    case("pitch", stated("pitch_mm", 1.51), "cpl places"),
    case("displacement", stated("displacement_mm", 0.26), "cpl places", says="by 10.0 um"),
    case("texture origin", stated("board.texture_origin_mm", [6.92, 18.25]), "cpl places", says="by 20.0 um"),
    case("board's size", stated("board.size_mm", [20.1, 20.0]), "profile", "job"),
    case("corner radius", stated("board.corner_radius_mm", 1.5), "profile"),
    case("hole", stated("board.holes.0", [16.42, 10.0, 1.0]), "drill-npth"),
    case("no hole", stated("board.holes", []), "roles", says="drill-npth"),
    case("rotation", stated("part.rotation_deg", 135.0), "cpl rotation"),
    case("pads", stated("land_pattern.pads.size_mm", [0.48, 0.4]), "copper-top area"),
    case("expansion", stated("land_pattern.opening_expansion_mm", 0.06), "coverlay-top shape"),
    case("tag's id", stated("tag.id", 101), "tag by OpenCV", says="legend shows tag 100, the manifest says 101"),
    case("tag's place", stated("tag.center_mm", [3.1, 3.5]), "tag by OpenCV", says="displaced"),
    case("tag's rotation", stated("tag.rotation_deg", 90.0), "tag by OpenCV"),
    case("tag's cells", stated("tag.cell_mm", 0.6), "tag by OpenCV"),
    case("no tag", stated("tag", None), "roles", says="legend-top"),
    case("no files", stated("files", []), "files", says="lists no files"),
    case("a file not listed", lambda kit: kit.manifest["files"].pop(0), "roles", says="bom 0 times"),
    case("a file listed twice", lambda kit: kit.manifest["files"].append(kit.manifest["files"][0]), "roles", says="bom 2 times"),
    case("a hash", stated("files.1.sha256", "0" * 64), "files", says="cpl.csv is not the file"),
    case("a size", stated("files.1.bytes", 1), "files", says="but the manifest lists 1 bytes"),
    case("a file that is not there", stated("files.1.path", "assembly/x.csv"), "files", says="assembly/x.csv is missing"),
]


@pytest.mark.parametrize(("edit", "fails", "says"), MANIFEST_CHANGES)
def test_a_changed_manifest_is_caught_and_named(
    edit: Edit, fails: tuple[str, ...], says: str, flat_kit: Kit, copied: Copy
) -> None:
    kit = OpenKit(copied(flat_kit))
    edit(kit)
    kit.save(consistent=False)
    lines = failed(verify_kit(kit.folder, quick=True))
    assert set(fails) <= set(lines)
    assert says in lines[fails[0]].message


PINNED_KEYS = (
    *("format", "name", "tool", "sector", "code", "origin", "columns", "rows", "pitch_mm", "displacement_mm", "board", "part"),
    *("fab", "spec", "symbols", "omitted", "tag", "files"),
)


@pytest.mark.parametrize("key", PINNED_KEYS)
def test_a_manifest_without_a_pinned_key_fails(key: str, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    del kit.manifest[key]
    kit.save(consistent=False)
    assert failed(verify_kit(kit.folder, quick=True)).keys() & {"manifest", "files", "roles"}


NUMBERS = (
    *("sector", "columns", "origin.0", "pitch_mm", "displacement_mm", "board.size_mm.0", "board.texture_origin_mm.1"),
    *("board.corner_radius_mm", "board.thickness_mm", "board.holes.0.2", "part.body_mm.2", "part.rotation_deg"),
    *("tag.id", "tag.cell_mm", "tag.center_mm.0", "tag.rotation_deg", "fab.limits_mm.pad-edge", "fab.limits_mm.body-edge"),
    *("land_pattern.pads.offset_mm", "land_pattern.paste.size_mm.1", "land_pattern.opening_expansion_mm"),
)


@pytest.mark.parametrize("path", NUMBERS)
def test_no_number_where_the_manifest_needs_one_fails_by_its_key(path: str, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    key = [key for key in path.split(".") if not key.isdigit()][-1]
    values: tuple[object, ...] = (float("nan"), float("inf"), "1", None, [], True, 10**400)
    for value in values:
        stated(path, value)(kit)
        kit.save(consistent=False)
        lines = failed(verify_kit(kit.folder, quick=True))
        no_json = isinstance(value, float)  # NaN and Infinity, which Python writes
        assert ("is no JSON" if no_json else key) in lines["manifest"].message, value


BAD_MANIFESTS: Mapping[str, Callable[[bytes], bytes]] = {
    "empty": lambda b: b"",
    "cut": lambda b: b[: len(b) // 2],
    "binary": lambda b: b"\x00\xff" * 100,
    "no JSON": lambda b: b"tactape",
    "a list": lambda b: b"[]",
    "a number": lambda b: b"1",
    "nested deep": lambda b: b"[" * 100_000,
    "another format": lambda b: b.replace(b"tactape-manifest/1", b"tactape-manifest/9"),
    "a format that is no text": lambda b: b.replace(b'"tactape-manifest/1"', b"[1]"),
    "a number of 5000 digits": lambda b: b.replace(b'"sector": 100', b'"sector": ' + b"1" * 5000),
}


@pytest.mark.parametrize("change", BAD_MANIFESTS.values(), ids=BAD_MANIFESTS.keys())
def test_an_unreadable_manifest_is_a_failed_line(change: Callable[[bytes], bytes], flat_kit: Kit, copied: Copy) -> None:
    file = copied(flat_kit) / "manifest.json"
    before = file.read_bytes()
    file.write_bytes(change(before))
    assert file.read_bytes() != before
    verification = verify_kit(file.parent, quick=True)
    assert set(failed(verification)) == {"manifest"}
    run = cli("verify", str(file.parent))
    assert run.exit_code == 4
    assert run.stderr.startswith("error: manifest: ")


# Files outside the kit


@pytest.mark.parametrize(
    "path", ["../tactape-s100.gtl", "gerber/../../tactape-s100.gtl", "{outside}", "~/x", "..\\x", "C:\\x", ""]
)
def test_a_path_out_of_the_kit_is_refused(path: str, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    outside = shutil.copy(kit.folder / kit.paths["copper-top"], kit.folder.parent)
    row = next(row for row in kit.manifest["files"] if row["role"] == "copper-top")
    row["path"] = path.format(outside=outside)
    kit.save(consistent=False)
    lines = failed(verify_kit(kit.folder, quick=True))
    assert "names no file inside the kit" in lines["files"].message
    assert "copper-top" in lines["content"].message
    assert cli("verify", str(kit.folder)).exit_code == 4


def _link_file(kit: OpenKit) -> None:
    place = kit.folder / kit.paths["copper-top"]
    place.rename(kit.folder.parent / place.name)
    place.symlink_to(kit.folder.parent / place.name)


def _link_folder(kit: OpenKit) -> None:
    (kit.folder / "gerber").rename(kit.folder.parent / "elsewhere")
    (kit.folder / "gerber").symlink_to("../elsewhere")


@pytest.mark.parametrize("link", [_link_file, _link_folder])
def test_a_link_out_of_the_kit_is_not_followed(link: Edit, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    link(kit)
    lines = failed(verify_kit(kit.folder, quick=True))
    assert "gerber/tactape-s100.gtl leads out of the kit's folder" in lines["files"].message
    assert "copper-top" in lines["content"].message
    assert cli("verify", str(kit.folder)).exit_code == 4


def test_an_unlisted_file_is_a_warning_only(flat_kit: Kit, copied: Copy) -> None:
    folder = copied(flat_kit)
    (folder / "gerber" / "notes.txt").write_text("mine")
    verification = verify_kit(folder, quick=True)
    (line,) = [c for c in verification.checks if c.name == "unlisted"]
    assert (line.passed, line.warning) == (False, True)
    assert "gerber/notes.txt" in line.message
    assert verification.passed
    run = cli("verify", str(folder))
    assert run.exit_code == 0
    assert "warn  unlisted" in run.stdout


# The command line


def cli(*arguments: str) -> Result:
    run = CliRunner().invoke(main, [*arguments, "--quick"])
    assert run.exception is None or isinstance(run.exception, SystemExit), run.exception
    return run


@BOTH
@pytest.mark.parametrize(
    ("edit", "line"),
    [
        (flashes("copper-top", moved(0.02, 0), PADS[0]), "copper-top places"),
        (rows("cpl", swap_rows), "cpl rows"),
        (turn_tag(2), "tag by OpenCV"),
        (bytes_of("paste-top", lambda b: b[:1000]), "paste-top"),
        (members(lambda kit, z: z.update({"x.txt": b"x"})), "fab-zip"),
    ],
    ids=["pad", "CPL", "tag", "paste", "zip"],
)
def test_the_command_exits_with_4_and_names_the_line(
    edit: Edit, line: str, consistent: bool, flat_kit: Kit, copied: Copy
) -> None:
    kit = OpenKit(copied(flat_kit))
    edit(kit)
    run = cli("verify", str(kit.save(consistent=consistent)))
    assert run.exit_code == 4
    assert f"error: {line}: " in run.stderr
    assert f"FAIL  {line} " in run.stdout
    assert "Traceback" not in run.output


def no_constant(name: str) -> None:
    raise AssertionError(f"{name} is no JSON")


@pytest.mark.parametrize(
    ("edit", "status"),
    [
        (lambda kit: None, 0),
        (flashes("copper-top", moved(0.02, 0), PADS[0]), 4),
        (rows("cpl", lambda table: table.__delitem__(slice(1, None))), 4),
    ],
    ids=["unchanged", "a pad moved", "a CPL without rows"],
)
def test_the_json_of_the_command_is_json(edit: Edit, status: int, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    edit(kit)
    run = cli("verify", str(kit.save(consistent=True)), "--json")
    assert run.exit_code == status
    content = json.loads(run.stdout, parse_constant=no_constant)
    assert content["passed"] is (status == 0)
    lines = {c["name"] for c in content["checks"] if c["passed"] is False and not c["warning"]}
    assert lines == set(failed(verify_kit(kit.folder, quick=True)))


def _empty_folder(folder: Path) -> Path:
    (folder / "manifest.json").unlink()
    return folder


def _unfinished(folder: Path) -> Path:
    return folder.rename(folder.with_name(".tactape-s100.x1.partial"))


NO_KITS: Mapping[str, tuple[Callable[[Path], Path], str]] = {
    "no manifest": (_empty_folder, "holds no manifest.json"),
    "missing": (lambda folder: folder / "nothing", "there is no such file"),
    "unfinished": (_unfinished, "unfinished"),
    "manifest of an unfinished one": (lambda folder: _unfinished(folder) / "manifest.json", "unfinished"),
}


@pytest.mark.parametrize(("make", "says"), NO_KITS.values(), ids=NO_KITS.keys())
def test_what_is_no_kit_is_refused_with_2(make: Callable[[Path], Path], says: str, flat_kit: Kit, copied: Copy) -> None:
    path = make(copied(flat_kit))
    with pytest.raises(SpecError, match=says):
        verify_kit(path, quick=True)
    run = cli("verify", str(path))
    assert run.exit_code == 2
    assert says in run.stderr
    assert run.stdout == ""


def test_an_unfinished_folder_is_refused_from_inside(flat_kit: Kit, copied: Copy, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(_unfinished(copied(flat_kit)))
    assert cli("verify", ".").exit_code == 2
