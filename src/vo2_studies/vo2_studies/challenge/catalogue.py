"""All concealed effects: the contract's ids and those outside it."""

from __future__ import annotations

from vo2_studies.challenge.effect import ConcealedEffect, Context, Drawn
from vo2_studies.challenge.effects_film import EFFECTS as FILM
from vo2_studies.challenge.effects_heat import EFFECTS as HEAT
from vo2_studies.challenge.effects_outside import OUTSIDE
from vo2_studies.challenge.effects_sensor import EFFECTS as SENSOR

__all__ = ["CATALOGUE", "OUTSIDE", "draw_effect", "find"]

CATALOGUE: tuple[ConcealedEffect, ...] = (*HEAT, *FILM, *SENSOR)


def find(name: str) -> ConcealedEffect:
    """Return the effect with id `name`, inside or outside the catalogue; `ValueError` if there is none."""
    for effect in (*CATALOGUE, *OUTSIDE):
        if effect.id == name:
            return effect
    known = ", ".join(effect.id for effect in CATALOGUE)
    raise ValueError(f"effect: found {name!r}, need one of {known}")


def draw_effect(effect: ConcealedEffect, context: Context) -> Drawn:
    """Draw parameters of `effect` (and its channel) for the device in `context`."""
    if effect.per_signal:
        signal = str(context.rng.choice(context.signals()))
        return Drawn(effect, effect.draw(context, signal), signal)
    return Drawn(effect, effect.draw(context))
