"""What is laminated to the underside, stiffener and adhesive: a layer each, named in words, as large as the board."""

from __future__ import annotations

from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.gerber_text import GerberText
from tactape_fab.kit.layout import Layout
from tactape_fab.profiles import FabProfile, material_words


def _render(layout: Layout, fab: FabProfile, role: str, what: str, backing: str | None) -> tuple[Artifact, ...]:
    if backing is None:
        return ()
    words = material_words(backing)
    gerber = GerberText(layout.tape, fab.x2, f"Other,{what}_Bottom_{words}")
    gerber.regions([layout.outline_mm], "Material")
    return (Artifact(role=role, path=fab.file_path(role, layout.tape.name, words), data=gerber.data()),)


def render_stiffener(layout: Layout, fab: FabProfile) -> tuple[Artifact, ...]:
    """The stiffener; nothing where none was asked for."""
    return _render(layout, fab, "stiffener-bottom", "Stiffener", layout.stiffener)


def render_adhesive(layout: Layout, fab: FabProfile) -> tuple[Artifact, ...]:
    """The adhesive; nothing where none was asked for."""
    return _render(layout, fab, "adhesive-bottom", "Adhesive", layout.adhesive)
