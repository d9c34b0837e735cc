"""Signed kits: keys of openssl and of ssh-keygen, what is accepted as whose, and what fails."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from tests.commands import run_words as run
from tests.signing import write_keys
from tests.thorough import as_elsewhere, slow

SMALL = ("make", "--sector", "9", "--size", "20x20", "--part", "block", "--tag", "none")


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_keys(tmp_path_factory.mktemp("keys"))


@pytest.fixture(scope="module")
def signed(keys: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("signed") / "kit"
    said = run(*SMALL, "-o", folder, "--sign", keys / "shop.pem")
    assert said.exit_code == 0, said.output
    return folder


@pytest.fixture
def kit(signed: Path, tmp_path: Path) -> Path:
    shutil.copytree(signed, tmp_path / "kit")
    return tmp_path / "kit"


@pytest.mark.parametrize("public", ["shop.pub", "shop.pub.pem"])
def test_a_kit_of_the_key_is_accepted_and_the_key_named(public: str, signed: Path, keys: Path) -> None:
    said = run("verify", signed, "--quick", "--key", keys / public)
    assert said.exit_code == 0, said.output
    assert "made by the holder of SHA256:" in said.output and public in said.output


@pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="ssh-keygen is not installed")
def test_the_fingerprint_is_that_of_ssh_keygen(signed: Path, keys: Path) -> None:
    shown = subprocess.run(["ssh-keygen", "-l", "-f", keys / "shop.pub"], capture_output=True, text=True, check=True).stdout
    assert shown.split()[1] in run("verify", signed, "--quick", "--key", keys / "shop.pub").output


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_openssl_accepts_the_signature(signed: Path, keys: Path) -> None:
    manifest = str(signed / "manifest.json")
    command = ["openssl", "pkeyutl", "-verify", "-rawin", "-pubin", "-inkey", str(keys / "shop.pub.pem")]
    command += ["-in", manifest, "-sigfile", manifest + ".sig"]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0


def test_both_forms_of_a_key_write_the_same_bytes(signed: Path, keys: Path, tmp_path: Path) -> None:
    assert run(*SMALL, "-o", tmp_path / "kit", "--sign", keys / "shop.ssh").exit_code == 0
    for file in signed.rglob("*"):
        if file.is_file():
            assert (tmp_path / "kit" / file.relative_to(signed)).read_bytes() == file.read_bytes()


def test_a_signature_changes_no_other_file(signed: Path, tmp_path: Path) -> None:
    assert run(*SMALL, "-o", tmp_path / "kit").exit_code == 0
    own = {p.relative_to(tmp_path / "kit"): p.read_bytes() for p in (tmp_path / "kit").rglob("*") if p.is_file()}
    assert own == {
        p.relative_to(signed): p.read_bytes() for p in signed.rglob("*") if p.is_file() and p.name != "manifest.json.sig"
    }


def test_a_signed_kit_can_be_made_again_and_replaced(kit: Path) -> None:
    assert run("verify", kit, "--reproduce").exit_code == 0
    assert run(*SMALL, "-o", kit, "--overwrite").exit_code == 0
    assert not (kit / "manifest.json.sig").exists()


def _of_another(kit: Path) -> None:
    (kit / "manifest.json.sig").write_bytes(
        Ed25519PrivateKey.from_private_bytes(b"o" * 32).sign((kit / "manifest.json").read_bytes())
    )


def _changed(kit: Path) -> None:
    with (kit / "manifest.json").open("ab") as stream:
        stream.write(b" ")


def _folder(kit: Path) -> None:
    (kit / "manifest.json.sig").unlink()
    (kit / "manifest.json.sig").mkdir()


HARM: dict[str, Callable[[Path], object]] = {
    "not signed": lambda kit: (kit / "manifest.json.sig").unlink(),
    "signed by another": _of_another,
    "manifest changed by a space": _changed,
    "signature cut": lambda kit: (kit / "manifest.json.sig").write_bytes(b"x" * 63),
    "signature with more": lambda kit: (kit / "manifest.json.sig").write_bytes((kit / "manifest.json.sig").read_bytes() + b"x"),
    "signature a folder": _folder,
}


@pytest.mark.parametrize("harm", HARM)
@pytest.mark.parametrize("how", [(), ("--quick",), ("--reproduce",)], ids=str)
def test_what_the_key_did_not_sign_fails_before_it_is_read(harm: str, how: tuple[str, ...], kit: Path, keys: Path) -> None:
    HARM[harm](kit)
    said = run("verify", kit, *how, "--key", keys / "shop.pub")
    assert said.exit_code == 4
    assert [line.split()[1] for line in said.stdout.splitlines()] == ["signature"]


def test_a_changed_file_of_a_signed_kit_fails(kit: Path, keys: Path) -> None:
    report = next(kit.glob("report.html"))
    report.write_bytes(report.read_bytes() + b" ")
    assert run("verify", kit, "--quick", "--key", keys / "shop.pub").exit_code == 4


def test_without_a_key_a_signature_is_only_mentioned(signed: Path, kit: Path) -> None:
    said = run("verify", signed, "--quick")
    assert said.exit_code == 0
    assert "whose it is was not checked" in said.output and "unlisted" not in said.output
    (kit / "manifest.json.sig").unlink()
    assert "signature" not in run("verify", kit, "--quick").output


@pytest.mark.parametrize("key", ["junk", "curve.pem", "locked.pem", "shop.pub", "missing", "."])
def test_a_key_that_cannot_sign_is_refused_before_anything_is_made(key: str, keys: Path, tmp_path: Path) -> None:
    said = run(*SMALL, "-o", tmp_path / "kit", "--sign", keys / key)
    assert said.exit_code == 2
    assert said.stderr.startswith("error: --sign = ") and len(said.stderr.splitlines()) == 1
    assert not (tmp_path / "kit").exists()


@pytest.mark.parametrize("key", ["junk", "curve.pub.pem", "shop.pem", "missing", "."])
def test_a_key_that_cannot_check_is_refused(key: str, keys: Path, signed: Path) -> None:
    said = run("verify", signed, "--quick", "--key", keys / key)
    assert said.exit_code == 2
    assert said.stderr.startswith("error: --key = ") and len(said.stderr.splitlines()) == 1


@slow
def test_each_kit_of_a_panel_and_of_a_list_is_signed(keys: Path, tmp_path: Path) -> None:
    with as_elsewhere():  # other processes make some of them
        film = ("make", "--sectors", "7,8", "--size", "40x60", "--no-3d", "--no-verify", "--sign", keys / "shop.pem")
        assert run(*film, "--jobs", "1", "-o", tmp_path / "list").exit_code == 0
        assert run(*film, "--panel", "2x1", "-o", tmp_path / "panel").exit_code == 0
        for kit in (*(tmp_path / "list").iterdir(), tmp_path / "panel", *(tmp_path / "panel" / "tapes").iterdir()):
            said = run("verify", kit, "--reproduce", "--key", keys / "shop.pub")
            assert said.exit_code == 0, said.output
