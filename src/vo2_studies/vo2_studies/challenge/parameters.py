"""Which parameter of a diagnosis means which drawn quantity: compared by effect, quantity and unit.

A diagnosis names its parameters as it likes. A parameter matches a quantity if its name is one of the quantity's
`names`; else if exactly one parameter and one quantity of the effect are left with the same kind of unit. What
cannot be matched is counted and reported, never dropped in silence.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["QUANTITIES", "Z90", "Comparison", "Quantity", "compare_parameters", "in_base_unit"]


@dataclass(frozen=True)
class Quantity:
    """One drawn quantity that a diagnosis should recover.

    Attributes
    ----------
    truth : its name among the answer's parameters
    names : what a diagnosis may call it, lower case
    unit : base unit, see `in_base_unit`
    sign_free : only the size is compared (the sign is a convention)
    group : of the quantities of one group (the same thing said in two ways) at most one is compared
    """

    truth: str
    names: tuple[str, ...]
    unit: str
    sign_free: bool = False
    group: str = ""


Z90 = 1.645
"""Half the width of a 90 per cent interval, in standard deviations of a normal distribution."""
_TIME = ("tau", "tau_s", "time_constant", "time_constant_s")
QUANTITIES: dict[str, tuple[Quantity, ...]] = {
    "second_thermal_mode": (
        Quantity("gain", ("gain", "g", "gain_2", "slow_gain", "share"), "1"),
        Quantity("time_constant", (*_TIME, "tau2", "tau_2", "tau_slow", "slow_time"), "s"),
    ),
    "dead_time": (Quantity("delay", ("theta", "theta_s", "delay", "dead_time", "dead_time_s"), "s"),),
    "cooling_asymmetry": (
        Quantity("ratio", ("tau_ratio", "tau_cooling_over_heating"), "1", group="cooling"),
        Quantity("change", ("ratio", "change", "cooling_ratio"), "1", group="cooling"),
    ),
    "ambient_drift": (
        Quantity("initial_rate", ("rate", "drift_rate", "initial_rate"), "K/s", group="drift"),
        Quantity("total_change", ("total", "total_change", "change"), "K", group="drift"),
    ),
    "nonlinear_heat_loss": (
        Quantity("share_at_60K", ("share_at_60k", "loss_share", "share"), "1"),
        Quantity("power", ("power", "exponent", "n"), "1"),
    ),
    "latent_heat": (Quantity("heat", ("l", "latent", "latent_heat", "heat"), "K"),),
    "heater_tcr": (Quantity("temperature_coefficient", ("alpha", "tcr", "temperature_coefficient"), "1/K"),),
    "laser_heating": (Quantity("rise", ("t_l", "rise", "laser", "temperature_rise"), "K"),),
    "sense_self_heating": (
        Quantity("rise_per_ohm", ("k", "k_s", "rise_per_ohm", "coefficient"), "K/ohm", group="sense"),
        Quantity("rise_at_cold", ("rise", "rise_at_cold"), "K", group="sense"),
    ),
    "transition_kinetics": (
        Quantity("time_constant", (*_TIME, "tau_k", "kinetic_time", "kinetics_time"), "s"),
    ),
    "phase_dependent_expansion": (
        Quantity("slope_change", ("slope_change", "delta_k", "dk", "expansion_change", "k1"), "m/K", True),
    ),
    "transition_offset": (Quantity("shift", ("delta", "offset", "shift", "delta_k"), "K"),),
    "minor_loop_incongruency": (Quantity("kappa", ("kappa", "kappa_k", "feedback"), "K"),),
    "training_drift": (
        Quantity("shift_per_reversal", ("shift_per_reversal", "per_reversal", "shift", "rate"), "K", True),
    ),
    "creep": (
        Quantity("share", ("share", "gain", "c", "creep", "fraction", "strength"), "1"),
        Quantity("time_constant", (*_TIME, "tau_c", "creep_time"), "s"),
    ),
    "cantilever_resonance": (
        Quantity("frequency", ("f", "f0", "frequency", "frequency_hz", "natural_frequency"), "Hz"),
        Quantity("damping_ratio", ("zeta", "damping", "damping_ratio"), "1"),
    ),
    "series_resistance": (Quantity("resistance", ("r", "r_s", "resistance", "series_resistance"), "ohm"),),
    "leakage_resistance": (
        Quantity(
            "resistance",
            ("r", "r_l", "resistance", "leakage_resistance", "parallel_resistance"),
            "ohm",
            group="l",
        ),
        Quantity("conductance", ("g", "g_l", "conductance"), "S", group="l"),
    ),
    "current_crosstalk": (Quantity("coupling", ("chi", "coupling", "crosstalk"), "ohm/A"),),
    "sensor_lag": (Quantity("time_constant", (*_TIME, "lag", "lag_s"), "s"),),
    "sensor_gain_drift": (
        Quantity("rate", ("d", "rate", "drift", "drift_rate"), "1/s", group="drift"),
        Quantity("total_change", ("total", "total_change", "change"), "1", group="drift"),
    ),
    "sensor_zero_drift": (
        Quantity("rate", ("rate", "drift", "drift_rate"), "m/s", group="drift"),
        Quantity("total_change", ("total", "total_change", "change"), "m", group="drift"),
    ),
    "clock_offset": (Quantity("delay", ("offset", "delay", "theta", "shift", "clock_offset"), "s", True),),
    "adc_saturation": (Quantity("level", ("level", "upper", "high", "maximum", "limit"), ""),),
    "adc_quantization": (Quantity("least_bit", ("lsb", "step", "least_bit", "resolution", "quantum"), ""),),
    "driver_saturation": (Quantity("limit", ("limit", "i_max", "maximum", "upper"), "A", True),),
    "driver_slew": (Quantity("slew_rate", ("rate", "slew", "slew_rate"), "A/s"),),
    "driver_deadzone": (Quantity("half_width", ("width", "half_width", "deadzone", "w"), "A"),),
    "phase_dependent_heat_loss": (Quantity("gamma", ("gamma",), "1"),),
    "peltier_joule_heating": (
        Quantity("joule", ("rho", "joule"), "K/A^2", True),
        Quantity("pumping", ("kappa", "pumping"), "1/A", True),
    ),
    "slow_relaxation": (
        Quantity("strength", ("a", "strength", "amplitude"), "1", True),
        Quantity("onset", ("t0", "t_0", "onset"), "s"),
    ),
    "non_hysteretic_branches": (
        Quantity("reversible_share", ("share", "reversible_share", "c", "fraction"), "1"),
    ),
    "rate_dependent_width": (),  # a logarithm of the rate here, a power there
    "loop_width_difference": (Quantity("width", ("width", "difference", "delta", "widening"), "K"),),
    "substrate_diffusion": (
        Quantity("gain", ("gain", "g", "share"), "1"),
        Quantity("time_constant", (*_TIME, "diffusion_time"), "s"),
    ),
    "log_creep": (
        Quantity("share", ("share", "gain", "c", "creep", "strength"), "1"),
        Quantity("onset", ("t0", "t_0", "onset"), "s"),
    ),
    "averaging": (Quantity("length", ("length", "window", "width", "duration"), "s"),),
    "drive_gain_drift": (
        Quantity("rate", ("d", "rate", "drift", "drift_rate"), "1/s", group="drift"),
        Quantity("total_change", ("total", "total_change", "change"), "1", group="drift"),
    ),
    "thermovoltage": (Quantity("slope", ("slope", "a", "coefficient", "seebeck"), "ohm/K"),),
    "contact_drift": (
        Quantity("rate", ("rate", "drift", "drift_rate"), "ohm/s", group="drift"),
        Quantity("total_change", ("total", "total_change", "change"), "ohm", group="drift"),
    ),
    "source_compression": (
        Quantity("share", ("share", "compression", "c"), "1"),
        Quantity("power", ("power", "exponent", "n"), "1"),
    ),
    "backlash": (Quantity("half_width", ("half_width", "width", "gap", "play"), "m"),),
    "stiffening": (Quantity("cubic", ("cubic", "share", "a"), "1"),),
    "sensor_ripple": (
        Quantity("amplitude", ("amplitude", "ripple", "a"), "m"),
        Quantity("period", ("period", "wavelength", "fringe"), "m"),
    ),
}
"""Effect id -> what its diagnosis should recover. Extend `names` where a diagnosis calls it otherwise."""

_PREFIX = {"": 1.0, "k": 1e3, "M": 1e6, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "n": 1e-9}
_BASE = ("ohm", "Hz", "s", "K", "A", "m", "S")
_WORDS = {"Ω": "ohm", "°C": "K", "degC": "K", "ohms": "ohm", "": "1", "-": "1", "none": "1", "kelvin": "K"}


def in_base_unit(unit: str) -> tuple[str, float]:
    """Return the base unit of `unit` and the factor to it: ms -> (s, 1e-3), um/K -> (m/K, 1e-6), % -> (1, 0.01)."""
    text = unit.strip().replace(" ", "").replace("²", "^2").replace("**", "^").replace("Ω", "ohm")
    text = re.sub(r"([A-Za-z])2\b", r"\1^2", text)
    if text in ("%", "percent"):
        return "1", 0.01
    if text in _WORDS:
        return _WORDS[text], 1.0
    over, factor = [], 1.0
    for place, part in enumerate(text.split("/")):
        name, _, power = part.partition("^")
        name = _WORDS.get(name, name) if name else name
        scale = 1.0
        for prefix, value in _PREFIX.items():
            for base in _BASE:
                if prefix and name == prefix + base:
                    name, scale = base, value
        power_number = float(power) if re.fullmatch(r"\d+(\.\d+)?", power or "") else 1.0
        factor *= scale**power_number if place == 0 else scale**-power_number
        over.append(name + (f"^{power}" if power else ""))
    return "/".join(over), factor


@dataclass(frozen=True)
class Comparison:
    """Result for one effect: errors (relative) and whether each 90 per cent interval held the truth.

    `unmatched` are the diagnosis' parameters without a counterpart, `missing` the quantities it did not report.
    """

    errors: dict[str, float]
    covered: dict[str, bool]
    unmatched: tuple[str, ...]
    missing: tuple[str, ...]


def compare_parameters(effect: str, truth: Mapping[str, Mapping], found: Mapping[str, Mapping]) -> Comparison:
    """Compare a diagnosis' parameters of one effect with the drawn ones.

    Parameters
    ----------
    effect : effect id
    truth : quantity -> {"value", "unit"}
    found : name -> {"value", "std", "unit"}

    A relative error is |value - truth| / |truth|; the 90 per cent interval is value +- 1.645 std.
    """
    quantities = [q for q in QUANTITIES.get(effect, ()) if q.truth in truth and truth[q.truth]["value"] != 0]
    pairs: dict[str, str] = {}
    left = dict(found)
    taken_groups: set[str] = set()

    def take(quantity: Quantity, name: str) -> None:
        pairs[quantity.truth] = name
        left.pop(name)
        if quantity.group:
            taken_groups.add(quantity.group)

    def open_quantities() -> list[Quantity]:
        return [q for q in quantities if q.truth not in pairs and q.group not in (taken_groups - {""})]

    def unit_of(quantity: Quantity) -> str:
        return in_base_unit(truth[quantity.truth]["unit"])[0]

    for quantity in list(quantities):
        if quantity not in open_quantities():
            continue
        for name in list(left):
            if name.lower() in quantity.names and in_base_unit(left[name]["unit"])[0] == unit_of(quantity):
                take(quantity, name)
                break
    for quantity in open_quantities():
        same = [name for name in left if in_base_unit(left[name]["unit"])[0] == unit_of(quantity)]
        rivals = [q for q in open_quantities() if unit_of(q) == unit_of(quantity)]
        if len(same) == 1 and len(rivals) == 1:
            take(quantity, same[0])
    errors, covered = {}, {}
    for quantity in quantities:
        if quantity.truth not in pairs:
            continue
        entry = found[pairs[quantity.truth]]
        factor = in_base_unit(entry["unit"])[1]
        value, std = float(entry["value"]) * factor, float(entry["std"]) * factor
        expected = float(truth[quantity.truth]["value"]) * in_base_unit(truth[quantity.truth]["unit"])[1]
        if quantity.sign_free:
            value, expected = abs(value), abs(expected)
        errors[quantity.truth] = abs(value - expected) / abs(expected)
        covered[quantity.truth] = abs(value - expected) <= Z90 * std
    missing = tuple(q.truth for q in open_quantities())
    return Comparison(errors, covered, tuple(left), missing)
