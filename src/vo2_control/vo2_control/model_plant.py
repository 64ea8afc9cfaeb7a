"""The sampled plant of a fitted model: not its thermal lag alone but all that is linear between the command and what is fed back.

The numbers come out of the simulation itself, so that an effect needs to be written down once only: its law is replaced by a
straight line, what is not linear is switched off, and the response to a small step is put into a state space.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from vo2_models.device.coefficients import Coefficient, blocks
from vo2_models.device.description import preset
from vo2_models.device.law_step import pack_law
from vo2_models.device.simulation import Simulation
from vo2_models.effects import effects
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

from vo2_control.sampled_loop import SampledPlant, ThermalLag

__all__ = ["linear_plant", "quasi_static"]

Floats = NDArray[np.float64]

_STRAIGHT = 1e-4
"""Slope per kelvin of the envelope that stands for a straight line: over the step its cube is nothing."""
_STEP = 0.01
"""Step, as a share of the operating range in the coordinate of the law."""
_TIMES, _FEWEST, _MOST = 8.0, 600, 10_000
"""Length of the response: multiples of the slowest time constant, and limits in samples."""
_LAGS = 120
"""Delays of the Hankel matrix, evenly on a logarithmic scale: a fast mode and a slow lag are both seen."""
_RANK = 1e-6
"""Singular value, relative to the largest, below which a state is none."""


def quasi_static(simulation: Simulation) -> Simulation:
    """Return the device without the lags, delays and modes that come behind or beside its body.

    Parameters
    ----------
    simulation : of the fitted model
    """
    return _with(simulation, [key for key in simulation.active() if not _is_linear_lag(key)], slow=False)


def linear_plant(
    simulation: Simulation, sample_period_s: float
) -> Callable[[ThermalLag], SampledPlant] | None:
    """Return what samples a lag together with all other linear dynamics of the model; None where there are none.

    What is fed back comes through the sensor of the resistance where the model has that, for the self-sensing starts there,
    else through that of the deflection. A mode of the structure counts in both cases, the deflection is what must not ring.

    Parameters
    ----------
    simulation : of the fitted model
    sample_period_s : [s]
    """
    nominal = preset(simulation.device)
    power = 2 if nominal.square_gain else 1
    cold, hot = (i**power for i in nominal.operating_range)
    middle = 0.5 * (cold + hot)
    travel = _STEP * (hot - cold)
    levels = np.array([middle, middle + travel]) ** (1 / power)
    straight = _straight(simulation, nominal.steady_temperature(levels[0]))
    lags = [key for key in straight.active() if _is_linear_lag(key)]
    if not lags and not simulation.coefficients[Coefficient.SLOW_SHARE]:
        return None
    own, alone = (_with(straight, keys, slow=slow) for keys, slow in ((lags, True), ([], False)))

    def sampled(lag: ThermalLag) -> SampledPlant:
        device = _of_lag(own, lag)
        count = int(np.clip(_TIMES * device.slowest_time() / sample_period_s, _FEWEST, _MOST))
        held, stepped = (_deflection(device, [levels[0], *[i] * count], sample_period_s) for i in levels)
        rest, moved = (_deflection(_of_lag(alone, lag), [i], sample_period_s)[0] for i in levels)
        response = lag.gain * (stepped - held) / (moved - rest)
        return _realised(np.diff(response), sample_period_s)

    return sampled


def _is_linear_lag(key: str) -> bool:
    """Whether an effect, by its key, is a linear process in time on the way to the deflection and its sensor."""
    block = blocks()[key]
    record = effects()[block.effect]
    if block.signal not in ("", TIP_DEFLECTION):
        return False
    if not {"delay", "follow"}.isdisjoint(record.hooks):
        return True
    return record.linear and bool(record.states) and record.stage in ("thermal", "structure", "sensor")


def _with(simulation: Simulation, keys: list[str], *, slow: bool) -> Simulation:
    """The device with these of its effects alone, and its second thermal path or not."""
    c = simulation.coefficients.copy()
    for key in simulation.active():
        if key not in keys:
            c[blocks()[key].active] = 0.0
    if not slow:
        c[Coefficient.SLOW_SHARE] = 0.0
    return replace(simulation, coefficients=c)


def _of_lag(simulation: Simulation, lag: ThermalLag) -> Simulation:
    c = simulation.coefficients.copy()
    c[Coefficient.TIME_CONSTANT], c[Coefficient.DEAD_TIME] = lag.time_constant_s, lag.dead_time_s
    return replace(simulation, coefficients=c)


def _straight(simulation: Simulation, centre: float) -> Simulation:
    """The device with a straight line for its law of the deflection; its sensor is that of the resistance where there is one."""
    one, slope, offset = 1.0 / _STRAIGHT, [_STRAIGHT], [-_STRAIGHT * centre]
    line = PlayBank(
        weights=[one], radii=[0.0], rising_slopes=slope, rising_offsets=offset, falling_slopes=slope, falling_offsets=offset
    )  # fmt: skip
    c = simulation.coefficients.copy()
    c[Coefficient.PLAY_LOW_D], c[Coefficient.PLAY_HIGH_D] = -one, one
    if simulation.has_resistance:
        for block in blocks().values():
            other = blocks().get(f"{block.effect}:{TIP_DEFLECTION}")
            if block.signal == RESISTANCE and other is not None:
                c[[other.active, *other.places.values()]] = c[[block.active, *block.places.values()]]
    packed = line.packed if simulation.packed_r.ndim == 1 else pack_law(line)
    return replace(simulation, coefficients=c, packed_d=packed, poly_d=np.zeros(1))


def _deflection(simulation: Simulation, current: list[float], period: float) -> Floats:
    return simulation.simulate(current, dt=period, noise=False, settled=True)[TIP_DEFLECTION]


def _realised(pulse: Floats, period: float) -> SampledPlant:
    """State space (Ho and Kalman) whose answer to a pulse is (n,), the first value one sample after the command."""
    half = pulse.size // 2
    at = np.unique(np.round(np.geomspace(1, half, _LAGS)).astype(int)) - 1
    places = at[:, None] + at
    left, size, right = np.linalg.svd(pulse[places])
    order = int(np.sum(size > _RANK * size[0]))
    root = np.sqrt(size[:order])
    left, right = left[:, :order] / root, right[:order].T / root
    a = left.T @ pulse[places + 1] @ right
    return SampledPlant(a, right[0] * size[:order], left[0] * size[:order], period)
