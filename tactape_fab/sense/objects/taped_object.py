"""An object and the tapes on it, from object.toml: converts fixes to the object's own frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, pi, radians
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import Problem, SpecError, refuse
from tactape_fab.base.fields import Fields, shown, shown_path
from tactape_fab.base.given_path import as_path
from tactape_fab.base.given_value import as_numbers
from tactape_fab.base.templates import read_toml
from tactape_fab.sense.decode.result import Localization, refuse_no_answer, state_of, tape_named
from tactape_fab.sense.decode.space import Surface, image_pose, pose_covariance, with_more
from tactape_fab.sense.geometry import from_quaternion
from tactape_fab.sense.objects.mount import (
    AROUND,
    SURFACES,
    Mount,
    ObjectPose,
    on_surface,
    printed_mount,
    texture_surface,
    to_object,
)
from tactape_fab.sense.objects.rigid import carried, fit_covariance, fit_rigid, from_rpy, to_quaternion
from tactape_fab.sense.objects.tag_view import tag_corners_mm, tag_side_mm
from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.manifest import find_manifest, read_manifest
from tactape_fab.texture.registry import read_registered
from tactape_fab.texture.tape import Tape

MOST_TAPES = 256
FARTHEST_MM = 10_000.0
LARGEST_RADIUS_MM = 10_000.0
MISFIT_SHARE = 0.15
"""Largest rms error of measured tag corners, as a fraction of the tag's side."""
_POSES = ("rpy_deg", "quaternion_xyzw", "tag_corners_mm")
_SIGMAS = {"sigma_mm": (10.0, "mm"), "sigma_deg": (10.0, "deg")}
"""Largest standard deviation of a mount along an axis, and about one, and its unit."""
_KEYS = ("kit", "surface", "position_mm", *_POSES, *_SIGMAS, "radius_mm", "under_mm", "around")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TapeOnObject:
    """A tape, the path of its kit, its mount on the object, and the rms error of its measured tag corners, mm."""

    kit: Path
    tape: Tape
    mount: Mount
    misfit_mm: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TapedObject:
    """An object and the tapes on it.

    Attributes
    ----------
    name : str
        The object's name.
    tapes : tuple of TapeOnObject
        Every tape with the path of its kit and its mount.
    """

    name: str
    tapes: tuple[TapeOnObject, ...]

    def locate(self, fix: Localization) -> ObjectPose | None:
        """A fix in the object's frame; None if it is not located, or on a tape that is not on this object.

        A tape is identified by name, sector and origin, as in a fix: `refuse_ambiguous` reports tapes with equal ones. The pose
        is inclined to the film where the fix knows its tilt.

        Parameters
        ----------
        fix : Localization
            On a registered tape.

        Returns
        -------
        ObjectPose or None
        """
        surface, state = self.surface_of(fix), state_of(fix)
        if surface is None or state is None:
            return None
        pose = image_pose(surface, state[0])
        covariance = None
        if state[1] is not None:
            covariance = with_more(pose_covariance(surface, state[0], state[1]), self.mount_covariance(fix, pose[:3, 3]))
        x, y, z = pose[:3, 3].tolist()
        return ObjectPose(object=self.name, position_mm=(x, y, z), rotation=to_quaternion(pose[:3, :3]), covariance=covariance)

    def surface_of(self, fix: Localization) -> Surface | None:
        """Where texture points of a fix's tape are on the object, flat or round its cylinder.

        Parameters
        ----------
        fix : Localization

        Returns
        -------
        callable or None
            From a texture point (2,), mm, to its place in the object's frame (3,), mm, and the texture's axes there, (3, 3):
            columns along x, along y, and into the object. None as of `locate`.
        """
        entry = self._entry(fix)
        return None if entry is None else texture_surface(entry.mount, entry.tape)

    def mount_covariance(self, fix: Localization, at_mm: npt.ArrayLike) -> FloatArray | None:
        """Covariance of a pose by the error of its tape's mount: the same error for all fixes on that tape.

        Parameters
        ----------
        fix : Localization
        at_mm : array_like, shape (3,)
            Origin of the pose in the object's frame, mm.

        Returns
        -------
        ndarray, shape (6, 6), or None
            Of that point, mm, then of small turns about the object's axes, rad. None where the mount counts as exact, and as of
            `locate`.
        """
        entry = self._entry(fix)
        if entry is None or entry.mount.covariance is None:
            return None
        return carried(entry.mount.covariance, as_numbers(at_mm, (3,), "at_mm", "x, y and z in mm") - entry.mount.position_mm)

    def _entry(self, fix: Localization) -> TapeOnObject | None:
        """The tape of a fix, if it is located and on the object."""
        refuse_no_answer(fix)
        if not fix.located or None in (fix.index, fix.cell, fix.position_mm, fix.theta_deg):
            return None
        named = tape_named(fix)
        return next((entry for entry in self.tapes if named == _place(entry.tape)), None)


