"""Carry a correction of the loop shape through everything behind the transitions.

The correction belongs to the film: it sees the temperature that the transition sees (with what effects add to
it), follows as late as the phase does, and passes terminals, structure and sensors. The compiled stages of
the device do that; nothing is written twice here. What acts behind the film leaves the film as it was: hypotheses
about terminals, structure and sensors share one simulation of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.assembly import state_size
from vo2_models.device.chain import (
    finish_film,
    late_correction,
    see_film,
    through_linear_structure,
    through_sensor,
)
from vo2_models.device.coefficients import CHANNELS, Sensor, blocks, neutral, sensor_index
from vo2_models.device.simulation import Simulation
from vo2_models.effects import effects
from vo2_models.identification.enrichment import Correction
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

__all__ = ["BEHIND_FILM", "Film", "as_sensed", "corrected_film", "film_alone", "propagate_correction"]

Floats = NDArray[np.float64]
BEHIND_FILM = ("terminals", "structure", "sensor")
"""Stages that the film does not feel."""
SMALL = 1e-5
"""Step of a derivative of a sensor that is not linear, as a share of what it is given."""
_FILM_CHANNELS = (RESISTANCE, TIP_DEFLECTION)


@cache
def _behind_film() -> tuple[NDArray[np.intp], Floats]:
    """Places, and neutral values, of what the film does not feel: terminals, structure and the two film sensors."""
    places = [sensor_index(channel, k) for channel in _FILM_CHANNELS for k in Sensor]
    for block in blocks().values():
        stage = effects()[block.effect].stage
        if stage in ("terminals", "structure") or (stage == "sensor" and block.signal in _FILM_CHANNELS):
            places += [block.active, *block.places.values()]
    where = np.array(places, dtype=np.intp)
    return where, neutral()[where]


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

    def resting_until(self, sample: int) -> Film:
        """The film from a sample (at least 1) on, taken for at rest as it was at the sample before."""
        last = sample - 1
        return Film(self.out[sample:], self.out[last], self.added[sample:], self.added[last])


def film_alone(coefficients: Floats) -> Floats:
    """Return the coefficients that decide a `Film`: those of terminals, structure and the two film sensors are neutral.

    Parameters
    ----------
    coefficients : (n,) of a device, as `Coefficient` numbers them
    """
    c = coefficients.copy()
    places, values = _behind_film()
    c[places] = values
    return c


def corrected_film(
    simulation: Simulation,
    out: Floats,
    dt: float,
    corrections: Mapping[str, Correction],
    *,
    from_rest: bool = True,
) -> Film:
    """Return the film behind `out` (n, 9) of `Simulation.run`, with corrections.

    Parameters
    ----------
    simulation : with effects
    out : as `Simulation.run` gave it
    dt : sample period [s]
    corrections : channel -> correction (of log10 R, and of the deflection [m])
    from_rest : whether the loops remember the rest without drive; else they know nothing of what was before `out`
    """
    c = simulation.prepared(dt)
    rest = simulation.run(np.zeros(1), dt=dt)[0]
    seen = np.empty((out.shape[0], 2))
    present = np.array([simulation.has_resistance, simulation.has_deflection], dtype=np.float64)
    see_film(simulation.kind, c, np.zeros(state_size()), present, np.ascontiguousarray(out), seen)
    added = np.zeros((out.shape[0], 2))
    at_rest = np.zeros(2)
    for place, channel in enumerate(_FILM_CHANNELS):
        if channel in corrections:
            values = corrections[channel](np.concatenate([rest[5:6], seen[:, place]]))
            at_rest[place] = values[0]
            if not from_rest:
                values[1:] = corrections[channel](seen[:, place])
            late_correction(c, np.zeros(state_size()), values)
            added[:, place] = values[1:]
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
    c = simulation.prepared(dt)
    result = film.out[every - 1 :: every].copy()
    finish_film(
        simulation.kind, c, np.zeros(state_size()), simulation.packed_r, simulation.packed_d, simulation.poly_d,
        film.rest, film.added_at_rest, film.added, film.out, every, result,
    )  # fmt: skip
    return result


def as_sensed(
    simulation: Simulation, channel: str, columns: Floats, dt: float, film: Floats | None = None
) -> Floats:
    """Return changes (n, k) of the film as its channel shows them: a late or slow sensor shows them late or slowly.

    Behind a sensor that is not linear they are small changes about `film`. A structure counts where it is linear; behind
    another one a change stays as it is.

    Parameters
    ----------
    simulation : with effects
    channel : resistance, in log10 ohm, or deflection [m]
    columns : (n, k) one change a column, from a long rest
    dt : sample period [s]
    film : (n,) what the sensor is given, for a resistance, in log10 ohm, and for a sensor that is not linear; of a resistance
        d log10 S[R] = S[R d log10 R] / S[R]
    """
    columns = _late(simulation, columns, dt)
    if channel == TIP_DEFLECTION:
        columns = _through_structure(simulation, columns, dt)
    records = [effects()[key.partition(":")[0]] for key in simulation.active() if key.endswith(f":{channel}")]
    linear = all(record.linear for record in records)
    if not records or (film is None and not linear):
        return columns
    c, place = simulation.prepared(dt, straight=True), CHANNELS.index(channel)

    def sensed(series: Floats) -> Floats:
        out = np.array(series.T, order="C")
        through_sensor(c, np.zeros(state_size()), place, out)
        return np.ascontiguousarray(out.T)

    if film is None or (linear and channel != RESISTANCE):
        return sensed(columns)
    level = film[:, None]
    if channel == RESISTANCE:
        level = 10.0**level
        columns = level * columns
    if linear:
        changed = sensed(columns)
    else:
        step = SMALL * np.ptp(level) / np.maximum(np.max(np.abs(columns), axis=0), 1e-300)
        changed = (sensed(level + step * columns) - sensed(level - step * columns)) / (2.0 * step)
    return changed / sensed(level) if channel == RESISTANCE else changed


def _late(simulation: Simulation, columns: Floats, dt: float) -> Floats:
    """Changes (n, k) of a transition's equilibrium as they are in its output, which may follow late."""
    if not any("follow" in effects()[key.partition(":")[0]].hooks for key in simulation.active()):
        return columns
    c = simulation.prepared(dt)
    out = np.array(columns.T, order="C")
    for series in out:
        late_correction(c, np.zeros(state_size()), series)
    return np.ascontiguousarray(out.T)


def _through_structure(simulation: Simulation, columns: Floats, dt: float) -> Floats:
    """Deflections (n, k) [m] as they are behind the structure: a creeping one, or one with a mode, keeps them on."""
    if not any(effects()[key].stage == "structure" for key in simulation.active() if ":" not in key):
        return columns
    # a column turns too often from sample to sample to go the way of the heat in between: straight is nearer
    c = simulation.prepared(dt, straight=True)
    out = np.array(columns.T, order="C")
    through_linear_structure(c, np.zeros(state_size()), out)
    return np.ascontiguousarray(out.T)
