"""Answers as JSON: the keys that an object adds to those of a localization."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tactape_fab.sense.objects.mount import ObjectPose


def object_json(there: ObjectPose | None) -> dict[str, Any]:
    """The keys that an object adds to an answer."""
    if there is None:
        return {"object": None, "object_mm": None, "object_rotation": None}
    return {"object": there.object, "object_mm": list(there.position_mm), "object_rotation": list(there.rotation)}
