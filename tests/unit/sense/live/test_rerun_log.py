"""What `watch --save` writes, read back by Rerun's own reader and judged by its own program."""

from __future__ import annotations

import os
import resource
import shlex
import signal
import socket
import subprocess
import sysconfig
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner, Result

from tactape_fab import Kit, TactapeError
from tactape_fab.cli import main
from tactape_fab.sense import simulate_frames
from tactape_fab.sense.files.jobs import localize, prepare
from tactape_fab.sense.live import rerun_log
from tactape_fab.sense.live.rerun_log import RerunLog

COUNT = 8
OFF = 5
STAMPS = 1_763_800_000.0 + 0.04 * np.arange(COUNT)

Rows = dict[str, list[dict[str, Any]]]


@pytest.fixture(scope="module")
def recording(default_kit: Kit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A slide over the tape that is lifted off once; not to be changed."""
    poses = np.column_stack([np.linspace(20.0, 60.0, COUNT), np.full(COUNT, 20.0), np.linspace(0.0, 40.0, COUNT)])
    depth = simulate_frames(default_kit.tape, COUNT, seed=2, poses=poses).depth.copy()
    depth[OFF] = 0.0
    folder = tmp_path_factory.mktemp("recording")
    np.savez(folder / "slide.npz", depth=depth, timestamp=STAMPS)
    command = f"watch {folder}/slide.npz --rate max --tape {default_kit.path} --save {folder}/slide.rrd"
    result = CliRunner().invoke(main, shlex.split(command))
    assert result.exit_code == 0, result.output
    return folder


def rows(path: Path) -> Rows:
    """Rows of each entity, in the order of their frames: component to value; times as whole numbers."""
    from rerun.chunk import RrdReader  # every worker collects these tests, and loading it takes a second

    found: Rows = defaultdict(list)
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if not name.startswith("rerun.")]
        for row in range(chunk.num_rows):
            values = {}
            for name in names:
                value = batch.column(name)[row]
                values[name] = value.value if name == "capture" else value.as_py()
            found[str(chunk.entity_path)].append(values)
    for entity in found.values():
        entity.sort(key=lambda row: row.get("frame", -1))
    return found


def test_rerun_itself_finds_the_file_sound(recording: Path) -> None:
    program = Path(sysconfig.get_path("scripts")) / "rerun"
    run = subprocess.run(
        [str(program), "rrd", "verify", str(recording / "slide.rrd")], capture_output=True, encoding="utf-8", check=False
    )
    assert run.returncode == 0, run.stderr


def test_everything_that_is_promised_is_in_it(recording: Path, default_kit: Kit) -> None:
    found = rows(recording / "slide.rrd")
    job = prepare([str(recording / "slide.npz")], [str(default_kit.path)], "gelsight-mini")
    fixes = [located.fix for located in localize(job)]
    assert [fix.located for fix in fixes] == [k != OFF for k in range(COUNT)]
    tape = "/tapes/tactape-s007"
    promised = {
        "/sensor/depth",
        "/sensor/dots",
        "/sensor/lattice",
        "/error/ellipse",
        "/chart/log10_p_false",
        "/chart/dots",
        "/chart/agreeing",
    }
    assert promised | {f"{tape}/{name}" for name in ("outline", "parts", "trace", "field", "ellipse")} <= set(found)

    for entity in ("/sensor/depth", "/sensor/dots", "/chart/dots", "/chart/agreeing"):
        assert [row["frame"] for row in found[entity]] == list(range(COUNT)), entity
        assert [row["capture"] for row in found[entity]] == [round(stamp * 1e9) for stamp in STAMPS], entity
    assert [row["Scalars:scalars"] for row in found["/chart/dots"]] == [[float(fix.n_dots)] for fix in fixes]
    assert [row["Scalars:scalars"] for row in found["/chart/agreeing"]] == [[float(fix.n_agree)] for fix in fixes]
    p_false = [row["Scalars:scalars"][0] for row in found["/chart/log10_p_false"]]
    np.testing.assert_allclose(p_false, np.log10([fix.p_false for fix in fixes if fix.p_false is not None]))

    with np.load(recording / "slide.npz") as truth:
        for row, depth in zip(found["/sensor/depth"], truth["depth"], strict=True):
            image = np.frombuffer(bytes(row["DepthImage:buffer"][0]), dtype=np.float32).reshape(240, 320)
            np.testing.assert_array_equal(image, depth)

    places = np.array([fix.position_mm for fix in fixes if fix.position_mm is not None])
    np.testing.assert_allclose(found[f"{tape}/trace"][-1]["LineStrips2D:strips"][0], places, atol=1e-4)
    assert len(found[f"{tape}/parts"][0]["Points2D:positions"]) == default_kit.tape.part_count
    outline = np.array(found[f"{tape}/outline"][0]["LineStrips2D:strips"][0])
    np.testing.assert_allclose(np.ptp(outline, axis=0), default_kit.tape.board.size_mm, atol=1e-4)
    ellipse = np.array(found["/error/ellipse"][0]["LineStrips2D:strips"][0])
    assert fixes[0].covariance is not None
    np.testing.assert_allclose(np.abs(ellipse).max(axis=0), 2000.0 * np.sqrt(np.diag(fixes[0].covariance)[:2]), rtol=0.01)
    on_map = np.array(found[f"{tape}/ellipse"][0]["LineStrips2D:strips"][0])
    np.testing.assert_allclose((on_map - places[0]) * 1000.0, ellipse, atol=0.02)


def test_a_frame_that_is_not_located_takes_the_last_answer_off(recording: Path) -> None:
    found = rows(recording / "slide.rrd")
    for entity, key in (("/sensor/lattice", "strips"), ("/error/ellipse", "strips"), ("/tapes/tactape-s007/field", "strips")):
        by_frame = {row["frame"]: row.get(f"LineStrips2D:{key}") for row in found[entity]}
        assert [k for k in range(COUNT) if not by_frame[k]] == [OFF], entity
    assert len(found["/tapes/tactape-s007/trace"][-1]["LineStrips2D:strips"][0]) == COUNT - 1


def test_dots_lie_on_what_stands_out_and_the_lattice_between_them(recording: Path) -> None:
    """In Rerun's pixels, which begin at the image's corner: the depth under a dot is higher than a pitch / 2 beside it."""
    found = rows(recording / "slide.rrd")
    for k in range(OFF):
        colours, counts = np.unique(found["/sensor/dots"][k]["Points2D:colors"], return_counts=True)
        assert len(colours) <= 2 and counts.max() > 0.8 * counts.sum()
        image = np.frombuffer(bytes(found["/sensor/depth"][k]["DepthImage:buffer"][0]), dtype=np.float32).reshape(240, 320)
        smooth = cv2.GaussianBlur(image, None, 2.0)
        dots = np.array(found["/sensor/dots"][k]["Points2D:positions"])
        inside = dots[(dots > 16).all(axis=1) & (dots < (304, 224)).all(axis=1)]

        def mean(shift: tuple[float, float], at: npt.NDArray[np.float64] = inside, of: Any = smooth) -> float:
            u, v = np.floor(at + shift).astype(int).T
            return float(of[v, u].mean())

        assert mean((0.0, 0.0)) > max(mean(shift) for shift in ((5.0, 0.0), (-5.0, 0.0), (0.0, 5.0), (0.0, -5.0))) + 0.005
        lines = np.array(found["/sensor/lattice"][k]["LineStrips2D:strips"])
        along = np.diff(lines, axis=1)[:, 0]
        normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None]
        apart = np.abs(((inside[:, None, :] - lines[None, :, 0]) * normal).sum(axis=2))
        assert np.percentile(np.sort(apart, axis=1)[:, :2], 90) < 16.0 * 0.25 * 1.2


def test_the_trace_does_not_grow_for_ever(
    recording: Path, default_kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tactape_fab.sense.live.rerun_log.TRACE_POSES", 3)
    job = prepare([str(recording / "slide.npz")], [str(default_kit.path)], "gelsight-mini")
    with RerunLog(job.tapes, job.sensor, save=tmp_path / "a.rrd", show=False) as log:
        for located in localize(job):
            log.write(located)
    traces = [row["LineStrips2D:strips"][0] for row in rows(tmp_path / "a.rrd")["/tapes/tactape-s007/trace"]]
    assert [len(trace) for trace in traces] == [1, 2, 3, 3, 3, 3, 3]


def test_a_file_that_does_not_fit_is_an_error(recording: Path, default_kit: Kit, tmp_path: Path) -> None:
    """Rerun writes on a thread of its own, logs that the disk is full, and goes on."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 19, before[1]))
    try:
        command = f"watch {recording}/slide.npz --rate max --tape {default_kit.path} --save {tmp_path}/a.rrd"
        result = CliRunner().invoke(main, shlex.split(command))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert result.exit_code == 1
    assert f"save {tmp_path}/a.rrd cannot be written" in result.stderr and "; use another place" in result.stderr


def unanswered(**_: object) -> None:
    raise RuntimeError("Flush timed out - not all log messages were sent")


@pytest.mark.parametrize("show", [False, True])
def test_a_file_thread_that_ended_holds_nothing_up(
    show: bool, recording: Path, default_kit: Kit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rerun's own thread may end before it answers: then closing, and Rerun's end with the interpreter, do not return."""
    monkeypatch.setattr(rerun_log, "_PATIENCE_S", 0.05)
    job = prepare([str(recording / "slide.npz")], [str(default_kit.path)], "gelsight-mini")
    log = RerunLog(job.tapes, job.sensor, save=tmp_path / "a.rrd", show=False)
    own, ended = log._recording, Event()
    forgotten: list[Any] = []
    monkeypatch.setattr(log, "_recording", SimpleNamespace(flush=unanswered, disconnect=ended.wait))
    monkeypatch.setattr(log, "_show", show)
    monkeypatch.setattr("atexit.unregister", forgotten.append)
    try:
        with pytest.raises(TactapeError, match=r"a\.rrd cannot be written"):
            log.close()
        assert forgotten == [log._rr.rerun_shutdown]
    finally:
        ended.set()
        own.disconnect()


def test_a_name_of_any_kind_is_one_entity(recording: Path, default_kit: Kit, tmp_path: Path) -> None:
    tape = replace(default_kit.tape, name="tape/7 ü.b")
    job = prepare([str(recording / "slide.npz")], [str(default_kit.path)], "gelsight-mini")
    located = next(iter(localize(job)))
    fix = replace(located.fix, tape=tape.name)
    with RerunLog([tape], job.sensor, save=tmp_path / "a.rrd", show=False) as log:
        assert log.write(replace(located, fix=fix))
        assert log.write(replace(located, fix=replace(fix, timestamp=None)))
        assert log.write(replace(located, fix=replace(fix, timestamp=1_700_000_000_000_000_000)))  # ns, with --rate
    entities = [entity for entity in rows(tmp_path / "a.rrd") if entity.startswith("/tapes/")]
    assert len({entity.rpartition("/")[0] for entity in entities}) == 1
    assert len(entities) == 5


def free_port() -> int:
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        return int(listening.getsockname()[1])


def shown(recording: Path, kit: Kit) -> Result:
    return CliRunner().invoke(main, shlex.split(f"watch {recording}/slide.npz --rate max --tape {kit.path} --rerun"))


def test_what_is_shown_goes_to_the_viewer(recording: Path, default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> None:
    """To one that is there already: the part of Rerun that listens, which needs no display."""
    monkeypatch.setattr(rerun_log, "_PORT", free_port())
    program = Path(sysconfig.get_path("scripts")) / "rerun"
    command = [str(program), "--serve-grpc", "--port", str(rerun_log._PORT)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True) as viewer:
        assert viewer.stderr is not None
        try:
            while b"Listening" not in viewer.stderr.readline():
                assert viewer.poll() is None
            result = shown(recording, default_kit)
        finally:
            os.killpg(viewer.pid, signal.SIGKILL)
    assert result.exit_code == 0
    assert f"located {COUNT - 1} of {COUNT} frames" in result.stderr


def test_a_viewer_that_does_not_start_is_a_word(recording: Path, default_kit: Kit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rerun_log, "_PORT", free_port())
    monkeypatch.setattr(rerun_log, "_PATIENCE_S", 0.2)
    monkeypatch.setattr("rerun.spawn", lambda **_: None)
    result = shown(recording, default_kit)
    assert result.exit_code == 1
    (error,) = result.stderr.splitlines()
    assert error.startswith("error: Rerun cannot be started: its viewer, which needs a display,")
