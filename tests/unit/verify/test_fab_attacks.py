"""Changes to what the fab gets, with all hashes made to fit, are caught without making the kit again: in any version's kits."""

from __future__ import annotations

import io
import re
import struct
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactape_fab import Kit, PanelKit
from tactape_fab.verify import verify_kit
from tests.roundtrip.kits import Edit, OpenKit, as_written, bytes_of, failed, points, text_of

Copy = Callable[[Kit | PanelKit], Path]


def swap(role: str, old: str, new: str, count: int = 1) -> Edit:
    def edit(kit: OpenKit) -> None:
        assert old in kit.data[role].decode("ascii"), f"{role} holds no {old!r}"
        kit.text(role, lambda text: text.replace(old, new, count))

    return edit


def rewritten(change: Callable[[zipfile.ZipInfo], None]) -> Edit:
    """The zip with changed members, in the writer's form otherwise."""

    def edit(kit: OpenKit) -> None:
        stream = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(kit.data["fab-zip"])) as old, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as new:
            for name in old.namelist():
                entry = as_written(name)
                change(entry)
                new.writestr(entry, old.read(name))
        kit.data["fab-zip"] = stream.getvalue()

    return edit


def unicode_path(entry: zipfile.ZipInfo) -> None:
    """Info-ZIP's Unicode path: unzip gives the file this name, Python's zipfile the other."""
    other = {"gtl": "gtp", "gtp": "gtl"}.get(entry.filename[-3:])
    if other is not None:
        name = (entry.filename[:-3] + other).encode()
        body = struct.pack("<BI", 1, zlib.crc32(entry.filename.encode())) + name
        entry.extra = struct.pack("<HH", 0x7075, len(body)) + body


def as_link(entry: zipfile.ZipInfo) -> None:
    entry.external_attr = 0o120777 << 16


def data_before(kit: OpenKit) -> None:
    """Another archive before the archive: one that reads from the front finds the other one's files."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as other:
        other.writestr(as_written(kit.name("copper-top")), kit.data["paste-top"])
    front = stream.getvalue()
    stream = io.BytesIO(front)
    stream.seek(0, 2)
    with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive, zipfile.ZipFile(io.BytesIO(kit.data["fab-zip"])) as own:
        for name in own.namelist():
            if name != kit.name("copper-top"):
                archive.writestr(as_written(name), own.read(name))
    kit.data["fab-zip"] = front + kit.data["fab-zip"]


def declared_small(kit: OpenKit) -> None:
    """A member that unpacks to 200 MB, declared as it should be."""
    data = kit.data["fab-zip"]
    name = kit.name("copper-top").encode()
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    bomb = packer.compress(bytes(200 << 20)) + packer.flush()
    at = data.index(name) - 30
    size = struct.unpack_from("<I", data, at + 18)[0]
    first = at + 30 + len(name)
    data = data[: at + 18] + struct.pack("<I", len(bomb)) + data[at + 22 : first] + bomb + data[first + size :]
    grown = len(bomb) - size
    end = data.rindex(b"PK\5\6")
    start = struct.unpack_from("<I", data, end + 16)[0] + grown
    directory = bytearray(data[start:end])
    place, own = 0, data.index(name, start) - 46 - start
    while place < len(directory):
        offset = struct.unpack_from("<I", directory, place + 42)[0]
        if place == own:
            struct.pack_into("<I", directory, place + 20, len(bomb))
        elif offset > at:
            struct.pack_into("<I", directory, place + 42, offset + grown)
        place += 46 + struct.unpack_from("<H", directory, place + 28)[0]
    kit.data["fab-zip"] = data[:start] + bytes(directory) + data[end : end + 16] + struct.pack("<I", start) + data[end + 20 :]


def many_names(kit: OpenKit) -> None:
    stream = io.BytesIO(kit.data["fab-zip"])
    with zipfile.ZipFile(stream, "a") as archive:
        for number in range(20_000):
            archive.writestr(as_written(f"{number}.txt"), b"")
    kit.data["fab-zip"] = stream.getvalue()


def incremental(kit: OpenKit) -> None:
    swap("copper-top", "%FSLAX46Y46*%", "%FSLIX46Y46*%")(kit)


def redefined(kit: OpenKit) -> None:
    """The pads' aperture defined again, as a dot, after its first flash."""
    text = kit.data["copper-top"].decode("ascii")
    first = text.index("D03*\n") + 5
    kit.data["copper-top"] = (text[:first] + "%ADD10C,0.010000*%\n" + text[first:]).encode("ascii")


