"""The certificate of a kit is computed anew whenever it is verified: nothing that was remembered can vouch for it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tactape_fab import Kit, Tape
from tactape_fab.texture.certify import certificate
from tactape_fab.verify.certificate import check_certificate
from tactape_fab.verify.files import WrittenFile


def test_another_texture_gives_another_certificate_though_the_tape_is_the_same(
    small_kit: Kit, monkeypatch: pytest.MonkeyPatch
) -> None:
    tape = Tape.load(small_kit.path)
    path = small_kit.files["certificate"]
    file = WrittenFile(path=path, data=(small_kit.path / path).read_bytes())
    assert check_certificate(file, tape).passed
    closest = certificate.closest

    def nearer(*arguments: object) -> certificate.Closest:
        found = closest(*arguments)  # type: ignore[arg-type]
        return replace(found, distance=(found.distance or 0) + 1)

    with monkeypatch.context() as patched:
        patched.setattr(certificate, "closest", nearer)
        failed = check_certificate(file, tape)
    assert not failed.passed
    assert "computed" in failed.message
    assert check_certificate(file, tape).passed
