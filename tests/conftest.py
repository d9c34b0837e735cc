"""What the tests share: kits made once, and outside readers that are a visible skip where they are missing."""

from __future__ import annotations

import fcntl
import gc
import locale
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from tactape_fab import Kit, TapeSpec, make_kit
from tactape_fab.kit.examine.coupon import examine_coupon
from tactape_fab.make.panel import PanelKit, make_panel
from tactape_fab.verify.trip import round_trip
from tests.panels import SIX, TWO, packed_panel, panel_of
from tests.thorough import AT_DESK, PART, THOROUGH, as_elsewhere, part_of, spread, with_less

_COMPILE = """
from dataclasses import replace
import numpy as np
from tests.contacts import TAPE
from tactape_fab import Localizer, TapeSpec
from tactape_fab.kit.examine.tape import examine
Localizer([TAPE])
Localizer([replace(TAPE, omitted=np.array([[3, 4]]))])
for directions in (4, 8):
    spec = TapeSpec(sector=1, code="touch-1", directions=directions, part="block", size_mm=(30.0, 20.0), tag="none")
    Localizer([examine(spec).tape])
"""
"""Kernels of whole tapes, of tapes with holes, and of codes without a plane in four and in eight directions."""

settings.register_profile("any machine", deadline=None, derandomize=True)
settings.load_profile("any machine")  # property tests try the same cases everywhere, as slowly as it may be


_BENCH = Path(__file__).with_name("bench")
_compiling: list[int] = []
"""The process that compiles the decoder for all workers."""
_UNDECODED = (
    *("tests/roundtrip/test_make_many.py", "tests/unit/solids/", "tests/unit/kit/"),
    *("tests/unit/verify/", "tests/unit/report/", "tests/golden/"),
)
"""Tests that need nothing compiled: workers begin with them, those that take longest first, while the decoder is compiled."""


def _turn(item: pytest.Item) -> int:
    """Number of a test's folder or file among those that come first; the last for all others."""
    return next((n for n, place in enumerate(_UNDECODED) if item.nodeid.startswith(place)), len(_UNDECODED))


def pytest_configure(config: pytest.Config) -> None:
    """In the background a shell lets tests, and all that they start, ignore Ctrl-C: some of them press it.

    Before several workers find that the decoder is not compiled, and each compiles it, one process does while they collect, and
    run what decodes nothing. What Python compiles is kept, as they collect in half the time then, also where the environment (a
    container's) says not to.
    """
    config.addinivalue_line("markers", "costly: of which a run at a desk tries one case")
    config.addinivalue_line("markers", "slow: which a run of whole folders at a desk leaves out")
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if getattr(config.option, "tx", None) and not hasattr(config, "workerinput"):
        run = subprocess.Popen([sys.executable, "-c", _COMPILE], cwd=config.rootpath, stderr=subprocess.DEVNULL)
        _compiling.append(run.pid)
        threading.Thread(target=run.wait).start()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int | None:
    """One more than processors for `-n auto`: a third of the time tests wait, for browsers, registries, programs that start.

    PYTEST_XDIST_AUTO_NUM_WORKERS says otherwise.
    """
    if config.option.numprocesses != "auto" or "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    return 1 + (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    node.workerinput["compiling"] = _compiling[0]


@pytest.fixture(autouse=True)
def _same_locale() -> Iterator[None]:
    """Some libraries of readers set the process's locale to C: a later test's text files were then read as ASCII."""
    before = locale.setlocale(locale.LC_CTYPE)
    yield
    locale.setlocale(locale.LC_CTYPE, before)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker waits until the decoder is compiled, before what may decode."""
    pid = getattr(item.config, "workerinput", {}).get("compiling")
    while pid is not None and _turn(item) == len(_UNDECODED) and Path(f"/proc/{pid}").exists():
        time.sleep(0.1)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update-golden", action="store_true", help="write the golden files anew instead of comparing")


def _asked_for(config: pytest.Config) -> bool:
    """Whether files, words or options say which tests are meant: all their cases are tried."""
    options = ("keyword", "update_golden", "benchmark_only")
    return any(map(config.getoption, options)) or any(".py" in word or "bench" in word for word in config.args)


def _all_cases(config: pytest.Config) -> bool:
    """Whether no case is left to a thorough run."""
    return THOROUGH or _asked_for(config)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """At a desk what tests the benchmarks is left out: nothing that is installed rests on it."""
    return True if collection_path == _BENCH and not _all_cases(config) else None


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if not _all_cases(config):
        left_out = f"at most {AT_DESK} cases of each test were tried, and no slow test nor one of tests/bench"
        terminalreporter.write_line(f"{left_out}: all are where a file is named, or TACTAPE_THOROUGH=1 is set")
    elif PART and not _asked_for(config):
        terminalreporter.write_line(f"part {PART} of the cases that a desk leaves out was tried: all are without TACTAPE_PART")


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """What is collected stays: looking for garbage in it takes each worker a second, and finds none."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """At a desk a few cases of each test; what need not wait for the decoder comes first."""
    if not _all_cases(config):
        items[:] = spread(items)
    elif PART and not _asked_for(config):
        items[:] = part_of(items, PART)
    items.sort(key=_turn)


@pytest.fixture(autouse=True)
def _no_build_date(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files carry the fixed date whatever the environment of the test run says."""
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)


