"""Signature of a kit: Ed25519 (RFC 8032) over the bytes of its manifest, which has the SHA-256 of every other file.

The signature is 64 bytes in a file beside the manifest, as `openssl pkeyutl -rawin` makes and checks it. It is deterministic, so
that signed kits are reproducible as well.
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactape_fab.base.errors import Check, Problem, SpecError, reason_of
from tactape_fab.base.fields import shown_path
from tactape_fab.base.input_file import read_regular
from tactape_fab.base.libraries import library
from tactape_fab.texture.manifest import MANIFEST_NAME, MOST_MANIFEST_BYTES, SIGNATURE_NAME, find_manifest
from tactape_fab.texture.panel_manifest import KITS_FOLDER

_NAME = "signature"
_SIGNATURE_BYTES, _MOST_KEY_BYTES = 64, 10_000
_OPENSSH = (b"-----BEGIN OPENSSH", b"ssh-ed25519 ")
_PRIVATE = "give an Ed25519 key as `openssl genpkey -algorithm ed25519` or `ssh-keygen -t ed25519` writes it, without a password"
_PUBLIC = "give an Ed25519 key as `openssl pkey -pubout` writes it, or the .pub file of ssh-keygen"


@dataclass(frozen=True, slots=True, kw_only=True)
class Signer:
    """The private key for signing kits, as the bytes of its file."""

    key: bytes = field(repr=False)

    def sign(self, folder: Path) -> None:
        """Write the signatures of a finished kit, or of a panel and of each kit on it, beside their manifests. Raises OSError."""
        key = _private_key(self.key)
        for manifest in (folder / MANIFEST_NAME, *sorted(folder.glob(f"{KITS_FOLDER}/*/{MANIFEST_NAME}"))):
            manifest.with_name(SIGNATURE_NAME).write_bytes(key.sign(manifest.read_bytes()))


def read_signer(path: str | Path) -> Signer:
    """Read a private key.

    Raises SpecError if it is not an Ed25519 key in PEM, by openssl or ssh-keygen, or is protected by a password.
    Raises MissingLibraryError if the extra ``sign`` is not installed.
    """
    signer = Signer(key=_read(path, "sign", _PRIVATE))
    try:
        _private_key(signer.key)
    except (ValueError, TypeError) as error:  # TypeError: the key is protected by a password
        raise SpecError(Problem("sign", f"sign = {shown_path(path)} is no private key that can be used; {_PRIVATE}")) from error
    return signer


def check_signed(kit: str | Path, key: str | Path | None) -> list[Check]:
    """Check the signature of a kit.

    kit: Folder of a kit or panel, or its manifest.json.
    key: File of the expected maker's public key; the check fails without a valid signature by it. If None, an unsigned kit gives
        no line, a signed one a warning.
    Raises SpecError if there is no kit, or the key is not a public Ed25519 key.
    Raises MissingLibraryError if the extra ``sign`` is not installed and a key is given.
    """
    manifest = find_manifest(kit)
    place = manifest.with_name(SIGNATURE_NAME)
    if key is None:
        there = place.exists() or place.is_symlink()
        message = f"{SIGNATURE_NAME} is there, but whose it is was not checked; use --key with the maker's public key"
        return [Check(name=_NAME, passed=False, warning=True, message=message)] if there else []
    public = _public_key(key)
    whose = f"{_fingerprint(public)} ({Path(key).name})"
    try:
        signature, data = read_regular(place, _SIGNATURE_BYTES), read_regular(manifest, MOST_MANIFEST_BYTES)
        public.verify(signature, data)
    except FileNotFoundError:
        message = f"there is no {SIGNATURE_NAME}: nothing says who made it; it should be {whose}"
    except OSError as error:
        message = f"{SIGNATURE_NAME} cannot be read: {reason_of(error)}"
    except library("cryptography.exceptions", "--key").InvalidSignature:
        message = f"it is not that of {whose} for this manifest: another made it, or it was changed since"
    else:
        return [Check(name=_NAME, passed=True, message=f"made by the holder of {whose}")]
    return [Check(name=_NAME, passed=False, message=message)]


def _read(path: str | Path, option: str, remedy: str) -> bytes:
    try:
        return read_regular(Path(path), _MOST_KEY_BYTES)
    except (OSError, ValueError) as error:
        raise SpecError(Problem(option, f"{option} = {shown_path(path)} cannot be read: {reason_of(error)}; {remedy}")) from error


def _private_key(data: bytes) -> Any:
    keys = library("cryptography.hazmat.primitives.serialization", "--sign")
    load = keys.load_ssh_private_key if data.startswith(_OPENSSH) else keys.load_pem_private_key
    return _ed25519(load(data, password=None), "Ed25519PrivateKey")


def _public_key(path: str | Path) -> Any:
    data = _read(path, "key", _PUBLIC)
    keys = library("cryptography.hazmat.primitives.serialization", "--key")
    try:
        load = keys.load_ssh_public_key if data.startswith(_OPENSSH) else keys.load_pem_public_key
        return _ed25519(load(data), "Ed25519PublicKey")
    except (ValueError, TypeError, library("cryptography.exceptions", "--key").UnsupportedAlgorithm) as error:
        raise SpecError(Problem("key", f"key = {shown_path(path)} is no public key that can be used; {_PUBLIC}")) from error


def _ed25519(key: Any, kind: str) -> Any:
    if not isinstance(key, getattr(library("cryptography.hazmat.primitives.asymmetric.ed25519", "--key"), kind)):
        raise ValueError("another kind of key")
    return key


def _fingerprint(public: Any) -> str:
    """Fingerprint of a public key in the form of `ssh-keygen -l` (RFC 4253 section 6.6, RFC 8709)."""
    name, raw = b"ssh-ed25519", public.public_bytes_raw()
    # the key in SSH's encoding: name and 32 bytes, each preceded by its length
    digest = hashlib.sha256(len(name).to_bytes(4, "big") + name + len(raw).to_bytes(4, "big") + raw).digest()
    return "SHA256:" + base64.b64encode(digest).decode("ascii").rstrip("=")
