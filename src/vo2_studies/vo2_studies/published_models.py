"""The parameters that the dissertation prints, as files for `--params-file`: `python -m vo2_studies.published_models`.

    tables_7_1_and_7_2.yaml   Tables 7.1 and 7.2: plant, estimator, controller
    table_6_3.yaml            Table 6.3: plant, estimator (kind drive)
    pi_chapter_7.yaml, pid_chapter_8.yaml   controllers by their gains
    hinf_chapter_8.yaml       the weights of section 8.3, which the node solves for
    robust_8_10.yaml          the controller (8.10) as it is printed

What is lost in print, and what was put in its place, stands at the head of each file.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from vo2_control.generalised_plant import DESIGN_PARAMETERS
from vo2_control.hinf import PUBLISHED_CONTROLLER
from vo2_control.pid import PUBLISHED_PELTIER_PID
from vo2_models.device.model import DeviceModel, SensorModel
from vo2_models.hysteresis.law_fit import fit_law
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.io import InputError, OutputFolder, write_whole
from vo2_models.parameters import Value
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

__all__ = [
    "PRINTED_ROBUST",
    "PublishedFile",
    "main",
    "printed_deflection",
    "printed_resistance",
    "published_files",
]

Floats = NDArray[np.float64]

PRINTED_ROBUST: Mapping[str, Value] = {
    "zpk.gain": -918.0,
    "zpk.zeros_rad_s": [-1.1, -5.3, -8.2, -100.0],
    "zpk.poles_rad_s": [-40830.0, -89.0, -1.0, -4.4],
    "zpk.poles_imaginary_rad_s": [0.0, 0.0, 0.0, 1.6],
}
"""(8.10); one value above 0 stands for the pair."""
SOLVED_GAIN = 0.0755
"""What `reproduce --only 8.3` finds for the printed weights [A/um]."""
SURROGATE = 1.0e4
"""Loop coordinate per current [K/A]: chapter 7 models over the current as a surrogate of the temperature (7.2)."""
OPERATING = (3.68e-3, 8.49e-3)
_RADII = np.arange(6) / 6
_CHAPTER_7 = {
    "schema": "vo2-device/1",
    "id": "integrated_chapter7",
    "drive": {
        "channel": "heater_current", "unit": "A", "limits": [0.0, 12.78e-3], "operating": list(OPERATING), "safe": 0.0,
    },
    "body": {
        "kind": "first_order", "ambient": 0.0, "linear_gain": SURROGATE, "square_gain": 0.0, "time_constant": 1.8e-3,
        "dead_time": 0.0,
    },
    "responses": {
        "film_resistance": {"unit": "ohm", "scale": "log10", "range": [11.19e3, 231.75e3], "noise": 2.0e-3},
        "tip_deflection": {"unit": "m", "range": [1.62e-6, 58.65e-6], "noise": 0.05e-6},
    },
    "sensing": {"from": "film_resistance", "to": "tip_deflection"},
    "structure": {"length": 425.0e-6},
    "sampling": {"period": 1.0e-3, "shortest": 5.0e-5},
}  # fmt: skip
_CHAPTER_6 = {
    "schema": "vo2-device/1",
    "id": "egpi_chapter6",
    "drive": {"channel": "input", "unit": "1", "limits": [-10.0, 10.0], "safe": 0.0},
    "body": {"kind": "first_order", "ambient": 0.0, "linear_gain": 1.0, "time_constant": 1.0e-3},
    "responses": {"output": {"unit": "1", "range": [-200.0, 200.0]}},
    "sampling": {"period": 1.0},
}


def printed_resistance() -> PlayBank:
    """Table 7.1 over the current in ampere: the output is -R in ohm (7.3), weights in units of 1e5 ohm."""
    weights = 1e5 * np.array([0.415, 0.648, 0.325, 0.0, 0.081, 0.618])
    return PlayBank(
        weights=weights, radii=_RADII,
        rising_slopes=np.full(6, 624.9), rising_offsets=np.full(6, -3.656),
        falling_slopes=np.full(6, 519.7), falling_offsets=np.full(6, -2.984),
        polynomial=np.array([-132556.3]),
    )  # fmt: skip


def printed_deflection() -> PlayBank:
    """Table 7.2 over the current in ampere: deflection in micrometres (7.5)."""
    return PlayBank(
        weights=np.array([27.24, 5.35, 3.18, 12.84, 1.00, 26.68]), radii=_RADII,
        rising_slopes=np.array([1202.6, 1376.2, 1243.0, 1173.7, 788.8, 788.8]),
        rising_offsets=np.array([-8.67, -12.15, -10.12, -7.42, -10.83, -11.21]),
        falling_slopes=np.array([982.5, 1754.8, 2169.2, 838.1, 1864.7, 1623.2]),
        falling_offsets=np.array([-6.49, -11.13, -11.56, -6.24, -6.46, -15.52]),
        polynomial=np.array([143.29, -8874.3]),
    )  # fmt: skip


def _over_coordinate(bank: PlayBank, output: float) -> PlayBank:
    """A bank over the current as one over the loop coordinate, its output scaled."""
    powers = SURROGATE ** np.arange(np.size(bank.polynomial))
    return PlayBank(
        weights=output * np.asarray(bank.weights), radii=bank.radii,
        rising_slopes=np.asarray(bank.rising_slopes) / SURROGATE, rising_offsets=bank.rising_offsets,
        falling_slopes=np.asarray(bank.falling_slopes) / SURROGATE, falling_offsets=bank.falling_offsets,
        polynomial=output * np.asarray(bank.polynomial) / powers,
    )  # fmt: skip


def _evaluated(bank: PlayBank, inputs: Floats) -> Floats:
    memory = bank.initial_memory()
    return np.array([bank.step(float(u), memory) for u in inputs])


@dataclass(frozen=True)
class PublishedFile:
    """A parameter file: its name, what stands at its head, its parameters for any node."""

    name: str
    head: str
    parameters: Mapping[str, Value]

    def text(self) -> str:
        """The YAML text."""
        comment = "".join(f"# {line}\n" for line in self.head.strip().splitlines())
        tree = {"/**": {"ros__parameters": dict(sorted(self.parameters.items()))}}
        return comment + str(yaml.safe_dump(tree, sort_keys=True, width=100))


def chapter_7_tables() -> PublishedFile:
    """Tables 7.1 and 7.2."""
    current = OPERATING[0] + (OPERATING[1] - OPERATING[0]) * damped_oscillation(np.linspace(0.0, 1.0, 31))
    places = np.arange(0.0, current.size - 0.75, 0.25)
    current = np.interp(places, np.arange(current.size), current)
    ohm = -_evaluated(printed_resistance(), current)
    fitted = fit_law("egpi", SURROGATE * current, -np.log10(ohm))
    deflection = _over_coordinate(printed_deflection(), 1e-6)
    tip = _evaluated(printed_deflection(), current)
    model = DeviceModel(
        device=json.dumps(_CHAPTER_7), resistance=fitted.law, deflection=deflection,
        sensors={RESISTANCE: SensorModel(noise=2e-3, residual=fitted.rmse), TIP_DEFLECTION: SensorModel(noise=0.05e-6)},
    )  # fmt: skip
    spans = f"{tip.min():.1f} to {tip.max():.1f} um", f"{ohm.min() / 1e3:.1f} to {ohm.max() / 1e3:.1f} kohm"
    head = f"""
