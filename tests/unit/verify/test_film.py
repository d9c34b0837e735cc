"""The files of a film and what is looked at in them: a right one passes, and one change of a file or a call fails."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tactape_fab import Kit
from tactape_fab.base.errors import Check
from tactape_fab.base.fields import Fields
from tactape_fab.kit.read.gerber_file import GerberContent, ReadbackError
from tactape_fab.verify import film
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.film import (
    FILE_FUNCTIONS,
    REQUIRED_ATTRIBUTES,
    FilmLayers,
    anchor_lines,
    check_attributes,
    check_tape,
    pair_all_lands,
    read_film_manifest,
    read_layers,
    read_role,
)
from tests.tapes import tape_at

TAPE = tape_at(7, (6, 5))
PADS, PASTE = SimpleNamespace(offset_mm=0.32), SimpleNamespace(offset_mm=0.30)
BACKINGS = {"stiffener-bottom": "FR4 0.2"}
ALL = (*FILE_FUNCTIONS, *BACKINGS)


def record(**said: Any) -> Any:
    """A manifest's record of a film; `film` are changes of its optional features."""
    optional = {"mode": "each", "anchor": None, "backings": BACKINGS, "job_in_zip": True} | said.pop("film", {})
    usual = {
        **{"lands": SimpleNamespace(pads=PADS, paste=PASTE), "film": SimpleNamespace(**optional), "x2": "full"},
        **{"assembly": SimpleNamespace(value="0R", footprint="R_0201"), "legend_is_light": True, "legend": "legend"},
        **{"limits_mm": {"trace": 0.1}, "order": None, "paths": {}, "names_known": False},
    }
    return SimpleNamespace(**usual | said)


def content(role: str, **said: Any) -> GerberContent:
    function, polarity = FILE_FUNCTIONS.get(role, ("Other,Stiffener_Bottom_FR4_0.2mm", "Positive"))
    usual: dict[str, Any] = {
        **{"flash_xy_mm": np.array([(1.0, 2.0), (3.0, 4.0), (5.0, 6.0)]), "flash_aperture": np.array([0, 1, 1])},
        **{"aperture_outlines_mm": (), "areas_mm": (), "strokes_mm": (), "stroke_width_mm": np.empty(0), "clear": False},
        **{"aperture_functions": ("SMDPad,CuDef", "SMDPad,CuDef"), "flash_component": ("R3", "R1", "R2")},
        **{"flash_pin": ("", "1", "1")},
        "file_attributes": {"FileFunction": tuple(function.split(",")), "FilePolarity": (polarity,)},
    }
    return GerberContent(**usual | said)


def text_of(role: str, *, start: str = "%TF.", end: str = "*%\n", more: str = "", origin: str = "kit-7") -> bytes:
    """The statements of a file that its attributes are looked for in, with a right signature."""
    function, polarity = FILE_FUNCTIONS.get(role, ("Other,Stiffener_Bottom_FR4_0.2mm", "Positive"))
    said = {"Part": "Single", "FileFunction": function, "FilePolarity": polarity, "SameCoordinates": origin}
    text = "".join(f"{start}{key},{value}{end}" for key, value in said.items()) + more
    digest = hashlib.md5(text.replace("\n", "").encode(), usedforsecurity=False).hexdigest()
    return f"{text}{start}MD5,{digest}{end}M02*\n".encode()


def files_of(**changed: bytes) -> dict[str, WrittenFile]:
    data = {role: text_of(role) for role in ALL} | {"drill-npth": b"; #@! TF.Part,Single\nM48\n"}
    data |= {role.replace("_", "-"): value for role, value in changed.items()}
    return {role: WrittenFile(path=f"gerber/{role}", data=value) for role, value in data.items()}


def layers_of(**changed: GerberContent) -> dict[str, GerberContent]:
    return {role: content(role) for role in ALL} | {role.replace("_", "-"): value for role, value in changed.items()}


# Attributes


