"""Topics of `watch`, in a log and on a bus, and the messages of an answer as their bytes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tactape_fab.sense.files.jobs import Located
from tactape_fab.sense.live.cdr import IMAGE, POSE, TEXT, MessageType
from tactape_fab.sense.live.messages import image_message, pose_message, stamp_ns, text_message
from tactape_fab.sense.objects.taped_object import TapedObject

POSE_TOPIC, DEPTH_TOPIC, TEXT_TOPIC = "/tactape/pose", "/tactape/depth", "/tactape/fix"
TOPICS: Mapping[str, MessageType] = {POSE_TOPIC: POSE, DEPTH_TOPIC: IMAGE, TEXT_TOPIC: TEXT}


def topic_of(topic: str, sensor: str) -> str:
    """A topic of one of several sensors: `/tactape/NAME/pose`."""
    return topic.replace("/tactape/", f"/tactape/{sensor}/") if sensor else topic


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Naming:
    """Frame ids of poses and depth images, None for the defaults (see `messages`); object in whose frame answers come, too."""

    frame_id: str | None = None
    sensor_frame: str | None = None
    thing: TapedObject | None = None


def encoded(located: Located, naming: Naming, sensor: str = "") -> tuple[int, list[tuple[str, bytes]]] | None:
    """Capture time (ns), and topic and CDR bytes of each message of an answer; no pose where it is not located.

    None where the frame has no capture time that a message can have. One of several sensors has its name in the topics,
    and for its frame.
    """
    stamp = stamp_ns(located.fix.timestamp)
    if stamp is None:
        return None
    pose = pose_message(located.fix, stamp, naming.frame_id)
    image = image_message(located.depth, located.sensor, stamp, sensor or naming.sensor_frame)
    messages = [
        (TEXT_TOPIC, TEXT.encode(text_message(located.frame, located.fix, naming.thing))),
        *([] if pose is None else [(POSE_TOPIC, POSE.encode(pose))]),
        (DEPTH_TOPIC, IMAGE.encode(image)),
    ]
    return stamp, [(topic_of(topic, sensor), data) for topic, data in messages]
