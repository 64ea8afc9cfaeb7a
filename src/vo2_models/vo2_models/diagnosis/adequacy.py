"""Whether an explanation is adequate: what it leaves over is no larger and no more structured than this device's own misfit.

A fitted law misses every device by something, and by how much is a matter of the device: a loop that is no Preisach
operator leaves several noise powers where another leaves none. What tells the own misfit from physics is not its size but
that nothing predicts it: no function of time, temperature, rate, current or memory that is fitted to some blocks of the
recording describes it on the others. What such functions do predict is structure, and a named answer must leave next to none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vo2_models.diagnosis.held_out import block_folds
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.nonparametric_correction import fit_nonparametric_correction
from vo2_models.diagnosis.pairs import Option, trace
from vo2_models.diagnosis.problem import LinearisedProblem

__all__ = ["Adequacy", "adequacy_of", "sureness"]


@dataclass(frozen=True)
class Adequacy:
    """What an explanation takes away, and what it leaves.

    Attributes
    ----------
    gain : drop of chi-square
    left : excess energy that is left, in noise powers of a sample
    own : the same that the device's own misfit is expected to leave; infinite where that is not known
    structured : of that, what functions without a name predict on held-out blocks
    sigmas : how surely its effects act, see `sureness`; infinite where the values themselves show one
    """

    gain: float
    left: float
    own: float
    structured: float
    sigmas: float

    @property
    def share(self) -> float:
        """Share of the excess that is explained, 0 to 1."""
        return self.gain / max(self.gain + max(self.left, 0.0), 1e-300)

    @property
    def open(self) -> float:
        """What could be explained further, as a share of what is explained with it, 0 to 1."""
        return self.structured / max(self.gain + self.structured, 1e-300)

    def sufficient(self, limits: Limits) -> bool:
        """Whether it surely acts and explains most, and leaves no more than the own misfit and next to nothing predictable."""
        no_more = self.left <= self.own or self.share >= limits.thorough
        closed = self.open <= 1.0 - limits.complete
        return self.sigmas > limits.sure and self.share >= limits.explained and no_more and closed


def adequacy_of(option: Option, problem: LinearisedProblem, left_out: float, limits: Limits) -> Adequacy:
    """Judge what an option leaves over.

    Parameters
    ----------
    option : the explanation with the problem about it
    problem : without effects, which the gain is told against
    left_out : excess power, in noise powers of a sample, of the device's own misfit
    limits : below which excess nothing is looked for

    Returns
    -------
    gain of the option, what it leaves over, and how much of that functions without a name predict
    """
    final, gain = option.final, option.chosen.gain
    left = final.count * option.remaining
    own = final.count * max(left_out, limits.slack)
    sigmas = np.inf if any(h.evident for h in option.chosen.hypotheses) else sureness(option)
    if option.remaining < limits.slack:  # what is left is noise, or hardly more
        return Adequacy(gain, left, own, 0.0, sigmas)
    residual = final.apply_inverse_covariance(final.residual - option.chosen.deviation)
    found = fit_nonparametric_correction(final, residual, block_folds(final))
    return Adequacy(gain, left, own, found.removed, sigmas)


def sureness(option: Option) -> float:
    """Return how surely the stretches of the recordings say together that each effect acts, in standard deviations.

    With x what an effect changes beside the others and e what is left, the nuisance model taken out of both, its gain is
    x'x + 2 x'e, or less where the nuisance model has paid for moving along. In noise x'e scatters by the root of x'x, which
    makes the root of the gain the certainty. Misfit goes on over many samples: the sum of x'e over a long stretch counts once,
    as in White's covariance for clusters, and S^2, the sum of their squares, may be larger. The certainty is the root of
    gain x'x / S^2. What a misfit has of a pattern, it has in some stretches and not in others.
    Cameron and Miller, J. Hum. Resour. 50, 317, 2015.

    Parameters
    ----------
    option : with the problem about it

    Returns
    -------
    of the least sure effect
    """
    final = option.final
    left = final.apply_inverse_covariance(final.residual - option.chosen.deviation)
    straight = replace(final, nuisance=replace(final.nuisance, courses=None))

    def one(key: str) -> float:
        acting = trace(final, key)
        x = straight.apply_inverse_covariance(acting)
        own = max(float(x @ acting), 1e-12)
        wider = max(float(np.sum(final.over_stretches(x * left) ** 2)) / own, 1.0)
        gain = min(own + 2.0 * float(x @ left), option.chosen.gain)
        return float(np.sqrt(max(gain, 0.0) / wider))

    return min(one(key) for key in option.chosen.keys)
