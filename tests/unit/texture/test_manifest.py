"""Manifest files: where they are found, how large they may be, and which paths may stand in them."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path, PurePosixPath

import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.texture import manifest
from tactape_fab.texture.manifest import find_manifest, read_any_manifest, read_manifest, safe_path


@pytest.mark.parametrize("text", ["a", "fab/a-b_c+1.gbr", "a b/c", "x" * 300, "..a", "a..", ".a"])
def test_a_path_inside_the_kit_is_safe(text: str) -> None:
    assert safe_path(text) == PurePosixPath(text)


@pytest.mark.parametrize(
    "text",
    [
        None,
        7,
        "",
        "x" * 301,
        "/a",
        "../a",
        "a/../b",
        "a/..",
        "..",
        "./a",
        "a//b",
        "a/",
        "a\\b",
        "a:b",
        "\u00e9",
        "a\n",
        "~a",
        "a*",
    ],
)
def test_any_other_path_is_none(text: object) -> None:
    assert safe_path(text) is None


def test_a_manifest_that_cannot_be_opened_is_refused_with_the_reason_alone(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").mkdir()
    with pytest.raises(SpecError, match=r"^manifest\.json cannot be read as JSON: it is no regular file; give"):
        read_any_manifest(tmp_path / "manifest.json")


def test_a_manifest_is_found_by_its_folder_or_itself(tmp_path: Path) -> None:
    file = tmp_path / "kit" / "manifest.json"
    file.parent.mkdir()
    with pytest.raises(SpecError, match=r"is no kit: it holds no manifest\.json; give the folder of a kit or its"):
        find_manifest(file.parent)
    with pytest.raises(SpecError, match="is no kit: there is no such file"):
        find_manifest(file)
    file.write_text("{}")
    assert find_manifest(file.parent) == find_manifest(str(file)) == file
    (tmp_path / "loop").symlink_to("loop")
    for wrong in (tmp_path / "loop", tmp_path / ("x" * 300), "a\0b"):
        with pytest.raises(SpecError, match="is no kit"):
            find_manifest(wrong)
    file.unlink()
    os.mkfifo(file)
    for place, said in ((file, "it is"), (file.parent, r"its manifest\.json is")):
        with pytest.raises(SpecError, match=f"is no kit: {said} no regular file; give the folder of a kit"):
            find_manifest(place)


def test_a_name_that_is_none_on_this_system_says_why(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=f"is no kit: {os.strerror(errno.ENAMETOOLONG)}; give the folder"):
        find_manifest(tmp_path / ("x" * 300))


def test_a_folder_that_is_being_built_is_none_by_any_way(tmp_path: Path) -> None:
    (tmp_path / "kit.partial").mkdir()
    (tmp_path / "kit.partial" / "manifest.json").write_text("{}")
    (tmp_path / "link").symlink_to("kit.partial")
    for place in (tmp_path / "kit.partial", tmp_path / "link", tmp_path / "link" / "manifest.json"):
        with pytest.raises(SpecError, match="is an unfinished kit"):
            find_manifest(place)


def test_a_manifest_may_have_so_many_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert manifest.MOST_MANIFEST_BYTES == 16 << 20
    monkeypatch.setattr(manifest, "MOST_MANIFEST_BYTES", 200)
    file = tmp_path / "manifest.json"
    text = json.dumps({"format": "tactape-manifest/1"})
    file.write_text(text + " " * (200 - len(text)))
    assert read_manifest(file) == read_any_manifest(file) == {"format": "tactape-manifest/1"}
    with file.open("a") as stream:
        stream.write(" ")
    with pytest.raises(SpecError, match="is larger than 200 bytes; it is not"):
        read_manifest(file)


def test_a_panel_is_no_tape_and_other_formats_are_none(tmp_path: Path) -> None:
    file = tmp_path / "manifest.json"
    file.write_text('{"format": "tactape-panel/1"}')
    assert read_any_manifest(file) == {"format": "tactape-panel/1"}
    with pytest.raises(SpecError, match=rf"{file} is that of a panel, not of one tape; .* such as PANEL/tapes/NAME"):
        read_manifest(file)
    for name in ("s8", "s7"):
        (tmp_path / "tapes" / name).mkdir(parents=True)
        (tmp_path / "tapes" / name / "manifest.json").touch()
    with pytest.raises(SpecError, match=rf"; give the folder of one of the kits on it, such as {tmp_path}/tapes/s7$"):
        read_manifest(file)
    for text, said in (
        ('{"format": "tactape-manifest/2"}', "has format 'tactape-manifest/2'"),
        ('"x"', "has format None"),
        ("{", "JSON"),
    ):
        file.write_text(text)
        with pytest.raises(SpecError, match=said):
            read_any_manifest(file)
    with pytest.raises(SpecError, match="cannot be read as JSON"):
        read_any_manifest(tmp_path / "none")
