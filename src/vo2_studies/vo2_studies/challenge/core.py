"""Heat and phase, coupled: fourth-order Runge-Kutta for the heat flow, an event loop for the grains.

    tau dT1/dt = P - (T1 - T0)(1 + gamma s) - beta (T1 - T0) |T1 - T0|^(n-1) - tau L ds/dt
    tau2 dT2/dt = g P - T2,   T = T1 + T2

with P the heat input in kelvin. The latent heat is not a derivative here but a Stefan problem: on heating the
film stays at a grain's threshold until that grain has taken up its share of L, and gives it back on cooling.
Every coefficient's neutral value (see `Terms`) leaves the plain first-order device.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vo2_models.numerics.kernel import kernel

from vo2_studies.challenge.devices import ARRHENIUS, Device
from vo2_studies.challenge.domains import Domains

__all__ = ["Terms", "run_core"]

Array = NDArray[np.floating]
REVERSAL_THRESHOLD = 1.0
"""A reversal of the film temperature counts once it has turned by this [K]."""


class Terms(NamedTuple):
    """Coefficients of the coupled part; each default is neutral.

    cooling_ratio : time constant while cooling over that while heating [1]
    slow_gain, slow_time : second thermal mode, gain [1] and time constant [s]
    loss_beta, loss_power : additional loss -beta (T - T0)^n, beta [K^(1-n)], n [1]
    loss_phase : loss (1 + gamma s), gamma [1]
    latent : latent heat over heat capacity [K]
    heater_tcr : heater's temperature coefficient [1/K], Joule heater only
    sense_heating : temperature rise per ohm of film, I_s^2 over the heat conductance [K/ohm]
    joule, pumping : Peltier cooling K i - joule i^2 - pumping i (T - T0), joule [K/A^2], pumping [1/A]
    kinetic_time : tau_k of tau_k ds/dt = s_eq - s [s]
    training : shift of the thresholds per reversal [K]
    structure_offset : the structural transition sees T + this [K]
    feedback : the grains see T + kappa (s - 1/2), kappa [K]
    """

    cooling_ratio: float = 1.0
    slow_gain: float = 0.0
    slow_time: float = 1.0
    loss_beta: float = 0.0
    loss_power: float = 2.0
    loss_phase: float = 0.0
    latent: float = 0.0
    heater_tcr: float = 0.0
    sense_heating: float = 0.0
    joule: float = 0.0
    pumping: float = 0.0
    kinetic_time: float = 0.0
    training: float = 0.0
    structure_offset: float = 0.0
    feedback: float = 0.0


@kernel
def _set_level(level, state, place, up, up_grain, down, down_grain, weight, fraction):
    """Move the grains' input to `level`; return the new transformed fraction.

    `place[0]` counts the sorted `up` thresholds below the input, `place[1]` the `down` thresholds, so that a
    move costs only the thresholds it crosses.
    """
    n = up.size
    while place[0] < n and up[place[0]] <= level:
        grain = up_grain[place[0]]
        if state[grain] == 0:
            state[grain] = 1
            fraction += weight[grain]
        place[0] += 1
    while place[1] < n and down[place[1]] <= level:
        place[1] += 1
    while place[1] > 0 and down[place[1] - 1] > level:
        grain = down_grain[place[1] - 1]
        if state[grain] == 1:
            state[grain] = 0
            fraction -= weight[grain]
        place[1] -= 1
    while place[0] > 0 and up[place[0] - 1] > level:
        place[0] -= 1
    return fraction


@kernel
def _stefan(temperature, heat, shift, latent, state, place, up, up_grain, down, down_grain, weight, fraction):
    """Add `heat` [K] to the film, grain by grain; return temperature, fraction and heat owed to the next step."""
    before = fraction  # the shift may have moved since the last step: settle first
    fraction = _set_level(temperature + shift, state, place, up, up_grain, down, down_grain, weight, fraction)
    heat -= latent * (fraction - before)
    n = up.size
    while heat > 0 and place[0] < n and temperature + shift + heat >= up[place[0]]:
        heat -= max(up[place[0]] - shift - temperature, 0.0)
        temperature = max(up[place[0]] - shift, temperature)
        grain = up_grain[place[0]]
        place[0] += 1
        if state[grain] == 0:
            state[grain] = 1
            fraction += weight[grain]
            heat -= latent * weight[grain]
            if heat <= 0:
                return temperature, fraction, heat
    while heat < 0 and place[1] > 0 and temperature + shift + heat < down[place[1] - 1]:
        heat += max(temperature + shift - down[place[1] - 1], 0.0)
        temperature = min(down[place[1] - 1] - shift, temperature)
        grain = down_grain[place[1] - 1]
        place[1] -= 1
        if state[grain] == 1:
            state[grain] = 0
            fraction -= weight[grain]
            heat += latent * weight[grain]
            if heat >= 0:
                return temperature, fraction, heat
    temperature += heat
    fraction = _set_level(temperature + shift, state, place, up, up_grain, down, down_grain, weight, fraction)
    return temperature, fraction, 0.0


@kernel
def _rate(t1, power, ambient, tau, fraction, cooling_ratio, beta, exponent, gamma, tcr, squared, pump):
    """Return dT1/dt [K/s] without latent heat; `pump` is the Peltier's pumping times current [1]."""
    rise = t1 - ambient
    heat = power * (1 + tcr * rise) if squared else power - pump * rise
    loss = rise * (1 + gamma * fraction)
    if beta != 0.0:
        loss += beta * rise * abs(rise) ** (exponent - 1)
    slope = (heat - loss) / tau
    return slope / cooling_ratio if slope < 0 else slope


