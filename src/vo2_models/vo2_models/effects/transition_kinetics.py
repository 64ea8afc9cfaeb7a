"""The phase needs time to follow the temperature."""

import math

from vo2_models.effects.record import FILM, Effect, constant_of

EFFECT = Effect(
    id="transition_kinetics",
    stage="transition",
    parameters=(constant_of("time_constant", 0, "s", "relaxation time of the phase fraction", 0, 1e9),),
    channels=FILM,
    typical={"integrated": {"time_constant": (0.3e-3, 2e-3)}, "peltier": {"time_constant": (1.0, 6.0)}},
    slowest_time="time_constant",
    equation="tau_k ds/dt = s_eq[T] - s",
    excitation="crossings at more than one rate and a chirp inside and outside the transition",
    source="mismatch table of the project; section 7.2.1 takes it to be fast for an ideal film",
    statement=(
        "The metallic fraction relaxes towards its equilibrium with a time constant of its own. Loops widen "
        "with rate inside the transition only; outside, where nothing switches, the response is as fast as "
        "before."
    ),
)


def follow(equilibrium, before, output, h, time_constant):
    # exact for an equilibrium that moves linearly through the step
    ramp = -math.expm1(-h / time_constant) * time_constant / h
    left = math.exp(-h / time_constant)
    return equilibrium - (equilibrium - before) * ramp + (output - before) * left
