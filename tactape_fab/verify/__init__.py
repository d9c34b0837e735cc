"""Verification: reads a written kit back with software that is not ours and compares it with its manifest."""

from tactape_fab.verify.kit import Verification, verify_folder, verify_kit
from tactape_fab.verify.trip.round_trip import Contact, read_contact

__all__ = ["Contact", "Verification", "read_contact", "verify_folder", "verify_kit"]
