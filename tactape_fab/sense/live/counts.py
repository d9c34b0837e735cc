"""Counts of frames, answers and problems, and latencies, in a buffer of fixed size."""

from __future__ import annotations

from collections import deque
from time import perf_counter

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.decode.result import Localization
from tactape_fab.sense.live.sources import Trouble

_MOST_MESSAGES = 100
_LEAST_MS, _BINS_A_DECADE, _DECADES = 0.01, 200, 7


class Latencies:
    """Times as counts in bins that are 1.2 % wide: percentiles of any number of them."""

    def __init__(self) -> None:
        self.count = 0
        self._bins: npt.NDArray[np.int64] = np.zeros(_BINS_A_DECADE * _DECADES, dtype=np.int64)

    def add(self, ms: float) -> None:
        """Count a time, ms; those below 0.01 ms and beyond the last bin count in the first and last one."""
        # a bin is a factor of 10^(1/200) wide
        place = int(np.log10(max(ms, _LEAST_MS) / _LEAST_MS) * _BINS_A_DECADE)
        self._bins[min(place, len(self._bins) - 1)] += 1
        self.count += 1

    def percentile_ms(self, percent: float) -> float:
        """Percentile of the times (upper edge of its bin), ms; NaN without any."""
        if self.count == 0:
            return float("nan")
        place = int(np.searchsorted(np.cumsum(self._bins), percent / 100.0 * self.count))
        return float(_LEAST_MS * 10.0 ** ((place + 1) / _BINS_A_DECADE))


class Tally:
    """Counts of one run.

    answered, located, unusable, dropped: Frames with an answer; those of them that are located; those that are not of the sensor;
        those that a later frame replaced.
    latencies: From the arrival of the whole frame to the end of all processing of its answer, ms.
    troubles: Number of troubles of each kind.
    """

    def __init__(self) -> None:
        self.answered = self.located = self.unusable = self.dropped = 0
        self.latencies = Latencies()
        self.troubles: dict[str, int] = {}
        self.last: Localization | None = None
        self._unreported: deque[str] = deque(maxlen=_MOST_MESSAGES)
        self._first_s = self._last_s = 0.0
        self._recent: deque[float] = deque(maxlen=50)

    def answer(self, fix: Localization, arrived_s: float) -> None:
        """Count an answer after all its processing."""
        now_s = perf_counter()
        if self.answered == 0:
            self._first_s = now_s
        self._last_s = now_s
        self._recent.append(now_s)
        self.located += fix.located
        self.last = fix
        self.latencies.add(1000.0 * (now_s - arrived_s))
        self.answered += 1  # last: whoever reads it from another thread finds the rest of this answer

    def trouble(self, trouble: Trouble) -> None:
        """Count a trouble; the first of its kind is kept for `unreported`."""
        count = self.troubles.get(trouble.kind, 0)
        self.troubles[trouble.kind] = count + 1
        if count == 0:
            self._unreported.append(f"{trouble.kind}: {trouble.message}")

    def unreported(self) -> list[str]:
        """Messages that are new since the last call."""
        messages = []
        while self._unreported:
            messages.append(self._unreported.popleft())
        return messages

    @property
    def hz(self) -> float:
        """Rate of the latest answers, Hz; it falls while none comes."""
        gaps = len(self._recent) - 1
        if gaps < 1:
            return 0.0
        span_s = self._recent[-1] - self._recent[0]
        # of the time since the last answer, what is more than a usual gap
        span_s += max(0.0, perf_counter() - self._recent[-1] - span_s / gaps)
        return gaps / span_s if span_s > 0 else 0.0

    @property
    def overall_hz(self) -> float:
        """Answers a second from the first to the last one; 0 where there are fewer than two."""
        span_s = self._last_s - self._first_s
        # n answers have n - 1 gaps between them
        return (self.answered - 1) / span_s if span_s > 0 else 0.0