@kernel
def _core(
    current, ambient, local, step, tau, gain, squared, terms, film, start,
    up_m, up_m_grain, down_m, down_m_grain, up_s, up_s_grain, down_s, down_s_grain, weight,
):  # fmt: skip
    """Run the coupled part; see `run_core`."""
    n = current.size
    temperature = np.empty(n + 1)
    film_temperature = np.empty(n + 1)
    metal = np.empty(n + 1)
    structure = np.empty(n + 1)
    state_m = np.zeros(weight.size, dtype=np.uint8)
    state_s = np.zeros(weight.size, dtype=np.uint8)
    place_m = np.zeros(2, dtype=np.int64)
    place_s = np.zeros(2, dtype=np.int64)
    fraction_m = _set_level(start, state_m, place_m, up_m, up_m_grain, down_m, down_m_grain, weight, 0.0)
    fraction_s = _set_level(start, state_s, place_s, up_s, up_s_grain, down_s, down_s_grain, weight, 0.0)
    slow_m, slow_s = fraction_m, fraction_s
    t1, t2, owed = start, 0.0, 0.0
    extremum, direction, reversals = start, 1.0, 0.0
    kinetic = terms.kinetic_time > 0
    keep = np.exp(-step / terms.kinetic_time) if kinetic else 0.0
    temperature[0] = start
    film_temperature[0] = start + local[0] if n > 0 else start
    metal[0], structure[0] = fraction_m, fraction_s
    for k in range(n):
        i = current[k]
        power = gain * i * i if squared else gain * i + terms.joule * i * i
        if terms.sense_heating != 0.0:
            # film = activation over k_B ln 10, reference kelvin, log cold, log hot, metal slope, hot temperature
            kelvin = film_temperature[k] + 273.15
            semi = film[2] + film[0] * (1 / kelvin - 1 / film[1])
            metallic = film[3] + film[4] * (film_temperature[k] - film[5])
            power += terms.sense_heating * 10 ** ((1 - slow_m) * semi + slow_m * metallic)
        pump = terms.pumping * i
        tcr = terms.heater_tcr
        a = ambient[k]
        args = (power, a, tau, slow_m, terms.cooling_ratio, terms.loss_beta, terms.loss_power,
                terms.loss_phase, tcr, squared, pump)  # fmt: skip
        if terms.slow_gain != 0.0:
            fade = np.exp(-step / terms.slow_time)
            t2 = fade * t2 + (1 - fade) * terms.slow_gain * power
        shift_m = t2 + local[k] - terms.training * reversals + terms.feedback * (slow_m - 0.5)
        # Runge-Kutta does not see the grains stop the temperature within a step: shorter ones with latent heat
        inner = 4 if terms.latent != 0.0 and not kinetic else 1
        h = step / inner
        for _ in range(inner):
            k1 = _rate(t1, *args)
            k2 = _rate(t1 + h / 2 * k1, *args)
            k3 = _rate(t1 + h / 2 * k2, *args)
            k4 = _rate(t1 + h * k3, *args)
            heat = h / 6 * (k1 + 2 * k2 + 2 * k3 + k4) + owed
            owed = 0.0
            if inner > 1:
                t1, fraction_m, owed = _stefan(
                    t1, heat, shift_m, terms.latent, state_m, place_m, up_m, up_m_grain, down_m, down_m_grain,
                    weight, fraction_m,
                )  # fmt: skip
            else:
                t1 += heat
                fraction_m = _set_level(
                    t1 + shift_m, state_m, place_m, up_m, up_m_grain, down_m, down_m_grain, weight, fraction_m
                )
        shift_s = (
            t2 + local[k] - terms.training * reversals + terms.structure_offset
            + terms.feedback * (slow_s - 0.5)
        )  # fmt: skip
        fraction_s = _set_level(
            t1 + shift_s, state_s, place_s, up_s, up_s_grain, down_s, down_s_grain, weight, fraction_s
        )
        if kinetic:
            new_m = fraction_m + keep * (slow_m - fraction_m)
            t1 -= terms.latent * (new_m - slow_m)
            slow_m = new_m
            slow_s = fraction_s + keep * (slow_s - fraction_s)
        else:
            slow_m, slow_s = fraction_m, fraction_s
        total = t1 + t2
        turned = (extremum - total) * direction
        if turned < 0:
            extremum = total
        elif turned > REVERSAL_THRESHOLD:
            reversals += 1
            direction = -direction
            extremum = total
        temperature[k + 1] = total
        film_temperature[k + 1] = total + local[k]
        metal[k + 1], structure[k + 1] = slow_m, slow_s
    return temperature, film_temperature, metal, structure, reversals


