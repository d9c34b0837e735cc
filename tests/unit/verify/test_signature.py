"""Signatures of folders with a manifest: whose they are, what is no key, and that nothing large is read."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tactape_fab.base.errors import Check, SpecError
from tactape_fab.texture.manifest import MOST_MANIFEST_BYTES
from tactape_fab.verify.signature import check_signed, read_signer
from tests.signing import SHOP, write_keys

FINGERPRINT = "SHA256:kV77AjwNB531Bj+lewx93m9dAbGJpy8hkre8voTKF9g"


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_keys(tmp_path_factory.mktemp("keys"))


@pytest.fixture
def kit(tmp_path: Path) -> Path:
    """A panel, as far as a signature looks: a manifest, and those of its two kits."""
    for folder in ("kit", "kit/tapes/a", "kit/tapes/b", "kit/other/c"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "manifest.json").write_text(f'{{"name": "{folder}"}}')
    return tmp_path / "kit"


def check(kit: Path, key: Path | None) -> Check:
    (found,) = check_signed(kit, key)
    return found


@pytest.mark.parametrize("private", ["shop.pem", "shop.ssh"])
@pytest.mark.parametrize("public", ["shop.pub", "shop.pub.pem"])
def test_a_panel_and_each_of_its_kits_is_signed_by_the_key(private: str, public: str, kit: Path, keys: Path) -> None:
    read_signer(keys / private).sign(kit)
    for folder in (kit, kit / "tapes" / "a", kit / "tapes" / "b"):
        assert (folder / "manifest.json.sig").read_bytes() == SHOP.sign((folder / "manifest.json").read_bytes())
        for given in (folder, folder / "manifest.json"):
            found = check(given, keys / public)
            assert (found.name, found.passed, found.warning) == ("signature", True, False)
            assert found.message == f"made by the holder of {FINGERPRINT} ({public})"
    assert not (kit / "other" / "c" / "manifest.json.sig").exists()


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="ssh-keygen is not installed")
def test_the_fingerprint_is_that_of_ssh_keygen(keys: Path) -> None:
    told = subprocess.run(["ssh-keygen", "-l", "-f", keys / "shop.pub"], capture_output=True, text=True, check=True).stdout
    assert told.split()[1] == FINGERPRINT


def test_another_manifest_or_signature_fails(kit: Path, keys: Path) -> None:
    read_signer(keys / "shop.pem").sign(kit)
    signature, manifest = kit / "manifest.json.sig", kit / "manifest.json"
    whole, text = signature.read_bytes(), manifest.read_bytes()
    another = f"it is not that of {FINGERPRINT} (shop.pub) for this manifest: another made it, or it was changed since"
    for changed in (whole[:63], whole + b"x", bytes(64), whole[:-1] + bytes([whole[-1] ^ 1]), b""):
        signature.write_bytes(changed)
        assert check(kit, keys / "shop.pub") == Check(name="signature", passed=False, message=another)
    signature.write_bytes(whole)
    manifest.write_bytes(text + b" ")
    assert check(kit, keys / "shop.pub").message == another
    manifest.write_bytes(text)
    assert check(kit, keys / "shop.pub").passed
    signature.unlink()
    none = f"there is no manifest.json.sig: nothing says who made it; it should be {FINGERPRINT} (shop.pub)"
    assert check(kit, keys / "shop.pub") == Check(name="signature", passed=False, message=none)
    signature.mkdir()
    found = check(kit, keys / "shop.pub")
    assert not found.passed and found.message.startswith("manifest.json.sig cannot be read: ") and "None" not in found.message
    signature.rmdir()
    signature.symlink_to(signature.name)
    assert check(kit, keys / "shop.pub").message == f"manifest.json.sig cannot be read: {os.strerror(errno.ELOOP)}"


def test_a_manifest_that_is_too_large_is_not_read_whole(kit: Path, keys: Path) -> None:
    with (kit / "manifest.json").open("r+b") as stream:
        stream.truncate(MOST_MANIFEST_BYTES + 2)
    read_signer(keys / "shop.pem").sign(kit)
    assert not check(kit, keys / "shop.pub").passed


def test_without_a_key_a_signature_is_mentioned(kit: Path, keys: Path) -> None:
    assert check_signed(kit, None) == []
    said = "manifest.json.sig is there, but whose it is was not checked; use --key with the maker's public key"
    (kit / "manifest.json.sig").symlink_to("nowhere")
    assert check(kit, None) == Check(name="signature", passed=False, warning=True, message=said)
    (kit / "manifest.json.sig").unlink()
    read_signer(keys / "shop.pem").sign(kit)
    assert check(kit, None) == Check(name="signature", passed=False, warning=True, message=said)


@pytest.mark.parametrize("key", ["junk", "curve.pem", "locked.pem", "shop.pub", "shop.pub.pem", "missing", "."])
def test_a_key_that_cannot_sign_is_refused(key: str, keys: Path) -> None:
    with pytest.raises(SpecError) as caught:
        read_signer(keys / key)
    (problem,) = caught.value.problems
    assert problem.key == "sign" and "without a password" in problem.message
    assert problem.message.startswith("sign = ") and "None" not in problem.message
    cannot = {"missing": f"cannot be read: {os.strerror(errno.ENOENT)}; ", ".": "cannot be read: "}.get(
        key, "is no private key that can be used; "
    )
    assert cannot in problem.message


@pytest.mark.parametrize("key", ["junk", "curve.pub", "curve.pub.pem", "shop.pem", "shop.ssh", "missing", "."])
def test_a_key_that_cannot_check_is_refused(key: str, kit: Path, keys: Path) -> None:
    with pytest.raises(SpecError) as caught:
        check_signed(kit, keys / key)
    (problem,) = caught.value.problems
    assert problem.key == "key" and "the .pub file of ssh-keygen" in problem.message
    cannot = {"missing": f"cannot be read: {os.strerror(errno.ENOENT)}; ", ".": "cannot be read: "}.get(
        key, "is no public key that can be used; "
    )
    assert cannot in problem.message


def test_a_key_is_not_shown(keys: Path) -> None:
    assert repr(read_signer(keys / "shop.pem")) == "Signer()"


def test_a_folder_without_a_manifest_is_no_kit(tmp_path: Path, keys: Path) -> None:
    with pytest.raises(SpecError, match="is no kit"):
        check_signed(tmp_path, keys / "shop.pub")
