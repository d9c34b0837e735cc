"""Answers in the Rerun viewer, or in a file for it: what the sensor sees, and where on the tape that is."""

from __future__ import annotations

import atexit
import shutil
import socket
import sysconfig
from collections import deque
from collections.abc import Sequence
from math import log10
from pathlib import Path
from threading import Thread
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

import numpy as np

from tactape_fab.base.errors import TactapeError, reason_of
from tactape_fab.base.fields import shown_path
from tactape_fab.sense.files.jobs import Located
from tactape_fab.sense.overlay import View, box_mm, ellipse_mm, grid_lines_mm, placed_mm
from tactape_fab.sense.sensors import SensorProfile
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import Tape

if TYPE_CHECKING:
    import rerun as rr

BOX_UM = 10.0
"""Half the side of the box round the error."""
TRACE_POSES = 500
"""Poses of the trace on a tape."""
MOST_MAPS = 4
"""Tapes that have a map of their own on the screen at the start."""

_PORT = 9876
_PATIENCE_S, _STEADY_S = 8.0, 1.0
_LEAST_P = 1e-30
_LAST_S = 2.0**33
"""Rerun's times are whole nanoseconds in 64 bits; timestamps in nanoseconds are beyond that."""
_CORNER = 0.5
"""Rerun counts pixels from the image's corner, everything else here from the middle of the first one."""
_AGREEING, _OTHER, _PLAIN = (90, 190, 240), (245, 110, 50), (235, 235, 235)
_GRID, _FIELD, _OUTLINE, _TRACE = (60, 95, 120), (110, 110, 110), (200, 200, 200), (90, 190, 240)
_AT_A_FIX = ("sensor/lattice", "error/ellipse")


