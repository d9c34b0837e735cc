"""watch: locates frames as they arrive."""

from __future__ import annotations

import re
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from threading import Event
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click

from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.cli.exits import FAILED, answers, with_options
from tactape_fab.cli.options import SENSORS, hertz, locating_options, locating_values, named_object, number, pair, seconds
from tactape_fab.cli.printing import clear_step, echo_lines_err

if TYPE_CHECKING:
    from tactape_fab.sense.files.jobs import Located
    from tactape_fab.sense.live.counts import Tally
    from tactape_fab.sense.live.opening import SourceSettings, Wanted
    from tactape_fab.sense.live.watch import Watch
    from tactape_fab.sense.objects.taped_object import TapedObject

_TERMINAL_S, _LOG_S = 0.1, 10.0
"""Time between status lines, s: on a terminal, where they are overwritten, and in a file."""
_NAMED = re.compile(r"([A-Za-z]\w{0,31})=([^:]+):(.+)", re.ASCII)
"""NAME=SENSOR:SOURCE; the name becomes part of a topic, so its characters are those that ROS allows."""
_OF_SENSOR = re.compile(r"([A-Za-z]\w{0,31})=", re.ASCII)

Output = Callable[["Located", str], bool]


@click.command()
@click.argument("source", required=False)
@click.argument("more", nargs=-1, metavar="")
@partial(locating_options, sensor=SENSORS)
@click.option("--rate", multiple=True, metavar="HZ|max", help="Rate of a file of frames.  [default: its timestamps', or 25]")
@click.option("--idle", multiple=True, metavar="S", help="End when a folder has had no new file for so long.  [default: never]")
@click.option("--count", metavar="N", help="End after so many answers.  [default: never]")
@click.option("--no-drop", is_flag=True, help="Let frames wait instead of dropping all but the latest.")
@click.option("--raw", is_flag=True, help="SOURCE has colour images of the gel: a camera, a film, or a folder.")
@click.option("--background", multiple=True, metavar="IMAGE", help="With --raw: the gel while it touches nothing.")
@click.option(
    "--weights",
    multiple=True,
    metavar="FILE.pth",
    help="With --raw: the network that turns the sensor's colours into slopes.",
)
@click.option(
    "--crop",
    multiple=True,
    metavar="U,V,W,H",
    help="With --raw: part of a camera's image that is scaled to the sensor's frame, px.",
)
@click.option("--mcap", metavar="FILE.mcap", help="Write poses, depth images and answers as ROS 2 messages.")
@click.option("--zenoh", metavar="local|ENDPOINT", help="Publish them over Zenoh, such as tcp/localhost:7447.")
@click.option("--frame-id", metavar="NAME", help="Frame that poses are given in.  [default: the tape's name]")
@click.option("--sensor-frame", metavar="NAME", help="Frame of the depth images.  [default: the sensor's name]")
@click.option("--rerun", is_flag=True, help="Show it in the Rerun viewer.")
@click.option("--save", metavar="FILE.rrd", help="Write what the Rerun viewer shows.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per frame, as decode does.")
def watch(
    source: str | None, more: Sequence[str], kits: Sequence[str], sensors: Sequence[str], as_json: bool, **given: Any
) -> None:
    """Locate frames as they come, and never be late: while one is located, only the latest of those that come is kept.

    SOURCE is a folder that files of frames are written into, a file of frames to replay, - for .npy arrays on standard input, or
    with --raw a camera: /dev/video0, or "usb:GelSight Mini" by its name. Ctrl-C ends it.

    Several sensors have --sensor NAME=SENSOR:SOURCE each, and no SOURCE; --rate, --idle, --background, --weights and --crop
    take NAME=VALUE for one of them.

    \b
    Example: tactape-fab watch frames --tape tactape-s007 --json
    Example: tactape-fab watch frames.npz --rate 100 --tape tactape-s007 --mcap touch.mcap
    Example: tactape-fab watch --sensor left=digit:frames-l --sensor right=gelsight-mini:frames-r --tape tactape-s007
    """
    tallies: dict[str, Tally] = {}
    with answers():
        from tactape_fab.sense.live.counts import Tally
        from tactape_fab.sense.objects.taped_object import refuse_ambiguous

        thing = named_object(given["object_file"], given)
        own = [] if thing is None else [str(entry.kit) for entry in thing.tapes]
        wanted, others = _wanted(source, sensors, given)
        count, watches = _opened(wanted, [*own, *kits, *others, *more], given)
        if thing is not None:
            refuse_ambiguous(thing, watches[0].job.tapes)
        tallies.update((one.name, Tally()) for one in wanted)
        stop = Event()
        with ExitStack() as stack:
            stack.enter_context(_ended_by_signals(stop))
            outputs = _outputs(stack, [one.name for one in wanted], watches[0], thing, given)
            stack.callback(_end, tallies)
            if as_json:
                outputs.insert(0, partial(_print, thing))
            _run(watches, tallies, stop, outputs, count=count)
    if any(tally.troubles for tally in tallies.values()) and not any(tally.answered for tally in tallies.values()):
        sys.exit(FAILED)  # frames arrived, but none could be used


