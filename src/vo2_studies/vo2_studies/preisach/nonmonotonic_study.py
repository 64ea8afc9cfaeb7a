"""Sections 5.3 and 5.4 in simulation: three models of a non-monotonic device, and two inverses that drive it.

    python -m vo2_studies.preisach.nonmonotonic_study [--devices 5]

The device is the simulated `peltier` one (thousands of switching domains, a hysteretic phase fraction in its
expansion, sensor noise): not the model that is fitted. It is held at each temperature until it has settled.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vo2_models.device import truth
from vo2_models.device.description import preset
from vo2_models.hysteresis.preisach.least_squares import fit_preisach
from vo2_models.hysteresis.preisach.nonmonotonic import fit_nonmonotonic
from vo2_models.hysteresis.preisach.nonmonotonic_inverse import NonMonotonicInverse
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.recording import TIP_DEFLECTION

from vo2_studies.preisach.beam import curvature_from_deflection
from vo2_studies.preisach.polynomial import fit_polynomial

__all__ = [
    "MODELS",
    "PUBLISHED",
    "PUBLISHED_PERCENT",
    "PUBLISHED_RANGE",
    "NonMonotonicStudy",
    "main",
    "nonmonotonic_study",
]

Floats = NDArray[np.float64]

MODELS = ("proposed", "signed Preisach", "polynomial")
PUBLISHED = {
    # "mostly bounded by" and "around"
    "fit max": {"proposed": 30.0, "polynomial": 500.0},
    "prediction max": {"proposed": 108.1, "signed Preisach": 108.8, "polynomial": 478.1},
    "inverse max": {"proposed": 78.0, "polynomial": 734.2},
    "inverse rms": {"proposed": 26.7, "polynomial": 320.6},
}
"""Errors as sections 5.3.2 and 5.4.2 print them [1/m]."""
PUBLISHED_RANGE = {
    "fit max": (-104.0, 1846.0),
    "prediction max": (-104.0, 1846.0),
    "inverse max": (-63.0, 1814.0),
    "inverse rms": (-63.0, 1814.0),
}
"""Curvatures that were measured, and those that were desired of the inverse [1/m]."""
PUBLISHED_PERCENT = {
    quantity: {
        model: 100 * error / (PUBLISHED_RANGE[quantity][1] - PUBLISHED_RANGE[quantity][0])
        for model, error in errors.items()
    }
    for quantity, errors in PUBLISHED.items()
}
"""The printed errors over the printed ranges [%]: of another device only shares can be compared."""

COLD, HOT = 23.0, 83.0
"""Operating range [degC]."""
TRANSITION = (44.0, 76.0)
"""Region where the phases coexist, [T_min, T_max] of chapter 5 [degC]."""
LEVEL = 20
SETTLE_S = 300.0


@dataclass(frozen=True, eq=False)
class NonMonotonicStudy:
    """Errors in per cent of a curvature range: quantity -> model -> value, averaged over the devices.

    Quantities are "fit max", "prediction max" (a random sequence of temperatures), both over the measured range,
    "inverse max" and "inverse rms" (open-loop tracking of random curvatures by the device itself), over the
    desired range.
    """

    percent: dict[str, dict[str, float]]
    most_temperatures: int


def nonmonotonic_study(*, devices: int = 5, seed: int = 0, targets: int = 150) -> NonMonotonicStudy:
    """Identify from one damped oscillation per device, then predict and invert.

    Raises
    ------
    ValueError : `devices` below 1.
    """
    if devices < 1:
        raise ValueError(f"devices: found {devices}, need at least 1")
    percent = {quantity: dict.fromkeys(models, 0.0) for quantity, models in PUBLISHED_PERCENT.items()}
    percent["fit max"]["signed Preisach"] = 0.0
    most = 0
    for number in range(devices):
        device = truth("peltier", seed=seed + number)
        length = preset("peltier").length

        def measured(temperature: Floats, run: int) -> Floats:
            recording = device.simulate((25.0 - temperature) / 50.0, dt=SETTLE_S, seed=run)  # noqa: B023
            return curvature_from_deflection(recording[TIP_DEFLECTION], length)  # noqa: B023

        rng = np.random.default_rng(seed + number)
        excited = damped_oscillation(np.linspace(COLD, HOT, 46))
        curvature = measured(excited, 1)
        span = float(np.ptp(curvature))
        proposed = fit_nonmonotonic(excited, curvature, np.linspace(*TRANSITION, LEVEL + 1))
        signed = fit_preisach(
            excited, curvature, np.linspace(COLD - 0.1, HOT + 0.1, LEVEL + 1), nonnegative=False
        )
        polynomial = fit_polynomial(excited, curvature)
        fitted: tuple[Callable[[Floats], Floats], ...] = (proposed, signed.operator, polynomial)
        probe = np.r_[COLD, random_levels(COLD, HOT, 200, seed=rng)]
        answer = measured(probe, 2)
        for name, model in zip(MODELS, fitted, strict=True):
            percent["fit max"][name] += (
                100 / devices * float(np.max(np.abs(model(excited) - curvature))) / span
            )
            percent["prediction max"][name] += (
                100 / devices * float(np.max(np.abs(model(probe) - answer))) / span
            )

        inverse = NonMonotonicInverse(proposed)
        wanted = rng.uniform(inverse.minimum[1], inverse.maximum[1], targets)
        state = proposed.operator.initial_memory()
        steps = [inverse.update(float(k), state).temperatures for k in wanted]
        most = max(most, *(len(step) for step in steps))
        arrival = np.cumsum([len(step) for step in steps])
        driven = {
            "proposed": measured(np.r_[COLD, np.concatenate(steps)], 3)[arrival],
            "polynomial": measured(np.r_[COLD, polynomial.inverse(wanted)], 3)[1:],
        }
        asked = inverse.maximum[1] - inverse.minimum[1]
        for name, reached in driven.items():
            error = 100 * (reached - wanted) / asked
            percent["inverse max"][name] += float(np.max(np.abs(error))) / devices
            percent["inverse rms"][name] += float(np.sqrt(np.mean(error**2))) / devices
    return NonMonotonicStudy(percent, most)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the errors of the three models and the two inverses beside the published ones."""
    parser = argparse.ArgumentParser(
        prog="python -m vo2_studies.preisach.nonmonotonic_study", description=main.__doc__
    )
    parser.add_argument("--devices", type=int, default=5, help="simulated devices to average over")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args(arguments)
    study = nonmonotonic_study(devices=chosen.devices, seed=chosen.seed)
    print(
        f"per cent of the measured or desired curvatures, mean of {chosen.devices} simulated devices (published: one measured "
        "device)"
    )
    for quantity, models in study.percent.items():
        for name, value in models.items():
            published = PUBLISHED_PERCENT[quantity].get(name)
            print(
                f"  {quantity:15} {name:16} {value:7.2f}   published {'-' if published is None else f'{published:.2f}'}"
            )
    print(f"temperatures per target: at most {study.most_temperatures}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
