"""Changes to what the fab gets, with all hashes made to fit, are caught without making the kit again: in any version's kits."""

from __future__ import annotations

import base64
import hashlib
import io
import re
import struct
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
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


ACROSS = "X11000000Y20000000D01*\nX11000000Y500D01*\nX10000000Y500D01*\nX10000000Y20000000D01*\n"
"""From the upper side to half a micrometre from the lower one, and back: all its corners lie on the outline."""
TONGUE = "-0.091924,0.261630,\n0.261276,-0.091571,\n0.091571,-0.261276,\n-0.261630,0.091924,\n"

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
    "copper: pads called fiducials": (swap("copper-top", "SMDPad,CuDef", "FiducialPad,Global"), "attributes"),
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
    "outline: a cut across": (
        swap("profile", "X1000000Y20000000D01*", ACROSS + "X1000000Y20000000D01*"),
        "profile",
    ),
    "coverlay: a tongue across each opening": (
        text_of("coverlay-top", lambda t: t.replace("4,1,4,", "4,1,8,").replace("\n-0.601041,", "\n" + TONGUE + "-0.601041,")),
        "coverlay-top shape",
    ),
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


def notes(old: str, new: str) -> Edit:
    return bytes_of("order-notes", lambda data: swapped(data, old.encode(), new.encode()))


def swapped(data: bytes, old: bytes, new: bytes) -> bytes:
    assert old in data, old
    return data.replace(old, new, 1)


def pdf(change: Callable[[list[bytes]], object]) -> Edit:
    """The drawing with changed objects, and a table that fits them."""

    def written(data: bytes) -> bytes:
        start, end = data.index(b"1 0 obj\n"), data.rindex(b"xref\n0 ")
        objects = re.split(rb"(?<=endobj\n)(?=\d+ 0 obj\n)", data[start:end])
        change(objects)
        out, table = data[:start], b""
        for body in objects:
            table += b"%010d 00000 n \n" % len(out)
            out += body
        head = b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
        trailer = re.sub(rb"startxref\n\d+", b"startxref\n%d" % len(out), data[data.index(b"trailer\n") :])
        return out + head + table + trailer

    return bytes_of("fab-drawing", written)


def object_with(word: bytes, change: Callable[[bytes], bytes]) -> Edit:
    def edit(objects: list[bytes]) -> None:
        (at,) = (i for i, body in enumerate(objects) if word in body)
        objects[at] = change(objects[at])

    return pdf(edit)


def of_page(change: Callable[[bytes], bytes], *, as_ascii: bool = False) -> Edit:
    """The drawing with another text of its page, as kits have it, or in ASCII as those of older versions do."""

    def edit(objects: list[bytes]) -> None:
        (number,) = (found[1] for body in objects if (found := re.search(rb"/Contents (\d+) 0 R", body)))
        (at,) = (i for i, body in enumerate(objects) if body.startswith(number + b" 0 obj"))
        after = change(zlib.decompress(objects[at].partition(b"stream\n")[2]))
        text = base64.a85encode(zlib.compress(after)) + b"~>" if as_ascii else zlib.compress(after)
        head = b"%b 0 obj\n<<\n/Filter [ %b/FlateDecode ] /Length %d\n>>\n"
        head %= number, b"/ASCII85Decode " * as_ascii, len(text)
        objects[at] = head + b"stream\n" + text + b"endstream\nendobj\n"

    return pdf(edit)


def of_report(old: str, new: str) -> Edit:
    return bytes_of("report", lambda data: swapped(data, old.encode(), new.encode()))


def script_with_its_hash(kit: OpenKit) -> None:
    """Another script that the page's policy allows."""
    data = kit.data["report"]
    old = data.rpartition(b"<script>")[2].partition(b"</script>")[0]
    new = old.replace(b"\n})();", b"\nalert(1);\n})();")
    a, b = (base64.b64encode(hashlib.sha256(script).digest()) for script in (old, new))
    kit.data["report"] = swapped(swapped(data, old, new), a, b)