def _print(thing: TapedObject | None, located: Located, name: str) -> bool:
    from tactape_fab.sense.live.messages import text_message

    text = text_message(located.frame, located.fix, thing)["data"]
    click.echo(f'{{"sensor": "{name}", {text[1:]}' if name else text)
    return True


def _wanted(source: str | None, sensors: Sequence[str], given: Mapping[str, Any]) -> tuple[list[Wanted], list[str]]:
    """The sensors to watch, and the argument in place of SOURCE if it is a kit."""
    from tactape_fab.base.errors import Problem, SpecError
    from tactape_fab.base.fields import shown
    from tactape_fab.sense.files.jobs import is_kit
    from tactape_fab.sense.live.opening import Wanted
    from tactape_fab.texture.packed import is_packed

    named = [found for text in sensors if (found := _NAMED.fullmatch(text))]
    # a path may contain an equals sign; if another sensor has a name, the text before the sign is a name
    form = r"[^=]*=[^:]+:.+" if named else r"[^=/]*=[^:]+:.+"
    misnamed = [text for text in sensors if not _NAMED.fullmatch(text) and re.fullmatch(form, text)]
    if misnamed:
        remedy = "use a letter, then letters, digits and _, 32 at most, such as left_hand=digit:frames"
        message = f"sensor = {shown(misnamed[0])}: its name becomes part of topics of ROS, which has rules for it; {remedy}"
        raise SpecError(Problem("sensor", message))
    names = [found[1] for found in named]
    _refuse_other_names(names, given)
    if not named:
        if source is None:
            message = (
                "no source is given; give SOURCE, such as a folder, or --sensor NAME=SENSOR:SOURCE for each of several sensors"
            )
            raise SpecError(Problem("source", message))
        return [
            Wanted(sensor=sensors[-1] if sensors else DEFAULT_SENSOR, source=source, settings=_source_settings("", (), given))
        ], []
    plain = [text for text in sensors if not _NAMED.fullmatch(text)]
    if plain:
        message = f"sensor = {shown(plain[0])} has no name and others have; give NAME=SENSOR:SOURCE for each"
        raise SpecError(Problem("sensor", message))
    if source is not None and not (is_kit(source) or is_packed(Path(source))):
        message = f"source = {shown(source)} stands beside --sensor NAME=SENSOR:SOURCE, which has its own; leave it out"
        raise SpecError(Problem("source", message))
    wanted = [
        Wanted(name=found[1], sensor=found[2], source=found[3], settings=_source_settings(found[1], names, given))
        for found in named
    ]
    return wanted, [] if source is None else [source]


def _refuse_other_names(names: Sequence[str], given: Mapping[str, Any]) -> None:
    """Refuse NAME=VALUE of a sensor that there is none of. Raises SpecError."""
    from tactape_fab.base.errors import Problem, refuse
    from tactape_fab.base.fields import shown

    there = f"the sensors are {', '.join(names)}" if names else "none has a name; give the value alone"
    refuse(
        [
            Problem(option, f"{option} = {shown(text)} is for a sensor {found[1]}, which there is not; {there}")
            for option in ("rate", "idle", "crop")
            for text in given[option]
            if (found := _OF_SENSOR.match(text)) and found[1] not in names
        ]
    )


