"""Depth map in, position out: which tape is touched, where, at what angle, and how likely that is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tactape_fab.decode.localizer import Localizer
    from tactape_fab.decode.reconstruct import Reconstruction, load_network, make_reconstruction
    from tactape_fab.decode.result import Localization
    from tactape_fab.decode.search import Prior

__all__ = ["Localization", "Localizer", "Prior", "Reconstruction", "load_network", "make_reconstruction"]

_HOMES = {
    **{"Localizer": "localizer", "Localization": "result", "Prior": "search"},
    **dict.fromkeys(("Reconstruction", "load_network", "make_reconstruction"), "reconstruct"),
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