def _sorted(domains: Domains) -> tuple[NDArray, ...]:
    """Return thresholds in rising order and the grain of each, for both transitions."""
    arrays: list[NDArray] = []
    for thresholds in (domains.up_metal, domains.down_metal, domains.up_structure, domains.down_structure):
        order = np.argsort(thresholds)
        arrays += [thresholds[order], order]
    return (*arrays, domains.weight)


def run_core(
    device: Device, terms: Terms, *, current: Array, ambient: Array, local: Array, step: float
) -> tuple[Array, Array, Array, Array, int]:
    """Run device temperature and phase from rest at ambient temperature, all grains cold.

    Parameters
    ----------
    device : the drawn device
    terms : coefficients of the effects
    current : heater current over each of n steps [A], constant within a step
    ambient : ambient temperature of each step [degC]
    local : film and cantilever above the heated body [K]
    step : length of a step [s]

    Returns
    -------
    temperature, film_temperature : (n + 1,) of the heated body and of the film [degC]; element 0 is the start
    metal, structure : (n + 1,) transformed fractions [1]
    reversals : counted reversals of the temperature
    """
    film = np.array(
        [
            device.activation / ARRHENIUS,
            device.cold_temperature + 273.15,
            device.log_cold,
            device.log_hot,
            device.metal_slope,
            device.hot_temperature,
        ]
    )
    temperature, film_temperature, metal, structure, reversals = _core(
        current, ambient, local, step, device.time_constant, device.gain, device.preset.squared,
        Terms(*map(float, terms)), film, float(device.ambient), *_sorted(device.domains),
    )  # fmt: skip
    return temperature, film_temperature, metal, structure, int(reversals)
