"""Every way to open the coverlay, anchor pads and back the film: what is written verifies, what is changed is caught."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.base.errors import DesignRuleError
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.profiles import load_fab
from tactape_fab.make.kit import make_examined
from tactape_fab.verify import verify_kit
from tests.roundtrip.kits import BACKINGS, Edit, OpenKit, failed, flashes, map_points, moved, points, replaced, text_of

SIZE_MM = (22.0, 22.0)
VARIANTS: dict[str, dict[str, Any]] = {
    "gang": {"coverlay": "gang"},
    "spur": {"anchor": "spur", "stiffener": "FR4 0.2", "adhesive": "3M468 0.13"},
    "full radius": {"tag": "none", "size_mm": (30.0, 16.6), "corner_radius_mm": 8.3},
    "round": {"tag": "none", "corner_radius_mm": 11.0},
    "mesh": {"anchor": "mesh", "pitch_mm": 1.8, "displacement_mm": 0.25, "holes_mm": [(15.0, 11.0, 1.0)]},
}
PROFILE_MODES = [(name, mode) for name in profile_names("fabs") for mode in load_fab(name).coverlay_modes]


def spec_of(**values: Any) -> TapeSpec:
    return TapeSpec(**{"sector": 100, "size_mm": SIZE_MM, "models": False, "name": "t", **values})


@pytest.fixture(scope="module")
def kits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kit]:
    folder = tmp_path_factory.mktemp("variants")
    return {name: make_kit(spec_of(**values), folder / name) for name, values in VARIANTS.items()}


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_verifies_with_every_reader(kits: dict[str, Kit], name: str) -> None:
    verification = verify_kit(kits[name].path)
    assert verification.passed, failed(verification)


@pytest.mark.parametrize(("name", "mode"), PROFILE_MODES)
def test_every_profile_and_mode_makes_a_kit_that_verifies(name: str, mode: str, tmp_path: Path) -> None:
    """At a pitch that every profile takes; made with verification, which raises where a line fails."""
    spec = spec_of(fab=name, coverlay=mode, pitch_mm=2.1, displacement_mm=0.25, size_mm=(25.0, 20.0))
    kit = make_kit(spec, tmp_path / "kit")
    assert kit.checks
    assert all(check.passed or check.warning for check in kit.checks)


def test_roles_and_names_of_what_is_laminated(kits: dict[str, Kit]) -> None:
    files = kits["spur"].files
    assert files["stiffener-bottom"] == "gerber/t-Stiffener_Bottom_FR4_0.2mm.gbr"
    assert files["adhesive-bottom"] == "gerber/t-Adhesive_Bottom_3M468_0.13mm.gbr"
    assert not set(BACKINGS) & set(kits["gang"].files)


def test_the_plain_tape_does_not_know_of_any_of_it(flat_kit: Kit) -> None:
    manifest = OpenKit(flat_kit.path).manifest
    assert not {"anchor", "stiffener", "adhesive", "forced"} & set(manifest)
    assert manifest["fab"]["coverlay_mode"] == manifest["spec"]["coverlay"] == "per-part"


# Changes


def case(variant: str, name: str, edit: Edit, *fails: str, says: str = "") -> Any:
    return pytest.param(variant, edit, fails, says, id=f"{variant}: {name}")


def manifest(change: Callable[[dict[str, Any]], object]) -> Edit:
    return lambda kit: change(kit.manifest) and None


def line_moved(number: int, dx_mm: float) -> Edit:
    """Both ends of one drawn line of the copper."""

    def change(text: str) -> str:
        head, tail = text.split("D03*\n%TD*%\n", 1)
        tail = map_points(tail, moved(dx_mm, 0.0), operation="D0[12]", only=(2 * number, 2 * number + 1))
        return f"{head}D03*\n%TD*%\n{tail}"

    return text_of("copper-top", change)


def last_line_deleted(text: str) -> str:
    lines = text.splitlines(keepends=True)
    last = max(i for i, line in enumerate(lines) if line.endswith("D01*\n"))
    return "".join(lines[: last - 1] + lines[last + 1 :])


def last_line_doubled(text: str) -> str:
    lines = text.splitlines(keepends=True)
    last = max(i for i, line in enumerate(lines) if line.endswith("D01*\n"))
    return "".join([*lines[: last + 1], "X3000000Y3000000D02*\n", "X3000000Y3500000D01*\n", *lines[last + 1 :]])


CASES = [
    case("gang", "window moved", points("coverlay-top", moved(0.05, 0.0)), "coverlay-top window", "coverlay-top parts"),
    case("gang", "window wider", points("coverlay-top", lambda p: (p[0] * 1.01 - 0.11, p[1])), "coverlay-top window"),
    case("gang", "corner cut", points("coverlay-top", moved(1.0, 1.0), 0), "coverlay-top window", says="um"),
    case(
        "gang",
        "an opening flashed",
        text_of("coverlay-top", lambda t: t.replace("G37*\n", "G37*\n%ADD10C,0.5*%\nD10*\nX11000000Y11000000D03*\n", 1)),
        "coverlay-top window",
    ),
    case("gang", "said to be per part", manifest(lambda m: m["fab"].update(coverlay_mode="per-part")), "coverlay-top openings"),
    case(
        "gang",
        "a wider frame asked for",
        manifest(lambda m: m["fab"]["limits_mm"].update({"opening-edge": 2.0})),
        "coverlay-top frame",
        says="less than 2 mm",
    ),
    case("spur", "a spur moved", line_moved(5, 0.01), "anchors", says="not an anchor"),
    case("spur", "a spur gone", text_of("copper-top", last_line_deleted), "anchors", says="missing"),
    case("spur", "a line more", text_of("copper-top", last_line_doubled), "anchors", says="not an anchor"),
    case("spur", "wider lines", replaced("copper-top", "C,0.100000*", "C,0.140000*"), "anchors", says="0.140 mm wide"),
    case("spur", "not in the manifest", manifest(lambda m: m.pop("anchor")), "copper-top pairs", says="not pads"),
    case(
        "spur",
        "an opening at a spur",
        flashes("coverlay-top", moved(-0.55, 0.55), 40),
        "coverlay-top places",
        "anchors to openings",
    ),
    case("spur", "a pad moved", flashes("copper-top", moved(0.01, 0.0), 8), "copper-top places"),
    case("spur", "stiffener moved", points("stiffener-bottom", moved(0.1, 0.0)), "stiffener-bottom", says="leaves the outline"),
    case("spur", "an outline begun anew", replaced("profile", "J1000000D01*", "J1000000D02*"), "profile", says="contours"),
    case("spur", "adhesive smaller", points("adhesive-bottom", lambda p: (p[0], p[1] * 0.9)), "adhesive-bottom"),
    case(
        "spur",
        "another stiffener",
        manifest(lambda m: m.update(stiffener="FR4 0.4")),
        "attributes",
        "stiffener-bottom",
        says="Stiffener",
    ),
    case("spur", "stiffener not in the manifest", manifest(lambda m: m.pop("stiffener")), "roles", says="stiffener-bottom"),
    case(
        "spur",
        "stiffener says it is an outline",
        replaced("stiffener-bottom", "Other,Stiffener_Bottom_FR4_0.2mm", "Profile,NP"),
        "attributes",
        says="Profile,NP",
    ),
    case("mesh", "a web moved", line_moved(200, 0.01), "anchors"),
    case("mesh", "a web gone", text_of("copper-top", last_line_deleted), "anchors", says="1 lines are missing"),
    case("mesh", "a spur moved", line_moved(0, 0.01), "anchors"),
    case(
        "mesh",
        "less room asked for",
        manifest(lambda m: m["anchor"].update(opening_mm=0.5)),
        "anchors to openings",
        says="less than 0.5 mm",
    ),
    case("mesh", "said to be spurs", manifest(lambda m: m["anchor"].update(mode="spur")), "anchors"),
]


@pytest.mark.parametrize(("variant", "edit", "fails", "says"), CASES)
def test_a_change_is_caught_and_named(
    kits: dict[str, Kit], variant: str, edit: Edit, fails: tuple[str, ...], says: str, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(kits[variant].path, tmp_path / "t"))
    kit = OpenKit(folder)
    edit(kit)
    kit.save(consistent=True)
    lines = failed(verify_kit(folder, quick=True))
    assert set(fails) <= set(lines), lines
    assert says in lines[fails[0]].message


@pytest.mark.parametrize("wrong", [{"mode": "net"}, {"web_mm": -1}, {"web_mm": "wide"}, {"tip_mm": float("nan")}, {"more": 1}, 3])
def test_a_manifest_with_nonsense_about_anchors_fails(kits: dict[str, Kit], wrong: Any, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(kits["spur"].path, tmp_path / "t"))
    kit = OpenKit(folder)
    kit.manifest["anchor"] = {**kit.manifest["anchor"], **wrong} if isinstance(wrong, dict) else wrong
    kit.save(consistent=True)
    assert set(failed(verify_kit(folder, quick=True))) == {"manifest"}


# Force


def test_a_forced_kit_says_what_it_was_made_in_spite_of(tmp_path: Path) -> None:
    examined = examine(spec_of(pitch_mm=1.45, displacement_mm=0.25, coverlay="per-part"))
    broken = [finding.rule for finding in examined.findings if finding.blocks]
    assert broken == ["opening-bridge"]
    kit = make_examined(examined, tmp_path / "kit", force=True)
    recorded = OpenKit(kit.path).manifest["forced"]
    assert [row["rule"] for row in recorded] == broken
    assert recorded[0]["value"] < recorded[0]["limit"] == 0.2
    assert verify_kit(kit.path, quick=True).passed


def test_anchors_that_gang_leaves_out_are_forced(tmp_path: Path) -> None:
    """Where the profile's own choice is gang; `coverlay` = gang with an anchor is refused."""
    examined = examine(spec_of(fab="jlcpcb-fpc", part="r01005", anchor="spur"))
    recorded = OpenKit(make_examined(examined, tmp_path / "kit", force=True).path).manifest
    assert (recorded["fab"]["coverlay_mode"], "anchor" in recorded, recorded["spec"]["anchor"]) == ("gang", False, "spur")
    assert [row["rule"] for row in recorded["forced"]] == ["anchor-opening"]


