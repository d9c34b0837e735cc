"""Answers as JSON: the keys of a localization, and those that an object adds."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tactape_fab.sense.decode.result import Localization
    from tactape_fab.sense.objects.mount import ObjectPose


def fix_json(frame: int, fix: Localization, *, dots: bool = False) -> dict[str, Any]:
    """The keys of an answer, with what each dot says if asked for; NaN becomes null."""
    return {key: _finite(value) for key, value in fix.to_mapping(frame, dots=dots).items()}


def object_json(there: ObjectPose | None) -> dict[str, Any]:
    """The keys that an object adds to an answer."""
    if there is None:
        return {"object": None, "object_mm": None, "object_rotation": None}
    return {"object": there.object, "object_mm": list(there.position_mm), "object_rotation": list(there.rotation)}


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value