def read_object(path: str | Path) -> TapedObject:
    """Read an object.toml.

    Parameters
    ----------
    path : str or Path
        A TOML file; paths of kits in it are relative to its folder.

    Returns
    -------
    TapedObject

    Raises
    ------
    SpecError
        Every problem found in it and in its kits.
    """
    path = as_path(path, "path", "the .toml file of an object")
    table = Fields(read_toml(path, "object"), f"object {shown_path(path.name)}: ")
    table.refuse_unknown(("name", "tapes"))
    name = table.text("name", longest=100)
    tapes: list[TapeOnObject] = []
    remedy = "give a [[tapes]] for each tape on the object"
    for i, row in enumerate(table.rows("tapes", longest=MOST_TAPES, remedy=remedy)):
        found = _read_tape(row, f"{table.where}tapes[{i}].", path.parent, table.problems)
        if found is not None:
            tapes.append(found)
    if not tapes and not table.problems:
        table.problem("tapes", f"tapes is empty; {remedy}")
    _refuse_doubles(tapes, table)
    refuse(table.problems)
    return TapedObject(name=name, tapes=tuple(tapes))


def directions_of(entry: TapeOnObject) -> FloatArray:
    """Where board x runs at a tape's tag, and where the film faces there, as columns in the object frame; (3, 2)."""
    middle_mm = tag_corners_mm(entry.tape).mean(axis=0)
    return np.asarray(to_object(entry.mount, middle_mm)[1][0][:, [0, 2]])


def refuse_ambiguous(thing: TapedObject, tapes: Sequence[Tape]) -> None:
    """Refuse registered tapes that a fix cannot distinguish from those of an object. Raises SpecError."""
    own = {_place(entry.tape): entry for entry in thing.tapes}
    textures = {entry.tape.texture_key: entry for entry in thing.tapes}
    problems = []
    for tape in tapes:
        entry = own.get(_place(tape))
        if entry is not None and entry.tape.texture_key != tape.texture_key:
            message = f"tape {tape.name} has name, sector and origin of {shown_path(entry.kit)}, which is on the object, but "
            problems.append(Problem("tape", f"{message}another texture; make it with another name, or leave it out"))
        alike = textures.get(tape.texture_key)
        if alike is not None and (alike.tape.name, alike.tape.board) != (tape.name, tape.board):
            message = f"tape {tape.name} has the texture of {shown_path(alike.kit)}, which is on the object, and no touch tells "
            problems.append(Problem("tape", f"{message}them apart; use another sector for one of them, or leave it out"))
    refuse(problems)


def _place(tape: Tape) -> tuple[str, int, tuple[int, int]]:
    """Key by which a localization names its tape."""
    return tape.name, tape.sector, tape.origin


def _refuse_doubles(tapes: list[TapeOnObject], table: Fields) -> None:
    """Problems of tapes that cannot be told apart: two with the same texture, or with the same name in an answer."""
    textures: dict[tuple[Any, ...], Path] = {}
    places: dict[tuple[Any, ...], Path] = {}
    for entry in tapes:
        texture, place = entry.tape.texture_key, _place(entry.tape)
        if texture in textures:
            message = f"tapes {shown_path(textures[texture])} and {shown_path(entry.kit)} have the same texture"
            table.problem("tapes", f"{message}, which no touch tells apart; use another sector for one of them")
        elif place in places:
            message = f"tapes {shown_path(places[place])} and {shown_path(entry.kit)} have the same name, sector and origin"
            table.problem("tapes", f"{message}, by which an answer names its tape; make one of them with another name")
        textures[texture] = places[place] = entry.kit


