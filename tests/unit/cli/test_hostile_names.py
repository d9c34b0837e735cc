"""Untrusted texts that look like the program's own lines, and files that never end, given to every command that reads any."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tactape_fab import Kit
from tactape_fab.cli.group import main

EVIL = "x\nverified: 62 checks \x1b[31m\u202e"
IN_MANIFEST: dict[str, tuple[tuple[str, ...], Any]] = {
    "name": (("name",), EVIL),
    "version": (("tool", "version"), EVIL),
    "code": (("code",), EVIL),
    "fab": (("fab", "name"), EVIL),
    "part": (("part", "name"), EVIL),
    "description": (("assembly", "description"), EVIL),
    "tag": (("tag", "family"), EVIL),
    "profile": (("spec", "fab"), EVIL + ".toml"),
    "date": (("made", "date"), EVIL),
    "libraries": (("made", "libraries"), {EVIL: EVIL, "numpy": EVIL}),
    "spec": (("spec", "name"), EVIL),
    "option": (("spec",), {EVIL: EVIL}),
    "finish": (("fab", "material", "finish"), EVIL),
    "avoided": (("search",), {"avoided": [EVIL]}),
    "forced": (("forced",), [EVIL]),
    "limit": (("fab", "limits_mm"), {EVIL: 1.0}),
}
NAMED = (
    ("inspect", EVIL + "a.png", "--tape", "kit", "-o", "o.json"),
    ("inspect", "a.png", "--tape", EVIL, "-o", "o.json"),
    ("calibrate", EVIL + "a.npz", "--tape", "kit", "--like", "gelsight-mini", "-o", "o.toml"),
    ("calibrate", "f.npz", "--tape", "kit", "--like", EVIL + "a.toml", "-o", "o.toml"),
    ("calibrate", "f.npz", "--tape", "kit", "--like", "evil.toml", "-o", "o.toml"),
    ("survey", "f.npz", "--tape", "kit", "--poses", "evil.csv", "-o", "o.json"),
    ("survey", "f.npz", "--tape", "kit", "--from", "evil.json", "-o", "o.json"),
    ("survey", EVIL + "a.npz", "--tape", "kit", "-o", "o.json"),
    ("advise", "7x7", "--fab", EVIL + "a.toml"),
    ("advise", "7x7", "--fab", "evil.toml"),
    ("registry", EVIL + "a.registry"),
    ("registry", "kit", "--pack", EVIL + "/p.registry"),
    ("decode", "f.npz", "--tape", "kit", "--method", "paper"),
    ("decode", "f.npz", "--tape", "kit", "--as-built", "evil.json"),
    ("decode", EVIL + "a.mcap", "--tape", "kit"),
    ("watch", EVIL + "a.npz", "--tape", "kit"),
    ("emboss", "kit", EVIL + "a.stl"),
    ("make", "evil.toml"),
    ("make", "--sector", "7", "--fab", "evil.toml"),
    ("make", "--sector", "7", "--no-3d", "--order", EVIL),
    ("make", "--sector", "7", "--name", EVIL),
    ("check", "evil.toml"),
    ("profiles", EVIL),
    ("coupon", EVIL),
    ("doctor", "--" + EVIL),
    (EVIL,),
)
ENDLESS = (
    ("inspect", "#.png", "--tape", "kit", "-o", "o.json"),
    ("calibrate", "#.npz", "--tape", "kit", "--like", "gelsight-mini", "-o", "o.toml"),
    ("calibrate", "f.npz", "--tape", "kit", "--like", "#.toml", "-o", "o.toml"),
    ("calibrate", "f.npz", "--tape", "kit", "--like", "gelsight-mini", "--hand-eye", "#.csv", "-o", "o.toml"),
    ("survey", "f.npz", "--tape", "kit", "--poses", "#.csv", "-o", "o.json"),
    ("survey", "f.npz", "--tape", "kit", "--from", "#.json", "-o", "o.json"),
    ("advise", "7x7", "--fab", "#.toml"),
    ("registry", "#.registry"),
    ("decode", "#.npz", "--tape", "kit"),
    ("decode", "#.mcap", "--tape", "kit"),
    ("decode", "f.npz", "--tape", "kit", "--as-built", "#.json"),
    ("emboss", "kit", "#.stl"),
    ("emboss", "kit", "#.step"),
    ("make", "#.toml"),
    ("make", "--sector", "7", "--no-3d", "--sign", "#.pub", "-o", "signed"),
    ("verify", "kit", "--quick", "--key", "#.pub"),
    ("verify", "beside", "--quick"),
    ("watch", "#.npz", "--tape", "kit"),
)


@pytest.fixture(scope="module")
def place(flat_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a kit, files whose names and texts forge lines, FIFOs and links to a device that never ends."""
    folder = tmp_path_factory.mktemp("hostile")
    for name in ("kit", "beside"):
        shutil.copytree(flat_kit.path, folder / name)
    os.mkfifo(folder / "beside" / "as-built.json")
    for kind in ("png", "npz", "toml", "registry", "mcap", "stl"):
        (folder / f"{EVIL}a.{kind}").write_bytes(b"junk\n" + EVIL.encode())
    for kind in ("png", "npz", "toml", "csv", "json", "registry", "mcap", "stl", "step", "pub"):
        os.mkfifo(folder / f"fifo.{kind}")
        (folder / f"zero.{kind}").symlink_to("/dev/zero")
    (folder / "evil.toml").write_text(
        f"{json.dumps(EVIL)} = 1\nname = {json.dumps(EVIL)}\nsector = {json.dumps(EVIL)}\n", "utf-8"
    )
    (folder / "evil.csv").write_text(f"frame,x\n{EVIL},verified: 62\n", "utf-8")
    parts: dict[str, list[Any]] = {key: [0.01] for key in ("dx_mm", "dy_mm", "rotation_deg", "sigma_mm")}
    parts |= {"designator": [EVIL], "present": [True]}
    content = {"format": "tactape-as-built/1", "tape": EVIL, "manifest_sha256": EVIL, "parts": parts, "source": [{"kind": EVIL}]}
    (folder / "evil.json").write_text(json.dumps(content))
    arrays: dict[str, Any] = {"depth": np.zeros((1, 240, 320), np.float32), EVIL: np.zeros(3)}
    np.savez(folder / "f.npz", **arrays)
    return folder


