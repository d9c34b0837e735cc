"""Frames and troubles of a source, and the one-frame buffer between its reader's thread and the locating thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import wraps
from threading import Condition, Event
from time import perf_counter
from typing import Any, Concatenate, ParamSpec

import numpy.typing as npt


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """A frame as its source delivers it: a depth map, or a colour image that is to become one.

    Attributes
    ----------
    number : int
        Counted by the source; frames that are dropped, or cannot be used, count.
    timestamp : float or None
        When it was taken, s; None where nothing says it.
    px_per_mm : (float, float) or None
        Where the frame's file says it.
    keep : bool
        Whether it waits for its turn instead of being dropped for a later one.
    arrived_s : float
        When it was there, whole, by `time.perf_counter`.
    """

    number: int
    image: npt.NDArray[Any]
    timestamp: float | None = None
    px_per_mm: tuple[float, float] | None = None
    keep: bool = False
    arrived_s: float = field(default_factory=perf_counter)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """An unusable frame, or anything else that is no frame: its kind, and the message for the user."""

    kind: str
    message: str


Source = Callable[[Event], Iterator[Frame | Trouble]]
"""Frames in their order until there are no more, or the event is set."""
P = ParamSpec("P")


def as_source(read: Callable[Concatenate[Event, P], Iterator[Frame | Trouble]]) -> Callable[P, Source]:
    """Decorator of a generator whose first argument is the stop event: called with the other arguments it returns a `Source`."""

    @wraps(read)
    def source(*args: P.args, **named: P.kwargs) -> Source:
        return lambda stop: read(stop, *args, **named)

    return source


class Slot:
    """One-frame buffer: a later frame replaces one that was not taken, so that locating never lags by more than one frame.

    Slots that are waited for together share a condition.
    """

    def __init__(self, changed: Condition | None = None) -> None:
        self.dropped = 0
        self._frame: Frame | None = None
        self._changed = changed or Condition()
        self._ended = False
        self._error: BaseException | None = None

    def put(self, frame: Frame, stop: Event) -> None:
        """Put a frame; one with `keep` waits until the one before it is taken, or `stop` is set."""
        with self._changed:
            # a frame that is to be kept neither takes a place nor gives its own up
            while self._frame is not None and (frame.keep or self._frame.keep) and not stop.is_set():
                self._changed.wait(0.1)
            self.dropped += self._frame is not None
            self._frame = frame
            self._changed.notify_all()

    def end(self, error: BaseException | None = None) -> None:
        """Nothing more will come; `take` raises the error once it has given what is here."""
        with self._changed:
            self._ended, self._error = True, error
            self._changed.notify_all()

    def take(self, timeout_s: float) -> Frame | None:
        """The frame, or None when none came in time. Raises EOFError when nothing more will come."""
        with self._changed:
            # a wait of no time would let go of the lock, which `take_next` holds over all slots
            if self._frame is None and not self._ended and timeout_s > 0.0:
                self._changed.wait(timeout_s)
            frame, self._frame = self._frame, None
            if frame is not None:
                self._changed.notify_all()
            elif self._ended:
                raise self._error or EOFError
            return frame


def take_next(slots: Sequence[Slot], changed: Condition, first: int, timeout_s: float) -> tuple[int, Frame] | None:
    """Index and frame of the first slot with a frame, in cyclic order from `first`; None when none came in time.

    Raises EOFError when nothing more will come in any of them; of sources that failed the error of the first instead.
    """
    # the one after the last that was served comes first: a fast sensor does not starve the others
    order = [*range(first, len(slots)), *range(first)]
    with changed:
        # look, wait once, and look again, under one lock: a frame that comes between looking and waiting is not slept through
        for timeout in (timeout_s, None):
            errors: list[BaseException] = []
            for k in order:
                try:
                    frame = slots[k].take(0.0)
                except BaseException as error:
                    errors.append(error)
                    continue
                if frame is not None:
                    return k, frame
            if len(errors) == len(slots):
                raise next((error for error in errors if not isinstance(error, EOFError)), errors[0])
            if timeout is not None:
                changed.wait(timeout)
    return None
