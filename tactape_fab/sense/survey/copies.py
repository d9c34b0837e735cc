"""Contacts of two copies of a tape, told by the residuals of each part, which agree between contacts of one copy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import eigsh
from scipy.spatial import cKDTree

from tactape_fab.base.errors import Problem, SpecError
from tactape_fab.texture.frames import BoolArray, FloatArray, IntArray

LEAST_CONTACTS, LEAST_PARTS = 3, 10
"""Fewest contacts of each copy, and fewest parts that two or more contacts of each show: with fewer it may be a gel that slid."""
LEAST_RATIO, LEAST_APART_MM = 5.0, 0.015
"""Median of a part's squared distance between both groups of contacts, over that expected from errors of dots;
and the distance. Simulated contacts of one tape have a ratio of 2.5 at most where they are split so that they differ most, with a
gel displaced by 50 um as well; those of two copies, placed to 0.02 mm and worse, 9 and more."""
MOST_ALIKE = 0.5
"""Correlation of neighbours' shifts from which on they are not due to placement: a lens or gel shifts neighbours alike."""
_ROUNDS = 20
_MOST_NAMED = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Split:
    """Two groups of contacts in which parts stand apart.

    second (contacts,): Which contacts are of the smaller group.
    apart_mm: Median distance of a part in one from where it is in the other.
    ratio: See `LEAST_RATIO`.
    alike: Correlation of neighbours' distances.
    parts: How many parts both groups show twice and more.
    """

    second: BoolArray
    apart_mm: float
    ratio: float
    alike: float
    parts: int


def refuse_copies(frames: Sequence[int], contact: IntArray, part: IntArray, left_mm: FloatArray, places_mm: FloatArray) -> None:
    """Refuse contacts of two copies of a tape. Raises SpecError.

    frames: Of each contact, for the message.
    contact, part (m,), left_mm (m, 2): Of each dot: its contact, its part, and its residual, texture frame.
    places_mm (n, 2): Of the parts.
    """
    found = split_of(contact, part, left_mm, places_mm, len(frames))
    if found is None or found.ratio < LEAST_RATIO or found.apart_mm < LEAST_APART_MM or found.alike > MOST_ALIKE:
        return
    of = [frames[k] for k in np.flatnonzero(found.second).tolist()]
    named = ", ".join(map(str, of[:_MOST_NAMED])) + (", ..." if len(of) > _MOST_NAMED else "")
    message = (
        f"contacts show two copies of the tape: in {len(of)} of {len(frames)} frames ({named}) parts are {found.apart_mm:.2g} mm "
        "from where they are in the others (median)"
    )
    raise SpecError(Problem("frames", f"{message}; survey each copy by itself, into a file of its own"))


def refuse_other_start(
    part: IntArray, left_mm: FloatArray, shift_mm: FloatArray, before_mm: FloatArray, sigma_mm: FloatArray
) -> None:
    """Refuse initial measured places that fit the contacts worse than the design, as of another copy. Raises SpecError.

    Dots then seem to scatter, as nothing else may give way, and what comes out is neither copy.

    part (m,), left_mm (m, 2): As of `refuse_copies`.
    shift_mm, before_mm (n, 2): Where parts are found to be, and were measured before, from the design.
    sigma_mm (n,): Of those measured before.
    """
    count = np.bincount(part, minlength=len(shift_mm))
    mean_mm = np.stack([np.bincount(part, left_mm[:, axis], len(shift_mm)) for axis in range(2)], axis=1)
    # where the contacts alone have them
    seen_mm = shift_mm + mean_mm / np.maximum(count, 1)[:, None]
    # if a part was measured at the design's position, both fit equally well
    telling = (count >= 2) & (np.hypot(*before_mm.T) > 2.0 * sigma_mm)
    if telling.sum() < LEAST_PARTS:
        return
    off_mm, design_mm = (float(np.median(np.hypot(*(seen_mm - at)[telling].T))) for at in (before_mm, np.zeros(2)))
    if off_mm > max(design_mm, LEAST_APART_MM):
        message = (
            f"the measured places to start from do not fit the contacts: parts are {off_mm:.2g} mm off those and "
            f"{design_mm:.2g} mm off the design (median), as where they are of another copy of the tape"
        )
        raise SpecError(Problem("from", f"{message}; give the file of the copy that was touched, or leave out --from"))


