"""tactape-fab: make tactile fiducial tapes that a PCB fab can build, prove them from the written files, locate contacts on them.

Specialists find sensors, simulation and messages in `tactape_fab.sense`, CAD in `tactape_fab.solids`; deeper modules are private.
"""

from __future__ import annotations

from pathlib import Path as _Path
from typing import TYPE_CHECKING

from tactape_fab.base.lazy import lazy_names
from tactape_fab.base.version import __version__ as __version__

if TYPE_CHECKING:
    from tactape_fab.base.errors import CapacityError as CapacityError
    from tactape_fab.base.errors import Check as Check
    from tactape_fab.base.errors import DesignRuleError as DesignRuleError
    from tactape_fab.base.errors import Finding as Finding
    from tactape_fab.base.errors import FrameError as FrameError
    from tactape_fab.base.errors import RenderError as RenderError
    from tactape_fab.base.errors import SpecError as SpecError
    from tactape_fab.base.errors import TactapeError as TactapeError
    from tactape_fab.base.errors import VerifyError as VerifyError
    from tactape_fab.base.templates import templates_folder as templates_folder
    from tactape_fab.kit.examine.order import examine_order as examine_order
    from tactape_fab.kit.examine.tape import examine as examine
    from tactape_fab.kit.examine.tape_lists import list_tapes as list_tapes
    from tactape_fab.kit.spec.tape_spec import TapeSpec as TapeSpec
    from tactape_fab.make.kit import Kit as Kit
    from tactape_fab.make.kit import make_kit as make_kit
    from tactape_fab.make.many import make_kits as make_kits
    from tactape_fab.make.panel import PanelKit as PanelKit
    from tactape_fab.make.panel import make_panel as make_panel
    from tactape_fab.sense.decode.localizer import Localizer as Localizer
    from tactape_fab.sense.decode.result import Localization as Localization
    from tactape_fab.sense.decode.search.prior import Prior as Prior
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
    from tactape_fab.texture.as_built import AsBuilt as AsBuilt
    from tactape_fab.texture.as_built import Film as Film
    from tactape_fab.texture.certify.certificate import certify as certify
    from tactape_fab.texture.certify.pairs import across as across
    from tactape_fab.texture.code import default_origin as default_origin
    from tactape_fab.texture.frames import board_to_texture as board_to_texture
    from tactape_fab.texture.frames import texture_to_board as texture_to_board
    from tactape_fab.texture.registry import read_tapes as read_tapes
    from tactape_fab.texture.tape import Tape as Tape
    from tactape_fab.verify.file import verify_kit as verify_kit
    from tactape_fab.verify.verification import Verification as Verification

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    {
        "base.errors": "CapacityError Check DesignRuleError Finding FrameError RenderError SpecError TactapeError VerifyError",
        "base.templates": "templates_folder",
        "kit.examine.order": "examine_order",
        "kit.examine.tape": "examine",
        "kit.examine.tape_lists": "list_tapes",
        "kit.spec.tape_spec": "TapeSpec",
        "make.kit": "Kit make_kit",
        "make.many": "make_kits",
        "make.panel": "PanelKit make_panel",
        "sense.decode.localizer": "Localizer",
        "sense.decode.result": "Localization",
        "sense.decode.search.prior": "Prior",
        "sense.objects.tag_pose": "refine_tag_pose",
        "sense.objects.tag_view": "pixels_to_texture tag_side_mm tag_to_texture texture_to_pixels",
        "sense.objects.taped_object": "TapedObject read_object",
        "sense.track.motion": "Motion",
        "sense.track.tracker": "Track Tracker",
        "texture.as_built": "AsBuilt Film",
        "texture.certify.certificate": "certify",
        "texture.certify.pairs": "across",
        "texture.code": "default_origin",
        "texture.frames": "board_to_texture texture_to_board",
        "texture.registry": "read_tapes",
        "texture.tape": "Tape",
        "verify.file": "verify_kit",
        "verify.verification": "Verification",
    },
)
__all__ += ["__version__"]
__path__.append(str(_Path(__file__).parent / "base" / "old_paths"))