def label_of(text: str, change: Callable[[list[str]], list[str]]) -> str:
    """The legend with its label's lines, those behind the areas, changed."""
    start = text.rindex("G37*")
    end = text.index("%TF.MD5")
    lines = text[start:end].splitlines()
    first = next(i for i, line in enumerate(lines) if line.endswith("D02*"))
    return text[:start] + "\n".join([*lines[:first], *change(lines[first:])]) + "\n" + text[end:]


def legend(change: Callable[[list[str]], list[str]]) -> Edit:
    return text_of("legend-top", lambda text: label_of(text, change))


def across_field(lines: list[str]) -> list[str]:
    return [*lines, "X8000000Y500000D02*", "X19000000Y19500000D01*"]


def drill_repeat(kit: OpenKit) -> None:
    swap("drill-npth", "X16.4000Y10.0000\n", "X16.4000Y10.0000\nR100000000X0.0001\n")(kit)


def turned_body(text: str) -> str:
    return re.sub(r"(?<=D11\*\n)X(\d+)Y(\d+)D02", lambda m: f"X{int(m[1]) + 50_000}Y{m[2]}D02", text, count=1)


ATTACKS: dict[str, tuple[Edit, str]] = {
    "zip: Unicode path exchanges copper and paste": (rewritten(unicode_path), "fab-zip"),
    "zip: symbolic link": (rewritten(as_link), "fab-zip"),
    "zip: executable": (rewritten(lambda e: setattr(e, "external_attr", 0o100755 << 16)), "fab-zip"),
    "zip: another system": (rewritten(lambda e: setattr(e, "create_system", 0)), "fab-zip"),
    "zip: comment of a file": (rewritten(lambda e: setattr(e, "comment", b"use FR4")), "fab-zip"),
    "zip: comment": (bytes_of("fab-zip", lambda b: b[:-2] + b"\x07\x00use FR4"), "fab-zip"),
    "zip: another archive before it": (data_before, "fab-zip"),
    "zip: bytes behind it": (bytes_of("fab-zip", lambda b: b + b"\0"), "fab-zip"),
    "zip: bytes before it": (bytes_of("fab-zip", lambda b: b"\0" + b), "fab-zip"),
    "zip: a member larger than it says": (declared_small, "fab-zip"),
    "zip: 20,000 names": (many_names, "fab-zip"),
    "copper: incremental notation": (incremental, "written form"),
    "copper: aperture defined again": (redefined, "written form"),
    "copper: stray %%": (swap("copper-top", "G75*\n", "%%\nG75*\n"), "written form"),
    "copper: inches after the first flash": (swap("copper-top", "D03*\n", "D03*\n%MOIN*%\n"), "copper-top"),
    "copper: clear after the first flash": (swap("copper-top", "D03*\n", "D03*\n%LPC*%\n"), "written form"),
    "copper: scaled": (swap("copper-top", "D10*\n", "%LS0.5*%\nD10*\n"), "copper-top"),
    "copper: deprecated statement": (swap("copper-top", "G01*\n", "G01*\nG91*\n"), "copper-top"),
    "copper: two statements in a line": (swap("copper-top", "D10*\n", "D10*X0Y0D02*\n"), "written form"),
    "copper: comment": (swap("copper-top", "G75*\n", "G75*\nG04 use FR4*\n"), "written form"),
    "copper: hidden a statement": (
        swap("copper-top", "%TF.Part,Single*%", "%TF.Part,Single*LPC*%"),
        "written form",
    ),
    "copper: end of another system": (text_of("copper-top", lambda t: t.replace("\n", "\r\n")), "written form"),
    "copper: aperture X1000000000": (
        swap("copper-top", "%TD*%\n", "%TD*%\n%AMBIG*\n1,1,$1X1000000000,0,0*%\n"),
        "copper-top",
    ),
    "outline: 5 mm wide": (swap("profile", "C,0.100000", "C,5.000000"), "profile"),
    "outline: hairline": (swap("profile", "C,0.100000", "C,0.000100"), "profile"),
    "outline: clear": (swap("profile", "%LPD*%", "%LPC*%"), "profile"),
    "drill: 100,000,000 holes in a line": (drill_repeat, "drill-npth"),
    "drill: inches": (swap("drill-npth", "METRIC\n", "INCH\n"), "written form"),
    "drill: routed slot": (swap("drill-npth", "M30\n", "G00X1.0000Y1.0000\nM15\nG01X9.0000Y9.0000\nM16\nM30\n"), "written form"),
    "job: thickness": (swap("job", '"BoardThickness": 0.11', '"BoardThickness": 1.6'), "job"),
    "job: layers": (swap("job", '"LayerNumber": 1', '"LayerNumber": 2'), "job"),
    "job: base": (swap("job", "polyimide", "FR4"), "job"),
    "job: finish": (swap("job", "ENIG", "HASL"), "job"),
    "job: functions exchanged": (
        text_of(
            "job",
            lambda t: t.replace("Copper,L1,Top", "?").replace("SolderPaste,Top", "Copper,L1,Top").replace("?", "SolderPaste,Top"),
        ),
        "job",
    ),
    "job: polarity of the mask": (swap("job", '"Negative"', '"Positive"'), "job"),
    "job: spacing": (swap("job", '"PadToPad": 0.1', '"PadToPad": 0.01'), "job"),
    "job: a key more": (swap("job", '"Header": {', '"Remark": "FR4",\n  "Header": {'), "job"),
    "job: copper": (swap("job", '"Thickness": 0.018', '"Thickness": 0.07'), "job"),
    "label: none": (legend(lambda lines: []), "label"),
    "label: one stroke less": (legend(lambda lines: lines[:-2]), "label"),
    "label: of 0.02 mm": (swap("legend-top", "C,0.15", "C,0.02"), "label"),
    "label: ink across the field": (legend(across_field), "label"),
    "label: moved": (points("legend-top", lambda p: (p[0], p[1] + 0.2 * (p[1] > 8.0))), "label"),
    "component layer: rotation": (swap("components-top", "CRot,45", "CRot,0"), "components-top data"),
    "component layer: value": (swap("components-top", "CVal,0R", "CVal,1k"), "components-top data"),
    "component layer: footprint": (swap("components-top", "CFtp,R_0201_0603Metric", "CFtp,C_0402"), "components-top data"),
    "component layer: rotation again": (
        swap("components-top", "%TO.C,R50*%", "%TO.CRot,0*%\n%TO.C,R50*%"),
        "components-top data",
    ),
    "component layer: pins exchanged": (
        text_of("components-top", lambda t: t.replace("R7,1*", "R7,?*").replace("R7,2*", "R7,1*").replace("R7,?*", "R7,2*")),
        "components-top data",
    ),
    "component layer: body": (text_of("components-top", turned_body), "components-top data"),
}


