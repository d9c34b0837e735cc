"""The job file's values are those of the manifest, one by one."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tactape_fab.base.fields import Fields
from tactape_fab.kit.profiles import load_fab
from tactape_fab.verify.files import WrittenFile
from tactape_fab.verify.layers.job_file import FabOrder, check_job, known_fab, read_fab_order

ORDER = FabOrder(
    base="polyimide",
    flexible=True,
    mask="coverlay",
    coverlay_colour="yellow",
    legend_colour="white",
    layers=1,
    thickness_mm=0.11,
    copper_um=18.0,
    finish="ENIG",
    pad_to_pad_mm=0.15,
)
PATHS = {
    "copper-top": "t-F_Cu.gbr",
    "paste-top": "t-F_Paste.gbr",
    "legend-top": "t-F_Silkscreen.gbr",
    "profile": "t-Edge_Cuts.gbr",
}
LAYERS = [
    {"Path": "t-F_Cu.gbr", "FileFunction": "Copper,L1,Top", "FilePolarity": "Positive"},
    {"Path": "t-F_Paste.gbr", "FileFunction": "SolderPaste,Top", "FilePolarity": "Positive"},
    {"Path": "t-F_Silkscreen.gbr", "FileFunction": "Legend,Top", "FilePolarity": "Positive"},
    {"Path": "t-Edge_Cuts.gbr", "FileFunction": "Profile", "FilePolarity": "Positive"},
]


def job() -> dict[str, Any]:
    """As the Gerber job format 2023.08 has it, in letters."""
    return {
        "Header": {
            "GenerationSoftware": {"Vendor": "tactape-fab", "Application": "tactape-fab", "Version": "0.1.0"},
            "CreationDate": "1980-01-01T00:00:00+00:00",
        },
        "GeneralSpecs": {
            "ProjectId": {"Name": "t", "GUID": "c1640f16-0fd4-4b24-8564-6172140fb7f8", "Revision": "0.1.0"},
            "Size": {"X": 30.0, "Y": 24.0},
            "LayerNumber": 1,
            "BoardThickness": 0.11,
            "Finish": "ENIG",
        },
        "DesignRules": [{"Layers": "Outer", "PadToPad": 0.15}],
        "FilesAttributes": LAYERS,
        "MaterialStackup": [
            {"Type": "Legend", "Color": "White", "Name": "Top legend"},
            {"Type": "SolderPaste", "Name": "Top paste"},
            {"Type": "SolderMask", "Color": "Yellow", "Name": "Top coverlay"},
            {"Type": "Copper", "Thickness": 0.018, "Name": "L1"},
            {"Type": "Dielectric", "Material": "polyimide", "Name": "Base film"},
        ],
    }


def changed(path: str, value: Any) -> dict[str, Any]:
    """The job with another value at a path of keys; None takes it away."""
    made = json.loads(json.dumps(job()))
    *parents, last = (int(key) if key.isdigit() else key for key in path.split("/"))
    place: Any = made
    for key in parents:
        place = place[key]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return dict(made)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (job(), "names the 4 layers and the board's size, stackup and finish"),
        (changed("Header/CreationDate", "2026-11-28T14:00:00+00:00"), "names the 4 layers"),
        (changed("GeneralSpecs/ProjectId/GUID", 8 * "0" + 4 * "-0000" + 8 * "0"), "names the 4 layers"),
        (changed("GeneralSpecs/ProjectId/GUID", 8 * "0" + 4 * "-0000"), "GUID"),
        (changed("Header/CreationDate", "yesterday"), "CreationDate"),
        (changed("Header/GenerationSoftware/Version", 1), "Version"),
        (changed("GeneralSpecs/ProjectId/Revision", "a b"), "Revision"),
        (changed("GeneralSpecs/ProjectId/Name", "u"), "Name"),
        (changed("GeneralSpecs/Size/X", 31.0), "its board is 31 x 24 mm"),
        (changed("GeneralSpecs/LayerNumber", 2), "LayerNumber"),
        (changed("GeneralSpecs/BoardThickness", 0.2), "BoardThickness"),
        (changed("GeneralSpecs/Finish", "HASL"), "Finish"),
        (changed("GeneralSpecs/ImpedanceControlled", True), "ImpedanceControlled"),
        (changed("DesignRules/0/PadToPad", 0.1), "PadToPad"),
        (changed("FilesAttributes/0/Path", "u.gbr"), "it names 'u.gbr', which is not there, it does not name t-F_Cu.gbr"),
        (changed("FilesAttributes/0/FilePolarity", "Negative"), "FilePolarity"),
        (changed("MaterialStackup/0", None), "MaterialStackup"),
        (changed("MaterialStackup/2/Color", "Green"), "Color"),
        (changed("MaterialStackup/3/Thickness", 18.0), "Thickness"),
        (changed("MaterialStackup/4/Name", "Base"), "Name"),
        (changed("GeneralSpecs/Size", None), "cannot be read: KeyError 'Size'"),
    ],
)
def test_every_value_is_the_manifest_s(given: dict[str, Any], says: str) -> None:
    files = {role: WrittenFile(path=f"gerber/{path}", data=b"") for role, path in PATHS.items()}
    files["job"] = WrittenFile(path="gerber/t-job.gbrjob", data=json.dumps(given).encode())
    check = check_job("t", (30.0, 24.0), ORDER, files)
    assert check.passed == says.startswith("names the") and says.strip("'") in check.message.replace('"', ""), check.message
    assert check_job("t", (30.0, 24.0), None, files).passed or "size" not in check.message


def test_without_a_legend_and_of_a_rigid_board() -> None:
    given = changed("MaterialStackup/0", None)
    given["MaterialStackup"][-1] = {"Type": "Dielectric", "Material": "FR4", "Name": "Base"}
    given["FilesAttributes"] = [row for row in LAYERS if "Legend" not in row["FileFunction"]]
    files = {role: WrittenFile(path=path, data=b"") for role, path in PATHS.items() if role != "legend-top"}
    files["job"] = WrittenFile(path="t-job.gbrjob", data=json.dumps(given).encode())
    rigid = FabOrder(**{f: getattr(ORDER, f) for f in FabOrder.__dataclass_fields__} | {"base": "FR4", "flexible": False})
    assert check_job("t", (30.0, 24.0), rigid, files).passed
    assert not check_job("t", (30.0, 24.0), ORDER, files).passed


def test_materials_are_the_manifest_s_or_those_of_a_known_profile() -> None:
    fab: dict[str, Any] = {
        "name": "generic-fpc",
        "coverlay_colour": "yellow",
        "legend_colour": "white",
        "limits_mm": {"pad-pad": 0.15},
    }
    material = {
        "base": "PEN",
        "flexible": True,
        "mask": "LPI",
        "layers": 2,
        "thickness_mm": 0.2,
        "copper_um": 35.0,
        "finish": "OSP",
    }
    table = Fields({"fab": fab | {"name": "mine", "material": material}})
    own = read_fab_order(table)
    assert (
        not table.problems
        and own is not None
        and (own.base, own.mask, own.layers, own.copper_um, own.pad_to_pad_mm) == ("PEN", "LPI", 2, 35.0, 0.15)
    )
    profile, older = load_fab("generic-fpc"), read_fab_order(Fields({"fab": fab}))
    assert older is not None and older.base == profile.material.base and older.flexible
    assert read_fab_order(Fields({"fab": fab | {"name": "mine"}})) is None
    assert known_fab(Fields({"name": 3})) is None
    rigid = read_fab_order(Fields({"fab": fab | {"name": "pcbway-fr4"}}))
    assert rigid is not None and not rigid.flexible
