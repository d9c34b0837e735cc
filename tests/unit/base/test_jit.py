"""Kernels as plain Python: without numba, and with its compiler switched off, answers are the same and one warning says so."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tactape_fab
from tactape_fab import Localizer
from tactape_fab.base import jit
from tactape_fab.sense import simulate
from tactape_fab.sense.decode.dots import kth
from tests.contacts import POSE, dots, tape_of
from tests.thorough import costly
from tests.unit.base.test_kept_kernels import ADDED

DECODE = """
import json, sys
if sys.argv[1] == "without":
    sys.modules["numba"] = None
from tests.unit.base.test_jit import answers
print(json.dumps(answers()))
"""
EXACT, OF_PIXELS = 1e-9, 1e-6
"""Compiled, sums over pixels in single precision are added in another order: places differ by some nanometres."""


def answers() -> list[tuple[float, dict[str, Any]]]:
    """Answers to dots and to a depth map, and how near another's must be."""
    localizer = Localizer([tape_of(7)])
    depth = simulate(tape_of(7), *POSE)
    found = [(EXACT, localizer.locate_dots(dots())), (OF_PIXELS, localizer.locate(depth))]
    return [(near, json.loads(json.dumps(fix.to_mapping(0) | {"elapsed_ms": 0.0}))) for near, fix in found]


@costly
@pytest.mark.parametrize("numba", ["without", "switched off"])
def test_plain_functions_give_the_same_answers_and_one_warning(numba: str, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = answers()
    if numba == "switched off":
        monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    done = subprocess.run([sys.executable, "-c", DECODE, numba], capture_output=True, encoding="utf-8", check=True)
    assert done.stderr.count("plain Python") == 1 and done.stderr.count("\n") == 1
    assert all(answer["located"] for _, answer in expected)
    for (near, answer), (_, plain) in zip(expected, json.loads(done.stdout), strict=True):
        for key in ("covariance", "tilt_covariance"):
            ours, theirs = answer.pop(key), plain.pop(key)
            assert theirs == ours or np.allclose(theirs, ours, rtol=1e3 * near, atol=0.0), key
        for key, value in answer.items():
            for ours, theirs in zip(*((v if isinstance(v, list) else [v]) for v in (value, plain[key])), strict=True):
                assert theirs == (pytest.approx(ours, rel=near, abs=near) if isinstance(ours, float) else ours), key


def test_a_folder_that_nothing_can_be_kept_in_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise RuntimeError("cannot cache function '_probe': no locator available")

    assert jit._can_be_kept()
    monkeypatch.setattr(jit, "njit", refuse)
    assert not jit._can_be_kept()


@pytest.mark.skipif(not jit.COMPILED, reason="nothing is compiled")
def test_every_kernel_says_whether_numbers_may_be_reordered() -> None:
    """One that says nothing is compiled as its first caller is: with `fastmath` it runs off an array that holds NaN."""
    for module in pkgutil.walk_packages(tactape_fab.__path__, "tactape_fab."):
        if ".sense.decode" in module.name or ".texture." in module.name or ".sense.raw" in module.name:
            importlib.import_module(module.name)
    kernels = [
        (name, value)
        for name, module in list(sys.modules.items())
        if name.startswith("tactape_fab.")
        for value in vars(module).values()
        if hasattr(value, "targetoptions") and value.targetoptions.get("inline") != "always"
    ]
    assert len(kernels) > 60
    assert [name for name, kernel in kernels if "fastmath" not in kernel.targetoptions] == []
    assert kth.select.targetoptions["fastmath"] is False  # its callers have both


@costly
@pytest.mark.skipif(not jit.KEPT, reason="nothing is compiled, or kept")
@pytest.mark.parametrize(("name", "value"), [("XDG_CACHE_HOME", ""), ("XDG_CACHE_HOME", "cache"), ("NUMBA_CACHE_DIR", "cache")])
def test_no_kernel_is_kept_in_the_current_folder(name: str, value: str, tmp_path: Path) -> None:
    """numba unpickles what is kept, and the current folder may be a stranger's."""
    program, here, home = tmp_path / "program.py", tmp_path / "here", tmp_path / "home"
    import_again = "import os\nfrom numba.core import config\nconfig.reload_config()\n"
    program.write_text(ADDED.replace("@kernel", f"{import_again}@kernel", 1) + f"assert os.environ[{name!r}] == {value!r}\n")
    (tmp_path / "__pycache__").touch()  # as beside the modules of an installation that the user may not write to
    here.mkdir()
    environment = {k: v for k, v in os.environ.items() if k not in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR")}
    environment |= {"PYTHONPATH": os.pathsep.join(sys.path), "HOME": str(home), name: value}
    subprocess.run([sys.executable, str(program)], cwd=here, check=True, env=environment)
    assert not [*here.iterdir()] and [*home.rglob("*")]
