"""profiles confirm: what it writes and what it says can be used as it stands, and it leaves nothing that cannot."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest
from click.testing import Result

from tactape_fab.kit.examine.coupon import examine_coupon
from tests.commands import run_words as run


@pytest.fixture
def coupon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What profiles confirm reads of a coupon, in the current folder."""
    monkeypatch.chdir(tmp_path)
    trials = [trial.to_mapping() for trial in examine_coupon("jlcpcb-fpc").trials]
    Path("my coupon").mkdir()
    content = {"format": "tactape-panel/1", "name": "c", "coupon": {"fab": "jlcpcb-fpc", "trials": trials}}
    Path("my coupon/manifest.json").write_text(json.dumps(content))
    return Path("my coupon")


def confirmed(coupon: Path, place: str) -> Result:
    return run("profiles", "confirm", str(coupon), "--held", "0,1,4-8", "--failed", "2,3", "-o", place)


def test_the_command_that_it_names_takes_the_profile(coupon: Path) -> None:
    made = confirmed(coupon, "my \U0001f600.toml")
    assert made.exit_code == 0, made.output
    words = shlex.split(made.stdout.rpartition("; tactape-fab ")[2])
    order = words[words.index("--order") + 1]
    assert Path(order).exists() and run("profiles", order).exit_code == 0


def test_a_profile_that_is_there_stays_and_no_option_is_named_that_there_is_not(coupon: Path) -> None:
    Path("mine.toml").write_text("mine")
    refused = confirmed(coupon, "mine.toml")
    assert refused.exit_code == 2 and "--overwrite" not in refused.stderr and Path("mine.toml").read_text() == "mine"


def test_a_profile_that_cannot_be_read_is_not_left(coupon: Path) -> None:
    before = "jlcpcb-fpc"
    for n in range(8):  # as long a chain as there may be
        Path(f"f{n}.toml").write_text(f'extends = "{before}"\n')
        before = f"f{n}.toml"
    manifest = coupon / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"fab": "jlcpcb-fpc"', '"fab": "f7.toml"'))
    refused = confirmed(coupon, "mine.toml")
    assert refused.exit_code == 2 and not Path("mine.toml").exists()