def _source_settings(name: str, names: Sequence[str], given: Mapping[str, Any]) -> SourceSettings:
    """Settings for reading a sensor's source: values given for its name, else those given without a name."""
    from tactape_fab.sense.live.opening import SourceSettings

    def value(option: str, read: Callable[[str], Any] = str) -> Any:
        # a value with another sensor's name is not for this one; the last of several counts
        own = [text.removeprefix(f"{name}=") for text in given[option] if names and text.startswith(f"{name}=")]
        common = [text for text in given[option] if not any(text.startswith(f"{other}=") for other in names)]
        return read((own or common)[-1]) if own or common else None

    background, weights = value("background"), value("weights")
    some_raw = bool(names) and any(given[option] for option in ("background", "weights"))
    return SourceSettings(
        rate=value("rate", hertz),
        idle=value("idle", seconds),
        crop=value("crop", pair),
        no_drop=given["no_drop"],
        # if other sensors have a background or a network, one without either gives depth
        raw=given["raw"] and not (some_raw and background is None and weights is None),
        background=background,
        weights=weights,
    )


def _opened(wanted: Sequence[Wanted], kits: Sequence[str], given: Mapping[str, Any]) -> tuple[int | None, list[Watch]]:
    """Number of answers after which to end (None for no end), and the opened sources with their jobs."""
    from tactape_fab.base.errors import Problem, SpecError, refuse, tried
    from tactape_fab.base.fields import Fields, shown
    from tactape_fab.base.libraries import missing
    from tactape_fab.sense.live.messages import FRAME_BY_NAME
    from tactape_fab.sense.live.opening import open_watches
    from tactape_fab.texture.registry import refuse_equal_names

    table = Fields({} if given["count"] is None else {"count": number(given["count"])})
    count = table.integer("count", low=1, high=10**12) if "count" in table.values else None
    unsent = given["mcap"] is None and given["zenoh"] is None
    if unsent and (given["frame_id"] is not None or given["sensor_frame"] is not None):
        table.problem("mcap", "--frame-id and --sensor-frame are for messages; give --mcap FILE.mcap with them, or --zenoh local")
    for key in ("frame-id", "sensor-frame"):
        name = given[key.replace("-", "_")]
        if name is not None and not (name and name.isprintable()):  # bytes that are not UTF-8 are not printable either
            table.problem(key, f"--{key} = {shown(name)} is no name of a frame; give letters, digits and _, or leave it out")
    if wanted[0].name and given["sensor_frame"] is not None:
        table.problem("sensor-frame", "--sensor-frame is for one sensor; of several, each has its name as frame; leave it out")
    if wanted[0].name and (given["rerun"] or given["save"] is not None):
        table.problem("rerun", "--rerun and --save show one sensor; leave them out, or watch that one by itself")
    problems = table.problems
    for option, module in {"mcap": "mcap", "rerun": "rerun", "save": "rerun", "zenoh": "zenoh"}.items():
        if given[option] and find_spec(module) is None:
            problems.append(Problem(option, missing(module, f"--{option}")))
    written = (("mcap", ".mcap", given["mcap"]), ("save", ".rrd", given["save"]))
    try:
        watches = open_watches(wanted, kits, written, **locating_values(given))
    except SpecError as error:
        raise SpecError([*problems, *error.problems]) from None
    if given["rerun"] or given["save"] is not None or not (unsent or given["frame_id"]):
        tried(lambda: refuse_equal_names(watches[0].job.tapes, FRAME_BY_NAME), problems)
    refuse(problems)
    return count, watches


