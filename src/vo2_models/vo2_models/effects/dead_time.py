"""Transport delay between current and heat."""

from vo2_models.effects.record import HEAT, Effect, constant_of

EFFECT = Effect(
    id="dead_time",
    stage="driver",
    parameters=(constant_of("delay", 0, "s", "delay added to the nominal dead time", 0, 1e9),),
    channels=HEAT,
    typical={"integrated": {"delay": (0.5e-3, 4e-3)}, "peltier": {"delay": (0.3, 2.0)}},
    equation="tau dtheta/dt = k u(t - delay) - theta",
    excitation="steps or a chirp; the phase it adds grows in proportion to frequency",
    source="equation (8.1): 0.375 s on the Peltier stage",
    statement=(
        "The current acts only after a delay: an output buffer of the controller, or heat that has to travel. "
        "Every thermal signal comes later by the same time, whatever its size, inside and outside the "
        "transition."
    ),
)


def delay(delay):
    return delay
