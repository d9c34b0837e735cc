"""watch: locates frames as they arrive."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from threading import Event
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.cli.exits import FAILED, answers
from tactape_fab.cli.options import locating_options, locating_values, named_object, number, pair
from tactape_fab.cli.printing import clear_step, echo_lines_err

if TYPE_CHECKING:
    from tactape_fab.sense.files.jobs import Located
    from tactape_fab.sense.live.counts import Tally
    from tactape_fab.sense.live.watch import Watch
    from tactape_fab.sense.objects.taped_object import TapedObject

_TERMINAL_S, _LOG_S = 0.1, 10.0
"""Time between two status lines, s: on a terminal, where they are overwritten, and in a file."""


@click.command()
@click.argument("source")
@click.argument("more", nargs=-1, metavar="")
@locating_options
@click.option("--rate", metavar="HZ|max", help="Rate of a file of frames.  [default: its timestamps', or 25]")
@click.option("--idle", metavar="S", help="End when a folder has had no new file for so long.  [default: never]")
@click.option("--count", metavar="N", help="End after so many answers.  [default: never]")
@click.option("--no-drop", is_flag=True, help="Let frames wait instead of dropping all but the latest.")
@click.option("--raw", is_flag=True, help="SOURCE has colour images of the gel: a camera, a film, or a folder.")
@click.option("--background", metavar="IMAGE", help="With --raw: the gel while it touches nothing.")
@click.option("--weights", metavar="FILE.pth", help="With --raw: the network that turns the sensor's colours into slopes.")
@click.option("--crop", metavar="U,V,W,H", help="With --raw: part of a camera's image that is scaled to the sensor's frame, px.")
@click.option("--mcap", metavar="FILE.mcap", help="Write poses, depth images and answers as ROS 2 messages.")
@click.option("--zenoh", metavar="local|ENDPOINT", help="Publish them over Zenoh, such as tcp/localhost:7447.")
@click.option("--frame-id", metavar="NAME", help="Frame that poses are given in.  [default: the tape's name]")
@click.option("--sensor-frame", metavar="NAME", help="Frame of the depth images.  [default: the sensor's name]")
@click.option("--rerun", is_flag=True, help="Show it in the Rerun viewer.")
@click.option("--save", metavar="FILE.rrd", help="Write what the Rerun viewer shows.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per frame, as decode does.")
def watch(source: str, more: Sequence[str], kits: Sequence[str], sensor: str, as_json: bool, **given: Any) -> None:
    """Locate frames as they come, and never be late: while one is located, only the latest of those that come is kept.

    SOURCE is a folder that files of frames are written into, a file of frames to replay, - for .npy arrays on standard input, or
    with --raw a camera such as /dev/video0. Ctrl-C ends it.

    \b
    Example: tactape-fab watch frames --tape tactape-s007 --json
    Example: tactape-fab watch frames.npz --rate 100 --tape tactape-s007 --mcap touch.mcap
    """
    tally = None
    with answers():
        from tactape_fab.sense.live.counts import Tally
        from tactape_fab.sense.objects.taped_object import refuse_ambiguous

        thing = named_object(given["object_file"], given)
        own = [] if thing is None else [str(entry.kit) for entry in thing.tapes]
        count, watched = _opened(source, [*own, *kits, *more], sensor, given)
        if thing is not None:
            refuse_ambiguous(thing, watched.job.tapes)
        tally = Tally()
        stop = Event()
        with ExitStack() as stack:
            stack.enter_context(_ended_by_signals(stop))
            outputs = _outputs(stack, watched, thing, given)
            stack.callback(_end, tally)
            if as_json:
                outputs.insert(0, partial(_print, thing))
            _run(watched, tally, stop, outputs, count=count)
    if tally.troubles and not tally.answered:  # something came, but not one frame that could be used
        sys.exit(FAILED)


def _print(thing: TapedObject | None, located: Located) -> bool:
    from tactape_fab.sense.live.messages import text_message

    click.echo(text_message(located.frame, located.fix, thing)["data"])
    return True


def _opened(source: str, kits: Sequence[str], sensor: str, given: Mapping[str, Any]) -> tuple[int | None, Watch]:
    """Number of answers after which to end (None: no end), and the opened source with its job."""
    from tactape_fab.base.errors import SpecError
    from tactape_fab.base.fields import Fields
    from tactape_fab.sense.live.extras import missing_extra
    from tactape_fab.sense.live.opening import Wishes, open_watch

    wishes = Wishes(
        rate=None if given["rate"] is None else number(given["rate"]),
        idle=None if given["idle"] is None else number(given["idle"].removesuffix("s")),
        crop=None if given["crop"] is None else pair(given["crop"]),
        **{name: given[name] for name in ("no_drop", "raw", "background", "weights")},
    )
    table = Fields({} if given["count"] is None else {"count": number(given["count"])})
    count = table.integer("count", low=1, high=10**12) if "count" in table.values else None
    unsent = given["mcap"] is None and given["zenoh"] is None
    if unsent and (given["frame_id"] is not None or given["sensor_frame"] is not None):
        table.problem("mcap", "--frame-id and --sensor-frame are for messages; give --mcap FILE.mcap with them, or --zenoh local")
    problems = [*table.problems, *missing_extra([name for name in ("mcap", "rerun", "save", "zenoh") if given[name]])]
    written = (("mcap", ".mcap", given["mcap"]), ("save", ".rrd", given["save"]))
    try:
        watched = open_watch(source, kits, sensor, wishes, written, **locating_values(given))
    except SpecError as error:
        raise SpecError([*problems, *error.problems]) from None
    if problems:
        raise SpecError(problems)
    return count, watched


def _outputs(
    stack: ExitStack, watched: Watch, thing: TapedObject | None, given: dict[str, Any]
) -> list[Callable[[Located], bool]]:
    """Functions that write or show an answer; each returns False where an answer has no timestamp that it needs."""
    from tactape_fab.sense.live.topics import Naming

    outputs: list[Callable[[Located], bool]] = []
    naming = Naming(frame_id=given["frame_id"], sensor_frame=given["sensor_frame"], thing=thing)
    if given["zenoh"] is not None:
        from tactape_fab.sense.live.zenoh_bus import ZenohBus

        outputs.append(stack.enter_context(ZenohBus(given["zenoh"], naming)).write)
    if given["mcap"] is not None:
        from tactape_fab.sense.live.mcap_log import McapLog

        outputs.append(stack.enter_context(McapLog(Path(given["mcap"]), naming)).write)
    if given["rerun"] or given["save"] is not None:
        from tactape_fab.sense.live.rerun_log import RerunLog

        path = None if given["save"] is None else Path(given["save"])
        outputs.append(stack.enter_context(RerunLog(watched.job.tapes, watched.job.sensor, save=path, show=given["rerun"])).write)
    return outputs


def _run(
    watched: Watch,
    tally: Tally,
    stop: Event,
    outputs: Sequence[Callable[[Located], bool]],
    *,
    count: int | None,
) -> None:
    from tactape_fab.sense.live.sources import Trouble
    from tactape_fab.sense.live.status_lines import status_line
    from tactape_fab.sense.live.watch import watch as watch_frames

    terminal = sys.stderr is not None and sys.stderr.isatty()
    period_s = _TERMINAL_S if terminal else _LOG_S
    due_s = perf_counter() + period_s
    for located in watch_frames(watched, tally, stop):
        if located is not None:
            for write in outputs:
                if not write(located):
                    message = f"frame {located.frame} has no timestamp that a message can have; it is not written"
                    tally.trouble(Trouble(kind="no timestamp", message=message))
            if count is not None and tally.answered + 1 >= count:
                stop.set()
        _warn(tally)
        if perf_counter() >= due_s:
            click.echo(f"\r{_cut(status_line(tally))}\033[K" if terminal else status_line(tally), err=True, nl=not terminal)
            due_s = perf_counter() + period_s


def _cut(line: str) -> str:
    """A line cut to the terminal's width, because only one line can be overwritten."""
    import shutil

    return line[: shutil.get_terminal_size().columns - 1]


def _warn(tally: Tally) -> None:
    messages = tally.unsaid()
    if messages:
        clear_step()
        echo_lines_err(f"warning: {message}" for message in messages)


def _end(tally: Tally) -> None:
    from tactape_fab.sense.live.status_lines import end_lines

    _warn(tally)
    clear_step()
    echo_lines_err(end_lines(tally))


@contextmanager
def _ended_by_signals(stop: Event) -> Iterator[None]:
    """Set an event on Ctrl-C or SIGTERM: the current answer is finished, files are closed. A second signal interrupts."""
    before: dict[signal.Signals, Any] = {}

    def end(which: int, _: object) -> None:
        stop.set()
        signal.signal(which, before[signal.Signals(which)])

    for which in (signal.SIGINT, signal.SIGTERM):
        before[which] = signal.signal(which, end)
    try:
        yield
    finally:
        for which, handler in before.items():
            signal.signal(which, handler)