@pytest.fixture(autouse=True, scope="module")
def _few_contacts(request: pytest.FixtureRequest) -> Iterator[None]:
    """A verification decodes a few contacts, and pictures are small; in fixtures as well.

    Not where it is the round trip itself that is tested, nor where times are taken.
    """
    with ExitStack() as stack:
        if request.module.__name__.rpartition(".")[2] != "test_round_trip":
            patch = stack.enter_context(pytest.MonkeyPatch.context())
            patch.setattr(round_trip.full_trips, "__kwdefaults__", {"counts": (6, 3)})
            if _BENCH not in request.path.parents:
                stack.enter_context(with_less())
        yield


@pytest.fixture(scope="module")
def kits_as_elsewhere() -> Iterator[None]:
    """For modules that compare kits with those of other processes."""
    with as_elsewhere():
        yield


Once = Callable[[str, Callable[[Path], Any]], Any]


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Once:
    """What `make` makes in a folder of that name, once for all workers."""
    base = tmp_path_factory.getbasetemp()
    root = (base if worker_id == "master" else base.parent) / "once"

    def made(name: str, make: Callable[[Path], Any]) -> Any:
        folder = root / name
        folder.mkdir(parents=True, exist_ok=True)
        with (root / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            kept = root / f"{name}.pickle"
            if not kept.exists():
                with as_elsewhere():  # a module with less may be the first to ask
                    kept.write_bytes(pickle.dumps(make(folder)))
            return pickle.loads(kept.read_bytes())

    return made


def _small_kit(path: Path, models: bool) -> Kit:
    return make_kit(TapeSpec(sector=100, size_mm=(20.0, 20.0), holes_mm=[(16.4, 10.0, 1.0)], models=models), path)


@pytest.fixture(scope="session")
def default_kit(once: Once) -> Kit:
    """The kit of the main job, 100 x 50 mm, sector 7; not to be changed."""
    kit: Kit = once("default", lambda folder: make_kit(TapeSpec(sector=7), folder / "tactape-s007"))
    return kit


@pytest.fixture(scope="session")
def small_kit(once: Once) -> Kit:
    """A kit of 8 x 12 grid points with a strip and a hole; not to be changed."""
    kit: Kit = once("small", lambda folder: _small_kit(folder / "tactape-s100", True))
    return kit


@pytest.fixture(scope="session")
def flat_kit(once: Once) -> Kit:
    """The small kit without 3D models, for what does not look at them; not to be changed."""
    kit: Kit = once("flat", lambda folder: _small_kit(folder / "tactape-s100", False))
    return kit


@pytest.fixture(scope="session")
def panel_2(once: Once) -> PanelKit:
    """A panel of two tapes; not to be changed."""
    panel: PanelKit = once("two", lambda folder: panel_of(TWO, folder / "panel"))
    return panel


@pytest.fixture(scope="session")
def panel_6(once: Once) -> PanelKit:
    """A panel of six tapes; not to be changed."""
    panel: PanelKit = once("six", lambda folder: panel_of(SIX, folder / "panel"))
    return panel


@pytest.fixture(scope="session")
def panel_packed(once: Once) -> PanelKit:
    """A packed panel of five different tapes, some turned; not to be changed."""
    panel: PanelKit = once("packed", packed_panel)
    return panel


@pytest.fixture(params=["panel_2", "panel_6"])
def panel(request: pytest.FixtureRequest) -> PanelKit:
    """A panel of either size; not to be changed."""
    made: PanelKit = request.getfixturevalue(request.param)
    return made


@pytest.fixture(scope="session")
def coupon_panel(once: Once) -> PanelKit:
    """The coupon of jlcpcb-fpc; not to be changed."""
    panel: PanelKit = once("coupon", lambda folder: make_panel(examine_coupon("jlcpcb-fpc"), folder / "panel", force=True))
    return panel


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def copied(tmp_path: Path) -> Callable[[Kit | PanelKit], Path]:
    """Copy a kit to a folder of the test's own, to be changed."""

    def copy(kit: Kit | PanelKit) -> Path:
        return Path(shutil.copytree(kit.path, tmp_path / kit.path.name))

    return copy


def _missing(name: str, remedy: str) -> None:
    if os.environ.get("TACTAPE_REQUIRE_READERS") == "1":
        pytest.fail(f"reader {name} is missing; {remedy}")
    pytest.skip(f"reader {name} is missing; {remedy}")


def _program(name: str, remedy: str, *commands: str) -> str:
    """Path of a reader by the first of its commands that is installed."""
    found = next(filter(None, map(shutil.which, commands)), None)
    if found is None:
        _missing(name, remedy)
    return str(found)


@pytest.fixture(scope="session")
def gerbv() -> str:
    """Path of gerbv."""
    return _program("gerbv", "install Debian's gerbv", "gerbv")


@pytest.fixture(scope="session")
def rsvg_convert() -> str:
    """Path of rsvg-convert, which turns SVG into PNG."""
    return _program("rsvg-convert", "install Debian's librsvg2-bin", "rsvg-convert")


@pytest.fixture(scope="session")
def pdftoppm() -> str:
    """Path of Poppler's pdftoppm, which turns PDF into PNG."""
    return _program("pdftoppm", "install Debian's poppler-utils", "pdftoppm")


@pytest.fixture(scope="session")
def node_module() -> Callable[[str], str]:
    """Path of node once the asked npm package can be loaded by it (NODE_PATH says where it is installed)."""

    def find(package: str) -> str:
        node = _program("node", "install Node.js", "node")
        run = subprocess.run([node, "-e", f"require({package!r})"], capture_output=True, check=False)
        if run.returncode != 0:
            _missing(package, f"npm install {package}, and set NODE_PATH to its node_modules")
        return node

    return find
