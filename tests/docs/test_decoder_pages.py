"""What docs/dots.md and docs/search.md say: their names are in the decoder, their numbers are those of its constants and of a
contact on the default tape.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
from pathlib import Path

import numpy as np
import pytest

from tactape_fab import TapeSpec
from tactape_fab.kit.examine.tape import examine
from tactape_fab.sense import decode
from tactape_fab.sense.decode import search
from tactape_fab.sense.decode.dots.detect import COARSE_PX_PER_MM
from tactape_fab.sense.decode.grid.lattice import ANGLES
from tactape_fab.sense.decode.rule import (
    AGREE_SIGMAS,
    LEAST_DOTS,
    OUTLIER_SHARE,
    PRIOR_SHARE,
    SMOOTHING_MM,
    WRONG_SHARE,
)
from tactape_fab.sense.decode.search.built_places import CANDIDATES
from tactape_fab.sense.decode.search.evidence import tables_of
from tactape_fab.sense.decode.search.families import families
from tactape_fab.sense.decode.search.groups import count_places, groups_of
from tactape_fab.sense.decode.search.matrices import LARGEST_CONTACT
from tactape_fab.sense.decode.search.tally import NEGLIGIBLE
from tactape_fab.texture.code import get_plane
from tactape_fab.texture.plane import PlaneCode

DOCS = Path(__file__).parents[2] / "docs"
TEXT, DOTS = ((DOCS / name).read_text(encoding="utf-8") for name in ("search.md", "dots.md"))
NAMED = re.compile(r"`(\w+)\.(_?\w+)`")
MODULES = {module.name for module in pkgutil.iter_modules(search.__path__)}
ALL = [module.name for module in pkgutil.walk_packages(decode.__path__, f"{decode.__name__}.")]


def is_there(module: str, name: str) -> bool:
    """Whether a module of the decoder, or a class of one, has a name."""
    for where in ALL:
        found = importlib.import_module(where)
        if where.endswith(f".{module}") and hasattr(found, name):
            return True
        if hasattr(found, module) and name in (*dir(getattr(found, module)), *getattr(getattr(found, module), "_fields", ())):
            return True
    return False


@pytest.mark.parametrize(("module", "name"), sorted(set(NAMED.findall(TEXT + DOTS))))
def test_what_is_named_is_there(module: str, name: str) -> None:
    assert is_there(module, name)


def test_a_name_that_is_gone_would_be_found() -> None:
    assert len(NAMED.findall(TEXT)) > 10 and len(NAMED.findall(DOTS)) > 10
    assert not is_there("tally", "weigh_none") and not is_there("none", "weigh_site") and not is_there("ManyBuffers", "none")


def test_every_module_of_the_search_is_in_the_table() -> None:
    told = {name for row in re.findall(r"^\| (`.+?) \|", TEXT, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    others = {"plane", "sequence_plane", "trace_plane"}  # of a code without tapes
    assert told == MODULES - others and {"sequence_plane", "trace_plane"} <= set(re.findall(r"`(\w+)`", TEXT))


def test_numbers_of_places_are_those_of_a_contact() -> None:
    tape = examine(TapeSpec(sector=7)).layout.tape
    (family,) = families([tape], open_world=True)
    assert family.unregistered is not None
    code = get_plane(tape.code)
    assert isinstance(code, PlaneCode)
    cells = np.stack(np.meshgrid(np.arange(7), np.arange(6), indexing="ij"), axis=-1).reshape(-1, 2)
    cells = cells[np.arange(len(cells)) % 6 != 3]
    assert len(cells) == 35
    tables = tables_of(cells, np.full((35, 4), 0.25), family.signs, LARGEST_CONTACT)
    groups = groups_of(tables, family.registered.sizes, LEAST_DOTS)
    registered = count_places([groups], [family.registered.classes])
    inside, over = registered.T
    assert f"{tape.columns}x{tape.rows} points" in TEXT and (tape.columns, tape.rows) == (62, 32)
    assert set(inside.tolist()) == {1482.0, 1512.0} and "at 1,482 or 1,512 places" in TEXT
    assert set(np.round(over, -2).tolist()) <= {800.0, 900.0} and "800 to 900 more" in TEXT
    assert 9000.0 < registered.sum() < 10000.0 and "more than 9,000 places in four turns" in " ".join(TEXT.split())
    unregistered = float(count_places([groups], [family.unregistered.classes]).sum())
    assert 3.8e6 < unregistered < 4e6 and "nearly four million places" in TEXT
    assert code.sectors == 256 and "255 other sectors" in TEXT
    assert tables.size[0].sum() == 13 and "with 13 terms" in TEXT


@pytest.mark.parametrize(
    "said",
    [
        f"exp({NEGLIGIBLE:g})",
        f"the best {CANDIDATES} places",
        f"at least {'six' if LEAST_DOTS == 6 else LEAST_DOTS} of them",
        f"one {'half' if PRIOR_SHARE == 0.5 else PRIOR_SHARE} of all weight",
    ],
)
def test_constants_are_those_of_the_search(said: str) -> None:
    assert said in " ".join(TEXT.split()), f"docs/search.md has to say: {said}"


@pytest.mark.parametrize(
    "said",
    [
        f"finer than {COARSE_PX_PER_MM:g} px/mm",
        f"a Gaussian of {SMOOTHING_MM:g} mm",
        f"looks at {ANGLES} angles",
        f"t = trust · {1.0 - OUTLIER_SHARE:g}",
        f"with {100.0 * WRONG_SHARE:g} % spread over all letters, so that no bit says more than ln {1.0 / WRONG_SHARE:.0f}",
        f"within {AGREE_SIGMAS:g} standard deviations",
    ],
)
def test_constants_are_those_of_the_dots(said: str) -> None:
    assert said in " ".join(DOTS.split()), f"docs/dots.md has to say: {said}"
