"""Stretch and bend of a whole tape, as the poses of a robot show them."""

from __future__ import annotations

import numpy as np

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.texture.frames import FloatArray

LEAST_BEND_MM, MOST_BEND_MM = 0.0005, 0.3
"""Stretch and bend of a tape, root mean square over its parts: least, which is the initial value, and largest."""


class Bend:
    """Stretch and bend of the whole tape: displacements that are polynomials of degree 2 in the design's x and y, not rigid.

    The priors of the single parts would hold back a common bend, with a thousand parts a thousand times, against any robot. So it
    has unknowns of its own, whose size is estimated as the scatter is. Without a robot it is not observable.

    modes (m, 2 k): x of all parts, then y; orthogonal, each with a root mean square of 1. Empty without a robot.
    amplitude_mm (m,): Amplitude of each mode.
    """

    def __init__(self, nominal_mm: FloatArray, *, held: bool) -> None:
        x, y = ((nominal_mm - nominal_mm.mean(axis=0)) / max(float(nominal_mm.std()), 1e-9)).T
        none, one = np.zeros_like(x), np.ones_like(x)
        rigid = [np.concatenate(pair) for pair in ((one, none), (none, one), (-y, x))]
        others = [np.concatenate(pair) for of in (x, y, x * x, x * y, y * y) for pair in ((of, none), (none, of))]
        # polynomials orthogonalised (QR) after the rigid motions; x along y is a rotation and a shear
        of_all = np.linalg.qr(np.stack([*rigid, *(other for k, other in enumerate(others) if k != 1)], axis=1))[0]
        self.modes = of_all[:, len(rigid) :].T * np.sqrt(2.0 * len(x)) if held else np.empty((0, 2 * len(x)))
        self.amplitude_mm, self.sigma_mm = np.zeros(len(self.modes)), LEAST_BEND_MM

    @property
    def shift_mm(self) -> FloatArray:
        """Displacement of each part (k, 2)."""
        return (self.amplitude_mm @ self.modes).reshape(2, -1).T

    def refuse_other_units(self) -> None:
        """Refuse a stretch and bend too large for a film: the poses have another scale, or another frame. Raises SpecError."""
        most_mm = float(np.sqrt((self.shift_mm**2).sum(axis=1).mean()))
        if most_mm > MOST_BEND_MM:
            message = (
                f"by the poses of the robot the tape is stretched or bent by {most_mm:.2g} mm (rms), more than {MOST_BEND_MM:g}"
            )
            remedy = "give poses in mm, of a calibrated robot, or leave out --poses"
            raise SpecError(Problem("poses", f"{message} mm; {remedy}"))

    def move(self, step_mm: FloatArray, variances: FloatArray) -> None:
        """Add a step of the amplitudes, which have these variances (mm²) after it."""
        self.amplitude_mm = self.amplitude_mm + step_mm
        # as for the scatter of parts, by expectation and maximisation
        squares = self.amplitude_mm**2 + variances
        self.sigma_mm = max(float(np.sqrt(squares.mean())), LEAST_BEND_MM)
