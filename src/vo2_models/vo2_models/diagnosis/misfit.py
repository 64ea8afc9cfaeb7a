"""The device's own misfit: an error of the fitted loops that wanders as the film is driven through the transition.

No law is the device's. What it misses is no white noise: it goes on from sample to sample, through a turning point, and is
forgotten after some kelvins of travel. As a process along the path of the temperature T it is

    m_k = phi_k m_(k-1) + sqrt(1 - phi_k^2) s eta_k,      phi_k = exp(-|T_k - T_(k-1)| / L),      eta_k unit normal,

(Ornstein and Uhlenbeck's, with the travel in the place of time) and stands still while the film does. Its size s and its
length L are those of highest marginal likelihood over the calibration; most devices that obey the law have none. In place of
white samples a diagnosis then judges innovations: what neither noise nor a misfit that was there a moment ago makes likely.
Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, appendix B.2; the filter is Kalman's.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.noise import NoiseModel
from vo2_models.numerics.kernel import kernel

__all__ = ["NO_MISFIT", "Misfit", "Whitening", "innovations"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Misfit:
    """Size and length of the wandering error.

    Attributes
    ----------
    level : standard deviation s inside the transition, in the channel's unit; 0 for none
    travel : distance L over which it is forgotten [K]
    """

    level: float
    travel: float

    def slope(self, noise: NoiseModel) -> float:
        """Size of the error in whitened samples: the noise's filter passes what is slow by (1 - sum of a) / innovation."""
        return self.level * (1.0 - sum(noise.ar)) / noise.innovation


NO_MISFIT = Misfit(0.0, 1.0)


@kernel(nogil=True)
def _innovations(z, slope, decay, variance, out):
    """Innovations (n, p) of z = slope x + e, x the unit process, e of `variance`; return the sum of log variances.

    A sample without variance is missing: its innovation is 0.
    """
    n, p = z.shape
    state = np.zeros(p)
    spread, total = 1.0, 0.0
    for k in range(n):
        for j in range(p):
            state[j] *= decay[k]
        spread = decay[k] * decay[k] * spread + 1.0 - decay[k] * decay[k]
        if variance[k] <= 0.0:
            for j in range(p):
                out[k, j] = 0.0
            continue
        expected = slope[k] * slope[k] * spread + variance[k]
        gain, root = slope[k] * spread / expected, np.sqrt(expected)
        for j in range(p):
            surprise = z[k, j] - slope[k] * state[j]
            out[k, j] = surprise / root
            state[j] += gain * surprise
        spread -= gain * slope[k] * spread
        total += np.log(expected)
    return total


@kernel(nogil=True)
def _undone(innovation, slope, decay, variance, out):
    """The samples (n,) whose innovations are given."""
    state, spread = 0.0, 1.0
    for k in range(innovation.size):
        state *= decay[k]
        spread = decay[k] * decay[k] * spread + 1.0 - decay[k] * decay[k]
        if variance[k] <= 0.0:
            out[k] = slope[k] * state
            continue
        expected = slope[k] * slope[k] * spread + variance[k]
        surprise = innovation[k] * np.sqrt(expected)
        out[k] = slope[k] * state + surprise
        state += slope[k] * spread / expected * surprise
        spread -= slope[k] ** 2 * spread**2 / expected


def innovations(columns: Floats, slope: Floats, moved: Floats, variance: Floats) -> tuple[Floats, float]:
    """Innovations of unit variance of columns that hold noise and a wandering misfit.

    Parameters
    ----------
    columns : (n, p)
    slope : (n,) size of the misfit, 0 outside of the transition
    moved : (n,) travel since the sample before, over the length L
    variance : (n,) of the noise; 0 where a sample is missing

    Returns
    -------
    tuple : innovations (n, p), and the sum of the logarithms of their variances before they were divided by them
    """
    out = np.empty(columns.shape)
    total = _innovations(np.ascontiguousarray(columns), slope, np.exp(-moved), variance, out)
    return out, float(total)


@dataclass(frozen=True)
class Whitening:
    """How a channel of a recording becomes innovations of unit variance.

    Attributes
    ----------
    noise : level and colour
    weight : (n,) what divides the noise's innovations; 0 where a sample is missing
    slope : (n,) size of the misfit in weighed innovations of the noise; empty for none
    decay : (n,) what is left of the misfit after the way from the sample before; empty for none
    size : (n,) of the noise over its level, where it is not the same everywhere; empty for one size
    """

    noise: NoiseModel
    weight: Floats
    slope: Floats
    decay: Floats
    size: Floats = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def along(
        cls, temperature: Floats, noise: NoiseModel, weight: Floats, misfit: Misfit, inside: NDArray[np.bool_]
    ) -> Whitening:
        """Return the whitening along a path of temperature (n,) [degC]; `inside` is where the film is in transition."""
        if misfit.level <= 0.0:
            return cls(noise, weight, np.zeros(0), np.zeros(0))
        moved = np.abs(np.diff(temperature, prepend=temperature[:1]))
        return cls(noise, weight, misfit.slope(noise) * weight * inside, np.exp(-moved / misfit.travel))

    def __call__(self, columns: Floats) -> Floats:
        """Whiten (n,) or (n, p) in the channel's unit."""
        if self.size.size:
            columns = columns / (self.size if columns.ndim == 1 else self.size[:, None])
        plain = self.noise.whiten(columns)
        if plain.ndim == 1:
            plain *= self.weight
            return self._surprises(plain[:, None])[:, 0] if self.slope.size else plain
        plain *= self.weight[:, None]
        return self._surprises(plain) if self.slope.size else plain

    def _surprises(self, plain: Floats) -> Floats:
        out = np.empty(plain.shape)
        _innovations(plain, self.slope, self.decay, self._known, out)
        return out

    @property
    def _known(self) -> Floats:
        return (self.weight > 0.0).astype(np.float64)

    def undo(self, innovation: Floats) -> Floats:
        """Return the values (n,) in the channel's unit whose whitened form is given, noise and misfit together."""
        plain = innovation
        if self.slope.size:
            plain = np.empty(innovation.size)
            _undone(np.ascontiguousarray(innovation), self.slope, self.decay, self._known, plain)
        values = self.noise.color(plain / np.where(self.weight > 0.0, self.weight, 1.0))
        return values * self.size if self.size.size else values
