"""Chunks of a PNG, looked at before OpenCV does: it makes room for what a length says, 4 GB for a file of 300 bytes."""

from __future__ import annotations

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def chunks_fit(data: bytes) -> bool:
    """Whether every chunk of a PNG ends inside the file (PNG, 5.3); true of everything else."""
    if not data.startswith(_SIGNATURE):
        return True
    at, kind = len(_SIGNATURE), b""
    while kind != b"IEND":
        kind = data[at + 4 : at + 8]
        at += 12 + int.from_bytes(data[at : at + 4], "big")
        if at > len(data):
            return False
    return True