def attributes(gerbers: Any = None, said: Any = None, **files: Any) -> Check:
    return check_attributes(layers_of() if gerbers is None else gerbers, files_of(**files), record() if said is None else said)


def test_right_attributes_pass() -> None:
    found = attributes()
    assert (found.name, found.passed) == ("attributes", True)
    assert found.message == "names and file functions as the roles, MD5 signatures right"


@pytest.mark.parametrize("name", REQUIRED_ATTRIBUTES)
@pytest.mark.parametrize("mode", ["full", "comments"])
def test_each_attribute_is_there_in_the_form_of_the_kit(name: str, mode: str) -> None:
    """Of the component layer they are always statements (Gerber 2024.05 section 5.6)."""
    start, end = {"full": ("%TF.", "*%\n"), "comments": ("G04 #@! TF.", "*\n")}[mode]
    whole = {role.replace("-", "_"): text_of(role, start=start, end=end) for role in ALL if role != "components-top"}
    assert attributes(said=record(x2=mode), **whole).passed
    lacking = whole | {"paste_top": whole["paste_top"].replace(f"{start}{name}".encode(), b"G04 TF.Other")}
    found = attributes(said=record(x2=mode), **lacking)
    assert not found.passed and f"paste-top has no .{name}" in found.message
    other = {"full": "G04 #@! TF.", "comments": "%TF."}[mode]
    assert not attributes(said=record(x2=mode), **whole | {"profile": text_of("profile", start=other)}).passed
    bare = text_of("components-top").replace(f"%TF.{name}".encode(), b"G04 TF.Other")
    assert f"components-top has no .{name}" in attributes(said=record(x2=mode), **whole, components_top=bare).message


def test_a_kit_without_attributes_needs_none_but_in_its_component_layer() -> None:
    nothing = {role.replace("-", "_"): b"M02*\n" for role in ALL if role != "components-top"}
    bare = {role: content(role, file_attributes={}) for role in ALL}
    assert attributes(bare, record(x2="none"), **nothing).passed
    assert not attributes(bare, record(x2="none"), **nothing, components_top=b"M02*\n").passed


def test_each_signature_fits_its_file() -> None:
    found = attributes(paste_top=text_of("paste-top").replace(b"Paste", b"Pasta"))
    assert not found.passed and "paste-top: its .MD5 signature does not fit its content" in found.message


@pytest.mark.parametrize("role", ["copper-top", "drill-npth"])
def test_every_file_is_of_one_part_without_nets(role: str) -> None:
    key, whole = role.replace("-", "_"), files_of()[role].data
    panel = attributes(**{key: whole.replace(b"Part,Single", b"Part,Array")})
    assert not panel.passed and f"{role} has .Part 'Array', not Single" in panel.message
    net = attributes(**{key: whole + b"%TO.N,GND*%\n"})
    assert not net.passed and f"{role} has a net 'GND'" in net.message
    assert attributes(**{key: whole + b"%TO.N,N/C*%\n"}).passed


def test_files_have_the_names_that_their_fab_tells_layers_by() -> None:
    paths = {role: f"gerber/{role}" for role in ALL}
    assert attributes(said=record(paths=paths, names_known=True)).passed
    of_other = {**paths, "copper-top": "gerber/paste-top", "paste-top": "gerber/copper-top"}
    for known in (False, True):
        found = attributes(said=record(paths=of_other, names_known=known))
        assert not found.passed and "copper-top has the name of paste-top, gerber/copper-top" in found.message
    own = {**paths, "copper-top": "gerber/t.gtl"}
    assert attributes(said=record(paths=own)).passed
    assert (
        "copper-top is named gerber/copper-top, not gerber/t.gtl" in attributes(said=record(paths=own, names_known=True)).message
    )


@pytest.mark.parametrize(("fab", "known"), [("generic-fpc", True), ("my-fab.toml", False)])
def test_names_are_those_of_the_profile_where_it_is_the_packages(fab: str, known: bool, flat_kit: Kit) -> None:
    manifest = json.loads((flat_kit.path / "manifest.json").read_bytes())
    manifest["spec"]["fab"] = fab
    found = read_film_manifest(Fields(manifest))
    assert found.names_known is known and flat_kit.files.items() >= {r: found.paths[r] for r in FILE_FUNCTIONS}.items()


