"""Largest size of each file of a kit, by its role and the number of parts and holes; larger files are not read.

A kit is untrusted, and so are the sizes in its manifest. The limits are at least three times the sizes of files that
this tool writes; `docs/make_limits.py` prints both.
"""

from __future__ import annotations

from types import MappingProxyType

from tactape_fab.texture.tape import Tape

MIB = 1 << 20
MOST_FILES = 1000
"""Most files that a manifest may list; a kit has some 25, a panel 20."""
MOST_FILE_BYTES = 1024 * MIB
WHOLE_KIT = "all files together"
_SMALL = (MIB, 0)
_LAYER = (MIB, 2_000)
BUDGETS = MappingProxyType(
    {
        **dict.fromkeys(("copper-top", "coverlay-top", "paste-top", "legend-top", "components-top", "drill-npth"), _LAYER),
        **dict.fromkeys(("fab-drawing", "fab-dxf"), _LAYER),
        **dict.fromkeys(("profile", "job", "certificate", "kicad-project", "order-notes"), _SMALL),
        **dict.fromkeys(("cpl", "bom", "placements"), (MIB, 500)),
        "fab-zip": (4 * MIB, 2_000),
        "kicad-pcb": (MIB, 8_000),
        "step-assembly": (MIB, 4_000),
        "step-solid": (MIB, 16_000),
        "stl": (MIB, 40_000),
        "3mf": (MIB, 10_000),
        WHOLE_KIT: (128 * MIB, 100_000),
    }
)
"""Bytes by role: of a file without parts, and per part or hole."""
OTHERS = (32 * MIB, 16_000)
"""The same for every other role: pictures, report, drawings."""
_OWN_PART = 512 * MIB
"""Bytes of the user's own part in a model of an embossed kit."""


def most_bytes(role: str, count: int, *, embossed: bool = False) -> int:
    """Most bytes of a file of a role, in a kit with `count` parts and holes; `embossed` for one on the user's own part."""
    base, each = BUDGETS.get(role, OTHERS)
    # the size of the user's own part does not follow from anything in the kit
    own = _OWN_PART if embossed and role in ("stl", "3mf", "step-solid", WHOLE_KIT) else 0
    return min(base + each * count + own, MOST_FILE_BYTES)


def count_of(*tapes: Tape) -> int:
    """Total number of parts and holes of tapes."""
    return sum(tape.part_count + len(tape.board.holes) for tape in tapes)
