"""Fab, part and process profiles: data files of templates/, or a user's own TOML by path, read into plain records."""

from __future__ import annotations

from tactape_fab.base.templates import profile_names as profile_names
from tactape_fab.base.templates import templates_folder as templates_folder
from tactape_fab.kit.profiles.explain import explain_fab as explain_fab
from tactape_fab.kit.profiles.fab_tables import COVERLAY_MODES as COVERLAY_MODES
from tactape_fab.kit.profiles.fab_tables import CoverlayMode as CoverlayMode
from tactape_fab.kit.profiles.fab_tables import material_words as material_words
from tactape_fab.kit.profiles.fabs import BACKING_ROLES as BACKING_ROLES
from tactape_fab.kit.profiles.fabs import GERBER_ROLES as GERBER_ROLES
from tactape_fab.kit.profiles.fabs import LIMIT_IDS as LIMIT_IDS
from tactape_fab.kit.profiles.fabs import X2_MODES as X2_MODES
from tactape_fab.kit.profiles.fabs import FabProfile as FabProfile
from tactape_fab.kit.profiles.fabs import LegendSizes as LegendSizes
from tactape_fab.kit.profiles.fabs import Material as Material
from tactape_fab.kit.profiles.fabs import X2Mode as X2Mode
from tactape_fab.kit.profiles.fabs import house_fab as house_fab
from tactape_fab.kit.profiles.fabs import load_fab as load_fab
from tactape_fab.kit.profiles.limits import Limit as Limit
from tactape_fab.kit.profiles.limits import Origin as Origin
from tactape_fab.kit.profiles.limits import cited as cited
from tactape_fab.kit.profiles.ordering import COSTS as COSTS
from tactape_fab.kit.profiles.ordering import Assumption as Assumption
from tactape_fab.kit.profiles.ordering import Ordering as Ordering
from tactape_fab.kit.profiles.ordering import PartNumber as PartNumber
from tactape_fab.kit.profiles.parts import LARGEST_BODY_MM as LARGEST_BODY_MM
from tactape_fab.kit.profiles.parts import LEAST_BODY_MM as LEAST_BODY_MM
from tactape_fab.kit.profiles.parts import ElementProfile as ElementProfile
from tactape_fab.kit.profiles.parts import LandPattern as LandPattern
from tactape_fab.kit.profiles.parts import PartProfile as PartProfile
from tactape_fab.kit.profiles.parts import element_problem as element_problem
from tactape_fab.kit.profiles.parts import load_part as load_part
from tactape_fab.kit.profiles.parts import read_land as read_land
from tactape_fab.kit.profiles.parts import read_part as read_part
from tactape_fab.kit.profiles.processes import PROCESS_LIMIT_IDS as PROCESS_LIMIT_IDS
from tactape_fab.kit.profiles.processes import ProcessProfile as ProcessProfile
from tactape_fab.kit.profiles.processes import load_process as load_process
