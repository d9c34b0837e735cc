"""Keys of a shop in the forms that openssl and ssh-keygen write, those of another, and keys that cannot be used."""

from __future__ import annotations

from pathlib import Path

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

PEM, SSH = serialization.Encoding.PEM, serialization.Encoding.OpenSSH
PKCS8, OWN = serialization.PrivateFormat.PKCS8, serialization.PrivateFormat.OpenSSH
SPKI, LINE = serialization.PublicFormat.SubjectPublicKeyInfo, serialization.PublicFormat.OpenSSH
OPEN = serialization.NoEncryption()
SHOP = Ed25519PrivateKey.from_private_bytes(b"s" * 32)


def write_keys(folder: Path) -> Path:
    for name, key in (("shop", SHOP), ("other", Ed25519PrivateKey.from_private_bytes(b"o" * 32))):
        (folder / f"{name}.pem").write_bytes(key.private_bytes(PEM, PKCS8, OPEN))
        (folder / f"{name}.pub.pem").write_bytes(key.public_key().public_bytes(PEM, SPKI))
        (folder / f"{name}.ssh").write_bytes(key.private_bytes(PEM, OWN, OPEN))
        (folder / f"{name}.pub").write_bytes(key.public_key().public_bytes(SSH, LINE) + b" someone@shop\n")
    (folder / "locked.pem").write_bytes(SHOP.private_bytes(PEM, PKCS8, serialization.BestAvailableEncryption(b"secret")))
    curve = generate_private_key(SECP256R1())
    (folder / "curve.pem").write_bytes(curve.private_bytes(PEM, PKCS8, OPEN))
    (folder / "curve.pub.pem").write_bytes(curve.public_key().public_bytes(PEM, SPKI))
    (folder / "curve.pub").write_bytes(curve.public_key().public_bytes(SSH, LINE))
    (folder / "junk").write_bytes(b"-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n")
    return folder