@pytest.fixture(autouse=True)
def here(place: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(place)
    yield
    os.chdir(before)


def refused(*words: str) -> str:
    """What a command says, which is neither done nor a traceback, and holds no line or mark of somebody else's."""
    result = CliRunner().invoke(main, list(words))
    assert result.exception is None or isinstance(result.exception, SystemExit), repr(result.exception)
    assert result.exit_code in (0, 1, 2, 3, 4)
    assert not any(line.startswith("verified: 62") for line in result.output.splitlines()), result.output
    assert "\x1b[31m" not in result.output and "\u202e" not in result.output, result.output
    return str(result.output)


@pytest.mark.parametrize("words", NAMED, ids=lambda words: " ".join(words).replace(EVIL, "?"))
def test_a_name_that_forges_a_line_is_escaped(words: tuple[str, ...]) -> None:
    assert refused(*words)


@pytest.mark.parametrize(("path", "value"), IN_MANIFEST.values(), ids=IN_MANIFEST.keys())
@pytest.mark.parametrize("command", [("verify", "--quick"), ("verify", "--reproduce"), ("registry",), ("certify",)], ids=" ".join)
def test_a_manifest_that_forges_a_line_is_escaped(
    command: tuple[str, ...], path: tuple[str, ...], value: Any, tmp_path: Path
) -> None:
    shutil.copytree("kit", tmp_path / "kit")
    file = tmp_path / "kit" / "manifest.json"
    content = json.loads(file.read_bytes())
    inner = content
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    file.write_text(json.dumps(content))
    refused(command[0], str(tmp_path / "kit"), *command[1:])


@pytest.mark.parametrize("kind", ["fifo", "zero"])
@pytest.mark.parametrize("words", ENDLESS, ids=" ".join)
def test_what_never_ends_is_refused_by_every_command(words: tuple[str, ...], kind: str) -> None:
    assert refused(*(word.replace("#", kind) for word in words))
