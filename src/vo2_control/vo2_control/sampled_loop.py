"""The loop as it really runs: a held current, a thermal lag with dead time, a sampled law; its margins."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vo2_models.validation import positive_number

from vo2_control.controller import LinearLaw

__all__ = [
    "Margins",
    "SampledPlant",
    "ThermalLag",
    "closed_loop_radius",
    "loop_margins",
    "modes",
    "with_modes",
]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ThermalLag:
    """K exp(-theta s) / (tau s + 1) from current to deflection (eq. 8.1 times K_c, with an exact delay).

    Attributes
    ----------
    gain : K, slope of deflection over current [m/A], or over squared current [m/A^2]
    time_constant_s : tau [s]
    dead_time_s : theta [s]
    """

    gain: float
    time_constant_s: float
    dead_time_s: float = 0.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.gain) or self.gain == 0:
            raise ValueError(
                f"gain: found {self.gain}, need a finite slope other than 0: else uncontrollable"
            )
        positive_number(self.time_constant_s, "time_constant_s")
        if not (math.isfinite(self.dead_time_s) and self.dead_time_s >= 0):
            raise ValueError(f"dead_time_s: found {self.dead_time_s}, need 0 s or more")

    def sampled(self, sample_period_s: float) -> SampledPlant:
        """Return the exact zero-order-hold discretisation, fractional delay included.

        A command computed from sample k acts from k on, so sample k + 1 sees it first.
        """
        period = positive_number(sample_period_s, "sample_period_s")
        whole = math.floor(self.dead_time_s / period + 1e-9)
        rest = max(self.dead_time_s - whole * period, 0.0)
        pole = math.exp(-period / self.time_constant_s)
        fresh = math.exp(-(period - rest) / self.time_constant_s)
        history = whole + (1 if rest > 1e-9 * period else 0)
        a = np.zeros((1 + history, 1 + history))
        b = np.zeros(1 + history)
        c = np.zeros(1 + history)
        a[0, 0], c[0] = pole, 1.0
        weights = {whole: self.gain * (1 - fresh), whole + 1: self.gain * (fresh - pole)}
        for delay, weight in weights.items():
            if delay == 0:
                b[0] += weight
            elif delay <= history:
                a[0, delay] += weight
        if history:
            b[1] = 1.0
            a[2:, 1:-1] = np.eye(history - 1)
        return SampledPlant(a, b, c, period)


@dataclass(frozen=True)
class SampledPlant:
    """x+ = a x + b u, y = c x: (n, n), (n,), (n,), at `sample_period_s` [s]."""

    a: Array
    b: Array
    c: Array
    sample_period_s: float

    def response(self, frequency_rad_s: Array) -> NDArray[np.complex128]:
        """Frequency response (m,) at the given angular frequencies [rad/s]."""
        return _response(self.a, self.b, self.c, 0.0, frequency_rad_s * self.sample_period_s)


@dataclass(frozen=True)
class Margins:
    """Robustness of one loop.

    Attributes
    ----------
    stable : all closed-loop poles inside the unit circle
    spectral_radius : largest magnitude of a closed-loop pole
    sensitivity_peak : Ms, largest |1/(1 + L)|; infinite if not stable
    complementary_peak : Mt, largest |L/(1 + L)|; infinite if not stable
    gain_margin : smallest factor above 1 that the loop gain may grow by; infinite where none
    phase_margin_deg : at the gain crossover with the least; infinite where there is none
    """

    stable: bool
    spectral_radius: float
    sensitivity_peak: float
    complementary_peak: float
    gain_margin: float
    phase_margin_deg: float


def closed_loop_radius(law: LinearLaw, plant: SampledPlant) -> float:
    """Largest magnitude of a pole of the sampled feedback loop; below 1 is stable.

    Parameters
    ----------
    law : of the controller
    plant : at the same sample period

    Returns
    -------
    float : of the largest pole
    """
    closed = np.block(
        [
            [plant.a + np.outer(plant.b, law.d[1] * plant.c), np.outer(plant.b, law.c)],
            [np.outer(law.b[:, 1], plant.c), law.a],
        ]
    )
    return float(np.abs(np.linalg.eigvals(closed)).max())


def loop_margins(law: LinearLaw, plant: SampledPlant, *, points: int = 1500) -> Margins:
    """Return the margins of the sampled feedback loop of `law` around `plant`.

    Parameters
    ----------
    law : its input from the estimate is used, the reference is taken as constant
    plant : at the same sample period
    points : frequencies, logarithmic from 1e-6 to 1 of the Nyquist frequency

    Raises
    ------
    ValueError : the sample periods differ.
    """
    if not math.isclose(law.sample_period_s, plant.sample_period_s, rel_tol=1e-9):
        raise ValueError(
            f"law: found a sample period of {law.sample_period_s:g} s, need the plant's {plant.sample_period_s:g} s"
        )
    radius = closed_loop_radius(law, plant)
    angle = with_modes(np.pi * np.logspace(-6, 0, points), plant)
    loop = -_response(law.a, law.b[:, 1], law.c, float(law.d[1]), angle) * _response(
        plant.a, plant.b, plant.c, 0.0, angle
    )
    stable = radius < 1
    sensitivity = 1 / np.maximum(np.abs(1 + loop), 1e-300)
    gain_margin = np.inf
    turns = np.flatnonzero((np.diff(np.sign(loop.imag)) != 0) & (loop.real[1:] < 0))
    for k in [*turns, loop.size - 1]:
        size = abs(loop.real[k])
        if loop.real[k] < 0 and size < 1:
            gain_margin = min(gain_margin, 1 / size)
    crossings = np.flatnonzero(np.diff(np.sign(np.abs(loop) - 1)) != 0)
    phases = [abs(np.degrees(np.angle(-loop[k]))) for k in crossings]
    return Margins(
        stable=stable,
        spectral_radius=radius,
        sensitivity_peak=float(sensitivity.max()) if stable else np.inf,
        complementary_peak=float((np.abs(loop) * sensitivity).max()) if stable else np.inf,
        gain_margin=float(gain_margin),
        phase_margin_deg=float(min(phases)) if phases else np.inf,
    )


def modes(plant: SampledPlant) -> NDArray[np.complex128]:
    """Return the poles (k,) of the modes of a plant that ring, one of each pair.

    Parameters
    ----------
    plant : sampled
    """
    poles = np.linalg.eigvals(plant.a)
    # the poles of a delay are at 0, wherever rounding puts them
    return np.asarray(poles[(np.abs(poles) > 0.1) & (poles.imag > 1e-6 * np.abs(poles))], dtype=np.complex128)


def with_modes(angle: Array, *plants: SampledPlant) -> Array:
    """Return angles of a frequency grid with more of them where a lightly damped mode of a plant has its peak.

    Parameters
    ----------
    angle : (m,) frequency times sample period [rad], growing
    plants : whose modes are looked at

    Returns
    -------
    (m + k,) angles, growing
    """
    poles = np.concatenate([modes(plant) for plant in plants])
    width = -np.log(np.minimum(np.abs(poles), 1 - 1e-9))
    near = np.add.outer(np.linspace(-3, 3, 25), np.zeros(poles.size)) * width + np.angle(poles)
    return np.union1d(angle, near[(near > angle[0]) & (near < angle[-1])])


def _response(a: Array, b: Array, c: Array, d: float, angle: Array) -> NDArray[np.complex128]:
    """c (zI - a)^-1 b + d on z = exp(i angle)."""
    if a.shape[0] == 0:
        return np.full(angle.shape, d, dtype=np.complex128)
    z = np.exp(1j * angle)
    matrices = z[:, None, None] * np.eye(a.shape[0]) - a
    states = np.linalg.solve(matrices, np.broadcast_to(b[:, None], (z.size, b.size, 1)))
    return np.asarray(states[:, :, 0] @ c + d)
