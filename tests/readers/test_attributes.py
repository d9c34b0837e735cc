"""Gerber attributes as gerbonara reads them, and as the Gerber format specification 2024.05 asks, in each `--x2` mode."""

from __future__ import annotations

import hashlib
import re
import uuid
import warnings
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from gerbonara.graphic_objects import Flash
from gerbonara.rs274x import GerberFile

from tactape_fab import Kit, TapeSpec, __version__, make_kit
from tests.readers.raster import LAYERS

_FUNCTIONS = {
    "copper-top": (("Copper", "L1", "Top"), "Positive", ("SMDPad", "CuDef")),
    "coverlay-top": (("Soldermask", "Top"), "Negative", ("Material",)),
    "paste-top": (("Paste", "Top"), "Positive", ("Material",)),
    "legend-top": (("Legend", "Top"), "Positive", ("Material",)),
    "profile": (("Profile", "NP"), "Positive", ("Profile",)),
}


@pytest.fixture(scope="module")
def kits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kit]:
    """One tape in each attribute mode."""

    def kit(mode: str) -> Kit:
        return make_kit(TapeSpec(sector=100, size_mm=(20.0, 20.0), x2=mode, name="t3"), tmp_path_factory.mktemp(mode) / "t3")

    return {mode: kit(mode) for mode in ("full", "comments", "off")}


def _read(kit: Kit, role: str) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return GerberFile.open(kit.path / kit.files[role])


def _text(kit: Kit, role: str) -> str:
    return (kit.path / kit.files[role]).read_text(encoding="ascii")


def _first_bytes_md5(text: str, before: str) -> str:
    signed, _, _ = text.partition(before)
    return hashlib.md5(re.sub("[\r\n]", "", signed).encode("ascii"), usedforsecurity=False).hexdigest()


def test_every_copper_flash_names_its_part_and_pin_in_order(kits: dict[str, Kit]) -> None:
    file = _read(kits["full"], "copper-top")
    parts = kits["full"].tape.part_count
    assert [flash.attrs[".P"] for flash in file.objects] == [(f"R{i}", pin) for i in range(1, parts + 1) for pin in "12"]
    assert {flash.attrs[".N"] for flash in file.objects} == {("N/C",)}


@pytest.mark.parametrize(("anchor", "nets"), [("spur", {("N/C",)}), ("mesh", {None})])
def test_a_pad_that_copper_connects_to_others_states_no_net(anchor: str, nets: set[Any], tmp_path: Path) -> None:
    # N/C is the net of a single pad (5.6.13): a netlist of such nets has as many shorts as a mesh connects pads
    spec = TapeSpec(sector=9, pitch_mm=2.4, size_mm=(20.0, 16.0), tag="none", anchor=anchor, models=False)
    kit = make_kit(spec, tmp_path / "tape", verify=False)
    drawn = _read(kit, "copper-top").objects
    pads = [thing for thing in drawn if isinstance(thing, Flash)]
    assert len(pads) == 2 * kit.tape.part_count
    assert {pad.attrs.get(".N") for pad in pads} == nets
    # 5.6.10: copper that connects is a Conductor, a pad never is
    assert {dict(thing.aperture.attrs)[".AperFunction"] for thing in drawn[len(pads) :]} == {("Conductor",)}


@pytest.mark.parametrize("layer", LAYERS)
def test_file_attributes_say_what_the_layer_is(kits: dict[str, Kit], layer: str) -> None:
    function, polarity, _ = _FUNCTIONS[layer]
    attributes = dict(_read(kits["full"], layer).file_attrs)
    _, guid, _ = attributes.pop(".ProjectId")
    attributes.pop(".CreationDate"), attributes.pop(".MD5")
    assert attributes == {
        ".GenerationSoftware": ("tactape-fab", "tactape-fab", __version__),
        ".SameCoordinates": (guid,),
        ".Part": ("Single",),
        ".FileFunction": function,
        ".FilePolarity": (polarity,),
    }


@pytest.mark.parametrize("layer", LAYERS)
def test_every_aperture_says_its_function(kits: dict[str, Kit], layer: str) -> None:
    drawn = [o.aperture for o in _read(kits["full"], layer).objects if hasattr(o, "aperture")]
    assert {dict(aperture.attrs)[".AperFunction"] for aperture in drawn} == {_FUNCTIONS[layer][2]}


def test_project_and_date_are_the_same_in_every_layer_and_well_formed(kits: dict[str, Kit]) -> None:
    files = [_read(kits["full"], role).file_attrs for role in (*LAYERS, "components-top")]
    ((name, guid, _),) = {attributes[".ProjectId"] for attributes in files}
    ((date,),) = {attributes[".CreationDate"] for attributes in files}
    assert name == "t3"
    assert uuid.UUID(guid).version in (1, 4)  # 5.6.8: a GUID of RFC 4122 version 1 or 4
    assert uuid.UUID(guid).variant == uuid.RFC_4122
    assert datetime.fromisoformat(date).tzinfo is not None


def test_components_name_every_part(kits: dict[str, Kit]) -> None:
    file = _read(kits["full"], "components-top")
    assert file.file_attrs[".FileFunction"] == ("Component", "L1", "Top")
    text = _text(kits["full"], "components-top")
    assert re.findall(r"%TO\.C,(R\d+)\*%", text) == [f"R{i}" for i in range(1, kits["full"].tape.part_count + 1)]


@pytest.mark.parametrize("role", [*LAYERS, "components-top"])
def test_the_signature_is_the_md5_of_all_before_it(kits: dict[str, Kit], role: str) -> None:
    text = _text(kits["full"], role)
    assert _read(kits["full"], role).file_attrs[".MD5"] == (_first_bytes_md5(text, "%TF.MD5,"),)
    assert re.search(r"%TF\.MD5,[0-9a-f]{32}\*%\nM02\*\n\Z", text)


@pytest.mark.parametrize("layer", LAYERS)
def test_comments_hold_the_same_attributes_and_none_in_percent_form(kits: dict[str, Kit], layer: str) -> None:
    full, comments = (_text(kits[mode], layer) for mode in ("full", "comments"))
    assert re.search("%T[FAOD]", comments) is None
    *said, signature = re.findall(r"^G04 #@! (T[^*]*)\*$", comments, flags=re.MULTILINE)
    assert said == re.findall(r"^%(T[^*]*)\*%$", full, flags=re.MULTILINE)[:-1]
    assert signature == f"TF.MD5,{_first_bytes_md5(comments, 'G04 #@! TF.MD5,')}"


@pytest.mark.parametrize("layer", LAYERS)
def test_off_leaves_the_drawing_alone(kits: dict[str, Kit], layer: str) -> None:
    full, off = (_text(kits[mode], layer) for mode in ("full", "off"))
    assert re.search("%T[FAOD]|#@!", off) is None
    assert off == re.sub(r"^%T[FAOD].*\n", "", full, flags=re.MULTILINE)
