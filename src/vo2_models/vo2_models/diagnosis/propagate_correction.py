"""Carry a correction of the loop shape through everything behind the transitions.

The correction belongs to the film: it sees the temperature that the transition sees (with what effects add to
it), follows as late as the phase does, and passes terminals, structure and sensors. The compiled stages of
the device do that; nothing is written twice here. What acts behind the film leaves the film as it was: hypotheses
about terminals, structure and sensors share one simulation of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from vo2_models.device.borrow import borrow
from vo2_models.device.chain import _film_deflection, _sense, _structure, _terminal_resistance
from vo2_models.device.coefficients import BEHIND_FILM, CHANNELS, Sensor, neutral, sensor_index
from vo2_models.device.coefficients import Coefficient as C
from vo2_models.device.core import ENSEMBLE, _count_reversals, output_share
from vo2_models.device.mode import mode_step
from vo2_models.device.simulation import Simulation
from vo2_models.device.state import SENSOR_LINE
from vo2_models.device.state import Slot as S
from vo2_models.identification.enrichment import Correction
from vo2_models.numerics.kernel import kernel
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

__all__ = ["Film", "corrected_film", "film_alone", "propagate_correction", "through_structure"]

Floats = NDArray[np.float64]
_SLOTS = len(S)
_NEUTRAL = neutral()
_IDEAL_R, _IDEAL_D = (sensor_index(channel, Sensor.IDEAL) for channel in (RESISTANCE, TIP_DEFLECTION))
_BEHIND = np.array(
    [*BEHIND_FILM, *(sensor_index(channel, k) for channel in (RESISTANCE, TIP_DEFLECTION) for k in Sensor)]
)


@dataclass(frozen=True)
class Film:
    """A corrected film in one recording: everything that terminals, structure and sensors look at.

    Attributes
    ----------
    out : (n, 9) of `Simulation.run`
    rest : (9,) the same at rest without current
    added, added_at_rest : (n, 2), (2,) corrections of log10 R and of the deflection [m]
    """

    out: Floats
    rest: Floats
    added: Floats
    added_at_rest: Floats


def film_alone(coefficients: Floats) -> Floats:
    """The coefficients that decide a `Film`: those of terminals, structure and the two film sensors are neutral."""
    c = coefficients.copy()
    c[_BEHIND] = _NEUTRAL[_BEHIND]
    return c


def corrected_film(
    simulation: Simulation, out: Floats, dt: float, corrections: Mapping[str, Correction]
) -> Film:
    """Return the film behind `out` (n, 9) of `Simulation.run`, with corrections.

    Parameters
    ----------
    simulation : with effects
    out : as `Simulation.run` gave it
    dt : sample period [s]
    corrections : channel -> correction (of log10 R, and of the deflection [m])
    """
    c, _ = simulation.prepared(dt)
    rest = simulation.run(np.zeros(1), dt=dt)[0]
    seen = np.empty((out.shape[0], 2))
    _seen_temperature(
        simulation.kind, c, simulation.packed_r, simulation.packed_d, np.ascontiguousarray(out), seen
    )
    added = np.zeros((out.shape[0], 2))
    at_rest = np.zeros(2)
    for place, channel in enumerate((RESISTANCE, TIP_DEFLECTION)):
        if channel in corrections:
            path = np.concatenate([rest[5:6], seen[:, place]])
            values = corrections[channel](path)
            added[:, place] = _late(values, float(c[C.KINETICS]), dt)[1:]
            at_rest[place] = values[0]
    return Film(out, rest, added, at_rest)


def propagate_correction(simulation: Simulation, film: Film, dt: float, *, every: int = 1) -> Floats:
    """Return what `Simulation.run` would give with this film; noise is not added.

    Parameters
    ----------
    simulation : with effects
    film : of m samples, from `corrected_film`
    dt : sample period of the film [s]
    every : of so many samples only the last is returned

    Returns
    -------
    (m // every, 9) columns as `chain.COLUMNS` describes

    Raises
    ------
    ValueError : a delay does not fit its line at this sample period.
    """
    c, mode = simulation.prepared(dt)
    result = film.out[every - 1 :: every].copy()
    _finish(
        simulation.kind, c, mode, simulation.poly_d, dt, film.rest, film.added_at_rest, film.added, film.out,
        np.zeros(_SLOTS), np.zeros((len(CHANNELS), 3)), np.zeros((len(CHANNELS), SENSOR_LINE)), every, result,
    )  # fmt: skip
    return result


def through_structure(simulation: Simulation, columns: Floats, dt: float) -> Floats:
    """Return deflections (n, k) [m] as they are behind the structure: a creeping one, or one with a mode, keeps them on.

    Parameters
    ----------
    simulation : with effects
    columns : (n, k) one deflection a column, from a long rest [m]
    dt : sample period [s]
    """
    c, _ = simulation.prepared(dt)
    if c[C.CREEP] == 0.0 and c[C.MODE_SHARE] == 0.0:
        return columns
    # a column turns too often from sample to sample to go the way of the heat in between: straight is nearer
    mode = mode_step(c[C.MODE_FREQUENCY], c[C.MODE_DAMPING], dt)
    out = np.ascontiguousarray(columns.T)
    _behind_structure(c, mode, dt, out)
    return np.ascontiguousarray(out.T)


def _late(values: Floats, constant: float, dt: float) -> Floats:
    """First-order lag, exact for values that move linearly between samples."""
    if constant <= 0.0:
        return values
    left = np.exp(-dt / constant)
    ramp = (1.0 - left) * constant / dt
    steps = np.diff(values, prepend=values[:1])
    # gap between the follower and its target: g_k = left g_(k-1) - ramp step_k
    gap = lfilter([-ramp], [1.0, -left], steps)
    return np.asarray(values + gap)


@kernel(nogil=True)
def _seen_temperature(kind, c, packed_r, packed_d, out, seen):
    """What each transition sees: film temperature plus training, incongruency and structural offset."""
    x = np.zeros(_SLOTS)
    x[S.TURN] = out[0, 5]
    for k in range(out.shape[0]):
        value = out[k, 5]
        if c[C.TRAINING] != 0.0:
            _count_reversals(c, x, value)
            value += c[C.TRAINING] * x[S.REVERSALS]
        seen[k, 0] = value
        seen[k, 1] = value + c[C.TRANSITION_OFFSET]
        if c[C.INCONGRUENCY] != 0.0:
            for which in range(2):
                if kind == ENSEMBLE or (packed_d[0] if which == 1 else packed_r[0]) > 0.0:
                    seen[k, which] += c[C.INCONGRUENCY] * (
                        output_share(kind, which, out[k, 7 + which], c) - 0.5
                    )


@kernel(nogil=True)
def _behind_structure(c, mode, period, series):
    """Replace each deflection (k, n) by what the structure makes of it."""
    for j in range(series.shape[0]):
        x = np.zeros(_SLOTS)
        x[S.CREPT] = series[j, 0]
        x[S.MODE] = series[j, 0]
        x[S.MODE_INPUT] = series[j, 0]
        for k in range(series.shape[1]):
            series[j, k] = _structure(c, x, mode, series[j, k], period)


@kernel(nogil=True)
def _finish(kind, c, mode, poly_d, period, rest, at_rest, film, out, x, sensors, lines, every, result):
    """Terminals, structure and sensors of both channels, once more, on the corrected film."""
    c, mode, poly_d, film, out, result = (
        borrow(c),
        borrow(mode),
        borrow(poly_d),
        borrow(film),
        borrow(out),
        borrow(result),
    )
    x, sensors, lines = borrow(x), borrow(sensors), borrow(lines)
    x[S.FILM] = rest[5]
    x[S.OUT_D] = rest[8] + at_rest[1]
    still = _film_deflection(kind, c, x, poly_d)
    x[S.CREPT] = still
    x[S.MODE] = still
    x[S.MODE_INPUT] = still
    sensors[1, 0] = _terminal_resistance(c, x, rest[6] * 10.0 ** at_rest[0], 0.0)
    sensors[2, 0] = still
    sensors[:, 2] = sensors[:, 0]
    lines[1, :] = sensors[1, 0]
    lines[2, :] = sensors[2, 0]
    for k in range(out.shape[0]):
        x[S.FILM] = out[k, 5]
        x[S.OUT_D] = out[k, 8] + film[k, 1]
        resistance = out[k, 6] * 10.0 ** min(max(film[k, 0], -30.0), 30.0)
        tip = _structure(c, x, mode, _film_deflection(kind, c, x, poly_d), period)
        terminal = _terminal_resistance(c, x, resistance, out[k, 0])
        if c[_IDEAL_R] == 0.0:
            terminal = _sense(c, 1, terminal, 0.0, k * period, period, k, sensors, lines)
        if c[_IDEAL_D] == 0.0:
            tip = _sense(c, 2, tip, 0.0, k * period, period, k, sensors, lines)
        if (k + 1) % every == 0:
            result[k // every, 1] = terminal
            result[k // every, 2] = tip


assert CHANNELS[1:3] == (RESISTANCE, TIP_DEFLECTION)
