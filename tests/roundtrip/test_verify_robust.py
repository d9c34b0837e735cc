"""`verify` answers whatever a kit's files hold: it returns its lines and never raises, and what was moved fails.

Damage is random with fixed seeds, or of a kind that parsers trip over; hashes are made to fit, so that the content is
always looked at. A warning counts as an exception here: it would reach the user's terminal.
"""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest

from tactape_fab import Kit
from tactape_fab.verify import Verification, verify_kit
from tests.roundtrip.kits import MODELS, ROLES, Edit, OpenKit, aperture, bytes_of, failed, flashes, points, replaced, text_of
from tests.thorough import THOROUGH, some

Copy = Callable[[Kit], Path]


def _short(value: object) -> str:
    return repr(value)[:12]


# Random damage


def _flip(random: Random, data: bytes) -> bytes:
    damaged = bytearray(data)
    for _ in range(random.randint(1, 4)):
        damaged[random.randrange(len(damaged))] = random.randrange(256)
    return bytes(damaged)


def _digit(random: Random, data: bytes) -> bytes:
    i = random.choice([m.start() for m in re.finditer(rb"\d", data)])
    return data[:i] + str(random.randrange(10)).encode() + data[i + 1 :]


def _cut(random: Random, data: bytes) -> bytes:
    return data[: random.randrange(len(data))]


def _remove(random: Random, data: bytes) -> bytes:
    i = random.randrange(len(data))
    return data[:i] + data[i + random.randint(1, 60) :]


def _repeat(random: Random, data: bytes) -> bytes:
    i = random.randrange(len(data))
    return data[: i + random.randint(1, 60)] + data[i:]


def _insert(random: Random, data: bytes) -> bytes:
    i = random.randrange(len(data))
    return data[:i] + random.randbytes(random.randint(1, 8)) + data[i:]


DAMAGES = (_flip, _digit, _cut, _remove, _repeat, _insert)


@pytest.mark.parametrize(("role", "seed"), [(role, seed) for i, role in enumerate(ROLES) for seed in range(i % 2, 6, 2)])
def test_random_damage_of_a_file_is_answered(role: str, seed: int, small_kit: Kit, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(small_kit if role in MODELS else flat_kit))
    kit.sign = seed % 4 != 3
    kit.data[role] = DAMAGES[seed % len(DAMAGES)](Random(f"{role} {seed}"), kit.data[role])
    verification = verify_kit(kit.save(consistent=True), quick=True)
    assert isinstance(verification, Verification)
    assert verification.checks[0].passed


@pytest.mark.parametrize("seed", range(some(12)))
def test_random_damage_of_the_manifest_is_answered(seed: int, small_kit: Kit, copied: Copy) -> None:
    file = copied(small_kit) / "manifest.json"
    file.write_bytes(DAMAGES[seed % len(DAMAGES)](Random(f"manifest {seed}"), file.read_bytes()))
    assert verify_kit(file, quick=True).checks


