"""Order notes: what they must say, what they must never say, and the figures of their estimate."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.base.errors import Finding
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.artifact import AnyArtifact, Artifact
from tactape_fab.kit.examine.tape import Examined, examine
from tactape_fab.kit.order_facts import OrderFacts, order_facts, panel_order_facts
from tactape_fab.kit.panel.packing import pack_panels
from tactape_fab.kit.profiles import COVERLAY_MODES, FabProfile, load_fab
from tactape_fab.kit.profiles.fabs import BACKING_ROLES
from tactape_fab.kit.render.order_notes import render_order_notes
from tactape_fab.kit.writer import FAB_ZIP_ROLES, RENDERERS
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.layers.order_notes import check_order_notes

FABS = profile_names("fabs")
EVERY = pytest.mark.parametrize("fab", FABS)


@cache
def examined(**values: Any) -> Examined:
    return examine(TapeSpec(**{"sector": 7, "size_mm": (40.0, 30.0), "models": False, **values}))


def files_of(made: Examined) -> list[AnyArtifact]:
    film = [artifact for role in ("cpl", "bom", *BACKING_ROLES) for artifact in RENDERERS[role](made.drawing, made.fab)]
    others = {"fab-zip": "-fab.zip", "preview-png": ".png", "placement-preview": "-placements.svg"}
    return [*film, *(Artifact(role=role, path=made.tape.name + ending, data=b"") for role, ending in others.items())]


def facts_of(made: Examined, fab: FabProfile | None = None, findings: Sequence[Finding] | None = None) -> OrderFacts:
    return order_facts(made.layout, fab or made.fab, made.findings if findings is None else findings, files_of(made))


def notes_of(facts: OrderFacts) -> str:
    (artifact,) = render_order_notes(facts)
    assert (artifact.role, artifact.path) == ("order-notes", f"{facts.tape.name}-order-notes.txt")
    return artifact.data.decode("utf-8")


def flat(text: str) -> str:
    return re.sub(r"\s+", " ", text)


@EVERY
def test_notes_name_files_counts_and_board(fab: str) -> None:
    made = examined(fab=fab)
    text = notes_of(facts_of(made))
    count = made.tape.part_count
    assert all(file.path in text for file in files_of(made))
    assert f"{count} parts" in text and "40 x 30 mm" in text
    assert f"one kind of part, {count} parts in {-(-count // 200)} rows" in flat(text)
    steps = [int(number) for number in re.findall(r"^STEP (\d+)\. [A-Z]", text, re.MULTILINE)]
    assert steps == list(range(1, 11))
    assert re.findall(r"^APPENDIX (.)", text, re.MULTILINE) == ["A", "B", "C"]
    assert "None" not in text and "{{" not in text and max(map(len, text.split("\n"))) < 260
    assert "\t" not in text and not re.search(r"\n{3}", text) and text.endswith("\n") and " \n" not in text


@EVERY
def test_every_assumption_of_the_estimate_is_shown_with_its_source(fab: str) -> None:
    profile = load_fab(fab)
    text = notes_of(facts_of(examined(fab=fab)))
    order = profile.order
    known = [figure for figure in (order.board, order.attrition, order.reel) if figure is not None]
    given = [*order.costs.values(), order.placement, *known]
    for assumption in given:
        assert f"{assumption.value:g}" in text and f"{assumption.least:g}" in text
        assert f"{assumption.origin.source}, {assumption.origin.date}" in text
    assert text.count(", unconfirmed") == len(given) == 9
    assert "bare board unknown" in text and "no figure of it has a source" in text


@EVERY
def test_every_unconfirmed_limit_in_play_is_asked_about(fab: str) -> None:
    made = examined(fab=fab)
    asked = [f for f in made.findings if f.source and not f.confirmed]
    assert len(asked) >= 5
    text = notes_of(facts_of(made))
    for finding in asked:
        assert f"{finding.rule}: {finding.message}" in text
        assert f"{finding.source}, 20" in text
    asking = text[text.index("STEP 10.") : text.index("APPENDIX A")]
    close = re.findall(r"^   - ([a-z-]+): ", asking, re.MULTILINE)
    assert close and set(close) < {finding.rule for finding in asked}
    assert all(f.value < 1.25 * f.limit for f in asked if f.rule in close and f.value is not None and f.limit is not None)


def test_confirmed_limits_are_not_asked_about() -> None:
    made = examined()
    findings = [replace(finding, confirmed=finding.rule != "pad-edge") for finding in made.findings]
    assert [q.rule for q in facts_of(made, findings=findings).questions] == ["pad-edge"]


def test_a_range_is_a_range_and_what_is_not_known_is_said() -> None:
    made = examined()
    order = made.fab.order
    board = replace(order.costs["setup"], value=30.0, least=10.0)
    known = replace(order, board=board, attrition=None, reel=None)
    facts = facts_of(made, replace(made.fab, order=known))
    five = next(quantity for quantity in facts.estimate.quantities if quantity.count == 5)
    fixture = order.costs["fixture"]
    assert five.cost[1] - five.cost[0] == pytest.approx(fixture.value - fixture.least) and fixture.least == 0.0
    assert five.boards == (50.0, 150.0) and five.parts is None
    text = notes_of(facts)
    assert "bare board USD 50.00 to 150.00" in text and "no figure of it has a source" not in text and " reels" not in text


@pytest.mark.parametrize("size_mm", [(40.0, 30.0), (100.0, 50.0), (26.0, 60.0), (30.0, 14.0)])
@pytest.mark.parametrize("name", [None, "a-name-of-a-tape-that-fills-the-strip"])
def test_where_the_fab_may_print_there_is_no_ink_and_no_part(size_mm: tuple[float, float], name: str | None) -> None:
    made = examined(size_mm=size_mm, name=name)
    layout, area = made.layout, facts_of(made).number_mm
    ink = shapely.union_all(
        [
            *(shapely.Polygon(a) for a in layout.legend.areas_mm),
            *(shapely.LineString(s).buffer(layout.legend.line_mm / 2) for s in layout.legend.strokes_mm),
        ]
    )
    if area is None:
        bands = shapely.box(0.5, (low := np.arange(0.3, size_mm[1] - 2.9, 0.1)), 5.5, low + 2.6)
        assert (shapely.distance(bands, ink) == 0.0).all()
        return
    box = shapely.box(*area)
    parts = shapely.union_all(shapely.polygons(layout.openings.xy_mm[:, None] + layout.openings.outline_mm))
    assert box.distance(ink) >= 0.3
    assert box.distance(parts) >= 0.3
    assert shapely.box(0, 0, *size_mm).contains(box)
    assert f"x {area[0]:.1f} to {area[2]:.1f} mm, y {area[1]:.1f} to {area[3]:.1f} mm" in notes_of(facts_of(made))


@pytest.mark.parametrize("hole", [(3.0, 40.0, 2.0), (6.4, 35.0, 2.0), (0.9, 38.0, 0.5)])
def test_where_the_fab_may_print_there_is_no_hole(hole: tuple[float, float, float]) -> None:
    free = facts_of(examined(size_mm=(50.0, 60.0), name="a", tag_id=7)).number_mm
    area = facts_of(examined(size_mm=(50.0, 60.0), name="a", tag_id=7, holes_mm=(hole,))).number_mm
    assert free is not None and area is not None
    cut = shapely.Point(hole[:2]).buffer(hole[2] / 2)
    assert shapely.box(*free).distance(cut) < 0.5 <= shapely.box(*area).distance(cut) + 1e-3


def test_without_a_strip_the_fab_may_print_nowhere() -> None:
    facts = facts_of(examined(tag="none"))
    assert facts.number_mm is None
    assert "this board has no room for one" in notes_of(facts)


@pytest.mark.parametrize(("fab", "label"), [("generic-fpc", "legend"), ("generic-fr4", "legend"), ("pcbway-fpc", "Silkscreen")])
def test_no_legend_is_ordered_where_none_is_drawn(fab: str, label: str) -> None:
    bare, none = examined(fab=fab, tag="none"), rf"(?i) {label} +none\s"
    assert re.search(none, notes_of(facts_of(bare)))
    assert re.search(none, packed_notes([bare]))
    assert not re.search(none, packed_notes([bare, examined(fab=fab)]))


@EVERY
def test_the_field_holds_every_opening(fab: str) -> None:
    made = examined(fab=fab)
    low, high = np.reshape(facts_of(made).field_mm, (2, 2))
    window = made.layout.window_mm
    corners = (made.layout.openings.xy_mm[:, None] + made.layout.openings.outline_mm).reshape(-1, 2)
    corners = corners if window is None else np.concatenate([corners, window])
    assert (corners >= low).all() and (corners <= high).all()
    assert np.abs(corners.min(axis=0) - low).max() <= 0.1 and np.abs(corners.max(axis=0) - high).max() <= 0.1


@pytest.mark.parametrize(
    ("rotation_deg", "slash"), [(45.0, "/"), (225.0, "/"), (135.0, "\\"), (315.0, "\\"), (0.0, "-"), (180.0, "-"), (90.0, "|")]
)
def test_how_a_part_leans(rotation_deg: float, slash: str) -> None:
    made = examined(rotation_deg=rotation_deg, pitch_mm=2.5)
    text = notes_of(facts_of(made))
    assert f"every part leans like this: {slash}\n" in text and f"all leaning like {slash};" in text


@pytest.mark.parametrize(
    ("profile", "rigid", "material", "rows"),
    [
        ("generic-fpc", False, 'base = "PET"', ("board flexible, PET",)),
        ("jlcpcb-fpc", False, 'base = "PET"', ("Base Material Flex, PET",)),
        ("pcbway-fpc", False, 'base = "PET"', ("Product FPC", "Material PET flex")),
        ("generic-fpc", True, 'base = "FR4"', ("board rigid, FR4",)),
        ("jlcpcb-fpc", True, 'base = "FR4"', ("Base Material FR-4",)),
        ("pcbway-fpc", True, 'base = "FR4"', ("Material FR-4",)),
        ("generic-fr4", True, 'base = "CEM-1  äö"', ("board rigid, CEM-1 äö",)),
        ("generic-fpc", False, 'finish = "Löt  Zinn"', ("surface finish Löt Zinn",)),
    ],
)
def test_the_board_is_that_of_the_profile(
    profile: str, rigid: bool, material: str, rows: tuple[str, ...], tmp_path: Path
) -> None:
    bend = 'bend = "none"\n' if rigid else ""
    (tmp_path / "own.toml").write_text(f'extends = "{profile}"\n{bend}[material]\n{material}\n', encoding="utf-8")
    spec = TapeSpec(sector=7, size_mm=(40.0, 30.0), fab=str(tmp_path / "own.toml"), models=False)
    kit = make_kit(spec, tmp_path / "kit")  # verified
    text = flat((kit.path / kit.files["order-notes"]).read_text(encoding="utf-8"))
    assert all(f" {row} " in text for row in rows)
    assert ("A carrier for assembly" in text) != rigid


@EVERY
def test_what_is_laminated_and_anchored_is_said(fab: str) -> None:
    facts = facts_of(examined(fab=fab))
    flex = facts.fab.material.base == "polyimide"
    plain = notes_of(facts)
    assert "Stiffener FR4" not in plain and "Adhesive 3M" not in plain and "Copper runs on" not in plain
    assert ("Isolated pads can peel" in plain) == ("A carrier for assembly" in plain) == flex
    files = {**facts.files, "stiffener-bottom": "gerber/s.gbr", "adhesive-bottom": "gerber/a.gbr"}
    mask = facts.fab.mask_name
    text = notes_of(replace(facts, stiffener="FR4 0.2", adhesive="3M468 0.13", anchors="mesh", files=files))
    assert "Stiffener FR4 0.2 mm on the underside, where gerber/s.gbr has it" in text
    assert "Adhesive 3M468 0.13 mm on the underside, below the stiffener, with its liner on, where gerber/a.gbr" in flat(text)
    assert f"Copper runs on from the pads under the {mask} (mesh)" in text
    assert "A carrier for assembly" not in text and "Isolated pads" not in text
    assert len(re.findall(r"FR4 0\.2 mm", text)) == (2 if flex else 1)


def test_each_way_to_open_the_coverlay_is_asked_for() -> None:
    facts = facts_of(examined())
    said = {mode: flat(notes_of(replace(facts, fab=facts.fab.in_mode(mode)))) for mode in COVERLAY_MODES}
    assert "The coverlay is cut for each part: one opening of 1.2 x 0.5 mm for both pads" in said["per-part"]
    assert "The solder mask is photo-imageable, one opening of 1.2 x 0.5 mm" in said["lpi"]
    assert "one opening over the whole field of parts, drawn so on purpose" in said["gang"]
    assert len(set(said.values())) == 3
    assert "The coverlay has one opening over" in said["gang"]
    assert "The solder mask has one opening over" in flat(notes_of(facts_of(examined(fab="generic-fr4", coverlay="gang"))))


@pytest.mark.parametrize(
    ("fab", "between", "bare"),
    [("generic-fpc", "coverlay", "film"), ("generic-lpi", "solder mask", "film"), ("jlcpcb-fr4", "solder mask", "laminate")],
)
def test_the_preview_shows_what_the_board_is_made_of(fab: str, between: str, bare: str) -> None:
    assert f"an opening for each part, and {between} between them: none merged" in notes_of(facts_of(examined(fab=fab)))
    gang = notes_of(facts_of(examined(fab=fab, coverlay="gang")))
    assert f"one opening over all parts of a tape, with bare {bare} between the pads" in gang


def test_a_forced_tape_says_so_and_a_sound_one_does_not() -> None:
    assert "FORCED" not in notes_of(facts_of(examined()))
    made = examined(displacement_mm=0.45)
    broken = [f for f in made.findings if f.blocks]
    assert broken
    text = notes_of(facts_of(made))
    assert "!! FORCED !!" in text
    assert all(f"- {f.rule}: {f.message}" in text for f in broken)


def test_a_board_that_fits_the_line_needs_no_panel() -> None:
    assert "please panelise it" in notes_of(facts_of(examined(size_mm=(100.0, 50.0))))
    assert "please panelise it" not in notes_of(facts_of(examined(size_mm=(100.0, 80.0), pitch_mm=4.0)))
    # no panel makes it shorter
    assert "please panelise it" not in (long := notes_of(facts_of(examined(size_mm=(251.0, 80.0), pitch_mm=4.0))))
    assert "Do you place its parts all the same" in long


def packed_notes(tapes: list[Examined]) -> str:
    """The notes of a panel packed of some tapes, on one line."""
    _, (packed,) = pack_panels([(tape.tape.board.size_mm, 1.0) for tape in tapes], tapes[0].fab)
    layouts = [tapes[i].layout for i in packed.tapes]
    facts = panel_order_facts("panel", packed.panel, layouts, tapes[0].fab, tapes[0].findings, files_of(tapes[0]))
    (artifact,) = render_order_notes(facts)
    return flat(artifact.data.decode("utf-8"))


@pytest.mark.parametrize(
    ("other", "designs"),
    [
        ({"name": "copy"}, 1),
        ({"sector": 8}, 2),
        ({"size_mm": (50.0, 30.0)}, 2),
        ({"pitch_mm": 1.8, "displacement_mm": 0.25}, 2),
        ({"holes_mm": ((30.0, 15.0, 1.0),)}, 2),
        ({"coverlay": "gang"}, 2),
    ],
)
def test_tapes_of_one_sector_that_differ_otherwise_are_different_designs(other: dict[str, Any], designs: int) -> None:
    usual: dict[str, Any] = {"fab": "jlcpcb-fpc", "pitch_mm": 2.1, "displacement_mm": 0.25}
    tapes = [examined(**{**usual, **more}) for more in ({}, other)]
    assert f"Different Design {designs} " in packed_notes(tapes)


def test_a_panel_s_corners_are_those_of_its_own_outline() -> None:
    round_one = examined(corner_radius_mm=3.0, tag="none")
    assert " mm, corner radius 1 mm " in packed_notes([round_one])
    assert "30 mm, corner radius 3 mm\n" in notes_of(facts_of(round_one))


@pytest.mark.parametrize(("anchors", "some"), [(("none", "mesh"), True), (("spur", "mesh"), False)])
def test_pads_that_nothing_holds_on_one_tape_of_a_panel_are_asked_about(anchors: tuple[str, ...], some: bool) -> None:
    tapes = [examined(sector=k, anchor=anchor, pitch_mm=1.8, displacement_mm=0.25) for k, anchor in enumerate(anchors)]
    said = packed_notes(tapes)
    assert f"Copper runs on from {'some' if some else 'the'} pads" in said
    assert ("Isolated pads can peel off" in said) == some


@pytest.mark.parametrize(("rotation_deg", "words"), [(45.0, "45 135 / \\"), (315.0, "315 45 \\ /"), (270.0, "270 0 | -")])
def test_parts_of_turned_tapes_are_turned_as_the_list_has_them(rotation_deg: float, words: str) -> None:
    sizes_mm = ((200.0, 30.0), (30.0, 200.0))
    tapes = [examined(sector=k, size_mm=size_mm, rotation_deg=rotation_deg) for k, size_mm in enumerate(sizes_mm)]
    first, second, lean, lean_turned = words.split()
    said = packed_notes(tapes)
    assert f"all on top, turned {first} deg counter-clockwise, on tapes that lie turned {second} deg: seen" in said
    assert f"every part leans like this: {lean} or, on turned tapes, {lean_turned}" in said


@pytest.mark.parametrize("fab", ["generic-fpc", "jlcpcb-fpc", "jlcpcb-fr4", "pcbway-fpc", "pcbway-fr4"])
@pytest.mark.parametrize(
    ("size_mm", "panelised", "asked"),
    [
        ((100.0, 50.0), True, False),  # too small alone
        ((236.0, 50.0), True, False),  # 250 mm with rails and slots
        ((236.1, 50.0), False, True),  # too narrow alone, too long with rails
        ((50.0, 260.0), False, True),  # too long alone
        ((100.0, 80.0), False, False),
    ],
)
def test_no_fab_is_asked_to_panelise_what_its_line_takes_on_no_panel(
    fab: str, size_mm: tuple[float, float], panelised: bool, asked: bool
) -> None:
    text = notes_of(facts_of(examined(fab=fab, size_mm=size_mm, tag="none")))
    assert ("please panelise it" in text) == ("as the remark of step 8 says" in text) == panelised
    assert (re.search(r"[Ss]ingle (pieces|PCB)", text) is not None) == (not panelised)
    assert ("Do you place its parts all the same" in text) == asked
    if asked:
        assert f"This board of {size_mm[0]:g} x {size_mm[1]:g} mm is outside that" in text


@pytest.mark.parametrize(("part", "why"), [("r0201", " (Economic takes no 0201)"), ("r0402", "")])
def test_why_assembly_is_standard_is_said_of_the_part_that_is_placed(part: str, why: str) -> None:
    text = notes_of(facts_of(examined(fab="jlcpcb-fpc", part=part, pitch_mm=2.2, displacement_mm=0.3)))
    assert re.search(rf"^   PCB Assembly +yes, Standard{re.escape(why)}$", text, re.MULTILINE)


@pytest.mark.parametrize(
    ("backings", "through"),
    [
        ({}, ""),
        ({"stiffener": "FR4 0.2"}, "stiffener as well, whose layer shows"),
        ({"adhesive": "3M468 0.13"}, "adhesive as well, whose layer shows"),
        ({"stiffener": "FR4 0.2", "adhesive": "3M468 0.13"}, "stiffener and adhesive as well, whose layers show"),
    ],
)
def test_holes_are_said_to_go_through_what_is_laminated_below(backings: dict[str, str], through: str) -> None:
    plain, drilled = (examined(holes_mm=holes_mm, **backings) for holes_mm in ((), ((25.0, 15.0, 2.0),)))
    assert "go through" not in notes_of(facts_of(plain))
    said = flat(notes_of(facts_of(drilled)))
    assert (f"The holes of the drill file go through {through} the outline alone." in said) == bool(through)
    # tooling holes of the rails have nothing below them
    assert "go through" not in packed_notes([plain])
    assert ("The holes of the drill file in tapes go through" in packed_notes([plain, drilled])) == bool(through)


def test_more_parts_than_a_line_takes_are_said() -> None:
    few, many = examined(size_mm=(20.0, 20.0), pitch_mm=2.0), examined()
    assert few.tape.part_count <= 300 < many.tape.part_count
    assert "more than 300" not in notes_of(facts_of(few))
    assert f"part-count: {many.tape.part_count} parts, more than 300" in notes_of(facts_of(many))


@pytest.mark.parametrize("house", ASSEMBLY_FORMATS)
def test_the_part_number_and_the_list_s_conventions_are_said(house: str) -> None:
    number = "C123" if house == "jlcpcb" else "RC0201-7"
    text = notes_of(facts_of(examined(assembly=house, part_number=number)))
    assert f"number {number}." in text
    turn = "mil, clockwise" if house == "macrofab" else "mm, counter-clockwise"
    assert f"format {house}: {turn}" in text
    assert "no part number is given" in notes_of(facts_of(examined(assembly=house)))


def test_the_profile_s_part_number_has_its_date_and_another_has_none() -> None:
    order = load_fab("jlcpcb-fpc").order
    assert order.number is not None
    text = notes_of(facts_of(examined(fab="jlcpcb-fpc", part_number=order.number.number)))
    assert order.number.names in text and f"as of {order.number.origin.date}" in text and "it is not confirmed" in text
    assert "as of 2" not in notes_of(facts_of(examined(fab="jlcpcb-fpc", part_number="C1")))


def test_files_that_a_profile_s_words_name_are_no_files_of_the_kit(default_kit: Kit) -> None:
    folder, paths = default_kit.path, default_kit.files
    files = {role: WrittenFile(path=path, data=(folder / path).read_bytes()) for role, path in paths.items()}
    data = files["order-notes"].data.replace(
        b"smallest coverlay bridge", b"see quote-4711.zip, only in the strip, x 9.0 to 9.9 mm"
    )
    assert data != files["order-notes"].data
    assert check_order_notes({**files, "order-notes": replace(files["order-notes"], data=data)}, default_kit.tape).passed


def test_a_profile_s_own_words_stay_in_their_line() -> None:
    made = examined()
    text = notes_of(facts_of(made, replace(made.fab, title="Fabrik S\u00fcd\n\nSTEP 2. THE BOARD:\x1b[31m {{ tape }}")))
    assert (
        f"ORDER NOTES: {made.tape.name} at Fabrik S\u00fcd STEP 2. THE BOARD: [31m {{{{ tape }}}} (profile generic-fpc)\n" in text
    )


def test_notes_are_the_same_bytes_again() -> None:
    assert render_order_notes(facts_of(examined())) == render_order_notes(facts_of(examined()))


def test_notes_stand_in_the_kit_and_never_in_the_zip(small_kit: Kit) -> None:
    assert "order-notes" not in FAB_ZIP_ROLES
    text = (small_kit.path / small_kit.files["order-notes"]).read_text("utf-8")
    with zipfile.ZipFile(small_kit.path / small_kit.files["fab-zip"]) as archive:
        assert not [name for name in archive.namelist() if name.endswith(".txt")]
    assert f"{small_kit.tape.name} at " in text
    assert "order-notes" in {check.name for check in small_kit.checks}


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (r"\d+ parts", "12 parts", "they lack '\\d+ parts'"),
        (r"100 x 50 mm", "100 x 51 mm", "they lack '100 x 50 mm'"),
        (r"tactape-s007 at", "tactape-s008 at", "they lack 'tactape-s007 at '"),
        (r"\S+-fab\.zip", "other-fab.zip", "they name other-fab.zip, which is not in the kit"),
        (r"assembly/\S+-cpl\.csv", "the list", "they lack 'assembly/tactape-s007-cpl.csv'"),
        (r"only in the strip at the left end", "anywhere", "do not say where the fab may print"),
        (r"(left end, x \d+\.\d) to \d+\.\d", r"\1 to 9.0", "on parts, ink or holes, or off the board"),
        (r"(left end, .*?to) \d+\.\d mm;", r"\1 99.0 mm;", "on parts, ink or holes, or off the board"),
        (r"(left end, .*? y )\d+\.\d", r"\g<1>2.0", "on parts, ink or holes, or off the board"),
        (r"ORDER", "\u00d6RDER", "not UTF-8"),
    ],
)
def test_verify_reads_the_notes(old: str, new: str, says: str, default_kit: Kit) -> None:
    files = {
        role: WrittenFile(path=path, data=(default_kit.path / path).read_bytes()) for role, path in default_kit.files.items()
    }
    assert check_order_notes(files, default_kit.tape).passed
    text = re.sub(old, new, files["order-notes"].data.decode("utf-8"), flags=re.DOTALL if "left end" in old else 0)
    data = text.encode("latin-1" if "\u00d6" in text else "utf-8")
    assert data != files["order-notes"].data
    check = check_order_notes({**files, "order-notes": replace(files["order-notes"], data=data)}, default_kit.tape)
    assert not check.passed
    assert re.search(says, check.message)
