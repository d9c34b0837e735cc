"""Verification: reads a written kit back with software that is not ours and compares it with its manifest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactape_fab.base.lazy import lazy_names

if TYPE_CHECKING:
    from tactape_fab.verify.file import verify_kit as verify_kit
    from tactape_fab.verify.kit import verify_folder as verify_folder
    from tactape_fab.verify.trip.round_trip import Contact as Contact
    from tactape_fab.verify.trip.round_trip import read_contact as read_contact
    from tactape_fab.verify.verification import Verification as Verification

_TRIP = "tactape_fab.verify.trip.round_trip"
_HOMES = {
    "Contact": _TRIP,
    "Verification": "tactape_fab.verify.verification",
    "read_contact": _TRIP,
    "verify_folder": "tactape_fab.verify.kit",
    "verify_kit": "tactape_fab.verify.file",
}
__all__ = ["Contact", "Verification", "read_contact", "verify_folder", "verify_kit"]

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