def first_x(change: Callable[[str], str]) -> Edit:
    """The pick-and-place list with the first part's x written otherwise."""
    return bytes_of(
        "cpl", lambda data: re.sub(r"(?<=\nR1,)[\d.]+", lambda m: change(m[0]), data.decode(), count=1).encode("utf-8")
    )


def before(role: str, line: str) -> Edit:
    return text_of(role, lambda text: line + "\n" + text)


OF_NO_OTHER_READER: dict[str, tuple[Edit, str]] = {
    "cpl: exponent": (first_x(lambda x: f"{float(x) / 10!r}e1"), "cpl"),
    "cpl: sign": (first_x(lambda x: "+" + x), "cpl"),
    "cpl: underscore": (first_x(lambda x: x[0] + "_" + x[1:]), "cpl"),
    "cpl: blank": (first_x(lambda x: " " + x), "cpl"),
    "cpl: Arabic digits": (first_x(lambda x: "".join(chr(0x660 + int(c)) if c.isdigit() else c for c in x)), "cpl"),
    "cpl: needless quotes": (first_x(lambda x: f'"{x}"'), "cpl"),
    "cpl: byte order mark": (bytes_of("cpl", lambda b: b"\xef\xbb\xbf" + b), "cpl"),
    "cpl: other line ends": (bytes_of("cpl", lambda b: b.replace(b"\r\n", b"\r")), "cpl"),
    "cpl: blank line": (bytes_of("cpl", lambda b: b.replace(b"\r\n", b"\r\n\r\n", 1)), "cpl"),
    "cpl: a turn further": (bytes_of("cpl", lambda b: b.replace(b",45\r\n", b",-315\r\n", 1)), "cpl"),
    "bom: other line ends": (bytes_of("bom", lambda b: b.replace(b"\r\n", b"\r")), "bom"),
    "copper: another function before": (before("copper-top", "%TF.FileFunction,Paste,Top*%"), "written form"),
    "copper: negative before": (before("copper-top", "%TF.FilePolarity,Negative*%"), "written form"),
    "mask: positive in a comment before": (before("coverlay-top", "G04 #@! TF.FilePolarity,Positive*"), "written form"),
    "copper: an attribute in a comment": (swap("copper-top", "G75*\nG01*\n", "G75*\nG01*\nG04 #@! TD*\n"), "written form"),
    "copper: pads of another function": (swap("copper-top", "SMDPad,CuDef", "WasherPad"), "written form"),
    "copper: an array": (swap("copper-top", "TF.Part,Single", "TF.Part,Array"), "attributes"),
    "drill: plated, too": (
        swap("drill-npth", "; #@! TF.Part", "; #@! TF.Filefunction,Plated\n; #@! TF.Part"),
        "written form",
    ),
    "drill: an array": (swap("drill-npth", "TF.Part,Single", "TF.Part,Array"), "attributes"),
    "preview: script": (swap("preview-svg", "</svg>", "<script>alert(1)</script></svg>"), "previews"),
    "preview: event": (swap("preview-svg", "<svg", "<svg onload='alert(1)'"), "previews"),
    "preview: from elsewhere": (swap("preview-svg", "</svg>", '<use href="http://example.org/a.svg"/></svg>'), "previews"),
    "preview: image": (swap("preview-svg", "</svg>", "<image x='1'/></svg>"), "previews"),
    "preview: style": (swap("preview-svg", 'fill="', 'style="fill:url(//example.org)" fill="'), "previews"),
    "preview: entities": (swap("preview-svg", "<title>", "<!DOCTYPE a [<!ENTITY b 'c'>]><title>"), "previews"),
}
"""What our readers pass over and others may not."""
ATTACKS |= OF_NO_OTHER_READER


