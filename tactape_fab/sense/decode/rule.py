"""The decision rule by which a contact is located or not: constants and formulas in plain Python and numpy.

The decoder's kernels are compiled with these constants; `advise` and `verify` read the same ones, without the compiler.

The rule in short. Before any tape is looked at, each dot gets a probability for each of its 4 (or 8) symbols, `posteriors`,
and from these q_i(0) + q_i(1) = 1 for each bit i of its symbol. A hypothesis h (tape, place on it, quarter turn) names all
bits b_i, and has the evidence

    E(h) = product over i of 2 q_i(b_i).

For a texture independent of the code the named bits are fair coins, so each factor has the mean
(2 q_i(0) + 2 q_i(1)) / 2 = 1, whatever q is, and so has E(h). Hence, by Markov's inequality, P(E(h) >= t) <= 1/t. With weights
w(h) that were fixed before any symbol was read and add up to 1 at most, the chance that any h has w(h) E(h) >= 1/p is at most
the sum of p w(h), which is p: the answer's 1 / (w E) is `p_tape`. All dots count, also those that disagree with the answer.

The bits of other places of the same code are not independent: they hold the same sequences, shifted. `p_place` is the posterior
probability of all these places, and the answer must lead over each of them by `KAPPA` as well.

After a change here, kernels that have the constant are compiled anew: `base.kept_kernels` compares what they were made of.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf, log, sqrt

import numpy as np

from tactape_fab.texture.frames import FloatArray
from tactape_fab.texture.tape import DEFAULT_GRID

# Limits of an answer

MAX_P_FALSE = 1e-4
"""Largest accepted p_false, a probability. Chosen: of 10,000 textures of any kind one may be located wrongly."""
KAPPA = 30.0
"""Least lead over any single other place, a likelihood ratio. Chosen: p_place depends on prior weights of places, this does
not."""
LEAST_DOTS = 6
"""Fewest dots on the answer's tape, and fewest of them that agree with the pose. The evidence of 6 dots of four directions is at
most 4^6 = 4,096, less than 1 / `MAX_P_FALSE`: fewer are not searched."""
GOOD_TRUST = 0.5
"""A dot of more trust is more likely a part than noise; of those on the tape half must agree with the pose (chosen)."""
SCALE_ERROR = 0.03
"""Share by which an answer's scale may be off beyond `View.scale_tolerance`: films stretch by up to 1 %, contacts on a cylinder
seem narrower by as much, and scales of small ones are off by 1 %. A tape of another W is seen as one at another scale."""
AGREE_SIGMAS = 3.5
"""A dot agrees within so many standard deviations of one axis: of two normal components 0.2 % of the right ones do not."""

# Prior weights of hypotheses, fixed before any symbol is read

UNREGISTERED_SHARE = 0.01
"""Weight of all unregistered tapes of the code together, a probability. Chosen; with as much for them as for the
registered ones a prototype located 17 % of contacts of 7x7 mm instead of 87 % (48 simulated contacts)."""
LEAST_COLUMNS, LEAST_ROWS = DEFAULT_GRID
"""Grid points of an unregistered tape, if no registered one is larger: those of the default tape."""
GRID_SHARES = (0.9, 0.05, 0.05)
"""Weights of the grids tried, best first; they add up to 1. The best grid is the one of most power, or the likeliest fit where
the fit to that one fails: both are known before any symbol is compared with a tape."""
LEAST_GRID_POWER = 0.12
"""Least power of a grid, as a share of a perfect one's. Displaced by W/6 dots keep ((1 + cos(pi/3)) / 2)^2 = 0.56 of it; n dots
that stand anywhere have 1/n on the mean."""
OVERHANG_SHARE = 0.1
"""Weight of all places where dots lie beyond a tape's edge, together. Chosen: most contacts have all their dots on the tape."""
PRIOR_SHARE = 0.5
"""Weight of the places near a `Prior`, together. All places share the rest: a wrong prior costs ln 2, and the bound still
holds."""
EVEN_TURNS: FloatArray = np.full(4, 0.25)
"""Weights of the four quarter turns where the shape of the dots tells nothing."""
MOST_TURN_SHARE = 0.98
"""Most that either pair of turns gets: bodies may be soldered askew, and an answer must remain possible where they are."""
MOST_ACROSS = 20.0
"""Ln odds up to which bodies may lie across the direction that an answer gives them. Of 6,854 right answers 5 were beyond 8.5,
the last at 45; of 5 wrong ones 4 were beyond 22: there two columns of a code were taken for two rows of it."""
GOOD_WEIGHT = 0.8
"""A dot at least this high, over a whole one, is imprinted well: it shows the error of dots, and its body's direction. Chosen."""
LEAST_GOOD = 4
"""Least number of good dots at which the direction of bodies is used. Chosen; `elongation` also weighs it by its scatter."""
MISREAD_SHARE = 0.02
"""Share of contacts whose symbols are read wrong as a whole, such as on a grid that is off by half a pitch. From 100,000 contacts
of 4.5 to 6 mm in a closed world (`python -m tests.bench.place_chance`): without it 64, 8, 2 and 2 answers were wrong where those
of p_place 1e-3 to 1e-2 and three decades below added up to 36, 1.0, 0.4 and 0.04; with it 56, 1, 0 and 0, of 56, 4.3, 0.9 and
0.05."""