Tables 7.1 and 7.2 of the dissertation as a model: plant, estimator (composite) and controller load it.
The loop coordinate is the current times 1e4 K/A, the surrogate g(T) of section 7.2.

Deflection: Table 7.2 digit by digit, in metres. From lower saturation it spans {spans[0]} over
3.68 to 8.49 mA, not the printed 1.62 to 58.65 um (7.3.1) nor 48.13 to 72.15 um (7.1.3): two recordings, digits lost.
Play 4 crosses its envelopes by 0.02; plays 5 and 6 never switch from lower saturation.

Resistance: Table 7.1 is a law of -R in ohm, its weights in units of 1e5 ohm and its sign reversed (the text has neither).
It spans {spans[1]}, the text says 11.19 to 231.75. Its envelopes cross above 6.39 mA. The model file
holds laws of -log10 R, so a bank of plays is fitted to what the table gives: r.m.s. {fitted.rmse:.4f} decades.

Not printed: noise and time constant of this recording (those of the preset integrated and 1.8 ms of 7.4 are used), the
polynomial of degree 8 and the Preisach weights it is compared with.
"""
    use: dict[str, Value] = {"preset": model.device, "source": "model"}
    return PublishedFile("tables_7_1_and_7_2.yaml", head, {**use, **model.to_parameters()})


def chapter_6_table(slope: float = 1e-3, terms: int = 27) -> PublishedFile:
    """Table 6.3: classical plays and 5 cos v."""
    radii = np.array([0, 0.2, 0.4, 0.6, 0.8, 2.0])
    weights = np.array([6, 2, 1, 2, 4, 4], dtype=float)
    cosine = np.zeros(2 * terms + 1)
    cosine[::2] = [5.0 * (-1.0) ** k / math.factorial(2 * k) for k in range(terms + 1)]
    same = np.full(6, slope)
    bank = PlayBank(
        weights=weights / slope, radii=slope * radii, rising_slopes=same, rising_offsets=np.zeros(6),
        falling_slopes=same, falling_offsets=np.zeros(6), polynomial=cosine,
    )  # fmt: skip
    model = DeviceModel(device=json.dumps(_CHAPTER_6), deflection=bank)
    head = """
