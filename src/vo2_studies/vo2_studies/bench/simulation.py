"""How fast the device simulation runs: the complete fitted chain, and the simulated device itself."""

from __future__ import annotations

from time import perf_counter

import numpy as np
from vo2_models.device.description import preset
from vo2_models.device.ground_truth import truth
from vo2_models.device.model import DeviceModel
from vo2_models.device.simulation import Simulation
from vo2_models.hysteresis.play_bank import PlayBank

from vo2_studies.bench.entry import Entry, Figure

__all__ = ["ENTRIES", "fitted_chain"]

_SAMPLES = 200_000
_PLAYS = 10


def _currents() -> np.ndarray:
    low, high = preset("integrated").operating_range
    return np.repeat(np.random.default_rng(0).uniform(low, high, _SAMPLES // 10), 10)


def _rate(simulation: Simulation, repeats: int = 7) -> float:
    """Samples per second of the fastest run: other processes can only slow it down."""
    current = _currents()
    normals = np.zeros((current.size, 4))
    simulation.run(current[:100], dt=1e-3)
    best = np.inf
    for _ in range(repeats):
        begun = perf_counter()
        simulation.run(current, dt=1e-3, normals=normals)
        best = min(best, perf_counter() - begun)
    return current.size / best


def fitted_chain() -> Simulation:
    """Return a chain with all stages and a full loop in both channels, as `fit` writes it."""
    half = np.linspace(1.5, 5.5, _PLAYS)
    centre = np.linspace(60.0, 57.0, _PLAYS)
    slope = np.full(_PLAYS, 0.28)

    def bank(weight: float, polynomial: list[float]) -> PlayBank:
        return PlayBank(
            np.full(_PLAYS, weight), np.zeros(_PLAYS), slope, -slope * (centre + half), slope,
            -slope * (centre - half), polynomial,
        )  # fmt: skip

    model = DeviceModel(
        "integrated",
        resistance=bank(0.05, [-5.2, 4e-3, 1e-5, 0.0]),
        deflection=bank(3e-6, [30e-6, -1e-7, 0.0, 0.0]),
    )
    return model.simulation


def simulation() -> Figure:
    """The fitted simulation: driver, heat, two loops of ten plays with own envelopes, structure, four sensors."""
    return Figure(_rate(fitted_chain()), "samples/s", note=f"one core, 2 x {_PLAYS} plays, no effect")


def simulation_feedback() -> Figure:
    """The same with an effect that acts back on the heat: several thermal steps a sample and a root each."""
    rate = _rate(fitted_chain().with_effects({"latent_heat": {"latent": 10.0}}), 3)
    return Figure(rate, "samples/s", note="one core, latent heat")


def truth_device() -> Figure:
    """The simulated device: twice 4000 switching domains."""
    return Figure(_rate(truth("integrated", seed=1), 3), "samples/s", note="one core, 2 x 4000 domains")


ENTRIES = (
    Entry("simulation", simulation, 2e6, above=True),
    Entry("simulation_feedback", simulation_feedback),
    Entry("truth_device", truth_device, 2e5, above=True),
)