def _leaves(value: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Paths of all values of a manifest, tables and lists included."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(leaf for key, item in inner for leaf in _leaves(item, (*path, key)))]


@pytest.mark.parametrize("value", [None, True, -1, 1e308, 10**400, "", "x", [], {}, [[]], {"x": None}], ids=_short)
def test_any_value_anywhere_in_the_manifest_is_answered(value: object, small_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(small_kit))
    file = kit.folder / "manifest.json"
    text = file.read_text()
    random = Random(repr(value)[:10])
    for path in random.sample(_leaves(kit.manifest)[1:], some(8)):
        manifest: Any = json.loads(text)
        place = manifest
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
        file.write_text(json.dumps(manifest))
        assert verify_kit(file, quick=True).checks, path


# Changes that can be told for certain


def _other_digit(random: Random, number: str, least: float) -> str:
    """The number with one digit changed, so that its value differs by more than `least`."""
    choices = [
        text
        for i, old in enumerate(number)
        if old.isdigit()
        for new in "0123456789"
        if abs(float(text := number[:i] + new + number[i + 1 :]) - float(number)) > least
    ]
    return random.choice(choices)


FLASH = r"(?<=X)-?\d+(?=Y-?\d+D03)|(?<=Y)-?\d+(?=D03)"
CENTRE = r"(?<=D10\*\nX)\d+|(?<=D10\*\nX\d{8}Y)\d+"
CPL_NUMBER = r"(?<=,)\d+\.\d{4}(?=,)|(?<=Top,)\d+"

DIGITS = {
    "copper-top": (FLASH, 2000.0),
    "paste-top": (FLASH, 2000.0),
    "coverlay-top": (FLASH, 1000.0),
    "components-top": (CENTRE, 1000.0),
    "profile": (r"(?<=[XY])\d{7,}", 10_000.0),
    "cpl": (CPL_NUMBER, 0.0015),
    "drill-npth": (r"(?<=[XYC])\d+\.\d{4}", 0.0015),
    "bom": (r"(?<=R)\d+(?=[,\"])", 0.0),
}
"""Where the numbers of a file stand, and by more than what one must change (nm, mm, or the number of a part)."""


@pytest.mark.parametrize("seed", range(4 if THOROUGH else 3))
@pytest.mark.parametrize("role", DIGITS)
def test_a_changed_digit_fails_the_line_of_its_file(role: str, seed: int, flat_kit: Kit, copied: Copy) -> None:
    random = Random(f"digit {role} {seed}")
    kit = OpenKit(copied(flat_kit))
    pattern, least = DIGITS[role]
    text = kit.data[role].decode("ascii")
    place = random.choice(list(re.finditer(pattern, text)))
    number = _other_digit(random, place[0], least)
    kit.data[role] = (text[: place.start()] + number + text[place.end() :]).encode("ascii")
    lines = failed(verify_kit(kit.save(consistent=True), quick=True))
    assert any(name.startswith(role) for name in lines), (place[0], number)
    assert lines.keys().isdisjoint({"files", "fab-zip", "attributes"})


@pytest.mark.parametrize("seed", range(8))
def test_a_damaged_zip_fails_unless_its_files_are_whole(seed: int, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.data["fab-zip"] = _flip(Random(f"zip {seed}"), kit.data["fab-zip"])
    lines = failed(verify_kit(kit.save(consistent=True), quick=True))
    assert ("fab-zip" in lines) is not _holds_the_same(kit, flat_kit)


def _holds_the_same(kit: OpenKit, original: Kit) -> bool:
    def members(data: bytes) -> dict[str, bytes]:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return {name: archive.read(name) for name in archive.namelist()}

    try:
        return members(kit.data["fab-zip"]) == members((original.path / original.files["fab-zip"]).read_bytes())
    except Exception:
        return False


# What parsers trip over


def _drawn(kit: OpenKit, *lines: str) -> None:
    """Replace what the profile draws."""
    text = kit.data["profile"].decode("ascii")
    drawn = text[text.index("X1000000Y0D02*") : text.index("%TF.MD5")]
    kit.text("profile", lambda t: t.replace(drawn, "".join(f"{line}\n" for line in lines)))


def _two_vertices(role: str) -> Edit:
    macro = "4,1,2,\n0.100000,0.100000,\n0.200000,0.200000,\n0.100000,0.100000,\n0*%"
    return text_of(role, lambda t: re.sub(r"4,1,\d+,\n.*?\n0\*%", macro, t, flags=re.DOTALL))


def _circle(role: str, diameter_mm: float) -> Edit:
    return text_of(role, lambda t: re.sub(r"%ADD10[A-Z]+\*%", f"%ADD10C,{diameter_mm}*%", t))


def _far_flash(role: str, distance_mm: float) -> Edit:
    return flashes(role, lambda _: (distance_mm, distance_mm), 4)


def _cpl_x(value: str) -> Edit:
    return bytes_of("cpl", lambda b: b.replace(b"R10,8.4000", b"R10," + value.encode("utf-8")))


def _job(**changes: Any) -> Edit:
    return bytes_of("job", lambda b: json.dumps({**json.loads(b), **changes}).encode())


def _vast_png(kit: OpenKit) -> None:
    data = bytearray(kit.data["preview-png"])
    data[16:24] = struct.pack(">II", 60_000, 60_000)
    data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    kit.data["preview-png"] = bytes(data)


def _zip_method(method: int, flags: int = 0) -> Edit:
    """Claim another compression, or encryption, of the first file in the zip, in both of its headers."""

    def edit(kit: OpenKit) -> None:
        data = bytearray(kit.data["fab-zip"])
        for signature, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
            start = data.index(signature) + place
            data[start : start + 4] = struct.pack("<HH", flags, method)
        kit.data["fab-zip"] = bytes(data)

    return edit


def _zip_noise(kit: OpenKit) -> None:
    data = bytearray(kit.data["fab-zip"])
    start = 30 + struct.unpack_from("<H", data, 26)[0]
    data[start : start + 40] = b"\xff" * 40
    kit.data["fab-zip"] = bytes(data)


HOSTILE: list[tuple[str, str, Edit]] = [
    # Gerber
    ("profile: a point", "profile", lambda kit: _drawn(kit, "X1000000Y0D02*", "X1000000Y0D01*")),
    ("profile: there and back", "profile", lambda kit: _drawn(kit, "X0Y0D02*", "X2000000Y0D01*", "X0Y0D01*")),
    ("profile: nothing", "profile", _drawn),
    ("profile: arc without radius", "profile", replaced("profile", "I0J1000000", "I0J0")),
    ("profile: 30 digits", "profile", text_of("profile", lambda t: t.replace("X20000000", "X2" + "0" * 30))),
    ("profile: 400 digits", "profile", text_of("profile", lambda t: t.replace("X20000000", "X2" + "0" * 400))),
    ("profile: rectangular pen", "profile", replaced("profile", "C,0.100000", "R,0.1X0.1")),
    ("legend: rectangular pen", "legend-top", text_of("legend-top", lambda t: re.sub(r"(?<=ADD10)C,[\d.]+", "R,0.1X0.1", t))),
    ("attribute without a name", "profile", replaced("profile", "%TF.CreationDate,", "%TF,")),
    ("pad: two vertices", "copper-top", _two_vertices("copper-top")),
    ("pad: a point", "copper-top", aperture("copper-top", lambda _: (0.0, 0.0))),
    ("pad: a line", "copper-top", aperture("copper-top", lambda p: (p[0], p[0]))),
    ("pad: no diameter", "copper-top", _circle("copper-top", 0.0)),
    ("pad: a circle", "copper-top", _circle("copper-top", 0.4)),
    ("paste: two vertices", "paste-top", _two_vertices("paste-top")),
    ("opening: two vertices", "coverlay-top", _two_vertices("coverlay-top")),
    ("opening: no diameter", "coverlay-top", _circle("coverlay-top", 0.0)),
    ("pad: very far", "copper-top", _far_flash("copper-top", 1e30)),
    ("pad: unbelievably far", "copper-top", _far_flash("copper-top", 1e290)),
    ("opening: unbelievably far", "coverlay-top", _far_flash("coverlay-top", 1e290)),
    ("pads: all in one place", "copper-top", points("copper-top", lambda _: (5.0, 5.0))),
    ("pads: none", "copper-top", text_of("copper-top", lambda t: re.sub(r"X.*D03\*\n", "", t))),
    ("openings: none", "coverlay-top", text_of("coverlay-top", lambda t: re.sub(r"X.*D03\*\n", "", t))),
    ("components: none", "components-top", text_of("components-top", lambda t: re.sub(r"X.*D03\*\n", "", t))),
    # drill
    ("drill: no unit", "drill-npth", replaced("drill-npth", "METRIC\n", "")),
    ("drill: inches", "drill-npth", replaced("drill-npth", "METRIC", "INCH")),
    ("drill: no tool", "drill-npth", replaced("drill-npth", "G05\nT1\n", "G05\n")),
    # CSV
    *[(f"CPL: {value}", "cpl", _cpl_x(value)) for value in ("1e9", "1e30", "1e300", "-1e300", "inf", "", "８", "0x8", '"')],
    ("CPL: a turn of 1e300 deg", "cpl", bytes_of("cpl", lambda b: b.replace(b"Top,45", b"Top,1e300", 1))),
    ("CPL: header only", "cpl", bytes_of("cpl", lambda b: b[: b.index(b"\n") + 1])),
    ("CPL: a blank line", "cpl", lambda kit: kit.data.update(cpl=b"\r\n")),
    ("CPL: a NUL", "cpl", bytes_of("cpl", lambda b: b.replace(b"R10", b"R1\x00"))),
    ("CPL: UTF-16", "cpl", bytes_of("cpl", lambda b: b.decode().encode("utf-16"))),
    ("BOM: header only", "bom", bytes_of("bom", lambda b: b[: b.index(b"\n") + 1])),
    ("BOM: a blank line", "bom", lambda kit: kit.data.update(bom=b"\r\n")),
    ("BOM: quantity of 5000 digits", "bom", bytes_of("bom", lambda b: b.replace(b",94,", b"," + b"9" * 5000 + b","))),
    # job, preview, zip
    ("job: nested deep", "job", lambda kit: kit.data.update(job=b"[" * 100_000)),
    ("job: a list", "job", lambda kit: kit.data.update(job=b"[]")),
    ("job: names that are no texts", "job", _job(FilesAttributes=[{"Path": 1}, {"Path": "x"}])),
    ("job: names that are lists", "job", _job(FilesAttributes=[{"Path": [1]}])),
    ("job: files are a text", "job", _job(FilesAttributes="x")),
    ("job: size of 400 digits", "job", _job(GeneralSpecs={"Size": {"X": 10**400, "Y": 20}})),
    ("job: size NaN", "job", _job(GeneralSpecs={"Size": {"X": float("nan"), "Y": 20}})),
    ("preview: vast", "previews", _vast_png),
    ("zip: noise in a file", "fab-zip", _zip_noise),
    *[(f"zip: method {method}", "fab-zip", _zip_method(method)) for method in (0, 9, 12, 14, 99)],
    ("zip: encrypted", "fab-zip", _zip_method(8, flags=1)),
]


@pytest.mark.parametrize(("line", "edit"), [pytest.param(line, edit, id=name) for name, line, edit in HOSTILE])
def test_hostile_content_fails_the_line_of_its_file(line: str, edit: Edit, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    before = dict(kit.data)
    edit(kit)
    assert kit.data != before
    lines = failed(verify_kit(kit.save(consistent=True), quick=True))
    assert any(name.startswith(line) for name in lines)


@pytest.mark.parametrize("value", [None, "x", 5, {}, [None], ["x"], [[]], [{}], [5]], ids=_short)
def test_any_list_of_files_is_answered(value: object, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.manifest["files"] = value
    (kit.folder / "manifest.json").write_text(json.dumps(kit.manifest))
    assert "files" in failed(verify_kit(kit.folder, quick=True))


def _own_link(place: Path) -> None:
    place.symlink_to(place.name)


@pytest.mark.parametrize("make", [_own_link, Path.mkdir], ids=["a link to itself", "a folder"])
def test_what_is_no_file_is_answered(make: Callable[[Path], None], flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    place = kit.folder / kit.paths["copper-top"]
    place.unlink()
    make(place)
    lines = failed(verify_kit(kit.folder, quick=True))
    assert "gerber/tactape-s100.gtl" in lines["files"].message


@pytest.mark.parametrize("path", ["a" * 280, "a/" * 140 + "a", "manifest.json", ".", "gerber", " ", None, 5, [], {}], ids=_short)
def test_any_path_is_answered(path: object, flat_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(flat_kit))
    kit.manifest["files"][0]["path"] = path
    (kit.folder / "manifest.json").write_text(json.dumps(kit.manifest))
    assert "files" in failed(verify_kit(kit.folder, quick=True))
