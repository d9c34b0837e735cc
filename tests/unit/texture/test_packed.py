"""Packed registries: the tapes that were packed come back, and no file makes another one of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tactape_fab import Localizer, Tape, TapeSpec, default_origin
from tactape_fab.base.errors import SpecError
from tactape_fab.cli import main
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import simulate
from tactape_fab.texture.as_built import AsBuilt
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.manifest import PACKED_FIRST_LINE
from tactape_fab.texture.packed import is_packed, pack
from tactape_fab.texture.plane import encode
from tactape_fab.texture.registry import read_registered, read_tapes

BEGIN = len(PACKED_FIRST_LINE) + 65


@pytest.fixture(scope="module")
def tapes() -> list[Tape]:
    one = examine(TapeSpec(sector=7)).layout.tape
    origin = default_origin(one.code, 9)
    symbols = encode(get_plane(one.code), 9, origin, (one.rows, one.columns))
    other = replace(one, name="nine", sector=9, origin=origin, symbols=symbols, tag=replace(one.tag, id=9))  # type: ignore[type-var]
    holed = replace(other, name="holed", omitted=np.array([[3, 2], [5, 7]]), tag=None)
    designed = examine(TapeSpec(sector=3, code="touch-1", size_mm=(50.0, 30.0))).layout.tape
    return [one, other, holed, designed, replace(designed, name="again")]


@pytest.fixture(scope="module")
def packed(tapes: list[Tape]) -> bytes:
    return pack(tapes, ["generic-fpc", "", "", "printed", "printed"])


def resealed(data: bytes, change: Callable[[dict[str, Any]], None], symbols: Callable[[bytes], bytes] = bytes) -> bytes:
    """A file with another index and other symbols, and the digest of these."""
    size = int.from_bytes(data[BEGIN : BEGIN + 8], "little")
    index = json.loads(data[BEGIN + 8 : BEGIN + 8 + size])
    change(index)
    text = json.dumps(index).encode()
    rest = len(text).to_bytes(8, "little") + text + symbols(data[BEGIN + 8 + size :])
    return PACKED_FIRST_LINE + sha256(rest).hexdigest().encode() + b"\n" + rest


def refusal(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(SpecError) as caught:
        read_tapes([path])
    assert "pack its kits again" in str(caught.value)
    return str(caught.value)


def test_tapes_come_back_as_they_were(tapes: list[Tape], packed: bytes, tmp_path: Path) -> None:
    file = tmp_path / "all.registry"
    file.write_bytes(packed)
    found = read_registered([file])
    assert is_packed(file)
    assert [entry.fab for entry in found] == ["generic-fpc", "", "", "printed", "printed"]
    assert [entry.tape.to_mapping() for entry in found] == [tape.to_mapping() for tape in tapes]
    assert not found[1].tape.symbols.flags.writeable
    assert found[1].tape.board is found[0].tape.board
    assert pack(tapes, [entry.fab for entry in found]) == packed


def test_a_tag_may_have_the_last_id(packed: bytes, tmp_path: Path) -> None:
    (tmp_path / "last.registry").write_bytes(resealed(packed, lambda index: index["tapes"][1].update(tag_id=586)))
    tag = read_tapes([tmp_path / "last.registry"])[1].tag
    assert tag is not None and tag.id == 586


def test_tapes_of_eight_directions_and_of_the_last_sector_come_back(tmp_path: Path) -> None:
    block = {"part": "block", "pitch_mm": 1.33, "displacement_mm": 0.177, "size_mm": (40.0, 30.0)}
    eight = examine(TapeSpec(sector=8, code="touch-1", directions=8, **block)).tape  # type: ignore[arg-type]
    last = examine(TapeSpec(sector=255, size_mm=(40.0, 30.0))).tape
    file = tmp_path / "all.registry"
    file.write_bytes(pack([eight, last, replace(last, name="again")], ["", "", ""]))
    found = read_tapes([file])
    assert [(tape.directions, tape.sector) for tape in found] == [(8, 8), (4, 255), (4, 255)]
    assert all((a.symbols == b.symbols).all() for a, b in zip(found, (eight, last, last), strict=True))
    assert eight.symbols.max() >= 4


def test_a_packed_registry_decodes_as_its_kits_do(tapes: list[Tape], tmp_path: Path) -> None:
    file = tmp_path / "all.registry"
    file.write_bytes(pack(tapes[:2], ["", ""]))
    depth = simulate(tapes[1], (40.0, 20.0), 30.0)
    one, other = (Localizer(given).locate(depth).to_mapping(dots=True) for given in (tapes[:2], file))
    assert one.pop("elapsed_ms") and other.pop("elapsed_ms")
    assert one["tape"] == "nine"
    assert one == other


def test_a_file_that_another_one_is_copied_over_leaves_its_tapes_as_they_were(tapes: list[Tape], tmp_path: Path) -> None:
    """As by `cp` and `scp`, which write into the file, while a robot decodes with it."""
    file, given = tmp_path / "tapes.registry", tapes[:2]
    file.write_bytes(pack(given, ["", ""]))
    read = read_tapes([file])
    for content in (pack(given[::-1], ["", ""]), b""):
        file.write_bytes(content)
        assert all((a.symbols == b.symbols).all() for a, b in zip(read, given, strict=True))


def test_a_file_that_is_too_large_for_memory_is_read_as_well(
    tapes: list[Tape], packed: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "tapes.registry"
    file.write_bytes(packed)
    monkeypatch.setattr("tactape_fab.texture.packed.MOST_HELD_BYTES", 1000)
    assert all((a.symbols == b.symbols).all() for a, b in zip(read_tapes([file]), tapes, strict=True))


def test_the_command_packs_and_the_file_is_given_as_a_tape(tapes: list[Tape], tmp_path: Path) -> None:
    file, kit, frames = tmp_path / "shelf.registry", tmp_path / "kit", tmp_path / "frames.npz"
    kit.mkdir()
    (kit / "manifest.json").write_text(
        json.dumps({"format": "tactape-manifest/1", "fab": {"name": "x"}, **tapes[0].to_mapping()})
    )
    np.savez(frames, depth=simulate(tapes[0], (40.0, 20.0), 30.0))
    run = CliRunner().invoke
    done = run(main, ["registry", str(kit), "--pack", str(file)])
    assert (done.exit_code, done.stdout.split(" in ")[0]) == (0, "1 tape")
    again = run(main, ["registry", str(kit), "--pack", str(file)])
    assert (again.exit_code, "--overwrite" in again.stderr) == (2, True)
    assert run(main, ["registry", str(kit), "--pack", str(file), "--overwrite"]).exit_code == 0
    beside = run(main, ["registry", str(kit), "--pack", str(tmp_path / "other"), "--json", "--workers", "2"])
    assert (beside.exit_code, beside.stderr.count("leave out --")) == (2, 2) and not (tmp_path / "other").exists()
    answer = run(main, ["decode", str(frames), "--tape", str(file), "--json"])
    assert (answer.exit_code, json.loads(answer.stdout)["tape"]) == (0, tapes[0].name)


def test_it_is_no_kit_and_says_so(packed: bytes, tmp_path: Path) -> None:
    (tmp_path / "tapes.registry").write_bytes(packed)
    with pytest.raises(SpecError, match=r"tapes\.registry is a packed registry, and one kit is asked for; give the folder"):
        Tape.load(tmp_path / "tapes.registry")


def test_measured_tapes_are_not_packed(tapes: list[Tape]) -> None:
    measured = replace(tapes[0], as_built=object.__new__(AsBuilt))
    with pytest.raises(SpecError, match="holds designs only; move that file away"):
        pack([measured], [""])


def test_no_damaged_file_is_read(packed: bytes, tmp_path: Path) -> None:
    file, rng = tmp_path / "bad.registry", np.random.default_rng(0)
    for end in (len(PACKED_FIRST_LINE), BEGIN - 1, BEGIN, BEGIN + 7, BEGIN + 8, BEGIN + 500, len(packed) - 1):
        refusal(file, packed[:end])
    for at in rng.integers(len(PACKED_FIRST_LINE), len(packed), 40).tolist():
        changed = bytearray(packed)
        changed[at] ^= 1 << int(rng.integers(8))
        refusal(file, bytes(changed))
    refusal(file, packed + b"\0")
    refusal(file, packed[:BEGIN] + b"\xff" * 8 + packed[BEGIN + 8 :])
    rest = (len(packed) - BEGIN - 7).to_bytes(8, "little") + packed[BEGIN + 8 :]  # an index that is a byte longer than the file
    assert "cut off" in refusal(file, PACKED_FIRST_LINE + sha256(rest).hexdigest().encode() + b"\n" + rest)
    file.write_bytes(b"tactape-registry/2\n" + packed[BEGIN:])
    with pytest.raises(SpecError, match="cannot be read as JSON"):
        read_tapes([file])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda index: index.update(tapes=[]), "names no tapes"),
        (lambda index: index.update(tapes=7), "tapes = 7 is not a list"),
        (lambda index: index.update(tapes=[0] * 65_537), "more than"),
        (lambda index: index["tapes"][0].update(design=len(index["designs"])), "tapes[0].design"),
        (lambda index: index["tapes"].insert(0, []), "tapes[0].design is missing"),
        (lambda index: index["tapes"].pop(), "more symbols than its tapes have"),
        (lambda index: index["tapes"].append(index["tapes"][0]), "not all there"),
        (lambda index: index["tapes"][1].update(name="../up"), "name = '../up'"),
        (lambda index: index["tapes"][1].update(sector=8), "tapes[1]: symbols differ from code"),
        (lambda index: index["tapes"][1].update(sector=256), "sector = 256 is outside 0 to 255"),
        (lambda index: index["tapes"][1].update(origin=[-1, 0]), "origin[0] = -1"),
        (lambda index: index["tapes"][1].update(tag_id=True), "tag_id = True"),
        (lambda index: index["tapes"][1].update(tag_id=587), "tag_id = 587"),
        (lambda index: index["tapes"][0].update(fab="x" * 201), "fab = "),
        (lambda index: index["tapes"][4].update(symbols_sha256="0" * 64), "one of them was changed"),
        (lambda index: index["designs"][0].update(columns=10**9), "columns = 1000000000"),
        (lambda index: index["designs"][0].update(columns=10**5, rows=10**5), "not all there"),
        (lambda index: index["designs"].__setitem__(0, 3), "columns is missing"),
        (lambda index: index["designs"][0].update(pitch_mm=-1.0), "pitch_mm = -1"),
        (lambda index: index["designs"][0].update(board=None), "board"),
    ],
)
def test_an_impossible_index_is_refused(
    change: Callable[[dict[str, Any]], None], said: str, packed: bytes, tmp_path: Path
) -> None:
    assert said in refusal(tmp_path / "bad.registry", resealed(packed, change))


@pytest.mark.parametrize("at", [5, 62 * 32 + 5])
@pytest.mark.parametrize("symbol", [b"\x04", b"\xff"])
def test_what_is_no_symbol_is_refused(at: int, symbol: bytes, packed: bytes, tmp_path: Path) -> None:
    changed = resealed(packed, lambda index: None, lambda symbols: symbols[:at] + symbol + symbols[at + 1 :])
    assert f"a symbol is {symbol[0]}" in refusal(tmp_path / "bad.registry", changed)


def test_folders_and_short_files_are_no_packed_registry(tmp_path: Path) -> None:
    (tmp_path / "short").write_bytes(PACKED_FIRST_LINE[:5])
    assert not any(is_packed(path) for path in (tmp_path, tmp_path / "short", tmp_path / "nothing", Path("a\0b")))
