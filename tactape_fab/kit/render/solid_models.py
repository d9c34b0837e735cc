"""The 3D models: STEP as an assembly of the placed parts, and one solid as STEP, STL and 3MF."""

from __future__ import annotations

from functools import partial

from tactape_fab.base.build_date import build_date, zip_date
from tactape_fab.base.version import __version__
from tactape_fab.kit.artifact import AnyArtifact, Artifact, LongArtifact
from tactape_fab.kit.profiles import FabProfile
from tactape_fab.kit.render.colours import BODY, COVERLAY_COLOURS, MOULD, TEXTURE, rgb
from tactape_fab.solids.forms import SolidForm
from tactape_fab.solids.mesh.sheet import texture_mesh
from tactape_fab.solids.mesh.triangles import stl_pieces, threemf_bytes
from tactape_fab.solids.step.assembly import assembly_step_chunks
from tactape_fab.solids.step.solid import solid_step_chunks
from tactape_fab.texture.tape import Tape


def render_assembly(tape: Tape, fab: FabProfile) -> LongArtifact:
    """The film with every part as an occurrence named by its designator."""
    pieces = partial(
        assembly_step_chunks,
        tape,
        name=tape.name,
        date=build_date(),
        board_rgb=rgb(COVERLAY_COLOURS[fab.coverlay_colour][0]),
        part_rgb=rgb(BODY),
    )
    return LongArtifact(role="step-assembly", path=f"models/{tape.name}-assembly.step", pieces=pieces)


def render_solid(tape: Tape, form: SolidForm) -> list[AnyArtifact]:
    """The texture, or its mould, as one solid: as an exact B-rep for CAD and milling, and as a mesh for printing."""
    title = f"{tape.name} mould" if form.negative else tape.name
    colour = rgb(MOULD if form.negative else TEXTURE)
    metadata = {
        "Description": f"{_kind(tape, form)}: sector {tape.sector} of {tape.code} at origin {tape.origin[0]},{tape.origin[1]}, "
        f"pitch {tape.pitch_mm:g} mm, displacement {tape.displacement_mm:g} mm{tape.in_directions}",
        "Application": f"tactape-fab {__version__}",
    }
    solid = partial(solid_step_chunks, tape, form, name=title, date=build_date(), rgb=colour)
    mesh = texture_mesh(tape, form)
    return [
        LongArtifact(role="step-solid", path=f"models/{tape.name}.step", pieces=solid),
        LongArtifact(role="stl", path=f"models/{tape.name}.stl", pieces=partial(stl_pieces, mesh, title)),
        Artifact(role="3mf", path=f"models/{tape.name}.3mf", data=threemf_bytes(mesh, title, metadata, zip_date())),
    ]


def _kind(tape: Tape, form: SolidForm) -> str:
    kind = "mould of a tactile texture" if form.negative else "tactile texture"
    return kind if form.cylinder is None else f"{kind} on a cylinder of radius {form.cylinder.radius_mm:g} mm"
