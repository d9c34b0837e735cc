"""Check of a kit's certificate, which is computed again and compared."""

from __future__ import annotations

from typing import Any

from tactape_fab.base.errors import Check
from tactape_fab.base.fields import shown
from tactape_fab.base.json_text import parse_json
from tactape_fab.texture.certify.certificate import certify
from tactape_fab.texture.tape import Tape
from tactape_fab.verify.files import CERTIFICATE, WrittenFile


def check_certificate(file: WrittenFile, tape: Tape) -> Check:
    """Check that every number of the certificate file equals the one computed from the tape."""
    certificate = certify(tape)
    try:
        content = parse_json(file.data)
    except ValueError as error:
        return Check(name=CERTIFICATE, passed=False, message=f"{file.path} cannot be read as JSON: {error}")
    wrong = difference(content, certificate.to_mapping())
    size = certificate.sizes[0]
    if wrong is not None:
        return Check(name=CERTIFICATE, passed=False, message=f"{file.path} is not this tape's: {wrong}")
    windows = f"{size.windows} windows of {size.side}x{size.side} differ"
    if size.windows == 1:  # the distance is that from itself, turned
        windows = f"1 window of {size.side}x{size.side} differs"
    message = f"as computed again: {windows} by {size.distance} symbols or more"
    if size.distance is None:
        message = f"as computed again: the tape has no whole window of {size.side}x{size.side}"
    return Check(name=CERTIFICATE, passed=True, message=message, figure=size.distance)


def difference(found: Any, expected: Any, where: str = "") -> str | None:
    """Description of the first place where two JSON values differ."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for key in [*expected, *(k for k in found if k not in expected)]:
            place = f"{where}.{key}" if where else str(key)
            if key not in found or key not in expected:
                return f"{shown(place)} {'is missing' if key in expected else 'does not belong there'}"
            if (wrong := difference(found[key], expected[key], place)) is not None:
                return wrong
        return None
    if isinstance(expected, list) and isinstance(found, list) and len(found) == len(expected):
        wrongs = (difference(f, e, f"{where}[{i}]") for i, (f, e) in enumerate(zip(found, expected, strict=True)))
        return next((wrong for wrong in wrongs if wrong is not None), None)
    # in Python True == 1 and 1.0 == 1, in a certificate not
    same = type(found) is type(expected) and found == expected
    return None if same else f"{where or 'the content'} = {shown(found)}, computed {shown(expected)}"
