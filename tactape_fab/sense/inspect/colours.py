"""Colours of body, metal and film, learned from the scan itself, and the mixture of channels that tells a body from the rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tactape_fab.base.errors import SpecError
from tactape_fab.sense.inspect.patches import Samples, patch_grid, sample
from tactape_fab.sense.inspect.scan_files import Picture
from tactape_fab.sense.inspect.warp import Warp
from tactape_fab.texture.frames import BoolArray, FloatArray, texture_to_board
from tactape_fab.texture.tape import Tape

LEAST_CONTRAST = 25.0
"""Least distance of the body's colour from the film's, of 255."""
_LEAST_OWN = 10.0
"""Colour of a body that film has at no brightness, of 255; a grey scan has none."""
MOST_WHITE, _WHITE = 0.5, 250.0
"""Share of the parts' metal that may be white, and what is: at 1200 dpi places are off by 2.2 um rms with 0.01 (glare), 3.3 with
0.3, 4.2 with 0.54, more than 5 from 0.66 on, where good parts are listed as well."""
_MOST_SITES = 600
_DARK_FILM = 0.7
"""Least brightness of the unit that brightness is counted in, as a share of the metal's: amber film has 0.74. In units of green
film, of 0.3, metal would be cut as glare is, hardly scatter, and 77 good parts of 393 look covered."""
LIKE_BODY = 0.6
"""Body-ness from which on a sample counts as body."""
_SHADE = 0.65
"""Film in the shadow of a part, as a share of its brightness."""
_BLACK = 0.4
"""Brightness of bodies over that of metal up to which no mixture of film and metal looks like them: those of chip resistors have
0.2 to 0.3, of ceramic capacitors 0.5 and more. Blurred edges of lands, and solder on gold, have the colour of the latter."""
_ROUGHLY = 0.1
"""How negative a share of a mixture may be, as colours of a scan are right to some percent."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Palette:
    """Median colours (blue, green, red), and ``body_axis`` (4,): body-ness = axis[:3] . colour + axis[3], 1 on bodies.

    ``beside`` is that of the openings beside parts, where it is known.
    """

    body: FloatArray
    metal: FloatArray
    film: FloatArray
    body_axis: FloatArray
    beside: FloatArray | None = None

    @property
    def like_lands(self) -> bool:
        """Whether edges of lands may look like bodies, so that body-ness does not tell whether a part is there."""
        seen = np.array([self.metal, self.film]).T
        share = np.linalg.lstsq(seen, self.body, rcond=None)[0]
        mixed = bool((share > -_ROUGHLY).all() and np.linalg.norm(self.body - seen @ share) < LEAST_CONTRAST)
        return mixed and bool(self.body.mean() > _BLACK * self.metal.mean())

    @property
    def others(self) -> list[FloatArray]:
        """Colours that are not the bodies'."""
        return [self.metal, self.film, _SHADE * self.film] + ([] if self.beside is None else [self.beside])

    def are_bodies(self, samples: Samples) -> BoolArray:
        """Whether samples (..., 3) are nearest to the bodies' colour, of all that this palette knows."""
        body, *rest = (np.square(samples - colour.astype(np.float32)).sum(axis=-1) for colour in (self.body, *self.others))
        return np.asarray(body < np.min(rest, axis=0))

    def body_share(self, samples: Samples) -> Samples:
        """Body-ness of the samples: 1 on bodies, 0 on film and metal; clipped to -0.2 ... 1.2."""
        axis = self.body_axis.astype(np.float32)
        return np.asarray(np.clip(samples @ axis[:3] + axis[3], -0.2, 1.2), dtype=np.float32)

    def unshaded_axis(self) -> npt.NDArray[np.float32] | None:
        """Mixture of channels that is 1 on bodies, 0 on film however dark; None where bodies have no colour of their own."""
        film = self.film / np.linalg.norm(self.film)
        # the part of the body's colour that is across the film's: shaded film stays on its own axis, where this is 0
        own = self.body - (self.body @ film) * film
        return (own / (own @ own)).astype(np.float32) if np.linalg.norm(own) > _LEAST_OWN else None

    def grey(self, samples: Samples) -> Samples:
        """Brightness in units of the film's, or of a share of the metal's where film is darker."""
        return np.asarray(samples.mean(axis=-1) / np.float32(max(self.film.mean(), _DARK_FILM * self.metal.mean())))


