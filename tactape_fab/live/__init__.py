"""On the robot: sources of frames as they come, tracking, answers as messages, logs that replay."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tactape_fab.live.messages import image_message, pose_message, text_message
    from tactape_fab.live.motion import Event, Motion, Slip
    from tactape_fab.live.tracker import Track, Tracker

__all__ = ["Event", "Motion", "Slip", "Track", "Tracker", "image_message", "pose_message", "text_message"]

_HOMES = {
    **dict.fromkeys(("image_message", "pose_message", "text_message"), "messages"),
    **dict.fromkeys(("Event", "Motion", "Slip"), "motion"),
    **dict.fromkeys(("Track", "Tracker"), "tracker"),
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
