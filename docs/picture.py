"""Draw the picture of the README: `python docs/picture.py` in the project's environment writes docs/picture.png."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from vo2_models.device import truth
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION, Recording
from vo2_models.self_sensing import self_sensing
from vo2_models.workflow import fit

BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#555555"
LOW, HIGH = 3.68e-3, 8.49e-3


def main() -> None:
    """Identify a simulated device from what a rig would record, then estimate an independent sequence."""
    device = truth("integrated", seed=4)
    slow = LOW + (HIGH - LOW) * np.repeat(damped_oscillation(np.linspace(0, 1, 31)), 10)
    recorded = device.simulate(slow, seed=1)
    names = ("heater_current", RESISTANCE, TIP_DEFLECTION)
    given = Recording(recorded.time_s, {name: recorded[name] for name in names}, "integrated")
    scheme = self_sensing("composite", fit(given, "integrated"))
    test = device.simulate(np.repeat(random_levels(LOW, HIGH, 60, seed=5), 10), seed=2)
    found, _ = scheme.estimate(test[RESISTANCE])

    figure, axes = plt.subplots(1, 3, figsize=(11, 3.2), constrained_layout=True)
    figure.get_layout_engine().set(wspace=0.05)
    temperature = recorded["true_temperature"]
    axes[0].semilogy(temperature, recorded[RESISTANCE] / 1e3, color=BLUE, lw=0.8)
    axes[0].set(xlabel="film temperature [°C]", ylabel="resistance [kΩ]", title="resistance falls a decade")
    axes[1].plot(temperature, 1e6 * recorded[TIP_DEFLECTION], color=BLUE, lw=0.8)
    axes[1].set(
        xlabel="film temperature [°C]", ylabel="tip deflection [µm]", title="the tip bends, not monotonically"
    )
    time = 1e3 * test.time_s
    axes[2].plot(time, 1e6 * test["true_tip_deflection"], color=GREY, lw=2.4, alpha=0.5, label="true")
    axes[2].plot(time, 1e6 * found.deflection, color=ORANGE, lw=0.9, ls="--", label="estimated")
    axes[2].set(xlabel="time [ms]", ylabel="tip deflection [µm]", title="estimated from the resistance alone")
    axes[2].set_ylim(-3, 82)
    axes[2].legend(loc="upper right", ncols=2, columnspacing=1.0, handlelength=1.6, frameon=False, fontsize=8)
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.savefig(Path(__file__).parent / "picture.png", dpi=130)


if __name__ == "__main__":
    main()