def dxf_cut(text: str) -> str:
    """The outline with a cut from its lower side to the upper one."""
    vertex = "  0\nVERTEX\n  8\nOUTLINE\n 10\n%f\n 20\n%f\n 30\n0.0\n"
    first = vertex % (19.0, 0.0)
    assert first in text
    cut = ((10.0, 0.0), (10.0, 19.9995), (11.0, 19.9995), (11.0, 0.0))
    return text.replace(first, "".join(vertex % point for point in cut) + first)


def dxf_number(text: str) -> str:
    """A place for the fab's number where the tag is: the field's box, moved there."""
    start, end = text.index("  0\nPOLYLINE\n  8\nFIELD"), text.index("SEQEND\n  8\nFIELD\n") + len("SEQEND\n  8\nFIELD\n")
    box = text[start:end].replace("FIELD", "NUMBER").replace("6.000000", "1.000000").replace("18.300000", "5.000000")
    return text[:end] + box.replace("19.200000", "5.000000") + text[end:]


FOR_PEOPLE: dict[str, tuple[Edit, str]] = {
    "notes: 1.6 mm": (notes("0.11 mm", "1.6 mm"), "order-notes"),
    "notes: a second thickness": (
        notes("   surface finish", "   thickness of base                  1.6 mm\n   surface finish"),
        "order-notes",
    ),
    "notes: no thickness": (bytes_of("order-notes", lambda b: re.sub(rb"   thickness [^\n]*\n", b"", b)), "order-notes"),
    "notes: layers": (bytes_of("order-notes", lambda b: re.sub(rb"(   layers +)1", rb"\g<1>2", b)), "order-notes"),
    "notes: size": (notes("20 x 20 mm, corner", "20 x 21 mm, corner"), "order-notes"),
    "notes: finish": (notes("ENIG", "HASL"), "order-notes"),
    "notes: base": (notes("flexible, polyimide", "rigid, FR4"), "order-notes"),
    "notes: copper": (notes("1/2 oz", "2 oz"), "order-notes"),
    "notes: colour": (notes("amber, cut", "black, cut"), "order-notes"),
    "notes: stiffener": (
        bytes_of("order-notes", lambda b: re.sub(rb"(   stiffener +)none", rb"\g<1>FR4 0.2 mm", b)),
        "order-notes",
    ),
    "notes: adhesive": (
        bytes_of("order-notes", lambda b: re.sub(rb"(   adhesive +)none", rb"\g<1>3M468 0.13 mm", b)),
        "order-notes",
    ),
    "notes: part number": (notes("none given", "C4711"), "order-notes"),
    "notes: number in the remark": (
        notes("parts of a board                   ", "parts of a board                   1"),
        "order-notes",
    ),
    "notes: rotation": (notes("all turned 45 deg", "all turned 135 deg"), "order-notes"),
    "notes: pitch": (notes("regular grid of 1.5 mm", "regular grid of 1.6 mm"), "order-notes"),
    "notes: displacement": (notes("differ by 0.25 mm", "differ by 0.2 mm"), "order-notes"),
    "notes: first part": (bytes_of("order-notes", lambda b: re.sub(rb"R1 at [\d.]+,", b"R1 at 9.9,", b)), "order-notes"),
    "notes: single": (notes("by the fab, as the remark of step 8 says", "single pieces"), "order-notes"),
    "notes: no panel": (bytes_of("order-notes", lambda b: re.sub(rb"   The board alone [^\n]*\n", b"", b)), "order-notes"),
    "notes: the line takes it": (notes("line takes (70 x 70 to", "line takes (20 x 20 to"), "order-notes"),
    "notes: merge openings": (notes("Do not merge openings", "Please merge openings"), "order-notes"),
    **{
        f"notes: {what}": (notes(old, new), "order-notes")
        for what, old, new in (
            ("lean in the remark", "leans like this: /", "leans like this: \\"),
            ("lean in the preview", "all leaning like /", "all leaning like \\"),
            ("sense of the rotation", "45 deg counter-clockwise", "45 deg clockwise"),
            ("side", "top only", "both sides"),
            ("side in the remark", "all on top", "all on the bottom"),
            ("unit of the list", "generic: mm, counter-clockwise", "generic: mil, counter-clockwise"),
            ("sense of the list", "generic: mm, counter-clockwise", "generic: mm, clockwise"),
            ("origin of the list", "origin as in the Gerber files", "origin in the middle"),
            ("frame", "lower left corner, y up", "upper left corner, y down"),
            ("align", "Do not align them", "Align them"),
            ("footprint", "94 parts R_0201_0603Metric", "94 parts R_0402_1005Metric"),
            ("kinds of part", "kinds of part                      1", "kinds of part                      2"),
            ("parts to buy", "parts for 5 tapes                  517", "parts for 5 tapes                  94"),
            ("part number in the remark", "no part number is given.", "number C4711."),
        )
    },
    "notes: quantity": (notes("STEP 8. ", "   96 parts a board, 1960 parts in all\n\nSTEP 8. "), "order-notes"),
    "dxf: outline": (swap("fab-dxf", "20.000000", "20.100000"), "fab-dxf"),
    "dxf: a cut across": (text_of("fab-dxf", dxf_cut), "fab-dxf"),
    "dxf: no hole": (text_of("fab-dxf", lambda t: re.sub(r"  0\nCIRCLE\n(?:.*\n){10}", "", t)), "fab-dxf"),
    "dxf: hole": (swap("fab-dxf", " 40\n0.500000", " 40\n0.800000"), "fab-dxf"),
    "dxf: inches": (swap("fab-dxf", "$INSUNITS\n 70\n4", "$INSUNITS\n 70\n1"), "fab-dxf"),
    "dxf: another layer": (swap("fab-dxf", "POLYLINE\n  8\nOUTLINE", "POLYLINE\n  8\nCUT"), "fab-dxf"),
    "dxf: a text": (swap("fab-dxf", "  0\nCIRCLE\n", "  0\nTEXT\n  8\nHOLES\n  1\nFR4\n  0\nCIRCLE\n"), "fab-dxf"),
    "dxf: a wide line": (text_of("fab-dxf", lambda t: t.replace(" 66\n1\n", " 40\n5.0\n", 1)), "fab-dxf"),
    "dxf: a bulge": (text_of("fab-dxf", lambda t: t.replace(" 70\n1\n  0\nVERTEX", " 42\n9.9\n  0\nVERTEX", 1)), "fab-dxf"),
    "dxf: an open outline": (text_of("fab-dxf", lambda t: t.replace(" 70\n1\n  0\nVERTEX", " 70\n0\n  0\nVERTEX", 1)), "fab-dxf"),
    "dxf: a field's corner": (
        text_of("fab-dxf", lambda t: re.sub(r"(X\n  8\nFIELD\n 10\n)[\d.]+", r"\g<1>12.0", t, count=1)),
        "fab-dxf",
    ),
    "dxf: an origin": (swap("fab-dxf", "OUTLINE\n 66\n1\n 10\n0.0", "OUTLINE\n 66\n1\n 10\n5.0"), "fab-dxf"),
    "dxf: an underscore": (swap("fab-dxf", "20.000000", "2_0.000000"), "fab-dxf"),
    "dxf: a sign": (swap("fab-dxf", "20.000000", "+20.000000"), "fab-dxf"),
    "dxf: a layer twice": (swap("fab-dxf", "LAYER\n  2\nSLOTS", "LAYER\n  2\nFIELD"), "fab-dxf"),
    "dxf: a layer that is in no table": (swap("fab-dxf", "LAYER\n  2\nHOLES", "LAYER\n  2\nCUTS"), "fab-dxf"),
    "dxf: not a number": (swap("fab-dxf", "20.000000", "nan"), "fab-dxf"),
    "dxf: very far": (text_of("fab-dxf", lambda t: re.sub(r"(LABEL\n 10\n)[\d.]+", r"\g<1>1e300", t, count=1)), "fab-dxf"),
    "dxf: cut off": (text_of("fab-dxf", lambda t: t[: len(t) // 2]), "fab-dxf"),
    "dxf: a block": (
        swap("fab-dxf", "  0\nSECTION\n  2\nENT", "  0\nSECTION\n  2\nBLOCKS\n  0\nBLOCK\n  0\nENDSEC\n  0\nSECTION\n  2\nENT"),
        "fab-dxf",
    ),
    "dxf: a frozen layer": (swap("fab-dxf", "OUTLINE\n 70\n0\n", "OUTLINE\n 70\n1\n"), "fab-dxf"),
    "dxf: a layer switched off": (swap("fab-dxf", " 62\n7\n", " 62\n-7\n"), "fab-dxf"),
    "dxf: a number on the tag": (text_of("fab-dxf", dxf_number), "fab-dxf"),
    "dxf: tag's corners in another order": (
        text_of(
            "fab-dxf",
            lambda t: re.sub(
                r"((?:  0\nVERTEX\n  8\nTAG\n(?:.*\n){6}){2})((?:  0\nVERTEX\n  8\nTAG\n(?:.*\n){6}){2})", r"\2\1", t, count=1
            ),
        ),
        "fab-dxf",
    ),
    "dxf: label": (text_of("fab-dxf", lambda t: re.sub(r"(LABEL\n 10\n)\d+\.", r"\g<1>19.", t, count=1)), "fab-dxf"),
    "drawing: script": (
        object_with(
            b"/Catalog", lambda b: b.replace(b"/PageMode", b"/OpenAction << /S /JavaScript /JS (app.alert) >> /PageMode")
        ),
        "fab-drawing",
    ),
    "drawing: script in other letters": (object_with(b"/Catalog", lambda b: b.replace(b"/UseNone", b"/A#41")), "fab-drawing"),
    "drawing: a file": (
        pdf(lambda o: o.append(b"%d 0 obj\n<<\n/Type /EmbeddedFile\n>>\nendobj\n" % (len(o) + 1))),
        "fab-drawing",
    ),
    "drawing: a second page": (pdf(lambda o: o.append(b"%d 0 obj\n<<\n/Type /Page\n>>\nendobj\n" % (len(o) + 1))), "fab-drawing"),
    "drawing: another page's text": (
        object_with(b"/Contents", lambda b: re.sub(rb"(/Contents \d+ 0 R)", rb"\1 /Contents [ 3 0 R ]", b)),
        "fab-drawing",
    ),
    "drawing: hidden in a text": (
        object_with(b"/Title", lambda b: b.replace(b"(anonymous)", b"() /AA 3 0 R /Author ()")),
        "fab-drawing",
    ),
    "drawing: bytes behind": (bytes_of("fab-drawing", lambda b: b + b"1 0 obj\n<<\n>>\nendobj\n"), "fab-drawing"),
    "drawing: a table of other places": (
        bytes_of("fab-drawing", lambda b: re.sub(rb"\n(\d{9})\d 00000 n", rb"\n\g<1>9 00000 n", b, count=1)),
        "fab-drawing",
    ),
    "drawing: 1.6 mm": (of_page(lambda b: swapped(b, b"film 0.11 thick", b"film 1.6 thick")), "fab-drawing"),
    "drawing: turned": (of_page(lambda b: swapped(b, b"parts turned 45", b"parts turned 90")), "fab-drawing"),
    "drawing: stiffener": (of_page(lambda b: swapped(b, b"(none) Tj", b"(FR4 0.2 mm, whole underside) Tj")), "fab-drawing"),
    **{
        f"drawing: {what}": (of_page(lambda b, old=old, new=new: swapped(b, old, new)), "fab-drawing")  # type: ignore[misc]
        for what, old, new in (
            ("sense of rotations", b"file are counter-clockwise", b"file are clockwise"),
            ("lean", b"leans like this: /", b"leans like this: -"),
            ("place of a hole", b"x 16.400", b"x 15.400"),
            ("a hole less", b"x 16.400", b"16.400"),
            ("pitch", b"(W 1.5)", b"(W 1.7)"),
            ("dimension", b"(20) Tj", b"(21) Tj"),
            ("radius", b"radius 1 ", b"radius 2 "),
            ("ink", b"white, lines", b"black, lines"),
            ("body", b"0.6 x 0.3 x 0.23", b"1.0 x 0.5 x 0.35"),
            ("lands", b"lands 0.46", b"lands 0.56"),
            ("openings", b"never merged", b"may be merged"),
            ("size of openings", b"openings of 1.2 x 0.5", b"openings of 1.3 x 0.5"),
            ("an opening", b"opening 1.2 x 0.5", b"opening 1.2 x 0.6"),
            ("spacing", b"least spacing 0.18", b"least spacing 0.48"),
            ("lines of ink", b"lines of 0.15", b"lines of 0.05"),
            ("length of the field", b"(field 1", b"(field "),
            ("unit", b"all dimensions in mm", b"all dimensions in mil"),
            ("which file rules", b"Gerber and drill files rule; this", b"drawing rules; this"),
            ("sector", b"sector 100", b"sector 101"),
            ("assembly format", b"format generic", b"format macrofab"),
            ("a text more", b"(none) Tj", b"(none) Tj (FR4 0.2 mm) Tj"),
            ("a text at the end", b"sheet 1 of 1, A4) Tj", b"sheet 1 of 1, A4) Tj (use FR4) Tj"),
        )
    },
    "report: script": (of_report("</main>", "</main><script>alert(1)</script>"), "report"),
    "report: no policy": (bytes_of("report", lambda b: re.sub(rb"<meta http-equiv[^>]*>\n", b"", b)), "report"),
    "report: a script before its policy": (of_report("<head>", "<head><script>alert(1)</script>"), "report"),
    "report: elsewhere": (of_report("</main>", '</main><meta http-equiv="refresh" content="0; url=//example.org">'), "report"),
    "report: changed script": (of_report('"use strict";', '"use strict"; alert(1);'), "report"),
    "report: changed script with its hash": (script_with_its_hash, "report"),
    "report: other notes": (of_report("0.11 mm\n   surface", "1.6 mm\n   surface"), "report"),
    "report: of another tape": (of_report('"name":"tactape-s100"', '"name":"tactape-s101"'), "report"),
}
"""What somebody at the fab, or on the shop floor, reads or opens."""
ATTACKS |= FOR_PEOPLE


def test_an_unchanged_drawing_is_written_again_the_same(flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    before = dict(kit.data)
    pdf(lambda objects: None)(kit)
    assert kit.data == before
    for as_ascii in (False, True):
        of_page(lambda content: content, as_ascii=as_ascii)(kit)
        assert not failed(verify_kit(kit.save(consistent=True), quick=True))


def test_what_is_not_compared_is_said(flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.manifest["tool"]["version"] = "0.0.1"
    script_with_its_hash(kit)
    said = {check.name: check.message for check in verify_kit(kit.save(consistent=True), quick=True).checks}
    assert all("not compared: " in said[name] for name in ("order-notes", "fab-drawing", "report"))
    assert said["report"].endswith(", and the script, of another version")


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
    "drill: of other coordinates": (
        bytes_of("drill-npth", lambda b: re.sub(rb"(?<=SameCoordinates,)[^\n]*", b"another", b)),
        "attributes",
    ),
    "drill: of another date": (swap("drill-npth", "CreationDate,1980", "CreationDate,1979"), "attributes"),
    "outline: of another project": (swap("profile", "ProjectId,tactape-s100", "ProjectId,tactape-s007"), "attributes"),
    "KiCad board: a rule in quotes": (swap("kicad-project", '"min_clearance": 0.1', '"min_clearance": "0.1"'), "kicad board"),
    "job: full-width digits": (bytes_of("job", lambda b: b.replace(b'": "1980', '": "\uff11980'.encode())), "job"),
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


def placements(pattern: str, new: str | Callable[[re.Match[str]], str], count: int = 0) -> Edit:
    return bytes_of("placement-preview", lambda data: re.sub(pattern, new, data.decode("utf-8"), count=count).encode("utf-8"))


def picture(change: Callable[[Any], Any]) -> Edit:
    """The preview's pixels changed."""

    def changed(data: bytes) -> bytes:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        return bytes(cv2.imencode(".png", np.ascontiguousarray(change(image.copy())))[1])

    return bytes_of("preview-png", changed)


def one_part_away(image: Any) -> Any:
    """R1, at (6.9, 18) mm of a board of 20 mm, painted over with film: 20 px a mm, 2 mm of margin."""
    image[68:92, 166:190] = image[480 - 45, 45]
    return image


OF_PICTURES: dict[str, tuple[Edit, str]] = {
    "placements: other names": (placements(">R2<", ">R3<"), "previews"),
    "placements: names exchanged": (
        placements(">R([12])<", lambda found: f">R{3 - int(found[1])}<"),
        "previews",
    ),
    "placements: a part that is not there": (placements(">R28<", ">R95<"), "previews"),
    "placements: a part before the first": (placements(">R28<", ">R0<"), "previews"),
    "placements: another angle": (placements("45°", "135°"), "previews"),
    "placements: no angle": (placements("45°", "45"), "previews"),
    "placements: land 1 at the other end": (
        placements(r'cx="([\d.]+)" cy="-([\d.]+)"', lambda m: f'cx="{float(m[1]) + 58.26:.2f}" cy="-{float(m[2]) + 58.26:.2f}"'),
        "previews",
    ),
    "placements: a body moved": (placements("721.82,-1810.61", "722.82,-1810.61"), "previews"),
    "placements: a part less": (placements(r"<circle[^>]*>\n<text[^>]*>R9</text>\n", ""), "previews"),
    "placements: nothing": (placements(r"(?s)(?<=</title>\n).*(?=</svg>)", ""), "previews"),
    "placements: no numbers": (placements("721.82,-1810.61", "7-1.82,-18..61"), "previews"),
    "picture: white": (picture(lambda image: image * 0 + 255), "previews"),
    "picture: mirrored": (picture(lambda image: image[:, ::-1]), "previews"),
    "picture: one part away": (picture(one_part_away), "previews"),
    "picture: half of it": (picture(lambda image: image[:, :240]), "previews"),
}
"""What is held beside the fab's own viewer."""
ATTACKS |= OF_PICTURES


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
    theirs = (other.path / other.files["legend-top"]).read_bytes().replace(b"tactape-s101", b"tactape-s100")
    own = kit.data["legend-top"]
    guid = re.search(rb"SameCoordinates,([^*]*)", own)
    assert guid is not None
    kit.data["legend-top"] = re.sub(rb"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", guid[1], theirs)
    assert set(failed(verify_kit(kit.save(consistent=True), quick=True))) == {"fab-dxf", "kicad board", "label"}


def test_attributes_in_comments_are_compared_like_statements(tmp_path: Path) -> None:
    from tactape_fab import TapeSpec, make_kit

    spec = TapeSpec(sector=101, size_mm=(20.0, 20.0), x2="comments", models=False)
    folder = make_kit(spec, tmp_path / "kit").path
    kit = OpenKit(folder)
    before, lines = kit.data["copper-top"], []
    for old, new in ((b"TO.P,R7,1*", b"TO.P,R8,1*"), (b"Copper,L1,Top", b"Copper,L2,Bot"), (b"G04 #@! TO.P,R7,1*\n", b"")):
        kit.data["copper-top"] = swapped(before, old, new)
        signed = kit.data["copper-top"].partition(b"G04 #@! TF.MD5")[0].replace(b"\n", b"")
        digest = hashlib.md5(signed, usedforsecurity=False).hexdigest().encode()
        kit.data["copper-top"] = re.sub(rb"(?<=MD5,)[0-9a-f]{32}", digest, kit.data["copper-top"])
        kit.sign = False
        lines.append({*failed(verify_kit(kit.save(consistent=True), quick=True))})
    assert "copper-top names" in lines[0] and "attributes" in lines[1] and "copper-top names" in lines[2]


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
        # names with the letters of the attributes TA and TO
        {"pitch_mm": 2.0, "coverlay": "per-part", "anchor": "mesh", "name": "TAPE-TO.1"},
        {"coverlay": "gang", "stiffener": "FR4 0.2", "adhesive": "3M468 0.13"},
        {"fab": "pcbway-fr4", "x2": "comments", "name": "DATA"},
        {"fab": "generic-lpi", "x2": "off", "holes_mm": [(16.4, 10.0, 1.0), (16.4, 14.0, 0.8)]},
    ]
    for number, values in enumerate(specs):
        kit = make_kit(TapeSpec(sector=3, size_mm=(26.0, 22.0), models=False, **values), tmp_path / f"kit{number}")
        assert {"written form", "components-top data", "label", "job"} <= {c.name for c in kit.checks if c.passed}
