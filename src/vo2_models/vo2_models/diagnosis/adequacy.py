"""Whether an explanation is adequate: what it leaves over is no larger and no more structured than this device's own misfit.

A fitted law misses every device by something, and by how much is a matter of the device: a loop that is no Preisach
operator leaves several noise powers where another leaves none. What tells the own misfit from physics is not its size but
that nothing predicts it: no function of time, temperature, rate, current or memory that is fitted to some blocks of the
recording describes it on the others. What such functions do predict is structure, and a named answer must leave next to none.
"""

from __future__ import annotations

from dataclasses import dataclass

from vo2_models.diagnosis.held_out import block_folds
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.nonparametric_correction import fit_nonparametric_correction
from vo2_models.diagnosis.pairs import Option
from vo2_models.diagnosis.problem import LinearisedProblem

__all__ = ["Adequacy", "adequacy_of"]


@dataclass(frozen=True)
class Adequacy:
    """What an explanation takes away, and what it leaves.

    Attributes
    ----------
    gain : drop of chi-square
    left : excess energy that is left, in noise powers of a sample
    own : the same that the device's own misfit is expected to leave; infinite where that is not known
    structured : of that, what functions without a name predict on held-out blocks
    """

    gain: float
    left: float
    own: float
    structured: float

    @property
    def share(self) -> float:
        """Share of the excess that is explained, 0 to 1."""
        return self.gain / max(self.gain + max(self.left, 0.0), 1e-300)

    @property
    def open(self) -> float:
        """What could be explained further, as a share of what is explained with it, 0 to 1."""
        return self.structured / max(self.gain + self.structured, 1e-300)

    def sufficient(self, limits: Limits) -> bool:
        """Whether most is explained, no more is left than the device's own misfit, and next to nothing that is predictable."""
        no_more = self.left <= self.own or self.share >= limits.thorough
        return self.share >= limits.explained and no_more and self.open <= 1.0 - limits.complete


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
    if option.remaining < limits.slack:  # what is left is noise, or hardly more
        return Adequacy(gain, left, own, 0.0)
    residual = final.apply_inverse_covariance(final.residual - option.chosen.deviation)
    found = fit_nonparametric_correction(final, residual, block_folds(final))
    return Adequacy(gain, left, own, found.removed)