MOST_RANGE = 100_000
"""Columns of the largest plane that is searched without a tape."""

# Detection of dots, and their trust; tuned on simulated frames

SMOOTHING_MM = 0.125
"""Standard deviation of the Gaussian that a depth map is smoothed with: 2 px at 16 px/mm."""
BACKGROUND_MM = 1.5625
"""Side of the square whose mean is taken away as background: 25 px at 16 px/mm."""
LEAST_HEIGHT = 0.3
"""Least height of a dot over the median of the strongest ones. Bumps of noise are mostly lower."""
USUAL_NOISE, LEAST_NOISE = 0.15, 0.03
"""Median height of the bumps of noise over a whole dot's: in the default scene, and the least value used."""
NOISE_MIDDLE, NOISE_WIDTH, MOST_MIDDLE = 1.95, 0.17, 0.6
"""Middle and width of `trusted`, in medians of the noise, and the largest middle, a height over a whole dot's. Fitted to
simulated frames of the default scene, of twice its noise, and of an elastomer of 0.25 mm."""
LEAST_TRUST = 0.02
"""Dots of less trust are left out: they would say nothing, and cost time."""

# Errors of a dot along one axis, in pitches; tuned on simulated frames

LEAST_SIGMA, USUAL_SIGMA, MOST_SIGMA = 0.012, 0.016, 0.06
"""Standard deviation of a good dot: the least and the most, 18 and 90 um at W = 1.5 mm, and the value assumed before a
frame is seen."""
USUAL_COUNT = 4.0
"""Errors that this belief counts as: those of two dots along two axes."""
LEAST_WEIGHT = 0.25
"""The error by noise grows as 1/height, down to this height over a whole dot's."""
RIM_ERROR = 0.06
"""Error that a contact's rim adds per unit of missing height."""
OUTLIER_SHARE = 0.01
"""Share of parts whose place says nothing of their symbol."""
WRONG_SHARE = 0.002
"""Share of dots that stand in another symbol's very place: the grid is off, or the part was placed so. No bit says more than ln
500 against a hypothesis then. In a prototype 2 % instead of 0.5 % lost 20 of 100 contacts of 7x7 mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits that an answer has to keep.

    max_p_false: Largest bound on being wrong.
    max_p_tape: Largest bound on the texture being none of ours; part of `max_p_false` where None.
    kappa: Least lead, as a factor, over any single other place.
    """

    max_p_false: float = MAX_P_FALSE
    max_p_tape: float | None = None
    kappa: float = KAPPA

    @property
    def precision(self) -> float:
        """Largest error of p_place, a probability, where it decides: a tenth of what is allowed."""
        return self.max_p_false / 10.0

    @property
    def on_tape(self) -> float:
        """Largest p_tape that can be accepted."""
        return self.max_p_false if self.max_p_tape is None else self.max_p_tape


def bound_of(ln_evidence: float) -> float:
    """p_tape from ln of the answer's w E: 1 / (w E), a bound by Markov's inequality, at most 1."""
    return exp(min(-ln_evidence, 0.0))


def share_of_others(others: float, p_tape: float) -> float:
    """p_place from the weighted likelihood w L of all other places, as a multiple of the answer's, and the answer's p_tape.

    Bayes' rule: the answer has 1 / (1 + others) of the posterior probability. L is E times what else speaks for a turn; it is a
    likelihood ratio, and p_place a probability, as far as the posteriors of the symbols are calibrated. They are not where the
    reading is wrong as a whole: its symbols are coins to every place then, whose E is 1 on the mean, the true one's as well. So a
    misread contact counts as one more place, of the weight `MISREAD_SHARE` and E = 1, which is p_tape of the answer's w E.
    Where the others were not counted, as the answer says nothing, they are infinite, and p_place is at most 1.
    """
    if others == inf:
        return 1.0
    # in multiples of the answer: MISREAD_SHARE 1 / (w E), and 1 / (w E) is p_tape
    others += MISREAD_SHARE * p_tape
    return others / (1.0 + others)