def _read_tape(row: object, where: str, folder: Path, problems: list[Problem]) -> TapeOnObject | None:
    """One tape of an object; None where its kit cannot be read, with every problem collected."""
    if not isinstance(row, Mapping):
        problems.append(Problem("tapes", f"{where[:-1]} = {shown(row)} is not a table; give [[tapes]]"))
        return None
    table = Fields(row, where, problems)
    table.refuse_unknown(_KEYS)
    before = len(problems)
    surface = table.text("surface", choices=SURFACES, default="plane")
    round_keys = [key for key in ("radius_mm", "under_mm", "around") if key in row]
    radius = under = 0.0
    around = "x"
    if surface == "cylinder":
        radius = table.number("radius_mm", above=0.0, high=LARGEST_RADIUS_MM)
        under = table.number("under_mm", low=0.0, high=100.0) if "under_mm" in row else 0.0
        around = table.text("around", choices=AROUND, default="x")
    elif round_keys:
        table.problem(
            round_keys[0], f"{round_keys[0]} is of a cylinder, but surface is {shown(surface)}; give surface = 'cylinder'"
        )
    given = [key for key in _POSES if key in row]
    if len(given) != 1:
        named = " and ".join(given) or "none"
        table.problem("rpy_deg", f"{' or '.join(_POSES)} says how the film lies, but given is {named}; give one of them")
    turn, position = _read_pose(table, given)
    spread = _read_sigmas(table)
    corners = _read_corners(table) if given == ["tag_corners_mm"] else None
    kit = folder / table.text("kit", longest=4096, pattern="(?s).+", remedy="give the folder of a kit")
    # an empty one would be the folder of this file
    tape, printed = (_read_kit(kit, table) if isinstance(row.get("kit"), str) and row["kit"] else None) or (None, None)
    if printed is not None and surface == "cylinder":
        message = f"kit = {shown_path(kit)} is printed round a cylinder of {printed.top_mm:g} mm already"
        remedy = "give surface = 'plane' with position_mm and rpy_deg of its model, and no radius_mm, under_mm and around"
        table.problem("surface", f"{message}; {remedy}")
    if tape is None or len(problems) > before:
        return None
    thickness = tape.board.thickness_mm
    mount = Mount(
        surface="cylinder" if surface == "cylinder" else "plane",
        rotation=turn,
        position_mm=position,
        # the neutral layer of a bent film is taken in its middle
        top_mm=radius + under + thickness,
        true_mm=radius + under + thickness / 2,
        around="y" if around == "y" else "x",
        covariance=spread,
    )
    if printed is not None:
        middle_mm = turn @ printed.position_mm  # of the model, from the point whose position is given
        moved = None if spread is None else carried(spread, middle_mm)
        mount = replace(printed, rotation=turn @ printed.rotation, position_mm=middle_mm + position, covariance=moved)
    elif surface == "cylinder" and not _goes_round(mount, tape, radius, table):
        return None
    if corners is None:
        return TapeOnObject(kit=kit, tape=tape, mount=mount)
    return _measured(kit, tape, mount, corners, table)


def _goes_round(mount: Mount, tape: Tape, radius_mm: float, table: Fields) -> bool:
    """Whether a film meets its own beginning at most; a longer one is a problem: no object of this radius carries it."""
    along = AROUND.index(mount.around)
    length_mm, height_mm = tape.board.size_mm[along], tape.board.size_mm[1 - along]
    # the neutral layer keeps the length of the flat film
    longest_mm = 2 * pi * mount.true_mm
    if length_mm <= longest_mm:
        return True
    # rounded up to a micrometre, so that the typed value is enough
    least_mm = ceil((length_mm / (2 * pi) - (mount.true_mm - radius_mm)) * 1000) / 1000
    message = f"radius_mm = {radius_mm:g} mm: the way round is {longest_mm:.3f} mm at the film's middle, {mount.true_mm:g} mm "
    message += f"from the axis, and the tape is {length_mm:g} mm along board {mount.around}; give the object's radius in mm, "
    turned = f", or around = '{AROUND[1 - along]}' if the side of {height_mm:g} mm goes round" if height_mm <= longest_mm else ""
    table.problem("radius_mm", f"{message}{least_mm:g} mm or more{turned}")
    return False


