"""By the names in the fab zip alone, gerbonara and npm's whats-that-gerber know every layer, and find one outline."""

from __future__ import annotations

import json
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from gerbonara.layers import LayerStack

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.profiles import BACKING_ROLES, load_fab
from tactape_fab.kit.rules.film_rules import name_findings
from tests.readers.conftest import Sample

_LAYERS = {("top", "copper"), ("top", "mask"), ("top", "silk"), ("top", "paste"), ("mechanical", "outline")}
_KINDS = {
    "copper-top": ("copper", "top"),
    "coverlay-top": ("soldermask", "top"),
    "paste-top": ("solderpaste", "top"),
    "legend-top": ("silkscreen", "top"),
    "profile": ("outline", "all"),
    "drill-npth": ("drill", "all"),
    "job": (None, None),
}


@pytest.fixture(scope="module", params=["full", "comments", "off"])
def kit(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Kit:
    spec = TapeSpec(sector=100, size_mm=(25.0, 25.0), holes_mm=[(20.5, 12.5, 1.0)], x2=request.param)
    return make_kit(spec, tmp_path_factory.mktemp(request.param) / "tape")


def test_gerbonara_opens_the_zip_as_a_board(kit: Kit) -> None:
    stack = LayerStack.open(kit.path / kit.files["fab-zip"])
    try:
        layers = {side_use for side_use, layer in stack.graphic_layers.items() if layer is not None}
        drills = [file.original_path.name for file in (stack.drill_pth, stack.drill_npth, *stack.drill_layers) if file]
        (width_mm, height_mm) = (high - low for low, high in zip(*stack.board_bounds(), strict=True))
    finally:
        stack.tmpdir.cleanup()
    assert layers == _LAYERS
    assert set(drills) == {"tactape-s100-NPTH.drl"}
    assert (width_mm, height_mm) == pytest.approx((25.0, 25.0), abs=0.11)  # the outline's line is 0.1 mm wide


def test_gerbonara_reads_the_hole_as_unplated(kit: Kit) -> None:
    stack = LayerStack.open(kit.path / kit.files["fab-zip"])
    stack.tmpdir.cleanup()
    assert stack.drill_pth is None
    assert stack.drill_npth is not None
    assert len(stack.drill_npth.objects) == 1


def test_whats_that_gerber_knows_every_name_in_the_zip(tape_6x4: Sample, node_module: Callable[[str], str]) -> None:
    node = node_module("whats-that-gerber")
    with zipfile.ZipFile(tape_6x4.path("fab-zip")) as archive:
        names = archive.namelist()
    script = "process.stdout.write(JSON.stringify(require('whats-that-gerber')(process.argv.slice(1))))"
    run = subprocess.run([node, "-e", script, *names], capture_output=True, encoding="utf-8", check=True)
    kinds = {name: (kind["type"], kind["side"]) for name, kind in json.loads(run.stdout).items()}
    roles = {path.rsplit("/", 1)[-1]: role for role, path in tape_6x4.kit.files.items()}
    assert kinds == {name: _KINDS[roles[name]] for name in names}
    assert sorted(kinds.values(), key=str) == sorted(_KINDS.values(), key=str)


@pytest.fixture(scope="module")
def zips(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kit]:
    """A kit of every fab profile with all that its fab laminates, and of every way to open its coverlay."""
    folder, kits = tmp_path_factory.mktemp("zips"), {}
    for name in profile_names("fabs"):
        fab = load_fab(name)
        backing = {key: (getattr(fab, key).choices or [None])[0] for key in ("stiffener", "adhesive")}
        for mode in fab.coverlay_modes:
            spec = TapeSpec(
                sector=100,
                pitch_mm=2.1,
                displacement_mm=0.25,
                size_mm=(25.0, 25.0),
                holes_mm=[(20.5, 12.5, 1.0)],
                fab=name,
                coverlay=mode,
                models=False,
                **backing,
            )
            kits[f"{name} {mode}"] = make_kit(spec, folder / f"{name}-{mode}", verify=False)
    return kits


def test_gerbonara_knows_each_profiles_layers_and_one_outline(zips: dict[str, Kit]) -> None:
    for name, kit in zips.items():
        stack = LayerStack.open(kit.path / kit.files["fab-zip"])
        stack.tmpdir.cleanup()
        layers = {side_use for side_use, layer in stack.graphic_layers.items() if layer is not None}
        outlines = [layer for (_, use), layer in stack.graphic_layers.items() if use == "outline" and layer is not None]
        assert layers == _LAYERS, name
        assert len(outlines) == 1, name
        assert stack.drill_pth is None, name


def test_whats_that_gerber_knows_each_profiles_layers_and_one_outline(
    zips: dict[str, Kit], node_module: Callable[[str], str]
) -> None:
    node = node_module("whats-that-gerber")
    script = "process.stdout.write(JSON.stringify(JSON.parse(process.argv[1]).map(require('whats-that-gerber'))))"
    archives = {name: zipfile.ZipFile(kit.path / kit.files["fab-zip"]).namelist() for name, kit in zips.items()}
    run = subprocess.run(
        [node, "-e", script, json.dumps(list(archives.values()))], capture_output=True, encoding="utf-8", check=True
    )
    for (name, kit), kinds in zip(zips.items(), json.loads(run.stdout), strict=True):
        roles = {path.rsplit("/", 1)[-1]: role for role, path in kit.files.items()}
        found = {roles[file]: (kind["type"], kind["side"]) for file, kind in kinds.items()}
        named = {role: kind for role, kind in found.items() if role not in BACKING_ROLES}
        assert named == {role: _KINDS[role] for role in named}, name
        assert [kind for kind, _ in found.values()].count("outline") == 1, name
        assert not {"copper", "soldermask", "solderpaste", "silkscreen", "drill"} & {
            found[role][0] for role in BACKING_ROLES if role in found
        }, name
        assert ("job" in found) is load_fab(name.split()[0]).job_in_zip, name


_MISREAD = [
    "outline", "Profile", "inner", "fabric", "NPTH", "pnp_bom", "edge_cuts", "f.cu", "thumb_cup", "leaf_mask",
    "f_paste", "b_silks", "pin1_cu", "top_copper", "bottom_copper", "top_mask", "bottom_mask", "top_paste",
    "bottom_paste", "top_silk", "bottom_silk", "copper_top", "copper_bottom", "soldermask_top", "soldermask_bottom",
    "solderpaste_top", "solderpaste_bottom", "silkscreen_top", "silkscreen_bottom",
]  # fmt: skip
_READ = [
    "tactape-s007", "drill", "top", "bottom", "topmask", "copper", "silk", "keepout", "mechanical", "x.gbl", "PTH",
    "v1.0", "incu", "cuff",
]  # fmt: skip


def test_whats_that_gerber_misreads_the_names_that_are_warned_of(node_module: Callable[[str], str]) -> None:
    node = node_module("whats-that-gerber")
    fab, names = load_fab("generic-fpc"), [*_MISREAD, *_READ]
    files = [[fab.file_path(role, name, "FR4").split("/")[-1] for role in (*_KINDS, "stiffener-bottom")] for name in names]
    script = "process.stdout.write(JSON.stringify(JSON.parse(process.argv[1]).map(require('whats-that-gerber'))))"
    run = subprocess.run([node, "-e", script, json.dumps(files)], capture_output=True, encoding="utf-8", check=True)
    kinds = [*_KINDS.values(), ("drawing", None)]
    misread = [
        name
        for name, of_name, found in zip(names, files, json.loads(run.stdout), strict=True)
        if [(found[file]["type"], found[file]["side"]) for file in of_name] != kinds
    ]
    assert misread == _MISREAD
    assert [name for name in names if name_findings(name)] == _MISREAD


def test_gerbonara_refuses_a_second_outline(tape_6x4: Sample, tmp_path: Path) -> None:
    with zipfile.ZipFile(tape_6x4.path("fab-zip")) as archive:
        archive.extractall(tmp_path)
    (tmp_path / "t1.gm2").write_bytes((tmp_path / "t1.gm1").read_bytes())
    with pytest.raises(SystemError, match="mechanical outline"):
        LayerStack.open(tmp_path)
