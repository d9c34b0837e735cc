"""tactape-fab: make tactile fiducial tapes that a PCB fab can build, and prove them from the written files."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from tactape_fab.kit.spec import TapeSpec as TapeSpec
    from tactape_fab.make import Kit as Kit
    from tactape_fab.make import make_kit as make_kit
    from tactape_fab.objects import TapedObject as TapedObject
    from tactape_fab.objects import read_object as read_object
    from tactape_fab.tag_pose import refine_tag_pose as refine_tag_pose
    from tactape_fab.texture.code import default_origin as default_origin
    from tactape_fab.texture.tag_view import pixels_to_texture as pixels_to_texture
    from tactape_fab.texture.tag_view import tag_side_mm as tag_side_mm
    from tactape_fab.texture.tag_view import tag_to_texture as tag_to_texture
    from tactape_fab.texture.tag_view import texture_to_pixels as texture_to_pixels
    from tactape_fab.texture.tape import Tape as Tape
    from tactape_fab.verify import verify_kit as verify_kit

_HOMES = {
    "Kit": "tactape_fab.make",
    "Tape": "tactape_fab.texture.tape",
    "TapeSpec": "tactape_fab.kit.spec",
    "TapedObject": "tactape_fab.objects",
    "default_origin": "tactape_fab.texture.code",
    "make_kit": "tactape_fab.make",
    "pixels_to_texture": "tactape_fab.texture.tag_view",
    "read_object": "tactape_fab.objects",
    "refine_tag_pose": "tactape_fab.tag_pose",
    "tag_side_mm": "tactape_fab.texture.tag_view",
    "tag_to_texture": "tactape_fab.texture.tag_view",
    "texture_to_pixels": "tactape_fab.texture.tag_view",
    "verify_kit": "tactape_fab.verify",
}

__all__ = [
    "Kit",
    "Tape",
    "TapeSpec",
    "TapedObject",
    "__version__",
    "default_origin",
    "make_kit",
    "pixels_to_texture",
    "read_object",
    "refine_tag_pose",
    "tag_side_mm",
    "tag_to_texture",
    "texture_to_pixels",
    "verify_kit",
]


def __getattr__(name: str) -> Any:
    """Import public names on first use, so that the command line answers at once (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
