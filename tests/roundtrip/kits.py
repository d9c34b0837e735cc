"""A written kit as bytes that a test may change, and the small changes of Gerber and CSV text that the tests use."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
import zipfile
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Check
from tactape_fab.verify import Verification

Point = tuple[float, float]
Edit = Callable[["OpenKit"], object]
Rows = list[list[str]]
Files = dict[str, bytes]

IN_ZIP = ("copper-top", "coverlay-top", "paste-top", "legend-top", "profile", "drill-npth", "job")
BACKINGS = ("stiffener-bottom", "adhesive-bottom")
LAYERS = ("copper-top", "coverlay-top", "paste-top", "legend-top", "profile")
MODELS = ("step-assembly", "step-solid", "stl", "3mf")
ROLES = (
    *(*IN_ZIP, *MODELS, "components-top", "cpl", "bom", "order-notes", "fab-drawing", "fab-dxf"),
    *("kicad-pcb", "kicad-project", "preview-png", "preview-svg", "certificate", "fab-zip", "report", "placement-preview"),
)

_POINT = re.compile(r"X(-?\d+)Y(-?\d+)(?=(?:I-?\d+J-?\d+)?(D0[123])\*)")
_VERTEX = re.compile(r"(-?\d+\.\d+),(-?\d+\.\d+)(?=,\n)")
_SIGNATURE = re.compile(rb"(?<=TF\.MD5,)[0-9a-f]{32}")


class OpenKit:
    """A kit's files by role and its manifest, to be changed in memory and saved.

    ``sign`` says whether a consistent save renews the .MD5 of the changed Gerber files.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.manifest: dict[str, Any] = json.loads((folder / "manifest.json").read_bytes())
        self.paths = {row["role"]: str(row["path"]) for row in self.manifest["files"]}
        self.data = {role: (folder / path).read_bytes() for role, path in self.paths.items()}
        self.sign = True
        self._before = dict(self.data)

    def save(self, *, consistent: bool) -> Path:
        """Write what has changed.

        A consistent save hides it: signatures, the copies in the fab zip, and sizes and SHA-256 in manifest and report fit.
        """
        changed = [role for role, data in self.data.items() if data != self._before[role]]
        if consistent:
            for role in changed if self.sign else ():
                self.data[role] = signed(self.data[role])
            if "fab-zip" not in changed and any(role in (*IN_ZIP, *BACKINGS) for role in changed):
                self.zip_members(
                    lambda members: members.update({self.name(r): self.data[r] for r in changed if r in (*IN_ZIP, *BACKINGS)})
                )
                changed.append("fab-zip")
            for role in changed if "report" in self.data and "report" not in changed else ():
                self.data["report"] = self.data["report"].replace(_listed(self._before[role]), _listed(self.data[role]))
            for row in self.manifest["files"]:
                if (data := self.data.get(row["role"])) is not None:
                    row.update(bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
        for role, path in self.paths.items():
            if self.data[role] != self._before[role]:
                (self.folder / path).write_bytes(self.data[role])
        (self.folder / "manifest.json").write_text(json.dumps(self.manifest), encoding="ascii")
        return self.folder

    def name(self, role: str) -> str:
        """File name as the fab zip has it."""
        return self.paths[role].rsplit("/", 1)[-1]

    def text(self, role: str, change: Callable[[str], str]) -> None:
        self.data[role] = change(self.data[role].decode("ascii")).encode("ascii")

    def rows(self, role: str, change: Callable[[Rows], object]) -> None:
        """Change a CSV file as a list of rows, the header first."""
        rows = list(csv.reader(io.StringIO(self.data[role].decode("ascii"), newline="")))
        change(rows)
        text = io.StringIO(newline="")
        csv.writer(text, lineterminator="\r\n").writerows(rows)
        self.data[role] = text.getvalue().encode("ascii")

    def zip_members(self, change: Callable[[dict[str, bytes]], object]) -> None:
        """Change the fab zip as a mapping of names to contents."""
        with zipfile.ZipFile(io.BytesIO(self.data["fab-zip"])) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        change(members)
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in sorted(members.items()):
                archive.writestr(as_written(name), data)
        self.data["fab-zip"] = stream.getvalue()


def contents(folder: Path) -> Files:
    """Every file below a folder by its path."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def as_written(name: str) -> zipfile.ZipInfo:
    """A member of a zip as the kit's writer makes it."""
    entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
    entry.compress_type, entry.create_system, entry.external_attr = zipfile.ZIP_DEFLATED, 3, 0o644 << 16
    return entry


def _listed(data: bytes) -> bytes:
    """Size and SHA-256 of a file as the report's data has them."""
    return f'"bytes":{len(data)},"sha256":"{hashlib.sha256(data).hexdigest()}"'.encode()


def signed(data: bytes) -> bytes:
    """The same Gerber file with a right .MD5 (Gerber 2024.05 section 5.6.9); other files as they are."""
    found = _SIGNATURE.search(data)
    if found is None:
        return data
    content = data[: data.rindex(b"%TF.MD5")].replace(b"\n", b"").replace(b"\r", b"")
    digest = hashlib.md5(content, usedforsecurity=False).hexdigest().encode()
    return data[: found.start()] + digest + data[found.end() :]


def failed(verification: Verification) -> dict[str, Check]:
    """Failed lines by name."""
    return {c.name: c for c in verification.checks if not c.passed and not c.warning}


def map_points(text: str, change: Callable[[Point], Point], *, operation: str = "D0[123]", only: Collection[int] = ()) -> str:
    """Change coordinates (mm) of a Gerber file: those of `operation`, all or the ones numbered in `only`."""
    number = -1

    def replaced(found: re.Match[str]) -> str:
        nonlocal number
        if not re.fullmatch(operation, found[3]):
            return found[0]
        number += 1
        if only and number not in only:
            return found[0]
        x_mm, y_mm = change((int(found[1]) / 1e6, int(found[2]) / 1e6))
        return f"X{round(x_mm * 1e6)}Y{round(y_mm * 1e6)}"

    return _POINT.sub(replaced, text)


def map_aperture(text: str, change: Callable[[Point], Point]) -> str:
    """Change the vertices (mm) of a Gerber file's outline macro."""

    def replaced(found: re.Match[str]) -> str:
        x_mm, y_mm = change((float(found[1]), float(found[2])))
        return f"{x_mm:.6f},{y_mm:.6f}"

    return _VERTEX.sub(replaced, text)


def map_component(text: str, designator: str, change: Callable[[Point], Point]) -> str:
    """Change the coordinates (mm) of one part of a component layer."""
    start = text.index(f"%TO.C,{designator}*%")
    end = text.index("%TD.P*%", start)
    return text[:start] + map_points(text[start:end], change) + text[end:]


def moved(dx_mm: float, dy_mm: float) -> Callable[[Point], Point]:
    return lambda p: (p[0] + dx_mm, p[1] + dy_mm)


def turned_90(centre: Point = (0.0, 0.0)) -> Callable[[Point], Point]:
    """A quarter turn counter-clockwise about `centre`."""
    return lambda p: (centre[0] - (p[1] - centre[1]), centre[1] + (p[0] - centre[0]))


def mirrored(width_mm: float) -> Callable[[Point], Point]:
    return lambda p: (width_mm - p[0], p[1])


# Edits: functions of an opened kit


def points(role: str, change: Callable[[Point], Point], *only: int, operation: str = "D0[123]") -> Edit:
    return text_of(role, lambda text: map_points(text, change, operation=operation, only=only))


def flashes(role: str, change: Callable[[Point], Point], *only: int) -> Edit:
    return points(role, change, *only, operation="D03")


def aperture(role: str, change: Callable[[Point], Point]) -> Edit:
    return text_of(role, lambda text: map_aperture(text, change))


def mirror(role: str, width_mm: float) -> Edit:
    """A whole layer seen from below: places and apertures."""

    def edit(kit: OpenKit) -> None:
        points(role, mirrored(width_mm))(kit)
        aperture(role, mirrored(0.0))(kit)

    return edit


def replaced(role: str, old: str, new: str) -> Edit:
    def edit(kit: OpenKit) -> None:
        assert old in kit.data[role].decode("ascii")
        kit.text(role, lambda text: text.replace(old, new, 1))

    return edit


def stated(path: str, value: Any) -> Edit:
    """Set a value of the manifest, by its keys and indices with dots between."""

    def edit(kit: OpenKit) -> None:
        *parents, last = [int(k) if k.isdigit() else k for k in path.split(".")]
        place: Any = kit.manifest
        for key in parents:
            place = place[key]
        place[last] = value

    return edit


def text_of(role: str, change: Callable[[str], str]) -> Edit:
    return lambda kit: kit.text(role, change)


def bytes_of(role: str, change: Callable[[bytes], bytes]) -> Edit:
    return lambda kit: kit.data.update({role: change(kit.data[role])})


def exchanged(a: str, b: str) -> Edit:
    return lambda kit: kit.data.update({a: kit.data[b], b: kit.data[a]})


def rows(role: str, change: Callable[[Rows], object]) -> Edit:
    return lambda kit: kit.rows(role, change)


def designators(change: Callable[[list[str]], object]) -> Edit:
    """Change the designators of the BOM's first row, its quantity with them."""

    def edit(table: Rows) -> None:
        header, row = table[:2]
        names = row[header.index("Designator")].split(",")
        change(names)
        row[header.index("Designator")] = ",".join(names)
        if "Quantity" in header:
            row[header.index("Quantity")] = str(len(names))

    return rows("bom", edit)


def members(change: Callable[[OpenKit, dict[str, bytes]], object]) -> Edit:
    return lambda kit: kit.zip_members(lambda content: change(kit, content))
