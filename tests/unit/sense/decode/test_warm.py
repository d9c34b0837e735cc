"""The first time ever: every kernel is compiled once, before the first frame, and a word says so."""

from __future__ import annotations

import logging
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from tactape_fab import Localizer
from tactape_fab.base.jit import COMPILED
from tactape_fab.sense import simulate
from tactape_fab.sense.decode import warm
from tactape_fab.sense.decode.result import Refined
from tests.contacts import POSE, tape_of
from tests.thorough import costly, only_thorough

PROGRAM = """
import sys

from dataclasses import replace

import numba.core.event as events
import numpy as np
from numba.core.dispatcher import Dispatcher
from tactape_fab import Localizer
from tactape_fab.sense import simulate
from tests.contacts import tape_of
from tests.unit.sense.decode.test_touch import contacts, touch

class Compiled(events.Listener):
    names = []
    def on_start(self, event):
        self.names.append("{0.__module__}.{0.__qualname__}".format(event.data["dispatcher"].py_func))
    def on_end(self, event):
        pass

def taken():
    # a name for each signature that was compiled or read from the disk
    modules = [module for name, module in sys.modules.items() if name.startswith("tactape_fab.")]
    kernels = {id(each): each for module in modules for each in vars(module).values() if isinstance(each, Dispatcher)}
    return sorted(f"{each.__module__}.{each.__qualname__}" for each in kernels.values() for _ in each.overloads)

depths = [depth for _, depth in contacts(tape_of(7), 3, 3)]
# in a gel that blurs less dots are put between edges
depths.append(simulate(tape_of(7), (40.0, 20.0), 30.0, elastomer_mm=0.06))
heard = Compiled()
events.register("numba:compile", heard)
world, *registries = sys.argv[1:]
for registry in registries:
    tapes = [tape_of(7), touch(1)]
    if registry == "holes":
        tapes.append(replace(tape_of(8), omitted=np.array([[30, 15]])))
    before = len(heard.names)
    localizer = Localizer(tapes, world=world)
    count, found = len(heard.names), taken()
    ours = [name for name in heard.names[before:] if name.startswith("tactape_fab.")]
    twice = sorted({name for name in ours if ours.count(name) > 1})
    assert twice == [], f"compiled for two types of arguments, of which rehearse has to call with those of a frame: {twice}"
    assert count > 20 or world == "closed"
    assert len(found) > 20
    assert any(".search.bounds." in name for name in {*heard.names, *found}) == (world == "open")
    assert any(".search.holes." in name for name in {*ours, *found}) == (registry == "holes")
    fixes = [fix for fix in map(localizer.locate, depths) if fix.located]
    assert fixes and all(len(fix.dots.uv_px) == fix.n_dots for fix in fixes)
    waited = heard.names[count:] + sorted({*taken()} - {*found})
    assert waited == [], f"a frame waits for kernels that rehearse of sense/decode/warm.py has to call: {waited}"
    assert taken() == found
"""


@only_thorough
def test_no_kernel_is_compiled_twice_and_none_by_a_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a closed world of few tapes neither are bounds of many of them, and without tapes with holes nothing for these.

    Tapes with holes that come to an open world compile what they need beyond it. The closed world reads from the disk what it has
    in common with that, which counts as compiled, and compiles what it alone has.
    """
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("NUMBA_OPT", "1")  # what is compiled is the same; by 0 some of it is not kept
    for number, words in enumerate((("open", "none", "holes"), ("closed", "holes"))):
        done = subprocess.run([sys.executable, "-c", PROGRAM, *words], capture_output=True, encoding="utf-8", check=False)
        assert done.returncode == 0, done.stderr
        assert "compiles its decoder, once on this machine; it takes some twenty seconds" in done.stderr or number > 0


def test_nothing_is_said_of_what_is_on_the_disk(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(warm, "compiled", lambda: True)
    with caplog.at_level(logging.DEBUG):
        warm.announce()
    assert caplog.text == ""


def test_where_nothing_can_be_kept_it_is_said(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(warm, "compiled", lambda: False)
    monkeypatch.setattr(warm, "KEPT", False)
    warm.announce()
    assert "NUMBA_CACHE_DIR" in caplog.text and warm.cache_folder() is None


UNPICKLED = """
import pickle, sys
from tests.unit.sense.decode.test_warm import taken_by_kernels
localizer, depth = pickle.load(sys.stdin.buffer)
before = taken_by_kernels()
assert localizer.locate(depth).located and len(before) > 20
after = taken_by_kernels()
assert after == before, f"a frame waits for kernels that rehearse of sense/decode/warm.py has to call: {set(after) - set(before)}"
"""


def taken_by_kernels() -> list[str]:
    """A name for each signature of a kernel that was compiled or read from the disk."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("tactape_fab.")]
    kernels = {id(each): each for module in modules for each in vars(module).values() if hasattr(each, "overloads")}
    return sorted(f"{each.__module__}.{each.__qualname__}" for each in kernels.values() for _ in each.overloads)


@costly
@pytest.mark.skipif(not COMPILED, reason="nothing is compiled")
@pytest.mark.parametrize("refine", ["dots", "pixels"])
def test_no_frame_waits_in_a_process_that_a_localizer_was_sent_to(refine: Refined) -> None:
    sent = pickle.dumps((Localizer([tape_of(7)], refine=refine), simulate(tape_of(7), *POSE)))
    done = subprocess.run([sys.executable, "-c", UNPICKLED], input=sent, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
