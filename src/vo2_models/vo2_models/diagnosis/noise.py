"""Noise of a channel: its level and colour, and the filter that whitens it.

Sensor noise may be coloured. A test that takes it for white alarms in most recordings without any effect,
so everything downstream works on innovations of an autoregressive model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d
from scipy.signal import lfilter, lfiltic

__all__ = ["LONGEST", "NoiseModel", "fit_noise", "level_from_differences", "outliers", "samples_apart"]

Floats = NDArray[np.float64]
LONGEST = 4
"""Highest autoregressive order considered [samples]."""
ALONE = 8.0
"""Robust deviations, of the distance from the line between both neighbours, from which a sample stands alone: the ten about one
are too few to tell less from noise that grows with the signal."""
COMB, AGREE = 3.0, 0.5
"""Steps of a converter from which a sample stands alone, and share of that distance by which its neighbours may differ."""
FEWEST = 50
"""Samples from which a noise has a colour."""
MOSTLY_THERE = 0.8
"""Share of the samples above which those that are missing are taken to lie on lines between the others."""
ABOUT = 11
"""Samples, itself among them, from which is seen what is usual about one."""
FEW_ABOUT, CLOSE = 7, 0.1
"""Samples of which up to three may be off together, and share of what these are off that the others may be."""
NEAR_BY = 7
"""Samples over which what a late reading may show is looked for, half of them on either side."""
SELDOM = 0.1
"""Share of the edges of a signal at which samples stand alone, up to which they are no late readings."""
RARE = 0.02
"""Largest share of samples that are outliers; more of them are no accidents."""
LAGS = 2000
"""Samples after which noise is taken as forgotten: what it is until then is a covariance, cut shorter it need not be one."""


@dataclass(frozen=True)
class NoiseModel:
    """x_k = a_1 x_(k-1) + ... + a_p x_(k-p) + e_k, e white.

    Attributes
    ----------
    innovation : standard deviation of e, in the channel's unit
    ar : (p,) coefficients, empty for white noise
    """

    innovation: float
    ar: tuple[float, ...] = ()

    @cached_property
    def level(self) -> float:
        """Standard deviation of the noise itself, in the channel's unit."""
        if not self.ar:
            return self.innovation
        return float(np.sqrt(np.sum(self._response() ** 2)))

    def _response(self) -> Floats:
        """What one innovation of a standard deviation does from then on (LAGS,)."""
        impulse = np.zeros(LAGS)
        impulse[0] = self.innovation
        return np.asarray(lfilter([1.0], [1.0, *(-a for a in self.ar)], impulse))

    def variance_of_sums(self, length: int) -> Floats:
        """Variance of the sum of 0, 1, ... `length` neighbouring samples (length + 1,): n g_0 + 2 sum (n - k) g_k."""
        lags = min(length, LAGS)
        covariance = np.zeros(length + 1)
        covariance[:lags] = self._covariance(lags)
        # second sum of the autocovariance
        once = 2.0 * np.cumsum(covariance) - covariance[0]
        return np.concatenate([[0.0], np.cumsum(once[:length])])

    def _covariance(self, lags: int) -> Floats:
        """Autocovariance at 0, 1, ... lags - 1 samples (lags,)."""
        h = self._response()
        return np.array([h[: h.size - k] @ h[k:] for k in range(lags)])

    def every(self, apart: int) -> NoiseModel:
        """The same noise where only each `apart`-th sample is there: regressed on these alone, by Yule-Walker equations."""
        if apart == 1 or not self.ar:
            return self
        order = max(LONGEST // apart, 1)
        g = self._covariance(order * apart + 1)[::apart]
        a = solve_toeplitz(g[:order], g[1:])
        ar = np.zeros(order * apart)
        ar[apart - 1 :: apart] = a
        return NoiseModel(float(np.sqrt(g[0] - a @ g[1:])), tuple(ar.tolist()))

    def whiten(self, x: Floats) -> Floats:
        """Filter (n, ...) along the first axis to innovations of unit variance.

        The start is treated as if the series had been at its first value before, damped to the scale a
        stationary start has, so that no spike of the filter enters.
        """
        x = np.asarray(x, dtype=np.float64)
        if not self.ar:
            return x / self.innovation
        order = len(self.ar)
        out = x.copy()  # lfilter would go through hundreds of columns one at a time
        for lag, a in enumerate(self.ar, 1):
            out[lag:] -= a * x[:-lag]
        out /= self.innovation
        out[:order] = x[:order] / self.level
        return out

    def color(self, innovations: Floats) -> Floats:
        """Undo `whiten`: (n,) innovations of unit variance to the channel's unit."""
        if not self.ar:
            return innovations * self.innovation
        e = innovations * self.innovation
        order = len(self.ar)
        start = innovations[:order] * self.level
        # the filter's first outputs are given, the rest follows from the recursion
        out = np.empty_like(e)
        out[:order] = start
        memory = lfiltic([1.0], [1.0, *(-a for a in self.ar)], y=start[::-1])
        out[order:] = lfilter([1.0], [1.0, *(-a for a in self.ar)], e[order:], zi=memory)[0]
        return out

    def scaled(self, factor: float) -> NoiseModel:
        """The same colour at `factor` times the level."""
        return NoiseModel(self.innovation * factor, self.ar)


def samples_apart(present: NDArray[np.bool_]) -> int:
    """Return how many samples the ones that are there are apart, in the median: 1 where some are missing at times.

    Parameters
    ----------
    present
        Whether a sample holds a value (n,).

    Returns
    -------
    Steps from one such sample to the next, at least 1; 1 for fewer than two.

    """
    places = np.flatnonzero(present)
    return int(np.median(np.diff(places))) if places.size > 1 else 1


def level_from_differences(x: Floats) -> float:
    """Return the robust level of white noise on a signal that is smooth over three samples [unit of x].

    Median of second differences, which a linear trend does not reach; for positively correlated noise it
    is a lower bound.

    Parameters
    ----------
    x : (n,) samples at equal distances
    """
    second = x[2:] - 2 * x[1:-1] + x[:-2]
    if second.size == 0:
        return 0.0
    return float(np.median(np.abs(second)) / (0.674490 * np.sqrt(6.0)))


def outliers(residual: Floats, step: float = 0.0, course: Floats | None = None) -> NDArray[np.bool_]:
    """Return which samples (n,) stand alone: far from the line between their neighbours, which agree with each other.

    Far is `ALONE` robust deviations of what all, or the ten about it, are off that line. What a device does is not over after
    a sample: an edge, or the answer to a step, is seen by the neighbours. Where more than `RARE` of the samples stand alone,
    they are what the signal is like, and none is an outlier.

    Parameters
    ----------
    residual : (n,) what a model leaves over, so that nothing steep is in it; NaN where missing
    step : of its converter, which makes samples that stand alone by that much [unit of residual]
    course : (n,) what the model says: one that is read late shows what the signal was a few samples before, which is seen at most
        edges or at hardly any
    """
    alone = np.zeros(residual.size, dtype=bool)
    known = np.flatnonzero(np.isfinite(residual))
    if known.size < ABOUT:
        return alone
    x = residual[known]
    off = np.abs(x[1:-1] - 0.5 * (x[:-2] + x[2:]))
    usual = np.maximum(np.median(off), median_filter(off, ABOUT, mode="nearest")) / 0.674490
    far = off > np.maximum(ALONE * usual, COMB * step)
    single = far & (np.abs(x[2:] - x[:-2]) < AGREE * off)
    if course is not None:
        low, high = minimum_filter1d(course, NEAR_BY), maximum_filter1d(course, NEAR_BY)
        motion = high - low
        here, moves = known[1:-1], motion[known[1:-1]]
        shown, margin = course[here] + (x[1:-1] - 0.5 * (x[:-2] + x[2:])), ALONE * usual
        late = single & (shown >= low[here] - margin) & (shown <= high[here] + margin)
        # what reads late reads late at every edge
        shows = moves > np.maximum(ALONE * usual, COMB * step)
        edges = np.count_nonzero(np.diff(shows.astype(int)) == 1)
        if np.count_nonzero(late) > SELDOM * edges:
            single &= ~late
        # two together, or near each other, are each other's neighbours: they are far from what most of those about them are,
        # and away from edges no answer of the device is as short
        away = np.abs(x - median_filter(x, FEW_ABOUT, mode="nearest"))
        all_over = np.median(off) / 0.674490
        apart = away > np.maximum(ALONE * all_over, np.maximum(COMB * step, 2.0 * motion[known]))
        alone[known] = apart & (median_filter(away, FEW_ABOUT, mode="nearest") < CLOSE * away)
    alone[known[1:-1]] |= single
    return alone if np.mean(alone) <= RARE else np.zeros_like(alone)


def fit_noise(
    residual: Floats, valid: NDArray[np.bool_] | None = None, *, order: int = LONGEST
) -> NoiseModel:
    """Estimate level and colour by Yule-Walker equations, the order by the Bayesian information criterion.

    Parameters
    ----------
    residual : (n,) what a good model leaves over; outliers beyond 5 robust deviations are set to zero
    valid : (n,) samples that count
    order : highest order tried

    Returns
    -------
    innovation [unit of residual] and coefficients of the autoregression

    Raises
    ------
    ValueError : fewer than `FEWEST` valid samples.
    """
    keep = np.isfinite(residual) if valid is None else valid & np.isfinite(residual)
    if np.count_nonzero(keep) < FEWEST:
        raise ValueError(f"residual: found {np.count_nonzero(keep)} valid samples, need at least {FEWEST}")
    x = np.where(keep, residual, 0.0)
    spread = 1.4826 * float(np.median(np.abs(x[keep] - np.median(x[keep]))))
    if spread > 0:
        x = np.clip(x, -5 * spread, 5 * spread)
    n = int(np.count_nonzero(keep))
    if n > MOSTLY_THERE * x.size:  # zeros between them would pass for white noise on what is slow
        places = np.arange(x.size)
        x, n = np.interp(places, places[keep], x[keep]), x.size
    covariance = np.array([np.dot(x[: x.size - k], x[k:]) / n for k in range(order + 1)])
    if covariance[0] <= 0:
        return NoiseModel(np.finfo(float).tiny)
    best, best_score = NoiseModel(float(np.sqrt(covariance[0]))), n * np.log(covariance[0])
    for p in range(1, order + 1):
        a = solve_toeplitz(covariance[:p], covariance[1 : p + 1])
        variance = covariance[0] - float(np.dot(a, covariance[1 : p + 1]))
        if variance <= 0:
            continue
        score = n * np.log(variance) + 2 * p * np.log(n)
        if score < best_score:
            best, best_score = NoiseModel(float(np.sqrt(variance)), tuple(float(v) for v in a)), score
    return best