def _read_pose(table: Fields, given: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Rotation matrix and position, mm, from a table with the values of the CAD."""
    turn, position = np.eye(3), np.zeros(3)
    if "rpy_deg" in given:
        turn = from_rpy(table.numbers("rpy_deg", 3, low=-360.0, high=360.0, unit="deg"))
    if "quaternion_xyzw" in given:
        before = len(table.problems)
        quaternion = table.numbers("quaternion_xyzw", 4, low=-1.01, high=1.01, unit="", default=(0.0, 0.0, 0.0, 1.0))
        length = float(np.linalg.norm(quaternion))
        if len(table.problems) == before and abs(length - 1.0) > 0.01:  # of refused numbers it is none of the user's
            table.problem("quaternion_xyzw", f"quaternion_xyzw has length {length:.3f}, not 1; give x, y, z, w of a rotation")
        elif length > 0.0:
            turn = from_quaternion(quaternion)
    if "tag_corners_mm" not in given:
        position = np.array(table.numbers("position_mm", 3, low=-FARTHEST_MM, high=FARTHEST_MM))
    elif "position_mm" in table.values:
        table.problem("position_mm", "position_mm and tag_corners_mm both say where the film is; give one of them")
    return turn, position


def _read_sigmas(table: Fields) -> FloatArray | None:
    """Covariance of a mount by its standard deviations, (6, 6) as `Mount` has it; None where none is given."""
    given = [key for key in _SIGMAS if key in table.values]
    if not given:
        return None
    if "tag_corners_mm" in table.values:
        message = f"{given[0]} is of a pose that is given; tag_corners_mm tell their error themselves: leave it out"
        table.problem(given[0], message)
        return None
    shift, turn = (table.number(key, low=0.0, high=most, unit=unit, default=0.0) for key, (most, unit) in _SIGMAS.items())
    return np.diag(np.repeat([shift**2, radians(turn) ** 2], 3))


def _read_corners(table: Fields) -> np.ndarray:
    rows = table.rows("tag_corners_mm", longest=4)
    named = Fields({f"tag_corners_mm[{i}]": row for i, row in enumerate(rows)}, table.where, table.problems)
    if len(rows) != 4:
        table.problem("tag_corners_mm", f"tag_corners_mm has {len(rows)} corners; give 4, from the lower left, counter-clockwise")
    return np.array([named.numbers(key, 3, low=-FARTHEST_MM, high=FARTHEST_MM) for key in named.values])


def _read_kit(kit: Path, table: Fields) -> tuple[Tape, Mount | None] | None:
    """The tape of a kit, and of one that is printed round a cylinder its mount in the board frame of its model."""
    try:
        entries = read_registered([kit])
        # a packed registry is refused: it does not say which form a print has
        solids = [read_manifest(find_manifest(entry.path)).get("solid") for entry in entries[:1]]
    except SpecError as error:
        table.problems.extend(Problem("kit", f"{table.where}kit: {p.message}") for p in error.problems)
        return None
    if len(entries) != 1:
        message = f"kit = {shown_path(kit)} holds {len(entries)} tapes; give the one that is here, such as PANEL/tapes/NAME"
        table.problem("kit", message)
        return None
    tape = entries[0].tape
    if tape.surface is not None:
        table.problem("kit", f"kit = {shown_path(kit)} stands on a part of its own, not on a film; give a kit of a film")
        return None
    form = solids[0].get("cylinder") if isinstance(solids[0], Mapping) else None
    if form is None:
        return tape, None
    cylinder = Fields(form if isinstance(form, Mapping) else {}, f"{table.where}kit: solid.cylinder.", table.problems)
    around = cylinder.text("around", choices=AROUND, default="x")
    radius_mm = cylinder.number("radius_mm", above=0.0, high=10 * FARTHEST_MM, default=1.0)
    return tape, printed_mount(tape.board.size_mm, radius_mm, "y" if around == "y" else "x")


def _measured(kit: Path, tape: Tape, mount: Mount, corners: np.ndarray, table: Fields) -> TapeOnObject | None:
    """The mount that fits the tag's corners to their measured places."""
    if tape.tag is None:
        table.problem("tag_corners_mm", f"tag_corners_mm: {shown_path(kit)} carries no tag; give position_mm and rpy_deg")
        return None
    on_tag = on_surface(mount, tag_corners_mm(tape))[0]
    rotation, position, misfit = fit_rigid(on_tag, corners)
    most = MISFIT_SHARE * tag_side_mm(tape)
    if not misfit <= most:
        message = f"the corners are {misfit:.2f} mm (rms) off those of a tag of {tag_side_mm(tape):g} mm, more than {most:.2f} mm"
        remedy = "give mm, from the upright tag's lower left corner, counter-clockwise"
        table.problem("tag_corners_mm", f"tag_corners_mm: {message}; {remedy}")
        return None
    spread = fit_covariance(on_tag @ rotation.T + position, position, misfit)
    placed = replace(mount, rotation=rotation, position_mm=position, covariance=spread)
    return TapeOnObject(kit=kit, tape=tape, mount=placed, misfit_mm=misfit)
