"""Heat and phase, coupled: fourth-order Runge-Kutta for the heat flow, the family's law for the film.

    tau dT1/dt = P - (T1 - T0)(1 + gamma s) - beta (T1 - T0) |T1 - T0|^(n-1) - tau L ds/dt
    tau2 dT2/dt = g P - T2,   T = T1 + T2

with P the heat input in kelvin. The latent heat is not a derivative here but shared out within each step by the law
(`families.law.absorb`). Every coefficient's neutral value (see `Terms`) leaves the plain first-order device.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vo2_models.numerics.kernel import kernel

from vo2_studies.challenge.devices import ARRHENIUS, Device
from vo2_studies.challenge.families.law import absorb, advance, settle

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
    overdrive, overdrive_rate : grains switch behind T by overdrive ln(1 + |dT/dt| / overdrive_rate) [K], [K/s]
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
    overdrive: float = 0.0
    overdrive_rate: float = 1.0


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
    current, ambient, local, shift, step, tau, gain, squared, terms, film, start, law_m, law_s, feedback
):
    """Run the coupled part; see `run_core`."""
    n = current.size
    temperature = np.empty(n + 1)
    film_temperature = np.empty(n + 1)
    metal = np.empty(n + 1)
    structure = np.empty(n + 1)
    memory_m = settle(law_m, start)
    memory_s = settle(law_s, start)
    slow_m, slow_s = memory_m[0], memory_s[0]
    t1, t2, owed = start, 0.0, 0.0
    last, behind = start, 0.0
    extremum, direction, reversals = start, 1.0, 0.0
    kinetic = terms.kinetic_time > 0
    keep = np.exp(-step / terms.kinetic_time) if kinetic else 0.0
    temperature[0] = start
    film_temperature[0] = start + local[0] if n > 0 else start
    metal[0], structure[0] = slow_m, slow_s
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
        common = t2 + local[k] + shift[k] - terms.training * reversals - behind
        shift_m = common + feedback * (slow_m - 0.5)
        # Runge-Kutta does not see the film stop the temperature within a step: shorter ones with latent heat
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
                t1, owed = absorb(law_m, memory_m, t1, shift_m, heat, terms.latent, h)
            else:
                t1 += heat
                advance(law_m, memory_m, t1 + shift_m, h)
        advance(law_s, memory_s, t1 + common + terms.structure_offset + feedback * (slow_s - 0.5), step)
        if kinetic:
            new_m = memory_m[0] + keep * (slow_m - memory_m[0])
            t1 -= terms.latent * (new_m - slow_m)
            slow_m = new_m
            slow_s = memory_s[0] + keep * (slow_s - memory_s[0])
        else:
            slow_m, slow_s = memory_m[0], memory_s[0]
        total = t1 + t2
        if terms.overdrive != 0.0:
            # what they see waits at a reversal until the temperature has come past it by the overdrive
            behind += total - last
            most = terms.overdrive * np.log(1 + abs(total - last) / step / terms.overdrive_rate)
            behind = min(behind, most) if total >= last else max(behind, -most)
            last = total
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


def run_core(
    device: Device, terms: Terms, *, current: Array, ambient: Array, local: Array, shift: Array, step: float
) -> tuple[Array, Array, Array, Array, int]:
    """Run device temperature and phase from rest at ambient temperature, reached from the cold.

    Parameters
    ----------
    device : the drawn device
    terms : coefficients of the effects
    current : heater current over each of n steps [A], constant within a step
    ambient : ambient temperature of each step [degC]
    local : film and cantilever above the heated body [K]
    shift : what the transition sees besides the film's temperature [K]
    step : length of a step [s]

    Returns
    -------
    temperature, film_temperature : (n + 1,) of the heated body and of the film [degC]; element 0 is the start
    metal, structure : (n + 1,) transformed fractions [1]
    reversals : counted reversals of the temperature
    """
    electrical = np.array(
        [
            device.activation / ARRHENIUS,
            device.cold_temperature + 273.15,
            device.log_cold,
            device.log_hot,
            device.metal_slope,
            device.hot_temperature,
        ]
    )
    film, terms = device.film, Terms(*map(float, terms))
    temperature, film_temperature, metal, structure, reversals = _core(
        current, ambient, local, shift, step, device.time_constant, device.gain, device.preset.squared, terms, electrical,
        float(device.ambient), film.metal, film.structure, film.feedback + terms.feedback,
    )  # fmt: skip
    return temperature, film_temperature, metal, structure, int(reversals)
