"""Check of the Gerber job file: every value is that of the manifest's fab, board and files."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from tactape_fab.base.errors import Check, SpecError
from tactape_fab.base.fields import Fields, named, shown
from tactape_fab.base.json_text import parse_json
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.profiles import FabProfile, Material, load_fab
from tactape_fab.verify.certificate import difference
from tactape_fab.verify.files import WrittenFile

_FUNCTIONS = {
    "copper-top": ("Copper,L1,Top", "Positive"),
    "coverlay-top": ("SolderMask,Top", "Negative"),
    "paste-top": ("SolderPaste,Top", "Positive"),
    "legend-top": ("Legend,Top", "Positive"),
    "profile": ("Profile", "Positive"),
    "stiffener-bottom": ("Other,Stiffener", "Positive"),
    "adhesive-bottom": ("Other,Adhesive", "Positive"),
}
_FREE = {
    ("Header", "GenerationSoftware", "Version"): r"[0-9A-Za-z.+-]{1,40}",
    ("Header", "CreationDate"): r"[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}\+00:00",
    ("GeneralSpecs", "ProjectId", "GUID"): r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}",
    ("GeneralSpecs", "ProjectId", "Revision"): r"[0-9A-Za-z.+-]{1,40}",
}
"""Values that depend on date and version, with the pattern of each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FabOrder(Material):
    """The film's materials, from a manifest."""

    flexible: bool
    mask: str
    coverlay_colour: str
    legend_colour: str
    pad_to_pad_mm: float


def known_fab(fab: Fields) -> FabProfile | None:
    """The profile of this package that a manifest names, for older manifests that record less; None for a user's own."""
    name = fab.values.get("name")
    if not isinstance(name, str) or name not in profile_names("fabs"):
        return None
    try:
        return load_fab(name)
    except SpecError:
        return None


def read_fab_order(table: Fields) -> FabOrder | None:
    """Read the materials from a manifest; None if it has no record and names a user's own profile. Problems go to `table`."""
    fab = table.table("fab")
    profile = known_fab(fab) if "material" not in fab.values else None
    if "material" not in fab.values and profile is None:
        return None
    if profile is not None:
        record = {**asdict(profile.material), "mask": profile.mask_name, "flexible": profile.bend is not None}
        material = Fields(record, "fab.material.", table.problems)
    else:
        material = fab.table("material")
    return FabOrder(
        base=material.text("base"),
        flexible=material.flag("flexible"),
        mask=material.text("mask"),
        coverlay_colour=fab.text("coverlay_colour", longest=20),
        legend_colour=fab.text("legend_colour", longest=20),
        layers=material.integer("layers", low=1, high=64),
        thickness_mm=material.number("thickness_mm", above=0.0, high=10.0),
        copper_um=material.number("copper_um", above=0.0, high=1000.0, unit="um"),
        finish=material.text("finish"),
        pad_to_pad_mm=fab.table("limits_mm").number("pad-pad", low=0.0, high=100.0),
    )


def check_job(name: str, size_mm: tuple[float, float], order: FabOrder | None, files: Mapping[str, WrittenFile]) -> Check:
    """Check that the job file is JSON with the manifest's project, size, layers, thickness, materials and files."""
    try:
        job = parse_json(files["job"].data)
        given = job["GeneralSpecs"]["Size"]
        written_mm = (float(given["X"]), float(given["Y"]))
        paths = {str(row["Path"]) for row in job["FilesAttributes"]}
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        return Check(name="job", passed=False, message=f"the job file cannot be read: {type(error).__name__} {shown(str(error))}")
    roles = [role for role in _FUNCTIONS if role in files]
    expected = {files[role].path.rsplit("/", 1)[-1]: _FUNCTIONS[role] for role in roles}
    problems = [f"it names {shown(p)}, which is not there" for p in sorted(paths - expected.keys())]
    problems += [f"it does not name {p}" for p in sorted(expected.keys() - paths)]
    if written_mm != size_mm:
        problems.append(f"its board is {written_mm[0]:g} x {written_mm[1]:g} mm")
    if not problems and order is not None:
        # compared as a whole, so that an added key is a difference
        wrong = difference(_free_taken_out(job), _expected(name, size_mm, order, expected, has_legend="legend-top" in files))
        problems += [] if wrong is None else [wrong]
    right = f"names the {len(expected)} layers and the board's size" + ("" if order is None else ", stackup and finish")
    return Check(name="job", passed=not problems, message=named(problems) or right)


def _free_taken_out(job: dict[str, Any]) -> dict[str, Any]:
    """A copy without the free values that match their pattern; others remain, and are differences."""
    copy: dict[str, Any] = json.loads(json.dumps(job))
    for (*parents, last), form in _FREE.items():
        place: Any = copy
        for key in parents:
            place = place.get(key) if isinstance(place, dict) else None
        if isinstance(place, dict) and isinstance(place.get(last), str) and re.fullmatch(form, place[last]):
            del place[last]
    return copy


def _expected(
    name: str, size_mm: tuple[float, float], order: FabOrder, layers: Mapping[str, tuple[str, str]], *, has_legend: bool
) -> dict[str, Any]:
    legend = [{"Type": "Legend", "Color": order.legend_colour.capitalize(), "Name": "Top legend"}] if has_legend else []
    return {
        "Header": {"GenerationSoftware": {"Vendor": "tactape-fab", "Application": "tactape-fab"}},
        "GeneralSpecs": {
            "ProjectId": {"Name": name},
            "Size": {"X": size_mm[0], "Y": size_mm[1]},
            "LayerNumber": order.layers,
            "BoardThickness": order.thickness_mm,
            "Finish": order.finish,
        },
        "DesignRules": [{"Layers": "Outer", "PadToPad": order.pad_to_pad_mm}],
        "FilesAttributes": [
            {"Path": path, "FileFunction": function, "FilePolarity": polarity} for path, (function, polarity) in layers.items()
        ],
        "MaterialStackup": [
            *legend,
            {"Type": "SolderPaste", "Name": "Top paste"},
            {"Type": "SolderMask", "Color": order.coverlay_colour.capitalize(), "Name": f"Top {order.mask}"},
            {"Type": "Copper", "Thickness": order.copper_um / 1000, "Name": "L1"},
            {"Type": "Dielectric", "Material": order.base, "Name": "Base film" if order.flexible else "Base"},
        ],
    }