def test_models_of_parts_that_run_into_each_other_are_not_forced(tmp_path: Path) -> None:
    values: dict[str, Any] = {"pitch_mm": 1.5, "displacement_mm": 0.7}
    with pytest.raises(DesignRuleError, match="or --no-3d"):
        make_examined(examine(spec_of(models=True, **values)), tmp_path / "kit", force=True)
    assert not (tmp_path / "kit").exists()
    kit = make_examined(examine(spec_of(**values)), tmp_path / "kit", force=True)
    assert {row["rule"] for row in OpenKit(kit.path).manifest["forced"]} == {"pad-pad", "body-body"}


def test_a_line_of_the_verification_that_a_forced_rule_fails_is_a_warning(tmp_path: Path) -> None:
    """A legend too near to an opening for its fab: refused, or with --force written and said."""
    profile = Path(tmp_path / "strict.toml")
    text = (Path(__file__).parents[2] / "templates/fabs/generic-fpc.toml").read_text(encoding="ascii")
    start = text.index("[limits.opening-legend]")
    profile.write_text(text[:start] + text[start:].replace("value_mm = 0.15", "value_mm = 3.0", 1), encoding="ascii")
    examined = examine(spec_of(fab=str(profile)))
    kit = make_examined(examined, tmp_path / "kit", force=True)
    (line,) = [check for check in kit.checks if check.name == "legend-top to openings"]
    assert (line.passed, line.warning) == (False, True)
    assert "in spite of rule opening-legend" in line.message
