"""Fab, part, process and sensor profiles: data files of templates/, or a user's own TOML by path, read into plain records."""

from __future__ import annotations

from tactape_fab.base.templates import profile_names, read_toml, templates_folder
from tactape_fab.kit.profiles.assembly import (
    FORMATS,
    PART_NUMBER_PATTERN,
    PART_NUMBER_REMEDY,
    BomTable,
    part_number_problem,
)
from tactape_fab.kit.profiles.explain import explain_fab
from tactape_fab.kit.profiles.fab_tables import COVERLAY_MODES, AnchorRules, CoverlayMode, material_words
from tactape_fab.kit.profiles.fabs import (
    BACKING_ROLES,
    GERBER_ROLES,
    LIMIT_IDS,
    X2_MODES,
    FabProfile,
    LegendRules,
    Material,
    X2Mode,
    house_fab,
    load_fab,
)
from tactape_fab.kit.profiles.limits import Limit, Origin, SizeLimit, cited
from tactape_fab.kit.profiles.ordering import COSTS, Assumption, Ordering, PartNumber
from tactape_fab.kit.profiles.parts import (
    LARGEST_BODY_MM,
    LEAST_BODY_MM,
    ElementProfile,
    LandPattern,
    PartProfile,
    element_problem,
    load_part,
    read_land,
    read_part,
)
from tactape_fab.kit.profiles.processes import PROCESS_LIMIT_IDS, ProcessProfile, load_process
from tactape_fab.texture.cpl import ASSEMBLY_FORMATS

__all__ = [
    "ASSEMBLY_FORMATS",
    "BACKING_ROLES",
    "COSTS",
    "COVERLAY_MODES",
    "FORMATS",
    "GERBER_ROLES",
    "LARGEST_BODY_MM",
    "LEAST_BODY_MM",
    "LIMIT_IDS",
    "PART_NUMBER_PATTERN",
    "PART_NUMBER_REMEDY",
    "PROCESS_LIMIT_IDS",
    "X2_MODES",
    "AnchorRules",
    "Assumption",
    "BomTable",
    "CoverlayMode",
    "ElementProfile",
    "FabProfile",
    "LandPattern",
    "LegendRules",
    "Limit",
    "Material",
    "Ordering",
    "Origin",
    "PartNumber",
    "PartProfile",
    "ProcessProfile",
    "SizeLimit",
    "X2Mode",
    "cited",
    "element_problem",
    "explain_fab",
    "house_fab",
    "load_fab",
    "load_part",
    "load_process",
    "material_words",
    "part_number_problem",
    "profile_names",
    "read_land",
    "read_part",
    "read_toml",
    "templates_folder",
]
