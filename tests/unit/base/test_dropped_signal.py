"""Signals that are held while a library is loaded."""

from __future__ import annotations

import signal

import pytest

from tactape_fab.base.dropped_signal import signals_held


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_until_a_library_is_loaded(number: signal.Signals) -> None:
    """manifold3d ended the process with status 134 where Ctrl-C raised an exception in what it calls of Python."""

    def leave(came: int, _: object) -> None:
        raise SystemExit(came)

    before, loaded = signal.signal(number, leave), False
    try:
        with pytest.raises(SystemExit), signals_held():
            signal.raise_signal(number)
            loaded = True
        assert loaded
    finally:
        signal.signal(number, before)
