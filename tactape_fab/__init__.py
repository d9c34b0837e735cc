"""tactape-fab: make tactile fiducial tapes that a PCB fab can build, and prove them from the written files."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from tactape_fab.kit.spec import TapeSpec as TapeSpec
    from tactape_fab.make import Kit as Kit
    from tactape_fab.make import make_kit as make_kit
    from tactape_fab.texture.code import default_origin as default_origin
    from tactape_fab.texture.tape import Tape as Tape
    from tactape_fab.verify import verify_kit as verify_kit

_HOMES = {
    "Kit": "tactape_fab.make",
    "Tape": "tactape_fab.texture.tape",
    "TapeSpec": "tactape_fab.kit.spec",
    "default_origin": "tactape_fab.texture.code",
    "make_kit": "tactape_fab.make",
    "verify_kit": "tactape_fab.verify",
}

__all__ = ["Kit", "Tape", "TapeSpec", "__version__", "default_origin", "make_kit", "verify_kit"]


def __getattr__(name: str) -> Any:
    """Import public names on first use, so that the command line answers at once (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
