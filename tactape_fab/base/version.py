"""Version of the package; manifests and Gerber attributes carry it."""

from __future__ import annotations

__version__ = "0.1.0"
