"""A second-order surface by weighted least squares, for kernels: a normal matrix that takes a point at a time, and its solution.

The matrix has 7 rows and columns. Rows and columns 0 to 5 are the surface's height, its slopes by x and y, and its second
derivatives by xx, yy and xy, all at x = y = 0; column 6 is the right side. Row 6 is memory for the terms of a point.
"""

from __future__ import annotations

from tactape_fab.base.jit import inner_kernel
from tactape_fab.sense.decode.grid.posterior import eliminate
from tactape_fab.texture.frames import FloatArray


@inner_kernel()
def add_point(x: float, y: float, value: float, weight: float, normal: FloatArray) -> None:
    """Add a point of the surface to the normal matrix (7, 7), of which only what is on and above the diagonal is kept."""
    terms = normal[6]
    terms[0], terms[1], terms[2], terms[3], terms[4], terms[5], terms[6] = 1.0, x, y, x * x / 2.0, y * y / 2.0, x * y, value
    for i in range(6):
        for j in range(i, 7):
            normal[i, j] += weight * terms[i] * terms[j]


@inner_kernel()
def solve(normal: FloatArray) -> None:
    """Solve for the surface, in place: rows and columns 0 to 5 become the inverse, and column 6 the surface."""
    for i in range(6):
        for j in range(i):
            normal[i, j] = normal[j, i]
    for i in range(6):
        eliminate(normal, i, len(normal) - 1)  # no literal: numba would compile it for each
