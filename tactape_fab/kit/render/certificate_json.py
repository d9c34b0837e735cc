"""The certificate of a tape as a JSON file."""

from __future__ import annotations

import json

from tactape_fab.kit.artifact import Artifact
from tactape_fab.texture.certify.certificate import Certificate


def render_certificate(certificate: Certificate) -> tuple[Artifact]:
    """The certificate of the tape."""
    text = json.dumps(certificate.to_mapping(), indent=1, ensure_ascii=True, allow_nan=False) + "\n"
    return (Artifact(role="certificate", path=f"{certificate.tape.name}-certificate.json", data=text.encode("ascii")),)