def split_of(contact: IntArray, part: IntArray, left_mm: FloatArray, places_mm: FloatArray, contacts: int) -> Split | None:
    """The two groups of contacts that differ most; None if too few parts are shown by both.

    The residuals of a part agree between contacts of one copy, and are opposite between two: the signs of the leading eigenvector
    of the contacts' products split them. Then each contact is compared with the means of both groups without it.
    """
    shape = (contacts, len(places_mm))
    seen = csr_matrix((np.ones(len(part)), (contact, part)), shape=shape)
    by = [csr_matrix((left_mm[:, axis], (contact, part)), shape=shape) for axis in range(2)]
    products = sum((of @ of.T for of in by), csr_matrix((contacts, contacts)))
    products.setdiag(0.0)
    # contacts that share no part tell nothing
    if contacts < 2 * LEAST_CONTACTS or products.count_nonzero() == 0:
        return None
    # any start that is not at right angles to the answer will do; the same one each time
    _, vector = eigsh(products, k=1, which="LA", v0=np.cos(np.arange(contacts) + 1.0))
    second: BoolArray = vector[:, 0] > 0.0
    for _ in range(_ROUNDS):
        of_first, of_second = (_squares(seen, by, contact, part, left_mm, group) for group in (~second, second))
        # a part that no other contact of one group shows tells nothing
        now = np.bincount(contact, np.nan_to_num(of_second - of_first), contacts) < 0.0
        # the fewer: contacts of which nothing is told are of the others
        now = now if now.sum() * 2 <= contacts else ~now
        if (now == second).all():
            break
        second = now
    if second.sum() < LEAST_CONTACTS:
        return None
    count, mean = zip(*(_means(seen, by, group) for group in (~second, second)), strict=True)
    both = (count[0] >= 2) & (count[1] >= 2)
    if both.sum() < LEAST_PARTS:
        return None
    own = np.where(second[contact, None], mean[1][part], mean[0][part])
    used = both[part]
    variance = float(((left_mm - own)[used] ** 2).sum()) / (2.0 * float((count[0] + count[1] - 2.0)[both].sum()))
    apart = (mean[1] - mean[0])[both]
    squares = (apart**2).sum(axis=1)
    # of two normal errors: |D|^2 / 2 s^2 has the median ln 2
    spread = variance * (1.0 / count[0][both] + 1.0 / count[1][both])
    ratio = float(np.median(squares / (2.0 * spread))) / np.log(2.0)
    near = cKDTree(places_mm[both]).query(places_mm[both], k=2)[1][:, 1]
    alike = float((apart * apart[near]).sum() / squares.sum())
    return Split(second=second, apart_mm=float(np.sqrt(np.median(squares))), ratio=ratio, alike=alike, parts=int(both.sum()))


def _means(seen: csr_matrix, by: Sequence[csr_matrix], group: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Number of contacts of a group that show each part (n,), and the mean residual of the part (n, 2), 0 where none does."""
    weight = group.astype(float)
    count = seen.T @ weight
    return count, np.stack([of.T @ weight for of in by], axis=1) / np.maximum(count, 1.0)[:, None]


def _squares(
    seen: csr_matrix, by: Sequence[csr_matrix], contact: IntArray, part: IntArray, left_mm: FloatArray, group: BoolArray
) -> FloatArray:
    """Squared distance of each dot from the mean of its part in a group without its contact (m,); NaN where there is none."""
    count, mean = _means(seen, by, group)
    mine = group[contact].astype(float)
    others = count[part] - mine
    others[others < 1.0] = np.nan
    without = (mean[part] * count[part, None] - mine[:, None] * left_mm) / others[:, None]
    # of few contacts a mean is off by as much as they are
    squares: FloatArray = ((left_mm - without) ** 2).sum(axis=1) / (1.0 + 1.0 / others)
    return squares