def test_a_part_of_the_panel_may_be_asked_for() -> None:
    files = {role: WrittenFile(path=role, data=b"%TF.Part,Array*%\n") for role in ("paste-top", "drill-npth")}
    gerbers, said = {"paste-top": content("paste-top")}, record(x2="none")
    assert check_attributes(gerbers, files, said, "Array").passed
    assert not check_attributes(gerbers, files, said).passed
    del files["drill-npth"]
    assert check_attributes(gerbers, files, said, "Array").passed


@pytest.mark.parametrize("role", ALL)
def test_function_and_polarity_are_those_of_the_role(role: str) -> None:
    right = content(role).file_attributes
    for attribute, wrong in (("FileFunction", ("Copper", "L2", "Bot")), ("FilePolarity", ("Neutral",))):
        gerbers = layers_of() | {role: content(role, file_attributes=right | {attribute: wrong})}
        found = attributes(gerbers)
        expected = ",".join(right[attribute])
        assert not found.passed and f"{role} has .{attribute} {','.join(wrong)}, not {expected}" in found.message


def test_all_layers_have_one_origin() -> None:
    found = attributes(profile=text_of("profile", origin="kit-8"))
    assert not found.passed and found.message == "the layers have different .SameCoordinates"


def test_each_pad_of_a_part_says_which_and_a_panels_fiducials_need_not() -> None:
    nameless = content("copper-top", flash_component=("R3", "R1", ""))
    found = attributes(layers_of(copper_top=nameless))
    assert not found.passed and found.message == "copper-top has pads without .P"
    assert attributes(layers_of(paste_top=content("paste-top", flash_component=("", "R1", "")))).passed
    comments = {role.replace("-", "_"): text_of(role, start="G04 #@! TF.", end="*\n") for role in ALL if role != "components-top"}
    assert "pads without .P" in attributes(layers_of(copper_top=nameless), record(x2="comments"), **comments).message
    mark = content("copper-top", aperture_functions=("FiducialPad,Global", "SMDPad,CuDef"), flash_component=("", "R1", "R2"))
    said = "copper-top has pads of function 'FiducialPad,Global'"
    for gerbers in ({"copper-top": mark}, {"copper-top": replace(mark, flash_component=("R3", "R1", "R2"))}):
        assert said in check_attributes(gerbers, files_of(), record()).message
    assert said not in check_attributes({"copper-top": mark}, files_of(), record(), "Array").message


# Reading


def refuse(data: bytes) -> GerberContent:
    if data.startswith(b"bad"):
        raise ReadbackError("no end")
    return content("paste-top", flash_component=(data.decode(),))


def test_a_file_that_cannot_be_read_is_a_failed_line(monkeypatch: pytest.MonkeyPatch) -> None:
    checks: list[Check] = []
    files = {role: WrittenFile(path=f"g/{role}", data=role.encode()) for role in ("copper-top", "profile", "stiffener-bottom")}
    assert read_role("copper-top", len, files, checks) == len("copper-top") and checks == []
    monkeypatch.setattr(film, "read_gerber", refuse)
    monkeypatch.setattr(film, "read_drill", lambda data: np.array([(1.0, 2.0, float(len(data)))]))
    found = read_layers(files, None, record().film, checks)
    assert {role: layer.flash_component for role, layer in found.gerbers.items()} == {role: (role,) for role in files}
    assert found.holes is None and found.cpl is None and checks == []
    broken = files | {"profile": WrittenFile(path="g/p", data=b"bad"), "drill-npth": WrittenFile(path="g/d", data=b"abc")}
    cpl: Any = object()
    found = read_layers(broken, cpl, record().film, checks)
    assert set(found.gerbers) == {"copper-top", "stiffener-bottom"} and found.cpl is cpl
    assert found.holes is not None and found.holes.tolist() == [[1.0, 2.0, 3.0]]
    assert [(c.name, c.passed, c.message) for c in checks] == [("profile", False, "g/p: no end")]