def least_agreeing(good: int) -> int:
    """Fewest dots that must agree with the pose, of so many good ones on the tape."""
    return max(LEAST_DOTS, good // 2)


def place_weights(counts: FloatArray, turn_weights: FloatArray, share: float) -> FloatArray:
    """Weight w of one place, by its quarter turn and by whether all dots lie on the tape.

    Places of a kind weigh the same, so w = share x turn x kind / count. A kind that has no place leaves its share to the other.

    counts (4, 2): Places by turn: with all dots on the tape, and with some beyond its edge.
    turn_weights (4,): They add up to 1.
    share: What all places weigh together.
    Returns (4, 2): ln w; -inf where there is no place.
    """
    out = []
    # E has the mean 1 at a place over the edge, too: a dot beyond it has the factor 1, as one at a grid point without a part
    for (inside, over), turn in zip(counts.tolist(), turn_weights.tolist(), strict=True):
        beyond = OVERHANG_SHARE if inside > 0.0 else 1.0
        within = 1.0 - OVERHANG_SHARE if over > 0.0 else 1.0
        out.append(
            (
                log(share * turn * within / inside) if inside > 0.0 else -inf,
                log(share * turn * beyond / over) if over > 0.0 else -inf,
            )
        )
    return np.array(out)


def turn_shares(ln_ratio: float) -> FloatArray:
    """Weights of the four quarter turns, shape (4,), from ln of how much likelier turns 0 and 2 are than 1 and 3.

    A logistic curve is the posterior of two alternatives of even prior. Bodies look alike after half a turn.
    """
    even = min(max(1.0 / (1.0 + float(np.exp(-ln_ratio))), 1.0 - MOST_TURN_SHARE), MOST_TURN_SHARE)
    half = even / 2.0
    return np.array([half, 0.5 - half, half, 0.5 - half])


def trusted(weights: FloatArray, noise: float = USUAL_NOISE) -> FloatArray:
    """Probability that dots are parts and not bumps of noise: a logistic curve over their heights.

    weights: Heights over that of a whole dot.
    noise: Median height of the bumps of noise, over the same.
    """
    # a part is at most 1 high: however loud the noise, a dot of MOST_MIDDLE is as likely a part as a bump
    middle = min(NOISE_MIDDLE * noise, MOST_MIDDLE)
    # 30 in the exponent is 1e-13: beyond it nothing changes, and nothing overflows
    return 1.0 / (1.0 + np.exp(np.minimum(np.maximum((middle - weights) / (NOISE_WIDTH * noise), -30.0), 30.0)))


def squared_errors(weights: FloatArray, sigma: float) -> FloatArray:
    """Variance of dots along one axis, pitches squared; `sigma` is the standard deviation of a good dot.

    A top moves by the noise's slope over the dot's own curvature, and that is as the dot's height: so by noise the error is
    sigma / height. What `rim` corrects of the rim's pull is right to `RIM_ERROR` times the missing height.
    """
    # a dot higher than a whole one is no better placed than that
    noise = sigma / np.minimum(np.maximum(weights, LEAST_WEIGHT), 1.0)
    rim = RIM_ERROR * np.maximum(1.0 - weights, 0.0)
    return noise * noise + rim * rim


def sigma_of(squares: float, dots: float) -> float:
    """Standard deviation of a good dot, in pitches, from the sum of squared distances of so many dots to their places.

    The belief before the frame is a sample of `USUAL_COUNT` errors of `USUAL_SIGMA`; each dot adds two, one for each axis.
    """
    # the posterior mean of the variance, for an inverse gamma prior of the mean USUAL_SIGMA^2
    sigma = sqrt((USUAL_COUNT * USUAL_SIGMA**2 + squares) / (USUAL_COUNT + 2.0 * dots))
    return min(max(sigma, LEAST_SIGMA), MOST_SIGMA)


def posteriors(squares: FloatArray, variance: FloatArray, trust: FloatArray) -> FloatArray:
    """Probability of each symbol of some dots, before any tape is looked at.

    With k places round a grid point, alike before the dot is seen, a part's dot has the density
    N_j = exp(-d_j^2 / 2 s^2) / (2 pi s^2) if its symbol is j. With probability 1 - t it is no part, or one whose place says
    nothing: it lies anywhere in its cell of area 1, and its symbol is any. By Bayes' rule

        q_j = (t N_j / k + (1 - t) / k) / (t sum_j N_j / k + 1 - t),   t = trust (1 - OUTLIER_SHARE),

    and `WRONG_SHARE` of it is spread over all symbols.

    squares (k, ...): Squared distances d_j^2 of the dots from the k places of their grid points, in pitches squared.
    variance (...): From `squared_errors`.
    trust (...): From `trusted`.
    Returns (k, ...): They add up to 1 over the first axis.
    """
    places = float(len(squares))
    part = trust * (1.0 - OUTLIER_SHARE)  # t
    q = np.exp(-0.5 * squares / variance) / (2.0 * places * np.pi * variance)  # N_j / k
    q = (part * q + (1.0 - part) / places) / (part * q.sum(axis=0) + 1.0 - part)
    mixed: FloatArray = (1.0 - WRONG_SHARE) * q + WRONG_SHARE / places
    return mixed
