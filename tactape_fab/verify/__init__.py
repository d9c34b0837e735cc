"""Verification: reads a written kit back with software that is not ours and compares it with its manifest."""

from tactape_fab.verify.kit import Verification, verify_folder, verify_kit
from tactape_fab.verify.panel import verify_panel_folder

__all__ = ["Verification", "verify_folder", "verify_kit", "verify_panel_folder"]