class RerunLog:
    """A recording that grows as answers come; what is in its file can be read however the process ends.

    Entities: ``sensor/depth`` (mm, canonical image), ``sensor/dots``, ``sensor/lattice`` (px); under ``tapes/NAME``, in its
    texture frame (mm), ``outline`` and ``parts`` of each tape and, of the one that is touched, ``trace``, ``field`` and
    ``ellipse``; ``error/ellipse`` (two standard deviations, micrometres) and ``error/box``; ``chart/log10_p_false``,
    ``chart/dots`` and ``chart/agreeing``. Timelines: ``frame`` and, where frames have a timestamp, ``capture``.

    tapes: Those that can be touched.
    sensor: Whose image is framed at the start.
    save: File to write, which must not be there.
    show: Open the viewer.
    Raises TactapeError when the file cannot be written, or the viewer not be started.
    """

    def __init__(self, tapes: Sequence[Tape], sensor: SensorProfile, *, save: Path | None, show: bool) -> None:
        import rerun as rr

        self._rr, self._save, self._show = rr, save, show
        self._recording = rr.RecordingStream("tactape-fab", make_default=False, make_thread_default=False)
        if hasattr(self._recording, "set_log_time_enabled"):  # when a frame was taken counts; lerobot's Rerun writes both
            self._recording.set_log_time_enabled(False)
        sinks: list[Any] = []
        try:
            if save is not None:
                sinks.append(rr.FileSink(save))
            if show:
                ours = shutil.which("rerun", path=sysconfig.get_path("scripts"))  # None leaves the search to Rerun
                rr.spawn(port=_PORT, connect=False, executable_path=ours, recording=self._recording)
                _wait_for_viewer()
                sinks.append(rr.GrpcSink(f"rerun+http://127.0.0.1:{_PORT}/proxy"))
            self._recording.set_sinks(*sinks, default_blueprint=_blueprint(tapes, sensor))
        except (OSError, RuntimeError) as error:
            what = f"save {shown_path(save)} cannot be written" if save is not None and not show else "Rerun cannot be started"
            raise TactapeError(f"{what}: {reason_of(error)}") from error
        self._names = {tape.name: f"tapes/{rr.escape_entity_path_part(tape.name)}" for tape in tapes}
        self._tapes = {tape.name: tape for tape in tapes}
        self._parts = {tape.name: placed_mm(tape) for tape in tapes}
        self._traces: dict[str, deque[tuple[float, float]]] = {t.name: deque(maxlen=TRACE_POSES) for t in tapes}
        self._touched: str | None = None
        for tape in tapes:
            self._draw_tape(tape)
        box = BOX_UM * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
        self._log("error/box", rr.LineStrips2D([box], colors=_OUTLINE, labels=[f"±{BOX_UM:g} µm"]), static=True)

    def __enter__(self) -> RerunLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Flush and close the file; a viewer that was closed before is no error.

        Raises TactapeError when the file could not be written: Rerun's own thread wrote it, and says so only here.
        """
        try:
            self._recording.flush(timeout_sec=_PATIENCE_S)
        except RuntimeError as error:
            # a viewer that was closed is told as such; a file that cannot be written may be told by nothing but the time
            if self._save is not None and not (self._show and "gRPC" in str(error)):
                message = f"save {shown_path(self._save)} cannot be written: {reason_of(error)}; use another place"
                raise TactapeError(message) from error
        finally:
            self._disconnect()

    def _disconnect(self) -> None:
        """Close what Rerun has open, if it can.

        Its thread that writes a file ends where that fails, and now and then leaves behind, unanswered, what asked it to flush
        (0.41: two of three times where a burst of frames did not fit): closing, and what Rerun does at the interpreter's end,
        would then wait for ever.
        """
        closing = Thread(target=self._recording.disconnect, daemon=True)
        closing.start()
        closing.join(_PATIENCE_S)
        if closing.is_alive():
            atexit.unregister(self._rr.rerun_shutdown)

    def write(self, located: Located) -> bool:
        """Show a frame and its answer."""
        rr, fix, sensor = self._rr, located.fix, located.sensor
        self._recording.set_time("frame", sequence=located.frame)
        if fix.timestamp is None or not abs(fix.timestamp) < _LAST_S:
            self._recording.disable_timeline("capture")
        else:
            self._recording.set_time("capture", timestamp=np.datetime64(round(fix.timestamp * 1e9), "ns"))
        image = np.ascontiguousarray(sensor.canonical(np.asarray(located.depth).astype(np.float32)))
        self._log(
            "sensor/depth", rr.DepthImage(image * np.float32(sensor.depth_unit_mm or 1.0), meter=1000.0, colormap="viridis")
        )
        tape = self._tapes.get(fix.tape or "")
        if tape is not None and fix.position_mm is not None and fix.theta_deg is not None:
            self._draw_fix(located, tape, image)
        else:
            self._clear_answer()
            dots = _dots(located)
            self._log("sensor/dots", rr.Points2D(dots + _CORNER, colors=_PLAIN, radii=rr.Radius.ui_points(4.0)))
        if fix.p_false is not None:
            self._log("chart/log10_p_false", rr.Scalars(log10(max(fix.p_false, _LEAST_P))))
        self._log("chart/dots", rr.Scalars(fix.n_dots))
        self._log("chart/agreeing", rr.Scalars(fix.n_agree))
        return True

    def _log(self, path: str, what: Any, *, static: bool = False) -> None:
        self._recording.log(path, what, static=static)

    def _draw_tape(self, tape: Tape) -> None:
        rr, path, parts = self._rr, self._names[tape.name], self._parts[tape.name]
        self._log(f"{path}/parts", rr.Points2D(parts, colors=_FIELD, radii=0.15), static=True)
        low, size_mm = box_mm(tape)
        outline = low + size_mm * np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)])
        self._log(f"{path}/outline", rr.LineStrips2D([outline], colors=_OUTLINE), static=True)

    def _draw_fix(self, located: Located, tape: Tape, image: np.ndarray[Any, np.dtype[np.float32]]) -> None:
        rr, fix = self._rr, located.fix
        assert fix.position_mm is not None
        view, path = View(located.sensor, fix, 1), self._names[tape.name]
        if self._touched not in (None, tape.name):
            self._clear_answer()
        self._touched = tape.name
        dots = _dots(located)
        parts = view.to_px(self._parts[tape.name])
        seen = parts[np.abs(parts - located.sensor.centre_px).max(axis=1) < max(image.shape)]
        apart = np.hypot(*(dots[:, None, :] - seen[None, :, :]).transpose(2, 0, 1)).min(axis=1, initial=np.inf)
        # nearer to a part than to the next symbol's place, which is W sqrt(2) / 6 away at the usual displacement
        agrees = apart < view.px_per_mm[0] * tape.pitch_mm / 10
        colours = np.where(agrees[:, None], _AGREEING, _OTHER).astype(np.uint8)
        self._log("sensor/dots", rr.Points2D(dots + _CORNER, colors=colours, radii=rr.Radius.ui_points(4.0)))
        self._log("sensor/lattice", rr.LineStrips2D(view.to_px(grid_lines_mm(tape, view)) + _CORNER, colors=_GRID))
        self._traces[tape.name].append(fix.position_mm)
        self._log(f"{path}/trace", rr.LineStrips2D([list(self._traces[tape.name])], colors=_TRACE))
        self._log(f"{path}/field", rr.LineStrips2D([view.corners_mm[[0, 1, 3, 2, 0]]], colors=_OTHER))
        if fix.covariance is not None:
            ellipse = ellipse_mm(fix.covariance)
            self._log(f"{path}/ellipse", rr.LineStrips2D([ellipse + fix.position_mm], colors=_OTHER))
            self._log("error/ellipse", rr.LineStrips2D([ellipse * 1000.0], colors=_AGREEING))

    def _clear_answer(self) -> None:
        """Take the last answer off the screen: this frame has none. The trace stays."""
        paths = [] if self._touched is None else [f"{self._names[self._touched]}/{name}" for name in ("field", "ellipse")]
        for path in (*_AT_A_FIX, *paths):
            self._log(path, self._rr.Clear(recursive=False))
        self._touched = None


def _wait_for_viewer() -> None:
    """Return once the viewer has been listening for a while: one without a display does so for a moment, too.

    Raises OSError when it does not: what is sent to it would pile up.
    """
    end_s, since_s = monotonic() + _PATIENCE_S, float("inf")
    while monotonic() - since_s < _STEADY_S:
        try:
            socket.create_connection(("127.0.0.1", _PORT), timeout=1.0).close()
            since_s = min(since_s, monotonic())
        except OSError:
            since_s = float("inf")
        if monotonic() > end_s:
            raise OSError("its viewer, which needs a display, does not answer; use --save and look at the file later")
        sleep(0.1)


def _dots(located: Located) -> FloatArray:
    from tactape_fab.sense.decode.dots.frame_dots import frame_dots
    from tactape_fab.sense.decode.dots.inputs import canonical_frame

    return frame_dots(canonical_frame(located.depth, located.sensor), located.sensor).xy_px


def _blueprint(tapes: Sequence[Tape], sensor: SensorProfile) -> rr.blueprint.Blueprint:
    """Sensor and error on the left, maps and charts on the right."""
    import rerun as rr
    import rerun.blueprint as rrb

    maps = [
        rrb.Spatial2DView(origin=f"tapes/{rr.escape_entity_path_part(tape.name)}", name=f"{tape.name}, mm")
        for tape in tapes[:MOST_MAPS]
    ]
    image = rrb.VisualBounds2D(x_range=[0.0, sensor.width_px], y_range=[0.0, sensor.height_px])
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(origin="sensor", name="depth, dots, lattice", visual_bounds=image),
                rrb.Spatial2DView(origin="error", name="two standard deviations, µm"),
                row_shares=[3, 2],
            ),
            rrb.Vertical(
                *maps,
                rrb.TimeSeriesView(origin="chart", contents="$origin/log10_p_false", name="log10 of p_false"),
                rrb.TimeSeriesView(origin="chart", contents=["$origin/dots", "$origin/agreeing"], name="dots"),
            ),
        ),
        collapse_panels=True,
    )
