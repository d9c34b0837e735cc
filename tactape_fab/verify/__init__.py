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

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "verify.file": "verify_kit",
        "verify.kit": "verify_folder",
        "verify.trip.round_trip": "Contact read_contact",
        "verify.verification": "Verification",
    },
)
