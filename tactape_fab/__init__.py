"""tactape-fab: make tactile fiducial tapes that a PCB fab can build, prove them from the written files, locate contacts on them.

What specialists use is in `tactape_fab.sense` (sensors, simulation, live sources) and `tactape_fab.solids` (CAD); anything deeper
is private.
"""

from __future__ import annotations

from pathlib import Path as _Path
from typing import TYPE_CHECKING

from tactape_fab.base.lazy import lazy_names

__version__ = "0.1.0"

if TYPE_CHECKING:
    from tactape_fab.kit.spec.tape_spec import TapeSpec as TapeSpec
    from tactape_fab.make.kit import Kit as Kit
    from tactape_fab.make.kit import make_kit as make_kit
    from tactape_fab.sense.decode.localizer import Localizer as Localizer
    from tactape_fab.sense.decode.result import Localization as Localization
    from tactape_fab.sense.decode.search.search import Prior as Prior
    from tactape_fab.sense.objects.tag_pose import refine_tag_pose as refine_tag_pose
    from tactape_fab.sense.objects.tag_view import pixels_to_texture as pixels_to_texture
    from tactape_fab.sense.objects.tag_view import tag_side_mm as tag_side_mm
    from tactape_fab.sense.objects.tag_view import tag_to_texture as tag_to_texture
    from tactape_fab.sense.objects.tag_view import texture_to_pixels as texture_to_pixels
    from tactape_fab.sense.objects.taped_object import TapedObject as TapedObject
    from tactape_fab.sense.objects.taped_object import read_object as read_object
    from tactape_fab.sense.track.motion import Motion as Motion
    from tactape_fab.sense.track.tracker import Track as Track
    from tactape_fab.sense.track.tracker import Tracker as Tracker
    from tactape_fab.texture.code import default_origin as default_origin
    from tactape_fab.texture.tape import Tape as Tape
    from tactape_fab.verify import Verification as Verification
    from tactape_fab.verify import verify_kit as verify_kit

_TAG_VIEW = "tactape_fab.sense.objects.tag_view"
_HOMES = {
    "Kit": "tactape_fab.make.kit",
    "Localization": "tactape_fab.sense.decode.result",
    "Localizer": "tactape_fab.sense.decode.localizer",
    "Motion": "tactape_fab.sense.track.motion",
    "Prior": "tactape_fab.sense.decode.search.search",
    "Tape": "tactape_fab.texture.tape",
    "TapeSpec": "tactape_fab.kit.spec.tape_spec",
    "TapedObject": "tactape_fab.sense.objects.taped_object",
    "Track": "tactape_fab.sense.track.tracker",
    "Tracker": "tactape_fab.sense.track.tracker",
    "Verification": "tactape_fab.verify.verification",
    "default_origin": "tactape_fab.texture.code",
    "make_kit": "tactape_fab.make.kit",
    "pixels_to_texture": _TAG_VIEW,
    "read_object": "tactape_fab.sense.objects.taped_object",
    "refine_tag_pose": "tactape_fab.sense.objects.tag_pose",
    "tag_side_mm": _TAG_VIEW,
    "tag_to_texture": _TAG_VIEW,
    "texture_to_pixels": _TAG_VIEW,
    "verify_kit": "tactape_fab.verify.file",
}
__all__ = [
    "Kit",
    "Localization",
    "Localizer",
    "Motion",
    "Prior",
    "Tape",
    "TapeSpec",
    "TapedObject",
    "Track",
    "Tracker",
    "Verification",
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
__getattr__, __dir__ = lazy_names(__name__, _HOMES)
__path__.append(str(_Path(__file__).parent / "base" / "old_paths"))
