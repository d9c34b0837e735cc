"""The robot's half: sensors, frames in and answers out, simulated contacts, tracking, live sources.

`Localizer`, `Tracker` and `read_object` are in `tactape_fab` itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactape_fab.base.lazy import lazy_names

if TYPE_CHECKING:
    from tactape_fab.sense.live.messages import image_message as image_message
    from tactape_fab.sense.live.messages import pose_message as pose_message
    from tactape_fab.sense.live.messages import text_message as text_message
    from tactape_fab.sense.raw.reconstruct import Reconstruction as Reconstruction
    from tactape_fab.sense.raw.reconstruct import load_network as load_network
    from tactape_fab.sense.raw.reconstruct import make_reconstruction as make_reconstruction
    from tactape_fab.sense.sensors import SensorProfile as SensorProfile
    from tactape_fab.sense.sensors import load_sensor as load_sensor
    from tactape_fab.sense.simulation.draw import Frame as Frame
    from tactape_fab.sense.simulation.draw import Frames as Frames
    from tactape_fab.sense.simulation.draw import draw_poses as draw_poses
    from tactape_fab.sense.simulation.draw import iterate_frames as iterate_frames
    from tactape_fab.sense.simulation.draw import simulate as simulate
    from tactape_fab.sense.simulation.draw import simulate_frames as simulate_frames
    from tactape_fab.sense.simulation.parts import Parts as Parts
    from tactape_fab.sense.simulation.parts import parts_from_cpl as parts_from_cpl
    from tactape_fab.sense.simulation.scene import Scene as Scene
    from tactape_fab.sense.track.motion import Event as Event
    from tactape_fab.sense.track.motion import Slip as Slip

_MESSAGES, _RAW = "tactape_fab.sense.live.messages", "tactape_fab.sense.raw.reconstruct"
_DRAW = "tactape_fab.sense.simulation.draw"
_HOMES = {
    "Event": "tactape_fab.sense.track.motion",
    "Frame": _DRAW,
    "Frames": _DRAW,
    "Parts": "tactape_fab.sense.simulation.parts",
    "Reconstruction": _RAW,
    "Scene": "tactape_fab.sense.simulation.scene",
    "SensorProfile": "tactape_fab.sense.sensors",
    "Slip": "tactape_fab.sense.track.motion",
    "draw_poses": _DRAW,
    "image_message": _MESSAGES,
    "iterate_frames": _DRAW,
    "load_network": _RAW,
    "load_sensor": "tactape_fab.sense.sensors",
    "make_reconstruction": _RAW,
    "parts_from_cpl": "tactape_fab.sense.simulation.parts",
    "pose_message": _MESSAGES,
    "simulate": _DRAW,
    "simulate_frames": _DRAW,
    "text_message": _MESSAGES,
}
__all__ = [
    "Event",
    "Frame",
    "Frames",
    "Parts",
    "Reconstruction",
    "Scene",
    "SensorProfile",
    "Slip",
    "draw_poses",
    "image_message",
    "iterate_frames",
    "load_network",
    "load_sensor",
    "make_reconstruction",
    "parts_from_cpl",
    "pose_message",
    "simulate",
    "simulate_frames",
    "text_message",
]
__getattr__, __dir__ = lazy_names(__name__, _HOMES)
