"""Localization: the answer for one frame."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import cos, inf, radians, sin
from typing import Any, Literal

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.base.fields import shown
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

Status = Literal["none", "weak", "solid"]
Strain = tuple[float | None, float | None, None]
Refined = Literal["dots", "pixels"]
Places = Literal["nominal", "as-built"]
SOLID_DOTS = 16
"""Least number of dots of a solid contact (paper, section III-B.2)."""
_PLANAR = np.array([0, 1, 5])
"""Indices of x, y and the turn about z among the six degrees of freedom."""


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
        """The arrays as lists, by name."""
        return {field.name: getattr(self, field.name).tolist() for field in fields(self)}


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
        S in the board frame, mm; None where the texture stands on no board.
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
        `theta_deg`. Displacement of the gel by `[gel]` counts as an error of the dots, and is in `strain_sigma`.
    refined : {"dots", "pixels"} or None
        What the pose was fitted to: the dots' centres, or the pixels around them. None where it is not located.
    refine_reason : str or None
        Why the pose is that of the dots although the pixels were asked for.
    places : {"nominal", "as-built"} or None
        What the answer rests on: the places of parts by the design, or those measured on this tape. Of a tape that was measured
        it is the one that the dots fit better. None without a tape.
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
    places: Places | None = None
    elapsed_ms: float = 0.0
    timestamp: float | None = None

    def transform(self, frame: str = "board") -> FloatArray | None:
        """The pose of the sensor's image in a frame of the tape, as a homogeneous matrix.

        The image's own frame has its origin at the image centre, x along u, y along v and z into the tape, all in mm; it is
        right-handed. A pixel p of the canonical image is at ``q = ((p - p0) / px_per_mm, 0, 1)`` there, and its texture point at
        ``transform("texture") @ q`` (paper, Eq. 12). The plane z = 0 is the one in which the tape's parts stand.

        Parameters
        ----------
        frame : {"board", "texture"}
            ``"board"``: x right, y up, z out of the tape, origin at the outline's lower left corner. ``"texture"``: x right,
            y down, so z into the tape, origin at grid point (0, 0).

        Returns
        -------
        ndarray, shape (4, 4), or None
            mm. None if the frame is not located, if only a code is known, or if the texture is not on a board.

        Raises
        ------
        SpecError
            For another frame. An object's is asked of the object: ``read_object(FILE).locate(fix).transform()``.
        """
        board = _is_board(frame)
        origin = self.board_mm if board else self.position_mm
        if not self.located or origin is None or self.theta_deg is None:
            return None
        c, s = cos(radians(self.theta_deg)), sin(radians(self.theta_deg))
        out = np.eye(4)
        out[:3, :3] = [(c, s, 0.0), (s, -c, 0.0), (0.0, 0.0, -1.0)] if board else [(c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)]
        out[:2, 3] = origin
        return out

    def covariance6(self, frame: str = "board") -> FloatArray | None:
        """Covariance of `transform`, including the three degrees of freedom that a contact does not show.

        Order and units are (x, y, z) in mm, then small turns about the frame's own x, y and z axes in rad, right-handed.
        `theta_deg` is counter-clockwise seen from above, so in the texture frame, whose z points into the tape, the turn about z
        is minus theta; in the board frame it is theta, and y has the other sign.

        Parameters
        ----------
        frame : {"board", "texture"}
            As for `transform`.

        Returns
        -------
        ndarray, shape (6, 6), or None
            The variances of z and of the turns about x and y are infinite: nothing is known of them. None where
            `transform` is None, or the method states no covariance.

        Raises
        ------
        SpecError
            For another frame.
        """
        if self.transform(frame) is None or self.covariance is None:
            return None
        signs = np.array([1.0, -1.0, 1.0] if _is_board(frame) else [1.0, 1.0, -1.0])
        out = np.diag([0.0, 0.0, inf, inf, inf, 0.0])
        out[np.ix_(_PLANAR, _PLANAR)] = self.covariance * np.outer(signs, signs)
        return out

    def to_mapping(self, frame: int | None = None, *, dots: bool = False) -> dict[str, Any]:
        """The answer as a mapping that `json.dumps` takes.

        Parameters
        ----------
        frame : int, optional
            Index of the frame, the mapping's first key ``frame``; without it there is no such key.
        dots : bool
            Whether to have the key ``dots`` as well, a mapping of lists: 11 numbers a dot, of eight directions 15.

        Returns
        -------
        dict
            Every attribute but `dots` by its name, numbers as Python's own.
        """
        values: dict[str, Any] = {} if frame is None else {"frame": frame}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "dots":
                values[field.name] = value.tolist() if isinstance(value, np.ndarray) else value
            elif dots:
                values["dots"] = None if self.dots is None else self.dots.to_mapping()
        return values


def _is_board(frame: str) -> bool:
    """Whether a frame of a tape is the board's; the texture's otherwise."""
    if frame not in ("board", "texture"):
        remedy = "give one of them; for an object's, use read_object(FILE).locate(fix).transform()"
        raise SpecError(Problem("frame", f"frame = {shown(frame)} is neither 'board' nor 'texture'; {remedy}"))
    return frame == "board"


def status_of(dots: int) -> Status:
    """Contact status of a number of dots (paper, section III-B.2)."""
    return "none" if dots == 0 else "weak" if dots < SOLID_DOTS else "solid"
