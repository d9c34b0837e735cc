"""A sensor that is watched on a thread, for loops that ask for the latest answer when they need one."""

from __future__ import annotations

import atexit
from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import cos, isnan, radians, sin
from numbers import Integral, Real
from os import PathLike
from threading import TIMEOUT_MAX, Condition, Event, Thread
from time import perf_counter
from typing import TYPE_CHECKING, Literal

from tactape_fab.base.errors import Problem, SpecError, TactapeError
from tactape_fab.base.given_path import as_path
from tactape_fab.base.given_value import refuse_other
from tactape_fab.base.templates import DEFAULT_SENSOR
from tactape_fab.sense.decode.result import refuse_no_answer
from tactape_fab.sense.files.jobs import Job, Locate, make_locator
from tactape_fab.sense.live.counts import Tally
from tactape_fab.sense.live.opening import SourceSettings, Wanted, open_watches
from tactape_fab.sense.live.watch import watch
from tactape_fab.texture.registry import refuse_equal_names
from tactape_fab.texture.tape import refuse_no_tapes

if TYPE_CHECKING:
    from tactape_fab.sense.decode.result import Localization
    from tactape_fab.sense.files.jobs import Located
    from tactape_fab.sense.sensors import SensorProfile
    from tactape_fab.texture.tape import Tape


class LiveSensor:
    """A source of frames, located as they come; the latest answer is kept.

    Parameters
    ----------
    source : str
        As `tactape-fab watch` takes it: a folder that files are written into, a file of frames, or a camera.
    kits : sequence of str
        Kits that can be touched.
    sensor : str
        Profile name or the path of its TOML file.
    rate : float or "max", optional
        Of a file of frames, Hz; "max" locates every one of them as fast as it can.
    raw : bool
        The source has colour images; with `background` and `weights`.
    background, weights : str, optional
        See `tactape-fab watch --raw`.
    crop : sequence of int, optional
        Part of a camera's image, (u, v, width, height), px.
    world : {"open", "closed"}
    max_p_false : float
        As for `Localizer`.

    Raises
    ------
    SpecError
        For everything that cannot be opened, all together.
    """

    def __init__(
        self,
        source: str,
        kits: Sequence[str],
        sensor: str = DEFAULT_SENSOR,
        *,
        rate: float | Literal["max"] | None = None,
        raw: bool = False,
        background: str | None = None,
        weights: str | None = None,
        crop: Sequence[int] | None = None,
        world: str = "open",
        max_p_false: float = 1e-4,
    ) -> None:
        for key, path in (("background", background), ("weights", weights)):
            if path is not None:
                as_path(path, key, "the path of a file")
        settings = SourceSettings(rate=rate, raw=raw, background=background, weights=weights, crop=crop)
        source = str(as_path(source, "source", "a folder, a file of frames, a camera or - for standard input"))
        given = [kits] if isinstance(kits, str | PathLike) or not isinstance(kits, Iterable) else kits
        refuse_other(raw, bool, "raw", "bool", "True or False")
        sensor = str(as_path(sensor, "sensor", "the name of a profile or a .toml file"))
        paths = [str(as_path(kit, "kits", "the paths of kits")) for kit in given]
        wanted = Wanted(sensor=sensor, source=source, settings=settings)
        (watched,) = open_watches([wanted], paths, (), world=world, max_p_false=max_p_false)
        self._watched = replace(watched, locator=self._prepare)
        self._latest: Located | None = None
        self._came_s, self._troubles, self._prepared = 0.0, list[str](), False
        self._changed, self._stop, self._tally = Condition(), Event(), Tally()
        self._ended: BaseException | None = None
        self._thread = Thread(target=self._run, daemon=True, name="watch")
        self._thread.start()
        atexit.register(self.close)  # a thread that is inside OpenCV when the process ends aborts it
        with self._changed:
            # the decoder is prepared in a second, or compiled in twenty: that is no part of the time in which a frame is to come
            self._changed.wait_for(lambda: self._prepared or self._ended is not None)

    @property
    def tapes(self) -> Sequence[Tape]:
        """The tapes that can be touched."""
        return self._watched.job.tapes

    @property
    def sensor(self) -> SensorProfile:
        """The sensor's profile."""
        return self._watched.job.sensor

    @property
    def running(self) -> bool:
        """Whether answers may still come."""
        return self._ended is None

    def read(self, *, after: int = -1, timeout_s: float = 1.0, max_age_s: float | None = None) -> Located:
        """The latest answer, which has ``frame``, ``depth`` and ``fix``.

        Parameters
        ----------
        after : int
            Wait for an answer whose frame is later than this; -1 for any.
        timeout_s : float
            ``math.inf`` waits for ever.
        max_age_s : float, optional
            Wait for an answer that came no longer ago than this. By default the latest stays, also of a source that has ended or
            failed.

        Returns
        -------
        Located

        Raises
        ------
        TimeoutError
            When none came in time.
        TactapeError
            When the source failed, or has ended and there is no such answer.
        SpecError
            If `after` is no whole number, or `timeout_s` or `max_age_s` no number.
        """
        refuse_other(after, Integral, "after", "index of a frame", "that of the answer before, or -1 for any")
        for key, value in (("timeout_s", timeout_s), ("max_age_s", 0.0 if max_age_s is None else max_age_s)):
            refuse_other(value, Real, key, "number of seconds", "one, or leave it out")
            if isnan(value):  # a wait of this length never ends
                raise SpecError(Problem(key, f"{key} = nan is no number of seconds; give one, or leave it out"))
        wanted = f"no frame after {after}" + ("" if max_age_s is None else f" in the last {max_age_s:g} s")
        wait_s = min(float(timeout_s), TIMEOUT_MAX)
        with self._changed:
            self._changed.wait_for(lambda: self._ended is not None or self._is_wanted(after, max_age_s), wait_s)
            if self._latest is not None and self._is_wanted(after, max_age_s):
                return self._latest
            if isinstance(self._ended, TactapeError):
                raise self._ended
            self._troubles += self._tally.unreported()  # the first of each kind
            why = "".join(f"; {message}" for message in self._troubles)
            if self._ended is not None:
                raise TactapeError(f"the source has ended, and gave {wanted}{why}") from self._ended
        raise TimeoutError(f"{wanted} was located within {timeout_s:g} s{why}")

    def close(self) -> None:
        """End it; the answer in hand is finished."""
        self._stop.set()
        self._thread.join()
        atexit.unregister(self.close)

    def __enter__(self) -> LiveSensor:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _is_wanted(self, after: int, max_age_s: float | None) -> bool:
        if self._latest is None or self._latest.frame <= after:
            return False
        return max_age_s is None or perf_counter() - self._came_s <= max_age_s

    def _prepare(self, job: Job, sensor: SensorProfile) -> Locate:
        locate = make_locator(job, sensor)
        with self._changed:
            self._prepared = True
            self._changed.notify_all()
        return locate

    def _run(self) -> None:
        ended: BaseException = EOFError()
        try:
            for located in watch(self._watched, self._tally, self._stop):
                if located is not None:
                    with self._changed:
                        self._latest, self._came_s = located, perf_counter()
                        self._changed.notify_all()
        except Exception as error:
            ended = error
        with self._changed:
            self._ended = ended
            self._changed.notify_all()


