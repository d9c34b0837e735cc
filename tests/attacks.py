"""Files that are small to send and dear to read, each with the command that reads it, and what that costs.

Every one is at most 1 MB as it is sent (a sparse file counts as what it takes in an archive).
`tests/roundtrip/test_limits.py` runs them, `python docs/make_limits.py` writes their table.
"""

from __future__ import annotations

import io
import json
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactape_fab.base.launch import limited
from tactape_fab.texture.frames import FloatArray
from tests.png import black_png
from tests.roundtrip.kits import OpenKit

MOST_CPU_S, MOST_BYTES = 5.0, 1 << 30
"""No input of at most 1 MB costs more, the start of the program and the kit's other files included."""
_KILLED_AFTER_S, _MEMORY = 60, 8 << 30


@dataclass(frozen=True, slots=True, kw_only=True)
class Attack:
    """An attack: its class, what is tried, how a folder with it is made, and the command's answer.

    Attributes
    ----------
    kind, tried : str
        Its row of the table.
    make : callable
        Puts the hostile files into a folder that holds a kit, `kit`; returns the command's arguments.
    status : int
        Exit status of the command.
    said : str
        Part of the command's answer.
    """

    kind: str
    tried: str
    make: Callable[[Path], list[str]]
    status: int
    said: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What a command cost, its children included, and what it answered."""

    cpu_s: float
    peak_bytes: int
    status: int
    output: str


def cost_of(attack: Attack, kit: Path) -> Cost:
    """Run an attack against a fresh copy of a kit; it is killed after a minute."""
    with tempfile.TemporaryDirectory(prefix="tactape-attack-") as folder:
        place = Path(folder)
        subprocess.run(["cp", "-r", str(kit), str(place / "kit")], check=True)
        arguments = attack.make(place)
        return measured(arguments, place)


_COUNTED = """
import os, sys
_, status, used = os.wait4(os.posix_spawn(sys.argv[2], sys.argv[2:], os.environ), 0)
with open(sys.argv[1], "w") as counted:
    print(os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, used.ru_maxrss * 1024, file=counted)
