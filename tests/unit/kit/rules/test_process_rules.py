"""Kits of solid elements, and the models of a film's kit: options, grid, process rules, files, manifest, previews."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import shapely

from tactape_fab import Kit, Tape, TapeSpec, make_kit
from tactape_fab.base.errors import DesignRuleError, Finding, SpecError
from tactape_fab.base.launch import python_command
from tactape_fab.base.launch import run as run_program
from tactape_fab.base.templates import templates_folder
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.plan import plan_texture
from tactape_fab.kit.profiles import ElementProfile, load_part, load_process, read_part
from tactape_fab.kit.rules.process_rules import check_models, check_texture
from tactape_fab.solids.forms import Cylinder, SolidForm
from tests.commands import run
from tests.thorough import costly, only_thorough
from tests.unit.kit.test_plan import STEP, turned

SMALL = {"sector": 7, "size_mm": (14.0, 11.0)}
pytestmark = pytest.mark.usefixtures("kits_as_elsewhere")
SOLID_ROLES = {"step-solid", "stl", "3mf", "preview-svg", "preview-png", "certificate", "report"}
FORMS: dict[str, dict[str, Any]] = {
    "block": {"part": "block"},
    "dome": {"part": "dome", "size_mm": (20.0, 14.0), "holes_mm": [(16.0, 7.0, 1.5)]},
    "cone": {"part": "cone", "top": "single", "process": "cnc"},
    "mould": {"part": "dome", "negative": True},
    "cylinder x": {"part": "block", "cylinder_mm": 16.0},
    "cylinder y": {"part": "dome", "cylinder_mm": 16.0, "around": "y", "shell": "whole"},
}

Floats = npt.NDArray[np.float64]


def spec_of(**values: Any) -> TapeSpec:
    return TapeSpec(**{**SMALL, **values})


def manifest_of(kit: Kit) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((kit.path / "manifest.json").read_bytes())
    return content


def by_rule(findings: list[Finding] | tuple[Finding, ...]) -> dict[str, Finding]:
    return {finding.rule: finding for finding in findings}


@pytest.fixture(scope="module", params=FORMS)
def solid_kit(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Kit:
    folder = tmp_path_factory.mktemp("solid") / request.param.replace(" ", "-")
    return make_kit(spec_of(**FORMS[request.param]), folder)


# Options


def test_a_solid_element_has_neither_fab_nor_ink() -> None:
    spec = spec_of(part="dome")
    assert (spec.fab, spec.tag, spec.tag_id, spec.assembly, spec.x2) == (None, "none", None, None, None)
    assert (spec.process, spec.base_mm, spec.body_mm, spec.dome_top_mm) == ("sla", 0.8, (0.6, 0.6, 0.23), None)


def test_a_film_has_models_and_no_process_unless_asked_for() -> None:
    spec = spec_of()
    assert (spec.fab, spec.tag, spec.process, spec.body_mm) == ("generic-fpc", "strip", None, None)
    assert spec.form == SolidForm()
    assert spec_of(models=False).form is None


@pytest.mark.parametrize(
    ("values", "form"),
    [
        ({"part": "block"}, SolidForm(mark=True)),
        ({"part": "block", "mark": False}, SolidForm()),
        ({"part": "block", "process": "cnc"}, SolidForm()),
        (
            {"part": "block", "base_mm": 2, "top": "single", "negative": True},
            SolidForm(base_mm=2.0, top="single", negative=True, mark=True),
        ),
        ({"cylinder_mm": 16}, SolidForm(cylinder=Cylinder(radius_mm=16.0))),
        (
            {"part": "dome", "cylinder_mm": 25.5, "around": "y", "shell": "whole"},
            SolidForm(cylinder=Cylinder(radius_mm=25.5, around="y", shell="whole"), mark=True),
        ),
    ],
)
def test_the_form_is_what_was_asked_for(values: dict[str, Any], form: SolidForm) -> None:
    assert spec_of(**values).form == form


@pytest.mark.parametrize(
    ("values", "body_mm", "top_mm"),
    [
        ({"part": "block", "body_mm": [0.8, 0.4, 0.3]}, (0.8, 0.4, 0.3), None),
        ({"part": "dome", "body_mm": [0.8, 0.3]}, (0.8, 0.8, 0.3), None),
        ({"part": "dome", "body_mm": [0.8, 0.8, 0.3]}, (0.8, 0.8, 0.3), None),
        ({"part": "dome", "body_mm": [0.6, 0.5], "dome_top_mm": 0.2}, (0.6, 0.6, 0.5), 0.2),
        ({"part": "cone"}, (0.6, 0.6, 0.23), 0.3),
        ({"part": "cone", "dome_top_mm": 0.25}, (0.6, 0.6, 0.23), 0.25),
    ],
)
def test_the_element_s_size_is_a_parameter(
    values: dict[str, Any], body_mm: tuple[float, float, float], top_mm: float | None
) -> None:
    part = examine(spec_of(**values)).tape.part
    assert (part.name, part.body_mm, part.top_mm) == (values["part"], body_mm, top_mm)


@pytest.mark.parametrize("values", [{}, {"models": False}, {"process": "fdm"}, {"cylinder_mm": 20.0}, *FORMS.values()])
def test_a_spec_s_mapping_gives_the_same_spec(values: dict[str, Any]) -> None:
    spec = spec_of(**values)
    assert TapeSpec.from_mapping(json.loads(json.dumps(spec.to_mapping()))) == spec


def test_a_process_of_ones_own_says_whether_it_makes_the_mark(tmp_path: Path) -> None:
    mill = tmp_path / "mill.toml"
    mill.write_bytes((templates_folder() / "processes" / "cnc.toml").read_bytes())
    assert spec_of(part="block", process=str(mill)).mark is False
    mill.write_text(mill.read_text(encoding="utf-8").replace("mark = false", ""), encoding="utf-8")
    assert spec_of(part="block", process=str(mill)).mark is spec_of(part="block", process="none.toml").mark is True


def test_every_option_may_stand_in_a_spec_file(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text(
        (templates_folder() / "processes" / "sla.toml").read_text(encoding="utf-8").replace('"sla"', '"our-lab"')
    )
    (tmp_path / "tape.toml").write_text(
        "sector = 7\nsize_mm = [14, 11]\npart = 'dome'\nbody_mm = [0.45, 0.2]\ndome_top_mm = 0.2\nprocess = 'lab.toml'\n"
        "base_mm = 1.5\nnegative = true\ntop = 'single'\ncylinder_mm = 20\naround = 'y'\nshell = 'segment'\nmodels = true\n"
    )
    result = run(f"make {tmp_path / 'tape.toml'} --base 2mm --no-verify -o {tmp_path / 'kit'}")
    assert result.exit_code == 0, result.stderr
    content = json.loads((tmp_path / "kit" / "manifest.json").read_bytes())
    assert content["solid"] == {
        "base_mm": 2.0,
        "mark": True,
        "negative": True,
        "top": "single",
        "cylinder": {"radius_mm": 20.0, "around": "y", "shell": "segment"},
    }
    assert (content["part"]["body_mm"], content["part"]["top_mm"]) == ([0.45, 0.45, 0.2], 0.2)
    assert (content["process"]["name"], content["spec"]["process"]) == ("our-lab", "lab.toml")


def test_corners_on_a_cylinder_are_square() -> None:
    assert spec_of(part="block").corner_radius_mm == 1.0
    assert spec_of(part="block", cylinder_mm=20.0).corner_radius_mm == 0.0
    assert spec_of(cylinder_mm=20.0).corner_radius_mm == 1.0  # the film's
    finding = by_rule(examine(spec_of(cylinder_mm=20.0)).findings)["model-corner"]
    assert (finding.level, finding.passed, finding.limit) == ("info", False, 1.0)


def test_a_part_without_lands_is_no_part_with_lands() -> None:
    with pytest.raises(SpecError, match="part = 'dome' is a solid element without lands; give a part with"):
        load_part("dome")


# Grid


def foot(part: ElementProfile, rotation_deg: float) -> shapely.Polygon:
    length, width, _ = part.body_mm
    if part.shape == "dome":
        return shapely.Point(0, 0).buffer(length / 2, quad_segs=256)
    corners = np.array([(-length, -width), (length, -width), (length, width), (-length, width)]) / 2
    return shapely.Polygon(turned(corners, rotation_deg))


def board_of(tape: Tape) -> shapely.Polygon:
    (width, height), radius = tape.board.size_mm, tape.board.corner_radius_mm
    return shapely.box(radius, radius, width - radius, height - radius).buffer(radius, quad_segs=256)


@pytest.mark.parametrize("seed", range(12))
def test_elements_keep_the_process_s_distances_and_no_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    name = ["block", "dome", "cone"][seed % 3]
    width, height = (round(float(v), 1) for v in rng.uniform((12, 10), (26, 20)))
    spec = TapeSpec(
        sector=int(rng.integers(256)),
        part=name,
        size_mm=(width, height),
        rotation_deg=float(rng.choice([0.0, 45.0, 30.0, 90.0])),
        corner_radius_mm=round(float(rng.uniform(0.0, 4.0)), 2),
        holes_mm=[(width / 2, height / 2, 1.3)] if seed % 2 else [],
    )
    process, part = load_process("sla"), read_part(name)
    assert isinstance(part, ElementProfile)
    tape = plan_texture(spec, process, part)
    outline, limit = board_of(tape), process.limits["body-edge"].value_mm
    foot_shape, board = foot(part, spec.rotation_deg), tape.to_mapping()
    x0, y0 = tape.board.texture_origin_mm

    def gap(shape: shapely.Polygon) -> float:
        if not outline.covers(shape):
            return -1.0
        return float(min([shape.distance(outline.exterior) - limit, *(shape.distance(hole) - 0.5 for hole in holes)]))

    holes = [shapely.Point(x, y).buffer(d / 2, quad_segs=256) for x, y, d in tape.board.holes]
    omitted = {tuple(cell) for cell in board["omitted"]}
    for r, row in enumerate(board["symbols"]):
        for c, letter in enumerate(row):
            dx, dy = (tape.displacement_mm * v for v in STEP[letter])
            value = gap(shapely.affinity.translate(foot_shape, x0 + c * 1.5 + dx, y0 - r * 1.5 + dy))
            assert (value >= -0.001) if (c, r) not in omitted else (value < 0.001)
    # one more column or row, displaced outward, would come too near
    reach_x, reach_y = foot_shape.bounds[2], foot_shape.bounds[3]
    assert x0 + tape.columns * 1.5 + 0.25 + reach_x > width - limit - 0.002
    assert height - tape.rows * 1.5 < 2 * (limit + reach_y + 0.25) + 0.002
    assert tape.tag is None
    assert tape.board.thickness_mm == spec.base_mm == 0.8


def test_a_film_with_and_without_models_is_the_same_film(tmp_path: Path) -> None:
    """Models come beside the other files and change none of them."""
    kits = [make_kit(spec_of(models=models), tmp_path / str(models), verify=False) for models in (True, False)]
    with_models, without = ({row["path"]: row for row in manifest_of(kit)["files"]} for kit in kits)
    added = {path: row["role"] for path, row in with_models.items() if path not in without}
    assert added == {
        "models/tactape-s007-assembly.step": "step-assembly",
        "models/tactape-s007.step": "step-solid",
        "models/tactape-s007.stl": "stl",
        "models/tactape-s007.3mf": "3mf",
    }
    assert all(with_models[path] == row for path, row in without.items() if row["role"] != "report")
    assert not {"solid", "process"} & manifest_of(kits[1]).keys()
    assert manifest_of(kits[0])["solid"] == SolidForm().to_mapping()
    assert manifest_of(kits[0])["process"] is None


# Process rules


def worst_gap_by_brute_force(tape: Tape, part: ElementProfile, rotation_deg: float) -> float:
    shapes = [shapely.affinity.translate(foot(part, rotation_deg), x, y) for x, y in tape.part_xy_mm()]
    tree = shapely.STRtree(shapes)
    a, b = tree.query(shapes, predicate="dwithin", distance=2.0)
    a, b = a[a < b], b[a < b]
    every = np.array(shapes)
    return float(shapely.distance(every[a], every[b]).min())


@pytest.mark.parametrize("name", ["block", "dome", "cone"])
@pytest.mark.parametrize("rotation_deg", [45.0, 0.0])
def test_gaps_and_widths_are_measured_on_the_elements(name: str, rotation_deg: float) -> None:
    part, process = read_part(name), load_process("fdm")
    assert isinstance(part, ElementProfile)
    spec = spec_of(part=name, process="fdm", rotation_deg=rotation_deg)
    tape = plan_texture(spec, process, part)
    findings = by_rule(check_texture(tape, SolidForm(base_mm=0.7), process, spec, part))
    values = {rule: finding.value for rule, finding in findings.items()}
    assert values["feature"] == {"block": 0.3, "dome": 0.6, "cone": 0.3}[name]
    assert values["gap"] == pytest.approx(worst_gap_by_brute_force(tape, part, rotation_deg), abs=2e-6)
    assert (values["height"], values["base"]) == (0.23, 0.7)
    assert {rule: findings[rule].limit for rule in values} == {
        rule: process.limits[rule].value_mm for rule in ("feature", "gap", "height", "base", "body-edge")
    }
    assert not findings["base"].passed
    assert findings["base"].message == ("thickness of the base 0.700 mm is below the limit 0.800 mm of fdm; use --base 0.8")
    assert {findings[rule].level for rule in ("feature", "gap", "height", "base")} == {"warn"}
    assert findings["body-edge"].passed


def test_in_a_mould_walls_are_features_and_cavities_are_gaps() -> None:
    process = load_process("cnc")
    examined = examine(spec_of(part="cone", process="cnc"))
    tape, spec, part = examined.tape, examined.spec, examined.profiles.part
    plain, mould = (by_rule(check_models(tape, SolidForm(negative=negative), process, spec, part)) for negative in (False, True))
    assert plain["feature"].value == mould["gap"].value == 0.3
    assert plain["gap"].value == mould["feature"].value
    assert "wall between two cavities" in mould["feature"].message
    assert "width of a cavity" in mould["gap"].message


@pytest.mark.parametrize("offset_mm", [0.0, -0.0004, -0.0006])
def test_a_threshold_is_met_down_to_half_a_micrometre_below_it(offset_mm: float) -> None:
    examined = examine(spec_of(part="block"))
    tape, spec, part = examined.tape, examined.spec, examined.profiles.part
    process = load_process("sla")
    limits = {**process.limits, "feature": replace(process.limits["feature"], value_mm=0.3 - offset_mm)}
    finding = by_rule(check_models(tape, SolidForm(), replace(process, limits=limits), spec, part))["feature"]
    assert finding.passed == (offset_mm > -0.0005)


def test_holes_of_a_texture_are_measured() -> None:
    spec = spec_of(part="dome", size_mm=(20.0, 14.0), holes_mm=[(8.0, 7.0, 1.0), (12.0, 7.0, 0.4)])
    findings = by_rule(examine(spec).findings)
    assert findings["hole-hole"].value == pytest.approx(3.3)
    assert findings["hole-size"].value == pytest.approx(0.4)
    assert not findings["hole-size"].passed
    assert findings["hole-edge"].value == pytest.approx(6.5)
    assert findings["hole-part"].passed
    assert findings["hole-part"].value is not None
    assert findings["hole-part"].value >= 0.4995
    near = examine(replace(spec, holes_mm=[(8.0, 7.0, 1.0), (9.5, 7.0, 1.0)]))
    assert by_rule(near.findings)["hole-hole"].blocks


def test_a_film_is_held_against_a_process_only_when_asked() -> None:
    rules = {"feature", "gap", "height", "base"}
    assert not rules & by_rule(examine(spec_of()).findings).keys()
    findings = by_rule(examine(spec_of(process="fdm")).findings)
    assert rules < findings.keys()
    assert not findings["feature"].passed
    assert "body-body" in findings


def test_parts_that_a_fab_places_may_be_too_large_for_models(tmp_path: Path) -> None:
    """A fab without limits takes them; the models need every part in its own cell."""
    text = (templates_folder() / "fabs" / "generic-fpc.toml").read_text(encoding="utf-8")
    (tmp_path / "any.toml").write_text(text.replace('level = "block"', 'level = "warn"'), encoding="utf-8")
    values = {"fab": str(tmp_path / "any.toml"), "pitch_mm": 0.8, "displacement_mm": 0.1, "tag": "none"}
    finding = by_rule(examine(spec_of(**values)).findings)["models"]
    assert finding.blocks
    assert "larger than its cell" in finding.message
    assert finding.message.endswith("or --no-3d")
    # --no-3d would be refused beside options of models, and be of no use with assets of them
    for option in ({"cylinder_mm": 15.0}, {"base_mm": 1.0}, {"negative": True}, {"sim": True}):
        assert "--no-3d" not in by_rule(examine(spec_of(**values, **option)).findings)["models"].message
    with pytest.raises(DesignRuleError, match="models: "):
        make_kit(spec_of(**values), tmp_path / "kit", verify=False)
    assert "models" not in by_rule(examine(spec_of(**values, models=False)).findings)


# Files and manifest


@costly
def test_a_solid_kit_has_models_previews_and_manifest(solid_kit: Kit) -> None:
    content = manifest_of(solid_kit)
    assert {row["role"] for row in content["files"]} == SOLID_ROLES == solid_kit.files.keys()
    written = {p.relative_to(solid_kit.path).as_posix() for p in solid_kit.path.rglob("*") if p.is_file()}
    assert written == {*(row["path"] for row in content["files"]), "manifest.json"}
    assert solid_kit.files["stl"] == "models/tactape-s007.stl"
    assert "land_pattern" not in content
    assert content["tag"] is None
    process = load_process(content["spec"]["process"])
    assert content["fab"] == content["process"] == {"name": process.name, **process.thresholds()}
    assert content["board"]["thickness_mm"] == content["solid"]["base_mm"] == 0.8


def test_the_tape_of_a_solid_kit_can_be_loaded(solid_kit: Kit) -> None:
    assert Tape.load(solid_kit.path).to_mapping() == solid_kit.tape.to_mapping()


@costly
def test_equal_specs_give_equal_bytes(solid_kit: Kit, tmp_path: Path) -> None:
    spec = TapeSpec.from_mapping(manifest_of(solid_kit)["spec"])
    again = make_kit(spec, tmp_path / "again", verify=False)  # equal bytes need no second verification
    for role, path in solid_kit.files.items():
        if role != "report":  # which says that there was none
            assert (again.path / path).read_bytes() == (solid_kit.path / path).read_bytes(), path
    first, second = manifest_of(solid_kit), manifest_of(again)
    for content in (first, second):
        content["files"] = [row for row in content["files"] if row["role"] != "report"]
    assert (first["made"].pop("verified"), second["made"].pop("verified")) == (True, False)
    assert first == second


# Previews


def loops(text: str) -> list[Floats]:
    """Every closed path of an SVG's element, y up again."""
    found = [np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", d), dtype=float) for d in re.findall(r"M([^MZ]+)Z", text)]
    return [loop * (1.0, -1.0) for loop in found]


def as_seen(tape: Tape, form: dict[str, Any]) -> Floats:
    xy = tape.part_xy_mm()
    return xy * (-1.0, 1.0) if form["negative"] else xy


def test_the_drawing_shows_every_element_in_its_place(solid_kit: Kit) -> None:
    text = (solid_kit.path / solid_kit.files["preview-svg"]).read_text(encoding="ascii")
    base, elements = text.split('<g id="elements"')
    feet, tape = loops(elements), solid_kit.tape
    assert len(feet) == tape.part_count
    centres = np.array([(foot.min(axis=0) + foot.max(axis=0)) / 2 for foot in feet])
    expected = as_seen(tape, manifest_of(solid_kit)["solid"])
    tree = shapely.STRtree(shapely.points(centres))
    _, distance = tree.query_nearest(shapely.points(expected), return_distance=True, all_matches=False)
    assert distance.max() < 0.002
    size = np.ptp(loops(base)[0], axis=0)
    assert size == pytest.approx(tape.board.size_mm, abs=0.002) or solid_kit.tape.board.corner_radius_mm == 0.0
    assert len(loops(base)) == 1 + len(tape.board.holes)


def test_the_picture_shows_relief_on_white(solid_kit: Kit) -> None:
    data = np.frombuffer((solid_kit.path / solid_kit.files["preview-png"]).read_bytes(), np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    assert image is not None
    assert (image[0] == 255).all()
    assert (image[:, 0] == 255).all()
    inside = image[image < 250]
    assert inside.size > 0.25 * image.size
    middle = np.median(inside)
    assert (inside < middle - 25).mean() > 0.01


# Command line


def test_make_names_what_goes_to_the_printer(tmp_path: Path) -> None:
    result = run(f"make --sector 7 --size 14x11 --part dome --no-verify -o {tmp_path / 'kit'}")
    assert result.exit_code == 0
    assert "for printing: " in result.stdout
    assert "for CAD and milling: " in result.stdout
    assert "for the fab" not in result.stdout
    assert "for assembly" not in result.stdout


def test_make_warns_of_what_the_process_cannot_make(tmp_path: Path) -> None:
    result = run(f"make --sector 7 --size 14x11 --part block --process fdm --no-verify --json -o {tmp_path / 'kit'}")
    assert result.exit_code == 0
    assert "warning: feature: narrowest width of an element 0.300 mm is below the limit 0.600 mm of fdm" in result.stderr
    content = json.loads(result.stdout)
    assert content["files"].keys() == SOLID_ROLES


def test_check_prints_the_process_s_rules() -> None:
    result = run("check --sector 7 --part dome --hole 50,25,2")
    verdicts = {line.split()[0]: line.split()[1] for line in result.stdout.splitlines()[1:]}
    assert result.exit_code == 0
    assert verdicts.keys() == {"feature", "gap", "height", "base", "body-edge", "hole-edge", "hole-size", "hole-part", "mark"}
    assert set(verdicts.values()) == {"ok"}


def test_no_3d_leaves_the_models_out(tmp_path: Path) -> None:
    result = run(f"make --sector 7 --size 20x12 --no-3d --no-verify -o {tmp_path / 'kit'}")
    assert result.exit_code == 0
    assert "for printing" not in result.stdout
    assert not (tmp_path / "kit" / "models").exists()


@only_thorough
def test_kits_with_models_load_no_cad_kernel_and_no_mesh_library(tmp_path: Path) -> None:
    program = (
        "import sys; from tactape_fab import TapeSpec, make_kit\n"
        f"for i, values in enumerate([{{}}, *{list(FORMS.values())!r}]):\n"
        "    make_kit(TapeSpec(**{'sector': 7, 'size_mm': (14.0, 11.0), **values}), f'kit{i}', verify=False)\n"
        "print(*sorted({name.split('.')[0] for name in sys.modules}))"
    )
    done = run_program(python_command(program), timeout_s=300.0, scratch=tmp_path)
    assert done.returncode == 0, done.stderr
    modules = set(done.stdout.split())
    assert "tactape_fab" in modules
    assert not modules & {"build123d", "OCP", "trimesh", "manifold3d", "scipy"}