def learn_palette(picture: Picture, warp: Warp, tape: Tape, inside: BoolArray) -> Palette:
    """Median colours at the centres of parts, on their ends, midway between four grid points, and in the openings beside parts.

    Raises SpecError if the scan is over-exposed, or bodies look like the film.
    """
    length, width, _ = tape.part.body_mm
    step = max(1, int(inside.sum()) // _MOST_SITES)
    cells, sites = tape.cells()[inside][::step], tape.part_xy_mm()[inside][::step]
    turn = tape.part.rotation_deg
    small, narrow = (patch_grid(0.12 * length, share * width, warp.px_per_mm) for share in (0.2, 0.1))
    along = np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
    across = np.array([-along[1], along[0]])
    ends, sides = (np.concatenate([sites + arm, sites - arm]) for arm in (0.55 * length * along, 0.67 * width * across))
    # nothing stands midway between four grid points
    between = texture_to_board((cells + 0.5) * tape.pitch_mm, tape.board.texture_origin_mm)
    places = ((sites, small), (ends, small), (between, small), (sides, narrow))
    seen = [sample(picture, warp, at, turn, grid) for at, grid in places]
    white = float((seen[1].min(axis=2) >= _WHITE).mean())
    if white > MOST_WHITE:
        raise SpecError(
            f"it is over-exposed: {white:.0%} of the parts' metal is white, more than {MOST_WHITE:.0%}, so edges are not where "
            "they seem; scan darker, without automatic levels"
        )
    # medians of a place, then of places: parts that are missing or covered do not count
    body, metal, film, beside = (np.median(np.median(each, axis=1), axis=0).astype(np.float64) for each in seen)
    if np.abs(body - film).max() < LEAST_CONTRAST:
        raise SpecError(
            f"bodies do not stand out from the film: {_rgb(body)} against {_rgb(film)}; scan in colour, with more light"
        )
    axis = _axis(body, metal, film)
    # gold in an opening of blue film would be body, and a place without a part full of it
    if abs(axis[:3] @ beside + axis[3]) > LIKE_BODY:
        axis = _axis(body, metal, film, beside)
    found = Palette(body=body, metal=metal, film=film, body_axis=axis, beside=beside)
    nearest = min(found.others, key=lambda colour: float(np.abs(body - colour).max()))
    if found.like_lands and np.abs(body - nearest).max() < LEAST_CONTRAST:
        raise SpecError(
            f"bodies do not stand out from film and lands: {_rgb(body)} against {_rgb(nearest)}; scan in colour, with more light"
        )
    return found


def _rgb(colour: FloatArray) -> str:
    return f"RGB {', '.join(f'{c:.0f}' for c in colour[::-1])}"


def _axis(body: FloatArray, metal: FloatArray, film: FloatArray, *beside: FloatArray) -> FloatArray:
    """Ridge regression of `body_axis`: 1 on the body, 0 on film, film in shadow, metal, glare and the other given colours."""
    rows = np.array([body, film, _SHADE * film, metal, np.minimum(1.3 * metal, 255.0), *beside]) / 255.0
    # four unknowns and colours that are nearly in one plane: without the ridge the mixture would be of huge opposite weights
    weight = np.array([4.0, 4.0, 1.0, 2.0, 1.0, *(2.0 for _ in beside)])[:, None]
    a = np.column_stack([rows, np.ones(len(rows))]) * weight
    want = np.eye(len(rows))[:, :1] * weight
    ridge = np.diag([0.03, 0.03, 0.03, 0.0]) ** 2 * 10.0
    axis = np.linalg.solve(a.T @ a + ridge, a.T @ want)[:, 0]
    axis[:3] /= 255.0
    # scaled so that film is 0 and the body 1 exactly
    low, high = (float(axis[:3] @ colour + axis[3]) for colour in (film, body))
    return np.append(axis[:3], axis[3] - low) / (high - low)