"""
"""Runs a command and writes its status, processor time and memory to a file. It stands between, as ru_maxrss begins with what the
parent has (Linux), and that of tests has much."""


def measured(arguments: list[str], folder: Path) -> Cost:
    """Cost of `tactape-fab` with these arguments in a folder."""
    command = limited([sys.executable, "-m", "tactape_fab", *arguments], cpu_s=_KILLED_AFTER_S, memory_bytes=_MEMORY)
    counting = [sys.executable, "-S", "-c", _COUNTED, str(folder / "counted"), *command]
    with (folder / "said").open("wb") as said:
        subprocess.run(counting, cwd=folder, stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT, check=True)
    output = (folder / "said").read_text("utf-8", "replace")
    status, cpu_s, peak_bytes = (folder / "counted").read_text().split()
    return Cost(cpu_s=float(cpu_s), peak_bytes=int(peak_bytes), status=int(status), output=output)


# Kits


def _verify(change: Callable[[OpenKit], object], *options: str) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        kit = OpenKit(folder / "kit")
        change(kit)
        kit.save(consistent=True)
        return ["verify", "kit", *(options or ("--quick",))]

    return make


def _role(role: str, data: Callable[[], bytes]) -> Callable[[Path], list[str]]:
    return _verify(lambda kit: kit.data.update({role: data()}))


def _text(role: str, old: str, new: str) -> Callable[[Path], list[str]]:
    def change(kit: OpenKit) -> None:
        assert old in kit.data[role].decode("ascii"), old
        kit.data[role] = kit.data[role].replace(old.encode(), new.encode(), 1)

    return _verify(change)


def _zip(*members: tuple[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in members:
            archive.writestr(name, data)
    return stream.getvalue()


def _threemf(model: bytes) -> bytes:
    return _zip(("[Content_Types].xml", b"<Types/>"), ("_rels/.rels", b"<Relationships/>"), ("3D/3dmodel.model", model))


def _declared_small(data: bytes) -> bytes:
    """A zip whose last member says that it unpacks to 100 bytes."""
    changed = bytearray(data)
    local, entry = data.rindex(b"PK\3\4"), data.rindex(b"PK\1\2")
    struct.pack_into("<I", changed, local + 22, 100)
    struct.pack_into("<I", changed, entry + 24, 100)
    return bytes(changed)


def _many_names(count: int) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for i in range(count):
            archive.writestr(zipfile.ZipInfo(f"{i:x}"), b"")
    return stream.getvalue()


def _sparse_listed(times: int, *, alike: bool) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        file = folder / "kit" / "manifest.json"
        manifest = json.loads(file.read_bytes())
        for i in range(times):
            name = "big" if alike else f"big{i}"
            with (folder / "kit" / name).open("wb") as stream:
                stream.truncate(1 << 30)
            manifest["files"].append({"role": f"stl{i}", "path": name, "bytes": 1 << 30, "sha256": "0" * 64})
        file.write_text(json.dumps(manifest))
        return ["verify", "kit", "--quick"]

    return make


def _manifest(text: bytes, *command: str) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        (folder / "kit" / "manifest.json").write_bytes(text)
        return list(command or ("verify", "kit", "--quick"))

    return make


def _large_manifest(size: int, *command: str) -> Callable[[Path], list[str]]:
    """A manifest of nothing but empty lists, which Python turns into objects of twenty times the size."""

    def make(folder: Path) -> list[str]:
        with (folder / "kit" / "manifest.json").open("wb") as stream:
            stream.write(b"[")
            for _ in range(size // 3_000_000):
                stream.write(b"[]," * 1_000_000)
            stream.write(b"[]]")
        return list(command or ("verify", "kit", "--quick"))

    return make


def _arcs(kit: OpenKit) -> None:
    arc = "X100000000000Y0I-100000000000J0D01*\n"
    text = kit.data["profile"].decode("ascii")
    start = text.index("X", text.index("D10*"))
    kit.data["profile"] = (text[:start] + "X100000000000Y0D02*\nG03*\n" + arc * 20_000 + text[text.index("%TF.MD5") :]).encode()


def _repeated(role: str, before: str, text: str, size: int = 900_000) -> Callable[[Path], list[str]]:
    """Put a text, repeated to this size, before another in a file of the kit."""

    def change(kit: OpenKit) -> None:
        data = kit.data[role]
        at = data.index(before.encode())
        kit.data[role] = data[:at] + text.encode() * (size // len(text)) + data[at:]

    return _verify(change)


# Frames


def _npy_header(length: int) -> bytes:
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", length)


def _frames(name: str, data: Callable[[], bytes]) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        (folder / name).write_bytes(data())
        return ["decode", name, "--tape", "kit"]

    return make


def _spaces(count: int) -> bytes:
    """The deflated form of a zip member of a numpy header of `count` spaces."""
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive,
        archive.open("depth.npy", "w", force_zip64=False) as member,
    ):
        member.write(_npy_header(count))
        block = b" " * (1 << 20)
        for _ in range(count >> 20):
            member.write(block)
    return stream.getvalue()


# Parts to emboss


def _emboss(name: str, data: Callable[[], bytes]) -> Callable[[Path], list[str]]:
    def make(folder: Path) -> list[str]:
        (folder / name).write_bytes(data())
        return ["emboss", "kit", name, "-o", "out"]

    return make


_MODEL = b'<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
_PLY = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\nproperty float z\n"
    b"element face 1\nproperty list uchar int vertex_indices\nend_header\n" + bytes(1000)
)


def _long_package() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in ("[Content_Types].xml", "_rels/.rels"):
            archive.writestr(name, b"<Types/>")
        with archive.open("3D/3dmodel.model", "w", force_zip64=False) as member:
            for _ in range(870):
                member.write(bytes(1 << 20))
    return stream.getvalue()


def _as_built(folder: Path) -> list[str]:
    with (folder / "kit" / "as-built.json").open("wb") as stream:
        stream.truncate(1 << 30)
    return ["verify", "kit", "--quick"]


def _many_items(items: int, vertices: int) -> bytes:
    points = b'<vertex x="0" y="0" z="0"/>' * vertices
    mesh = b"<mesh><vertices>" + points + b'</vertices><triangles><triangle v1="0" v2="1" v3="2"/></triangles></mesh>'
    build = b"</resources><build>" + b'<item objectid="1"/>' * items + b"</build></model>"
    return _threemf(_MODEL + b'<resources><object id="1">' + mesh + b"</object>" + build)


def _long_model() -> bytes:
    """A 3MF whose model unpacks to a thousand times its size."""
    stream = io.BytesIO()
    archive = zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=9)
    with archive, archive.open("3D/3dmodel.model", "w") as member:
        member.write(_MODEL + b'<resources><object id="1"><mesh><vertices>')
        block = b'<vertex x="0" y="0" z="0"/>' * 40_000
        for _ in range(800):
            member.write(block)
    return stream.getvalue()


def stl(corners: FloatArray) -> bytes:
    """Triangles, shape (n, 3, 3), as a binary STL."""
    rows = np.zeros((len(corners), 50), dtype=np.uint8)
    rows[:, 12:48] = corners.reshape(-1, 9).astype("<f4").view(np.uint8).reshape(-1, 36)
    return bytes(80) + struct.pack("<I", len(corners)) + rows.tobytes()


def nested_tetrahedra(count: int) -> bytes:
    """Tetrahedra of 20 to 50 mm about one middle: the boxes of all their triangles overlap."""
    points = np.array([(1, 1, 1), (-1, -1, 1), (-1, 1, -1), (1, -1, -1)], dtype=np.float64)
    one = points[np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])]
    return stl((np.linspace(20.0, 50.0, count)[:, None, None, None] * one).reshape(-1, 3, 3))


def _long_strip(count: int) -> bytes:
    """A closed strip of triangles whose vertices are met in a random order."""
    random = np.random.default_rng(1)
    places = random.permutation(count).astype(np.float64)
    corners = np.zeros((count - 2, 3, 3))
    for k in range(3):
        corners[:, k, 0] = places[k : count - 2 + k]
    return stl(corners)


_PLY_FACES = (
    b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 4000000000\n"
    b"property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
)


def _step(data: bytes) -> bytes:
    """A STEP file with this data section."""
    return (
        b"ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\n"
        b"FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));\nENDSEC;\nDATA;\n" + data + b"ENDSEC;\nEND-ISO-10303-21;\n"
    )


def _npy(kind: str, shape: str, version: int = 1) -> bytes:
    """The header of an array of a kind and a shape."""
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY" + bytes([version, 0]) + len(header).to_bytes(2 if version == 1 else 4, "little") + header


def _on_one_edge(count: int) -> bytes:
    """Triangles that share an edge."""
    corners = np.zeros((count, 3, 3))
    corners[:, 1, 2] = 30.0
    corners[:, 2] = np.random.default_rng(1).uniform(-30.0, 30.0, (count, 3))
    return stl(corners)


def _of_themselves(count: int) -> bytes:
    """3MF objects, each of two of the one before, the first of itself."""
    pair = b'<component objectid="%d"/>'
    objects = [
        b'<object id="%d"><components>' % i + pair % max(i - 1, 1) * 2 + b"</components></object>" for i in range(1, count)
    ]
    build = b'</resources><build><item objectid="%d"/></build></model>' % (count - 1)
    return _threemf(_MODEL + b"<resources>" + b"".join(objects) + build)


def _entities(count: int) -> bytes:
    """XML entities, each of ten of the one before."""
    rest = [b'<!ENTITY a%d "%s">' % (i, b"&a%d;" % (i - 1) * 10) for i in range(1, count)]
    return (
        b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY a0 "x">'
        + b"".join(rest)
        + b']><model unit="millimeter">&a%d;</model>' % (count - 1)
    )


def _drawn(line: Callable[[int], bytes], count: int) -> Callable[[Path], list[str]]:
    """More drawings on the KiCad board."""

    def change(kit: OpenKit) -> None:
        kit.data["kicad-pcb"] = kit.data["kicad-pcb"].rstrip()[:-1] + b"".join(map(line, range(count))) + b")\n"

    return _verify(change)


def _packed(folder: Path) -> list[str]:
    (folder / "a.registry").write_bytes(bytes(900_000))
    return ["registry", "a.registry"]


def _wide_as_built(folder: Path) -> list[str]:
    columns = ",".join(f'"{i}":[{"1," * 449}1]' for i in range(1000))
    (folder / "kit" / "as-built.json").write_text('{"format":"tactape-as-built/1","parts":{' + columns + "}}")
    return ["verify", "kit", "--quick"]


ATTACKS = (
    # what a kit holds
    Attack(
        kind="3MF",
        tried="`<model ` 270,000 times",
        make=_role("3mf", lambda: _threemf(b"<?xml " + b"<model " * 270_000)),
        status=4,
        said="3mf",
    ),
    Attack(
        kind="3MF",
        tried="a vertex of 900,000 quotes",
        make=_role("3mf", lambda: _threemf(b"<?xml " + _MODEL[38:] + b'<vertex x="' * 90_000)),
        status=4,
        said="3mf",
    ),
    Attack(
        kind="3MF",
        tried="a member that is declared small, and unpacks to 870 MB",
        make=_role("3mf", lambda: _declared_small(_long_package())),
        status=4,
        said="3mf",
    ),
    Attack(
        kind="3MF",
        tried="`<item ` 140,000 times",
        make=_role("3mf", lambda: _threemf(_MODEL + b"<item " * 140_000)),
        status=4,
        said="3mf",
    ),
    Attack(kind="3MF", tried="11,000 names", make=_role("3mf", lambda: _many_names(11_000)), status=4, said="3mf"),
    Attack(
        kind="STL",
        tried="19,000 triangles in a chain without order",
        make=_role("stl", lambda: _long_strip(19_000)),
        status=4,
        said="stl",
    ),
    Attack(
        kind="report",
        tried="0.84 MB of script tags",
        make=_role("report", lambda: b'<script type="application/json" id="data">' * 20_000),
        status=4,
        said="report",
    ),
    Attack(kind="fab zip", tried="11,000 names", make=_role("fab-zip", lambda: _many_names(11_000)), status=4, said="fab-zip"),
    Attack(
        kind="fab zip",
        tried="a member that is declared small, and unpacks to 900 MB",
        make=_role("fab-zip", lambda: _declared_small(_long_package())),
        status=4,
        said="fab-zip",
    ),
    Attack(
        kind="order notes",
        tried="140 kB of a path that never ends",
        make=_role("order-notes", lambda: b"\n1. FILES\n" + b"a/" * 70_000),
        status=4,
        said="order-notes",
    ),
    Attack(
        kind="order notes",
        tried="a word of 90 kB",
        make=_role("order-notes", lambda: b"\n1. FILES\n" + b"a." * 45_000),
        status=4,
        said="order-notes",
    ),
    Attack(
        kind="manifest",
        tried="a sparse file of 1 GB, listed 12 times",
        make=_sparse_listed(12, alike=True),
        status=4,
        said="files",
    ),
    Attack(kind="manifest", tried="12 sparse files of 1 GB", make=_sparse_listed(12, alike=False), status=4, said="files"),
    Attack(kind="manifest", tried="255 MB of `[],`", make=_large_manifest(255_000_000), status=4, said="manifest"),
    Attack(
        kind="manifest",
        tried="255 MB of `[],` to decode with",
        make=_large_manifest(255_000_000, "registry", "kit"),
        status=2,
        said="manifest",
    ),
    Attack(kind="manifest", tried="1 MB of `[],`", make=_large_manifest(3_000_000), status=4, said="manifest"),
    Attack(kind="manifest", tried="nested 100,000 deep", make=_manifest(b"[" * 100_000), status=4, said="manifest"),
    Attack(
        kind="drill", tried="`R100000000`", make=_text("drill-npth", "M30", "R100000000X0.1\nM30"), status=4, said="drill-npth"
    ),
    Attack(
        kind="drill", tried="900 kB of tools", make=_repeated("drill-npth", "%\nG05", "T1C1.0000\n"), status=4, said="drill-npth"
    ),
    Attack(
        kind="Gerber",
        tried="an aperture of `X1000000000*`",
        make=_text("profile", "%ADD10C,0.100000*%", "%ADD10P,0.1X1000000000*%"),
        status=4,
        said="profile",
    ),
    Attack(
        kind="Gerber",
        tried="a macro of a polygon of 1,000,000,000 corners",
        make=_text("profile", "%ADD10C,0.100000*%", "%AMA*\n5,1,1000000000,0,0,1,0*%\n%ADD10A*%"),
        status=4,
        said="profile",
    ),
    Attack(kind="Gerber", tried="20,000 circles of 200 m", make=_verify(_arcs), status=4, said="profile"),
    Attack(
        kind="Gerber",
        tried="900 kB of flashes",
        make=_repeated("copper-top", "M02*", "D10*\nX1Y1D03*\n"),
        status=4,
        said="copper-top",
    ),
    Attack(
        kind="Gerber",
        tried="900 kB of strokes in one place",
        make=_repeated("legend-top", "M02*", "X1Y1D01*\n"),
        status=4,
        said="legend-top",
    ),
    Attack(kind="Gerber", tried="900 kB of `%`", make=_repeated("copper-top", "M02*", "%"), status=4, said="copper-top"),
    Attack(kind="CPL", tried="900 kB of quotes", make=_role("cpl", lambda: b'"' * 900_000), status=4, said="cpl"),
    Attack(kind="BOM", tried="900 kB of commas", make=_role("bom", lambda: b"," * 900_000), status=4, said="bom"),
    Attack(
        kind="KiCad",
        tried="900 kB of brackets",
        make=_role("kicad-pcb", lambda: b"(" * 450_000 + b")" * 450_000),
        status=4,
        said="kicad",
    ),
    Attack(
        kind="KiCad",
        tried="900 kB of lists",
        make=_role("kicad-pcb", lambda: b"(" + b"(a)" * 300_000 + b")"),
        status=4,
        said="kicad",
    ),
    Attack(
        kind="job", tried="900 kB of `[],`", make=_role("job", lambda: b"[" + b"[]," * 300_000 + b"[]]"), status=4, said="job"
    ),
    Attack(
        kind="certificate",
        tried="nested 400,000 deep",
        make=_role("certificate", lambda: b"[" * 400_000),
        status=4,
        said="certificate",
    ),
    Attack(
        kind="preview",
        tried="a PNG of 20,000 x 20,000 px",
        make=_role("preview-png", lambda: black_png(20_000, 20_000, bits=1)),
        status=4,
        said="previews",
    ),
    Attack(
        kind="STEP",
        tried="900 kB of points",
        make=_role("step-solid", lambda: b"ISO-10303-21;" + b"#1=CARTESIAN_POINT('',(" * 39_000),
        status=4,
        said="step-solid",
    ),
    Attack(
        kind="STEP",
        tried="900 kB of occurrences without end",
        make=_role("step-assembly", lambda: b"ISO-10303-21;" + b"CARTESIAN_POINT('',(0.,0.,0.));#1=AXIS2_PLACEMENT_3D" * 17_000),
        status=4,
        said="step-assembly",
    ),
    Attack(kind="as-built", tried="a sparse file of 1 GB", make=_as_built, status=4, said="as-built"),
    # frames
    Attack(
        kind="frames",
        tried="npz with a header of 4 GB",
        make=_frames("f.npz", lambda: _spaces(900 << 20)),
        status=2,
        said="f.npz",
    ),
    Attack(
        kind="frames",
        tried="npy with a header of 4 GB",
        make=_frames("f.npy", lambda: _npy_header(0xFFFFFFFF)),
        status=2,
        said="f.npy",
    ),
    Attack(
        kind="frames", tried="npz of 11,000 names", make=_frames("f.npz", lambda: _many_names(11_000)), status=2, said="f.npz"
    ),
    Attack(
        kind="frames",
        tried="PNG of 20,000 x 20,000 px",
        make=_frames("f.png", lambda: black_png(20_000, 20_000, bits=1)),
        status=2,
        said="f.png",
    ),
    # parts to emboss
    Attack(
        kind="emboss",
        tried="3MF of 9,000 items of 100,000 vertices",
        make=_emboss("a.3mf", lambda: _many_items(9_000, 100_000)),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss", tried="3MF of 0.9 MB that unpacks to 1 GB", make=_emboss("a.3mf", _long_model), status=2, said="SURFACE"
    ),
    Attack(
        kind="emboss",
        tried="5,000 nested tetrahedra",
        make=_emboss("a.stl", lambda: nested_tetrahedra(5_000)),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="900 kB of an OBJ's faces",
        make=_emboss("a.obj", lambda: b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * 112_000),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="OBJ faces of many corners",
        make=_emboss("a.obj", lambda: b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1 2 3" * 150_000),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="PLY of 4,000,000,000 announced vertices",
        make=_emboss("a.ply", lambda: _PLY),
        status=2,
        said="SURFACE",
    ),
    # more of all kinds
    Attack(
        kind="emboss",
        tried="STEP of 900 kB of brackets",
        make=_emboss("a.step", lambda: _step(b"#1=A(" + b"(" * 450_000 + b")" * 450_000 + b");\n")),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="STEP of 30,000 solids without faces",
        make=_emboss("a.step", lambda: _step(b"".join(b"#%d=MANIFOLD_SOLID_BREP('',#1);\n" % i for i in range(2, 30000)))),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="STEP of a spline of 80,000 points",
        make=_emboss(
            "a.step",
            lambda: _step(
                b"#1=CARTESIAN_POINT('',(0.,0.,0.));\n#2=B_SPLINE_SURFACE('',80000,80000,(("
                + b"#1," * 150000
                + b"#1)),.UNSPECIFIED.,.F.,.F.,.F.);\n"
            ),
        ),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="OBJ of 900 kB of one line",
        make=_emboss("a.obj", lambda: b"v " + b"1 " * 450_000),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="PLY of a list of 255 corners, announced 4,000,000,000 times",
        make=_emboss("a.ply", lambda: _PLY_FACES + b"255 " * 200_000),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="STL of triangles on one edge",
        make=_emboss("a.stl", lambda: _on_one_edge(18_000)),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="ASCII STL of 900 kB of `facet`",
        make=_emboss("a.stl", lambda: b"solid a\n" + b"facet\n" * 150_000),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="3MF of components that name themselves",
        make=_emboss("a.3mf", lambda: _of_themselves(6000)),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="emboss",
        tried="3MF with entities within entities",
        make=_emboss("a.3mf", lambda: _threemf(_entities(12))),
        status=2,
        said="SURFACE",
    ),
    Attack(
        kind="3MF",
        tried="a model of 900 kB of entities",
        make=_role("3mf", lambda: _threemf(b'<?xml version="1.0"?><!DOCTYPE a [' + b'<!ENTITY a "x">' * 60_000 + b"]>")),
        status=4,
        said="3mf",
    ),
    Attack(
        kind="frames",
        tried="npz of 900 depths of 4096 x 4096 px",
        make=_frames("f.npz", lambda: _zip(*((f"d{i}.npy", _npy("<f8", "(4096, 4096)")) for i in range(900)))),
        status=2,
        said="f.npz",
    ),
    Attack(
        kind="frames",
        tried="npy of objects",
        make=_frames("f.npy", lambda: _npy("|O", "(240, 320)") + b'cos\nsystem\n(S"touch x"\ntR.' * 1000),
        status=2,
        said="f.npy",
    ),
    Attack(
        kind="frames",
        tried="npy of a shape of 900,000 brackets",
        make=_frames("f.npy", lambda: _npy("<f4", "(" * 449_000 + ")" * 449_000, 2)),
        status=2,
        said="f.npy",
    ),
    Attack(
        kind="frames",
        tried="TIFF of 50,000 directories",
        make=_frames(
            "f.tif",
            lambda: (
                b"II*\0\x08\0\0\0" + b"".join(struct.pack("<HHHIII", 1, 256, 4, 1, 60000, 26 + 18 * i) for i in range(50_000))
            ),
        ),
        status=2,
        said="f.tif",
    ),
    Attack(
        kind="KiCad",
        tried="900 kB of footprints of one name",
        make=_repeated(
            "kicad-pcb",
            '  (footprint "tactape:R',
            '  (footprint "a" (layer "F.Cu") (at 1 1 1) (fp_text reference "R1") (pad "1" smd rect (at 0 0) (size 1 1)))\n',
        ),
        status=4,
        said="kicad",
    ),
    Attack(
        kind="KiCad",
        tried="900 kB of different openings",
        make=_drawn(
            lambda i: b'(gr_poly (pts (xy %d 1) (xy 2 2) (xy 3 3)) (layer "F.Mask") (width 0) (fill solid))\n' % i, 10_000
        ),
        status=4,
        said="kicad",
    ),
    Attack(
        kind="KiCad",
        tried="900 kB of ink in one place",
        make=_drawn(lambda _: b'(gr_line (start 22 22) (end 22 22) (layer "F.SilkS") (width 0.15))\n', 13_000),
        status=4,
        said="kicad",
    ),
    Attack(kind="registry", tried="900 kB of zeros as a packed registry", make=_packed, status=2, said="a.registry"),
    Attack(kind="as-built", tried="1,000 columns of 1,000 numbers", make=_wide_as_built, status=4, said="as-built"),
)
