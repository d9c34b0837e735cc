"""The zip for the fab beside one written by zipfile: every byte of it counts, but the date and the way of compression."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Iterable
from random import Random

import pytest

from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.layers.fab_zip import check_zip, zip_problems
from tests.roundtrip.kits import as_written

FILES = {
    "a.gbr": b"%FSLAX46Y46*%\n" * 5,
    "b.drl": b"METRIC\n" + Random(1).randbytes(40),
    "c.gbrjob": b'{"Header": 1}',
}
LARGER = "holds more, or says other things of its files, than the writer does"


def zip_of(files: Iterable[tuple[str, bytes]], level: int = 6, date: tuple[int, ...] | None = None) -> bytes:
    """A zip in the writer's form; `date` of the last file, if it has another."""
    stream, rows = io.BytesIO(), list(files)
    with zipfile.ZipFile(stream, "w", compresslevel=level) as archive:
        for name, data in rows:
            entry = as_written(name)
            if date is not None and name == rows[-1][0]:
                entry.date_time = (*date, 0, 0, 0)  # type: ignore[assignment]
            archive.writestr(entry, data, compresslevel=level)
    return stream.getvalue()


GOOD = zip_of(FILES.items())


def problems(data: bytes, expected: dict[str, bytes] | None = None) -> list[str]:
    return list(zip_problems(data, FILES if expected is None else expected))


@pytest.mark.parametrize("level", [1, 6, 9])
def test_files_compressed_in_any_way_are_the_files(level: int) -> None:
    assert problems(zip_of(FILES.items(), level)) == []


def test_any_one_date_will_do() -> None:
    alone = {"a.gbr": b"G04*\n"}
    assert problems(zip_of(alone.items(), date=(1999, 12, 31)), alone) == []
    assert problems(zip_of(FILES.items(), date=(1999, 12, 31))) == [f"it {LARGER}"]


def test_no_file_at_all_is_a_zip_of_none() -> None:
    assert problems(zip_of([]), {}) == []
    assert problems(zip_of([("a", b"")]), {}) == ["a does not belong in the zip"]


def unpacked(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_no_byte_may_be_another() -> None:
    """Unread bits at the end of a member, or of a block in it, may: what is unpacked is the same."""
    for place in range(len(GOOD)):
        for bit in (1, 128):
            data = GOOD[:place] + bytes([GOOD[place] ^ bit]) + GOOD[place + 1 :]
            assert problems(data) or unpacked(data) == FILES, (place, bit)
    headers = len(GOOD) - sum(len(deflated(content)) for content in FILES.values())
    refused = sum(bool(problems(GOOD[:place] + bytes([GOOD[place] ^ 128]) + GOOD[place + 1 :])) for place in range(len(GOOD)))
    assert refused >= headers


def test_a_zip_that_ends_or_begins_elsewhere_is_no_zip() -> None:
    for size in range(len(GOOD)):
        assert problems(GOOD[:size])[0].startswith("it cannot be opened: "), size
        assert problems(GOOD[size + 1 :]), size


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda data: b"\0" + data,
            "it cannot be opened: its directory is broken, or a file is packed in a way that few programs open",
        ),
        (lambda data: data + b"\0", f"its directory {LARGER}"),
        (lambda data: data + bytes(65_535), f"its directory {LARGER}"),
        (lambda data: data + bytes(65_536), "it cannot be opened: its end is missing"),
        (lambda data: b"", "it cannot be opened: its end is missing"),
    ],
)
def test_bytes_before_and_behind_are_refused(change: object, said: str) -> None:
    assert callable(change)
    assert problems(change(GOOD)) == [said]


@pytest.mark.parametrize(("field", "where"), [("comment", "its directory"), ("extra", "it")])
def test_comments_and_fields_of_files_are_refused(field: str, where: str) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in FILES.items():
            entry = as_written(name)
            setattr(entry, field, b"\1\0\3\0FR4")
            archive.writestr(entry, content)
    assert problems(stream.getvalue()) == [f"{where} {LARGER}"]


def test_names_are_compared() -> None:
    rows = list(FILES.items())
    assert problems(zip_of(rows[1:])) == ["a.gbr is missing from the zip"]
    assert problems(zip_of([*rows, ("d", b"")])) == ["d does not belong in the zip"]
    assert problems(zip_of([("e", b""), *rows[1:]])) == ["a.gbr is missing from the zip", "e does not belong in the zip"]
    with pytest.warns(UserWarning, match="Duplicate name"):
        assert problems(zip_of([*rows, rows[0]])) == ["a.gbr is in the zip twice"]
    assert problems(zip_of(rows[::-1])) == ["its files stand in another order than the writer's"]
    assert problems(zip_of([*rows, ("å", b"")])) == ["\\xc3\\xa5 does not belong in the zip"]


def test_of_many_names_a_few_are_read() -> None:
    many = zip_of([*FILES.items(), *((str(number), b"") for number in range(30))])
    assert problems(many) == [f"{number} does not belong in the zip" for number in range(5)]