def observation_names(tapes: Sequence[Tape]) -> list[str]:
    """Names of the numbers of `observation`.

    Parameters
    ----------
    tapes : sequence of Tape
        The registered tapes, in an order that stays.

    Returns
    -------
    list of str

    Raises
    ------
    SpecError
        If an argument is of another type, or two tapes have one name.
    """
    refuse_no_tapes(tapes, "tapes")
    refuse_equal_names(tapes, "an observation")
    return [f"on_{tape.name}" for tape in tapes] + list(_OF_FIX)


_OF_FIX = ("located", "x_mm", "y_mm", "theta_sin", "theta_cos", "x_var_mm2", "y_var_mm2", "theta_var_rad2", "p_false")


def observation(fix: Localization, tapes: Sequence[Tape]) -> dict[str, float]:
    """An answer as numbers that a policy takes: no None, no NaN, and no jump at 180 degrees.

    Parameters
    ----------
    fix : Localization
    tapes : sequence of Tape
        The registered tapes, as for `observation_names`.

    Returns
    -------
    dict of str to float
        One of the tapes is 1 where it is located on it; place (texture frame), sine and cosine of theta, the covariance's
        diagonal, p_false. Not located: all of them 0, but for p_false, which is then 1.

    Raises
    ------
    SpecError
        If an argument is of another type, two tapes have one name, or it is located on none of them.
    """
    refuse_no_answer(fix)
    values = dict.fromkeys(observation_names(tapes), 0.0) | {"p_false": 1.0}
    if not fix.located or fix.tape is None or fix.position_mm is None or fix.theta_deg is None:
        return values
    if f"on_{fix.tape}" not in values:
        message = f"tapes has no {fix.tape}, on which the answer is; give all that are registered, such as LiveSensor.tapes"
        raise SpecError(Problem("tapes", message))
    theta, variance = radians(fix.theta_deg), (0.0, 0.0, 0.0) if fix.covariance is None else fix.covariance.diagonal().tolist()
    seen = (1.0, *fix.position_mm, sin(theta), cos(theta), *variance, 1.0 if fix.p_false is None else fix.p_false)
    return values | {f"on_{fix.tape}": 1.0} | dict(zip(_OF_FIX, map(float, seen), strict=True))
