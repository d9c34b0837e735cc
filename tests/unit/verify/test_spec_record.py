"""A spec in a manifest that says another thing than the manifest: every option that it has beside the spec is compared."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from tactape_fab import Tape, TapeSpec, make_kit, verify_kit
from tactape_fab.kit.spec.tape_spec import KEYS
from tactape_fab.verify.spec_record import contradictions

FILM = TapeSpec(
    sector=7,
    size_mm=(40, 30),
    holes_mm=[(20.0, 1.5, 1.0)],
    anchor="spur",
    pitch_mm=2.0,
    base_mm=1.0,
    stiffener="PI 0.1",
    adhesive="3M468 0.13",
    part_number="C1",
)
PRINT = TapeSpec(sector=7, part="dome", size_mm=(40, 30), cylinder_mm=20.0, directions=4)
OTHER: dict[str, object] = {
    **{"sector": 8, "name": "x", "code": "debruijn-4x4", "origin": [0, 0], "pitch_mm": 1.9, "displacement_mm": 0.2},
    **{"size_mm": [40.0, 31.0], "corner_radius_mm": 1.1, "holes_mm": [], "rotation_deg": 40.0, "tag_id": 8, "tag_cell_mm": 0.6},
    **{"tag": "none", "directions": 8, "part": "r0402", "base_mm": 0.8, "negative": True, "top": "single"},
}
OF_FILM: dict[str, object] = {
    **{"fab": "generic-lpi", "assembly": "jlcpcb", "part_number": "C2", "coverlay": "gang", "anchor": "none"},
    **{"stiffener": "PI 0.2", "adhesive": "tesa8854 0.1", "cylinder_mm": 10.0},
}
OF_PRINT: dict[str, object] = {
    **{"process": "fdm", "mark": False, "cylinder_mm": 25.0, "around": "y", "shell": "whole"},
    **{"body_mm": [0.6, 0.6, 0.2], "dome_top_mm": 0.2},
}
ALONE = {"x2", "sim", "models", "bend_axis", "bend_radius_mm"}
"""Options of which nothing else in a manifest says anything."""


def test_every_option_is_compared_or_stands_alone() -> None:
    assert {*OTHER, *OF_FILM, *OF_PRINT} | ALONE == set(KEYS), "enter another value of it, or its name in ALONE"


@pytest.fixture(scope="module")
def manifests(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("kits")
    made = {name: make_kit(spec, folder / name, verify=False).path for name, spec in (("film", FILM), ("print", PRINT))}
    return {name: json.loads((path / "manifest.json").read_text()) for name, path in made.items()}


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [("film", *item) for item in {**OTHER, **OF_FILM}.items()] + [("print", *item) for item in OF_PRINT.items()],
)
def test_every_option_is_held_against_the_manifest(
    manifests: dict[str, dict[str, Any]], kind: str, key: str, value: object
) -> None:
    manifest = deepcopy(manifests[kind])
    tape = Tape.from_mapping(manifest)
    assert not contradictions(manifest, tape)
    manifest["spec"][key] = value
    assert [problem.key for problem in contradictions(manifest, tape)] == [key]
    del manifest["spec"][key]  # as of a version that had no such option
    assert not contradictions(manifest, tape)


def test_a_profile_of_the_user_s_own_may_have_any_name(manifests: dict[str, dict[str, Any]]) -> None:
    manifest = deepcopy(manifests["film"])
    manifest["spec"] |= {"fab": "mine.toml", "part": "mine.toml"}
    assert not contradictions(manifest, Tape.from_mapping(manifest))


def test_an_origin_that_was_looked_for_may_be_any(manifests: dict[str, dict[str, Any]]) -> None:
    manifest = deepcopy(manifests["film"])
    manifest["spec"] |= {"origin": "best", "code": "best"}
    assert [problem.key for problem in contradictions(manifest, Tape.from_mapping(manifest))] == ["code"]


def test_verify_says_so(tmp_path: Path) -> None:
    made = make_kit(TapeSpec(sector=7, size_mm=(30, 25), models=False), tmp_path / "kit", verify=False)
    place = made.path / "manifest.json"
    place.write_text(place.read_text().replace('"holes_mm": []', '"holes_mm": [[15.0, 1.5, 1.0]]'))
    (line,) = [check for check in verify_kit(made.path, quick=True).checks if not check.passed]
    assert (line.name, line.message) == ("manifest", "spec.holes_mm = [[15.0, 1.5, 1.0]] is not that of the tape, []")
