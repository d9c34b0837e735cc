"""Stiffener and adhesive under the film: one layer each, named by material, with the outline of each tape."""

from __future__ import annotations

from tactape_fab.kit.artifact import Artifact
from tactape_fab.kit.film.drawing import Drawing
from tactape_fab.kit.profiles import FabProfile, material_words
from tactape_fab.kit.render.gerber_text import GerberText


def _render(drawing: Drawing, fab: FabProfile, role: str, what: str, backing: str | None) -> tuple[Artifact, ...]:
    if backing is None:
        return ()
    words = material_words(backing)
    # gerbonara and whats-that-gerber take a mechanical layer with a Protel
    # extension (.gm2) for a second outline; with a plain name it is a drawing
    gerber = GerberText(drawing.project, fab.x2, f"Other,{what}_Bottom_{words}")
    gerber.regions(drawing.backed_mm, "Material")
    return (Artifact(role=role, path=fab.file_path(role, drawing.name, words), data=gerber.data()),)


def render_stiffener(drawing: Drawing, fab: FabProfile) -> tuple[Artifact, ...]:
    """The stiffener; empty without one."""
    return _render(drawing, fab, "stiffener-bottom", "Stiffener", drawing.stiffener)


def render_adhesive(drawing: Drawing, fab: FabProfile) -> tuple[Artifact, ...]:
    """The adhesive; empty without one."""
    return _render(drawing, fab, "adhesive-bottom", "Adhesive", drawing.adhesive)
