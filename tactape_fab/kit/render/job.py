"""Gerber job file (.gbrjob; Gerber Job Format Specification 2020.08): board, material stack and file list as JSON."""

from __future__ import annotations

import json
from typing import Any

from tactape_fab.base.build_date import build_date
from tactape_fab.base.version import __version__
from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.profiles import FabProfile, material_words

# for mask, paste and profile the job file's names of functions differ from those of X2
_FUNCTIONS = {
    "copper-top": ("Copper,L1,Top", "Positive"),
    "coverlay-top": ("SolderMask,Top", "Negative"),
    "paste-top": ("SolderPaste,Top", "Positive"),
    "legend-top": ("Legend,Top", "Positive"),
    "profile": ("Profile", "Positive"),
}


def render_job(drawing: Drawing, fab: FabProfile) -> tuple[Artifact]:
    """The job file for the fabrication layers in the same folder."""
    name, guid, revision = drawing.project.id.split(",")
    has_legend = bool(drawing.legend.areas_mm)
    width_mm, height_mm = drawing.size_mm
    content: dict[str, Any] = {
        "Header": {
            "GenerationSoftware": {"Vendor": "tactape-fab", "Application": "tactape-fab", "Version": __version__},
            "CreationDate": f"{build_date():%Y-%m-%dT%H:%M:%S+00:00}",
        },
        "GeneralSpecs": {
            "ProjectId": {"Name": name, "GUID": guid, "Revision": revision},
            "Size": {"X": width_mm, "Y": height_mm},
            "LayerNumber": fab.material.layers,
            "BoardThickness": fab.material.thickness_mm,
            "Finish": fab.material.finish,
        },
        "DesignRules": [{"Layers": "Outer", "PadToPad": fab.limits["pad-pad"].value_mm}],
        "FilesAttributes": [
            {"Path": fab.file_path(role, drawing.name).split("/")[-1], "FileFunction": function, "FilePolarity": polarity}
            for role, (function, polarity) in _FUNCTIONS.items()
            if role != "legend-top" or has_legend
        ]
        + _backings(drawing, fab),
        "MaterialStackup": [
            *([{"Type": "Legend", "Color": fab.legend_colour.capitalize(), "Name": "Top legend"}] if has_legend else []),
            {"Type": "SolderPaste", "Name": "Top paste"},
            {"Type": "SolderMask", "Color": fab.coverlay_colour.capitalize(), "Name": f"Top {fab.mask_name}"},
            {"Type": "Copper", "Thickness": fab.material.copper_um / 1000, "Name": "L1"},
            {"Type": "Dielectric", "Material": fab.material.base, "Name": "Base film" if fab.bend is not None else "Base"},
        ],
    }
    role = "job"
    data = (json.dumps(content, indent=2) + "\n").encode("ascii")
    return (Artifact(role=role, path=fab.file_path(role, drawing.name), data=data),)


def _backings(drawing: Drawing, fab: FabProfile) -> list[dict[str, str]]:
    kinds = (("stiffener-bottom", "Stiffener", drawing.stiffener), ("adhesive-bottom", "Adhesive", drawing.adhesive))
    return [
        {
            "Path": fab.file_path(role, drawing.name, material_words(backing)).split("/")[-1],
            "FileFunction": f"Other,{what}",
            "FilePolarity": "Positive",
        }
        for role, what, backing in kinds
        if backing is not None
    ]
