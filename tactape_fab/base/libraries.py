"""Optional libraries: imported where they are used; if one is missing, the error gives the command that installs it.

A robot installs only numpy, numba and click. Libraries for pictures and solids are imported by `library`.
"""

from __future__ import annotations

import zlib
from functools import cache
from importlib import import_module
from typing import Any

from tactape_fab.base.errors import MissingLibraryError

_INSTALLED_BY = {
    "OCP": '"tactape-fab[cad]"',
    "build123d": '"tactape-fab[cad]"',
    "cryptography": '"tactape-fab[sign]"',
    "cv2": "opencv-python-headless",
    "distributed": '"tactape-fab[cluster]"',
    "gtsam": '"tactape-fab[slam]"',
    "manifold3d": '"tactape-fab[cad]"',
    "lz4": '"tactape-fab[live]"',
    "mcap": '"tactape-fab[live]"',
    "pyarrow": "pyarrow",
    "rerun": '"tactape-fab[rerun]"',
    "scipy": '"tactape-fab[measure]"',
    "tomli": "tomli",
    "zstandard": '"tactape-fab[live]"',
    "zenoh": '"tactape-fab[zenoh]"',
}
"""The pip requirement of each module; all other modules come with the package's own dependencies."""
_OWN = "tactape-fab"
_IN_KITS = ("numpy", "shapely", "gerbonara", "jinja2", "Hershey-Fonts", "trimesh", "opencv-python-headless", "reportlab")
"""Distributions whose version may change bytes of a kit: figures, outlines, label, previews, notes, report, drawings."""


def library(module: str, use: str) -> Any:
    """Import an optional library by the name of its module.

    use: What needs it, as the beginning of a sentence: ``"drawing pictures"``.
    Raises MissingLibraryError when it is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != module.partition(".")[0]:
            raise
        raise MissingLibraryError(missing(error.name, use), name=error.name) from error


def missing(module: str, use: str) -> str:
    """Message that a library is not installed, with the command that installs it."""
    name = module.partition(".")[0]
    return f"{use} needs {name}, which is not installed; pip install {_INSTALLED_BY.get(name, _OWN)}"


@cache
def versions_in_kits() -> dict[str, str]:
    """Versions of the libraries on which the bytes of a kit depend, for its manifest; those not installed are left out."""
    from importlib.metadata import PackageNotFoundError, version  # 30 ms, of which most commands need nothing

    found = {}
    for name in _IN_KITS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # the module comes from a distribution of another name
            continue
    return {**found, "zlib": zlib.ZLIB_RUNTIME_VERSION}
