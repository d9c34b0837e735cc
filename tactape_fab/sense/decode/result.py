"""Localization: the answer for one frame."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import degrees, inf, isfinite, radians
from numbers import Integral
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown
from tactape_fab.base.given_value import refuse_other
from tactape_fab.sense.decode.space import Surface, image_pose, pose_covariance, texture_plane, with_more
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from tactape_fab.sense.decode.contact.surface import ContactSurface

Status = Literal["none", "weak", "solid"]
Strain = tuple[float | None, float | None, None]
Refined = Literal["dots", "pixels"]
Places = Literal["nominal", "as-built"]
SOLID_DOTS = 16
"""Least number of dots of a solid contact (paper, section III-B.2)."""
PLANAR = np.array([0, 1, 5])
"""Indices of x, y and the turn about z among the six degrees of freedom."""
_FRAMES, _ORIGINS = ("texture", "board", "object"), ("tape", "gel")
_PRESSED = ("tilt_deg", "tilt_covariance", "indentation_mm", "indentation_sigma_mm", "force_n", "force_sigma_n")
"""Properties computed from `contact`, in the order of `to_mapping`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocatedDots:
    """The dots of a located answer, as read-only arrays with one row for each.

    Attributes
    ----------
    uv_px : ndarray, shape (n, 2)
        Where the dot is seen, (u, v) in the canonical image, px: as detected, before the profile's camera is taken out.
    cell : ndarray of int, shape (n, 2)
        Column and row on the tape; (-1, -1) where the tape has no part. Without a tape, column and row in the code plane.
    symbol : ndarray, shape (n, 4) or (n, 8)
        Probability of each symbol, in the order of `Tape.symbols` (N, W, E, S, then n, w, e, s), as the dot says it by its place
        on the grid before any tape is looked at. Rows sum to 1.
    residual_mm : ndarray, shape (n, 2)
        Texture frame: where the dot is seen less where its part should be, by the answer's position, theta and scale, with the
        aspect, shear and radial distortion of the same fit taken out. Dots at the contact's rim are put back first. NaN where
        the tape has no part.
    inlier : ndarray of bool, shape (n,)
        Whether the dot agrees with the answer: `n_agree` of them.
    """

    uv_px: FloatArray
    cell: IntArray
    symbol: FloatArray
    residual_mm: FloatArray
    inlier: BoolArray

    def to_mapping(self) -> dict[str, Any]:
        """The arrays as lists, by name, with None for NaN."""
        return {field.name: _finite(getattr(self, field.name).tolist()) for field in fields(self)}


