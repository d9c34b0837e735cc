"""Kits of another version cannot be made again: changes with hashes re-fitted are caught by what is compared."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactape_fab import Kit
from tactape_fab.make.reproduce import reproduce_kit
from tactape_fab.verify import verify_kit
from tests.roundtrip.kits import Edit, OpenKit, bytes_of, failed, members, rows
from tests.unit.verify.test_fab_attacks import swap

Copy = Callable[[Kit], Path]


def said(*path: Any, as_: object) -> Edit:
    """Another value in the manifest."""

    def edit(kit: OpenKit) -> None:
        place: Any = kit.manifest
        for key in path[:-1]:
            place = place[key]
        assert place[path[-1]] != as_
        place[path[-1]] = as_

    return edit


def changed(role: str, pattern: str, new: str) -> Edit:
    return bytes_of(role, lambda data: re.sub(pattern.encode(), new.encode(), data, count=1))


TRIANGLE = "G36*\nX8000000Y8000000D02*\nG01*\nX9000000Y8000000D01*\nX9000000Y9000000D01*\nX8000000Y8000000D01*\nG37*\n"
EDITS: dict[str, tuple[Edit, str]] = {
    "certificate: distance": (swap("certificate", '"distance": 2', '"distance": 9'), "certificate"),
    "certificate: contact": (swap("certificate", '"told_apart": 4', '"told_apart": 2'), "certificate"),
    "certificate: sector": (swap("certificate", '"sector": 100', '"sector": 101'), "certificate"),
    "certificate: a key more": (swap("certificate", '"parts": 94', '"note": "safe", "parts": 94'), "certificate"),
    "manifest: spacing": (said("fab", "limits_mm", "pad-pad", as_=0.01), "job"),
    "manifest: edge": (said("fab", "limits_mm", "pad-edge", as_=0.0), "kicad board"),
    "manifest: thickness": (said("board", "thickness_mm", as_=1.6), "kicad board"),
    "manifest: thickness of the order": (said("fab", "material", "thickness_mm", as_=1.6), "job"),
    "manifest: finish": (said("fab", "material", "finish", as_="HASL"), "job"),
    "manifest: height of the parts": (said("part", "body_mm", as_=[0.6, 0.3, 0.33]), "components-top data"),
    "manifest: length of the parts": (said("part", "body_mm", as_=[0.62, 0.3, 0.23]), "kicad board"),
    "manifest: tag": (said("tag", "id", as_=101), "label"),
    "manifest: place of the tag": (said("tag", "center_mm", as_=[3.0, 4.5]), "label"),
    "manifest: cells of the tag": (said("tag", "cell_mm", as_=0.4), "label"),
    "manifest: no tag": (said("tag", as_=None), "label"),
    "manifest: hole": (said("board", "holes", as_=[[16.4, 10.0, 1.2]]), "drill-npth"),
    "manifest: origin": (said("board", "texture_origin_mm", as_=[6.95, 18.25]), "cpl places"),
    "manifest: corners": (said("board", "corner_radius_mm", as_=2.0), "profile"),
    "manifest: rotation": (said("part", "rotation_deg", as_=135.0), "cpl rotation"),
    "manifest: pitch": (said("pitch_mm", as_=1.6), "cpl places"),
    "manifest: displacement": (said("displacement_mm", as_=0.2), "cpl places"),
    "manifest: parts left out": (said("omitted", as_=[[6, 5]]), "cpl rows"),
    "manifest: pads": (said("land_pattern", "pads", "size_mm", as_=[0.5, 0.4]), "copper-top shape"),
    "manifest: stencil": (said("land_pattern", "paste", "offset_mm", as_=0.4), "paste-top pairs"),
    "manifest: openings": (said("land_pattern", "opening_expansion_mm", as_=0.5), "coverlay-top shape"),
    "manifest: value": (said("assembly", "value", as_="10k"), "bom"),
    "manifest: part number": (said("assembly", "part_number", as_="C4711"), "bom"),
    "manifest: assembly house": (said("assembly", "format", as_="jlcpcb"), "bom"),
    "manifest: colour of ink": (said("fab", "legend_colour", as_="black"), "job"),
    "manifest: colour of film": (said("fab", "coverlay_colour", as_="black"), "job"),
    "manifest: one window": (said("fab", "coverlay_mode", as_="gang"), "coverlay-top window"),
    "manifest: job in the zip": (said("fab", "job_in_zip", as_=False), "fab-zip"),
    "manifest: name": (said("name", as_="tactape-s101"), "label"),
    "zip: bytes behind a layer": (
        members(lambda k, c: c.update({k.name("copper-top"): k.data["copper-top"] + b"\n"})),
        "fab-zip",
    ),
    "zip: a file more": (members(lambda k, c: c.update({"readme.txt": b"use FR4"})), "fab-zip"),
    "zip: capitals": (members(lambda k, c: c.update({k.name("copper-top").upper(): c.pop(k.name("copper-top"))})), "fab-zip"),
    "zip: no drill": (members(lambda k, c: c.pop(k.name("drill-npth"))), "fab-zip"),
    "copper: negative": (swap("copper-top", "FilePolarity,Positive", "FilePolarity,Negative"), "attributes"),
    "copper: another layer": (swap("copper-top", "Copper,L1,Top", "Copper,L2,Bot"), "attributes"),
    "copper: arcs of a quadrant": (swap("copper-top", "G75*", "G74*"), "written form"),
    "copper: turned": (swap("copper-top", "D10*\n", "%LR90*%\nD10*\n"), "copper-top"),
    "copper: mirrored": (swap("copper-top", "D10*\n", "%LMX*%\nD10*\n"), "copper-top"),
    "copper: a net": (swap("copper-top", "%TO.N,N/C*%", "%TO.N,GND*%"), "attributes"),
    "copper: repeated": (swap("copper-top", "D10*\n", "%SRX2Y1I30J0*%\nD10*\n"), "copper-top"),
    "copper: an area": (swap("copper-top", "%TF.MD5", TRIANGLE + "%TF.MD5"), "copper-top pairs"),
    "copper: a stop": (swap("copper-top", "D10*\n", "M00*\nD10*\n"), "copper-top"),
    "copper: of another set": (swap("copper-top", "SameCoordinates,aa", "SameCoordinates,bb"), "attributes"),
    "copper: behind its end": (changed("copper-top", r"M02\*\n\Z", "M02*\nX8000000Y8000000D03*\nM02*\n"), "copper-top"),
    "coverlay: an opening more": (swap("coverlay-top", "%TF.MD5", TRIANGLE + "%TF.MD5"), "coverlay-top openings"),
    "coverlay: positive": (swap("coverlay-top", "FilePolarity,Negative", "FilePolarity,Positive"), "attributes"),
    "outline: a cut inside": (
        swap("profile", "G01*\n%TF.MD5", "X5000000Y5000000D02*\nX6000000Y5000000D01*\nX5000000Y5000000D01*\nG01*\n%TF.MD5"),
        "profile",
    ),
    "outline: plated": (swap("profile", "Profile,NP", "Profile,P"), "attributes"),
    "drill: plated": (swap("drill-npth", "NonPlated,1,1,NPTH", "Plated,1,1,PTH"), "drill-npth"),
    "drill: a hole more": (swap("drill-npth", "Y10.0000\n", "Y10.0000\nX5.0000Y5.0000\n"), "drill-npth"),
    "drill: size": (swap("drill-npth", "T1C1.0000", "T1C1.0500"), "drill-npth"),
    "drill: incremental": (swap("drill-npth", "G05\n", "G05\nG91\n"), "drill-npth"),
    "component layer: height": (swap("components-top", "CHgt,0.23", "CHgt,0.9"), "components-top data"),
    "component layer: mounting": (swap("components-top", "CMnt,SMD", "CMnt,TH"), "components-top data"),
    "component layer: maker": (swap("components-top", "%TO.CVal", "%TO.CMfr,Other*%\n%TO.CVal"), "components-top data"),
    "component layer: a pin": (changed("components-top", r"(D13\*\n)X7126274", r"\1X7226274"), "components-top data"),
    "cpl: underside": (swap("cpl", "Top", "Bottom"), "cpl rows"),
    "cpl: a column more": (swap("cpl", "Rotation\r\n", "Rotation,Val\r\n"), "cpl"),
    "cpl: a part twice": (rows("cpl", lambda table: table.append(table[-1])), "cpl rows"),
    "cpl: another order": (rows("cpl", lambda table: table.insert(1, table.pop(2))), "cpl rows"),
    "cpl: inches": (swap("cpl", "Mid X", "Mid X (inch)"), "cpl"),
    "bom: number": (swap("bom", ",94,0R", ",95,0R"), "bom"),
    "bom: part number": (changed("bom", r",\r?\n\Z", ",C4711\r\n"), "bom"),
    "bom: description": (swap("bom", "any value", "22k"), "bom"),
    "bom: a part twice": (swap("bom", "R1,R2,", "R1,R1,R2,"), "bom"),
    "job: name": (swap("job", '"Name": "tactape-s100"', '"Name": "tactape-s101"'), "job"),
    "job: colour": (swap("job", '"Color": "Amber"', '"Color": "Green"'), "job"),
    "job: a key twice": (swap("job", '"LayerNumber": 1', '"LayerNumber": 2, "LayerNumber": 1'), "job"),
    "job: path": (swap("job", '"Path": "tactape-s100.gtl"', '"Path": "../tactape-s100.gtl"'), "job"),
    "job: no paste": (changed("job", r'    \{\n      "Path": "tactape-s100.gtp"[^}]*\},\n', ""), "job"),
}


@pytest.mark.parametrize(("edit", "line"), EDITS.values(), ids=EDITS.keys())
def test_a_change_in_a_kit_of_another_version_is_caught(edit: Edit, line: str, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.manifest["tool"]["version"] = "0.0.9"
    edit(kit)
    lines = failed(verify_kit(kit.save(consistent=True), quick=True))
    assert line in lines, sorted(lines)
    assert "files" not in lines


def test_without_a_change_it_passes(flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.manifest["tool"]["version"] = "0.0.9"
    folder = kit.save(consistent=True)
    assert not failed(verify_kit(folder, quick=True))
    (line,) = reproduce_kit(folder, required=False).checks
    assert line.warning and line.skipped


@pytest.mark.parametrize("version", ["0.0.9", None])
@pytest.mark.parametrize(
    ("key", "value"),
    [("sector", 101), ("size_mm", [200.0, 20.0]), ("rotation_deg", 0.0), ("tag_id", 3), ("name", "tactape-s101")],
)
def test_a_spec_of_another_tape_is_refused_in_any_version(
    key: str, value: object, version: str | None, flat_kit: Kit, copied: Copy
) -> None:
    kit = OpenKit(copied(flat_kit))
    if version is not None:
        kit.manifest["tool"]["version"] = version
    said("spec", key, as_=value)(kit)
    (line,) = reproduce_kit(kit.save(consistent=True), required=False).checks
    assert not line.passed and not line.warning and f"spec.{key}" in line.message