@pytest.mark.parametrize(("edit", "line"), ATTACKS.values(), ids=ATTACKS.keys())
def test_a_change_of_what_the_fab_gets_is_caught(edit: Edit, line: str, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    before = dict(kit.data)
    edit(kit)
    assert kit.data != before
    folder, started = kit.save(consistent=True), time.process_time()
    lines = failed(verify_kit(folder, quick=True))
    assert line in lines, sorted(lines)
    assert "files" not in lines
    assert time.process_time() - started < 5.0


def test_the_label_of_another_sector_is_caught(flat_kit: Kit, copied: Copy, tmp_path: Path) -> None:
    from tactape_fab import TapeSpec, make_kit

    spec = TapeSpec(sector=101, tag_id=100, size_mm=(20.0, 20.0), holes_mm=[(16.4, 10.0, 1.0)], models=False)
    other = make_kit(spec, tmp_path / "other", verify=False)
    kit = OpenKit(copied(flat_kit))
    theirs = (other.path / other.files["legend-top"]).read_bytes()
    own = kit.data["legend-top"]
    guid = re.search(rb"SameCoordinates,([^*]*)", own)
    assert guid is not None
    kit.data["legend-top"] = re.sub(rb"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", guid[1], theirs)
    assert set(failed(verify_kit(kit.save(consistent=True), quick=True))) == {"label"}


FORMULAS = ("=cmd|' /C calc'!A0", "+1", "-2+3", "@SUM(A1)", "\t=1", "0R\n=1")


@pytest.mark.parametrize("value", FORMULAS)
@pytest.mark.parametrize("key", ["value", "footprint", "description"])
def test_a_formula_in_the_lists_is_refused(key: str, value: Any, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.manifest["assembly"][key] = value
    (line,) = failed(verify_kit(kit.save(consistent=True), quick=True)).values()
    assert line.name == "manifest" and "holds no formula" in line.message


def test_kits_of_before_these_records_are_compared_with_the_packages_profile(flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    for key in ("material", "legend_line_mm", "legend_text_mm", "legend_edge_mm"):
        del kit.manifest["fab"][key]
    swap("job", '"BoardThickness": 0.11', '"BoardThickness": 1.6')(kit)
    assert set(failed(verify_kit(kit.save(consistent=True), quick=True))) == {"job"}
    kit.manifest["fab"]["name"] = "my-fab"
    verification = verify_kit(kit.save(consistent=True), quick=True)
    assert "label" in {c.name for c in verification.checks if c.warning}


def test_panels_and_all_kinds_of_film_pass(panel_2: PanelKit, tmp_path: Path) -> None:
    from tactape_fab import TapeSpec, make_kit

    assert verify_kit(panel_2.path, quick=True).passed
    specs: list[dict[str, Any]] = [
        {"pitch_mm": 2.0, "coverlay": "per-part", "anchor": "mesh"},
        {"coverlay": "gang", "stiffener": "FR4 0.2", "adhesive": "3M468 0.13"},
        {"fab": "pcbway-fr4", "x2": "comments"},
        {"fab": "generic-lpi", "x2": "off", "holes_mm": [(16.4, 10.0, 1.0), (16.4, 14.0, 0.8)]},
    ]
    for number, values in enumerate(specs):
        kit = make_kit(TapeSpec(sector=3, size_mm=(26.0, 22.0), models=False, **values), tmp_path / f"kit{number}")
        assert {"written form", "components-top data", "label", "job"} <= {c.name for c in kit.checks if c.passed}