Table 6.3 of the dissertation with D(v) = 5 cos v (6.17): plant, and estimator with kind drive, load it.
Input and output have no unit. The envelopes gamma(v) = v are tanh of 1e-3 v over 1e-3, within 4e-5 of v for |v| up to 10; the
cosine is its series to the 54th power, for |v| up to 10.
Radius 6 is printed as 2; the others are in steps of 0.2. What start the operators have is not printed.
"""
    use: dict[str, Value] = {
        "preset": model.device,
        "source": "model",
        "kind": "drive",
        "drive_channel": "input",
    }
    return PublishedFile("table_6_3.yaml", head, {**use, **model.to_parameters()})


def controllers() -> tuple[PublishedFile, ...]:
    """The printed controllers."""
    gains = {
        f"pid.{name}": getattr(PUBLISHED_PELTIER_PID, name)
        for name in ("kp", "ki", "kd", "derivative_filter_s", "reference_derivative_weight")
    }
    limits: dict[str, Value] = {"limits.lower_a": -1.2, "limits.upper_a": 1.2}
    operating = """
Neither law is told the current about which it works: 35 um need about -0.8 A. Set operating_a to what holds your device there;
0 A, the file's value, leaves the H-infinity design, which has no integral action, far from its reference.
"""
    weights: dict[str, Value] = {p.name: p.default for p in DESIGN_PARAMETERS if p.default is not None}
    return (
        PublishedFile(
            "pi_chapter_7.yaml",
            "PI of section 7.4: K_p 1.4e-3, K_I 2.03e-5, printed without units. Read as A/um at 1 kHz the loop is unstable;\n"
            "read as mA/um and A/(um sample) they give about the published errors.",
            {"preset": "integrated", "kind": "pi", "pid.kp": 1.4, "pid.ki": 2.03e4},
        ),
        PublishedFile(
            "pid_chapter_8.yaml",
            "PID of section 8.4: K_p 0.059, K_i 0.004, K_d 0.0136, read as A/um and with the plant's sign: negative heats.\n"
            "The printed derivative has no filter; one sample period (125 ms) makes it realisable.\n"
            + operating.strip(),
            {"preset": "peltier_chapter8", "kind": "pid", "operating_a": 0.0, **gains, **limits},
        ),
        PublishedFile(
            "hinf_chapter_8.yaml",
            "H-infinity of section 8.3: plant (8.1) and weights (8.5) to (8.9); the node solves for the controller, the printed\n"
            "matrices having lost entries. gamma is then 0.115 (printed 0.118). That is not (8.10), see robust_8_10.yaml:\n"
            f"the gain at zero frequency is {SOLVED_GAIN:g} A/um, that of (8.10) {abs(PUBLISHED_CONTROLLER(0)):.4f}.\n"
            + operating.strip(),
            {"preset": "peltier_chapter8", "kind": "hinf", "operating_a": 0.0, **weights, **limits},
        ),
        PublishedFile(
            "robust_8_10.yaml",
            "The controller (8.10) of section 8.3.2 digit by digit: zeros, poles and gain, from micrometres to ampere. Its\n"
            "pole at -40830 1/s is far beyond what 8 Hz sampling sees: the node replaces it by its gain.\n"
            + operating.strip(),
            {"preset": "peltier_chapter8", "kind": "zpk", "operating_a": 0.0, **PRINTED_ROBUST, **limits},
        ),
    )


def published_files() -> tuple[PublishedFile, ...]:
    """All files."""
    return (chapter_7_tables(), chapter_6_table(), *controllers())


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the files into a folder."""
    parser = argparse.ArgumentParser(
        prog="python -m vo2_studies.published_models", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--output", type=Path, required=True, metavar="DIR")
    options = parser.parse_args(arguments)
    files = published_files()
    outputs = OutputFolder(options.output, tuple(file.name for file in files))
    try:
        outputs.check()
        for file in files:
            write_whole(options.output / file.name, file.text())
            print(options.output / file.name)
        outputs.remember()
    except (InputError, OSError) as error:
        print(f"published_models: --output: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