class OnObject(Protocol):
    """An object that knows where its tapes are: `TapedObject`."""

    def surface_of(self, fix: Localization) -> Surface | None:
        """Where texture points of a fix's tape are on the object; None where that tape is not on it."""

    def mount_covariance(self, fix: Localization, at_mm: FloatArray) -> FloatArray | None:
        """Covariance that the error of that tape's mount adds to `covariance6` of a pose at a point (3,), mm; None: exact."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Localization:
    """Pose of a sensor on a tape, or the reason why it is not located. Unknown fields are None.

    Angles for people and for scripts are degrees (`theta_deg`); the covariance has its angle in radians, as filters want it.

    Attributes
    ----------
    status : {"none", "weak", "solid"}
        No dots, fewer than 16, or 16 and more (paper, section III-B.2).
    located : bool
        Whether the requested bounds hold; if False, the fields below still hold everything known.
    reason : str or None
        Why it is not located.
    tape : str or None
        Name of the registered tape.
    sector : int or None
        Sector of the code.
    position_mm : (float, float) or None
        S, the texture point under the image centre (texture frame, mm).
    theta_deg : float or None
        Turn of the sensor on the tape, degrees, counter-clockwise seen from above, in (-180, 180].
    board_mm : (float, float) or None
        S in the board frame, mm; None where the texture stands on no board, or equal tapes lie elsewhere on theirs.
    contact_mm : (float, float) or None
        Nominal centre of the agreeing dot nearest the contact's centre (texture frame): the paper's C.
    cell : (int, int) or None
        Column and row of that dot on the tape.
    index : (int, int) or None
        The same in the code plane.
    plane_mm : (float, float) or None
        S from code-plane index (0, 0); only without a tape.
    px_per_mm : float or None
        Scale along u that was used or estimated, px/mm.
    covariance : ndarray of shape (3, 3), or None
        Of (x mm, y mm, theta rad) in the texture frame; theta counter-clockwise like `theta_deg`, but in radians. `covariance6`
        has it in the board frame.
    n_dots, n_agree : int
        Dots found, and those that fit the answer.
    p_tape, p_place, p_false : float or None
        Bound on the probability that an unregistered texture looks like this; probability that another place or tape is
        the true one (of registered ones alone, if p_tape already refuses the answer); their sum.
    dots : LocatedDots or None
        What each dot says; None where it is not located, and with method "paper".
    strain, strain_sigma : (float or None, float or None, None) or None
        Aspect, shear and rotation of what is seen against the tape, beyond the profile's `[geometry]` and in its terms: stretch
        along image u over that along v less 1, and shift along u for each unit along v; and their standard deviations.
        They come from the fit that gives the pose, so the profile's standard deviations are their prior. The image alone does
        not tell the camera from the gel. An entry is None where the frame leaves 0.9 of the prior's standard deviation or more:
        it is not observable then. The rotation never is: a gel that turns as a whole looks as a sensor that is turned, and is in
        `theta_deg`. Displacement of the gel by `[gel]` counts as an error of the dots, and is in `strain_sigma`. A tape that
        the depths show to be round a cylinder is unrolled before; where they do not, as without ``depth.unit_mm`` in the profile,
        a strip of half width h on a radius R is foreshortened by about h^2 / (10 R^2), which is seen as aspect.
    refined : {"dots", "pixels"} or None
        What the pose was fitted to: the dots' centres, or the pixels around them. None where it is not located.
    refine_reason : str or None
        Why the pose is that of the dots although it was to be fitted to the pixels.
    contact : ContactSurface or None
        Depths at the parts' tops, from which the properties below are computed when they are asked for; None where it is not
        located, by `locate_dots`, with method "paper", where the sensor's profile has no `depth.unit_mm`, and where the tops'
        depths are cut off.
    places : {"nominal", "as-built"} or None
        What the answer rests on: the places of parts by the design, or those measured on this tape. Of a tape that was measured
        the measured ones, unless the dots fit the design a thousand times better. None without a tape.
    elapsed_ms : float
        Computing time, ms.
    timestamp : float or None
        Capture time as it came with the frame, s.
    """

    status: Status
    located: bool
    reason: str | None = None
    tape: str | None = None
    sector: int | None = None
    position_mm: tuple[float, float] | None = None
    theta_deg: float | None = None
    board_mm: tuple[float, float] | None = None
    contact_mm: tuple[float, float] | None = None
    cell: tuple[int, int] | None = None
    index: tuple[int, int] | None = None
    plane_mm: tuple[float, float] | None = None
    px_per_mm: float | None = None
    covariance: FloatArray | None = None
    n_dots: int = 0
    n_agree: int = 0
    p_tape: float | None = None
    p_place: float | None = None
    p_false: float | None = None
    dots: LocatedDots | None = None
    strain: Strain | None = None
    strain_sigma: Strain | None = None
    refined: Refined | None = None
    refine_reason: str | None = None
    contact: ContactSurface | None = field(default=None, repr=False)
    places: Places | None = None
    elapsed_ms: float = 0.0
    timestamp: float | None = None

    @property
    def tilt_deg(self) -> tuple[float, float] | None:
        """Angles by which the tape rises towards the sensor along image u and v, degrees.

        They are those of the parts' tops in the image's centre. None where fewer than eight tops are seen, or the
        tape would be steeper than 30 degrees: the frame is then in another unit.
        """
        tilt = None if self.contact is None else self.contact.tilt
        return None if tilt is None else (degrees(tilt[0][0]), degrees(tilt[0][1]))

    @property
    def tilt_covariance(self) -> FloatArray | None:
        """Covariance of the two angles of `tilt_deg`; shape (2, 2), in rad^2 as in `covariance`."""
        tilt = None if self.contact is None else self.contact.tilt
        return None if tilt is None else tilt[1]

    @property
    def indentation_mm(self) -> float | None:
        """How deep the parts' tops are pressed into the gel, in the middle of the contact, mm.

        None also where the frame has no zero, as one whose mean is zero, and the profile does not know the gel.
        """
        found = None if self.contact is None else self.contact.indentation
        return None if found is None else found[0]

    @property
    def indentation_sigma_mm(self) -> float | None:
        """Standard deviation of `indentation_mm`."""
        found = None if self.contact is None else self.contact.indentation
        return None if found is None else found[1]

    @property
    def force_n(self) -> float | None:
        """Normal force on the gel that the image shows, N; None where the profile has no thickness or modulus of the gel.

        It is proportional to the profile's `gel.modulus_kpa`, and no more exact.
        """
        found = None if self.contact is None else self.contact.force[0]
        return None if found is None else found[0]

    @property
    def force_sigma_n(self) -> float | None:
        """Standard deviation of `force_n` for a gel that is as the profile says."""
        found = None if self.contact is None else self.contact.force[0]
        return None if found is None else found[1]

    def transform(self, frame: str = "board", *, on: OnObject | None = None, origin: str = "tape") -> FloatArray | None:
        """The pose of the sensor's image in a frame of the tape or of an object, as a homogeneous matrix.

        The image's own frame has its origin at the image centre, x along u, y along v and z into the tape, all in mm; it is
        right-handed. Its origin is on the tape: a pixel p of the canonical image is at ``q = ((p - p0) / px_per_mm, 0, 1)``
        there, and where `tilt_deg` is None its texture point is at ``transform("texture") @ q`` (paper, Eq. 12). Where the tilt
        is known, z is the sensor's axis, inclined to the tape. The plane z = 0 is the one in which the tape's parts stand.

        Parameters
        ----------
        frame : {"board", "texture", "object"}
            ``"board"``: x right, y up, z out of the tape, origin at the outline's lower left corner. ``"texture"``: x right,
            y down, so z into the tape, origin at grid point (0, 0). ``"object"``: that of the object `on`.
        on : TapedObject, optional
            The object that the tape is on, flat or round a cylinder: ``read_object(FILE)``. With "object" only.
        origin : {"tape", "gel"}
            Where the image's frame is along its z: on the tape, or where the sensor's axis meets the gel's undeformed surface,
            which moves with the sensor. That is known from tilt and indentation.

        Returns
        -------
        ndarray, shape (4, 4), or None
            mm. None if the frame is not located, if only a code is known, if the texture is not on a board, if the tape is
            not on the object, or if the gel's surface is asked for and not known.

        Raises
        ------
        SpecError
            For another frame or origin, and for an object without "object" or the reverse.
        """
        surface, state = surface_of(self, frame, on), state_of(self, origin)
        return None if surface is None or state is None else image_pose(surface, state[0])

    def covariance6(self, frame: str = "board", *, on: OnObject | None = None, origin: str = "tape") -> FloatArray | None:
        """Covariance of `transform`: of what a contact does not show the variance is infinite.

        Order and units are (x, y, z) in mm, then small turns about the frame's own x, y and z axes in rad, right-handed.
        `theta_deg` is counter-clockwise seen from above, so in the texture frame, whose z points into the tape, the turn about z
        is minus theta; in the board frame it is theta, and y has the other sign.

        Parameters
        ----------
        frame, on, origin
            As for `transform`.

        Returns
        -------
        ndarray, shape (6, 6), or None
            The turns about x and y have infinite variance where `tilt_deg` is None, and so have those axes of an object about
            which they turn. z has in the board and the texture frame where the origin is on the tape: nothing is said of the
            sensor's distance. In an object's frame that origin is a point of the tape, and as certain along its normal as the
            tape's mount, whose error is in all entries. None where `transform` is None, or the method states no covariance.

        Raises
        ------
        SpecError
            As `transform`.
        """
        surface, state = surface_of(self, frame, on), state_of(self, origin)
        if surface is None or state is None or state[1] is None:
            return None
        if frame != "object" and np.isinf(state[1][3, 3]):  # exactly, as there is nothing to carry over
            # of x, y and the turn. Board: y has the other sign, and theta is the turn about z, which points out of the tape;
            # texture: z points into it, and the turn is -theta
            signs = np.array([1.0, -1.0, 1.0] if frame == "board" else [1.0, 1.0, -1.0])
            out = np.diag([0.0, 0.0, inf, inf, inf, 0.0])
            out[np.ix_(PLANAR, PLANAR)] = state[1][:3, :3] * np.outer(signs, signs)
            return out
        out = pose_covariance(surface, state[0], state[1])
        if on is not None:
            out = with_more(out, on.mount_covariance(self, image_pose(surface, state[0])[:3, 3]))
        if origin == "tape" and frame != "object":
            out[2], out[:, 2] = 0.0, 0.0
            out[2, 2] = inf
        return out

    def to_mapping(self, frame: int | None = None, *, dots: bool = False) -> dict[str, Any]:
        """The answer as a mapping that `json.dumps` takes, with None for a number that is NaN or infinite.

        Parameters
        ----------
        frame : int, optional
            Index of the frame, the mapping's first key ``frame``; without it there is no such key.
        dots : bool
            Whether to have the key ``dots`` as well, a mapping of lists: 11 numbers a dot, of eight directions 15.

        Returns
        -------
        dict
            Every attribute but `dots` and `contact` by its name, and what the contact says, numbers as Python's own.
        """
        refuse_other(frame, (Integral, type(None)), "frame", "index", "a whole number, or leave it out")
        values: dict[str, Any] = {} if frame is None else {"frame": int(frame)}
        names = [name for one in fields(self) for name in (_PRESSED if one.name == "contact" else (one.name,))]
        for name in names:
            value = getattr(self, name)
            if name != "dots":
                values[name] = _finite(value.tolist() if isinstance(value, np.ndarray) else value)
            elif dots:
                values["dots"] = None if self.dots is None else self.dots.to_mapping()
        return values


def _finite(value: Any) -> Any:
    """A value with None for each float that JSON cannot hold."""
    if isinstance(value, list | tuple):
        return type(value)(map(_finite, value))
    return None if isinstance(value, float) and not isfinite(value) else value


def tape_named(fix: Localization) -> tuple[str | None, int | None, tuple[int, int] | None]:
    """Name, sector and origin of the tape of an answer: all that it says of which one it is."""
    if fix.index is None or fix.cell is None:
        return fix.tape, fix.sector, None
    return fix.tape, fix.sector, (fix.index[0] - fix.cell[0], fix.index[1] - fix.cell[1])


def refuse_no_answer(fix: object) -> None:
    """Refuse anything but a `Localization`. Raises SpecError."""
    refuse_other(fix, Localization, "fix", "Localization", "what Localizer.locate returns")


def surface_of(fix: Localization, frame: str, on: OnObject | None) -> Surface | None:
    """Where the tape of an answer is in a frame, as `Localization.transform` takes it; None where that is not known."""
    refuse_no_answer(fix)
    if not isinstance(frame, str) or frame not in _FRAMES or (frame == "object" and on is None):
        remedy = "give one of them; for an object's give 'object' and on=read_object(FILE), or use"
        message = f"frame = {shown(frame)} is neither 'board' nor 'texture'; {remedy} read_object(FILE).locate(fix).transform()"
        raise SpecError(Problem("frame", message))
    if frame != "object" and on is not None:
        raise SpecError(Problem("on", f"on is for frame = 'object', not {shown(frame)}; leave it out, or give 'object'"))
    if on is not None and not callable(getattr(on, "surface_of", None)):
        raise SpecError(Problem("on", f"on = {shown(on)} is no object; give read_object(FILE)"))
    if not fix.located or fix.position_mm is None:
        return None
    if on is not None:
        return on.surface_of(fix)
    if frame == "texture":
        return texture_plane
    if fix.board_mm is None:
        return None
    # board = origin + (x, -y): y up against y down, and z out of the tape against z into it
    x0, y0 = fix.board_mm[0] - fix.position_mm[0], fix.board_mm[1] + fix.position_mm[1]
    return lambda at_mm: (np.array([x0 + at_mm[0], y0 - at_mm[1], 0.0]), np.diag([1.0, -1.0, -1.0]))


def state_of(fix: Localization, origin: str = "tape") -> tuple[FloatArray, FloatArray | None] | None:
    """The state of a located answer's pose, as `space.image_pose` takes it, and its covariance, (6,) and (6, 6).

    The tilt is 0 with an infinite variance where it is not known. None where there is no pose, or no `origin` of it.
    """
    if not isinstance(origin, str) or origin not in _ORIGINS:
        raise SpecError(Problem("origin", f"origin = {shown(origin)} is neither 'tape' nor 'gel'; give one of them"))
    ahead = fix.contact.ahead if origin == "gel" and fix.contact is not None else None
    if not fix.located or fix.position_mm is None or fix.theta_deg is None or (origin == "gel" and ahead is None):
        return None
    state, plane = np.array([*fix.position_mm, radians(fix.theta_deg), 0.0, 0.0, 0.0]), None
    covariance = np.diag([0.0, 0.0, 0.0, inf, inf, 0.0])
    if fix.contact is not None and fix.contact.plane is not None:
        plane = fix.contact.plane
        state[3:5] = plane.rise[1:]
        covariance[3:5, 3:5] = plane.covariance[1:, 1:]
    if ahead is not None and plane is not None:
        state[5], covariance[5, 5] = ahead[0], ahead[1] ** 2
        # height and slopes are coefficients of one fitted plane, and correlate
        covariance[5, 3:5] = covariance[3:5, 5] = plane.covariance[0, 1:]
    if fix.covariance is None:
        return state, None
    covariance[:3, :3] = fix.covariance
    return state, covariance


def status_of(dots: int) -> Status:
    """Contact status of a number of dots (paper, section III-B.2)."""
    return "none" if dots == 0 else "weak" if dots < SOLID_DOTS else "solid"