def test_light_ink_is_any_but_black_and_limits_are_the_manifest_s(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("read_recorded", "read_assembly", "read_legend_record", "read_fab_order"):
        monkeypatch.setattr(film, name, lambda table, name=name: name)
    optional = SimpleNamespace(backings=BACKINGS)
    monkeypatch.setattr(film, "read_film_record", lambda table: optional)
    for colour, light in (("white", True), ("black", False)):
        table = Fields({"spec": {"x2": "comments"}, "fab": {"legend_colour": colour, "limits_mm": {"trace": 0.1}}})
        found: Any = read_film_manifest(table)
        assert (found.x2, found.legend_is_light, dict(found.limits_mm)) == ("comments", light, {"trace": 0.1})
        assert (found.lands, found.assembly, found.film) == ("read_recorded", "read_assembly", optional)
        assert (found.legend, found.order) == ("read_legend_record", "read_fab_order")


def test_pads_and_stencil_are_paired_by_their_own_offsets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "pair_lands", lambda *of: of)
    gerbers = layers_of()
    found: dict[str, Any] = dict(pair_all_lands(FilmLayers(gerbers=gerbers, holes=None, cpl=None), record().lands, TAPE))
    assert set(found) == {"copper-top", "paste-top"}
    for role, offset_mm in (("copper-top", 0.32), ("paste-top", 0.30)):
        assert found[role][0] is gerbers[role].flash_xy_mm and found[role][1:] == (offset_mm, 45.0)
    del gerbers["copper-top"]
    assert set(pair_all_lands(FilmLayers(gerbers=gerbers, holes=None, cpl=None), record().lands, TAPE)) == {"paste-top"}


def test_anchor_lines_are_those_of_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    lines, width_mm = anchor_lines(record(), TAPE)
    assert lines.shape == (0, 2, 2) and width_mm == 0.0
    built = np.ones((3, 2, 2))
    monkeypatch.setattr(film, "build_anchors", lambda plan, tape, pads: SimpleNamespace(lines_mm=built))
    lines, width_mm = anchor_lines(record(film={"anchor": SimpleNamespace(web_mm=0.15)}), TAPE)
    assert lines is built and width_mm == 0.15


# Which checks are made: each by its name and by what it is told

MANY = ("check_lands", "check_window", "check_openings", "check_edges", "check_anchors", "check_symbols", "check_tag")
ONE = ("check_drill", "check_backing", "check_components", "check_part_data", "check_legend_clear", "check_label")
CPL = SimpleNamespace(xy_mm=np.array([(1.0, 2.0)]))
ANCHOR = SimpleNamespace(web_mm=0.15)


def made(
    monkeypatch: pytest.MonkeyPatch,
    *,
    without: tuple[str, ...] = (),
    said: Any = None,
    cpl: Any = CPL,
    holes: bool = True,
    with_pupil: bool = True,
) -> tuple[list[str], dict[str, list[tuple[tuple[Any, ...], dict[str, Any]]]]]:
    """Names of the lines of a tape, and what each check was told."""
    told: dict[str, list[tuple[tuple[Any, ...], dict[str, Any]]]] = {}

    def stub(name: str, several: bool) -> Any:
        def check(*of: Any, **named: Any) -> Any:
            told.setdefault(name, []).append((of, named))
            said = f"{name} {of[0]}" if isinstance(of[0], str) else f"{name} {of[2]}" if name == "check_symbols" else name
            line = Check(name=said.removeprefix("check_"), passed=True, message="")
            return [line] if several else line

        return check

    for name in (*MANY, *ONE):
        monkeypatch.setattr(film, name, stub(name, name in MANY))
    monkeypatch.setattr(film, "opening_outline", lambda lands, tape: "outline")
    gerbers = {role: layer for role, layer in layers_of().items() if role not in without}
    layers: Any = FilmLayers(gerbers=gerbers, holes=np.zeros((1, 3)) if holes else None, cpl=cpl)
    pairs: Any = {r: SimpleNamespace(centre_mm=r) for r in ("copper-top", "paste-top") if r in gerbers}
    some = record() if said is None else said
    checks = check_tape(layers, pairs, TAPE, some, files_of(), with_pupil=with_pupil)
    return [check.name for check in checks], told


