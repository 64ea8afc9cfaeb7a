"""All concealed effects: the contract's ids in one or several forms, their families, and what is outside them."""

from __future__ import annotations

from collections.abc import Mapping

from vo2_studies.challenge.effect import ConcealedEffect, Context, Drawn
from vo2_studies.challenge.effects_drive import EFFECTS as DRIVE
from vo2_studies.challenge.effects_film import EFFECTS as FILM
from vo2_studies.challenge.effects_forms import EFFECTS as FORMS
from vo2_studies.challenge.effects_heat import EFFECTS as HEAT
from vo2_studies.challenge.effects_sensor import EFFECTS as SENSOR
from vo2_studies.challenge.outside import COMPOSED, families_of

__all__ = [
    "CATALOGUE",
    "IDS",
    "OUTSIDE",
    "draw_effect",
    "families",
    "family_of_name",
    "forms",
    "presets_of",
    "redrawn",
]

CATALOGUE: tuple[ConcealedEffect, ...] = (*DRIVE, *HEAT, *FILM, *SENSOR, *FORMS)
IDS = tuple(dict.fromkeys(effect.id for effect in CATALOGUE))
OUTSIDE = COMPOSED.id

_FAMILIES: dict[str, tuple[str, ...]] = {
    "drive": (
        *("driver_saturation", "driver_slew", "driver_deadzone", "drive_gain_drift", "source_compression"),
    ),
    "heat": (
        *("second_thermal_mode", "substrate_diffusion", "dead_time", "cooling_asymmetry", "ambient_drift"),
        *("nonlinear_heat_loss", "latent_heat", "heater_tcr", "laser_heating", "sense_self_heating"),
        *("phase_dependent_heat_loss", "peltier_joule_heating"),
    ),
    "transition": (
        *("transition_kinetics", "minor_loop_incongruency", "training_drift", "slow_relaxation"),
        *("non_hysteretic_branches", "transition_offset", "loop_width_difference", "rate_dependent_width"),
    ),
    "film": (
        *("series_resistance", "leakage_resistance", "current_crosstalk", "thermovoltage", "contact_drift"),
    ),
    "structure": (
        *("phase_dependent_expansion", "creep", "log_creep", "cantilever_resonance", "backlash"),
        *("stiffening",),
    ),
    "sensor:tip_deflection": ("sensor_ripple", "sensor_zero_drift"),
}
_ALSO = {
    "transition_offset": "structure",
    "loop_width_difference": "structure",
    "latent_heat": "transition",
    "dead_time": "drive",
    "heater_tcr": "drive",
}
"""Another family that says as much: the lattice's own transition is the structure's, latent heat the transition's."""


def forms(name: str) -> tuple[ConcealedEffect, ...]:
    """Return the forms of the effect with id `name`, inside or outside the catalogue; `ValueError` if there is none."""
    found = tuple(effect for effect in (*CATALOGUE, COMPOSED) if effect.id == name)
    if not found:
        raise ValueError(f"effect: found {name!r}, need one of {', '.join(IDS)}")
    return found


def presets_of(name: str) -> tuple[str, ...]:
    """Return the presets that the effect applies to."""
    return forms(name)[0].presets


def family_of_name(name: str, signal: str | None) -> str:
    """Return the contract's family of the effect with id `name` on a sensor channel; "" for an unknown id."""
    if signal is not None and any(effect.id == name and effect.per_signal for effect in CATALOGUE):
        return f"{'clock' if name == 'clock_offset' else 'sensor'}:{signal}"
    return next((family for family, members in _FAMILIES.items() if name in members), "")


def families(drawn: Drawn) -> tuple[str, ...]:
    """Return the family of a drawn effect as the contract calls it, then others that say as much."""
    if drawn.effect is COMPOSED:
        return families_of(drawn.values)
    name = drawn.effect.id
    own = (family_of_name(name, drawn.signal),)
    return own + ((_ALSO[name],) if name in _ALSO else ())


def draw_effect(effect: ConcealedEffect, context: Context) -> Drawn:
    """Draw parameters of `effect` (and its channel) for the device in `context`."""
    if effect.per_signal:
        signal = str(context.rng.choice(context.signals()))
        return Drawn(effect, effect.draw(context, signal), signal)
    return Drawn(effect, effect.draw(context))


def redrawn(name: str, form: str, parameters: Mapping[str, Mapping], signal: str | None) -> Drawn:
    """Return a drawn effect from what an answer says of it."""
    (effect,) = (one for one in forms(name) if one.form == form)
    return Drawn(effect, {key: (p["value"], p["unit"]) for key, p in parameters.items()}, signal)
