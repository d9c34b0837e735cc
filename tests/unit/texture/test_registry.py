"""Paths to tapes: kits, panels, folders of them, packed files, measured places; and that all faults come together."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tactape_fab import Tape
from tactape_fab.base.errors import SpecError
from tactape_fab.texture import registry
from tactape_fab.texture.packed import pack
from tactape_fab.texture.registry import as_tapes, labels, read_registered, read_tapes, refuse_equal_names, taken_once
from tests.measured import measured
from tests.tapes import tape_at


def kit(folder: Path, sector: int, name: str | None = None, **more: Any) -> Path:
    """A folder with nothing but the manifest of a small tape."""
    folder.mkdir(parents=True)
    content = {"format": "tactape-manifest/1", **tape_at(sector, (6, 5), name=name).to_mapping(), **more}
    (folder / "manifest.json").write_text(json.dumps(content))
    return folder


def test_equal_names_are_those_of_two_textures() -> None:
    tape, wider = tape_at(7, (6, 5), name="a"), tape_at(7, (9, 5), name="a")
    refuse_equal_names([tape, wider, tape, tape_at(8, (6, 5), name="b")], "it")
    with pytest.raises(SpecError, match="tapes of sectors 7 and 8 are both named a, and it names its tape by that alone"):
        refuse_equal_names([tape, tape_at(8, (6, 5), name="a")], "it")


def digest_of(folder: Path) -> str:
    return hashlib.sha256((folder / "manifest.json").read_bytes()).hexdigest()


def panel(folder: Path, *sectors: int) -> Path:
    rows = [
        {
            "manifest": str(kit(folder / "tapes" / f"s{sector}", sector).relative_to(folder) / "manifest.json"),
            "sha256": "0" * 64,
            "offset_mm": [0.0, 0.0],
            "rotation_deg": 0.0,
            "first_designator": "R1",
        }
        for sector in sectors
    ]
    (folder / "manifest.json").write_text(json.dumps({"format": "tactape-panel/1", "tapes": rows}))
    return folder


def sectors(*paths: Path) -> list[int]:
    return [tape.sector for tape in read_tapes(paths)]


def messages(*paths: object, as_built: tuple[object, ...] = ()) -> list[str]:
    with pytest.raises(SpecError) as caught:
        read_tapes(paths, as_built)  # type: ignore[arg-type]
    return [problem.message for problem in caught.value.problems]


def test_tapes_come_in_the_order_given(tmp_path: Path) -> None:
    one, two = kit(tmp_path / "one", 9), kit(tmp_path / "two", 4)
    many = panel(tmp_path / "panel", 30, 20)
    file = tmp_path / "all.registry"
    file.write_bytes(pack([tape_at(70, (6, 5)), tape_at(60, (6, 5))], ["a", "b"]))
    assert sectors(one, many, file, two / "manifest.json") == [9, 30, 20, 70, 60, 4]
    assert [entry.fab for entry in read_registered([file])] == ["a", "b"]
    assert read_tapes([]) == []


def test_a_folder_of_kits_and_panels_is_read_in_the_order_of_names(tmp_path: Path) -> None:
    kit(tmp_path / "all" / "b", 2)
    panel(tmp_path / "all" / "c", 8, 3)
    kit(tmp_path / "all" / "a", 5)
    kit(tmp_path / "all" / "aa.partial", 6)
    (tmp_path / "all" / "z").mkdir()
    (tmp_path / "all" / "notes").write_text("")
    assert sectors(tmp_path / "all") == [5, 2, 8, 3]
    kit(tmp_path / "all" / "a" / "inside", 7)
    assert sectors(tmp_path / "all" / "a") == [5]
    assert len(messages(tmp_path / "all" / "z")) == 1


def test_the_profile_of_a_kit_is_told_where_there_is_one(tmp_path: Path) -> None:
    said = [{"name": "cheap"}, {}, "cheap", {"name": "x" * 300}, {"name": 7}]
    kits = [kit(tmp_path / str(n), n, fab=fab) for n, fab in enumerate(said)] + [kit(tmp_path / "none", 9)]
    found = read_registered(kits)
    assert [entry.fab for entry in found] == ["cheap", "", "", "x" * 200, "7", ""]
    assert [entry.path for entry in found] == kits


def test_all_that_is_wrong_is_said_with_its_place(tmp_path: Path) -> None:
    good, bad = kit(tmp_path / "good", 1), kit(tmp_path / "bad", 2, pitch_mm=-1, rows="x")
    packed = tmp_path / "cut.registry"
    packed.write_bytes(pack([tape_at(3, (6, 5))], [""])[:-1])
    found = messages(good, bad, tmp_path / "none", packed)
    assert len(found) == 4 + (len(messages(bad)) - 2)
    assert all(str(bad) in message for message in messages(bad))
    assert sum("none is no kit" in message for message in found) == 1
    assert sum("cut.registry cannot be read" in message for message in found) == 1
    assert not any(message.count(str(tmp_path)) > 1 for message in found)


def test_only_so_many_tapes_are_registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "MOST_TAPES", 3)
    all_of = panel(tmp_path / "panel", 1, 2, 3)
    assert len(read_tapes([all_of])) == 3
    assert messages(all_of, kit(tmp_path / "one", 4)) == ["more than 3 tapes are given; register those that can be touched"]
    file = tmp_path / "all.registry"
    file.write_bytes(pack([tape_at(n, (6, 5)) for n in range(4)], [""] * 4))
    assert messages(file) == ["more than 3 tapes are given; register those that can be touched"]


def test_tapes_and_paths_may_be_given_alone_or_mixed(tmp_path: Path) -> None:
    one, tape = kit(tmp_path / "one", 9), tape_at(4, (6, 5))
    assert as_tapes(tape) == [tape] and as_tapes([tape, tape]) == [tape, tape]
    for given in (one, str(one), [one], [str(one)]):
        assert [found.sector for found in as_tapes(given)] == [9]
    assert [found.sector for found in as_tapes(iter([tape, one]))] == [4, 9]
    with pytest.raises(SpecError) as caught:
        as_tapes([7, tmp_path / "none", one, None])
    assert [problem.message.split(" ")[2] for problem in caught.value.problems if "is no tape" in problem.message] == [
        "7",
        "None",
    ]
    assert len(caught.value.problems) == 3
    with pytest.raises(SpecError, match="tape = 7 is no tape"):
        as_tapes(7)


def built_for(folder: Path, sector: int, dx_mm: float) -> Tape:
    """The tape of a kit with places of its own, all off by so much along x."""
    built = measured(tape_at(sector, (6, 5)), 0.0, error_mm=0.0, digest=digest_of(folder))[0].as_built
    assert built is not None
    return replace(tape_at(sector, (6, 5)), as_built=replace(built, dx_mm=built.dx_mm + dx_mm))


def shifts(*tapes: Tape) -> list[float | None]:
    return [None if tape.as_built is None else float(tape.as_built.dx_mm[0]) for tape in tapes]


def test_measured_places_are_those_given_those_beside_the_kit_or_none(tmp_path: Path) -> None:
    one, two, three = (kit(tmp_path / str(n), n) for n in (1, 2, 3))
    files = []
    for number, folder in enumerate((one, two), 1):
        beside, given = built_for(folder, number, 0.01).as_built, built_for(folder, number, 0.02).as_built
        assert beside is not None and given is not None
        beside.write(folder)
        files.append(given.write(tmp_path / f"given-{number}.json"))
    assert shifts(*read_tapes([one, two, three])) == [0.01, 0.01, None]
    assert shifts(*read_tapes([one, two, three], files)) == [0.02, 0.02, None]
    assert shifts(*read_tapes([one, two, three], files[:1])) == [0.02, 0.01, None]
    for none in (["none"], ["none", "none"]):
        assert shifts(*read_tapes([one, two, three], none)) == [None, None, None]
    (unused,) = messages(one, three, as_built=tuple(files))
    assert "given-2.json is for the manifest" in unused and digest_of(two)[:12] + "..., and none of tape-1, tape-3 has" in unused
    six = [kit(tmp_path / f"more-{n}", n) for n in range(10, 16)]
    assert "none of tape-10, tape-11, tape-12, tape-13, tape-14 has" in messages(*six, as_built=(files[0],))[0]
    assert messages(one, as_built=("none", files[0])) == [
        "as_built = none is given together with files; give either none or the files"
    ]
    again = tmp_path / "again.json"
    again.write_bytes(files[0].read_bytes())
    assert shifts(*read_tapes([one], [files[0], files[0]])) == [0.02]
    (twice,) = messages(one, as_built=(files[0], again))
    assert twice == f"as_built = {files[0]} and {again} are of one kit, whose parts stand in one place; give one of them"
    (first, second) = messages(tmp_path / "nothing", as_built=(files[0],))
    assert "is no kit" in first and "and none is there; give its kit, too" in second


def test_a_label_has_its_path_where_a_name_is_not_enough(tmp_path: Path) -> None:
    kits = [kit(tmp_path / "a", 1, "same"), kit(tmp_path / "b", 2, "same"), kit(tmp_path / "c", 3, "other")]
    assert labels(read_registered(kits)) == (f"same ({kits[0]})", f"same ({kits[1]})", "other")


def test_a_file_that_is_given_again_is_taken_once(tmp_path: Path) -> None:
    one, copy = kit(tmp_path / "one", 9), kit(tmp_path / "copy", 9)
    (tmp_path / "link").symlink_to(one)
    (tmp_path / "link.json").symlink_to(one / "manifest.json")
    file = tmp_path / "all.registry"
    file.write_bytes(pack([tape_at(7, (6, 5)), tape_at(8, (6, 5))], ["", ""]))
    (tmp_path / "link.registry").symlink_to(file)
    links = [one / "manifest.json", tmp_path / "link", tmp_path / "link.json"]
    given = read_registered([one, file, one, *links, copy, tmp_path / "link.registry"])
    assert len(given) == 10
    found, again = taken_once(given)
    assert [(entry.path, entry.tape.sector) for entry in found] == [(one, 9), (file, 7), (file, 8), (copy, 9)]
    assert again == [
        f"{one} is given again, and taken once",
        *(f"{link} is {one}, and taken once" for link in links),
        f"{tmp_path / 'link.registry'} is {file}, and taken once",
    ]


def test_one_path_needs_no_list(tmp_path: Path) -> None:
    one = kit(tmp_path / "one", 9)
    assert [tape.sector for tape in read_tapes(str(one))] == [tape.sector for tape in read_tapes(one, "none")] == [9]
    with pytest.raises(SpecError, match=r"^tape = b'k7' is no tape; give Tape.load\(KIT\), or the path of a kit$"):
        as_tapes(b"k7")