def test_contents_are_compared() -> None:
    for name, content in FILES.items():
        for data in (content[:-1], content + b"\n", b"", content[::-1]):
            assert problems(zip_of({**FILES, name: data}.items())) == [f"{name} in the zip differs from the kit's"]


def by_hand(packed: bytes, content: bytes, *, method: int = 8, offset: int = 0, extra: bytes = b"") -> bytes:
    """A zip of one file a.gbr by APPNOTE.TXT; `extra` bytes in both of its headers."""
    name = b"a.gbr"
    fields = (method, 0, 33, zlib.crc32(content), len(packed), len(content), len(name), len(extra))
    local = struct.pack("<4s5H3I2H", b"PK\3\4", 20, 0, *fields) + name + extra + packed
    entry = struct.pack("<4s6H3I5H2I", b"PK\1\2", 3 << 8 | 20, 20, 0, *fields, 0, 0, 0, 0o644 << 16, offset) + name + extra
    return local + entry + struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 1, 1, len(entry), len(local), 0)


def deflated(content: bytes) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    return packer.compress(content) + packer.flush()


CONTENT = b"G04 a layer*\n" * 9


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (by_hand(deflated(CONTENT), CONTENT), None),
        (
            by_hand(CONTENT, CONTENT, method=0),
            "it cannot be opened: its directory is broken, or a file is packed in a way that few",
        ),
        (by_hand(deflated(CONTENT), CONTENT, offset=1), "it cannot be opened: a.gbr does not lie in it"),
        (by_hand(deflated(CONTENT), CONTENT, offset=9999), "it cannot be opened: unpack_from requires a buffer"),
        (by_hand(deflated(CONTENT), CONTENT, extra=b"\1\0\0\0"), f"it {LARGER}"),
        (by_hand(deflated(CONTENT) + b"\0", CONTENT), "a.gbr in the zip differs from the kit's"),
        (by_hand(deflated(CONTENT)[:-1], CONTENT), "a.gbr in the zip differs from the kit's"),
        (by_hand(b"\xff" * 9, CONTENT), "a.gbr in the zip differs from the kit's"),
        (by_hand(deflated(CONTENT * 9), CONTENT), "a.gbr in the zip differs from the kit's"),
    ],
    ids=["good", "stored", "shifted", "outside", "extra field", "more in it", "cut", "broken", "larger"],
)
def test_a_member_is_whole_and_no_more(data: bytes, said: str | None) -> None:
    found = problems(data, {"a.gbr": CONTENT})
    assert found == [] if said is None else len(found) == 1 and found[0].startswith(said)


@pytest.mark.parametrize(
    ("behind", "said"),
    [(0, "a.gbr in the zip differs from the kit's"), (1, "it cannot be opened: a.gbr does not lie in it")],
)
def test_a_member_ends_within_the_file(behind: int, said: str) -> None:
    data = bytearray(by_hand(deflated(CONTENT), CONTENT))
    struct.pack_into("<I", data, data.rindex(b"PK\1\2") + 20, len(data) - 35 + behind)
    assert problems(bytes(data), {"a.gbr": CONTENT}) == [said]


def kit_files(*, job_in_zip: bool) -> dict[str, WrittenFile]:
    paths = {"profile": "kit/fab/z.gbr", "copper-top": "y.gbr", "job": "kit/fab/x.gbrjob", "bom": "kit/bom.csv"}
    files = {role: WrittenFile(path=path, data=path.encode()) for role, path in paths.items()}
    inside = ["job", "profile", "copper-top"][not job_in_zip :]
    packed = zip_of((files[role].path.rpartition("/")[2], files[role].data) for role in inside)
    return {**files, "fab-zip": WrittenFile(path="kit/fab.zip", data=packed)}


@pytest.mark.parametrize("job_in_zip", [True, False])
def test_the_job_file_is_in_it_where_the_fab_asks_for_it(job_in_zip: bool) -> None:
    files = kit_files(job_in_zip=job_in_zip)
    check = check_zip(files, with_job=job_in_zip)
    assert (check.name, check.passed) == ("fab-zip", True)
    assert check.message == f"{2 + job_in_zip} files, each as in the kit, nothing else"
    wrong = check_zip(files, with_job=not job_in_zip)
    assert not wrong.passed and wrong.message.startswith("x.gbrjob ")
    assert check_zip(files).passed == job_in_zip


def test_two_files_of_one_name_are_not_one() -> None:
    one, other = b"%MOMM*%\n", b"G04*\n"
    files = {"copper-top": WrittenFile(path="gerber/a.gbr", data=one), "paste-top": WrittenFile(path="other/a.gbr", data=other)}
    found = check_zip({**files, "fab-zip": WrittenFile(path="fab.zip", data=zip_of([("a.gbr", other)]))})
    assert not found.passed and found.message == "2 files of the kit have 1 names in it"
