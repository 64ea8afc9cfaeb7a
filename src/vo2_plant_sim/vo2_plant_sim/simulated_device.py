"""Which device the plant steps: the ground truth with its concealed effects, or the simulation of a model file."""

from __future__ import annotations

from collections.abc import Mapping

from vo2_interface.parameters import ParameterTable
from vo2_models.device import truth
from vo2_models.device.description import check_model_of
from vo2_models.device.stepper import Stepper
from vo2_models.io import load_yaml
from vo2_models.parameters import Parameter

__all__ = ["SIMULATED_DEVICE_PARAMETERS", "TRUE_CHANNELS", "SimulatedDevice", "simulated_device"]

TRUE_CHANNELS = ("true_tip_deflection", "true_temperature")
"""What no rig measures: deflection before its sensor [m], film temperature [degC]."""

SIMULATED_DEVICE_PARAMETERS = (
    Parameter("seed", 1, "1", "Which device: seed of its domains.", 0, 2**31 - 1),
    Parameter(
        "noise_seed",
        -1,
        "1",
        "Seed of the sensors' noise, for several runs of one device; -1 takes it from seed (seed + 1, with source "
        "model seed itself).",
        -1,
        2**31 - 1,
    ),
    Parameter(
        "source", "truth", "", "Step the ground truth, or what model.* describes.", choices=("truth", "model")
    ),
    Parameter(
        "effects",
        "",
        "",
        "Physics beyond the nominal device, as YAML; in a shell -p effects:='\"{creep: {share: 0.05}}\"'; empty for none.",
    ),
    Parameter("noise", True, "", "Whether the sensors are noisy."),
)


class SimulatedDevice:
    """One current in, one sample of every channel out.

    Attributes
    ----------
    period : sample period [s]
    channels : names of the measured channels, in the order of the values
    """

    def __init__(self, stepper: Stepper) -> None:
        self._stepper = stepper
        self.period = stepper.period
        self.channels = stepper.channels

    def step(self, current_a: float) -> list[float]:
        """Apply `current_a` [A] for one period; return the measured channels."""
        values: list[float] = self._stepper.step(current_a).tolist()
        return values

    def true_values(self) -> tuple[float, float]:
        """Return `TRUE_CHANNELS` of the last sample."""
        return self._stepper.true_deflection, self._stepper.temperature


def simulated_device(preset: str, rate_hz: float, parameters: ParameterTable) -> SimulatedDevice:
    """Return the device that the parameters describe.

    Parameters
    ----------
    preset : preset, or path of a device file
    rate_hz : samples per second of simulated time

    Raises
    ------
    ValueError : unknown effect, value out of range, or no model where one is asked for.
    """
    period = 1.0 / rate_hz if rate_hz else None
    seed, noise_seed = (int(parameters.number(name)) for name in ("seed", "noise_seed"))
    noise = parameters.flag("noise")
    effects = _effects(parameters.text("effects"))
    if parameters.text("source") == "model":
        from vo2_models.device.model import EFFECTS, DeviceModel

        given = parameters.given("model.") | parameters.undeclared(EFFECTS)
        if not given:
            raise ValueError(
                "source: found model, need model.* parameters; load a file that fit wrote (--params-file)"
            )
        model = DeviceModel.from_parameters(given)
        check_model_of(model.device, preset)
        drawn = seed if noise_seed < 0 else noise_seed
        return SimulatedDevice(
            Stepper(model.simulation.with_effects(effects), dt=period, seed=drawn, noise=noise)
        )
    device = truth(preset, seed=seed, effects=effects)
    # the noise has a stream of its own: the device must not change with it
    drawn = seed + 1 if noise_seed < 0 else noise_seed
    return SimulatedDevice(device.stepper(dt=period, seed=drawn, noise=noise))


def _effects(text: str) -> Mapping[str, Mapping[str, float | str]]:
    found = load_yaml(text, "effects") if text.strip() else {}
    if not isinstance(found, dict) or not all(isinstance(values, dict) for values in found.values()):
        raise ValueError(
            f'effects: found {text!r}, need a mapping such as "{{creep: {{share: 0.3, time_constant: 2.0}}}}"'
        )
    return found
