"""How a rig's loop follows its drive in time and sense, chosen by what predicts held-out parts of the calibration.

The drive is laid over the loop coordinate, delayed or followed with one lag or two, and given to a convex fit of plays, of
which what has hysteresis may follow with a lag of its own while the memoryless part does not (`transition_kinetics`), or
behind which all that moves may ring (`cantilever_resonance`). The
sense (which end of the drive is the lower saturation), the lags or the delay, the mode, and the degree of the memoryless part
are those with the smallest error on blocks that the fit was not given; what is more complicated must be better by a margin.
Whether the drive heats, and heats the film itself, is `rig_heat`'s.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.signal import lfilter, lfilter_zi

from vo2_models.device.description import DeviceDescription
from vo2_models.device.mode import mode_step
from vo2_models.device.simulation import AT_ONCE
from vo2_models.effects import effects
from vo2_models.identification.bank_fit import Late
from vo2_models.identification.grid import GriddedRecording
from vo2_models.identification.noise import residual_colour
from vo2_models.identification.play_dictionary import DictionaryFit, PlayDictionary, fit_dictionary
from vo2_models.recording import TIP_DEFLECTION

__all__ = [
    "DAMPED",
    "FASTEST",
    "LAGS",
    "RigDynamics",
    "after",
    "choose_dynamics",
    "loop_path",
    "relaxing",
    "ringing",
    "sensing",
]

Floats = NDArray[np.float64]
COLD = -300.0
"""Loop coordinate put before each recording, which brings every play to its lower saturation."""
DEGREES = (1, 3)
_MARGIN = 0.98
"""A lag, a delay or a higher degree must lower the held-out error to this share of what does without it."""
_RELAXED = 0.8
"""The same for loops that relax: it is another kind of model, and it smooths what a grid of plays makes of a sharp loop. And for
a mode, which has two numbers to fit."""
_PERIODS, _DAMPINGS = (3.0, 6.0, 12.0, 24.0, 48.0), (0.05, 0.3)
"""Periods of a mode, in sample periods, and damping ratios tried first, beside those that the residual shows."""
FASTEST = 2.2
"""Shortest period of a mode, in sample periods: about what sampling can show."""
_SEEN = 0.95
"""Share of the held-out error of what is simpler, with coarse plays, from which a mode is looked for more closely."""
DAMPED, _LEAST_LAG = (1e-3, 1.0), 0.1
"""Damping ratios of a mode, and the shortest lag beside it in sample periods."""
_POLES, _MODE_STEPS = 8, 60
"""Order of the autoregression whose poles are tried, and evaluations of the search."""
LAGS = 2.0 ** np.arange(-1, 9)
_DELAYS = (1, 2, 3, 4, 6, 8, 12, 16)
"""Lags and delays tried first, in sample periods."""
_SIGNED = 0.7
"""The same for weights of either sign, by which a response is told that turns within the loop."""
_CLOSE = 0.01
"""Relative accuracy of a lag [1]."""
_PATIENCE = 3
"""Longer lags are left out once as many in a row were no better than the best: the error has one minimum, or two close by."""
_USUAL, _TOLD = 110, 10
"""Fits that a choice takes, about, and those from one word about progress to the next."""
_COARSE, _FINE = {"centres": 12, "widths": 7}, {"centres": 20, "widths": 10}
_SAMPLES = 2500


@dataclass(frozen=True)
class RigDynamics:
    """How the loop follows the drive.

    Attributes
    ----------
    falling : whether the lower saturation is at the upper end of the drive
    lag, delay, relaxation : [s], of the drive, of the drive, of what has hysteresis behind it, which has no delay and no
        lag of the drive besides
    behind : lag of the sensor behind the loops [s]
    frequency, damping : of a mode behind the loops of what moves [Hz, 1], 0 where there is none
    held : whether the drive is held over a sample, so that what is behind the loops is given what follows with `lag` after a
        jump; else it goes straight from sample to sample
    slow_share, slow : part of what the drive does that arrives through a second, slower lag [1], and that lag [s]
    degree : of the memoryless part
    score : sum over the responses of the logarithm of the held-out error
    near : others that plays on a grid cannot tell from it for certain, such as a lag with and without a delay of a sample
    """

    falling: bool = False
    lag: float = 0.0
    delay: float = 0.0
    relaxation: float = 0.0
    behind: float = 0.0
    frequency: float = 0.0
    damping: float = 0.0
    held: bool = False
    slow_share: float = 0.0
    slow: float = 0.0
    degree: int = DEGREES[0]
    score: float = np.inf
    near: tuple[RigDynamics, ...] = ()


def loop_path(grids: Sequence[GriddedRecording], device: DeviceDescription, dynamics: RigDynamics) -> Floats:
    """Loop coordinate along all recordings one behind the other, each settled at its first drive and preceded by `COLD`.

    Parameters
    ----------
    grids : recordings in roles
    device : completed description
    dynamics : sense, and lag or delay

    Returns
    -------
    array : (n,) loop coordinate [degC]
    """
    low, high = sorted(device.operating_range)
    ends = sorted(device.steady_temperature(v) for v in (low, high))
    parts = []
    for grid in grids:
        share = (grid.current - low) / (high - low)
        u = ends[0] + (ends[1] - ends[0]) * (1.0 - share if dynamics.falling else share)
        if dynamics.delay:
            # between samples the chain's delay takes the mean of the held drive: linear between neighbours
            at = np.arange(u.size) - dynamics.delay / grid.dt
            u = np.interp(at, np.arange(u.size), u)
        parts += [np.array([COLD]), after(u, dynamics, grid.dt, float(u[0]))]
    return np.concatenate(parts)


def after(u: Floats, dynamics: RigDynamics, dt: float, start: float) -> Floats:
    """Return what comes of u (n,) behind both lags: (1 - share) L1 u + share L2 u, each tau dx/dt = u - x, u held.

    Parameters
    ----------
    u : (n,) value during the interval that ends at each sample
    dynamics : lags and share
    dt : [s]
    start : value before the first sample, at which both rest
    """

    def lagged(lag: float) -> Floats:
        if not lag:
            return u
        keep = np.exp(-dt / lag)
        return np.asarray(lfilter([1.0 - keep], [1.0, -keep], u, zi=[keep * start])[0])

    share = dynamics.slow_share
    return (
        (1.0 - share) * lagged(dynamics.lag) + share * lagged(dynamics.slow)
        if share
        else lagged(dynamics.lag)
    )


def relaxing(
    grids: Sequence[GriddedRecording], device: DeviceDescription, dynamics: RigDynamics
) -> Late | None:
    """Return what plays along `loop_path` go through where they relax: tau ds/dt = s_eq - s; None where they do not.

    As `transition_kinetics` does in the simulation: within a sample period s_eq goes as the loop coordinate does behind a
    held drive, s_eq = e1 + (e0 - e1) exp(-t / tau_0), with tau_0 the lag of the drive or the device's own. Each recording
    begins settled.

    Parameters
    ----------
    grids : recordings, m samples together
    device : completed description
    dynamics : with the time constant tau [s]

    Returns
    -------
    of (m + recordings, k) outputs of plays, one row before each recording, or None
    """
    tau = dynamics.relaxation
    if not tau:
        return None
    first = dynamics.lag or device.time_constant
    if abs(first - tau) < 1e-6 * tau:  # the two terms below go over into one
        first = tau * (1.0 + 1e-6)

    def step(dt: float) -> tuple[Floats, Floats]:
        left = np.exp(-dt / tau)
        before = first / (first - tau) * (np.exp(-dt / first) - left)
        return np.array([1.0 - left - before, before]), np.array([1.0, -left])

    return Late(_filtered(grids, step))


def ringing(grids: Sequence[GriddedRecording], dynamics: RigDynamics) -> Late | None:
    """Return what all of a response along `loop_path` goes through where it rings: z'' + 2 zeta w z' + w^2 z = w^2 D.

    As `cantilever_resonance` does on a device without body: between samples D goes straight, or as a held drive behind its
    lag does. Each recording begins at rest.

    Parameters
    ----------
    grids : recordings, m samples together
    dynamics : with frequency and damping

    Returns
    -------
    of (m + recordings, k) columns, one row before each recording, or None
    """
    if not dynamics.frequency:
        return None

    def step(dt: float) -> tuple[Floats, Floats]:
        (zz, zr, zl, zn), (rz, rr, rl, rn) = mode_step(
            dynamics.frequency, dynamics.damping, dt, time_constant=_between(dynamics, dt)
        )
        gone = np.array([1.0, -(zz + rr), zz * rr - zr * rz])
        return np.array([zn, zl - rr * zn + zr * rn, zr * rl - rr * zl]), gone

    return Late(_filtered(grids, step), whole=True)


def sensing(grids: Sequence[GriddedRecording], dynamics: RigDynamics) -> Late | None:
    """Return what all of a response along `loop_path` goes through where its sensor lags: tau dz/dt = y - z.

    As `sensor_lag` does on a device without body: between samples y goes straight, or as a held drive behind its lag does.
    Each recording begins at rest.

    Parameters
    ----------
    grids : recordings, m samples together
    dynamics : with the time constant tau [s]

    Returns
    -------
    of (m + recordings, k) columns, one row before each recording, or None
    """
    if not dynamics.behind:
        return None
    sensor = effects()["sensor_lag"].hooks["advance"]

    def step(dt: float) -> tuple[Floats, Floats]:
        # linear: what of its own value and what of the sample before is left
        left, old = (
            sensor(0.0, dt, _between(dynamics, dt), *last, dynamics.behind, 0.0)[0]
            for last in ((1.0, 0.0), (0.0, 1.0))
        )
        return np.array([1.0 - left - old, old]), np.array([1.0, -left])

    return Late(_filtered(grids, step), whole=True)


def _between(dynamics: RigDynamics, dt: float) -> float:
    """Time constant with which a response moves on between two samples [s], inf where it goes straight."""
    return max(dynamics.lag, AT_ONCE * dt) if dynamics.held else math.inf


def _filtered(
    grids: Sequence[GriddedRecording], step: Callable[[float], tuple[Floats, Floats]]
) -> Callable[[Floats], Floats]:
    """Columns behind a filter of gain 1, whose coefficients `step` gives for a sample period, each recording from rest."""

    def through(columns: Floats) -> Floats:
        out, begin = columns.copy(), 0
        for grid in grids:
            own = slice(begin + 1, begin + 1 + grid.current.size)
            ahead, back = step(grid.dt)
            rest = lfilter_zi(ahead, back)[:, None] * columns[begin + 1 : begin + 2]
            out[own], _ = lfilter(ahead, back, columns[own], axis=0, zi=rest)
            begin = own.stop
        return out

    return through


def choose_dynamics(
    grids: Sequence[GriddedRecording],
    device: DeviceDescription,
    values: Mapping[str, Floats],
    *,
    rates: bool = True,
    relaxes: bool = True,
    progress: Callable[[float], None] | None = None,
) -> RigDynamics:
    """Return sense, lag, delay or relaxation, and degree with the smallest held-out error.

    Parameters
    ----------
    grids : recordings
    device : without body
    values : role -> (n,) judged values along `loop_path`, NaN where missing
    rates : whether the drive has different rates; at one rate a lag is a wider loop, and none is looked for
    relaxes : whether what has hysteresis may relax; only plays are fitted behind that
    progress : called with the share done, 0 to 1
    """
    count = itertools.count(1)
    low, high = sorted(device.steady_temperature(v) for v in device.operating_range)
    signed = False
    coarse, sharp = (PlayDictionary.over(low, high, **grid) for grid in (_COARSE, _FINE))
    plays = coarse

    def tried(dynamics: RigDynamics, of: PlayDictionary | None = None) -> RigDynamics:
        fits = fitted(dynamics, of or plays).values()
        done = next(count)
        if progress and done % _TOLD == 0:
            progress(min(done / _USUAL, 1.0))
        return replace(dynamics, score=float(sum(np.log(max(fit.misfit, 1e-300)) for fit in fits)))

    def fitted(dynamics: RigDynamics, plays: PlayDictionary) -> dict[str, DictionaryFit]:
        path, late = loop_path(grids, device, dynamics), relaxing(grids, device, dynamics)
        rings = ringing(grids, dynamics)
        return {
            role: fit_dictionary(
                plays, path, y, degree=dynamics.degree, most=_SAMPLES,
                late=rings if role == TIP_DEFLECTION and rings else late, signed=signed,
            )
            for role, y in values.items()
        }  # fmt: skip

    def mode() -> RigDynamics:
        """The best of what a mode makes of `found` with a lag: a converter holds the drive, an amplifier is slow.

        It is `found` itself where coarse plays see no mode.
        """
        at_once = fitted(found, plays)[TIP_DEFLECTION]
        left = at_once.residual(loop_path(grids, device, found), values[TIP_DEFLECTION])
        slowest = 0.1 * longest * dt
        starts = [
            (frequency, damping)
            for frequency, damping in (
                *_modes_of(left, dt),
                *itertools.product((1.0 / (k * dt) for k in _PERIODS), _DAMPINGS),
            )
            if frequency * slowest > 1.0
        ]
        first = min(
            (
                tried(replace(found, frequency=f, damping=z, lag=dt, delay=delay), coarse)
                for f, z in starts
                for delay in (0.0, dt)
            ),
            key=lambda one: one.score,
        )

        if first.score > tried(simple, coarse).score + len(values) * np.log(_SEEN):
            return found

        def of(vector: Floats, held: bool) -> RigDynamics:
            f, z, lag = np.exp(vector)
            return replace(
                first,
                held=held,
                frequency=float(min(f, 1.0 / (FASTEST * dt))),
                damping=float(np.clip(z, *DAMPED)),
                lag=float(np.clip(lag, _LEAST_LAG * dt, LAGS[-1] * dt)),
            )

        def sought(held: bool) -> RigDynamics:
            start = np.log([first.frequency, first.damping, first.lag])
            least = minimize(
                lambda vector: tried(of(vector, held)).score, start, method="Nelder-Mead",
                options={"maxfev": _MODE_STEPS, "initial_simplex": start + np.diag([0.0, 0.1, 0.5, -0.7])[:, 1:]},
            )  # fmt: skip
            return tried(of(least.x, held))

        return best(sought(False), [sought(True)])

    def best(simple: RigDynamics, others: Sequence[RigDynamics], margin: float = _MARGIN) -> RigDynamics:
        better, since = simple, 0
        for one in map(tried, others):
            better, since = (one, 0) if one.score < better.score else (better, since + 1)
            if since == _PATIENCE:
                break
        return better if better.score < simple.score + len(values) * np.log(margin) else simple

    def slow(about: RigDynamics, of: Callable[[float], RigDynamics]) -> RigDynamics:
        """The best of what a lag makes of `about`, which may be none."""
        start = best(about, [of(lag) for lag in lengths])
        if start is about:
            return about
        ends = np.log(max(start.lag, start.relaxation)) + np.array([-1.0, 1.0]) * np.log(LAGS[1] / LAGS[0])
        least = minimize_scalar(
            lambda logarithm: tried(of(float(np.exp(logarithm)))).score,
            bounds=ends, method="bounded", options={"xatol": _CLOSE},
        )  # fmt: skip
        return min(start, tried(of(float(np.exp(least.x)))), key=lambda one: one.score)

    dt, longest = grids[0].dt, max(grid.current.size for grid in grids)
    lengths = [k * dt for k in LAGS if k < 0.1 * longest] if rates else []
    # the sense of a loop that lags shows only behind a lag: without one the way there may look like the way back
    either = [RigDynamics(falling=way, lag=lag) for way in (False, True) for lag in (0.0, *lengths[::3])]
    way = min((tried(one) for one in either), key=lambda one: one.score).falling
    found = tried(RigDynamics(falling=way))
    found = best(found, [replace(found, degree=degree) for degree in DEGREES if degree != found.degree])
    if not rates:
        return found
    # coarse plays leave more of a sharp loop than a lag does
    plays = sharp
    found = tried(found)
    signed = True
    mixed = tried(found)
    signed = mixed.score < found.score + len(values) * np.log(_SIGNED)
    found = mixed if signed else found
    delays = [replace(found, delay=k * dt) for k in _DELAYS if k < 0.1 * longest]
    lagging, late = slow(found, lambda lag: replace(found, lag=lag)), best(found, delays)
    simple = min(lagging, late, key=lambda one: one.score)
    # a drive that is logged as it is set acts from the next sample on, and its lag begins there
    if lagging.lag:
        delayed = tried(replace(found, delay=dt))
        both = (lagging, slow(delayed, lambda lag: replace(delayed, lag=lag)))
        simple = best(simple, both[1:])
        if simple in both:
            simple = replace(simple, near=tuple(one for one in both if one is not simple))
    another = []
    if relaxes and not signed:
        another.append(slow(found, lambda lag: replace(found, relaxation=lag)))
    if TIP_DEFLECTION in values and 0.1 * longest > _PERIODS[0]:
        another.append(mode())
    return best(simple, another, _RELAXED)


def _modes_of(left: Floats, dt: float) -> list[tuple[float, float]]:
    """Frequency [Hz] and damping of what a residual (n,) rings with: the poles of its autoregression that turn."""
    colour = np.array(residual_colour(left, _POLES))
    poles = np.log(np.roots(np.r_[1.0, -colour]).astype(np.complex128))
    turning = poles[(poles.imag > 0.0) & (poles.imag < 2.0 * np.pi / FASTEST) & (poles.real < 0.0)]
    return [(abs(p) / (2.0 * np.pi * dt), float(-p.real / abs(p))) for p in turning]
