"""Gauss-Newton alignment of many patches with one template; the weight of each sample is learned from all patches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tactape_fab.sense.inspect.patches import PatchGrid, Samples
from tactape_fab.texture.frames import BoolArray, FloatArray

_TUKEY = 4.5
"""Tukey's cut-off, in scatters of a sample: at 3 glare would remove the ends of good parts, and positions along them suffer."""
_FLOOR, _LEAST_SIGMA = 0.35, 0.02
"""Lower limits of a sample's scatter, as weights would be unbounded: a share of the usual scatter, and in units of contrast and
brightness. Where most samples are clipped, as on black film, the usual scatter is nearly 0."""
_MOST_PATCHES = 200
"""Largest number of patches from which the correlation of residuals is estimated."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Template:
    """An aligned patch, and the weight of each sample.

    value (channels, m)
    sigma (channels, m): Scatter of each sample about it, robust.
    used (m,): Mask of the samples that are fitted.
    tail (channels, m): Residual that nine parts of ten are below, over that of a normal scatter; 1 or more.
    """

    value: FloatArray
    sigma: FloatArray
    used: BoolArray
    tail: FloatArray

    def flat(self, picture: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The used samples of all channels; shape (..., channels * used)."""
        chosen = picture[..., self.used]
        return chosen.reshape(*chosen.shape[:-2], -1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Nuisance:
    """Nuisance modes, in which parts differ other than by a shift: pictures (k, channels, m), and their prior sigmas (k,)."""

    pictures: FloatArray
    sigma: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Step:
    """One step of Gauss-Newton for every patch.

    move (n, 3): Along a, along b (mm), and the turn (rad), in the patch's axes; 0 turn where it was not asked for.
    sigma_mm (n, 2): Of the place along a and b, from the residuals of the patch, correlation of neighbouring samples taken into
        account.
    misfit (n,): Root mean square residual, in units of each sample's scatter and tail.
    gain (n,): Contrast of the patch in units of the template's.
    nuisance (k,): Strength of each nuisance among the patches.
    scatter (channels, m): Robust scatter of each sample about the fit, to weigh the next fit by.
    tail (channels, m): As of a template, to judge the next fit by.
    """

    move: FloatArray
    sigma_mm: FloatArray
    misfit: FloatArray
    gain: FloatArray
    nuisance: FloatArray
    scatter: FloatArray
    tail: FloatArray


def learn_template(channels: Samples, used: BoolArray) -> Template:
    """Median and median deviation of every sample over the patches.

    channels (n, channels, m); used (m,)
    """
    value = np.median(channels, axis=0)
    # of a normal scatter the median deviation is 0.6745 sigma
    sigma = 1.4826 * np.median(np.abs(channels - value), axis=0)
    sigma = _not_too_small(sigma, used).astype(np.float64)
    return Template(value=value.astype(np.float64), sigma=sigma, used=used, tail=np.ones_like(sigma))


def _not_too_small(sigma: npt.NDArray[Any], used: BoolArray) -> npt.NDArray[Any]:
    return np.asarray(np.maximum(sigma, max(_FLOOR * float(np.median(sigma[:, used])), _LEAST_SIGMA)))


def step(
    channels: Samples, template: Template, grid: PatchGrid, *, turns: bool, robust: bool = True, nuisance: Nuisance | None = None
) -> Step:
    """Shift, turn, gain and offset (of each channel) of every patch relative to the template, by one step.

    A part that lies at e of where its patch was taken is seen as P(x) = T(x - e), to first order T - e . grad T.

    channels (n, channels, m)
    turns: Whether parts may be turned.
    robust: Whether samples that fit badly are left out patch by patch; twice as slow.
    """
    n, count, _ = channels.shape
    sigma = template.flat(template.sigma)
    columns = _columns(template, grid, turns=turns)
    if nuisance is not None:
        columns = np.concatenate([columns, template.flat(nuisance.pictures)])
    # divided by each sample's scatter, least squares is weighted least squares
    columns = (columns / sigma).astype(np.float32)
    rest = template.flat(channels - template.value.astype(np.float32)) / sigma.astype(np.float32)
    k = len(columns)
    correlated = 1.0
    # products of all pairs of columns, so that a patch's weights times these are its normal matrix: one product for all patches
    pairs = (columns[:, None] * columns[None]).reshape(k * k, -1).T
    weight = np.ones_like(rest)
    for again in range(3 if robust else 1):
        # in the first round all weights are 1, and all patches share one matrix
        normal = (weight @ pairs).astype(np.float64).reshape(n, k, k) if again else (columns @ columns.T).astype(np.float64)[None]
        prior = np.full(k, 1e-6)
        if nuisance is not None:
            # samples count as independent in the normal matrix, which then says `correlated` times too much: so must the prior
            prior[-len(nuisance.sigma) :] = max(correlated, 4.0) / nuisance.sigma**2
        inverse = np.linalg.inv(normal + np.diag(prior))
        right = ((weight * rest if again else rest) @ columns.T).astype(np.float64)
        solved = (inverse @ right[..., None])[..., 0]
        left = rest - solved.astype(np.float32) @ columns
        # every third sample is enough for a median
        spread = np.maximum(1.4826 * np.median(np.abs(left[:, ::3]), axis=1), 0.3)
        correlated = _correlated_samples(left, template, grid, count)
        if robust and again < 2:
            # Tukey's biweight: (1 - (r / c)^2)^2, and 0 beyond c
            weight = np.square(np.maximum(1.0 - np.square(left / (_TUKEY * spread[:, None])), 0.0))
    variance = spread.astype(np.float64) ** 2 * correlated
    extra = 0 if nuisance is None else len(nuisance.sigma)
    posterior = np.median(variance[:, None] * np.diagonal(inverse, axis1=1, axis2=2), axis=0)
    # estimates are drawn to 0 by the prior: their own scatter and what the fit leaves open add up to that of the parts
    strength = 1.4826 * np.median(np.abs(solved), axis=0)
    scatter, tail = template.sigma.copy(), np.ones_like(template.sigma)
    # where metal ends differ in length, one part in six may show metal where the others show body: such a sample is of no use to
    # tell a good part
    near, far = np.quantile(np.abs(left[:: max(1, n // _MOST_PATCHES)]), (0.5, 0.9), axis=0) * sigma * ((1.4826,), (1 / 1.645,))
    scatter[:, template.used] = near.reshape(count, -1)
    scatter = _not_too_small(scatter, template.used)
    tail[:, template.used] = np.maximum(1.0, far.reshape(count, -1) / scatter[:, template.used])
    return Step(
        move=np.column_stack([solved[:, 0], solved[:, 1], solved[:, 2] if turns else np.zeros(n)]),
        sigma_mm=np.sqrt(variance[:, None] * np.diagonal(inverse, axis1=1, axis2=2)[:, :2]),
        misfit=np.sqrt(np.square(left / template.flat(template.tail).astype(np.float32)).mean(axis=1, dtype=np.float64)),
        gain=1.0 + solved[:, 3 if turns else 2],
        nuisance=np.sqrt(strength**2 + posterior)[k - extra :],
        scatter=scatter,
        tail=tail,
    )


def _columns(template: Template, grid: PatchGrid, *, turns: bool) -> FloatArray:
    """Derivatives of a patch by the part's shift, its turn, gain, and the offset of each channel; (k, channels * used)."""
    da, db = gradients(template.value, grid)
    rows = [-da, -db]
    if turns:
        # a part turned by phi shows at (a, b) what the template has at (a + phi b, b - phi a)
        rows.append(da * grid.b_mm - db * grid.a_mm)
    rows.append(template.value - template.value[:, template.used].mean(axis=1, keepdims=True))
    for channel in range(len(da)):
        offset = np.zeros_like(da)
        offset[channel] = 1.0
        rows.append(offset)
    return template.flat(np.stack(rows))


def gradients(pictures: FloatArray, grid: PatchGrid) -> tuple[FloatArray, FloatArray]:
    """Derivatives along a and b of pictures (channels, m), each a mm."""
    db, da, *_ = np.gradient(pictures.reshape(-1, *grid.shape), grid.step_mm, axis=(1, 2))
    return da.reshape(pictures.shape), db.reshape(pictures.shape)


def _correlated_samples(left: FloatArray, template: Template, grid: PatchGrid, count: int) -> float:
    """Number of samples per independent one, from the correlation of residuals with their neighbours along both axes."""
    some = left[:: max(1, len(left) // _MOST_PATCHES)]
    full = np.zeros((len(some), count, grid.count), dtype=np.float32)
    full[..., template.used] = np.clip(some, -4, 4).reshape(len(some), count, -1)
    z, used = full.reshape(-1, count, *grid.shape), template.used.reshape(grid.shape)
    power = float(np.square(some.clip(-4, 4)).mean())
    if power <= 0:
        return 1.0
    along = float((z[..., 1:] * z[..., :-1])[..., used[:, 1:] & used[:, :-1]].mean()) / power
    across = float((z[..., 1:, :] * z[..., :-1, :])[..., used[1:] & used[:-1]].mean()) / power
    # a sum over a chain of samples with the correlation r^k has (1 + r) / (1 - r) times the variance of independent ones, along
    # each axis
    return float(np.prod([(1 + r) / (1 - r) for r in (min(max(along, 0.0), 0.9), min(max(across, 0.0), 0.9))]))