def _outputs(
    stack: ExitStack, names: Sequence[str], watched: Watch, thing: TapedObject | None, given: dict[str, Any]
) -> list[Output]:
    """Functions that write or show an answer of a sensor; each returns False if the answer lacks a timestamp that it needs."""
    from tactape_fab.sense.live.topics import Naming

    outputs: list[Output] = []
    naming = Naming(frame_id=given["frame_id"], sensor_frame=given["sensor_frame"], thing=thing)
    if given["zenoh"] is not None:
        from tactape_fab.sense.live.zenoh_bus import ZenohBus

        outputs.append(stack.enter_context(ZenohBus(given["zenoh"], naming, names)).write)
    if given["mcap"] is not None:
        from tactape_fab.sense.live.mcap_log import McapLog

        outputs.append(stack.enter_context(McapLog(Path(given["mcap"]), naming, names)).write)
    if given["rerun"] or given["save"] is not None:
        from tactape_fab.sense.live.rerun_log import RerunLog

        path = None if given["save"] is None else Path(given["save"])
        shown = stack.enter_context(RerunLog(watched.job.tapes, watched.job.sensor, save=path, show=given["rerun"]))
        outputs.append(lambda located, _: shown.write(located))
    return outputs


def _run(
    watches: Sequence[Watch], tallies: Mapping[str, Tally], stop: Event, outputs: Sequence[Output], *, count: int | None
) -> None:
    from tactape_fab.sense.live.sources import Trouble
    from tactape_fab.sense.live.watch import watch_all

    terminal = sys.stderr is not None and sys.stderr.isatty()
    period_s = _TERMINAL_S if terminal else _LOG_S
    due_s = perf_counter() + period_s
    names = list(tallies)
    for found in watch_all(watches, list(tallies.values()), stop):
        if found is not None:
            name, located = names[found[0]], found[1]
            for write in outputs:
                if not write(located, name):
                    message = f"frame {located.frame} has no timestamp that a message can have; it is not written"
                    tallies[name].trouble(Trouble(kind="no timestamp", message=message))
            # the tally counts this answer only when the next one is requested
            if count is not None and sum(tally.answered for tally in tallies.values()) + 1 >= count:
                stop.set()
        _warn(tallies)
        if perf_counter() >= due_s:
            line = _status(tallies)
            click.echo(f"\r{_cut(line)}\033[K" if terminal else line, err=True, nl=not terminal)
            due_s = perf_counter() + period_s


def _status(tallies: Mapping[str, Tally]) -> str:
    from tactape_fab.sense.live.status_lines import status_line

    return " | ".join(_of(name, status_line(tally)) for name, tally in tallies.items())


def _of(name: str, line: str) -> str:
    """A line with the name of its sensor, if there are several."""
    return f"{name}: {line}" if name else line


def _cut(line: str) -> str:
    """A line cut to the terminal's width, as only one line can be overwritten."""
    import shutil

    return line[: shutil.get_terminal_size().columns - 1]


def _warn(tallies: Mapping[str, Tally]) -> None:
    messages = [_of(name, message) for name, tally in tallies.items() for message in tally.unreported()]
    if messages:
        clear_step()
        echo_lines_err(f"warning: {with_options(message)}" for message in messages)


def _end(tallies: Mapping[str, Tally]) -> None:
    from tactape_fab.sense.live.status_lines import end_lines

    _warn(tallies)
    clear_step()
    echo_lines_err(_of(name, line) for name, tally in tallies.items() for line in end_lines(tally))


@contextmanager
def _ended_by_signals(stop: Event) -> Iterator[None]:
    """Context manager: Ctrl-C, SIGTERM and SIGHUP set an event, so that the current answer is finished and files are closed.

    A second signal interrupts.
    """
    before: dict[signal.Signals, Any] = {}

    def end(which: int, _: object) -> None:
        stop.set()
        # the previous handler is restored, so that a second signal interrupts
        signal.signal(which, before[signal.Signals(which)])

    # Windows has no SIGHUP; nohup ignores it, which is respected
    hangup = getattr(signal, "SIGHUP", signal.SIGTERM)
    ending = {signal.SIGINT, signal.SIGTERM} | ({hangup} if signal.getsignal(hangup) != signal.SIG_IGN else set())
    for which in sorted(ending):
        before[which] = signal.signal(which, end)
    try:
        yield
    finally:
        for which, handler in before.items():
            signal.signal(which, handler)
