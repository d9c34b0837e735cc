"""certify, registry, --origin best and --avoid through the command line: answers, pictures, and what is refused."""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path

import cv2
import pytest

from tactape_fab import Kit
from tactape_fab.cli.certify import certified_lines
from tactape_fab.cli.registry import registry_lines
from tactape_fab.kit.examine.code_tapes import default_tapes
from tactape_fab.kit.examine.tape import examine
from tactape_fab.report.certify_picture import draw_certified
from tactape_fab.texture.certify.certificate import certify
from tactape_fab.texture.certify.kits import certified, registry
from tests.commands import run
from tests.tapes import tape_at


@pytest.fixture
def shelf(tmp_path: Path, default_kit: Kit, small_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, which holds a folder of two kits, one of them twice."""
    monkeypatch.chdir(tmp_path)
    for kit, name in ((default_kit, "seven"), (small_kit, "hundred"), (small_kit, "again")):
        (tmp_path / "shelf" / name).mkdir(parents=True)
        shutil.copy(kit.path / "manifest.json", tmp_path / "shelf" / name)
    return tmp_path


def test_certify_one_tape_in_words_and_as_json(shelf: Path, default_kit: Kit) -> None:
    lines = run("certify shelf/seven").stdout.splitlines()
    certificate = certify(default_kit.tape)
    rows = [line.split() for line in lines[2:5]]
    wanted = [(f"{s.side}x{s.side}", s.windows, s.distance, s.pairs, s.detects, s.corrects) for s in certificate.sizes]
    assert rows == [[str(v) for v in row] for row in wanted]
    assert f"two contacts never read the same from {certificate.distinct_side}x{certificate.distinct_side} parts on" in lines
    result = run("certify shelf/seven/manifest.json --json")
    assert json.loads(result.stdout) == {"tapes": [certificate.to_mapping()], "across": []}
    assert result.stderr == ""


def test_certify_several_tapes(shelf: Path) -> None:
    result = run("certify shelf")
    assert result.exit_code == 0
    assert "tactape-s100 (shelf/again)" in result.stdout
    assert "nearest windows of 4x4 of different tapes, which read the same:" in result.stdout
    found = json.loads(run("certify shelf/seven shelf/again --json").stdout)
    assert [t["name"] for t in found["tapes"]] == ["tactape-s007", "tactape-s100"]
    assert [a["side"] for a in found["across"]] == [4, 5, 6]


def test_registry_lists_tapes_and_conflicts(shelf: Path, default_kit: Kit) -> None:
    lines = run("registry shelf").stdout.splitlines()
    assert [line.split()[0] for line in lines[1:4]] == ["tactape-s100", "tactape-s100", "tactape-s007"]
    row = next(line for line in lines if line.startswith("tactape-s007"))
    assert row.split()[1:] == ["7", "microdots-4x4", "84,1428", "62", "x", "32", "100", "x", "50", "1.5", "7", "generic-fpc"]
    conflicts = [line for line in lines if line.startswith("conflict: ")]
    assert [("same tape" in c, "read the same" in c, "tags have id 100" in c) for c in conflicts] == [
        (True, False, False), (False, True, False), (False, False, True),
    ]  # fmt: skip
    found = json.loads(run("registry shelf --json").stdout)
    assert [c["kind"] for c in found["conflicts"]] == ["same-tape", "windows", "tag"]
    assert found["across"][0]["distances"][0][:2] == [None, 0]
    assert found["tapes"][2]["size_mm"] == list(default_kit.tape.board.size_mm)
    alone = run("registry shelf/seven").stdout
    assert "no conflicts" in alone and "least number" not in alone


def test_a_kit_that_is_given_again_is_not_compared_with_itself(shelf: Path) -> None:
    note = "note: shelf/seven/manifest.json is shelf/seven, and taken once\n"
    for command in ("certify", "registry", "registry --pack twice.registry"):
        once = run(f"{command.replace('twice', 'once')} shelf/seven")
        twice = run(f"{command} shelf/seven shelf/seven/manifest.json")
        assert (twice.exit_code, twice.stderr) == (0, note)
        assert twice.stdout.replace("twice", "once") == once.stdout
    assert run("certify shelf shelf/seven").stderr == "note: shelf/seven is given again, and taken once\n"


def test_a_packed_registry_is_taken_as_it_says(shelf: Path) -> None:
    Path("my tapes").mkdir()
    packed = run("registry shelf/seven --pack 'my tapes/a b.registry'")
    option, *words = shlex.split(packed.stdout.partition("; give it as ")[2])
    assert option == "--tape" and run(shlex.join(["registry", *words])).exit_code == 0


def test_large_registries_are_printed_by_their_nearest_tapes() -> None:
    tapes = [tape_at(s, (12, 8)) for s in range(20)]
    result = certified(tapes)
    assert len(certified_lines(result)) < 60
    assert draw_certified(result).shape[2] == 3


def test_registry_of_many_kits_stays_short(tmp_path: Path) -> None:
    for sector in range(14):
        examined = examine({"sector": sector, "size_mm": (12.0, 12.0), "tag": "none", "models": False})
        folder = tmp_path / f"{sector:02d}"
        folder.mkdir()
        manifest = {"format": "tactape-manifest/1", **examined.tape.to_mapping(), "fab": {"name": "x" * 500}}
        (folder / "manifest.json").write_text(json.dumps(manifest))
    found = registry([tmp_path])
    lines = registry_lines(found)
    assert len(found.entries) == 14
    assert sum(line.startswith("  ") for line in lines) == 20
    assert lines.index("the nearest tapes:") > 0


def test_picture_of_one_tape_and_of_several(shelf: Path) -> None:
    for kits, least in (("shelf/hundred", 300), ("shelf", 200)):
        result = run(f"certify {kits} --picture map.png --json --overwrite")
        assert result.exit_code == 0
        picture = cv2.imread(str(shelf / "map.png"))
        assert picture is not None and min(picture.shape[:2]) >= least
        first = (shelf / "map.png").read_bytes()
        assert run(f"certify {kits} --picture map.png --overwrite").exit_code == 0
        assert (shelf / "map.png").read_bytes() == first


def test_certify_of_a_code_is_that_of_its_sectors() -> None:
    tapes = default_tapes("debruijn-4x4", (20.0, 15.0))
    assert [t.sector for t in tapes] == list(range(256))
    assert {t.code for t in tapes} == {"debruijn-4x4"}
    assert len(default_tapes("anoto-6x6", (30.0, 20.0))) == 256


@pytest.mark.parametrize(
    ("args", "said"),
    [
        ("certify", "nothing to certify is given"),
        ("certify nowhere gone", "gone is no kit"),
        ("certify --code foo", "code = 'foo' is none of"),
        ("certify --code microdots-4x4 --size 3x3", "is too small"),
        ("certify --code microdots-4x4 --size 10x13", "; use --size 13x13\n"),  # not --tag none, which it does not have
        ("certify --code microdots-4x4 --size 5000x40", "; use a smaller --size\n"),
        ("certify --code microdots-4x4 --size nan", "--size"),
        ("certify --size 60x40", "--size has no effect without --code"),
        ("certify shelf --code microdots-4x4", "give either"),
        ("certify broken.json", "error: broken.json cannot be read as JSON"),
        ("registry nowhere", "nowhere is no kit"),
        ("registry", "Missing argument"),
        ("make --sector 7 --avoid nowhere", "nowhere is no kit"),
        ("make --sector 7 --avoid nowhere --w nan", "--w = nan"),
        ("make --avoid shelf --origin 3,4", "--origin = '3,4' contradicts avoid"),
        ("make --avoid shelf --origin 3,4 --size 0x9", "--size = '0x9': 0 mm is not above 0 mm"),
        ("make --avoid shelf --sector 999", "sector = 999 is outside 0 to 255"),
        ("make --origin bst --sector 3", "or best"),
        ("make --origin best", "sector is missing"),
        ("make --origin best --sector 3 --size 9000x100", "exceeds 5062.5 mm"),
    ],
)
def test_bad_input_is_refused_with_a_remedy(args: str, said: str, shelf: Path) -> None:
    (shelf / "broken.json").write_text("{")
    before = sorted(shelf.rglob("*"))
    result = run(args)
    assert result.exit_code == 2
    assert said in result.stderr
    assert "Traceback" not in result.output
    assert sorted(shelf.rglob("*")) == before


def test_picture_in_no_folder_is_refused(shelf: Path) -> None:
    result = run("certify shelf/seven --picture gone/map.png")
    assert result.exit_code == 2
    assert "gone/map.png: there is no folder of that name" in result.stderr


def test_make_away_from_kits_chooses_the_sector(shelf: Path) -> None:
    result = run("make --avoid shelf --size 20x20 --no-3d --no-verify --json")
    assert result.exit_code == 0
    made = json.loads(result.stdout)
    assert made["sector"] not in (7, 100)
    manifest = json.loads((Path(made["path"]) / "manifest.json").read_bytes())
    assert manifest["search"]["avoided"] == ["tactape-s100", "tactape-s100", "tactape-s007"]


def test_make_warns_of_windows_that_read_the_same(shelf: Path) -> None:
    args = "make --sector 4 --origin 0,0 --no-3d --no-verify -o same"
    twins = certify(examine({"sector": 4, "origin": [0, 0], "models": False}).tape)
    assert twins.of_side(4).distance == 0
    result = run(args)
    assert result.exit_code == 0
    assert f"warning: windows: {twins.of_side(4).pairs} pair" in result.stderr
    assert "use --origin best" in result.stderr
    better = run("make --sector 4 --origin best --no-3d --no-verify -o best")
    search = json.loads(Path("best/manifest.json").read_bytes())["search"]
    assert "warning" not in better.stderr
    assert f"best of {search['candidates']} origins: 4x4 windows differ by at least {search['distance']} symbols" in better.stdout
