"""What costs little to send costs little to refuse: no file of a kit of up to 1 MB keeps `verify` for more than 5 s."""

from __future__ import annotations

import io
import os
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from tactape_fab import Kit, PanelKit
from tactape_fab.verify import verify_kit
from tests.roundtrip.kits import Edit, OpenKit, bytes_of, failed

Copy = Callable[[Kit | PanelKit], Path]


def model(change: Callable[[bytes], bytes]) -> Edit:
    def edit(kit: OpenKit) -> None:
        stream = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(kit.data["3mf"])) as old, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as new:
            for name in old.namelist():
                data = old.read(name)
                new.writestr(name, change(data) if name.endswith(".model") else data)
        kit.data["3mf"] = stream.getvalue()

    return edit


def listed_often(kit: OpenKit) -> None:
    """A sparse file of 1 GB, listed twelve times."""
    row = next(row for row in kit.manifest["files"] if row["role"] == "order-notes")
    os.truncate(kit.folder / row["path"], 1 << 30)
    kit.manifest["files"] += [{**row, "role": f"order-notes-{i}"} for i in range(12)]


ATTACKS: dict[str, tuple[Edit, str]] = {
    "3MF: 140,000 times <model": (model(lambda b: b"<model " * 140_000 + b), "3mf"),
    "3MF: 140,000 times <item": (model(lambda b: b"<item " * 140_000 + b), "3mf"),
    "3MF: vertices without an end": (model(lambda b: b'<vertex x="' * 80_000 + b), "3mf"),
    "report: 22,000 script tags": (
        bytes_of("report", lambda b: b'<script type="application/json" id="data">' * 22_000),
        "report",
    ),
    "order notes: a word of 140 kB": (bytes_of("order-notes", lambda b: b"\n1. FILES\n" + b"a." * 70_000), "order-notes"),
    "order notes: a word of 90 kB": (bytes_of("order-notes", lambda b: b"\n1. FILES\n" + b"a." * 45_000), "order-notes"),
    "a file listed twelve times": (listed_often, "files"),
}


@pytest.mark.parametrize(("edit", "line"), ATTACKS.values(), ids=ATTACKS.keys())
def test_a_file_that_costs_much_is_refused_soon(edit: Edit, line: str, small_kit: Kit, copied: Copy) -> None:
    kit = OpenKit(copied(small_kit))
    edit(kit)
    folder, started = kit.save(consistent=edit is not listed_often), time.process_time()
    assert line in failed(verify_kit(folder, quick=True))
    assert time.process_time() - started < 5.0