OF_CPL = ["lands copper-top", "lands paste-top", "openings", "components", "part_data", "edges", "legend_clear"]
REST = ["symbols CPL", "symbols copper", "tag", "label"]


def test_all_of_a_tape_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    names, told = made(monkeypatch)
    assert names == ["drill", "backing stiffener-bottom", *OF_CPL, *REST]
    assert [named for _, named in told["check_lands"]] == [{"lines": False}, {"lines": False}]
    assert [of[3] for of, _ in told["check_lands"]] == [PADS, PASTE]
    assert told["check_backing"][0][0][2:4] == ("gerber/stiffener-bottom", "FR4 0.2")
    assert told["check_tag"][0][1] == {"legend_is_light": True, "with_pupil": True}
    assert [of[1] is CPL.xy_mm for of, _ in told["check_symbols"]] == [True, False]
    assert told["check_symbols"][1][0][1] == "copper-top"
    assert made(monkeypatch, with_pupil=False)[1]["check_tag"][0][1]["with_pupil"] is False


def test_without_a_cpl_the_layers_are_looked_at_by_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    assert made(monkeypatch, cpl=None)[0] == ["drill", "backing stiffener-bottom", *REST[1:]]


def test_a_tape_without_holes_has_no_drill_line(monkeypatch: pytest.MonkeyPatch) -> None:
    assert made(monkeypatch, holes=False)[0] == ["backing stiffener-bottom", *OF_CPL, *REST]


@pytest.mark.parametrize(
    ("without", "lacking"),
    [
        ("copper-top", {"lands copper-top", "edges", "symbols copper"}),
        ("paste-top", {"lands paste-top"}),
        ("coverlay-top", {"openings", "legend_clear"}),
        ("legend-top", {"legend_clear", "tag", "label"}),
        ("components-top", {"components", "part_data"}),
        ("stiffener-bottom", {"backing stiffener-bottom"}),
        ("profile", set()),
    ],
)
def test_a_layer_that_is_not_there_takes_only_its_own_lines_away(
    monkeypatch: pytest.MonkeyPatch, without: str, lacking: set[str]
) -> None:
    whole, some = (made(monkeypatch, without=layers)[0] for layers in ((), (without,)))
    assert some == [name for name in whole if name not in lacking] and len(some) == len(whole) - len(lacking)


def test_one_window_is_looked_at_in_place_of_openings(monkeypatch: pytest.MonkeyPatch) -> None:
    gang = record(film={"mode": "gang"})
    names, told = made(monkeypatch, said=gang)
    assert "window" in names and "openings" not in names and told["check_window"][0][0][1] == "outline"
    assert "window" not in made(monkeypatch, said=gang, without=("coverlay-top",))[0]


def test_anchors_are_looked_at_where_there_are_some(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their lines are in the copper, and nowhere else."""
    anchored = record(film={"anchor": ANCHOR})
    names, told = made(monkeypatch, said=anchored)
    assert "anchors" in names and [named for _, named in told["check_lands"]] == [{"lines": True}, {"lines": False}]
    for without in ("copper-top", "coverlay-top"):
        assert "anchors" not in made(monkeypatch, said=anchored, without=(without,))[0]
    assert "anchors" in made(monkeypatch, said=anchored, cpl=None)[0]


def test_dark_ink_is_said_to_tag_and_label(monkeypatch: pytest.MonkeyPatch) -> None:
    for light in (True, False):
        told = made(monkeypatch, said=record(legend_is_light=light))[1]
        assert told["check_tag"][0][1]["legend_is_light"] is light and told["check_label"][0][1] == {"light": light}
