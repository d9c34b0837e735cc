"""Tapes of a code without kits, as `make` plans them."""

from __future__ import annotations

from typing import Any

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.kit.examine.tape import profiles_of
from tactape_fab.kit.spec.tape_spec import TapeSpec
from tactape_fab.texture.code import CODE_NAMES, get_code, has_plane
from tactape_fab.texture.tape import Tape

MOST_SECTORS = 256
"""Most sectors of a code that are certified without kits."""


def default_tapes(code: str, size_mm: Any = (100.0, 50.0)) -> list[Tape]:
    """The tapes of a code's first `MOST_SECTORS` sectors at their default origins, as `make` plans them.

    Raises SpecError if there is no such code, or no tape of that size.
    """
    if not has_plane(code):
        message = f"code = '{code}' has no tapes but those that were made: each is designed; name their kits"
        raise SpecError(Problem("code", message))
    sectors = min(get_code(code).sectors, MOST_SECTORS) if code in CODE_NAMES else 1
    specs = [TapeSpec(sector=s, code=code, size_mm=size_mm) for s in range(sectors)]
    profiles = profiles_of(specs[0])
    return [profiles.plan(spec) for spec in specs]
